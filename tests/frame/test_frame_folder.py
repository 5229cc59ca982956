"""Frames found in a folder: those of `write_frame`, with holes, and of strangers."""

from __future__ import annotations

import json
import os
import zipfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from clsco.errors import FileError, SceneError
from clsco.files.arrays import read_exr, read_npz
from clsco.files.images import write_exr, write_npz
from clsco.frame.files import files_of, write_frame
from clsco.frame.frame import Frame
from clsco.frame.frame_folder import read_frame_folder

SCENE = {"sequence": {"interval": 0.04, "frames": 9}, "image": {"transfer": "linear"}}


def frames(folder: Path, numbers: Sequence[int], truth: str = "", stereo: bool = False, scene: Any = SCENE) -> None:
    for number in numbers:
        generator = np.random.default_rng(number)
        one = Frame(
            number,
            generator.random((4, 6, 3), "f4"),
            sharp=generator.random((4, 6, 3), "f4"),
            depth=generator.random((4, 6), "f4"),
            flow=generator.random((4, 6, 2), "f4"),
        )
        views = [replace(one, eye="left"), replace(one, eye="right", color=1 - one.color)] if stereo else [one]
        about = {"scene": {**scene, "stereo": {}} if stereo else scene, "scene_sha256": "abc"}
        write_frame(folder, views, 8, "linear", files_of("", truth), about)


def test_frames_are_found_with_what_a_clip_needs(tmp_path: Path) -> None:
    frames(tmp_path, range(3, 7), "npz")
    found = read_frame_folder(tmp_path)
    assert (found.numbers, found.eyes, found.of) == (range(3, 7), ("",), 9)
    assert (found.interval, found.transfer) == (0.04, "linear")
    assert found.scenes == {"abc"}
    assert [image.shape for image in found.images()] == [(4, 6, 3)] * 4
    with np.load(tmp_path / "frame_0004.npz") as arrays:
        for name in ("color", "sharp", "depth", "flow"):
            np.testing.assert_array_equal(list(found.arrays(name))[1], arrays[name], strict=True)
    assert read_frame_folder(tmp_path, range(4, 6)).numbers == range(4, 6)


def test_arrays_come_from_exr_too(tmp_path: Path) -> None:
    frames(tmp_path, [0], "npz,exr", stereo=True)
    found = read_frame_folder(tmp_path)
    assert found.eyes == ("left", "right")
    for eye in found.eyes:
        for name in ("color", "sharp", "depth", "flow"):
            (one,) = found.arrays(name, eye)
            npz = tmp_path / f"frame_0000_{eye}.npz"
            away = npz.rename(tmp_path / "away.npz")
            (other,) = found.arrays(name, eye)
            np.testing.assert_array_equal(one, other, strict=True)
            away.rename(npz)
    (tmp_path / "frame_0000_left.npz").unlink()
    with pytest.raises(FileError, match=r"frame_0000.exr: must hold the channel coc; got none of this name"):
        list(found.arrays("coc", "left"))
    (tmp_path / "frame_0000.exr").unlink()
    with pytest.raises(FileError, match=r"must hold frame_0000_left.npz or frame_0000.exr, with"):
        list(found.arrays("depth", "left"))


def faults(folder: Path) -> list[str]:
    with pytest.raises(SceneError) as caught:
        read_frame_folder(folder)
    return [message.removeprefix(f"{folder}{os.sep}") for message in caught.value.messages]


def test_holes_are_named(tmp_path: Path) -> None:
    frames(tmp_path, [0, 1, 3, 6])
    (tmp_path / "frame_0001.json").unlink()
    (tmp_path / "frame_0003.png").unlink()
    assert faults(tmp_path) == [
        "frame_0002.json: must be there, as a clip has no hole in its frames; got 1 and then 3",
        "frame_0004.json: must be there, as a clip has no hole in its frames; got 3 and then 6",
        "frame_0001.json: must be there and readable, as it makes its frame whole; got No such file or directory",
        "frame_0003.png: must be there, as frame_0003.json is; got none",
    ]


def test_a_folder_without_frames_is_refused(tmp_path: Path) -> None:
    assert faults(tmp_path) == [f"{tmp_path}: must hold frames from clsco render, frame_0000.json and so on; got none"]
    for place in (tmp_path / "none", tmp_path / "file"):
        (tmp_path / "file").touch()
        with pytest.raises(FileError, match="must be a folder of frames; got N"):
            read_frame_folder(place)


def test_frames_of_different_scenes_are_refused(tmp_path: Path) -> None:
    frames(tmp_path, [0, 1])
    frames(tmp_path, [2], scene={"sequence": {"interval": 0.5}})
    (fault,) = faults(tmp_path)
    expected = "interval, transfer and views of frame 0, 0.04 s, linear, one view; got 0.5 s, srgb, one view"
    assert fault == f"frame_0002.json: must have the {expected}"


