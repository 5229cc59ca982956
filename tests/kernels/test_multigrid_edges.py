"""Kernels of coarse.cl one by one against the twin: what they make of a grid, and that nothing else is written."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyopencl as cl
import pytest
from numpy.typing import NDArray

from clsco.constants import EDGE_COLUMNS, EDGE_ROWS, TAP_LANES
from clsco.frame.strips import frame_struct
from clsco.opencl.buffers import download, upload
from clsco.opencl.program import build, kernel, launch
from clsco.opencl.session import Program, Session
from clsco.optics.multigrid import coarse_frame, plane_shape
from clsco.optics.psf_tables import psf_features, psf_table
from clsco.passes.blur import BLOCKS, PIXELS, PLAIN
from clsco.passes.pack import psf_struct
from clsco.plan.buffers import margin
from clsco.records import structs
from clsco.reference.blur import multigrid as twin
from clsco.reference.common.geometry import table_coordinate
from clsco.scene.model import Psf
from tests.kernels.conftest import source_planes

Array = NDArray[Any]
CHANNELS, ROWS = 2, 3
WIDTHS = [16, 21]  # whole vectors, and not; both fewer than a work-group has
UNTOUCHED = 5.0
PSF = Psf()
LARGEST = 12.0


@pytest.fixture
def program(session: Session) -> Program:
    features = PLAIN | psf_features(PSF) | {"CHANNELS": CHANNELS, "TILT": 1, "SAMPLED": 0}
    return build(session, ["blur/multigrid.cl"], features, structs("double"), "double")


def plane_of(grid: Array, around: float) -> Array:
    """A grid (..., height, width) as a plane of coarse.cl, something around it."""
    height, width = grid.shape[-2:]
    plane = np.full((*grid.shape[:-2], *plane_shape(width, height)), around, np.float32)
    plane[..., EDGE_ROWS : EDGE_ROWS + height, EDGE_COLUMNS : EDGE_COLUMNS + width] = grid
    return plane


def run(
    session: Session, program: Program, name: str, size: tuple[int, int], local: tuple[int, int], *args: Any
) -> None:
    launch(session, kernel(program, name), size, local, *args)


def untouched(session: Session, *shape: int, value: float = UNTOUCHED) -> cl.Buffer:
    """Planes of a grid (..., height, width) that have one value everywhere."""
    return upload(session, plane_of(np.full(shape, value), value))


def assert_grid(session: Session, buffer: cl.Buffer, expected: Array, around: float, lanes: bool) -> None:
    """A plane, or several; around: what has to be there still; lanes: but for those of a vector that ends a row."""
    height, width = expected.shape[-2:]
    found = download(session, buffer, (*expected.shape[:-2], *plane_shape(width, height)), np.float32)
    inside = found[..., EDGE_ROWS : EDGE_ROWS + height, EDGE_COLUMNS:]
    np.testing.assert_allclose(inside[..., :width], expected, rtol=2e-6, atol=1e-5)
    end = -(-width // TAP_LANES) * TAP_LANES if lanes else width
    assert np.isfinite(inside[..., width:end]).all()
    inside[..., :end] = around
    np.testing.assert_array_equal(found, np.float32(around))


def ends_with(values: Array) -> Array:
    """A buffer's content and some more floats."""
    return np.append(values.ravel(), np.full(2 * TAP_LANES, UNTOUCHED)).astype(np.float32)


def assert_ends(session: Session, buffer: cl.Buffer, expected: Array) -> None:
    """Check a buffer made by `ends_with`: these values, and the same after them as before."""
    found = download(session, buffer, (expected.size + 2 * TAP_LANES,), np.float32)
    np.testing.assert_allclose(found[: expected.size].reshape(expected.shape), expected, rtol=2e-6, atol=1e-5)
    assert (found[expected.size :] == UNTOUCHED).all()


