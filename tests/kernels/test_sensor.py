"""sensor.cl: the bits of the reference for every kind of sensor, in parts, and for light that is hardly any or too
much; and that the reference's random numbers have the distributions that they should."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import ndtri
from scipy.stats import poisson as exact_poisson

from clsco.constants import LEAST_NORMAL, SENSED_PIXELS
from clsco.frame.strips import Strip
from clsco.opencl.buffers import upload
from clsco.opencl.session import Session
from clsco.optics.sensor import SensorModel, camera_word, reciprocals_of_counts, sensor_model
from clsco.passes.blur import Plane
from clsco.passes.sensor import FrameSensor
from clsco.plan.buffers import padded_columns
from clsco.reference.sensor.noise import exp_minus, minus_log, normal_of, philox, poisson, square_root, uniform_of
from clsco.reference.sensor.sensor import sense
from clsco.scene.model import Plane as Card
from clsco.scene.model import Scene, Sensor, Sequence
from tests.kernels.launches import Amid, run

RNG = np.random.default_rng
ALL = 2**32 - 1
KNOWN = {  # of Random123, kat_vectors: counter and key of zeros, of ones, of digits of pi
    ((0, 0, 0, 0), (0, 0)): "6627e8d5 e169c58d bc57ac4c 9b00dbd8",
    ((ALL, ALL, ALL, ALL), (ALL, ALL)): "408f276d 41c83b0e a20bc7c6 6d5451fd",
    ((0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344), (0xA4093822, 0x299F31D0)): "d16cfe09 94fdcceb 5001e420 24126ea1",
}
SENSORS: dict[str, tuple[int, dict[str, Any]]] = {
    "noise alone": (1, {"prnu": 0.0, "dsnu": 0.0}),
    "pattern": (1, {"prnu": 0.02, "dsnu": 3.0}),
    "hot pixels": (1, {"hot_pixels": 0.2, "dark_current": 40.0}),
    "color": (3, {"quantum_efficiency": (0.4, 0.6, 0.5)}),
    "mosaic": (3, {"mosaic": "grbg", "quantum_efficiency": (0.4, 0.6, 0.5), "seed": 2**62 + 5}),
    "later exposure": (3, {"mosaic": "rggb", "noise_seed": 2**53 - 7}),
    "gray mosaic": (1, {"mosaic": "bggr", "quantum_efficiency": (0.4, 0.6, 0.5)}),
    "no noise": (1, {"prnu": 0.0, "dsnu": 0.0, "read_noise": 0.0}),
    "few codes": (1, {"bits": 1, "black_level": 0}),
    "black only": (1, {"bits": 16, "black_level": 65535, "gain": 1.0}),
    "large": (1, {"bits": 16, "white_electrons": 1e7, "full_well": 1e7, "black_level": 0}),
    "wild": (1, {"prnu": 1.0, "dsnu": 1e6, "read_noise": 1e6, "gain": 1e6}),
}


def sensor_of(name: str) -> SensorModel:
    channels, keys = SENSORS[name]
    return sensor_model(Scene(objects=(Card(),), sensor=Sensor(**keys), sequence=Sequence(shutter=0.5)), channels)


def exposed(
    session: Session, known: SensorModel, light: NDArray[np.float32], camera: int, strips: tuple[Strip, ...] = ()
) -> tuple[NDArray[np.uint16], NDArray[np.bool_]]:
    """Codes of light (rows, columns, channels) from the device, strip by strip."""
    rows, columns, channels = light.shape
    pixels = len(known.filters) * rows * padded_columns(columns)
    found = FrameSensor(session, known, {"code": 2 * pixels, "saturated": pixels})
    code = np.zeros((rows, columns, len(known.filters)), np.uint16)
    saturated = np.zeros(code.shape, np.bool_)
    for strip in strips or (Strip(0, rows, 0, 0),):
        part = np.ascontiguousarray(np.moveaxis(light[strip.inside], -1, 0))
        plane = Plane(upload(session, part), (channels, strip.rows, columns), strip.rows, columns)
        found.expose(strip, plane, camera, []).read(session, code[strip.inside], saturated[strip.inside])
    return code, saturated


@pytest.mark.parametrize("given", KNOWN)
def test_known_answers(given: tuple[tuple[int, int, int, int], tuple[int, int]]) -> None:
    counter, key = given
    assert " ".join(f"{int(word):08x}" for word in philox(*counter, key)) == KNOWN[given]


@pytest.mark.parametrize("name", SENSORS)
@pytest.mark.parametrize("columns", [1, 16, SENSED_PIXELS + 21])
def test_the_device_has_the_bits_of_the_reference(session: Session, name: str, columns: int) -> None:
    known = sensor_of(name)
    light = RNG(3).random((9, columns, known.channels), np.float32) ** 4
    light[0] *= 1e-3
    code, saturated = exposed(session, known, light, camera_word(7, "right"))
    wanted, full = sense(known, light, camera_word(7, "right"))
    np.testing.assert_array_equal(code, wanted)
    np.testing.assert_array_equal(saturated, full)


@pytest.mark.parametrize("value", [0.0, 1e-34, 1e-12, 3e-3, 1e3, 1e30, np.inf, np.nan, -1.0])
@pytest.mark.parametrize("name", ["pattern", "large", "wild"])
def test_light_that_is_hardly_any_or_too_much(session: Session, name: str, value: float) -> None:
    known = sensor_of(name)
    light = np.full((5, 40, 1), value, np.float32)
    code, saturated = exposed(session, known, light, 0)
    wanted, full = sense(known, light, 0)
    np.testing.assert_array_equal(code, wanted)
    np.testing.assert_array_equal(saturated, full)
    if name != "wild":
        assert saturated.all() == (value >= 1e3)
        dark = np.abs(code - float(known.sensor.black_level)).max() / known.gain < 7 * 3.7
        assert dark == (not value >= 3e-3)


@pytest.mark.parametrize("name", ["pattern", "mosaic", "color"])
def test_strips_have_the_bits_of_the_whole(session: Session, name: str) -> None:
    known = sensor_of(name)
    light = RNG(4).random((11, 37, known.channels), np.float32)
    whole = exposed(session, known, light, 5)
    parts = exposed(session, known, light, 5, (Strip(0, 3, 0, 0), Strip(3, 7, 0, 0), Strip(10, 1, 0, 0)))
    assert all((a == b).all() for a, b in zip(whole, parts, strict=True))


@pytest.mark.parametrize("local", [(1, 1, 1), (2, 3, 2)])
def test_nothing_is_written_around_the_codes(session: Session, local: tuple[int, int, int]) -> None:
    """A window of a plane, with work-groups that reach beyond it."""
    known = sensor_of("color")
    rows, columns, padded = 5, 21, 32
    plane = RNG(6).random((3, 9, 30), np.float32)
    codes = Amid(session, np.zeros((3, rows, padded), np.uint16), 7)
    full = Amid(session, np.zeros((3, rows, padded), np.uint8), 9)
    sensor = FrameSensor(session, known, {"code": 2, "saturated": 1})
    given = {"rows": rows, "columns": columns, "top": 0, "padded": padded, "camera": np.uint32(4), "plane": plane}
    given |= {"apart": 9 * 30, "start": 2 * 30 + 3, "pitch": 30, "sensor": sensor.struct, "code": codes}
    given |= {"reciprocals": reciprocals_of_counts(), "saturated": full}
    run(session, sensor.target, "sense", (1, rows, 3), local, **given)
    wanted, _ = sense(known, np.moveaxis(plane[:, 2:7, 3:24], 0, -1), 4)
    np.testing.assert_array_equal(codes.now()[..., :columns], np.moveaxis(wanted, -1, 0))
    assert full.now().max() <= 1


def test_noise_depends_on_seeds_frame_eye_and_channel_alone() -> None:
    known, light = sensor_of("color"), np.full((20, 30, 3), 0.3, np.float32)

    def codes(seed: int, frame: int, eye: Any, noise_seed: int = 0) -> NDArray[np.int64]:
        other = replace(known, sensor=known.sensor.model_copy(update={"seed": seed, "noise_seed": noise_seed}))
        return sense(other, light, camera_word(frame, eye))[0].astype(np.int64)

    first = codes(1, 0, "left")
    assert (codes(1, 0, "left") == first).all()
    others = [codes(1, 0, "left", 1), codes(1, 0, "left", 2**32), codes(1, 0, "left", 2**52)]
    others += [codes(2, 0, "left"), codes(2**32 + 1, 0, "left"), codes(1, 1, "left"), codes(1, 0, "right")]
    for one in (*others, first[..., [1, 2, 0]]):
        noise = [each - each.mean(axis=(0, 1)) for each in (first, one)]
        assert abs(np.corrcoef(noise[0].ravel(), noise[1].ravel())[0, 1]) < 0.1


def test_the_pattern_stays_from_frame_to_frame_and_differs_from_eye_to_eye() -> None:
    known = sensor_model(Scene(objects=(Card(),), sensor=Sensor(prnu=0.05, dsnu=20.0, read_noise=0.0)), 1)
    light = np.full((60, 60, 1), 0.5, np.float32)
    one, other, right = (
        sense(known, light, camera_word(*which))[0].ravel().astype(float)
        for which in ((0, "left"), (9, "left"), (0, "right"))
    )
    pattern, shot = (0.05 * 5000) ** 2 + 20**2, 5000.0
    assert np.corrcoef(one, other)[0, 1] == pytest.approx(pattern / (pattern + shot), abs=0.02)
    assert abs(np.corrcoef(one, right)[0, 1]) < 0.05


def test_functions_of_single_numbers() -> None:
    x = np.concatenate([RNG(1).random(1000), 2.0 ** -np.arange(1.0, 33.0), [1.0]]).astype(np.float32)
    np.testing.assert_allclose(minus_log(x), -np.log(x.astype(float)), atol=4e-7, rtol=3e-7)
    np.testing.assert_allclose(square_root(100 * x), np.sqrt(100 * x.astype(float)), rtol=5e-6)
    assert square_root(np.zeros(1, np.float32))[0] == 0
    mean = np.linspace(0, 80, 4001).astype(np.float32)
    np.testing.assert_allclose(exp_minus(mean), np.exp(-mean.astype(float)), rtol=6e-6)
    ends = np.array([0, 1, 2**31 - 1, 2**31, ALL - 1, ALL], np.uint32)
    assert uniform_of(ends).min() > 0
    assert uniform_of(ends).max() == 1
    assert np.abs(normal_of(ends)).max() < 6.4


def test_normal_numbers() -> None:
    word = (np.arange(2**18, dtype=np.uint64) * 2**14 + 2**13).astype(np.uint32)
    np.testing.assert_allclose(normal_of(word), ndtri((word + 0.5) / 2**32), atol=5e-5)
    tail = np.array([0, 1, 5, 77, 1000, 10**5], np.uint32)
    np.testing.assert_allclose(normal_of(tail), ndtri((tail + 0.5) / 2**32), atol=5e-5)
    np.testing.assert_array_equal(normal_of(~tail), -normal_of(tail))


def distribution(mean: float) -> NDArray[np.float64]:
    """Probabilities of counts, from words at equal steps."""
    word = (np.arange(2**20, dtype=np.uint64) * 2**12 + 2**11).astype(np.uint32)
    count = poisson(np.full(word.size, mean, np.float32), word, reciprocals_of_counts())
    return np.bincount(count) / word.size


@pytest.mark.parametrize("mean", [0.0, 1e-3, 0.2, 2.0, 13.7, 29.9, 30.0, 100.0, 30000.0])
def test_total_variation_from_poisson(mean: float) -> None:
    found = distribution(mean)
    exact = exact_poisson.pmf(np.arange(found.size), np.float32(mean))
    distance = 0.5 * (np.abs(found - exact).sum() + 1 - exact.sum())
    assert distance < (1e-3 if mean >= LEAST_NORMAL else 5e-5)


def test_a_mean_that_is_hardly_there_is_kept() -> None:
    """As many words give one electron as should."""
    word = np.arange(10_000, dtype=np.uint32)
    count = poisson(np.full(word.size, 1e-6, np.float32), word, reciprocals_of_counts())
    assert (count == (word < 1e-6 * 2**32)).mean() > 0.9999
    assert not poisson(np.full(word.size, 1e-30, np.float32), word, reciprocals_of_counts()).any()


@pytest.mark.parametrize("mean", [1e7, 2.0**24])
def test_whole_electrons_of_many(mean: float) -> None:
    """Floats of that size have no odd numbers beyond 2^24: mean and deviation are right, and so is the last digit."""
    word = RNG(8).integers(0, 2**32, 2**18, dtype=np.uint64).astype(np.uint32)
    count = poisson(np.full(word.size, mean, np.float32), word, reciprocals_of_counts())
    assert count.mean() == pytest.approx(mean, abs=5 * np.sqrt(mean / word.size))
    assert count.std() == pytest.approx(np.sqrt(mean), rel=0.01)
    assert (count % 2).mean() == pytest.approx(0.5, abs=0.01)
