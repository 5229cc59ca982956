"""geometry.clh on the device against its twin, also roots within bounds; the solution itself: test_ray_surface.py."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import clsco
from clsco.constants import CURVED_IMAGE
from clsco.opencl.buffers import download, empty
from clsco.opencl.session import Session
from clsco.optics.distortion import with_distortion
from clsco.optics.lens import Lens
from clsco.optics.motion import pose_at
from clsco.optics.point_spread import point_spread
from clsco.optics.psf_tables import psf_table
from clsco.optics.quadrics import PlacedSurface, place
from clsco.passes.pack import camera_grid, lens_struct, psf_struct, surface_structs
from clsco.records import REAL, Real
from clsco.reference.common import geometry as twin
from clsco.scene.model import Camera, Cone, Cylinder, Ellipsoid, Object, ObjectMotion, Plane, Psf, Quadric
from tests.kernels.launches import held, whole
from tests.spreads import table_coordinate

Array = NDArray[Any]
Run = Callable[..., None]
RNG = np.random.default_rng
FLOAT = 2.0**-24  # largest relative error of rounding to float32
UNIT = {"double": 2.0**-53, "float": FLOAT}  # relative error of an operation

SOURCE = """
#include "common/angles.clh"
// Of the hit of the ray through (row, column): slope, normal, blur radius and its gradient, pixel at rest.
__kernel void follow(__constant surface_t *surface, const grid_t grid, const lens_t given,
                     __global const real *row, __global const real *column, const int count, __global real *w,
                     __global real *out)
{
    const int i = get_global_id(0);
    if (i >= count)
        return;
    const real3 ray = pixel_ray(grid, row[i], column[i]);
    uchar root;
    const real found = solve_quadric(surface, ray, &root);
    w[i] = found;
    if (!root) {
        for (int k = 0; k < 11; ++k)
            out[11 * i + k] = 0;
        return;
    }
    const real2 slope = surface_slope(surface, ray, found);
    const lens_t lens = lens_along(grid, given, ray);
    const real2 gradient = blur_gradient(grid, lens, bend_along(grid, given, ray), slope, ray, found);
    const real3 normal = surface_normal(surface, ray, found);
    const real3 pixel = rest_pixel(surface, grid, ray, found);
    const real all[11] = {slope.x, slope.y, normal.x, normal.y, normal.z, gradient.x, gradient.y,
                          blur_radius(lens, ray, found), pixel.x, pixel.y, pixel.z};
    for (int k = 0; k < 11; ++k)
        out[11 * i + k] = all[k];
}

__kernel void sample(const grid_t grid, __global const float *texture, __global const real *row,
                     __global const real *column, const int count, __global float *out)
{
    const int i = get_global_id(0);
    if (i < count)
        out[i] = sample_texture(texture, grid, row[i], column[i]);
}

__kernel void small(const psf_t psf, __global const real *a, __global const real *b, __global const real *c,
                    __global const real *d, const int count, __global real *difference, __global float *coordinate,
                    __global float *sub_coordinate, __global float2 *tilt, __global float2 *pixel,
                    __global real *spread, __global int *mirrored)
{
    const int i = get_global_id(0);
    if (i >= count)
        return;
    const real radius = a[i], product = difference_of_products(radius, b[i], c[i], d[i]);
    difference[i] = product;
    coordinate[i] = table_coordinate(psf, radius, 0);
    sub_coordinate[i] = table_coordinate(psf, radius, 1);
    const real2 gradient = (real2)(b[i], c[i]);
    real spread_by;
    tilt[i] = tilt_slope(gradient, radius);
    pixel[i] = pixel_tilt(gradient, radius, &spread_by);
    spread[i] = spread_by;
    mirrored[i] = mirror_index(i - 50, 7);
}

__kernel void solve(__constant surface_t *surfaces, __global const real *x, __global const real *y, const int count,
                    const int each, __global real *w, __global uchar *label)
{
    const int i = get_global_id(0);
    if (i >= count)
        return;
    uchar root;
    const real found = solve_quadric(surfaces + i / each, (real3)(x[i], y[i], 1), &root);
    w[i] = found;
    label[i] = root;
}

__kernel void angles(__global const real *y, __global const real *x, const int count, __global real *out)
{
    const int i = get_global_id(0);
    if (i >= count)
        return;
    const real angle = polar_angle(y[i], x[i]);
    const real3 turn = cos_sin(angle);
    out[3 * i] = angle, out[3 * i + 1] = turn.x, out[3 * i + 2] = turn.y;
}

