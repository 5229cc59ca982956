"""Images of several color profiles in one scene: LittleCMS judges their conversion to the primaries of sRGB."""

from __future__ import annotations

import io
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest
from numpy.typing import NDArray
from PIL import Image, ImageCms
from tifffile import TiffFile

import clsco
from clsco.data.record import make_record
from clsco.files.color import CICP_CHROMATICITIES as CICP
from clsco.files.color import SRGB_CHROMATICITIES, Color, chromaticities_to_srgb, chunk_color, icc_color
from clsco.files.images import read_image, write_png, write_tiff
from clsco.files.transfer import decode, encode
from clsco.inputs.files import InputFiles
from clsco.inputs.textures import load_scene_textures
from tests.command import clsco_, done
from tests.data.samples import drawn
from tests.files.profiles import ADOBE, D65, P3, made, srgb_table
from tests.slow import mostly_slow

Array = NDArray[Any]
PHOTO = np.random.default_rng(8).integers(0, 256, (48, 64, 3)).astype(np.uint8)


PROFILES = {
    "Display P3": made(whitepoint=D65, primaries=P3, transferfunction=srgb_table(4096)),
    "Adobe RGB": made("adobergb"),
    "white of 5000 K": made(whitepoint=[0.3457, 0.3585, 1.0], primaries=ADOBE, gamma=1.8),
}
SCENE = """[camera]
resolution = [64, 48]
aperture_diameter = 0.001
[[object]]
name = "left"
shape = "rectangle"
center = [0, 0, 250]
size = [100, 100]
texture = "{}"
[[object]]
name = "wall"
shape = "plane"
distance = 260
texture = "{}"
"""


def scene_in(folder: Path, first: str, second: str, options: str = "") -> Path:
    (folder / "scene.toml").write_text(options + SCENE.format(first, second))
    return folder / "scene.toml"


def by_littlecms(codes: Array, icc: bytes) -> Array:
    """Codes in sRGB, by the relative colorimetric intent."""
    source, srgb = ImageCms.ImageCmsProfile(io.BytesIO(icc)), ImageCms.createProfile("sRGB")
    intent = ImageCms.Intent.RELATIVE_COLORIMETRIC
    flags = ImageCms.Flags.HIGHRESPRECALC
    found = ImageCms.profileToProfile(Image.fromarray(codes), source, srgb, intent, flags=flags)
    assert found is not None
    return np.asarray(found)


@pytest.mark.parametrize("name", PROFILES)
def test_frames_are_as_by_littlecms(tmp_path: Path, name: str) -> None:
    icc = PROFILES[name]
    write_png(tmp_path / "photo.png", PHOTO, Color("P", icc))
    write_png(tmp_path / "plain.png", PHOTO)
    path = scene_in(tmp_path, "photo.png", "plain.png")
    result = done("render", path, "-o", tmp_path / "out")
    called = icc_color(icc, 3).name
    line = f"frames are in sRGB, and colors of the profile {called} are converted to it"
    assert result.stderr.endswith(f"{tmp_path / 'photo.png'}: {line}\n")
    frame, expected = read_image(tmp_path / "out" / "frame_0000.png"), by_littlecms(PHOTO, icc)
    assert frame.color.icc == b""
    off = np.abs(frame.data.astype(int) - expected)
    assert off.max() <= 1
    assert np.abs(PHOTO.astype(int) - expected).max() > 20  # taken as such


