"""Depth files: the numbers that they store, what those mean in each unit, and one line where they cannot be meant."""

from __future__ import annotations

import io
import struct
import time
import tracemalloc
import zipfile
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import imagecodecs
import numpy as np
import OpenEXR
import pytest
import tifffile
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from PIL import Image

from clsco.depthmaps import FARTHEST, UNITS, check_sizes, inverse_depth, read_depth
from clsco.errors import ImageError
from clsco.optics import LARGEST_BLUR, blur_radius, blur_scale, focus_power
from clsco.scene import Camera

Array = NDArray[Any]
CAMERA = Camera()  # kappa = 10,000 px mm, in focus at 250.017 mm, 39.997 px at infinity
BASELINE = 60.0


def numbers(dtype: str, shape: tuple[int, ...] = (5, 7)) -> Array:
    """Numbers of which no two rows, columns or byte orders agree; floats have all kinds that a file can hold."""
    generator = np.random.default_rng(3)
    if np.dtype(dtype).kind == "f":
        data = (1000 * generator.standard_normal(shape)).astype(dtype)
        data.flat[:4] = np.nan, np.inf, -np.inf, 0
        return data
    limits = np.iinfo(dtype)
    data = generator.integers(
        limits.min, limits.max, shape, endpoint=True, dtype=limits.dtype.newbyteorder("=")
    ).astype(dtype)
    data.flat[:2] = limits.max, limits.min
    return data


def save_exr(path: Path, channels: dict[str, Array]) -> None:
    header = {"type": OpenEXR.scanlineimage, "compression": OpenEXR.ZIP_COMPRESSION}
    OpenEXR.File(header, {name: np.ascontiguousarray(data) for name, data in channels.items()}).write(str(path))


def save_pfm(path: Path, data: Array, scale: str = "-1") -> None:
    order = "<" if scale.startswith("-") else ">"
    kind = "PF" if data.ndim == 3 else "Pf"
    content = b"".join(row.astype(f"{order}f4").tobytes() for row in data[::-1])  # the lowest row comes first
    path.write_bytes(f"{kind}\n{data.shape[1]} {data.shape[0]}\n{scale}\n".encode() + content)


