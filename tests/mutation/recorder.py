"""Recorder of the launches of each test: which kernels of which program texts."""

from __future__ import annotations

import json
import re
import subprocess
import time
from collections import defaultdict
from collections.abc import Callable, Generator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyopencl as cl
import pytest

from tests.mutation.switched import Switches

CONDITION, GIVEN = re.compile(r"^\s*#\s*(?:el)?if.*", re.MULTILINE), re.compile(r"\b__[A-Z]\w+")


class Launches:
    """Records from now on which kernels of which programs are launched; now: by whom.

    plain: of a program's text that which `clsco.opencl.source_text.program_text` has made.
    """

    def __init__(self, plain: Callable[[str], str] = str) -> None:
        from clsco.opencl import program

        self.now = ""
        self.programs: dict[str, int] = {}
        self.launched: dict[str, set[tuple[int, str]]] = defaultdict(set)
        places: dict[cl.Kernel, int] = {}
        built, call = program._built, cl.Kernel.__call__

        def recorded_program(session: Any, where: str, text: str, options: list[str]) -> Any:
            found = built(session, where, text, options)
            asked = [*options, *_defined(session, text)]
            place = self.programs.setdefault(json.dumps([asked, plain(text)]), len(self.programs))
            places.update(dict.fromkeys(found.values(), place))
            return found

        def recorded_launch(kernel: Any, *args: Any, **options: Any) -> Any:
            if kernel in places:
                self.launched[self.now].add((places[kernel], kernel.function_name))
            return call(kernel, *args, **options)

        program._built = recorded_program
        cl.Kernel.__call__ = recorded_launch  # type: ignore[method-assign,assignment]

    def write(self, path: Path, tests: dict[str, dict[str, Any]], left_out: Sequence[int] = ()) -> None:
        """tests: `slow`, `seconds`, `elsewhere`, `launched`; left_out: see `Recorder`."""
        programs = [json.loads(program) for program in self.programs]
        path.write_text(json.dumps({"programs": programs, "tests": tests, "left_out": left_out}), "utf-8")


class Recorder:
    """Plugin of pytest that writes a file when the tests end: {"programs": [[options, text]], "tests": {test: what}}.

    what: `slow`, `seconds`, `launched` as pairs of the program's place and the kernel's name, and `elsewhere` where the
    test starts processes, of which nothing is known. What a fixture of several tests launches, all of them launch.
    Where kernels have switches, texts are those without, and `left_out` are mutants with which programs do not build.
    """

    def __init__(self, path: Path, switches: Switches | None) -> None:
        self.path, self.switches = path, switches
        if switches is not None:
            _build_without(switches)
        self.launches = Launches(switches.unswitched if switches else str)
        self.tests: dict[str, dict[str, Any]] = {}
        self.elsewhere: set[str] = set()
        popen = subprocess.Popen.__init__

        def recorded_process(process: Any, *args: Any, **options: Any) -> None:
            self.elsewhere.add(self.launches.now)
            popen(process, *args, **options)

        subprocess.Popen.__init__ = recorded_process  # type: ignore[method-assign,assignment]

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Generator[None, object, object]:
        self.launches.now, begun = item.nodeid, time.monotonic()
        result = yield
        names = [item.nodeid, *(_fixture(item, name) for name in getattr(item, "fixturenames", ()))]
        self.tests[item.nodeid] = {
            "slow": item.get_closest_marker("slow") is not None,
            "seconds": time.monotonic() - begun,
            "elsewhere": any(name in self.elsewhere for name in names),
            "launched": sorted(set[tuple[int, str]]().union(*(self.launches.launched[name] for name in names))),
        }
        return result

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef: Any, request: pytest.FixtureRequest) -> Generator[None, object, object]:
        before = self.launches.now
        if fixturedef.scope != "function":
            self.launches.now = _fixture(request.node, fixturedef.argname)
        result = yield
        self.launches.now = before
        return result

    def pytest_sessionfinish(self) -> None:
        left_out = sorted(self.switches.left_out) if self.switches else []
        self.launches.write(self.path, self.tests, left_out)


def _defined(session: Any, text: str) -> list[str]:
    """Options for the macros of a text's conditions that the device's compiler has, as __AVX2__: others may differ."""
    names = sorted({name for line in CONDITION.findall(text) for name in GIVEN.findall(line)})
    lines = [f"#ifdef {name}\nout[{place}] = 1;\n#endif" for place, name in enumerate(names)]
    source = "\n".join(["__kernel void tell(__global int *out)\n{", *lines, "}"])
    there = np.zeros(len(names) + 1, np.int32)
    out = cl.Buffer(session.context, cl.mem_flags.COPY_HOST_PTR, hostbuf=there)
    cl.Program(session.context, source).build().tell(session.queue, (1,), None, out)
    cl.enqueue_copy(session.queue, there, out)
    return [f"-D{name}" for name, defined in zip(names, there.tolist(), strict=False) if defined]


def _build_without(switches: Switches) -> None:
    """Have programs that do not build leave mutants out, in the tree of this process as well."""
    from clsco.errors import KernelError
    from clsco.opencl import program

    built = program._built

    def tried(session: Any, where: str, text: str, options: list[str]) -> Any:
        while True:
            try:
                return built(session, where, text, options)
            except KernelError as error:
                again = switches.without(text, str(error))
                if again is None:
                    raise
                text = again
                switches.write(Path.cwd())

    program._built = tried


def _fixture(node: Any, name: str) -> str:
    return f"{node.nodeid.split('::')[0]}::fixture {name}"
