"""Each kernel of layered.cl against its twin on planes that stand amid other numbers, with work-items beyond them.

Whole frames hardly tell of what is rare in them: ends of rows, ties, radii at a bound, levels of which little is known.
"""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
import pyopencl as cl
import pytest
from numpy.typing import NDArray

from clsco.opencl.program import build, kernel, launch
from clsco.opencl.session import Session
from clsco.passes.blur import PLAIN
from clsco.passes.pack import grid_struct
from clsco.records import flat, structs
from clsco.reference.layered import layered as twin
from tests.kernels.launches import Amid

Array = NDArray[Any]
RNG = np.random.default_rng
LOCAL = (8, 4)  # beyond the grids in both directions
ROUNDING = 1e-6  # of sums of 16 terms of numbers up to 4, as in test_layer.py
CHANNELS = 2  # of the image


def run(session: Session, name: str, size: tuple[int, ...], *args: Any, scatter: bool = False) -> None:
    """Kernel `name` over more than `size` work-items, one in each direction at least."""
    features = PLAIN | {"SAMPLED": 0, "CHANNELS": CHANNELS + 1, "SCATTER": int(scatter)}
    program = build(session, ["layered/layered.cl"], features, structs("double"), "double")
    given = [arg.buffer if isinstance(arg, Amid) else arg for arg in args]
    launch(session, kernel(program, name), tuple(n + 1 for n in size), LOCAL[: len(size)], *given)


def grid(shape: tuple[int, ...]) -> Any:
    return grid_struct(shape[0], shape[1], 0, "double")


def plane(session: Session, array: Array, around: float, dtype: Any = np.float32) -> Amid:
    return Amid(session, np.ascontiguousarray(array, dtype), around)


def test_jumps_are_added_to_those_known(session: Session) -> None:
    """Jumps of exactly as many px as divide classes, of more than the largest class, at either end, and amid holes.

    Radii beyond the bins are in the outermost ones.
    """
    rng, low, bins = RNG(61), -2.0, 16
    near = np.array([-2.5, -1.0, -0.25, 0.0, 0.5, 0.75, 1.0, 1.75])
    far_away = np.array([0.0, 1.0, 2.0, 512.0, 513.0, 1023.0, 1025.0, 3000.0])
    pools = (near, np.concatenate([near, near + 2.0 ** np.arange(8)]), far_away)
    above = np.zeros((), bool)
    for number in range(60):
        shape = (int(rng.integers(1, 5)), int(rng.integers(1, 6)))
        coc = rng.choice(pools[number % 3], shape) * rng.choice([-1.0, 1.0])
        valid, far = rng.random(shape) < rng.choice([0.5, 1.0]), int(rng.choice([1, 2, 3]))
        expected, largest_sum = twin.find_discontinuities(coc, valid, low, bins, far)
        whole = np.append(expected, largest_sum)
        before = np.where(rng.random(whole.size) < 0.3, rng.integers(0, 9, whole.size), 0)
        before[0], before[-1] = 9000, number % 2  # no jump's number is as large, but another place's
        latest = plane(session, before, 1 << 20, np.int32)
        head = grid(shape), np.float64(low), np.int32(bins), np.int32(far)
        maps = plane(session, coc, 77.0, np.float64), plane(session, valid, 1, np.uint8)
        run(session, "find_discontinuities", (sum(shape),), *head, *maps, latest)
        np.testing.assert_array_equal(latest.now(), np.maximum(before, whole), err_msg=f"{coc} {valid} {far}")
        above = above | (expected > 0).any(axis=1)
    assert above.all()


