"""Visibility of lens points against plain lines through the scene, where the lens is many cells wide."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from clsco.optics.lens import Lens, blur_radius
from clsco.optics.motion import Pose, rest_center, rotation_matrix
from clsco.optics.point_spread import PointSpread, point_spread
from clsco.optics.quadrics import place
from clsco.optics.visibility import OcclusionGroup
from clsco.reference.common.equation import Points
from clsco.reference.common.geometry import nearest_surface, solve_quadric, surface_normal
from clsco.reference.common.occluder import Part, leave_free, soft_step
from clsco.reference.common.visibility import CLEAR, HIDDEN, check_visibility
from clsco.reference.common.visibility_test import cell_visibility, tap_share
from clsco.scene.model import Camera, Cone, Cylinder, Disc, Ellipsoid, Object, Plane, Psf, Quadric, Sphere

Array = NDArray[Any]
# Pixels so small that the lens is 10^4 to 10^6 of them wide: the soft edge is 1 cell, and what it adds for the width of
# the source at most some hundred cells, unless the occluder touches the source.
CAMERA = Camera(pixel_pitch=1e-6, aperture_diameter=30.0, resolution=(64, 64))
LENS = Lens.of(CAMERA)
STILL = Pose(np.eye(3), np.zeros(3))
BOX = ((-20.0, 14.0), (-16.0, 25.0), (-30.0, 22.0))
BOWL = Quadric(coefficients=(1.0, 0.8, 0.0, 0, 0, 0, 0, 0, -40.0, 0), center=(3.0, 0.0, 170.0))
SADDLE = Quadric(coefficients=(1.0, -0.8, 0.2, 0.1, 0, 0, 0, 0, -40.0, 30.0), center=(3.0, 0.0, 190.0))
OCCLUDERS: dict[str, Object] = {
    "sphere": Sphere(center=(3.0, -2.0, 180.0), radius=22.0),
    "small sphere": Sphere(center=(3.0, -2.0, 120.0), radius=2.0),
    "ellipsoid": Ellipsoid(center=(-5.0, 2.0, 190.0), semi_axes=(30.0, 9.0, 20.0)),
    "cylinder": Cylinder(center=(4.0, 3.0, 170.0), radius=9.0, axis=(0.4, 1.0, 0.3)),
    "wire": Cylinder(center=(-2.0, 0.0, 150.0), radius=0.4, axis=(1.0, 0.2, 0.0)),
    "cone": Cone(apex=(2.0, 3.0, 150.0), half_angle=25.0),
    "cone towards": Cone(apex=(2.0, 3.0, 220.0), half_angle=20.0, nappe="towards"),
    "plane": Plane(distance=190.0, slope_x=0.4, slope_y=-0.2),
    "card": Plane(distance=170.0, slope_x=0.4, slope_y=-0.9, bounds=BOX),
    "disc": Disc(center=(3.0, -2.0, 170.0), radius=14.0, offset=-4.0),
    "bounded cylinder": Cylinder(center=(2.0, 1.0, 170.0), radius=12.0, axis=(0.4, 0.1, 1.0), bounds=BOX),
    "cap": Sphere(center=(3.0, -2.0, 180.0), radius=22.0, bounds=BOX),
    "bounded cone": Cone(apex=(2.0, 3.0, 160.0), half_angle=40.0, bounds=BOX),
    "paraboloid": BOWL,
    "bounded paraboloid": BOWL.model_copy(update={"bounds": BOX}),
    "saddle": SADDLE,
    "bounded saddle": SADDLE.model_copy(update={"bounds": BOX}),
    "tube around the lens": Cylinder(center=(0.0, 3.0, 200.0), radius=55.0, axis=(0.1, 0.0, 1.0)),
    "bowl around the lens": BOWL.model_copy(update={"center": (0.0, 5.0, -60.0)}),
    "ball around the lens": Sphere(center=(5.0, 0.0, 60.0), radius=140.0),
}


PILLBOX = point_spread(Psf())


def quadric_of(item: Object) -> tuple[Array, Array, float]:
    """Matrix, vector and constant of x M x + 2 v x + k = 0 in the object's own frame, from its definition."""
    if isinstance(item, Plane):
        return np.zeros((3, 3)), np.array([-item.slope_x, -item.slope_y, 1.0]) / 2, 0.0
    if isinstance(item, Disc):
        return np.zeros((3, 3)), np.array([0.0, 0.0, 0.5]), -item.offset
    if isinstance(item, Sphere):
        return np.eye(3), np.zeros(3), -(item.radius**2)
    if isinstance(item, Ellipsoid):
        return np.diag(1.0 / np.square(item.semi_axes)), np.zeros(3), -1.0
    if isinstance(item, Cylinder):
        axis = np.asarray(item.axis) / np.linalg.norm(item.axis)
        return np.eye(3) - np.outer(axis, axis), np.zeros(3), -(item.radius**2)
    if isinstance(item, Cone):
        return np.diag([1.0, 1.0, -(np.tan(np.radians(item.half_angle)) ** 2)]), np.zeros(3), 0.0
    assert isinstance(item, Quadric)
    xx, yy, zz, xy, yz, zx, x, y, z, constant = item.coefficients
    matrix = np.array([[xx, xy / 2, zx / 2], [xy / 2, yy, yz / 2], [zx / 2, yz / 2, zz]])
    return matrix, np.array([x, y, z]) / 2, constant


