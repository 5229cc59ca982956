"""The ray-surface solution against closed forms, exact arithmetic and differences."""

from __future__ import annotations

from collections.abc import Callable
from decimal import Decimal, localcontext
from fractions import Fraction

import numpy as np
import pytest
from numpy.typing import NDArray

import clsco
from clsco.optics.lens import Lens
from clsco.optics.point_spread import point_spread
from clsco.optics.psf_grid import table_coordinate as coordinate_of_radius
from clsco.optics.quadrics import PlacedSurface
from clsco.optics.visibility import OcclusionGroup
from clsco.reference.common.geometry import (
    Filter,
    blur_gradient,
    blur_radius,
    difference_of_products,
    mirror_index,
    nearest_surface,
    pixel_ray,
    project,
    rest_pixel,
    sample_texture,
    solve_quadric,
    surface_normal,
    surface_slope,
)
from clsco.scene.model import AnyShape, Camera, Cone, Cylinder, Ellipsoid, ObjectMotion, Plane, Psf, Quadric, Sphere
from tests.spreads import table_coordinate

Array = NDArray[np.float64]
Placer = Callable[..., PlacedSurface]

EPS = np.finfo(np.float64).eps
# Each depth is a few dozen float64 operations on numbers that do not cancel: 64 eps covers them all.
CLOSE = 64 * EPS
CAMERA = Camera(resolution=(65, 49))
SHAPES = (
    Plane(distance=250.0, slope_x=0.7, slope_y=-0.4),
    Sphere(center=(5.0, -3.0, 280.0)),
    Cylinder(axis=(0.3, 1.0, 0.2)),
    Cone(half_angle=40.0, apex=(1.0, 2.0, 250.0)),
    Ellipsoid(center=(0.0, 0.0, 300.0), semi_axes=(30.0, 20.0, 50.0)),
    Quadric(center=(0.0, 0.0, 250.0), coefficients=(1.0, -0.7, 0.4, 0.2, 0.1, -0.3, 2.0, 1.0, -5.0, 30.0)),
)


def all_rays(scale: float = 1.0) -> Array:
    """Rays of every pixel of CAMERA, slopes multiplied by `scale`."""
    rays = pixel_ray(CAMERA, np.arange(49)[:, None], np.arange(65)[None, :])
    return rays * np.array([scale, scale, 1.0])


def quadratic_root(a: Array, b: Array | float, c: float) -> Array:
    """The smaller root of 3.15, 3.21 and 3.37 as the thesis writes it (3.16, 3.22, 3.38); NaN where none."""
    discriminant = b * b - 4 * a * c
    return np.where(discriminant >= 0, (-b - np.sqrt(np.abs(discriminant))) / (2 * a), np.nan)


def thesis_depth(item: AnyShape, rays: Array) -> Array:
    """Depth Z by the thesis' own formulas, with its names; NaN where the ray misses."""
    x, y = rays[..., 0], rays[..., 1]
    square = x**2 + y**2
    if isinstance(item, Plane):
        return item.distance / (1 - item.slope_x * x - item.slope_y * y)  # 3.10
    if isinstance(item, Cone):
        return item.apex[2] / (1 - np.sqrt(square) / np.tan(np.radians(item.half_angle)))  # 3.32, near nappe
    assert item.shape != "background"
    c = item.center[2]
    if isinstance(item, Sphere):
        return quadratic_root(1 + square, -2 * c, c**2 - item.radius**2)  # 3.22
    if isinstance(item, Cylinder):
        return quadratic_root(1 + x**2, -2 * c, c**2 - item.radius**2)  # 3.16
    assert isinstance(item, Ellipsoid)
    b, _, a = item.semi_axes
    return quadratic_root(b**2 + square * a**2, -2 * c * b**2, b**2 * (c**2 - a**2))  # 3.36


OF_THE_THESIS = (SHAPES[0], Sphere(), Cylinder(), Cone(half_angle=60.0), Ellipsoid(semi_axes=(30.0, 30.0, 50.0)))


