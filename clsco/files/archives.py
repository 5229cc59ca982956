"""Reader of untrusted NPY files and ZIP archives, which unpacks no more bytes than requested."""

from __future__ import annotations

import io
import math
import os
from typing import TYPE_CHECKING, Any, BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import zipfile  # 3 ms

HEADER = 2**14  # largest header of an NPY, bytes; numpy accepts up to 10000
MOST_DIRECTORY = 2**22  # largest directory of an archive, bytes; enough for 40,000 members
_END = b"PK\x05\x06"  # start of an archive's end record: 22 bytes and a comment of up to 65535


class NpyHeader(NamedTuple):
    """Header of an NPY: shape, order and type of the array, and the offset of the array's first byte."""

    shape: tuple[int, ...]
    fortran: bool
    dtype: np.dtype[Any]
    start: int


def npy_header(file: BinaryIO | zipfile.ZipExtFile) -> NpyHeader:
    """Read the header at the start of an NPY file. Raises ValueError if there is none."""
    head = io.BytesIO(file.read(HEADER))
    version = np.lib.format.read_magic(head)
    if version not in ((1, 0), (2, 0)):
        raise ValueError(f"NPY of version {version}")
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, fortran, dtype = read(head)
    if any(size < 0 for size in shape):
        raise ValueError(f"an array of shape {shape}")
    return NpyHeader(shape, fortran, dtype, head.tell())


def image_shape(shape: tuple[int, ...]) -> tuple[int, ...]:
    """Shape of an image or a map without outer axes of length 1: (rows, columns) for (1, rows, columns)."""
    while len(shape) > 2 and shape[-1] == 1:
        shape = shape[:-1]
    while len(shape) > 2 and shape[0] == 1 and (len(shape) > 3 or shape[-1] != 3):
        shape = shape[1:]
    return shape


def npy_bytes(array: NDArray[Any]) -> bytes:
    """NPY file of an array of numbers or bools of any shape; equal arrays give equal bytes."""
    stream = io.BytesIO()
    np.lib.format.write_array(stream, np.ascontiguousarray(array), allow_pickle=False)
    return stream.getvalue()


def npy_size(dtype: np.dtype[Any], shape: tuple[int, ...]) -> int:
    """Largest size in bytes of an NPY file with an array of this type and shape."""
    return math.prod(shape) * dtype.itemsize + HEADER


def npy_array(content: bytes | bytearray | memoryview, dtype: np.dtype[Any], shape: tuple[int, ...]) -> NDArray[Any]:
    """The array in an NPY file; shares writable memory of `content`. Raises ValueError for another type or shape."""
    header = npy_header(io.BytesIO(content[:HEADER]))
    if header.dtype.hasobject or (header.dtype.newbyteorder("="), header.shape) != (dtype, shape):
        raise ValueError(f"{header.dtype} of shape {header.shape} for {dtype} {shape}")
    if len(content) != header.start + math.prod(shape) * dtype.itemsize:
        raise ValueError(f"{len(content)} bytes of {header.dtype} of shape {header.shape}")
    plain = np.frombuffer(content, header.dtype, math.prod(shape), header.start)
    array = plain.reshape(shape, order="F" if header.fortran else "C")
    return np.array(array, dtype, order="C", copy=None if plain.flags.writeable else True)


def open_archive(file: BinaryIO) -> zipfile.ZipFile:
    """Open a ZIP archive. Raises ValueError if its directory is large, BadZipFile if it is not an archive."""
    import zipfile

    size = file.seek(0, os.SEEK_END)
    file.seek(max(0, size - 22 - 65535))
    tail = file.read(22 + 65535)
    at = tail.rfind(_END)
    if at >= 0 and (directory := int.from_bytes(tail[at + 12 : at + 16], "little")) > MOST_DIRECTORY:
        raise ValueError(f"a directory of {directory} bytes")
    return zipfile.ZipFile(file)


def open_member(archive: zipfile.ZipFile, name: str) -> zipfile.ZipExtFile:
    """Open a stored or deflated member. Raises ValueError for other methods, which may unpack more than is read."""
    import zipfile

    about = archive.getinfo(name)
    if about.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise ValueError(f"{name} compressed by another method than deflate")
    return archive.open(about)  # type: ignore[return-value]


def member_bytes(archive: zipfile.ZipFile, name: str, most: int) -> bytes:
    """Content of a member. Raises ValueError if it has more than `most` bytes, or is damaged."""
    size = archive.getinfo(name).file_size
    if size > most:
        raise ValueError(f"{size} bytes in {name}")
    with open_member(archive, name) as member:
        content = member.read(size + 1)  # without a size, the whole member would be unpacked, however large it is
    if len(content) != size:
        raise ValueError(f"{len(content)} bytes of {size} in {name}")
    return content


def member_array(archive: zipfile.ZipFile, name: str, header: NpyHeader) -> NDArray[Any]:
    """The array in a member that is an NPY with this header, and has no bytes after the array."""
    needed = header.start + math.prod(header.shape) * header.dtype.itemsize
    if archive.getinfo(name).file_size > needed:
        raise ValueError("bytes after the array")
    return npy_array(member_bytes(archive, name, needed), header.dtype.newbyteorder("="), header.shape)
