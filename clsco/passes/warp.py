"""Host side of the forward warp: every pixel at rest to its place at one moment, holes filled."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from clsco.opencl.buffers import download, empty, upload
from clsco.opencl.program import build, kernel, launch
from clsco.opencl.session import Session
from clsco.optics.motion import Pose, rest_center
from clsco.optics.quadrics import PlacedSurface
from clsco.passes.blur import PIXELS, Events
from clsco.passes.fill import LINES, LISTED, OWNERS, ZERO, Filler
from clsco.passes.pack import pose_structs, surface_structs
from clsco.plan.plan import Plan
from clsco.records import WIDE, WIDE_BYTES, Real, Struct, in_parts, structs, together

KERNELS = ("warp/warp.cl", "inpainting/fill.cl", "inpainting/score.cl", "inpainting/fill_mean_median.cl")
# As in the kernels.
ITEM_PIXELS = 64  # sources of a row that a work-item moves, with OWNED
NO_WINNER = np.array(np.iinfo(np.int32).max, np.int32)

# Bands of rows that reproject_nearest makes of the image: few, since each looks at all segments, but enough
# to share out.
BANDS_PER_CORE, SMALLEST_BAND = 4, 16

SHAPE_FEATURES = ("CHANNELS", "SEVERAL", "QUADRATIC", "LINEAR", "NAPPE", "BOUNDED")

Surfaces = Sequence[PlacedSurface | None]


@dataclass(frozen=True)
class Warped:
    """One moment on the device, on the padded grid (height, width); overwritten by the next one.

    value: float (CHANNELS, height, width), radiance times weight; w: wide_t, inverse depth in 1/mm; coc: wide_t, signed
    radius of the blur in px; valid: uchar, known or filled (elsewhere value, w and coc are 0); status: uchar, 0 known
    or not missing, 1 filled, 2 left; object: uchar, number of the object that is seen, 255 for none and in
    the mirror image around a depth map, or None where the scene has only one; counters: as `Filler.fill` returns them.
    """

    value: cl.Buffer
    w: cl.Buffer
    coc: cl.Buffer
    valid: cl.Buffer
    status: cl.Buffer
    object: cl.Buffer | None
    counters: dict[str, int]


def forward_features(plan: Plan, owned: bool) -> dict[str, int]:
    """What reproject.cl and fill.cl are compiled for; owned: bands of the image without atomics, for CPUs.

    A depth map has no outline that a ray could miss: where there is one, domain "surface" is "span". Holes are filled
    from the far side (FILL_FAR) where a scene may have surfaces at several depths: several objects, or a depth map.
    """
    fill, mapped = plan.scene.fill, any(item.shape == "depth_map" for item in plan.scene.objects)
    shape = {name: value for name, value in plan.features().items() if name in SHAPE_FEATURES}
    return shape | {
        "FILTER": 0,
        "SAMPLED": 0,
        "GENERAL": 0,
        "IMAGE": 0,
        "CODES": 0,
        "OWNED": int(owned),
        "MAPPED": int(mapped),
        "FILL_AIT": int(fill.method == "ait"),
        "FILL_MEAN_MEDIAN": int(fill.method == "mean_median"),
        "FILL_FAR": int(mapped or len(plan.scene.objects) > 1),
        "DOMAIN_SURFACE": int(fill.domain == "surface" and not mapped),
    }


class ForwardWarp:
    """Owns the buffers of the forward warp for one plan on one device, and the pixels' inverse depth at rest.

    camera: camera_t of the plan; texture: float (textures, CHANNELS, rows, columns). Of every object of the scene:
    surfaces: as the textures show it, None for a depth map; maps: inverse depth (rows, columns) in 1/mm of a depth map,
    0 where nothing is, None for others; textures: number of its texture, by default its own. owned: the depth test
    without atomics, by default on processors; the same bits either way; brightest: largest radiance of the textures.
    Raises DeviceError, KernelError. Validated against `warp.warp` and `inpainting.fill`.
    """

    def __init__(
        self,
        session: Session,
        plan: Plan,
        camera: Struct,
        texture: cl.Buffer,
        surfaces: Surfaces,
        maps: Sequence[NDArray[np.float64] | None],
        real: Real,
        owned: bool | None = None,
        textures: Sequence[int] | None = None,
        brightest: float = 1.0,
    ) -> None:
        self.brightest = brightest
        self.session, self.plan, self.camera, self.texture, self.real = session, plan, camera, texture, real
        self.items = plan.scene.objects
        self.textures = list(textures or range(len(self.items)))
        self.owned = session.device.kind == "cpu" if owned is None else owned
        features = forward_features(plan, self.owned)
        self.program = build(session, KERNELS, features, structs(real), real)
        self.filler = Filler(session, self.program, camera, features)
        # Once the pixels are in their places, the filling may have these for its lists.
        self.target, self.winner = self.filler.indices
        self.sources = plan.rows * plan.columns
        self.rest = empty(session, WIDE_BYTES * self.sources)
        self.moved = empty(session, WIDE_BYTES * self.sources)
        if features["SEVERAL"]:  # objects take turns, and leave what is another one's as it is
            for buffer in (self.target, self.moved):
                cl.enqueue_fill_buffer(session.queue, buffer, ZERO, 0, buffer.size)
        self.object = (empty(session, self.sources),) if features["SEVERAL"] else ()
        self.rest_surfaces = self._surfaces(surfaces)
        members = np.uint64(sum(1 << k for k, surface in enumerate(surfaces) if surface is not None))
        given = [depth for depth in maps if depth is not None]
        self.maps = (upload(session, in_parts(np.stack(given), real)),) if given else ()
        args = (camera, self.rest_surfaces, np.int32(len(self.items)), members, *self.maps, self.rest, *self.object)
        self._per_pixel("reproject_rest", [], (plan.columns, plan.rows), *args)
        self.segments = plan.rows * -(-plan.columns // ITEM_PIXELS)
        if self.owned:
            self.bounds = empty(session, 8 * self.segments)
            self.depth = self.filler.coc  # not yet written then
        else:
            self.depth = empty(session, self.winner.size)

    def warp(self, poses: Sequence[Pose], surfaces: Surfaces, weight: float, events: Events) -> Warped:
        """The pixels at rest after the move of the objects to `poses`, with missing ones filled as the scene says.

        poses: of every object before the camera, wherever that is itself; surfaces: the objects in their poses, None
        for depth maps; weight: of this moment in the exposure; events: gets what was enqueued.
        """
        self.nearest(poses, surfaces, events)
        self.gather(weight, events)
        planes, plan = self.filler, self.plan
        counters = planes.fill(self.placed[1], len(self.items), events, self.brightest * weight)
        if self.maps:
            out = (planes.value, planes.w, planes.coc, planes.valid)
            self._per_pixel("extend_border", events, (plan.width, plan.height), self.camera, *out)
        return Warped(planes.value, planes.w, planes.coc, planes.valid, planes.status, planes.object, counters)

    def nearest(self, poses: Sequence[Pose], surfaces: Surfaces, events: Events) -> None:
        """Enqueue the depth test: where each pixel at rest moves, and which one is the nearest that comes to a pixel.

        Arguments as for `warp`.
        """
        # Held until the queue is done with them; the filling waits for that.
        self.placed = upload(self.session, pose_structs(poses, self.real)), self._surfaces(surfaces)
        args = (self.camera, self.rest_surfaces, self.placed[0], self.rest, self.target, self.moved, *self.object)
        if self.owned:
            self._test_in_bands(args, events)
        else:
            self._test_by_atomics(args, events)

    def gather(self, weight: float, events: Events) -> None:
        """Enqueue what the winners of the depth test bring: the planes of `filler`, with nothing filled. As `warp`."""
        planes, plan = self.filler, self.plan
        if planes.is_far:
            chunks = (-(-plan.width // (ITEM_PIXELS if self.owned else 1)), plan.height)
            gaps = (self.camera, self.depth, self.winner, planes.valid)
            self._launch("reproject_gaps", events, chunks, (1, *LINES) if self.owned else PIXELS, *gaps)
        head = (self.camera, np.float32(weight), self.texture, self.moved, self.winner)
        several = (self.rest_surfaces, *self.object) if self.object else ()
        seen = () if planes.object is None else (planes.object,)
        out = (planes.value, planes.w, planes.coc, planes.valid, planes.status, *seen)
        self._per_pixel("reproject_gather", events, (plan.width, plan.height), *head, *several, *out)

    def note_radii(self, statistics: cl.Buffer, events: Events) -> None:
        """Keep the range of the radii that `warp` has found, largest and smallest, in the first two of these ints."""
        chunks = (-(-self.plan.width // (ITEM_PIXELS if self.owned else 1)), self.plan.height)
        found = (self.filler.coc, self.filler.valid, statistics)
        self._launch("note_radii", events, chunks, (1, *LINES) if self.owned else PIXELS, self.camera, *found)

    def truth(
        self, poses: Sequence[Pose], surfaces: Surfaces, wanted: Collection[str], events: Events
    ) -> dict[str, NDArray[Any]]:
        """What is wanted of these, float32 or as stated, (rows, columns[, channels]). Other arguments as for `warp`.

        "sharp": radiance after the move; "filled": uint8, as `Warped.status`. Of a scene with a depth map, at which no
        ray can be cast, also what is known of the pixels' surface, filled ones included: "depth" in mm, +inf for none,
        float64, for normals come from its differences; "blur_radius" in px, 0 for none; "mask", bool; "object_id",
        int32, -1 for none. These are values of the source that came to the pixel, up to half a pixel from its center.
        """
        plan = self.plan
        names = {"sharp", "filled"} | ({"depth", "blur_radius", "mask", "object_id"} if self.maps else set())
        if not names & set(wanted):
            return {}
        warped = self.warp(poses, surfaces, 1.0, events)
        wide, valid = WIDE[self.real], self._frame(warped.valid, np.bool_)
        found: dict[str, NDArray[Any]] = {"mask": valid}
        if "sharp" in wanted:
            planes = self._frame(warped.value, np.float32, plan.channels)
            found["sharp"] = np.ascontiguousarray(planes[0] if plan.channels == 1 else np.moveaxis(planes, 0, -1))
        if "filled" in wanted:
            found["filled"] = self._frame(warped.status, np.uint8)
        if self.maps:
            w = together(self._frame(warped.w, wide), self.real)
            found["depth"] = np.where(valid, 1.0 / np.where(valid, w, 1.0), np.inf)
            found["blur_radius"] = together(self._frame(warped.coc, wide), self.real).astype(np.float32)
            seen = np.zeros(valid.shape, np.int32)
            if warped.object is not None:
                seen = self._frame(warped.object, np.uint8).astype(np.int32)
            found["object_id"] = np.where(valid, seen, -1).astype(np.int32)
        return {name: array for name, array in found.items() if name in names & set(wanted)}

    def _frame(self, buffer: cl.Buffer, dtype: Any, channels: int | None = None) -> NDArray[Any]:
        """The frame's part (rows, columns) of a plane on the padded grid, or (channels, rows, columns) of several."""
        plan, guard = self.plan, self.plan.guard_px
        shape = (plan.height, plan.width) if channels is None else (channels, plan.height, plan.width)
        inside = (..., slice(guard, guard + plan.rows), slice(guard, guard + plan.columns))
        return np.ascontiguousarray(download(self.session, buffer, shape, dtype)[inside])

    def _surfaces(self, surfaces: Surfaces) -> cl.Buffer:
        """surface_t of every object on the device; of depth maps only the center, about which they turn."""
        known = [k for k, surface in enumerate(surfaces) if surface is not None]
        placed = [surface for surface in surfaces if surface is not None]
        array = np.zeros(len(self.items), structs(self.real)["surface_t"])
        array[known] = surface_structs([self.items[k] for k in known], placed, self.real)
        for k in set(range(len(self.items))) - set(known):
            center, rest = rest_center(self.items[k]), array["rest"][k]
            rest[:3] = center
            rest[3:] = (center - rest[:3])[: rest.size - 3]  # the low parts of single precision
        array["texture"] = self.textures
        return upload(self.session, array)

    def _test_in_bands(self, args: tuple[Any, ...], events: Events) -> None:
        """Targets and winners; work-items own bands of the image."""
        rows, cores = self.plan.height, self.session.device.compute_units
        band = max(SMALLEST_BAND, -(-rows // (BANDS_PER_CORE * cores)))
        self._launch("reproject_targets", events, (self.segments,), LINES, *args, self.bounds)
        owned = (self.camera, self.target, self.moved, self.bounds, np.int32(band), self.winner)
        depth = (self.depth,) if self.filler.is_far else ()
        self._launch("reproject_nearest", events, (-(-rows // band),), OWNERS, *owned, *depth)

    def _test_by_atomics(self, args: tuple[Any, ...], events: Events) -> None:
        """Targets and winners; a work-item per source."""
        cl.enqueue_fill_buffer(self.session.queue, self.depth, ZERO, 0, self.depth.size)
        cl.enqueue_fill_buffer(self.session.queue, self.winner, NO_WINNER, 0, self.winner.size)
        tested = (self.camera, self.target, self.moved, self.depth)
        self._launch("reproject_targets", events, (self.sources,), LISTED, *args)
        self._launch("reproject_depth", events, (self.sources,), LISTED, *tested)
        self._launch("reproject_winner", events, (self.sources,), LISTED, *tested, self.winner)

    def _per_pixel(self, name: str, events: Events, size: tuple[int, int], *args: Any) -> None:
        self._launch(name, events, size, PIXELS, *args)

    def _launch(self, name: str, events: Events, size: tuple[int, ...], local: tuple[int, ...], *args: Any) -> None:
        events.append((name, launch(self.session, kernel(self.program, name), size, local, *args)))
