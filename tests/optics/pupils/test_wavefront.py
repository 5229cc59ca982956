"""Zernike polynomials and slopes of wavefronts."""

from __future__ import annotations

import numpy as np
import pytest

from clsco.optics.pupils.wavefront import Wavefront, zernike

RADIUS = np.sqrt((np.arange(256) + 0.5) / 256)[:, None]  # of rings of one area
ANGLE = np.arange(64) * (2.0 * np.pi / 64)
X, Y = RADIUS * np.cos(ANGLE), -RADIUS * np.sin(ANGLE)
TERMS = [(n, m) for n in range(2, 7) for m in range(-n, n + 1, 2)]


def test_polynomials_are_orthonormal_over_the_circle() -> None:
    values = np.array([zernike(n, m, X, Y).ravel() for n, m in TERMS])
    assert np.abs(values @ values.T / values.shape[1] - np.eye(len(TERMS))).max() < 2e-3
    assert np.abs(values.mean(axis=1)).max() < 1e-3


@pytest.mark.parametrize(
    ("term", "value"),
    [
        ((2, 0), 3.0**0.5 * (2.0 * 0.25 - 1.0)),
        ((2, 2), 6.0**0.5 * 0.25 * 0.5),
        ((2, -2), 6.0**0.5 * 0.25 * 0.75**0.5),
        ((3, 1), 8.0**0.5 * (3.0 * 0.125 - 1.0) * np.cos(np.pi / 6.0)),
        ((3, -1), 8.0**0.5 * (3.0 * 0.125 - 1.0) * 0.5),
        ((4, 0), 5.0**0.5 * (6.0 * 0.0625 - 6.0 * 0.25 + 1.0)),
    ],
)
def test_polynomials_of_the_standard(term: tuple[int, int], value: float) -> None:
    """At half of the radius, 30 deg counter-clockwise from the right."""
    angle = np.pi / 6.0
    expected = value if term[0] != 3 else value / (3.0 * 0.125 - 1.0) * (3.0 * 0.125 - 2.0 * 0.5)
    at = np.array(0.5 * np.cos(angle)), np.array(-0.5 * np.sin(angle))
    assert float(zernike(*term, *at)) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize(
    ("wavefront", "rms"),
    [(Wavefront(((3, 1, 0.3), (4, 0, 0.4))), 0.5), (Wavefront(spherical=1.0), 2.0 / (3.0 * 5.0**0.5))],
)
def test_rms(wavefront: Wavefront, rms: float) -> None:
    assert float(wavefront.path(X, Y).std()) == pytest.approx(rms, rel=1e-3)


@pytest.mark.parametrize(
    ("wavefront", "slope"),
    [
        (Wavefront(), 0.0),
        (Wavefront(spherical=-0.5), 2.0),
        (Wavefront(((2, 0, 1.0),)), 4.0 * 3.0**0.5),
        (Wavefront(((3, 1, 1.0),)), 7.0 * 8.0**0.5),
    ],
)
def test_steepest_slope(wavefront: Wavefront, slope: float) -> None:
    assert wavefront.slope == pytest.approx(slope, rel=1e-4)
    assert wavefront.is_flat == (slope == 0.0)
