"""Tests that are collected once and run many times, each time in a fork; kernels are read when they run."""

from __future__ import annotations

import os
import signal
import sys
import warnings
from collections.abc import Sequence
from contextlib import suppress
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, BinaryIO

import pyopencl as cl
import pytest

from tests.mutation.memo import remember
from tests.mutation.recorder import Recorder
from tests.mutation.switched import Switches, reserve, turn_on

Programs = Sequence[tuple[list[str], str]]  # options and text
# Processes begin with what all tests import but the package itself.
STARTED = get_context("forkserver")
STARTED.set_forkserver_preload(["numpy", "pyopencl", "pydantic", "imageio.v3", "scipy.special", "pytest"])


class Forks:
    """Plugin of pytest: when its tests are collected, each question is answered by a fork that runs them.

    PoCL reads its library of functions once for all forks, 0.4 s; its device `basic` has no threads that a fork misses.
    """

    def __init__(self, asked: Connection, output: BinaryIO, switches: Switches | None, programs: Programs) -> None:
        self.asked, self.output, self.switches, self.programs = asked, output, switches, programs

    def pytest_runtestloop(self, session: pytest.Session) -> None:
        """Fork for each list of tests, or for each file to record all of them in; go on in the fork."""
        queue = _prepared()
        _build_once(queue.context, self.programs)
        while True:
            wanted, number = self.asked.recv()
            self.output.seek(0)
            self.output.truncate()
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", DeprecationWarning)  # threads of NumPy, which are idle here
                child = os.fork()
            if child == 0:
                os.setsid()
                _work_in(queue)
                if self.switches is not None:
                    turn_on(number)
                if isinstance(wanted, Path):
                    session.config.pluginmanager.register(Recorder(wanted, self.switches))
                else:
                    items = {item.nodeid: item for item in session.items}
                    session.items[:] = [items[name] for name in wanted]
                return
            self.asked.send(child)
            self.asked.send(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))


def _prepared() -> cl.CommandQueue:
    """A queue of a context that has built a program."""
    from clsco.opencl import device
    from clsco.opencl.session import Session

    session = Session(device.choose("pocl"))
    cl.Program(session.context, "__kernel void nothing() {}").build()
    return session.queue


def _work_in(shared: cl.CommandQueue) -> None:
    """Have all sessions of this process, a fork, work in that queue's context."""
    from clsco.opencl import device
    from clsco.opencl import session as sessions

    opened = sessions.Session.__init__

    def initialize(session: Any, chosen: device.Device, queue: cl.CommandQueue | None = None) -> None:
        timed = cl.command_queue_properties.PROFILING_ENABLE
        opened(session, chosen, queue or cl.CommandQueue(shared.context, properties=timed))

    device._process = os.getpid()
    sessions.Session.__init__ = initialize  # type: ignore[method-assign,assignment]


def _build_once(context: cl.Context, programs: Programs) -> None:
    """Have these programs be built now, for all forks."""
    from clsco.opencl import program

    built = {
        (tuple(options), text): {kernel.function_name: kernel for kernel in _kernels(context, options, text)}
        for options, text in programs
    }
    build = program._built

    def found(session: Any, where: str, text: str, options: list[str]) -> Any:
        return built.get((tuple(options), text)) or build(session, where, text, options)

    program._built = found


def _kernels(context: cl.Context, options: list[str], text: str) -> list[cl.Kernel]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", cl.CompilerWarning)
        return cl.Program(context, text).build(options).all_kernels()


def collect(
    tree: Path,
    cache: Path,
    output: Path,
    arguments: list[str],
    asked: Connection,
    switches: Switches | None,
    programs: Programs,
) -> None:
    """In a process of its own: collect tests in a copy of the tree, and have forks run them."""
    os.setsid()
    os.chdir(tree)
    os.environ["POCL_CACHE_DIR"], os.environ["PYTHONPATH"] = str(cache), str(tree)
    os.environ["POCL_DEVICES"] = "basic"
    with open(output, "wb", buffering=0) as file:
        os.dup2(file.fileno(), 1)
        os.dup2(file.fileno(), 2)
        for name in [name for name in sys.modules if name.split(".")[0] == "tests"]:
            del sys.modules[name]
        sys.path.insert(0, str(tree))
        sys.dont_write_bytecode = True
        if switches is not None:
            reserve()
            remember(cache)
        status = int(pytest.main(arguments, plugins=[Forks(asked, file, switches, programs)]))
        sys.stdout.flush()
    os._exit(status)


class Collected:
    """Tests of some files of a copy.

    marked: which ones, as pytest's -m. switches: those in the copy's kernels. programs: which ones they build.
    """

    def __init__(
        self,
        tree: Path,
        cache: Path,
        output: Path,
        files: Sequence[str],
        marked: str,
        switches: Switches | None,
        programs: Programs = (),
    ) -> None:
        plugins = ["-p", "no:cacheprovider", "-p", "no:hypothesispytest"]  # which is read by each fork, 1 s
        options = ["-x", "-q", "--tb=line", "-rf", "-n", "0", *plugins, "-m", marked]
        self.pipe, theirs = STARTED.Pipe()
        arguments = (tree, cache, output, [*options, *files], theirs, switches, programs)
        self.process = STARTED.Process(target=collect, args=arguments, daemon=True)
        self.process.start()
        theirs.close()
        self.child: int | None = None

    def run(self, wanted: Sequence[str] | Path, number: int, timeout: float) -> int | None:
        """Exit status of these tests, or of all while they are recorded in a file; None past the time.

        number: of the mutant that is on.
        """
        try:
            self.pipe.send((wanted, number))
            self.child = self.pipe.recv()
            late = not self.pipe.poll(timeout)
            self.kill()
            status = self.pipe.recv()
        except (EOFError, OSError):  # they could not be collected
            self.process.join()
            return self.process.exitcode
        return None if late else status

    def kill(self) -> None:
        """End the tests that run, with all that they have started."""
        if self.child is not None:
            with suppress(ProcessLookupError):
                os.killpg(self.child, signal.SIGKILL)
            self.child = None

    def stop(self) -> None:
        """End all of it."""
        self.kill()
        self.process.kill()
        self.process.join()
        self.pipe.close()
