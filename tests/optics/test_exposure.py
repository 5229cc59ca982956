"""Times and weights of an exposure."""

import numpy as np
import pytest

from clsco import ObjectMotion, Scene, Sphere
from clsco.optics.exposure import PREDICTED_TIMES, Exposure, frame_exposure, middle_time, sequence_times, shutter_span
from clsco.scene.model import Sequence

EPS = float(np.finfo(np.float64).eps)


def scene_of(sequence: Sequence, speed: float = 10.0) -> Scene:
    return Scene(objects=(Sphere(motion=ObjectMotion(velocity=(speed, 0.0, 0.0))),), sequence=sequence)


def test_midpoints_and_endpoints() -> None:
    found = frame_exposure(scene_of(Sequence(interval=2.0, shutter=1.0, sampling="midpoint")), 3, 4)
    assert found.times.tolist() == [6.125, 6.375, 6.625, 6.875]
    assert found.weights.tolist() == [0.25] * 4
    found = frame_exposure(scene_of(Sequence(interval=2.0, shutter=1.0, sampling="endpoint")), 3, 4)
    assert found.times.tolist() == [6.25, 6.5, 6.75, 7.0]


@pytest.mark.parametrize("samples", [1, 3, 5, 1001])
def test_an_odd_number_of_midpoints_has_the_middle_of_the_shutter(samples: int) -> None:
    sequence = Sequence(interval=0.3, shutter=0.2)
    found = frame_exposure(scene_of(sequence), 7, samples)
    assert found.times[samples // 2] == pytest.approx(middle_time(sequence, 7), rel=4 * EPS)
    assert middle_time(sequence, 7) == pytest.approx(7 * 0.3 + 0.1, rel=4 * EPS)
    assert found.weights.sum() == pytest.approx(1.0, abs=samples * EPS)
    assert found.times.mean() == pytest.approx(middle_time(sequence, 7), rel=1e-14)
    opens, closes = shutter_span(sequence, 7)
    assert ((found.times > opens) & (found.times < closes)).all()
    assert (opens, closes) == pytest.approx((2.1, 2.3))


def test_what_stays_is_one_image() -> None:
    still = frame_exposure(scene_of(Sequence(samples=5), speed=0.0), 3, 5)
    assert (still.times.tolist(), still.weights.tolist(), still.is_one_image) == ([0.0], [1.0], True)
    assert frame_exposure(scene_of(Sequence()), 0, 1).is_one_image
    assert not frame_exposure(scene_of(Sequence()), 0, 2).is_one_image
    assert not Exposure(np.zeros(1), np.array([[1.0, 0.5]])).is_one_image


def test_weights_of_all_rows_and_of_each() -> None:
    assert Exposure(np.zeros(2), np.array([0.25, 0.75])).of_rows(3).tolist() == [[0.25] * 3, [0.75] * 3]
    ramp = np.array([[1.0, 0.5, 0.0], [0.0, 0.5, 1.0]])
    assert (Exposure(np.zeros(2), ramp).of_rows(3) == ramp).all()


@pytest.mark.parametrize("frames", [1, 2, 9, 300])
def test_few_times_are_looked_at_however_long_the_sequence_is(frames: int) -> None:
    times = sequence_times(scene_of(Sequence(frames=frames)))
    assert 1 < len(times) <= PREDICTED_TIMES
    assert (times[0], times[-1]) == (0.0, float(frames))
    assert sequence_times(scene_of(Sequence(frames=frames), speed=0.0)) == [0.0]
