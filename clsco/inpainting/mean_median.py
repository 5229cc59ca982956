"""Host side of mean/median filling of an image with a mask (thesis, chapter 5).

The device holds only pixels in and around holes, so work and memory of all stages except scoring depend only on the
number of missing pixels; scoring processes the image in bands of rows.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import lru_cache
from time import perf_counter
from typing import Any

import numpy as np
import pyopencl as cl
from numpy.typing import DTypeLike, NDArray

from clsco.constants import CODE_LANES, FILL_LANES, SCORE_SUMS, SCORED_COLUMNS
from clsco.inpainting.rules import (
    Histogram,
    MeanMedian,
    Score,
    bits_of,
    border_histogram,
    most_sweeps,
    score_of_sums,
    score_scale,
)
from clsco.opencl.buffers import copied, download, download_into, empty, upload
from clsco.opencl.program import Target, launch
from clsco.opencl.session import Session
from clsco.records import Struct, filled

Mask = NDArray[np.bool_]
Floats = NDArray[np.float32]
Pixels = NDArray[np.int64]
Progress = Callable[[float], object]

KERNELS = ("inpainting/score.cl", "inpainting/mean_median.cl")
MANY = 9  # number of neighbors stored for pixels that are not missing, more than the possible 8
VECTORS, OWNERS = (8,), (1,)  # local sizes of kernels with a work-item per vector, or per segment
ENTRIES = 64  # largest local size of kernels with a work-item per entry of a list

BAND_VALUES = 2**21  # number of values of the image that are scored or blended at once
ALIGNED = 128  # alignment in bytes
MOST_ENTRIES = 2**14  # largest number of pixels in a sweep that a single work-group processes
NEVER = 2**31 - 1  # limit of sweeps that is never reached
MOST_VECTORS = 2**13  # largest number of vectors, over all channels, that one work-item of a processor smooths alone
GROUP = 128  # work-group size of a sweep on a graphics card; on a processor it is one work-item, which uses vectors
FEWEST = 4  # least number of consecutive pixels that are smoothed as a run
SHARES = {"score": 0.5, "fill": 0.2, "smooth": 0.2, "blend": 0.1}  # share of each stage in the progress


@dataclass(eq=False)
class Stages:
    """Results of the stages, for M missing pixels, B border pixels (the known pixels beside holes), and K channels.

    pixels, border: pixel numbers (M,) and (B,), row by row; filled, smoothed: (M, K) values after stages 1 and 2;
    gradients: (B,) magnitude by Sobel's operator; blended: (B, K) medians, which replace border pixels whose gradient
    reaches the threshold of `histogram`; score: None unless the estimator is "scored"; histogram: None without border
    pixels or if `border_share` is 0; sweeps: number of sweeps that filled pixels; seconds: duration by stage.
    """

    pixels: Pixels
    border: Pixels
    filled: Floats = field(init=False)
    smoothed: Floats = field(init=False)
    gradients: NDArray[np.float64] = field(init=False)
    blended: Floats = field(init=False)
    score: Score | None = None
    histogram: Histogram | None = None
    sweeps: int = 0
    seconds: dict[str, float] = field(default_factory=dict)

    @property
    def is_blended(self) -> Mask:
        """Mask (B,) of the border pixels that are replaced by their median."""
        if self.histogram is None or self.histogram.threshold is None:
            return np.zeros(self.border.size, np.bool_)
        return self.gradients >= self.histogram.threshold


def fill_mean_median(
    session: Session, image: NDArray[Any], missing: Mask, span: float, constants: MeanMedian, progress: Progress
) -> Stages:
    """Run all stages of the thesis' method on an image with missing pixels.

    image: (rows, columns, K), codes or floats; values of missing pixels are ignored; missing: (rows, columns), some but
    not all True; span: range of the values; progress: called with the fraction done, from 0 to 1. Takes 100 to 200
    bytes per missing pixel and per known pixel beside it, and up to 8 per pixel of the image. Raises DeviceError.
    """
    target = _target(session, image.shape[2], image.dtype == np.uint8)
    layout = Layout(missing)
    stages = Stages(layout.pixels, layout.border)
    stages.gradients, stages.blended = np.empty(0), np.empty((layout.border.size, image.shape[2]), np.float32)
    done = 0.0

    @contextmanager
    def stage(name: str) -> Iterator[Progress]:
        nonlocal done
        before = perf_counter()
        yield lambda share: progress(done + SHARES[name] * share)
        stages.seconds[name] = perf_counter() - before
        done += SHARES[name]
        progress(done)

    wins = np.int32(bits_of(Score((0,) * 9, (0,) * 9, 0, 1.0).median_wins(constants.estimator)))
    if constants.estimator == "scored":
        with stage("score") as reported:
            stages.score = score_image(session, target, image, missing, score_scale(span), reported)
        wins = np.int32(bits_of(stages.score.median_wins()))
    holes = Holes(session, target, layout, image)
    with stage("fill") as reported:
        stages.sweeps = holes.fill(wins, constants.minimum, most_sweeps(*missing.shape), reported)
        stages.filled = holes.values()
    with stage("smooth") as reported:
        rounds = constants.smoothing_rounds
        stages.smoothed = holes.smooth(rounds, reported) if rounds else stages.filled
    del holes
    if layout.border.size and constants.border_share:
        with stage("blend") as reported:
            blend_border(session, target, image, missing, stages, reported)
        stages.histogram = border_histogram(stages.gradients, span / 255, constants.border_share)
    return stages


@lru_cache(maxsize=8)  # reading the files would take a tenth of the time for a small image
def _target(session: Session, channels: int, codes: bool) -> Target:
    features = {"CHANNELS": channels, "CODES": codes, "ALONE": group_size(session) == 1}
    features |= {"FILL_MEAN_MEDIAN": True, "IMAGE": True}
    return Target(session, KERNELS, features, "float")


def group_size(session: Session) -> int:
    """Work-group size of the kernel `sweep_holes`."""
    return 1 if session.device.kind == "cpu" else min(GROUP, session.device.max_work_group)


class Layout:
    """Numbering of M missing pixels and their neighbors: B known pixels, and a border of 1 px around the image.

    missing: (rows, columns). pixels, border: flat indices in the image of the missing (M,) and the known pixels (B,);
    slots: count of numbers, which are assigned row by row; at: (M,) number of each missing pixel; beside: (M, 2)
    numbers of the pixels above and below it.
    """

    def __init__(self, missing: Mask) -> None:
        self.pixels = np.flatnonzero(missing)
        around = dilated(np.pad(missing, 1))
        self.border = np.flatnonzero(around[1:-1, 1:-1] & ~missing)
        self.shape, places = around.shape, np.flatnonzero(around)
        self.slots = places.size
        self._number = np.empty(around.size, np.int32)
        self._number[places] = np.arange(self.slots, dtype=np.int32)
        self._framed_pixels = self._framed(self.pixels)
        above, self.at, below = (self._number.take(self._framed_pixels + n * self.shape[1]) for n in (-1, 0, 1))
        self.beside = np.stack([above, below], axis=1)

    def on_border(self) -> NDArray[np.int64]:
        """Numbers (B,) of the known pixels beside holes."""
        return self._number.take(self._framed(self.border)).astype(np.int64)

    def near(self) -> NDArray[np.int32]:
        """Number of known neighbors (M,) of each missing pixel."""
        known = np.zeros(self.shape, np.uint8)
        known.ravel()[self._framed(self.border)] = 1
        for axis in (0, 1):
            line = np.moveaxis(known, axis, 0)
            line[1:-1] = line[:-2] + line[1:-1] + line[2:]
        return known.ravel().take(self._framed_pixels).astype(np.int32)

    def _framed(self, pixels: Pixels) -> Pixels:
        """Flat indices in the image with its border of 1 px, from flat indices in the image."""
        columns = self.shape[1] - 2
        return pixels + 2 * (pixels // columns) + (columns + 3)


def dilated(missing: Mask) -> Mask:
    """Mask (rows, columns) of missing pixels and their eight neighbors."""
    wide = missing.copy()
    wide[:, 1:] |= missing[:, :-1]
    wide[:, :-1] |= missing[:, 1:]
    high = wide.copy()
    high[1:] |= wide[:-1]
    high[:-1] |= wide[1:]
    return high


@dataclass(frozen=True, eq=False)
class Band:
    """Rows of an image from `top` to `bottom` - 1, and the rows directly above and below them.

    above: number of the first row in the band, which is `top` or the row above it; value: flat array of (count,
    columns, K) values, finite at missing pixels, and of CODE_LANES more pixels. The next band overwrites it. missing:
    (count, columns).
    """

    top: int
    bottom: int
    above: int
    value: NDArray[Any]
    missing: Mask

    @property
    def count(self) -> int:
        return self.missing.shape[0]


def bands(image: NDArray[Any], missing: Mask, wanted: Mask, dtype: DTypeLike) -> Iterator[Band]:
    """Bands of an image (rows, columns, K) that have any row with `wanted` (rows,) True, converted to `dtype`."""
    rows, columns, channels = image.shape
    step, most = max(1, BAND_VALUES // (columns * channels)), CODE_LANES * channels
    room = np.zeros(channels * columns * min(step + 2, rows) + most + ALIGNED, dtype)
    room = room[-room.ctypes.data % ALIGNED // room.itemsize :]  # aligned, so that processors read it without a copy
    for top in range(0, rows, step):
        bottom = min(top + step, rows)
        if not wanted[top:bottom].any():
            continue
        part = slice(max(top - 1, 0), min(bottom + 1, rows))
        pixels = room[: (part.stop - part.start) * columns * channels].reshape(-1, columns, channels)
        pixels[...] = image[part]
        if image.dtype.kind == "f":
            pixels[missing[part]] = 0  # values of missing pixels may be NaN
        yield Band(top, bottom, part.start, room[: pixels.size + most], missing[part])


def score_image(
    session: Session, target: Target, image: NDArray[Any], missing: Mask, scale: float, progress: Progress
) -> Score:
    """Stage 0: score mean and median; scale: from `score_scale`; other arguments as for `fill_mean_median`."""
    rows, columns, _ = image.shape
    segments, found = -(-columns // SCORED_COLUMNS), [np.zeros((1, SCORE_SUMS), np.int64)]
    for band in bands(image, missing, np.ones(rows, np.bool_), np.uint8 if image.dtype == np.uint8 else np.float32):
        valid = np.concatenate([~band.missing.ravel(), np.zeros(CODE_LANES, np.bool_)])
        grid, count = _grid(band.count, columns), band.count * segments
        sums, buffers = empty(session, 8 * SCORE_SUMS * count), (upload(session, band.value), upload(session, valid))
        launch(session, target["score_mean_median"], (count,), OWNERS, grid, np.float32(scale), *buffers, sums)
        found.append(download(session, sums, (count, SCORE_SUMS), np.int64).sum(axis=0, keepdims=True))
        progress(band.bottom / rows)
    return score_of_sums(np.concatenate(found), scale)


class Holes:
    """Fills the holes of an image; owns the buffers on the device, laid out as in mean_median.cl."""

    def __init__(self, session: Session, target: Target, layout: Layout, image: NDArray[Any]) -> None:
        self.session, self.target, self.channels = session, target, image.shape[2]
        self.at, self.index = layout.at, layout.at.astype(np.int64)  # NumPy is faster with its index type
        self.slots, self.missing = np.int32(layout.slots + FILL_LANES), np.int32(layout.at.size)
        self.level = layout.near()
        near, beside = np.full(layout.slots, MANY, np.int32), np.zeros((layout.slots, 2), np.int32)
        near[self.index], beside[self.index] = self.level, layout.beside
        values = np.full((self.channels, self.slots), np.inf, np.float32)
        border, known = layout.on_border(), image.reshape(-1, self.channels).take(layout.border, axis=0)
        for k in range(self.channels):
            values[k, border] = known[:, k]
        self.near, self.beside = copied(self.session, near), upload(session, beside)
        self.value, self.found = copied(self.session, values), copied(self.session, values)

    def fill(self, wins: np.int32, minimum: int, limit: int, progress: Progress) -> int:
        """Stage 1: fill all missing pixels; returns the number of sweeps.

        wins: integer whose bit k is set if the median is used for pixels with k known neighbors; minimum: number of
        known neighbors that a pixel needs; limit: number of sweeps after which a single neighbor is enough.
        """
        state = self._sweep(wins, minimum, limit, self.level, np.zeros(2, np.int32), progress)
        if state[1] < self.missing:
            near = download(self.session, self.near, (int(self.slots) - FILL_LANES,), np.int32)[self.index]
            left = np.where(np.isinf(self.values()[:, 0]), near, 0)
            state = self._sweep(wins, 1, NEVER, left, state, progress)
        return int(state[0])

    def _sweep(
        self, wins: np.int32, minimum: int, limit: int, level: NDArray[np.int32], before: NDArray[np.int32],
        progress: Progress,
    ) -> NDArray[np.int32]:  # fmt: skip
        """Fill in sweeps, at most `limit`, until no pixel is missing; return the counts of sweeps and of filled pixels.

        level: (M,) number of valid neighbors of each missing pixel, 0 if filled; before: counts of sweeps and filled
        pixels so far. Short sweeps follow each other on the device, long sweeps are launched one by one.
        """
        queue, count, group = self.session.queue, int(self.missing), group_size(self.session)
        lists, state = self._lists(np.minimum(level, minimum), minimum)
        state[0] = before
        on_device = copied(self.session, state)
        rule = (self.beside, self.missing, np.int32(minimum), self.found, self.value, self.near, lists, on_device)
        while state[0, 0] < limit and (open_lists := np.flatnonzero(state[1:, 0] < state[1:, 1])).size:
            k = int(open_lists[-1]) + 1
            begin, end = state[k].tolist()
            if end - begin <= MOST_ENTRIES:
                limits = np.int32(MOST_ENTRIES), np.int32(limit)
                self._launch("sweep_holes", group, (group,), self.slots, *limits, wins, *rule)
            else:
                part = (self.slots, *(np.int32(count * (k - 1) + n) for n in (begin, end)))
                planes = (lists, self.beside, self.value, self.found)
                self._launch("fill_holes", -(-(end - begin) // FILL_LANES), VECTORS, *part, wins, *planes)
                items = end - begin if group > 1 else 1
                self._launch("settle_holes", items, (min(group, ENTRIES),), *part, *rule)
            found = download(self.session, on_device, state.shape, np.int32)
            if end - begin > MOST_ENTRIES:
                found[k, 0] = end
                found[0, 0] += found[0, 1] > state[0, 1]
                cl.enqueue_copy(queue, on_device, found)
            state = found
            progress(state[0, 1] / count)
        return state[0]

    def _lists(self, level: NDArray[np.int32], minimum: int) -> tuple[cl.Buffer, NDArray[np.int32]]:
        """Lists and state of mean_median.cl before a sweep.

        level: (M,), number of known neighbors of each pixel, at most `minimum`, 0 if it is filled.
        """
        state = np.zeros((minimum + 1, 2), np.int32)
        lists = np.empty((minimum, self.at.size), np.int32)
        for k in range(1, minimum + 1):
            entries = self.at[level == k]
            state[k, 1] = entries.size
            lists[k - 1, : entries.size] = entries
        return copied(self.session, lists), state

    def smooth(self, rounds: int, progress: Progress) -> Floats:
        """Stage 2: smooth the missing pixels by rounds of the median, in two alternating buffers; return the values."""
        run, single, alone = parts(self.at, self.level == 8)
        buffers = (upload(self.session, run), np.int32(len(run)), upload(self.session, single))
        items = len(run) + -(-single.size // FILL_LANES)
        # A single work-item needs no barrier between rounds, and for few pixels is faster than a launch per round.
        by_one = rounds > 1 and group_size(self.session) == 1 and items * self.channels <= MOST_VECTORS
        at_once = rounds if by_one else 1
        for n in range(0, rounds, at_once):
            # Pixels whose neighbors are all known have equal values in both buffers after two rounds.
            singles = np.int32(single.size - (alone if n > 1 else 0))
            size, planes = ((1, OWNERS) if by_one else (items, VECTORS)), (self.beside, self.value, self.found)
            self._launch("smooth_holes", *size, self.slots, np.int32(at_once), *buffers, singles, *planes)
            if at_once % 2:
                self.value, self.found = self.found, self.value
            self.session.queue.flush()
            progress((n + at_once) / rounds)
        return self.values()

    def values(self) -> Floats:
        """Current values of missing pixels, (M, K)."""
        shape = (self.channels, int(self.slots))
        planes: Floats = download(self.session, self.value, shape, np.float32)
        return np.stack([plane.take(self.index) for plane in planes], axis=1)

    def _launch(self, name: str, size: int, local: tuple[int, ...], *args: Any) -> None:
        launch(self.session, self.target[name], (size,), local, *args)


def parts(at: NDArray[np.int32], alone: Mask) -> tuple[NDArray[np.int32], NDArray[np.int32], int]:
    """Runs of missing pixels, and single missing pixels, in the form that the kernel smooth_holes reads.

    at: (M,), numbers of the missing pixels; alone: (M,), mask of those whose eight neighbors are all known. Returns
    first numbers and lengths of runs (R, 2), numbers of single pixels (S,), and how many of the single pixels are
    `alone`; these are last.
    """
    starts = np.flatnonzero(np.diff(at, prepend=-2) != 1)
    within = np.arange(at.size) - np.repeat(starts, np.diff(starts, append=at.size))
    first = np.flatnonzero(within % FILL_LANES == 0)
    counts = np.diff(first, append=at.size)
    runs = counts >= FEWEST
    single = np.repeat(~runs, counts)
    some = [at[single & ~alone], at[single & alone]]
    return np.stack([at[first[runs]], counts[runs].astype(np.int32)], axis=1), np.concatenate(some), some[1].size


def blend_border(
    session: Session, target: Target, image: NDArray[Any], missing: Mask, stages: Stages, progress: Progress
) -> None:
    """Stage 3: write gradients and medians of all border pixels to `stages`; a threshold later selects from them."""
    (rows, columns, channels), border = image.shape, stages.border
    stages.gradients, stages.blended = np.empty(border.size), np.empty((border.size, channels), np.float32)
    for band in bands(image, missing, np.isin(np.arange(rows), border // columns), np.float32):
        before, size = band.above * columns, band.count * columns
        planes = band.value[: channels * size].reshape(size, channels)
        holes = slice(*np.searchsorted(stages.pixels, (before, before + size)))
        planes[stages.pixels[holes] - before] = stages.smoothed[holes]
        some = slice(*np.searchsorted(border, (band.top * columns, band.bottom * columns)))
        entries = (border[some] - before).astype(np.int32)
        count, grid = entries.size, _grid(band.count, columns)
        steepness, blended = empty(session, 4 * count), empty(session, 4 * count * channels)
        args = (upload(session, entries), np.int32(count), upload(session, band.value), steepness, blended)
        launch(session, target["blend_border"], (-(-count // FILL_LANES),), VECTORS, grid, *args)
        stages.gradients[some] = np.sqrt(download(session, steepness, (count,), np.float32).astype(np.float64))
        download_into(session, blended, stages.blended[some])
        progress(band.bottom / rows)


def _grid(rows: int, columns: int) -> Struct:
    """`grid_t` of an image without a guard band."""
    return filled("grid_t", "float", {"columns": columns, "width": columns, "rows": rows, "height": rows})
