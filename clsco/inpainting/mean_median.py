"""Host side of mean/median filling of an image with a mask (thesis, chapter 5).

The device holds what is in and around holes only, so that work and memory of all stages but the scoring follow the
missing pixels, wherever they are; scoring passes over the image in bands of rows.
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
from numpy.typing import NDArray

from clsco.device import Program, Session
from clsco.estimators import Histogram, MeanMedian, Score, bits_of, border_histogram, score_of_sums, score_scale
from clsco.layout import frame_struct, structs
from clsco.program import build, download, empty, kernel, launch, upload

Mask = NDArray[np.bool_]
Floats = NDArray[np.float32]
Pixels = NDArray[np.int64]
Progress = Callable[[float], object]

KERNELS = ("score.cl", "holes.cl")
FEATURES = dict.fromkeys(("SEVERAL", "QUADRATIC", "LINEAR", "NAPPE", "BOUNDED", "FILTER", "SAMPLED"), 0)
FEATURES |= {"FILL_MEAN_MEDIAN": 1}
# As in the kernels.
LANES, SUMS, SCORED = 8, 13, 256
NEIGHBORS = ((0, -1), (0, 1), (-1, 0), (1, 0), (-1, -1), (1, 1), (-1, 1), (1, -1))
VECTORS, ENTRIES, OWNERS = (8,), (64,), (1,)  # local sizes of kernels with a work-item per vector, entry, or segment

BAND_VALUES = 2**21  # of the image that are scored or blended at once
ALIGNED = 32  # floats
MOST_ENTRIES = 4096  # of a sweep for a single work-group
GROUP = 128  # its size on a graphics card; a processor has one work-item, which does it in vectors
SHARES = {"score": 0.5, "fill": 0.2, "smooth": 0.2, "blend": 0.1}  # of the whole, for progress


@dataclass(eq=False)
class Stages:
    """What the stages have made of the missing pixels (M,), and of known ones beside them (B,); K channels.

    pixels, border: numbers in the order of rows; filled, smoothed: (M, K) after stages 1 and 2; gradients: (B,)
    Sobel's magnitude; blended: (B, K) medians, which those pixels take that have the `histogram`'s threshold; score:
    None where it was turned off, histogram: None without a border or where it was turned off; sweeps: those that have
    filled something; seconds: by stage.
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
        """Which of the border pixels (B,) take their median."""
        if self.histogram is None or self.histogram.threshold is None:
            return np.zeros(self.border.size, np.bool_)
        return self.gradients >= self.histogram.threshold


def fill_mean_median(
    session: Session, image: NDArray[Any], missing: Mask, span: float, constants: MeanMedian, progress: Progress
) -> Stages:
    """All stages of the thesis' method on an image with missing pixels.

    image: (rows, columns, K), codes or floats, of which those of missing pixels do not matter; missing: (rows,
    columns), some but not all; span: range of the values; progress: gets the share that is done, from 0 to 1.
    Takes 100 to 200 bytes per missing pixel and known one beside it, and 4 per pixel of the image.
    Raises DeviceError. Validated against `clsco.reference.holes`, bit by bit.
    """
    program = _program(session, image.shape[2])
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
        with stage("score") as tell:
            stages.score = score_image(session, program, image, missing, score_scale(span), tell)
        wins = np.int32(bits_of(stages.score.median_wins()))
    holes = Holes(session, program, layout, image)
    with stage("fill") as tell:
        stages.sweeps = holes.fill(wins, constants.minimum, tell)
        stages.filled = holes.values()
    with stage("smooth") as tell:
        stages.smoothed = (
            holes.smooth(constants.smoothing_rounds, tell) if constants.smoothing_rounds else stages.filled
        )
    del holes
    if layout.border.size and constants.border_share:
        with stage("blend") as tell:
            blend_border(session, program, layout.border, image, missing, stages, tell)
        stages.histogram = border_histogram(stages.gradients, span / 255, constants.border_share)
    return stages


@lru_cache(maxsize=8)  # of a small image, to read the files would take a tenth of the time
def _program(session: Session, channels: int) -> Program:
    return build(session, KERNELS, FEATURES | {"CHANNELS": channels}, structs("float"), "float")