@pytest.mark.parametrize("item", OF_THE_THESIS, ids=lambda item: item.shape)
def test_depth_is_that_of_the_thesis(item: AnyShape, at: Placer) -> None:
    rays = all_rays(8.0)
    w, label = solve_quadric(at(item), None, rays)
    expected = thesis_depth(item, rays)
    assert ((label > 0) == (np.isfinite(expected) & (expected > 0))).all()
    hit = label > 0
    assert hit.mean() > 0.2
    # The thesis' form subtracts c^2 - rho^2 and a root of the discriminant: with c/rho < 10 that costs some
    # 100 eps, and sqrt(100 eps) where the discriminant itself vanishes, at the limb.
    assert np.abs(w[hit] * expected[hit] - 1).max() < 10 * np.sqrt(EPS)
    assert np.median(np.abs(w[hit] * expected[hit] - 1)) < CLOSE


@pytest.mark.parametrize("distance", [1e4, 1e5, 1e6])
def test_small_far_sphere_keeps_its_digits(distance: float, at: Placer) -> None:
    item = Sphere(center=(0.0, 0.0, distance), radius=1.0)
    surface = at(item)
    slopes = np.random.default_rng(7).uniform(-1.1 / distance, 1.1 / distance, (400, 2))
    rays = np.concatenate([slopes, np.ones((400, 1))], axis=1)
    w, label = solve_quadric(surface, None, rays)
    assert 0.4 < (label > 0).mean() < 0.9
    naive_wrong = 0
    with localcontext() as context:
        context.prec = 60
        for ray, found in zip(rays, w, strict=True):
            x, y = Decimal(float(ray[0])), Decimal(float(ray[1]))
            c = Decimal(distance)
            a = 1 + x * x + y * y
            discriminant = c * c - a * (c * c - 1)
            if abs(discriminant) <= 16 * Decimal(EPS):
                continue  # within rounding of the products of a ray that just touches
            assert (found > 0) == (discriminant > 0)
            b = 2 * distance
            naive = b * b - 4 * float(a) * (distance**2 - 1)
            if discriminant < 0:
                continue
            exact = (c - discriminant.sqrt()) / a
            near = exact - c  # in units of the radius: what cancellation would destroy
            z = 1 / Decimal(float(found))
            # Z itself is rounded to eps of c, and sqrt(D) to 8 eps / sqrt(D) of the radius.
            limit = 8 * Decimal(EPS) * (c + 1 / discriminant.sqrt())
            assert abs((z - c) - near) <= limit
            naive_z = (b - np.sqrt(max(naive, 0.0))) / (2 * float(a))
            naive_wrong += abs(Decimal(float(naive_z)) - exact) > limit
    assert naive_wrong > 100  # the thesis' form fails this very test


def test_plane_at_the_horizon_changes_sign_instead_of_running_away(at: Placer) -> None:
    surface = at(Plane(distance=250.0, slope_x=100.0))
    rays = all_rays(10.0)
    w, label = solve_quadric(surface, None, rays)
    expected = (1 - 100.0 * rays[..., 0]) / 250.0
    assert 0.2 < (expected > 0).mean() < 0.8
    assert ((label > 0) == (expected > 0)).all()
    # w is a difference of numbers up to |100 x| / 250, so its error is relative to those.
    assert (np.abs(w - np.maximum(expected, 0)) <= CLOSE * (1 + np.abs(100.0 * rays[..., 0])) / 250.0).all()


def test_bounds_turn_with_the_object(at: Placer) -> None:
    turned = Plane(motion=ObjectMotion(angular_velocity=(0.0, 0.0, 90.0)))
    bounds = ((-20.0, 20.0), (-5.0, 5.0), (-1.0, 1.0))
    ray = np.array([[15 / 250, 0.0, 1.0], [0.0, 15 / 250, 1.0]])
    assert (solve_quadric(at(turned, 0.0), bounds, ray)[1] > 0).tolist() == [True, False]
    assert (solve_quadric(at(turned, 1.0), bounds, ray)[1] > 0).tolist() == [False, True]


