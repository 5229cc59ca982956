"""Comments and docstrings point to files and definitions that exist."""

from __future__ import annotations

import re
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import pytest

from tests.architecture.test_language import ROOT, docstrings, sources

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
    return (ROOT / name).exists() or any(path.as_posix().endswith(f"/{name}") for path in sources("kernels", "tests"))


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
        (
            "a.clh",
            "// Twin: clsco/reference/trace/gone.py. Host:\n// clsco/passes/trace.py.\n",
            "clsco/reference/trace/gone.py",
        ),
        ("a.clh", "// As in trace.cl and gone.cl.\n", "gone.cl"),
        (
            "a.clh",
            "// see tilt_slope, see PsfGrid in clsco/optics/psf_grid.py\n",
            "PsfGrid of clsco/optics/psf_grid.py",
        ),
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
