"""Copies of the tree in which mutants are tried, by processes that have collected their tests before."""

from __future__ import annotations

import os
import re
import shutil
import signal
import sys
import tempfile
import time
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from typing import BinaryIO

import pytest

from tests.mutation.mutants import Mutant

ROOT = Path(__file__).resolve().parents[2]
COPIED = ("clsco", "kernels", "tests", "examples", "benchmarks", "docs", "pyproject.toml", "README.md", "Makefile")
NONE_SELECTED = 5  # pytest's status
# Processes begin with what all tests import but the package itself.
STARTED = get_context("forkserver")
STARTED.set_forkserver_preload(["numpy", "pyopencl", "pydantic", "imageio.v3", "scipy.special", "pytest"])
NOT_BUILT = ("must build on", "SyntaxError")  # what says that a mutant is no program


class Forks:
    """Plugin of pytest: when its tests are collected, each question is answered by a process that runs them."""

    def __init__(self, asked: Connection, told: BinaryIO) -> None:
        self.asked, self.told = asked, told

    def pytest_runtestloop(self, session: pytest.Session) -> None:
        """Fork for each list of tests that go first; in the fork, go on with pytest's own loop."""
        while True:
            first = self.asked.recv()
            self.told.seek(0)
            self.told.truncate()
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", DeprecationWarning)  # threads of NumPy, which are idle here
                child = os.fork()
            if child == 0:
                os.setsid()
                places = {name: place for place, name in enumerate(first)}
                session.items.sort(key=lambda item: places.get(item.nodeid, len(places)))
                return
            self.asked.send(child)
            self.asked.send(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))


def collect(tree: Path, cache: Path, told: Path, arguments: list[str], asked: Connection) -> None:
    """In a process of its own: collect tests in a copy of the tree, and have forks run them."""
    os.setsid()
    os.chdir(tree)
    os.environ["POCL_CACHE_DIR"], os.environ["PYTHONPATH"] = str(cache), str(tree)
    with open(told, "wb", buffering=0) as file:
        os.dup2(file.fileno(), 1)
        os.dup2(file.fileno(), 2)
        for name in [name for name in sys.modules if name.split(".")[0] == "tests"]:
            del sys.modules[name]
        sys.path.insert(0, str(tree))
        sys.dont_write_bytecode = True
        status = int(pytest.main(arguments, plugins=[Forks(asked, file)]))
        sys.stdout.flush()
    os._exit(status)


class Collected:
    """Tests of a copy that are collected, and can be run many times; kernels are read when they run."""

    def __init__(self, copy: Copy, names: tuple[str, ...], marked: str) -> None:
        options = ["-x", "-q", "--tb=short", "-rf", "-n", "0", "-p", "no:cacheprovider", "-m", marked]
        self.pipe, theirs = STARTED.Pipe()
        arguments = (copy.tree, copy.cache, copy.told, [*options, *names], theirs)
        self.process = STARTED.Process(target=collect, args=arguments, daemon=True)
        self.process.start()
        theirs.close()
        self.child: int | None = None

    def run(self, first: Sequence[str], timeout: float) -> int | None:
        """Exit status of the tests, 0 also where none is marked so, None past the time; first: which go first."""
        try:
            self.pipe.send(list(first))
            self.child = self.pipe.recv()
            late = not self.pipe.poll(timeout)
            self.kill()
            status = self.pipe.recv()
        except (EOFError, OSError):  # they could not be collected
            self.process.join()
            return self.process.exitcode
        return None if late else 0 if status == NONE_SELECTED else status

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


class Copy:
    """A copy of the tree in which one mutant at a time is tried."""

    def __init__(self, folder: Path) -> None:
        self.tree, self.cache, self.told = folder / "tree", folder / "cache", folder / "told"
        self.collected: dict[tuple[tuple[str, ...], str], Collected] = {}
        for name in COPIED:
            source, target = ROOT / name, self.tree / name
            if source.is_dir():
                shutil.copytree(source, target, ignore=shutil.ignore_patterns("__pycache__", "results"))
            else:
                target.parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(source, target)
        self.cache.mkdir()

    def tested(
        self, names: Sequence[str], first: Sequence[str], timeout: float, marked: str, anew: bool
    ) -> tuple[int | None, str]:
        """Exit status of tests, see `Collected.run`, and what they print; anew: the package itself has changed."""
        key = tuple(names), marked
        if anew:
            self.forget(key)
        if key not in self.collected:
            self.collected[key] = Collected(self, *key)
        status = self.collected[key].run(first, timeout)
        if anew or not self.collected[key].process.is_alive():
            self.forget(key)
        return status, self.told.read_text("utf-8", "replace")

    def forget(self, key: tuple[tuple[str, ...], str]) -> None:
        """End what was collected."""
        if key in self.collected:
            self.collected.pop(key).stop()

    def stop(self) -> None:
        """End all processes."""
        for key in list(self.collected):
            self.forget(key)

    def tried(
        self, mutant: Mutant, tests: Sequence[str], first: Sequence[str], timeout: float, marks: tuple[str, ...]
    ) -> tuple[str, float, str]:
        """What came of a mutant, the seconds that it took, and the test that failed; first: tests that go first."""
        path, begun = self.tree / mutant.file, time.monotonic()
        text, known = path.read_text("utf-8"), set(self.cache.glob("*/*"))
        path.write_text(mutant.of(text), "utf-8")
        try:
            for marked in marks:
                status, out = self.tested(tests, first, timeout, marked, mutant.file.endswith(".py"))
                if status != 0:
                    break
        finally:
            path.write_text(text, "utf-8")
            for entry in set(self.cache.glob("*/*")) - known:  # no other mutant has these kernels
                shutil.rmtree(entry, ignore_errors=True)
        outcome = "survived" if status == 0 else "timeout" if status is None else "killed"
        if outcome == "killed" and any(words in out for words in NOT_BUILT):
            outcome = "not built"
        assert "ERROR: not found:" not in out, out[-2000:]
        failed = re.search(r"^FAILED (tests/.+?::.+?)(?: - .*)?$", out, re.MULTILINE)
        return outcome, time.monotonic() - begun, failed[1] if failed else ""


@contextmanager
def copies(count: int) -> Iterator[list[Copy]]:
    """Copies of the tree, removed at the end, by Ctrl-C and SIGTERM as well."""
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    with tempfile.TemporaryDirectory(prefix="clsco-mutation-", ignore_cleanup_errors=True) as folder:
        made = [Copy(Path(folder) / str(k)) for k in range(count)]
        try:
            yield made
        finally:
            for copy in made:
                copy.stop()
