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
from benchmarks.stability.rays import FAMILIES
from benchmarks.stability.report import Stability
from clsco.opencl.session import Session


@pytest.fixture(scope="module")
def steps() -> list[int]:
    return []


@pytest.fixture(scope="module")
def measured(session: Session, steps: list[int]) -> Stability:
    return stabilityreport.run(session.device, True, lambda: steps.append(1))


def test_every_hard_case_is_within_its_bound(measured: Stability, steps: list[int]) -> None:
    for case in measured.cases:
        assert case.reached, case
        # What the textbook's form does shows that the case is hard.
        assert case.worst("naive") > 5 * case.bounds[1] or (case.wrong is not None and case.wrong[0] > 100), case.name
        assert case.values > 1000
    assert len(steps) == stabilityreport.steps(True)


def test_depths_of_random_rays(measured: Stability) -> None:
    assert {(one.family, one.precision) for one in measured.rays} == {
        (family, real) for family in FAMILIES for real in ("float", "double")
    }
    for one in measured.rays:
        assert one.reached, one
        assert 0 < one.hits < one.rays
        assert one.certain > 0.95 * one.rays
        assert one.oracle_bits > 46
        assert one.worst_ulp < 0.6 or one.precision == "float"  # half a unit is the rounding of the depth itself
    assert sum(one.rays for one in measured.rays) >= 2e5


def test_degenerate_cases_are_of_the_reference_s_class(measured: Stability) -> None:
    assert len({one.name for one in measured.degenerate}) >= 200
    for one in measured.degenerate:
        assert one.reached, one
    assert sum(one.other_class for one in measured.degenerate) < 250  # of 460,000, in single precision
    hits = {name: int(degenerate.reference_hits(target).sum()) for name, target in degenerate.cases().items()}
    assert hits["sphere about the lens"] == degenerate.ACROSS**2
    assert hits["nothing"] == hits["imaginary cylinder"] == 0
    assert len(set(hits.values())) > 40


def test_distinct_cases_are_neither_turned_nor_scaled() -> None:
    targets = degenerate.cases()
    assert 200 <= len(degenerate.distinct(targets)) < len(targets)


def test_what_needs_no_device(session: Session) -> None:
    for make in (large_angles, near_objects):
        case = make(session)
        assert case.reached, case
        assert case.worst("naive") > 100 * case.worst("single")


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
