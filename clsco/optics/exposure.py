"""Exposure of a frame: the time samples that it averages, and the weight of each in every row (float64, pure).

Shutter curves, and later rows that are exposed one after another, change `frame_exposure` alone: all that renders,
predicts and reports takes times and weights from here. A curve is sampled at the middles of equal shares of the
exposure, each with the light of its share: with a sample for a px of motion and more that is closer than times at equal
light.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clsco.scene.model import Scene, Sequence
from clsco.scene.sequence import CURVES, ShutterCurve

Array = NDArray[np.float64]
PREDICTED_TIMES = 33  # of the whole sequence at most


@dataclass(frozen=True, eq=False)
class Exposure:
    """Time samples of a frame, and the weights by which the frame adds up their blurred images.

    Attributes
    ----------
    times : ndarray of float64, (samples,)
        Seconds since the reference pose.
    weights : ndarray of float64, (samples,) or (samples, rows)
        Weight of each time sample in all rows of the frame, or in each of them; the sum of a row is 1.

    Examples
    --------
    >>> import numpy as np
    >>> from clsco.optics.exposure import Exposure
    >>> rolling = Exposure(np.array([0.0, 0.5]), np.array([[1.0, 0.5, 0.0], [0.0, 0.5, 1.0]]))
    >>> rolling.of_rows(3)[1].tolist(), rolling.is_one_image
    ([0.0, 0.5, 1.0], False)
    """

    times: Array
    weights: Array

    @property
    def is_one_image(self) -> bool:
        """True if the frame is the image of a single time sample, of weight 1."""
        return len(self.times) == 1 and bool((self.weights == 1.0).all())

    def of_rows(self, rows: int) -> Array:
        """Weights (samples, rows) of a frame with so many rows."""
        return np.broadcast_to(self.weights.reshape(len(self.times), -1), (len(self.times), rows))


def frame_exposure(scene: Scene, frame: int, samples: int) -> Exposure:
    """Exposure of a frame: one time sample in the reference pose where nothing moves.

    Parameters
    ----------
    scene : Scene
    frame : int
    samples : int
        Number of time samples. "midpoint": t = (i + 1/2) T / N after the shutter opens; "endpoint": t = (i + 1) T / N,
        the thesis, which displaces the image by half an interval.

    Returns
    -------
    Exposure
        The weight of a time sample is the integral of the shutter curve over its share of the exposure.

    Examples
    --------
    >>> import clsco
    >>> from clsco.optics.exposure import frame_exposure
    >>> ball = clsco.Sphere(center=(0, 0, 280), radius=30, motion=clsco.ObjectMotion(velocity=(10, 0, 0)))
    >>> exposure = frame_exposure(clsco.Scene(objects=(ball,)), 0, 2)
    >>> exposure.times.tolist(), exposure.weights.tolist()
    ([0.25, 0.75], [0.5, 0.5])
    """
    if not scene.moves:
        return Exposure(np.zeros(1), np.ones(1))
    sequence = scene.sequence
    steps = np.arange(samples, dtype=np.float64) + (0.5 if sequence.sampling == "midpoint" else 1.0)
    times = shutter_span(sequence, frame)[0] + steps * (sequence.shutter / samples)
    if sequence.shutter_curve == "box":
        return Exposure(times, np.full(samples, 1.0 / samples))
    return Exposure(times, _differences(curve_integral(sequence.shutter_curve, np.linspace(0.0, 1.0, samples + 1))))


def curve_integral(curve: ShutterCurve, times: Array) -> Array:
    """Share of the light of an exposure that has passed a shutter up to some times.

    Parameters
    ----------
    curve : str or tuple of float
        Name of a shutter curve, or weights at equal times, linear between them.
    times : ndarray of float64
        From 0, the opening of the shutter, to 1, its closing; what is beyond counts as these.

    Returns
    -------
    ndarray of float64
        From 0 to 1, of the shape of `times`.

    Examples
    --------
    >>> import numpy as np
    >>> from clsco.optics.exposure import curve_integral
    >>> curve_integral("triangle", np.array([0.0, 0.25, 0.5, 1.0])).tolist()
    [0.0, 0.125, 0.5, 1.0]
    """
    weights = np.asarray(CURVES[curve] if isinstance(curve, str) else curve, dtype=np.float64)
    weights = weights / weights.max()  # the sum of the largest ones is finite, that of the smallest not 0
    intervals = len(weights) - 1
    passed = np.concatenate([[0.0], np.cumsum(0.5 * (weights[1:] + weights[:-1]))])
    place = np.clip(times, 0.0, 1.0) * intervals
    k = np.minimum(place.astype(np.intp), intervals - 1)
    into = place - k
    found = passed[k] + into * (weights[k] + 0.5 * into * (weights[k + 1] - weights[k]))
    return np.asarray(found / passed[-1])


def _differences(passed: Array) -> Array:
    """Weights (samples, ...) of the shares of an exposure, between whose ends (samples + 1, ...) light has passed.

    Each is what its end has beyond the sum of those before, so that in the order of time they add up to 1 to the bit.
    """
    total, found = np.zeros(passed.shape[1:]), np.empty((len(passed) - 1, *passed.shape[1:]))
    for k, end in enumerate(passed[1:]):
        found[k] = np.maximum(end - total, 0.0)
        total = total + found[k]
    return found


def shutter_span(sequence: Sequence, frame: int) -> tuple[float, float]:
    """Times at which the shutter of a frame opens and closes, s since the reference pose."""
    opens = frame * sequence.interval + sequence.shutter_start
    return opens, opens + sequence.shutter


def middle_time(sequence: Sequence, frame: int) -> float:
    """Time of a frame's ground truth, s since the reference pose: half way from the opening of its shutter to the
    closing, whatever the curve between them is."""
    return shutter_span(sequence, frame)[0] + 0.5 * sequence.shutter


def sequence_times(scene: Scene) -> list[float]:
    """Times over the whole sequence, s since the reference pose, few enough for predictions before every rendering."""
    if not scene.moves:
        return [0.0]
    last = scene.sequence.frames - 1
    count = min(4 * scene.sequence.frames + 1, PREDICTED_TIMES)
    return np.linspace(shutter_span(scene.sequence, 0)[0], shutter_span(scene.sequence, last)[1], count).tolist()
