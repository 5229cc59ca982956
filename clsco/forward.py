"""Host side of the forward warp: every pixel at rest to its place at one moment, holes filled."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from clsco.device import Program, Session
from clsco.estimators import MeanMedian, bits_of, score_of_sums, score_scale
from clsco.layout import WIDE, WIDE_BYTES, Real, Struct, in_parts, pose_structs, structs, surface_structs, together
from clsco.motion import Pose, rest_center
from clsco.plan import Plan
from clsco.program import build, download, empty, kernel, launch, upload
from clsco.spread import PIXELS, Events
from clsco.surfaces import PlacedSurface

KERNELS = ("reproject.cl", "fill.cl", "score.cl", "mean_median.cl")
# As in the kernels.
SEGMENT = 64  # sources of a row that a work-item moves, with OWNED
COUNTERS = 5
SUMS, SCORED = 13, 128  # sums of score_mean_median, and columns per work-item there
LEFT, LEFT_INSIDE, FILLED, FILLED_INSIDE, DONE = range(COUNTERS)
CHUNK = 64  # pixels per work-item where it counts
LANES = 8  # pixels of a vector; score_mean_median may read so many beyond the end
NO_WINNER = np.array(np.iinfo(np.int32).max, np.int32)
ZERO = np.array(0, np.int32)

# Bands of rows that reproject_nearest makes of the image: few, since each looks at all segments, but enough
# to share out.
BANDS_PER_CORE, SMALLEST_BAND = 4, 16
LISTED = (64,)  # local size of kernels with a work-item per source or per entry of a list
OWNERS = (1,)  # of those with few, large work-items
LINES = (8,)  # of those with a work-item per row, column, segment, chunk or vector
CHAPTER5 = MeanMedian()

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
        "IMAGE": 0,
        "CODES": 0,
        "OWNED": int(owned),
        "MAPPED": int(mapped),
        "FILL_AIT": int(fill.method == "ait"),
        "FILL_MEAN_MEDIAN": int(fill.method == "mean_median"),
        "FILL_FAR": int(mapped or len(plan.scene.objects) > 1),
        "DOMAIN_SURFACE": int(fill.domain == "surface" and not mapped),
    }


class Filler:
    """Owns planes with missing pixels on one device, and fills them (4.3.5, chapter 5).

    program: with fill.cl; camera: camera_t, whose padded grid the planes have; features: of the program. value, w, coc,
    valid, status and object (None without SEVERAL) are as in fill.cl, for the caller to write
    before `fill`; indices are two buffers of ints per pixel that only `fill` itself needs.
    Raises DeviceError. Validated against `clsco.reference.fill`.
    """

    def __init__(self, session: Session, program: Program, camera: Struct, features: dict[str, int]) -> None:
        self.session, self.program, self.camera = session, program, camera
        self.interpolates, self.smooths = bool(features["FILL_AIT"]), bool(features["FILL_MEAN_MEDIAN"])
        self.is_far, channels = bool(features["FILL_FAR"]), features["CHANNELS"]
        self.rows, self.columns = int(camera["height"]), int(camera["width"])
        self.lines, pixels = self.rows + self.columns, self.rows * self.columns
        self.value, self.w = empty(session, 4 * (channels * pixels + LANES)), empty(session, WIDE_BYTES * pixels)
        self.valid, self.status = empty(session, pixels + LANES), empty(session, pixels)
        self.coc = empty(session, WIDE_BYTES * pixels)
        tail = np.zeros(4 * LANES, np.uint8)  # read beyond the end, and used for nothing
        cl.enqueue_copy(session.queue, self.value, tail, dst_offset=4 * channels * pixels)
        cl.enqueue_copy(session.queue, self.valid, tail[:LANES], dst_offset=pixels)
        self.indices = empty(session, 4 * pixels), empty(session, 4 * pixels)
        self.spans, self.grown = empty(session, 8 * self.lines), empty(session, 8 * self.lines)
        self.counters = empty(session, 4 * COUNTERS)
        self.object = empty(session, pixels) if features["SEVERAL"] else None
        self.far: tuple[cl.Buffer, ...] = (empty(session, 4 * pixels),) if self.is_far else ()
        if self.smooths:
            self.scored = self.rows * -(-self.columns // SCORED)
            self.done, self.sums = empty(session, 4 * pixels), empty(session, 8 * SUMS * self.scored)
            self.other_value, self.other_w = empty(session, self.value.size), empty(session, self.w.size)

    def fill(self, surfaces: cl.Buffer, count: int, events: Events, brightest: float = 1.0) -> dict[str, int]:
        """Fill missing pixels sweep by sweep; returns the fields of `clsco.reference.fill.FillReport`.

        surfaces: `count` of surface_t, where pixels may be missing with domain "surface"; brightest: what radiance is
        at most. Waits once per sweep.
        """
        cl.enqueue_fill_buffer(self.session.queue, self.counters, ZERO, 0, self.counters.size)
        source, left = self.indices
        placed = (self.camera, surfaces, np.int32(count), self.valid)
        found = self._mark(placed, source, events)
        wins = self._score(brightest, events) if self.smooths and found[LEFT] else 0
        sweeps = filled = first = 0
        most, least = CHAPTER5.minimum if self.smooths else 1, 0 if self.is_far else 1
        minimum = most
        while (self.interpolates or self.smooths) and found[LEFT]:
            self._sweep(source, found[LEFT], np.int32(wins), np.int32(minimum), events)
            found = self._settle(placed, source, left, found[LEFT], events)
            source, left = left, source
            if found[FILLED]:
                sweeps, minimum = sweeps + 1, most
                filled += found[FILLED_INSIDE]
                first = filled if sweeps == 1 else first
            elif minimum > least:
                minimum -= 1  # fewer neighbors will do where the filling would stall, and then nearer ones
            else:
                break
        if self.smooths and found[DONE]:
            self._smooth(found[DONE], events)
        return {
            "missing_pixels": filled + found[LEFT_INSIDE],
            "filled_pixels": filled,
            "unfilled_pixels": found[LEFT_INSIDE],
            "sweeps": sweeps,
            "filled_first_sweep": first,
        }

    def _mark(self, placed: tuple[Any, ...], source: cl.Buffer, events: Events) -> list[int]:
        """List all missing pixels."""
        chunks, head = (-(-self.columns // CHUNK), self.rows), (self.camera, self.valid)
        self._launch("find_spans", events, (self.lines,), LINES, *head, self.spans, self.grown)
        args = (*placed, self.spans, self.status, source, self.counters, *self._depths())
        self._launch("mark_missing", events, chunks, (1, *LINES), *args)
        return self._found()

    def _depths(self) -> tuple[cl.Buffer, ...]:
        """What the bound on the depth of neighbors is made from, and kept in."""
        return (self.w, *self.far) if self.is_far else ()

    def _sweep(self, source: cl.Buffer, count: int, wins: np.int32, minimum: np.int32, events: Events) -> None:
        """Fill what can be filled of a list of `count` missing pixels; wins: of the median, by count of neighbors."""
        seen = () if self.object is None else (self.object,)
        planes = (*self.far, self.valid, self.value, self.w, self.coc, self.status, *seen)
        head = (self.camera, source, np.int32(count))
        if self.interpolates:
            rule = (minimum,) if self.is_far else ()
            self._launch("fill_ait", events, (count,), LISTED, *head, *rule, *planes)
        else:
            vectors = (-(-count // LANES),)
            self._launch("fill_mean_median", events, vectors, LINES, *head, wins, minimum, *planes)

    def _settle(
        self, placed: tuple[Any, ...], source: cl.Buffer, left: cl.Buffer, count: int, events: Events
    ) -> list[int]:
        """End a sweep over the list `source`; lists in `left` what is missing now."""
        cl.enqueue_fill_buffer(self.session.queue, self.counters, ZERO, 0, 4 * DONE)
        lines = (self.spans, self.grown)
        args = (self.camera, source, np.int32(count), *lines, self.status, self.valid, left, self.counters)
        done = (self.done,) if self.smooths else ()
        self._launch("settle_sweep", events, (-(-count // CHUNK),), LINES, *args, *done)
        grown = (*placed, *lines, self.status, left, self.counters, *self._depths())
        self._launch("mark_grown", events, (self.lines,), LISTED, *grown)
        return self._found()

    def _score(self, brightest: float, events: Events) -> int:
        """For which counts of neighbors the median is the better estimator: bit k for k of them."""
        scale = score_scale(brightest)
        args = (self.camera, np.float32(scale), self.value, self.valid, self.sums)
        self._launch("score_mean_median", events, (self.scored,), OWNERS, *args)
        score = score_of_sums(download(self.session, self.sums, (self.scored, SUMS), np.int64), scale)
        return bits_of(score.median_wins())

    def _smooth(self, count: int, events: Events) -> None:
        """Rounds of the median over the filled pixels, to and fro between two sets of planes."""
        here, there = (self.value, self.w), (self.other_value, self.other_w)
        for source, target in zip(here, there, strict=True):
            cl.enqueue_copy(self.session.queue, target, source, byte_count=source.size)
        vectors, head = (-(-count // LANES),), (self.camera, self.done, np.int32(count), *self.far, self.valid)
        for _ in range(CHAPTER5.smoothing_rounds):  # an even number: the last one writes to the first set
            self._launch("smooth_median", events, vectors, LINES, *head, *here, *there, self.coc)
            here, there = there, here

    def _found(self) -> list[int]:
        found: list[int] = download(self.session, self.counters, (COUNTERS,), np.int32).tolist()
        return found

    def _launch(self, name: str, events: Events, size: tuple[int, ...], local: tuple[int, ...], *args: Any) -> None:
        events.append((name, launch(self.session, kernel(self.program, name), size, local, *args)))


class ForwardWarp:
    """Owns the buffers of the forward warp for one plan on one device, and the pixels' inverse depth at rest.

    camera: camera_t of the plan; texture: float (textures, CHANNELS, rows, columns). Of every object of the scene:
    surfaces: as the textures show it, None for a depth map; maps: inverse depth (rows, columns) in 1/mm of a depth map,
    0 where nothing is, None for others; textures: number of its texture, by default its own. owned: the depth test
    without atomics, by default on processors; the same bits either way; brightest: largest radiance of the textures.
    Raises DeviceError, KernelError. Validated against `clsco.reference.reproject` and `clsco.reference.fill`.
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
        self.segments = plan.rows * -(-plan.columns // SEGMENT)
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
            chunks = (-(-plan.width // (SEGMENT if self.owned else 1)), plan.height)
            gaps = (self.camera, self.depth, self.winner, planes.valid)
            self._launch("reproject_gaps", events, chunks, (1, *LINES) if self.owned else PIXELS, *gaps)
        head = (self.camera, np.float32(weight), self.texture, self.moved, self.winner)
        several = (self.rest_surfaces, *self.object) if self.object else ()
        seen = () if planes.object is None else (planes.object,)
        out = (planes.value, planes.w, planes.coc, planes.valid, planes.status, *seen)
        self._per_pixel("reproject_gather", events, (plan.width, plan.height), *head, *several, *out)

    def note_radii(self, statistics: cl.Buffer, events: Events) -> None:
        """Keep the range of the radii that `warp` has found, largest and smallest, in the first two of these ints."""
        chunks = (-(-self.plan.width // (SEGMENT if self.owned else 1)), self.plan.height)
        found = (self.filler.coc, self.filler.valid, statistics)
        self._launch("note_radii", events, chunks, (1, *LINES) if self.owned else PIXELS, self.camera, *found)

    def truth(
        self, poses: Sequence[Pose], surfaces: Surfaces, wanted: Collection[str], events: Events
    ) -> dict[str, NDArray[Any]]:
        """What is wanted of these, float32 or as stated, (rows, columns[, channels]). Other arguments as for `warp`.

        "sharp": radiance after the move; "filled": uint8, as `Warped.status`. Of a scene with a depth map, at which no
        ray can be cast, also what is known of the pixels' surface, filled ones included: "depth" in mm, +inf for none,
        float64, for normals come from its differences; "coc" in px, 0 for none; "mask", bool; "object_id", int32, -1
        for none. These are the values of the source that came to the pixel, up to half a pixel from its center.
        """
        plan = self.plan
        names = {"sharp", "filled"} | ({"depth", "coc", "mask", "object_id"} if self.maps else set())
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
            found["coc"] = together(self._frame(warped.coc, wide), self.real).astype(np.float32)
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
