"""Host side of the forward warp: every pixel at rest to its place at one moment, holes filled."""

from __future__ import annotations

from dataclasses import dataclass
from math import comb
from typing import Any

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from clsco.device import Session
from clsco.layout import Real, Struct, pose_struct, structs, surface_struct
from clsco.motion import Pose
from clsco.plan import Plan
from clsco.program import build, download, empty, kernel, launch
from clsco.spread import PIXELS, Events
from clsco.surfaces import PlacedSurface

# As in the kernels.
SEGMENT = 64  # sources of a row that a work-item moves, with OWNED
COUNTERS = 6
SUMS = 7  # of a row
LEFT, LEFT_INSIDE, FILLED, FILLED_INSIDE, GROWN, DONE = range(COUNTERS)
CHUNK = 64  # pixels per work-item where it counts
LANES = 8  # elements that score_mean_median may read beyond the end
NO_WINNER = np.array(np.iinfo(np.int32).max, np.int32)
ZERO = np.array(0, np.int32)

# Bands of rows that reproject_nearest makes of the image: few, since each looks at all segments, but enough
# to share out.
BANDS_PER_CORE, SMALLEST_BAND = 8, 16
LISTED = (64,)  # local size of kernels with a work-item per source or per entry of a list
LINES = (8,)  # of those with a work-item per row, column or chunk
MINIMUM_COUNT, SMOOTHING_ROUNDS = 4, 20  # chapter 5

SHAPE_FEATURES = ("CHANNELS", "QUADRATIC", "LINEAR", "NAPPE", "BOUNDED")


@dataclass(frozen=True)
class Warped:
    """One moment on the device, on the padded grid (height, width); overwritten by the next one.

    value: float (CHANNELS, height, width), radiance times weight; coc: real, signed radius of the blur in px;
    valid: uchar, known or filled (elsewhere value and coc are 0); status: uchar, 0 known or not missing,
    1 filled, 2 left; counters: within the frame, the fields of `clsco.reference.fill.FillReport`.
    """

    value: cl.Buffer
    coc: cl.Buffer
    valid: cl.Buffer
    status: cl.Buffer
    counters: dict[str, int]


def forward_features(plan: Plan, owned: bool) -> dict[str, int]:
    """What reproject.cl and fill.cl are compiled for; owned: bands of the image without atomics, for CPUs."""
    fill = plan.scene.fill
    shape = {name: value for name, value in plan.features().items() if name in SHAPE_FEATURES}
    return shape | {
        "FILTER": 0,
        "SAMPLED": 0,
        "OWNED": int(owned),
        "FILL_AIT": int(fill.method == "ait"),
        "FILL_MEAN_MEDIAN": int(fill.method == "mean_median"),
        "DOMAIN_SURFACE": int(fill.domain == "surface"),
    }


def forward_bytes(plan: Plan, real: Real) -> int:
    """Bytes of the buffers that a `ForwardWarp` owns."""
    size, smooths = 8 if real == "double" else 4, plan.scene.fill.method == "mean_median"
    sets = 2 if smooths else 1
    per_pixel = sets * 4 * plan.channels + (sets + 1) * size + 3 * 4 + 2
    return plan.height * plan.width * per_pixel + plan.rows * plan.columns * 2 * size


def median_wins(sums: NDArray[np.floating[Any]]) -> int:
    """Bit k is set where the median of k neighbors has a smaller squared error than the mean.

    sums: (rows, 7) from score_mean_median. The binomial coefficients count subsets: see the kernel.
    """
    squared, squares, *medians = sums.astype(np.float64).sum(axis=0).tolist()
    wins = 0
    for k, median in zip(range(4, 9), medians, strict=True):
        mean_error = (comb(6, k - 2) * squared + comb(6, k - 1) * squares) / k**2
        median_error = median / (1 if k % 2 else 4)
        wins |= (median_error < mean_error) << k
    return wins


