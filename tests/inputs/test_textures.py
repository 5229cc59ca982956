"""Codes and light, resampling, and the built-in patterns."""

from __future__ import annotations

import hashlib
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from clsco.errors import FileError
from clsco.files.images import write_png
from clsco.files.transfer import decode, encode
from clsco.inputs.resampling import resample
from clsco.inputs.textures import (
    PATTERNS,
    bricks,
    checkerboard,
    find_stretched,
    load_scene_textures,
    load_texture,
    texture_size,
)
from clsco.scene.model import Background, Camera, DepthMap, Plane, Scene
from clsco.scene.texture_keys import BUILT_IN_TEXTURES

Array = NDArray[Any]
BITS_AND_TRANSFERS = pytest.mark.parametrize(("bits", "transfer"), list(product((8, 16), ("srgb", "linear"))))


def srgb_light(value: float) -> float:
    """IEC 61966-2-1, in plain Python."""
    return value / 12.92 if value <= 0.04045 else ((value + 0.055) / 1.055) ** 2.4


@BITS_AND_TRANSFERS
def test_every_code_is_decoded_by_the_standard_and_comes_back(bits: int, transfer: str) -> None:
    codes = np.arange(2**bits, dtype=f"u{bits // 8}")
    light = decode(codes, transfer)
    top = 2**bits - 1
    expected = [srgb_light(code / top) if transfer == "srgb" else code / top for code in range(2**bits)]
    # The same formula in two implementations of the power, each right to an ULP or two.
    np.testing.assert_allclose(light, expected, rtol=1e-15, strict=True)
    for dtype in (np.float32, np.float64):
        np.testing.assert_array_equal(encode(light.astype(dtype), bits, transfer), codes, strict=True)


@BITS_AND_TRANSFERS
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_codes_change_halfway_between_them(bits: int, transfer: str, dtype: type) -> None:
    top = 2**bits - 1
    half = (np.arange(top) + 0.5) / top
    start = np.array([srgb_light(value) for value in half]) if transfer == "srgb" else half
    # One part in 10^6 from the change is ten ULP of float32 and, at 16 bits, a thirtieth of a code or less.
    above: Array = (start * (1 + 1e-6)).astype(dtype)
    below: Array = (start * (1 - 1e-6)).astype(dtype)
    np.testing.assert_array_equal(encode(above, bits, transfer), np.arange(top) + 1)
    np.testing.assert_array_equal(encode(below, bits, transfer), np.arange(top))
    generator = np.random.default_rng(5)
    light: Array = generator.random((50, 40, 3)).astype(dtype) ** 3
    expected = np.searchsorted(start, light.astype(np.float64), side="right")
    assert 0.5 * top < np.ptp(expected)
    np.testing.assert_array_equal(encode(light, bits, transfer), expected)


@BITS_AND_TRANSFERS
def test_light_outside_of_the_codes_is_clipped(bits: int, transfer: str) -> None:
    light = np.array([-np.inf, -1, -0.0, 1, 1.5, np.inf, np.nan], np.float32)
    top = 2**bits - 1
    assert encode(light, bits, transfer).tolist() == [0, 0, 0, top, top, top, 0]


def test_floats_are_linear_and_unknown_transfers_refused() -> None:
    light = np.array([0, 0.25, 7], np.float32)
    np.testing.assert_array_equal(decode(light, "srgb"), light.astype(np.float64), strict=True)
    with pytest.raises(ValueError, match=r"transfer: must be one of srgb, linear; got 'gamma'"):
        decode(np.zeros(1, np.uint8), "gamma")
    with pytest.raises(ValueError, match=r"transfer: must be one of srgb, linear; got 'gamma'"):
        encode(light, 8, "gamma")


SIZES = [((40, 30), (17, 90)), ((40, 30), (40, 7)), ((5, 5), (64, 1)), ((1, 1), (3, 4)), ((64, 48), (16, 12))]


