"""Exposure of a frame: its time samples, and their weights in every row (float64, pure).

Shutter curves, and lines (rows or columns) that are exposed one after another, affect only `frame_exposure`: rendering,
predictions and reports take times and weights from it. A curve is sampled at the middles of equal intervals of the
exposure, weighted by the light of each interval: with one or more samples per px of motion, this is more accurate than
intervals of equal light. If keyframes make an object jump while the shutter is open, an interval ends at the jump;
intervals between two jumps are equal.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from math import ceil
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.scene.model import Scene, Sequence
from clsco.scene.sequence import CURVES, ShutterCurve

Array = NDArray[np.float64]
PREDICTED_TIMES = 33  # largest number of `sequence_times`
AT_AN_END = 1e-9  # fraction of an exposure: a jump this near to one of its ends counts as outside


@dataclass(frozen=True, eq=False)
class Exposure:
    """Time samples of a frame, and the weights of their blurred images.

    times: (samples,), s since the reference pose. weights: (samples,) for the whole frame, or (samples, lines), whose
    sum over the samples is 1 for each line. by_columns: True if lines are columns, not rows.
    """

    times: Array
    weights: Array
    by_columns: bool = False

    @property
    def is_one_image(self) -> bool:
        """True if the frame is the image of a single time sample, of weight 1."""
        return len(self.times) == 1 and bool((self.weights == 1.0).all())

    def line_weights(self, lines: int) -> Array:
        """Weights (samples, lines) of a frame with this number of lines."""
        return np.broadcast_to(self.weights.reshape(len(self.times), -1), (len(self.times), lines))


def frame_exposure(scene: Scene, frame: int, samples: int) -> Exposure:
    """Exposure of a frame: one time sample in the reference pose if nothing moves.

    samples: number N of time samples while a line of the frame is exposed. "midpoint": t = (i + 1/2) T / N after the
    shutter opens; "endpoint": t = (i + 1) T / N, as in the thesis, which displaces the image by half an interval. The
    weight of a time sample is the integral of the shutter curve over its interval of the exposure, for each line.
    """
    if not scene.moves:
        return Exposure(np.zeros(1), np.ones(1))
    sequence = scene.sequence
    if sequence.rolls:
        return _rolling_exposure(scene, frame, samples)
    span = shutter_span(sequence, frame)
    if sequence.sampling == "midpoint" and (jumps := jump_times(scene, frame)).size:
        ends = share_ends((0.0, 1.0), (jumps - span[0]) / sequence.shutter, subframes_of(scene, samples))
        times = span[0] + 0.5 * sequence.shutter * (ends[1:] + ends[:-1])
        return Exposure(times, _differences(curve_integral(sequence.shutter_curve, ends)))
    samples = subframes_of(scene, samples)
    steps = np.arange(samples, dtype=np.float64) + (0.5 if sequence.sampling == "midpoint" else 1.0)
    times = span[0] + steps * (sequence.shutter / samples)
    if sequence.shutter_curve == "box":
        return Exposure(times, np.full(samples, 1.0 / samples))
    return Exposure(times, _differences(curve_integral(sequence.shutter_curve, np.linspace(0.0, 1.0, samples + 1))))


def _rolling_exposure(scene: Scene, frame: int, samples: int) -> Exposure:
    """Exposure of a frame whose lines are exposed one after another.

    Lines that are open at the same time share their time samples, which divide the frame's whole exposure into equal
    intervals of at most shutter / samples; if no lines overlap in time, each has its own samples.
    """
    sequence, opens = scene.sequence, line_openings(scene)
    (begins, _), curve, shutter = shutter_span(sequence, frame), sequence.shutter_curve, sequence.shutter
    count, jumps = subframes_of(scene, samples), jump_times(scene, frame) - begins
    if lines_overlap(scene):
        ends = share_ends((0.0, sequence.readout + shutter), jumps, count)
        passed = curve_integral(curve, (ends[:, None] - opens) / shutter)
        passed[-1] = 1.0  # for the last line, in spite of rounding
        weights = _differences(passed)
        return Exposure(begins + 0.5 * (ends[1:] + ends[:-1]), weights, sequence.by_columns)
    count //= len(opens)
    shares = [(jumps - opening) / shutter for opening in np.sort(opens)]  # jumps as fractions of each line's exposure
    ends = np.stack([share_ends((0.0, 1.0), share[(share > 0.0) & (share < 1.0)], count) for share in shares])
    times = (np.sort(opens)[:, None] + 0.5 * shutter * (ends[:, 1:] + ends[:, :-1])).ravel()
    in_turn = np.eye(len(opens))[np.argsort(opens)]
    line_weights = _differences(curve_integral(curve, ends).T).T
    weights = np.repeat(in_turn, count, axis=0) * line_weights.reshape(-1, 1)
    return Exposure(begins + times, weights, sequence.by_columns)


def jump_times(scene: Scene, frame: int) -> Array:
    """Times (n,) in s, increasing, of jumps of objects or the camera, by stepped keyframes, while a shutter is open."""
    jumps = _all_jumps(scene)
    if not jumps.size:
        return jumps
    begin, end = _inside(scene.sequence, frame)
    return jumps[(jumps > begin) & (jumps < end)]


def _all_jumps(scene: Scene) -> Array:
    """Times (n,) of all jumps, increasing."""
    moved = (scene.camera.motion, *(motion.motion for motion in (*scene.groups, *scene.objects)), scene.lens)
    keys = [motion.keyframe or () for motion in moved if motion is not None and motion.interpolation == "step"]
    return np.unique(np.array([key.time for motion in keys for key in motion[1:]], dtype=np.float64))


def _inside(sequence: Sequence, frame: NDArray[np.int64] | int) -> tuple[Any, Any]:
    """Times between which a jump counts as inside the exposure of a frame; arrays for several frames."""
    begin = frame * sequence.interval + sequence.shutter_start
    slack = AT_AN_END * (sequence.shutter + sequence.readout)
    return begin + slack, begin + sequence.shutter + sequence.readout - slack


def share_ends(span: tuple[float, float], jumps: Array, count: int) -> Array:
    """Ends (count + 1,) of the intervals of an exposure.

    jumps: times inside `span`, increasing, fewer than `count`. Jumps divide the span into pieces; the intervals of a
    piece are equal, and longer pieces have more intervals. count: number of intervals.
    """
    if not jumps.size:
        return np.linspace(*span, count + 1)
    ends = np.array([span[0], *jumps, span[1]])
    lengths, counts = np.diff(ends), np.ones(len(ends) - 1, np.intp)
    for _ in range(count - len(counts)):
        counts[np.argmax(lengths / counts)] += 1
    pieces = [np.linspace(*pair, int(number) + 1)[:-1] for pair, number in zip(pairwise(ends), counts, strict=True)]
    return np.concatenate([*pieces, ends[-1:]])


def lines_overlap(scene: Scene) -> bool:
    """True if neighboring lines are open at the same time."""
    return scene.sequence.shutter * (frame_lines(scene) - 1) > scene.sequence.readout


def subframes_of(scene: Scene, samples: int) -> int:
    """Number of time samples of a frame, so that each line has about `samples` while it is exposed; the same in all
    frames, and at least one for each piece between jumps.
    """
    sequence, least = scene.sequence, _most_parts(scene)
    if not sequence.rolls:
        return max(samples, least)
    if not lines_overlap(scene):
        return max(samples, least) * frame_lines(scene)
    return max(ceil(samples * (1.0 + sequence.readout / sequence.shutter) * (1.0 - 1e-12)), least)


def _most_parts(scene: Scene) -> int:
    """Largest number of pieces into which jumps divide the exposure of a frame."""
    jumps = _all_jumps(scene)
    if not jumps.size or scene.sequence.sampling == "endpoint":
        return 1
    begins, ends = _inside(scene.sequence, np.arange(scene.sequence.frames))
    inside = np.searchsorted(jumps, ends) - np.searchsorted(jumps, begins, side="right")
    return 1 + int(inside.max())


def frame_lines(scene: Scene) -> int:
    """Number of lines of a frame: its columns if these are exposed one after another, else its rows."""
    columns, rows = scene.camera.frame_size
    return columns if scene.sequence.by_columns else rows


def line_openings(scene: Scene) -> Array:
    """Times (lines,) in s after the frame's shutter opens at which its lines open: from 0 to `readout`."""
    sequence, lines = scene.sequence, frame_lines(scene)
    opens = np.linspace(0.0, sequence.readout, lines) if lines > 1 else np.zeros(1)
    return opens[::-1] if sequence.scan in ("bottom_to_top", "right_to_left") else opens


