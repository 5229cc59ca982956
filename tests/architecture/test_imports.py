"""Imports run one way, from what a user means to commands, and each outside library has its place."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Mapping
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parents[2] / "clsco"

# A package or module imports only what stands before it.
ORDER = (
    "cache", "constants", "errors", "resources", "records", "scene", "optics", "files", "frame", "inputs",
    "truth", "plan", "opencl", "inpainting", "passes", "engine", "reference", "data", "studio", "cli", "__main__",
)  # fmt: skip
# Narrower than the order: what knows OpenCL knows no scenes, and codecs know none either.
ONLY = {
    "files": {"errors", "resources"},
    "opencl": {"cache", "constants", "errors", "resources", "records"},
    "records": set[str](),
    "truth": {"errors", "files", "frame", "inputs", "resources", "scene"},  # and no formula of what it judges
}
ON_OPENCL = (
    "opencl", "passes", "engine", "inpainting", "data.shards", "data.verify",
    "cli.check", "cli.check_scene", "cli.plan_time", "cli.warm",
)  # fmt: skip
OUTSIDE = {
    "pyopencl": ("opencl", "inpainting", "passes", "engine"),
    "imageio": ("files.decoders",),
    "imagecodecs": ("files.decoders",),
    "tifffile": ("files.tiff",),
    "OpenEXR": ("files.decoders",),
    "PIL": (
        "files.tags",
        "cli.demo",
        "cli.psf_sheet",
        "frame.contact_sheet",
        "studio.pictures",
        "studio.presets",
    ),
    "av": (),
    "starlette": ("studio.guard", "studio.routes", "studio.server"),
    "uvicorn": ("studio.server",),
    "click": ("cli",),
    "rich": ("cli",),
    "matplotlib": ("inpainting.report",),
    "numba": ("truth",),
    "colour_demosaicing": (),
    "pydantic": ("scene",),
}


def imported(text: str, modules: set[str]) -> set[str]:
    """Imports anywhere in a file: names of clsco's modules without "clsco.", and of other packages the first name."""
    found = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"line {node.lineno}: imports are absolute"
            inside = [f"{node.module}.{alias.name}" for alias in node.names]
            names = [name if name.removeprefix("clsco.") in modules else node.module or "" for name in inside]
        else:
            continue
        for name in names:
            first, _, rest = name.partition(".")
            found.add(rest if first == "clsco" else first)
    return found - {""}


def is_in(module: str, places: tuple[str, ...]) -> bool:
    return any(f"{module}.".startswith(f"{place}.") for place in places)


def violations(texts: Mapping[str, str]) -> list[str]:
    """The rules that a package breaks, given the text of each module."""
    found = []
    graph: dict[str, set[str]] = {}
    for name, text in texts.items():
        top = name.partition(".")[0]
        if top not in ORDER:
            found.append(f"{name}: must be in the order of packages; got none")
            continue
        graph[name] = set()
        for target in sorted(imported(text, set(texts))):
            other = target.partition(".")[0]
            if target in OUTSIDE and not is_in(name, OUTSIDE[target]):
                found.append(f"{name}: {target} is for {', '.join(OUTSIDE[target])} only")
            if other not in ORDER:
                continue
            graph[name].add(target)
            if ORDER.index(other) > ORDER.index(top):
                found.append(f"{name}: must not import {target}, which comes later")
            elif other != top and other not in ONLY.get(top, {other}):
                found.append(f"{name}: must know {', '.join(sorted(ONLY[top]))} only; got {target}")
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        found.append(f"imports must not go round in a circle; got {' -> '.join(error.args[1])}")
    return found


def package_texts() -> dict[str, str]:
    """Text by module; of a package that of its `__init__`. The front door is lazy, as test_package.py shows."""
    return {
        ".".join(path.relative_to(PACKAGE).with_suffix("").parts).removesuffix(".__init__"): path.read_text("utf-8")
        for path in sorted(PACKAGE.rglob("*.py"))
        if path != PACKAGE / "__init__.py"
    }


def test_the_package_keeps_the_rules() -> None:
    texts = package_texts()
    assert len(texts) > 10
    assert violations(texts) == []


def test_the_top_of_the_package_is_small() -> None:
    modules = [path.stem for path in PACKAGE.glob("*.py")]
    assert len(modules) <= 7  # with __main__
    assert {path.parent.name for path in PACKAGE.glob("*/__init__.py")} | set(modules) == {*ORDER, "__init__"}


@pytest.mark.parametrize(
    ("name", "text", "rule"),
    [
        ("scene.model", "def f():\n    from pyopencl.tools import x", "pyopencl is for"),
        ("frame.frame", "import imageio.v3", "imageio is for files.decoders only"),
        ("optics.lens", "from clsco.plan.plan import Plan", "must not import plan.plan, which comes later"),
        ("optics.lens", "from clsco.plan import plan", "must not import plan.plan, which comes later"),
        ("plan.plan", "import clsco.engine.render", "must not import engine.render, which comes later"),
        ("engine.render", "from clsco.reference.trace import trace", "must not import reference.trace"),
        ("opencl.program", "from clsco.scene.model import Scene", "must know cache, constants, errors"),
        ("scene.model", "from clsco.scene.file import load_scene", "circle"),
        ("extra", "", "extra: must be in the order of packages"),
    ],
)
def test_a_broken_rule_is_found(name: str, text: str, rule: str) -> None:
    others = dict.fromkeys(("scene.model", "plan.plan", "engine.render", "opencl.device", "reference.trace"), "")
    others["scene.file"] = "from clsco.scene.model import Scene"
    assert violations(others) == []
    (found,) = violations(others | {name: text})
    assert rule in found


def test_everything_but_opencl_works_without_it() -> None:
    modules = [name for name in package_texts() if not is_in(name, ON_OPENCL)]
    assert {"scene.model", "reference.blur.blur", "cli.main", "cli.tables", "frame.provenance"} <= set(modules)
    lines = ["import sys", "sys.modules['pyopencl'] = None", "import clsco"]
    lines += [f"import clsco.{name}" for name in modules]
    subprocess.run([sys.executable, "-c", "\n".join(lines)], check=True, cwd=PACKAGE.parent)