HOSTILE: list[tuple[bytes, str]] = [
    (b"", "must be JSON; got JSONDecodeError"),
    (b"[" * 100_000, "must be JSON; got RecursionError"),
    (b"[]", "must be a table; got list"),
    (b"{}", "scene: must be a table, as clsco render writes it; got NoneType"),
    (b'{"scene": 3}', "scene: must be a table, as clsco render writes it; got int"),
    (b" " * 5_000_000, "must be there and readable, as it makes its frame whole; got 5000000 bytes, more than 4194304"),
    (b'{"scene": {"sequence": 3}}', "scene.sequence.interval: must be one of a scene; got None"),
    (b'{"scene": {"sequence": {"interval": "1"}}}', "scene.sequence.interval: must be one of a scene; got 1"),
    (b'{"scene": {"sequence": {"interval": NaN}}}', "scene.sequence.interval: must be one of a scene; got nan"),
    (b'{"scene": {"sequence": {"interval": -1}}}', "scene.sequence.interval: must be one of a scene; got -1"),
    (b'{"scene": {"sequence": {"frames": 1e9}}}', "scene.sequence.frames: must be one of a scene; got 1000000000.0"),
    (b'{"scene": {"image": {"transfer": ["srgb"]}}}', "scene.image.transfer: must be one of a scene; got ['srgb']"),
]


@pytest.mark.parametrize(("content", "message"), HOSTILE, ids=range(len(HOSTILE)))
def test_json_of_a_stranger(tmp_path: Path, content: bytes, message: str) -> None:
    frames(tmp_path, [0])
    (tmp_path / "frame_0000.json").write_bytes(content)
    assert f"frame_0000.json: {message}" in faults(tmp_path)


def test_pipes_links_and_huge_numbers(tmp_path: Path) -> None:
    frames(tmp_path, [0])
    (tmp_path / "frame_0000.json").unlink()
    os.mkfifo(tmp_path / "frame_0000.json")
    (tmp_path / "frame_999999999.json").write_text("{}")
    (tmp_path / f"frame_{'9' * 90}.json").write_text("{}")
    (tmp_path / "frame_00001.json").write_text("{}")  # not as frames are called
    found = faults(tmp_path)
    assert "must be there, as a clip has no hole in its frames; got 0 and then 999999999" in found[0]
    rule = "must be there and readable, as it makes its frame whole"
    assert found[1] == f"frame_0000.json: {rule}; got a device or a pipe"


def test_an_interval_of_many_digits(tmp_path: Path) -> None:
    frames(tmp_path, [0])
    text = json.dumps({"scene": SCENE}).replace("0.04", "1" + "0" * 400)
    (tmp_path / "frame_0000.json").write_text(text)
    assert read_frame_folder(tmp_path).interval == 1e300


def test_npz_of_a_stranger(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    wrong: list[tuple[Any, str]] = [
        (np.zeros((2, 2), "i4"), "array depth must hold floats of shape .*; got int32 of shape"),
        (np.zeros((2, 2, 4), "f4"), "array depth must hold floats of shape .*; got float32 of shape"),
        (np.zeros(3, "f4"), "array depth must hold floats of shape"),
    ]
    for array, message in wrong:
        write_npz(path, {"depth": array})
        with pytest.raises(FileError, match=message):
            read_npz(path, ["depth"])
    with pytest.raises(FileError, match="must hold the array coc; got none of this name"):
        read_npz(path, ["coc"])
    with zipfile.ZipFile(path, "w") as archive, archive.open("depth.npy", "w") as member:
        header = {"descr": "<f4", "fortran_order": False, "shape": (60000, 60000)}
        np.lib.format.write_array_header_1_0(member, header)
    with pytest.raises(FileError, match=r"at most 134217728 pixels; got 60000 x 60000"):
        read_npz(path, ["depth"])
    path.write_bytes(b"PK\x03\x04 no archive")
    with pytest.raises(FileError, match="must be a whole NPZ"):
        read_npz(path, ["depth"])


def test_exr_of_a_stranger(tmp_path: Path) -> None:
    path = tmp_path / "a.exr"
    write_exr(path, {"Z": np.zeros((2, 3), "f4")})
    assert read_exr(path, ["Z"])[0].shape == (2, 3)
    with pytest.raises(FileError, match=r"must hold the channel Z; got none of this name in the view left"):
        read_exr(path, ["Z"], "left")
    path.write_bytes(path.read_bytes()[:300])
    with pytest.raises(FileError, match="must be a whole EXR"):
        read_exr(path, ["Z"])
