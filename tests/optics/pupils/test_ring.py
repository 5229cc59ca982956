"""Weights of a ring: light, moments, and the limit of a small obstruction."""

from __future__ import annotations

import numpy as np
import pytest

from clsco.optics.point_spread import point_spread
from clsco.optics.psf_tables import psf_table
from clsco.scene.model import Aperture, Psf
from tests.optics.test_point_spread import Array


def grid(half: int) -> tuple[Array, Array]:
    span = np.arange(-half, half + 1.0)
    return span[None, :], span[:, None]


@pytest.mark.parametrize("edge", ["integrated", "area"])
@pytest.mark.parametrize("obstruction", [0.1, 0.5, 0.95])
def test_light_and_moments_are_those_of_two_discs(obstruction: float, edge: str) -> None:
    """The second moment per axis is R^2 (1 + q^2) / 4, that of the larger disc less the smaller one's."""
    psf = point_spread(Psf.model_validate({"edge": edge}), Aperture(shape="ring", obstruction=obstruction))
    for radius in (0.0, 1e-6, 0.4, 3.3, -14.4):
        (x, y), size = grid(int(abs(radius)) + 2), np.asarray(radius)
        found = psf.weights(x, y, size)
        assert found.min() >= 0.0
        assert found.sum() == pytest.approx(1.0, abs=1e-12)
        assert psf.subpixel_weights(x - 0.375, y + 0.125, size).sum() == pytest.approx(1.0, abs=1e-9)
    moment = (found * x * x).sum()
    assert psf.second_moment(14.4) == pytest.approx(14.4**2 * (1 + obstruction**2) / 4, rel=1e-2)
    assert moment == pytest.approx(psf.second_moment(14.4), rel=1e-4 if edge == "integrated" else 1e-2)


def test_the_middle_is_dark_and_all_taps_between_the_rims_are_alike() -> None:
    psf = point_spread(Psf(), Aperture(shape="ring", obstruction=0.5))
    x, y = grid(21)
    found, distance = psf.weights(x, y, np.asarray(20.0)), np.hypot(x, y)
    assert not found[distance < 10.0 - 1.5].any()
    between = found[(distance > 10.0 + 1.5) & (distance < 20.0 - 1.5)]
    np.testing.assert_allclose(between, 1.0 / (np.pi * (20.0**2 - 10.0**2)), rtol=1e-12)


def test_tables_hold_the_weights_and_runs_of_equal_ones() -> None:
    psf = point_spread(Psf(), Aperture(shape="ring", obstruction=0.5))
    table, disc = psf_table(psf, 5.0, 6.0), psf_table(point_spread(Psf()), 5.0, 6.0)
    assert table.intervals.tolist() == disc.intervals.tolist()
    assert np.abs(table.coefficients - disc.coefficients).max() > 1e-3
    number = table.low - table.first
    assert (table.outlines[number, 0, 0] > 0) == (table.outlines[number, 0, 0] < disc.outlines[number, 0, 0])
