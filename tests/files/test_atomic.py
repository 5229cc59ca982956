"""Writing: a frame's files hold the frame, and a file is whole on the disk or not there."""

from __future__ import annotations

import errno
import json
import os
import resource
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest

from clsco import resources
from clsco.errors import FileError
from clsco.files.atomic import make_writable_folder
from clsco.files.images import read_image, write_exr, write_json, write_npz, write_png
from clsco.files.transfer import encode
from clsco.frame.channels import exr_channels
from clsco.frame.files import files_of, frame_files, read_complete, write_frame
from clsco.frame.frame import Frame
from clsco.frame.outputs import FILE_NAMES, TRUTH_NAMES

NPZ, BOTH = files_of("", "npz"), files_of("", "npz,exr")
GRAY = np.arange(256, dtype=np.uint8).reshape(8, 32)
COLOR = np.random.default_rng(7).integers(0, 65536, (300, 300, 3), "u2")
LIGHT = np.random.default_rng(7).random((300, 300), "f4")


def frame(channels: int) -> Frame:
    generator = np.random.default_rng(3)
    shape = (6, 8) if channels == 1 else (6, 8, 3)
    shapes = {"color": shape, "sharp": shape, "depth": (6, 8), "blur_radius": (6, 8), "normal": (6, 8, 3)}
    arrays = arrays_of(generator, shapes | {"flow": (6, 8, 2)}, ("mask", "missing", "hidden"))
    arrays["depth"][0] = np.inf
    codes: Any = {
        "filled": generator.integers(0, 3, (6, 8), "u1"),
        "object_id": generator.integers(-1, 3, (6, 8), "i4"),
    }
    return Frame(index=3, **arrays, **codes, metadata={"title": "Kugel, groß"})


def arrays_of(generator: np.random.Generator, shapes: Mapping[str, tuple[int, ...]], masks: tuple[str, ...]) -> Any:
    """Floats from -0.2 to 1.3 of these shapes, and masks of 6 x 8 pixels."""
    floats = {name: (generator.random(shape) * 1.5 - 0.2).astype("f4") for name, shape in shapes.items()}
    return floats | {name: generator.random((6, 8)) < 0.5 for name in masks}


@pytest.mark.parametrize("channels", [1, 3])
def test_frame_files_hold_the_frame(tmp_path: Path, channels: int) -> None:
    shown = frame(channels)
    content = write_frame(tmp_path, (shown,), 32, "srgb", BOTH)
    names = ["frame_0003.exr", "frame_0003.json", "frame_0003.npz", "frame_0003.png"]
    assert sorted(path.name for path in tmp_path.iterdir()) == names
    assert json.loads((tmp_path / "frame_0003.json").read_text("utf-8")) == content
    assert content["title"] == "Kugel, groß"
    assert sorted(content["files"]) == [name for name in names if not name.endswith("json")]

    image = read_image(tmp_path / "frame_0003.png")
    np.testing.assert_array_equal(image.data, encode(shown.color, 16, "srgb"), strict=True)
    with np.load(tmp_path / "frame_0003.npz", allow_pickle=False) as truth:
        assert set(truth.files) == {FILE_NAMES[name] for name in ("color", *TRUTH_NAMES)} > {"coc"}
        for name in ("color", *TRUTH_NAMES):
            np.testing.assert_array_equal(truth[FILE_NAMES[name]], getattr(shown, name), strict=True)

    stored = OpenEXR.File(str(tmp_path / "frame_0003.exr"), separate_channels=True).channels()
    frame_channels = exr_channels(shown.arrays())
    assert set(stored) == set(frame_channels)
    expected = "R G B A Z coc sharp.R sharp.G sharp.B N.X N.Y N.Z flow.u flow.v id mask filled missing hidden"
    assert set(stored) == set(expected.split())
    for name, channel in stored.items():
        np.testing.assert_array_equal(channel.pixels, frame_channels[name].astype("f4"), strict=True)
    assert shown.flow is not None
    np.testing.assert_array_equal(stored["flow.v"].pixels, shown.flow[..., 1])
    np.testing.assert_array_equal(stored["B"].pixels, shown.color.reshape(6, 8, -1)[..., -1])


def pair() -> tuple[Frame, Frame]:
    """Two views of different content."""
    generator = np.random.default_rng(4)
    shapes: dict[str, Any] = {"subframes": (2, 6, 8), "flow_backward": (6, 8, 2), "uv": (6, 8, 2)}
    shapes |= {"color": (6, 8), "disparity": (6, 8), "alpha": (6, 8)}
    left, right = (
        replace(
            frame(1), **arrays_of(generator, shapes, ("occluded", "flow_occluded")), eye=eye,
            metadata={"guard_px": guard},
        )
        for eye, guard in (("left", 4), ("right", 5))
    )  # fmt: skip
    return left, right


