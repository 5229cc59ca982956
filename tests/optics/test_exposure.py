"""Times and weights of an exposure."""

from math import ceil
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from clsco import Camera, Keyframe, ObjectMotion, Scene, Sphere
from clsco.optics import exposure
from clsco.optics.exposure import (
    PREDICTED_TIMES,
    Exposure,
    frame_exposure,
    jump_times,
    line_times,
    middle_time,
    sequence_times,
    share_ends,
    shutter_span,
    subframes_of,
)
from clsco.scene.model import Sequence
from clsco.scene.sequence import ShutterCurve

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
    assert Exposure(np.zeros(2), np.array([0.25, 0.75])).line_weights(3).tolist() == [[0.25] * 3, [0.75] * 3]
    ramp = np.array([[1.0, 0.5, 0.0], [0.0, 0.5, 1.0]])
    assert (Exposure(np.zeros(2), ramp).line_weights(3) == ramp).all()


@pytest.mark.parametrize("frames", [1, 2, 9, 300])
def test_few_times_are_looked_at_however_long_the_sequence_is(frames: int) -> None:
    times = sequence_times(scene_of(Sequence(frames=frames)))
    assert 1 < len(times) <= PREDICTED_TIMES
    assert (times[0], times[-1]) == (0.0, float(frames))
    assert sequence_times(scene_of(Sequence(frames=frames), speed=0.0)) == [0.0]


CURVE = (0.0, 0.3, 1.0, 0.1)


@pytest.mark.parametrize("curve", ["trapezoid", "triangle", CURVE, (1.0, 0.0), (1e-300, 1e-301), (0.0, 1e9, 0.0, 0.0)])
@pytest.mark.parametrize("samples", [1, 2, 7, 10, 1000])
def test_weights_of_a_curve_are_the_light_of_their_shares(curve: ShutterCurve, samples: int) -> None:
    sequence = Sequence(interval=2.0, shutter=0.3, shutter_curve=curve)
    found, box = (frame_exposure(scene_of(each), 3, samples) for each in (sequence, Sequence(interval=2, shutter=0.3)))
    assert (found.times == box.times).all()
    total = 0.0
    for weight in found.weights.tolist():  # in the order of time, as the frame adds them
        total += weight
    assert total == 1.0
    named: dict[ShutterCurve, tuple[float, ...]] = {"trapezoid": (0, 1, 1, 1, 0), "triangle": (0, 1, 0)}
    knots = np.asarray(named[curve] if isinstance(curve, str) else curve, np.float64)
    fine = (np.arange(200 * samples * 3) + 0.5) / (200 * samples * 3)
    passed = np.interp(fine, np.linspace(0.0, 1.0, len(knots)), knots / knots.max()).reshape(samples, -1).sum(axis=1)
    np.testing.assert_allclose(found.weights, passed / passed.sum(), atol=2e-6)
    assert (found.weights >= 0.0).all()


def test_shares_after_the_shutter_has_closed_weigh_nothing() -> None:
    weights = frame_exposure(scene_of(Sequence(shutter_curve=(0.3, 1.0, 0.0, 0.0))), 0, 12).weights
    assert (weights[8:] == 0.0).all()
    assert (weights[:8] > 0.0).all()


def test_the_shutter_opens_at_its_start() -> None:
    sequence = Sequence(frames=3, interval=2.0, shutter=0.5, shutter_start=-0.25)
    assert shutter_span(sequence, 1) == (1.75, 2.25)
    assert middle_time(sequence, 1) == 2.0
    assert frame_exposure(scene_of(sequence), 1, 2).times.tolist() == [1.875, 2.125]
    times = sequence_times(scene_of(sequence))
    assert (times[0], times[-1]) == (-0.25, 4.25)


def test_an_edge_through_a_trapezoid_is_as_close_as_its_midpoints() -> None:
    """The ramp of an edge that moves 16 px, with 17 samples, against the integral of the curve: 0.0015 rms at most."""
    samples, px = 17, 16.0
    found = frame_exposure(scene_of(Sequence(shutter_curve="trapezoid")), 0, samples)
    place = np.arange(-4.0, px + 4.0, 0.05)  # of pixels from where the edge begins

    def passed(time: np.ndarray) -> np.ndarray:
        """Share of the light after a time, by the areas of ramps and of what is between them."""
        u = np.clip(time, 0.0, 1.0)
        rise, fall = 2.0 * np.minimum(u, 0.25) ** 2, 2.0 * np.maximum(u - 0.75, 0.0) ** 2
        return (rise + np.clip(u - 0.25, 0.0, 0.75) - fall) / 0.75

    # A pixel is 1 px wide: the mean over it of what the edge has covered.
    inside = np.linspace(-0.5, 0.5, 401)
    exact = np.mean(1.0 - passed((place[:, None] + inside) / px), axis=1)
    covered = np.clip(px * found.times[:, None] - place + 0.5, 0.0, 1.0)
    error = found.weights @ covered - exact
    assert np.sqrt(np.mean(error[(place > 0) & (place < px)] ** 2)) <= 0.0015
    assert np.abs(error).max() <= 0.0025


