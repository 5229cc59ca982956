"""Optical flow in the formats of Middlebury (.flo) and KITTI (16-bit PNG): arrays to bytes."""

from __future__ import annotations

import struct

import numpy as np
from numpy.typing import NDArray

from clsco.files.ranges import check_values, raise_shape_error

TAG = struct.pack("<f", 202021.25)
LARGEST_FLO = 1e9  # px, from which on Middlebury's readers treat a vector as unknown
UNKNOWN_FLO = 1e10  # value of unknown vectors in files of Middlebury's writers
KITTI_STEPS = 64  # per px
KITTI_ZERO = 32768  # code of 0 px


def _checked(where: str, flow: NDArray[np.floating], valid: NDArray[np.bool_] | None) -> NDArray[np.bool_]:
    """Check a flow, and return a mask of its known vectors: those that are `valid`, by default all, and finite."""
    if flow.ndim != 3 or flow.shape[2] != 2:
        raise_shape_error(where, "(rows, columns, 2)", flow)
    finite = np.isfinite(flow).all(axis=-1)
    return finite if valid is None else finite & valid


def flo_bytes(flow: NDArray[np.floating], valid: NDArray[np.bool_] | None = None, where: str = "flow") -> bytes:
    """A .flo file of Middlebury: float32 without loss, 1e10 for unknown vectors.

    flow: (rows, columns, 2), px, right and down. valid: known vectors, by default all finite ones.
    """
    known = _checked(where, flow, valid)
    beyond = known & (np.abs(flow) >= LARGEST_FLO).any(axis=-1)
    check_values(where, "sizes must be below 1e9 px, as readers of .flo take others for unknown", flow, beyond)
    rows, columns = flow.shape[:2]
    stored = np.full(flow.shape, UNKNOWN_FLO, "<f4")
    stored[known] = flow[known]
    return struct.pack("<4sii", TAG, columns, rows) + stored.tobytes()


def kitti_flow_codes(
    flow: NDArray[np.floating], valid: NDArray[np.bool_] | None = None, where: str = "flow"
) -> NDArray[np.uint16]:
    """Codes of KITTI's flow, uint16 (rows, columns, 3): 64 u + 32768, 64 v + 32768, and 1 for known vectors.

    Arguments are those of `flo_bytes`; vectors are rounded to 1/64 px, unknown ones are (0, 0, 0).
    """
    known = _checked(where, flow, valid)
    codes = np.rint(np.where(known[..., None], flow, 0.0).astype(np.float64) * KITTI_STEPS) + KITTI_ZERO
    beyond = np.asarray(((codes < 0) | (codes > 65535)).any(axis=-1))
    rule = "must lie within -512 to 511.984375 px, which KITTI's 16 bits hold in steps of 1/64 px"
    check_values(where, rule, flow, beyond)
    return np.where(known[..., None], np.dstack([codes, np.ones(known.shape)]), 0.0).astype(np.uint16)
