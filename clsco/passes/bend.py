"""Host side of trace/bend.cl, which computes the effect of a lens on the rays of all pixels for many time samples."""

from __future__ import annotations

from collections.abc import Hashable

import pyopencl as cl

from clsco.opencl.buffers import allocate
from clsco.opencl.program import Events, Target
from clsco.passes.blur import PIXELS
from clsco.plan.buffers import bend_buffers
from clsco.plan.features import curvature_of
from clsco.records import Struct
from clsco.scene.model import Scene


class Bends:
    """Planes that trace/bend.cl fills, cached while they do not change; target: has the kernels that cast rays.

    If the lens never changes and the frame has one strip, the session caches the planes; otherwise only the latest
    planes are kept.
    """

    def __init__(self, target: Target, scene: Scene) -> None:
        self.target, self.scene = target, scene
        self.curved = curvature_of(scene)
        self.latest: tuple[Hashable, dict[str, cl.Buffer]] = None, {}

    def planes(self, grid: Struct, lens: Struct, events: Events) -> dict[str, cl.Buffer]:
        """The buffers of "bends" and "slopes" that the lens needs, for a grid and a lens; empty for a thin lens."""
        sizes = bend_buffers(self.scene, int(grid["width"]) * int(grid["height"]))
        if not sizes:
            return {}
        focus = (self.curved, *(float(lens[name]) for name in ("sag", "detector_power", "sphere")))
        session, key = self.target.session, (grid.tobytes(), focus, tuple(sizes.items()), self.target.real)

        def filled(planes: dict[str, cl.Buffer]) -> dict[str, cl.Buffer]:
            size = int(grid["width"]), int(grid["height"])
            self.target.run("bend", size, PIXELS, events, grid, lens, planes["bends"], planes.get("slopes"))
            return planes

        if not self.scene.lens_moves and grid["rows"] == grid["frame_rows"]:
            total = sum(sizes.values())
            return session.cache.get(("bends", key), lambda: filled(allocate(session, sizes)), lambda _: total)
        latest_key, planes = self.latest
        if latest_key != key:
            fits = {name: buffer.size for name, buffer in planes.items()} == sizes
            self.latest = key, filled(planes if fits else allocate(session, sizes))
        return self.latest[1]
