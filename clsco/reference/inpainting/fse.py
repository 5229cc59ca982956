"""Inpainting with texture by frequency-selective extrapolation, coarse to fine.

Method and sources: clsco/inpainting/fse.py.
"""

from __future__ import annotations

import numpy as np

from clsco.constants import FSE_BEFORE, FSE_BLOCK, FSE_SIDE
from clsco.inpainting.fse_tables import FEWEST_WAVES, GUESS, MOST_WAVES, STEP, TRUST, WAVES_PER_CONTRAST, tables
from clsco.inpainting.hole_shapes import block_turns, doubled, halved
from clsco.reference.common.geometry import Array
from clsco.reference.inpainting.neighbors import Mask, Pixels


def fill_texture(image: Array, missing: Mask) -> Array:
    """Fill the holes (H, W) of an image (H, W, K) whose values are about 0 to 1; results are not clipped.

    At least one pixel must be known.
    """
    if not missing.any():
        return image
    turns = block_turns(missing, FSE_BLOCK)
    value = np.where(missing[..., None], 0.0, image)
    weight = np.where(missing, 0.0, 1.0)
    if turns.max() > 1:  # some block is wholly missing
        value[missing] = doubled(fill_texture(*halved(value, missing)), missing)
        weight[missing] = GUESS
    for turn in range(int(turns.max()) + 1):
        blocks = np.argwhere(turns == turn) * FSE_BLOCK
        value, weight = settle_blocks(extrapolate_blocks(value, weight, blocks), blocks, value, weight)
    return value


def extrapolate_blocks(value: Array, weight: Array, blocks: Pixels) -> Array:
    """Values (N, FSE_BLOCK, FSE_BLOCK, K) of blocks from the windows around them.

    value: (H, W, K), about 0 to 1; weight: (H, W), 0 for unknown pixels; blocks: (N, 2), row and column of each block's
    first pixel.
    """
    table = [t.astype(np.float64) for t in tables()[:2]]
    padding = ((FSE_BEFORE, FSE_SIDE), (FSE_BEFORE, FSE_SIDE))
    weights, values = np.pad(weight, padding), np.pad(value, (*padding, (0, 0)))
    result = np.empty((len(blocks), FSE_BLOCK, FSE_BLOCK, value.shape[2]))
    for n, (row, column) in enumerate(blocks):
        at = np.s_[row : row + FSE_SIDE, column : column + FSE_SIDE]
        result[n] = _extrapolated(values[at], weights[at] * table[0], table[1])
    return result


def settle_blocks(filled: Array, blocks: Pixels, value: Array, weight: Array) -> tuple[Array, Array]:
    """Values (H, W, K) and weights (H, W) after unknown pixels have been set to the values `filled` of blocks."""
    value, weight = value.copy(), weight.copy()
    for block, (row, column) in zip(filled, blocks, strict=True):
        at = np.s_[row : row + FSE_BLOCK, column : column + FSE_BLOCK]
        unknown = weight[at] != 1
        value[at][unknown] = block[: unknown.shape[0], : unknown.shape[1]][unknown]
        weight[at][unknown] = TRUST
    return value, weight


def _extrapolated(f: Array, w: Array, preference: Array) -> Array:
    """Extrapolated middle (FSE_BLOCK, FSE_BLOCK, K) of a window with values f (FSE_SIDE, FSE_SIDE, K).

    w: weights of the window's pixels (FSE_SIDE, FSE_SIDE).
    """
    total = w.sum()
    mean, square = ((w[..., None] * f**power).sum(axis=(0, 1)) / total for power in (1, 2))
    deviation = np.sqrt(max((square - mean**2).max(), 0.0))
    waves = min(max(int(WAVES_PER_CONTRAST * deviation + 0.5), FEWEST_WAVES), MOST_WAVES)
    W, R = np.fft.fft2(w), np.fft.fft2(w[..., None] * f, axes=(0, 1))
    middle = np.arange(FSE_BEFORE, FSE_BEFORE + FSE_BLOCK)
    result = np.zeros((FSE_BLOCK, FSE_BLOCK, f.shape[2]))
    for _ in range(waves):
        energy = (np.abs(R[:, : FSE_SIDE // 2]) ** 2).sum(axis=2) * preference
        u, v = np.unravel_index(int(energy.argmax()), energy.shape)
        q = (STEP if u or v else 0.5 * STEP) * R[u, v] / total
        R -= np.roll(W, (u, v), (0, 1))[..., None] * q + np.roll(W, (-u, -v), (0, 1))[..., None] * q.conj()
        wave = np.exp(2j * np.pi / FSE_SIDE * (u * middle[:, None] + v * middle))
        result += 2 * (wave[..., None] * q).real
    return result
