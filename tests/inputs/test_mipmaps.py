"""Levels of images for large footprints."""

from __future__ import annotations

import numpy as np
import pytest

from clsco.constants import CUBE_BORDER
from clsco.inputs.mipmaps import cube_side, level_sizes, mipmap, mipmap_floats, side_point


def test_levels_end_with_one_texel() -> None:
    assert level_sizes(5, 3) == [(5, 3), (3, 2), (2, 1), (1, 1)]
    levels = mipmap([np.zeros((3, 5, 2), np.float32)])
    assert [level.shape for level in levels] == [(1, 3, 5, 2), (1, 2, 3, 2), (1, 1, 2, 2), (1, 1, 1, 2)]
    assert sum(level.size for level in levels) == mipmap_floats(5, 3, 2, 1)


@pytest.mark.parametrize("shape", [(64, 64), (37, 50)])
def test_levels_keep_means_and_second_moments(shape: tuple[int, int]) -> None:
    """A bump well inside the image: its energy, place and width stay, so that no level is wider than the image."""
    i, j = np.indices(shape)
    image = np.exp(-(((i - 17.3) / 5) ** 2 + ((j - 30.1) / 5) ** 2)).astype(np.float32)[..., None]
    level = mipmap([image])[2][0, ..., 0].astype(float)
    scale = np.array(shape) / level.shape
    y, x = ((np.arange(n) + 0.5) * s - 0.5 for n, s in zip(level.shape, scale, strict=True))
    total = level.sum() * scale.prod()
    assert total == pytest.approx(image.sum(), rel=2e-3)
    middle = (level.sum(1) @ y / level.sum(), level.sum(0) @ x / level.sum())
    assert middle == pytest.approx((17.3, 30.1), abs=0.02)
    width = level.sum(0) @ (x - middle[1]) ** 2 / level.sum()
    assert width == pytest.approx(12.5, rel=0.02)  # a mean over 4 x 4 texels would add 1.25


def test_points_of_a_cube_come_back() -> None:
    x, y = np.meshgrid(np.linspace(-0.9, 0.9, 5), np.linspace(-0.8, 0.8, 4))
    for side in range(6):
        number, right, up = cube_side(2.5 * side_point(side, x, y))
        assert (number == side).all()
        np.testing.assert_allclose(right, x, atol=1e-15)
        np.testing.assert_allclose(up, y, atol=1e-15)


def test_borders_of_a_cube_map_are_its_neighbors() -> None:
    """Sides that show a direction: what is beyond an edge goes on as the cube does."""
    size = 16
    x, y = np.meshgrid((2 * np.arange(size) + 1) / size - 1, 1 - (2 * np.arange(size) + 1) / size)
    points = [side_point(side, x, y) for side in range(6)]
    sides = [(point / np.linalg.norm(point, axis=-1, keepdims=True)).astype(np.float32) for point in points]
    whole = mipmap(sides)[0]
    assert whole.shape == (6, size + 2 * CUBE_BORDER, size + 2 * CUBE_BORDER, 3)
    i, j = np.arange(-CUBE_BORDER, size + CUBE_BORDER), np.arange(-CUBE_BORDER, size + CUBE_BORDER)
    x, y = np.meshgrid((2 * j + 1) / size - 1, 1 - (2 * i + 1) / size)
    for side in range(6):
        expected = side_point(side, x, y)
        expected /= np.linalg.norm(expected, axis=-1, keepdims=True)
        near = (np.abs(x) <= 1) | (np.abs(y) <= 1)  # at corners three sides meet
        assert np.abs(whole[side] - expected)[near].max() < 0.02
