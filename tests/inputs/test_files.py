"""Files that scenes name: decoded once by their content, again when they change, and never beyond a limit."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from clsco.files import images
from clsco.inputs import depth_files
from clsco.inputs.files import InputFiles
from tests.scenes import scene_from


@pytest.fixture
def reads(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of the files that are decoded."""
    loaded: list[str] = []

    def counted(read: Any) -> Any:
        def counting(path: str, *options: Any, **names: Any) -> Any:
            loaded.append(Path(path).name)
            return read(path, *options, **names)

        return counting

    for module, name in ((images, "read_image"), (depth_files, "read_depth")):
        monkeypatch.setattr(module, name, counted(getattr(module, name)))
    return loaded


def save(path: Path, value: float, settled: bool = True) -> str:
    np.save(path, np.full((6, 8), value, np.float32))
    if settled:  # as if it had been written a while ago
        before = time.time() - 10
        os.utime(path, (before, before))
        time.sleep(0.12)
    return str(path)


def test_a_file_is_decoded_once_by_its_content(tmp_path: Path, reads: list[str]) -> None:
    files = InputFiles()
    one, copy = save(tmp_path / "one.npy", 0.5), save(tmp_path / "copy.npy", 0.5)
    loaded = [files.texture(path, "srgb", (6, 8)) for path in (one, copy, one)]
    assert reads == ["one.npy"]
    assert loaded[0].radiance is loaded[1].radiance is loaded[2].radiance
    assert [texture.source for texture in loaded] == [one, copy, one]
    assert loaded[0].content == loaded[1].content
    with pytest.raises(ValueError, match="read-only"):
        loaded[0].radiance[0, 0] = 1.0


@pytest.mark.parametrize("settled", [True, False])
def test_a_file_that_changes_is_read_again(tmp_path: Path, reads: list[str], settled: bool) -> None:
    files, path = InputFiles(), tmp_path / "texture.npy"
    for value in (0.25, 0.75, 0.25):
        save(path, value, settled)
        assert files.texture(str(path), "srgb", (6, 8)).radiance[0, 0] == np.float32(value)
    assert len(reads) == 2  # 0.25 is still there


def test_a_depth_map_is_read_once(tmp_path: Path, reads: list[str]) -> None:
    files, path = InputFiles(), save(tmp_path / "depth.npy", 280.0)
    item = {"shape": "depth_map", "depth": path, "texture": "bricks"}
    scene = scene_from({"camera": {"resolution": [8, 6]}}, item)
    maps = [files.maps(scene)[0] for _ in range(3)]
    assert reads == ["depth.npy"]
    assert maps[0] is maps[1] is maps[2]
    other = scene.replace("object[0].scale", 2.0)
    assert files.maps(other)[0] is not maps[0]
    assert reads == ["depth.npy"]


def test_no_more_than_a_limit_is_kept(tmp_path: Path, reads: list[str]) -> None:
    files, path = InputFiles(limit=100), save(tmp_path / "texture.npy", 0.5)
    for _ in range(2):
        files.texture(path, "srgb", (6, 8))
    assert len(reads) >= 2
    assert files.cache.bytes <= 100
