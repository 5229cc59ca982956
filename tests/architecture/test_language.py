"""Docstrings, and comments that head definitions, begin with a noun or a verb; names say what they hold; lines of
kernels are short."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
HOLLOW = ("Of", "What", "Whether", "Which", "Those", "How", "Where", "Who", "Whose", "When")
HOLLOW_NAMES = {"found", "given", "wanted", "told", "kept", "taken"}
FIRST_WORD = re.compile(r"\W*(\w+)")
HEADS = re.compile(r"(?:^//[^\n]*\n)+", re.MULTILINE)  # of a file, a function, a struct or a macro


def entries(text: str) -> Iterator[tuple[int, str]]:
    """Lines and texts of entries in NumPy's sections: what stands, indented, below a parameter, a field or a type."""
    for line, found in docstrings(text):
        for entry in re.finditer(r"\n( *)\S[^\n]*\n\1 {4}(?=(\S[^\n]*))", found):
            yield line + found.count("\n", 0, entry.end()), entry[2]


def docstrings(text: str) -> Iterator[tuple[int, str]]:
    """Lines and texts of docstrings: of modules, classes, functions and attributes."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            yield node.lineno, node.value.value


def heads(text: str) -> Iterator[tuple[int, str]]:
    """Lines and texts of comments that head definitions of a kernel file."""
    for found in HEADS.finditer(text):
        yield text.count("\n", 0, found.start()) + 1, found[0]


def hollow(found: Iterator[tuple[int, str]]) -> list[int]:
    """Lines whose text begins with a word that stands for a noun which is left out."""
    words = ((line, FIRST_WORD.match(text)) for line, text in found)
    return [line for line, word in words if word and word[1] in HOLLOW]


def sources(*folders: str) -> list[Path]:
    return [path for folder in folders for kind in ("py", "cl", "clh") for path in (ROOT / folder).rglob(f"*.{kind}")]


def test_first_words_are_nouns_or_verbs() -> None:
    files = sources("clsco", "kernels", "tests", "benchmarks")
    assert len(files) > 500
    found = {
        f"{path.relative_to(ROOT)}:{line}"
        for path in files
        for find in ((docstrings, entries) if path.suffix == ".py" else (heads,))
        for line in hollow(find(path.read_text("utf-8")))
    }
    assert sorted(found) == []


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ('"""What it does."""', 1),
        ('def f() -> bool:\n    """Whether it is."""', 2),
        ('class A:\n    x: int\n    r"""Of both."""', 3),
        ('"""Limits of a device. What they are for."""\n', None),
    ],
)
def test_a_hollow_docstring_is_found(text: str, line: int | None) -> None:
    assert hollow(docstrings(text)) == ([] if line is None else [line])


def test_a_hollow_entry_is_found() -> None:
    section = "Parameters\n    ----------\n    a : int\n        Of both.\n    b : int\n        Whether."
    text = f'def f() -> None:\n    """Do it.\n\n    {section}\n    """'
    assert hollow(entries(text)) == [7, 9]


def test_a_hollow_head_is_found() -> None:
    assert hollow(heads("int n; // where\n\n// Which one,\n// of all.\nint first(void);\n\n// Sum.\n")) == [3]


def hollow_names(text: str) -> set[str]:
    """Functions, arguments and variables of a file that are named after how a value came, not after what it holds."""
    names = set[str]()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.FunctionDef):
            names.add(node.name)
        elif isinstance(node, ast.arg):
            names.add(node.arg)
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            names.add(node.id)
    return names & HOLLOW_NAMES


def test_names_say_what_they_hold() -> None:
    names = {
        path.relative_to(ROOT).as_posix(): hollow_names(path.read_text("utf-8"))
        for path in sources(*(f"clsco/{package}" for package in ("cli", "files", "frame", "inputs", "scene")))
    }
    assert {path: hollow for path, hollow in names.items() if hollow} == {}


def test_a_hollow_name_is_found() -> None:
    text = "def given(told):\n    for found, wanted in told:\n        kept = found\n    return lambda taken: wanted"
    assert hollow_names(text) == HOLLOW_NAMES


def test_no_line_of_a_kernel_is_too_long() -> None:
    lines = {
        f"{path.relative_to(ROOT)}:{number}": len(line)
        for path in sources("kernels")
        for number, line in enumerate(path.read_text("utf-8").splitlines(), 1)
    }
    assert {place: length for place, length in lines.items() if length > 120} == {}