def test_a_stereo_pair_has_files_of_each_view_and_one_exr(tmp_path: Path) -> None:
    views = pair()
    content = write_frame(tmp_path, views, 8, "linear", BOTH, {"title": "Pair"})
    endings = (".npz", ".png", "_sample_00.png", "_sample_01.png")
    apart = [f"frame_0003_{eye}{ending}" for eye in ("left", "right") for ending in endings]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["frame_0003.exr", "frame_0003.json", *apart]
    assert set(content["files"]) == frame_files(3, True, BOTH, 2) == {"frame_0003.exr", *apart}
    assert content["views"] == {"left": {"guard_px": 4}, "right": {"guard_px": 5}}
    assert content["title"] == "Pair"
    assert read_complete(tmp_path, 3) == content

    parts = OpenEXR.File(str(tmp_path / "frame_0003.exr"), separate_channels=True).parts
    assert [part.name() for part in parts] == [part.header["view"] for part in parts] == ["left", "right"]
    for shown, part in zip(views, parts, strict=True):
        frame_channels = exr_channels(shown.arrays())
        assert set(part.channels) == set(frame_channels)
        assert set(part.channels) >= {"R", "Z", "flow.u", "flow_backward.v", "flow_occluded", "disparity", "occluded"}
        for name, channel in part.channels.items():
            np.testing.assert_array_equal(channel.pixels, frame_channels[name].astype("f4"), strict=True)
        np.testing.assert_array_equal(part.channels["disparity"].pixels, shown.disparity, strict=True)
        stem = f"frame_0003_{shown.eye}"
        np.testing.assert_array_equal(read_image(tmp_path / f"{stem}.png").data, encode(shown.color, 8, "linear"))
        with np.load(tmp_path / f"{stem}.npz", allow_pickle=False) as truth:
            files = {name: file for name, file in FILE_NAMES.items() if getattr(shown, name) is not None}
            assert set(truth.files) == set(files.values())
            for name, in_file in files.items():
                np.testing.assert_array_equal(truth[in_file], getattr(shown, name), strict=True)

    (tmp_path / "frame_0003_right.png").write_bytes((tmp_path / "frame_0003_left.png").read_bytes())
    assert read_complete(tmp_path, 3) is None


@pytest.mark.parametrize("broken", ["write_png", "write_npz", "write_exr"])
def test_a_pair_is_written_together_or_not_at_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, broken: str) -> None:
    from clsco.frame import files as framefiles

    write = getattr(framefiles, broken)
    name = "frame_0003.exr" if broken == "write_exr" else f"frame_0003_right.{broken[-3:]}"

    def last_fails(path: Path, *arguments: object, **options: object) -> None:
        if path.name == name:
            raise FileError(f"{path}: the file must be writable; got No space left on device")
        write(path, *arguments, **options)

    monkeypatch.setattr(framefiles, broken, last_fails)
    with pytest.raises(FileError) as caught:
        write_frame(tmp_path, pair(), 8, "linear", BOTH)
    assert str(caught.value) == f"{tmp_path / name}: the file must be writable; got No space left on device"
    assert list(tmp_path.iterdir()) == []


def test_frame_without_truth(tmp_path: Path) -> None:
    write_frame(tmp_path, (Frame(12345, np.full((2, 3), 0.5, "f4")),), 8, "linear", NPZ)
    assert read_image(tmp_path / "frame_12345.png").data.tolist() == [[128] * 3] * 2
    with np.load(tmp_path / "frame_12345.npz") as truth:
        assert truth.files == ["color"]


