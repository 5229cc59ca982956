"""geometry.clh on the device against its twin; the ray-surface solution itself: test_ray_surface.py."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from clsco.device import Session
from clsco.layout import Real, camera_struct, psf_struct, surface_structs
from clsco.motion import pose_at
from clsco.program import download, empty
from clsco.psf import psf_table
from clsco.reference import geometry as twin
from clsco.scene import Camera, Cone, Ellipsoid, Object, ObjectMotion, Plane, Psf, Quadric
from clsco.surfaces import place

Array = NDArray[Any]
Run = Callable[..., None]
RNG = np.random.default_rng
UNIT = {"double": 2.0**-53, "float": 2.0**-24}  # largest relative error of one rounding
NUMBER: dict[str, type[np.floating[Any]]] = {"double": np.float64, "float": np.float32}

SOURCE = """\
// Of the hit of the ray through (row, column): slope, normal, blur radius and its gradient, pixel at rest.
__kernel void follow(__constant surface_t *surface, const camera_t camera, __global const real *row,
                     __global const real *column, const int count, __global real *w, __global real *out)
{
    const int i = get_global_id(0);
    if (i >= count)
        return;
    const real3 ray = pixel_ray(camera, row[i], column[i]);
    uchar root;
    w[i] = solve_quadric(surface, ray, &root);
    if (!root)
        return;
    const real2 slope = surface_slope(surface, ray, w[i]), gradient = blur_gradient(camera, slope);
    const real3 normal = surface_normal(surface, ray, w[i]), pixel = rest_pixel(surface, camera, ray, w[i]);
    const real radius = blur_radius(camera, w[i]);
    const real all[11] = {slope.x, slope.y, normal.x, normal.y, normal.z, radius, gradient.x, gradient.y,
                          pixel.x, pixel.y, pixel.z};
    for (int k = 0; k < 11; ++k)
        out[11 * i + k] = all[k];
}

__kernel void sample(const camera_t camera, __global const float *texture, __global const real *row,
                     __global const real *column, const int count, __global float *out)
{
    const int i = get_global_id(0);
    if (i < count)
        out[i] = sample_texture(texture, camera, row[i], column[i]);
}