def crossings(item: Object, pose: Pose, start: Array, end: Array) -> Array:
    """Mask of lines from start to end (..., 3) in mm that cross a surface, apart from their ends: (...)."""
    matrix, vector, constant = quadric_of(item)
    own: list[Array] = [(point - rest_center(item) - pose.shift) @ pose.rotation for point in (start, end)]
    way = own[1] - own[0]
    a = np.einsum("...i,ij,...j", way, matrix, way)
    b = np.einsum("...i,ij,...j", way, matrix, own[0]) + way @ vector
    c = np.einsum("...i,ij,...j", own[0], matrix, own[0]) + 2 * own[0] @ vector + constant
    found = np.zeros(a.shape, dtype=bool)
    with np.errstate(all="ignore"):
        root = np.sqrt(b * b - a * c)
        t = -b - np.copysign(root, b)
        for along in (t / a, c / t):
            hit = (along > 1e-9) & (along < 1.0)
            point = own[0] + np.where(hit, along, 0.0)[..., None] * way
            if isinstance(item, Cone):
                hit &= point[..., 2] * (1.0 if item.nappe == "away" else -1.0) >= 0
            if isinstance(item, Disc):
                hit &= np.hypot(point[..., 0], point[..., 1]) <= item.radius
            for axis, (low, high) in enumerate(item.bounds or ()):
                hit &= (point[..., axis] >= low) & (point[..., axis] <= high)
            found |= hit
    return found


def lens_points(rays: Array, w: Array, dx: Array, dy: Array) -> Array:
    """Points (..., 3) of the lens from which light of the points rays / w gets to (dx, dy) px beside them.

    All light that leaves through the plane in focus at one place gets to one place on the detector.
    """
    far = CAMERA.focused_distance
    step = CAMERA.pixel_pitch / CAMERA.normalization_distance
    point = rays / w[..., None]
    focused = far * (rays + np.stack([dx * step, -dy * step, np.zeros_like(dx)], axis=-1))
    along = point[..., 2] / (point[..., 2] - focused[..., 2])
    return np.asarray(point + along[..., None] * (focused - point))


def free_shares(
    items: Sequence[Object], poses: Sequence[Pose], rays: Array, w: Array, lens: Array, psf: PointSpread,
    group: OcclusionGroup | None = None,
) -> tuple[Array, Array]:  # fmt: skip
    """State (N,) of points rays / w, and share (T, N) that is free as seen from taps R l; lens: (T, 2)."""
    surfaces = [place(*one) for one in zip(items, poses, strict=True)]
    group = group or OcclusionGroup(0, (1 << len(items)) - 1)
    radius, middle = blur_radius(CAMERA, w), np.zeros_like(w)
    bounds = [item.bounds for item in items]
    state, _, visibility = check_visibility(
        LENS, surfaces, bounds, group, psf, Points(rays, w, radius, middle, middle, 1.0, np.zeros((len(w), 2)))
    )
    cells, share = cell_visibility(visibility), np.ones((len(lens), w.size))
    tested = visibility.row >= 0
    for tap, (x, y) in enumerate(lens):
        share[tap, tested] = tap_share(visibility, cells, x * visibility.radius, y * visibility.radius)
    share[:, state == HIDDEN] = 0.0
    return state, share


def blocked_lines(items: Sequence[Object], poses: Sequence[Pose], rays: Array, w: Array, lens: Array) -> Array:
    """Mask of lines from each point to each place in the lens that any of the surfaces crosses: (T, N)."""
    taps = lens[:, None] * blur_radius(CAMERA, w)[None, :, None]
    ends = lens_points(rays, w, taps[..., 0], taps[..., 1])
    assert np.abs(ends[..., 2]).max() < 1e-6  # the lens is where z = 0, and as wide as it is said to be
    size = np.hypot(ends[..., 0], ends[..., 1]) / LENS.radius
    np.testing.assert_allclose(size, np.broadcast_to(np.linalg.norm(lens, axis=1)[:, None], size.shape), rtol=1e-6)
    start = np.broadcast_to(rays / w[:, None], ends.shape)
    return np.asarray(np.any([crossings(*one, start, ends) for one in zip(items, poses, strict=True)], axis=0))


