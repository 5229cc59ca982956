"""What each test launches: which kernels of which program texts."""

from __future__ import annotations

import json
import subprocess
import time
from collections import defaultdict
from collections.abc import Generator
from pathlib import Path
from typing import Any

import pyopencl as cl
import pytest


class Recorder:
    """Plugin of pytest that writes a file when the tests end: {"programs": [[options, text]], "tests": {test: what}}.

    what: `slow`, `seconds`, `launched` as pairs of the program's place and the kernel's name, and `elsewhere` where the
    test starts processes, of which nothing is known. What a fixture of several tests launches, all of them launch.
    """

    def __init__(self, path: Path) -> None:
        from clsco import program

        self.path, self.now = path, ""
        self.programs: dict[str, int] = {}
        self.tests: dict[str, dict[str, Any]] = {}
        self.launched: dict[str, set[tuple[int, str]]] = defaultdict(set)  # by test or fixture
        self.elsewhere: set[str] = set()
        places: dict[cl.Kernel, int] = {}
        built, call, popen = program._built, cl.Kernel.__call__, subprocess.Popen.__init__

        def noted_program(session: Any, where: str, text: str, options: list[str]) -> Any:
            found = built(session, where, text, options)
            place = self.programs.setdefault(json.dumps([options, text]), len(self.programs))
            places.update(dict.fromkeys(found.values(), place))
            return found

        def noted_launch(kernel: Any, *args: Any, **options: Any) -> Any:
            if kernel in places:
                self.launched[self.now].add((places[kernel], kernel.function_name))
            return call(kernel, *args, **options)

        def noted_process(process: Any, *args: Any, **options: Any) -> None:
            self.elsewhere.add(self.now)
            popen(process, *args, **options)

        program._built = noted_program
        cl.Kernel.__call__ = noted_launch  # type: ignore[method-assign,assignment]
        subprocess.Popen.__init__ = noted_process  # type: ignore[method-assign,assignment]

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Generator[None, object, object]:
        self.now, begun = item.nodeid, time.monotonic()
        result = yield
        names = [item.nodeid, *(_fixture(item, name) for name in getattr(item, "fixturenames", ()))]
        self.tests[item.nodeid] = {
            "slow": item.get_closest_marker("slow") is not None,
            "seconds": time.monotonic() - begun,
            "elsewhere": any(name in self.elsewhere for name in names),
            "launched": sorted(set[tuple[int, str]]().union(*(self.launched[name] for name in names))),
        }
        return result

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef: Any, request: pytest.FixtureRequest) -> Generator[None, object, object]:
        before = self.now
        if fixturedef.scope != "function":
            self.now = _fixture(request.node, fixturedef.argname)
        result = yield
        self.now = before
        return result

    def pytest_sessionfinish(self) -> None:
        programs = [json.loads(program) for program in self.programs]
        self.path.write_text(json.dumps({"programs": programs, "tests": self.tests}), "utf-8")


def _fixture(node: Any, name: str) -> str:
    return f"{node.nodeid.split('::')[0]}::fixture {name}"
