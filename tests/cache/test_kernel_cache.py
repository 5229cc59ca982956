"""Kernels that runs of the tests leave to one another."""

from __future__ import annotations

import os
from pathlib import Path

from tests.kernel_cache import cache_folder, remove_old


def test_what_was_not_used_for_the_longest_time_is_removed(tmp_path: Path) -> None:
    for name, age in (("ABCD", 30), ("EFGH", 10), ("IJKL", 20), ("MNOP", 40)):
        program = tmp_path / name[:2] / name[2:]
        (program / "kernel").mkdir(parents=True)
        (program / "kernel" / "kernel.so").write_text("x" * 100)
        (program / "last_accessed").touch()
        os.utime(program / "last_accessed", (age, age))
    remove_old(tmp_path, 3 * sum(path.stat().st_size for path in (tmp_path / "AB" / "CD").rglob("*")))
    assert sorted(path.name for path in tmp_path.glob("??/*")) == ["CD", "KL", "OP"]


def test_where_nothing_can_be_kept_a_run_has_a_temporary_folder(tmp_path: Path) -> None:
    assert cache_folder(tmp_path / "kernels") == tmp_path / "kernels"
    (tmp_path / "file").touch()
    folder = cache_folder(tmp_path / "file" / "kernels")
    assert folder.is_dir()
    assert tmp_path not in folder.parents
