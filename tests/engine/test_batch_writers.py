"""Two writers in one folder: the second one stops at a frame that the first one has written, and leaves it."""

from __future__ import annotations

from pathlib import Path

import pytest

import clsco
from clsco.engine import batch
from clsco.plan.prepare import prepare

SCENE = clsco.parse_scene(
    {"camera": {"resolution": [24, 16]}, "sequence": {"frames": 2}, "object": [{"shape": "plane", "distance": 280.0}]}
)


def job(folder: Path, frames: range) -> batch.Job:
    return batch.prepare(prepare(SCENE), folder, frames, (), resume=False)


def test_a_frame_of_another_writer_stays(tmp_path: Path) -> None:
    one, other = job(tmp_path, range(2)), job(tmp_path, range(2))
    assert len(list(batch.run([one], None))) == 2
    before = {path: (path.stat().st_mtime_ns, path.read_bytes()) for path in tmp_path.iterdir()}
    with pytest.raises(clsco.FileError, match=r"frame_0000.json: frames must have one writer at a time; got one that"):
        list(batch.run([other], None))
    assert {path: (path.stat().st_mtime_ns, path.read_bytes()) for path in tmp_path.iterdir()} == before


def test_frames_apart_and_older_ones_are_written(tmp_path: Path) -> None:
    first, last = job(tmp_path, range(1)), job(tmp_path, range(1, 2))
    assert [len(list(batch.run([each], None))) for each in (first, last)] == [1, 1]
    assert len(list(batch.run([job(tmp_path, range(2))], None))) == 2
