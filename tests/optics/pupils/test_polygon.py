"""Weights of polygonal irises: light, moments, orientation, the limit of many blades, and areas by brute force."""

from __future__ import annotations

from math import pi

import numpy as np
import pytest

from clsco.optics.point_spread import PointSpread, point_spread
from clsco.optics.pupils.polygon import vertices
from clsco.scene.model import Aperture, Psf
from tests.optics.test_point_spread import Array


def iris(blades: int, rotation: float = 0.0, edge: str = "integrated") -> PointSpread:
    return point_spread(Psf.model_validate({"edge": edge}), Aperture(shape="polygon", blades=blades, rotation=rotation))


def grid(half: int) -> tuple[Array, Array]:
    span = np.arange(-half, half + 1.0)
    return span[None, :], span[:, None]


@pytest.mark.parametrize(("blades", "measured"), [(6, (43.1, 44.0)), (5, (40.9, 39.1))])
def test_variances_are_those_of_cycles(blades: int, measured: tuple[float, float]) -> None:
    """Measured in Cycles with an emitter 0.92 px wide at R = 14.4 px, 2,048 samples: to 3 %."""
    x, y = grid(16)
    found = iris(blades).weights(x, y, np.asarray(14.4))
    assert [(found * x * x).sum(), (found * y * y).sum()] == pytest.approx(measured, rel=0.03)


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