@pytest.mark.parametrize("item", SHAPES, ids=lambda item: item.shape)
def test_slope_and_normal_agree_with_differences(item: AnyShape, at: Placer) -> None:
    moved = item.model_copy(update={"motion": ObjectMotion(angular_velocity=(10.0, -5.0, 30.0))})
    surface, rays = at(moved, 1.0), all_rays(6.0)[3::6, 3::6]
    w, label = solve_quadric(surface, None, rays)
    step = 1e-6
    slope = surface_slope(surface, rays, w)
    around = []
    inner = label > 0
    for axis in range(2):
        shift = np.zeros(3)
        shift[axis] = step
        (ahead, right), (behind, left) = (solve_quadric(surface, None, rays + s * shift) for s in (1, -1))
        inner &= (right == label) & (left == label)
        around.append((ahead - behind) / (2 * step))
    differences = np.stack(around, axis=-1)
    inner &= np.abs(slope).max(axis=-1) < 1.0 / 20.0  # leave out the limb, where higher derivatives run away
    assert inner.sum() > 20
    # Rounding: eps w / step = 1e-12. Truncation: step^2 / 6 times the third derivative, below 1e5 where the
    # slope is below 1/20: 2e-8.
    np.testing.assert_allclose(slope[inner], differences[inner], atol=1e-7, rtol=0)
    normal = surface_normal(surface, rays, w)
    assert ((normal * rays).sum(axis=-1)[inner] < 0).all()
    np.testing.assert_allclose((normal**2).sum(axis=-1)[label > 0], 1.0, rtol=CLOSE)
    assert not normal[label == 0].any()
    for axis in range(2):
        # P = ray / w: the surface's tangent along a slope is (e - ray w'/w) / w, and the normal stands on it.
        tangent = np.eye(3)[axis] - rays * (slope[..., axis] / np.where(inner, w, 1.0))[..., None]
        assert (np.abs((tangent * normal).sum(axis=-1))[inner] < 1e-11 * np.abs(tangent).max(axis=-1)[inner]).all()


def test_normal_of_a_sphere_is_its_radius_vector(at: Placer) -> None:
    item = Sphere(center=(5.0, -3.0, 280.0))
    rays = all_rays(6.0)
    w, label = solve_quadric(at(item), None, rays)
    hit = label > 0
    assert hit.any()
    point = rays[hit] / w[hit][:, None]
    normal = surface_normal(at(item), rays, w)[hit]
    # The points' coordinates carry eps of 280 mm, near the limb sqrt(eps) of that along the ray at worst.
    np.testing.assert_allclose(normal, (point - np.array(item.center)) / 30.0, atol=1e-9)


def test_apex_of_a_cone_has_a_direction_and_no_slope(at: Placer) -> None:
    ray = np.array([[0.0, 0.0, 1.0]])
    surface = at(Cone())
    w, label = solve_quadric(surface, None, ray)
    assert label[0] > 0
    assert w[0] == 1 / 250.0
    assert surface_slope(surface, ray, w).tolist() == [[0.0, 0.0]]
    assert surface_normal(surface, ray, w).tolist() == [[0.0, 0.0, -1.0]]


@pytest.mark.parametrize("lens", [None, clsco.Lens(field_curvature=-1 / 30), clsco.Lens(focus_surface="sphere")])
def test_blur_gradient_agrees_with_differences(at: Placer, lens: clsco.Lens | None) -> None:
    surface = at(Plane(distance=280.0, slope_x=1.5, slope_y=-0.5))
    row, column = 20.0, 30.0

    def radius(row: float, column: float) -> float:
        ray = pixel_ray(CAMERA, row, column)
        return float(blur_radius(Lens.of(CAMERA, lens), ray, solve_quadric(surface, None, ray)[0]))

    ray = pixel_ray(CAMERA, row, column)
    w, _ = solve_quadric(surface, None, ray)
    right, down = blur_gradient(CAMERA, Lens.of(CAMERA, lens), surface_slope(surface, ray, w), ray, w)
    # R is linear over the plane, so that differences are exact but for eps R / 1 px; else for what bends.
    bent = 1e-11 if lens is None else 1e-7
    assert abs(right - (radius(row, column + 0.5) - radius(row, column - 0.5))) < bent
    assert abs(down - (radius(row + 0.5, column) - radius(row - 0.5, column))) < bent
    assert right > 0.02
    assert down > 0.005


