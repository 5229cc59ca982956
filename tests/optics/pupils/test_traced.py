"""Spots of lenses with aberrations by rays: the closed disc, moments, directions and light."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from clsco.optics.pupils.circle import Circle
from clsco.optics.pupils.polygon import Polygon
from clsco.optics.pupils.traced import Traced
from clsco.optics.pupils.wavefront import Wavefront
from tests.slow import mostly_slow

Array = np.ndarray[Any, Any]
SPAN = np.arange(-24, 25.0)
PIXELS = 1.0 / 6.0  # px^2 that a square source in a square pixel adds along an axis, to a spot of several px


def weights_of(wavefront: Wavefront, radius: float, offset: tuple[float, float] | None = None) -> Array:
    dx, dy = offset or (0.0, 0.0)
    lens = Traced(Circle(), wavefront=wavefront)
    return lens.rows(np.array([radius]), SPAN - dx, SPAN - dy, offset is None)[0]


def moments(weights: Array) -> tuple[float, float, float, float]:
    """Means of x and y, and variances."""
    across, down = weights.sum(axis=0), weights.sum(axis=1)
    x, y = float(across @ SPAN), float(down @ SPAN)
    return x, y, float(across @ (SPAN - x) ** 2), float(down @ (SPAN - y) ** 2)


# 224 rays per radius of the largest, as its cells are as coarse; 320 would have 6e-5, and take twice as long.
@pytest.mark.parametrize(("radius", "most"), [(0.6, 6e-5), (2.5, 1.5e-4), (10.0, 1e-4), (20.0, 1.5e-4)])
def test_field_curvature_is_the_disc_of_another_radius(radius: float, most: float) -> None:
    """Half of R by 2 grad (R / 8 |l|^2)."""
    found = weights_of(Wavefront(bend=(0.125 * radius, 0.0, 0.125 * radius)), 0.5 * radius)
    exact = Circle().share(SPAN, SPAN[:, None], np.array(radius), tent=True)
    assert np.abs(found - exact).sum() < most


@pytest.mark.parametrize("offset", [(0.125, -0.375), (1.0 / 3.0, 0.0)])
@pytest.mark.parametrize("radius", [0.6, 2.5, 10.0])
def test_points_in_a_pixel(radius: float, offset: tuple[float, float]) -> None:
    found = weights_of(Wavefront(bend=(0.125 * radius, 0.0, 0.125 * radius)), 0.5 * radius, offset)
    exact = Circle().share(SPAN - offset[0], SPAN[:, None] - offset[1], np.array(radius), tent=False)
    assert np.abs(found - exact).sum() < 1.5e-3


@pytest.mark.parametrize("radius", [0.0, -8.0])
def test_moments_of_coma(radius: float) -> None:
    """Rays c (2 (3 x^2 + y^2), 4 x y) from R l: mean 2 c, variances 2 c^2 and 2/3 c^2 beside those of the disc."""
    for coma, turned in (((2.0, 0.0), False), ((0.0, -2.0), True)):
        found = moments(weights_of(Wavefront(coma=coma), radius))
        x, y, across, down = (found[1], found[0], found[3], found[2]) if turned else found
        size = sum(coma)
        assert (x, y) == pytest.approx((2.0 * size, 0.0), abs=3e-4)
        disc = 0.25 * radius**2 + PIXELS
        assert across == pytest.approx(disc + 2.0 * size**2, rel=1.5e-3)
        assert down == pytest.approx(disc + 2.0 / 3.0 * size**2, rel=1.5e-3)


@pytest.mark.parametrize("radius", [-7.0, 5.0])
def test_moments_of_astigmatism_and_spherical_aberration(radius: float) -> None:
    """R + 4 W222 across; and 8 s |l|^2 l of variance 8 s^2, 2 / 3 R * 4 s with R."""
    _, _, across, down = moments(weights_of(Wavefront(bend=(0.5, 0.0, 0.0)), radius))
    assert across == pytest.approx(0.25 * (radius + 2.0) ** 2 + PIXELS, rel=1.5e-3)
    assert down == pytest.approx(0.25 * radius**2 + PIXELS, rel=1.5e-3)
    _, _, across, down = moments(weights_of(Wavefront(spherical=0.5), radius))
    expected = 0.25 * radius**2 + 8.0 * radius * 0.5 / 3.0 + 8.0 * 0.25 + PIXELS
    assert (across, down) == pytest.approx((expected, expected), rel=1.5e-3)


@pytest.mark.parametrize(
    ("radius", "square", "point"),
    mostly_slow([(-2.3, 1.6e-3, 1.22e-2), (1.3, 4.8e-4, 1.35e-3)], [(1.3, 4.8e-4, 1.35e-3)]),
)
def test_many_single_rays(radius: float, square: float, point: float) -> None:
    """Spherical aberration, coma and astigmatism, of square sources and of points in their pixels."""
    wavefront = Wavefront(spherical=0.5, coma=(0.7, 0.4), bend=(0.3, 0.2, -0.2))
    y, x = np.mgrid[-1 + 1 / 1600 : 1 : 1 / 800, -1 + 1 / 1600 : 1 : 1 / 800]
    x, y = x[x * x + y * y < 1.0], y[x * x + y * y < 1.0]
    step = 1e-4
    at_x = radius * x + (wavefront.path(x + step, y) - wavefront.path(x - step, y)) / step
    at_y = radius * y + (wavefront.path(x, y + step) - wavefront.path(x, y - step)) / step
    edges, offset = np.arange(-24.5, 25.0), (0.125, -0.375)
    points = np.histogram2d(at_y + offset[1], at_x + offset[0], bins=(edges, edges))[0] / len(x)
    assert np.abs(weights_of(wavefront, radius, offset) - points).sum() < point
    column, row = np.floor(at_x), np.floor(at_y)
    squares = np.zeros((49, 49))
    for i, down_part in ((0, 1.0 - at_y + row), (1, at_y - row)):
        for k, right_part in ((0, 1.0 - at_x + column), (1, at_x - column)):
            squares += np.histogram2d(row + i, column + k, bins=(edges, edges), weights=down_part * right_part)[0]
    assert np.abs(weights_of(wavefront, radius) - squares / len(x)).sum() < square


def test_a_blade_aperture_turns_over() -> None:
    lens = Traced(Polygon(5), wavefront=Wavefront())
    behind, before = lens.rows(np.array([6.0, -6.0]), SPAN, SPAN, tent=True)
    exact = lens.opening.rows(np.array([6.0]), SPAN, SPAN, tent=True)[0]
    assert np.abs(behind - exact).sum() < 3e-4
    assert np.abs(before - behind[::-1, ::-1]).max() < 2e-5


@pytest.mark.parametrize("tent", [True, False])
def test_all_light_arrives(tent: bool) -> None:
    lens = Traced(Circle(), wavefront=Wavefront(((3, 3, 0.3), (4, 0, -0.2)), coma=(0.4, 0.3)))
    for radii in (np.array([-4.0, -0.01, 0.0]), np.array([2.0, 9.3])):
        off = 0.0 if tent else 0.25
        found = lens.rows(radii, SPAN - off, SPAN + off, tent)
        assert found.sum(axis=(1, 2)) == pytest.approx(1.0, abs=2e-3 if not tent else 1e-6)
        assert found.min() > -1e-5  # of cubics between nodes, of rays bent so far 1/4 px apart; at 1/8 px -2e-7


def test_single_weights_are_those_of_rows() -> None:
    lens = Traced(Circle(), wavefront=Wavefront(coma=(0.5, 0.2)))
    rows = lens.rows(np.array([1.3]), SPAN, SPAN, tent=True)[0]
    assert lens.share(SPAN, SPAN[:, None], np.array(1.3), tent=True) == pytest.approx(rows, abs=1e-15)
