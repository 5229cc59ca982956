"""Passes and the engine have all that they work with from the start, and values keep theirs: nothing is asserted, comes
later, is written into what is frozen, or known by its address."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
TREES = {
    path.relative_to(ROOT).as_posix(): ast.parse(path.read_text("utf-8"))
    for folder in ("passes", "engine")
    for path in sorted((ROOT / "clsco" / folder).glob("*.py"))
}


def late(tree: ast.AST) -> Iterator[str]:
    """Attributes that methods of a class set, and neither its body nor `__init__`."""
    for owner in (node for node in ast.walk(tree) if isinstance(node, ast.ClassDef)):
        methods = {node.name: stored(node) for node in owner.body if isinstance(node, ast.FunctionDef)}
        fields = [node.target for node in owner.body if isinstance(node, ast.AnnAssign)]
        body = {target.id for target in fields if isinstance(target, ast.Name)}
        known = body | methods.pop("__init__", set())
        yield from (f"{owner.name}.{name}" for names in methods.values() for name in names - known)


def stored(method: ast.AST) -> set[str]:
    return {
        node.attr
        for node in ast.walk(method)
        if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store)
        if isinstance(node.value, ast.Name) and node.value.id == "self"
    }


def hidden(tree: ast.AST) -> Iterator[str]:
    """Ways to change a frozen value, and addresses, which another object may have later, in its place."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and node.attr == "__setattr__":
            yield "__setattr__"
        if isinstance(node, ast.Name) and node.id in ("PrivateAttr", "id") and isinstance(node.ctx, ast.Load):
            yield node.id


def kinds(tree: ast.AST) -> Iterator[str]:
    """Pupils of which something asks whether a value is one."""
    nodes = [*ast.walk(tree)]
    imports = [node for node in nodes if isinstance(node, ast.ImportFrom) and node.module]
    pupils = [node for node in imports if f"{node.module}.".startswith("clsco.optics.pupils.")]
    known = {name.name for node in pupils for name in node.names}
    for call in (node for node in nodes if isinstance(node, ast.Call) and ast.unparse(node.func) == "isinstance"):
        yield from known & {node.id for node in ast.walk(call.args[1]) if isinstance(node, ast.Name)}


def test_nothing_is_asserted() -> None:
    nodes = [(name, node) for name, tree in TREES.items() for node in ast.walk(tree)]
    assert {f"{name}:{node.lineno}" for name, node in nodes if isinstance(node, ast.Assert)} == set()


def test_attributes_are_born_with_their_object() -> None:
    assert len(TREES) > 20
    assert {name: found for name, tree in TREES.items() if (found := sorted(late(tree)))} == {}
    told = "class A:\n    def __init__(self): self.a = 1\n    def run(self): self.a = self.b = 2"
    assert [*late(ast.parse(told))] == ["A.b"]


def test_values_are_frozen_and_keys_are_values() -> None:
    """But for free blocks of memory, which are alike, and held as long as their addresses count."""
    paths = sorted((ROOT / "clsco").rglob("*.py"))
    assert len(paths) > 200
    found = {
        path.relative_to(ROOT).as_posix(): names
        for path in paths
        if (names := [*hidden(ast.parse(path.read_text("utf-8")))])
    }
    assert found == {"clsco/opencl/pages.py": ["id"]}
    assert [*hidden(ast.parse("object.__setattr__(a, 'b', {id(a): PrivateAttr()})"))]


def test_optics_alone_tells_pupils_apart() -> None:
    paths = [path for path in sorted((ROOT / "clsco").rglob("*.py")) if "optics" not in path.parts]
    assert {path.name: found for path in paths if (found := [*kinds(ast.parse(path.read_text("utf-8")))])} == {}
    told = "from clsco.optics.pupils.ring import Ring\nisinstance(pupil, Ring | int)"
    assert [*kinds(ast.parse(told))] == ["Ring"]
