"""Depth files: the numbers that they store, and one line where a file is none."""

from __future__ import annotations

import io
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import imagecodecs
import numpy as np
import OpenEXR
import pytest
import tifffile
from numpy.typing import NDArray

from clsco.errors import FileError
from clsco.files.images import check_sizes
from clsco.inputs.depth_files import read_depth
from clsco.inputs.depth_maps import inverse_depth
from clsco.scene.model import Camera, DepthMap
from tests.files.readers import dpt_bytes
from tests.hostile.pictures import encoded, exr, pfm, soon_and_small

Array = NDArray[Any]
CAMERA = Camera()  # kappa = 10,000 px mm, in focus at 250.017 mm, 39.997 px at infinity


def numbers(dtype: str, shape: tuple[int, ...] = (5, 7)) -> Array:
    """Numbers of which no two rows, columns or byte orders agree; floats have all kinds that a file can hold."""
    generator = np.random.default_rng(3)
    if np.dtype(dtype).kind == "f":
        data = (1000 * generator.standard_normal(shape)).astype(dtype)
        data.flat[:4] = np.nan, np.inf, -np.inf, 0
        return data
    limits = np.iinfo(dtype)
    native = limits.dtype.newbyteorder("=")
    data = generator.integers(limits.min, limits.max, shape, endpoint=True, dtype=native).astype(dtype)
    data.flat[:2] = limits.max, limits.min
    return data


