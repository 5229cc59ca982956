"""coarse.cl by way of its host against the twin: every PSF, with and without guard band, empty pixels and jumps."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from clsco.constants import TAP_LANES
from clsco.frame.strips import Grid, frame_struct
from clsco.opencl.buffers import download, empty, upload
from clsco.opencl.program import build, kernel, launch
from clsco.opencl.session import Session
from clsco.optics.multigrid import coarse_radii
from clsco.optics.psf import MINIMUM_BLUR
from clsco.optics.psf_tables import psf_features, psf_table
from clsco.passes.blur import BLOCKS, PLAIN, Sources, blur_target
from clsco.passes.blur import prepare_sources as make_sources
from clsco.passes.multigrid import Multigrid, make_blur
from clsco.passes.pack import psf_struct
from clsco.plan.approximation import sample_places
from clsco.plan.buffers import source_bytes
from clsco.plan.methods import BlurSpec
from clsco.records import Real, flat, in_parts, structs
from clsco.reference.blur import multigrid as twin
from clsco.reference.blur.blur import prepare_sources, scatter
from clsco.reference.common.geometry import table_coordinate
from clsco.reference.trace.trace import Sources as Light
from clsco.scene.model import Psf
from tests.kernels.conftest import source_planes
from tests.slow import mostly_slow

Array = NDArray[Any]
# Tables of the coarser grids, with edge = "area", are off by up to 1e-4 in sum, to both sides (test_psf.py); in
# the square all sources have one radius and so the same errors, of which nothing averages out but their signs.
FIGURE = 3e-5
PSFS = [Psf(edge="sampled"), Psf(), Psf(model="gaussian", edge="sampled"), Psf(model="gaussian")]
SHAPE = (28, 36)
WHOLE, PARTLY_OCCLUDED = -1, -2  # as in kernels/common/sources.clh


def light_of(shape: tuple[int, int], largest: float, channels: int, falls: bool = False) -> Light:
    """Noise before radii that rise, or fall, to the right, with a square of another sign and an empty corner."""
    rng = np.random.default_rng(7)
    i, j = np.mgrid[0 : shape[0], 0 : shape[1]]
    across = j[:, ::-1] if falls else j
    radius = largest * (0.45 + 0.55 * across / (shape[1] - 1.0)) - 0.02 * i
    radius[6:20, 6:18] = -0.5 * largest
    there = np.ones(shape, bool)
    there[-7:, :5] = False
    radiance = np.where(there[..., None], rng.random((*shape, channels)), 0.0)
    radius = np.where(there, radius, 0.0)
    return Light(radiance, np.ones(shape), there.astype(np.uint8), radius, prepare_sources(radius, there), there)


def spread(
    session: Session, psf: Psf, light: Light, guard: int, least: float, places: Array | None, real: Real = "double"
) -> tuple[Multigrid, Sources]:
    """Blur of a frame that measures its error at places, and the light as it takes it."""
    height, width, channels = light.radiance.shape
    camera = frame_struct(height - 2 * guard, width - 2 * guard, guard, real)
    size = np.abs(light.radius[light.lit])
    smallest, largest = float(size.min()), float(size.max())
    spec = BlurSpec(psf, "gather", smallest, largest, tilt=psf.tilt, least=least)
    target = blur_target(session, spec, channels, real)
    grid = Grid.whole(height - 2 * guard, width - 2 * guard, guard, channels)
    blur = make_blur(target, spec, grid, camera, places)
    assert isinstance(blur, Multigrid)
    value = upload(session, flat(light.radiance, np.float32))
    radii, valid = upload(session, in_parts(light.radius, real)), upload(session, light.lit.astype(np.uint8))
    source = empty(session, source_bytes(height * width, psf.tilt))
    make_sources(target, camera, blur.struct, (radii, valid), source, [])
    blur.clear()
    session.queue.finish()  # the radii are let go of
    return blur, Sources(source, value)


def approximate(
    session: Session, psf: Psf, light: Light, guard: int, least: float, places: Array | None, real: Real = "double"
) -> tuple[Array, Array]:
    """Frame (m, n, C) on the device, and its error at places."""
    blur, sources = spread(session, psf, light, guard, least, places, real)
    blur.add(sources, [])
    frame = blur.image([])
    return (frame if blur.channels > 1 else frame[..., None]).astype(np.float64), blur.missed()


def assert_close(got: Array, expected: Array, figure: float) -> None:
    difference = np.abs(got - expected)
    at = np.unravel_index(difference.argmax(), difference.shape)
    assert difference.max() <= figure, (
        f"{got[at]} instead of {expected[at]} at {at}, {(difference > figure).sum()} more"
    )


@pytest.mark.parametrize(
    ("psf", "guard"), mostly_slow([*((psf, 3) for psf in PSFS), (Psf(), 8)], [(PSFS[0], 3)]),
    ids=lambda value: f"{value.model}-{value.edge}" if isinstance(value, Psf) else str(value),
)  # fmt: skip
def test_the_device_does_what_the_twin_does(session: Session, psf: Psf, guard: int) -> None:
    channels = 3 if guard == 3 else 1
    light = light_of((SHAPE[0] + 2 * guard, SHAPE[1] + 2 * guard), 11.0, channels)
    assert len(coarse_radii(psf, 11.0, 2.0)) == 2  # two coarser grids
    expected, wide = twin.coarse(psf, light, None, SHAPE, guard, 2.0)
    assert wide.mean() > 0.1  # of 0.5: much of the light takes that way
    places = sample_places(*SHAPE)
    found, missed = approximate(session, psf, light, guard, 2.0, places)
    assert_close(found, expected, FIGURE)
    exact = scatter(psf, light, None, SHAPE, guard)
    off = twin.sample_frame(found - exact, places)
    assert np.abs(off).max() > 10 * FIGURE  # there is an error to be measured
    assert_close(missed.astype(np.float64), off, FIGURE)
    share = twin.shares(psf, twin.measure_radii(light, None)[0], 2.0, 0)
    moved = twin.probe(psf, light, share, SHAPE, guard, places)
    assert_close(twin.sample_frame(wide, places) - moved, off, FIGURE)


def test_shares_in_what_is_left_of_a_row(session: Session) -> None:
    """Radii begin to move where a row ends that is no multiple of a vector."""
    psf, guard, channels = PSFS[0], 3, 3
    light = light_of((SHAPE[0] + 2 * guard, SHAPE[1] + 2 * guard), 11.0, channels, falls=True)
    share = twin.shares(psf, twin.measure_radii(light, None)[0], 2.0, 0)
    last = share[:, share.shape[1] // 8 * 8 :]
    assert ((last > 0.1) & (last < 0.9)).mean() > 0.3
    expected, _ = twin.coarse(psf, light, None, SHAPE, guard, 2.0)
    found, _ = approximate(session, psf, light, guard, 2.0, None)
    assert_close(found, expected, FIGURE)


@pytest.mark.parametrize("psf", PSFS, ids=lambda psf: f"{psf.model}-{psf.edge}")
@pytest.mark.parametrize("marked", [True, False])
def test_radii_come_back_from_coordinates(session: Session, psf: Psf, marked: bool) -> None:
    """Radii of sources that may move: that are there, whole and with nothing in their way."""
    rows, columns, pitch, edge = 3, 21, 48, 8
    sampled = psf.edge == "sampled"
    radius = np.geomspace(1.01 * MINIMUM_BLUR if sampled else 0.01, 5.9, rows * columns).reshape(rows, columns)
    table = psf_table(psf, 0.0, 6.0)
    records = np.zeros((rows, columns, 4), np.float32)
    records[..., 0] = table_coordinate(psf, radius, False, table.low, table.end - table.low)
    records[1, ::4, 0] = -1  # nothing there
    marks = np.full((rows, columns), WHOLE, np.int32)
    marks[:, 2], marks[:, 7] = 5, PARTLY_OCCLUDED
    records[..., 3] = marks.view(np.float32)
    may = records[..., 0] >= 0
    may &= (marks == WHOLE) | (not marked)
    features = PLAIN | psf_features(psf) | {"CHANNELS": 1, "TILT": 0, "SAMPLED": int(sampled)}
    program = build(session, ["blur/multigrid.cl"], features, structs("double"), "double")
    plane = empty(session, 4 * (rows + 2 * edge) * pitch)
    args = (
        frame_struct(rows, columns, 0, "double"), psf_struct(psf, table, None, "double"),
        upload(session, source_planes(records, False, True)), np.int32(marked), np.int32(sampled), np.int32(pitch),
        plane, plane,
    )  # fmt: skip
    launch(session, kernel(program, "measure_radii"), (-(-columns // TAP_LANES), rows), BLOCKS, *args)
    found = download(session, plane, (rows + 2 * edge, pitch), np.float32)[edge:-edge, edge : edge + columns]
    assert (found[~may] < 0).all()
    np.testing.assert_allclose(found[may], radius[may], rtol=2e-6)


@pytest.mark.slow
def test_without_tilt_and_in_single_precision(session: Session) -> None:
    psf, light = Psf(tilt=False), light_of(SHAPE, 11.0, 1)
    expected, _ = twin.coarse(psf, light, None, SHAPE, 0, 2.0)
    for real in ("double", "float"):
        found, missed = approximate(session, psf, light, 0, 2.0, None, real)
        assert missed.shape == (0, 1)
        assert_close(found, expected, FIGURE)


def test_radii_too_small_for_a_coarser_grid_are_left_alone(session: Session) -> None:
    light, places = light_of(SHAPE, 6.0, 1), sample_places(*SHAPE)
    found, missed = approximate(session, Psf(), light, 0, 4.0, places)
    assert_close(found, scatter(Psf(), light, None, SHAPE, 0), FIGURE)
    assert not missed.any()


def test_the_same_bits_each_time(session: Session) -> None:
    light, places = light_of(SHAPE, 11.0, 3), sample_places(*SHAPE)
    (one, missed), (other, again) = (approximate(session, PSFS[0], light, 0, 2.0, places) for _ in range(2))
    assert np.array_equal(one, other)
    assert np.array_equal(missed, again)


def test_errors_are_measured_at_these_places_only(session: Session) -> None:
    """Another one, which is there in memory but not counted, is left alone."""
    places, found = sample_places(*SHAPE)[:14], []
    for count in (14, 13):
        blur, sources = spread(session, PSFS[0], light_of(SHAPE, 11.0, 3), 0, 2.0, places)
        blur.places = places[:count]
        blur.add(sources, [])
        blur.image([])
        found.append(download(session, blur.misses, (14, 3), np.float32))
    assert found[0].all()
    assert np.array_equal(found[1][:13], found[0][:13])
    assert not found[1][13:].any()