class ForwardWarp:
    """Owns the buffers of the forward warp for one plan on one device, and the pixels' inverse depth at rest.

    camera: camera_t of the plan; texture: float (CHANNELS, rows, columns); rest: the surface at rest; owned:
    the depth test without atomics, by default on processors; the same bits either way.
    Raises DeviceError, KernelError. Validated against `clsco.reference.reproject` and `clsco.reference.fill`.
    """

    def __init__(
        self,
        session: Session,
        plan: Plan,
        camera: Struct,
        texture: cl.Buffer,
        rest: PlacedSurface,
        real: Real,
        owned: bool | None = None,
    ) -> None:
        self.session, self.plan, self.camera, self.texture, self.real = session, plan, camera, texture, real
        self.item, self.method = plan.scene.objects[0], plan.scene.fill.method
        smooths = self.method == "mean_median"
        self.owned = session.device.kind == "cpu" if owned is None else owned
        features = forward_features(plan, self.owned)
        self.program = build(session, ["reproject.cl", "fill.cl"], features, structs(real), real)
        self.rest_surface = surface_struct(self.item, rest, real)
        self.dtype = np.dtype(np.float64 if real == "double" else np.float32)
        sources, pixels, size = plan.rows * plan.columns, plan.height * plan.width, self.dtype.itemsize
        self.rest, self.moved = empty(session, size * sources), empty(session, size * sources)
        # Targets and winners are of no use after the warp: the lists of missing pixels take their place.
        self.target, self.winner = empty(session, 4 * pixels), empty(session, 4 * pixels)
        self.segments = plan.rows * -(-plan.columns // SEGMENT)
        self.bounds = empty(session, 8 * self.segments if self.owned else 0)
        # Depths for the test with atomics, then the list of filled pixels.
        self.depth = empty(session, 4 * pixels if smooths or not self.owned else 0)
        self.value, self.w = self._planes(pixels, size)
        self.smooth_value, self.smooth_w = self._planes(pixels if smooths else 0, size)
        self.coc = empty(session, size * pixels)
        self.valid, self.status = empty(session, pixels + LANES), empty(session, pixels)
        self.spans = empty(session, 8 * (plan.height + plan.width))
        self.sums = empty(session, size * SUMS * plan.height if smooths else 0)
        self.counters = empty(session, 4 * COUNTERS)
        for buffer in (self.value, self.valid):  # so that nobody reads what nobody wrote, beyond the end
            cl.enqueue_fill_buffer(session.queue, buffer, np.array(0, np.uint8), 0, buffer.size)
        self._per_pixel("reproject_rest", [], (plan.columns, plan.rows), camera, self.rest_surface, self.rest)

    def warp(self, pose: Pose, surface: PlacedSurface, weight: float, events: Events) -> Warped:
        """The pixels at rest after the move to `pose`, with missing ones filled as the scene says.

        surface: the object in `pose`; weight: of this moment in the exposure; events: gets what was enqueued.
        """
        self._reproject(pose, weight, events)
        moved = surface_struct(self.item, surface, self.real)
        counters = self._fill(moved, events)
        return Warped(self.value, self.coc, self.valid, self.status, counters)

    def truth(self, pose: Pose, surface: PlacedSurface, events: Events) -> dict[str, NDArray[Any]]:
        """What the plan wants of these: "sharp", float32 (rows, columns[, channels]) radiance
        after the move, and "filled", uint8 (rows, columns), as `Warped.status`. Arguments as for `warp`."""
        plan, guard = self.plan, self.plan.guard_px
        if not {"sharp", "filled"} & set(plan.truth):
            return {}
        warped = self.warp(pose, surface, 1.0, events)
        frame = (..., slice(guard, guard + plan.rows), slice(guard, guard + plan.columns))
        found: dict[str, NDArray[Any]] = {}
        if "sharp" in plan.truth:
            shape = (plan.channels, plan.height, plan.width)
            planes = download(self.session, warped.value, shape, np.float32)[frame]
            image = planes[0] if plan.channels == 1 else np.moveaxis(planes, 0, -1)
            found["sharp"] = np.ascontiguousarray(image)
        if "filled" in plan.truth:
            status = download(self.session, warped.status, (plan.height, plan.width), np.uint8)
            found["filled"] = np.ascontiguousarray(status[frame])
        return found

    def _planes(self, pixels: int, size: int) -> tuple[cl.Buffer, cl.Buffer]:
        """Radiance and inverse depth of so many pixels."""
        channels = self.plan.channels
        return empty(self.session, 4 * (channels * pixels + LANES)), empty(self.session, size * pixels)

    def _reproject(self, pose: Pose, weight: float, events: Events) -> None:
        plan, camera = self.plan, self.camera
        args = (camera, self.rest_surface, pose_struct(pose, self.real), self.rest, self.target, self.moved)
        if self.owned:
            cores = self.session.device.compute_units
            band = max(SMALLEST_BAND, -(-plan.height // (BANDS_PER_CORE * cores)))
            self._launch("reproject_targets", events, (self.segments,), (8,), *args, self.bounds)
            owned = (camera, self.target, self.moved, self.bounds, np.int32(band), self.winner)
            self._launch("reproject_nearest", events, (-(-plan.height // band),), (1,), *owned)
        else:
            queue, sources = self.session.queue, (plan.rows * plan.columns,)
            cl.enqueue_fill_buffer(queue, self.depth, ZERO, 0, self.depth.size)
            cl.enqueue_fill_buffer(queue, self.winner, NO_WINNER, 0, self.winner.size)
            self._launch("reproject_targets", events, sources, LISTED, *args)
            tested = (camera, self.target, self.moved, self.depth)
            self._launch("reproject_depth", events, sources, LISTED, *tested)
            self._launch("reproject_winner", events, sources, LISTED, *tested, self.winner)
        head = (camera, np.float32(weight), self.texture, self.moved, self.winner)
        out = (self.value, self.w, self.coc, self.valid, self.status)
        self._per_pixel("reproject_gather", events, (plan.width, plan.height), *head, *out)

    def _fill(self, surface: Struct, events: Events) -> dict[str, int]:
        """Fill missing pixels sweep by sweep; returns the counts within the frame."""
        cl.enqueue_fill_buffer(self.session.queue, self.counters, ZERO, 0, self.counters.size)
        source, left = self.target, self.winner
        found = self._mark(surface, source, events)
        wins = self._score(events) if self.method == "mean_median" and found[LEFT] else 0
        sweeps = filled = first = 0
        minimum = MINIMUM_COUNT
        while self.method != "none" and found[LEFT]:
            found = self._sweep(source, left, found[LEFT], wins, minimum, events)
            source, left = left, source
            if found[FILLED]:
                sweeps, minimum = sweeps + 1, MINIMUM_COUNT
                filled += found[FILLED_INSIDE]
                first = first or filled
                if found[GROWN]:
                    found = self._mark(surface, source, events)
            elif self.method == "mean_median" and minimum > 1:
                minimum -= 1  # fewer neighbors will do where the filling would stall
            else:
                break
        if self.method == "mean_median" and found[DONE]:
            self._smooth(found[DONE], events)
        return {
            "missing_pixels": filled + found[LEFT_INSIDE],
            "filled_pixels": filled,
            "unfilled_pixels": found[LEFT_INSIDE],
            "sweeps": sweeps,
            "filled_first_sweep": first,
        }

    def _mark(self, surface: Struct, source: cl.Buffer, events: Events) -> list[int]:
        """List all missing pixels."""
        plan = self.plan
        self._clear()
        lines, chunks = (plan.height + plan.width,), (-(-plan.width // CHUNK), plan.height)
        self._launch("find_spans", events, lines, LINES, self.camera, self.valid, self.spans)
        args = (self.valid, self.spans, self.status, source, self.counters)
        self._launch("mark_missing", events, chunks, (1, *LINES), self.camera, surface, *args)
        return self._found()

    def _sweep(
        self, source: cl.Buffer, left: cl.Buffer, count: int, wins: int, minimum: int, events: Events
    ) -> list[int]:
        """Fill what can be filled of a list of missing pixels; lists the others in `left`."""
        self._clear()
        listed = (self.camera, source, np.int32(count))
        planes = (self.valid, self.value, self.w, self.coc, self.status)
        if self.method == "ait":
            self._launch("fill_ait", events, (count,), LISTED, *listed, *planes)
        else:
            rule = (np.int32(wins), np.int32(minimum))
            self._launch("fill_mean_median", events, (count,), LISTED, *listed, *rule, *planes)
        done = () if self.method == "ait" else (self.depth,)
        args = (self.spans, self.status, self.valid, left, self.counters)
        self._launch("settle_sweep", events, (-(-count // CHUNK),), LINES, *listed, *args, *done)
        return self._found()

    def _score(self, events: Events) -> int:
        """For which counts of neighbors the median is the better estimator, as bits."""
        rows = self.plan.height
        args = (self.camera, self.value, self.valid, self.sums)
        self._launch("score_mean_median", events, (rows,), (1,), *args)
        return median_wins(download(self.session, self.sums, (rows, SUMS), self.dtype))

    def _smooth(self, count: int, events: Events) -> None:
        """Rounds of the median over the filled pixels, to and fro between two sets of planes."""
        queue, here, there = self.session.queue, (self.value, self.w), (self.smooth_value, self.smooth_w)
        for source, target in zip(here, there, strict=True):
            cl.enqueue_copy(queue, target, source, byte_count=source.size)
        head = (self.camera, self.depth, np.int32(count), self.valid)
        for _ in range(SMOOTHING_ROUNDS):  # an even number: the last one writes to the first set
            self._launch("smooth_median", events, (count,), LISTED, *head, *here, *there, self.coc)
            here, there = there, here

    def _clear(self) -> None:
        """Counters of a sweep to 0."""
        cl.enqueue_fill_buffer(self.session.queue, self.counters, ZERO, 0, 4 * DONE)

    def _found(self) -> list[int]:
        found: list[int] = download(self.session, self.counters, (COUNTERS,), np.int32).tolist()
        return found

    def _per_pixel(self, name: str, events: Events, size: tuple[int, int], *args: Any) -> None:
        self._launch(name, events, size, PIXELS, *args)

    def _launch(
        self, name: str, events: Events, size: tuple[int, ...], local: tuple[int, ...], *args: Any
    ) -> None:
        events.append((name, launch(self.session, kernel(self.program, name), size, local, *args)))
