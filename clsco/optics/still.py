"""Splits the sources of an exposure into those that change between its time samples and still ones (float64, pure).

Still sources are blurred once, with the weight of the whole exposure: the same terms are added in another order. A
source may change within CHANGE_MARGIN of the extent of a moving object of its group, where outlines may change, and if
a line from it to the lens may meet a moving object, from its inverse depth u to that of the object, w: these lines
spread by D (w - u), for the largest aperture radius D in mm.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from math import inf

import numpy as np
from numpy.typing import NDArray

from clsco.constants import CHANGE_TILE
from clsco.optics.lens import Lens, ray_step
from clsco.optics.motion import Pose
from clsco.optics.quadrics import PlacedSurface
from clsco.optics.visibility import OcclusionGroup
from clsco.scene.model import Camera

Changes = NDArray[np.float32]
CHANGE_MARGIN = 4  # px; sub-pixel sources depend on labels up to 2 px away, and these on those of the next pixel


def moving_objects(poses: Sequence[Sequence[Pose]]) -> frozenset[int]:
    """Numbers of the objects that are not in the same pose at all time samples."""
    return frozenset(k for k, each in enumerate(zip(*poses, strict=True)) if any(map(partial(_differ, each[0]), each)))


def map_changes(
    group: OcclusionGroup, moving: frozenset[int], surfaces: Sequence[Sequence[PlacedSurface]],
    camera: Camera, reach: float, guard: int,
) -> Changes:  # fmt: skip
    """Least inverse depth in 1/mm at which a group's source is still, in tiles of CHANGE_TILE px over frame and guard
    band, of which one begins at row and column 0 of the frame.

    Infinite where outlines may change, -1 in tiles beside those with changing sources, and -inf in all others. moving:
    of `moving_objects`; surfaces: of all objects at each time sample; camera: does not move, and has a resolution;
    reach: extent of the lens in lens radii; guard: width of the guard band, px.
    """
    size, step, before = Lens.of(camera).radius * reach, ray_step(camera), -(-guard // CHANGE_TILE)
    corners = [CHANGE_TILE * np.arange(-before, before - (-length // CHANGE_TILE)) for length in camera.frame_size]
    still = [s.extent.w[0] for k, s in enumerate(surfaces[0]) if group.members >> k & 1 and k not in moving]
    least = np.full((len(corners[1]), len(corners[0])), -inf)
    for placed in surfaces:
        for k in (k for k in moving if (group.members | group.occluders) >> k & 1):
            ends = placed[k].extent.x, (-placed[k].extent.y[1], -placed[k].extent.y[0])
            x, y = (
                np.maximum(low / step - (corner + CHANGE_TILE - 0.5 * length), corner - 0.5 * length - high / step)
                for (low, high), corner, length in zip(ends, corners, camera.frame_size, strict=True)
            )
            away = np.maximum(x, y[:, None]) - CHANGE_MARGIN  # px
            if group.members >> k & 1:
                least[away <= 0] = inf
            if group.occluders >> k & 1 and still:
                nearest = placed[k].extent.w[1]
                least = np.maximum(least, nearest - np.maximum(away, 0.0) * step / max(size, 1e-300))
    least[least < min(still, default=-inf)] = -inf
    near = np.pad(least, 1, constant_values=-inf)
    beside = np.maximum.reduce([near[i : i + len(least), j : j + least.shape[1]] for i in range(3) for j in range(3)])
    return np.where((least == -inf) & (beside > -inf), -1.0, least).astype(np.float32)


def _differ(one: Pose, other: Pose) -> bool:
    return one is not other and bool((one.rotation != other.rotation).any() or (one.shift != other.shift).any())
