"""visibility.clh and occluder.clh: how surfaces and made-up occluders hide the lens from single points, tap by tap."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from clsco.constants import LENS_CELLS
from clsco.opencl.buffers import download, empty
from clsco.opencl.session import Session
from clsco.optics.lens import Lens
from clsco.optics.motion import Pose
from clsco.optics.point_spread import point_spread
from clsco.optics.quadrics import cutting_bounds, place
from clsco.optics.visibility import OcclusionGroup, lens_floats
from clsco.passes.pack import lens_struct, surface_structs
from clsco.records import REAL, Real
from clsco.reference.common.equation import PIXEL_CELLS, SOFT_BOX, TAP_LENS, Points
from clsco.reference.common.geometry import pixel_reach
from clsco.reference.common.occluder import Occluder
from clsco.reference.common.visibility import CLEAR, HIDDEN, PARTLY, Visibility, check_visibility
from clsco.reference.common.visibility_test import cell_visibility, free_share, tap_share
from clsco.scene.model import Camera, Cone, Cylinder, Ellipsoid, Object, Plane, Psf, Quadric, Sphere
from tests.kernels.lines import crossings, lens_points, passes_lens

Array = NDArray[Any]
Runner = Callable[..., None]
KERNEL = """
// What point i sees of the lens: place holds (x, y) of its ray and its inverse depth, chosen (surface, own, root), tap
// the cells from it, right and down, of each of its taps.
__kernel void meet(const lens_t lens, __constant surface_t *surfaces, const real extent, const real width,
                   __global const real *place, __global const int4 *chosen, __global const real *radius,
                   __global const real2 *gradient, __global const float2 *tap, __global int4 *seen,
                   __global float *share)
{
    const int i = get_global_id(0);
    if (i >= POINTS)
        return;
    const real3 ray = (real3)(place[3 * i], place[3 * i + 1], 1);
    const group_t group = {0, 3, 1, chosen[i].y ? 0 : -1, chosen[i].z};  // of one object: the second bit is no one's
    visibility_t visibility;
    bool edge;
    const float2 tilt = tilt_slope(gradient[i], radius[i]);
    const division_t division = division_of(radius[i], extent, width, tilt);
    const division_t taps = tap_division(radius[i], extent, width, tilt);
    const real w = place[3 * i + 2];
    int hidden = check_visibility(lens, surfaces + chosen[i].x, group, ray, w, taps, &visibility, &edge);
    if (sees_by_cells(taps, &visibility))
        hidden = check_visibility(lens, surfaces + chosen[i].x, group, ray, w, division, &visibility, &edge);
    visibility.behind = hidden == HIDDEN;
    const int state = check_visibility(lens, surfaces + chosen[i].x, group, ray, w, division, 0, &edge);
    seen[i] = (int4)(state, edge, visibility.wide, visibility.count);
    for (int t = i * TAPS; t < (i + 1) * TAPS; ++t) {
        const lanes_t x = tap[t].x, y = tap[t].y;
        share[t] = state == PARTLY ? FIRST_LANE(free_share(&visibility, false, x, y)) : state == CLEAR;
    }
}
"""
TAPS = 16
CAMERA = Camera(resolution=(144, 120), pixel_pitch=0.04, aperture_diameter=25.0, focus_distance=250.0)
LENS = Lens.of(CAMERA)
PILLBOX, GAUSSIAN = Psf(), Psf(model="gaussian", sigma_ratio=0.5)
UPRIGHT = Pose(np.eye(3), np.zeros(3))
# Points at which conditions are met all over the lens but for the last 1e-4 of a step, which float32 may not see.
UNSURE = 1e-3


def any_way(rng: np.random.Generator) -> Array:
    """A rotation."""
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return np.asarray(q * np.linalg.det(q))


def quadric(rng: np.random.Generator, **given: Any) -> Quadric:
    """Quadric of any kind, also of two sheets and around the lens; every other of those without two of the squares."""
    size = rng.uniform(3, 30)
    c = np.concatenate([rng.normal(size=6), rng.normal(size=3) * size, rng.normal(size=1) * size**2])
    if rng.random() < 0.2:
        c[:6] *= np.eye(6)[rng.integers(0, 3)]  # two parallel planes, or a parabolic cylinder
    return Quadric(coefficients=tuple(c.tolist()), **given)


def some_surfaces(rng: np.random.Generator, count: int) -> list[tuple[Object, Pose]]:
    """Surfaces of every shape, any way round, a third of each with bounds; the lens is inside some, and on others."""
    found: list[tuple[Object, Pose]] = []
    for k in range(count):
        middle = tuple((rng.normal(size=3) * (15, 15, 30) + (0, 0, 180)).tolist())
        bounds = tuple((-abs(a), abs(b)) for a, b in (rng.normal(size=(3, 2)) * 25).tolist())
        cut: dict[str, Any] = {"bounds": bounds} if k % 3 == 0 else {}
        pose, size = Pose(any_way(rng), np.zeros(3)), float(np.exp(rng.uniform(-1, 3.4)))
        item: Object
        match k % 8:
            case 0:
                item = Sphere(center=middle, radius=size, **cut)
            case 1:
                item = Cylinder(center=middle, radius=0.5 * size, axis=tuple(rng.normal(size=3).tolist()), **cut)
            case 2:
                item = Cone(apex=middle, half_angle=2 * size, nappe="away" if k % 16 == 2 else "towards", **cut)
            case 3:
                item = Ellipsoid(center=middle, semi_axes=tuple(rng.uniform(2, 30, 3).tolist()), **cut)
            case 4:
                across = k % 16 == 4
                cut = {"bounds": ((-300.0, 300.0),) * 3} if across else cut
                item = Plane(distance=middle[2], slope_x=float(rng.normal()), slope_y=float(rng.normal()), **cut)
                if across:  # a little before the middle of the lens, or behind it
                    shape = place(item, pose)
                    normal = shape.turn.T @ shape.canonical.l
                    away = shape.constant / 2 + rng.uniform(-1, 1)
                    pose = replace(pose, shift=normal * (away / (normal @ normal)))
            case 5:  # the lens on it, hardly outside, or hardly inside
                item = Sphere(center=(0.0, 0.0, 190.0), radius=190.0 + float(rng.choice([-1e-3, 0, 0, 1e-3])), **cut)
                pose = UPRIGHT
            case _:
                item = quadric(rng, center=middle, **cut)
        found.append((item, pose))
    return [*found, (Plane(distance=128.0), UPRIGHT)]


def some_points(rng: np.random.Generator, surfaces: list[tuple[Object, Pose]], each: int) -> dict[str, Array]:
    """Around and behind all surfaces, for lenses that are wide and narrow; some are said to be of the surface itself.

    Also radii at which lenses become wide and change sides, depths before which there is nothing of a surface, and
    points on the last one.
    """
    placed, surface = [place(*one) for one in surfaces], np.repeat(np.arange(len(surfaces)), each)
    points = surface.size
    middle = np.array([item.rest for item in placed])[surface]
    depth = np.maximum(middle[:, 2] + np.abs(rng.normal(size=points)) * rng.choice([5.0, 60.0], points) - 5, 40.0)
    depth[5::40] = 128.0
    around = rng.normal(size=(points, 2)) * rng.choice([4.0, 25.0], (points, 1))
    x, y = (middle[:, :2] / middle[:, 2:] + around / depth[:, None]).T
    w = 1 / depth
    radius = rng.choice([-1.0, 1.0], points) * np.exp(rng.uniform(-2, 4, points))
    radius[::40], radius[1::40], radius[2::40] = 0.0, 4.0, -4.0
    nearest = np.array([item.extent.w[1] for item in placed])[surface]
    w[3::40] = np.where(nearest < 1, nearest, w)[3::40]
    own = np.arange(points) % 5 == 4
    return {
        "surface": surface, "own": own, "root": surface // 3 % 3 * own, "x": x, "y": y, "w": w, "radius": radius,
    }  # fmt: skip


@dataclass(frozen=True)
class Met:
    """Results of the device for N points and their taps, and of the twin; blocked: lines that a surface crosses, of
    points that are on none."""

    state: Array
    edge: Array
    wide: Array
    count: Array
    share: Array
    expected_state: Array
    expected_edge: Array
    expected_wide: Array
    expected: Array
    blocked: Array


def meet(
    session: Session, run: Runner, surfaces: list[tuple[Object, Pose]], points: dict[str, Array], psf: Psf = PILLBOX,
    width: float = 1.0, gather: int = 1, real: Real = "double",
) -> Met:  # fmt: skip
    """points: their surface, own, root, x, y, w, radius; width: of the sources, px."""
    items, placed = [item for item, _ in surfaces], [place(*one) for one in surfaces]
    count, extent, radius = points["w"].size, point_spread(psf).extent, points["radius"]
    features = {"OCCLUDED": 1, "POINTS": count, "TAPS": TAPS}
    features |= {"GATHER": gather, "LIMITED": 1, "SUBPIXELS": int(width < 1)}
    buffers = [empty(session, 4 * count * size) for size in (4, TAPS)]
    number = np.float64 if real == "double" else np.float32
    chosen = np.stack([points["surface"], points["own"], points["root"], 0 * points["own"]], axis=-1)
    turn = np.arange(count) * 2.4  # slopes of R in every direction, none at some points
    gradient = (np.arange(count) % 5 * 0.1 * np.stack([np.cos(turn), np.sin(turn)])).T
    reach = pixel_reach(radius) / np.maximum(np.abs(radius), 1.0) if width == 1.0 else np.ones(count)
    wide, state, edge = is_wide(radius, extent, width), np.zeros(count, np.uint8), np.zeros(count, bool)
    checked = []
    for key in np.unique(chosen, axis=0):
        (k, own, root, _), at = key.tolist(), np.flatnonzero((chosen == key).all(axis=1))
        rays, nothing = np.stack([points["x"][at], points["y"][at], np.ones(at.size)], axis=-1), np.zeros(at.size)
        # Slopes of whole pixels are over another radius.
        slope = gradient[at] * reach[at, None]
        state[at], edge[at], visibility = check_visibility(
            LENS, placed[k : k + 1], [cutting_bounds(items[k])], OcclusionGroup(1, 1, 0 if own else -1, root),
            point_spread(psf), Points(rays, points["w"][at], radius[at], nothing, nothing, width, slope),
        )  # fmt: skip
        wide[at[visibility.row >= 0]] = visibility.wide
        checked.append((k, at, rays, visibility))
    cells = np.where(wide, np.maximum(np.abs(radius), PIXEL_CELLS), LENS_CELLS / extent) * np.where(radius < 0, -1, 1)
    rim = np.abs(cells) * extent  # within which taps of wide lenses stay where they are
    taps = some_taps(count, np.where(wide, np.sqrt(np.maximum(rim * rim - 2 * rim, (rim / 8) ** 2)), rim))
    run(
        KERNEL, "meet", real, features, count, lens_struct(LENS, real), surface_structs(items, placed, real),
        number(extent), number(width), np.stack([points[k] for k in "xyw"], axis=-1).astype(REAL[real]),
        chosen.astype(np.int32), radius.astype(number), gradient.astype(number), taps, *buffers,
    )  # fmt: skip
    expected, blocked = (state == CLEAR)[:, None] * np.ones(TAPS), np.zeros((count, TAPS), bool)
    for k, at, rays, visibility in checked:
        partly = at[visibility.row >= 0]
        for tap in range(TAPS):
            expected[partly, tap] = free_share(visibility, *taps[partly, tap].T.astype(np.float64))
        ends = lens_points(LENS, cells[at, None], taps[at, :, 0], taps[at, :, 1])
        item, pose = surfaces[k]
        blocked[at] = crossings(item, pose, (rays / points["w"][at, None])[:, None], ends)
    seen = download(session, buffers[0], (count, 4), np.int32)
    share = download(session, buffers[1], (count, TAPS), np.float32)
    return Met(seen[:, 0], seen[:, 1] != 0, seen[:, 2] != 0, seen[:, 3], share, state, edge, wide, expected, blocked)


def is_wide(radius: Array, extent: float, width: float) -> Array:
    """True (points,) where the lens is tested tap by tap: for pixels, and where it is at least TAP_LENS px wide."""
    return (np.abs(radius) * extent >= TAP_LENS) | (width >= 1.0)


def some_taps(points: int, rim: Array) -> NDArray[np.float32]:
    """Taps (points, TAPS, 2), right and down, within the rim (points,) of the lens."""
    rng = np.random.default_rng(3)
    turn, away = rng.uniform(0, 2 * np.pi, (points, TAPS)), rim[:, None] * np.sqrt(rng.random((points, TAPS)))
    return np.stack([away * np.cos(turn), away * np.sin(turn)], axis=-1).astype(np.float32)


@pytest.mark.parametrize(("psf", "gather"), [(PILLBOX, 1), (GAUSSIAN, 0)], ids=["vectors", "gaussian"])
def test_any_surface_before_any_point(session: Session, run_source: Runner, psf: Psf, gather: int) -> None:
    """Surfaces hide wide lenses and narrow ones, tap by tap, as the twin says, and where their edges do not go over the
    taps, as plain lines."""
    rng, width = np.random.default_rng(7), 1.0 if gather else 0.25
    surfaces = some_surfaces(rng, 64)
    points = some_points(rng, surfaces, 40)
    met = meet(session, run_source, surfaces, points, psf, width, gather)
    assert min((met.state == state).mean() for state in (CLEAR, PARTLY, HIDDEN)) > 0.1
    other = met.state != met.expected_state
    assert other.mean() <= UNSURE
    assert (np.minimum(met.state, met.expected_state)[other] == PARTLY).all()
    assert (met.edge == met.expected_edge).all()
    assert met.edge.mean() > 0.1
    assert (met.count == (met.state == PARTLY)).mean() > 0.95  # edges of pixels near the focus are sharper for the blur
    sure = ~other & (met.state == PARTLY)
    assert (met.wide == met.expected_wide)[sure].all()
    assert (met.wide != is_wide(points["radius"], point_spread(psf).extent, width))[sure].any() == bool(gather)
    error = np.abs(met.share - met.expected)[sure]
    # h has terms of up to some ten widths of the edge, each rounded to 6e-8 of that, and the step is up to 1.5 times as
    # steep.
    assert np.quantile(error, 0.99) < 1e-5
    assert error.max() < 3e-4
    assert error.size > 8000
    assert ((met.share > 0.1) & (met.share < 0.9)).sum() > 600
    through = np.array([passes_lens(LENS, *one, point_spread(psf).extent) for one in surfaces])
    plain = ~points["own"] & ~through[points["surface"]] & (points["w"] != 1 / 128)  # which are on the last surface
    decided = plain[:, None] & ((met.share < 1e-6) | (met.share > 1 - 1e-6))
    assert decided.sum() > 15000
    assert 0.2 < met.blocked[decided].mean() < 0.5
    np.testing.assert_array_equal((met.share < 0.5)[decided], met.blocked[decided])


def test_near_bounds_in_single_precision(session: Session, run_source: Runner) -> None:
    """A point that is within 0.02 mm of corners of the bounds, and hardly behind, is known to 2e-3 of the edge."""
    rng, points = np.random.default_rng(9), 64
    pose = Pose(np.eye(3), np.array([0.777, -1.213, 0.039]))
    surfaces: list[tuple[Object, Pose]] = []
    spots = []
    for k, slope_x in enumerate((0.9, 0.8)):
        x, y = (-35.012, 36.123), (-34.321, 33.789)
        corner = np.array([x[k], y[k], slope_x * x[k] + 0.4 * y[k]])
        # All six cut: by 0.001 mm in z, there where x and y do.
        z = (float(corner[2]) + 0.001, 30.0) if k == 0 else (-30.0, float(corner[2]) - 0.001)
        item = Plane(distance=181.371, slope_x=slope_x, slope_y=0.4, bounds=(x, y, z))
        surfaces.append((item, pose))
        behind = corner + np.array([0.0, 0.0, 0.05]) + rng.uniform(-0.02, 0.02, (points, 3))
        spots.append(behind + place(item, pose).rest + pose.shift)
    at, none = np.concatenate(spots), np.zeros(2 * points, np.int64)
    near = {"surface": np.repeat([0, 1], points), "own": none, "root": none, "radius": rng.uniform(5, 9, 2 * points)}
    near |= {"x": at[:, 0] / at[:, 2], "y": at[:, 1] / at[:, 2], "w": 1 / at[:, 2]}
    met = meet(session, run_source, surfaces, near, width=0.25, real="float")
    assert (met.state == PARTLY).all()
    assert (met.expected_state == PARTLY).all()
    # Of a step 0.1 mm wide; of 180 mm, or of 35 mm, a float leaves 1e-4 of it, or 2e-5.
    np.testing.assert_allclose(met.share, met.expected, rtol=0, atol=3e-3)
    assert ((met.expected > 0.1) & (met.expected < 0.9)).mean() > 0.1


# Made-up occluders, whose numbers reach what few scenes do

FEATURES = {"OCCLUDED": 2, "LIMITED": 1, "GATHER": 1}
MADE_UP = """
// States of seven blocks of taps from place (x, y) on: 0 hidden, 1 free, else 1/2. unmoved: the first and the last
// block whose taps the rim does not move. counts: occluders; per occluder limits and crossings.
// height: per occluder base, bx, by, slack, rim; limit: per occluder seven of (constant, x, y).
__kernel void say_along(const int rows, __global const float2 *place, __global const int2 *unmoved,
                        __global const int *counts,
                        __global const float *height, __global const float *limit, __global float *state)
{
    const int i = get_global_id(0);
    if (i >= rows)
        return;
    visibility_t both[2];  // the other one's share is what is before the occluders
    for (int row = 0; row < NARROW_ROWS; ++row)
        for (int lane = 0; lane < NARROW_LANES; ++lane)
            both[0].share[row][lane] = 0;
    visibility_t *visibility = both + 1;
    visibility->count = counts[5 * i];
    for (int k = 0; k < 2; ++k) {
        occluder_t *m = visibility->occluder + k;
        __global const float *h = height + 5 * (2 * i + k);
        m->base = h[0], m->bx = h[1], m->by = h[2], m->slack = h[3], m->rim = h[4];
        m->root = m->fx = m->fy = m->fxx = m->fxy = m->fyy = 0;
        m->limits = counts[5 * i + 1 + 2 * k], m->crossings = counts[5 * i + 2 + 2 * k];
        for (int n = 0; n < 7; ++n)
            for (int c = 0; c < 3; ++c)
                m->limit[n][c] = limit[3 * (7 * (2 * i + k) + n) + c];
    }
    conics_t conics[OCCLUDED];
    const blocks_t blocks = classify_blocks(visibility, place[i].x, place[i].y, 7, unmoved[i].x, unmoved[i].y, conics);
    for (int n = 0; n < 7; ++n)
        state[8 * i + n] = blocks.hidden >> n & 1 ? 0 : blocks.free >> n & 1 ? 1 : 0.5f;
}