class Layout:
    """The numbers of missing pixels (M of them), of known ones beside them (B), and of what is beyond the image.

    missing: (rows, columns). pixels, border: (M,) and (B,) numbers in the image, in the order of rows; nothing: M + B.
    """

    def __init__(self, missing: Mask) -> None:
        rows, columns = missing.shape
        self.columns = columns
        self.pixels, self.border = np.flatnonzero(missing), np.flatnonzero(beside(missing))
        self.nothing = self.pixels.size + self.border.size
        # With a frame around the image, so that all neighbors have a place.
        self.number = np.full((rows + 2) * (columns + 2), self.nothing, np.int32)
        self.number[self._place(self.pixels)] = np.arange(self.pixels.size)
        self.number[self._place(self.border)] = np.arange(self.pixels.size, self.nothing)

    def neighbors(self) -> NDArray[np.int32]:
        """Numbers (M, 8) of the neighbors of missing pixels, in the order of kernels."""
        at, found = self._place(self.pixels), np.empty((self.pixels.size, 8), np.int32)
        for k, (i, j) in enumerate(NEIGHBORS):
            found[:, k] = self.number[at + (i * (self.columns + 2) + j)]
        return found

    def _place(self, pixels: Pixels) -> Pixels:
        return pixels + 2 * (pixels // self.columns) + (self.columns + 3)


def beside(missing: Mask) -> Mask:
    """Known pixels (rows, columns) with a missing one among their eight neighbors."""
    wide = missing.copy()
    wide[:, 1:] |= missing[:, :-1]
    wide[:, :-1] |= missing[:, 1:]
    high = wide.copy()
    high[1:] |= wide[:-1]
    high[:-1] |= wide[1:]
    high &= ~missing
    return high


@dataclass(frozen=True, eq=False)
class Band:
    """Rows of an image from `top` to before `bottom`, with those beside them.

    above: the first row that there is; value: float32 (K, count, columns) and LANES more, finite where pixels are
    missing; overwritten by the next band.
    """

    top: int
    bottom: int
    above: int
    value: Floats
    missing: Mask

    @property
    def count(self) -> int:
        """Rows that there are."""
        return self.missing.shape[0]


def bands(image: NDArray[Any], missing: Mask, wanted: Mask) -> Iterator[Band]:
    """The bands of an image (rows, columns, K) with any wanted row (rows,)."""
    rows, columns, channels = image.shape
    step = max(1, BAND_VALUES // (columns * channels))
    room = np.zeros(channels * columns * min(step + 2, rows) + LANES + ALIGNED, np.float32)
    room = room[-room.ctypes.data // 4 % ALIGNED :]  # processors then work in it, without a copy
    for top in range(0, rows, step):
        bottom = min(top + step, rows)
        if not wanted[top:bottom].any():
            continue
        part = slice(max(top - 1, 0), min(bottom + 1, rows))
        size = (part.stop - part.start) * columns
        value = room[: channels * size + LANES]
        planes = value[: channels * size].reshape(channels, -1, columns)
        for k in range(channels):
            planes[k] = image[part, :, k]
        if image.dtype.kind == "f":
            planes[:, missing[part]] = 0  # that may be no number
        yield Band(top, bottom, part.start, value, missing[part])


def score_image(
    session: Session, program: Program, image: NDArray[Any], missing: Mask, scale: float, progress: Progress
) -> Score:
    """Stage 0; arguments as of `fill_mean_median`."""
    rows, columns, _ = image.shape
    segments, found = -(-columns // SCORED), [np.zeros((1, SUMS), np.int64)]
    for band in bands(image, missing, np.ones(rows, np.bool_)):
        valid = np.concatenate([~band.missing.ravel(), np.zeros(LANES, np.bool_)])
        camera, count = frame_struct(band.count, columns, 0, "float"), band.count * segments
        sums, buffers = empty(session, 8 * SUMS * count), (upload(session, band.value), upload(session, valid))
        launch(
            session, kernel(program, "score_mean_median"), (count,), OWNERS, camera, np.float32(scale), *buffers, sums
        )
        found.append(download(session, sums, (count, SUMS), np.int64).sum(axis=0, keepdims=True))
        progress(band.bottom / rows)
    return score_of_sums(np.concatenate(found), scale)


class Holes:
    """Owns what the device holds of holes, as holes.cl has it, and fills them."""

    def __init__(self, session: Session, program: Program, layout: Layout, image: NDArray[Any]) -> None:
        self.session, self.program, channels = session, program, image.shape[2]
        self.missing, self.slots, self.channels = layout.pixels.size, np.int32(layout.nothing + 1), channels
        around = layout.neighbors()
        self.near = ((around >= self.missing) & (around < layout.nothing)).sum(axis=1, dtype=np.int32)
        self.neighbors, self.runs = (upload(session, around), np.int32(self.missing)), upload(session, runs(around))
        values, valid = np.zeros((channels, layout.nothing + 1), np.float32), np.zeros(layout.nothing + 1, np.uint8)
        values[:, self.missing : layout.nothing] = image.reshape(-1, channels)[layout.border].T
        valid[self.missing : layout.nothing] = 1
        self.value, self.valid = self._writable(values), self._writable(valid)

    def fill(self, wins: np.int32, minimum: int, progress: Progress) -> int:
        """Stage 1; returns the number of sweeps. wins: bit k where the median is taken of k neighbors.

        Short sweeps run one after another on the device, long ones are launched one by one.
        """
        queue, level = self.session.queue, np.minimum(self.near, minimum)
        state = np.zeros((minimum + 1, 2), np.int32)
        lists = empty(self.session, 4 * self.missing * minimum)
        for k in range(1, minimum + 1):
            entries = np.flatnonzero(level == k).astype(np.int32)
            state[k, 1] = entries.size
            cl.enqueue_copy(queue, lists, entries, dst_offset=4 * self.missing * (k - 1))
        near, on_device = self._writable(self.near), self._writable(state)
        rule, group = (*self.neighbors, np.int32(minimum), self.valid), self._group()
        while (open_lists := np.flatnonzero(state[1:, 0] < state[1:, 1])).size:
            k = int(open_lists[-1]) + 1
            begin, end = state[k].tolist()
            if end - begin <= MOST_ENTRIES:
                most, planes = np.int32(MOST_ENTRIES), (self.value, near, lists, on_device)
                self._launch("sweep_holes", *group, self.slots, most, wins, *rule, *planes)
            else:
                part = [np.int32(self.missing * (k - 1) + n) for n in (begin, end)]
                planes = (lists, self.neighbors[0], self.valid, self.value)
                self._launch("fill_holes", -(-(end - begin) // LANES), VECTORS, self.slots, *part, wins, *planes)
                self._launch("settle_holes", end - begin, ENTRIES, *part, *rule, near, lists, on_device)
            found = download(self.session, on_device, state.shape, np.int32)
            if end - begin > MOST_ENTRIES:
                found[k, 0] = end
                found[0, 0] += found[0, 1] > state[0, 1]
                cl.enqueue_copy(queue, on_device, found)
            state = found
            progress(state[0, 1] / self.missing)
        return int(state[0, 0])

    def _group(self) -> tuple[int, tuple[int]]:
        """Size of the work-group of sweep_holes, twice."""
        device = self.session.device
        size = 1 if device.kind == "cpu" else min(GROUP, device.max_work_group)
        return size, (size,)

    def smooth(self, rounds: int, progress: Progress) -> Floats:
        """Stage 2, to and fro between two sets of values; returns those of missing pixels."""
        here, there = self.value, empty(self.session, self.value.size)
        cl.enqueue_copy(self.session.queue, there, here)
        for n in range(rounds):
            vectors = -(-self.missing // LANES)
            self._launch(
                "smooth_holes", vectors, VECTORS, self.slots, *self.neighbors, self.runs, self.valid, here, there
            )
            here, there = there, here
            self.session.queue.flush()
            progress((n + 1) / rounds)
        self.value = here
        return self.values()

    def values(self) -> Floats:
        """What missing pixels have now, (M, K)."""
        planes: Floats = download(self.session, self.value, (self.channels, int(self.slots)), np.float32)
        return np.ascontiguousarray(planes[:, : self.missing].T)

    def _writable(self, array: NDArray[Any]) -> cl.Buffer:
        buffer = empty(self.session, array.nbytes)
        cl.enqueue_copy(self.session.queue, buffer, array)
        return buffer

    def _launch(self, name: str, size: int, local: tuple[int, ...], *args: Any) -> None:
        launch(self.session, kernel(self.program, name), (size,), local, *args)


def runs(around: NDArray[np.int32]) -> NDArray[np.uint8]:
    """Bits for each LANES pixels: bit k where their neighbors (M, 8) k are numbered one after another."""
    vectors = around[: len(around) // LANES * LANES].reshape(-1, LANES, 8)
    follows = (vectors[:, 1:] == vectors[:, :-1] + 1).all(axis=1)
    return np.append(np.packbits(follows, axis=1, bitorder="little"), np.uint8(0))


def blend_border(
    session: Session, program: Program, border: Pixels, image: NDArray[Any], missing: Mask, stages: Stages,
    progress: Progress,
) -> None:  # fmt: skip
    """Stage 3 of all border pixels: their gradients and medians, for the threshold to choose among."""
    rows, columns, channels = image.shape
    stages.gradients = np.empty(border.size, np.float64)
    stages.blended = np.empty((border.size, channels), np.float32)
    wanted = np.zeros(rows, np.bool_)
    wanted[border // columns] = True
    for band in bands(image, missing, wanted):
        before, size = band.above * columns, band.count * columns
        planes = band.value[: channels * size].reshape(channels, size)
        holes = slice(*np.searchsorted(stages.pixels, (before, before + size)))
        planes[:, stages.pixels[holes] - before] = stages.smoothed[holes].T
        some = slice(*np.searchsorted(border, (band.top * columns, band.bottom * columns)))
        entries = (border[some] - before).astype(np.int32)
        count, camera = entries.size, frame_struct(band.count, columns, 0, "float")
        steepness, blended = empty(session, 4 * count), empty(session, 4 * count * channels)
        args = (upload(session, entries), np.int32(count), upload(session, band.value), steepness, blended)
        launch(session, kernel(program, "blend_border"), (-(-count // LANES),), VECTORS, camera, *args)
        stages.gradients[some] = np.sqrt(download(session, steepness, (count,), np.float32).astype(np.float64))
        stages.blended[some] = download(session, blended, (channels, count), np.float32).T
        progress(band.bottom / rows)
