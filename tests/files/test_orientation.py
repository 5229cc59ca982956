"""Orientation tags: readers turn pixels upright, masks and depth maps are compared upright, writers keep no tag."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import imagecodecs
import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray
from PIL import Image, ImageOps

from clsco.errors import FileError
from clsco.files.images import image_size, read_image, write_png, write_tiff
from clsco.inputs.depth_files import read_depth
from tests.command import clsco_, done
from tests.files.test_images import chunk

Array = NDArray[Any]
UPRIGHT = np.arange(6 * 9, dtype=np.uint8).reshape(6, 9) * np.uint8(4)
PNG_XMP = b"XML:com.adobe.xmp\0\0\0\0\0"
# How each orientation stores an upright image, by EXIF 2.32, table 6.
STORED: dict[int, Callable[[Array], Array]] = {
    1: np.array,
    2: np.fliplr,
    3: lambda image: np.rot90(image, 2),
    4: np.flipud,
    5: lambda image: image.swapaxes(0, 1),
    6: np.rot90,
    7: lambda image: np.rot90(image, 2).swapaxes(0, 1),
    8: lambda image: np.rot90(image, 3),
}


def exif(orientation: int) -> bytes:
    tags = Image.Exif()
    tags[274] = orientation
    return tags.tobytes()


def xmp(orientation: int) -> bytes:
    return f'<x:xmpmeta><rdf:Description tiff:Orientation="{orientation}"/></x:xmpmeta>'.encode()


def png(data: Array, *extra: bytes, last: bool = False) -> bytes:
    """A PNG with chunks before its pixels, or after them."""
    plain = bytes(imagecodecs.png_encode(np.ascontiguousarray(data)))
    at = len(plain) - 12 if last else 33
    return plain[:at] + b"".join(extra) + plain[at:]


def exif_chunk(orientation: int) -> bytes:
    return chunk(b"eXIf", exif(orientation).removeprefix(b"Exif\0\0"))


def save_png(path: Path, data: Array, orientation: int) -> None:
    path.write_bytes(png(data, exif_chunk(orientation)))


def save_tiff(path: Path, data: Array, orientation: int) -> None:
    options: Any = {"photometric": "rgb" if data.ndim == 3 else "minisblack", "metadata": None}
    tifffile.imwrite(path, data, extratags=[(274, 3, 1, orientation, True)], **options)


def save_by_pillow(path: Path, data: Array, **options: Any) -> None:
    Image.fromarray(np.ascontiguousarray(data)).save(path, quality=100, subsampling=0, **options)


SAVERS: dict[str, Callable[[Path, Array, int], object]] = {
    "png": save_png,
    "late.png": lambda path, data, turn: path.write_bytes(png(data, exif_chunk(turn), last=True)),
    "xmp.png": lambda path, data, turn: path.write_bytes(png(data, chunk(b"iTXt", PNG_XMP + xmp(turn)))),
    "pillow.png": lambda path, data, turn: save_by_pillow(path, data, exif=exif(turn)),
    "tif": save_tiff,
    "jpg": lambda path, data, turn: save_by_pillow(path, data, exif=exif(turn)),
    "xmp.jpg": lambda path, data, turn: save_by_pillow(path, data, xmp=xmp(turn)),
}


@pytest.mark.parametrize("orientation", STORED)
@pytest.mark.parametrize("name", SAVERS)
def test_every_reader_turns_pixels_upright(tmp_path: Path, name: str, orientation: int) -> None:
    for data in (UPRIGHT, np.dstack([UPRIGHT, UPRIGHT + 3, 255 - UPRIGHT])):
        path = tmp_path / f"image.{name}"
        SAVERS[name](path, STORED[orientation](data), orientation)
        picture = read_image(path).data
        assert image_size(path) == (9, 6)
        if not name.endswith("jpg"):
            np.testing.assert_array_equal(picture, data, strict=True)
        else:  # which compresses
            expected = np.asarray(ImageOps.exif_transpose(Image.open(path)))
            np.testing.assert_array_equal(picture, expected, strict=True)
    assert picture.flags.c_contiguous


def test_16_bits_and_depths_are_turned_as_well(tmp_path: Path) -> None:
    deep = UPRIGHT.astype(np.uint16) * np.uint16(250) + np.uint16(7)
    for name, save in SAVERS.items():
        if name.endswith("jpg") or name == "pillow.png":
            continue
        save(tmp_path / f"a.{name}", STORED[6](deep), 6)
        np.testing.assert_array_equal(read_image(tmp_path / f"a.{name}").data, deep, strict=True)
        np.testing.assert_array_equal(read_depth(tmp_path / f"a.{name}"), deep)


@pytest.mark.parametrize("body", [
    b"", b"II*\0", b"garbage that is no EXIF", exif(9).removeprefix(b"Exif\0\0"), exif(0).removeprefix(b"Exif\0\0"),
    b"II*\0\x08\0\0\0\xff\xff" + b"\x12\x01\x03\0\1\0\0\0\6\0\0\0", b"MM\0*\xff\xff\xff\xff",
])  # fmt: skip
def test_a_damaged_tag_turns_nothing(tmp_path: Path, body: bytes) -> None:
    (tmp_path / "a.png").write_bytes(png(UPRIGHT, chunk(b"eXIf", body)))
    np.testing.assert_array_equal(read_image(tmp_path / "a.png").data, UPRIGHT)


def test_a_tag_of_a_wrong_length_is_no_tag(tmp_path: Path) -> None:
    whole = png(UPRIGHT, chunk(b"eXIf", exif(6)))
    at = whole.index(b"eXIf") - 4
    (tmp_path / "a.png").write_bytes(whole[:at] + struct.pack(">I", 2**31) + whole[at + 4 :])
    with pytest.raises(FileError, match=r"must be a whole PNG; got the end of the file"):
        read_image(tmp_path / "a.png")


def test_a_depth_map_as_the_sensor_had_it_is_found(tmp_path: Path) -> None:
    """The image is turned by its tag, and the depth map, which has none, is not."""
    save_png(tmp_path / "image.png", STORED[6](UPRIGHT), 6)
    depth = UPRIGHT.astype(np.uint16) + np.uint16(250)
    write_png(tmp_path / "depth.png", STORED[6](depth))
    image, map_ = tmp_path / "image.png", tmp_path / "depth.png"
    result = clsco_("defocus", image, map_, "-o", tmp_path / "out.png")
    hint = f"{image} is turned upright by its orientation tag, and {map_} has none: turn it likewise"
    rule = f"error: {map_}: the size must be that of {image}, 9 x 6 pixels; got 6 x 9 ({hint})\n"
    assert (result.exit_code, result.stderr) == (1, rule)
    mask = tmp_path / "mask.png"
    write_png(mask, np.where(STORED[6](UPRIGHT) == 24, 255, 0).astype(np.uint8))
    result = clsco_("inpaint", image, mask, "-o", tmp_path / "out.png")
    assert (result.exit_code, result.stderr) == (1, rule.replace(str(map_), str(mask)))
    write_png(map_, depth)  # upright, as sizes show
    result = clsco_("defocus", image, map_, "-o", tmp_path / "out.png")
    assert "upright" not in result.stderr
    assert image_size(tmp_path / "out.png") == (9, 6)
    save_png(map_, STORED[8](depth), 8)  # with a tag of its own
    result = clsco_("defocus", image, map_, "-o", tmp_path / "same.png")
    assert "upright" not in result.stderr
    assert (tmp_path / "same.png").read_bytes() == (tmp_path / "out.png").read_bytes()


@pytest.mark.parametrize(("orientation", "size", "tagged"), [(6, 6, "image"), (3, 9, "other")])
def test_what_sizes_do_not_show_is_said(tmp_path: Path, orientation: int, size: int, tagged: str) -> None:
    data = UPRIGHT[:, :size]
    image, depth, mask = (tmp_path / name for name in ("image.tif", "depth.tif", "mask.tif"))
    save_tiff(image, data, orientation if tagged == "image" else 1)
    for path, values in ((depth, data.astype(np.uint16) + np.uint16(250)), (mask, np.where(data == 24, 255, 0))):
        save_tiff(path, values.astype(np.uint8 if path == mask else np.uint16), 1 if tagged == "image" else orientation)
    for command, other in (("defocus", depth), ("inpaint", mask)):
        result = done(command, image, other, "-o", tmp_path / "out.tif")
        turned, plain = (image, other) if tagged == "image" else (other, image)
        line = f"{plain}: is taken to be upright, as {turned} is turned by its orientation tag\n"
        assert result.stderr.startswith(line)


def test_writers_keep_no_orientation(tmp_path: Path) -> None:
    save_png(tmp_path / "image.png", STORED[6](UPRIGHT), 6)
    write_png(tmp_path / "mask.png", np.where(UPRIGHT == 24, 255, 0).astype(np.uint8))
    for name in ("out.png", "out.tif"):
        assert clsco_("inpaint", tmp_path / "image.png", tmp_path / "mask.png", "-o", tmp_path / name).exit_code == 0
        np.testing.assert_array_equal(read_image(tmp_path / name).data[UPRIGHT != 24], UPRIGHT[UPRIGHT != 24])
        with Image.open(tmp_path / name) as written:
            assert written.getexif().get(274, 1) == 1
            assert written.size == (9, 6)
    write_tiff(tmp_path / "a.tif", UPRIGHT)
    with Image.open(tmp_path / "a.tif") as written:
        assert 274 not in written.getexif()
