"""Means of textures over footprints, against many samples of the filtered image."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from clsco.optics.point_spread import point_spread
from clsco.optics.texture_mapping import texture_map
from clsco.reference.common.geometry import Filter, sample_texture
from clsco.reference.trace.footprint import footprint_of, mean_texture, taps_of
from clsco.reference.trace.mapping import Mapped, MappedTexture, Texel, is_bent, mapped_texture, texel_at, texel_change
from clsco.scene.model import Psf
from tests.scenes import scene_from

SIDE, SAMPLES = 40, 120
COUNT = 8
IMAGE = np.random.default_rng(3).random((SIDE, SIDE, 1)).astype(np.float32)
FILTERS: tuple[Filter, ...] = ("nearest", "bilinear", "bicubic")
ALONG = (((1.8, 0.0), (0.0, 1.3)), ((0.0, 1.7), (-2.3, 0.0)), ((0.3, 0.0), (0.0, 0.2)), ((12.5, 0.0), (0.0, 1.1)))
ASKEW = (((1.3, 1.3), (-1.3, 1.3)), ((1.8, 0.3), (0.2, 1.6)), ((1.5, 0.0), (0.9, 1.5)), ((0.7, -0.2), (0.1, 0.6)))


def texture_of(texture_filter: Filter) -> MappedTexture:
    """IMAGE on a card, with its finest level alone."""
    card: dict[str, Any] = {"shape": "rectangle", "center": [0, 0, 250], "size": [20, 20], "texture_mapping": "surface"}
    placed = texture_map(scene_from({}, card).objects[0], SIDE, SIDE)
    found = mapped_texture([IMAGE], placed, point_spread(Psf()), texture_filter)
    return replace(found, levels=found.levels[:1])


def means(texture_filter: Filter, sides: Any) -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]:
    """The mean over a footprint at some places, and that of many samples."""
    places = np.random.default_rng(4).uniform(12.0, 28.0, (COUNT, 2))
    (right, down), none = sides, np.zeros(COUNT)
    changes = tuple((np.full(COUNT, side[0]), np.full(COUNT, side[1])) for side in (right, down))
    nothing = Mapped(*(np.zeros((COUNT, 3)) for _ in range(3)))
    texel = Texel(places[:, 0], places[:, 1], none.astype(np.intp))
    texture = texture_of(texture_filter)
    footprint = footprint_of(texture, (changes[0], changes[1]), none > 0)
    b, a = np.meshgrid(*2 * ((np.arange(SAMPLES) + 0.5) / SAMPLES - 0.5,), indexing="ij")
    x, y = (a * right[k] + b * down[k] + places[:, k, None, None] - 0.5 for k in range(2))
    expected = sample_texture(IMAGE.astype(float), y, x, texture_filter).mean(axis=(1, 2))
    return mean_texture(texture, nothing, texel, footprint), expected


@pytest.mark.parametrize("texture_filter", FILTERS)
@pytest.mark.parametrize("sides", ALONG)
def test_means_along_columns_and_rows_are_exact(texture_filter: Filter, sides: Any) -> None:
    """But for the samples, whose rows and columns are counted whole at edges."""
    found, expected = means(texture_filter, sides)
    np.testing.assert_allclose(found, expected, rtol=0, atol=0.02 if texture_filter == "nearest" else 2e-4)


@pytest.mark.parametrize("texture_filter", FILTERS)
@pytest.mark.parametrize("sides", ASKEW)
def test_means_askew(texture_filter: Filter, sides: Any) -> None:
    """Noise is the hardest image there is: 0.29 of white RMS."""
    found, expected = means(texture_filter, sides)
    assert (
        np.sqrt(np.mean((found - expected) ** 2))
        < {"nearest": 0.03, "bilinear": 0.004, "bicubic": 0.008}[texture_filter]
    )


def test_means_near_the_apex_of_a_cone() -> None:
    """Bent footprints: 8 px from the apex, 2 texels a px."""
    cone: dict[str, Any] = {"shape": "cone", "apex": [0, 0, 250], "half_angle": 50, "texture_mapping": "surface"}
    placed = texture_map(scene_from({}, cone | {"texture_size": 20}).objects[0], SIDE, SIDE)
    texture = mapped_texture([IMAGE], placed, point_spread(Psf()), "bicubic")
    angle, px = np.random.default_rng(6).uniform(-3, 3, 200), 1.0
    out, none = np.stack([np.cos(angle), 0 * angle, np.sin(angle)], axis=-1), np.zeros(len(angle), np.bool_)
    along = out * np.sin(np.radians(50)) + [0, -np.cos(np.radians(50)), 0]
    seen = Mapped(8 * px * along, px * along, px * np.stack([-out[:, 2], 0 * angle, out[:, 0]], axis=-1))

    def mean(seen: Mapped, bent: Any) -> np.ndarray[Any, Any]:
        changes = texel_change(placed, seen.at, seen.right), texel_change(placed, seen.at, seen.down)
        return mean_texture(texture, seen, texel_at(placed, seen.at), footprint_of(texture, changes, bent))

    assert is_bent(placed, seen).all()
    places, count = (np.arange(16) + 0.5) / 16 - 0.5, np.zeros((len(angle), 1))
    for b in places:
        for a in places:
            small = Mapped(seen.at + a * seen.right + b * seen.down, seen.right / 16, seen.down / 16)
            count += mean(small, none) / 16**2
    error = float(np.sqrt(np.mean((mean(seen, ~none) - count) ** 2)))
    assert error < 0.004  # cells at their middles: 0.009


@pytest.mark.parametrize("texture_filter", FILTERS)
def test_weights_sum_to_one_and_slopes_to_zero(texture_filter: Filter) -> None:
    middle, width = np.random.default_rng(5).uniform(0.02, 9.0, (2, 50))
    taps = taps_of(middle, width, texture_filter)
    np.testing.assert_allclose(taps.mean.sum(axis=1), 1.0, atol=1e-12)
    np.testing.assert_allclose(taps.slope.sum(axis=1), 0.0, atol=1e-10)
    places = taps.first[:, None] + np.arange(taps.mean.shape[1])
    if texture_filter != "nearest":
        np.testing.assert_allclose((taps.mean * places).sum(axis=1), middle, atol=1e-9)
        np.testing.assert_allclose((taps.slope * places).sum(axis=1), 1.0, atol=1e-9)
