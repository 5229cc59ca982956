"""Lines and words stay within their budget."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.size import BUDGET, measure_text


def test_the_repository_is_within_its_budget() -> None:
    sizes = measure_text()
    assert {name: size for name, size in sizes.items() if size > BUDGET[name]} == {}
    assert all(sizes.values())


def test_blank_lines_are_not_counted(tmp_path: Path) -> None:
    for name, text in (("clsco/a.py", "a = 1\n\n  \nb = 2\n"), ("kernels/b.clh", "int\n"), ("tests/t.py", "\n")):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    (tmp_path / "docs").mkdir()
    (tmp_path / "docs" / "page.md").write_text("# Two words\n\nand three more\n")
    (tmp_path / "README.md").write_text("one")
    assert [*measure_text(tmp_path).values()] == [2, 1, 0, 7]


@pytest.mark.slow
def test_the_wheel_is_within_its_budget() -> None:
    from benchmarks.size import measure_wheel

    assert 0 < measure_wheel()["wheel, kB"] <= BUDGET["wheel, kB"]
