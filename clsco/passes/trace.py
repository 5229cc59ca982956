"""Host side of ray tracing, which computes sources, sub-pixel sources at silhouettes, and the pinhole image."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import pyopencl as cl

from clsco.constants import STATISTIC_SLOTS, STATISTIC_SMALLEST, TAP_LANES
from clsco.opencl.buffers import allocate, download, upload
from clsco.opencl.program import Target
from clsco.opencl.session import Session
from clsco.optics.lens import Lens
from clsco.optics.quadrics import EVERYWHERE
from clsco.optics.visibility import NO_GROUP, OcclusionGroup
from clsco.passes.bend import Bends
from clsco.passes.blur import BLOCKS, PIXELS, Image, Sources
from clsco.passes.job import SceneJob
from clsco.passes.pack import group_struct, lens_struct
from clsco.passes.placed import PlacedScene
from clsco.plan.buffers import STATISTICS, Sizes, hit_buffers, silhouette_buffers
from clsco.plan.plan import Plan
from clsco.records import REAL, Struct

SPARE_SLOTS = 1.25  # ratio of allocated to needed slots when slots are added, as the next time sample may need more
ROUNDED = 1e-5  # relative margin of extents, far above the rounding errors of rays and depths in single precision
# The kernels that cast rays.
TRACE_FILES = tuple(f"trace/{name}.cl" for name in ("cast", "aim", "silhouettes", "subpixels", "bend", "truth"))
# Statistics at the beginning of a frame, before any radius or slot is recorded.
EMPTY_STATISTICS = np.zeros(STATISTICS, np.int32)
EMPTY_STATISTICS[STATISTIC_SMALLEST] = np.iinfo(np.int32).max

HitPlanes = tuple[cl.Buffer, ...]  # planes of value, depth and label, see trace/cast.cl
Cast = Callable[[HitPlanes], None]


class HitKey(NamedTuple):
    """Cache key of ray hits, with all that the hits depend on; `textures` is None if hits cannot be cached."""

    group: OcclusionGroup
    cast: Hashable
    textures: Hashable


class LatestHits:
    """Cache of each occlusion group's hits at the latest time sample, for the lenses of a sweep.

    `planes` returns the planes of the hits; if they are not cached, it calls `cast`, which enqueues the kernel that
    fills them.
    """

    def __init__(self, session: Session) -> None:
        self.session = session
        self.latest: dict[OcclusionGroup, tuple[HitKey, HitPlanes]] = {}

    def planes(self, sizes: Sizes, key: HitKey, cast: Cast) -> HitPlanes:
        latest, planes = self.latest.get(key.group) or (None, tuple(allocate(self.session, sizes).values()))
        if latest != key:
            cast(planes)
            self.latest[key.group] = key, planes
        return planes


class CachedHits:
    """Cache of ray hits in the session, for several time samples and renderings."""

    def __init__(self, session: Session) -> None:
        self.session = session

    def planes(self, sizes: Sizes, key: HitKey, cast: Cast) -> HitPlanes:
        def cast_new() -> HitPlanes:
            planes = tuple(allocate(self.session, sizes).values())
            cast(planes)
            return planes

        if key.textures is None:
            return cast_new()
        return self.session.cache.get(("hits", key), cast_new, lambda _: sum(sizes.values()))


Hits = LatestHits | CachedHits


@dataclass(eq=False)
class Tracer:
    """Casts the rays of a plan.

    buffers: named as in `clsco.plan.buffers.trace_buffers`, `silhouette_buffers` and `map_buffers`, shared by all
    colors; buffers of slots are replaced if more slots are needed. psf: psf_t of the blur that will add the sources.
    hits: ray hits shared with other lenses; by default, rays are cast for this lens alone.
    """

    plan: Plan
    scene: PlacedScene
    buffers: dict[str, cl.Buffer]
    psf: Struct
    hits: Hits | None = None

    @cached_property
    def target(self) -> Target:
        """Target with the kernels that cast rays."""
        return ray_target(self.plan, self.scene)

    @cached_property
    def bends(self) -> Bends:
        """The lens's effect on rays."""
        return Bends(self.target, self.plan.scene)

    def _bends(self, job: SceneJob, *names: str) -> tuple[cl.Buffer, ...]:
        """Kernel arguments: those of the planes "bends" and "slopes" in `names` that the lens has."""
        planes = self.bends.planes(job.grid, self.lens(job), job.events)
        return tuple(planes[name] for name in names if name in planes)

    def lens(self, job: SceneJob) -> Struct:
        """lens_t at a time sample."""
        return lens_struct(Lens.of(job.sample.camera, self.plan.scene.lens, self.plan.only), self.scene.real)

    @cached_property
    def extents(self) -> cl.Buffer | None:
        """Predicted extents of all objects in a buffer on the device; None for a single object."""
        count = len(self.plan.scene.objects)
        if count == 1:
            return None
        extents = self.plan.extents or [EVERYWHERE] * count
        ends = np.array([(*extent.x, *extent.y, *extent.w) for extent in extents])
        ends += np.array([-1.0, 1.0] * 3) * (ROUNDED * np.abs(ends))
        return upload(self.scene.session, ends.astype(REAL[self.scene.real]))

    def trace(self, job: SceneJob, group: OcclusionGroup) -> Sources:
        """Sources of one occlusion group; they overwrite those of the previous group."""
        plan, buffers, head = self.plan, self.buffers, self._head(job, group)
        sizes, changes = hit_buffers(plan.grid, plan.mapped > 0), job.changes.get(group) or ()
        if self.hits is None:
            planes = tuple(buffers[name] for name in sizes)
            self._cast(job, group, planes, changes)
        else:
            shared = (changes[0], np.int32(0)) if changes else ()  # casts all rays
            planes = self.hits.planes(
                sizes, self._key(job, group), lambda planes: self._cast(job, group, planes, shared)
            )
        value, depth, label = planes
        source = buffers.get("source")
        out = (source, buffers["statistics"], self.extents, np.int32(plan.spare_px))
        maps = (value, self.scene.texture_maps, buffers.get("share"))
        bends = self._bends(job, "slopes", "bends")
        self._per_pixel("aim", job, *head, depth, label, *out, *maps, *bends, *changes)
        occluders: dict[str, Any] = {}
        if plan.spec.occluders:
            occluders = {"lens": head[1], "surfaces": job.sample.surfaces, "group": head[3], "depth": depth}
        return Sources(source, value, label=label, bends=bends[-1] if plan.psf.stretched else None, **occluders)

    def _cast(self, job: SceneJob, group: OcclusionGroup, planes: HitPlanes, changes: tuple[Any, ...]) -> None:
        """Enqueue the kernel that casts the rays of one occlusion group, which are the same for all lenses."""
        grid, _, surfaces, members, _ = self._head(job, group)
        args = (*self._appearance(job), *planes, *self._bends(job, "slopes"), *changes)
        self._per_pixel("cast", job, grid, surfaces, members, *args)

    def silhouettes(self, job: SceneJob, group: OcclusionGroup, sources: Sources) -> Sources:
        """The sources of an occlusion group with sub-pixel sources added."""
        size = (max(self._assign_slots(job, sources), 1),)
        buffers, room = self.buffers, self._room
        source, statistics, slots = buffers["source"], buffers["statistics"], np.int32(room)
        subs = buffers["sub_source"], buffers["sub_value"]
        labels, depth = buffers["sub_label"], buffers["sub_depth"]
        head, run = self._head(job, group), self.target.run
        grid, _, surfaces, members, _ = head
        slotted = (*head, *self._appearance(job), buffers["pixels"], slots)
        labeled = (grid, surfaces, members, buffers["pixels"], slots, labels, depth, statistics)
        run("label_subpixels", size, PIXELS[:1], job.events, *labeled)
        run("trace_subpixels", size, PIXELS[:1], job.events, *slotted, source, *subs, labels, depth, statistics)
        if self.plan.small:
            run("trace_small", size, PIXELS[:1], job.events, *slotted, source, *subs, depth, statistics)
        value = sources.value
        if "sharper" in buffers:
            run("trace_detail", size, PIXELS[:1], job.events, *slotted, source, *subs, depth, statistics)
            value = buffers["sharper"]
            self._per_pixel("sharpen", job, job.grid, sources.value, buffers["share"], source, value)
        return replace(sources, value=value, sub_source=subs[0], sub_value=subs[1], capacity=room, sub_depth=depth)

    @property
    def _room(self) -> int:
        """Number of slots for pixels near silhouettes."""
        return self.buffers["pixels"].size // 4

    def _assign_slots(self, job: SceneJob, sources: Sources) -> int:
        """Assign slots to pixels that need sub-pixel sources, and add slots if there are too few. Returns the number of
        these pixels; waits for the device.
        """
        session, statistics = self.target.session, self.buffers["statistics"]
        runs = -(-int(job.grid["width"]) // TAP_LANES), int(job.grid["height"])
        first_slot = np.zeros(1, np.int32)
        while True:
            cl.enqueue_fill_buffer(session.queue, statistics, first_slot, 4 * STATISTIC_SLOTS, 4)
            marks = (self.buffers["source"], self.buffers["pixels"], statistics)
            head = (job.grid, sources.label, np.int32(self._room))
            self.target.run("mark_silhouettes", runs, BLOCKS, job.events, *head, *marks)
            count = int(download(session, statistics, (STATISTIC_SLOTS + 1,), np.int32)[STATISTIC_SLOTS])
            if count <= self._room:
                return count
            first_slot[0] = self._room
            self._make_room(int(SPARE_SLOTS * count))

    def _make_room(self, slots: int) -> None:
        """Replace the buffers of slots by larger ones, and copy the assigned slots. The queue must be empty."""
        session, before = self.target.session, self.buffers["pixels"]
        self.buffers.update(allocate(session, silhouette_buffers(self.plan.spec, self.plan.grid, slots, False)))
        cl.enqueue_copy(session.queue, self.buffers["pixels"], before, byte_count=before.size).wait()

    def pinhole(self, job: SceneJob) -> Image:
        """The pinhole image with the blur radius of each pixel."""
        value, coc, valid = (self.buffers[name] for name in ("value", "coc", "valid"))
        head = (job.grid, self.lens(job), job.sample.surfaces, everything(self.plan), *self._appearance(job))
        out = value, coc, valid, self.buffers["statistics"], *self._bends(job, "slopes", "bends")
        self._per_pixel("pinhole", job, *head, *out)
        return Image(value, (coc, valid))

    @cached_property
    def _hit_features(self) -> Hashable:
        """The features of the kernels on which ray hits depend, and the precision of the geometry."""
        features = self.plan.features()
        return *(features[name] for name in ("CHANNELS", "MOVED", "FILTER", "TEXTURED", "LIT")), self.scene.real

    def _key(self, job: SceneJob, group: OcclusionGroup) -> HitKey:
        """Cache key of the ray hits of an occlusion group at a time sample."""
        sample = job.sample
        members = [k for k in range(len(sample.placed)) if group.members >> k & 1]
        light = tuple(light_t.tobytes() for light_t in sample.light)
        cast = (job.grid.tobytes(), sample.packed[members].tobytes(), light, tuple(members), self._hit_features)
        maps = self.scene.packed_maps.tobytes() if self.plan.mapped else b""
        return HitKey(group, (cast, maps), self.scene.content)

    def _appearance(self, job: SceneJob) -> tuple[Any, ...]:
        """Kernel arguments: textures, texture mappings and, if the scene has one, a light."""
        return (self.scene.texture, self.scene.texture_maps, *job.sample.light)

    def without_occluders(self, job: SceneJob) -> dict[str, Any]:
        """Lens, surfaces and a group without occluders, as fields of `Sources`."""
        return {"lens": self.lens(job), "surfaces": job.sample.surfaces, "group": group_struct(NO_GROUP, 0)}

    def _head(self, job: SceneJob, group: OcclusionGroup) -> tuple[Any, ...]:
        members = group_struct(group, len(job.sample.placed))
        return job.grid, self.lens(job), job.sample.surfaces, members, self.psf

    def _per_pixel(self, name: str, job: SceneJob, *args: Any) -> None:
        """Enqueue a kernel with a work-item for each pixel of the frame and the guard band."""
        self.target.run(name, (int(job.grid["width"]), int(job.grid["height"])), PIXELS, job.events, *args)


def ray_target(plan: Plan, scene: PlacedScene) -> Target:
    """Target with the kernels that cast rays."""
    return Target(scene.session, TRACE_FILES, plan.features(), scene.real)


def everything(plan: Plan) -> Struct:
    """group_t of all objects of a scene, without occluders."""
    count = len(plan.scene.objects)
    return group_struct(OcclusionGroup((1 << count) - 1, 0), count)