// Shares of all taps for one edge over the lens; source: radius, ox, oy, and h: base, bx, by.
__kernel void see_through(const int sources, __constant float *lens, const float extent, __global const float *source,
                          __global float *share)
{
    const int i = get_global_id(0);
    if (i >= sources)
        return;
    __global const float *s = source + 6 * i;
    visibility_t visibility;
    visibility.count = 1;
    visibility.wide = visibility.behind = false;
    visibility.limb = i & 1;
    visibility.point = i >> 1 & 1;
    visibility.lean_x = 0.03125f, visibility.lean_y = -0.25f;
    occluder_t *m = visibility.occluder;
    m->base = s[3], m->bx = s[4], m->by = s[5];
    m->root = m->fx = m->fy = m->fxx = m->fxy = m->fyy = 0;
    m->limits = 0, m->crossings = 0;
    cell_visibility(&visibility, lens, s[0], extent, s[1], s[2], NARROW_MIDDLE);
    for (int row = 0; row < NARROW_ROWS; ++row)
        for (int column = 0; column < NARROW_ROWS; ++column)
            share[(NARROW_ROWS * i + row) * NARROW_ROWS + column] = visibility.share[row][column];
}
"""


def test_blocks_are_decided_where_all_of_them_is_clear_or_hidden(session: Session, run_source: Runner) -> None:
    """A row of seven blocks of 8 x 8 taps: 0 where one occluder hides all of it, 1 where none hides any, else between.

    A block goes from half a px before its first tap to half a px behind its last, along both axes. Of a card, it is
    hidden where all limits are half a width of the soft edge away at its corners, and clear where any is; others have a
    slack besides. What the rim may do to taps is one width, or what others say.
    """
    rng, count = np.random.default_rng(5), 300
    place = rng.uniform([-20, -6], [4, 6], (count, 2)).astype(np.float32)
    occluders = rng.integers(0, 3, count)
    kind = rng.choice(["card", "whole"], (count, 2), p=[0.6, 0.4])
    limits = np.where(kind == "whole", 0, rng.integers(1, 5, (count, 2)))
    crossings = np.zeros((count, 2), int)
    edges = rng.uniform(-1, 1, (count, 2, 7, 3)) * np.array([15.0, 0.5 / SOFT_BOX, 0.5 / SOFT_BOX])
    edges[..., 0] += 4  # so that all of some are met
    edges[: count // 8, ..., 1:] = 0
    edges[: count // 8, ..., 0] *= 0.4
    height = edges[..., 6, :] - np.array([4, 0, 0])
    slack, rim = rng.uniform(0, 2, (2, count, 2, 1))
    unmoved = rng.integers([-1, 2], [4, 8], (count, 2))
    state = empty(session, 4 * 8 * count)
    run_source(
        MADE_UP, "say_along", "double", FEATURES, count, np.int32(count), place,
        unmoved.astype(np.int32),
        np.stack([occluders, limits[:, 0], crossings[:, 0], limits[:, 1], crossings[:, 1]], axis=-1).astype(np.int32),
        np.concatenate([height, slack, rim], axis=-1).astype(np.float32), edges.astype(np.float32), state,
    )  # fmt: skip
    found = download(session, state, (count, 8), np.float32)[:, :7]

    ends = place[:, :1] - 0.5 + 8 * np.arange(8)
    both = np.stack([ends[:, :-1], ends[:, 1:]] * 2)[..., None, None]  # (corners, rows, blocks, 1, 1)
    y = place[:, 1, None, None, None] + np.array([-0.5, -0.5, 7.5, 7.5])[:, None, None, None, None]
    part = edges[:, None]
    g = part[..., 0] + part[..., 1] * both + part[..., 2] * y  # (corners, rows, blocks, occluders, limits)
    there = np.arange(7) < limits[:, None, :, None]
    block = np.arange(7)
    moved = ((block < unmoved[:, :1]) | (block > unmoved[:, 1:]))[..., None]  # (rows, blocks, 1)
    least = 0.5 + moved[..., None]
    card_hides = ((g.min(axis=0) >= least) | ~there).all(axis=-1)
    card_clears = ((g.max(axis=0) <= -least) & there).any(axis=-1)
    h = height[:, None, :, 0] + height[:, None, :, 1] * both[..., 0] + height[:, None, :, 2] * y[..., 0]
    reach = slack[:, None, :, 0] + moved * rim[:, None, :, 0]
    low, high = h.min(axis=0) - reach, h.max(axis=0) + reach
    assert min(np.abs(np.abs(g) - least).min(), np.abs(low - 0.5).min(), np.abs(high + 0.5).min()) > 1e-5  # no ties
    whole, card = (np.broadcast_to((kind == name)[:, None], low.shape) for name in ("whole", "card"))
    hidden = (whole & (low >= 0.5)) | (card & card_hides)
    clear = (whole & (high <= -0.5)) | (card & card_clears)
    states = np.where(hidden, 0.0, np.where(clear, 1.0, 0.5))
    there = np.where(np.arange(2) < occluders[:, None, None], states, 1.0)
    expected = np.where((there == 0).any(axis=-1), 0.0, np.where((there == 1).all(axis=-1), 1.0, 0.5))
    for one in (whole, card):
        assert min((states[one] == value).mean() for value in (0.0, 0.5, 1.0)) > 0.1
    np.testing.assert_array_equal(found, expected)


def test_a_lens_larger_than_the_aperture_through_its_cells(session: Session, run_source: Runner) -> None:
    """The lens of a Gaussian has twice the radius, and so have its cells: an edge across it, from every tap, of
    pixels and of points."""
    psf, rng, count = Psf(model="gaussian"), np.random.default_rng(7), 20
    extent, turn = point_spread(psf).extent, rng.uniform(0, 2 * np.pi, count)
    radius = rng.choice([-1.0, 1.0], count) * rng.uniform(0.3, 4.0, count) / extent
    offset = rng.integers(-2, 3, (count, 2)) / 8
    slope = 0.5 / SOFT_BOX * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    h = np.concatenate([rng.uniform(-4, 4, (count, 1)), slope], axis=-1)
    source = np.concatenate([radius[:, None], offset, h], axis=-1).astype(np.float32)
    shares = empty(session, 4 * count * 15 * 15)
    run_source(
        MADE_UP, "see_through", "double", FEATURES, count, np.int32(count),
        lens_floats(point_spread(psf)).astype(np.float32),
        np.float32(extent), source, shares,
    )  # fmt: skip
    found = download(session, shares, (count, 15, 15), np.float32)

    zero, none = np.zeros(count), np.zeros((count, 6))
    edge = Occluder(h, zero, none[:, :5])
    there = np.ones(count, dtype=bool)
    x, y = offset.T
    lean, limb = np.tile([0.03125, -0.25], (count, 1)), np.arange(count) % 2 == 1
    point = np.arange(count) // 2 % 2 == 1
    lens = point_spread(psf), point_spread(psf).lens_cells(), lean, limb, zero
    visibility = Visibility(np.arange(count), radius, ~there, point, x, y, ((there, edge),), *lens)
    cells = cell_visibility(visibility)
    taps = range(-7, 8)
    expected = np.array([[tap_share(visibility, cells, float(dx), float(dy)) for dx in taps] for dy in taps])
    assert np.ptp(expected[7, 7]) > 0.5
    # Sums of 256 float32 each.
    np.testing.assert_allclose(found, np.moveaxis(expected, -1, 0), rtol=0, atol=1e-5)
