"""Docstrings, and comments that head definitions, begin with a noun or a verb, and point to files and definitions that
exist; lines of kernels are short."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import pytest

from tests.architecture.trees import ROOT, docstrings

HOLLOW = ("Of", "What", "Whether", "Which", "Those", "How", "Where", "Who", "Whose", "When")
FIRST_WORD = re.compile(r"\W*(\w+)")
HEADS = re.compile(r"(?:^//[^\n]*\n)+", re.MULTILINE)  # of a file, a function, a struct or a macro


def entries(text: str) -> Iterator[tuple[int, str]]:
    """Lines and texts of entries in NumPy's sections: what stands, indented, below a parameter, a field or a type."""
    for line, found in docstrings(text):
        for entry in re.finditer(r"\n( *)\S[^\n]*\n\1 {4}(?=(\S[^\n]*))", found):
            yield line + found.count("\n", 0, entry.end()), entry[2]


def heads(text: str) -> Iterator[tuple[int, str]]:
    """Lines and texts of comments that head definitions of a kernel file."""
    for found in HEADS.finditer(text):
        yield text.count("\n", 0, found.start()) + 1, found[0]


def hollow(found: Iterable[tuple[int, str]]) -> list[int]:
    """Lines whose text begins with a word that stands for a noun which is left out."""
    words = ((line, FIRST_WORD.match(text)) for line, text in found)
    return [line for line, word in words if word and word[1] in HOLLOW]


@cache
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


def test_no_line_of_a_kernel_is_too_long() -> None:
    lines = {
        f"{path.relative_to(ROOT)}:{number}": len(line)
        for path in sources("kernels")
        for number, line in enumerate(path.read_text("utf-8").splitlines(), 1)
    }
    assert {place: length for place, length in lines.items() if length > 120} == {}


KERNELS = [path for path in sources("kernels") if path.suffix != ".py"]
MODULES = [path.relative_to(ROOT).with_suffix("").as_posix() for path in sources("clsco")]
MODULES = [name.removesuffix("/__init__").replace("/", ".") for name in MODULES]
PATH = r"(?:(?:clsco|kernels|tests|benchmarks|docs|examples)/[\w/]+\.[a-z]+|(?:\w+/)*\w+\.clh?)\b"
NAME = r"(`\w+`|\w+_\w+|[A-Z]\w*[A-Z]\w*)"  # bare words are left alone, unless they can only be identifiers
FILE = re.compile(rf"(?<![\w/.]){PATH}")
DOTTED = re.compile(r"`((?:\w+\.)+(?!jsonl?`)\w+)")
NAMED = re.compile(rf"{NAME} (?:of|in) ({PATH})")
SEEN = re.compile(rf"\b[Ss]ee {NAME}(?!\w|\.\w| (?:of|in) )")


def prose(path: Path, text: str) -> str:
    """Comments and docstrings in one line."""
    comments = re.sub(r"\n *(?://|#) ?", " ", "\n".join(re.findall(r"(?://|#) .*", text)))
    found = [comments, *(text for _, text in docstrings(text))] if path.suffix == ".py" else [comments]
    return " ".join(" ".join(found).split())


def is_file(name: str) -> bool:
    return name in _ends() or (ROOT / name).exists()


@cache
def _ends() -> set[str]:
    """Ends of the paths of kernels and tests, by which comments name these."""
    parts = [path.relative_to(ROOT).parts for path in sources("kernels", "tests")]
    return {"/".join(names[start:]) for names in parts for start in range(1, len(names))}


def defines(path: Path, name: str) -> bool:
    """True if a file of Python or OpenCL C defines or imports a name."""
    name = name.strip("`")
    python = rf"^\s*(?:async )?(?:def|class) {name}\b|^\s*{name}\b.*[:=]|^from \S+ import (?:\([^)]*|.*)\b{name}\b"
    device = rf"#\s*define {name}\b|^}} {name};|^typedef .*\b{name};|^[A-Za-z_][\w *()]*\b{name}\("
    return re.search(python if path.suffix == ".py" else device, path.read_text("utf-8"), re.MULTILINE) is not None


def leads(name: str) -> bool:
    """True if a dotted name leads from `clsco`, or from a module of it, to a definition; names of others do."""
    first, *rest = name.split(".")
    starts = [first] if first == "clsco" else [module for module in MODULES if module.endswith(f".{first}")]
    return not starts or any(_has(import_module(start), rest) for start in starts)


def _has(found: object, rest: list[str]) -> bool:
    for part in rest:
        module = f"{getattr(found, '__name__', '')}.{part}"
        if hasattr(found, "__path__") and not hasattr(found, part) and find_spec(module):
            found = import_module(module)
        elif part in getattr(found, "__annotations__", ()) or hasattr(found, part):
            found = getattr(found, part, None)
        else:
            return False
    return True


def lost(path: Path, text: str) -> list[str]:
    """Signposts of a file that lead nowhere."""
    words = prose(path, text)
    found = [name for name in FILE.findall(words) if not is_file(name)]
    found += [name for name in DOTTED.findall(words) if path.suffix == ".py" and not leads(name)]
    places = [path] if path.suffix == ".py" else KERNELS
    found += [name for name in SEEN.findall(words) if not any(defines(place, name) for place in places)]
    for name, file in NAMED.findall(words):
        places = [place for place in (ROOT / file, *KERNELS) if place.as_posix().endswith(f"/{file}")]
        found += [f"{name} of {file}"] * (not any(place.exists() and defines(place, name) for place in places))
    return found


def test_signposts_lead_to_files_and_definitions() -> None:
    paths = [*sources("clsco", "tests", "benchmarks"), *KERNELS]
    paths.remove(Path(__file__))
    assert [f"{path.relative_to(ROOT)}: {name}" for path in paths for name in lost(path, path.read_text("utf-8"))] == []


@pytest.mark.parametrize(
    ("name", "text", "wrong"),
    [
        ("a.clh", "// Twin: clsco/truth/gone.py. Host:\n// clsco/passes/trace.py.\n", "clsco/truth/gone.py"),
        ("a.clh", "// As in aim.cl and gone.cl.\n", "gone.cl"),
        ("a.clh", "// see tilt_slope, see PsfGrid in clsco/optics/lens.py\n", "PsfGrid of clsco/optics/lens.py"),
        ("a.clh", "// see gone_slope\n", "gone_slope"),
        ("a.py", '"""Arguments as for `clsco.render`; `clsco.optics.lens.gone`."""', "clsco.optics.lens.gone"),
        ("a.py", '"""A plane, see `f`; a\nplane, see `gone`."""\ndef f() -> int: ...\n', "`gone`"),
        ("a.py", "# of\n# kernels/gone.cl\n", "kernels/gone.cl"),
    ],
)
def test_a_lost_signpost_is_found(tmp_path: Path, name: str, text: str, wrong: str) -> None:
    path = tmp_path / name
    path.write_text(text)
    assert lost(path, text) == [wrong]
