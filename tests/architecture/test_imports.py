"""Imports run one way, from scene file to files, and each outside library has its place."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parents[2] / "clsco"

# A module imports from the layers above its own line only.
LAYERS = (
    ("errors", "resources", "poclcache", "poclcpu", "transfer", "png", "quantities", "holes", "waves"),
    ("files", "shapes", "frame", "strips", "estimators"),
    ("scene",),
    ("optics", "psf", "motion", "images", "scenefile"),
    ("stencil", "slabs"),
    ("surfaces", "textures", "depthmaps", "sweep", "framefiles", "coarsening"),
    ("occlusion", "maptruth"),
    ("layout",),
    ("plan",),
    ("memory",),
    ("reference",),
    ("device",),
    ("program", "arrays"),
    ("inpainting",),
    ("convolution",),
    ("spread", "stillmap"),
    ("coarse",),
    ("layers",),
    ("defocus", "forward"),
    ("renderer",),
    ("render",),
    ("describe", "demo", "defocus_command", "inpaint_command"),
    ("batch", "check", "bench"),
    ("show",),
    ("cli",),
)
# What knows OpenCL knows nothing of scenes.
ONLY = {
    "poclcache": set[str](),
    "poclcpu": set[str](),
    "device": {"errors", "poclcache", "poclcpu"},
    "program": {"errors", "resources", "device"},
}
IMPORTS_REFERENCE = {"check", "bench"}
OPENCL = {
    "device", "arrays", "program", "inpainting", "convolution", "spread", "coarse", "layers", "defocus", "forward",
    "renderer", "stillmap",
}  # fmt: skip
ON_OPENCL = {"render", "batch", "check", "bench"}
IMAGES = {"images"}
OUTSIDE = {
    "pyopencl": OPENCL | {"bench"},
    "imageio": IMAGES,
    "imagecodecs": IMAGES,
    "tifffile": IMAGES,
    "OpenEXR": IMAGES,
    "PIL": IMAGES | {"demo"},
    "click": {"cli"},
    "rich": {"cli", "show", "bench"},
    "matplotlib": {"bench", "inpainting"},
    "numba": {"bench"},
    "cv2": {"bench"},
    "mpmath": {"bench"},
    "pydantic": {"quantities", "shapes", "scene", "scenefile"},
}


def imported(text: str, modules: set[str]) -> set[str]:
    """What a file imports anywhere in it: "clsco.x" for the package's modules, the first name for others."""
    found = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"line {node.lineno}: imports are absolute"
            inside = [f"clsco.{alias.name}" for alias in node.names if alias.name in modules]
            names = inside if node.module == "clsco" else [node.module or ""]
        else:
            continue
        for name in names:
            parts = name.split(".")
            found.add(".".join(parts[:2]) if parts[0] == "clsco" else parts[0])
    return found


def violations(texts: Mapping[str, str]) -> list[str]:
    """The rules that a package breaks, given the text of each module (of `reference`: "reference.x")."""
    rank = {module: layer for layer, modules in enumerate(LAYERS) for module in modules}
    names = {name.partition(".")[0] for name in texts}
    found = [f"{name}: must have a layer; got none" for name in sorted(names - rank.keys())]
    for name, text in texts.items():
        top = name.partition(".")[0]
        for target in sorted(imported(text, names)):
            if target in OUTSIDE and top not in OUTSIDE[target]:
                found.append(f"{name}: {target} is for {', '.join(sorted(OUTSIDE[target]))} only")
            other = target.removeprefix("clsco.")
            if other in (target, top) or top not in rank:
                continue
            if rank.get(other, -1) >= rank[top]:
                found.append(f"{name}: must not import {other}, which is not above it")
            elif other == "reference" and top not in IMPORTS_REFERENCE:
                found.append(f"{name}: reference is for {', '.join(sorted(IMPORTS_REFERENCE))} only")
            elif other not in ONLY.get(top, {other}):
                found.append(f"{name}: must know {', '.join(sorted(ONLY[top]))} only; got {other}")
    return found


def package_texts() -> dict[str, str]:
    return {
        ".".join(path.relative_to(PACKAGE).with_suffix("").parts): path.read_text("utf-8")
        for path in sorted(PACKAGE.rglob("*.py"))
        if path != PACKAGE / "__init__.py"  # lazy, and shown to be so in test_package.py
    }


def test_the_package_keeps_the_rules() -> None:
    texts = package_texts()
    assert len(texts) > 10
    assert violations(texts) == []


@pytest.mark.parametrize(
    ("name", "text", "rule"),
    [
        ("scene", "import pyopencl as cl", "pyopencl is for"),
        ("scene", "def f():\n    from pyopencl.tools import x", "pyopencl is for"),
        ("reference.blur", "import pyopencl", "pyopencl is for"),
        ("frame", "import imageio.v3", "imageio is for images only"),
        ("plan", "import click", "click is for cli only"),
        ("scene", "from clsco.scenefile import load_scene", "scene: must not import scenefile"),
        ("optics", "from clsco import psf", "optics: must not import psf"),
        ("plan", "import clsco.render", "plan: must not import render"),
        ("render", "from clsco.reference.trace import trace", "render: reference is for bench, check only"),
        ("reference.blur", "from clsco.device import choose", "must not import device"),
        (
            "program",
            "from clsco.scene import Scene",
            "program: must know device, errors, resources only; got scene",
        ),
        ("extra", "", "extra: must have a layer"),
    ],
)
def test_a_broken_rule_is_noticed(name: str, text: str, rule: str) -> None:
    others = dict.fromkeys(("scene", "scenefile", "psf", "render", "device", "reference.trace"), "")
    assert violations(others) == []
    (found,) = violations(others | {name: text})
    assert rule in found


def test_allowed_imports_pass() -> None:
    texts = {
        "cli": "import click\nfrom clsco import __version__\nfrom clsco.check import compare_frames",
        "check": "from clsco import reference\nfrom clsco.render import render",
        "render": "from clsco.renderer import Renderer",
        "renderer": "import pyopencl\nfrom clsco.plan import make_plan",
        "plan": "",
        "reference.__init__": "from clsco.reference.render import render",
        "reference.render": "from clsco.plan import make_plan",
    }
    assert violations(texts) == []


def test_everything_but_opencl_works_without_it() -> None:
    modules = [name for name in package_texts() if name.partition(".")[0] not in OPENCL | ON_OPENCL]
    assert {"scene", "reference.blur", "cli", "show", "describe"} <= set(modules)
    lines = ["import sys", "sys.modules['pyopencl'] = None", "import clsco"]
    lines += [f"import clsco.{name.removesuffix('.__init__')}" for name in modules]
    subprocess.run([sys.executable, "-c", "\n".join(lines)], check=True, cwd=PACKAGE.parent)
