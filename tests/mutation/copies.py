"""Copies of the tree in which mutants are tried, each with a process of its own that runs pytest."""

from __future__ import annotations

import os
import re
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from multiprocessing import get_context
from multiprocessing.process import BaseProcess
from pathlib import Path

import pytest

from tests.mutation.mutants import Mutant

ROOT = Path(__file__).resolve().parents[2]
COPIED = ("clsco", "kernels", "tests", "examples", "benchmarks", "docs", "pyproject.toml", "README.md", "Makefile")
NONE_SELECTED = 5  # pytest's status
# Processes begin with what all tests import but the package itself.
STARTED = get_context("forkserver")
STARTED.set_forkserver_preload(["numpy", "pyopencl", "pydantic", "imageio.v3", "scipy.special", "pytest"])
NOT_BUILT = ("must build on", "SyntaxError")  # what says that a mutant is no program


def run_tests(tree: Path, cache: Path, told: Path, arguments: list[str]) -> None:
    """In a process of its own: pytest in a copy of the tree."""
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
    status = int(pytest.main(arguments))
    sys.stdout.flush()
    os._exit(status)


class Copy:
    """A copy of the tree in which one mutant at a time is tried."""

    def __init__(self, folder: Path) -> None:
        self.tree, self.cache, self.told = folder / "tree", folder / "cache", folder / "told"
        self.running: BaseProcess | None = None
        for name in COPIED:
            source, target = ROOT / name, self.tree / name
            if source.is_dir():
                shutil.copytree(source, target, ignore=shutil.ignore_patterns("__pycache__", "results"))
            else:
                target.parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(source, target)
        self.cache.mkdir()

    def tested(self, names: list[str], timeout: float, marked: str) -> tuple[int | None, str]:
        """Exit status of tests, 0 also where none is marked so, None past the time, and what they print."""
        options = ["-x", "-q", "--tb=short", "-rf", "-n", "0", "-p", "no:cacheprovider", "-m", marked]
        process = self.running = STARTED.Process(
            target=run_tests, args=(self.tree, self.cache, self.told, [*options, *names])
        )
        process.start()
        process.join(timeout)
        late = process.is_alive()
        self.stop()
        status, out = process.exitcode, self.told.read_text("utf-8", "replace")
        return (None if late else 0 if status == NONE_SELECTED else status), out

    def stop(self) -> None:
        """End the tests that run, with all that they have started."""
        if self.running is not None and self.running.pid is not None:
            with suppress(ProcessLookupError):
                os.killpg(self.running.pid, signal.SIGKILL)
            self.running.kill()
            self.running.join()

    def tried(self, mutant: Mutant, tests: list[str], timeout: float, marks: tuple[str, ...]) -> tuple[str, float, str]:
        """What came of a mutant, the seconds that it took, and the test that failed; tests: in order."""
        path, begun = self.tree / mutant.file, time.monotonic()
        text, known = path.read_text("utf-8"), set(self.cache.glob("*/*"))
        path.write_text(mutant.of(text), "utf-8")
        try:
            for marked in marks:
                status, out = self.tested(tests, timeout, marked)
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
        yield [Copy(Path(folder) / str(k)) for k in range(count)]