def test_every_image_of_a_scene_is_converted_in_the_reference_too(tmp_path: Path) -> None:
    """Two profiles, neither of them sRGB; on surfaces and projected; frames and reference have the same light."""
    for name, key in (("a", "Display P3"), ("b", "Adobe RGB")):
        write_tiff(tmp_path / f"{name}.tif", PHOTO, Color(key, PROFILES[key]))
    scene = clsco.load_scene(scene_in(tmp_path, "a.tif", "b.tif"))
    loaded = load_scene_textures(scene)[1]
    for texture, mine, key in zip(loaded, InputFiles().textures(scene), ("Display P3", "Adobe RGB"), strict=True):
        np.testing.assert_array_equal(texture.radiance, mine.radiance)
        expected = decode(by_littlecms(PHOTO, PROFILES[key]), "srgb")
        inside = (texture.radiance >= 0) & (texture.radiance <= 1)
        assert np.abs(texture.radiance - expected)[inside].max() < 0.006  # of a code near white
        assert (texture.radiance < 0).any()  # outside of sRGB: kept until codes are written
    (reference,) = clsco.reference.render(scene)
    np.testing.assert_allclose(clsco.render_frame(scene).color, reference.color, atol=1e-5)


def test_one_profile_keeps_its_bits(tmp_path: Path) -> None:
    """Images of one profile, beside gray ones without color, are not converted; nor are linear codes."""
    icc = PROFILES["Adobe RGB"]
    write_png(tmp_path / "a.png", PHOTO, Color("P", icc))
    write_png(tmp_path / "b.png", PHOTO[::-1].copy(), Color("P", icc))
    write_png(tmp_path / "plain.png", PHOTO)
    curve = icc_color(icc, 3).transfer("srgb")
    files = InputFiles()
    alone = files.textures(clsco.load_scene(scene_in(tmp_path, "a.png", "b.png")))
    np.testing.assert_array_equal(alone[0].radiance, decode(PHOTO, curve).astype(np.float32))
    mixed = files.textures(clsco.load_scene(scene_in(tmp_path, "a.png", "plain.png")))
    assert np.abs(mixed[0].radiance - alone[0].radiance).max() > 0.1
    np.testing.assert_array_equal(mixed[1].radiance, decode(PHOTO, "srgb").astype(np.float32))
    again = files.textures(clsco.load_scene(scene_in(tmp_path, "a.png", "b.png")))
    np.testing.assert_array_equal(again[0].radiance, alone[0].radiance)  # kept apart from the converted one
    linear = files.textures(clsco.load_scene(scene_in(tmp_path, "a.png", "plain.png", 'image.transfer = "linear"\n')))
    np.testing.assert_array_equal(linear[0].radiance, decode(PHOTO, "linear").astype(np.float32))


def test_profiles_without_a_matrix_are_taken_as_such(tmp_path: Path) -> None:
    lut = bytearray(128)
    lut[16:24], lut[36:40] = b"RGB Lab ", b"acsp"
    icc = bytes(lut) + struct.pack(">I4sII", 1, b"A2B0", 144, 44) + b"mft2" + bytes(40)
    write_png(tmp_path / "a.png", PHOTO, Color("P", icc))
    write_png(tmp_path / "b.png", PHOTO[..., 0].copy(), Color("P", made("gray", gamma=2.2)))
    path = scene_in(tmp_path, "a.png", "b.png")
    result = done("render", path, "-o", tmp_path / "out")
    no_curves = "the color profile without a name has no curves: codes are taken as sRGB's"
    line = "frames are in sRGB, and colors of the profile without a name are taken as such"
    notes = f"{tmp_path / 'a.png'}: {no_curves}\n{tmp_path / 'a.png'}: {line}\n"  # gray has no colors
    assert result.stderr.endswith(notes)
    np.testing.assert_array_equal(read_image(tmp_path / "out" / "frame_0000.png").data, PHOTO)


def test_profiles_of_srgb_have_no_matrix_but_one() -> None:
    for icc in (made("srgb"), ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()):
        np.testing.assert_array_equal(icc_color(icc, 3).to_srgb, np.eye(3))
    assert icc_color(made("gray", gamma=2.2), 1).to_srgb is None


