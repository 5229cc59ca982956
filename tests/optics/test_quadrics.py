"""Canonical quadrics against the shapes' own equations, and predicted depths against a search along the ray."""

from __future__ import annotations

from math import radians, tan

import numpy as np
import pytest
from scipy.optimize import brentq

from clsco.optics.motion import Pose, pose_at
from clsco.optics.quadrics import Canonical, PlacedSurface, canonical, place, predict_inverse_depth
from clsco.reference.common.geometry import solve_quadric
from clsco.scene.model import AnyShape, Cone, Cylinder, Disc, Ellipsoid, ObjectMotion, Plane, Quadric, Sphere
from tests.optics.grids import Array

EPS = np.finfo(np.float64).eps
MOTION = ObjectMotion(velocity=(3.0, -2.0, 9.0), angular_velocity=(25.0, -40.0, 60.0))
NAMED = {
    "paraboloid": (1, 1, 0, 0, 0, 0, 0, 0, -40, 0),
    "paraboloid aside": (0, 1, 2, 0, 0, 0, 40, 0, 0, -900),
    "saddle": (1, -1, 0, 0, 0, 0, 0, 0, -40, 0),
    "saddle in xy": (0, 0, 0, 1, 0, 0, 0, 0, -20, 0),
    "one sheet": (1, 1, -1, 0, 0, 0, 0, 0, 0, -400),
    "two sheets": (1, 1, -1, 0, 0, 0, 0, 0, 0, 400),
    "elliptic cylinder": (1, 0, 3, 0, 0, 0, 0, 0, 0, -700),
    "parabolic cylinder": (1, 0, 0, 0, 0, 0, 0, 0, -40, 0),
    "hyperbolic cylinder": (1, 0, -1, 0, 0, 0, 0, 0, 0, -300),
    "elliptic cone": (1, 2, -1, 0, 0, 0, 0, 0, 0, 0),
    "product of planes": (0, 0, 0, 1, 0, 0, 0, 0, 1, 0),
    "two parallel planes": (0, 0, 1, 0, 0, 0, 0, 0, 0, -100),
    "crossing planes": (1, 0, -1, 0, 0, 0, 0, 0, 0, 0),
    "plane": (0, 0, 0, 0, 0, 0, -0.5, 0.25, 1, 3),
    "nearly a plane": (1e-9, 0, 0, 0, 0, 0, 0.3, 0, 1, 0),
    "large coefficients": (1e20, 1e20, 1e20, 0, 0, 0, 0, 0, 0, -9e22),
    "small coefficients": (1e-20, 2e-20, 1e-20, 0, 0, 0, 0, 0, 0, -9e-18),
}
QUADRICS = {name: Quadric(coefficients=tuple(float(c) for c in row)) for name, row in NAMED.items()}
SHAPES: dict[str, AnyShape] = {
    "plane in front": Plane(distance=250.0, slope_x=0.7, slope_y=-0.4),
    "sphere": Sphere(center=(5.0, -3.0, 280.0)),
    "sphere around the lens": Sphere(center=(5.0, -3.0, 10.0)),
    "cylinder": Cylinder(axis=(0.3, 1.0, 0.2)),
    "cylinder along z": Cylinder(axis=(0.0, 0.0, -2.0), center=(3.0, 0.0, 200.0)),
    "cone": Cone(half_angle=40.0, apex=(1.0, 2.0, 250.0)),
    "cone towards": Cone(half_angle=40.0, apex=(1.0, 2.0, 250.0), nappe="towards"),
    "ellipsoid": Ellipsoid(semi_axes=(30.0, 20.0, 50.0)),
    "card": Plane(distance=250.0, slope_x=0.5, bounds=((-20.0, 20.0), (-10.0, 30.0), (-90.0, 90.0))),
    "disc": Disc(center=(2.0, 1.0, 250.0), radius=22.0, offset=-3.0),
    "cap": Sphere(bounds=((-30.0, 30.0), (-30.0, 10.0), (-31.0, -5.0))),
    "bowl": Sphere(bounds=((-30.0, 30.0), (-30.0, 30.0), (0.0, 31.0))),
    "tube": Cylinder(bounds=((-31.0, 31.0), (-15.0, 15.0), (-31.0, 31.0))),
    **QUADRICS,
}


