"""visibility.clh and visibility_test.clh: what single taps of a source see of the lens, as their twins and lines do."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from clsco.opencl.buffers import download, empty
from clsco.opencl.session import Session
from clsco.optics.lens import Lens
from clsco.optics.motion import Pose
from clsco.optics.point_spread import point_spread
from clsco.optics.psf_tables import psf_table
from clsco.optics.quadrics import cutting_bounds, place
from clsco.optics.visibility import OcclusionGroup, lens_floats
from clsco.passes.pack import camera_grid, group_struct, lens_struct, psf_struct, surface_structs
from clsco.records import Real
from clsco.reference.common.equation import Points
from clsco.reference.common.geometry import blur_radius, nearest_surface, pixel_ray, surface_normal
from clsco.reference.common.visibility import CLEAR, PARTLY, check_visibility
from clsco.reference.common.visibility_test import cell_visibility, tap_share
from clsco.scene.model import Camera, Cone, Cylinder, Disc, Ellipsoid, Object, Plane, Psf, Scene, Sphere
from tests.kernels.lines import crossings, lens_points
from tests.scenes import plan_scene
from tests.slow import combined, mostly_slow

Array = NDArray[Any]
Runner = Callable[..., None]
KERNEL = """
// What source i sees of the lens from every tap: place holds (column, row, ox, oy), tap (dx, dy). state: -1 for no
// source. blocks: of the block with every tap as its first one, 1 if it is free, 0 if it is hidden, else 1/2.
__kernel void see_taps(const grid_t grid, const lens_t lens, __constant surface_t *surfaces, const group_t group,
                       const psf_t psf, __constant float *cells, const float width, __global const float4 *place,
                       const int taps,
                       __global const int2 *tap, __global int *state, __global int *edges, __global float *share,
                       __global float *blocks)
{
    const int i = get_global_id(0);
    if (i >= SOURCES)
        return;
    const real column = place[i].x + place[i].z, row = place[i].y + place[i].w;
    const real3 ray = pixel_ray(grid, row, column);
    uchar label;
    int object;
    const real w = nearest_surface(surfaces, group, ray, &label, &object);
    state[i] = -1;
    if (!label)
        return;
    const real radius = blur_radius(lens, ray, w);
    visibility_t visibility;
    bool edge;
    const real reach = width < 1 ? ABS(radius) : PIXEL_REACH(ABS(radius));
    const float2 tilt = tilt_slope((real2)(0.2, -0.1), radius < 0 ? -reach : reach);
    const division_t of_source = division_of(radius, psf.lens_extent, width, tilt);
    state[i] = check_visibility(lens, surfaces, group, ray, w, of_source, 0, &edge);
    edges[i] = edge;
    division_t of_taps = tap_division(radius, psf.lens_extent, width, tilt);
    bool again;
    int hidden = check_visibility(lens, surfaces, group, ray, w, of_taps, &visibility, &again);
    if (sees_by_cells(of_taps, &visibility))
        hidden = check_visibility(lens, surfaces, group, ray, w, of_source, &visibility, &again);
    visibility.behind = hidden == HIDDEN;
    if (!visibility.wide)
        cell_visibility(&visibility, cells, radius, psf.lens_extent, place[i].z, place[i].w, NARROW_MIDDLE);
    for (int t = 0; t < taps; ++t) {
        const int dx = tap[t].x, dy = tap[t].y;
        const lanes_t x = dx - place[i].z, y = dy - place[i].w;
        share[i * taps + t] = visibility.wide ? FIRST_LANE(free_share(&visibility, visibility.count > 1, x, y))
                                         : visibility.share[dy + NARROW_MIDDLE][dx + NARROW_MIDDLE];
    }
#if GATHER
    conics_t conics[OCCLUDED];
#if LIMITED
    find_conics(&visibility, 20, conics);
#endif
    for (int t = 0; t < taps && visibility.wide; ++t) {
        const float x = tap[t].x - place[i].z, y = tap[t].y - place[i].w;
        const blocks_t block = classify_blocks(&visibility, x, y, 1, 1, 0, conics);
        blocks[i * taps + t] = block.hidden & 1 ? 0 : block.free & 1 ? 1 : 0.5f;
    }
#endif
}

