"""Syntax trees of the repository's files, each parsed once for all rules."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "clsco"


@cache
def package_trees() -> dict[str, ast.Module]:
    """Tree of each file of the package, by its path there."""
    paths = sorted(PACKAGE.rglob("*.py"))
    assert len(paths) > 200
    return {path.relative_to(PACKAGE).as_posix(): ast.parse(path.read_text("utf-8")) for path in paths}


@cache
def docstrings(text: str) -> tuple[tuple[int, str], ...]:
    """Lines and texts of docstrings: of modules, classes, functions and attributes."""
    return tuple(
        (node.lineno, node.value.value)
        for node in statements(ast.parse(text))
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
    )


def statements(node: ast.AST) -> Iterator[ast.AST]:
    """Statements of a tree, at any depth, without what they are made of."""
    for block in ("body", "orelse", "finalbody", "handlers", "cases"):
        for statement in getattr(node, block, ()):
            yield statement
            yield from statements(statement)
