"""The benchmark: its rows and files, what it refuses, and its arithmetic; no test looks at how long something took."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from itertools import product
from math import inf
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
from click.testing import CliRunner, Result

from benchmarks.__main__ import main
from benchmarks.blur import cases as grids
from benchmarks.blur import measure, report
from benchmarks.blur.cases import PSFS, QUICK, Case, grid_cases, make_grid, mean_taps
from benchmarks.blur.measure import Bench, front
from benchmarks.blur.paces import Paces
from benchmarks.blur.passes import MeasuredPass
from benchmarks.blur.roofline import Roof, intensity, multiply_add_rate, tap_rate, triad_rate
from clsco.errors import ClscoError, FileError
from clsco.opencl.session import Session
from clsco.passes.gather import Gather
from clsco.plan.buffers import column_bytes
from clsco.plan.methods import Blur
from clsco.scene.model import Psf

FIGURE = 1e-5  # of white, as in tests/engine/test_defocus.py
METHODS = set(get_args(Blur)) - {"none"}
FILES = ["bench.csv", "bench.json", "radius.png", "roofline.png", "size.png", "speed_error.png"]
SMALL = replace(
    QUICK, sizes=(24, 40), radii=(2.5,), channels=(3,), rounds=2, longest_s=100.0, once_s=100.0, slowest=inf
)


def bench_(*words: object) -> Result:
    return CliRunner().invoke(main, ["blur", *map(str, words)])


def test_a_grid_has_all_combinations_that_the_device_can_do() -> None:
    both = replace(SMALL, precisions=get_args(grids.Precision), channels=(1, 3))
    cases, single = grid_cases(both, has_fp64=True), grid_cases(both, has_fp64=False)
    assert len(set(cases)) == len(cases) == 2 * len(single) == 4 * len(grid_cases(SMALL, has_fp64=True))
    assert {(case.precision, case.channels) for case in cases} == set(product(both.precisions, both.channels))
    assert {case.precision for case in single} == {"single"}
    large = grid_cases(replace(both, both_to=24), has_fp64=True)
    assert {(case.size, case.precision) for case in large} == {(24, "double"), (24, "single"), (40, "double")}


def test_a_graphics_card_does_not_gather(session: Session) -> None:
    on_a_gpu = measure._cases(SMALL, replace(session.device, kind="gpu"), [])
    assert {case.method for case in on_a_gpu} == METHODS - {"gather"}
    on_a_cpu = measure._cases(SMALL, replace(session.device, kind="cpu"), [])
    assert on_a_cpu == grid_cases(SMALL, has_fp64=True)


@pytest.fixture(scope="module")
def steps() -> list[int]:
    return []


@pytest.fixture(scope="module")
def measured(session: Session, steps: list[int]) -> Bench:
    return measure.run(SMALL, session.device, [], lambda: steps.append(1))


@pytest.mark.slow
@pytest.mark.processor  # which has all methods
def test_every_case_has_a_row(measured: Bench, steps: list[int], session: Session) -> None:
    cases = grid_cases(SMALL, has_fp64=True)
    names = ("size", "radius", "scene", "psf", "channels", "precision", "tool", "method")

    def keys(things: list[Any]) -> list[tuple[Any, ...]]:
        return sorted(tuple(getattr(thing, name) for name in names) for thing in things)

    assert keys(measured.rows) == keys(cases)
    assert len(set(cases)) == len(cases) == 2 * len(PSFS) * len(METHODS)
    assert {case.method for case in cases} == METHODS
    assert measured.left_out == []
    assert len(steps) == measure.steps(SMALL, session.device, []) == 3 * len(cases)


@pytest.mark.slow
def test_every_method_is_close_to_the_reference(measured: Bench) -> None:
    for row in measured.rows:
        assert 0.0 <= row.rms_error <= row.largest_error < FIGURE, row
        assert (row.psnr_db is None) == (row.rms_error == 0.0)
    worst = max(measured.rows, key=lambda row: row.largest_error)
    assert worst.largest_error > 0.0


@pytest.mark.slow
def test_figures_of_a_row_belong_together(measured: Bench) -> None:
    for row in measured.rows:
        assert row.device_ns is not None
        assert row.gflop_per_s is not None
        assert row.of_peak is not None
        assert row.cost_ns == (row.cpu_ns if measured.device["kind"] == "cpu" else row.device_ns)
        assert row.method in row.kernels_ns
        assert ("prepare_sources" in row.kernels_ns) == (row.method != "convolve")
        assert sum(row.kernels_ns.values()) == pytest.approx(row.device_ns)
        assert row.gflop_per_s * row.device_ns == pytest.approx(2 * row.taps)
        assert row.of_peak * measured.roof.gflop_per_s == pytest.approx(row.gflop_per_s)
        assert min(row.cpu_ns, row.wall_ns, row.first_call_s) > 0.0
        # A color in and one out, and a record of 16 bytes where radii differ.
        least = row.size**2 * (8 * row.channels + (16 if row.method != "convolve" else 0))
        assert row.device_bytes is not None
        assert row.device_bytes >= least
    assert measured.peak_rss_bytes is None or measured.peak_rss_bytes > 2**20


def test_bytes_on_the_device_are_those_of_its_buffers(session: Session) -> None:
    """In focus nothing hangs over: record, validity, color, radius, the frame with its margins, and scratch."""
    radii = np.zeros((16, 16))
    psf = Psf(edge="sampled")
    one = MeasuredPass(session, np.zeros((16, 16), np.float32), radii, psf, "gather", "double")
    blur = one.blur
    assert isinstance(blur, Gather)
    margins = 4 * 16 * blur.pitch
    held = [buffer for table in (*blur.tables, blur.tap_tables) for buffer in table]
    tables = sum(buffer.size for buffer in held if buffer is not None)
    scratch = column_bytes(blur.spec.psf, psf.tilt, 1, 0) + blur.position.size
    assert one.bytes == 256 * (12 + 1 + 4 + 8) + margins + tables + scratch


@pytest.mark.slow
def test_a_long_call_is_timed_once(session: Session) -> None:
    grid = replace(SMALL, sizes=(24,), once_s=0.0)
    calls: list[int] = []
    found = measure.run(grid, session.device, [], lambda: calls.append(1))
    assert {row.calls for row in found.rows} == {1}
    assert len(calls) == measure.steps(grid, session.device, [])


def test_what_was_slow_is_left_out_at_larger_sizes() -> None:
    grid = replace(SMALL, longest_s=1.0, slowest=10.0)
    paces = Paces(grid)
    slow, fast = (Case(100, 6.0, "varying", "sampled", 1, "double", "clsco", name) for name in ("scatter", "gather"))
    peer, other = replace(slow, tool="numba"), replace(slow, radius=20.0)
    for case, seconds in ((slow, 0.011), (fast, 0.001), (peer, 0.011), (other, 0.011)):
        assert paces.objection(case) == ""
        paces.note(case, seconds)
    larger = [replace(case, size=200) for case in (slow, fast, peer, other)]
    reasons = [paces.objection(case) for case in larger]
    assert reasons == ["a way must take 10 times as long as the fastest at most; got 11 at 100 px", "", "", ""]
    paces.note(larger[1], 0.004)
    assert paces.objection(replace(slow, size=400)) == reasons[0]
    assert paces.objection(replace(fast, size=5000)) == "a call must take 1 s at most; got at least 1.2 s, by 200 px"
    assert paces.objection(replace(fast, size=4000)) == ""


def test_what_is_slow_on_its_crop_is_left_out() -> None:
    """Its light goes beyond the crop: nothing says how long it takes in full size."""
    paces = Paces(replace(SMALL, slowest=10.0))
    gather = Case(512, 60.0, "varying", "gaussian", 1, "double", "clsco", "gather")
    scatter = replace(gather, method="scatter")
    for case, seconds in ((gather, 0.001), (scatter, 0.009)):
        assert paces.crop_objection(case, seconds) == ""
    why = "a way must take 10 times as long as the fastest at most; got 11 at its crop"
    assert paces.crop_objection(scatter, 0.011) == why
    assert paces.objection(replace(scatter, size=1024)) == why


def test_light_beyond_the_crop_costs_those_who_blur_it() -> None:
    """A crop of 39 px with R to 60 px is all border: what is blurred there is four times as wide and high."""
    first = measure._FirstCall(first_call_s=0.1, crop_px=39, rms=0.0, largest=0.0, warm_s=1e-3)
    whole = Case(3900, 60.0, "constant", "sampled", 1, "double", "clsco", "convolve")
    assert measure._by_crop(whole, first) == pytest.approx(1e-3 * (3900 / (39 + 2 * 60)) ** 2, rel=0.05)
    left = replace(whole, scene="varying", method="private", tool="numba")
    taps = mean_taps(PSFS["sampled"], 60.0, "varying")
    assert measure._by_crop(left, first) == pytest.approx(1e-3 * 100**2 * taps / 39**2)
    assert taps > 2 * 39**2


def test_no_case_is_begun_when_the_time_is_over() -> None:
    paces = Paces(replace(SMALL, minutes=1e-9))
    case = Case(100, 6.0, "varying", "sampled", 1, "double", "clsco", "gather")
    assert paces.objection(case) == "no case is begun after 1e-09 minutes"
    assert Paces(replace(SMALL, minutes=1.0)).objection(case) == ""


@pytest.mark.slow
def test_long_cases_are_left_out_with_the_reason(session: Session, tmp_path: Path) -> None:
    grid = replace(SMALL, sizes=(24,), longest_s=0.0)
    calls: list[int] = []
    found = measure.run(grid, session.device, [], lambda: calls.append(1))
    assert found.rows == []
    assert len(found.left_out) == len(measure._cases(grid, session.device, []))
    assert len(calls) == measure.steps(grid, session.device, [])
    for case in found.left_out:
        assert case["method"] in METHODS
        assert case["why"].startswith("a call must take 0 s at most; got about ")
    with pytest.raises(ClscoError, match=r"^bench: some case must be short enough; got none, a call must take 0 s"):
        report.write(tmp_path, found)
    assert list(tmp_path.iterdir()) == []


def test_the_front_is_what_nothing_beats() -> None:
    rng = np.random.default_rng(3)
    for count in (0, 1, 2, 30):
        for _ in range(20):
            costs, errors = rng.integers(0, 8, (2, count)).astype(float).tolist()  # few values: many are equal
            pairs = list(zip(costs, errors, strict=True))
            beaten = [any(c <= x and e <= y and (c, e) != (x, y) for c, e in pairs) for x, y in pairs]
            assert front(costs, errors) == [not each for each in beaten]
            assert all(beaten) == (count == 0)


def test_rates_of_known_times() -> None:
    assert triad_rate(1000, 100.0) == 30.0  # 3000 bytes in 100 ns
    assert multiply_add_rate(items=4, count=5, nanoseconds=100.0) == 32.0  # 4 x 5 steps of 10 x 8 x 2 flop
    assert tap_rate(taps=50.0, nanoseconds=10.0) == 10.0
    assert intensity(taps=6.0) == 1.0
    roof = Roof(gb_per_s=10.0, gflop_per_s=100.0)
    assert [roof.at(x) for x in (0.5, 10.0, 40.0)] == [5.0, 100.0, 100.0]


def test_taps_of_one_radius_are_counted() -> None:
    """Pixel centers within 2 px; squares of 2 px around those that a disc of 0.5 px touches; 3 sigma of 2.12 px + 1."""
    assert mean_taps(PSFS["sampled"], 2.0, "constant") == 13.0
    assert mean_taps(PSFS["integrated, tilt"], 0.5, "constant") == 9.0
    assert mean_taps(PSFS["gaussian"], 1.0, "constant") == 49.0
    assert mean_taps(PSFS["sampled"], 2.0, "varying") < 13.0


def test_the_crop_lies_in_the_image_and_holds_an_edge() -> None:
    for size in (16, 100, 512, 8192):
        for radius in (0.0, 6.0, 60.0):
            for psf in PSFS.values():
                rows, columns = grids.crop_of(size, radius, psf)
                assert 0 <= rows.start < rows.stop <= size
                assert 0 <= columns.start < columns.stop <= size
                assert rows.stop - rows.start == columns.stop - columns.start >= min(size, 32)
    crop = grids.crop_of(2048, 60.0, PSFS["gaussian"])
    radii = grids.radius_map(2048, 60.0)[crop]
    assert np.abs(np.diff(radii, axis=1)).max() > 10.0


@pytest.mark.slow
@pytest.mark.parametrize("failure", [OSError("disk full"), RuntimeError("no such font")])
def test_nothing_is_left_when_a_plot_fails(
    measured: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, failure: Exception
) -> None:
    def fail(_: Bench) -> Any:
        raise failure

    (tmp_path / "bench.csv").write_text("before")
    plots: dict[str, Callable[[Bench], Any]] = {"speed_error.png": fail}
    monkeypatch.setattr(report, "PLOTS", plots)
    with pytest.raises(FileError if isinstance(failure, OSError) else RuntimeError):
        report.write(tmp_path, measured)
    assert [path.name for path in tmp_path.iterdir()] == ["bench.csv"]
    assert (tmp_path / "bench.csv").read_text() == "before"


@pytest.mark.slow
def test_the_command_writes_and_shows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("matplotlib")
    small = replace(QUICK, channels=(3,), precisions=("double",), rounds=1, longest_s=100.0)
    monkeypatch.setattr("benchmarks.blur.cases.QUICK", small)
    result = bench_("-o", tmp_path / "new", "--quick", "--size", 20, "--radius", 0, "--radius", 1.5, "--device", "pocl")
    assert (result.exit_code, result.stderr) == (0, "")
    assert sorted(path.name for path in (tmp_path / "new").iterdir()) == FILES
    rows = json.loads((tmp_path / "new/bench.json").read_text())["rows"]
    assert {(row["size"], row["radius"], row["channels"]) for row in rows} == {(20, 0.0, 3), (20, 1.5, 3)}
    assert max(row["largest_error"] for row in rows) < FIGURE
    assert result.stdout.count(" gather ") == sum(row["method"] == "gather" for row in rows) == 2 * len(PSFS)
    sharp = {row["psnr_db"] for row in rows if row["radius"] == 0.0}
    assert sharp == {None}  # no error, hence no ratio


@pytest.mark.parametrize(
    ("option", "rule", "values"),
    [
        ("--size", "must be 16 to 8192 px", (0, 8193)),
        ("--radius", "must be 0 to 60 px", (-1, 61, "nan")),
        ("--minutes", "must be above 0", (0, "nan")),
    ],
)
def test_bad_options_give_one_message(option: str, rule: str, values: tuple[object, ...], tmp_path: Path) -> None:
    for value in values:
        result = bench_("-o", tmp_path / "out", option, value)
        message = f"error: {option}: {rule}; got {value}"
        assert (result.exit_code, result.stdout, result.stderr.splitlines()) == (1, "", [message])
    assert not (tmp_path / "out").exists()


def test_grids_of_the_options() -> None:
    assert make_grid(False, [], []) == grids.FULL
    assert make_grid(True, [], []) == QUICK
    asked = make_grid(True, [64, 32, 64], [3.0])
    assert (asked.sizes, asked.radii, asked.rounds) == ((32, 64), (3.0,), QUICK.rounds)
    image = np.zeros((4, 5, 3), np.float32)
    assert [grids.channels_of(image, count).shape for count in (1, 3)] == [(4, 5), (4, 5, 3)]