def passes_lens(item: Object, pose: Pose, extent: float) -> bool:
    """True if a quadric without its bounds goes through the lens, where nothing is to be seen of a scene."""
    matrix, vector, constant = quadric_of(item)
    angle = np.arange(64) * (np.pi / 32)
    rings = [size * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=-1) for size in np.linspace(0, extent, 9)]
    own = (LENS.radius * np.concatenate(rings) - rest_center(item) - pose.shift) @ pose.rotation
    value = np.einsum("ni,ij,nj->n", own, matrix, own) + 2 * own @ vector + constant
    return bool(value.min() <= 0 <= value.max())


def random_poses(rng: np.random.Generator, item: Object, count: int, extent: float) -> list[Pose]:
    """At rest, and half of the others far from it."""
    assert not passes_lens(item, STILL, extent)
    poses: list[Pose] = [STILL]
    while len(poses) < count:
        size = 0.1 if len(poses) % 2 else 1.5
        pose = Pose(rotation_matrix(rng.uniform(-size, size, 3), "axis"), rng.uniform(-12, 12, 3))
        poses += [] if passes_lens(item, pose, extent) else [pose]
    return poses


def random_points(rng: np.random.Generator, count: int) -> tuple[Array, Array]:
    """Rays (N, 3) over a wide view and inverse depths (N,), on both sides of all occluders, none of them in focus."""
    rays = np.concatenate([rng.uniform(-0.3, 0.3, (count, 2)), np.ones((count, 1))], axis=-1)
    depth = np.where(rng.random(count) < 0.7, rng.uniform(60.0, 400.0, count), rng.uniform(400.0, 4000.0, count))
    near_focus = np.abs(depth / CAMERA.focused_distance - 1) < 0.02
    return rays, 1.0 / np.where(near_focus, 330.0, depth)


def random_taps(rng: np.random.Generator, count: int, extent: float) -> Array:
    """Places (T, 2) in the lens, in its radii."""
    angle, radius = rng.uniform(0, 2 * np.pi, count), extent * np.sqrt(rng.random(count))
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)


def decided(share: Array) -> Array:
    """Taps over which the edge of what is hidden does not go."""
    return np.asarray((share < 1e-6) | (share > 1 - 1e-6))


@pytest.mark.parametrize("psf", [PILLBOX, point_spread(Psf(model="gaussian"))], ids=["pillbox", "gaussian"])
@pytest.mark.parametrize("name", OCCLUDERS)
def test_one_occluder_against_lines(name: str, psf: PointSpread) -> None:
    item, rng = OCCLUDERS[name], np.random.default_rng([len(name), 7 + psf.pupil.soft])
    unsure = wrong = points = hidden = seen = 0
    for pose in random_poses(rng, item, 8, psf.extent):
        rays, w = random_points(rng, 400)
        lens = random_taps(rng, 25, psf.extent)
        state, share = free_shares([item], [pose], rays, w, lens, psf)
        blocked = blocked_lines([item], [pose], rays, w, lens)
        assert not blocked[:, state == CLEAR].any()
        wrong += int((decided(share) & ((share < 0.5) != blocked)).sum())
        points, unsure = points + share.size, unsure + int((~decided(share)).sum())
        hidden, seen = hidden + int(blocked.sum()), seen + int((~blocked).sum())
    # Of a curved surface with bounds the lens is looked at in 16 places, to find out whether it is hidden as a whole: a
    # sliver between them may stay unseen, one of some 10^5 lines.
    assert wrong <= (1e-4 * points if item.bounds is not None and item.shape != "plane" else 0)
    assert min(hidden, seen) > 1e-3 * points
    # One cell of at least 10^4 across, and some hundred cells in a thousandth of the points, which are near it.
    assert unsure < 2e-4 * points


