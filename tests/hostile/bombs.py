"""Files that are small and say that they are large, or take long, and what reads each."""

from __future__ import annotations

import bz2
import io
import lzma
import struct
import tarfile
import zipfile
import zlib
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import imagecodecs
import numpy as np
import OpenEXR
import tifffile
import zarr
from zarr.codecs import ZstdCodec

from clsco.data.containers import CONTAINERS
from clsco.data.containers.base import meta_bytes
from clsco.errors import ClscoError
from clsco.files.archives import npy_bytes
from clsco.files.arrays import read_npz
from clsco.files.images import read_image
from clsco.inputs.depth_files import read_depth
from tests.data.samples import record
from tests.hostile.pictures import encoded

ZEROS = 2**26  # bytes that a bomb unpacks to
SAMPLE = record(1, (64, 64), ("depth",))
SIDE = int(ZEROS**0.5) // 16 * 16
Made = tuple[str, Callable[[Path], object]]
"""Name of a file or folder that a bomb is, and what reads it."""


def packed_zeros(count: int, kind: str) -> bytes:
    """So many zeros, deflated, or by bzip2 or LZMA, made piece by piece."""
    makers = {"deflate": zlib.compressobj(9), "bzip2": bz2.BZ2Compressor(9), "lzma": lzma.LZMACompressor()}
    packer: Any = makers[kind]
    block = bytes(2**20)
    return b"".join([packer.compress(block) for _ in range(count >> 20)] + [packer.flush()])


def _zip(path: Path, members: dict[str, bytes], kind: int, zeros: int, size: int | None = None) -> None:
    """A ZIP whose last member goes on with zeros; `size`: what its directory says instead of the truth."""
    with zipfile.ZipFile(path, "w", kind, compresslevel=9) as archive:
        for name, content in members.items():
            with archive.open(name, "w", force_zip64=True) as member:
                member.write(content)
                if name == list(members)[-1]:
                    for _ in range(zeros >> 20):
                        member.write(bytes(2**20))
        if size is not None:
            archive.filelist[-1].file_size = size


def _npy_header(shape: tuple[int, ...], dtype: str = "<f4") -> bytes:
    file = io.BytesIO()
    np.lib.format.write_array_header_1_0(file, {"descr": dtype, "fortran_order": False, "shape": shape})
    return file.getvalue()


def _npz(kind: int, header: bytes, read: Callable[[Path], object]) -> Callable[[Path], Made]:
    def make(folder: Path) -> Made:
        _zip(folder / "bomb.npz", {"depth.npy": header}, kind, ZEROS)
        return "bomb.npz", read

    return make


def _sample_npz(folder: Path) -> Made:
    (folder / "shard").mkdir()
    content = npy_bytes(SAMPLE.arrays["depth"])
    members = {"meta.json": meta_bytes(SAMPLE), "depth.npy": content}
    _zip(folder / "shard/000000001.npz", members, zipfile.ZIP_DEFLATED, ZEROS, len(content))
    return "shard", CONTAINERS["npz"].read


def _scans(folder: Path) -> Made:
    """A progressive JPEG whose last scan comes 800 times."""
    from PIL import Image

    content = encoded(Image.new("RGB", (4096, 4096), (9, 99, 199)).save, "JPEG", progressive=True)
    last = content.rindex(b"\xff\xda")
    (folder / "bomb.jpg").write_bytes(content[:last] + 800 * content[last:-2] + content[-2:])
    return "bomb.jpg", read_image


def _segment(compression: str, inside: Callable[[int], bytes]) -> Callable[[Path], Made]:
    """A TIFF of 16 x 16 pixels, in whose only strip there is something large."""

    return lambda folder: _tiff(folder, inside(SIDE), compression=compression, rowsperstrip=16)


def _large_tile(folder: Path) -> Made:
    return _tiff(folder, packed_zeros(ZEROS, "deflate"), compression="zlib", tile=(SIDE, SIDE))


def _tiff(folder: Path, content: bytes, **options: Any) -> Made:
    kind: dict[str, Any] = {"shape": (16, 16), "dtype": "u1", "photometric": "minisblack", "metadata": None}
    tifffile.imwrite(folder / "bomb.tif", iter([content]), **kind, **options)
    return "bomb.tif", read_image


