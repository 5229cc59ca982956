"""Images with known blur radii, and static depth maps; the host uploads both strip by strip."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from functools import cached_property
from typing import Any, Literal

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from clsco.frame.strips import Strip, with_apron
from clsco.opencl.buffers import upload
from clsco.opencl.session import Session
from clsco.optics.lens import Lens
from clsco.optics.rays import slopes_at
from clsco.passes.blur import Image
from clsco.passes.job import Job
from clsco.records import REAL, Real, flat
from clsco.scene.model import Camera

Array = NDArray[np.float64]


class HostImage(ABC):
    """An image (rows, columns[, channels]) and its signed radii, in host memory.

    guard: width of the guard band, px. The band holds mirror images, as for textures, or 0 with outside = "constant".
    """

    def __init__(
        self, session: Session, radiance: NDArray[Any], guard: int,
        outside: Literal["symmetric", "constant"] = "symmetric",
    ) -> None:  # fmt: skip
        self.session, self.radiance, self.guard, self.outside = session, radiance, guard, outside

    @abstractmethod
    def radii(self, strip: Strip) -> dict[str, NDArray[Any]]:
        """Signed radii "coc" on the source grid of a strip; for a depth map also the mask "valid" of known radii.

        For an image of a user there is no mask, as all its radii are known; if its pixels have one radius, the result
        is empty.
        """

    def image(self, job: Job, buffers: Mapping[str, cl.Buffer]) -> Image:
        """Upload the image of a strip to the buffers "value", "coc" and "valid".

        If there is no buffer of a name, kernels read the host's array in place. The buffer "valid" is not written if
        `radii` returns no mask.
        """
        value = self._send(buffers.get("value"), flat(self._around(self.radiance, job.strip), np.float32))
        uploaded = {name: self._send(buffers.get(name), array) for name, array in self.radii(job.strip).items()}
        planes = {name: buffers[name] for name in ("coc", "valid") if name in buffers} | uploaded
        return Image(value, tuple(planes[name] for name in ("coc", "valid") if name in planes))

    def _send(self, buffer: cl.Buffer | None, array: NDArray[Any]) -> cl.Buffer:
        if buffer is None:
            return upload(self.session, array, lent=True)
        cl.enqueue_copy(self.session.queue, buffer, array)
        return buffer

    def _around(self, plane: NDArray[Any], strip: Strip) -> NDArray[Any]:
        return with_apron(plane, strip, self.guard, self.outside)


class StaticMap(HostImage):
    """Image and depth map of a static scene, whose pixels are the pinhole image from the viewpoint of the map.

    radiance: (rows, columns[, channels]); inverse_depth: (rows, columns), 1/mm, 0 without a surface. Validated against
    `clsco.reference.render`, which moves every pixel.
    """

    def __init__(
        self, session: Session, camera: Camera, lens: Lens, radiance: NDArray[np.float32], inverse_depth: Array,
        guard: int, real: Real,
    ) -> None:  # fmt: skip
        super().__init__(session, radiance, guard)
        self.camera, self.lens, self.inverse_depth, self.real = camera, lens, inverse_depth, real

    def radii(self, strip: Strip) -> dict[str, NDArray[Any]]:
        w = self._around(self.inverse_depth, strip)
        valid, radii = w > 0, self._radii(w, strip.top - strip.above)
        radii *= valid
        return {"coc": radii.astype(REAL[self.real], copy=False), "valid": valid.view(np.uint8)}

    def _radii(self, w: Array, top: int) -> Array:
        """Signed radii in px of inverse depths `w` (rows, columns); top: row of the frame with the first row of `w`."""
        if not self.lens.is_curved and self.lens.distortion is None:
            return self.lens.blur_radius(w)
        (rows, columns), (_, height) = w.shape, self.camera.frame_size
        up = 0.5 * (height - 1) - top - np.arange(rows)
        slopes = slopes_at(self.camera, np.arange(columns) - 0.5 * (columns - 1), up[:, None])
        return self.lens.image_radius(w, *slopes)

    @cached_property
    def missing(self) -> NDArray[np.bool_]:
        """Mask (rows, columns) of pixels without depth that lie between pixels with depth in their row or column."""
        valid = self.inverse_depth > 0
        ends = [
            np.logical_or.accumulate(valid, axis) & np.flip(np.logical_or.accumulate(np.flip(valid, axis), axis), axis)
            for axis in (0, 1)
        ]
        return (ends[0] | ends[1]) & ~valid

    def truth(self) -> dict[str, NDArray[Any]]:
        """Outputs of ground truth that depend on single pixels only, like those of the method `truth` of a warp."""
        w, valid = self.inverse_depth, self.inverse_depth > 0
        mask = valid if self.radiance.ndim == 2 else valid[..., None]
        radii = self._radii(w, 0)
        return {
            "sharp": np.where(mask, self.radiance, np.float32(0)),
            "filled": np.where(self.missing, np.uint8(2), np.uint8(0)),
            "depth": np.where(valid, 1.0 / np.where(valid, w, 1.0), np.inf),
            "blur_radius": np.where(valid, radii, 0.0).astype(np.float32),
            "mask": valid,
            "object_id": np.where(valid, 0, -1).astype(np.int32),
        }
