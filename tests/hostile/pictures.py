"""Small valid images of every format that is read, and their damaged copies, by a seed and a number."""

from __future__ import annotations

import io
import random
import struct
import time
import tracemalloc
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import imagecodecs
import numpy as np
import OpenEXR
import tifffile
from numpy.typing import NDArray
from PIL import Image

from tests.files.readers import dpt_bytes

Array = NDArray[Any]
Change = Callable[[random.Random, bytes], bytes]


def encoded(save: Callable[..., object], *arguments: Any, **options: Any) -> bytes:
    """Bytes that `save` writes into a file that it is given first or last."""
    stream = io.BytesIO()
    save(stream, *arguments, **options)
    return stream.getvalue()


def exr(compression: int = OpenEXR.ZIP_COMPRESSION, /, **channels: Array) -> bytes:
    """An EXR of these channels."""
    header = {"type": OpenEXR.scanlineimage, "compression": compression}
    return encoded(OpenEXR.File(header, channels).write)


def tiff(data: Array, **options: Any) -> bytes:
    """A TIFF of gray or RGB."""
    kind = "rgb" if data.ndim == 3 else "minisblack"
    return encoded(tifffile.imwrite, data, **{"photometric": kind, "metadata": None, **options})


def pfm(data: Array, scale: str = "-1.0") -> bytes:
    """A PFM of gray or RGB; scale: below 0 for little endian."""
    head = f"{'PF' if data.ndim == 3 else 'Pf'}\n{data.shape[1]} {data.shape[0]}\n{scale}\n"
    return head.encode() + data[::-1].astype("<f4" if scale.startswith("-") else ">f4").tobytes()


def soon_and_small(call: Callable[[Path], str], path: Path) -> str:
    """Result of a call, in no more time and memory than a file of strangers may take."""
    tracemalloc.start()
    start = time.perf_counter()
    found = call(path)
    seconds, peak = time.perf_counter() - start, tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert seconds < 1  # the figure to reach for hostile images
    assert peak < 2**24  # the first import of a codec takes some 10 MB, the smallest image over the limit 128 MB
    return found


@cache
def samples() -> dict[str, tuple[str, bytes]]:
    """Name -> suffix and content: valid images of 12 x 9 pixels."""
    rng = np.random.default_rng(1)
    gray, color = rng.integers(0, 256, (9, 12), "u1"), rng.integers(0, 256, (9, 12, 3), "u1")
    wide, light = rng.integers(0, 65536, (9, 12, 3), "u2"), rng.random((9, 12, 3), np.float32)
    planes = {name: np.ascontiguousarray(light[..., k]) for k, name in enumerate("RGB")}
    turned = Image.Exif()
    turned[274] = 6
    adobe = bytes(imagecodecs.cms_profile("adobergb"))
    tagged = {"exif": turned, "icc_profile": adobe}
    layers = {f"ViewLayer.Combined.{name}": plane for name, plane in planes.items()}
    layers["ViewLayer.Depth.Z"] = planes["R"]
    found = {
        "gray png": (".png", bytes(imagecodecs.png_encode(gray))),
        "color png": (".png", encoded(Image.fromarray(color).save, "PNG")),
        "16-bit png": (".png", bytes(imagecodecs.png_encode(wide))),
        "palette png": (".png", encoded(Image.fromarray(color).quantize(7).save, "PNG")),
        "jpeg": (".jpg", encoded(Image.fromarray(color).save, "JPEG")),
        "progressive jpeg": (".jpg", encoded(Image.fromarray(color).save, "JPEG", progressive=True)),
        "tiff": (".tif", tiff(gray)),
        "zlib tiff": (".tif", tiff(wide, compression="zlib", predictor=True)),
        "lzw tiff": (".tif", tiff(wide, compression="lzw")),
        "float tiff": (".tif", tiff(light, compression="zstd")),
        "tiled tiff": (".tif", tiff(color, tile=(16, 16), compression="packbits")),
        "zip exr": (".exr", exr(OpenEXR.ZIP_COMPRESSION, **planes)),
        "rle exr": (".exr", exr(OpenEXR.RLE_COMPRESSION, **planes)),
        "piz exr": (".exr", exr(OpenEXR.PIZ_COMPRESSION, **planes)),
        "pxr24 exr": (".exr", exr(OpenEXR.PXR24_COMPRESSION, **planes)),
        "dwaa exr": (".exr", exr(OpenEXR.DWAA_COMPRESSION, **planes)),
        "half exr": (".exr", exr(OpenEXR.B44_COMPRESSION, **{k: v.astype("f2") for k, v in planes.items()})),
        "pfm": (".pfm", pfm(light)),
        "npy": (".npy", encoded(np.save, light)),
        "npz": (".npz", encoded(np.savez_compressed, depth=light[..., 0])),
        "dpt": (".dpt", dpt_bytes(light[..., 0] + 1)),
        "tagged png": (".png", encoded(Image.fromarray(color).save, "PNG", **tagged)),
        "tagged jpeg": (".jpg", encoded(Image.fromarray(color).save, "JPEG", **tagged)),
        "tagged tiff": (".tif", tiff(color, iccprofile=adobe, extratags=[(274, 3, 1, 6, True)])),
        "keyed png": (".png", encoded(Image.fromarray(color).save, "PNG", transparency=(1, 2, 3))),
        "layered exr": (".exr", exr(OpenEXR.ZIP_COMPRESSION, **layers)),
    }
    return {name: (suffix, bytes(content)) for name, (suffix, content) in found.items()}


