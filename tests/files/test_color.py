"""Color profiles: codes decode by their own curve, LittleCMS is the judge, and outputs carry what they need."""

from __future__ import annotations

import io
import json
import struct
import zlib
from pathlib import Path
from typing import Any

import imagecodecs
import numpy as np
import OpenEXR
import pytest
import tifffile
from numpy.typing import NDArray
from PIL import Image

from clsco.files.color import LARGEST_PROFILE, SRGB, Color, chunk_color, icc_color
from clsco.files.images import WRITERS, read_image, write_png, write_tiff
from clsco.files.transfer import CODES, decode, encode
from clsco.inputs.textures import load_texture
from tests.command import clsco_, done
from tests.files.profiles import ADOBE, D65, P3, made, srgb_table

Array = NDArray[Any]
SQUARE = (np.linspace(0, 1, 1024) ** 2 * 65535).astype("u2")
RGB_PROFILES = {
    "Adobe RGB": (made("adobergb"), ADOBE),
    "gamma 2.4": (made(whitepoint=D65, primaries=P3, gamma=2.4), P3),
    "a table": (made(whitepoint=D65, primaries=P3, transferfunction=SQUARE), P3),
    "linear": (made(whitepoint=D65, primaries=ADOBE, gamma=1.0), ADOBE),
}
PHOTO = np.random.default_rng(4).integers(0, 256, (12, 16, 3)).astype(np.uint8)
GRAY_22 = made("gray", gamma=2.2)


def curve_of(color: Color) -> Any:
    assert color.note == ""
    assert color.curve is not None
    return color.curve


@pytest.mark.parametrize("name", RGB_PROFILES)
def test_codes_decode_as_by_littlecms(name: str) -> None:
    icc, primaries = RGB_PROFILES[name]
    ramp = np.repeat(CODES[None, :, None], 3, axis=2)
    linear = made(whitepoint=D65, primaries=primaries, gamma=1.0)
    options: Any = {"colorspace": "rgb", "outcolorspace": "rgb", "outdtype": "float32"}
    expected = imagecodecs.cms_transform(ramp, icc, linear, **options)
    # Its own float32, and 16 bits of the matrices, whose rows sum to 1 within 2e-5.
    np.testing.assert_allclose(decode(ramp, curve_of(icc_color(icc, 3))), expected, rtol=0, atol=3e-5)


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("name", [*RGB_PROFILES, "gray"])
def test_codes_come_back(name: str, bits: int) -> None:
    icc, channels = (GRAY_22, 1) if name == "gray" else (RGB_PROFILES[name][0], 3)
    curve = curve_of(icc_color(icc, channels))
    codes = np.arange(2**bits).astype(f"u{bits // 8}")
    back = encode(decode(codes, curve), bits, curve)
    moved = back != codes  # where a curve is flat in 2^16 steps of its table: the darkest codes
    np.testing.assert_array_equal(decode(back, curve), decode(codes, curve))
    assert moved.mean() < 0.02
    assert not moved[2 ** (bits - 4) :].any()
    if bits == 8:
        assert not moved.any()


def test_codes_are_the_nearest_ones() -> None:
    curve = curve_of(icc_color(made(whitepoint=D65, primaries=P3, gamma=2.0), 3))
    linear = np.array([[-1.0, 0.0, 0.2501, 1.0, 7.0, np.nan, (99.49 / 255) ** 2, (99.51 / 255) ** 2]], np.float32)
    np.testing.assert_array_equal(encode(linear, 8, curve), [[0, 0, 128, 255, 255, 0, 99, 100]])
    np.testing.assert_array_equal(encode(linear[..., :5], 16, curve), [[0, 0, 32774, 65535, 65535]])