def test_several_occluders_against_lines() -> None:
    """A line is free where none of them is in its way, whichever parts of the lens the others hide."""
    items, rng = [OCCLUDERS[name] for name in ("sphere", "wire", "card", "bounded cylinder")], np.random.default_rng(5)
    poses = [random_poses(rng, item, 2, 1.0)[1] for item in items]
    rays, w = random_points(rng, 3000)
    lens = random_taps(rng, 30, 1.0)
    _, share = free_shares(items, poses, rays, w, lens, PILLBOX)
    blocked = blocked_lines(items, poses, rays, w, lens)
    alone = [blocked_lines([item], [pose], rays, w, lens) for item, pose in zip(items, poses, strict=True)]
    assert min(int((one & (np.sum(alone, axis=0) > 1)).sum()) for one in alone) > 10
    assert ((share < 0.5) == blocked)[decided(share)].mean() > 1 - 1e-4  # of the bounded cylinder, see above
    assert decided(share).mean() > 0.999


@pytest.mark.parametrize("name", ["bounded cylinder", "cap", "bounded paraboloid", "bounded cone"])
def test_a_hollow_surface_hides_its_own_inside(name: str) -> None:
    """The near rim is in the way of points on the far wall; the wall itself is not."""
    item, rng = OCCLUDERS[name], np.random.default_rng(11)
    wrong = points = hidden = seen = 0
    for pose in random_poses(rng, item, 12, 1.0):
        surface = place(item, pose)
        far = 1 if surface.constant < 0 else 2
        group = OcclusionGroup(1, 1, 0, far)
        rays, _ = random_points(rng, 8000)
        w, label, _ = nearest_surface([surface], [item.bounds], group, rays)
        chosen = (label > 0) & (np.abs(1 / np.where(w > 0, w, 1.0) / CAMERA.focused_distance - 1) > 0.02)
        rays, w = rays[chosen], w[chosen]
        if not w.size:
            continue
        lens = random_taps(rng, 25, 1.0)
        _, share = free_shares([item], [pose], rays, w, lens, PILLBOX, group)
        blocked = blocked_lines([item], [pose], rays, w, lens)
        # Lens points that are behind the surface at the point itself get no light of it by the tilt.
        taps = lens[:, None] * blur_radius(CAMERA, w)[None, :, None]
        way = lens_points(rays, w, taps[..., 0], taps[..., 1]) - rays / w[:, None]
        normal = surface_normal(surface, rays, w)
        before = (way * normal).sum(axis=-1) > 1e-3 * np.linalg.norm(way, axis=-1)
        wrong += int((before & decided(share) & ((share < 0.5) != blocked)).sum())
        points, hidden, seen = points + int(before.sum()), hidden + int(blocked.sum()), seen + int((~blocked).sum())
    assert points > 5000
    assert min(hidden, seen) > 0.02 * points
    assert wrong <= 1e-3 * points


def test_points_inside_of_another_object_are_hidden() -> None:
    """Two balls share a lens of space: each hides the other's part that is in it, at any lens point."""
    left, right = Sphere(center=(-5.0, 0.0, 200.0), radius=12.0), Sphere(center=(5.0, 3.0, 204.0), radius=10.0)
    for own, other in ((left, right), (right, left)):
        surface = place(other, STILL)
        rng = np.random.default_rng(8)
        rays = np.concatenate([rng.uniform(-0.1, 0.1, (4000, 2)), np.ones((4000, 1))], axis=-1)
        w, label = solve_quadric(place(own, STILL), None, rays)
        rays, w = rays[label > 0], w[label > 0]
        inside = np.linalg.norm(rays / w[:, None] - other.center, axis=1) < other.radius
        assert 0.02 < inside.mean() < 0.5
        radius, middle = blur_radius(CAMERA, w), np.zeros_like(w)
        args = (
            [surface],
            [None],
            OcclusionGroup(0, 1),
            PILLBOX,
            Points(rays, w, radius, middle, middle, 1.0, np.zeros((len(w), 2))),
        )
        state, edge, _ = check_visibility(LENS, *args)
        assert (state[inside] == HIDDEN).all()
        assert (state[~inside] != HIDDEN).any()
        # The change is an outline for sub-pixel sources, whether or not anything can be seen of what is beyond.
        assert edge[inside].all()


@pytest.mark.parametrize("name", [name for name in OCCLUDERS if name.endswith("around the lens")])
def test_around_the_lens(name: str) -> None:
    """A lens inside of a convex surface is seen by all that is inside, and by nothing outside."""
    item = OCCLUDERS[name]
    assert place(item, STILL).constant < 0
    rays, w = random_points(np.random.default_rng(9), 3000)
    matrix, vector, constant = quadric_of(item)
    point = rays / w[:, None] - rest_center(item)
    value = np.einsum("ni,ij,nj->n", point, matrix, point) + 2 * point @ vector + constant
    assert 0.05 < (value > 0).mean() < 0.95
    state, _ = free_shares([item], [STILL], rays, w, random_taps(np.random.default_rng(1), 1, 1.0), PILLBOX)
    # Not all are found to be clear at once: the bound of what h can come to is wide for strongly bent surfaces.
    assert (state[value > 0] == HIDDEN).all()
    assert (state[value < 0] != HIDDEN).all()