def test_pixel_ray_and_project_are_inverse() -> None:
    corner = pixel_ray(CAMERA, 0.0, 0.0)
    np.testing.assert_allclose(corner, [-32 * 0.01 / 20, 24 * 0.01 / 20, 1.0], rtol=CLOSE)
    row, column = np.random.default_rng(3).uniform(-20, 90, (2, 50))
    back = project(CAMERA, 37.0 * pixel_ray(CAMERA, row, column))
    np.testing.assert_allclose(back, (row, column), atol=1e-12)  # eps of a few hundred px


@pytest.mark.parametrize(("distance", "expected"), [(250.0, 80.0), (285.0, 10 * 20 / 285 / 0.01)])
def test_ten_millimeters_are_eighty_pixels(distance: float, expected: float, at: Placer) -> None:
    surface = at(Plane(distance=distance, motion=ObjectMotion(velocity=(10.0, 0.0, 0.0))), 1.0)
    rays = all_rays()
    w, _ = solve_quadric(surface, None, rays)
    row, column, valid = rest_pixel(surface, CAMERA, rays, w)
    assert valid.all()
    np.testing.assert_allclose(column, np.arange(65)[None, :] - expected + 0 * row, atol=1e-10)  # eps of 1e3 px
    np.testing.assert_allclose(row, np.arange(49)[:, None] + 0 * row, atol=1e-10)


def test_rest_pixel_refuses_what_was_behind_the_lens(at: Placer) -> None:
    # Z = 50 + 20 X: the point at X = -4 was at Z = -30 and is now at 70.
    item = Plane(distance=50.0, slope_x=20.0, motion=ObjectMotion(velocity=(0.0, 0.0, 100.0)))
    surface = at(item, 1.0)
    ray = np.array([[-4.0 / 70.0, 0.0, 1.0], [0.0, 0.0, 1.0]])
    w, label = solve_quadric(surface, None, ray)
    assert (label > 0).all()
    row, column, valid = rest_pixel(surface, CAMERA, ray, w)
    assert valid.tolist() == [False, True]
    assert row[0] == column[0] == 0.0


def test_difference_of_products_survives_cancellation() -> None:
    rng = np.random.default_rng(5)
    a, b = rng.uniform(1, 2, (2, 500))
    c, d = a * (1 + 1e-9 * rng.standard_normal(500)), b * (1 + 1e-9 * rng.standard_normal(500))
    found = difference_of_products(a, b, c, d)
    errors = []
    for values in zip(a, b, c, d, found, a * b - c * d, strict=True):
        p, q, r, s, value, naive = (Fraction(float(v)) for v in values)
        exact = p * q - r * s
        errors.append([abs(float((rounded - exact) / exact)) for rounded in (value, naive)])
    worst, naive_worst = np.max(errors, axis=0)
    assert worst <= 2 * EPS < naive_worst  # 1.5 ulp and the last rounding


def test_mirror_index() -> None:
    assert mirror_index(np.arange(-5, 9), 3).tolist() == [1, 2, 2, 1, 0, 0, 1, 2, 2, 1, 0, 0, 1, 2]
    assert mirror_index(np.arange(-3, 4), 1).tolist() == [0] * 7


@pytest.mark.parametrize("texture_filter", ["nearest", "bilinear", "bicubic"])
def test_texels_are_kept(texture_filter: Filter) -> None:
    texture = np.random.default_rng(2).random((5, 7, 3))
    row, column = np.meshgrid(np.arange(-6, 12), np.arange(-8, 15), indexing="ij")
    found = sample_texture(texture, row.astype(float), column.astype(float), texture_filter)
    expected = np.pad(texture, ((6, 7), (8, 8), (0, 0)), mode="symmetric")
    assert (found == expected).all()