def test_channels_have_their_own_curves() -> None:
    curves = [np.linspace(0, 1, 64) ** power for power in (1.5, 2.0, 2.5)]
    tags = b"".join(curv(curve) for curve in curves)
    color = icc_color(profile(tags, [16 + 2 * 64 - 4] * 3), 3)
    codes = np.dstack([CODES[None]] * 3)
    linear = decode(codes, curve_of(color))
    for channel, power in enumerate((1.5, 2.0, 2.5)):
        np.testing.assert_allclose(linear[0, :, channel], (CODES / 65535) ** power, atol=2e-3)
    np.testing.assert_array_equal(encode(linear, 8, curve_of(color)), (codes.astype(int) * 255 + 32768) // 65535)


def curv(curve: Array) -> bytes:
    return struct.pack(">4s4xI", b"curv", len(curve)) + np.rint(curve * 65535).astype(">u2").tobytes()


def para(kind: int, *numbers: float) -> bytes:
    return struct.pack(f">4s4xHxx{len(numbers)}i", b"para", kind, *(round(65536 * number) for number in numbers))


def profile(tags: bytes, sizes: list[int], space: bytes = b"RGB ", kinds: tuple[bytes, ...] = ()) -> bytes:
    """An ICC profile of these tags, one after the other."""
    names = kinds or (b"rTRC", b"gTRC", b"bTRC")[: len(sizes)]
    start, table = 132 + 12 * len(sizes), b""
    for name, size in zip(names, sizes, strict=True):
        table += struct.pack(">4sII", name, start, size)
        start += size
    head = bytearray(128)
    head[16:20], head[20:24], head[36:40] = space, b"XYZ ", b"acsp"
    return bytes(head) + struct.pack(">I", len(sizes)) + table + tags


X = CODES / 65535
PARAMETRIC = {
    0: ((2.2,), X**2.2),
    1: ((2.2, 1.2, -0.2), np.where(X >= 1 / 6, np.maximum(1.2 * X - 0.2, 0) ** 2.2, 0)),
    2: ((2.2, 1.0, -0.2, 0.1), np.where(X >= 0.2, np.maximum(X - 0.2, 0) ** 2.2, 0) + 0.1),
    3: ((2.4, 1 / 1.1, 0.1 / 1.1, 0.05, 0.1), np.where(X >= 0.1, ((X + 0.1) / 1.1) ** 2.4, 0.05 * X)),
    4: ((2.4, 0.9, 0.0, 0.02, 0.1, 0.1, 0.05), np.where(X >= 0.1, (0.9 * X) ** 2.4 + 0.1, 0.02 * X + 0.05)),
}


@pytest.mark.parametrize("kind", PARAMETRIC)
def test_parametric_curves_are_the_standards(kind: int) -> None:
    """ICC.1:2022, table 68."""
    numbers, expected = PARAMETRIC[kind]
    tag = para(kind, *numbers)
    color = icc_color(profile(tag, [len(tag)], b"GRAY", (b"kTRC",)), 1)
    np.testing.assert_allclose(decode(CODES, curve_of(color)), expected, rtol=0, atol=4e-5)  # numbers have 16 bits


GAMMA, FALLING = curv(np.array([2.0 * 256 / 65535])), curv(np.array([0.0, 1.0, 0.5, 1.0]))
LEFT_OUT = "the color profile is left out, as it cannot be read: "
UNUSABLE: dict[str, tuple[bytes, int, str]] = {
    "no profile": (b"damaged", 3, LEFT_OUT + "no ICC profile"),
    "too large": (bytes(LARGEST_PROFILE + 1), 3, LEFT_OUT + "over 4194304 bytes"),
    "many tags": (profile(b"", []).replace(bytes(4), b"\xff" * 4), 3, LEFT_OUT),
    "few tags": (profile(b"", [])[:128] + struct.pack(">I", 200), 3, LEFT_OUT),
    "a tag beyond": (profile(GAMMA, [99999], b"GRAY", (b"kTRC",)), 1, LEFT_OUT + "a tag beyond its end"),
    "a long curve": (profile(struct.pack(">4s4xI", b"curv", 2**31) + bytes(8), [20], b"GRAY", (b"kTRC",)), 1, LEFT_OUT),
    "a falling curve": (profile(FALLING, [20], b"GRAY", (b"kTRC",)), 1, LEFT_OUT + "a curve that does not increase"),
    "another curve": (profile(b"sf32" + bytes(16), [20], b"GRAY", (b"kTRC",)), 1, LEFT_OUT + "a curve of kind b'sf32'"),
    "kind 9": (profile(para(9, 1.0), [16], b"GRAY", (b"kTRC",)), 1, LEFT_OUT + "a parametric curve of kind 9"),
    "divided by 0": (profile(para(1, 2.0, 0.0, 1.0), [24], b"GRAY", (b"kTRC",)), 1, LEFT_OUT),
    "no number": (profile(para(0, -1.0), [16], b"GRAY", (b"kTRC",)), 1, LEFT_OUT + "a curve that does not increase"),
    "of gray": (GRAY_22, 3, "the color profile gray built-in is left out: it is for gray images"),
    "of RGB": (made("adobergb"), 1, "the color profile Adobe RGB (compatible) is left out: it is for RGB"),
    "of CMYK": (profile(b"", [], b"CMYK"), 3, "the color profile without a name is left out: it is for neither gray "),
}


@pytest.mark.parametrize("name", UNUSABLE)
def test_profiles_that_cannot_be_used_are_noted_in_a_line(name: str) -> None:
    icc, channels, message = UNUSABLE[name]
    color = icc_color(icc, channels)
    assert color.note.startswith(message)
    assert "\n" not in color.note
    assert color.is_plain
    assert color.curve is None


def test_a_profile_without_curves_is_carried_and_said() -> None:
    color = icc_color(profile(b"mft2" + bytes(40), [44], kinds=(b"A2B0",)), 3)
    assert color.note == "the color profile without a name has no curves: codes are taken as sRGB's"
    assert color.icc


def test_a_name_has_no_controls() -> None:
    text = b"desc" + bytes(8) + b"Red\x1b[31m\nP3\0more"
    color = icc_color(profile(text, [len(text)], kinds=(b"desc",)), 3)
    assert color.name == "Red[31mP3"
    wide = "P3 \u202e wide".encode("utf-16-be")
    text = b"mluc" + bytes(4) + struct.pack(">II4sII", 1, 12, b"enUS", len(wide), 28) + wide
    assert icc_color(profile(text, [len(text)], kinds=(b"desc",)), 3).name == "P3  wide"


def test_srgb_keeps_its_bits() -> None:
    for icc in (made("srgb"), made(whitepoint=D65, primaries=P3, transferfunction=srgb_table(1024))):
        color = icc_color(icc, 3)
        assert (color.curve, color.note, color.icc) == (None, "", icc)
        assert color.transfer("srgb") == "srgb"


CHRM = struct.pack(">8I", 31270, 32900, 68000, 32000, 26500, 69000, 15000, 6000)
BT709 = np.where(X < 0.0812429, X / 4.5, ((X + 0.0992968) / 1.0992968) ** (1 / 0.45))
CHUNKS: dict[str, tuple[dict[bytes, bytes], bool, Array | None]] = {
    "nothing": ({}, True, None),
    "sRGB": ({b"sRGB": b"\0", b"gAMA": struct.pack(">I", 100000)}, True, None),
    "cICP sRGB": ({b"cICP": bytes([1, 13, 0, 1])}, True, None),
    "cICP P3": ({b"cICP": bytes([12, 13, 0, 1])}, False, None),
    "cICP BT.709": ({b"cICP": bytes([1, 1, 0, 1])}, False, BT709),
    "cICP gamma": ({b"cICP": bytes([1, 4, 0, 1])}, False, X**2.2),
    "cICP linear": ({b"cICP": bytes([9, 8, 0, 1])}, False, X),
    "gAMA of sRGB": ({b"gAMA": struct.pack(">I", 45455)}, True, None),
    "gAMA and P3": ({b"gAMA": struct.pack(">I", 45455), b"cHRM": CHRM}, False, None),
    "P3 alone": ({b"cHRM": CHRM}, False, None),
    "BT.709 alone": ({b"cHRM": struct.pack(">8I", 31270, 32900, 64000, 33000, 30000, 60000, 15000, 6000)}, True, None),
    "gAMA 1": ({b"gAMA": struct.pack(">I", 100000)}, False, X),
    "gAMA 1.8": ({b"gAMA": struct.pack(">I", 55556)}, False, X ** (1 / 0.55556)),
    "gAMA 0": ({b"gAMA": bytes(4)}, True, None),
    "short gAMA": ({b"gAMA": b"\1"}, True, None),
}  # fmt: skip


@pytest.mark.parametrize("name", CHUNKS)
def test_chunks_of_a_png_stand_for_a_profile(name: str) -> None:
    chunks, plain, expected = CHUNKS[name]
    color = chunk_color(chunks)
    assert (color.is_plain, color.note) == (plain, "")
    assert (color.curve is None) == (expected is None)
    if expected is not None:
        np.testing.assert_allclose(decode(CODES, color.transfer("srgb")), expected, rtol=0, atol=1e-5)


def test_a_curve_that_is_not_known_is_said() -> None:
    color = chunk_color({b"cICP": bytes([9, 16, 0, 1])})
    assert color.note == "the transfer curve 16 of the chunk cICP is not known: codes are taken as sRGB's"
    assert color.chunks == ((b"cICP", bytes([9, 16, 0, 1])),)


def saved(path: Path, data: Array, icc: bytes) -> Path:
    if path.suffix == ".tif":
        tifffile.imwrite(path, data, photometric="rgb" if data.ndim == 3 else "minisblack", iccprofile=icc)
    elif data.dtype == np.uint16:
        write_png(path, data, Color("P", icc))
    else:
        Image.fromarray(data).save(path, icc_profile=icc, quality=100, subsampling=0)
    return path


def icc_in(path: Path) -> bytes:
    with Image.open(path) as image:
        return bytes(image.info.get("icc_profile", b""))


@pytest.mark.parametrize("dtype", ["u1", "u2"])
@pytest.mark.parametrize("suffix", ["png", "tif", "jpg"])
@pytest.mark.parametrize("gray", [False, True])
def test_readers_find_profiles(tmp_path: Path, suffix: str, dtype: str, gray: bool) -> None:
    if suffix == "jpg" and dtype == "u2":
        return
    data, icc = (PHOTO.astype(dtype) * (257 if dtype == "u2" else 1)).astype(dtype), made("adobergb")
    if gray:
        data, icc = data[..., 0], GRAY_22
    picture = read_image(saved(tmp_path / f"a.{suffix}", data, icc))
    assert picture.color.icc == icc
    for transfer, curve in (("srgb", curve_of(picture.color)), ("linear", "linear")):
        radiance = load_texture(tmp_path / f"a.{suffix}", transfer).radiance
        np.testing.assert_array_equal(radiance, decode(picture.data, curve).astype(np.float32))


@pytest.mark.parametrize("out", ["out.png", "out.tif"])
def test_kept_pixels_look_the_same(tmp_path: Path, out: str) -> None:
    """Codes and profile stay those of the image, through `inpaint` and through a `defocus` that blurs nothing."""
    icc = made("adobergb")
    image = saved(tmp_path / "image.jpg", PHOTO, icc)
    codes = read_image(image).data
    hole = np.zeros(PHOTO.shape[:2], np.uint8)
    hole[4:6, 5:9] = 255
    write_png(tmp_path / "mask.png", hole)
    np.save(tmp_path / "radius.npy", np.zeros(PHOTO.shape[:2]))
    blurred = ["defocus", image, tmp_path / "radius.npy", "--unit", "coc"]
    for words in (["inpaint", image, tmp_path / "mask.png"], blurred):
        result = done(*words, "-o", tmp_path / out)
        assert "profile" not in result.output
        assert icc_in(tmp_path / out) == icc
        unchanged = hole == 0 if "inpaint" in words else np.ones_like(hole, np.bool_)
        np.testing.assert_array_equal(read_image(tmp_path / out).data[unchanged], codes[unchanged])


def test_frames_in_a_folder_have_the_profile(tmp_path: Path) -> None:
    icc = made("adobergb")  # which has its time within
    image = saved(tmp_path / "image.png", PHOTO, icc)
    np.save(tmp_path / "radius.npy", np.zeros(PHOTO.shape[:2]))
    words = ("-o", tmp_path / "all", "--unit", "coc", "--format", "exr")
    done("defocus", image, tmp_path / "radius.npy", *words)
    assert icc_in(tmp_path / "all" / "frame_0000.png") == icc
    np.testing.assert_array_equal(read_image(tmp_path / "all" / "frame_0000.png").data, PHOTO)
    described = json.loads((tmp_path / "all" / "frame_0000.json").read_text())
    assert described["color_profile"] == "Adobe RGB (compatible)"
    header = OpenEXR.File(str(tmp_path / "all" / "frame_0000.exr"), header_only=True).header()
    assert "aperture" in header
    adobe = (0.64, 0.33, 0.21, 0.71, 0.15, 0.06, 0.3127, 0.329)
    np.testing.assert_allclose(header["chromaticities"], adobe, atol=2e-4)  # of a profile's 16 bits
    saved(image, PHOTO, made("srgb"))
    clsco_("defocus", image, tmp_path / "radius.npy", *words)
    assert json.loads((tmp_path / "all" / "frame_0000.json").read_text())["color_profile"] == "sRGB built-in"


def test_blur_is_linear_in_the_images_own_light(tmp_path: Path) -> None:
    """Half black, half white, out of focus: their mean is half the radiance, and a gamma of 1 makes that code 128."""
    half = np.zeros((16, 64, 3), np.uint8)
    half[:, ::2] = 255
    means = {}
    for name, gamma in (("linear", 1.0), ("square", 2.0)):
        saved(tmp_path / "image.png", half, made(whitepoint=D65, primaries=P3, gamma=gamma))
        np.save(tmp_path / "radius.npy", np.full((16, 64), 9.0))
        done("defocus", tmp_path / "image.png", tmp_path / "radius.npy", "-o", tmp_path / "a.png", "--unit", "coc")
        means[name] = read_image(tmp_path / "a.png").data[8, 24:40].mean()
    assert means["linear"] == pytest.approx(127.5, abs=4)
    assert means["square"] == pytest.approx(255 * 0.5**0.5, abs=4)


def test_what_cannot_be_carried_or_read_is_said(tmp_path: Path) -> None:
    no_matrix = profile(3 * curv(np.zeros(0)), [12] * 3)
    image = saved(tmp_path / "image.tif", PHOTO, no_matrix)
    write_png(tmp_path / "depth.png", np.full(PHOTO.shape[:2], 250, np.uint16))
    result = clsco_("defocus", image, tmp_path / "depth.png", "-o", tmp_path / "a.exr")
    loss = "an EXR has no place for the color profile without a name, which is left out"
    assert f"{tmp_path / 'a.exr'}: {loss}\n" in result.stderr
    write_tiff(image, PHOTO, Color("P", b"damaged"))
    write_png(tmp_path / "mask.png", np.zeros(PHOTO.shape[:2], np.uint8))
    for words in (["defocus", image, tmp_path / "depth.png"], ["inpaint", image, tmp_path / "mask.png"]):
        result = done(*words, "-o", tmp_path / "a.png")
        assert f"{image}: {LEFT_OUT}no ICC profile\n" in result.stderr
        assert icc_in(tmp_path / "a.png") == b""


def test_a_profile_bomb_is_cut_short(tmp_path: Path) -> None:
    content = io.BytesIO()
    Image.fromarray(PHOTO).save(content, "PNG")
    packed = b"bomb\0\0" + zlib.compress(bytes(2**26))
    body = struct.pack(">I", len(packed)) + b"iCCP" + packed + struct.pack(">I", zlib.crc32(b"iCCP" + packed))
    (tmp_path / "a.png").write_bytes(content.getvalue()[:33] + body + content.getvalue()[33:])
    picture = read_image(tmp_path / "a.png")
    assert picture.color.note == LEFT_OUT + "over 4194304 bytes"
    np.testing.assert_array_equal(picture.data, PHOTO)


def test_every_writer_says_what_it_loses() -> None:
    icc, chunks = Color("P", b"icc"), Color("of gAMA", chunks=((b"gAMA", bytes(4)),))
    lossless = {suffix: (not writer.loss(icc), not writer.loss(chunks)) for suffix, writer in WRITERS.items()}
    assert lossless == {".png": (True, True), ".tif": (True, False), ".tiff": (True, False), ".exr": (False, False)}
    assert not any(writer.loss(SRGB) for writer in WRITERS.values())
