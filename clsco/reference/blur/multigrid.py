"""Sources of wide blur on coarser grids, in NumPy float64: what clsco/passes/multigrid.py approximates a frame by.

Grids are (H, W) px of their level, with `guard` rows and columns around the frame (m, n). Node (i, j) of the next level
stands at (2 i - 3.5, 2 j - 3.5) of the grid before.
"""

from __future__ import annotations

from dataclasses import replace
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from clsco.optics.multigrid import (
    FADE,
    MOST_LEVELS,
    STEEPEST,
    coarse_frame,
    coarse_psf,
    loss,
    sharpening,
)
from clsco.optics.psf import shape_of
from clsco.reference.blur.blur import Shape, scatter
from clsco.reference.common.geometry import Array
from clsco.reference.trace.trace import Sources, SubpixelSources
from clsco.scene.model import Psf

Places = NDArray[np.int32]
TENT = np.array([0.25, 0.75, 0.75, 0.25])  # share of a node in the four pixels around it, along one axis


def measure_radii(sources: Sources, sub: SubpixelSources | None) -> tuple[Array, Array]:
    """|R| in px (H, W) of sources that may move, NaN of others, and R grad R in px (H, W, 2).

    Those may that are whole and have no occluders.
    """
    may = sources.lit.copy()
    if sub is not None:
        may[sub.row, sub.column] = False
    if sources.visibility is not None:
        may &= (sources.visibility.row < 0).reshape(may.shape)
    return np.where(may, np.abs(sources.radius), np.nan), sources.gradient * sources.radius[..., None]


def pick(radius: Array, least: float, to: float, steepest: float) -> Array:
    """Share (H, W) of each source that moves: see the kernel; radius: NaN where none may."""
    blocked = np.pad(np.isnan(radius), 2)
    windows = {}
    for name, filling in (("low", np.inf), ("high", -np.inf)):
        padded = np.pad(radius, 2, constant_values=filling)
        windows[name] = np.lib.stride_tricks.sliding_window_view(np.where(blocked, -1.0, padded), (5, 5))
    low, high = windows["low"].min(axis=(2, 3)), windows["high"].max(axis=(2, 3))
    r = np.where(np.isnan(radius), 0.0, radius)
    t = np.clip((r - least) / (to - least), 0.0, 1.0)
    return np.where((low >= r - steepest) & (high <= r + steepest), t * t * (3.0 - 2.0 * t), 0.0)


def _nodes(plane: Array, shape: Shape) -> Array:
    """Sums (H', W') over the pixels around each node, weighted by TENT in both axes."""
    far = 2 * max(shape) + 8
    padded = np.pad(plane, ((5, far), (5, far)))
    along = sum(TENT[i] * padded[:, i : i + 2 * shape[1] : 2] for i in range(4))
    return np.asarray(sum(TENT[i] * along[i : i + 2 * shape[0] : 2] for i in range(4)))


def halve(
    radius: Array, share: Array, radiance: Array, tilt: Array, loss: float, shape: Shape
) -> tuple[Array, Array, Array]:
    """Radiance (H', W', C), |R| (H', W') in px of the next grid, NaN for no source, and R grad R (H', W', 2) there.

    share: of `pick`; radiance: (H, W, C); tilt: (H, W, 2); loss: px^2, see the kernel; shape: (H', W').
    """
    moves = share > 0.0
    number = _nodes(moves.astype(np.float64), shape)
    there = number > 0.0
    number = np.where(there, number, 1.0)
    mean = _nodes(np.where(moves, radius, 0.0), shape) / number
    small = np.where(there, 0.5 * np.sqrt(np.maximum(mean * mean - loss, 0.0)), np.nan)
    turned = [_nodes(np.where(moves, tilt[..., k], 0.0), shape) / (2.0 * number) for k in range(2)]
    moved = [_nodes(share * radiance[..., k], shape) / 4.0 for k in range(radiance.shape[2])]
    return np.stack(moved, axis=-1), small, np.stack(turned, axis=-1)


