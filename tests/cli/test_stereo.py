"""Stereo pairs on the command line: files of both views, resumed as one, planned and checked view by view."""

from __future__ import annotations

import re
from functools import partial
from pathlib import Path

import pytest

import clsco
from clsco.cli.check import compare_frames
from clsco.engine import batch
from clsco.engine.sequence import render_prepared
from clsco.frame.files import read_complete
from clsco.opencl.session import Session
from clsco.plan.prepare import Prepared
from tests.cli.test_main import rendered_again
from tests.command import clsco_, done
from tests.scenes import scene_file

PAIR = """
title = "Pair"
[camera]
resolution = [40, 24]
pixel_pitch = 0.1
[stereo]
baseline = 6.0
[sequence]
frames = 2
samples = 2
[[object]]
name = "ball"
shape = "sphere"
center = [0.0, 0.0, 200.0]
radius = 9.0
[object.motion]
velocity = [3.0, 0.0, 0.0]
[[object]]
name = "wall"
shape = "plane"
distance = 380.0
texture = "checkerboard"
"""


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    return scene_file(tmp_path / "pair.toml", PAIR)


@pytest.mark.slow
def test_a_pair_is_resumed_as_one(scene: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    redone = partial(rendered_again, out, "render", scene, "-o", out, "--resume")
    assert clsco_("render", scene, "-o", out).exit_code == 0
    assert redone() == set()
    first = {"frame_0000.json", "frame_0000_left.png", "frame_0000_right.png"}
    (out / "frame_0000_right.png").write_bytes((out / "frame_0000_left.png").read_bytes())
    assert redone() == first
    (out / "frame_0000_left.png").unlink()
    assert redone() == first
    assert redone("--format", "exr", "--frames", ":1") == first | {"frame_0000.exr"}
    assert redone("--precision", "double") == set()
    assert redone("--precision", "single", "--frames", ":1") == first
    content = read_complete(out, 0)
    assert content is not None
    assert {view["precision"] for view in content["views"].values()} == {"single"}
    alone = "\n".join(line for line in PAIR.splitlines() if "stereo" not in line and "baseline" not in line)
    scene.write_text(alone)
    assert redone("--frames", ":1") == {"frame_0000.json", "frame_0000.png"}


def test_scenes_that_share_rays_are_those_rendered_alone(scene: Path, tmp_path: Path) -> None:
    sweep = ["--set", "camera.f_number=[2, 8]", "--frames", "1:", "--format", "npz"]
    assert batch.TOGETHER > 2
    assert clsco_("render", scene, "-o", tmp_path / "out", *sweep).exit_code == 0
    for number in (2, 8):
        alone = ["--set", f"camera.f_number={number}", *sweep[2:]]
        assert clsco_("render", scene, "-o", tmp_path / "alone", *alone).exit_code == 0
        for name in ("left.png", "left.npz", "right.png", "right.npz"):
            places = (tmp_path / folder / f"frame_0001_{name}" for folder in (f"out/f_number_{number}", "alone"))
            assert len({path.read_bytes() for path in places}) == 1


@pytest.mark.slow
@pytest.mark.parametrize("limit", ["TOGETHER", "PIXELS_TOGETHER"])
def test_long_sweeps_are_rendered_in_parts(
    scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, limit: str
) -> None:
    sizes: list[int] = []

    def counted(session: Session, prepared: list[Prepared], frames: list[int]) -> object:
        sizes.append(len(prepared))
        return render_prepared(session, prepared, frames)

    monkeypatch.setattr(batch, "render_prepared", counted)
    monkeypatch.setattr(batch, limit, 2 if limit == "TOGETHER" else 2 * 40 * 24)
    values = ["--set", "camera.f_number=[2, 3, 4, 5, 6]", "--frames", ":1"]
    assert clsco_("render", scene, "-o", tmp_path / "out", *values).exit_code == 0
    assert sizes == [2, 2, 1]
    assert len(list((tmp_path / "out").glob("*/frame_0000_right.png"))) == 5


def test_the_plan_reports_both_views(scene: Path) -> None:
    result = clsco_("plan", scene, "--set", "stereo.toe_in=1.5", "--format", "npz")
    text = " ".join(result.output.split())
    assert "views left and right, 6 mm apart, each turned inwards by 1.5 deg" in text
    assert "disparity, occluded" in text
    still = clsco_("plan", scene, "--set", "object.0.motion.velocity=[0, 0, 0]")
    text = " ".join(still.output.split())
    assert "texture sampling (left) nothing moves" in text
    rays = "rays against the sphere, plane, one per pixel texture sampling bicubic"
    assert re.search(rf"trace \(right\) 2 [\d.]+ [\d.]+ m?s {rays}", text)


def test_every_view_is_checked(scene: Path) -> None:
    result = done("check", "--rays", 0, scene, "--set", "sequence.frames=1", "--precision", "double")
    for view in ("left", "right"):
        assert f"Frame 0, {view} view, against the reference" in result.output
    words = result.output.split()
    assert [words.count(name) for name in ("disparity", "occluded", "flow_backward", "flow_occluded")] == [2] * 4


@pytest.mark.slow
@pytest.mark.parametrize("warp", ["inverse", "forward"])
def test_views_turned_inwards_agree_with_the_reference(scene: Path, warp: str) -> None:
    words = ["stereo.toe_in=1.5", "sequence.frames=1", f"motion.warp={warp}"]
    views = list(compare_frames(clsco.load_scene(scene, words), None, "double"))
    assert [checked.frame.eye for checked in views] == ["left", "right"]
    assert [difference for checked in views for difference in checked.differences if difference.count] == []
    # The texture is that of the camera that is not turned: 1.5 deg are 20 mm / 0.1 mm * tan(1.5 deg) = 5.2 columns.
    frame = next(clsco.render(clsco.load_scene(scene, [*words, "object.0.motion.velocity=[0, 0, 0]"])))
    assert frame.hidden is not None
    assert frame.hidden.mean() == pytest.approx(5 / 40, abs=1 / 40)


def test_a_fault_of_the_right_view_alone_is_reported_before_anything_is_written(tmp_path: Path) -> None:
    # The plane falls towards the right: 250 - 2.497 * 100 = 0.3 mm before the right camera.
    wall = '[camera]\nresolution = [40, 24]\n[[object]]\nshape = "plane"\nslope_x = -2.497\n'
    path = scene_file(tmp_path / "wall.toml", wall)
    assert clsco_("validate", path).exit_code == 0
    path.write_text(f"[stereo]\nbaseline = 100.0\n{wall}")
    for words in (("validate", path), ("render", path, "-o", tmp_path / "out")):
        result = clsco_(*words)
        assert result.exit_code == 1
        assert "the surface comes as near as 0.29" in result.stderr
    assert not (tmp_path / "out").exists()