@pytest.mark.parametrize("width", [0.0, 1.0])
def test_narrow_lenses_are_weighed_cell_by_cell(width: float) -> None:
    """Below some px of blur a tap's response weighs the cells of the lens: against sums over 400 x 400 lens points.

    The response is the box of a pixel to a point, and to a source that is a pixel a tent.
    """
    camera = CAMERA.model_copy(update={"pixel_pitch": 0.15, "aperture_diameter": 10.0})
    item = Plane(distance=200.0, bounds=((0.4, 60.0), (-60.0, 60.0), (-1.0, 1.0)))
    rays, w = np.array([[0.0, 0.0, 1.0]]), np.array([1 / 400.0])
    radius = blur_radius(camera, w)
    assert 0.5 < radius[0] < 2.0
    zero, surfaces = np.zeros(1), [place(item, STILL)]
    _, _, visibility = check_visibility(
        Lens.of(camera),
        surfaces,
        [item.bounds],
        OcclusionGroup(0, 1),
        PILLBOX,
        Points(rays, w, radius, zero, zero, width, np.zeros((1, 2))),
    )
    assert (visibility.row == 0).all()
    cells = cell_visibility(visibility)
    fine = (np.arange(400) + 0.5) / 200 - 1
    x, y = np.meshgrid(fine, fine)
    # The line crosses the card's plane half way to the lens point 5 mm x, from a place in the pixel that is 1.5 mm wide
    # there.
    free = np.clip((0.4 - 2.5 * x) / 1.5 + 0.5, 0.0, 1.0) if width else 2.5 * x < 0.4
    for dx, dy in ((0, 0), (1, 0), (-1, 0), (0, 1), (1, 1)):
        away = np.abs([x * radius - dx, y * radius - dy])
        response = np.prod(np.maximum(0, 1 - away) if width else away <= 0.5, axis=0)
        response = np.where(x * x + y * y <= 1, response, 0.0)
        # The grid has 16 cells across, and its edge is softened over one of them.
        assert tap_share(visibility, cells, dx, dy)[0] == pytest.approx(
            (response * free).sum() / response.sum(), abs=0.02
        )
    assert tap_share(visibility, cells, 5.0, 0.0)[0] == 1.0  # no light goes there: nothing to divide by


def test_soft_step_is_a_step() -> None:
    t = np.linspace(-1.0, 1.0, 2001)
    step = soft_step(t)
    assert (np.diff(step) >= 0).all()
    assert step[t <= -0.5].max() == 0.0
    assert step[t >= 0.5].min() == 1.0
    np.testing.assert_allclose(step + soft_step(-t), 1.0, atol=1e-15)
    # As a spread over [-a, a], a = 1/2, its slope has the variance a^2 / 5.
    middle, slope = 0.5 * (t[1:] + t[:-1]), np.diff(step)
    assert (middle**2 * slope).sum() == pytest.approx(0.25 / 5, rel=1e-5)


@pytest.mark.parametrize(("degrees", "expected"), [(0.0, 0.3), (180.0, 0.0), (90.0, 0.3 * 0.6)])
def test_edges_in_one_cell_hide_by_their_directions(degrees: float, expected: float) -> None:
    """Two half planes that leave 0.3 and 0.6 of a cell: the less of it if both hide the same side, nothing if they hide
    opposite ones and overlap, the product if their edges are perpendicular; in any order, and alone each its own."""
    turn, one = np.radians(degrees), np.ones(1)
    first = Part(0.7 * one, 3.0 * one, 0.0 * one)
    second = Part(0.4 * one, np.cos(turn) * one, np.sin(turn) * one)
    for a, b in ((first, second), (second, first)):
        alone = leave_free(Part(one, 0 * one, 0 * one), a)
        np.testing.assert_array_equal(alone.share, 1 - a.share)
        np.testing.assert_allclose(leave_free(alone, b).share, expected, atol=1e-12)


def test_the_gap_between_two_edges_is_left() -> None:
    """Two half planes that hide 0.3 and 0.2 of a cell from opposite sides leave the half between them."""
    one, none = np.ones(1), np.zeros(1)
    left = leave_free(Part(one, none, none), Part(0.3 * one, one, none))
    np.testing.assert_allclose(leave_free(left, Part(0.2 * one, -one, none)).share, 0.5)