// Ray i, of components in `rays` one after the other, and surface i, or the only one.
__kernel void roots(__constant surface_t *surfaces, const int single, const int only, __global const real *rays,
                    const int count, __global real *w, __global uchar *label)
{
    const int i = get_global_id(0);
    if (i >= count)
        return;
    const real3 ray = (real3)(rays[i], rays[count + i], rays[2 * count + i]);
    uchar found;
    w[i] = solve_root(surfaces + (single ? 0 : i), ray, only, &found);
    label[i] = found;
}
"""


CURVED = clsco.Lens(field_curvature=-1 / 30, focus_surface="sphere")
DISTORTED = clsco.Lens(distortion=(-2.0, 1.0, 0.5), tangential=(0.02, -0.03))
MOTION = ObjectMotion(velocity=(2.0, 1.0, 5.0), angular_velocity=(10.0, -15.0, 30.0))
# Features of all programs; those whose code does not meet go together, so that few are compiled.
NAPPE, FIELD, IMAGE = {"NAPPE": 1, "FILTER": 1}, {"CURVED": 3, "SAMPLED": 1, "LINEAR": 1}, {"CURVED": 7, "FILTER": 2}
BOUNDED = {"LINEAR": 1, "BOUNDED": 1}
FLAT = {"QUADRATIC": 0, "CURVED": 4}
SLOPED = Plane(distance=250.0, slope_x=0.7, slope_y=-0.4, motion=MOTION)
BODY = Ellipsoid(center=(0.0, 0.0, 300.0), semi_axes=(30.0, 20.0, 50.0), motion=MOTION)
ITEMS: list[tuple[Object, dict[str, int]]] = [
    (SLOPED, BOUNDED | {"QUADRATIC": 0}),
    (BODY, {}),
    (Cone(half_angle=40.0, apex=(1.0, 2.0, 250.0), motion=MOTION), NAPPE),
    (SLOPED, FIELD),
    (BODY, FIELD),
    (SLOPED, FLAT),
    (BODY, IMAGE),
    (Quadric(coefficients=(1.0, -0.5, 0.0, 0, 0, 0, 0, 0, -40.0, 0), motion=MOTION), BOUNDED),
]


def moved(item: Object) -> PlacedSurface:
    return place(item, pose_at(MOTION, 0.6, "euler"))


@pytest.mark.parametrize("real", ["double", "float"])
@pytest.mark.parametrize("size", [(65, 49), (8192, 8000)])
@pytest.mark.parametrize(("item", "features"), ITEMS, ids=lambda v: getattr(v, "shape", ""))
def test_what_follows_from_a_hit(
    session: Session, run_source: Run, item: Object, features: dict[str, int], size: tuple[int, int], real: Real
) -> None:
    camera = Camera(resolution=size, pixel_pitch=0.08 * 65 / size[0])
    surface, count = moved(item), 800
    row, column = held(RNG(8).uniform([[-0.16], [-0.12]], [[1.14], [1.1]], (2, count)) * np.array(size[::-1])[:, None])
    w, out = empty(session, 8 * count), empty(session, 88 * count)
    placed = surface_structs([item], [surface], real)
    curved = features.get("CURVED", 0)
    camera = with_distortion(camera, DISTORTED if curved & CURVED_IMAGE else None)
    lens = Lens.of(camera, CURVED if curved % CURVED_IMAGE else None)
    optics = camera_grid(camera, 0, real), lens_struct(lens, real)
    positions = (row.astype(REAL[real]), column.astype(REAL[real]))
    run_source(SOURCE, "follow", real, features, count, placed, *optics, *positions, np.int32(count), w, out)
    rays = twin.pixel_ray(camera, row, column)
    expected_w, label = twin.solve_quadric(surface, None, rays)
    hit = label > 0
    assert hit.mean() > 0.2
    found_w, found = whole(session, w, (count,), real), whole(session, out, (count, 11), real)[hit]
    # The twin rounds in another order here and there: some 100 units, and more at the limb, where slopes run away.
    unit = 1e-14 if real == "double" else FLOAT
    np.testing.assert_allclose(found_w, expected_w, rtol=100 * unit)
    slope = twin.surface_slope(surface, rays, expected_w)
    steep = np.maximum(np.abs(slope).max(axis=1), 1e-3)[hit]
    scale = steep / 1e-3
    assert np.median(scale) < 100
    pixel_row, pixel_column, valid = twin.rest_pixel(surface, camera, rays, expected_w)
    assert valid[hit].all()
    digits = 100 * unit
    wanted = {
        "slope": (slope, digits),
        "normal": (twin.surface_normal(surface, rays, expected_w), digits),
        "gradient": (twin.blur_gradient(camera, lens, slope, rays, expected_w), digits),
        "radius": (twin.blur_radius(lens, rays, expected_w)[:, None], 100 * unit),
        "pixel at rest": (np.stack([pixel_column, pixel_row], axis=1), 100 * unit),
    }
    at = 0
    for name, (expected, digits) in wanted.items():
        part = found[:, at : at + expected.shape[1]]
        at += expected.shape[1]
        limit = (digits + 100 * unit * scale**2)[:, None] * max(1.0, float(np.abs(expected[hit]).max()))
        error = np.abs(part - expected[hit])
        assert (error <= limit).all(), f"{name}: {error.max():.3g}"


@pytest.mark.parametrize("real", ["double", "float"])
@pytest.mark.parametrize("name", ["nearest", "bilinear", "bicubic"])
def test_texture_filters(session: Session, run_source: Run, name: twin.Filter, real: Real) -> None:
    rng = RNG(9)
    texture = rng.random((13, 17), np.float32)
    row, column = held(rng.uniform([[-30], [-30]], [[45], [50]], (2, 3000)))
    row[:40], column[:40] = rng.integers(-20, 30, (2, 40))  # exactly on texels
    row[40:44], column[40:44] = [2e6, -3e7, np.nan, 3.0], [1.0, 2.0, 3.0, np.inf]  # nowhere: taken as 0
    out = empty(session, 4 * row.size)
    features = {"nearest": {}, "bilinear": NAPPE, "bicubic": IMAGE}[name]
    grid = camera_grid(Camera(resolution=(17, 13)), 0, real)
    with np.errstate(invalid="ignore"):
        rows_columns = row.astype(REAL[real]), column.astype(REAL[real])
    run_source(SOURCE, "sample", real, features, row.size, grid, texture, *rows_columns, np.int32(row.size), out)
    found = download(session, out, row.shape, np.float32)
    row, column = (np.where(np.abs(v) < 1e6, v, 0).astype(float) for v in (row, column))
    expected = twin.sample_texture(texture.astype(float), row, column, name)
    assert np.ptp(expected) > 0.9
    # Weights, 16 products and their sum in float32; weights of one axis are at most 1.3 in sum of absolute values.
    np.testing.assert_allclose(found, expected, rtol=0, atol=20 * 1.3**2 * FLOAT)
    whole = slice(0, 40)
    assert (found[whole] == expected[whole]).all()


PSFS = [Psf(), Psf(edge="area"), Psf(edge="sampled"), Psf(model="gaussian", edge="sampled")]


@pytest.mark.parametrize("real", ["double", "float"])
@pytest.mark.parametrize("psf", PSFS, ids=lambda psf: f"{psf.model}-{psf.edge}")
def test_table_coordinate_tilt_mirror_and_difference_agree_with_the_twin(
    session: Session, run_source: Run, psf: Psf, real: Real
) -> None:
    rng = RNG(10)
    radius = np.concatenate([rng.uniform(-9, 9, 3000), rng.choice([-1, 1], 900) * np.exp(rng.uniform(-20, 3, 900))])
    ring = np.sqrt(np.arange(1, 34))
    # A ring exactly, where that can be distinguished, and to both sides of it by what R^2 may be off.
    step = (1 if real == "double" else 8) * UNIT[real] * ring
    radius = np.concatenate([radius, np.arange(1.0, 6.0), ring - step, ring + step, [0.0]])
    count = radius.size
    b, c = rng.uniform(-2, 2, (2, count))
    b[:3], c[:3] = [1e30, -1e12, 0.0], [3.0, 1e9, -0.0]  # a limb
    d = np.ones(count)
    d[3:] = (radius * b / np.where(c == 0, 1, c) * (1 + 1e-9 * rng.standard_normal(count)))[3:]  # nearly a b = c d
    if real == "float":
        radius, b, c, d = (held(v) for v in (radius, b, c, d))
    main, sub = psf_table(point_spread(psf), 0.2, 8.0), psf_table(point_spread(psf), 0.2, 8.0, 2)
    sizes = (8, 4, 4, 8, 8, 8, 4)
    out = [empty(session, size * count) for size in sizes]
    struct = psf_struct(point_spread(psf), main, sub, real)
    features = FIELD if psf.edge == "sampled" else {}
    numbers = (v.astype(REAL[real]) for v in (radius, b, c, d))
    run_source(SOURCE, "small", real, features, count, struct, *numbers, np.int32(count), *out)
    difference, spread = (whole(session, out[k], (count,), real) for k in (0, 5))
    coordinate, sub_coordinate, tilt, pixel, mirrored = (
        download(session, buffer, shape, dtype)
        for buffer, shape, dtype in zip(
            [*out[1:5], out[6]],
            [(count,), (count,), (count, 2), (count, 2), (count,)],
            [np.float32, np.float32, np.float32, np.float32, np.int32],
            strict=True,
        )
    )
    for found, table, subpixel in ((coordinate, main, False), (sub_coordinate, sub, True)):
        expected = table_coordinate(point_spread(psf), radius, subpixel, table.low, table.end - table.low)
        if psf.edge == "sampled" and not subpixel:
            np.testing.assert_array_equal(np.floor(found), np.floor(expected))  # else the tables are continuous
        # u of some 300 is formed by another order of operations: the rounding to float32 may fall on the other side.
        apart = np.abs(found - expected)
        if real == "double":
            np.testing.assert_array_less(apart, np.spacing(expected) * 1.01)
            assert (apart > 0).mean() < 1e-3
        else:  # of some 300 steps per octave
            np.testing.assert_array_less(apart, 8 * np.spacing(np.maximum(expected, 64)))
        assert found.min() >= table.low
        assert found.max() < table.end
    with np.errstate(over="ignore"):
        slope = twin.tilt_slope(np.stack([b, c], axis=1), radius)
    np.testing.assert_allclose(tilt, slope, rtol=4 * FLOAT)  # two conversions, a quotient and a product
    assert np.abs(tilt).max() == 1e6
    with np.errstate(over="ignore"):
        slope, radii = twin.pixel_tilt(np.stack([b, c], axis=1), radius)
    # Below 1/2 px differences of corners, of some 1 px, over their mean.
    np.testing.assert_allclose(pixel, slope, rtol=4 * FLOAT, atol=4 * FLOAT)
    np.testing.assert_allclose(spread, radii, rtol=4 * UNIT[real])
    assert (np.abs(spread) > np.abs(radius)).sum() > 100
    assert (mirrored == twin.mirror_index(np.arange(count) - 50, 7)).all()
    usual = slice(3, None)
    exact = twin.difference_of_products(radius, b, c, d)
    assert (np.abs(difference - exact) <= 4 * UNIT[real] * np.abs(exact))[usual].all()  # 1.5 units each
    assert (np.abs(exact) < (1e-8 if real == "double" else 1e-6) * np.abs(radius * b))[usual].mean() > 0.9


@pytest.mark.parametrize("real", ["double", "float"])
def test_angles_and_their_cosines_and_sines(session: Session, run_source: Run, real: Real) -> None:
    rng = np.random.default_rng(6)
    angle = np.concatenate(
        [rng.uniform(-np.pi, np.pi, 500), np.arctan(np.arange(-32, 33) / 32), [0.0, 1e-9, np.pi / 2]]
    )
    size = np.exp(rng.uniform(-6, 6, angle.size))
    y, x = (held(size * part) for part in (np.sin(angle), np.cos(angle)))
    y, x = np.append(y, [0.0, 0.0, 3.0, -3.0, -0.0]), np.append(x, [0.0, -2.0, 0.0, 0.0, 5.0])
    out = empty(session, 8 * 3 * y.size)
    given = (values.astype(REAL[real]) for values in (y, x))
    run_source(SOURCE, "angles", real, {}, y.size, *given, np.int32(y.size), out)
    found = whole(session, out, (y.size, 3), real)
    exact, limit = np.arctan2(y, x), 4e-15 if real == "double" else 1.6e-6
    assert np.abs(found[:, 0] - exact).max() < limit
    assert np.abs(found[:, 1] - np.cos(exact)).max() < limit
    assert np.abs(found[:, 2] - np.sin(exact)).max() < limit


# Roots of a quadric that count: within bounds, as near to them as arithmetic can tell, and of one root.

BOX = ((4.0, 30.0), (-30.0, 30.0), (-40.0, 22.0))


def rays_to(count: int, width: float) -> Array:
    """Rays (count, 3) that both precisions hold exactly."""
    slopes = RNG(21).uniform(-width, width, (count, 2))
    return held(np.concatenate([slopes, np.ones((count, 1))], axis=1))


def solved(
    session: Session, run_source: Run, items: list[Object], rays: Array, real: Real, only: int = 0, quadratic: int = 1
) -> tuple[Array, Array]:
    """Inverse depths and labels (count,) of a surface for each ray, or of one for all."""
    count = len(rays)
    w, label = empty(session, 8 * count), empty(session, count)
    placed = surface_structs(items, [moved(item) for item in items], real)
    numbers = np.int32(len(items) == 1), np.int32(only), rays.T.ravel().astype(REAL[real]), np.int32(count)
    run_source(SOURCE, "roots", real, BOUNDED | {"QUADRATIC": quadratic}, count, placed, *numbers, w, label)
    return whole(session, w, (count,), real), download(session, label, (count,), np.uint8)


SOLIDS: list[Object] = [
    BODY.model_copy(update={"bounds": BOX}),
    # The same with the other sign: the root with +sqrt is the farther one.
    Quadric(
        coefficients=(-1.0, -1.5, -0.5, 0.3, 0.1, 0.2, 0, 0, 0, 900.0), center=(0, 0, 300), motion=MOTION, bounds=BOX
    ),
]


@pytest.mark.parametrize("real", ["double", "float"])
@pytest.mark.parametrize("item", SOLIDS, ids=lambda item: str(item.shape))
def test_one_sheet_or_both_within_bounds(session: Session, run_source: Run, item: Object, real: Real) -> None:
    rays, surface = rays_to(4000, 0.1), moved(item)
    assert (surface.constant < 0) == isinstance(item, Quadric)
    found_labels = []
    for only in range(3):
        w, label = solved(session, run_source, [item], rays, real, only)
        expected_w, expected = twin.solve_quadric(surface, item.bounds, rays, only)
        np.testing.assert_array_equal(label, expected)
        np.testing.assert_allclose(w, expected_w, rtol=1e-9 if real == "double" else 1e-6, atol=0)
        found_labels.append(label)
    both, plus, minus = found_labels
    # Each is seen alone, and the farther one through the part of the nearer one that the bounds take away.
    for one, other, alone in ((plus, minus, 1), (minus, plus, 2)):
        assert set(np.unique(one)) == {0, alone}
        assert ((one > 0) & (other == 0)).sum() > 50
        assert ((one > 0) & (both == alone)).sum() > 50


@pytest.mark.parametrize("real", ["double", "float"])
@pytest.mark.parametrize("axis", range(3))
def test_bounds_close_to_the_surface(session: Session, run_source: Run, axis: int, real: Real) -> None:
    """Each ray has a surface of its own, with a bound just before or behind where the ray meets it."""
    item = Cylinder(center=(3.0, -5.0, 310.0), radius=40.0, motion=MOTION)
    rays, surface = rays_to(240, 0.08), moved(item)
    w, label = twin.solve_quadric(surface, None, rays)
    assert label.all()
    along = surface.body_offset[axis] * w, twin.turned(surface.body_turn, rays)[:, axis]
    position, step = sum(along) / w, (1e-10 if real == "double" else 4e-6) * sum(np.abs(part) for part in along) / w
    items: list[Object] = []
    for i in range(len(rays)):
        within, low = i % 2, i // 2 % 2
        bound = position[i] + step[i] * (1 if bool(within) != bool(low) else -1)
        box = [(-1e4, 1e4)] * 3
        box[axis] = (bound, 1e4) if low else (-1e4, bound)
        items.append(item.model_copy(update={"bounds": tuple(box)}))
    # The near root is the one that is cut.
    _, near = solved(session, run_source, items, rays, real, only=int(label[0]))
    assert (label == label[0]).all()
    np.testing.assert_array_equal(near > 0, np.arange(len(rays)) % 2 == 1)


@pytest.mark.parametrize("real", ["double", "float"])
@pytest.mark.parametrize("quadratic", [0, 1])
def test_bounds_that_touch_the_surface_take_nothing_away(
    session: Session, run_source: Run, real: Real, quadratic: int
) -> None:
    """A plane lies at depth 0 of its own frame: a box that begins there holds all of it."""
    item = Plane(distance=250.0, motion=MOTION, bounds=((-1e4, 1e4), (-1e4, 1e4), (0.0, 1e4)))
    rays = rays_to(2000, 0.3)
    _, label = solved(session, run_source, [item], rays, real, quadratic=quadratic)
    assert label.all()
