"""An image and its depth map: the scene that they make, what the map leaves out, and one image file."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import imagecodecs
import numpy as np
import OpenEXR
import pytest
import tifffile

from clsco.cli.defocus import is_image_file, layer_files, prepare_image, scenes_from_files, write_color
from clsco.errors import FileError, MissingDependencyError, SceneError
from clsco.files.images import read_image, write_png
from clsco.scene.file import parse_scene
from clsco.scene.model import DepthMap, Scene, Stereo
from tests.command import clsco_

CODES = np.arange(12 * 9, dtype=np.uint8).reshape(9, 12)
DEPTHS = CODES.astype(np.uint16) + np.uint16(200)


@pytest.fixture
def files(tmp_path: Path) -> tuple[Path, Path]:
    """An image of 12 x 9 px and a depth map in mm of the same size."""
    write_png(tmp_path / "image.png", CODES)
    write_png(tmp_path / "depth.png", DEPTHS)
    return tmp_path / "image.png", tmp_path / "depth.png"


def scene_of(image: Path, depth: Path, options: dict[str, Any] | None = None, overrides: Sequence[str] = ()) -> Scene:
    (scene,) = scenes_from_files([layer_files(image, depth)], options or {}, overrides).scenes
    return scene


def only_map(scene: Scene) -> DepthMap:
    (item,) = scene.objects
    assert isinstance(item, DepthMap)
    return item


def test_defaults_are_those_of_a_scene(files: tuple[Path, Path]) -> None:
    image, depth = files
    scene = scene_of(image, depth, {"f_number": None, "unit": None})
    table = {"shape": "depth_map", "name": "image", "texture": str(image), "depth": str(depth)}
    assert scene == parse_scene({"object": [table]})


def test_options_are_keys_of_the_scene(files: tuple[Path, Path]) -> None:
    keys: dict[str, Any] = {"unit": "disparity", "scale": 0.5, "baseline": 60.0, "offset": -124.343}
    keys |= {"depth_kind": "z", "no_depth": "far"}
    camera = {"focal_length": 50.0, "f_number": 2.8, "focus_distance": 900.0, "pixel_pitch": 0.005}
    scene = scene_of(*files, keys | camera)
    assert {key: getattr(only_map(scene), key) for key in keys} == keys
    assert {key: getattr(scene.camera, key) for key in camera} == camera


def test_overrides_come_last_and_reach_every_key(files: tuple[Path, Path]) -> None:
    overrides = ["camera.aperture_diameter=4", "object.0.center=[0, 0, 300]", "camera.motion.velocity=[1, 0, 0]"]
    scene = scene_of(*files, {"f_number": 2.0, "unit": "mm"}, overrides)
    assert (scene.camera.aperture_diameter, scene.camera.f_number) == (4.0, None)
    assert only_map(scene).center == (0.0, 0.0, 300.0)
    assert scene.camera.motion.velocity == (1.0, 0.0, 0.0)


def test_paths_are_absolute_and_a_pattern_is_none(files: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch) -> None:
    image, depth = files
    monkeypatch.chdir(image.parent)
    item = only_map(scene_of(Path("bricks"), Path(depth.name)))
    assert (item.texture, item.depth) == (str(image.parent / "bricks"), str(depth))


def test_an_image_file_is_distinguished_from_a_folder(tmp_path: Path) -> None:
    assert [is_image_file(tmp_path / f"a{suffix}") for suffix in (".png", ".TIF", ".tiff", ".exr")] == [True] * 4
    assert not any(is_image_file(tmp_path / name) for name in ("out", "v1.2", ".png"))
    (tmp_path / "folder.jpg").mkdir()
    assert not is_image_file(tmp_path / "folder.jpg")
    with pytest.raises(FileError) as caught:
        is_image_file(tmp_path / "a.jpg")
    rule = "must be a folder, or end in one of .png .tif .tiff .exr"
    assert str(caught.value) == f"{tmp_path / 'a.jpg'}: {rule}; got '.jpg'"


def test_one_file_takes_one_image(files: tuple[Path, Path], tmp_path: Path) -> None:
    out = tmp_path / "out.png"
    prepare_image([scene_of(*files)], out)
    with pytest.raises(SceneError, match=r"out\.png: a file takes one image, a folder takes more; got 3"):
        prepare_image([scene_of(*files, {}, ["sequence.frames=3"])], out)
    two = scene_of(*files).model_copy(update={"stereo": Stereo(baseline=60.0)})
    with pytest.raises(SceneError, match=r"got 2$"):
        prepare_image([two], out)
    with pytest.raises(SceneError, match=r"got 2$"):
        prepare_image([scene_of(*files)] * 2, out)
    prepare_image([scene_of(*files)], tmp_path / "new" / "out.png")
    assert list((tmp_path / "new").iterdir()) == []
    with pytest.raises(FileError, match="must be a folder that can be written"):
        prepare_image([scene_of(*files)], files[0] / "out.png")
    for path in files:
        with pytest.raises(FileError, match="must not be the image or the depth that it is made of"):
            prepare_image([scene_of(*files)], path.parent / ".." / path.parent.name / path.name)


def exr_pixels(path: Path) -> Any:
    channels = OpenEXR.File(str(path), separate_channels=True).channels()
    assert set(channels) == set("RGB")
    return np.dstack([channels[name].pixels for name in "RGB"])


READERS: dict[str, Callable[[Path], Any]] = {
    ".png": lambda path: imagecodecs.png_decode(path.read_bytes()),
    ".tif": tifffile.imread,
    ".tiff": tifffile.imread,
    ".exr": exr_pixels,
}


@pytest.mark.parametrize("channels", [(), (3,)], ids=["gray", "color"])
@pytest.mark.parametrize(("suffix", "bits", "dtype"), [
    (".png", 8, "u1"), (".png", 16, "u2"), (".png", 32, "u2"),
    (".tif", 8, "u1"), (".tiff", 16, "u2"), (".TIF", 32, "f4"), (".exr", 8, "f4"),
])  # fmt: skip
def test_one_image_is_written_and_read_back(
    tmp_path: Path, suffix: str, bits: int, dtype: str, channels: tuple[int, ...]
) -> None:
    color = np.random.default_rng(5).random((9, 12, *channels)).astype(np.float32)
    out = tmp_path / f"out{suffix}"
    write_color(out, color, bits, "linear")
    data = READERS[suffix.lower()](out)
    assert data.dtype == np.dtype(dtype)
    top = 1 if dtype == "f4" else np.iinfo(dtype).max
    expected = color if suffix != ".exr" or channels else np.dstack([color] * 3)
    # Codes are the nearest ones, half a code off at most; floats are stored as they are.
    np.testing.assert_allclose(data / top, expected, rtol=0, atol=0.0 if top == 1 else 0.5 / top * (1 + 1e-6))
    assert read_image(out).bits == 8 * np.dtype(dtype).itemsize
    assert sorted(tmp_path.iterdir()) == [out]


def test_codes_have_the_transfer_of_the_image(tmp_path: Path) -> None:
    color = np.full((2, 2), 0.2158605, np.float32)  # ((128 / 255 + 0.055) / 1.055)^2.4, by IEC 61966-2-1
    for name in ("a.png", "a.tif"):
        write_color(tmp_path / name, color, 8, "srgb")
        np.testing.assert_array_equal(read_image(tmp_path / name).data, np.full((2, 2), 128))


@pytest.mark.parametrize(("name", "module", "extra"), [("a.tif", "tifffile", "formats"), ("a.exr", "OpenEXR", "exr")])
def test_a_missing_extra_is_named_before_anything_is_done(
    files: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, module: str, extra: str
) -> None:
    scene = scene_of(*files)
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(MissingDependencyError, match=rf"needs {module}: pip install 'clsco\[{extra}\]'"):
        prepare_image([scene], tmp_path / "new" / name)
    assert not (tmp_path / "new").exists()
    prepare_image([scene], tmp_path / "new" / "a.png")


def test_the_command_tells_of_wrong_usage_and_of_what_it_was_given(files: tuple[Path, Path], tmp_path: Path) -> None:
    image, depth = files
    other = tmp_path / "other.png"
    write_png(other, DEPTHS[:4])
    pair = [image, depth, "-o", tmp_path / "a"]
    at = [*pair, "--focus-at", "3,4"]
    several = "focus: goes without several values of the focus; got 2"
    cases: list[tuple[list[object], int, str]] = [
        ([image, depth], 2, "Missing option '-o'"),
        ([image, depth, "-o", tmp_path / "a.png", "--format", "npz"], 2, "--truth: OUT must be a folder; got "),
        ([*pair, "--scale", "1/0"], 2, "like 1/256; got 1/0"),
        ([*pair, "--scale", "1e"], 2, "like 1/256; got 1e"),
        ([image, depth, "-o", tmp_path / "a.jpg"], 1, "a.jpg: must be a folder, or end in one of .png .tif .tiff .exr"),
        ([image, other, "-o", tmp_path / "a"], 1, f"{other}: the size must be that of {image}, 12 x 9 "),
        ([*pair, "--unit", "feet"], 1, "defocus: object[0].unit: must be mm, m, "),
        ([*pair, "--scale", "1e-3"], 1, "give unit m"),
        ([image, tmp_path / "none.exr", "-o", tmp_path / "a"], 1, "none.exr: must be a file that can be read; got "),
        ([*pair, "--set", "camera={f_number=2, aperture_diameter=3}"], 1, "not both; got"),
        ([*pair, "--focus-at", "3;4"], 2, "must be X,Y, a pixel's column and row counted"),
        ([*pair, "--focus-at", "12,0"], 1, "image.png: focus: must be a pixel of"),
        ([*pair, "--focus-depth", "1.5"], 2, "1.5 is not in the range 0.0<=x<=1.0"),
        ([*at, "--focus-depth", "0.5"], 2, "without --focus-depth"),
        ([*at, "--focus-distance", "250"], 2, "got both"),
        ([*at, "--focal-length", "400"], 1, "beyond the focal length, 400 mm; got a depth of 251 mm"),
        ([*at, "--unit", "coc", "--scale", "0.1"], 1, 'image.png: focus: depths must be known; got unit = "coc"'),
        ([*at, "--set", "camera.focus_distance=[250, 300]"], 1, f"image.png: {several}"),
    ]
    for words, status, message in cases:
        result = clsco_("defocus", *words)
        assert (result.exit_code, result.stdout) == (status, ""), result.output
        assert message in result.stderr
        assert "Traceback" not in result.stderr
    assert sorted(tmp_path.iterdir()) == sorted([image, depth, other])


def test_folders_give_a_folder_or_a_file_for_each_image(tmp_path: Path) -> None:
    """The bits of single calls; each depth map is that of its image's name."""
    images, depths = tmp_path / "images", tmp_path / "depths"
    for folder in (images, depths):
        folder.mkdir()
    for number, name in enumerate("ab"):
        write_png(images / f"{name}.png", np.roll(CODES, number))
        write_png(depths / f"{name}.png", DEPTHS + np.uint16(20 * number))
    (images / "notes.txt").touch()
    options = ("--focus-depth", "0.5", "--pixel-pitch", "0.05")
    result = clsco_("defocus", images, depths, "-o", tmp_path / "{}.exr", *options)
    assert (result.exit_code, result.stdout) == (0, f"{tmp_path / '{}.exr'}: 2 images\n")
    assert clsco_("defocus", images, depths, "-o", tmp_path / "frames", *options).exit_code == 0
    for name in "ab":
        alone = tmp_path / f"alone_{name}.exr"
        assert clsco_("defocus", images / f"{name}.png", depths / f"{name}.png", "-o", alone, *options).exit_code == 0
        assert alone.read_bytes() == (tmp_path / f"{name}.exr").read_bytes()
        assert (tmp_path / "frames" / name / "frame_0000.png").is_file()
    rule = "must be a file with {} for the name of each image, or a folder without {}; got 2 images"
    for name, message in (
        ("one.png", rule), ("{}", rule),
        ("{}.jpg", "must be a folder, or end in one of .png .tif .tiff .exr; got '.jpg'"),
    ):  # fmt: skip
        assert (
            clsco_("defocus", images, depths, "-o", tmp_path / name).stderr == f"error: {tmp_path / name}: {message}\n"
        )
    (depths / "b.png").unlink()
    message = f"{depths}: must have a file for each image in {images}; got none for b"
    assert clsco_("defocus", images, depths, "-o", tmp_path / "new").stderr == f"error: {message}\n"
    write_png(images / "a.tif.png", CODES)
    (images / "a.tif.png").rename(images / "a.jpg")
    for folder, got in ((images, "a.jpg a.png b.png"), (tmp_path / "frames", "none")):
        result = clsco_("defocus", folder, depths, "-o", tmp_path / "new")
        assert result.stderr.startswith(f"error: {folder}: must hold files of different names that end in .png ")
        assert result.stderr.endswith(f"; got {got}\n")
    assert not (tmp_path / "new").exists()
