"""Sweeps on the command line: a folder for each value, resumed one by one, and reported by the other commands."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.cli.test_main import marks, messages, names
from tests.command import clsco_, done
from tests.scenes import PLANE, scene_file

PLACE = 'distance = 300.0\ntexture = "texture.npy"\n'
STACK = PLANE.replace("[camera]", "[camera]\nf_number = { from = 2, to = 4, steps = 3 }") + PLACE


@pytest.fixture
def still(tmp_path: Path) -> Path:
    return scene_file(tmp_path / "still.toml", PLANE)


@pytest.fixture
def stack(tmp_path: Path) -> Path:
    np.save(tmp_path / "texture.npy", np.random.default_rng(3).random((9, 12), np.float32))
    return scene_file(tmp_path / "stack.toml", STACK)


def test_every_value_of_a_sweep_has_a_folder(stack: Path, still: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    more = ["--set", "sequence.frames=[1, 2]"]
    assert clsco_("render", stack, "-o", out, *more, "--frames", ":1").exit_code == 0
    labels = [f"f_number_{number}__frames_{count}" for number in (2, 3, 4) for count in (1, 2)]
    assert names(out) == [f"{label}/frame_0000.{suffix}" for label in labels for suffix in ("json", "png")]
    for number in (2, 3, 4):
        alone = tmp_path / f"alone_{number}"
        assert clsco_("render", stack, "-o", alone, "--set", f"camera.f_number={number}").exit_code == 0
        picture = (alone / "frame_0000.png").read_bytes()
        assert picture == (out / f"f_number_{number}__frames_2" / "frame_0000.png").read_bytes()
    pictures = {(out / label / "frame_0000.png").read_bytes() for label in labels}
    assert len(pictures) == 3  # each f-number has its own blur
    several = tmp_path / "several"
    assert clsco_("render", stack, still, "-o", several, "--frames", ":1").exit_code == 0
    expected = [*(f"stack/f_number_{number}" for number in (2, 3, 4)), "still"]
    assert names(several) == [f"{place}/frame_0000.{suffix}" for place in expected for suffix in ("json", "png")]


def test_resume_renders_the_values_that_are_missing(stack: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert clsco_("render", stack, "-o", out).exit_code == 0
    (out / "f_number_3" / "frame_0000.png").unlink()
    before = {label: marks(out / label) for label in ("f_number_2", "f_number_3", "f_number_4")}
    assert clsco_("render", stack, "-o", out, "--resume").exit_code == 0
    assert {label for label in before if marks(out / label) != before[label]} == {"f_number_3"}
    wider = ["--set", "camera.f_number=[2, 8]", "--resume"]
    assert clsco_("render", stack, "-o", out, *wider).exit_code == 0
    assert marks(out / "f_number_2") == before["f_number_2"]
    assert names(out / "f_number_8") == ["frame_0000.json", "frame_0000.png"]


def test_a_sweep_is_reported_by_the_other_commands(stack: Path, still: Path) -> None:
    result = clsco_("plan", stack)
    assert result.output.splitlines()[0] == "the first of 3 scenes, f_number_2:"
    assert "first of" not in clsco_("plan", still).output
    result = done("check", "--rays", 0, stack, "--set", "camera.f_number=[16, 8]")
    assert result.output.splitlines()[0] == "the first of 2 scenes, f_number_16:"
    assert result.output.count("Frame 0") == 1
    result = clsco_("validate", stack, still)
    assert result.output == f"{stack}: valid, 3 scenes\n{still}: valid\n"


def test_a_bad_value_of_a_sweep_is_reported_before_anything_is_written(stack: Path, tmp_path: Path) -> None:
    command = ("render", stack, "-o", tmp_path / "out", "--set")
    (line,) = messages(clsco_(*command, "camera.f_number=[2, 0, 4]"), 1)
    assert line == f"error: {stack}: camera.f_number[1]: must be greater than 0; got 0"
    (line,) = messages(clsco_(*command, "camera.f_number=[2, 0.001]"), 1)
    assert line.startswith(f"error: {stack}: camera: the blur radius must be at most 512 px; got ")
    assert line.endswith(" (with f_number_0.001)")
    (tmp_path / "texture.npy").unlink()
    (line,) = messages(clsco_(*command[:-1]), 1)
    assert line.startswith(f"error: {stack}: object[0].texture: {tmp_path / 'texture.npy'}: must be a file")
    assert not (tmp_path / "out").exists()


def test_commands_say_that_an_image_is_stretched(stack: Path, still: Path, tmp_path: Path) -> None:
    assert clsco_("validate", stack).stderr == ""
    np.save(tmp_path / "texture.npy", np.zeros((9, 9), np.float32))
    line = f"{stack}: object[0].texture: is stretched from 9 x 9 to the frame's 12 x 9 px\n"
    result = clsco_("validate", stack, still)
    assert (result.exit_code, result.stdout) == (0, f"{stack}: valid, 3 scenes\n{still}: valid\n")
    assert (result.stderr, clsco_("plan", stack).stderr) == (line, line)
    result = clsco_("render", stack, "-o", tmp_path / "out", "--quiet", "--set", "camera.resolution=[[12, 9], [8, 8]]")
    assert (result.exit_code, result.stderr) == (0, line)  # of the square frames nothing is to be said
