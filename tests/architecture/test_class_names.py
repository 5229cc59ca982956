"""Class names: outside of the core each is there once, so that a name says which class is meant."""

from __future__ import annotations

import ast
from collections import defaultdict
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[2] / "clsco"
OUTER = {"files", "frame", "data", "studio", "cli"}


def classes(text: str) -> list[str]:
    return [node.name for node in ast.walk(ast.parse(text)) if isinstance(node, ast.ClassDef)]


def test_no_class_outside_of_the_core_has_the_name_of_another() -> None:
    """Passes and the reference, which mirror each other, have some twins."""
    places = defaultdict[str, list[str]](list)
    for path in PACKAGE.rglob("*.py"):
        for name in classes(path.read_text("utf-8")):
            places[name].append(path.relative_to(PACKAGE).as_posix())
    assert len(places) > 300
    twice = {name: found for name, found in places.items() if len(found) > 1}
    assert {name: found for name, found in twice.items() if {place.split("/")[0] for place in found} & OUTER} == {}


def test_classes_anywhere_in_a_file_are_found() -> None:
    assert classes("class A: ...\ndef f():\n    class B: ...\n") == ["A", "B"]
