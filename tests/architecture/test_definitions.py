"""Rules on definitions: passes and the engine have all that they work with from the start, and values keep theirs; a
name says which class is meant; a number that host and kernels share stands once, in clsco/constants.py."""

from __future__ import annotations

import ast
import re
from collections import defaultdict
from collections.abc import Iterator

from clsco.constants import definitions
from tests.architecture.trees import ROOT, package_trees
from tests.kernels.test_programs_build import PROGRAMS

TREES = {name: tree for name, tree in package_trees().items() if name.split("/")[0] in ("passes", "engine")}
KERNELS = [path.read_text("utf-8") for path in (ROOT / "kernels").rglob("*.cl*")]
MODULES = [tree for name, tree in package_trees().items() if name != "constants.py"]
OUTER = {"files", "frame", "data", "studio", "cli"}


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
    ways = {name: found for name, tree in package_trees().items() if (found := [*hidden(tree)])}
    assert ways == {"opencl/pages.py": ["id"]}
    assert [*hidden(ast.parse("object.__setattr__(a, 'b', {id(a): PrivateAttr()})"))]


def test_optics_alone_tells_pupils_apart() -> None:
    others = {name: tree for name, tree in package_trees().items() if not name.startswith("optics/")}
    assert {name: found for name, tree in others.items() if (found := [*kinds(tree)])} == {}
    told = "from clsco.optics.pupils.ring import Ring\nisinstance(pupil, Ring | int)"
    assert [*kinds(ast.parse(told))] == ["Ring"]


def test_no_class_outside_of_the_core_has_the_name_of_another() -> None:
    """Passes and the reference, which mirror each other, have some twins."""
    places = defaultdict[str, list[str]](list)
    for name, tree in package_trees().items():
        for node in ast.walk(tree):
            if isinstance(node, ast.ClassDef):
                places[node.name].append(name)
    assert len(places) > 300
    twice = {name: files for name, files in places.items() if len(files) > 1}
    assert {name: files for name, files in twice.items() if {file.split("/")[0] for file in files} & OUTER} == {}


def without_comments(text: str) -> str:
    return re.sub(r"//.*|/\*.*?\*/", "", text)


def test_kernels_use_all_and_define_none() -> None:
    used = {name for text in KERNELS for name in re.findall(r"\w+", without_comments(text))}
    defined = {name for text in KERNELS for name in re.findall(r"^\s*#\s*define\s+(\w+)", text, re.MULTILINE)}
    assert definitions().keys() - used == set()
    assert definitions().keys() & defined == set()


def test_the_package_uses_all_and_defines_none() -> None:
    nodes = [node for tree in MODULES for node in ast.walk(tree)]
    names = [node for node in nodes if isinstance(node, ast.Name)]
    assert definitions().keys() - {node.id for node in names if isinstance(node.ctx, ast.Load)} == set()
    assert definitions().keys() & {node.id for node in names if isinstance(node.ctx, ast.Store)} == set()


def test_all_come_from_their_own_module() -> None:
    imports = [node for tree in MODULES for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    found = {node.module for node in imports for alias in node.names if alias.name in definitions()}
    assert found == {"clsco.constants"}


def test_no_feature_has_the_name_of_one() -> None:
    assert definitions().keys() & {name for features in PROGRAMS.values() for name in features} == set()


def test_all_are_numbers() -> None:
    assert {type(value) for value in definitions().values()} == {int, float}
