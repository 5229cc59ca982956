"""Exposure of a frame: the time samples that it averages, and the weight of each in every row (float64, pure).

A shutter curve, or rows that are exposed one after another, changes `frame_exposure` alone: all that renders, predicts
and reports takes times and weights from here.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clsco.scene.model import Scene, Sequence

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
        Equal weights, as the shutter is a box.

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
    times = frame * sequence.interval + steps * (sequence.shutter / samples)
    return Exposure(times, np.full(samples, 1.0 / samples))


def shutter_span(sequence: Sequence, frame: int) -> tuple[float, float]:
    """Times at which the shutter of a frame opens and closes, s since the reference pose."""
    opens = frame * sequence.interval
    return opens, opens + sequence.shutter


def middle_time(sequence: Sequence, frame: int) -> float:
    """Middle of the shutter of a frame, s since the reference pose: the time of its ground truth."""
    return frame * sequence.interval + 0.5 * sequence.shutter


def sequence_times(scene: Scene) -> list[float]:
    """Times over the whole sequence, s since the reference pose, few enough for predictions before every rendering."""
    if not scene.moves:
        return [0.0]
    last = scene.sequence.frames - 1
    count = min(4 * scene.sequence.frames + 1, PREDICTED_TIMES)
    return np.linspace(0.0, shutter_span(scene.sequence, last)[1], count).tolist()
