"""Reading images: exactly what the file stores, or a refusal in one line."""

from __future__ import annotations

import errno
import os
import struct
import sys
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import imagecodecs
import imageio.v3 as iio
import numpy as np
import OpenEXR
import pytest
import tifffile
from numpy.typing import NDArray
from PIL import Image

from clsco.errors import FileError, MissingDependencyError
from clsco.files.images import image_size, read_image, write_exr, write_png
from clsco.inputs.depth_files import read_depth
from tests.hostile.pictures import encoded, exr, pfm, soon_and_small, tiff

Array = NDArray[Any]
SHAPES = {"grey": (13, 7), "rgb": (13, 7, 3), "row": (1, 9), "pixel": (1, 1, 3)}


def pixels(dtype: str, shape: tuple[int, ...]) -> Array:
    """Give random values over the whole range of a type, its limits among them; floats up to 100."""
    generator = np.random.default_rng(7)
    if np.dtype(dtype).kind == "f":
        return (100 * generator.random(shape)).astype(dtype)
    data = generator.integers(0, np.iinfo(dtype).max, shape, endpoint=True).astype(dtype)
    data.flat[0] = np.iinfo(dtype).max
    return data


def save_exr(path: Path, **channels: Array) -> None:
    pixels = {name: np.ascontiguousarray(channel) for name, channel in channels.items()}
    OpenEXR.File({"type": OpenEXR.scanlineimage}, pixels).write(str(path))


def save_tiff(path: Path, data: Array, **options: Any) -> None:
    tifffile.imwrite(path, data, photometric="rgb" if data.ndim == 3 else "minisblack", **options)


def save_rgb_exr(path: Path, data: Array) -> None:
    save_exr(path, **({"Y": data} if data.ndim == 2 else {name: data[..., n] for n, name in enumerate("RGB")}))


def png(columns: int, rows: int, depth: int, color: int, raw: bytes, *extra: bytes, laced: int = 0) -> bytes:
    """Put a PNG together chunk by chunk; `raw` are its rows with their filter bytes, `extra` whole chunks."""
    header = chunk(b"IHDR", struct.pack(">IIBBBBB", columns, rows, depth, color, 0, 0, laced))
    body = [header, *extra, chunk(b"IDAT", zlib.compress(raw)), chunk(b"IEND", b"")]
    return b"\x89PNG\r\n\x1a\n" + b"".join(body)


def chunk(kind: bytes, body: bytes) -> bytes:
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))


