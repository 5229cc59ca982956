"""Numbers of a sensor's read-out, and that the noise that is reported is the noise that there is."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from clsco.frame.development import values_at_sites
from clsco.optics.sensor import camera_word, noise_variance, sensor_model, sensor_values
from clsco.reference.sensor.sensor import sense
from clsco.scene.model import Plane, Scene, Sensor, Sequence


def scene_of(shutter: float = 1.0, **keys: Any) -> Scene:
    return Scene(objects=(Plane(),), sensor=Sensor(**keys), sequence=Sequence(shutter=shutter))


def test_dark_current_doubles_with_the_temperature_and_grows_with_the_time() -> None:
    keys = {"dark_current": 10.0, "temperature_reference": 25.0, "temperature_doubling": 6.0}
    found = [sensor_model(scene_of(0.5, temperature=t, **keys), 1).dark for t in (25.0, 31.0, 13.0, 1000.0)]
    assert found[:3] == [5.0, 10.0, 1.25]
    assert np.isfinite(found[3])
    hottest = sensor_model(scene_of(temperature=1000.0, dark_current=1e9, temperature_doubling=0.1), 1)
    assert sensor_values(hottest)["dark"] == 2**24


def test_gain_and_iso() -> None:
    base = sensor_model(scene_of(), 1)
    assert base.gain == (4095 - 64) / 12000
    assert base.scale == (1e4, 1e4, 1e4)
    fast = sensor_model(scene_of(iso=400.0), 1)
    assert (fast.gain, fast.scale[1]) == (4 * base.gain, 2500.0)
    assert sensor_model(scene_of(iso=400.0, iso_base=400.0), 1).gain == base.gain
    assert sensor_model(scene_of(gain=0.25, quantum_efficiency=(0.5, 0.25, 1.0)), 3).scale == (5000.0, 2500.0, 1e4)
    assert sensor_model(scene_of(gain=0.25), 1).gain == 0.25


def test_filters_of_planes() -> None:
    assert sensor_model(scene_of(), 1).filters == ((1, 1, 1, 1),)
    assert sensor_model(scene_of(), 3).filters == ((0,) * 4, (1,) * 4, (2,) * 4)
    mosaic = sensor_model(scene_of(mosaic="grbg"), 3)
    assert values_at_sites((0, 1, 2), mosaic, (2, 4))[..., 0].tolist() == [[1, 0, 1, 0], [2, 1, 2, 1]]


def test_a_pattern_is_there_only_where_pixels_differ() -> None:
    assert sensor_model(scene_of(), 1).has_pattern
    assert not sensor_model(scene_of(prnu=0.0, dsnu=0.0), 1).has_pattern
    assert sensor_model(scene_of(prnu=0.0, dsnu=0.0, hot_pixels=0.1), 1).has_pattern


def test_views_and_frames_have_words_of_their_own() -> None:
    words = [camera_word(frame, eye) for frame in range(3) for eye in ("left", "right")]
    assert words == [0, 1, 2, 3, 4, 5]


@pytest.mark.parametrize("light", [0.0, 0.002, 0.5])
@pytest.mark.parametrize("keys", [{}, {"prnu": 0.05, "dsnu": 6.0, "dark_current": 20.0}, {"gain": 0.3}])
def test_noise_is_as_predicted(light: float, keys: dict[str, Any]) -> None:
    found = sensor_model(scene_of(**keys), 1)
    codes = sense(found, np.full((300, 300, 1), light), 0)[0].astype(float)
    electrons = (codes - found.sensor.black_level) / found.gain
    photo = np.array(light * found.scale[0])
    assert electrons.mean() == pytest.approx(float(photo) + found.dark, abs=5 * electrons.std() / 300)
    assert electrons.var() == pytest.approx(float(noise_variance(found, photo)), rel=0.03)
