"""Kernels that runs of the tests leave to one another."""

from __future__ import annotations

import os
from pathlib import Path

from tests import kernel_cache
from tests.kernel_cache import keep, take_kept


def compiled(folder: Path, name: str, content: str = "code") -> Path:
    """A program of PoCL with one kernel, used a moment ago."""
    path = folder / name[:2] / name[2:] / "kernel" / "64-1-1" / "kernel.so"
    path.parent.mkdir(parents=True)
    path.write_text(content)
    (folder / name[:2] / name[2:] / "last_accessed").touch()
    return path


def content(folder: Path) -> dict[str, str]:
    return {str(path.relative_to(folder)): path.read_text() for path in folder.rglob("*") if path.is_file()}


def test_a_run_has_what_workers_of_the_one_before_have_compiled(tmp_path: Path) -> None:
    for name, worker in (("ABCD", "gw0"), ("EFGH", "gw1")):
        compiled(tmp_path / "run-1" / worker, name)
    (tmp_path / "run-1" / "gw0" / "tempfile_a").touch()
    keep(tmp_path / "run-1", tmp_path)
    take_kept(tmp_path / "run-2" / "gw0", tmp_path)
    kernel = "kernel/64-1-1/kernel.so"
    assert content(tmp_path / "run-2" / "gw0") == {f"AB/CD/{kernel}": "code", f"EF/GH/{kernel}": "code"}


def test_what_is_kept_stays_as_it_is(tmp_path: Path) -> None:
    compiled(tmp_path / "run-1", "ABCD", "first")
    compiled(tmp_path / "run-2", "ABCD", "second")
    for run in ("run-1", "run-2"):
        keep(tmp_path / run, tmp_path)
    assert "first" in content(tmp_path / "AB").values()


def test_what_was_not_used_for_the_longest_time_is_forgotten(tmp_path: Path) -> None:
    for name, age in (("ABCD", 30), ("EFGH", 10), ("IJKL", 20)):
        compiled(tmp_path / "run-0", name, "x" * 100)
        keep(tmp_path / "run-0", tmp_path)
        os.utime(tmp_path / name[:2] / name[2:], (age, age))
        (tmp_path / "run-0" / name[:2] / name[2:] / "last_accessed").unlink()
    compiled(tmp_path / "run-1", "MNOP", "x" * 100)
    program = sum(path.stat().st_size for path in (tmp_path / "AB" / "CD").rglob("*"))
    take_kept(tmp_path / "run-1", tmp_path)
    (tmp_path / "run-1" / "AB" / "CD" / "last_accessed").touch()  # used again
    keep(tmp_path / "run-1", tmp_path, 3 * program)
    assert sorted(path.name for path in tmp_path.glob("??/*")) == ["CD", "KL", "OP"]


def test_folders_of_runs_that_were_killed_are_removed_after_a_day(tmp_path: Path) -> None:
    for name in ("run-old", "run-new", "run-1"):
        (tmp_path / name).mkdir()
    os.utime(tmp_path / "run-old", (0, 0))
    keep(tmp_path / "run-1", tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["run-1", "run-new"]


def test_where_nothing_can_be_kept_a_run_has_a_temporary_folder(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    run = kernel_cache.new_run(tmp_path / "file" / "kernels")
    assert run.is_dir()
    assert tmp_path not in run.parents
