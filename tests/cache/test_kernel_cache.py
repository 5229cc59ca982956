"""Kernels that runs of the tests leave to one another."""

from __future__ import annotations

import os
from pathlib import Path

from tests.kernel_cache import array_folder, exchange_programs, remove_old, worker_folder


def test_what_was_not_used_for_the_longest_time_is_removed(tmp_path: Path) -> None:
    for name, age in (("ABCD", 30), ("EFGH", 10), ("IJKL", 20), ("MNOP", 40)):
        program = tmp_path / name[:2] / name[2:]
        (program / "kernel").mkdir(parents=True)
        (program / "kernel" / "kernel.so").write_text("x" * 100)
        (program / "last_accessed").touch()
        os.utime(program / "last_accessed", (age, age))
    remove_old(tmp_path, 3 * sum(path.stat().st_size for path in (tmp_path / "AB" / "CD").rglob("*")))
    assert sorted(path.name for path in tmp_path.glob("??/*")) == ["CD", "KL", "OP"]


def test_workers_compile_in_their_own_folders_and_exchange_what_they_compiled(tmp_path: Path) -> None:
    kept = tmp_path / "kernels"
    kept.mkdir()
    (kept / "GH" / "IJ").mkdir(parents=True)
    first, second = worker_folder(kept), worker_folder(kept)
    for folder, name in ((first, "AB/CD/program.bc"), (second, "AB/EF/program.bc"), (second, "GH/IJ/kernel.so")):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(name)
    for folder in (first, second, first):
        exchange_programs(folder, kept)
    for folder in (first, second, worker_folder(kept), kept):
        assert sorted(path.name for path in folder.glob("??/*/*")) == ["kernel.so", "program.bc", "program.bc"]


def test_where_nothing_can_be_kept_a_worker_has_a_temporary_folder(tmp_path: Path) -> None:
    assert worker_folder(tmp_path / "kernels").parent == tmp_path
    (tmp_path / "file").touch()
    for find_folder in (worker_folder, array_folder):
        folder = find_folder(tmp_path / "file" / "kernels")
        assert folder.is_dir()
        assert tmp_path not in folder.parents
        folder.rmdir()