@pytest.mark.parametrize("width", WIDTHS)
def test_radii_and_slopes(session: Session, program: Program, width: int) -> None:
    rng = np.random.default_rng(1)
    radius, slope = rng.uniform(1.0, LARGEST, (ROWS, width)), rng.uniform(0.1, 1.0, (2, ROWS, width))
    table = psf_table(PSF, 0.0, LARGEST)
    records = np.zeros((ROWS, width, 4), np.float32)
    records[..., 0] = table_coordinate(PSF, radius, False, table.low, table.end - table.low)
    records[..., 1:3] = np.moveaxis(slope, 0, -1)
    records[..., 3] = np.full((ROWS, width), -1, np.int32).view(np.float32)  # whole ones, and no number
    radii, tilt = untouched(session, ROWS, width, value=np.nan), untouched(session, 2, ROWS, width)
    args = (
        frame_struct(ROWS, width, 0, "double"), psf_struct(PSF, table, None, "double"),
        upload(session, source_planes(records, True, True)), np.int32(1), np.int32(0),
        np.int32(plane_shape(width, ROWS)[1]), radii, tilt,
    )  # fmt: skip
    run(session, program, "measure_radii", (-(-width // TAP_LANES), ROWS), BLOCKS, *args)
    assert_grid(session, radii, radius, np.nan, False)
    assert_grid(session, tilt, slope * radius**2, UNTOUCHED, True)


@pytest.mark.parametrize("width", WIDTHS)
def test_shares(session: Session, program: Program, width: int) -> None:
    rng = np.random.default_rng(2)
    limits = (5.0, 6.25, 1.0)
    radius = np.linspace(4.5, 7.0, width) + rng.uniform(0.0, 0.1, (ROWS, width))
    radius[0, 0], radius[-1, 10] = np.nan, -1.0
    value, coordinate = rng.random((CHANNELS, ROWS, width)), rng.uniform(1.0, 9.0, (ROWS, width))
    share = twin.pick(np.where(radius < 0.0, np.nan, radius), *limits)
    assert np.unique(share).size > 6
    source, kept = upload(session, ends_with(coordinate)), upload(session, ends_with(np.zeros(value.shape)))
    moved, light = untouched(session, ROWS, width), untouched(session, CHANNELS, ROWS, width)
    args = (
        frame_struct(ROWS, width, 0, "double"), upload(session, plane_of(radius, np.nan)),
        upload(session, ends_with(value)), *map(np.float32, limits), np.int32(plane_shape(width, ROWS)[1]), source,
        kept, moved, light,
    )  # fmt: skip
    run(session, program, "pick", (-(-width // TAP_LANES), ROWS), BLOCKS, *args)
    assert_ends(session, source, np.where(share == 1.0, -2.0 - coordinate, coordinate))
    assert_ends(session, kept, (1.0 - share) * value)
    assert_grid(session, moved, np.where(share > 0.0, radius, 0.0), UNTOUCHED, True)
    assert_grid(session, light, share * value, UNTOUCHED, True)


@pytest.mark.parametrize("width", WIDTHS)
def test_light_and_radii_of_nodes(session: Session, program: Program, width: int) -> None:
    rng = np.random.default_rng(3)
    fine, loss = (ROWS, 2 * width - 8), 0.4
    radius, share = rng.uniform(5.0, 6.0, fine), rng.uniform(0.1, 1.0, fine) * (rng.random(fine) < 0.6)
    value, slope = rng.random((CHANNELS, *fine)), rng.uniform(-1.0, 1.0, (2, *fine))
    light, small, turned = twin.halve(
        radius, share, np.moveaxis(value, 0, -1), np.moveaxis(slope, 0, -1), loss, (ROWS, width)
    )
    assert np.isnan(small[:, -1]).any()
    found = upload(session, ends_with(np.zeros((CHANNELS, ROWS, width))))
    radii, tilt = untouched(session, ROWS, width, value=np.nan), untouched(session, 2, ROWS, width)
    args = (
        frame_struct(*fine, 0, "double"), frame_struct(ROWS, width, 0, "double"),
        *(upload(session, plane_of(grid, 0.0)) for grid in (np.where(share > 0.0, radius, 0.0), share * value, slope)),
        np.float32(loss), np.int32(plane_shape(fine[1], ROWS)[1]), np.int32(plane_shape(width, ROWS)[1]),
        found, radii, tilt,
    )  # fmt: skip
    run(session, program, "halve", (-(-width // TAP_LANES), ROWS), BLOCKS, *args)
    assert_ends(session, found, np.moveaxis(light, -1, 0))
    assert_grid(session, radii, np.where(np.isnan(small), -1.0, small), np.nan, False)
    assert_grid(session, tilt, np.moveaxis(turned, -1, 0), UNTOUCHED, True)


def test_records_of_nodes(session: Session, program: Program) -> None:
    rng, shape, blunt = np.random.default_rng(4), (ROWS, 21), 0.3
    radius, tilt = rng.uniform(2.0, LARGEST, shape), rng.uniform(-1.0, 1.0, (2, *shape))
    radius[1, ::4] = -1.0
    there, table = radius > 0.0, psf_table(PSF, 0.0, LARGEST)
    coordinate = table_coordinate(PSF, np.where(there, radius, 1.0), False, table.low, table.end - table.low)
    expected = np.stack([coordinate, *tilt / (radius * radius + blunt)])
    source = upload(session, ends_with(np.zeros(expected.shape)))
    args = (
        frame_struct(*shape, 0, "double"), psf_struct(PSF, table, None, "double"),
        upload(session, plane_of(radius, np.nan)), upload(session, plane_of(tilt, 0.0)), np.float32(blunt),
        np.int32(plane_shape(21, ROWS)[1]), source,
    )  # fmt: skip
    run(session, program, "aim_nodes", (21, ROWS), PIXELS, *args)
    assert_ends(session, source, np.where(there, expected, np.array([-1.0, 0.0, 0.0])[:, None, None]))


@pytest.mark.parametrize(("columns", "guard"), [(63, 3), (15, 4), (16, 3)])
def test_the_way_back(session: Session, program: Program, columns: int, guard: int) -> None:
    """Rows end with a vector, and one before."""
    rng, sharp = np.random.default_rng(5), 0.2
    rows, nodes, around = coarse_frame(ROWS, columns, guard)
    coarse_pad, coarse_pitch = margin(nodes, around, 8)
    pad, pitch = margin(columns, guard, 8)
    coarse = rng.uniform(1.0, 2.0, (CHANNELS, rows, coarse_pitch))
    total = upload(session, np.full((CHANNELS, ROWS, pitch), UNTOUCHED, np.float32))
    args = (
        frame_struct(rows, nodes, around, "double"), np.int32(coarse_pitch), np.int32(coarse_pad),
        upload(session, coarse.astype(np.float32)), frame_struct(ROWS, columns, guard, "double"), np.int32(pitch),
        np.int32(pad), total, np.float32(sharp),
    )  # fmt: skip
    run(session, program, "enlarge", (-(-(columns + 1) // TAP_LANES), ROWS), BLOCKS, *args)
    found = download(session, total, (CHANNELS, ROWS, pitch), np.float32)
    frame = np.moveaxis(coarse[..., coarse_pad : coarse_pad + nodes], 0, -1)
    expected = twin.enlarge(frame, around, (ROWS, columns), guard, sharp)
    np.testing.assert_allclose(
        found[..., pad : pad + columns], UNTOUCHED + np.moveaxis(expected, -1, 0), rtol=2e-6, atol=1e-5
    )
    odd = 1 - guard % 2
    end = -(-(columns + odd) // TAP_LANES) * TAP_LANES - odd
    assert (found[..., : pad - odd] == UNTOUCHED).all()
    assert (found[..., pad + end :] == UNTOUCHED).all()
