"""Weights of polygonal irises: light, moments, orientation, the limit of many blades, and areas by brute force."""

from __future__ import annotations

from math import ceil, cos, pi, tau

import numpy as np
import pytest

from clsco.optics.point_spread import PointSpread, point_spread
from clsco.optics.psf_grid import table_coordinate
from clsco.optics.psf_tables import psf_table, table_bytes
from clsco.optics.pupils.polygon import lens_mask, vertices
from clsco.scene.model import Aperture, Psf
from tests.optics.test_point_spread import Array


def iris(blades: int, rotation: float = 0.0, edge: str = "integrated") -> PointSpread:
    return point_spread(Psf.model_validate({"edge": edge}), Aperture(shape="polygon", blades=blades, rotation=rotation))


def grid(half: int) -> tuple[Array, Array]:
    span = np.arange(-half, half + 1.0)
    return span[None, :], span[:, None]


@pytest.mark.parametrize("edge", ["integrated", "area"])
@pytest.mark.parametrize("blades", [3, 5, 6, 32])
@pytest.mark.parametrize("radius", [1e-9, 1e-4, 0.3, 1.0, -7.3, 40.0])
def test_no_light_is_lost(blades: int, radius: float, edge: str) -> None:
    psf = iris(blades, 17.0, edge)
    found = psf.weights(*grid(int(abs(radius)) + 2), np.asarray(radius))
    assert found.min() >= 0.0
    assert found.sum() == pytest.approx(1.0, abs=1e-12)
    x, y = grid(int(abs(radius)) + 2)
    assert psf.subpixel_weights(x - 0.375, y + 0.125, np.asarray(radius)).sum() == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("blades", [3, 5, 6, 8])
@pytest.mark.parametrize(("edge", "pixel"), [("integrated", 1 / 6), ("area", 1 / 12)])
def test_moments_are_exact(blades: int, edge: str, pixel: float) -> None:
    """The centroid is the source; the variance per axis is R^2 (2 + cos(2 pi / n)) / 12 and that of the pixels."""
    psf, (x, y) = iris(blades, 11.0, edge), grid(16)
    found = psf.weights(x, y, np.asarray(14.4))
    expected = 14.4**2 * (2 + cos(tau / blades)) / 12
    exactly = 1e-11 if edge == "integrated" else 1e-3  # px; tents sum to the place of a source, boxes to its pixel's
    assert (found * x).sum() == pytest.approx(0.0, abs=exactly)
    assert (found * y).sum() == pytest.approx(0.0, abs=exactly)
    if edge == "integrated":
        assert (found * x * x).sum() == pytest.approx(expected + pixel, rel=1e-5)
        assert (found * y * y).sum() == pytest.approx(expected + pixel, rel=1e-5)
    else:
        assert (found * x * x).sum() == pytest.approx(expected + pixel, rel=2e-4)
    assert psf.pupil.second_moment == pytest.approx(expected / 14.4**2)


@pytest.mark.parametrize(("blades", "measured"), [(6, (43.1, 44.0)), (5, (40.9, 39.1))])
def test_variances_are_those_of_cycles(blades: int, measured: tuple[float, float]) -> None:
    """Measured in Cycles with an emitter 0.92 px wide at R = 14.4 px, 2,048 samples: to 3 %."""
    x, y = grid(16)
    found = iris(blades).weights(x, y, np.asarray(14.4))
    assert [(found * x * x).sum(), (found * y * y).sum()] == pytest.approx(measured, rel=0.03)


def test_a_pentagon_has_an_edge_to_the_right_behind_the_focus_and_turns_over_in_front_of_it() -> None:
    psf, (x, y) = iris(5), grid(22)
    behind, before = (psf.weights(x, y, np.asarray(radius)) for radius in (20.0, -20.0))
    np.testing.assert_allclose(before, behind[::-1, ::-1], rtol=0, atol=1e-15)
    right, left = (np.flatnonzero(behind.sum(axis=0) > 1e-9)[[-1, 0]] - 22).tolist()
    assert right == ceil(20 * cos(pi / 5))  # the edge, at the apothem, and half a pixel of source and of detector
    assert left == -20  # and a corner opposite
    assert np.abs(before - behind).sum() > 0.1


