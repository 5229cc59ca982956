"""Files of the repository as rules read them: syntax trees of the package, each parsed once, and docstrings of all."""

from __future__ import annotations

import ast
import re
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "clsco"
TRIPLE = re.compile(r'(^ *r?)?"""(.*?)"""', re.MULTILINE | re.DOTALL)


@cache
def package_nodes() -> dict[str, list[ast.AST]]:
    """Nodes of the syntax tree of each file of the package, at any depth, by its path there."""
    paths = sorted(PACKAGE.rglob("*.py"))
    assert len(paths) > 200
    return {path.relative_to(PACKAGE).as_posix(): [*ast.walk(ast.parse(path.read_text("utf-8")))] for path in paths}


@cache
def docstrings(text: str) -> tuple[tuple[int, str], ...]:
    """Lines and texts of docstrings: texts in three quotes that begin a line, which parsing takes a hundred times as
    long to find."""
    assert text.count(3 * '"') % 2 == 0, "three quotes must come in pairs"
    strings = (found for found in TRIPLE.finditer(text) if found[1] is not None)
    return tuple((text.count("\n", 0, found.start()) + 1, found[2]) for found in strings)
