"""The command line: what it prints and writes, its exit status, and one line for everything that is wrong."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click
import numpy as np
import pytest
from click.testing import Result

import clsco
from clsco.cli import sheets
from clsco.cli.main import COMMANDS, main
from clsco.engine import batch
from clsco.errors import FileError
from clsco.files.images import read_image
from clsco.files.png import png_parts
from clsco.frame.files import read_complete
from clsco.frame.frame import Frame
from clsco.frame.outputs import FILE_NAMES, MOTION_NAMES, TRUTH_NAMES
from clsco.opencl import device, self_test
from clsco.plan.prepare import prepare
from clsco.scene import examples
from clsco.scene.file import parse_scene
from clsco.scene.model import Scene
from tests.command import clsco_, done
from tests.scenes import PLANE, scene_file

ROOT = Path(__file__).resolve().parents[2]


def messages(result: Result, status: int) -> list[str]:
    """The lines on stderr of a command that failed as it should: with a message, and without a traceback."""
    assert (result.exit_code, result.stdout) == (status, ""), result.output
    assert isinstance(result.exception, SystemExit)
    return result.stderr.splitlines()


def names(folder: Path) -> list[str]:
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())


def test_the_list_of_commands_says_what_each_says_of_itself() -> None:
    context = click.Context(main)
    for name, (_, text) in COMMANDS.items():
        command = main.get_command(context, name)
        assert command is not None
        assert str(command.help).replace("\n", " ").startswith(text.rstrip("."))


def test_render_ends_with_what_it_wrote(ball: Path, tmp_path: Path) -> None:
    def said(*words: object) -> str:
        result = clsco_("render", *words)
        assert (result.exit_code, result.stderr) == (0, "")
        return result.stdout

    words = (ball, "-o", tmp_path / "out", "--frames", "1:")
    assert said(*words) == f"{tmp_path / 'out'}: 2 frames, from frame_0001 on: png, json\n"
    assert said(*words, "--resume") == f"{tmp_path / 'out'}: all frames are there already\n"
    assert said(*words, "--quiet") == ""
    two = ("--set", "camera.f_number=[2,4]", "--frames", "0:1", "--truth", "depth", "--format", "npz")
    both = said(ball, "-o", tmp_path / "two", *two)
    assert both == f"{tmp_path / 'two'}: 2 frames in 2 folders, from frame_0000 on: png, json, npz\n"


def test_render_writes_frames(ball: Path, tmp_path: Path) -> None:
    result = clsco_("render", ball, "-o", tmp_path / "new" / "out", "--format", "npz,exr", "--frames", "1:", "--quiet")
    assert (result.exit_code, result.output) == (0, "")
    expected = [f"frame_000{n}.{suffix}" for n in (1, 2) for suffix in ("exr", "json", "npz", "png")]
    assert names(tmp_path / "new") == [f"out/{name}" for name in expected]
    picture = read_image(tmp_path / "new/out/frame_0001.png")
    assert (picture.data.shape, picture.bits) == ((24, 40), 8)
    frame = next(clsco.render(clsco.load_scene(ball), frames=[1]))
    with np.load(tmp_path / "new/out/frame_0001.npz") as arrays:
        assert set(arrays) == {FILE_NAMES[name] for name in ("color", *TRUTH_NAMES, *MOTION_NAMES)}
        for name in ("color", *TRUTH_NAMES, *MOTION_NAMES):
            np.testing.assert_array_equal(arrays[FILE_NAMES[name]], getattr(frame, name), strict=True)


def test_check_adds_figures_of_rays_to_the_record(ball: Path, tmp_path: Path) -> None:
    assert clsco_("render", ball, "-o", tmp_path, "--check", "--frames", "1:2").exit_code == 0
    check = json.loads((tmp_path / "frame_0001.json").read_text())["check"]
    assert check["pixels"] > 100
    assert check["psnr"] > 45
    assert check["deviations"] < 0.1 * check["pixels"]


def test_the_json_tells_every_parameter_and_what_became_of_it(ball: Path, tmp_path: Path) -> None:
    settings = ["--set", "camera.f_number=4", "--set", "object.0.radius=25", "--precision", "single"]
    began = time.perf_counter()
    assert clsco_("render", ball, "-o", tmp_path, *settings).exit_code == 0
    recorded = json.loads((tmp_path / "frame_0002.json").read_text())
    scene = clsco.load_scene(ball, ["camera.f_number=4", "object.0.radius=25"])
    assert parse_scene(recorded["scene"]) == scene
    assert recorded["derived"] == {"aperture_diameter": 5.0, "sensor_distance": 21.739}
    assert (recorded["version"], recorded["frame"], recorded["precision"]) == (clsco.__version__, 2, "single")
    assert (recorded["samples"], recorded["bits"]) == (3, 8)
    assert recorded["guard_px"] > 0
    assert [moment["weight"] for moment in recorded["intermediate"]] == [1 / 3] * 3
    # Midpoints of thirds of the third second: (1/2 + i) / 3.
    assert [moment["time"] for moment in recorded["intermediate"]] == pytest.approx([2 + 1 / 6, 2.5, 2 + 5 / 6])
    counters = {"missing_pixels", "filled_pixels", "unfilled_pixels", "sweeps"}
    assert all(counters <= set(moment) for moment in recorded["intermediate"])
    assert recorded["device"]
    assert set(recorded["seconds"]) >= {"cast", "aim", recorded["blur_method"], "host"}
    assert 0 < sum(recorded["seconds"].values()) < time.perf_counter() - began  # of three frames, and all else
    assert "ground_truth" not in recorded["seconds"]  # nobody asked for it
    assert list(recorded["files"]) == ["frame_0002.png"]
    assert read_complete(tmp_path, 2) == recorded


def test_frames_stay_inside_the_folder(ball: Path, tmp_path: Path) -> None:
    out = tmp_path / "a" / "out"
    for name in ("...toml", "..toml", "ball.toml"):
        other = tmp_path / "a" / name
        other.parent.mkdir(exist_ok=True)
        other.write_text(PLANE)
        (line,) = messages(clsco_("render", ball, other, "-o", out), 1)
        assert line.startswith(f"error: {other}: ")
        rule = "different names" if name == "ball.toml" else f"must stay inside {out}"
        assert rule in line
    assert not out.exists()
    picture = tmp_path / "out" / "frame_0007.png"
    assert clsco_("render", ball, "-o", picture.parent, "--frames", "0:1").exit_code == 0
    (picture.parent / "frame_0000.png").rename(picture)
    text = f'[[object]]\nshape = "plane"\ntexture = "{picture.name}"\n'
    scene = scene_file(picture.parent / "scene.toml", text)
    (line,) = messages(clsco_("render", scene, "-o", picture.parent), 1)
    assert "a texture must not lie where frames are written" in line
    assert picture.exists()


def marks(folder: Path) -> dict[str, int]:
    return {path.name: path.stat().st_mtime_ns for path in folder.iterdir()}


def rendered_again(folder: Path, *words: object) -> set[str]:
    """Run a command; gives the names of files in a folder that it has written."""
    before = marks(folder)
    done(*words)
    assert sorted(marks(folder)) == sorted(before | marks(folder))
    return {name for name, mark in marks(folder).items() if before.get(name) != mark}


def test_resume_renders_what_is_missing_damaged_or_of_another_scene(ball: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    command = ("render", ball, "-o", out)

    def redone(*more: str) -> set[str]:
        return {name[6:10] for name in rendered_again(out, *command, *more)}

    assert clsco_(*command).exit_code == 0
    assert redone("--resume") == set()
    (out / "frame_0000.json").unlink()
    picture = out / "frame_0001.png"
    picture.write_bytes(picture.read_bytes()[:-1])
    assert redone("--resume") == {"0000", "0001"}
    (out / "frame_0002.json").write_text("{")
    assert redone("--resume", "--frames", "0:2") == set()
    assert redone("--resume") == {"0002"}
    assert redone("--resume", "--format", "npz", "--frames", ":1") == {"0000"}
    assert redone("--resume") == set()  # a file more does no harm
    assert redone("--resume", "--precision", "double") == set()
    assert redone("--resume", "--precision", "single") == {"0000", "0001", "0002"}
    assert redone("--resume", "--set", "object.0.radius=29") == {"0000", "0001", "0002"}
    assert redone() == {"0000", "0001", "0002"}


def test_resume_notices_another_texture_of_the_same_name(tmp_path: Path) -> None:
    for value in (0.25, 0.75):
        np.save(tmp_path / "texture.npy", np.full((9, 12), value, np.float32))
        plane = scene_file(tmp_path / "plane.toml", PLANE + 'texture = "texture.npy"\n')
        assert clsco_("render", plane, "-o", tmp_path, "--resume").exit_code == 0
        light = read_image(tmp_path / "frame_0000.png").data[4, 6] / 65535
        # sRGB of 1/4 and 3/4 (IEC 61966-2-1): 1.055 x^(1/2.4) - 0.055, to half a code of 16 bits.
        assert light == pytest.approx(1.055 * value ** (1 / 2.4) - 0.055, abs=1e-4)


def test_a_depth_map_lies_outside_the_frames(tmp_path: Path) -> None:
    item = {"shape": "depth_map", "depth": str(tmp_path / "frame_0000.npz")}
    scene = parse_scene({"camera": {"resolution": [4, 3]}, "object": [item]})
    np.savez(tmp_path / "frame_0000.npz", depth=np.full((3, 4), 280.0))
    with pytest.raises(FileError, match="a depth must not lie where frames are written"):
        batch.prepare(prepare(scene), tmp_path, [0], (), False)


BAD_SCENES = {
    "missing.toml": (None, "cannot be read: No such file or directory"),
    "nan.toml": ("[camera]\nfocal_length = nan\n" + PLANE[9:], "must be a finite number; got nan"),
    "unknown.toml": (PLANE + "colour = 1\n", "object[0].colour: unknown key"),
    "texture.toml": (PLANE + 'texture = "none.png"\n', "none.png: must be a file that can be read"),
    "pattern.toml": (PLANE + 'texture = "brick"\n', "must be one of bricks, checkerboard"),
    "broken.toml": (PLANE + 'texture = "broken.png"\n', "must be a whole PNG"),
    "large.toml": (PLANE.replace("[12, 9]", "[65536, 65536]"), "must have at most 268435456 pixels"),
    "near.toml": (PLANE + "distance = 0.001\n", "the blur radius must be at most 512 px"),
    "words.toml": ("what is this", "not valid TOML"),
    "scene.txt": (PLANE, "must end in .toml or .json"),
}


@pytest.fixture
def bad(tmp_path: Path) -> Path:
    picture = b"".join(png_parts(np.zeros((9, 12), np.uint8)))
    (tmp_path / "broken.png").write_bytes(picture[:60])
    for name, (text, _) in BAD_SCENES.items():
        if text is not None:
            (tmp_path / name).write_text(text)
    return tmp_path


def test_validate_tells_all_faults_of_all_files(bad: Path, ball: Path) -> None:
    result = clsco_("validate", ball, *(bad / name for name in BAD_SCENES), ball)
    assert (result.exit_code, result.stdout) == (1, f"{ball}: valid\n" * 2)
    for line, (name, (_, rule)) in zip(result.stderr.splitlines(), BAD_SCENES.items(), strict=True):
        assert name in line
        assert rule in line
    assert done("validate", ball, ball).output == f"{ball}: valid\n" * 2


def test_without_a_device_it_says_what_to_install(ball: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(device, "_devices", lambda: ())
    out = ("-o", tmp_path / "out")
    for command in (["render", ball, *out], ["check", ball], ["devices"], ["demo", *out]):
        (line,) = messages(clsco_(*command), 3)
        assert 'pip install "clsco[pocl]"' in line
    assert not (tmp_path / "out").exists()


def test_what_needs_no_opencl_works_without_it(ball: Path) -> None:
    code = "import sys; sys.modules['pyopencl'] = None; from clsco.cli.main import main\n"
    code += "for words in (['plan', sys.argv[1]], ['validate', sys.argv[1]], ['schema']):\n"
    code += "    main(words, standalone_mode=False)\n"
    command = [sys.executable, "-W", "error", "-c", code, str(ball)]
    environ = os.environ | {"PYTHONPATH": str(ROOT)}
    subprocess.run(command, check=True, env=environ, stdout=subprocess.DEVNULL, timeout=60)


def test_plan(ball: Path) -> None:
    result = done("plan", ball, "--set", "psf.occlusion=layered", "--set", "motion.rotation=axis")
    text = " ".join(result.output.split())
    assert "3, 40 x 24 px, gray" in text
    assert "intermediate frames 3 per frame" in text
    for each in prepare(clsco.load_scene(ball)).plan.passes:
        what, how = each.parameters[0]
        assert re.search(rf"{each.kind} 3 \d+\.\d [\d.]+ m?s {what} {re.escape(how[:12])}", text)
    assert "ground truth nobody asked for it" in text
    assert "psf.occlusion one object" in text
    assert "motion.rotation euler and axis differ only for turns about several axes" in text
    assert "guard band" in text
    assert "MiB" in text
    assert "weights per frame" in text
    assert "nobody asked for it" not in clsco_("plan", ball, "--format", "npz").output
    assert "blur method gather" in text


def test_devices() -> None:
    result = done("devices", "--self-test")
    used = device.choose()
    assert used.name in result.output
    assert f"used: {used} (" in result.output
    assert result.output.count("passed") >= 4
    result = clsco_("devices", "--device", "abacus")
    assert (result.exit_code, "OpenCL devices" in result.stdout) == (3, True)
    assert "must be a part of the name of one of" in result.stderr


def test_a_failed_self_test_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(self_test, "self_test", lambda item: [self_test.Check("fp64", False, "work-item 3")])
    result = clsco_("devices", "--self-test")
    assert result.exit_code == 1
    assert "work-item 3" in result.stdout
    assert "must pass; got failures in" in result.stderr


def test_schema() -> None:
    schema = json.loads(clsco_("schema").output)
    assert schema["$schema"].startswith("https://json-schema.org/")
    assert "camera" in schema["properties"]


def test_help_and_version() -> None:
    assert clsco_("--version").output == f"clsco, version {clsco.__version__}\n"
    for name in COMMANDS:
        assert f"\n  {name} " in clsco_("--help").output
        done(name, "--help")
    for name in ("make", "status", "verify", "show", "convert", "open", "remake"):
        assert f"\n  {name} " in clsco_("dataset", "--help").output
        done("dataset", name, "--help")
    assert clsco_("paint").exit_code == 2


@pytest.mark.slow
def test_demo(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = examples.example

    def small(name: str) -> Scene:
        scene = whole(name)
        if name == "depth_map":  # its files have their size
            return scene
        return scene.replace("camera.resolution", (64, 64)).replace("camera.pixel_pitch", 0.08)

    monkeypatch.setattr(examples, "example", small)
    monkeypatch.setattr(examples, "EXAMPLES", {name: examples.EXAMPLES[name] for name in sheets.DETAILS})
    out = tmp_path / "demo"
    result = clsco_("demo", "-o", out)
    assert (result.exit_code, result.stderr) == (0, "")
    assert str(out / "contact_sheet.png") in result.output
    for name in examples.EXAMPLES:
        assert name in result.output
        apart = ["frame_0000.npz", "frame_0000.png"]
        if name == "stereo":
            apart = [f"frame_0000_{eye}.{suffix}" for eye in ("left", "right") for suffix in ("npz", "png")]
        assert set(names(out / name)) >= {"frame_0000.json", *apart}
    sheet = read_image(out / "contact_sheet.png").data
    assert sheet.shape[2] == 3
    assert sheet.std() > 20
    colors = np.ptp(sheet.astype(int), axis=2)
    assert (colors > 60).mean() > 0.05  # maps of the ground truth have color, photographs of bricks have none


@pytest.mark.parametrize(
    ("error", "status", "line"),
    [
        (KeyboardInterrupt, 130, "interrupted"),
        (MemoryError, 1, "error: memory: must hold the arrays of the scene; got too little of it"),
    ],
)
def test_ctrl_c_and_too_little_memory(
    ball: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: type[BaseException], status: int, line: str
) -> None:
    def ended(*args: Any) -> Iterator[Frame]:
        raise error
        yield

    monkeypatch.setattr(batch, "run", ended)
    assert messages(clsco_("render", ball, "-o", tmp_path), status) == [line]


@pytest.mark.parametrize("command", ["render", "defocus", "inpaint"])
def test_an_empty_path_is_not_the_current_folder(command: str, ball: Path) -> None:
    files = [ball] if command == "render" else [ball, ball]
    result = clsco_(command, *files, "-o", "")
    assert (result.exit_code, 'must be a path; got ""' in result.output) == (2, True)


def test_a_long_title_is_one_line(ball: Path) -> None:
    title = " ".join(["A ball that is described in more words than any of the tables below it is wide"] * 2)
    assert clsco_("plan", ball, "--set", f"title={title}").output.splitlines()[0].rstrip() == f"Plan: {title}"
