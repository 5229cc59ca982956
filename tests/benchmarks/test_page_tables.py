"""Tables of pages are those that `benchmarks.page_tables` writes from the result files."""

from __future__ import annotations

import pytest

from benchmarks.page_tables import DOCS, TABLES, table, with_table


@pytest.mark.parametrize("name", TABLES)
def test_a_table_has_the_figures_of_its_result_file(name: str) -> None:
    page, make = TABLES[name]
    text = (DOCS / page).read_text("utf-8")
    assert with_table(text, name, make()) == text


def test_a_table_is_replaced() -> None:
    text = "a\n<!-- table: x -->\nold\n<!-- table: end -->\nb\n"
    made = table(("p", "q"), [("1", "2")])
    assert made == "| p | q |\n|---|---|\n| 1 | 2 |\n"
    assert with_table(text, "x", made) == f"a\n<!-- table: x -->\n\n{made}\n<!-- table: end -->\nb\n"
