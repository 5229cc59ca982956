"""Depth test and copies of neighborhoods in numba, as one would write them without OpenCL; needs the extra `bench`."""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from clsco.constants import NO_WINNER

SNAP = 4096.0  # steps per px, to which kernels/warp/warp.cl snaps positions


def _nearest(rest, pose, center, step, threads):  # type: ignore[no-untyped-def]
    """Number of the nearest pixel that comes to each pixel (rows, columns), NO_WINNER for none; of equals the first.

    rest: inverse depth (rows, columns) in 1/mm; pose: rotation (9) and shift (3) in mm of an object about its center
    (3); step: slope of the ray from pixel to pixel. An image per thread, merged at the end.
    """
    rows, columns = rest.shape
    winner = np.full((threads, rows, columns), NO_WINNER, np.int32)
    depth = np.zeros((threads, rows, columns), np.float32)
    turn = np.empty(3)
    for k in range(3):
        moved = pose[3 * k] * center[0] + pose[3 * k + 1] * center[1] + pose[3 * k + 2] * center[2]
        turn[k] = center[k] + pose[9 + k] - moved
    for t in prange(threads):
        for i in range(t * rows // threads, (t + 1) * rows // threads):
            y = step * (0.5 * (rows - 1) - i)
            for j in range(columns):
                w = rest[i, j]
                if not w > 0.0:
                    continue
                x = step * (j - 0.5 * (columns - 1))
                px = pose[0] * x + pose[1] * y + pose[2] + w * turn[0]
                py = pose[3] * x + pose[4] * y + pose[5] + w * turn[1]
                pz = pose[6] * x + pose[7] * y + pose[8] + w * turn[2]
                if not pz > 0.0:
                    continue
                nearness = 1.0 / pz
                scale = nearness / step
                to_j = int(np.floor(px * scale + 0.5 * (columns - 1) + 0.5 + 0.5 / SNAP))
                to_i = int(np.floor(0.5 * (rows - 1) - py * scale + 0.5 + 0.5 / SNAP))
                if 0 <= to_i < rows and 0 <= to_j < columns:
                    near = np.float32(w * nearness)
                    if near > depth[t, to_i, to_j]:
                        depth[t, to_i, to_j] = near
                        winner[t, to_i, to_j] = i * columns + j
    for i in prange(rows):
        for t in range(1, threads):
            for j in range(columns):
                if depth[t, i, j] > depth[0, i, j]:
                    depth[0, i, j] = depth[t, i, j]
                    winner[0, i, j] = winner[t, i, j]
    return winner[0]


nearest_threads = njit(parallel=True, cache=True)(_nearest)
# With one thread, and then in less CPU time: nothing is shared out or merged.
nearest_serial = njit(cache=True)(_nearest)


@njit(cache=True)
def copy_neighborhoods(missing, value, w, coc, to_value, to_w, to_coc):  # type: ignore[no-untyped-def]
    """Read the 3 x 3 pixels around each of some `missing` ones (n, 2) and write them to other planes (rows, columns).

    What a filling moves, with nothing found or computed. Missing ones are not on the outermost rows and columns.
    """
    for k in range(len(missing)):
        i, j = missing[k]
        for a in range(i - 1, i + 2):
            for b in range(j - 1, j + 2):
                to_value[a, b] = value[a, b]
                to_w[a, b] = w[a, b]
                to_coc[a, b] = coc[a, b]