def test_rotation_is_counter_clockwise_as_the_image_is_seen() -> None:
    corners = vertices(5, 20.0) * [1, -1]  # up
    found = np.sort(np.degrees(np.arctan2(corners[:, 1], corners[:, 0])) % 360)
    np.testing.assert_allclose(found, [56, 128, 200, 272, 344])
    upper_right = iris(3, 90.0).weights(*grid(12), np.asarray(10.0))
    rows = np.flatnonzero(upper_right.sum(axis=1) > 1e-9) - 12
    assert (rows[0], rows[-1]) == (-5, 10)  # an edge above, a corner below


@pytest.mark.parametrize("edge", ["integrated", "area"])
def test_many_blades_become_the_disc(edge: str) -> None:
    """The polygon lacks 1 - sin(2 pi / n) n / (2 pi) of the disc, 2 pi^2 / (3 n^2): of L1 at most twice that."""
    disc, (x, y), radius = point_spread(Psf.model_validate({"edge": edge})), grid(12), np.asarray(10.0)
    off = [np.abs(iris(n, 3.0, edge).weights(x, y, radius) - disc.weights(x, y, radius)).sum() for n in (8, 16, 32)]
    assert off[2] < 2 * 2 * pi**2 / (3 * 32**2)
    assert off[0] / off[1] == pytest.approx(4.0, rel=0.15)
    assert off[1] / off[2] == pytest.approx(4.0, rel=0.15)


@pytest.mark.parametrize("tent", [True, False])
def test_weights_are_areas_by_brute_force(tent: bool) -> None:
    """Points of the polygon, each seen from points of the pixel: 1 / 400 px apart."""
    blades, turn, radius = 5, 13.0, -2.7
    step = np.arange(-1200, 1200) / 400 + 1 / 800
    u, v = np.meshgrid(step, step)
    inside = np.ones(u.shape, bool)
    for x, y, distance in lens_mask(blades, turn):
        inside &= (x * u + y * v) / radius <= distance
    u, v = u[inside], v[inside]
    psf = iris(blades, turn, "integrated" if tent else "area")
    for dx, dy in ((0, 0), (2, 1), (-2, 0), (1, -2), (-1, 2)):
        a, b = np.abs(u - dx), np.abs(v - dy)
        seen = np.maximum(1 - a, 0) * np.maximum(1 - b, 0) if tent else (a < 0.5) & (b < 0.5)
        found = psf.weights(np.asarray(float(dx)), np.asarray(float(dy)), np.asarray(radius))
        assert found == pytest.approx(seen.mean(), abs=2e-4)


@pytest.mark.parametrize("samples", [0, 2])
@pytest.mark.parametrize("edge", ["integrated", "area"])
def test_tables_hold_the_weights(samples: int, edge: str) -> None:
    """At most 1e-4 of the light is elsewhere, at any radius of either sign, and 2e-5 on the mean."""
    psf = iris(5, 8.0, edge)
    table, off = psf_table(psf, 0.0, 6.0, samples), []
    lost = table.intervals.nbytes + table.coefficients.nbytes + table.taps.nbytes + table.outlines.nbytes
    assert table_bytes(psf, 0.0, 6.0, samples) == lost
    for radius in [*np.linspace(-5.99, 5.99, 61), 0.001]:
        u = float(table_coordinate(psf, np.asarray(radius), samples > 0)) - table.first
        number = int(u) + table.count * (radius < 0)
        start, half = table.intervals[number]
        lanes, size = -(-(2 * half + 1) // 8) * 8, 2 * half + 1
        count = max(samples, 1) ** 2 * size
        block = table.coefficients[start : start + count * 4 * lanes].reshape(count, 4, lanes)[..., :size]
        found = np.tensordot((u % 1.0) ** np.arange(4), block.astype(float), axes=(0, 1)).reshape(-1, size, size)
        x, y = grid(half)
        if samples:
            offsets = [-0.25, 0.25]
            expected = [psf.subpixel_weights(x - ox, y - oy, np.asarray(radius)) for oy in offsets for ox in offsets]
        else:
            expected = [psf.weights(x, y, np.asarray(radius))]
        off.append(max(np.abs(a - b).sum() for a, b in zip(found, expected, strict=True)))
    assert max(off) < 1e-4
    assert np.mean(off) < 2e-5
