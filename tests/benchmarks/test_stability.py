"""The stability report in its quick form: every row within its bound; files, tables, and what shortfalls do."""

from __future__ import annotations

from dataclasses import replace
from math import inf, nan
from pathlib import Path

import pytest
from click.testing import CliRunner

from benchmarks.__main__ import main
from benchmarks.stability import degenerate
from benchmarks.stability import report as stabilityreport
from benchmarks.stability.hardcase import Compared, HardCase, hard_case
from benchmarks.stability.hardimages import large_angles, near_objects
from benchmarks.stability.report import Stability
from clsco.opencl.session import Session


@pytest.fixture(scope="module")
def measured(session: Session) -> Stability:
    steps: list[int] = []
    report = stabilityreport.run(session.device, True, lambda: steps.append(1))
    assert len(steps) == stabilityreport.steps(True)
    return report


def test_distinct_cases_are_neither_turned_nor_scaled() -> None:
    targets = degenerate.cases()
    assert 200 <= len(degenerate.distinct(targets)) < len(targets)


def test_what_needs_no_device(session: Session) -> None:
    for make in (large_angles, near_objects):
        case = make(session)
        assert case.reached, case
        assert case.worst("naive") > 100 * case.worst("single")


@pytest.mark.slow
def test_what_is_beyond_its_bound_is_reported(measured: Stability) -> None:
    assert measured.shortfalls() == []
    case, found, outcome = measured.cases[0], measured.rays[0], measured.degenerate[0]
    worse = replace(
        measured,
        cases=[replace(case, bounds=(0.1, 0.1)), replace(case, wrong=(9, 0, 1)), case],
        rays=[replace(found, misclassified=3)],
        degenerate=[replace(outcome, not_finite=2)],
    )
    lines = worse.shortfalls()
    assert len(lines) == 4
    assert "3 misclassified" in lines[2]
    assert lines[3].endswith("2 not finite, 0 of another class")


@pytest.mark.parametrize(("error", "reached"), [(0.5, True), (1.0, True), (1.1, False), (inf, False), (nan, False)])
def test_a_case_needs_a_finite_error_within_its_bound(error: float, reached: bool) -> None:
    found = [(1.0, {"naive": Compared(9.0, 1, 2), "single": Compared(error, 0, 2)})]
    case: HardCase = hard_case("x", "y", "z", found, (1.0, 1.0), "")
    assert case.reached == reached
    assert (case.values, case.wrong) == (2, (1, 0, 0))


@pytest.mark.slow
def test_a_shortfall_ends_the_command(measured: Stability, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    figure = pytest.importorskip("matplotlib.figure")
    worse = replace(measured, cases=[replace(measured.cases[0], bounds=(0.1, 0.1))])
    monkeypatch.setattr(stabilityreport, "run", lambda *given: worse)
    monkeypatch.setattr(stabilityreport, "plot", lambda cases: figure.Figure())
    words = ["stability", "-o", str(tmp_path / "out"), "--quick", "--device", "pocl"]
    result = CliRunner().invoke(main, words)
    assert result.exit_code == 1
    message = "error: stability: every error must be within its bound; got 1 beyond: sphere far away: beyond its bound"
    assert result.stderr.splitlines() == [message]
    assert "SHORT" in result.stdout
    assert (tmp_path / "out/stability.csv").is_file()
