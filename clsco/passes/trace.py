"""Host side of the tracing: rays to sources, sub-pixel sources at silhouettes, and what a pinhole sees."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pyopencl as cl

from clsco.constants import STATISTIC_SLOTS, STATISTIC_SMALLEST
from clsco.frame.strips import Strip
from clsco.opencl.buffers import allocate
from clsco.opencl.session import Session
from clsco.optics.slabs import Slabs
from clsco.optics.visibility import Layer
from clsco.passes.blur import PIXELS, Events, Sources, Target
from clsco.passes.pack import layer_struct
from clsco.passes.placed import PlacedScene, TimeSample
from clsco.plan.buffers import STATISTICS, hit_buffers
from clsco.plan.plan import Plan
from clsco.records import Struct

# What of the statistics a frame must begin with: no radius met, no slot taken (trace.cl).
EMPTY_STATISTICS = np.zeros(STATISTICS, np.int32)
EMPTY_STATISTICS[STATISTIC_SMALLEST] = np.iinfo(np.int32).max

Planes = tuple[cl.Buffer, cl.Buffer, cl.Buffer]  # value, coc and valid on the padded grid, as in layered.cl


class Hits:
    """What rays hit for the lenses of one group: planes of the last time sample of each occlusion group."""

    def __init__(self, session: Session) -> None:
        self.session = session
        self.buffers: dict[Layer, dict[str, cl.Buffer]] = {}
        self.times: dict[Layer, float] = {}

    def planes(self, plan: Plan, time: float, group: Layer) -> tuple[tuple[cl.Buffer, ...], bool]:
        """Planes value, depth and hit of an occlusion group, as in trace.cl, and whether they are still to be cast for
        `time`."""
        if group not in self.buffers:
            self.buffers[group] = allocate(self.session, hit_buffers(plan.grid))
        new = self.times.get(group) != time
        self.times[group] = time
        return tuple(self.buffers[group].values()), new


@dataclass
class Work:
    """A strip of a frame while its passes run, and what they hand on.

    Attributes
    ----------
    strip : Strip
    camera : numpy.void
        camera_t of the strip.
    events : list
        What was enqueued.
    sample : TimeSample
    group : Layer, optional
        The occlusion group that is traced and blurred.
    planes : (Buffer, Buffer, Buffer)
        An image with its radii, where there is one.
    sources : Sources
        What the blur adds.
    depth_layers : dict
        Depth layers of whole time samples by their times, where the frame is made in strips.
    report : dict
        What is reported of a time sample.
    """

    strip: Strip
    camera: Struct
    events: Events
    sample: TimeSample
    group: Layer | None = None
    planes: Planes | None = None
    sources: Sources | None = None
    depth_layers: Mapping[float, Slabs] = field(default_factory=dict)
    report: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Tracer:
    """Casts the rays of a plan.

    Attributes
    ----------
    plan : Plan
    scene : PlacedScene
    target : Target
        With the kernels of trace.cl.
    buffers : mapping
        By the names of `clsco.plan.buffers.trace_buffers`, `silhouette_buffers` and `map_buffers`.
    psf : numpy.void
        psf_t of the blur that the sources are for.
    hits : Hits, optional
        Shared with other lenses.
    """

    plan: Plan
    scene: PlacedScene
    target: Target
    buffers: Mapping[str, cl.Buffer]
    psf: Struct
    hits: Hits | None = None

    def trace(self, work: Work) -> None:
        """Sources of one occlusion group; its buffers are those of the group before, which the queue is done with."""
        buffers, occluded = self.buffers, bool(self.plan.features()["OCCLUDED"])
        sample, head = work.sample, self._head(work)
        share = np.float32(sample.weight)
        source, label, statistics = (buffers.get(name) for name in ("source", "label", "statistics"))
        assert work.group is not None
        if self.hits is None:
            value, depth = buffers["value"], buffers.get("depth")
            args = (*head, share, self.scene.texture, source, value, label, statistics)
            self._per_pixel("trace", work, *args, *((depth,) if occluded else ()))
        else:
            planes, new = self.hits.planes(self.plan, sample.time, work.group)
            value, depth, hit = planes
            if new:
                self._per_pixel("cast", work, *head[:3], share, self.scene.texture, *planes)
            self._per_pixel("aim", work, *head, depth, hit, source, label, statistics)
        hidden: dict[str, Any] = {"surfaces": sample.surfaces, "layer": head[2], "depth": depth} if occluded else {}
        work.sources = Sources(source, value, **hidden)

    def silhouettes(self, work: Work) -> None:
        """Sub-pixel sources of an occlusion group after `trace`."""
        assert work.sources is not None
        plan, buffers, statistics = self.plan, self.buffers, self.buffers["statistics"]
        slots, source = np.int32(plan.slots), buffers["source"]
        cl.enqueue_fill_buffer(self.target.session.queue, statistics, np.zeros(1, np.int32), 4 * STATISTIC_SLOTS, 4)
        marks = (work.camera, buffers["label"], slots, source, buffers["pixels"], statistics)
        self._per_pixel("mark_silhouettes", work, *marks)
        subs = (buffers["sub_source"], buffers["sub_value"], statistics)
        sub_depth = buffers.get("sub_depth")
        occluded = (sub_depth,) if sub_depth is not None else ()
        head = (*self._head(work), np.float32(work.sample.weight), self.scene.texture)
        size = (plan.slots * plan.silhouettes**2,)
        self.target.run(
            "trace_subpixels", size, PIXELS[:1], work.events, *head, buffers["pixels"], slots, *subs, *occluded
        )
        work.sources = replace(
            work.sources, sub_source=subs[0], sub_value=subs[1], capacity=plan.slots, sub_depth=sub_depth
        )

    def pinhole(self, work: Work, weight: float) -> None:
        """The image of a pinhole of so much weight, with its radii."""
        value, coc, valid = (self.buffers[name] for name in ("value", "coc", "valid"))
        head = (work.camera, work.sample.surfaces, everything(self.plan), np.float32(weight), self.scene.texture)
        self._per_pixel("pinhole", work, *head, value, coc, valid, self.buffers["statistics"])
        work.planes = value, coc, valid

    def _head(self, work: Work) -> tuple[Any, ...]:
        assert work.group is not None
        placed = work.sample
        return work.camera, placed.surfaces, layer_struct(work.group, len(placed.placed)), self.psf

    def _per_pixel(self, name: str, work: Work, *args: Any) -> None:
        size = (int(work.camera["width"]), int(work.camera["height"]))
        self.target.run(name, size, PIXELS, work.events, *args)


def everything(plan: Plan) -> Struct:
    """layer_t of all objects of a scene, with nothing in their way."""
    count = len(plan.scene.objects)
    return layer_struct(Layer((1 << count) - 1, 0), count)
