"""One frame and its ground truth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

TRUTH_NAMES = ("sharp", "depth", "coc", "mask", "filled", "object_id", "normal", "flow", "hidden")
STEREO_NAMES = ("disparity", "occluded")  # besides, of a stereo pair


@dataclass(frozen=True, eq=False)
class Frame:
    """A rendered frame: the photograph, and what nobody can see in a photograph.

    Row 0 is on top, column 0 on the left, pixel centers at integer coordinates. Channels are red, green,
    blue; arrays of a gray scene have none. Truth that nobody asked for is None. `sharp`, `depth`, `coc`,
    `mask`, `object_id`, `normal` and `flow` belong to the middle of the shutter and are never anti-aliased.

    index      number of the frame in its sequence, from 0
    color      float32 (rows, columns[, 3]), linear light, 1 = white: blurred by defocus and motion
    sharp      float32 (rows, columns[, 3]), linear light: all in focus
    depth      float32 (rows, columns), mm: planar Z at the pixel center, +inf where nothing is
    coc        float32 (rows, columns), px: signed blur radius R, positive behind the focal surface
    mask       bool (rows, columns): a surface is there
    filled     uint8 (rows, columns): 0 known, 1 filled, 2 could not be filled
    object_id  int32 (rows, columns): position in the scene's list of objects, -1 none
    normal     float32 (rows, columns, 3): unit vector in the camera frame, x right, y up, z into the scene
    flow       float32 (rows, columns, 2), px: x right, y down, to the next frame
    hidden     bool (rows, columns): the point was not seen at rest, so its radiance is extrapolated
    disparity  float32 (rows, columns), px: column in the left view less column in the right one of the surface point;
               0 where nothing is. Only of a stereo pair, as the next
    occluded   bool (rows, columns): the other view does not see the point: something is before it, or it is outside
    eye        "left" or "right" of a stereo pair, else ""
    metadata   what made the frame; JSON-able
    """

    index: int
    color: NDArray[np.float32]
    sharp: NDArray[np.float32] | None = None
    depth: NDArray[np.float32] | None = None
    coc: NDArray[np.float32] | None = None
    mask: NDArray[np.bool_] | None = None
    filled: NDArray[np.uint8] | None = None
    object_id: NDArray[np.int32] | None = None
    normal: NDArray[np.float32] | None = None
    flow: NDArray[np.float32] | None = None
    hidden: NDArray[np.bool_] | None = None
    disparity: NDArray[np.float32] | None = None
    occluded: NDArray[np.bool_] | None = None
    eye: str = ""
    metadata: Mapping[str, Any] = field(default_factory=dict)