def refusal(path: Path) -> str:
    """Read what must not be read, and give the message, a single line, after its path."""
    with pytest.raises((FileError, MissingDependencyError)) as caught:
        read_image(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert "; got " in message
    assert "\n" not in message
    return message.removeprefix(f"{path}: ")


ROUND_TRIPS: list[tuple[str, str, Callable[[Path, Array], object]]] = [
    *[("png", dtype, write_png) for dtype in ("u1", "u2")],
    ("png", "u1", lambda path, data: iio.imwrite(path, data)),
    *[(kind, "u2", lambda path, data: path.write_bytes(imagecodecs.png_encode(data))) for kind in ("png", "PNG")],
    *[("tif", dtype, save_tiff) for dtype in ("u1", "f2", "f4", "f8")],
    ("tiff", "u2", save_tiff),
    ("tif", ">u2", lambda path, data: save_tiff(path, data, byteorder=">")),
    ("tif", "u2", lambda path, data: save_tiff(path, data, compression="zlib", predictor=True)),
    *[("exr", dtype, save_rgb_exr) for dtype in ("f2", "f4")],
    ("pfm", "f4", lambda path, data: path.write_bytes(pfm(data))),
    ("pfm", "f4", lambda path, data: path.write_bytes(pfm(data, "1.0"))),
    *[("npy", dtype, np.save) for dtype in ("u1", "u2", ">u2", "f2", "f4", "f8")],
    ("npy", "f4", lambda path, data: np.save(path, np.asfortranarray(data))),
]


@pytest.mark.parametrize("shape", SHAPES.values(), ids=SHAPES)
@pytest.mark.parametrize(("suffix", "dtype", "save"), ROUND_TRIPS)
def test_reads_what_was_stored(
    tmp_path: Path, suffix: str, dtype: str, save: Callable[[Path, Array], object], shape: tuple[int, ...]
) -> None:
    data = pixels(dtype, shape)
    path = tmp_path / f"image.{suffix}"
    save(path, data)
    picture = read_image(path)
    expected = data.astype(np.float32) if data.dtype.kind == "f" else data.astype(data.dtype.newbyteorder("="))
    np.testing.assert_array_equal(picture.data, expected, strict=True)
    assert picture.bits == 8 * expected.dtype.itemsize
    assert picture.is_float == (data.dtype.kind == "f")
    assert image_size(path) == (shape[1], shape[0])


@pytest.mark.parametrize("bits", [1, 2, 4])
def test_few_bits_and_palettes_become_8_bits(tmp_path: Path, bits: int) -> None:
    codes = np.arange(8) % 2**bits
    packed = np.packbits((codes[:, None] >> np.arange(bits)[::-1]) & 1).tobytes()
    path = tmp_path / "image.png"
    path.write_bytes(png(8, 1, bits, 0, b"\0" + packed))
    np.testing.assert_array_equal(read_image(path).data, (codes[None] * (255 // (2**bits - 1))).astype(np.uint8))

    colors = pixels("u1", (2**bits, 3))
    table, opaque = chunk(b"PLTE", colors.tobytes()), chunk(b"tRNS", b"\xff\xff")
    path.write_bytes(png(8, 1, bits, 3, b"\0" + packed, table, opaque))
    np.testing.assert_array_equal(read_image(path).data, colors[codes][None])
    path.write_bytes(png(8, 1, bits, 3, b"\0" + packed, table, chunk(b"tRNS", b"\xff\xfe")))
    assert refusal(path).startswith(f"pixels must be opaque; got {(codes == 1).sum()} of a transparent color")
    if bits > 1:  # entries that no pixel has may be transparent
        path.write_bytes(png(4, 1, bits, 3, b"\0" + bytes(2), table, chunk(b"tRNS", b"\xff\xfe")))
        np.testing.assert_array_equal(read_image(path).data, np.repeat(colors[:1][None], 4, axis=1))


@pytest.mark.parametrize("depth", [1, 2, 4, 8, 16])
def test_a_transparent_gray_that_no_pixel_has_is_none(tmp_path: Path, depth: int) -> None:
    for key, count in ((1, 0), (0, 16)):
        rows, transparent = bytes(1 + 2 * depth), chunk(b"tRNS", struct.pack(">H", key))
        check_keyed(tmp_path / "a.png", png(16, 1, depth, 0, rows, transparent), count, np.zeros((1, 16)))


def check_keyed(path: Path, content: bytes, count: int, data: Array) -> None:
    """Check that a PNG with so many pixels of a transparent color is refused, or gives these data without any."""
    path.write_bytes(content)
    if count:
        assert refusal(path) == f"pixels must be opaque; got {count} of a transparent color (chunk tRNS)"
    else:
        np.testing.assert_array_equal(read_image(path).data, data)


@pytest.mark.parametrize("dtype", ["u1", "u2"])
def test_a_transparent_color_that_no_pixel_has_is_none(tmp_path: Path, dtype: str) -> None:
    data, bits = pixels(dtype, (4, 5, 3)), 8 * np.dtype(dtype).itemsize
    rows = b"".join(b"\0" + row.astype(f">{dtype}").tobytes() for row in data)
    other = (data[0, 0] ^ np.array([0, 0, 1], dtype)).tolist()
    for key, count in ((other, 0), (data[0, 0].tolist(), 1)):
        transparent = chunk(b"tRNS", struct.pack(">HHH", *key))
        check_keyed(tmp_path / "a.png", png(5, 4, bits, 2, rows, transparent), count, data)
    (tmp_path / "a.png").write_bytes(png(5, 4, bits, 2, rows, chunk(b"tRNS", b"\0")))
    assert refusal(tmp_path / "a.png").startswith("must be a whole PNG; got ")


@pytest.mark.parametrize(("shape", "expected"), [
    ((1, 6, 7), (6, 7)), ((6, 7, 1), (6, 7)), ((1, 1, 6, 7), (6, 7)), ((1, 6, 7, 1), (6, 7)), ((1, 6, 7, 3), (6, 7, 3)),
    ((1, 7, 3), (1, 7, 3)), ((1, 1, 3), (1, 1, 3)), ((1, 1), (1, 1)), ((1, 1, 1, 1), (1, 1)), ((1, 7), (1, 7)),
])  # fmt: skip
@pytest.mark.parametrize("suffix", ["npy", "npz"])
def test_axes_of_length_1_around_an_image_are_dropped(
    tmp_path: Path, shape: tuple[int, ...], expected: tuple[int, ...], suffix: str
) -> None:
    data = pixels("f4", shape)
    if suffix == "npz":
        np.savez(tmp_path / "a.npz", other=np.zeros(3), depth=data[..., :1] if expected[-1] == 3 else data)
        if expected[-1] != 3:
            np.testing.assert_array_equal(read_depth(tmp_path / "a.npz"), data.reshape(expected))
        return
    np.save(tmp_path / "a.npy", data)
    np.testing.assert_array_equal(read_image(tmp_path / "a.npy").data, data.reshape(expected), strict=True)
    assert image_size(tmp_path / "a.npy") == (expected[1], expected[0])


def test_bools_are_black_and_white(tmp_path: Path) -> None:
    mask = pixels("u1", (5, 6)) > 100
    np.save(tmp_path / "mask.npy", mask)
    np.testing.assert_array_equal(read_image(tmp_path / "mask.npy").data, np.where(mask, 255, 0).astype(np.uint8))
    with pytest.raises(FileError, match=r"values must be integers or floats; got bool$"):
        read_depth(tmp_path / "mask.npy")


def test_interlaced_png(tmp_path: Path) -> None:
    data = pixels("u1", (11, 13))
    steps = ((0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4), (0, 2, 2, 4), (1, 0, 2, 2), (0, 1, 1, 2))
    passes = [data[y::dy, x::dx] for x, y, dx, dy in steps]
    rows = b"".join(b"\0" + row.tobytes() for part in passes for row in part)
    (tmp_path / "image.png").write_bytes(png(13, 11, 8, 0, rows, laced=1))
    np.testing.assert_array_equal(read_image(tmp_path / "image.png").data, data)
    (tmp_path / "image.png").write_bytes(png(13, 11, 8, 0, rows[:-1], laced=1))
    assert "fewer pixels" in refusal(tmp_path / "image.png")


@pytest.mark.parametrize("channels", [2, 4])
@pytest.mark.parametrize("kind", ["png u1", "png u2", "tif u2", "tif f4", "exr f4"])
def test_only_opaque_alpha_is_dropped(tmp_path: Path, kind: str, channels: int) -> None:
    suffix, dtype = kind.split()
    data = pixels(dtype, (5, 6, channels))
    data[..., -1] = 1 if dtype == "f4" else np.iinfo(dtype).max
    path = tmp_path / f"image.{suffix}"

    def save() -> None:
        if suffix == "png":
            path.write_bytes(imagecodecs.png_encode(data))
        elif suffix == "tif":
            photometric = "rgb" if channels == 4 else "minisblack"
            tifffile.imwrite(path, data, photometric=photometric, planarconfig="contig", extrasamples=["unassalpha"])
        else:
            names = "RGBA" if channels == 4 else "YA"
            save_exr(path, **{name: data[..., n] for n, name in enumerate(names)})

    save()
    np.testing.assert_array_equal(read_image(path).data, data[..., 0] if channels == 2 else data[..., :3])
    data[2, 3, -1] = 0
    save()
    assert refusal(path) == "alpha must be opaque everywhere, except for clsco defocus --layer; got 1 other pixels"


def test_jpeg_markers_may_be_padded(tmp_path: Path) -> None:
    (tmp_path / "image.jpg").write_bytes(JPEG[:2] + b"\xff\xff\xff" + JPEG[2:])
    assert image_size(tmp_path / "image.jpg") == (30, 40)
    assert read_image(tmp_path / "image.jpg").data.shape == (40, 30)


GRAY = pixels("u1", (40, 30))
PNG = bytes(imagecodecs.png_encode(GRAY))


CHANNEL = pixels("f4", (4, 5))
JPEG = encoded(Image.fromarray(GRAY).save, "JPEG")
TIFF = tiff(GRAY)
BIG_TIFF = TIFF.replace(struct.pack("<HHII", 256, 4, 1, 30), struct.pack("<HHII", 256, 4, 1, 70000))
EXR = exr(Y=pixels("f4", (40, 30)))
BIG_EXR = EXR.replace(struct.pack("<4i", 0, 0, 29, 39), struct.pack("<4i", 0, 0, 12999, 12999))
CROPPED_EXR = EXR.replace(struct.pack("<4i", 0, 0, 29, 39), struct.pack("<4i", 3, 3, 32, 42), 1)
NPY = encoded(np.save, GRAY)
BIG_NPY = NPY.replace(b"(40, 30), }       ", b"(40000000, 30), } ")
OBJECTS = encoded(np.save, np.array([[{}]]), allow_pickle=True)
WHOLE = "must be a whole PNG; got "
LIMIT = "columns and rows must be from 1 to 65536, and at most 134217728 pixels; got "

VALUES = "values must be finite, and at most 1e+36 in size; got "
DTYPES = "values must be uint8, uint16, float16, float32 or float64; got "
NUMBERS = "an NPY must hold numbers of shape (rows, columns) or (rows, columns, 3); got "
CONTENT = "the content must be PNG, as the extension says; got "
ROWS = bytes(20)  # of 4 x 4 pixels of 8 bits

# fmt: off
REFUSED: dict[str, tuple[str, bytes, str]] = {
    "empty": ("a.png", b"", f"{CONTENT}an empty file"),
    "text": ("a.png", b"hello world", f"{CONTENT}the first bytes b'hello wo'"),
    "other format": ("a.png", JPEG, f"{CONTENT}JPEG"),
    "other extension": ("a.bmp", b"BM", "the extension must be one of .png "),
    "no extension": ("a", PNG, "the extension must be one of .png "),
    "bomb": ("a.png", png(13000, 13000, 8, 0, bytes(13001)), f"{LIMIT}13000 x 13000"),
    "big header": ("a.png", png(2**31 - 1, 2**31 - 1, 8, 0, b""), f"{LIMIT}2147483647 x 2147483647"),
    "no columns": ("a.png", png(0, 5, 8, 0, b""), f"{LIMIT}0 x 5"),
    "long row": ("a.png", png(65537, 1, 8, 0, bytes(65538)), f"{LIMIT}65537 x 1"),
    "big JPEG": ("a.jpg", JPEG.replace(struct.pack(">HH", 40, 30), b"\xff" * 4), f"{LIMIT}65535 x 65535"),
    "big TIFF": ("a.tif", BIG_TIFF, f"{LIMIT}70000 x 40"),
    "big EXR": ("a.exr", BIG_EXR, f"{LIMIT}13000 x 13000"),
    "big PFM": ("a.pfm", b"Pf\n13000 13000\n-1\n", f"{LIMIT}13000 x 13000"),
    "negative PFM": ("a.pfm", b"Pf\n-3 -3\n-1\n", f"{LIMIT}-3 x -3"),
    "big NPY": ("a.npy", BIG_NPY, f"{LIMIT}30 x 40000000"),
    "checksum": ("a.png", PNG[:60] + bytes([PNG[60] ^ 1]) + PNG[61:], f"{WHOLE}a wrong checksum"),
    "few rows": ("a.png", png(8, 8, 8, 0, bytes(9 * 5)), f"{WHOLE}fewer pixels than the header says"),
    "bad filter": ("a.png", png(4, 4, 8, 0, b"\7aaaa" * 4), WHOLE),
    "bad color": ("a.png", png(4, 4, 8, 5, ROWS), f"{WHOLE}color type 5"),
    "animation": ("a.png", png(4, 4, 8, 0, ROWS, chunk(b"acTL", bytes(8))), f"{WHOLE}an animation"),
    "keyed": ("a.png", png(4, 4, 8, 0, ROWS, chunk(b"tRNS", b"\0\0")), "pixels must be opaque; got "),
    "CMYK": ("a.jpg", encoded(Image.new("CMYK", (9, 9)).save, "JPEG"), "a JPEG must be gray or RGB; got "),
    "no frame": ("a.jpg", b"\xff\xd8\xff\xd9" + ROWS, "must be a whole JPEG; got no frame header"),
    "pages": ("a.tif", tiff(np.zeros((3, 8, 9), "u1"), photometric="minisblack"), "must be a single image; got 3 p"),
    "white is 0": ("a.tif", tiff(GRAY, photometric="miniswhite"), "a TIFF must be gray (0 is black) or RGB"),
    "signed": ("a.tif", tiff(GRAY.astype("i2")), f"{DTYPES}int16"),
    "32-bit": ("a.npy", encoded(np.save, GRAY.astype("u4")), f"{DTYPES}uint32"),
    "objects": ("a.npy", OBJECTS, f"{NUMBERS}object"),
    "volume": ("a.npy", encoded(np.save, np.zeros((4, 5, 4))), f"{NUMBERS}float64 of shape (4, 5, 4)"),
    "depth only": ("a.exr", exr(Z=CHANNEL), "an EXR must hold the channels R G B or Y; got Z"),
    "cropped": ("a.exr", CROPPED_EXR, "must be a whole EXR; got 0 readable parts of 1"),
    "integers": ("a.exr", exr(Y=CHANNEL.astype("u4")), "EXR pixels must be floats; got uint32"),
    "nan": ("a.npy", encoded(np.save, [[0, np.nan], [np.nan, 1]]), f"{VALUES}nan at row 0, column 1 (2 "),
    "infinite": ("a.exr", exr(Y=CHANNEL + np.float32(np.inf)), f"{VALUES}inf at row 0, column 0 (20 in all)"),
    "overflow": ("a.npy", encoded(np.save, [[1e39]]), f"{VALUES}inf at row 0, column 0 (1 in all)"),
    "minus infinite": ("a.pfm", b"Pf 2 1 -1 " + struct.pack("<ff", 1, -np.inf), f"{VALUES}-inf at row 0, column 1"),
    "many bytes": ("a.pfm", b"Pf 1 1 -1 12345678", "must be a whole PFM; got 8 bytes of 1 x 1 x 1"),
}
# fmt: on


@pytest.mark.parametrize(("name", "content", "message"), REFUSED.values(), ids=REFUSED)
def test_refuses_in_one_line_soon_and_small(tmp_path: Path, name: str, content: bytes, message: str) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    assert soon_and_small(refusal, path).startswith(message)
    if message.startswith(LIMIT):
        with pytest.raises(FileError, match="columns and rows must"):
            image_size(path)


@pytest.mark.parametrize(("suffix", "content"), [
    ("png", PNG), ("jpg", JPEG), ("tif", TIFF), ("exr", EXR), ("npy", NPY),
    ("pfm", b"PF 2 2 -1 " + bytes(48)),
])  # fmt: skip
def test_refuses_every_truncation(tmp_path: Path, suffix: str, content: bytes) -> None:
    path = tmp_path / f"image.{suffix}"
    path.write_bytes(content)
    read_image(path)
    needed = len(content) - (2 if suffix == "jpg" else 0)  # decoders need no end marker after the last block
    lengths = {*range(0, min(needed, 200), 7), *range(200, needed, 97), needed - 1}
    for length in sorted(lengths):
        path.write_bytes(content[:length])
        refusal(path)


def test_refuses_what_is_no_file(tmp_path: Path) -> None:
    assert refusal(tmp_path / "none.png") == "must be a file that can be read; got No such file or directory"
    assert refusal(tmp_path) == "must be an image file; got a folder"
    os.mkfifo(tmp_path / "pipe.png")
    assert refusal(tmp_path / "pipe.png") == "must be an image file; got a device or a pipe"
    (tmp_path / "loop.png").symlink_to("loop.png")
    assert refusal(tmp_path / "loop.png") == "must be a file that can be read; got Too many levels of symbolic links"
    for name in ("a\0b.png", "a\nb.png", "\udcff.png", "x" * 300 + ".png"):
        with pytest.raises((FileError, MissingDependencyError)) as caught:
            read_image(tmp_path / name)
        assert str(caught.value).isprintable()


def test_refuses_without_permission(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_png(tmp_path / "image.png", GRAY)

    def denied(*_arguments: object, **_options: object) -> None:  # root may open everything
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr("builtins.open", denied)
    assert refusal(tmp_path / "image.png") == "must be a file that can be read; got Permission denied"


@pytest.mark.parametrize(("module", "extra", "save"), [
    ("imagecodecs", "formats", lambda path: write_png(path.with_suffix(".png"), pixels("u2", (4, 5, 3)))),
    ("tifffile", "formats", lambda path: save_tiff(path.with_suffix(".tif"), GRAY)),
    ("OpenEXR", "exr", lambda path: save_rgb_exr(path.with_suffix(".exr"), CHANNEL)),
])  # fmt: skip
def test_names_the_extra_that_is_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, module: str, extra: str, save: Callable[[Path], None]
) -> None:
    save(tmp_path / "image")
    monkeypatch.setitem(sys.modules, module, None)
    message = refusal(next(tmp_path.iterdir()))
    assert message.startswith(f"needs {module}: pip install 'clsco[{extra}]'; got ")
    if module == "OpenEXR":
        with pytest.raises(MissingDependencyError, match=r"needs OpenEXR: pip install 'clsco\[exr\]'"):
            write_exr(tmp_path / "new.exr", {"Y": CHANNEL})


def test_core_formats_need_no_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for module in ("imagecodecs", "tifffile", "OpenEXR"):
        monkeypatch.setitem(sys.modules, module, None)
    write_png(tmp_path / "rgb.png", pixels("u1", (4, 5, 3)))
    write_png(tmp_path / "grey.png", pixels("u2", (4, 5)))
    assert read_image(tmp_path / "rgb.png").bits == 8
    assert read_image(tmp_path / "grey.png").bits == 16
