"""Frames in the formats of the field, from the command to its readers: names, what is unknown, what does not fit."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

import clsco
from clsco.errors import FileError, MissingDependencyError
from clsco.frame.files import TRUTH_FORMATS, files_of, frame_files, read_complete, require_truth_formats, write_frame
from clsco.frame.frame import Frame
from clsco.frame.outputs import FILE_NAMES
from clsco.scene.file import parse_scene
from tests.command import clsco_
from tests.files.readers import torchvision_flo, torchvision_kitti_flow, torchvision_pfm
from tests.scenes import scene_file
from tests.slow import mostly_slow

FIELD = "npy,pfm,flo,kitti_flow,kitti_disparity,kitti_depth,colmap"
# A ball before nothing, which moves: masks, flow forwards and backwards, and disparity.
PAIR = """
[camera]
resolution = [40, 24]
pixel_pitch = 0.1
[sequence]
frames = 2
samples = 2
[stereo]
baseline = 6.0
[[object]]
shape = "sphere"
center = [0.0, 0.0, 200.0]
radius = 9.0
[object.motion]
velocity = [3.0, 1.0, 0.0]
"""
SHAPE = (6, 8)
RNG = np.random.default_rng(8)
MASK = RNG.random(SHAPE) < 0.7
FRAME = Frame(
    4,
    RNG.random((*SHAPE, 3), np.float32),
    depth=np.where(MASK, 2000 * RNG.random(SHAPE) + 5, np.inf).astype(np.float32),
    mask=MASK,
    flow=np.where(MASK[..., None], RNG.normal(0, 9, (*SHAPE, 2)), 0).astype(np.float32),
    disparity=np.where(MASK, 20 * RNG.random(SHAPE) + 1, 0).astype(np.float32),
)
SCENE = parse_scene({"camera": {"resolution": [8, 6]}, "object": [{"shape": "plane"}]})


def flo(path: Path | str) -> tuple[NDArray[Any], NDArray[Any]]:
    """Flow, and which of it is known."""
    flow = torchvision_flo(Path(path))
    return flow, np.asarray((np.abs(flow) < 1e9).all(axis=-1))


def pfm(path: Path | str) -> NDArray[Any]:
    return torchvision_pfm(Path(path), 2)


def test_a_rendered_pair_is_read_by_everybody(tmp_path: Path) -> None:
    scene, out = scene_file(tmp_path / "pair.toml", PAIR), tmp_path / "out"
    result = clsco_("render", scene, "-o", out, "--format", FIELD, "--frames", "1:")
    assert (result.exit_code, result.stderr) == (0, "")
    frames = list(clsco.render(clsco.load_scene(scene), frames=[1]))
    stem = "frame_0001_"
    for frame in frames:
        own = {path.name.removeprefix(f"{stem}{frame.eye}") for path in out.glob(f"{stem}{frame.eye}*")}
        flows = {f"_{name}{end}" for name in ("flow", "flow_backward") for end in (".flo", ".pfm")}
        codes = {f"_kitti_{name}.png" for name in ("flow", "flow_backward", "disparity", "depth")}
        arrays = {in_file for name, in_file in FILE_NAMES.items() if getattr(frame, name) is not None}
        plain = {f"_{name}.pfm" for name in ("color", "sharp", "depth", "coc", "normal", "disparity")}
        expected = flows | codes | plain | {f"_{name}.npy" for name in arrays}
        assert own == expected | {".png"}

        base = str(out / f"{stem}{frame.eye}")
        assert frame.mask is not None
        assert frame.depth is not None
        assert frame.disparity is not None
        there, depth = frame.mask, frame.depth
        assert there.any()
        assert not there.all()
        for name, in_file in FILE_NAMES.items():
            if getattr(frame, name) is not None:
                np.testing.assert_array_equal(np.load(f"{base}_{in_file}.npy"), getattr(frame, name), strict=True)
        for name in ("flow", "flow_backward"):
            flow = getattr(frame, name)
            vectors, valid = flo(f"{base}_{name}.flo")
            np.testing.assert_array_equal(valid, there)
            for read in (vectors, cv2.readOpticalFlow(f"{base}_{name}.flo"), pfm(f"{base}_{name}.pfm")):
                np.testing.assert_array_equal(read[there], flow[there])
                assert (read[~there] > 1e9).all()
            near, valid = torchvision_kitti_flow(Path(f"{base}_kitti_{name}.png"))
            np.testing.assert_array_equal(valid, there)
            assert np.abs(near - flow)[there].max() <= 1 / 128
        meters = cv2.imread(f"{base}_kitti_depth.png", cv2.IMREAD_UNCHANGED) / 256
        np.testing.assert_array_equal(meters > 0, there)
        assert np.abs(meters - depth / 1000)[there].max() <= 1 / 512
        pixels = cv2.imread(f"{base}_kitti_disparity.png", cv2.IMREAD_UNCHANGED) / 256
        np.testing.assert_array_equal(pixels > 0, there)
        assert np.abs(pixels - frame.disparity)[there].max() <= 1 / 512
        stored = cv2.imread(f"{base}_disparity.pfm", cv2.IMREAD_UNCHANGED)
        np.testing.assert_array_equal(np.where(np.isinf(stored), 0, stored), frame.disparity)
        np.testing.assert_array_equal(cv2.imread(f"{base}_depth.pfm", cv2.IMREAD_UNCHANGED), depth)
    content = read_complete(out, 1)
    assert content is not None
    held = {in_file for name, in_file in FILE_NAMES.items() if getattr(frames[0], name) is not None}
    assert set(content["files"]) == frame_files(1, True, files_of("", FIELD), 0, held)
    assert "truth" not in content


PLANE = '[[object]]\nshape = "plane"\n'
MOVES = "[object.motion]\nvelocity = [1.0, 0.0, 0.0]\n"
SCENES = {
    "still": PLANE,
    "forward": f'[motion]\nwarp = "forward"\n{PLANE}{MOVES}',
    "mapped": f'[sequence]\nsamples = 2\n{PLANE}texture_mapping = "surface"\ntexture_size = [9.0, 9.0]\n{MOVES}',
}


@pytest.mark.parametrize("more", mostly_slow(SCENES.values(), [SCENES["still"]]), ids=SCENES)
def test_frames_are_resumed_by_the_names_of_their_arrays(tmp_path: Path, more: str) -> None:
    scene, out = scene_file(tmp_path / "plane.toml", f"[camera]\nresolution = [12, 9]\n{more}"), tmp_path / "out"

    def rendered(*truth: str) -> bool:
        before = (out / "frame_0000.json").stat().st_mtime_ns if out.exists() else 0
        result = clsco_("render", scene, "-o", out, "--resume", *truth)
        assert result.exit_code == 0, result.output
        return (out / "frame_0000.json").stat().st_mtime_ns != before

    assert rendered("--format", "npy,flo")
    assert not rendered("--format", "npy,flo")
    assert not rendered("--format", "flo,colmap")
    assert " frame_0000.png\n" in (out / "sparse/0/images.txt").read_text()
    assert rendered("--truth", "depth,alpha", "--format", "npy", "--types", "all=float16")
    assert not rendered("--truth", "alpha,depth", "--format", "npy", "--types", "all=float16")
    assert np.load(out / "frame_0000_depth.npy").dtype == np.float16
    assert rendered("--format", "npy")
    (out / "frame_0000_flow.npy").unlink()
    assert rendered("--format", "npy")


def test_a_scene_without_the_array_of_a_format_is_refused(tmp_path: Path) -> None:
    scene = scene_file(tmp_path / "plane.toml", '[camera]\nresolution = [12, 9]\n[[object]]\nshape = "plane"\n')
    cases = (
        (("--format", "flo,kitti_disparity"), "disparity; got kitti_disparity"),
        (("--truth", "flow_backward", "--format", "flo"), "flow_backward; got flo:flow_backward"),
    )
    for words, missing in cases:
        result = clsco_("render", scene, "-o", tmp_path / "out", *words)
        assert (result.exit_code, result.stderr) == (1, f"error: {scene}: truth: the scene must have {missing}\n")
    assert not (tmp_path / "out").exists()


NOWHERE = r"; got .* at row 3, column 2 \(1 in all\)$"


@pytest.mark.parametrize(("truth", "name", "value", "message"), [
    ("kitti_flow", "flow", 700.5, "kitti_flow.png: must lie within -512 to 511.984375 px, .*; got 700.5, 700.5 at"),
    ("flo", "flow", 2e9, "flow.flo: sizes must be below 1e9 px, .*" + NOWHERE),
    ("kitti_depth", "depth", 3e5, "kitti_depth.png: must round to 1/256 to 65535/256 m, .*; got 300 at row 3"),
    ("kitti_disparity", "disparity", -0.5, "kitti_disparity.png: must round to 1/256 .* px, .*; got -0.5 at row 3"),
    ("npy", "depth", 7e4, "frame 4: depth: sizes must be at most 65504 in float16" + NOWHERE),
])  # fmt: skip
def test_what_does_not_fit_is_refused_and_nothing_is_left(
    tmp_path: Path, truth: str, name: str, value: float, message: str
) -> None:
    formats = "exr,flo" if truth == "flo" else f"exr,flo,{truth}"
    truth_files = files_of("", formats, "depth=float16" if truth == "npy" else "")
    write_frame(tmp_path, (FRAME,), 8, "srgb", truth_files, scene=SCENE)
    before = {path: path.stat().st_mtime_ns for path in tmp_path.iterdir()}
    array = getattr(FRAME, name).copy()
    array[3, 2] = value
    mask = MASK.copy()
    mask[3, 2] = True
    with pytest.raises(FileError, match=message) as caught:
        write_frame(tmp_path, (replace(FRAME, mask=mask, **{name: array}),), 8, "srgb", truth_files, scene=SCENE)
    assert ".part" not in str(caught.value)
    assert {path: path.stat().st_mtime_ns for path in tmp_path.iterdir()} == before  # the older frame, whole
    if not np.isnan(value) and name != "depth":  # it does not matter where nothing is
        mask[3, 2] = False
        write_frame(tmp_path, (replace(FRAME, mask=mask, **{name: array}),), 8, "srgb", truth_files, scene=SCENE)


def test_a_failed_model_of_colmap_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from clsco.frame import files as framefiles

    def last_fails(path: Path, content: bytes) -> None:
        if path.name == "points3D.txt":
            raise FileError(f"{path}: the file must be writable; got No space left on device")
        path.write_bytes(content)

    monkeypatch.setattr(framefiles, "atomic_write_bytes", last_fails)
    with pytest.raises(FileError, match=re.escape(f"{tmp_path}/sparse/0/points3D.txt: the file must be writable")):
        framefiles.write_scene_files(tmp_path, SCENE, files_of("", "colmap"))
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []


def test_the_extra_that_a_format_needs_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("clsco.errors.find_spec", lambda name: None)
    require_truth_formats(files_of("", "npy,pfm,flo,kitti_flow,colmap"))
    with pytest.raises(MissingDependencyError, match=r"format tiff: needs tifffile: pip install 'clsco\[formats\]'"):
        require_truth_formats(files_of("", "tiff"))


def test_the_help_names_every_format() -> None:
    text = " ".join(clsco_("render", "--help").output.split())
    assert all(re.search(rf"\b{name}\b", text) for name in TRUTH_FORMATS)


def test_what_gets_behind_the_lens_has_no_flow(tmp_path: Path) -> None:
    """A camera flies past a ball, straight to a wall, whose middle stays where it is."""
    text = """
    [camera]
    resolution = [41, 31]
    pixel_pitch = 0.1
    motion = { velocity = [0.0, 0.0, 300.0] }
    [sequence]
    shutter = 0.001
    samples = 1
    [[object]]
    shape = "sphere"
    center = [15.0, 0.0, 200.0]
    radius = 9.0
    [[object]]
    shape = "plane"
    distance = 900.0
    """
    scene = scene_file(tmp_path / "past.toml", text)
    words = ("--truth", "flow,flow_backward,object_id,depth", "--format", "npz,flo,kitti_flow,pfm")
    result = clsco_("render", scene, "-o", tmp_path, *words)
    assert (result.exit_code, result.stderr) == (0, "")
    with np.load(tmp_path / "frame_0000.npz") as arrays:
        flow, ball = arrays["flow"], arrays["object_id"] == 0
    assert ball.sum() > 20
    assert not flow[ball].any()  # the arrays have 0 there
    assert not flow[15, 20].any()
    _, valid = flo(tmp_path / "frame_0000_flow.flo")
    np.testing.assert_array_equal(valid, ~ball)
    np.testing.assert_array_equal(torchvision_kitti_flow(tmp_path / "frame_0000_kitti_flow.png")[1], ~ball)
    np.testing.assert_array_equal(np.isinf(pfm(tmp_path / "frame_0000_flow.pfm")[..., 0]), ball)
    _, valid = flo(tmp_path / "frame_0000_flow_backward.flo")
    assert valid.all()  # a frame before, both were farther away