def damaged(seed: int, number: int) -> tuple[str, str, bytes]:
    """The damaged copy of this number: name of the sample, suffix, content."""
    rng = random.Random(f"{seed}:{number}")
    name = rng.choice(list(samples()))
    suffix, content = samples()[name]
    for _ in range(rng.choice((1, 1, 2, 5))):
        content = rng.choice(DAMAGES)(rng, content)
    return name, suffix, content


def flip(rng: random.Random, content: bytes, times: tuple[int, ...] = (1, 1, 4)) -> bytes:
    """Change single bits, as many as one of `times` says."""
    changed = bytearray(content)
    for _ in range(rng.choice(times) if changed else 0):
        changed[rng.randrange(len(changed))] ^= 1 << rng.randrange(8)
    return bytes(changed)


def _in_the_head(rng: random.Random, content: bytes) -> bytes:
    """Another byte, or a number of 2 or 4 bytes, among the first ones, where sizes and kinds are."""
    changed = bytearray(content)
    start = rng.randrange(min(len(changed), 400) or 1)
    new = rng.choice((
        rng.randbytes(1), b"\0", b"\xff", struct.pack("<I", rng.choice((0, 1, 2**16, 2**27, 2**31 - 1, 2**32 - 1))),
        struct.pack(">H", rng.choice((0, 1, 12, 300, 65535))), struct.pack("<Q", rng.choice((0, 2**32, 2**63))),
    ))  # fmt: skip
    changed[start : start + len(new)] = new
    return bytes(changed)


def cut(rng: random.Random, content: bytes) -> bytes:
    return content[: rng.randrange(len(content) + 1)]


def _leave_out(rng: random.Random, content: bytes) -> bytes:
    start = rng.randrange(len(content) + 1)
    return content[:start] + content[start + rng.choice((1, 4, 30)) :]


def _repeat(rng: random.Random, content: bytes) -> bytes:
    start = rng.randrange(len(content) + 1)
    part = content[start : start + rng.choice((1, 12, 200))]
    return content[:start] + part * rng.choice((2, 50)) + content[start:]


DAMAGES: tuple[Change, ...] = (flip, _in_the_head, _in_the_head, cut, _leave_out, _repeat)