@pytest.mark.parametrize("code", sorted(CICP))
def test_primaries_of_chunks_are_as_by_littlecms(code: int) -> None:
    """cICP, and cHRM of the same numbers, against a profile of these numbers that LittleCMS makes, adapted to D50."""
    numbers = CICP[code]
    white, *primaries = ([*numbers[k : k + 2], 1.0] for k in range(0, 8, 2))
    icc = made(whitepoint=white, primaries=[n for primary in primaries for n in primary], gamma=1.0)
    expected = icc_color(icc, 3).to_srgb
    assert expected is not None
    found = chunk_color({b"cICP": bytes([code, 8, 0, 1])}).to_srgb
    chrm = struct.pack(">8I", *(round(1e5 * number) for number in numbers))
    by_chrm = chunk_color({b"gAMA": struct.pack(">I", 100000), b"cHRM": chrm}).to_srgb
    for matrix in (found, by_chrm):
        assert matrix is not None
        np.testing.assert_allclose(matrix, expected, rtol=0, atol=3e-4)  # a profile has 16 bits, D50 four digits
        np.testing.assert_allclose(matrix.sum(axis=1), 1.0, atol=1e-9)  # white stays


DAMAGED = {
    "short": b"\0" * 8,
    "zeros": bytes(32),
    "no y": struct.pack(">8I", 31270, 0, 64000, 33000, 30000, 60000, 15000, 6000),
    "one line": struct.pack(">8I", 31270, 32900, 30000, 30000, 20000, 20000, 10000, 10000),
    "huge": b"\xff" * 32,
}


@pytest.mark.parametrize("name", DAMAGED)
def test_primaries_that_span_no_colors_have_no_matrix(name: str) -> None:
    color = chunk_color({b"gAMA": struct.pack(">I", 45455), b"cHRM": DAMAGED[name]})
    assert color.to_srgb is None
    assert color.chunks


def test_colorants_that_are_none_have_no_matrix() -> None:
    icc = made("adobergb")
    start = icc.index(b"gXYZ", 128)
    (at,) = struct.unpack_from(">I", icc, start + 4)
    for wrong in (b"none", b"XYZ " + bytes(16)):
        damaged = icc[:at] + wrong + icc[at + len(wrong) :]
        assert (icc_color(damaged, 3).to_srgb, icc_color(damaged, 3).note) == (None, "")
    for white in (0.0, 1e-5, -1.0):  # of the medium or before its adaptation: conversions do not need it
        for tag in (b"wtpt", b"chad"):
            (at,) = struct.unpack_from(">I", icc, icc.index(tag, 128) + 4) if tag in icc else (len(icc),)
            damaged = icc[: at + 8] + struct.pack(">i", round(65536 * white)) * 3 + icc[at + 20 :]
            assert icc_color(damaged, 3).note == ""


def test_srgb_is_the_unit() -> None:
    np.testing.assert_array_equal(chromaticities_to_srgb(SRGB_CHROMATICITIES), np.eye(3))


ACES = {  # x and y of red, green, blue and white, as OpenEXR has them
    "AP0": (0.7347, 0.2653, 0.0, 1.0, 0.0001, -0.077, 0.32168, 0.33767),
    "AP1": (0.713, 0.293, 0.165, 0.83, 0.128, 0.044, 0.32168, 0.33767),
}
RADIANCE = np.random.default_rng(9).uniform(0.1, 0.6, (48, 64, 3)).astype(np.float32)


def saved_exr(path: Path, chromaticities: tuple[float, ...], parts: tuple[str, ...] = ("",)) -> Path:
    planes = {name: np.ascontiguousarray(RADIANCE[..., k]) for k, name in enumerate("RGB")}
    header = {"chromaticities": chromaticities, "type": OpenEXR.scanlineimage}
    held = [planes, {"Z": RADIANCE[..., 0].copy()}]
    made = [OpenEXR.Part({**header}, channels, name) for channels, name in zip(held, parts, strict=False)]
    OpenEXR.File(made).write(str(path))
    return path


def chromaticities_in(path: Path) -> Any:
    return OpenEXR.File(str(path), header_only=True).parts[0].header.get("chromaticities")


