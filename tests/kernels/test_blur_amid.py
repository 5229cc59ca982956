"""Kernels of blur.cl amid other numbers: what each work-item looks at, and what it leaves alone."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import clsco
from clsco import reference
from clsco.cli.check import compare
from clsco.constants import BAND
from clsco.opencl.buffers import download
from clsco.opencl.program import Target
from clsco.opencl.session import Session
from clsco.optics.point_spread import point_spread
from clsco.optics.psf_tables import psf_table
from clsco.passes import blur as spread
from clsco.passes.blur import FILES_OF, PIXELS
from clsco.passes.pack import psf_struct
from clsco.plan import buffers
from clsco.plan.buffers import by_columns, column_bytes, margin
from clsco.reference.blur import blur as twin
from clsco.reference.blur.blur import tilt_factor
from clsco.reference.common.geometry import tilt_slope
from clsco.scene.file import parse_scene
from clsco.scene.model import Psf
from tests.kernels import sources as light_sources
from tests.kernels.conftest import source_planes
from tests.kernels.launches import Amid, run
from tests.kernels.sources import FIGURE, RNG, ROUNDING, SMOOTH, Light, assert_close, blurred, features, light
from tests.slow import mostly_slow
from tests.spreads import spec_of

Array = NDArray[Any]
LEFT_ALONE = 7.0


def in_color(session: Session, psf: Psf) -> Target:
    """A program of several tests, also of such as have no sub-pixel sources or but one channel."""
    return Target(session, FILES_OF["gather"], features(psf, 3, 2, 4.0), "double")


@pytest.mark.parametrize(("columns", "items"), [(80, 8), (80, 10), (75, 10)])
@pytest.mark.parametrize("tilt", mostly_slow([True, False], [True]))
def test_prepare_sources_writes_those_of_its_work_items(session: Session, tilt: bool, columns: int, items: int) -> None:
    """With marks; all of a row that fills whole vectors or not, or the first 64 columns of it."""
    psf = Psf(tilt=tilt)
    given = light(psf, shape=(12, columns - 4), guard=2)
    coc = given.sources.radius + 1.0
    valid = RNG(48).random(coc.shape) < 0.98
    valid[-1, -8:] = True
    target = in_color(session, psf)
    records = light_sources.records(given, coc, twin.prepare_sources(coc, valid), valid, False)
    expected = source_planes(records, tilt, True)
    expected[-1] = np.full(coc.shape, -1, np.int32).view(np.float32)
    out = Amid(session, np.full_like(expected, LEFT_ALONE), LEFT_ALONE)
    planes = {"grid": given.grid(), "psf": psf_struct(point_spread(psf), given.table(), None, "double"), "source": out}
    planes |= {"coc": Amid(session, coc, 9.0), "valid": Amid(session, valid.astype(np.uint8), 1)}
    run(session, target, "prepare_sources", (items, coc.shape[0]), (items, 1), **planes)
    found = out.now()
    np.testing.assert_allclose(found[:-1, :, : 8 * items], expected[:-1, :, : 8 * items], rtol=2.5e-7)
    assert (found[-1].view(np.int32)[:, : 8 * items] == -1).all()
    assert (found[..., 8 * items :] == LEFT_ALONE).all()


def test_resolve_writes_the_frame_alone(session: Session) -> None:
    given = light(Psf(), shape=(5, 70), channels=3)
    target = in_color(session, given.psf)
    sums = RNG(49).integers(0, 2**40, (3, 5, 70))
    total = Amid(session, np.full((3, 5, 88), LEFT_ALONE, np.float32), LEFT_ALONE)
    planes = {"scale": 2.0**40, "pitch": 88, "pad": 8, "sums": sums, "total": total}
    run(session, target, "resolve", (70, 5), PIXELS, grid=given.grid(), **planes)
    found = total.now()
    np.testing.assert_allclose(found[..., 8:78], sums / 2.0**40, rtol=2.0**-23)
    assert (found[..., :8] == LEFT_ALONE).all()
    assert (found[..., 78:] == LEFT_ALONE).all()


def test_renormalized_subpixel_sources(session: Session) -> None:
    """Also in focus or nearly so; those that tilt so much that nothing is left in the frame stay as they are."""
    given = light(Psf(border="renormalize"), shape=(9, 11), guard=0, channels=3, samples=2)
    assert given.sub is not None
    radius = RNG(50).choice([0.0, 1e-3, 2.5], given.sub.radius.shape)
    edge = (given.sub.row == 0) | (given.sub.column == 0)
    gradient = np.where(edge[:, None, None, None], -40.0, given.sub.gradient)
    given = replace(given, sub=replace(given.sub, radius=radius, gradient=gradient))
    assert given.sub is not None
    untouched = light_sources.on_device(session, given, 1.0)
    sources = light_sources.renormalized(session, given, "scatter")
    assert untouched.sub_value is not None
    assert sources.sub_value is not None
    shape = (3, sources.capacity, 2, 2)
    before = download(session, untouched.sub_value, shape, np.float32)
    found = download(session, sources.sub_value, shape, np.float32)
    _, scaled = twin.renormalize(spec_of(given.psf), given.sources, given.sub, given.shape, 0)
    assert scaled is not None
    slots = RNG(44).permutation(len(given.sub.row))
    expected = np.moveaxis(scaled.radiance, -1, 0) / 4
    lost = given.sub.hit & (scaled.radiance == 0).all(axis=-1)
    kept = given.sub.hit & ~lost
    assert lost.any()
    np.testing.assert_allclose(found[:, slots][:, kept], expected[:, kept], rtol=1e-3)
    assert (found[:, slots][:, lost] == before[:, slots][:, lost]).all()


def test_subpixel_sources_in_focus_and_of_the_first_slot(session: Session) -> None:
    """The latter in pixels without a source of their own, of which all are."""
    given = light(Psf(), shape=(9, 11), guard=1, channels=3, samples=2)
    assert given.sub is not None
    sharp = replace(given, sub=replace(given.sub, radius=np.zeros_like(given.sub.radius)))
    alone = replace(given, sources=replace(given.sources, lit=np.zeros_like(given.sources.lit)))
    assert alone.expected().max() > 0.1
    for each in (sharp, alone):
        assert_close(blurred(session, each, "gather"), each.expected(), FIGURE["area"])
        assert_close(blurred(session, each, "scatter"), each.expected(), FIGURE["area"])


def gathered(
    session: Session, given: Light, part_rows: int, start: int, kept: dict[str, int], scratch: dict[str, Any],
    part: Amid,
) -> Array:  # fmt: skip
    """The frame (channels, rows, columns) after two work-items, from band `start` on; kept: features for `scratch`."""
    pad, pitch = margin(given.shape[1], given.guard, given.table().reach)
    total = Amid(session, np.zeros((given.channels, given.shape[0], pitch), np.float32), LEFT_ALONE)
    sources = light_sources.on_device(session, given, 1.0)
    planes = {"source": sources.source, "value": sources.value, "total": total, "part": part}
    light_sources.gather(
        session, given, 2, kept, part_rows=part_rows, start=start, position=np.zeros(2, np.int32), **planes, **scratch
    )
    return total.now()[..., pad : pad + given.shape[1]]


@pytest.mark.parametrize(("part_rows", "start"), [(1, 1), (3, 1), (3, 2)])
def test_gather_source_by_source(session: Session, part_rows: int, start: int) -> None:
    """Sums of few rows of sources, each with light up to the top of its reach, in bands from the second on."""
    psf = Psf(edge="sampled")
    given = light(psf, shape=(3 * BAND, 17), guard=5, largest=4.0, channels=2)
    given = given.constant(4.0)
    _, pitch = margin(17, 5, psf_table(point_spread(psf), 4.0, 4.0).reach)
    part = Amid(session, np.zeros((2, 2 * BAND, pitch), np.float32), 1.0)
    found = gathered(session, given, part_rows, start, {"BY_COLUMNS": 0}, {}, part)
    expected = np.moveaxis(given.expected(), -1, 0)
    assert_close(found[:, start * BAND :], expected[:, start * BAND :], ROUNDING)
    assert not found[:, : start * BAND].any()
    assert not part.now().any()


def test_gather_with_parts_of_its_own(session: Session) -> None:
    """Level sources and lone steep ones for the second work-item, in its memory; the first one has nothing to do."""
    psf = Psf()
    given = light(psf, shape=(2 * BAND, 8), guard=4, largest=6.6, smallest=2.0, channels=2)
    rows, columns = np.indices(given.sources.lit.shape)
    steep = (rows > BAND + 20) & (rows % 13 == 0) & (columns == 0)
    there = steep | ((rows > BAND + 20) & (columns == 5))
    gradient = np.where(steep[..., None], (30.0, -30.0), np.zeros(2))
    sources = replace(given.sources, lit=there, gradient=gradient, radius=np.where(there, 6.6, 0.0))
    given = replace(given, sources=sources)
    assert by_columns(point_spread(psf))
    far = psf_table(point_spread(psf), given.smallest, given.largest).reach
    _, pitch = margin(8, 4, far)
    own = np.zeros((2, 2, BAND, pitch), np.float32)
    own[:, 0] = LEFT_ALONE
    part = Amid(session, own, 1.0)
    size = column_bytes(point_spread(psf), psf.tilt, 2, far) // 8
    scratch = Amid(session, np.zeros((2, size)), 0.0)
    found = gathered(session, given, 1, 0, {}, {"scratch": scratch, "scratch_size": size}, part)
    assert_close(found, np.moveaxis(given.expected(), -1, 0), 2e-5)
    assert found.any()
    assert (part.now() == own).all()
    used = scratch.now().view(np.uint64).any(axis=1)
    assert used.tolist() == [False, True]


def test_gather_of_single_sources(session: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    """Sampled discs of any radius one by one, in rows that end amid a block."""
    given = light(Psf(edge="sampled"), shape=(9, 27), guard=5, largest=26.0, channels=2)
    expected = blurred(session, given, "scatter")
    for module in (spread, buffers):
        monkeypatch.setattr(module, "by_columns", lambda psf: False)
    assert not features(given.psf, 2, 0, given.largest)["BY_COLUMNS"]
    assert_close(blurred(session, given, "gather"), expected, ROUNDING)


def summed(given: Light) -> Array:
    """The sum over all pairs of a source and a pixel (rows, columns, channels), of a Gaussian that is separable."""
    (rows, columns), sources = given.shape, given.sources
    y, x = np.argwhere(sources.lit).T - given.guard
    radius = np.abs(sources.radius[sources.lit])
    down: Array = np.arange(rows)[:, None] - y
    right: Array = np.arange(columns)[:, None] - x
    along = [point_spread(given.psf).axis_weights(np.abs(offset).astype(float), radius) for offset in (down, right)]
    share = along[0][:, None] * along[1]
    if given.psf.tilt:
        slope = tilt_slope(sources.gradient[sources.lit], sources.radius[sources.lit])
        share = share * tilt_factor(right, down[:, None], slope)
    return np.asarray(share @ sources.radiance[sources.lit])


@pytest.mark.parametrize(
    ("psf", "radius", "brightness", "shape"),
    [
        (SMOOTH.model_copy(update={"tilt": False}), 38.0, 1.0, (37, 45)),
        (SMOOTH.model_copy(update={"tilt": True}), 124.0, 1.0, (BAND, 20)),
        (SMOOTH.model_copy(update={"tilt": False}), 4600.0, 3e5, (9, 20)),
    ],
    ids=["as many as ITEMS_BYTES hold", "the least number", "each more than ITEMS_BYTES"],
)
def test_memory_of_wide_gaussians(
    session: Session, psf: Psf, radius: float, brightness: float, shape: tuple[int, int]
) -> None:
    """In their own memory, however much a source takes of it; relative to light of about 1."""
    given = light(psf, shape=shape, guard=3, largest=radius, smallest=0.97 * radius, steepest=0.5)
    sources = replace(given.sources, radiance=brightness * given.sources.radiance)
    given = replace(given, sources=sources)
    expected = summed(given)
    np.testing.assert_allclose(light_sources.gather_alone(session, given), expected, rtol=2e-5)


def test_partly_hidden_sources_in_focus(session: Session) -> None:
    """All light of theirs that there is stays in their own pixels."""
    wanted = parse_scene(
        {
            "camera": {"resolution": [26, 18], "pixel_pitch": 0.2, "aperture_diameter": 24.0, "focus_distance": 250.0},
            "object": [
                {"shape": "sphere", "center": [-9.0, 4.0, 190.0], "radius": 12.0},
                {"shape": "plane", "distance": 250.0},
            ],
            "psf": {"edge": "sampled", "tilt": False, "silhouette_samples": 1},
        }
    )
    (exact,) = reference.render(wanted)
    (frame,) = clsco.render(wanted, precision="double", method="gather")
    assert frame.metadata["blur_method"] == "gather"
    assert [found for found in compare(frame, exact) if found.count] == []
