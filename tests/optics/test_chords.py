"""Weights of round lenses that rims cut, against brute force over the lens."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from clsco.optics.chords import chord_weights, open_share
from tests.optics.grids import Array

Rims = list[tuple[float, float, float]]
WAY = 1.0 - 16.0 / 250.0
OPENINGS: dict[str, Rims] = {
    "clears": [(0.0, 0.0, 0.95 / WAY)],
    "stops down": [(0.0, 0.0, 0.8 / WAY)],
    "cat-eye": [(0.5, 0.3, 0.8 / WAY)],
    "both sides": [(0.8, 0.3, 1.1), (-0.3, -0.1, 0.9)],
    "pinhole": [(0.0, 0.0, 0.001 / WAY)],
}


def scaled(rims: Rims, radius: float) -> list[tuple[Array, Array, Array]]:
    return [(np.asarray(x * radius), np.asarray(y * radius), np.asarray(size * radius)) for x, y, size in rims]


def light(name: str, radius: float, right: float = 0.0, down: float = 0.0, point: bool = False) -> float:
    """Sum of the weights of an opening, for a source off the middle of its pixel."""
    x, rims = np.arange(-np.ceil(radius + 1.0), np.ceil(radius + 1.0) + 1.0), scaled(OPENINGS[name], radius)
    return float(chord_weights(x - right, x[:, None] - down, np.asarray(radius), rims=rims, point=point).sum())


def brute(radius: float, rims: Rims, count: int = 900) -> tuple[Array, Array]:
    """Offsets, and weights of all pixels by points of the lens, each with the tent of both pixels."""
    at = (np.arange(count) + 0.5) / count * 2.0 - 1.0
    x, y = np.meshgrid(at, at)
    passes = x * x + y * y <= 1.0
    for right, down, size in rims:
        passes &= (x - right) ** 2 + (y - down) ** 2 <= size * size
    far = np.arange(-np.ceil(radius + 1.0), np.ceil(radius + 1.0) + 1.0)
    tent = np.maximum(1.0 - np.abs(radius * at - far[:, None]), 0.0)
    return far, tent @ passes.astype(np.float64) @ tent.T / (np.pi / 4.0 * count * count)


@pytest.mark.parametrize("name", OPENINGS)
@pytest.mark.parametrize("radius", [0.1, 1.0, 3.1, 3.3, 8.0])
def test_against_brute_force(name: str, radius: float) -> None:
    x, exact = brute(radius, OPENINGS[name])
    weights = chord_weights(x, x[:, None], np.asarray(radius), rims=scaled(OPENINGS[name], radius))
    assert np.abs(weights - exact).sum() < 9e-4


@pytest.mark.parametrize("name", OPENINGS)
def test_light_is_the_area_of_the_opening_at_any_radius(name: str) -> None:
    """Weights of pixels, and of points in them."""
    area = float(open_share(scaled(OPENINGS[name], 1.0)))
    assert area == pytest.approx(float(brute(1.0, OPENINGS[name], 2000)[1].sum()), abs=3e-4)
    for radius in (0.1, 0.5, 1.0, 2.0, 3.1, 3.2, 3.5, 5.0, 9.0, 30.0):
        assert light(name, radius) == pytest.approx(area, abs=5e-4)
    offsets = product((-0.375, -0.125, 0.125, 0.375), (-0.125, 0.375))
    points = [light(name, 2.0, right, down, point=True) for right, down in offsets]
    assert points == pytest.approx([area] * len(points), abs=2e-3)
    assert np.mean(points) == pytest.approx(area, abs=5e-4)


def test_rims_apart_let_nothing_through() -> None:
    x, rims = np.arange(-5.0, 6.0), scaled([(1.5, 0.0, 0.4)], 3.0)
    assert not chord_weights(x, x[:, None], np.asarray(3.0), rims=rims).any()
    assert float(open_share(scaled([(1.5, 0.0, 0.4)], 1.0))) == 0.0