def aim_nodes(radius: Array, tilt: Array, blunt: float) -> Array:
    """Gradient (H, W, 2) of the radius in px per px that makes the radiance's first moment half the change of its
    second.

    radius: px, NaN for no source; tilt: R grad R; blunt: px^2, see the kernel.
    """
    r = np.where(np.isnan(radius), 1.0, radius)
    return np.asarray(tilt * (np.maximum(r, 1.0) / (r * r + blunt))[..., None])


def enlarge(coarse: Array, coarse_guard: int, shape: Shape, guard: int, sharp: float) -> Array:
    """A coarser frame (m', n', C) at the pixels (m, n) of the next finer one: see the kernel."""
    a, b = 1.0 + 2.0 * sharp, -sharp
    for axis, size in enumerate(shape):
        pixel = np.arange(size) + guard
        node = (pixel + 1) // 2 + 1 - coarse_guard
        t = np.where(pixel % 2 == 1, 0.25, 0.75)
        weight = np.array([b * (1.0 - t), a * (1.0 - t) + b * t, a * t + b * (1.0 - t), b * t])
        nodes = np.moveaxis(coarse, axis, -1)[..., node + np.arange(-1, 3)[:, None]]
        coarse = np.moveaxis((weight * nodes).sum(axis=-2), -1, axis)
    return coarse


def sample_frame(frame: Array, places: Places) -> Array:
    """Pixels (places, C) of a frame."""
    return np.asarray(frame[places[:, 0], places[:, 1]])


def probe(psf: Psf, sources: Sources, share: Array, shape: Shape, guard: int, places: Places) -> Array:
    """Irradiance (places, C) of some pixels by the exact way, from the radiance that moves; share: of `pick`."""
    moved = replace(sources, lit=sources.lit & (share > 0.0), radiance=sources.radiance * share[..., None])
    return sample_frame(scatter(psf, moved, None, shape, guard), places)


def coarse(
    psf: Psf, sources: Sources, sub: SubpixelSources | None, shape: Shape, guard: int, least: float
) -> tuple[Array, Array]:
    """Approximated frame (m, n, C), and the part of it that came from coarser grids.

    Arguments as for `clsco.reference.blur.blur.scatter`; least: as for `clsco.passes.multigrid.Multigrid`.
    """
    return _blurred(psf, sources, sub, shape, guard, least, 0)


def shares(psf: Psf, radius: Array, least: float, level: int) -> Array:
    """Share (H, W) of each source that moves on from a level, 0 the finest; radius: NaN where none may."""
    limit = sqrt(4.0 * least**2 + loss(psf, level == 0))
    return pick(radius, limit, FADE * limit, STEEPEST)


def _blurred(
    psf: Psf, sources: Sources, sub: SubpixelSources | None, shape: Shape, guard: int, least: float, level: int,
    planes: tuple[Array, Array] | None = None,
) -> tuple[Array, Array]:  # fmt: skip
    """As `coarse`, of a level; planes: radii and R grad R of a coarser level's nodes."""
    own = psf if level == 0 else coarse_psf(psf)
    radius, tilt = measure_radii(sources, sub) if planes is None else planes
    share = shares(psf, radius, least, level) if level < MOST_LEVELS else np.zeros(radius.shape)
    stays = replace(sources, lit=sources.lit & (share < 1.0), radiance=sources.radiance * (1.0 - share)[..., None])
    frame = scatter(own, stays, sub, shape, guard)
    if not share.any():
        return frame, np.zeros_like(frame)
    m, n, around = coarse_frame(*shape, guard)
    nodes = m + 2 * around, n + 2 * around
    radiance, small, turned = halve(radius, share, sources.radiance, tilt, loss(psf, level == 0), nodes)
    there = ~np.isnan(small)
    blunt = shape_of(coarse_psf(psf)).pixel_moment / shape_of(psf).second_moment
    sources = Sources(
        radiance,
        np.ones(nodes),
        there.astype(np.uint8),
        np.where(there, small, 0.0),
        aim_nodes(small, turned, blunt),
        there,
    )
    below, _ = _blurred(psf, sources, None, (m, n), around, least, level + 1, (small, turned))
    wide = enlarge(below, around, shape, guard, sharpening(psf))
    return frame + wide, wide