def test_filters_keep_what_they_must() -> None:
    row, column = np.random.default_rng(4).uniform(2, 5, (2, 200))
    i, j = np.meshgrid(np.arange(8.0), np.arange(9.0), indexing="ij")
    nearest = sample_texture(10 * i + j, row, column, "nearest")
    assert (nearest == 10 * np.floor(row + 0.5) + np.floor(column + 0.5)).all()
    # A linear and a quadratic signal of size 100 come out to eps of that.
    bilinear = sample_texture(3 * i - 2 * j + i * j, row, column, "bilinear")
    np.testing.assert_allclose(bilinear, 3 * row - 2 * column + row * column, atol=1e-12)
    bicubic = sample_texture(i**2 - 3 * j**2 + i * j, row, column, "bicubic")
    np.testing.assert_allclose(bicubic, row**2 - 3 * column**2 + row * column, atol=1e-12)
    assert sample_texture(i, np.array([2.5]), np.array([3.0]), "nearest")[0] == 3.0  # halves go up


@pytest.mark.parametrize("psf", [Psf(), Psf(edge="sampled"), Psf(model="gaussian", edge="sampled")])
def test_table_coordinate_stays_in_its_interval(psf: Psf) -> None:
    radius = np.concatenate([np.random.default_rng(6).uniform(-6, 6, 5000), np.sqrt(np.arange(1, 36))])
    radius = np.concatenate([radius, np.nextafter(radius, 0.0)])
    for subpixel in (False, True):
        exact = coordinate_of_radius(point_spread(psf), radius, subpixel)
        last = int(exact.max())
        found = table_coordinate(point_spread(psf), radius, subpixel, 0, last + 1)
        assert found.dtype == np.float32
        # Others are continuous there: rounding may take them to where the next interval begins, and no farther.
        jumps = psf.edge == "sampled" and not subpixel
        assert ((np.floor(found) == np.floor(exact)) | (not jumps) & (found == np.ceil(exact))).all()
        np.testing.assert_allclose(found, exact, rtol=2.0**-23)  # one rounding, or one step back
        clamped = table_coordinate(point_spread(psf), radius, subpixel, 5, 3)
        assert clamped.min() == 5.0
        assert clamped.max() == np.nextafter(np.float32(8.0), np.float32(0.0))


def test_nearest_of_several_surfaces(at: Placer) -> None:
    """Each of those that count, ray by ray; of two equally near ones the first."""
    items = (Sphere(center=(-10.0, 0.0, 250.0)), Sphere(center=(10.0, 0.0, 255.0)), Plane(distance=300.0))
    surfaces, bounds = [at(item) for item in (*items, items[0])], [None] * 4
    rays = all_rays(10.0)
    roots = [solve_quadric(surface, None, rays) for surface in surfaces[:3]]
    for members in range(1, 8):
        w, label, number = nearest_surface(surfaces, bounds, OcclusionGroup(members, 0), rays)
        depths = np.stack([roots[k][0] if members >> k & 1 else 0 * w for k in range(3)])
        assert (w == depths.max(axis=0)).all()
        assert (number == np.where(w > 0, depths.argmax(axis=0), -1)).all()
        own = np.stack([roots[k][1] for k in range(3)])[np.maximum(number, 0), *np.indices(w.shape)]
        assert (label == np.where(w > 0, 2 * number + own, 0)).all()
    assert len(np.unique(number)) == 3
    assert not (nearest_surface(surfaces, bounds, OcclusionGroup(0b1001, 0), rays)[2] == 3).any()


def test_sheets_are_the_two_roots(at: Placer) -> None:
    ball = at(Sphere(center=(5.0, -3.0, 280.0)))
    rays = all_rays(10.0)
    near, far = (solve_quadric(ball, None, rays, only) for only in (1, 2))
    hit = near[1] > 0
    assert 0.1 < hit.mean() < 0.9
    assert (near[0] == solve_quadric(ball, None, rays)[0]).all()
    assert (far[1] == np.where(hit, 2, 0)).all()
    assert (far[0][hit] < near[0][hit]).all()
    back = np.linalg.norm(rays[hit] / far[0][hit][:, None] - [5.0, -3.0, 280.0], axis=-1)
    np.testing.assert_allclose(back, 30.0, rtol=1e-12)