def _second_part(folder: Path) -> Made:
    side = int((ZEROS // 4) ** 0.5)
    shown = (np.array([0, 0], np.int32), np.array([15, 15], np.int32))
    header = {"type": OpenEXR.scanlineimage, "compression": OpenEXR.ZIP_COMPRESSION, "displayWindow": shown}
    small, large = np.ones((16, 16), np.float32), np.zeros((side, side), np.float32)
    parts = [OpenEXR.Part(dict(header), {"Y": plane}, name=name) for name, plane in (("a", small), ("b", large))]
    OpenEXR.File(parts).write(str(folder / "bomb.exr"))
    return "bomb.exr", read_image


def _deflated_chunk(folder: Path) -> Made:
    CONTAINERS["hdf5"].write(folder / "bomb.h5", iter([SAMPLE]))
    with h5py.File(folder / "bomb.h5", "r+") as file:
        file["000000001/depth"].id.write_direct_chunk((0, 0), packed_zeros(ZEROS, "deflate"))
    return "bomb.h5", CONTAINERS["hdf5"].read


def _zarr_chunk(folder: Path) -> Made:
    """Zarr as clsco writes it, with a large chunk in place of a file of several."""
    CONTAINERS["zarr"].write(folder / "bomb.zarr", iter([SAMPLE]))
    group = zarr.open_group(folder / "bomb.zarr", mode="r+", zarr_format=3)
    zstd = ZstdCodec()
    group.create_array("depth", shape=(1, 64, 64), dtype="f4", chunks=(1, 64, 64), compressors=zstd, filters=None,
                       overwrite=True)[:] = 1  # fmt: skip
    (folder / "bomb.zarr/depth/c/0/0/0").write_bytes(imagecodecs.zstd_encode(bytes(ZEROS), 3))
    return "bomb.zarr", CONTAINERS["zarr"].read


def _tar(folder: Path, *headers: bytes) -> Made:
    """A tar of one member, with these extended headers before it."""
    path, head = folder / "bomb.tar", tarfile.TarInfo("././@PaxHeader")
    with tarfile.open(path, "w", format=tarfile.USTAR_FORMAT) as tar:
        for records in headers:
            head.type, head.size = tarfile.XHDTYPE, len(records)
            tar.addfile(head, io.BytesIO(records))
        tar.addfile(tarfile.TarInfo("000000001.meta.json"))
    return path.name, CONTAINERS["webdataset"].read


def _pax(folder: Path) -> Made:
    """A tar whose header of a member is digits, in which `tarfile` looks for a record from each of them on."""
    return _tar(folder, b"1" * 210_000)


def _sparse_pax(folder: Path) -> Made:
    """A tar whose header is a map of a sparse file, which is read line by line from its end on."""
    count = 20_000
    records = b"".join(
        b"%d %s\n" % (len(text) + 3 if len(text) < 97 else len(text) + 4, text)
        for text in [b"GNU.sparse.offset=0", b"GNU.sparse.numbytes=0"] * (count // 4)
    )
    return _tar(folder, records)


def _pax_chain(folder: Path) -> Made:
    """A tar of nothing but headers of headers."""
    return _tar(folder, *[b"11 a=bcdef\n"] * 2000)


_HEAD = _npy_header((16, 16))
_LONG_HEAD = b"\x93NUMPY\x02\x00" + struct.pack("<I", 2**30)
_read_npz = partial(read_npz, names=["depth"])
BOMBS: dict[str, Callable[[Path], Made]] = {
    "npz of bzip2": _npz(zipfile.ZIP_BZIP2, _HEAD, _read_npz),
    "npz of lzma": _npz(zipfile.ZIP_LZMA, _HEAD, _read_npz),
    "npz deflated": _npz(zipfile.ZIP_DEFLATED, _HEAD, _read_npz),
    "npz with a header of 1 GiB": _npz(zipfile.ZIP_DEFLATED, _LONG_HEAD, _read_npz),
    "depth npz of bzip2": _npz(zipfile.ZIP_BZIP2, _HEAD, read_depth),
    "sample npz deflated": _sample_npz,
    "hdf5 chunk deflated": _deflated_chunk,
    "zarr chunk": _zarr_chunk,
    "tar pax records": _pax,
    "tar sparse map": _sparse_pax,
    "tar chain of headers": _pax_chain,
    "png in tiff": _segment("png", lambda side: bytes(imagecodecs.png_encode(np.zeros((side, side), "u1"), level=9))),
    "webp in tiff": _segment("webp", lambda side: bytes(
        imagecodecs.webp_encode(np.zeros((min(side, 16368), min(side, 16368), 3), "u1"), lossless=True))),
    "deflate in tiff": _segment("zlib", lambda side: packed_zeros(side * side, "deflate")),
    "tile larger than its tiff": _large_tile,
    "jpeg of 800 scans": _scans,
    "exr second part": _second_part,
}  # fmt: skip
LIKE_OTHERS = {"npz of lzma", "depth npz of bzip2", "webp in tiff"}
"""Bombs that take seconds to make, and that the readers refuse at the same line as others."""


def read_all(path: Path, read: Callable[[Path], Any]) -> str:
    """Read a bomb to its end: "refused", or what was read."""
    try:
        found = read(path)
        if hasattr(found, "record"):
            for each in found:
                del each
        return "read"
    except ClscoError as error:
        return f"refused: {error}"
    except BaseException as error:
        return f"{type(error).__name__}: {error}"
