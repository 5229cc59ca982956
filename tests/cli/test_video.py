"""`clsco video`, `clsco render --video`, `clsco.write_video`: clips of frames, and one line for what is wrong."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import click
import numpy as np
import pytest
from click.testing import Result

import clsco
from clsco.cli import video
from clsco.errors import ArgumentError
from clsco.files.images import read_image, save_image
from clsco.files.video import PRESETS
from tests.command import clsco_
from tests.scenes import scene_file

BALL = """
[camera]
resolution = [48, 32]
pixel_pitch = 0.1
[sequence]
frames = 4
interval = 0.04
samples = 2
[[object]]
shape = "sphere"
[object.motion]
velocity = [20.0, 0.0, 0.0]
"""
PLAYED = "4 frames at 25 frames per second, as sequence.interval = 0.04 s"


def lines(result: Result, status: int) -> list[str]:
    assert result.exit_code == status, result.output
    assert result.exception is None or isinstance(result.exception, SystemExit)
    return result.stderr.splitlines()


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return scene_file(tmp_path_factory.mktemp("scene") / "ball.toml", BALL)


@pytest.fixture(scope="module")
def ball(scene: Path) -> Path:
    """Frames of a ball that moves, with their truth, and a clip."""
    folder = scene.parent / "out"
    result = clsco_("render", scene, "-o", folder, "--format", "npz,exr", "--video", "ffv1")
    assert lines(result, 0) == [f"{folder}/clip.mkv: {PLAYED}"]
    return folder


def decoded(path: Path, form: str = "rgb24") -> tuple[dict[str, str], Any, list[Any]]:
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        pictures = [picture.to_ndarray(format=form) for picture in container.decode(stream)]
        return {key.lower(): value for key, value in container.metadata.items()}, stream.average_rate, pictures


def codes(folder: Path, stem: str = "") -> list[Any]:
    return [read_image(path).data for path in sorted(folder.glob(f"frame_*{stem}.png"))]


def test_render_writes_a_clip_beside_its_frames(ball: Path) -> None:
    about, rate, pictures = decoded(ball / "clip.mkv", "gray")
    assert rate == 25
    np.testing.assert_array_equal(pictures, codes(ball), strict=True)
    assert about["comment"] == f"clsco {clsco.__version__}; {PLAYED}"


def test_a_clip_waits_for_all_frames(scene: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    result = clsco_("render", scene, "-o", out, "--frames", "2:", "--video", "ffv1")
    assert lines(result, 0) == [f"{out}: no clip, as 2 of 4 frames are missing, frame 0 first"]
    assert not (out / "clip.mkv").exists()
    other = scene_file(tmp_path / "other.toml", BALL.replace("20.0", "30.0"))
    assert clsco_("render", other, "-o", out, "--frames", ":1").exit_code == 0
    result = clsco_("render", scene, "-o", out, "--frames", "1:2", "--video", "ffv1")
    assert lines(result, 0) == [f"{out}: no clip, as some of the frames are of another scene"]
    result = clsco_("render", scene, "-o", out, "--resume", "--video", "ffv1")
    assert "4 frames at 25 frames per second" in lines(result, 0)[0]
    (out / "clip.mkv").write_bytes(b"of older frames")
    assert clsco_("render", scene, "-o", out, "--frames", ":1", "--video", "ffv1").exit_code == 0
    assert len(decoded(out / "clip.mkv")[2]) == 4


def test_each_folder_and_each_eye_has_a_clip(scene: Path, tmp_path: Path) -> None:
    short = ["--set", "sequence.frames=2", "--set", "camera.resolution=[24, 16]"]
    sweep = ["--set", "camera.f_number=[2, 4]"]
    assert clsco_("render", scene, "-o", tmp_path / "sweep", *short, *sweep, "--video", "ffv1").exit_code == 0
    for label in ("f_number_2", "f_number_4"):
        folder = tmp_path / "sweep" / label
        np.testing.assert_array_equal(decoded(folder / "clip.mkv", "gray")[2], codes(folder))
    pair = tmp_path / "pair"
    stereo = ["--set", "stereo.baseline=30"]
    assert clsco_("render", scene, "-o", pair, *short, *stereo, "--video", "ffv1").exit_code == 0
    assert clsco_("video", pair, "-o", tmp_path / "other.mkv").exit_code == 0
    for eye in ("left", "right"):
        for clip in (pair / f"clip_{eye}.mkv", tmp_path / f"other_{eye}.mkv"):
            np.testing.assert_array_equal(decoded(clip, "gray")[2], codes(pair, f"_{eye}"))


def test_a_scene_without_a_rate_is_refused_before_it_is_rendered(scene: Path, tmp_path: Path) -> None:
    result = clsco_("render", scene, "-o", tmp_path / "out", "--set", "sequence.interval=2", "--video", "mp4")
    rule = "sequence.interval must give 1 to 240 frames per second; otherwise a rate must be given"
    assert lines(result, 1)[-1] == f"error: {scene}: {rule}; got 2 s"
    result = clsco_("render", scene, "-o", tmp_path / "out", "--video", "hevc10")
    assert lines(result, 1)[-1].startswith(f"error: {scene}: hevc10 needs 66 columns and rows or more")
    assert not (tmp_path / "out").exists()
    result = clsco_("render", scene, "-o", tmp_path / "out", "--video", "gif")
    assert "must be one of mp4, mp4-444, " in lines(result, 2)[-1]


def test_the_default_interval_is_one_frame_per_second(scene: Path, tmp_path: Path) -> None:
    keys = ["--set", "sequence.interval=1", "--set", "sequence.frames=2"]
    (line,) = lines(clsco_("render", scene, "-o", tmp_path, *keys, "--video", "mp4"), 0)
    said = "2 frames at 1 frames per second, as sequence.interval = 1 s; clsco video --fps 24 plays it faster"
    assert line.endswith(said)
    assert decoded(tmp_path / "clip.mp4")[1] == 1


@pytest.mark.parametrize(
    ("words", "rate", "said"),
    [
        (["--fps", "24000/1001"], Fraction(24000, 1001), "24000/1001 frames per second, 0.959041 times the speed"),
        (["--speed", "0.25"], Fraction(25, 4), "25/4 frames per second, 0.25 times the speed of the scene"),
        (["--speed", "1/20"], Fraction(5, 4), "5/4 frames per second, 0.05 times the speed of the scene"),
    ],
)
def test_playing_speed(ball: Path, tmp_path: Path, words: list[str], rate: Fraction, said: str) -> None:
    clip = tmp_path / "clip.mp4"
    (line,) = lines(clsco_("video", ball, "-o", clip, *words), 0)
    about, found, _ = decoded(clip)
    assert (found, said in line, said in about["comment"]) == (rate, True, True)


@pytest.mark.parametrize("view", ["sharp", "coc", "depth", "flow", "compare"])
def test_views(ball: Path, tmp_path: Path, view: str) -> None:
    said = lines(clsco_("video", ball, "-o", tmp_path / "clip.mkv", "--view", view), 0)
    about, _, pictures = decoded(tmp_path / "clip.mkv")
    assert len(pictures) == 4
    assert pictures[0].shape == (32, 96 if view == "compare" else 48, 3)
    if view in ("coc", "depth", "flow"):
        assert said[1].startswith(f"{tmp_path / 'clip.mkv'}: {view}: ")
        assert said[1].partition(": ")[2] in about["comment"]
    else:
        assert len(said) == 1
    if view == "compare":
        np.testing.assert_array_equal([picture[:, 48:, 0] for picture in pictures], codes(ball))
    if view == "flow":
        with np.load(ball / "frame_0000.npz") as arrays:
            seen = arrays["mask"]
        assert (pictures[0][~seen] == 255).all()
        assert (pictures[0][seen][:, 0] > pictures[0][seen][:, 1]).all()  # to the right: red


@pytest.mark.parametrize(
    ("words", "status", "message"),
    [
        (["-o", "a.avi"], 1, "a.avi: the extension must be one of .mp4 .webm .mkv .mov .y4m; got '.avi'"),
        (["-o", "a.mp4", "--preset", "ffv1"], 1, "a.mp4: the extension must be .mkv for ffv1; got '.mp4'"),
        (["-o", "a.mp4", "--fps", "2", "--speed", "2"], 2, "--speed: must be without --fps, which says how fast"),
        (["-o", "a.mp4", "--fps", "29,97"], 2, "must be exact: a Fraction, a whole number, or text like 24"),
        (["-o", "a.mp4", "--speed", "0.01"], 1, "otherwise a rate must be given; got 0.04 s at 0.01 times"),
        (["-o", "a.mp4", "--view", "normal"], 2, "'normal' is not one of"),
        (["-o", "none/a.mp4"], 1, "none/a.mp4: the file must be writable; got No such file or directory"),
        (["-o", "a.mp4", "--preset", "gif"], 2, "must be one of mp4, mp4-444, hevc10"),
    ],
)
def test_wrong_use_is_one_line(
    ball: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: list[str], status: int, message: str
) -> None:
    monkeypatch.chdir(tmp_path)
    said = lines(clsco_("video", ball, *words), status)
    assert message in said[-1]
    assert status == 2 or len(said) == 1
    assert list(tmp_path.iterdir()) == []


def test_plain_images_are_played_in_natural_order(tmp_path: Path) -> None:
    for number in (10, 9, 2):
        save_image(tmp_path / f"a{number}.{'exr' if number == 9 else 'png'}", np.full((2, 4, 3), number / 10, "f4"))
    for path in tmp_path.glob("*.exr"):
        (line,) = lines(clsco_("video", tmp_path, "-o", tmp_path / "a.mkv", "--fps", "5"), 1)
        assert "frame 1: size and type must be those of frame 0, 4 x 2 px, color, uint16; got 4 x 2" in line
        path.unlink()
    said = lines(clsco_("video", tmp_path, "-o", tmp_path / "a.mkv"), 2)
    assert said[-1].startswith("Error: --fps: images that clsco render did not write need it")
    (line, *_) = lines(clsco_("video", tmp_path, "-o", tmp_path / "a.mkv", "--fps", "5"), 0)
    assert line.endswith("a.mkv: 2 images, a2.png to a10.png, at 5 per second")
    pictures = decoded(tmp_path / "a.mkv")[2]
    assert [picture.max() for picture in pictures] == [124, 255]


def test_frames_without_arrays_have_no_views(ball: Path, tmp_path: Path) -> None:
    for path in (*ball.glob("*.png"), *ball.glob("*.json")):
        (tmp_path / path.name).write_bytes(path.read_bytes())
    (line,) = lines(clsco_("video", tmp_path, "-o", tmp_path / "a.mkv", "--view", "depth"), 1)
    rule = "must hold frame_0000.npz or frame_0000.exr, with depth; got neither"
    assert line == f"error: {tmp_path}: {rule}"
    (tmp_path / "frame_0002.png").write_bytes((ball / "frame_0002.png").read_bytes()[:200])
    (line,) = lines(clsco_("video", tmp_path, "-o", tmp_path / "a.mkv"), 1)
    assert line.startswith(f"error: {tmp_path / 'frame_0002.png'}: must be a whole PNG; got ")
    (tmp_path / "frame_0001.json").unlink()
    assert "frame_0001.json: must be there" in lines(clsco_("video", tmp_path, "-o", tmp_path / "a.mkv"), 1)[0]
    assert not list(tmp_path.glob("*.mkv"))
    assert not list(tmp_path.glob(".*"))


def test_the_help_names_all_presets() -> None:
    (option,) = (found for found in video.video.params if found.name == "preset")
    assert isinstance(option, click.Option)
    assert str(option.help).startswith(", ".join(list(PRESETS)[:-1]) + " or y4m. Default")


def test_frames_and_arrays_become_a_file(scene: Path, ball: Path, tmp_path: Path) -> None:
    rendered = list(clsco.render(scene, truth=()))
    assert clsco.write_video(tmp_path / "a.mkv", rendered, 25) == ()
    np.testing.assert_array_equal(decoded(tmp_path / "a.mkv", "gray")[2], codes(ball))
    clsco.write_video(tmp_path / "b.mkv", codes(ball), Fraction(25))
    clsco.write_video(tmp_path / "c.mkv", [frame.color for frame in rendered], "25")
    same = (tmp_path / "a.mkv").read_bytes()
    assert (tmp_path / "b.mkv").read_bytes() == (tmp_path / "c.mkv").read_bytes() == same
    left, right = clsco.render(clsco.load_scene(scene, ["stereo.baseline=9", "sequence.frames=1"]), truth=())
    wrong: list[tuple[dict[str, Any], str]] = [
        ({"frames": [left, right]}, "frames: must be of one view; got right at 1, after left"),
        ({"transfer": "pq"}, "transfer: must be one of srgb, linear; got pq"),
        ({"rate": 29.97}, "rate: must be exact: a Fraction, a whole number, or text like 24 or 30000/1001; got 29.97"),
        ({"preset": "gif"}, "preset: must be one of mp4, "),
    ]
    for change, message in wrong:
        given: dict[str, Any] = {"frames": rendered, "rate": 25} | change
        with pytest.raises(ArgumentError) as caught:
            clsco.write_video(tmp_path / "d.mkv", **given)
        assert str(caught.value).startswith(message)
    assert not (tmp_path / "d.mkv").exists()