def terms(item: AnyShape, p: Array) -> Array:
    """Terms, to be added, of the equation of a shape at points p (..., 3) in its own frame."""
    x, y, z = p[..., 0], p[..., 1], p[..., 2]
    one = np.ones_like(x)
    match item:
        case Plane():  # 3.7
            parts = [z, -item.slope_x * x, -item.slope_y * y]
        case Disc():
            parts = [z, -item.offset * one]
        case Sphere():  # 3.18
            parts = [x * x, y * y, z * z, -(item.radius**2) * one]
        case Cylinder():  # 3.11, about any axis: |P|^2 - (P . axis)^2
            axis = np.array(item.axis) / np.linalg.norm(item.axis)
            parts = [x * x, y * y, z * z, -((p @ axis) ** 2), -(item.radius**2) * one]
        case Cone():  # 3.23, squared
            parts = [x * x, y * y, -((z * tan(radians(item.half_angle))) ** 2)]
        case Ellipsoid():  # 3.33
            a, b, c = item.semi_axes
            parts = [(x / a) ** 2, (y / b) ** 2, (z / c) ** 2, -one]
        case Quadric():  # 3.39
            factors = (x * x, y * y, z * z, x * y, y * z, z * x, x, y, z, one)
            parts = [c * f for c, f in zip(item.coefficients, factors, strict=True)]
    return np.stack(parts)


def value(shape: Canonical, x: Array) -> Array:
    """Value of the canonical equation at points (..., 3) of the canonical frame."""
    return np.asarray((shape.q * x**2 + 2.0 * shape.l * x).sum(axis=-1) - shape.k)


@pytest.mark.parametrize("name", SHAPES)
def test_canonical_form_is_the_shape(name: str) -> None:
    item = SHAPES[name]
    shape = canonical(item)
    np.testing.assert_allclose(shape.axes @ shape.axes.T, np.eye(3), rtol=0, atol=8 * EPS)
    points = np.random.default_rng(1).uniform(-60, 60, (300, 3))
    parts = terms(item, points)
    expected = parts.sum(axis=0)
    found = value(shape, (points - shape.origin) @ shape.axes.T)
    assert (expected > 0).any()
    if name not in ("two parallel planes", "nearly a plane"):
        assert (expected < 0).any()
    # The canonical form may be scaled, and each of a dozen products is rounded relative to the largest of them: those
    # of the equation, or q o^2 with the center o of its curvature, which is far away where that is small.
    scale = float(found @ expected / (expected @ expected))
    assert scale > 0
    from_center = np.abs(shape.q) @ (shape.axes @ shape.origin) ** 2
    limit = 64 * EPS * (np.abs(parts).sum(axis=0).max() * scale + from_center)
    np.testing.assert_allclose(found, scale * expected, rtol=0, atol=limit)


def test_random_quadrics_keep_their_equation() -> None:
    rng = np.random.default_rng(2)
    for rank in (1, 2, 3):
        for _ in range(60):
            axes = np.linalg.qr(rng.standard_normal((3, 3)))[0]
            curvature = np.where(np.arange(3) < rank, rng.uniform(0.2, 2.0, 3) * rng.choice([-1, 1], 3), 0.0)
            m = axes.T @ np.diag(curvature) @ axes
            linear, constant = rng.uniform(-30, 30, 3), rng.uniform(-900, 900)
            rows = (m[0, 0], m[1, 1], m[2, 2], 2 * m[0, 1], 2 * m[1, 2], 2 * m[2, 0], *linear, constant)
            item = Quadric(coefficients=tuple(float(c) for c in rows))
            shape = canonical(item)
            assert np.count_nonzero(shape.q) == rank  # curvature that is only rounding is none
            points = rng.uniform(-60, 60, (50, 3))
            parts = terms(item, points)
            # A dropped eigenvalue is some eps of the largest one; the center lies up to |linear| / min |q| = 150 away.
            limit = 64 * EPS * (np.abs(parts).sum(axis=0).max() + 2.0 * (60 + 300) ** 2)
            found, expected = value(shape, (points - shape.origin) @ shape.axes.T), parts.sum(axis=0)
            scale = float(np.exp2(np.rint(np.log2(found @ expected / (expected @ expected)))))
            np.testing.assert_allclose(found / scale, expected, rtol=0, atol=limit)


def test_a_multiple_of_a_quadric_is_the_same_surface() -> None:
    """Squares of 1e20 would leave the range of float32."""
    coefficients = (0.3, -2.0, 0.7, 0.1, 0.2, -0.4, 3.0, -5.0, 1.0, -90.0)
    plain = canonical(Quadric(coefficients=coefficients))
    assert 0.2 < np.abs(plain.q).max() < 4.0
    for exponent in (-80, -7, 1, 66):
        scaled = canonical(Quadric(coefficients=tuple(2.0**exponent * c for c in coefficients)))
        for field in ("q", "l", "k", "axes", "origin"):
            np.testing.assert_array_equal(getattr(scaled, field), getattr(plain, field))


