"""Inpainting with smooth surfaces on the device, by the biharmonic equation.

The Laplacian of the Laplacian is 0 in the holes, which continues values and slopes at the outlines (Damelin and Hoang
2018, doi:10.1155/2018/3950312; scikit-image's `inpaint_biharmonic` solves the equations directly). Here the equations
are solved by conjugate gradients, preconditioned by quadratic B-splines of every size in the holes (Bramble, Pasciak
and Xu 1990, doi:10.2307/2008789; Oswald 1992): the number of steps hardly grows with the size of holes, and memory is a
fixed number of bytes per missing pixel.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from clsco.constants import DOT_SEGMENT
from clsco.inpainting.hole_shapes import FINER_GAIN, FIRST_GAIN, MOST_STEPS, TOLERANCE, spline_holes
from clsco.inpainting.tiles import Progress, fill_in_tiles, no_progress
from clsco.opencl.buffers import download, empty, upload
from clsco.opencl.program import Target, launch
from clsco.opencl.session import Session
from clsco.records import Real

LOCAL = (64,)
CHECK_EVERY = 10  # number of steps between two tests of the residual, as a test waits for the device


def fill_biharmonic(
    session: Session, image: NDArray[Any], missing: NDArray[np.bool_], progress: Progress = no_progress
) -> NDArray[np.float32]:
    """Values of missing pixels by the biharmonic equation; see `clsco.inpainting.fse.fill_texture` for the arguments.

    Memory besides the image: a byte per pixel, and 8 bytes and the result per missing pixel. The tile that is being
    filled takes another 12 channels + 6 bytes per pixel, and 43 channels + 5 bytes per missing pixel.
    """
    real: Real = "double" if session.device.has_fp64 else "float"
    features = {"CHANNELS": image.shape[2]}
    target = Target(session, ["inpainting/biharmonic.cl"], features, real)

    def fill(part: NDArray[np.float32], holes: NDArray[np.bool_]) -> NDArray[np.float32]:
        part[holes] = _Solver(session, target, real, part.shape[2], holes).solve(part)
        return part

    return fill_in_tiles(image, missing, fill, progress)


@dataclass(frozen=True)
class _Level:
    """Unknowns at one resolution: pixels in the holes of a reduced image, and their values `vector`.

    size: rows and columns of the image; list: pixel number of each of the `count` unknowns; index: number of the
    unknown at each pixel, -1 for none.
    """

    size: tuple[np.int32, np.int32]
    count: np.int32
    list: cl.Buffer
    index: cl.Buffer
    vector: cl.Buffer


class _Solver:
    """Conjugate gradient solver for the holes of one image; owns the buffers on the device."""

    def __init__(self, session: Session, target: Target, real: Real, channels: int, missing: NDArray[np.bool_]) -> None:
        self.session, self.target, self.channels = session, target, channels
        self.real = np.float64 if real == "double" else np.float32
        holes = [missing]
        while (coarse := spline_holes(holes[-1])).any() and coarse.size < holes[-1].size:
            holes.append(coarse)
        self.levels = [self._level(inside) for inside in holes]
        unknowns = int(self.levels[0].count)
        self.residual = self.levels[0].vector
        self.solution, self.direction, self.applied, self.better = (self._vector(unknowns) for _ in range(4))
        self.partial, self.sums = self._vector(-(-unknowns // DOT_SEGMENT)), self._vector(3)

    def solve(self, image: NDArray[np.float32]) -> NDArray[np.float32]:
        """The solution (N, K) at the N missing pixels, row by row, of an image (H, W, K)."""
        finest, now = self.levels[0], 0
        count = finest.count
        known = upload(self.session, image)
        for buffer in (self.solution, self.direction, self.sums):
            cl.enqueue_fill_buffer(self.session.queue, buffer, np.zeros(1, np.uint32), 0, buffer.size)
        unknowns = finest.index, finest.list, count
        self._launch("start_residual", count, *finest.size, known, *unknowns, self.residual)
        self._precondition()
        self._dot(self.residual, self.better, now)
        # As all other sums are 0, the first direction is the preconditioned residual itself.
        self._launch("turn_direction", count, self.sums, np.int32(1), self.better, count, self.direction)
        first = self._sum(now)
        for step in range(MOST_STEPS):
            if step % CHECK_EVERY == 0 and not (self._sum(now) > TOLERANCE**2 * first).any():
                break
            self._launch("apply_biharmonic", count, *finest.size, self.direction, *unknowns, self.applied)
            self._dot(self.direction, self.applied, 2)
            vectors = (self.direction, self.applied, count, self.solution, self.residual)
            self._launch("take_step", count, self.sums, np.int32(now), *vectors)
            self._precondition()
            self._dot(self.residual, self.better, 1 - now)
            self._launch("turn_direction", count, self.sums, np.int32(now), self.better, count, self.direction)
            now = 1 - now
        return download(self.session, self.solution, (int(finest.count), self.channels), self.real).astype(np.float32)

    def _precondition(self) -> None:
        """Compute the preconditioned residual, from the finest resolution to the coarsest and back."""
        pairs = list(pairwise(self.levels))
        for fine, coarse in pairs:
            gain = self.real(FIRST_GAIN if fine is self.levels[0] else FINER_GAIN)
            inputs = (*fine.size, fine.vector, fine.index, coarse.list, coarse.count, gain, coarse.vector)
            self._launch("coarser", coarse.count, *inputs)
        for fine, coarse in reversed(pairs):
            target = self.better if fine is self.levels[0] else fine.vector
            outputs = (*fine.size, fine.vector, fine.list, fine.count, coarse.vector, coarse.index, target)
            self._launch("finer", fine.count, *outputs)
        if not pairs:
            cl.enqueue_copy(self.session.queue, self.better, self.residual, byte_count=self.residual.size)

    def _dot(self, a: cl.Buffer, b: cl.Buffer, slot: int) -> None:
        count = self.levels[0].count
        segments = -(-int(count) // DOT_SEGMENT)
        self._launch("add_products", segments, a, b, count, self.partial)
        self._launch("add_partials", self.channels, self.partial, np.int32(segments), np.int32(slot), self.sums)

    def _sum(self, slot: int) -> NDArray[Any]:
        return download(self.session, self.sums, (3, self.channels), self.real)[slot]

    def _launch(self, name: str, size: int | np.int32, *args: Any) -> None:
        launch(self.session, self.target[name], (int(size),), LOCAL, *args)

    def _level(self, inside: NDArray[np.bool_]) -> _Level:
        at = np.flatnonzero(inside).astype(np.int32)
        index = np.full(inside.size, -1, np.int32)
        index[at] = np.arange(at.size, dtype=np.int32)
        size = np.int32(inside.shape[0]), np.int32(inside.shape[1])
        buffers = upload(self.session, at), upload(self.session, index), self._vector(at.size)
        return _Level(size, np.int32(at.size), *buffers)

    def _vector(self, entries: int) -> cl.Buffer:
        return empty(self.session, entries * self.channels * np.dtype(self.real).itemsize)
