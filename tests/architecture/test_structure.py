"""Rules on the modules of the package, whose trees one worker parses: imports run one way, from what a user means to
commands, and each outside library has its place; passes and the engine have all that they work with from the start, and
values keep theirs; a number that host and kernels share stands once, in clsco/constants.py; names say what they hold.
"""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections import defaultdict
from collections.abc import Iterator, Mapping
from graphlib import CycleError, TopologicalSorter

import pytest

from clsco.constants import definitions
from tests.architecture.trees import PACKAGE, ROOT, package_nodes
from tests.kernels.test_programs_build import PROGRAMS

KERNELS = [path.read_text("utf-8") for path in (ROOT / "kernels").rglob("*.cl*")]
OUTER = {"files", "frame", "data", "studio", "cli"}
HOLLOW_NAMES = {"found", "given", "wanted", "told", "kept", "taken"}

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
    "cli.check",
)  # fmt: skip
OUTSIDE = {
    "pyopencl": ("opencl", "inpainting", "passes", "engine"),
    "imageio": ("files.decoders",),
    "imagecodecs": ("files.decoders",),
    "tifffile": ("files.tiff",),
    "OpenEXR": ("files.decoders",),
    "PIL": ("files.tags", "cli.sheets", "frame.contact_sheet", "studio.pictures", "studio.presets"),
    "av": (),
    "starlette": ("studio.guard", "studio.routes", "studio.server"),
    "uvicorn": ("studio.server",),
    "click": ("cli",),
    "rich": ("cli",),
    "numba": ("truth",),
    "colour_demosaicing": (),
    "pydantic": ("scene",),
}


def nodes_of(text: str) -> list[ast.AST]:
    return [*ast.walk(ast.parse(text))]


def nodes_in(*places: str) -> dict[str, list[ast.AST]]:
    """Nodes of each file of some packages, by its path."""
    return {name: nodes for name, nodes in package_nodes().items() if name.split("/")[0] in places}


def nodes_beside(*places: str) -> dict[str, list[ast.AST]]:
    """Nodes of each file but those of some packages and modules, by its path."""
    return {name: nodes for name, nodes in package_nodes().items() if name.split("/")[0] not in places}


def imported(nodes: list[ast.AST], modules: set[str]) -> set[str]:
    """Imports anywhere in a file: names of clsco's modules without "clsco.", and of other packages the first name."""
    found = set()
    for node in nodes:
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


def violations(modules: Mapping[str, list[ast.AST]]) -> list[str]:
    """The rules that a package breaks, given the nodes of each module."""
    found = []
    graph: dict[str, set[str]] = {}
    for name, nodes in modules.items():
        top = name.partition(".")[0]
        if top not in ORDER:
            found.append(f"{name}: must be in the order of packages; got none")
            continue
        graph[name] = set()
        for target in sorted(imported(nodes, set(modules))):
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


def package_modules() -> dict[str, list[ast.AST]]:
    """Nodes by module; of a package those of its `__init__`. The front door is lazy, as test_package.py shows."""
    return {
        name.removesuffix(".py").replace("/", ".").removesuffix(".__init__"): nodes
        for name, nodes in nodes_beside("__init__.py").items()
    }


def test_the_package_keeps_the_rules() -> None:
    assert violations(package_modules()) == []


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
    others = dict.fromkeys(
        ("scene.model", "plan.plan", "engine.render", "opencl.device", "reference.trace"), nodes_of("")
    )
    others["scene.file"] = nodes_of("from clsco.scene.model import Scene")
    assert violations(others) == []
    (found,) = violations(others | {name: nodes_of(text)})
    assert rule in found


def test_everything_but_opencl_works_without_it() -> None:
    modules = [name for name in package_modules() if not is_in(name, ON_OPENCL)]
    assert {"scene.model", "reference.blur.blur", "cli.main", "cli.tables", "frame.provenance"} <= set(modules)
    lines = ["import sys", "sys.modules['pyopencl'] = None", "import clsco"]
    lines += [f"import clsco.{name}" for name in modules]
    subprocess.run([sys.executable, "-c", "\n".join(lines)], check=True, cwd=PACKAGE.parent)


def late(nodes: list[ast.AST]) -> Iterator[str]:
    """Attributes that methods of a class set, and neither its body nor `__init__`."""
    for owner in (node for node in nodes if isinstance(node, ast.ClassDef)):
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


