"""An image and its depth map: the scene that they make, what the map leaves out, and one image file."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import imagecodecs
import numpy as np
import OpenEXR
import pytest
import tifffile

from clsco.defocus_command import check_single, depth_report, is_image_file, scene_from_files, write_image
from clsco.errors import ClscoError, ImageError, SceneError
from clsco.frame import Frame
from clsco.images import read_image, write_png
from clsco.scene import DepthMap, Scene, Stereo
from clsco.scenefile import dump, parse_scene

CODES = np.arange(12 * 9, dtype=np.uint8).reshape(9, 12)
DEPTHS = CODES.astype(np.uint16) + np.uint16(200)


@pytest.fixture
def files(tmp_path: Path) -> tuple[Path, Path]:
    """An image of 12 x 9 px and a depth map in mm of the same size."""
    write_png(tmp_path / "image.png", CODES)
    write_png(tmp_path / "depth.png", DEPTHS)
    return tmp_path / "image.png", tmp_path / "depth.png"


def only_map(scene: Scene) -> DepthMap:
    (item,) = scene.objects
    assert isinstance(item, DepthMap)
    return item


def test_defaults_are_those_of_a_scene(files: tuple[Path, Path]) -> None:
    image, depth = files
    scene = scene_from_files(image, depth, {"camera.f_number": None, "object.unit": None})
    table = {"shape": "depth_map", "name": "image", "texture": str(image), "depth": str(depth)}
    assert scene == parse_scene({"object": [table]})


def test_options_are_keys_of_the_scene(files: tuple[Path, Path]) -> None:
    options = {
        "object.unit": "disparity",
        "object.scale": 0.5,
        "object.baseline": 60.0,
        "camera.focal_length": 50.0,
        "camera.f_number": 2.8,
        "camera.focus_distance": 900.0,
        "camera.pixel_pitch": 0.005,
        "psf.model": "gaussian",
        "psf.edge": "area",
        "psf.occlusion": "none",
    }
    scene = scene_from_files(*files, options)
    for key, value in options.items():
        section, _, name = key.partition(".")
        assert getattr(only_map(scene) if section == "object" else getattr(scene, section), name) == value
    pair = scene_from_files(*files, {"camera.aperture_diameter": 3.0, "camera.sensor_distance": 20.5}).camera
    assert (pair.aperture_diameter, pair.sensor_distance) == (3.0, 20.5)


def test_overrides_come_last_and_reach_every_key(files: tuple[Path, Path]) -> None:
    overrides = [
        "camera.aperture_diameter=4",
        "object.0.center=[0.0, 0.0, 300.0]",
        "camera.motion.velocity=[1.0, 0.0, 0.0]",
    ]
    scene = scene_from_files(*files, {"camera.f_number": 2.0, "object.unit": "mm"}, overrides)
    assert (scene.camera.aperture_diameter, scene.camera.f_number) == (4.0, None)
    assert only_map(scene).center == (0.0, 0.0, 300.0)
    assert scene.camera.motion.velocity == (1.0, 0.0, 0.0)


def test_paths_are_absolute_and_a_pattern_is_none(files: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch) -> None:
    image, depth = files
    monkeypatch.chdir(image.parent)
    item = only_map(scene_from_files(Path("bricks"), Path(depth.name), {}))
    assert (item.texture, item.depth) == (str(image.parent / "bricks"), str(depth))


@pytest.mark.parametrize(("options", "overrides", "message"), [
    ({"object.unit": "feet"}, [],
     "defocus: object[0].unit: must be mm, m, inverse_mm, inverse_m, disparity or coc; got "),
    ({"object.unit": "disparity"}, [],
     'defocus: object[0].baseline: must be given with unit = "disparity"; got nothing'),
    ({"object.baseline": 6.0}, [],
     'defocus: object[0].baseline: belongs to unit = "disparity", not "mm"; got 6.0'),
    ({"object.scale": 0.0}, [], "defocus: object[0].scale: must be greater than 0; got 0.0"),
    ({"camera.f_number": 2.0, "camera.aperture_diameter": 5.0}, [],
     "defocus: camera.aperture_diameter: give f_number or aperture_diameter, not both; got 5.0"),
    ({"camera.focal_length": float("nan")}, [], "defocus: camera.focal_length: must be a finite number; got nan"),
    ({"psf.occlusion": "visibility"}, [], "defocus: psf.occlusion: "),
    ({}, ["f_number"], "defocus: override must be KEY=VALUE, like camera.f_number=4; got "),
    ({}, ["camera.zoom=2"], "defocus: camera.zoom: unknown key; got 2"),
])  # fmt: skip
def test_faults_name_the_key(
    files: tuple[Path, Path], options: dict[str, Any], overrides: list[str], message: str
) -> None:
    with pytest.raises(SceneError) as caught:
        scene_from_files(*files, options, overrides)
    (told,) = caught.value.messages
    assert told.startswith(message)


def test_all_faults_are_told_at_once(files: tuple[Path, Path]) -> None:
    with pytest.raises(SceneError) as caught:
        scene_from_files(*files, {"camera.focal_length": -1.0, "object.scale": -1.0, "psf.edge": "soft"})
    assert len(caught.value.messages) == 3


def test_the_report_counts_what_has_no_depth(files: tuple[Path, Path]) -> None:
    image, depth = files
    scene = scene_from_files(image, depth, {})
    assert depth_report(scene) == []
    codes = DEPTHS.copy()
    codes[0, :5] = 0
    write_png(depth, codes)
    assert depth_report(scene) == [f"{depth}: 5 of 108 pixels have no depth (5 zero)"]
    with pytest.raises(ImageError, match=r"depth\.png: the blur radius must be at most 512 px.*give unit mm"):
        depth_report(scene_from_files(image, depth, {"object.unit": "inverse_mm"}))


def test_sizes_must_agree(files: tuple[Path, Path]) -> None:
    image, depth = files
    write_png(depth, DEPTHS[:-1])
    with pytest.raises(ImageError) as caught:
        depth_report(scene_from_files(image, depth, {}))
    assert str(caught.value) == f"{depth}: the size must be that of {image}, 12 x 9 pixels; got 12 x 8"


@pytest.mark.parametrize("broken", [0, 1])
def test_missing_files_are_named(files: tuple[Path, Path], broken: int) -> None:
    files[broken].unlink()
    with pytest.raises(ImageError) as caught:
        depth_report(scene_from_files(*files, {}))
    assert str(caught.value) == f"{files[broken]}: must be a file that can be read; got No such file or directory"


def test_an_image_file_is_told_from_a_folder(tmp_path: Path) -> None:
    assert [is_image_file(tmp_path / f"a{suffix}") for suffix in (".png", ".TIF", ".tiff", ".exr")] == [True] * 4
    assert not any(is_image_file(tmp_path / name) for name in ("out", "v1.2", ".png"))
    (tmp_path / "folder.jpg").mkdir()
    assert not is_image_file(tmp_path / "folder.jpg")
    with pytest.raises(ImageError) as caught:
        is_image_file(tmp_path / "a.jpg")
    assert (
        str(caught.value)
        == f"{tmp_path / 'a.jpg'}: must be a folder, or end in one of .png .tif .tiff .exr; got '.jpg'"
    )


def test_one_file_takes_one_image(files: tuple[Path, Path], tmp_path: Path) -> None:
    out = tmp_path / "out.png"
    check_single(scene_from_files(*files, {}), out)
    with pytest.raises(SceneError, match=r"out\.png: a file takes one image, a folder takes more; got 3"):
        check_single(scene_from_files(*files, {}, ["sequence.frames=3"]), out)
    two = scene_from_files(*files, {}).model_copy(update={"stereo": Stereo(baseline=60.0)})
    with pytest.raises(SceneError, match=r"got 2$"):
        check_single(two, out)
    for path in files:
        with pytest.raises(ImageError, match="must not be the image or the depth that it is made of"):
            check_single(scene_from_files(*files, {}), path.parent / ".." / path.parent.name / path.name)


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
    write_image(out, Frame(index=0, color=color, metadata={}), bits, "linear")
    data = READERS[suffix.lower()](out)
    assert data.dtype == np.dtype(dtype)
    top = 1 if dtype == "f4" else np.iinfo(dtype).max
    wanted = color if suffix != ".exr" or channels else np.dstack([color] * 3)
    # Codes are the nearest ones, half a code off at most; floats are stored as they are.
    np.testing.assert_allclose(data / top, wanted, rtol=0, atol=0.0 if top == 1 else 0.5 / top * (1 + 1e-6))
    assert read_image(out).bits == 8 * np.dtype(dtype).itemsize
    assert sorted(tmp_path.iterdir()) == [out]


def test_codes_have_the_transfer_of_the_image(tmp_path: Path) -> None:
    color = np.full((2, 2), 0.2158605, np.float32)  # ((128 / 255 + 0.055) / 1.055)^2.4, by IEC 61966-2-1
    for name in ("a.png", "a.tif"):
        write_image(tmp_path / name, Frame(index=0, color=color, metadata={}), 8, "srgb")
        np.testing.assert_array_equal(read_image(tmp_path / name).data, np.full((2, 2), 128))


def test_a_file_that_cannot_be_written_is_told(tmp_path: Path) -> None:
    for suffix in (".png", ".tif", ".exr"):
        with pytest.raises(ClscoError, match="the file must be writable; got No such file or directory"):
            write_image(
                tmp_path / "none" / f"a{suffix}",
                Frame(index=0, color=np.ones((2, 2), np.float32), metadata={}),
                8,
                "srgb",
            )


def test_the_scene_can_be_written_down(files: tuple[Path, Path]) -> None:
    scene = scene_from_files(*files, {"object.unit": "m", "camera.f_number": 4.0})
    assert parse_scene(dump(scene)) == scene
