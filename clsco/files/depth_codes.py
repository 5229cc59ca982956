"""Depth and disparity in the formats of KITTI (16-bit PNG, depth in m) and Middlebury (PFM)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clsco.files.ranges import check_values, raise_shape_error

MM_PER_M = 1000.0
KITTI_STEPS = 256  # codes per m of depth, and per px of disparity


def _kitti_codes(values: NDArray[np.float64], valid: NDArray[np.bool_], where: str, unit: str) -> NDArray[np.uint16]:
    codes = np.rint(np.where(valid, values, 0.0) * KITTI_STEPS)
    rule = f"must round to 1/256 to 65535/256 {unit}, which KITTI's 16 bits hold besides 0 for unknown"
    check_values(where, rule, values, valid & ((codes < 1) | (codes > 65535)))
    return codes.astype(np.uint16)


def kitti_depth_codes(depth: NDArray[np.floating], where: str = "depth") -> NDArray[np.uint16]:
    """Codes of KITTI's depth, uint16 (rows, columns): 256 per m, 0 without a surface.

    depth: planar Z in mm, +inf without a surface. Raises FileError, whose message begins with `where`.
    """
    if depth.ndim != 2:
        raise_shape_error(where, "(rows, columns)", depth)
    check_values(where, "must be greater than 0, and +inf where nothing is", depth, ~(depth > 0))
    return _kitti_codes(depth.astype(np.float64) / MM_PER_M, np.isfinite(depth), where, "m")


def kitti_disparity_codes(
    disparity: NDArray[np.floating], valid: NDArray[np.bool_] | None = None, where: str = "disparity"
) -> NDArray[np.uint16]:
    """Codes of KITTI's disparity, uint16 (rows, columns): 256 per px, 0 if unknown.

    disparity: px, column on the left minus column on the right. valid: known pixels, by default all finite ones.
    """
    if disparity.ndim != 2:
        raise_shape_error(where, "(rows, columns)", disparity)
    known = np.isfinite(disparity) if valid is None else np.isfinite(disparity) & valid
    return _kitti_codes(disparity.astype(np.float64), known, where, "px")


def pfm_bytes(array: NDArray[np.floating], where: str = "array") -> bytes:
    """A PFM file of (rows, columns[, 2 or 3]): float32, little endian, the bottom row first.

    Two channels get a third one of zeros, as in the flow of FlyingThings. Readers of disparity take +inf for unknown.
    """
    if array.ndim == 3 and array.shape[2] == 2:
        array = np.dstack([array, np.zeros_like(array[..., 0])])
    if array.ndim != 2 and (array.ndim != 3 or array.shape[2] != 3):
        raise_shape_error(where, "(rows, columns[, 2 or 3])", array)
    head = f"{'PF' if array.ndim == 3 else 'Pf'}\n{array.shape[1]} {array.shape[0]}\n-1.0\n"
    return head.encode() + array[::-1].astype("<f4").tobytes()