__kernel void sizes(__global int *size)
{
    if (get_global_id(0) > 0)
        return;
    size[0] = NARROW_MIDDLE, size[1] = NARROW_ROWS, size[2] = NARROW_LANES, size[3] = LANE_COUNT;
}
"""
CAMERA = Camera(resolution=(144, 120), pixel_pitch=0.04, aperture_diameter=25.0, focus_distance=250.0)
BOX = ((-20.0, 14.0), (-16.0, 25.0), (-30.0, 22.0))
CUT = ((-20.0, 8.0), (-16.0, 25.0), (-30.0, 22.0))
BALL = Sphere(center=(-10.0, 4.0, 190.0), radius=14.0)
DISC = Disc(center=(-3.0, 4.0, 190.0), radius=14.0, rotation=(50.0, 20.0, 0.0))
WALL = Plane(name="wall", distance=380.0, slope_x=0.3)
NEAR_FOCUS = Plane(name="wall", distance=255.0, slope_x=0.05)
# What is in the way, and what it is in the way of: the last object of a scene.
SCENES: dict[str, tuple[Object, ...]] = {
    "ball": (BALL, WALL),
    "ball, narrow lens": (BALL, NEAR_FOCUS),
    "wire, narrow lens": (Cylinder(center=(-2.0, 0.0, 170.0), radius=0.5, axis=(0.3, 1.0, 0.0)), NEAR_FOCUS),
    "card": (Plane(distance=190.0, slope_x=0.9, bounds=BOX), WALL),
    "card, narrow lens": (Plane(distance=190.0, slope_x=0.9, bounds=BOX), NEAR_FOCUS),
    "disc": (DISC, WALL),
    "disc, narrow lens": (DISC, NEAR_FOCUS),
    "cap": (BALL.model_copy(update={"bounds": CUT}), WALL),
    "tube, narrow lens": (Cylinder(center=(3.0, 0.0, 200.0), radius=9.0, axis=(0.4, 0.1, 1.0), bounds=BOX), NEAR_FOCUS),
    "bounded cone": (Cone(apex=(2.0, 3.0, 170.0), half_angle=35.0, bounds=BOX), WALL),
    "four at once": (
        BALL,
        Ellipsoid(center=(12.0, -6.0, 210.0), semi_axes=(10.0, 4.0, 8.0)),
        Plane(distance=220.0, bounds=((-9.0, 4.0), (-16.0, -2.0), (-1.0, 1.0))),
        Cylinder(center=(4.0, 0.0, 240.0), radius=3.0, axis=(1.0, 0.4, 0.0)),
        WALL,
    ),
    "sunk in two": (
        Sphere(center=(-5.0, 0.0, 300.0), radius=25.0),
        Sphere(center=(8.0, 3.0, 300.0), radius=22.0),
        Plane(distance=300.0, slope_x=0.8, slope_y=-0.5),
    ),
    "sunk in": (Sphere(center=(0.0, 0.0, 300.0), radius=25.0), Plane(distance=300.0, slope_x=0.8, slope_y=-0.5)),
}
PILLBOX = Psf()
STILL = Pose(np.eye(3), np.zeros(3))
QUICK = ["ball", "ball, narrow lens", "card", "disc"]
ROWS = (-6, -2, 0, 3, 7)  # of taps, two vectors of 8 in each
COUNT = 900  # of sources


@dataclass(frozen=True)
class Seen:
    """Results of the device for N sources and T taps, and of the twin; wide: of the lens, by the twin; plain: taps that
    stand for one line to a point of the lens, and blocked: of these, the lines that an occluder is in the way of."""

    state: Array
    edge: Array
    share: Array
    blocks: Array
    expected_state: Array
    expected_edge: Array
    expected: Array
    wide: Array
    plain: Array
    blocked: Array


def features_of(
    items: tuple[Object, ...], psf: Psf = PILLBOX, gather: int = 1, occluded: int = 1, camera: Camera = CAMERA
) -> dict[str, int]:
    """Features of the kernels: one program for bodies, and one for cards."""
    features = plan_scene(Scene(camera=camera, objects=items, psf=psf), 1).features()
    features |= {"OCCLUDED": occluded, "LIMITED": features["NAPPE"], "GATHER": gather}
    return features | {"SOURCES": COUNT, "BOUNDED": 1}


def see(
    session: Session, run: Runner, items: tuple[Object, ...], psf: Psf = PILLBOX, real: Real = "double",
    gather: int = 1, width: float = 1.0, group: OcclusionGroup | None = None, camera: Camera = CAMERA,
) -> Seen:  # fmt: skip
    """Sources of the last object at random pixels, and what is in their way; width: of the sources, px."""
    far = len(items) - 1
    group = group or OcclusionGroup(1 << far, (1 << far) - 1)
    surfaces, bounds = [place(item, STILL) for item in items], [cutting_bounds(item) for item in items]
    rng, count = np.random.default_rng(17), COUNT
    at = np.stack([rng.integers(-10, 154, count), rng.integers(-10, 130, count)], axis=-1)
    offset = rng.integers(-2, 3, (count, 2)) / 8 if width < 1 else np.zeros((count, 2))
    taps = np.array([(x, y) for y in ROWS for start in (-7, 0) for x in range(start, start + 8)], np.int32)
    features = features_of(items, psf, gather, group.occluders.bit_count(), camera)
    buffers = [empty(session, 4 * count * size) for size in (1, 1, len(taps), len(taps))]
    spread = point_spread(psf)
    run(
        KERNEL, "see_taps", real, features, count, camera_grid(camera, 0, real), lens_struct(Lens.of(camera), real),
        surface_structs(items, surfaces, real), group_struct(group, len(items)),
        psf_struct(spread, psf_table(spread, 0.0, 20.0), None, real), lens_floats(spread).astype(np.float32),
        np.float32(width),
        np.concatenate([at, offset], axis=-1).astype(np.float32), np.int32(len(taps)), taps, *buffers,
    )  # fmt: skip
    state, edge = (download(session, one, (count,), np.int32) for one in buffers[:2])
    share, blocks = (download(session, one, (count, len(taps)), np.float32) for one in buffers[2:])

    rays = pixel_ray(camera, at[:, 1] + offset[:, 1], at[:, 0] + offset[:, 0])
    w, label, _ = nearest_surface(surfaces, bounds, group, rays)
    there = label > 0
    assert ((state >= 0) == there).all()
    w, radius, (x, y) = w[there], blur_radius(Lens.of(camera), rays[there], w[there]), offset[there].T
    gradient = np.broadcast_to([0.2, -0.1], (w.size, 2))
    points = Points(rays[there], w, radius, x, y, width, gradient)
    found, outline, visibility = check_visibility(Lens.of(camera), surfaces, bounds, group, point_spread(psf), points)
    cells, expected, wide = cell_visibility(visibility), np.ones((w.size, len(taps))), np.zeros(w.size, dtype=bool)
    for n, (dx, dy) in enumerate(taps.astype(float).tolist()):
        expected[visibility.row >= 0, n] = tap_share(visibility, cells, dx, dy)
    wide[visibility.row >= 0] = visibility.wide
    away = taps - offset[there][:, None]
    start = (rays[there] / w[:, None])[:, None]
    ends = lens_points(Lens.of(camera), radius[:, None], away[..., 0], away[..., 1])
    size = np.abs(radius) * spread.extent
    inner = np.sqrt(np.maximum(size * size - 2 * size, 0))  # within which taps of wide lenses stay where they are
    plain = wide[:, None] & (np.hypot(away[..., 0], away[..., 1]) < inner[:, None])
    if group.own >= 0:  # what its tilt leaves of the lens
        way, normal = ends - start, surface_normal(surfaces[group.own], rays[there], w)[:, None]
        plain &= (way * normal).sum(axis=-1) > 1e-3 * np.linalg.norm(way, axis=-1)
    occluders = [item for k, item in enumerate(items) if group.occluders >> k & 1]
    blocked = np.any([crossings(item, STILL, start, ends) for item in occluders], axis=0)
    return Seen(state[there], edge[there], share[there], blocks[there], found, outline, expected, wide, plain, blocked)


def assert_same(seen: Seen) -> None:
    """States and outlines are the same, shares to what float32 leaves of them, and those of plain lines."""
    assert (seen.state == seen.expected_state).all()
    assert (seen.edge == seen.expected_edge).all()
    partly = seen.state == PARTLY
    if not partly.any():
        return
    error = np.abs(seen.share[partly] - seen.expected[partly])
    # h has terms of up to some ten widths of the edge, each rounded to 6e-8 of that and some ten of them, and the step
    # is up to 1.5 times as steep. Where a line just touches a surface with bounds, its crossing is the root of a
    # difference, of which float32 has half of the digits left.
    assert np.quantile(error, 0.999) < 3e-5
    assert error.max() < 3e-4
    if seen.wide.any():
        assert np.ptp(seen.expected) > 0.7
    decided = seen.plain & ((seen.share < 1e-6) | (seen.share > 1 - 1e-6))
    np.testing.assert_array_equal((seen.share < 0.5)[decided], seen.blocked[decided])


@pytest.mark.parametrize(("psf", "gather"), combined((PILLBOX, Psf(model="gaussian")), (1, 0), kept=[(PILLBOX, 1)]))
@pytest.mark.parametrize("name", mostly_slow(list(SCENES), QUICK))
def test_taps(session: Session, run_source: Runner, name: str, gather: int, psf: Psf) -> None:
    narrow = name.endswith("narrow lens")  # of points: pixels are tested tap by tap
    seen = see(session, run_source, SCENES[name], psf, gather=gather, width=0.25 if narrow else 1.0)
    partly = seen.state == PARTLY
    assert partly.sum() > 20
    if psf.model == "pillbox":
        assert (seen.wide[partly].mean() > 0.5) != narrow
    assert_same(seen)
    if not gather or not seen.wide.any():
        return
    # What is said of a block of taps as a whole holds for each row of it.
    chosen = partly & seen.wide
    vectors = seen.share[chosen].reshape(-1, len(ROWS), 2, 8)
    blocks = seen.blocks[chosen].reshape(-1, len(ROWS), 2, 8)[..., 0]
    for (k, first), (n, row) in product(enumerate(ROWS), repeat=2):
        if first <= row < first + 8:
            assert not vectors[:, n][blocks[:, k] == 0].any()
            assert (vectors[:, n][blocks[:, k] == 1] == 1).all()
    if name in ("ball", "card"):
        assert min((blocks == value).mean() for value in (0, 0.5, 1)) > 0.02


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ball", "wire, narrow lens", "disc", "bounded cone"])
def test_single_precision(session: Session, run_source: Runner, name: str) -> None:
    assert_same(see(session, run_source, SCENES[name], real="float"))


@pytest.mark.parametrize("name", ["ball", "ball, narrow lens", "card, narrow lens", "disc", "cap", "sunk in"])
@pytest.mark.slow
def test_subpixel_sources(session: Session, run_source: Runner, name: str) -> None:
    """Sources that are not in the middle of their pixel, and narrower than it."""
    whole, quarter = (see(session, run_source, SCENES[name], width=width) for width in (1.0, 0.25))
    assert_same(quarter)
    assert not np.array_equal(whole.share, quarter.share)


@pytest.mark.parametrize("far", [False, True])
@pytest.mark.parametrize("name", mostly_slow(["tube, narrow lens", "cap"], ["cap"]))
def test_a_hollow_surface_before_itself(session: Session, run_source: Runner, name: str, far: bool) -> None:
    """Points of its far wall look past its rim; those of the near one see all of the lens."""
    (item, _), camera = SCENES[name], CAMERA.model_copy(update={"sensor_distance": 20.5, "aperture_diameter": 30.0})
    near_sheet = 1 if place(item, STILL).constant > 0 else 2
    group = OcclusionGroup(1, 1, 0, 3 - near_sheet if far else near_sheet)
    seen = see(session, run_source, (item,), group=group, camera=camera)
    assert (seen.state == PARTLY).any() if far else (seen.state == CLEAR).all()
    assert_same(seen)


def test_outlines_close_before_a_wall(session: Session, run_source: Runner) -> None:
    """They ask for sub-pixel sources where the wall is so near behind them that they are blurred by 2 px at most."""
    ball, wall = Sphere(center=(-3.0, 4.0, 300.0), radius=25.0), Plane(distance=331.0, slope_x=0.8)
    seen = see(session, run_source, (ball, wall))
    partly = seen.state == PARTLY
    assert_same(seen)
    assert 0.3 < seen.edge[partly].mean() < 0.7


def test_taps_around_a_source_have_room(session: Session, run_source: Runner) -> None:
    """As many rows and columns on each side of a source, and whole vectors from any of them on."""
    size = empty(session, 4 * 4)
    run_source(KERNEL, "sizes", "double", features_of(SCENES["ball"]), 1, size)
    middle, rows, lanes, vector = download(session, size, (4,), np.int32)
    assert 2 * middle < rows
    assert 2 * middle + vector <= lanes
