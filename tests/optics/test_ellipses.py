"""Weights of ellipses against their integral."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from clsco.optics.chords import chord_weights
from clsco.optics.ellipses import across_of
from clsco.optics.pupils.circle import Circle

X = np.arange(-30.0, 31.0)


def turned(ratio: float, angle: float) -> NDArray[np.float64]:
    """Shape of an ellipse of the area of a unit disc, whose axes are `ratio` to 1."""
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    form = turn @ np.diag([1.0 / ratio, ratio]) @ turn.T
    return np.array([form[0, 0], form[0, 1], form[1, 1]])


# Chords crowd to both ends of a column, as those of small lenses begin and end in one, where large ones have one end.
@pytest.mark.parametrize(("radius", "limit"), [(2.0, 1.3e-3), (4.0, 1.5e-3), (10.0, 1.1e-3), (20.0, 9.5e-4)])
def test_a_disc_has_the_weights_of_the_circle(radius: float, limit: float) -> None:
    size: Any = np.asarray(radius)
    weights = chord_weights(X, X[:, None], size)
    assert np.abs(weights - Circle().share(X, X[:, None], size, tent=True)).sum() < limit


@pytest.mark.parametrize(("radius", "limit"), [(0.05, 3e-5), (0.5, 1e-4), (1.3, 6e-4), (6.0, 5e-4)])
def test_against_the_integral(radius: float, limit: float) -> None:
    """Points of the ellipse, each with the tent of both pixels, at any radius."""
    shape, step = turned(1.25, 0.4), max(radius / 600.0, 2e-4)
    at = (np.arange(1600) + 0.5 - 800) * step
    inside = shape[0] * at * at + 2.0 * shape[1] * at * at[:, None] + shape[2] * (at * at)[:, None] <= radius * radius
    offset = np.arange(-9.0, 10.0)
    tent = np.maximum(0.0, 1.0 - np.abs(at - offset[:, None]))
    exact = tent @ inside @ tent.T / inside.sum()
    weights = chord_weights(offset, offset[:, None], np.asarray(radius), shape)
    assert np.abs(weights - exact).sum() < limit


@pytest.mark.parametrize(("radius", "limit"), [(0.3, 1.2e-2), (1.3, 4.5e-3), (6.0, 1.3e-3)])
def test_points_against_the_integral(radius: float, limit: float) -> None:
    """Points of the ellipse, each in the pixel that it is in, off the source that is not in the middle of its own."""
    shape = turned(1.25, 0.4)
    at = (np.arange(2000) + 0.5 - 1000) * (0.0005 if radius < 1.0 else 0.0025 if radius < 2.0 else 0.01)
    inside = shape[0] * at * at + 2.0 * shape[1] * at * at[:, None] + shape[2] * (at * at)[:, None] <= radius * radius
    offset = np.arange(-9.0, 10.0) + 0.3
    box = np.abs(at - offset[:, None]) < 0.5
    exact = box @ inside.astype(np.float64) @ box.T / inside.sum()
    weights = chord_weights(offset, offset[:, None], np.asarray(radius), shape, point=True)
    assert np.abs(weights - exact).sum() < limit
    assert weights.sum() == pytest.approx(1.0, abs=3e-5)


def test_the_way_to_the_disc_is_the_root_of_the_form() -> None:
    xx, xy, yy = across_of(turned(1.7, 0.6)).tolist()
    root = np.array([[xx, xy], [xy, yy]])
    form = turned(1.7, 0.6)
    np.testing.assert_allclose(root @ root, [[form[0], form[1]], [form[1], form[2]]], rtol=1e-12)
