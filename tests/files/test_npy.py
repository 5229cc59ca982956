"""NPY files: np.load reads them, and with zstd what any decompressor makes of them."""

from __future__ import annotations

import io
import sys

import imagecodecs
import numpy as np
import pytest

from clsco.errors import MissingDependencyError
from clsco.files.npy import npy_bytes

RNG = np.random.default_rng(13)


@pytest.mark.parametrize("dtype", ["f2", "f4", "f8", "?", "u1", "i4"])
@pytest.mark.parametrize("shape", [(5, 7), (5, 7, 3), (2, 5, 7, 3)])
def test_np_load_reads_them(dtype: str, shape: tuple[int, ...]) -> None:
    array = RNG.integers(0, 2, shape).astype(dtype)[:, ::-1]
    for content in (npy_bytes(array), imagecodecs.zstd_decode(npy_bytes(array, zstd=True))):
        np.testing.assert_array_equal(np.load(io.BytesIO(content), allow_pickle=False), array, strict=True)
    assert npy_bytes(array, zstd=True) == npy_bytes(array.copy(), zstd=True)


def test_zstd_states_its_size_and_is_smaller() -> None:
    array = np.zeros((100, 100), np.float32)
    content = npy_bytes(array, zstd=True)
    assert len(content) < 200
    assert content[:4] == b"\x28\xb5\x2f\xfd"
    assert content[4] >> 6 or content[4] & 0x20  # RFC 8878: the header has the size, so that readers need not guess it


def test_zstd_needs_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "imagecodecs", None)
    assert npy_bytes(np.zeros(3))
    with pytest.raises(
        MissingDependencyError, match=r"a.npy.zst: needs imagecodecs: pip install 'clsco\[formats\]'; got "
    ):
        npy_bytes(np.zeros(3), True, "a.npy.zst")