def by_hand(numbers: tuple[float, ...]) -> Array:
    """Matrix to linear sRGB from x and y of red, green, blue and white; whites by Bradford."""

    def to_xyz(numbers: Any) -> tuple[Array, Array]:
        x, y = np.array(numbers).reshape(4, 2).T
        xyz = np.array([x, y, 1 - x - y])
        white = xyz[:, 3] / y[3]
        return xyz[:, :3] * np.linalg.solve(xyz[:, :3], white), white

    cones = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])
    (source, white), (srgb, d65) = to_xyz(numbers), to_xyz((0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329))
    bradford = np.linalg.inv(cones) @ np.diag((cones @ d65) / (cones @ white)) @ cones
    return np.asarray(np.linalg.inv(srgb) @ bradford @ source)


def test_the_matrix_of_acescg_is_as_published() -> None:
    published = [[1.70505, -0.62179, -0.08326], [-0.13026, 1.14080, -0.01055], [-0.02400, -0.12897, 1.15297]]
    np.testing.assert_allclose(by_hand(ACES["AP1"]), published, atol=2e-5)


@pytest.mark.parametrize("name", mostly_slow(ACES, ["AP1"]))
def test_chromaticities_of_an_exr_come_out_of_every_writer(tmp_path: Path, name: str) -> None:
    """With values as they are; in PNG and TIFF as a profile, by which LittleCMS gets the colors of the matrix."""
    numbers, image = ACES[name], saved_exr(tmp_path / "image.exr", ACES[name])
    np.save(tmp_path / "radius.npy", np.zeros((48, 64)))
    write_png(tmp_path / "mask.png", np.zeros((48, 64), np.uint8))
    blurred = ["defocus", image, tmp_path / "radius.npy", "--unit", "coc"]
    filled = ["inpaint", image, tmp_path / "mask.png"]
    scene = scene_in(tmp_path, "image.exr", "image.exr")
    (tmp_path / "all").mkdir()
    runs = [(blurred, "a.exr"), (filled, "b.exr"), (blurred, "a.png"), (blurred, "a.tif"), (filled, "b.tif")]
    runs += [([*blurred, "--format", "exr"], "folder"), (["render", scene, "--format", "exr"], "all")]
    for words, out in runs:
        assert "left out" not in done(*words, "-o", tmp_path / out).stderr
    frame = clsco.render_frame(clsco.load_scene(scene))
    frame.save(tmp_path / "frame.exr")
    frame.save(tmp_path / "frame.tif")
    make_record(drawn(1), 0, [[frame]], ("color",), {"color": "float32"}).save(tmp_path / "record.exr")
    for path in ("a.exr", "b.exr", "folder/frame_0000.exr", "all/frame_0000.exr", "frame.exr", "record.exr"):
        np.testing.assert_array_equal(chromaticities_in(tmp_path / path), np.array(numbers, np.float32))
        np.testing.assert_allclose(read_image(tmp_path / path).data, RADIANCE, atol=1e-6)
    for path in ("folder/frame_0000.json", "all/frame_0000.json"):
        described = json.loads((tmp_path / path).read_text())
        np.testing.assert_array_equal(described["chromaticities"], np.array(numbers, np.float32))
    matrix = by_hand(numbers)
    for path in ("a.png", "all/frame_0000.png", "a.tif", "b.tif", "frame.tif"):
        picture = read_image(tmp_path / path)
        assert picture.color.to_srgb is not None
        np.testing.assert_allclose(picture.color.to_srgb, matrix, atol=4e-4)  # D50 has four digits, colorants 16 bits
        linear = decode(picture.data, picture.color.transfer("srgb"))
        icc = picture.color.icc
        if path.endswith("tif"):
            with TiffFile(tmp_path / path) as tiff:
                assert tiff.pages[0].iccprofile == icc  # type: ignore[union-attr]
        converted = np.clip(RADIANCE.astype(np.float64) @ matrix.T, 0, 1)
        codes = np.rint(255 * RADIANCE if path.endswith("tif") else encode(RADIANCE, 8, "srgb")).astype(np.uint8)
        off = np.abs(decode(by_littlecms(codes, icc), "srgb") - converted)
        assert off.max() < 0.04  # codes of 8 bits, times 1.7 or 2.5
        assert off.mean() < 0.005
        np.testing.assert_allclose(linear, RADIANCE, atol=1e-4)


