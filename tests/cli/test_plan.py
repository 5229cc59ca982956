"""Predicted time on the command line: `clsco plan`, `clsco plan --json`, and the warning of `clsco validate`."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from tests.command import clsco_
from tests.scenes import scene_file

CAMERA = "[camera]\nresolution = [40, 24]\npixel_pitch = 0.1\nnormalization_distance = 20.0\n"
BALL = """
[sequence]
frames = 3
samples = 400
[[object]]
shape = "sphere"
[object.motion]
velocity = [3.0, 0.0, 0.0]
"""


@pytest.fixture
def ball(tmp_path: Path) -> Path:
    return scene_file(tmp_path / "ball.toml", CAMERA + BALL)


def test_plan_predicts_seconds(ball: Path) -> None:
    words = " ".join(clsco_("plan", ball).output.split())
    assert re.search(r"predicted time [\d.]+ m?s per frame on \d+ cores?, \d+% of it in the pass \w+", words)
    result = clsco_("plan", ball, "--json", "--truth", "depth")
    values = json.loads(result.stdout)
    (view,) = values["views"]
    assert [each["pass"] for each in view["passes"]] == ["trace", "silhouettes", "blur", "accumulate", "ground truth"]
    assert 0.0 < sum(each["seconds"] for each in view["passes"]) < values["seconds"]
    assert values["frames"] == 3
    assert "not known" in clsco_("plan", ball, "--gpu").output
    assert json.loads(clsco_("plan", ball, "--gpu", "--json").stdout)["seconds"] is None
    several = clsco_("plan", ball, "--json", "--set", "camera.f_number=[2,4]")
    assert json.loads(several.stdout)["views"]
    assert several.stderr == "the first of 2 scenes, f_number_2:\n"


def test_a_sensor_and_ground_truth_are_run_once_a_frame(ball: Path) -> None:
    values = json.loads(clsco_("plan", ball, "--json", "--truth", "depth", "--set", "sensor.bits=10").stdout)
    times = {each["pass"]: each["times"] for each in values["views"][0]["passes"]}
    assert (times["sensor"], times["ground truth"], times["blur"], times["accumulate"]) == (1, 1, 400, 400)


def test_validate_warns_of_long_frames(ball: Path, tmp_path: Path) -> None:
    camera = CAMERA.replace("[40, 24]", "[8192, 8192]").replace("0.1", "0.0004") + "f_number = [1.8, 2]\n"
    heavy = scene_file(tmp_path / "heavy.toml", camera + BALL)
    result = clsco_("validate", ball, heavy)
    assert result.exit_code == 0
    assert result.stdout.splitlines() == [f"{ball}: valid", f"{heavy}: valid, 2 scenes"]
    (line,) = result.stderr.splitlines()
    assert line.startswith(f"{heavy} (with f_number_1.8): a frame will take about ")
    assert "sequence.samples = 5, " in line