def hidden(nodes: list[ast.AST]) -> Iterator[str]:
    """Ways to change a frozen value, and addresses, which another object may have later, in its place."""
    for node in nodes:
        if isinstance(node, ast.Attribute) and node.attr == "__setattr__":
            yield "__setattr__"
        if isinstance(node, ast.Name) and node.id in ("PrivateAttr", "id") and isinstance(node.ctx, ast.Load):
            yield node.id


def kinds(nodes: list[ast.AST]) -> Iterator[str]:
    """Pupils of which something asks whether a value is one."""
    imports = [node for node in nodes if isinstance(node, ast.ImportFrom) and node.module]
    pupils = [node for node in imports if f"{node.module}.".startswith("clsco.optics.pupils.")]
    known = {name.name for node in pupils for name in node.names}
    for call in (node for node in nodes if isinstance(node, ast.Call) and ast.unparse(node.func) == "isinstance"):
        yield from known & {node.id for node in ast.walk(call.args[1]) if isinstance(node, ast.Name)}


def test_nothing_is_asserted() -> None:
    nodes = [(name, node) for name, nodes in nodes_in("passes", "engine").items() for node in nodes]
    assert {f"{name}:{node.lineno}" for name, node in nodes if isinstance(node, ast.Assert)} == set()


def test_attributes_are_born_with_their_object() -> None:
    files = nodes_in("passes", "engine")
    assert len(files) > 20
    assert {name: found for name, nodes in files.items() if (found := sorted(late(nodes)))} == {}
    text = "class A:\n    def __init__(self): self.a = 1\n    def run(self): self.a = self.b = 2"
    assert [*late(nodes_of(text))] == ["A.b"]


def test_values_are_frozen_and_keys_are_values() -> None:
    """But for free blocks of memory, which are alike, and held as long as their addresses count."""
    ways = {name: found for name, nodes in package_nodes().items() if (found := [*hidden(nodes)])}
    assert ways == {"opencl/pages.py": ["id"]}
    assert [*hidden(nodes_of("object.__setattr__(a, 'b', {id(a): PrivateAttr()})"))]


def test_optics_alone_tells_pupils_apart() -> None:
    others = nodes_beside("optics")
    assert {name: found for name, nodes in others.items() if (found := [*kinds(nodes)])} == {}
    text = "from clsco.optics.pupils.ring import Ring\nisinstance(pupil, Ring | int)"
    assert [*kinds(nodes_of(text))] == ["Ring"]


def test_no_class_outside_of_the_core_has_the_name_of_another() -> None:
    """Passes and the reference, which mirror each other, have some twins."""
    places = defaultdict[str, list[str]](list)
    for name, nodes in package_nodes().items():
        for node in nodes:
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
    names = [node for nodes in nodes_beside("constants.py").values() for node in nodes if isinstance(node, ast.Name)]
    assert definitions().keys() - {node.id for node in names if isinstance(node.ctx, ast.Load)} == set()
    assert definitions().keys() & {node.id for node in names if isinstance(node.ctx, ast.Store)} == set()


def test_all_come_from_their_own_module() -> None:
    nodes = [node for nodes in nodes_beside("constants.py").values() for node in nodes]
    imports = [node for node in nodes if isinstance(node, ast.ImportFrom)]
    found = {node.module for node in imports for alias in node.names if alias.name in definitions()}
    assert found == {"clsco.constants"}


def test_all_are_numbers_and_no_feature_has_the_name_of_one() -> None:
    assert {type(value) for value in definitions().values()} == {int, float}
    assert definitions().keys() & {name for features in PROGRAMS.values() for name in features} == set()


def hollow_names(nodes: list[ast.AST]) -> set[str]:
    """Functions, arguments and variables of a file that are named after how a value came, not after what it holds."""
    names = set[str]()
    for node in nodes:
        if isinstance(node, ast.FunctionDef):
            names.add(node.name)
        elif isinstance(node, ast.arg):
            names.add(node.arg)
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            names.add(node.id)
    return names & HOLLOW_NAMES


def test_names_say_what_they_hold() -> None:
    core = ("optics", "truth", "plan", "opencl", "passes", "engine", "reference")
    files = nodes_in("cli", "files", "frame", "inputs", "scene", *core)
    assert {name: hollow for name, nodes in files.items() if (hollow := hollow_names(nodes))} == {}


def test_a_hollow_name_is_found() -> None:
    text = "def given(told):\n    for found, wanted in told:\n        kept = found\n    return lambda taken: wanted"
    assert hollow_names(nodes_of(text)) == HOLLOW_NAMES