def rolling(lines: int, **sequence: Any) -> Scene:
    """A scene whose rows, or columns where it scans these, are as many."""
    return scene_of(Sequence(**sequence)).replace("camera.resolution", [lines, lines])


def in_order(weights: NDArray[np.float64]) -> NDArray[np.float64]:
    total = np.zeros(weights.shape[1:])
    for one in weights:  # in the order of time, as the frame adds them
        total = total + one
    return total


@pytest.mark.parametrize("scan", ["top_to_bottom", "bottom_to_top", "left_to_right", "right_to_left"])
@pytest.mark.parametrize(("readout", "samples", "count"), [(0.2, 5, 10), (0.1, 1, 2), (1.0, 3, 18)])
def test_weights_of_a_line_are_what_its_exposure_has_of_a_share(
    scan: str, readout: float, samples: int, count: int
) -> None:
    found = frame_exposure(rolling(7, shutter=0.2, interval=0.5, readout=readout, scan=scan), 2, samples)
    assert found.weights.shape == (count, 7)
    assert found.by_columns == (scan in ("left_to_right", "right_to_left"))
    share = (0.2 + readout) / count
    np.testing.assert_allclose(found.times, 1.0 + (np.arange(count) + 0.5) * share, atol=1e-15)
    for line in range(7):
        opens = 1.0 + readout * (6 - line if scan in ("bottom_to_top", "right_to_left") else line) / 6
        low, high = np.maximum(found.times - share / 2, opens), np.minimum(found.times + share / 2, opens + 0.2)
        np.testing.assert_allclose(found.weights[:, line], np.maximum(high - low, 0.0) / 0.2, atol=1e-12)
    assert (in_order(found.weights) == 1.0).all()


@pytest.mark.parametrize("curve", ["box", "trapezoid", CURVE])
@pytest.mark.parametrize(("readout", "samples"), [(0.7, 11), (0.013, 2), (30.0, 4)])
def test_lines_are_as_bright_as_each_other(curve: ShutterCurve, readout: float, samples: int) -> None:
    found = frame_exposure(rolling(31, shutter=0.2, readout=readout, shutter_curve=curve), 0, samples)
    assert (in_order(found.weights) == 1.0).all()
    assert (found.weights >= 0.0).all()
    assert (np.diff(found.times) > 0.0).all()


def test_lines_that_are_not_open_together_share_no_time() -> None:
    scene = rolling(5, shutter=0.1, interval=9.0, readout=8.0, scan="bottom_to_top", shutter_curve="triangle")
    found = frame_exposure(scene, 1, 2)
    np.testing.assert_allclose(found.times, np.repeat([9.0, 11.0, 13.0, 15.0, 17.0], 2) + [0.025, 0.075] * 5)
    assert (found.weights == np.kron(np.eye(5)[::-1], [[0.5], [0.5]])).all()
    assert line_times(scene, 1).tolist() == pytest.approx([17.05, 15.05, 13.05, 11.05, 9.05])


def test_the_number_of_subframes_goes_over_from_shared_to_own_ones() -> None:
    counts = [subframes_of(rolling(9, shutter=shutter, readout=0.8), 3) for shutter in (0.0999, 0.1, 0.10001)]
    assert counts == [27, 27, 27]
    alone, plain = (frame_exposure(rolling(1, shutter=0.5, readout=late), 0, 2) for late in (0.25, 0.0))
    assert (alone.times == plain.times).all()
    assert (alone.weights[:, 0] == plain.weights).all()
    assert subframes_of(rolling(9, shutter=0.5), 4) == 4


# Share of the readout that a row is exposed for, px per sub-frame, and RMS and largest error of an edge that moves by
# 24 px in the readout, against continuous time.
TABLE = [(1.0, 1.0, 0.0010, 0.006), (0.25, 1.0, 0.0064, 0.021), (0.25, 0.5, 0.0019, 0.0055)]
TABLE += [(0.1, 1.0, 0.022, 0.0505), (0.1, 0.5, 0.0066, 0.0135)]


