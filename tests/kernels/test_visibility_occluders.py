"""visibility.clh: how single surfaces are found to hide the lens from single points, number by number."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from clsco.opencl.buffers import download, empty
from clsco.opencl.session import Session
from clsco.optics.lens import Lens
from clsco.optics.motion import Pose
from clsco.optics.point_spread import point_spread
from clsco.optics.quadrics import cutting_bounds, place
from clsco.optics.visibility import OcclusionGroup
from clsco.passes.pack import lens_struct, surface_structs
from clsco.records import REAL, Real
from clsco.reference.common.equation import Points
from clsco.reference.common.occluder import Occluder
from clsco.reference.common.visibility import CLEAR, HIDDEN, PARTLY, check_visibility
from clsco.scene.model import Camera, Cone, Cylinder, Ellipsoid, Object, Plane, Psf, Quadric, Sphere

Array = NDArray[Any]
Runner = Callable[..., None]
KERNEL = """
typedef char of_its_size[sizeof(occluder_t) == BYTES ? 1 : -1];

// What is in the way of point i: place holds (x, y) of its ray and its inverse depth, chosen (surface, own, root).
__kernel void meet(const lens_t lens, __constant surface_t *surfaces, const real extent, const real width,
                   __global const real *place, __global const int4 *chosen, __global const real *radius,
                       __global const real2 *gradient, __global int4 *found, __global float4 *rims,
                           __global uchar *occluders)
{
    const int i = get_global_id(0);
    if (i >= POINTS)
        return;
    const real3 ray = (real3)(place[3 * i], place[3 * i + 1], 1);
    const group_t group = {0, 3, 1, chosen[i].y ? 0 : -1, chosen[i].z};  // of one object: the second bit is no one's
    visibility_t visibility;
    bool edge;
    const division_t division = division_of(radius[i], extent, width, tilt_slope(gradient[i], radius[i]));
    found[i].x = check_visibility(lens, surfaces + chosen[i].x, group, ray, place[3 * i + 2], division, &visibility,
                                  &edge);
    found[i].yzw = (int3)(edge, visibility.wide, visibility.count);
    rims[i] = (float4)(visibility.rim, visibility.rim_scale, visibility.rim_shift, 0);
    for (int n = 0; n < BYTES; ++n)
        occluders[BYTES * i + n] = visibility.count ? ((const uchar *)visibility.occluder)[n] : 0;
}
"""
# Of a occluder_t, in the order of the struct.
FIELDS = {"h": 3, "root": 1, "f": 5, "slack": 1, "rim": 1, "limits": 1, "crossings": 1}
FIELDS |= {"b": 3, "f0": 1, "c": 6, "d": 6, "soft": 1, "limit": 28}
CAMERA = Camera(resolution=(144, 120), pixel_pitch=0.04, aperture_diameter=25.0, focus_distance=250.0)
LENS = Lens.of(CAMERA)
PILLBOX, GAUSSIAN = Psf(), Psf(model="gaussian", sigma_ratio=0.5)
UPRIGHT = Pose(np.eye(3), np.zeros(3))
FLOAT = 2e-7  # three roundings to float32
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
    nearest = np.array([item.seen.w[1] for item in placed])[surface]
    w[3::40] = np.where(nearest < 1, nearest, w)[3::40]
    own = np.arange(points) % 5 == 4
    return {
        "surface": surface, "own": own, "root": surface // 3 % 3 * own, "x": x, "y": y, "w": w, "radius": radius,
    }  # fmt: skip


@dataclass(frozen=True)
class Met:
    """Results of the device for N points, and of the twin; occluders: of which points, and what it has of them.

    rims: (N, 3) of a visibility_t; fields: (N, ...) each, of its first occluder.
    """

    state: Array
    edge: Array
    wide: Array
    count: Array
    rims: Array
    fields: dict[str, Array]
    expected_state: Array
    expected_edge: Array
    occluders: list[tuple[Array, Occluder]]


def meet(
    session: Session, run: Runner, surfaces: list[tuple[Object, Pose]], given: dict[str, Array], psf: Psf = PILLBOX,
    width: float = 1.0, gather: int = 1, real: Real = "double",
) -> Met:  # fmt: skip
    """given: of points the surface, own, root, x, y, w, radius; width: of the sources, px."""
    items, placed = [item for item, _ in surfaces], [place(*one) for one in surfaces]
    count, words, extent = given["w"].size, sum(FIELDS.values()), point_spread(psf).extent
    features = {"OCCLUDED": 1, "POINTS": count, "BYTES": 4 * words, "GATHER": gather, "LIMITED": 1}
    buffers = [empty(session, 4 * count * size) for size in (4, 4, words)]
    number = np.float64 if real == "double" else np.float32
    chosen = np.stack([given["surface"], given["own"], given["root"], 0 * given["own"]], axis=-1)
    turn = np.arange(count) * 2.4  # slopes of R in every direction, none at some points
    gradient = (np.arange(count) % 5 * 0.1 * np.stack([np.cos(turn), np.sin(turn)])).T
    run(
        KERNEL, "meet", real, features, count, lens_struct(LENS, real), surface_structs(items, placed, real),
        number(extent), number(width), np.stack([given[k] for k in "xyw"], axis=-1).astype(REAL[real]),
        chosen.astype(np.int32), given["radius"].astype(number), gradient.astype(number), *buffers,
    )  # fmt: skip
    found = download(session, buffers[0], (count, 4), np.int32)
    rims, sent = (download(session, b, (count, n), np.float32) for b, n in zip(buffers[1:], (4, words), strict=True))
    if (
        width == 1.0
    ):  # what is left of it in records of whole pixels near the focus, as `pixel_tilt` of geometry.clh has it
        gradient = gradient * np.minimum(2.0 * np.abs(given["radius"]), 1.0)[:, None]
    fields = dict(zip(FIELDS, np.split(sent, np.cumsum(list(FIELDS.values()))[:-1], axis=1), strict=True))
    for name in ("limits", "crossings"):
        fields[name] = fields[name].view(np.int32)
    fields["limit"] = fields["limit"].reshape(-1, 7, 4)
    state, edge, occluders = np.zeros(count, np.uint8), np.zeros(count, bool), []
    for key in np.unique(chosen, axis=0):
        (k, own, root, _), at = key.tolist(), np.flatnonzero((chosen == key).all(axis=1))
        rays, nothing = np.stack([given["x"][at], given["y"][at], np.ones(at.size)], axis=-1), np.zeros(at.size)
        state[at], edge[at], visibility = check_visibility(
            LENS, placed[k : k + 1], [cutting_bounds(items[k])], OcclusionGroup(1, 1, 0 if own else -1, root),
            point_spread(psf),
            Points(rays, given["w"][at], given["radius"][at], nothing, nothing, width, gradient[at]),
        )  # fmt: skip
        occluders += [
            (at[visibility.row >= 0], occluder) for _, occluder in visibility.occluders if (visibility.row >= 0).any()
        ]
    return Met(
        found[:, 0], found[:, 1] != 0, found[:, 2] != 0, found[:, 3], rims[:, :3], fields, state, edge, occluders
    )  # fmt: skip


def conditions(occluder: Occluder) -> tuple[Array, Array]:
    """Number of conditions that are left (N,), and the conditions (N, 7, 4), 0 where there are none."""
    points = occluder.f0.size
    count, limits = np.zeros(points, np.int64), np.zeros((points, 7, 4))
    for k, limit in enumerate(occluder.limits):
        kept = occluder.needed[k] & np.isfinite(limit[:, 0])
        limits[kept, count[kept], : limit.shape[1]] = limit[kept]
        count += kept
    return count, limits


def assert_close(found: Array, expected: Array, limit: float, least: float = 1e-30) -> None:
    np.testing.assert_allclose(found, expected.reshape(found.shape), rtol=limit, atol=least)


def assert_same_occluders(met: Met, limit: float = FLOAT) -> None:
    """Every number of what is left to be tested for taps."""
    others = 0
    for at, occluder in met.occluders:
        found = {name: values[at] for name, values in met.fields.items()}
        count, limits = conditions(occluder)
        there = met.state[at] == PARTLY
        same = there & (count == found["limits"][:, 0])
        others += int(np.count_nonzero(there & ~same))
        used = same[:, None] & (np.arange(7) < count[:, None])
        # Those of a plane are differences of floats, of up to some hundred widths of the edge.
        parts, least = (4, 1e-30) if occluder.crossings.any() else (3, 5e-5)
        assert_close(found["limit"][used, :parts], limits[used, :parts], limit, least)
        twice, bound = there & (occluder.crossings == 2), same & (count > 0) & (occluder.crossings > 0)
        for name in ("h", "root", "f"):
            assert_close(found[name][twice], getattr(occluder, name)[twice], limit)
        for name in ("crossings", "b", "f0", "c", "d", "soft"):
            assert_close(found[name][bound], getattr(occluder, name)[bound], limit)
    assert others <= UNSURE * met.state.size


@pytest.mark.parametrize(("psf", "gather"), [(PILLBOX, 1), (GAUSSIAN, 0)], ids=["vectors", "gaussian"])
def test_any_surface_before_any_point(session: Session, run_source: Runner, psf: Psf, gather: int) -> None:
    """Surfaces hide wide lenses and narrow ones as the twin says, in every number that is kept of them."""
    rng, width = np.random.default_rng(7), 1.0 if gather else 0.25
    surfaces = some_surfaces(rng, 128)
    given = some_points(rng, surfaces, 40)
    met = meet(session, run_source, surfaces, given, psf, width, gather)
    assert min((met.state == state).mean() for state in (CLEAR, PARTLY, HIDDEN)) > 0.1
    other = met.state != met.expected_state
    assert other.mean() <= UNSURE
    assert (np.minimum(met.state, met.expected_state)[other] == PARTLY).all()
    assert (met.edge == met.expected_edge).all()
    assert met.edge.mean() > 0.1
    assert (met.count == (met.state == PARTLY)).all()
    across = np.abs(given["radius"]) * point_spread(psf).extent
    assert (met.wide == (across >= 3.2)).all()
    rim = np.maximum(across, 1.0)
    assert_close(met.rims, np.stack([rim / 2, 0.5 / rim, 1 / (3 * rim)], axis=-1), FLOAT)
    assert_same_occluders(met)
    # Twice what a root that is bent as it is at the source leaves of a chord over all taps of a vector, and 1.
    twice = np.concatenate([at[(occluder.crossings == 2) & (occluder.root > 1e-20)] for at, occluder in met.occluders])
    twice = twice[met.state[twice] == PARTLY]
    found = {name: met.fields[name][twice].astype(np.float64) for name in ("root", "f", "slack", "rim")}
    root = found["root"][:, 0]
    bend = np.abs(found["f"][:, 2:]).sum(axis=1) + (found["f"][:, :2] ** 2).sum(axis=1) / (4 * root**2)
    assert_close(found["slack"][:, 0], 2 * bend / root * (64 if gather else 1) / 4, 5 * FLOAT)
    assert (found["rim"] == 1).all()


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
    given = {"surface": np.repeat([0, 1], points), "own": none, "root": none, "radius": rng.uniform(5, 9, 2 * points)}
    given |= {"x": at[:, 0] / at[:, 2], "y": at[:, 1] / at[:, 2], "w": 1 / at[:, 2]}
    met = meet(session, run_source, surfaces, given, width=0.25, real="float")
    assert (met.state == PARTLY).all()
    assert (met.expected_state == PARTLY).all()
    for points_of, occluder in met.occluders:
        count, limits = conditions(occluder)
        used = np.arange(7) < count[:, None]  # others are met all over the lens
        assert 2 < count.mean() <= 3
        assert (met.fields["limits"][points_of, 0] == count).all()
        # Of a step 0.1 mm wide; of 180 mm, or of 35 mm, a float leaves 1e-4 of it, or 2e-5.
        assert_close(met.fields["limit"][points_of][used, :3], limits[used, :3], FLOAT, 2e-3)