def refusal(path: Path) -> str:
    """The message, a single line, after the path, with which a file is not read."""
    with pytest.raises(FileError) as caught:
        read_depth(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert "; got " in message
    assert message.isprintable()
    return message.removeprefix(f"{path}: ")


FORMATS: dict[str, tuple[str, str, Callable[[Path, Array], object]]] = {
    "PNG 8": ("png", "u1", lambda path, data: path.write_bytes(imagecodecs.png_encode(data))),
    "PNG 16": ("png", "u2", lambda path, data: path.write_bytes(imagecodecs.png_encode(data))),
    "TIFF u2": ("tiff", "u2", tifffile.imwrite),
    "TIFF i2": ("tif", "i2", tifffile.imwrite),
    "TIFF u4": ("tif", "u4", tifffile.imwrite),
    "TIFF f4": ("tif", "f4", tifffile.imwrite),
    "TIFF f4, big endian": ("tif", "f4", lambda path, data: tifffile.imwrite(path, data, byteorder=">")),
    "EXR f4": ("exr", "f4", lambda path, data: path.write_bytes(exr(Z=data))),
    "EXR u4": ("exr", "u4", lambda path, data: path.write_bytes(exr(Z=data))),
    "PFM": ("pfm", "f4", lambda path, data: path.write_bytes(pfm(data))),
    "PFM, big endian": ("pfm", "f4", lambda path, data: path.write_bytes(pfm(data, "1"))),
    "PFM, scaled as Middlebury's": ("pfm", "f4", lambda path, data: path.write_bytes(pfm(data, "-0.003922"))),
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
    native = np.float64 if data.dtype.kind == "f" else data.dtype.newbyteorder("=")
    np.testing.assert_array_equal(read, data.astype(native), strict=True)
    assert read.flags.c_contiguous


@pytest.mark.parametrize("kind", ["png u1", "png u2", "tif u2", "tif f4", "pfm f4", "npy f8", "npz f4"])
def test_three_equal_channels_are_one_depth(tmp_path: Path, kind: str) -> None:
    suffix, dtype = kind.split()
    savers: dict[str, Callable[[Path, Array], object]] = {
        "png": lambda path, data: path.write_bytes(imagecodecs.png_encode(data)),
        "tif": lambda path, data: tifffile.imwrite(path, data, photometric="rgb"),
        "pfm": lambda path, data: path.write_bytes(pfm(data)),
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
    rule = "must hold one depth per pixel: red, green and blue must be equal"
    assert refusal(path) == f"{rule}; got 1, 1, 2 at row 4, column 5 (1 in all)"


Z, OTHER, THIRD = (numbers("f4") + np.float32(n) for n in (0, 1, 2))

CHANNELS: dict[str, dict[str, Array]] = {
    "Blender, one layer": {"R": OTHER, "G": OTHER, "B": OTHER, "A": OTHER, "Z": Z},
    "Blender, several layers": {
        **dict.fromkeys(("Composite.Combined.R", "ViewLayer.Combined.R", "ViewLayer.Mist.Z"), OTHER),
        **{f"ViewLayer.Normal.{axis}": OTHER for axis in "XYZ"},
        "ViewLayer.Depth.Z": Z,
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
    (tmp_path / "depth.exr").write_bytes(exr(**channels))
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
    (tmp_path / "depth.exr").write_bytes(exr(**channels))
    message = refusal(tmp_path / "depth.exr")
    assert message.startswith("an EXR must hold one depth")
    assert message.endswith(f"; got {got}")


def save_parts(path: Path, *parts: dict[str, Array], **last: Any) -> None:
    headers: list[dict[str, Any]] = [{"type": OpenEXR.scanlineimage, "name": f"part{n}"} for n in range(len(parts))]
    headers[-1] |= last
    pages = [OpenEXR.Part(header, dict(part), header["name"]) for header, part in zip(headers, parts, strict=True)]
    OpenEXR.File(pages).write(str(path))


def test_reads_what_sintel_writes(tmp_path: Path) -> None:
    depth = np.array([[200.0, 350.0, np.inf], [500.0, 1e5, 20.0]], np.float32)
    (tmp_path / "depth.dpt").write_bytes(dpt_bytes(depth.astype(np.float64) / 1000))
    depths = read_depth(tmp_path / "depth.dpt")
    np.testing.assert_array_equal(depths, (depth.astype(np.float64) / 1000).astype(np.float32))
    w = inverse_depth(depths, DepthMap(depth="z.dpt", unit="m"), CAMERA).inverse_depth
    np.testing.assert_allclose(w[:, :2], 1 / depth[:, :2], rtol=2.0**-23)
    (tmp_path / "depth.dpt").write_bytes(dpt_bytes(depth)[:-1])
    rule = "must be a whole DPT; got 23 bytes after a header of 3 x 2 pixels"
    assert refusal(tmp_path / "depth.dpt").startswith(rule)
    (tmp_path / "depth.pfm").write_bytes(b"Pf " + 100 * b"a" + b" 3 -1\n")
    assert refusal(tmp_path / "depth.pfm") == f"must be a whole PFM; got a header of b'Pf {29 * 'a'}'"
    (tmp_path / "depth.pfm").write_bytes(b"Pf 1 1 -1\n\x01\x00\xa0\x7f")
    assert np.isnan(read_depth(tmp_path / "depth.pfm"))  # a signaling NaN


def test_an_exr_may_have_parts(tmp_path: Path) -> None:
    path = tmp_path / "depth.exr"
    save_parts(path, {"ViewLayer.Combined.R": OTHER}, {"ViewLayer.Depth.Z": Z})
    np.testing.assert_array_equal(read_depth(path), Z)
    save_parts(path, {"Z": OTHER}, {"Z": Z})
    rule = "an EXR must hold one depth, or equal ones, or its layer must be named"
    assert refusal(path) == f"{rule}; got channels part0.Z part1.Z that differ"
    np.testing.assert_array_equal(read_depth(path, "part1"), Z)
    save_parts(path, {"R": OTHER}, {"Z": Z[:3]}, dataWindow=((0, 0), (6, 2)), displayWindow=((0, 0), (6, 4)))
    cropped = Z.copy()
    cropped[3:] = np.nan  # what is not in the data window has no depth
    np.testing.assert_array_equal(read_depth(path), cropped)
    save_parts(path, {"R": np.tile(OTHER, (40, 40))}, {"Z": np.tile(Z, (40, 40))})
    content = path.read_bytes()
    path.write_bytes(content[: len(content) - 200])
    assert refusal(path).startswith("must be a whole EXR; got ")


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
NPY = encoded(np.save, SMALL)
BIG_NPY = NPY.replace(b"(5, 7), }        ", b"(13000, 13000), }")
LONG_NPY = NPY.replace(b"(5, 7), }    ", b"(1, 70000), }")
NPZ = archive(depth=NPY)
OBJECTS = encoded(np.save, np.array([[{}]]), allow_pickle=True)
MANY_CHANNELS = encoded(
    OpenEXR.File({"type": OpenEXR.scanlineimage}, {f"c{n}": np.zeros((4, 4), "f2") for n in range(5)}).write
).replace(struct.pack("<4i", 0, 0, 3, 3), struct.pack("<4i", 0, 0, 11999, 10999))
LIMIT = "columns and rows must be from 1 to 65536, and at most 134217728 pixels; got "
NONE_OF_THEM = "an NPZ must hold an array depth, or one array with two dimensions; got "
ONLY_NUMBERS = "array depth must hold numbers of shape (rows, columns); got "

# fmt: off
REFUSED: dict[str, tuple[str, bytes, str]] = {
    "no NPZ": ("a.npz", NPY, "the content must be NPZ, as the extension says; got NPY"),
    "big NPY": ("a.npy", BIG_NPY, f"{LIMIT}13000 x 13000"),
    "big NPZ": ("a.npz", archive(depth=BIG_NPY), f"{LIMIT}13000 x 13000"),
    "long NPZ": ("a.npz", archive(depth=LONG_NPY), f"{LIMIT}70000 x 1"),
    "no rows": ("a.npz", archive(depth=encoded(np.save, np.ones((0, 4)))), f"{LIMIT}4 x 0"),
    "many channels": ("a.exr", MANY_CHANNELS,
                      "an EXR must hold at most 536870912 values; got 5 channels of 12000 x 11000"),
    "objects": ("a.npz", archive(depth=OBJECTS), f"{ONLY_NUMBERS}object of shape (1, 1)"),
    "complex": ("a.npz", archive(depth=encoded(np.save, np.ones((2, 2), "c8"))), f"{ONLY_NUMBERS}complex64 of shape"),
    "complex TIFF": ("a.tif", encoded(tifffile.imwrite, np.ones((2, 2), "c8")),
                     "values must be integers or floats; got complex64"),
    "volume": ("a.npz", archive(depth=encoded(np.save, np.ones((2, 2, 2)))),
               f"{ONLY_NUMBERS}float64 of shape (2, 2, 2)"),
    "one number": ("a.npz", archive(depth=encoded(np.save, 1.0)), f"{ONLY_NUMBERS}float64 of shape ()"),
    "two arrays": ("a.npz", archive(z=NPY, d=NPY), f"{NONE_OF_THEM}arrays d z"),
    "no array": ("a.npz", archive(points=encoded(np.save, np.ones((2, 2, 3)))), f"{NONE_OF_THEM}none"),
    "many arrays": ("a.npz", archive(**{f"a{n}": b"" for n in range(257)}),
                    "an NPZ must hold an array depth, or at most 256 arrays; got more"),
    "short array": ("a.npz", archive(depth=NPY[:-4]), "must be a whole NPZ; got "),
    "long array": ("a.npz", archive(depth=NPY + b"1234"), "must be a whole NPZ; got bytes after the array"),
    "no header": ("a.npz", archive(depth=b"hello"), "must be a whole NPZ; got "),
    "encrypted": ("a.npz", encrypted(NPZ), "must be a whole NPZ; got "),
}
# fmt: on


@pytest.mark.parametrize(("name", "content", "message"), REFUSED.values(), ids=REFUSED)
def test_refuses_in_one_line_soon_and_small(tmp_path: Path, name: str, content: bytes, message: str) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    assert soon_and_small(refusal, path).startswith(message)


def test_refuses_every_truncation(tmp_path: Path) -> None:
    path = tmp_path / "depth.npz"
    for length in range(0, len(NPZ), 3):
        path.write_bytes(NPZ[:length])
        refusal(path)


def test_every_flipped_byte_is_found_or_changes_no_number(tmp_path: Path) -> None:
    path = tmp_path / "depth.npz"
    for at in range(len(NPZ)):
        path.write_bytes(NPZ[:at] + bytes([NPZ[at] ^ 0x55]) + NPZ[at + 1 :])
        try:
            np.testing.assert_array_equal(read_depth(path), SMALL)
        except FileError:
            continue


def test_sizes_must_be_the_same() -> None:
    check_sizes("a.png", (640, 480), "b.exr", (640, 480))
    with pytest.raises(FileError) as caught:
        check_sizes("a.png", (640, 480), "b.exr", (480, 640))
    rule = "the size must be that of a.png, 640 x 480 pixels"
    assert str(caught.value) == f"b.exr: {rule}; got 480 x 640 (one of them lies on its side)"