__kernel void small(const psf_t psf, __global const real *a, __global const real *b, __global const real *c,
                    __global const real *d, const int count, __global real *difference, __global float *coordinate,
                    __global float *sub_coordinate, __global float2 *tilt, __global int *mirrored)
{
    const int i = get_global_id(0);
    if (i >= count)
        return;
    difference[i] = difference_of_products(a[i], b[i], c[i], d[i]);
    coordinate[i] = table_coordinate(psf, a[i], 0);
    sub_coordinate[i] = table_coordinate(psf, a[i], 1);
    tilt[i] = tilt_slope((real2)(b[i], c[i]), a[i]);
    mirrored[i] = mirror_index(i - 50, 7);
}
"""


MOTION = ObjectMotion(velocity=(2.0, 1.0, 5.0), angular_velocity=(10.0, -15.0, 30.0))
ITEMS: list[tuple[Object, dict[str, int]]] = [
    (Plane(distance=250.0, slope_x=0.7, slope_y=-0.4, motion=MOTION), {"QUADRATIC": 0}),
    (Ellipsoid(center=(0.0, 0.0, 300.0), semi_axes=(30.0, 20.0, 50.0), motion=MOTION), {}),
    (Cone(half_angle=40.0, apex=(1.0, 2.0, 250.0), motion=MOTION), {"NAPPE": 1}),
    (Quadric(coefficients=(1.0, -0.5, 0.0, 0, 0, 0, 0, 0, -40.0, 0), motion=MOTION), {"LINEAR": 1}),
]


@pytest.mark.parametrize(("item", "features"), ITEMS, ids=lambda v: getattr(v, "shape", ""))
def test_what_follows_from_a_hit(session: Session, run_source: Run, item: Object, features: dict[str, int]) -> None:
    camera = Camera(resolution=(65, 49), pixel_pitch=0.08)
    surface = place(item, pose_at(MOTION, 0.6, "euler"))
    count = 800
    row, column = RNG(8).uniform([[-8], [-8]], [[56], [72]], (2, count))
    w, out = empty(session, 8 * count), empty(session, 88 * count)
    placed, lens = surface_structs([item], [surface], "double"), camera_struct(camera, 0, "double")
    run_source(SOURCE, "follow", "double", features, count, placed, lens, row, column, np.int32(count), w, out)
    rays = twin.pixel_ray(camera, row, column)
    expected_w, label = twin.solve_quadric(surface, None, rays)
    hit = label > 0
    assert hit.mean() > 0.2
    found_w = download(session, w, (count,), np.float64)
    found = download(session, out, (count, 11), np.float64)[hit]
    # The twin rounds in another order here and there: some 100 units, and more at the limb, where slopes run away.
    np.testing.assert_allclose(found_w, expected_w, rtol=1e-12)
    slope = twin.surface_slope(surface, rays, expected_w)
    steep = np.maximum(np.abs(slope).max(axis=1), 1e-3)[hit]
    scale = steep / 1e-3
    assert np.median(scale) < 100
    pixel_row, pixel_column, valid = twin.rest_pixel(surface, camera, rays, expected_w)
    assert valid[hit].all()
    wanted = {
        "slope": slope,
        "normal": twin.surface_normal(surface, rays, expected_w),
        "radius": twin.blur_radius(camera, expected_w)[:, None],
        "gradient": twin.blur_gradient(camera, slope),
        "pixel at rest": np.stack([pixel_column, pixel_row], axis=1),
    }
    at = 0
    for name, expected in wanted.items():
        part = found[:, at : at + expected.shape[1]]
        at += expected.shape[1]
        limit = 1e-12 * (scale**2)[:, None] * max(1.0, float(np.abs(expected[hit]).max()))
        assert (np.abs(part - expected[hit]) <= limit).all(), name


@pytest.mark.parametrize("real", ["double", "float"])
@pytest.mark.parametrize("name", ["nearest", "bilinear", "bicubic"])
def test_texture_filters(session: Session, run_source: Run, name: twin.Filter, real: Real) -> None:
    rng = RNG(9)
    texture = rng.random((13, 17), np.float32)
    row, column = rng.uniform([[-30], [-30]], [[45], [50]], (2, 3000))
    row[:40], column[:40] = rng.integers(-20, 30, (2, 40))  # exactly on texels
    row[40:44], column[40:44] = [2e6, -3e7, np.nan, 3.0], [1.0, 2.0, 3.0, np.inf]  # nowhere: taken as 0
    row, column = (v.astype(NUMBER[real]) for v in (row, column))
    out = empty(session, 4 * row.size)
    features = {"FILTER": ("nearest", "bilinear", "bicubic").index(name)}
    camera = camera_struct(Camera(resolution=(17, 13)), 0, real)
    run_source(SOURCE, "sample", real, features, row.size, camera, texture, row, column, np.int32(row.size), out)
    found = download(session, out, row.shape, np.float32)
    row, column = (np.where(np.abs(v) < 1e6, v, 0).astype(float) for v in (row, column))
    expected = twin.sample_texture(texture.astype(float), row, column, name)
    assert np.ptp(expected) > 0.9
    # Weights, 16 products and their sum in float32; weights of one axis are at most 1.3 in sum of absolute values.
    # In single precision a position of up to 50 px is itself a part of a texel only to 50 units, here given alike.
    np.testing.assert_allclose(found, expected, rtol=0, atol=20 * 1.3**2 * UNIT["float"])
    whole = slice(0, 40)
    assert (found[whole] == expected[whole]).all()


PSFS = [Psf(), Psf(edge="area"), Psf(edge="sampled"), Psf(model="gaussian", edge="sampled")]


@pytest.mark.parametrize("psf", PSFS, ids=lambda psf: f"{psf.model}-{psf.edge}")
def test_table_coordinate_tilt_mirror_and_difference_agree_with_the_twin(
    session: Session, run_source: Run, psf: Psf
) -> None:
    count, rng = 4000, RNG(10)
    radius = np.concatenate([rng.uniform(-9, 9, 3000), rng.choice([-1, 1], 900) * np.exp(rng.uniform(-20, 3, 900))])
    ring = np.sqrt(np.arange(1, 34))
    radius = np.concatenate([radius, ring, np.nextafter(ring, 0), np.nextafter(ring, 9), [0.0]])[:count]
    b, c = rng.uniform(-2, 2, (2, count))
    b[:3], c[:3] = [1e300, -1e12, 0.0], [3.0, 1e9, -0.0]  # a limb
    d = np.ones(count)
    d[3:] = (radius * b / np.where(c == 0, 1, c) * (1 + 1e-9 * rng.standard_normal(count)))[3:]  # nearly a b = c d
    main, sub = psf_table(psf, 0.2, 8.0), psf_table(psf, 0.2, 8.0, 2)
    sizes = (8, 4, 4, 8, 4)
    out = [empty(session, size * count) for size in sizes]
    struct = psf_struct(psf, main, sub, "double")
    features = {"SAMPLED": int(psf.edge == "sampled")}
    run_source(SOURCE, "small", "double", features, count, struct, radius, b, c, d, np.int32(count), *out)
    difference, coordinate, sub_coordinate, tilt, mirrored = (
        download(session, buffer, shape, dtype)
        for buffer, shape, dtype in zip(
            out,
            [(count,), (count,), (count,), (count, 2), (count,)],
            [np.float64, np.float32, np.float32, np.float32, np.int32],
            strict=True,
        )
    )
    for found, table, subpixel in ((coordinate, main, False), (sub_coordinate, sub, True)):
        expected = twin.table_coordinate(psf, radius, subpixel, table.first, len(table.intervals))
        if psf.edge == "sampled" and not subpixel:
            np.testing.assert_array_equal(np.floor(found), np.floor(expected))  # else the tables are continuous
        # u of some 300 is formed by another order of operations: the rounding to float32 may fall on the other side.
        np.testing.assert_array_less(np.abs(found - expected), np.spacing(expected) * 1.01)
        assert (found != expected).mean() < 1e-3
        assert found.min() >= table.first
        assert found.max() < table.first + len(table.intervals)
    with np.errstate(over="ignore"):
        slope = twin.tilt_slope(np.stack([b, c], axis=1), radius)
    np.testing.assert_allclose(tilt, slope, rtol=4 * UNIT["float"])  # two conversions, a quotient and a product
    assert np.abs(tilt).max() == 1e6
    assert (mirrored == twin.mirror_index(np.arange(count) - 50, 7)).all()
    usual = slice(3, None)
    exact = twin.difference_of_products(radius, b, c, d)
    np.testing.assert_allclose(difference[usual], exact[usual], rtol=4 * UNIT["double"])  # 1.5 units each
    assert (np.abs(exact) < 1e-8 * np.abs(radius * b))[usual].mean() > 0.9
