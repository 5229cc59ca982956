"""A disk that fails while a set is made: one line, no half-written file, nothing left over, and --resume goes on."""

from __future__ import annotations

import os
import resource
import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from click.testing import Result

from clsco.data import pool
from clsco.files.atomic import naming
from tests.cli.test_dataset import DISTRIBUTION, HerePool
from tests.command import clsco_
from tests.data.test_shards import files
from tests.faults import kills
from tests.faults.opencl import counted
from tests.faults.test_torn import Disk

_failing: list[tuple[Disk, str]] = []


def _fail(event: str, args: tuple[Any, ...]) -> None:
    for disk, folder in _failing:
        if event in ("open", "os.rename", "os.mkdir") and str(args[0]).startswith(folder):
            with naming(Path(args[0])):  # as the system does it
                disk.call(event)


sys.addaudithook(_fail)


@contextmanager
def failing(folder: Path, disk: Disk, size: int = resource.RLIM_INFINITY) -> Iterator[None]:
    """Count what is opened, made, renamed and flushed in a folder; the disk fails at one call, or at `size` bytes."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", counted(disk.call, "fsync", os.fsync))
        _failing.append((disk, str(folder)))
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
        try:
            yield
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)
            _failing.pop()


@pytest.mark.filterwarnings("ignore:coroutine")  # zarr drops calls that follow the one that failed
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize("step", [40, pytest.param(1, marks=pytest.mark.slow)])
@pytest.mark.parametrize("form", ["webdataset", "webdataset+raw", "npz", "hdf5", "zarr"])
def test_a_set_on_a_disk_that_fails(form: str, step: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pool, "_Pool", HerePool)
    (tmp_path / "set.toml").write_text(DISTRIBUTION)
    words = f"dataset make {tmp_path}/set.toml --resume --quiet --count 4 --shard-size 2 --truth depth --split a=1,b=1"

    def make(out: Path, *about: Any) -> Result:
        with failing(out, *about):
            return clsco_(*words.split(), "--format", form, "-o", out)

    count = Disk()
    assert make(tmp_path / "whole", count).exit_code == 0
    whole, out, faults = files(tmp_path / "whole"), tmp_path / "out", 0
    largest = max(map(len, whole.values()))
    for about in [(Disk(each),) for each in range(step // 4, len(count.names), step)] + [
        (Disk(), size) for size in (100, largest // 2, largest - 1)
    ]:
        result = make(out, *about)
        assert result.exception is None or isinstance(result.exception, SystemExit), (about, repr(result.exception))
        assert (result.exit_code == 0) == (result.stderr == "")  # an open file or folder may be tried twice
        if result.exit_code:
            faults += 1
            assert (result.exit_code, len(result.stderr.splitlines())) == (1, 1), result.stderr
            assert "sample" not in result.stderr
            assert str(out) in result.stderr
            there = files(out) if out.exists() else {}
            assert {key: data for key, data in there.items() if whole.get(key) != data}.keys() <= {"dataset.json"}
            assert make(out, Disk()).exit_code == 0
        assert files(out) == whole
        assert not list(out.glob(".*"))
        shutil.rmtree(out)
    assert faults >= 3


@pytest.mark.parametrize(("seed", "count"), [(1, 2), pytest.param(2, 60, marks=pytest.mark.slow)])
def test_commands_that_are_killed_go_on(seed: int, count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kills, "COUNT", 24)
    assert kills.main(["--kills", str(count), "--seed", str(seed), "--ways", "pool 2"]) == 0
