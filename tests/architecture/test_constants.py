"""A number that host and kernels share stands once, in clsco/constants.py."""

from __future__ import annotations

import ast
import re
from pathlib import Path

from clsco.constants import definitions
from tests.kernels.test_programs_build import PROGRAMS

ROOT = Path(__file__).resolve().parents[2]
KERNELS = {path: path.read_text("utf-8") for path in sorted((ROOT / "kernels").rglob("*.cl*"))}
MODULES = {
    path: ast.parse(path.read_text("utf-8"))
    for path in sorted((ROOT / "clsco").rglob("*.py"))
    if path != ROOT / "clsco" / "constants.py"
}


def without_comments(text: str) -> str:
    return re.sub(r"//.*|/\*.*?\*/", "", text)


def test_kernels_use_all_and_define_none() -> None:
    used = {name for text in KERNELS.values() for name in re.findall(r"\w+", without_comments(text))}
    defined = {name for text in KERNELS.values() for name in re.findall(r"^\s*#\s*define\s+(\w+)", text, re.MULTILINE)}
    assert definitions().keys() - used == set()
    assert definitions().keys() & defined == set()


def test_the_package_uses_all_and_defines_none() -> None:
    nodes = [node for tree in MODULES.values() for node in ast.walk(tree)]
    names = [node for node in nodes if isinstance(node, ast.Name)]
    assert definitions().keys() - {node.id for node in names if isinstance(node.ctx, ast.Load)} == set()
    assert definitions().keys() & {node.id for node in names if isinstance(node.ctx, ast.Store)} == set()


def test_all_come_from_their_own_module() -> None:
    imports = [node for tree in MODULES.values() for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    found = {node.module for node in imports for alias in node.names if alias.name in definitions()}
    assert found == {"clsco.constants"}


def test_no_feature_has_the_name_of_one() -> None:
    assert definitions().keys() & {name for features in PROGRAMS.values() for name in features} == set()


def test_all_are_numbers() -> None:
    assert {type(value) for value in definitions().values()} == {int, float}
