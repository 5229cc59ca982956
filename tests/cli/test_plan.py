"""Predicted time on the command line."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from clsco.cli.plan_tables import duration
from clsco.engine.probe import SECONDS, FrameTime, measure_frame
from clsco.errors import DeviceError
from clsco.opencl.session import Session
from clsco.plan.prepare import Prepared
from tests.command import clsco_
from tests.scenes import scene_file


@pytest.fixture
def ball(ball: Path) -> Path:
    return scene_file(ball, ball.read_text().replace("samples = 3", "samples = 400"))


@pytest.fixture(autouse=True)
def brief(monkeypatch: pytest.MonkeyPatch) -> None:
    """Commands measure a smaller part of a frame."""

    def measure(session: Session, prepared: Prepared, seconds: float = SECONDS) -> FrameTime:
        return measure_frame(session, prepared, seconds / 20)

    monkeypatch.setattr("clsco.engine.probe.measure_frame", measure)


def test_plan_predicts_seconds(ball: Path) -> None:
    words = " ".join(clsco_("plan", ball).output.split())
    assert re.search(r"predicted time [\d.]+ m?s per frame, \d+% of it in the pass \w+; measured on [\d.]+%", words)
    result = clsco_("plan", ball, "--json", "--truth", "depth")
    values = json.loads(result.stdout)
    (view,) = values["views"]
    assert [each["pass"] for each in view["passes"]] == ["trace", "silhouettes", "blur", "accumulate", "ground truth"]
    assert all(each["seconds"] > 0.0 for each in view["passes"])
    assert sum(each["seconds"] for each in view["passes"]) == pytest.approx(values["seconds"])
    assert values["frames"] == 3
    fewer = json.loads(clsco_("plan", ball, "--json", "--tolerance", "0.05").stdout)
    assert fewer["samples"] < values["samples"]
    several = clsco_("plan", ball, "--json", "--set", "camera.f_number=[2,4]")
    assert json.loads(several.stdout)["views"]
    assert several.stderr == "the first of 2 scenes, f_number_2:\n"


def test_a_plan_without_a_device_has_no_time(ball: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(device: str | None) -> Session:
        raise DeviceError("device: must be one; got none")

    monkeypatch.setattr("clsco.opencl.session.session_for", fail)
    words = " ".join(clsco_("plan", ball).output.split())
    assert "device none: must be one; got none" in words
    assert "predicted time not measured" in words
    assert json.loads(clsco_("plan", ball, "--json").stdout)["seconds"] is None
    assert clsco_("plan", ball, "--device", "cpu").exit_code == 3


def test_a_sensor_and_ground_truth_are_run_once_a_frame(ball: Path) -> None:
    found = json.loads(clsco_("plan", ball, "--json", "--truth", "depth", "--set", "sensor.bits=10").stdout)
    times = {each["pass"]: each["times"] for each in found["views"][0]["passes"]}
    assert (times["sensor"], times["ground truth"], times["blur"], times["accumulate"]) == (1, 1, 400, 400)


def test_durations_are_short() -> None:
    texts = ["4.2 ms", "990 ms", "1.5 s", "41 s", "1.7 min", "1.9 h", "120 h"]
    assert [duration(value) for value in (0.0042, 0.99, 1.5, 41.0, 100.0, 7000.0, 432000.0)] == texts