@pytest.mark.parametrize("count", [1, 4, 7])
def test_labels_of_radii_beyond_the_bins(session: Session, count: int) -> None:
    rng, shape, low, bins = RNG(62), (5, 19), -2.0, 16
    coc, valid = rng.integers(-14, 15, shape) / 4, rng.random(shape) < 0.8
    bounds = sorted([1, 15, *rng.permutation(np.arange(2, 15))[: max(count - 2, 0)].tolist()])[:count]
    expected = twin.label_depth_layers(coc, valid, low, bins, bounds)
    assert expected.max() == count + 1
    layer = plane(session, np.full(shape, 99), 99, np.uint8)
    some = cl.cltypes.make_int8(*bounds, *(0,) * (8 - count))  # type: ignore[attr-defined]
    head = grid(shape), np.float64(low), np.int32(bins), np.int32(count), some
    maps = plane(session, coc, 0.0, np.float64), plane(session, valid, 1, np.uint8)
    run(session, "label_depth_layers", shape[::-1], *head, *maps, layer)
    np.testing.assert_array_equal(layer.now(), expected)


@pytest.mark.parametrize("shape", [(1, 9), (9, 1), (11, 24), (6, 37)])
def test_seeds_of_any_labels(session: Session, shape: tuple[int, int]) -> None:
    """Also jumps within a layer, and of exactly 1 px; all seeds of a column in its last row, or in its first."""
    for number in range(8):
        rng = RNG(number)
        layer = rng.integers(0, 5, shape).astype(np.uint8)
        coc = rng.integers(0, 7, shape) / 2
        seed = plane(session, np.full(shape, 99), 99, np.uint8)
        maps = plane(session, coc, 50.0, np.float64), plane(session, layer, 9, np.uint8)
        run(session, "seed_hidden", shape[::-1], grid(shape), *maps, seed)
        expected = twin.seed_hidden(coc, layer)
        np.testing.assert_array_equal(seed.now(), expected)
        few = np.where(rng.random(shape) < 0.2, expected, 0)
        few[0, ::3], few[-1, 1::3] = 3, 2
        offset = plane(session, np.full(shape, 99), 99, np.int32)
        run(session, "column_seeds", (-(-shape[1] // 16),), grid(shape), plane(session, few, 1, np.uint8), offset)
        np.testing.assert_array_equal(offset.now(), twin.column_seeds(few))


def seeds_of(kind: str, shape: tuple[int, int]) -> Array:
    """Labels (H, W) of seeds, 0 for none."""
    rng, seed = RNG(64), np.zeros(shape, np.uint8)
    labels = rng.integers(1, 6, shape)
    if kind == "none":
        return seed
    if kind == "aside":  # the first pixel of a run has them to one side alone
        seed[:2, 71:] = labels[:2, 71:]
    elif kind == "farther aside":
        seed[:2, 72:] = 5
    elif kind == "ends":  # of rows; what is beyond the end of one is in the next one
        seed[::2, 0], seed[1::5, -1], seed[2, 63:65] = 3, 4, 5
    elif kind == "lone":
        seed[5, np.array([30, 98, 100, 131]) % shape[1]] = 5, 2, 4, 3
    elif kind == "left":
        seed[:, 3] = 5
    else:
        seed = np.where(rng.random(shape) < float(kind), labels, 0).astype(np.uint8)
    return seed


@pytest.mark.parametrize("kind", ["none", "aside", "farther aside", "ends", "lone", "left", "0.002", "0.01", "0.2"])
@pytest.mark.parametrize(("columns", "deep"), [(200, 20), (192, 9), (203, 3), (150, 11), (70, 8)])
def test_nearest_seeds_of_runs(session: Session, kind: str, columns: int, deep: int) -> None:
    """Runs are amid the row, or at an end of it; with seeds as far away as they may be, and many equally near."""
    shape = (17, columns)
    seed = seeds_of(kind, shape)
    layer = RNG(65).integers(0, 4, shape).astype(np.uint8)
    offset = twin.column_seeds(seed)
    hidden, edge = (plane(session, np.full(shape, 99), 99, np.uint8) for _ in range(2))
    maps = plane(session, layer, 1, np.uint8), plane(session, seed, 5, np.uint8), plane(session, offset, 0, np.int32)
    runs = (-(-columns // 64), shape[0])
    run(session, "reach_hidden", runs, grid(shape), np.int32(deep), *maps, hidden, edge)
    expected, near = twin.reach_hidden(layer, seed, offset, deep)
    np.testing.assert_array_equal(hidden.now(), expected)
    np.testing.assert_array_equal(edge.now(), near)


def level(rng: np.random.Generator, shape: tuple[int, int], whole: bool) -> Array:
    """Level (H, W, C + 2) of a pyramid: parts of it unknown, known in part, and known; or in whole or not at all."""
    known = rng.choice([0.0, 1.0] if whole else [0.0, 0.25, 0.5, 1.0], shape)
    rows, columns = np.indices(shape)
    known *= (rows // 5 + columns // 7) % 3 > 0
    known[:, [0, -1]] = np.maximum(known[:, [0, -1]], rng.random((shape[0], 2)) < 0.5)
    value = rng.uniform(0.5, 1.5, (*shape, CHANNELS + 1))
    return np.concatenate([value * (known > 0)[..., None], known[..., None]], axis=-1)


GAP = 600  # numbers between levels
SHAPES = [(1, 1), (2, 5), (7, 8), (4, 9), (8, 24), (9, 31), (6, 32), (5, 40), (13, 53)]


def pyramid(session: Session, fine: Array, coarse: Array) -> tuple[Amid, Array, int, int]:
    """Two levels amid other numbers on the device, those numbers, and where the levels begin."""
    between = np.full(GAP, 7.5)
    held = np.concatenate([between, flat(fine, np.float64).ravel(), between, flat(coarse, np.float64).ravel(), between])
    return plane(session, held, 7.5), held.astype(np.float32), GAP, 2 * GAP + fine.size


def assert_planes(found: Array, expected: Array, before: Array, at: int) -> None:
    """A level (H, W, C + 2) at a place of a pyramid, the rest of it as before."""
    values = flat(expected, np.float64).ravel()
    here = slice(at, at + values.size)
    np.testing.assert_allclose(found[here], values, rtol=0, atol=ROUNDING)
    np.testing.assert_array_equal(np.delete(found, here), np.delete(before, here))


@pytest.mark.parametrize("shape", SHAPES)
def test_push_of_what_is_known_in_part(session: Session, shape: tuple[int, int]) -> None:
    for last, number in product((False, True), range(3)):
        fine = level(RNG(number), shape, whole=False) * (number < 2)
        half = (-(-shape[0] // 2), -(-shape[1] // 2))
        levels, held, at, coarse_at = pyramid(session, fine, np.full((*half, CHANNELS + 2), 7.5))
        sizes = (np.int32(n) for n in (*shape, *half, at, coarse_at, last))
        run(session, "push", (-(-half[1] // 4), half[0]), *sizes, levels)
        assert_planes(levels.now(), twin.push(fine, last), held, coarse_at)


@pytest.mark.parametrize("shape", SHAPES)
def test_pull_of_what_is_known_in_part(session: Session, shape: tuple[int, int]) -> None:
    """Also where neither level knows anything, or the finer one something and the coarser one nothing."""
    half = (-(-shape[0] // 2), -(-shape[1] // 2))
    for number in range(3):
        fine, coarse = level(RNG(number), shape, whole=False), level(RNG(9 + number), half, whole=True) * (number < 2)
        levels, held, at, coarse_at = pyramid(session, fine, coarse)
        run(session, "pull", shape[::-1], *(np.int32(n) for n in (*shape, *half, at, coarse_at)), levels)
        assert_planes(levels.now(), twin.pull(fine, coarse), held, at)


@pytest.mark.parametrize("shape", [(1, 1), (6, 9), (7, 16), (10, 21)])
def test_layers_are_opened_and_taken(session: Session, shape: tuple[int, int]) -> None:
    """Amid pixels of other layers, with hidden pixels of which the coarser level knows something or nothing."""
    rng, which, size = RNG(66), 2, shape[0] * shape[1]
    radiance, coc = rng.uniform(0.5, 1.5, (*shape, CHANNELS)), rng.uniform(1, 4, shape)
    layer, hidden = rng.integers(0, 4, shape).astype(np.uint8), rng.integers(0, 4, shape).astype(np.uint8)
    maps = (
        plane(session, flat(radiance, np.float32), 5.0), plane(session, coc, 5.0, np.float64),
        plane(session, layer, which, np.uint8),
    )  # fmt: skip
    finest = plane(session, np.full((CHANNELS + 2, *shape), 7.5), 7.5)
    run(session, "open_depth_layer", shape[::-1], grid(shape), np.int32(which), *maps, finest)
    opened = twin.open_depth_layer(radiance, coc, layer, which)
    np.testing.assert_array_equal(finest.now(), flat(opened.astype(np.float32), np.float32))

    half = (-(-shape[0] // 2), -(-shape[1] // 2))
    coarse = level(rng, half, whole=True)
    levels, _, _, at = pyramid(session, np.zeros((*shape, CHANNELS + 2)), coarse)
    light = plane(session, np.full((CHANNELS + 1, *shape), 7.5), 7.5)
    radius, there = plane(session, np.full(shape, 7.5), 7.5, np.float64), plane(session, np.full(shape, 9), 9, np.uint8)
    sizes = (np.int32(n) for n in (which, *half, at))
    behind = plane(session, hidden, which, np.uint8)
    run(session, "take_depth_layer", shape[::-1], grid(shape), *sizes, *maps, behind, levels, light, radius, there)
    expected = twin.take_depth_layer(radiance, coc, layer, hidden, coarse, which)
    np.testing.assert_allclose(light.now(), flat(expected[0], np.float64), rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(radius.now(), expected[1], rtol=0, atol=ROUNDING)
    np.testing.assert_array_equal(there.now(), expected[2])
    assert size < 50 or (np.asarray(expected[0])[..., 0][expected[2]] == 0).any()


@pytest.mark.parametrize("near_edges", [0, 1])
def test_sources_are_kept_in_the_grid_alone(session: Session, near_edges: int) -> None:
    rng, shape = RNG(67), (5, 18)
    edge, radius = rng.random(shape) < 0.5, rng.uniform(0, 4, shape).astype(np.float32)
    source = plane(session, radius, 3.0)
    around = plane(session, edge, 1 - near_edges, np.uint8)
    run(session, "keep_sources", shape[::-1], grid(shape), np.int32(near_edges), around, source)
    np.testing.assert_array_equal(source.now(), np.where(edge == near_edges, radius, -1.0))


@pytest.mark.parametrize("scatter", [False, True])
def test_composite_to_the_bit(session: Session, scatter: bool) -> None:
    """Radiances, coverages and a unit of which all products are exact; columns beside the frame keep what is there."""
    rng, (rows, columns), (pad, pitch), (from_pad, from_pitch) = RNG(68), (5, 18), (3, 27), (8, 32)
    blurred = np.full((CHANNELS + 1, rows, from_pitch), 0.5)
    inside = blurred[..., from_pad : from_pad + columns]
    inside[:-1] = rng.integers(0, 256, inside[:-1].shape) / 64
    inside[-1] = rng.choice([0.0, 0.5, 1.0, 2.0], inside[-1].shape)
    before = rng.choice([0.0, 0.5, 0.75, 1.0, 1.25], (rows, columns))
    image = rng.integers(0, 2**10, (CHANNELS, rows, columns))
    expected, room = twin.composite(np.zeros((rows, columns, CHANNELS)), before, np.moveaxis(inside, 0, -1))
    expected = np.moveaxis(expected, -1, 0)
    covered = plane(session, before, 0.25)
    head = grid_struct(rows, columns, 2, "double"), np.int32(from_pitch), np.int32(from_pad)
    light = plane(session, blurred, 0.5)
    if scatter:
        unit = 16.0
        sums = Amid(session, image, 7)
        run(session, "composite", (columns, rows), *head, light, covered, np.float32(unit), sums, scatter=True)
        np.testing.assert_array_equal(sums.now(), image + np.floor(expected * unit + 0.5).astype(np.int64))
    else:
        wide = np.full((CHANNELS, rows, pitch), 7.0)
        wide[..., pad : pad + columns] = image / 64
        total = plane(session, wide, 7.0)
        run(session, "composite", (columns, rows), *head, light, covered, np.int32(pitch), np.int32(pad), total)
        wide[..., pad : pad + columns] += expected
        np.testing.assert_array_equal(total.now(), wide)
    np.testing.assert_array_equal(covered.now(), room)
