"""mean_median.cl and score.cl against their twins, bit by bit: each kernel, and fillings of every mask."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import islice
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from clsco.constants import CODE_LANES, FILL_LANES, SCORE_SUMS
from clsco.inpainting import mean_median
from clsco.inpainting.mean_median import KERNELS, Holes, Layout, score_image
from clsco.inpainting.rules import MeanMedian, bits_of, most_sweeps, score_of_sums
from clsco.opencl import source_text
from clsco.opencl.buffers import copied, download, upload
from clsco.opencl.program import Target, launch
from clsco.opencl.session import Session
from clsco.passes.pack import grid_struct
from clsco.reference.inpainting import mean_median as twin
from clsco.reference.inpainting.fill_mean_median import fill_mean_median, smooth_median
from clsco.reference.inpainting.score import score_mean_median
from tests.slow import mostly_slow

Array = NDArray[Any]
Mask = NDArray[np.bool_]
NO_WINS, ALL_WIN, SOME_WIN = (np.arange(9) >= k for k in (9, 4, 6))


def target(session: Session, channels: int, codes: bool = False) -> Target:
    features = {"CHANNELS": channels, "CODES": codes, "ALONE": mean_median.group_size(session) == 1}
    return Target(session, KERNELS, features | {"FILL_MEAN_MEDIAN": 1, "IMAGE": 1}, "float")


class Sheet(Layout):
    """Many images in one, with nothing between them: each is filled as if it were alone."""

    def __init__(self, missing: Mask, inside: Mask) -> None:
        super().__init__(missing)
        self.border = np.flatnonzero(twin.border_pixels(missing) & inside)


def sheet_of(masks: Array) -> tuple[Mask, Mask]:
    """Missing pixels of masks (N, H, W), one below another with a row between, and what is inside of any."""
    count, rows, columns = masks.shape
    missing, inside = (np.zeros((count, rows + 1, columns), np.bool_) for _ in range(2))
    missing[:, :-1], inside[:, :-1] = masks, True
    return missing.reshape(-1, columns), inside.reshape(-1, columns)


def check_sheet(
    session: Session, masks: Array, wins: Mask, minimum: int, channels: int, rounds: int = 2
) -> NDArray[np.int64]:
    """Fill masks on the device and in the reference, which must agree in every bit; sweeps that each has taken, without
    a limit."""
    missing, inside = sheet_of(masks)
    image = np.random.default_rng(5).random((*missing.shape, channels)).astype(np.float32)
    holes = Holes(session, target(session, channels), Sheet(missing, inside), image)
    sweeps = holes.fill(np.int32(bits_of(wins)), minimum, mean_median.NEVER, lambda share: None)
    values = np.where((inside & ~missing)[..., None], image, np.float32(0))
    expected, taken = plain_sweeps(values, inside & ~missing, missing, wins, minimum, masks.shape[0])
    assert expected.dtype == np.float32
    assert (holes.values() == expected[missing]).all()
    assert sweeps == taken.shape[0]
    if rounds:
        for _ in range(rounds):
            expected = smooth_median(expected, missing, inside)
        assert (holes.smooth(rounds, lambda share: None) == expected[missing]).all()
    return taken.sum(axis=0)


def check_alone(session: Session, mask: Mask) -> int:
    """The same of one mask with the limit, and the sweeps that it has taken."""
    image = np.random.default_rng(5).random((*mask.shape, 1)).astype(np.float32)
    holes, limit = Holes(session, target(session, 1), Layout(mask), image), most_sweeps(*mask.shape)
    sweeps = holes.fill(np.int32(bits_of(SOME_WIN)), 4, limit, lambda share: None)
    values = np.where(mask[..., None], np.float32(0), image)
    expected, taken = twin.sweep_holes(values, ~mask, mask, SOME_WIN, 4)
    assert (holes.values() == expected[mask]).all()
    assert sweeps == taken
    return sweeps


def plain_sweeps(
    values: Array, known: Mask, missing: Mask, wins: Mask, minimum: int, images: int
) -> tuple[Array, NDArray[np.bool_]]:
    """Values of a sheet after all sweeps, and in which of its images each has filled something (sweeps, images).

    An image that stalls waits until all do: that changes nothing in it.
    """
    taken, least = [], minimum
    sheet: list[Array] = [array.reshape(images, -1, *array.shape[1:]).copy() for array in (values, known, missing)]
    while (left := np.flatnonzero(sheet[2].any(axis=(1, 2)))).size:
        planes, valid, open_ = (array[left].reshape(-1, *array.shape[2:]) for array in sheet)
        planes, filled, _ = fill_mean_median(planes, valid, open_, wins, least)
        for array, new in zip(sheet, (planes, valid | filled, open_ & ~filled), strict=True):
            array[left] = new.reshape(left.size, *array.shape[1:])
        if filled.any():
            taken.append(np.isin(np.arange(images), left[filled.reshape(left.size, -1).any(axis=1)]))
        least = minimum if filled.any() else least - 1
    return sheet[0].reshape(values.shape), np.array(taken).reshape(-1, images)


def test_every_mask_of_4_x_4_ends(session: Session) -> None:
    """All 65,536 but the one with nothing known."""
    masks = (np.arange(2**16 - 1)[:, None] >> np.arange(16) & 1).astype(np.bool_).reshape(-1, 4, 4)
    assert check_sheet(session, masks, SOME_WIN, 4, 1, rounds=1).max() <= most_sweeps(4, 4)


@pytest.mark.parametrize(("wins", "minimum", "channels"), [(NO_WINS, 4, 3), (ALL_WIN, 3, 1), (SOME_WIN, 8, 1)])
def test_some_masks_of_4_x_4_by_other_constants(session: Session, wins: Mask, minimum: int, channels: int) -> None:
    masks = np.random.default_rng(7).random((1000, 4, 4)) < 0.8
    masks[masks.all(axis=(1, 2)), 0, 0] = False
    assert check_sheet(session, masks, wins, minimum, channels).max() <= most_sweeps(4, 4)


def random_masks(seed: int, shapes: int, each: int) -> Iterator[Array]:
    """Masks (each, H, W) of random sizes up to 64 x 64 and densities, blocks and half images among them."""
    rng = np.random.default_rng(seed)
    for _ in range(shapes):
        rows, columns = rng.integers(1, 65, 2)
        masks = rng.random((each, rows, columns)) < rng.random((each, 1, 1))
        for mask in masks[::3]:
            top, left = rng.integers(0, rows), rng.integers(0, columns)
            mask[top : top + rng.integers(1, 65), left : left + rng.integers(1, 65)] = True
        at = rng.integers(0, rows, each), rng.integers(0, columns, each)
        masks[np.arange(each), *at] = False  # something is known
        yield masks


def test_random_masks_end(session: Session) -> None:
    for masks in random_masks(11, 6, 20):
        assert check_sheet(session, masks, SOME_WIN, 4, 1).max() <= most_sweeps(*masks.shape[1:])


@pytest.mark.slow
def test_ten_thousand_random_masks_end(session: Session) -> None:
    limited = 0
    for masks in random_masks(13, 100, 100):
        rows, columns = masks.shape[1:]
        for mask in masks[check_sheet(session, masks, SOME_WIN, 4, 1) > most_sweeps(rows, columns)]:
            assert check_alone(session, mask) <= 4 * (rows + columns)
            limited += 1
    assert limited > 30


@pytest.mark.parametrize("most", [0, mean_median.MOST_ENTRIES])
def test_no_mask_takes_more_than_four_sweeps_per_row_and_column(
    session: Session, most: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """This one would take 4.09 of them; launched sweep by sweep or not."""
    monkeypatch.setattr(mean_median, "MOST_ENTRIES", most)
    mask = next(islice(random_masks(13, 100, 100), 83, None))[31]
    assert mask.shape == (61, 51)
    assert check_sheet(session, mask[None], SOME_WIN, 4, 1) > 4 * (61 + 51)
    assert most_sweeps(61, 51) < check_alone(session, mask) <= 4 * (61 + 51)


@pytest.mark.parametrize("shape", [(1, 2), (1, 33), (33, 1), (2, 21), (21, 2), (64, 61)])
def test_all_but_one_pixel_is_missing(session: Session, shape: tuple[int, int]) -> None:
    """It is anywhere in the image: in corners, at borders, inside."""
    every = np.arange(shape[0] * shape[1])
    some = every if every.size < 100 else every[[0, shape[1] - 1, 30, -1, -shape[1], every.size // 2]]
    masks = np.ones((some.size, *shape), np.bool_)
    masks.reshape(some.size, -1)[np.arange(some.size), some] = False
    assert check_sheet(session, masks, SOME_WIN, 4, 3).max() <= most_sweeps(*shape)


def test_holes_at_corners_and_borders(session: Session) -> None:
    masks = np.zeros((9, 20, 23), np.bool_)
    for mask, i, j in zip(masks, (0, 0, 0, 7, 7, 7, 14, 14, 14), (0, 8, 16, 0, 8, 16, 0, 8, 16), strict=True):
        mask[i : i + 6, j : j + 7] = True
    assert check_sheet(session, masks, SOME_WIN, 4, 3, rounds=20).max() < 20


@pytest.mark.parametrize("most", mostly_slow([0, 40, 10**9], [40]))
def test_sweeps_are_the_same_launched_or_not(session: Session, most: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Long sweeps are launched, short ones are the work of a group of any size."""
    monkeypatch.setattr(mean_median, "MOST_ENTRIES", most)
    for size in (1, 8):
        monkeypatch.setattr(mean_median, "group_size", lambda session, size=size: size)
        for masks in random_masks(17, 2, 3):
            check_sheet(session, masks, SOME_WIN, 4, 1)