@pytest.mark.parametrize("transfer", ["srgb", "linear"])
@pytest.mark.parametrize("name", ACES)
def test_an_exr_beside_another_image_is_converted(tmp_path: Path, name: str, transfer: str) -> None:
    saved_exr(tmp_path / "image.exr", ACES[name])
    write_png(tmp_path / "plain.png", PHOTO)
    path = scene_in(tmp_path, "image.exr", "plain.png", f'image.transfer = "{transfer}"\n')
    result = clsco_("render", path, "-o", tmp_path / "out", "--format", "exr")
    assert "frames are in sRGB, and colors of the profile of chromaticities 0.7" in result.stderr
    assert "are converted to it" in result.stderr
    np.testing.assert_allclose(chromaticities_in(tmp_path / "out/frame_0000.exr")[:2], (0.64, 0.33), atol=1e-6)
    written = read_image(tmp_path / "out/frame_0000.exr").data
    np.testing.assert_allclose(written, RADIANCE.astype(np.float64) @ by_hand(ACES[name]).T, atol=5e-4)


def test_chromaticities_of_parts_and_those_that_are_none(tmp_path: Path) -> None:
    parts = saved_exr(tmp_path / "parts.exr", ACES["AP1"], ("rgb", "depth"))
    assert read_image(parts).color == read_image(saved_exr(tmp_path / "a.exr", ACES["AP1"])).color
    assert read_image(saved_exr(tmp_path / "b.exr", (0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329))).color.is_plain
    for wrong in ((0.0,) * 8, (*ACES["AP1"][:7], np.nan)):
        color = read_image(saved_exr(tmp_path / "c.exr", wrong)).color
        assert color.is_plain
        assert color.note.endswith("are left out: they span no colors")


CHRM = (np.array(CICP[12]) * 1e5).round().astype(">u4").tobytes()


@pytest.mark.parametrize("chunks", [
    {b"cICP": bytes([12, 13, 0, 1])}, {b"cICP": bytes([12, 4, 0, 1])}, {b"iCCP": PROFILES["Display P3"]},
    {b"gAMA": struct.pack(">I", 45455), b"cHRM": CHRM}, {b"cHRM": CHRM},
])  # fmt: skip
def test_primaries_of_a_png_survive_in_tiff_and_exr(tmp_path: Path, chunks: dict[bytes, bytes]) -> None:
    color = Color("P", chunks[b"iCCP"]) if b"iCCP" in chunks else Color("P", chunks=tuple(chunks.items()))
    write_png(tmp_path / "image.png", PHOTO, color)
    np.save(tmp_path / "radius.npy", np.zeros((48, 64)))
    for out in ("a.tif", "a.exr"):
        words = ["defocus", tmp_path / "image.png", tmp_path / "radius.npy", "--unit", "coc", "-o", tmp_path / out]
        assert "no place" not in done(*words).stderr
    before, tiff = read_image(tmp_path / "image.png"), read_image(tmp_path / "a.tif")
    np.testing.assert_array_equal(tiff.data, PHOTO)
    light = [decode(each.data, each.color.transfer("srgb")) for each in (before, tiff)]
    np.testing.assert_allclose(light[1], light[0], atol=2e-5)
    np.testing.assert_allclose(read_image(tmp_path / "a.exr").data, light[0], atol=1e-6)
    p3 = (0.68, 0.32, 0.265, 0.69, 0.15, 0.06, 0.3127, 0.329)
    np.testing.assert_allclose(chromaticities_in(tmp_path / "a.exr"), p3, atol=2e-4)
    assert tiff.color.to_srgb is not None
    np.testing.assert_allclose(tiff.color.to_srgb, by_hand(p3), atol=4e-4)
