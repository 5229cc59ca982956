"""A static depth map as the only surface: its own pixels are what the pinhole sees, strip by strip from the host."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from clsco.frame.strips import Strip, around
from clsco.opencl.session import Session
from clsco.optics.lens import blur_radius
from clsco.records import REAL, Real, flat
from clsco.scene.model import Camera

Array = NDArray[np.float64]


class StaticMap:
    """Image and depth map of a scene where nothing moves, and which is seen from where they were made.

    camera: of the scene; radiance: float32 (rows, columns[, channels]); inverse_depth: (rows, columns) in 1/mm, 0 where
    nothing is; guard: px of the apron around the frame, where both go on as their mirror images, as textures do.
    Validated against `clsco.reference.render`, which moves every pixel to its own place.
    """

    def __init__(
        self, camera: Camera, radiance: NDArray[np.float32], inverse_depth: Array, guard: int, real: Real
    ) -> None:
        self.camera, self.radiance, self.inverse_depth = camera, radiance, inverse_depth
        self.guard, self.real = guard, real

    def send(self, session: Session, strip: Strip, value: cl.Buffer) -> None:
        """Write the radiance of a strip on its padded grid, as `clsco.passes.layered.DepthLayers.add` takes it."""
        cl.enqueue_copy(session.queue, value, flat(self._around(self.radiance, strip), np.float32))

    def send_radii(self, session: Session, strip: Strip, coc: cl.Buffer, valid: cl.Buffer) -> None:
        """Write where its surface is and how it is blurred, in the same way."""
        w = self._around(self.inverse_depth, strip)
        there, radii = w > 0, blur_radius(self.camera, w)
        radii *= there
        cl.enqueue_copy(session.queue, coc, radii.astype(REAL[self.real]))
        cl.enqueue_copy(session.queue, valid, there.view(np.uint8))

    @cached_property
    def missing(self) -> NDArray[np.bool_]:
        """Pixels (rows, columns) without depth between the first and last one with it of their row, or their column."""
        there = self.inverse_depth > 0
        ends = [
            np.logical_or.accumulate(there, axis) & np.flip(np.logical_or.accumulate(np.flip(there, axis), axis), axis)
            for axis in (0, 1)
        ]
        return (ends[0] | ends[1]) & ~there

    def truth(self) -> dict[str, NDArray[Any]]:
        """Ground truth that needs no differences; values as of `clsco.passes.warp.ForwardWarp.truth`."""
        w, there = self.inverse_depth, self.inverse_depth > 0
        seen = there if self.radiance.ndim == 2 else there[..., None]
        return {
            "sharp": np.where(seen, self.radiance, np.float32(0)),
            "filled": np.where(self.missing, np.uint8(2), np.uint8(0)),
            "depth": np.where(there, 1.0 / np.where(there, w, 1.0), np.inf),
            "blur_radius": np.where(there, blur_radius(self.camera, w), 0.0).astype(np.float32),
            "mask": there,
            "object_id": np.where(there, 0, -1).astype(np.int32),
        }

    def _around(self, plane: NDArray[Any], strip: Strip) -> NDArray[Any]:
        return around(plane, strip, self.guard)
