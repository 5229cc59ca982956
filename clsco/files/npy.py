"""NPY files, also compressed by Zstandard: what `np.load` reads, or reads once it is decompressed."""

from __future__ import annotations

import io
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.errors import import_extra

ZSTD = ("imagecodecs", "formats")  # module, and the extra of clsco that brings it
LEVEL = 3


def npy_bytes(array: NDArray[Any], zstd: bool = False, where: str = "array") -> bytes:
    """An NPY file, or with `zstd` an .npy.zst file.

    Parameters
    ----------
    array : ndarray
        Numbers or bools, of any shape.
    zstd : bool
        Compress the whole file as one frame of Zstandard: `np.load(io.BytesIO(zstandard.decompress(content)))` reads
        it, and `zstd -d` makes an NPY of it.
    where : str
        Place or name that messages begin with.

    Returns
    -------
    bytes
        The same for the same array.

    Raises
    ------
    MissingDependencyError
        The extra `formats` is missing.

    Notes
    -----
    512 x 512 floats, 1048 kB, of depth become 228 kB in 1.6 ms, of color 552 kB in 2.5 ms; 512 x 512 x 2 of flow, 2097
    kB, 183 kB in 5 ms. More than level 3 takes twice the time and saves nothing or some percent; imagecodecs and the
    package zstandard give the same bytes in the same time. Bytes sorted by significance would be 1 to 36 % smaller, and
    `np.load` could not read them.
    """
    stream = io.BytesIO()
    np.lib.format.write_array(stream, np.ascontiguousarray(array), allow_pickle=False)
    if not zstd:
        return stream.getvalue()
    compressed: bytes = import_extra(where, *ZSTD).zstd_encode(stream.getbuffer(), level=LEVEL)
    return compressed
