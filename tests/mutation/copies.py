"""Copies of the tree in which mutants are tried."""

from __future__ import annotations

import json
import re
import shutil
import signal
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from tests.mutation.collected import Collected
from tests.mutation.mutants import ROOT, Mutant

COPIED = ("clsco", "kernels", "tests", "examples", "benchmarks", "docs", "pyproject.toml", "README.md", "Makefile")
NOT_BUILT = ("must build on", "SyntaxError")  # what says that a mutant is no program


class Copy:
    """A copy of the tree in which one mutant at a time is tried."""

    def __init__(self, folder: Path, marked: str) -> None:
        self.marked = marked
        self.tree, self.cache, self.told = folder / "tree", folder / "cache", folder / "told"
        self.records = folder / "records.json"
        self.collected: tuple[tuple[str, ...], Collected] | None = None
        for name in COPIED:
            source, target = ROOT / name, self.tree / name
            if source.is_dir():
                shutil.copytree(source, target, ignore=shutil.ignore_patterns("__pycache__", "results"))
            else:
                target.parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(source, target)
        self.cache.mkdir()

    def _run(
        self, files: Sequence[str], wanted: Sequence[str] | Path, timeout: float, anew: bool
    ) -> tuple[int | None, str]:
        """Exit status of tests, see `Collected.run`, and what they print; anew: the package itself has changed."""
        if anew or self.collected is None or self.collected[0] != tuple(files):
            self.stop()
            self.collected = tuple(files), Collected(self.tree, self.cache, self.told, files, self.marked)
        status = self.collected[1].run(wanted, timeout)
        if anew or not self.collected[1].process.is_alive():
            self.stop()
        return status, self.told.read_text("utf-8", "replace")

    def stop(self) -> None:
        """End all processes."""
        if self.collected is not None:
            self.collected[1].stop()
            self.collected = None

    def recorded(self, file: str, timeout: float) -> dict[str, Any]:
        """What each test of a file launches, see `Recorder`. Raises RuntimeError where one fails."""
        status, out = self._run([file], self.records, timeout, True)
        if status not in (0, pytest.ExitCode.NO_TESTS_COLLECTED):  # none that are not slow
            raise RuntimeError(f"{file} must pass without a change; got {status}\n{out[-3000:]}")
        found: dict[str, Any] = json.loads(self.records.read_text("utf-8"))
        return found

    def tried(self, mutant: Mutant, files: Sequence[str], tests: Sequence[str], timeout: float) -> tuple[str, str]:
        """What came of a mutant, and the test that failed; tests: of the files, in order."""
        if not tests:
            return "survived", ""
        path = self.tree / mutant.file
        text, known = path.read_text("utf-8"), set(self.cache.glob("*/*"))
        path.write_text(mutant.of(text), "utf-8")
        try:
            status, out = self._run(files, tests, timeout, mutant.file.endswith(".py"))
        finally:
            path.write_text(text, "utf-8")
            for entry in set(self.cache.glob("*/*")) - known:  # no other mutant has these kernels
                shutil.rmtree(entry, ignore_errors=True)
        outcome = "survived" if status == 0 else "timeout" if status is None else "killed"
        if outcome == "killed" and any(words in out for words in NOT_BUILT):
            outcome = "not built"
        failed = re.search(r"^FAILED (tests/.+?::.+?)(?: - .*)?$", out, re.MULTILINE)
        return outcome, failed[1] if failed else ""


@contextmanager
def copies(count: int, marked: str) -> Iterator[list[Copy]]:
    """Copies of the tree, removed at the end, by Ctrl-C and SIGTERM as well; marked: which tests, as pytest's -m."""
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    with tempfile.TemporaryDirectory(prefix="clsco-mutation-", ignore_cleanup_errors=True) as folder:
        made = [Copy(Path(folder) / str(k), marked) for k in range(count)]
        try:
            yield made
        finally:
            for copy in made:
                copy.stop()
