"""The stages of the forward warp by themselves, to be timed and inspected (see `clsco.passes.warp`)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.inputs.pupils import scene_point_spread
from clsco.inputs.textures import Texture
from clsco.opencl.buffers import download
from clsco.opencl.session import Session
from clsco.passes.placed import PlacedScene
from clsco.passes.warp import ForwardWarp
from clsco.plan.plan import make_plan
from clsco.records import Real
from clsco.scene.model import Scene

Array = NDArray[Any]


class MeasuredStages:
    """The stages of the forward warp of one scene on the device; real: by default double where that has it."""

    def __init__(self, session: Session, scene: Scene, texture: Array, real: Real | None = None) -> None:
        plan = make_plan(scene, scene_point_spread(scene), 1)
        real = real or ("double" if session.device.has_fp64 else "float")
        self.session, self.scene = session, scene
        placed = PlacedScene(
            session, scene, plan.psf, [Texture(np.ascontiguousarray(texture, np.float32), 8, "")], real
        )
        self.sample = placed.at(scene.sequence.shutter)
        self.warp = ForwardWarp(plan, placed, [None])
        self.shape, self.guard = (plan.height, plan.width), plan.guard_px

    def depth_test(self) -> None:
        """Find the nearest pixel that comes to each."""
        self.warp.nearest(self.sample, [])
        self.session.queue.finish()

    def gather(self) -> None:
        """Bring what the nearest ones are, with nothing filled."""
        self.warp.gather([])
        self.session.queue.finish()

    def fill(self) -> None:
        """Find missing pixels and fill them; after `gather`."""
        self.warp.filler.fill(self.sample.surfaces, 1, [])
        self.session.queue.finish()

    def winners(self) -> Array:
        """Number of the nearest pixel of the reference pose that comes to each of the frame, (rows, columns); after
        `depth_test`."""
        found = download(self.session, self.warp.winner, self.shape, np.int32)
        inside = slice(self.guard, -self.guard or None)
        return found[inside, inside]

    def filled(self) -> Array:
        """Row and column (n, 2) of the filled pixels that are not on the padded grid's outermost rows and columns."""
        status = download(self.session, self.warp.filler.planes.status, self.shape, np.uint8)
        return (np.argwhere(status[1:-1, 1:-1] == 1) + 1).astype(np.int32)