@pytest.mark.parametrize(("before", "after"), SIZES)
def test_resampling_keeps_constants_and_mirrors(before: tuple[int, int], after: tuple[int, int]) -> None:
    # Weights are divided by their sum, so only rounding is left: a few hundred terms of 1e-16.
    flat = resample(np.full((*before, 3), 0.3), after)
    np.testing.assert_allclose(flat, np.full((*after, 3), 0.3), rtol=1e-13)
    image = np.random.default_rng(1).random((*before, 3))
    result = resample(image, after)
    assert result.shape == (*after, 3)
    for axis in (0, 1):
        np.testing.assert_allclose(resample(np.flip(image, axis), after), np.flip(result, axis), atol=1e-13)
    np.testing.assert_allclose(resample(image[..., 1], after), result[..., 1], atol=1e-15)
    assert result.min() >= 0
    np.testing.assert_array_equal(resample(image, after, 1, 3), result[1:3])
    assert np.shares_memory(resample(image, before), image)


def test_resampling_keeps_the_mean() -> None:
    image = np.full((60, 90), 0.5)
    image[16:-16, 16:-16] += 0.3 * (np.random.default_rng(2).random((28, 58)) - 0.5)
    # By a whole factor every inner pixel has the same total weight (the cubic is a partition of unity), and
    # the outer ones, which have not, are all 0.5 here: only rounding is left.
    for factor in (2, 3, 5):
        result = resample(image, (60 // factor, 90 // factor))
        assert np.ptp(result) > 0.01
        assert result.mean() == pytest.approx(image.mean(), rel=1e-13)
    # By any other factor the totals differ a little; noise of 0.087 in 1,624 pixels makes that 1e-3 at most.
    assert resample(image, (37, 71)).mean() == pytest.approx(image.mean(), rel=1e-3)


@pytest.mark.parametrize("columns", [256, 100, 40])
def test_resampling_passes_what_fits_and_removes_what_aliases(columns: int) -> None:
    before = 128
    position = np.arange(before) + 0.5

    def wave(cycles: float) -> Array:
        return np.asarray(0.5 + 0.4 * np.cos(2 * np.pi * cycles * position / before) * np.ones((2, 1)))

    # A slow cosine, h = 2 pi / 32 per pixel: linear interpolation would miss it by h^2 / 8, 0.0048 of 0.4.
    # The cubic is of third order, at least three times better here.
    after = (np.arange(columns) + 0.5) * before / columns
    cycles = min(before, columns) / 32
    slow = 0.5 + 0.4 * np.cos(2 * np.pi * cycles * after / before)
    inner = slice(columns // 16, -columns // 16)
    resampled = resample(wave(cycles), (2, columns))[0]
    np.testing.assert_allclose(resampled[inner], slow[inner], atol=0.4 * 0.0016)
    if columns == 40:
        # 60 cycles in 40 columns would show as 20 with all of their contrast; the cubic leaves 0.5 %.
        fast = resample(wave(60), (2, columns))[0, 3:-3]
        assert np.abs(fast - 0.5).max() < 0.4 * 0.01


def test_ringing_does_not_go_below_black() -> None:
    step = np.zeros((8, 8))
    step[:, 4:] = 1
    result = resample(step, (8, 40))
    assert result.min() == 0
    assert result.max() > 1.02


@pytest.mark.parametrize("name", PATTERNS)
def test_patterns_have_every_size_and_never_change(name: str) -> None:
    for size in ((1, 1), (1, 50), (37, 1), (3, 2), (100, 64), (12, 160)):
        codes = PATTERNS[name](*size)
        assert codes.shape == size
        assert codes.dtype == np.uint8
        np.testing.assert_array_equal(codes, PATTERNS[name](*size))
        for first in range(0, size[0], 5):
            np.testing.assert_array_equal(PATTERNS[name](*size, first, first + 7), codes[first : first + 7])
    assert np.ptp(PATTERNS[name](100, 64)) > 100
    assert texture_size(name) == (512, 512)
    for transfer in ("srgb", "linear"):
        texture = load_texture(name, transfer, (100, 64))
        light = decode(PATTERNS[name](100, 64), transfer).astype(np.float32)
        np.testing.assert_array_equal(texture.radiance, light, strict=True)
        assert (texture.bits, texture.source) == (8, name)
    assert load_texture(name, "srgb").radiance.shape == (512, 512)


def test_bricks() -> None:
    wall = bricks(512, 512)
    digest = "acb51410fb5cd303105dd9e22c0314650bf76bab60c533e8c9dfa52c7ef54086"
    assert hashlib.sha256(wall.tobytes()).hexdigest() == digest
    light = wall.astype(float)
    # Half the size shows the same wall: means of 2 x 2 pixels agree but for the grain.
    small = light.reshape(256, 2, 256, 2).mean(axis=(1, 3))
    assert np.corrcoef(small.ravel(), bricks(256, 256).ravel())[0, 1] > 0.8


def test_checkerboard() -> None:
    board = checkerboard(512, 512)
    assert set(np.unique(board)) == {24, 232}
    np.testing.assert_array_equal(board, np.roll(board, (32, 32), (0, 1)))
    assert (np.diff(board[0].astype(int)) != 0).sum() == 15
    assert (board[31, 31], board[31, 32]) == (232, 24)


def area_by_samples(inside: Any, i: Array, j: Array, count: int = 64) -> Array:
    """Share of each unit pixel at (i, j) where inside(y, x) holds, by count x count midpoints."""
    step = (np.arange(count) + 0.5) / count - 0.5
    y, x = i[:, None, None] + step[:, None], j[:, None, None] + step
    return np.asarray(inside(y, x).mean(axis=(1, 2)))


def test_slanted_edge_has_exact_areas() -> None:
    codes = PATTERNS["slanted_edge"](64, 48)
    light = decode(codes, "srgb")
    assert light.max() / light.min() == pytest.approx(4, rel=0.02)  # half a code of each: 0.0045 and 0.0017
    i, j = (axis.ravel() for axis in np.indices((64, 48)))
    angle = np.deg2rad(5)
    share = area_by_samples(lambda y, x: x * np.cos(angle) + y * np.sin(angle) > 0, i - 31.5, j - 23.5)
    assert ((share > 0) & (share < 1)).sum() > 60
    # Half a code is at most 0.0045 of light below 0.8; 64 x 64 samples along one line miss 1 / 64 of 0.6 at
    # most.
    np.testing.assert_allclose(light.ravel(), 0.2 + 0.6 * share, atol=0.0045 + 0.6 / 64)


def test_siemens_star_has_exact_areas_and_grey_in_the_center() -> None:
    codes = PATTERNS["siemens_star"](201, 201)
    i, j = (axis.ravel() - 100 for axis in np.indices((201, 201)))

    def bright(y: Array, x: Array) -> Array:
        return np.asarray(np.floor(np.arctan2(y, x) * 36 / np.pi) % 2 == 0)

    chosen = np.random.default_rng(4).permutation(i.size)[:4000]
    share = area_by_samples(bright, i[chosen], j[chosen])
    expected = 0.05 + 0.75 * share
    error = np.abs(decode(codes, "srgb").ravel()[chosen] - expected)
    near = np.hypot(i[chosen], j[chosen]) < 20
    # Half a code 0.0045, 1 / 64 of 0.75 for a line among the samples; near the center 1 / 16, for up to three
    # lines.
    assert error[~near].max() < 0.0045 + 0.75 / 64
    assert error[near].max() < 0.0045 + 3 * 0.75 / 16
    assert decode(codes[98:103, 98:103], "srgb").mean() == pytest.approx(0.425, abs=0.02)
    ring = codes[np.rint(100 + 60 * np.sin(np.arange(3600) * np.pi / 1800)).astype(int),
                 np.rint(100 + 60 * np.cos(np.arange(3600) * np.pi / 1800)).astype(int)]  # fmt: skip
    assert (np.diff((ring > 150).astype(int)) == 1).sum() in (35, 36)


def test_files_are_decoded_and_resampled(tmp_path: Path) -> None:
    path = tmp_path / "image.png"
    codes = np.random.default_rng(6).integers(0, 65536, (20, 30, 3)).astype(np.uint16)
    codes[...] = codes[..., :1]  # equal channels stay three
    write_png(path, codes)
    assert texture_size(path) == (30, 20)
    for transfer in ("srgb", "linear"):
        texture = load_texture(path, transfer)
        np.testing.assert_array_equal(texture.radiance, decode(codes, transfer).astype(np.float32), strict=True)
        assert (texture.bits, texture.source) == (16, str(path))
        np.testing.assert_array_equal(
            load_texture(path, transfer, (15, 8)).radiance,
            resample(decode(codes, transfer), (15, 8)).astype(np.float32),
            strict=True,
        )
    np.save(tmp_path / "light.npy", np.array([[0.0, 2.5]]))
    texture = load_texture(tmp_path / "light.npy", "srgb")
    assert texture.radiance.tolist() == [[0, 2.5]]
    assert texture.bits == 32


def test_a_scene_gets_its_textures_and_its_size(tmp_path: Path) -> None:
    write_png(tmp_path / "image.png", np.arange(600, dtype=np.uint16).reshape(20, 30))
    plane = Plane(shape="plane", name="wall", distance=300.0)
    still = plane.model_copy(update={"texture": str(tmp_path / "image.png")})
    scene, (texture,) = load_scene_textures(Scene.model_validate({"object": [still]}))
    assert scene.camera.resolution == (30, 20)
    assert (texture.bits, texture.radiance.shape) == (16, (20, 30))

    sized = Scene.model_validate({"object": [still], "camera": {"resolution": [40, 25]}})
    scene, (texture,) = load_scene_textures(sized)
    assert scene == sized
    assert (texture.bits, texture.radiance.shape) == (16, (25, 40))
    scene, (texture,) = load_scene_textures(Scene.model_validate({"object": [plane]}))
    assert scene.camera.resolution == (512, 512)
    assert tuple(PATTERNS) == BUILT_IN_TEXTURES


@pytest.mark.parametrize("load", [texture_size, lambda name: load_texture(name, "srgb")])
def test_names_what_textures_there_are(load: Any, tmp_path: Path) -> None:
    names = "bricks, checkerboard, slanted_edge, siemens_star, a color #rrggbb"
    with pytest.raises(FileError, match=rf"texture: must be one of {names}, or an image file; got 'tiles'"):
        load("tiles")
    with pytest.raises(FileError, match=r"image file \(did you mean bricks\?\); got 'Brick'"):
        load(tmp_path / "Brick")
    with pytest.raises(FileError, match=r"none.png: must be a file that can be read; got No such file"):
        load(tmp_path / "none.png")


@pytest.mark.parametrize(
    ("image", "frame", "is_stretched"),
    [
        ((640, 480), (512, 512), True),
        ((480, 640), (640, 480), True),
        ((640, 480), (320, 240), False),
        ((1000, 667), (512, 341), False),  # as near as whole pixels come: 341.5
        ((1000, 667), (512, 342), False),
        ((1000, 667), (512, 340), True),
        ((3, 2), (640, 427), False),
        ((3, 2), (640, 428), True),
    ],
)
def test_a_projected_image_of_another_aspect_is_stretched(
    image: tuple[int, int], frame: tuple[int, int], is_stretched: bool
) -> None:
    array = np.zeros(image[::-1], np.float32)
    (size, other), line = (f"{columns} x {rows}" for columns, rows in (image, frame)), "object[1].texture: is stretched"
    items = {"projected": Plane(distance=300.0, texture=array), "pattern": Plane(distance=300.0)}
    items["lying"] = Plane(distance=300.0, texture=array, texture_mapping="surface", texture_size=(9.0, 3.0))
    names = ("pattern", "projected", "lying", "projected")  # the same image again is one
    scene = Scene(camera=Camera(resolution=frame), objects=tuple(items[name] for name in names))
    notes = find_stretched([scene, scene])
    assert notes == ([f"{line} from {size} to the frame's {other} px"] if is_stretched else [])


def test_backgrounds_and_depth_maps_are_stretched_as_well() -> None:
    array = np.zeros((480, 640), np.float32)
    items = Background(texture=array), DepthMap(depth=np.full((8, 8), 300.0), texture=array[:, :600])
    notes = find_stretched([Scene(camera=Camera(resolution=(8, 8)), objects=items)])
    assert [line[: line.index(" to")] for line in notes] == [
        "object[0].texture: is stretched from 640 x 480",
        "object[1].texture: is stretched from 600 x 480",
    ]
