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
from typing import Any, ClassVar

import pytest

from tests.mutation.collected import Collected, Programs
from tests.mutation.mutants import ROOT, Mutant
from tests.mutation.switched import Switches

COPIED = ("clsco", "kernels", "tests", "examples", "benchmarks", "docs", "pyproject.toml", "README.md", "Makefile")
NOT_BUILT = ("must build on", "SyntaxError")  # what says that a mutant is no program


class Copy:
    """A copy of the tree in which one mutant at a time is tried."""

    programs: ClassVar[dict[str, Programs]] = {}  # of files of tests, without switches

    def __init__(self, folder: Path, cache: Path, marked: str, switches: Switches) -> None:
        self.shared, self.marked, self.switches = cache, marked, switches
        self.tree, self.cache, self.output = folder / "tree", folder / "cache", folder / "output"
        self.records = folder / "records.json"
        self.collected: tuple[object, Collected] | None = None
        for name in COPIED:
            source, target = ROOT / name, self.tree / name
            if source.is_dir():
                shutil.copytree(source, target, ignore=shutil.ignore_patterns("__pycache__", "results"))
            else:
                target.parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(source, target)
        self.cache.mkdir()

    def _tests(self, files: Sequence[str], switched: bool, programs: Programs = ()) -> Collected:
        """Tests of these files, with kernels that have switches, or with those of the tree; programs: they build."""
        kind = (*files, len(self.switches.left_out) if switched else None)
        if self.collected is None or self.collected[0] != kind or not self.collected[1].process.is_alive():
            self.stop()
            for file, text in (self.switches.texts if switched else self.switches.plain).items():
                (self.tree / file).write_text(text, "utf-8")
            cache, switches = (self.shared, self.switches) if switched else (self.cache, None)
            self.collected = kind, Collected(self.tree, cache, self.output, files, self.marked, switches, programs)
        return self.collected[1]

    def stop(self) -> None:
        """End all processes."""
        if self.collected is not None:
            self.collected[1].stop()
            self.collected = None

    def recorded(self, file: str, switched: bool, timeout: float) -> dict[str, Any]:
        """Launches of each test of a file (`tests.mutation.recorder.Recorder`). Raises RuntimeError where one fails."""
        status = self._tests([file], switched).run(self.records, 0, timeout)
        self.stop()
        if status not in (0, pytest.ExitCode.NO_TESTS_COLLECTED):  # none that are not slow
            out = self.output.read_text("utf-8", "replace")
            raise RuntimeError(f"{file} must pass without a change; got {status}\n{out[-3000:]}")
        found: dict[str, Any] = json.loads(self.records.read_text("utf-8"))
        self.programs[file] = found["programs"]
        return found

    def tried(self, mutant: Mutant, files: Sequence[str], tests: Sequence[str], timeout: float) -> tuple[str, str]:
        """Outcome of a mutant, and the test that failed; tests: of the files, in order."""
        if not tests:
            return "survived", ""
        if self.switches.has(mutant):
            programs = [
                (options, self.switches.switched(text)) for file in files for options, text in self.programs[file]
            ]
            status = self._tests(files, True, programs).run(tests, self.switches.numbers[mutant], timeout)
        else:
            status = self._tried_alone(mutant, files, tests, timeout)
        out = self.output.read_text("utf-8", "replace")
        outcome = "survived" if status == 0 else "timeout" if status is None else "killed"
        if outcome == "killed" and any(words in out for words in NOT_BUILT):
            outcome = "not built"
        failed = re.search(r"^FAILED (tests/.+?::.+?)(?: - .*)?$", out, re.MULTILINE)
        return outcome, failed[1] if failed else ""

    def _tried_alone(self, mutant: Mutant, files: Sequence[str], tests: Sequence[str], timeout: float) -> int | None:
        """Exit status with a mutant in the text of its file."""
        path, package = self.tree / mutant.file, mutant.file.endswith(".py")
        if not package:
            self._tests(files, False)
        text, known = path.read_text("utf-8"), set(self.cache.glob("*/*"))
        path.write_text(mutant.of(text), "utf-8")
        try:
            if package:  # it is read when tests are collected
                self.stop()
            return self._tests(files, False).run(tests, 0, timeout)
        finally:
            path.write_text(text, "utf-8")
            if package:
                self.stop()
            for entry in set(self.cache.glob("*/*")) - known:  # no other mutant has these kernels
                shutil.rmtree(entry, ignore_errors=True)


@contextmanager
def copies(count: int, marked: str, switches: Switches) -> Iterator[list[Copy]]:
    """Copies of the tree, removed at the end, by Ctrl-C and SIGTERM as well; marked: which tests, as pytest's -m."""
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    with tempfile.TemporaryDirectory(prefix="clsco-mutation-", ignore_cleanup_errors=True) as folder:
        cache = Path(folder) / "cache"
        cache.mkdir()
        made = [Copy(Path(folder) / str(k), cache, marked, switches) for k in range(count)]
        try:
            yield made
        finally:
            for copy in made:
                copy.stop()