def line_times(scene: Scene, frame: int) -> Array:
    """Middles (lines,) of the exposures of lines, s since the reference pose: the times of their ground truth."""
    return shutter_span(scene.sequence, frame)[0] + line_openings(scene) + 0.5 * scene.sequence.shutter


def pixel_time(scene: Scene, frame: int, column: int, row: int) -> float:
    """Time of the ground truth of a pixel, s since the reference pose: the middle of its exposure."""
    if not scene.sequence.rolls:
        return middle_time(scene.sequence, frame)
    return float(line_times(scene, frame)[column if scene.sequence.by_columns else row])


def curve_integral(curve: ShutterCurve, times: Array) -> Array:
    """Fraction of an exposure's light, 0 to 1, that has passed a shutter up to given times.

    curve: name of a shutter curve, or weights at equal times, linear between them; times: from 0, when the shutter
    opens, to 1, when it closes; other times are clamped.
    """
    weights = np.asarray(CURVES[curve] if isinstance(curve, str) else curve, dtype=np.float64)
    weights = weights / weights.max()  # so that sums of huge weights are finite, and sums of tiny weights not 0
    intervals = len(weights) - 1
    passed = np.concatenate([[0.0], np.cumsum(0.5 * (weights[1:] + weights[:-1]))])
    place = np.clip(times, 0.0, 1.0) * intervals
    k = np.minimum(place.astype(np.intp), intervals - 1)
    into = place - k
    light = passed[k] + into * (weights[k] + 0.5 * into * (weights[k + 1] - weights[k]))
    return np.asarray(light / passed[-1])