def test_frame_is_complete_or_not(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shown = frame(1)
    assert read_complete(tmp_path, 3) is None
    content = write_frame(tmp_path, (shown,), 8, "srgb", NPZ)
    assert read_complete(tmp_path, 3) == content
    (tmp_path / "frame_0003.png").write_bytes(b"x")
    assert read_complete(tmp_path, 3) is None

    content = write_frame(tmp_path, (shown,), 8, "srgb", NPZ)
    with monkeypatch.context() as patch:
        patch.setattr("clsco.frame.files.write_npz", lambda *_: (_ for _ in ()).throw(FileError("disk")))
        with pytest.raises(FileError, match="disk"):
            write_frame(tmp_path, (replace(shown, color=1 - shown.color),), 8, "srgb", NPZ)
    assert read_complete(tmp_path, 3) == content  # the older frame is still there
    monkeypatch.setattr("clsco.frame.files.write_json", lambda *_: (_ for _ in ()).throw(FileError("disk")))
    with pytest.raises(FileError, match="disk"):
        write_frame(tmp_path, (shown,), 8, "srgb", NPZ)
    assert read_complete(tmp_path, 3) is None  # new files, and none that says they are whole
    (tmp_path / "frame_0003.json").write_text("[]")
    assert read_complete(tmp_path, 3) is None


def test_same_content_gives_same_bytes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = write_frame(tmp_path, (frame(3),), 8, "srgb", BOTH)
    later = time.gmtime(time.time() + 100_000)
    monkeypatch.setattr(time, "localtime", lambda _=None: later)  # what archives put beside a name
    assert write_frame(tmp_path, (frame(3),), 8, "srgb", BOTH) == first


WRITERS: dict[str, Callable[[Path], None]] = {
    "png": lambda path: write_png(path, COLOR),
    "npz": lambda path: write_npz(path, {"color": LIGHT}),
    "exr": lambda path: write_exr(path, {"R": LIGHT}),
    "json": lambda path: write_json(path, {"numbers": list(range(100_000))}),
}


@pytest.mark.parametrize("failure", ["fsync", "replace", "disk", "interrupt"])
@pytest.mark.parametrize("write", WRITERS.values(), ids=WRITERS)
def test_failed_writing_leaves_what_was_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, write: Callable[[Path], None], failure: str
) -> None:
    path = tmp_path / "file.bin"
    path.write_bytes(b"before")

    def fail(*_arguments: object) -> None:
        if failure == "interrupt":
            raise KeyboardInterrupt
        raise OSError(errno.ENOSPC, "No space left on device")

    limit = resource.getrlimit(resource.RLIMIT_FSIZE)
    if failure == "disk":  # the system refuses byte 50,001 in the middle of the file
        resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, limit[1]))
    else:
        monkeypatch.setattr(Path if failure == "replace" else os, "replace" if failure == "replace" else "fsync", fail)
    try:
        with pytest.raises(KeyboardInterrupt if failure == "interrupt" else FileError) as caught:
            write(path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limit)
    if failure != "interrupt":
        assert str(caught.value).startswith(f"{path}: the file must be writable; got ")
        assert str(caught.value).isprintable()
    assert path.read_bytes() == b"before"
    assert list(tmp_path.iterdir()) == [path]
    monkeypatch.undo()
    write(path)
    assert path.stat().st_size > 50_000
    assert list(tmp_path.iterdir()) == [path]


def test_writing_shows_nothing_unfinished(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[list[str]] = []
    monkeypatch.setattr(os, "fsync", lambda _: seen.append([path.name for path in tmp_path.iterdir()]))
    write_png(tmp_path / "file.png", GRAY)
    ((name,),) = seen
    assert name.startswith(f".file.png.{resources._HOST}-{os.getpid()}-")
    assert name.endswith(".part")


def test_unwritable_places(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"")
    (tmp_path / "folder" / "inner").mkdir(parents=True)
    for path in (tmp_path / "none" / "a.png", tmp_path / "file" / "a.png", tmp_path / "folder", tmp_path / "a\0.png"):
        with pytest.raises(FileError, match="the file must be writable; got "):
            write_png(path, GRAY)
    with pytest.raises(FileError, match="the file must be writable; got Out of range float"):
        write_json(tmp_path / "a.json", {"x": float("nan")})
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "folder"]

    assert make_writable_folder(tmp_path / "new" / "deep") == tmp_path / "new" / "deep"
    assert list((tmp_path / "new" / "deep").iterdir()) == []
    for path in (tmp_path / "file", tmp_path / "file" / "below", Path("/proc/nothing"), tmp_path / "a\0"):
        with pytest.raises(FileError, match="must be a folder that can be written; got "):
            make_writable_folder(path)


def test_stale_temporary_files_are_removed(tmp_path: Path) -> None:
    with subprocess.Popen([sys.executable, "-c", ""]) as process:
        process.wait()
    host = resources._HOST
    alive = tmp_path / resources.work_name(".a.png", "0")
    parent = tmp_path / f".a.png.{host}-{os.getppid()}-0-0.part"
    stale = tmp_path / f".a.png.{host}-{process.pid}-0-0.part"
    earlier = tmp_path / f".a.png.{host}-{os.getpid()}-0-0.part"  # of a process that had this one's number
    foreign = tmp_path / ".foreign.part"
    for path in (alive, parent, stale, earlier, foreign, tmp_path / "a.part"):
        path.touch()
    folder = tmp_path / f".frame_0000.{host}-{process.pid}-1-0.part"
    folder.mkdir()
    (folder / "frame_0000.png").touch()
    resources.remove_left(tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted([alive.name, parent.name, foreign.name, "a.part"])
