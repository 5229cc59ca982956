"""No kernel reads or writes out of bounds, reads what nobody wrote, or races: on Oclgrind, which sees every access."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from clsco.resources import processors
from tests.oclgrind import simulator
from tests.oclgrind.cases import EVERY, SHAPES, drawn_scenes
from tests.oclgrind.faults import FAULTS

pytestmark = pytest.mark.oclgrind
ROOT = Path(__file__).resolve().parents[2]
PROCESSES = processors()
Results = list[dict[str, Any]]


def work(folder: Path, jobs: Sequence[tuple[str, ...]]) -> Results:
    """Output of workers, each the check and the arguments of a job; so many at a time as there are processors."""
    found: Results = []
    for first in range(0, len(jobs), PROCESSES):
        running = []
        for k, (check, *given) in enumerate(jobs[first : first + PROCESSES], first):
            environ = simulator.environ(folder / f"{k}.log", check) | {"PYTHONPATH": str(ROOT)}
            command = [sys.executable, "-m", "tests.oclgrind.worker", *given]
            with open(folder / f"{k}.out", "w") as out, open(folder / f"{k}.err", "w") as errors:
                running.append(subprocess.Popen(command, env=environ, cwd=ROOT, stdout=out, stderr=errors))
        for k, process in enumerate(running, first):
            status = process.wait()
            assert status == 0, f"{jobs[k]} ended with {status}\n{(folder / f'{k}.err').read_text()[-3000:]}"
            lines = (folder / f"{k}.out").read_text("utf-8").splitlines()
            found += [json.loads(line) | {"check": jobs[k][0]} for line in lines]
    return found


@pytest.fixture(scope="module")
def cases(tmp_path_factory: pytest.TempPathFactory) -> Results:
    """Each case, with each check."""
    jobs = [(check, "cases", str(k), str(PROCESSES)) for check in simulator.CHECKS for k in range(PROCESSES)]
    return work(tmp_path_factory.mktemp("cases"), jobs)


def test_nothing_is_reported(cases: Results) -> None:
    faulty = [
        f"{one['check']}: {one['name']}, {one['about']}\n{one['report'][:2000]}" for one in cases if one["report"]
    ]
    assert not faulty, f"{len(faulty)} of {len(cases)}\n" + "\n".join(faulty[:5])


@pytest.mark.parametrize("check", simulator.CHECKS)
def test_every_kernel_is_run(cases: Results, check: str) -> None:
    text = "".join(path.read_text("utf-8") for path in (ROOT / "kernels").rglob("*.cl"))
    kernels = set(re.findall(r"^__kernel void (\w+)\(", text, re.MULTILINE))
    assert len(kernels) > 50
    launched = {name for one in cases if one["check"] == check for name in one["launched"]}
    assert launched == kernels if EVERY == 1 else len(launched) > 40


def test_what_is_run() -> None:
    """Shapes, and pairs of features that the drawn scenes have in common."""
    assert len(set(SHAPES)) >= 20
    assert all(rows <= 32 and columns <= 32 for rows, columns in SHAPES)
    taken, drawn, pairs = drawn_scenes()
    assert len(taken) < drawn
    assert pairs > 2000


@pytest.fixture(scope="module")
def faults(tmp_path_factory: pytest.TempPathFactory) -> Results:
    return work(tmp_path_factory.mktemp("faults"), [(check, "faults", check) for check in simulator.CHECKS])


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.name)
def test_a_fault_is_found(faults: Results, fault: Any) -> None:
    report = next(one["report"] for one in faults if one["name"] == fault.name)
    assert fault.recorded in report