@pytest.mark.parametrize(("share", "px", "rms", "largest"), TABLE)
def test_an_edge_under_a_rolling_shutter(
    share: float, px: float, rms: float, largest: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows, speed, shutter = 96, 24.0, share
    count = ceil(speed * (1.0 + shutter) / px)
    monkeypatch.setattr(exposure, "subframes_of", lambda *_: count)
    found = frame_exposure(rolling(rows, interval=3.0, shutter=shutter, readout=1.0), 0, 1)
    place, errors = np.arange(-2.0, 50.0, 0.1), []
    for row in range(0, rows, 5):
        begin, end = speed * row / (rows - 1), speed * (row / (rows - 1) + shutter)
        inside = (place > begin - 0.5) & (place < end + 0.5)

        def ramp(at: NDArray[np.float64]) -> NDArray[np.float64]:
            """Integral of what an edge at `at` px covers of a pixel at 0."""
            return np.asarray(0.5 * np.clip(at + 0.5, 0.0, 1.0) ** 2 + np.maximum(at - 0.5, 0.0))

        exact = (ramp(end - place[inside]) - ramp(begin - place[inside])) / (end - begin)
        covered = np.clip(speed * found.times[:, None] - place[inside] + 0.5, 0.0, 1.0)
        errors.append(found.weights[:, row] @ covered - exact)
    error = np.concatenate(errors)
    assert np.sqrt(np.mean(error**2)) <= rms
    assert np.abs(error).max() <= largest


def jumping(*times: float, **sequence: Any) -> Scene:
    """A ball that jumps at some times, and is where it begins before them."""
    keys = tuple(Keyframe(time=time, position=(float(k), 0.0, 0.0)) for k, time in enumerate((-1.0, *times)))
    ball = Sphere(motion=ObjectMotion(keyframe=keys, interpolation="step"))
    return Scene(camera=Camera(resolution=(8, 12)), objects=(ball,), sequence=Sequence(**sequence))


@pytest.mark.parametrize("samples", [1, 2, 5, 8])
@pytest.mark.parametrize("curve", ["box", "triangle"])
def test_shares_end_where_something_jumps(samples: int, curve: ShutterCurve) -> None:
    """Poses before and after a jump have the light of their times, however few samples there are."""
    wanted = jumping(2.31, 2.9, frames=3, shutter=0.8, shutter_curve=curve)
    found = frame_exposure(wanted, 2, samples)
    assert len(found.times) == subframes_of(wanted, samples) == max(samples, 2)
    assert sum(found.weights.tolist()) == 1.0
    before = found.weights[found.times < 2.31].sum()
    assert before == pytest.approx(float(exposure.curve_integral(curve, np.array(0.31 / 0.8))), rel=1e-12)
    assert (np.diff(found.times) > 0.0).all()
    # All frames have as many samples, but those without a jump equal shares.
    plain = frame_exposure(wanted, 1, samples)
    assert len(plain.times) == len(found.times)
    np.testing.assert_allclose(np.diff(plain.times), 0.8 / len(plain.times), rtol=1e-12)


def test_jumps_at_the_ends_of_an_exposure_are_in_none() -> None:
    """Frame 2 closes at 0.30000000000000004 s, and frame 3 opens then."""
    wanted = jumping(0.3, 0.6, frames=9, interval=0.1)
    assert [jump_times(wanted, frame).size for frame in range(9)] == [0] * 9
    assert subframes_of(wanted, 1) == 1
    assert subframes_of(jumping(0.35, 0.36, 0.37, frames=9, interval=0.1), 1) == 4
    assert subframes_of(jumping(0.35, frames=9, interval=0.1, sampling="endpoint"), 1) == 1
    assert jump_times(scene_of(Sequence()), 0).size == 0


def test_pieces_between_jumps_have_shares_by_their_lengths() -> None:
    ends = share_ends((0.0, 1.0), np.array([0.1, 0.5]), 10)
    assert np.histogram(ends[:-1], [0.0, 0.1, 0.5, 1.0])[0].tolist() == [1, 4, 5]
    np.testing.assert_array_equal(share_ends((0.0, 1.0), np.array([]), 3), np.linspace(0.0, 1.0, 4))


@pytest.mark.parametrize("readout", [0.4, 30.0])
def test_lines_have_the_light_of_their_own_times_before_a_jump(readout: float) -> None:
    wanted = jumping(0.31, shutter=0.6, interval=40.0, readout=readout)
    found, times = frame_exposure(wanted, 0, 3), line_times(wanted, 0)
    weights = found.line_weights(12)
    np.testing.assert_allclose(weights.sum(axis=0), 1.0, rtol=0, atol=1e-12)
    before = (weights * (found.times < 0.31)[:, None]).sum(axis=0)
    np.testing.assert_allclose(before, np.clip((0.31 - times + 0.3) / 0.6, 0.0, 1.0), rtol=0, atol=1e-12)
