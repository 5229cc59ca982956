"""Holes: their order, images at half the size and back."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

from clsco.inpainting.hole_shapes import block_turns, doubled, halved, spline_holes

Array = NDArray[Any]


def holes(shape: tuple[int, int], seed: int) -> Array:
    """Single pixels, a wide hole, and one at the corner."""
    missing = np.random.default_rng(seed).random(shape) < 0.2
    missing[: shape[0] // 2, : shape[1] // 3] = True
    missing[shape[0] // 4 :, shape[1] // 2 : -2] = True
    assert missing.any()
    assert not missing.all()
    return missing


@pytest.mark.parametrize("shape", [(40, 61), (33, 20), (8, 100), (7, 7)])
def test_blocks_have_their_turn_by_distance_and_color(shape: tuple[int, int]) -> None:
    missing = holes(shape, 1)
    turns = block_turns(missing, 2)
    padding = ((0, shape[0] % 2), (0, shape[1] % 2))
    blocks = np.pad(missing, padding, constant_values=True).reshape(turns.shape[0], 2, turns.shape[1], 2)
    wholly = blocks.all(axis=(1, 3))
    assert wholly.any()
    rings = ndimage.distance_transform_cdt(wholly, "chessboard")
    color = np.add.outer(np.arange(turns.shape[0]), np.arange(turns.shape[1])) % 2
    some = np.pad(missing, padding).reshape(blocks.shape).any(axis=(1, 3))
    assert np.array_equal(turns, np.where(some, 2 * rings + color, -1))


def test_half_the_size_is_the_mean_of_what_is_known() -> None:
    image = np.arange(15.0).reshape(3, 5, 1)
    missing = np.zeros((3, 5), bool)
    missing[0, 0] = missing[:2, 2:4] = missing[2, 4] = True
    coarse, none = halved(image, missing)
    assert np.array_equal(none, [[False, True, False], [False, False, True]])
    assert np.allclose(coarse[..., 0], [[(1 + 5 + 6) / 3, 0, 6.5], [10.5, 12.5, 0]])


@pytest.mark.parametrize("shape", [(8, 12), (7, 13)])
def test_twice_the_size_keeps_a_slope(shape: tuple[int, int]) -> None:
    row, column = np.mgrid[0 : shape[0], 0 : shape[1]]
    fine = (0.3 * row - 0.7 * column)[..., None]
    coarse, none = halved(fine, np.zeros(shape, bool))
    assert not none.any()
    found = doubled(coarse, np.ones(shape, bool)).reshape(fine.shape)
    assert np.allclose(found[1:-2, 1:-2], fine[1:-2, 1:-2])  # beyond the outermost coarse pixels it is constant


@pytest.mark.parametrize("shape", [(40, 61), (33, 20), (16, 16)])
def test_splines_of_twice_the_size_lie_in_the_holes(shape: tuple[int, int]) -> None:
    missing = holes(shape, 2)
    inside = spline_holes(missing)
    assert inside.shape == ((shape[0] + 1) // 2, (shape[1] + 1) // 2)
    assert inside.any()
    for i, j in np.ndindex(inside.shape):
        rows = slice(max(2 * i - 1, 0), 2 * i + 3)
        assert inside[i, j] == missing[rows, max(2 * j - 1, 0) : 2 * j + 3].all()
