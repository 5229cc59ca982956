"""Examples in docstrings run, and public functions and their classes have one."""

from __future__ import annotations

import doctest
import inspect
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

import clsco
import clsco.data
from clsco import reference
from tests.architecture.test_language import sources
from tests.architecture.trees import ROOT
from tests.data.samples import make_set

PUBLIC = {
    f"{module.__name__}.{name}": getattr(module, name)
    for module in (clsco, clsco.data, reference)
    for name in module.__all__
}
MODULES = [
    ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
    for path in sources("clsco")
    if ">>> " in path.read_text("utf-8")
]


def examples(found: Any) -> Iterator[doctest.DocTest]:
    return (test for test in doctest.DocTestFinder().find(found) if test.examples)


@pytest.mark.parametrize("name", [name for name, found in PUBLIC.items() if inspect.isfunction(found)])
def test_a_public_function_has_an_example(name: str) -> None:
    assert ">>> " in (PUBLIC[name].__doc__ or "")


@pytest.mark.parametrize(
    "name", ["clsco.Scene", "clsco.Frame", "clsco.Live", "clsco.MeanMedian", "clsco.data.Dataset", "clsco.data.Record"]
)
def test_a_class_with_methods_has_an_example(name: str) -> None:
    assert any(examples(PUBLIC[name]))


@pytest.mark.parametrize("module", MODULES)
def test_examples_run(module: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if module.startswith("clsco.data"):
        make_set(tmp_path / "DATA", "npz")
        make_set(tmp_path / "STACKS", "npz", count=1, variants=5)
    monkeypatch.chdir(tmp_path)
    runner = doctest.DocTestRunner(optionflags=doctest.IGNORE_EXCEPTION_DETAIL)
    for test in examples(import_module(module)):
        test.globs = {"__file__": test.filename}  # an example imports what it takes
        report: list[str] = []
        runner.run(test, out=report.append)
        assert report == [], "".join(report)
