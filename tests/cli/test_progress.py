"""Text of the progress bar, and its end."""

from __future__ import annotations

import json
import os
import pty
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest

from clsco.cli.progress import position
from clsco.opencl.session import Progress
from tests.command import clsco_, done
from tests.scenes import PLANE, scene_file


@pytest.mark.parametrize(
    ("here", "done", "said"),
    [
        (Progress("compiling gather"), 0, "compiling gather"), (Progress("blur", 0.25, 0, 1), 0, "blur 25%"),
        (Progress("blur", 0.25, 0, 12), 0, "blur 25%, time sample 1 of 12"),
        (Progress("blur", 1.0, 3, 12), 0, "blur, time sample 4 of 12, 70 s left"),
        (Progress("trace", 0.0, 0, 1), 1, "trace, 10 s left"),
    ],
)  # fmt: skip
def test_where_a_frame_is(here: Progress, done: int, said: str) -> None:
    assert position(here, done, 2, 10.0) == said


def test_a_terminal_shows_frames_and_what_the_device_does(tmp_path: Path) -> None:
    words = ["render", "examples/sphere.toml", "--set", "camera.resolution=[32,32]", "-o", str(tmp_path)]
    ours, theirs = pty.openpty()
    process = subprocess.Popen(
        [sys.executable, "-c", "from clsco.cli.process import run; run()", *words],
        stderr=theirs, stdout=subprocess.DEVNULL, cwd=Path(__file__).parents[2], env=os.environ | {"TERM": "xterm"},
    )  # fmt: skip
    os.close(theirs)
    shown = b""
    with suppress(OSError):  # when the other end is closed
        while chunk := os.read(ours, 4096):
            shown += chunk
    os.close(ours)
    assert process.wait(60) == 0
    assert b"frames" in shown
    assert b"1/1" in shown


def test_programs_get_lines_of_json(tmp_path: Path) -> None:
    scene = scene_file(tmp_path / "scene.toml", f"[sequence]\nframes = 3\n{PLANE}")
    words = ["render", scene, "-o", tmp_path / "out", "--progress", "json", "--quiet"]
    result = clsco_(*words)
    assert (result.exit_code, result.stdout) == (0, "")
    said = [json.loads(line) for line in result.stderr.splitlines()]
    assert said[0] == {"progress": "frames", "done": 0, "total": 3}
    assert said[-1] == {"progress": "frames", "done": 3, "total": 3}
    assert [each["done"] for each in said] == sorted(each["done"] for each in said)
    result = clsco_(*words, "--resume")
    assert [json.loads(line)["total"] for line in result.stderr.splitlines()] == [0]


def test_lines_of_json_tell_the_position_within_a_frame(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("clsco.cli.progress.WITHIN_S", 0.01)
    scene = scene_file(tmp_path / "scene.toml", f"[sequence]\nsamples = 64\n{PLANE}motion.velocity = [9.0, 0.0, 0.0]\n")
    result = done("render", scene, "-o", tmp_path / "out", "--progress", "json")
    said = [json.loads(line) for line in result.stderr.splitlines()]
    within = [each for each in said if "step" in each]
    assert any(each["step"] for each in within)
    assert all(0 <= each["share"] <= 1 and each["sample"] <= max(each["samples"], 1) for each in within)
    assert said[-1] == {"progress": "frames", "done": 1, "total": 1}