def refusal(path: Path) -> str:
    """The message, a single line, after the path, with which a file is not read."""
    with pytest.raises(ImageError) as caught:
        read_depth(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert "; got " in message
    assert message.isprintable()
    return message.removeprefix(f"{path}: ")


FORMATS: dict[str, tuple[str, str, Callable[[Path, Array], object]]] = {
    "PNG 8": ("png", "u1", lambda path, data: path.write_bytes(imagecodecs.png_encode(data))),
    "PNG 16": ("png", "u2", lambda path, data: path.write_bytes(imagecodecs.png_encode(data))),
    "PNG 16 by Pillow": ("PNG", "u2", lambda path, data: Image.fromarray(data).save(path)),
    "TIFF u1": ("tif", "u1", tifffile.imwrite),
    "TIFF u2": ("tiff", "u2", tifffile.imwrite),
    "TIFF u2, big endian": ("tif", "u2", lambda path, data: tifffile.imwrite(path, data, byteorder=">")),
    "TIFF i2": ("tif", "i2", tifffile.imwrite),
    "TIFF u4": ("tif", "u4", tifffile.imwrite),
    "TIFF f2": ("tif", "f2", tifffile.imwrite),
    "TIFF f4": ("tif", "f4", tifffile.imwrite),
    "TIFF f4, big endian": ("tif", "f4", lambda path, data: tifffile.imwrite(path, data, byteorder=">")),
    "TIFF f4, compressed": ("tif", "f4", lambda path, data: tifffile.imwrite(path, data, compression="zlib")),
    "TIFF f4 by Pillow": ("tif", "f4", lambda path, data: Image.fromarray(data).save(path)),
    "TIFF f8": ("tif", "f8", tifffile.imwrite),
    "EXR f2": ("exr", "f2", lambda path, data: save_exr(path, {"Z": data})),
    "EXR f4": ("exr", "f4", lambda path, data: save_exr(path, {"Z": data})),
    "EXR u4": ("exr", "u4", lambda path, data: save_exr(path, {"Z": data})),
    "PFM": ("pfm", "f4", save_pfm),
    "PFM, big endian": ("pfm", "f4", lambda path, data: save_pfm(path, data, "1")),
    "PFM, scaled as Middlebury's": ("pfm", "f4", lambda path, data: save_pfm(path, data, "-0.003922")),
    "NPZ": ("npz", "f4", lambda path, data: np.savez(path, depth=data)),
    "NPZ, compressed": ("npz", ">u2", lambda path, data: np.savez_compressed(path, depth=data)),
    "NPZ, only one": ("npz", "f8", lambda path, data: np.savez(path, z=data, t=3.0, xyz=np.ones((5, 7, 3)))),
    "NPZ, one of two": ("npz", "f8", lambda path, data: np.savez(path, K=np.eye(3), depth=data)),
    **{f"NPY {dtype}": ("npy", dtype, np.save) for dtype in ("u1", "i2", ">u2", "i4", "u8", "f2", ">f4", "f8")},
    "NPY, columns first": ("npy", "f4", lambda path, data: np.save(path, np.asfortranarray(data))),
}


@pytest.mark.parametrize(("suffix", "dtype", "save"), FORMATS.values(), ids=FORMATS)
def test_reads_the_numbers_that_a_file_stores(
    tmp_path: Path, suffix: str, dtype: str, save: Callable[[Path, Array], object]
) -> None:
    data = numbers(dtype)
    path = tmp_path / f"depth.{suffix}"
    save(path, data)
    read = read_depth(path)
    np.testing.assert_array_equal(read, data.astype(np.float64), strict=True)
    assert read.flags.c_contiguous


def test_a_pfm_begins_with_its_lowest_row(tmp_path: Path) -> None:
    path = tmp_path / "depth.pfm"
    path.write_bytes(b"Pf\n2 2\n-1.0\n" + struct.pack("<4f", 1, 2, 3, 4))
    np.testing.assert_array_equal(read_depth(path), [[3, 4], [1, 2]])
    path.write_bytes(b"Pf\n2 2\n1.0\n" + struct.pack(">4f", 1, 2, 3, 4))
    np.testing.assert_array_equal(read_depth(path), [[3, 4], [1, 2]])


@pytest.mark.parametrize("kind", ["png u1", "png u2", "tif u2", "tif f4", "pfm f4", "npy f8", "npz f4"])
def test_three_equal_channels_are_one_depth(tmp_path: Path, kind: str) -> None:
    suffix, dtype = kind.split()
    savers: dict[str, Callable[[Path, Array], object]] = {
        "png": lambda path, data: path.write_bytes(imagecodecs.png_encode(data)),
        "tif": lambda path, data: tifffile.imwrite(path, data, photometric="rgb"),
        "pfm": save_pfm,
        "npy": np.save,
        "npz": lambda path, data: np.savez(path, depth=data),
    }
    gray = numbers(dtype)
    path = tmp_path / f"depth.{suffix}"
    data = np.stack([gray] * 3, axis=-1)
    savers[suffix](path, data)
    np.testing.assert_array_equal(read_depth(path), gray.astype(np.float64))
    data[4, 5] = (1, 1, 2)
    savers[suffix](path, data)
    got = [1.0, 1.0, 2.0] if dtype[0] == "f" else [1, 1, 2]
    rule = "must hold one depth per pixel: red, green and blue must be equal"
    assert refusal(path) == f"{rule}; got {got} at row 4, column 5 (1 in all)"


Z, OTHER, THIRD = (numbers("f4") + np.float32(n) for n in (0, 1, 2))

CHANNELS: dict[str, dict[str, Array]] = {
    "Blender, one layer": {"R": OTHER, "G": OTHER, "B": OTHER, "A": OTHER, "Z": Z},
    "Blender, several layers": {
        "Composite.Combined.R": OTHER,
        "ViewLayer.Combined.R": OTHER,
        "ViewLayer.Depth.Z": Z,
        "ViewLayer.Mist.Z": OTHER,
        "ViewLayer.Normal.X": OTHER,
        "ViewLayer.Normal.Y": OTHER,
        "ViewLayer.Normal.Z": OTHER,
    },
    "Blender, values": {"ViewLayer.Depth.V": Z, "ViewLayer.Position.X": OTHER},
    "Blender, file output": {"Depth.V": Z, "Image.R": OTHER},
    "a vector and a value": {"N.X": OTHER, "N.Y": OTHER, "N.Z": OTHER, "near.Z": Z},
    "clsco": {"R": OTHER, "Z": Z, "coc": THIRD, "N.X": OTHER, "N.Y": OTHER, "N.Z": THIRD, "id": OTHER},
    "all layers and one": {"Z": Z, "ViewLayer.Depth.Z": OTHER},
    "V": {"V": Z, "R": OTHER},
    "R": {"R": Z, "A": OTHER},
    "gray as RGB": {"R": Z, "G": Z, "B": Z},
    "Y": {"Y": Z, "A": OTHER},
    "depth": {"depth": Z, "R": OTHER},
    "layer of a depth": {"left.depth": Z, "R": OTHER},
    "only one": {"distance": Z},
    "two that agree": {"one.Depth.Z": Z, "two.Depth.Z": Z},
}


@pytest.mark.parametrize("channels", CHANNELS.values(), ids=CHANNELS)
def test_finds_the_depth_among_channels(tmp_path: Path, channels: dict[str, Array]) -> None:
    save_exr(tmp_path / "depth.exr", channels)
    np.testing.assert_array_equal(read_depth(tmp_path / "depth.exr"), Z)


@pytest.mark.parametrize(("channels", "got"), [
    ({"one.Z": Z, "two.Z": OTHER, "R": Z}, "channels one.Z two.Z that differ"),
    ({"a.Depth.Z": Z, "b.Depth.V": OTHER, "Mist.Z": Z}, "channels a.Depth.Z b.Depth.V that differ"),
    ({"R": Z, "G": OTHER, "B": Z}, "channels B G R that differ"),
    ({"X": Z, "Y.": Z, "Z.X": Z}, "X Y. Z.X"),
    ({"P.X": Z, "P.Y": Z, "P.Z": Z}, "P.X P.Y P.Z"),
    ({f"c{n:02}": Z for n in range(22)}, f"{' '.join(f'c{n:02}' for n in range(20))} and 2 more"),
    ({"a\nb": Z, "c": Z}, r"'a\nb' c"),
])  # fmt: skip
def test_lists_the_channels_where_the_depth_is_not_clear(tmp_path: Path, channels: dict[str, Array], got: str) -> None:
    save_exr(tmp_path / "depth.exr", channels)
    message = refusal(tmp_path / "depth.exr")
    assert message.startswith("an EXR must hold one depth")
    assert message.endswith(f"; got {got}")


def save_parts(path: Path, *parts: dict[str, Array], **last: Any) -> None:
    headers: list[dict[str, Any]] = [{"type": OpenEXR.scanlineimage, "name": f"part{n}"} for n in range(len(parts))]
    headers[-1] |= last
    pages = [OpenEXR.Part(header, dict(part), header["name"]) for header, part in zip(headers, parts, strict=True)]
    OpenEXR.File(pages).write(str(path))


def test_an_exr_may_have_parts(tmp_path: Path) -> None:
    path = tmp_path / "depth.exr"
    save_parts(path, {"ViewLayer.Combined.R": OTHER}, {"ViewLayer.Depth.Z": Z})
    np.testing.assert_array_equal(read_depth(path), Z)
    save_parts(path, {"Z": OTHER}, {"Z": Z})
    assert refusal(path) == "the channels of an EXR must have different names; got Z"
    save_parts(path, {"R": OTHER}, {"Z": Z[:3]}, dataWindow=((0, 0), (6, 2)), displayWindow=((0, 0), (6, 4)))
    assert refusal(path) == "must be a whole EXR; got channel Z of shape (3, 7)"
    save_parts(path, {"R": np.tile(OTHER, (40, 40))}, {"Z": np.tile(Z, (40, 40))})
    content = path.read_bytes()
    path.write_bytes(content[: len(content) - 200])
    assert refusal(path).startswith("must be a whole EXR; got ")


def stored(save: Callable[..., object], *arguments: Any, **options: Any) -> bytes:
    stream = io.BytesIO()
    save(stream, *arguments, **options)
    return stream.getvalue()


def archive(**members: bytes) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as file:
        for name, content in members.items():
            file.writestr(f"{name}.npy", content)
    return stream.getvalue()


def encrypted(content: bytes) -> bytes:
    """Set the bit that says that the first member is encrypted, in both of its headers."""
    data = bytearray(content)
    data[6] |= 1
    data[data.index(b"PK\1\2") + 8] |= 1
    return bytes(data)


SMALL = numbers("f4")
NPY = stored(np.save, SMALL)
BIG_NPY = NPY.replace(b"(5, 7), }        ", b"(13000, 13000), }")
LONG_NPY = NPY.replace(b"(5, 7), }    ", b"(1, 70000), }")
NPZ = archive(depth=NPY)
OBJECTS = stored(np.save, np.array([[{}]]), allow_pickle=True)
MANY_CHANNELS = stored(
    OpenEXR.File({"type": OpenEXR.scanlineimage}, {f"c{n}": np.zeros((4, 4), "f2") for n in range(5)}).write
).replace(struct.pack("<4i", 0, 0, 3, 3), struct.pack("<4i", 0, 0, 11999, 10999))
LIMIT = "columns and rows must be from 1 to 65536, and at most 134217728 pixels; got "
NONE_OF_THEM = "an NPZ must hold an array depth, or one array with two dimensions; got "
ONLY_NUMBERS = "array depth must hold numbers of shape (rows, columns); got "

# fmt: off
REFUSED: dict[str, tuple[str, bytes, str]] = {
    "JPEG": ("a.jpg", b"\xff\xd8\xff", "the extension must be one of .png .tif .tiff .exr .pfm .npy .npz; got '.jpg'"),
    "no NPZ": ("a.npz", NPY, "the content must be NPZ, as the extension says; got NPY"),
    "empty": ("a.npz", b"", "the content must be NPZ, as the extension says; got an empty file"),
    "big PNG": ("a.png", stored(Image.new("L", (13000, 13000)).save, "PNG"), f"{LIMIT}13000 x 13000"),
    "big PFM": ("a.pfm", b"Pf\n13000 13000\n-1\n", f"{LIMIT}13000 x 13000"),
    "big NPY": ("a.npy", BIG_NPY, f"{LIMIT}13000 x 13000"),
    "big NPZ": ("a.npz", archive(depth=BIG_NPY), f"{LIMIT}13000 x 13000"),
    "long NPZ": ("a.npz", archive(depth=LONG_NPY), f"{LIMIT}70000 x 1"),
    "no rows": ("a.npz", archive(depth=stored(np.save, np.ones((0, 4)))), f"{LIMIT}4 x 0"),
    "many channels": ("a.exr", MANY_CHANNELS,
                      "an EXR must hold at most 536870912 values; got 5 channels of 12000 x 11000"),
    "objects": ("a.npz", archive(depth=OBJECTS), f"{ONLY_NUMBERS}object of shape (1, 1)"),
    "objects in an NPY": ("a.npy", OBJECTS, "an NPY must hold numbers of shape "),
    "complex": ("a.npz", archive(depth=stored(np.save, np.ones((2, 2), "c8"))), f"{ONLY_NUMBERS}complex64 of shape"),
    "complex TIFF": ("a.tif", stored(tifffile.imwrite, np.ones((2, 2), "c8")),
                     "values must be integers or floats; got complex64"),
    "volume": ("a.npz", archive(depth=stored(np.save, np.ones((2, 2, 2)))),
               f"{ONLY_NUMBERS}float64 of shape (2, 2, 2)"),
    "one number": ("a.npz", archive(depth=stored(np.save, 1.0)), f"{ONLY_NUMBERS}float64 of shape ()"),
    "two arrays": ("a.npz", archive(z=NPY, d=NPY), f"{NONE_OF_THEM}arrays d z"),
    "no array": ("a.npz", archive(points=stored(np.save, np.ones((2, 2, 3)))), f"{NONE_OF_THEM}none"),
    "many arrays": ("a.npz", archive(**{f"a{n}": b"" for n in range(257)}),
                    "an NPZ must hold an array depth, or at most 256 arrays; got more"),
    "short array": ("a.npz", archive(depth=NPY[:-4]), "must be a whole NPZ; got "),
    "long array": ("a.npz", archive(depth=NPY + b"1234"), "must be a whole NPZ; got bytes after the array"),
    "no header": ("a.npz", archive(depth=b"hello"), "must be a whole NPZ; got "),
    "encrypted": ("a.npz", encrypted(NPZ), "must be a whole NPZ; got "),
    "few bytes": ("a.pfm", b"Pf 2 1 -1 1234", "must be a whole PFM; got 4 bytes of 2 x 1 x 1 float32 pixels"),
    "seen through": ("a.png", bytes(imagecodecs.png_encode(np.full((2, 2, 2), 9, np.uint8))),
                     "alpha must be opaque everywhere; got 4 other pixels"),
    "pages": ("a.tif", stored(tifffile.imwrite, np.zeros((2, 8, 9), "f4")), "must be a single image; got 2 pages"),
}
# fmt: on


@pytest.mark.parametrize(("name", "content", "message"), REFUSED.values(), ids=REFUSED)
def test_refuses_in_one_line_soon_and_small(tmp_path: Path, name: str, content: bytes, message: str) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    tracemalloc.start()
    start = time.perf_counter()
    assert refusal(path).startswith(message)
    seconds, peak = time.perf_counter() - start, tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert seconds < 1  # the figure to reach for hostile images
    assert peak < 2**24  # the first import of a codec takes some 10 MB, the smallest map over the limit 128 MB


@pytest.mark.parametrize(("suffix", "content"), [("npz", NPZ), ("npy", NPY)])
def test_refuses_every_truncation(tmp_path: Path, suffix: str, content: bytes) -> None:
    path = tmp_path / f"depth.{suffix}"
    for length in range(0, len(content), 3):
        path.write_bytes(content[:length])
        refusal(path)


def test_every_flipped_byte_is_noticed_or_changes_no_number(tmp_path: Path) -> None:
    path = tmp_path / "depth.npz"
    for at in range(len(NPZ)):
        path.write_bytes(NPZ[:at] + bytes([NPZ[at] ^ 0x55]) + NPZ[at + 1 :])
        try:
            np.testing.assert_array_equal(read_depth(path), SMALL)
        except ImageError:
            continue


def test_sizes_must_be_the_same() -> None:
    check_sizes("a.png", (640, 480), "b.exr", (640, 480))
    with pytest.raises(ImageError) as caught:
        check_sizes("a.png", (640, 480), "b.exr", (480, 640))
    assert str(caught.value) == "b.exr: the size must be that of a.png, 640 x 480 pixels; got 480 x 640"


def w_of(raw: list[float], unit: str, **options: Any) -> Array:
    given: dict[str, Any] = {"scale": 1.0, "camera": CAMERA, "baseline": BASELINE if unit == "disparity" else None}
    return inverse_depth(np.array([raw]), unit, **(given | options)).inverse_depth[0]


@pytest.mark.parametrize(("unit", "value", "meters"), [
    ("mm", 320.0, Fraction(32, 100)),
    ("m", 0.75, Fraction(3, 4)),
    ("inverse_mm", 2.0**-8, Fraction(256, 1000)),
    ("inverse_m", 4.0, Fraction(1, 4)),
    # Z = B s0 / (p d) = 60 mm * 20 mm / (0.01 mm * 480)
    ("disparity", 480.0, Fraction(1, 4)),
])  # fmt: skip
def test_units_against_exact_fractions(unit: str, value: float, meters: Fraction) -> None:
    wanted = float(1 / (1000 * meters))
    # Three roundings at most, of the product with the scale, of a factor and of the division: 2^-53 each.
    np.testing.assert_allclose(w_of([value], unit), [wanted], rtol=3 * 2.0**-53)
    np.testing.assert_allclose(w_of([value * 256], unit, scale=1 / 256), [wanted], rtol=3 * 2.0**-53)


def test_a_radius_is_taken_as_it_is() -> None:
    radii = [-30.0, 0.0, 12.5, 39.0]
    # K - w cancels: both are at most 0.007 per mm, each rounded twice to 2^-53 of that, and kappa makes px of it.
    bound = 4 * 2.0**-53 * 0.007 * blur_scale(CAMERA)
    assert blur_radius(CAMERA, w_of(radii, "coc")) == pytest.approx(radii, abs=bound)
    assert blur_radius(CAMERA, w_of(radii, "coc", scale=0.5)) == pytest.approx([-15, 0, 6.25, 19.5], abs=bound)


def test_infinity_as_a_radius_is_infinitely_far() -> None:
    at_infinity = np.float32(blur_radius(CAMERA, 0.0))  # as a file of floats has it, a little beyond or short of it
    beyond = float(np.nextafter(at_infinity, np.float32(np.inf)))
    values = inverse_depth(np.array([[beyond, 0.0]]), "coc", 1.0, CAMERA)
    assert values.inverse_depth[0, 0] == FARTHEST
    assert (values.far, values.invalid) == (1, 0)


KINDS = [0.0, -0.0, -1.0, -np.inf, np.nan, np.inf]
GOOD = {"mm": 250.0, "m": 0.25, "inverse_mm": 0.004, "inverse_m": 4.0, "disparity": 480.0, "coc": 3.0}


@pytest.mark.parametrize(("unit", "zero", "negative", "nan", "infinite", "far"), [
    ("mm", 2, 2, 1, 0, 1),
    ("m", 2, 2, 1, 0, 1),
    ("inverse_mm", 0, 2, 1, 1, 2),
    ("inverse_m", 0, 2, 1, 1, 2),
    ("disparity", 2, 2, 1, 1, 0),
    ("coc", 0, 0, 1, 2, 0),
])  # fmt: skip
def test_what_every_kind_of_number_means(
    unit: str, zero: int, negative: int, nan: int, infinite: int, far: int
) -> None:
    raw = np.array([[GOOD[unit], *KINDS]])
    baseline = BASELINE if unit == "disparity" else None
    values = inverse_depth(raw, unit, 1.0, CAMERA, baseline)
    assert (values.zero, values.negative, values.nan, values.infinite, values.far) == (
        zero, negative, nan, infinite, far,
    )  # fmt: skip
    w = values.inverse_depth[0]
    assert w[0] > FARTHEST
    assert (w == FARTHEST).sum() == far
    assert (w == 0).sum() == values.invalid == zero + negative + nan + infinite
    assert (w >= 0).all()
    assert np.isfinite(w).all()
    assert values.inverse_depth.shape == raw.shape


def test_report_tells_the_kinds_that_there_are() -> None:
    raw = np.array([[250.0, 0.0, 0.0, np.nan], [250.0, np.inf, -3.0, 1e10]])
    told = "4 of 8 pixels have no depth (2 zero, 1 negative, 1 NaN), 1 are infinitely far"
    assert inverse_depth(raw, "mm", 1.0, CAMERA).report() == told
    assert inverse_depth(np.full((2, 2), 250.0), "mm", 1.0, CAMERA).report() == ""
    assert inverse_depth(np.array([[250.0, np.inf]]), "mm", 1.0, CAMERA).report() == "1 are infinitely far"
    disparity = inverse_depth(np.array([[480.0, np.inf]]), "disparity", 1.0, CAMERA, BASELINE)
    assert disparity.report() == "1 of 2 pixels have no depth (1 infinite)"


def test_the_background_of_a_renderer_is_there() -> None:
    values = inverse_depth(np.array([[0.3, 1e10, 1e9, 65504.0]]), "m", 1.0, CAMERA)
    np.testing.assert_array_equal(values.inverse_depth[0, 1:3], FARTHEST)
    assert (values.invalid, values.far) == (0, 2)
    # 1e-12 per mm is 1e-8 px from infinity with kappa = 1e4 px mm.
    assert blur_radius(CAMERA, values.inverse_depth[0, 1]) == pytest.approx(float(blur_radius(CAMERA, 0.0)), abs=1e-7)


def test_files_of_kitti_and_middlebury_work_as_they_are(tmp_path: Path) -> None:
    meters = np.array([[0.5, 1.25], [80.0, 0.0]])
    (tmp_path / "kitti.png").write_bytes(imagecodecs.png_encode((256 * meters).astype(np.uint16)))
    values = inverse_depth(read_depth(tmp_path / "kitti.png"), "m", 1 / 256, CAMERA)
    np.testing.assert_allclose(values.inverse_depth, [[1 / 500, 1 / 1250], [1 / 80000, 0]], rtol=3 * 2.0**-53)
    assert values.zero == 1

    disparity = np.array([[240.0, np.inf], [120.5, 480.0]], np.float32)
    save_pfm(tmp_path / "disp0.pfm", disparity, "-0.003922")
    values = inverse_depth(read_depth(tmp_path / "disp0.pfm"), "disparity", 1.0, CAMERA, BASELINE)
    wanted = np.where(np.isinf(disparity), 0, 0.01 * disparity.astype(np.float64) / (BASELINE * 20.0))
    np.testing.assert_allclose(values.inverse_depth, wanted, rtol=4 * 2.0**-53)
    assert values.infinite == 1


@given(
    millimeters=st.floats(20.0, 1e9),
    unit=st.sampled_from(UNITS),
    scale=st.floats(1e-4, 1e4),
    focal_length=st.floats(10.0, 100.0),
    focus=st.floats(2.0, 1e4),
    baseline=st.floats(1.0, 1e3),
)
def test_every_unit_tells_the_same_depth(
    millimeters: float, unit: str, scale: float, focal_length: float, focus: float, baseline: float
) -> None:
    camera = Camera(
        focal_length=focal_length, focus_distance=focal_length * focus, aperture_diameter=0.1, pixel_pitch=0.01
    )
    wanted = 1 / millimeters
    value = {
        "mm": millimeters,
        "m": millimeters / 1000,
        "inverse_mm": wanted,
        "inverse_m": 1000 * wanted,
        "disparity": baseline * camera.normalization_distance / (camera.pixel_pitch * millimeters),
        "coc": float(blur_radius(camera, wanted)),
    }[unit]
    given_baseline = baseline if unit == "disparity" else None
    values = inverse_depth(np.array([[value / scale]]), unit, scale, camera, given_baseline)
    # Eight roundings of 2^-53 at most; of a radius, each is relative to the larger of K and w instead.
    size = max(wanted, abs(focus_power(camera)), 1 / focal_length) if unit == "coc" else wanted
    assert values.inverse_depth[0, 0] == pytest.approx(wanted, rel=0, abs=8 * 2.0**-53 * size)
    assert values.invalid == 0


def fault(raw: list[float], unit: str, **options: Any) -> str:
    with pytest.raises(ImageError) as caught:
        w_of(raw, unit, **options)
    return str(caught.value)


METERS = [0.2, 0.25, 5.0, 0.0]
LARGE = "depth: the blur radius must be at most 512 px; got "
AT_INFINITY = "px, which the camera has at infinity"


IN = "the depth is probably in {0}: give unit {0}".format
NO_UNIT = "no unit makes it less: scale, or the camera, is probably wrong"


@pytest.mark.parametrize(("raw", "unit", "got", "pixels", "cause"), [
    (METERS, "mm", "4.996e+04 px at 0.2 mm", "3 of 3", IN("m")),
    ([200.0, 5000.0], "inverse_m", "4.996e+04 px at 5000 inverse_m", "2 of 2", IN("mm")),
    ([200.0, 5000.0], "inverse_mm", "5e+07 px at 5000 inverse_mm", "2 of 2", IN("mm")),
    ([0.0, 300.0], "inverse_mm", "3e+06 px at 300 inverse_mm", "1 of 2", IN("mm")),
    ([0.003, 0.005], "mm", "3.333e+06 px at 0.003 mm", "2 of 2", IN("inverse_mm")),
    ([300.0, 5000.0], "coc", "5000 px at 5000 coc", "1 of 2", IN("mm")),
    ([-2000.0, 500.0], "coc", "2000 px at -2000 coc", "1 of 2", NO_UNIT),
    ([1.0, 1e6], "disparity", "8.329e+04 px at 1e+06 disparity", "1 of 2", IN("m")),
    ([250.0, 1e-9], "mm", "1e+13 px at 1e-09 mm", "1 of 2", NO_UNIT),
    ([250.0, 1e-320], "mm", "inf px at 1e-320 mm", "1 of 2", NO_UNIT),
])  # fmt: skip
def test_radii_of_thousands_of_pixels_name_the_likely_unit(
    raw: list[float], unit: str, got: str, pixels: str, cause: str
) -> None:
    assert fault(raw, unit) == f"{LARGE}{got}, and more than that limit in {pixels} pixels ({cause})"


def test_a_camera_of_thousands_of_pixels_is_named() -> None:
    message = fault([250.0, 1e5], "mm", camera=Camera(aperture_diameter=1000.0))
    assert message == (
        f"{LARGE}3990 px at 1e+05 mm, and more than that limit in 1 of 2 pixels (the camera has 4000 px at infinity: "
        "aperture_diameter or pixel_pitch is probably wrong)"
    )
    w_of([250.0, 260.0], "mm", camera=Camera(aperture_diameter=1000.0))  # as long as no surface is that far


def test_the_limit_is_the_one_of_the_renderer() -> None:
    nearest = 1 / (focus_power(CAMERA) + LARGEST_BLUR / blur_scale(CAMERA))
    w_of([nearest * (1 + 1e-9)], "mm")
    assert fault([nearest * (1 - 1e-9)], "mm").startswith(LARGE)


@pytest.mark.parametrize(("raw", "unit", "options", "message"), [
    ([0.0, np.nan, -2.0], "mm", {}, "depth: at least one pixel must have a depth; got 1 zero, 1 negative, 1 nan"),
    ([np.inf], "disparity", {}, "depth: at least one pixel must have a depth; got 1 infinite"),
    ([250.0], "cm", {}, "depth: unit must be one of mm, m, inverse_mm, inverse_m, disparity, coc; got 'cm'"),
    ([250.0], "mm", {"scale": 0.0}, "depth: scale must be finite and greater than 0; got 0"),
    ([250.0], "mm", {"scale": -1.0}, "depth: scale must be finite and greater than 0; got -1"),
    ([2.0], "coc", {"scale": np.nan}, "depth: scale must be finite and greater than 0; got nan"),
    ([250.0], "mm", {"baseline": 9.0}, "depth: baseline belongs to unit disparity, which needs it; got 9.0 and mm"),
    ([250.0], "disparity", {"baseline": None},
     "depth: baseline belongs to unit disparity, which needs it; got None and disparity"),
    ([250.0], "disparity", {"baseline": -5.0},
     "depth: baseline must be a finite number of mm greater than 0; got -5"),
    ([45.0, 60.0, 3.0], "coc", {},
     f"depth: radii must be at most 39.9972 {AT_INFINITY}, or its aperture_diameter at least 15.02 mm; got 60 px"),
    ([0.0], "coc", {"camera": Camera(sensor_distance=19.0)},
     f"depth: radii must be at most -26.3158 {AT_INFINITY}; got 0 px, and 1 pixels above the limit"),
    ([2e-7], "mm", {"camera": Camera(aperture_diameter=1e-6, pixel_pitch=1.0)},
     "depth: depth must be at least 1e-06 mm; got 2e-07 mm"),
    ([0.25], "mm", {"where": "room.exr"}, "room.exr: the blur radius must be at most 512 px"),
])  # fmt: skip
def test_every_other_refusal(raw: list[float], unit: str, options: dict[str, Any], message: str) -> None:
    assert fault(raw, unit, **options).startswith(message)


def test_the_aperture_that_is_suggested_will_do() -> None:
    w_of([45.0, 60.0, 3.0], "coc", camera=Camera(aperture_diameter=15.02))
