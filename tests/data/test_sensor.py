"""Data sets of scenes with a sensor: what varies of it, and the types in which what it gives is stored."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from click.testing import CliRunner

import clsco
import clsco.data
from clsco.cli.main import main
from clsco.data.record import make_record
from clsco.frame.outputs import SENSOR_NAMES
from tests.data.distributions import SCENE, Load, messages

TEXT = """
[sensor]
mosaic = "rggb"
[vary.sensor]
iso = { log_uniform = [100.0, 3200.0] }
seed = { integers = [0, 1000000] }
"""


def test_keys_vary_and_arrays_are_stored_as_they_are(load: Load) -> None:
    sample = load(TEXT).draw(3, 5)
    (scene,) = sample.scenes
    assert scene.sensor is not None
    assert sample.parameters == {"sensor.iso": scene.sensor.iso, "sensor.seed": scene.sensor.seed}
    assert 100 <= sample.parameters["sensor.iso"] <= 3200
    frame = clsco.render_frame(scene, truth=SENSOR_NAMES)
    made = make_record(sample, 3, [[frame]], {"color", *SENSOR_NAMES})
    assert {name: array.dtype.name for name, array in made.arrays.items()} == {
        "color": "uint16", "raw": "uint16", "electrons": "float32", "noise_sigma": "float32", "saturated": "bool",
    }  # fmt: skip
    for name in SENSOR_NAMES:
        np.testing.assert_array_equal(made[name], frame.arrays()[name])
    assert made.meta["arrays"]["raw"]["unit"] == "DN"


def test_a_gain_that_varies_takes_the_place_of_iso(load: Load) -> None:
    text = "[sensor]\niso = 400.0\n[vary.sensor]\ngain = { uniform = [0.1, 0.5] }\n"
    sensor = load(text).draw(1, 0).scenes[0].sensor
    assert sensor is not None
    assert sensor.iso is None
    assert 0.1 <= (sensor.gain or 0) <= 0.5


def test_what_cannot_be_is_told_with_its_key(load: Load) -> None:
    (message,) = messages(load, "[vary.sensor]\nbits = { integers = [12, 20] }\n")
    assert "sensor.bits: must be between 1 and 16" in message


def test_codes_need_an_image(tmp_path: Path) -> None:
    (tmp_path / "set.toml").write_text(SCENE + TEXT)
    words = ["dataset", "make", str(tmp_path / "set.toml"), "-o", str(tmp_path / "out"), "--count", "1", "--no-color"]
    run = CliRunner().invoke(main, [*words, "--truth", "raw"])
    assert run.exit_code == 2
    assert "without color no image is made, so it must be without raw" in run.output


def test_an_infinite_focus_is_a_text_in_json(load: Load) -> None:
    sample = load("[vary.camera]\nfocus_distance = { choice = [inf] }\n").draw(1, 0)
    assert sample.table["camera"]["focus_distance"] == sample.parameters["camera.focus_distance"] == "inf"
    assert sample.scenes[0].camera.sensor_distance == 20.0
