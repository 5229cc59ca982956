"""Kernels that runs of the tests leave to one another."""

from __future__ import annotations

import os
from pathlib import Path

from tests.kernel_cache import array_folder, keep_programs, remove_old, worker_folder


def test_what_was_not_used_for_the_longest_time_is_removed(tmp_path: Path) -> None:
    for name, age in (("ABCD", 30), ("EFGH", 10), ("IJKL", 20), ("MNOP", 40)):
        program = tmp_path / name[:2] / name[2:]
        (program / "kernel").mkdir(parents=True)
        (program / "kernel" / "kernel.so").write_text("x" * 100)
        (program / "last_accessed").touch()
        os.utime(program / "last_accessed", (age, age))
    remove_old(tmp_path, 3 * sum(path.stat().st_size for path in (tmp_path / "AB" / "CD").rglob("*")))
    assert sorted(path.name for path in tmp_path.glob("??/*")) == ["CD", "KL", "OP"]


def test_workers_compile_in_their_own_folders_and_leave_what_they_compiled(tmp_path: Path) -> None:
    kept = tmp_path / "kernels"
    compiled = [["AB/CD/program.bc", "clsco.lock"], ["AB/CD/kernel/kernel.so", "AB/EF/program.bc"]]
    for worker, files in enumerate(compiled):
        folder = worker_folder(kept)
        assert [path.name for path in folder.glob("??/*/program.bc")] == ["program.bc"] * worker
        for name in files:
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_text(name)
        keep_programs(folder, kept)
        assert not folder.exists()
    names = sorted(str(path.relative_to(kept)) for path in kept.rglob("*") if path.is_file())
    assert names == ["AB/CD/kernel/kernel.so", "AB/CD/program.bc", "AB/EF/program.bc"]


def test_where_nothing_can_be_kept_a_worker_has_a_temporary_folder(tmp_path: Path) -> None:
    assert worker_folder(tmp_path / "kernels").parent == tmp_path
    (tmp_path / "file").touch()
    for find_folder in (worker_folder, array_folder):
        folder = find_folder(tmp_path / "file" / "kernels")
        assert folder.is_dir()
        assert tmp_path not in folder.parents
        folder.rmdir()
