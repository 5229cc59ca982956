"""Depth, disparity and optical flow in the formats of KITTI (16-bit PNG, depth in m) and Middlebury (PFM, .flo)."""

from __future__ import annotations

import struct

import numpy as np
from numpy.typing import NDArray

from clsco.files.ranges import check_values, raise_shape_error

Floats = NDArray[np.floating]
Mask = NDArray[np.bool_]
Codes = NDArray[np.uint16]

MM_PER_M = 1000.0
DEPTH_STEPS = 256  # KITTI's codes per m of depth, and per px of disparity
FLOW_STEPS = 64  # KITTI's codes per px of flow
FLOW_ZERO = 32768  # KITTI's code of a flow of 0 px
FLO_TAG = struct.pack("<f", 202021.25)
LARGEST_FLO = 1e9  # px, from which on Middlebury's readers treat a vector as unknown
UNKNOWN_FLO = 1e10  # value of unknown vectors in files of Middlebury's writers


def _kitti_codes(values: NDArray[np.float64], valid: Mask, where: str, unit: str) -> Codes:
    codes = np.rint(np.where(valid, values, 0.0) * DEPTH_STEPS)
    rule = f"must round to 1/256 to 65535/256 {unit}, which KITTI's 16 bits hold besides 0 for unknown"
    check_values(where, rule, values, valid & ((codes < 1) | (codes > 65535)))
    return codes.astype(np.uint16)


def kitti_depth_codes(depth: Floats, where: str = "depth") -> Codes:
    """Codes of KITTI's depth, uint16 (rows, columns): 256 per m, 0 without a surface.

    depth: planar Z in mm, +inf without a surface. Raises FileError, whose message begins with `where`.
    """
    if depth.ndim != 2:
        raise_shape_error(where, "(rows, columns)", depth)
    check_values(where, "must be greater than 0, and +inf where nothing is", depth, ~(depth > 0))
    return _kitti_codes(depth.astype(np.float64) / MM_PER_M, np.isfinite(depth), where, "m")


def kitti_disparity_codes(disparity: Floats, valid: Mask | None = None, where: str = "disparity") -> Codes:
    """Codes of KITTI's disparity, uint16 (rows, columns): 256 per px, 0 if unknown.

    disparity: column in the left view minus column in the right view, px. valid: mask of the known pixels, by default
    all that are finite.
    """
    if disparity.ndim != 2:
        raise_shape_error(where, "(rows, columns)", disparity)
    known = np.isfinite(disparity) if valid is None else np.isfinite(disparity) & valid
    return _kitti_codes(disparity.astype(np.float64), known, where, "px")


def pfm_bytes(array: Floats, where: str = "array") -> bytes:
    """A PFM file of an array (rows, columns[, 2 or 3]), stored as float32, little endian, the bottom row first.

    To two channels a third one of zeros is added, as in FlyingThings. Readers of disparity take +inf for unknown.
    """
    if array.ndim == 3 and array.shape[2] == 2:
        array = np.dstack([array, np.zeros_like(array[..., 0])])
    if array.ndim != 2 and (array.ndim != 3 or array.shape[2] != 3):
        raise_shape_error(where, "(rows, columns[, 2 or 3])", array)
    head = f"{'PF' if array.ndim == 3 else 'Pf'}\n{array.shape[1]} {array.shape[0]}\n-1.0\n"
    return head.encode() + array[::-1].astype("<f4").tobytes()


def _known(where: str, flow: Floats, valid: Mask | None) -> Mask:
    """Check a flow; returns the mask of its known vectors, which are finite and, if `valid` is given, valid."""
    if flow.ndim != 3 or flow.shape[2] != 2:
        raise_shape_error(where, "(rows, columns, 2)", flow)
    finite = np.asarray(np.isfinite(flow).all(axis=-1))
    return finite if valid is None else finite & valid


def flo_bytes(flow: Floats, valid: Mask | None = None, where: str = "flow") -> bytes:
    """A .flo file of Middlebury: float32 without loss, 1e10 for unknown vectors.

    flow: (rows, columns, 2), px to the right and down. valid: mask of the known vectors, by default all finite ones.
    """
    known = _known(where, flow, valid)
    beyond = known & (np.abs(flow) >= LARGEST_FLO).any(axis=-1)
    check_values(where, "sizes must be below 1e9 px, as readers of .flo take others for unknown", flow, beyond)
    rows, columns = flow.shape[:2]
    stored = np.full(flow.shape, UNKNOWN_FLO, "<f4")
    stored[known] = flow[known]
    return struct.pack("<4sii", FLO_TAG, columns, rows) + stored.tobytes()


def kitti_flow_codes(flow: Floats, valid: Mask | None = None, where: str = "flow") -> Codes:
    """Codes of KITTI's flow (u, v), uint16 (rows, columns, 3): 64 u + 32768, 64 v + 32768, and 1 for known vectors.

    Arguments are as for `flo_bytes`. Vectors are rounded to 1/64 px; codes of unknown vectors are (0, 0, 0).
    """
    known = _known(where, flow, valid)
    codes = np.rint(np.where(known[..., None], flow, 0.0).astype(np.float64) * FLOW_STEPS) + FLOW_ZERO
    beyond = np.asarray(((codes < 0) | (codes > 65535)).any(axis=-1))
    rule = "must lie within -512 to 511.984375 px, which KITTI's 16 bits hold in steps of 1/64 px"
    check_values(where, rule, flow, beyond)
    return np.where(known[..., None], np.dstack([codes, np.ones(known.shape)]), 0.0).astype(np.uint16)