@pytest.mark.parametrize("name", SHAPES)
def test_a_placed_surface_moves_with_its_pose(name: str) -> None:
    item = SHAPES[name]
    pose = pose_at(MOTION, 0.7, "euler")
    surface = place(item, pose)
    body = np.random.default_rng(3).uniform(-60, 60, (20, 3))
    seen = surface.rest + pose.shift + body @ pose.rotation.T  # P(t) = C + v t + M (P0 - C)
    length = 500.0
    np.testing.assert_allclose(surface.body_offset + seen @ surface.body_turn.T, body, rtol=0, atol=32 * EPS * length)
    own, offset = surface.canonical, surface.offset
    expected, limit = (body - own.origin) @ own.axes.T, 32 * EPS * (length + np.abs(own.origin).max())
    np.testing.assert_allclose(offset + seen @ surface.turn.T, expected, rtol=0, atol=limit)
    largest = float(np.abs(own.q) @ offset**2 + 2 * np.abs(own.l * offset).sum()) + abs(own.k)
    assert surface.constant == pytest.approx(float(value(own, offset)), abs=32 * EPS * largest)


def test_a_far_sphere_keeps_the_digits_of_its_value_at_the_lens() -> None:
    for distance in (1e4, 1e6):
        surface = place(Sphere(center=(0.0, 0.0, distance), radius=1.0), Pose(np.eye(3), np.zeros(3)))
        assert surface.constant == (distance - 1.0) * (distance + 1.0)


def search(item: AnyShape, pose: Pose, rest: Array, ray: Array) -> float:
    """Inverse depth of the nearest point of a shape along a ray, by its change of sign; 0 where there is none."""

    def body(z: float) -> Array:
        return np.asarray(pose.rotation.T @ (z * ray - rest - pose.shift))

    def equation(z: float) -> float:
        return float(terms(item, body(z)).sum())

    grid = np.geomspace(1.0, 1e6, 4000)
    points = (grid[:, None] * ray - rest - pose.shift) @ pose.rotation
    sign = np.sign(terms(item, points).sum(axis=0))
    for k in np.flatnonzero(sign[1:] != sign[:-1]).tolist():
        z = float(brentq(equation, grid[k], grid[k + 1], xtol=1e-12, rtol=1e-14))
        p = body(z)
        if item.bounds is not None and not all(low <= v <= high for v, (low, high) in zip(p, item.bounds, strict=True)):
            continue
        if isinstance(item, Disc) and np.hypot(p[0], p[1]) > item.radius:
            continue
        if isinstance(item, Cone) and (p[2] >= 0) != (item.nappe == "away"):
            continue
        return 1.0 / z
    return 0.0


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("time", [0.0, 0.4])
def test_depths_are_what_a_search_finds(name: str, time: float) -> None:
    """Depths that the plan predicts, and those of the reference."""
    item = SHAPES[name]
    pose = pose_at(MOTION, time, "euler")
    surface: PlacedSurface = place(item, pose)
    slopes = np.random.default_rng(4).uniform(-0.15, 0.15, (2, 50))
    expected = np.array([search(item, pose, surface.rest, np.array([x, y, 1.0])) for x, y in slopes.T])
    assert (expected > 0).sum() > 5, "nothing to compare"
    exact, _ = solve_quadric(surface, item.bounds, np.stack([*slopes, np.ones(50)], axis=-1))
    for found in (predict_inverse_depth(item, surface, *slopes), exact):
        # Both searches stop at 1e6 mm, and two roots nearer to each other than 0.35 % do not change the sign between
        # two points of the grid: leave those rays to the exact tests.
        differs = (found > 2e-6) != (expected > 2e-6)
        assert differs.mean() < 0.05
        both = (found > 2e-6) & (expected > 2e-6)
        # The textbook discriminant loses the digits that its terms have over it, up to 1e3 to 1e4 here.
        np.testing.assert_allclose(found[both], expected[both], rtol=1e-9)


def test_shapes_of_a_tensor_of_rays() -> None:
    x = np.linspace(-0.1, 0.1, 24).reshape(2, 3, 4)
    surface = place(SHAPES["sphere"], pose_at(MOTION, 0.0, "euler"))
    found = predict_inverse_depth(SHAPES["sphere"], surface, x, 0.5 * x)
    assert found.shape == (2, 3, 4)
    flat = predict_inverse_depth(SHAPES["sphere"], surface, x.ravel(), 0.5 * x.ravel())
    assert (found.ravel() == flat).all()
