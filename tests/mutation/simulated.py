"""Mutants on Oclgrind, which sees what they read and write; a process of its own for each.

python -m tests.mutation.simulated record FILE: what each case launches, as `tests.mutation.recorder.Recorder` has it.
python -m tests.mutation.simulated try: a mutant of the standard input; prints the first case that kills it.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from unittest.mock import patch

from tests.mutation.mutants import ROOT, Mutant
from tests.mutation.recorder import Launches
from tests.oclgrind import simulator, worker
from tests.oclgrind.cases import all_cases


def _process(arguments: Sequence[str], given: str, timeout: float | None) -> str:
    """Output of the worker."""
    with tempfile.TemporaryDirectory(prefix="clsco-simulated-") as place:
        environ = simulator.environ(Path(place) / "log", "races") | {"PYTHONPATH": str(ROOT)}
        command = [sys.executable, "-m", "tests.mutation.simulated", *arguments]
        done = subprocess.run(
            command, input=given, env=environ, cwd=ROOT, capture_output=True, text=True, timeout=timeout
        )
    if done.returncode > 0:
        raise RuntimeError(f"the simulator must go on; got {done.returncode}\n{done.stderr[-3000:]}")
    return done.stdout if done.returncode == 0 else f"signal {-done.returncode}"


def recorded() -> dict[str, Any]:
    """Launches of each case."""
    with tempfile.TemporaryDirectory(prefix="clsco-simulated-") as place:
        _process(["record", f"{place}/cases"], "", None)
        found: dict[str, Any] = json.loads((Path(place) / "cases").read_text("utf-8"))
        return found


def tried(mutant: Mutant, cases: Sequence[str], timeout: float) -> tuple[str, str]:
    """Outcome of a mutant, and the case that killed it, of those named."""
    text = mutant.of((ROOT / mutant.file).read_text("utf-8"))
    try:
        by = _process(["try"], json.dumps([mutant.file.removeprefix("kernels/"), text, cases]), timeout).strip()
    except subprocess.TimeoutExpired:
        return "timeout", ""
    return ("killed", by) if by else ("survived", "")


def _record(path: Path) -> None:
    last = [""]
    made = simulator._program_text

    def recorded_text(*given: Any) -> str:
        last[0] = made(*given)
        return last[0]

    launches, tests = Launches(lambda _: last[0]), dict[str, dict[str, Any]]()
    with patch.object(simulator, "_program_text", recorded_text):
        for case in all_cases():
            launches.now = case.name
            found = worker.run(case, Path(os.environ["OCLGRIND_LOG"]))
            if found["report"]:
                raise RuntimeError(f"{case.name} must pass without a change; got {found['report'][:2000]}")
            launched = sorted(launches.launched[case.name])
            tests[case.name] = {"slow": False, "seconds": found["seconds"], "elsewhere": False, "launched": launched}
    launches.write(path, tests)


def _try(file: str, text: str, names: Sequence[str]) -> str:
    wanted = {case.name: case for case in all_cases() if case.name in names}
    with worker.with_kernel(file, text):
        for name in names:
            if worker.run(wanted[name], Path(os.environ["OCLGRIND_LOG"]))["report"]:
                return name
    return ""


if __name__ == "__main__":
    simulator.without_intrinsics()
    if sys.argv[1] == "record":
        _record(Path(sys.argv[2]))
    else:
        print(_try(*json.load(sys.stdin)))