def _differences(light: Array) -> Array:
    """Weights (samples, ...) of the intervals of an exposure, from the light up to their ends (samples + 1, ...).

    Each is the light up to its end minus the sum of the earlier weights, so that added in order they sum to exactly 1.
    """
    total, weights = np.zeros(light.shape[1:]), np.empty((len(light) - 1, *light.shape[1:]))
    for k, end in enumerate(light[1:]):
        weights[k] = np.maximum(end - total, 0.0)
        total = total + weights[k]
    return weights


def shutter_span(sequence: Sequence, frame: int) -> tuple[float, float]:
    """Times at which the shutter opens for the first line and closes for the last one, s since the reference pose."""
    opens = frame * sequence.interval + sequence.shutter_start
    return opens, opens + sequence.shutter + sequence.readout


def middle_time(sequence: Sequence, frame: int) -> float:
    """Time of a frame's ground truth, s since the reference pose: half way between the opening and the closing of its
    shutter, whatever its curve. With a rolling shutter it is the time of the middle line.
    """
    return shutter_span(sequence, frame)[0] + 0.5 * (sequence.shutter + sequence.readout)


def sequence_times(scene: Scene) -> list[float]:
    """Times over the whole sequence, s since the reference pose; few, as predictions use them before each rendering."""
    if not scene.moves:
        return [0.0]
    last = scene.sequence.frames - 1
    count = min(4 * scene.sequence.frames + 1, PREDICTED_TIMES) if scene.moves_evenly else PREDICTED_TIMES
    return np.linspace(shutter_span(scene.sequence, 0)[0], shutter_span(scene.sequence, last)[1], count).tolist()
