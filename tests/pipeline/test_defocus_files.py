"""`clsco defocus` from files to files: a wall is a plane, a file and a folder get the same image, and focal stacks."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import imagecodecs
import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray

import clsco
from clsco.files.images import read_image
from clsco.files.transfer import encode
from clsco.optics.lens import blur_radius
from clsco.scene.file import parse_scene
from clsco.scene.model import Camera
from tests.cli.test_defocus import exr_pixels
from tests.command import clsco_, done


@pytest.fixture
def wall(tmp_path: Path) -> tuple[Path, Path]:
    """A float image of 40 x 32 px, and the depth in m of a wall at 0.4 m."""
    image = np.random.default_rng(2).random((32, 40, 3)).astype(np.float32)
    tifffile.imwrite(tmp_path / "image.tif", image, photometric="rgb")
    np.save(tmp_path / "depth.npy", np.full((32, 40), 0.4, np.float32))
    return tmp_path / "image.tif", tmp_path / "depth.npy"


OPTIONS = ("--unit", "m", "--pixel-pitch", 0.05, "--focus-distance", 250)  # R = 2.99 px at 400 mm


def test_a_wall_of_depths_is_a_plane(wall: tuple[Path, Path], tmp_path: Path) -> None:
    image, depth = wall
    result = done("defocus", image, depth, "-o", tmp_path / "out.tif", *OPTIONS)
    at = "(depths 400 to 400, focus at 250 mm; a pixel or a share of the depths can be focused on)"
    assert result.stderr == f"{depth}: R 3 to 3 px; in focus: 0 % of the picture {at}\n"
    camera = {"pixel_pitch": 0.05, "focus_distance": 250.0}
    plane = {"shape": "plane", "distance": 400.0, "texture": str(image)}
    (frame,) = clsco.reference.render(parse_scene({"camera": camera, "object": [plane]}))
    # A plane goes on beyond the frame, a map does not: that light reaches R = 3 px and a pixel inwards.
    inner = (slice(5, -5), slice(5, -5))
    # The figure to reach for whole frames; 0.4 m is 1.5e-8 from 400 mm in float32, and so is R.
    np.testing.assert_allclose(read_image(tmp_path / "out.tif").data[inner], frame.color[inner], rtol=0, atol=1e-5)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["depth.npy", "image.tif", "out.tif"]


FIGURE, WALL = 900.0, 4000.0  # mm
INVERSE = np.full((32, 40), 1000 / WALL)  # 1/m
INVERSE[8:24, 12:28] = 1000 / FIGURE
RELATIVE = (INVERSE - INVERSE.min()) / np.ptp(INVERSE)
LENS = ("--focal-length", 50, "--f-number", 2, "--pixel-pitch", 0.1, "--focus-distance", 1500)
NETWORK = ("--unit", "inverse_m", "--near", FIGURE, "--far", WALL)


def pfm(disparity: NDArray[Any]) -> bytes:
    return b"Pf\n40 32\n-1.0\n" + disparity[::-1].astype("<f4").tobytes()


def missing(codes: NDArray[Any], value: float = 0) -> NDArray[Any]:
    codes[:4, 30:] = value
    return codes


@pytest.mark.parametrize(("name", "content", "options"), [
    ("phone.jpg", imagecodecs.jpeg_encode(np.rint(255 * RELATIVE).astype(np.uint8), level=100), NETWORK),
    ("fitted.pfm", pfm(37 * INVERSE - 5), ("--unit", "inverse_m", "--scale", "1/37", "--offset", 5 / 37)),
    # Z = B s0 / (p d) = B f / d, f = 500 px
    ("kitti.png", imagecodecs.png_encode(missing(np.rint(256 * 0.5 * 200 * INVERSE).astype(np.uint16))),
        ("--unit", "disparity", "--scale", "1/256", "--baseline", 200)),
    ("disp0.pfm", pfm(missing(0.5 * 193 * INVERSE - 30, np.inf)),
        ("--unit", "disparity", "--baseline", 193, "--offset", 30)),
])  # fmt: skip
def test_depths_of_phones_networks_and_data_sets(
    tmp_path: Path, name: str, content: bytes, options: tuple[Any, ...]
) -> None:
    """As docs/depth_maps.md says; the wall of disp0.pfm has negative disparities."""
    imagecodecs.imwrite(tmp_path / "image.png", np.full((32, 40), 99, np.uint8))
    (tmp_path / name).write_bytes(content)
    words = ("-o", tmp_path / "out", "--truth", "coc", *LENS, *options)
    result = done("defocus", tmp_path / "image.png", tmp_path / name, *words)
    assert ("40 of 1280 pixels have no depth" in result.stderr) == (name[0] in "kd")
    camera = Camera(focal_length=50, f_number=2, pixel_pitch=0.1, focus_distance=1500)
    radii = np.load(tmp_path / "out/frame_0000.npz")["coc"]
    np.testing.assert_allclose(radii, blur_radius(camera, INVERSE / 1000), atol=0.03)  # R -3 and 3 px


def test_a_folder_gets_frames_and_a_file_the_same_image(wall: tuple[Path, Path], tmp_path: Path) -> None:
    depths = np.full((32, 40), 0.4, np.float32)
    depths[0, :3] = 0, np.nan, -1
    np.save(wall[1], depths)
    for out in ("all", "one.png", "one.exr"):
        result = done("defocus", *wall, "-o", tmp_path / out, *OPTIONS, *(["--truth", "all"] if out == "all" else []))
        counted, lens = result.stderr.splitlines()
        assert counted == f"{wall[1]}: 3 of 1280 pixels have no depth (1 zero, 1 negative, 1 NaN)"
        assert lens.startswith(f"{wall[1]}: R 3 to 3 px; in focus: 0 % of the picture (")
    assert sorted(path.name for path in (tmp_path / "all").iterdir()) == [
        "frame_0000.json", "frame_0000.npz", "frame_0000.png",
    ]  # fmt: skip
    assert (tmp_path / "all" / "frame_0000.png").read_bytes() == (tmp_path / "one.png").read_bytes()
    with np.load(tmp_path / "all" / "frame_0000.npz") as truth:
        np.testing.assert_array_equal(truth["color"], exr_pixels(tmp_path / "one.exr"))
        # What has no depth gets that around it, and keeps its light.
        assert truth["mask"].all()
        np.testing.assert_array_equal(truth["sharp"], read_image(wall[0]).data)
        # 1 / (1 / Z) in float64 and one rounding to float32.
        np.testing.assert_allclose(truth["depth"], 400.0, rtol=2.0**-23)


def test_where_there_is_no_depth_nothing_is_without_filling(wall: tuple[Path, Path], tmp_path: Path) -> None:
    depths = np.full((32, 40), 0.4, np.float32)
    depths[10:14, 20:] = 0
    np.save(wall[1], depths)
    more = ("--format", "npz", "--set", "motion.warp=forward", "--set", "fill.method=none")
    done("defocus", *wall, "-o", tmp_path / "out", *OPTIONS, *more)
    with np.load(tmp_path / "out" / "frame_0000.npz") as truth:
        np.testing.assert_array_equal(truth["mask"], depths > 0)
        assert (truth["sharp"][depths == 0] == 0).all()


def test_a_focal_stack_fills_folders(wall: tuple[Path, Path], tmp_path: Path) -> None:
    swept = ("--set", "camera.focus_distance=[250, 400]")
    result = done("defocus", *wall, "-o", tmp_path / "out", *OPTIONS[:-2], *swept)
    first, second = result.stderr.splitlines()
    assert first.startswith(f"{wall[1]} (with focus_distance_250): R 3 to 3 px; in focus: 0 % of the picture (")
    assert second == (
        f"{wall[1]} (with focus_distance_400): R 0 to 0 px; in focus: 100 % of the picture (nothing is blurred by more "
        "than a pixel: depths 400 to 400, focus at 400 mm, focal length 20 mm, pixel pitch 0.05 mm; is the unit of "
        "each right?)"
    )
    names = sorted(path.name for path in (tmp_path / "out").iterdir())
    assert names == ["focus_distance_250", "focus_distance_400"]
    sharp = read_image(tmp_path / "out" / names[1] / "frame_0000.png").data
    wanted = encode(read_image(wall[0]).data, 16, "srgb")
    # Light is off by a rounding of float32, 2^-24: at most 0.05 codes where sRGB is steepest, so the next code at most.
    np.testing.assert_allclose(sharp.astype(int), wanted, rtol=0, atol=1)
    result = clsco_("defocus", *wall, "-o", tmp_path / "o.png", *OPTIONS, *swept)
    assert (result.exit_code, result.stdout) == (1, "")
    assert "o.png: a file takes one image, a folder takes more; got 2" in result.stderr


def test_a_point_or_a_share_comes_into_focus(wall: tuple[Path, Path], tmp_path: Path) -> None:
    depths = np.full((32, 40), 0.4, np.float32)
    depths[:, :10] = 0.3
    np.save(wall[1], depths)
    sharp = read_image(wall[0]).data
    for words, inside in ((["--focus-at", "30,2"], 30), (["--focus-depth", "0"], 4)):
        result = done("defocus", *wall, "-o", tmp_path / "out.tif", *OPTIONS[:-2], *words)
        share = 25 if inside == 4 else 75
        assert f"px; in focus: {share} % of the picture\n" in result.stderr
        image = read_image(tmp_path / "out.tif").data
        np.testing.assert_allclose(image[8:-8, inside], sharp[8:-8, inside], rtol=0, atol=1e-5)
        assert np.abs(image[8:-8, 34 - inside] - sharp[8:-8, 34 - inside]).max() > 0.1
