"""The sensor of a scene file: rules of every key, defaults that follow from others, and its way back."""

from __future__ import annotations

import json
from typing import Any

import pytest

import clsco
from clsco.errors import SceneError
from clsco.inputs.dump import dump_scene
from clsco.scene.changes import dump
from clsco.scene.file import parse_scene
from clsco.scene.sweep import parse_sweep

BALL: dict[str, Any] = {"shape": "sphere"}
EVERY = {
    "white_electrons": 500.0, "full_well": 700.0, "read_noise": 1.5, "dark_current": 3.0, "temperature": -10.0,
    "temperature_reference": 25.0, "temperature_doubling": 6.0, "prnu": 0.01, "dsnu": 2.0, "hot_pixels": 1e-4,
    "bits": 14, "black_level": 512, "iso": 800.0, "iso_base": 200.0, "quantum_efficiency": [0.4, 0.6, 0.5],
    "exposure": "physical", "reference_shutter": 0.01, "reference_f_number": 2.8,
    "mosaic": "gbrg", "demosaic": "malvar", "seed": 2**63 - 1, "noise_seed": 2**53 - 1,
}  # fmt: skip


@pytest.mark.parametrize("sensor", [{}, EVERY, {"gain": 0.5, "bits": 1}])
def test_dumps_are_the_way_back(sensor: dict[str, Any]) -> None:
    scene = parse_scene({"object": [BALL], "sensor": sensor})
    assert parse_scene(json.loads(json.dumps(dump(scene), allow_nan=False))) == scene
    assert parse_scene(dump_scene(scene)) == scene
    given = sensor | {"quantum_efficiency": tuple(sensor.get("quantum_efficiency", (1, 1, 1)))}
    assert scene.sensor == clsco.Sensor(**given)


@pytest.mark.parametrize(("bits", "black"), [(12, 64), (16, 1024), (8, 4), (5, 0)])
def test_the_black_level_follows_the_bits(bits: int, black: int) -> None:
    assert clsco.Sensor(bits=bits).black_level == black


def test_iso_and_gain_take_the_place_of_each_other() -> None:
    scene = parse_scene({"object": [BALL], "sensor": {"iso": 400.0}})
    with_gain = scene.replace("sensor.gain", 0.3)
    assert with_gain.sensor is not None
    assert scene.sensor is not None
    assert (with_gain.sensor.gain, with_gain.sensor.iso) == (0.3, None)
    again = with_gain.replace("sensor.iso", 400.0)
    assert again == scene
    assert scene.replace("sensor", None) == parse_scene({"object": [BALL]})


def test_sensors_are_swept() -> None:
    sweep = parse_sweep({"object": [BALL], "sensor": {"iso": [100.0, 400.0], "seed": [1, 2]}})
    found = [(scene.sensor.iso, scene.sensor.seed) for scene in sweep.scenes if scene.sensor]
    assert found == [(iso, seed) for iso in (100.0, 400.0) for seed in (1, 2)]


def test_a_physical_exposure_has_one_opening() -> None:
    physical = {"object": [BALL], "sensor": {"exposure": "physical"}}
    pulled = {"keyframe": [{"time": 0.0, "focus_distance": 300.0}, {"time": 1.0, "focus_distance": 100.0}]}
    with pytest.raises(SceneError, match=r"sensor.exposure: must be normalized where keyframes have f-numbers; got "):
        parse_scene(physical | {"lens": {"keyframe": [{"time": 0.0, "f_number": 2.0}]}})
    with pytest.raises(SceneError, match=r"exposure: must be normalized where keyframes change the lens and normaliz"):
        parse_scene(physical | {"lens": pulled, "camera": {"normalization_distance": "sensor"}})
    assert parse_scene(physical | {"lens": pulled}).sensor is not None  # N is f / D at any focus
    usual = parse_scene({"object": [BALL], "sensor": EVERY}).replace("sensor.exposure", "normalized").sensor
    assert usual is not None
    assert (usual.reference_shutter, usual.reference_f_number) == (1.0, 1.0)


def test_all_keys_are_tried() -> None:
    assert {*EVERY, "gain"} == clsco.Sensor.model_fields.keys()
