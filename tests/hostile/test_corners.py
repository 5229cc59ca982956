"""Corners that hostile input has found, each with the fault that it had."""

from __future__ import annotations

import errno
import json
import os
import sys
import warnings
from pathlib import Path
from typing import Any

import click
import numpy as np
import pytest

from clsco.engine.batch import prepare
from clsco.errors import FileError
from clsco.files import decoders
from clsco.files.atomic import is_same_place
from clsco.files.images import read_image
from clsco.frame.files import read_complete
from clsco.inputs.depth_files import read_depth
from clsco.plan.prepare import prepare as planned
from clsco.plan.prepare import prepare_sweep
from clsco.scene.sweep import parse_sweep
from tests.command import clsco_
from tests.hostile.pictures import exr
from tests.scenes import refusals


def test_a_value_nested_too_deeply_for_a_label() -> None:
    deep: Any = 1
    for _ in range(3000):
        deep = [deep]
    for value in ([deep], {"a": deep}):
        messages = refusals(parse_sweep, {"camera": {"f_number": value}, "object": [{"shape": "plane"}]})
        assert messages[0].startswith("scene: camera.f_number")
    scene = {"camera": {"f_number": [deep]}, "object": [{"shape": "plane"}]}
    nested = "scene: camera.f_number[0]: nested too deeply; got a list of 1 entries"
    assert nested in refusals(parse_sweep, scene)


def test_many_keys_with_several_values_make_a_short_message() -> None:
    items = [{"shape": "plane", "motion": {"velocity": [[1, 0, 0], [2, 0, 0]]}} for _ in range(60)]
    (message,) = refusals(parse_sweep, {"object": items})
    assert " and 56 more: must give at most 4096 scenes in all; got " in message


def test_a_cone_whose_apex_turns_in_the_lens_is_planned_without_a_warning() -> None:
    motion = {"angular_velocity": [5.0, 0.001, 0.0]}
    sweep = parse_sweep({"object": [{"shape": "cone", "apex": [0, 0, 0], "half_angle": 50.0, "motion": motion}]})
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        prepare_sweep(sweep)


def test_a_frame_is_not_taken_for_whole_by_what_its_json_names(tmp_path: Path) -> None:
    described = tmp_path / "frame_0000.json"
    os.mkfifo(tmp_path / "pipe")
    for content in (
        '{"files": {"/dev/zero": "x"}}', '{"files": {"pipe": "x"}}', '{"files": {"../x": "x"}}', "[" * 100_000, "3",
    ):  # fmt: skip
        described.write_text(content)
        assert read_complete(tmp_path, 0) is None
    (tmp_path.parent / "outside").write_bytes(b"")
    empty = "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855"
    described.write_text(json.dumps({"files": {"../outside": empty}}))
    assert read_complete(tmp_path, 0) is None
    described.unlink()
    os.mkfifo(described)
    assert read_complete(tmp_path, 0) is None


def test_resuming_in_a_folder_of_another_kind_of_scene(tmp_path: Path) -> None:
    """A pair where a single frame has been rendered: its JSON file tells of no views."""
    (scene,) = parse_sweep({"stereo": {"baseline": 6}, "object": [{"shape": "plane"}]}).scenes
    (tmp_path / "frame_0000.json").write_text('{"files": {}}')
    assert prepare(planned(scene), tmp_path, [0], (), resume=True).frames == (0,)


def test_a_scene_file_is_not_overwritten_by_its_frames(tmp_path: Path) -> None:
    scene = tmp_path / "frame_0000.json"
    scene.write_text('{"camera": {"resolution": [12, 9]}, "object": [{"shape": "plane"}]}')
    before = scene.read_bytes()
    refused = clsco_("render", scene, "-o", tmp_path)
    assert refused.exit_code == 1
    assert "a scene file must not lie where frames are written; got " in refused.stderr
    assert scene.read_bytes() == before


def test_a_link_to_itself_is_a_place(tmp_path: Path) -> None:
    (tmp_path / "loop").symlink_to("loop")
    assert is_same_place(tmp_path / "loop", tmp_path / "loop")
    assert not is_same_place(tmp_path / "loop", tmp_path)


def test_an_image_with_too_many_channels(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, plane = tmp_path / "a.exr", np.ones((9, 12), "f4")
    path.write_bytes(exr(R=plane, G=plane, B=plane, x=plane))
    assert read_image(path).data.shape == (9, 12, 3)
    monkeypatch.setattr(decoders, "LARGEST_EXR", 400)
    for read in (read_image, read_depth):
        with pytest.raises(FileError, match=r"must hold at most 400 values; got 4 channels of 12 x 9"):
            read(path)


def test_an_output_that_cannot_be_written(monkeypatch: pytest.MonkeyPatch) -> None:
    echo = click.echo

    def full(message: str, err: bool = False, nl: bool = True) -> None:
        if not err:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        echo(message, err=err, nl=nl)

    monkeypatch.setattr(click, "echo", full)
    refused = clsco_("schema")
    assert (refused.exit_code, refused.stdout) == (1, "")
    assert refused.stderr == "error: output: must be writable; got No space left on device\n"


def test_nothing_is_printed_where_stdout_is_closed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from clsco.cli.progress import progress
    from clsco.cli.tables import print_tables

    monkeypatch.setattr(sys, "stdout", None)
    monkeypatch.setattr(sys, "stderr", None)
    print_tables("x")
    with progress(3, quiet=False) as advance:
        advance()
