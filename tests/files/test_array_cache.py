"""Arrays on disk: what was written comes back, and what is damaged, or cannot be written, is not there."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from clsco.files import array_cache
from clsco.files.array_cache import DIGEST, ArrayCache

ARRAYS = {"one": np.arange(12, dtype=np.float32).reshape(3, 4), "none": np.zeros((0, 2), np.int32)}


def test_arrays_come_back(tmp_path: Path) -> None:
    cache = ArrayCache(tmp_path)
    assert cache.get("key") is None
    cache.put("key", ARRAYS)
    arrays = ArrayCache(tmp_path).get("key")
    assert arrays is not None
    assert arrays.keys() == ARRAYS.keys()
    for name, array in ARRAYS.items():
        np.testing.assert_array_equal(arrays[name], array)
        assert arrays[name].dtype == array.dtype
    assert cache.get("other") is None
    assert len(list(tmp_path.iterdir())) == 1


@pytest.mark.parametrize("at", [0, DIGEST, DIGEST + 40, -1])
def test_a_damaged_file_is_not_there(tmp_path: Path, at: int) -> None:
    cache = ArrayCache(tmp_path)
    cache.put("key", ARRAYS)
    (path,) = tmp_path.iterdir()
    content = bytearray(path.read_bytes())
    content[at] ^= 1
    path.write_bytes(content)
    assert cache.get("key") is None
    path.write_bytes(content[: len(content) // 2])
    assert cache.get("key") is None
    cache.put("key", ARRAYS)
    assert cache.get("key") is not None


def test_a_folder_that_cannot_be_written_is_no_error(tmp_path: Path) -> None:
    for cache in (ArrayCache(None), ArrayCache(tmp_path / "none")):
        cache.put("key", ARRAYS)
        assert cache.get("key") is None


def test_a_folder_stays_within_its_limit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cache = ArrayCache(tmp_path)
    cache.put("0", ARRAYS)
    (path,) = tmp_path.iterdir()
    monkeypatch.setattr(array_cache, "MOST_BYTES", 3 * path.stat().st_size)
    for key in ("1", "2"):
        cache.put(key, ARRAYS)
    assert cache.get("0") is not None  # used last
    cache.put("3", ARRAYS)
    assert [cache.get(str(key)) is not None for key in range(4)] == [True, False, True, True]