def test_a_group_sweeps_what_is_left_of_a_list(session: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    """Earlier entries of the list stay as they are."""
    monkeypatch.setattr(mean_median, "group_size", lambda session: 8)
    missing = np.zeros((18, 27), np.bool_)
    missing[1::3, 1::3] = True
    image = np.random.default_rng(43).random((18, 27, 1)).astype(np.float32)
    built, size, begin = target(session, 1), np.int32(missing.sum()), 24
    holes = Holes(session, built, Layout(missing), image)
    lists, state = holes._lists(np.minimum(holes.level, 4), 4)
    state[4, 0] = begin
    rest = (holes.beside, size, np.int32(4), holes.found, holes.value, holes.near, lists, copied(session, state))
    args = (holes.slots, size, np.int32(1), np.int32(bits_of(SOME_WIN)), *rest)
    launch(session, built["sweep_holes"], (8,), (8,), *args)
    assert download(session, rest[-1], (5, 2), np.int32)[[0, 4]].tolist() == [[1, size - begin], [size, size]]
    known_values = np.where(missing[..., None], np.float32(0), image)
    expected, *_ = fill_mean_median(known_values, ~missing, missing, SOME_WIN, 4)
    for plane in (holes.found, holes.value):
        found = download(session, plane, (int(holes.slots),), np.float32)[holes.index]
        assert (found[:begin] == np.inf).all()
        assert (found[begin:] == expected[missing][begin:, 0]).all()


def test_a_lone_pixel_is_filled_by_one_launch_and_smoothed(session: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    """As many entries as a single work-group takes at most, and a pixel more than vectors are full of."""
    monkeypatch.setattr(mean_median, "MOST_ENTRIES", 1)
    missing = np.zeros((5, 5), np.bool_)
    missing[2, 2] = True
    image = np.random.default_rng(31).random((5, 5, 1)).astype(np.float32)
    holes, shares = Holes(session, target(session, 1), Layout(missing), image), list[float]()

    def tell(share: float) -> None:
        shares.append(share)
        assert shares == [1.0]

    assert holes.fill(np.int32(bits_of(NO_WINS)), 4, mean_median.NEVER, tell) == 1
    filled: Array = image.copy()
    filled[missing] = holes.values()
    smoothed = smooth_median(filled, missing, np.ones_like(missing))
    assert smoothed[2, 2] != filled[2, 2]
    assert (holes.smooth(1, lambda share: None) == smoothed[missing]).all()


BORDERED = [((1, 1), 1), ((1, 9), 1), ((2, 70), 3), ((50, 43), 3), ((33, 8), 16)]


@pytest.mark.parametrize(("shape", "channels"), mostly_slow(BORDERED, BORDERED[:-1]))
def test_the_border_is_its_twin(
    session: Session, shape: tuple[int, int], channels: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = np.random.default_rng(23)
    image, missing = rng.random((*shape, channels)).astype(np.float32), rng.random(shape) < 0.3
    missing[0, 0] = False
    built, layout = target(session, channels), Layout(missing)
    stages = mean_median.Stages(layout.pixels, layout.border)
    stages.smoothed = rng.random((layout.pixels.size, channels)).astype(np.float32)
    whole: Array = image.copy()
    whole[missing] = stages.smoothed
    steepness, blended = twin.blend_border(whole, twin.border_pixels(missing))
    assert ((mean_median.dilated(missing) & ~missing) == twin.border_pixels(missing)).all()
    for values in (mean_median.BAND_VALUES, 100):
        monkeypatch.setattr(mean_median, "BAND_VALUES", values)
        mean_median.blend_border(session, built, image, missing, stages, lambda share: None)
        assert (stages.gradients == np.sqrt(steepness.astype(np.float64))).all()
        assert (stages.blended == blended).all()


@pytest.mark.parametrize("count", [20, 8 * FILL_LANES + 1])
def test_a_group_writes_its_own_border_pixels_only(session: Session, count: int) -> None:
    border = np.arange(90) < count
    image: Array = np.random.default_rng(37).random((9, 10, 1)).astype(np.float32)
    entries, outputs = np.flatnonzero(border), [copied(session, np.full(90, -1, np.float32)) for _ in range(2)]
    given = upload(session, entries.astype(np.int32)), np.int32(count), upload(session, image)
    blend, grid = target(session, 1)["blend_border"], grid_struct(9, 10, 0, "float")
    launch(session, blend, mean_median.VECTORS, mean_median.VECTORS, grid, *given, *outputs)
    for output, expected in zip(outputs, twin.blend_border(image, border.reshape(9, 10)), strict=True):
        found, own = download(session, output, (90,), np.float32), min(count, 8 * FILL_LANES)
        assert (found[:own] == expected.ravel()[:own]).all()
        assert (found[own:] == -1).all()


@pytest.mark.parametrize("avx2", [True, False])
def test_scores_of_codes_are_exact(session: Session, avx2: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Columns fill segments; each writes its own sums only. On processors without AVX2 as well."""
    text = source_text.program_text
    if not avx2:
        monkeypatch.setattr(source_text, "program_text", lambda *arguments: "#undef __AVX2__\n" + text(*arguments))
        monkeypatch.setattr(session, "programs", {})
    rng, rows, columns = np.random.default_rng(41), 4, 128
    image, missing = rng.integers(0, 256, (rows, columns, 1), np.uint8), rng.random((rows, columns)) < 0.02
    room = np.zeros(CODE_LANES, np.uint8)
    planes = (np.concatenate([plane.ravel(), room]) for plane in (image, (~missing).astype(np.uint8)))
    sums, grid = (
        copied(session, np.full((rows + 1, SCORE_SUMS), -1, np.int64)),
        grid_struct(rows, columns, 0, "float"),
    )
    buffers = *(upload(session, plane) for plane in planes), sums
    score = target(session, 1, codes=True)["score_mean_median"]
    launch(session, score, (rows,), mean_median.OWNERS, grid, np.float32(256), *buffers)
    found = download(session, sums, (rows + 1, SCORE_SUMS), np.int64)
    assert score_of_sums(found[:rows], 256.0) == score_mean_median(image.astype(np.float64), ~missing, 256.0)
    assert (found[rows:] == -1).all()


@pytest.mark.parametrize("dtype", mostly_slow([np.uint8, np.uint16, np.float32], [np.uint16, np.float32]))
def test_scores_of_images_are_exact(session: Session, dtype: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """In bands of any height, and with whole numbers of 64 bits where the device has no float64."""
    rng = np.random.default_rng(29)
    lesser, codes = replace(session.device, has_fp64=False), dtype == np.uint8
    for shape in [(1, 1), (2, 5), (3, 3), (20, 300), (61, 70)]:
        floats = rng.normal(size=(*shape, 3)) * 3.0
        image = (
            floats.astype(dtype) if dtype == np.float32 else rng.integers(0, np.iinfo(dtype).max, (*shape, 3), dtype)
        )
        missing = rng.random(shape) < 0.05
        scale = 2.0**12 if dtype == np.float32 else 1.0 if dtype == np.uint16 else 256.0
        expected = score_mean_median(image.astype(np.float64), ~missing, scale)
        assert expected.samples > 100 or min(shape) < 4
        if dtype == np.float32:
            image[missing] = np.nan
        for values in (10**6, 100):
            monkeypatch.setattr(mean_median, "BAND_VALUES", values)
            found = score_image(session, target(session, 3, codes), image, missing, scale, lambda share: None)
            assert found == expected
    with Session(lesser) as opened:
        assert score_image(opened, target(opened, 3, codes), image, missing, scale, lambda share: None) == expected


@pytest.mark.parametrize("dtype", mostly_slow([np.uint8, np.float32], [np.uint8]))
def test_what_gpus_build_gives_the_same_bits(session: Session, dtype: Any) -> None:
    """Vectors in plain OpenCL C, atomics and groups of many work-items."""
    rng = np.random.default_rng(29)
    image = rng.integers(0, 256, (41, 70, 1)).astype(dtype)
    missing = rng.random((41, 70)) < 0.2
    missing[10:30, 20:50] = True
    with Session(replace(session.device, kind="gpu")) as opened:
        stages = [
            mean_median.fill_mean_median(one, image, missing, 255.0, MeanMedian(), lambda share: None)
            for one in (session, opened)
        ]
    one, other = stages
    assert one.score == other.score
    assert one.sweeps == other.sweeps
    for name in ("filled", "smoothed", "gradients", "blended"):
        assert np.array_equal(getattr(one, name), getattr(other, name)), name
