"""Host side of vignetting, which darkens the blurred plane of a time sample."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from clsco.constants import SUMMED_PIXELS
from clsco.opencl.buffers import Refilled
from clsco.opencl.program import Events, Target
from clsco.opencl.session import Session
from clsco.optics.vignetting import throughput
from clsco.passes.blur import BLOCKS, Plane
from clsco.scene.lens import Vignetting as Kind
from clsco.scene.model import Camera


@lru_cache(maxsize=2)
def _share(camera: Camera, kind: Kind) -> NDArray[np.float32]:
    """Vignetting (rows, columns) by `throughput`, cached for many time samples and frames."""
    return throughput(camera, kind).astype(np.float32)


class Vignetting:
    """Multiplies planes in place by the vignetting of the lens, except a channel of coverage after the color channels.

    Validated against `clsco.optics.vignetting.throughput`.
    """

    def __init__(self, session: Session, kind: Kind, colors: int, pixels: int) -> None:
        self.target = Target(session, ["blur/vignetting.cl"], {}, "float")
        self.kind, self.colors = kind, colors
        self._buffer = Refilled(session, 4 * pixels)  # kernels of the previous time sample may still read it
        self._filled: NDArray[np.float32] | None = None
        self.local = (1, 1) if session.device.kind == "cpu" else BLOCKS  # as in `FrameSum`

    def darken(self, plane: Plane, camera: Camera, top: int, events: Events) -> Plane:
        """Darken a plane in place, and return it; top: row of the frame with the plane's first row."""
        share = _share(camera, self.kind)
        if share is not self._filled:
            self._buffer.fill(share)
            self._filled = share
        head = (np.int32(n) for n in (plane.rows, plane.columns, self.colors))
        size = (-(-plane.columns // SUMMED_PIXELS), plane.rows)
        self.target.run("vignette", size, self.local, events, *head, *plane.layout, self._buffer.buffer, np.int32(top))
        return plane
