"""Whole frames against the traced lens and Mitsuba, and the forward warp's stages; no test looks at times."""

from __future__ import annotations

import csv
import importlib.util
import json
import sys
from dataclasses import replace
from math import inf
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from click.testing import CliRunner

from benchmarks.__main__ import main
from benchmarks.blur import measure, report
from benchmarks.blur.cases import PSFS, BenchGrid, Peer, radius_map
from benchmarks.blur.measure import BenchRow
from benchmarks.blur.roofline import Roof
from benchmarks.blur.stages import MeasuredStages
from benchmarks.speed import compare, lens, peers, warp
from benchmarks.speed.compare import Compared, Comparison
from benchmarks.speed.lens import Lens, LensRow, compared, sized, time_for
from benchmarks.speed.lensreport import lens_table
from benchmarks.speed.warp import WarpRow
from benchmarks.truth import mitsuba
from clsco.constants import NO_WINNER
from clsco.inputs.textures import load_scene_textures
from clsco.opencl.session import Session
from clsco.reference.warp.warp import reproject_depth, reproject_targets, reproject_winner
from clsco.scene.model import Camera

TWO = ("sampled", "integrated, tilt, silhouettes")
ROWS = [
    LensRow("clsco", TWO[0], 0.01, 0.01, 1e-2, 40.0),
    LensRow("clsco", TWO[1], 0.02, 0.02, 1e-4, 80.0),
    LensRow("Mitsuba", "16", 0.5, 0.3, 2e-2, 34.0),
    LensRow("Mitsuba", "64", 2.0, 1.1, 5e-3, 46.0),
]
WARPS = [WarpRow("turned", 2048, "depth test", 8.0, "numba, one thread", 20.0, 0.14, 2.5)]


def has_mitsuba() -> bool:
    return importlib.util.find_spec("mitsuba") is not None and mitsuba.unusable() is None


@pytest.mark.parametrize(
    ("error", "seconds", "outside"),
    [(2e-3, 4.0, False), (4e-3, 1.0, False), (5e-4, 64.0, True), (1.6e-2, 0.125, True)],  # half the error: 4 x time
)
def test_time_for_an_error_follows_the_curve(error: float, seconds: float, outside: bool) -> None:
    found, extrapolated = time_for(error, [(1e-3, 16.0), (4e-3, 1.0), (8e-3, 0.5)])
    assert found == pytest.approx(seconds)
    assert extrapolated == outside


def test_rows_are_compared_at_equal_error() -> None:
    first, second, *theirs = compared(ROWS)
    assert theirs == ROWS[2:]
    assert first.mitsuba_cpu_s == pytest.approx(1.0)  # 16 and 64 rays, in the middle of the logarithms
    assert first.times_less == pytest.approx(100.0)
    assert second.mitsuba_cpu_s == pytest.approx(2.0 * 50.0**2)
    assert second.times_less == pytest.approx(2.5e5)
    assert [first.extrapolated, second.extrapolated] == [False, True]
    assert compared(ROWS[:2]) == ROWS[:2]


def test_the_scene_keeps_its_field_of_view_and_radii() -> None:
    full, small = sized(512).camera, sized(64).camera
    assert full.resolution == (512, 512)
    assert mitsuba.field_of_view(small, 64) == pytest.approx(mitsuba.field_of_view(full, 512))
    # R in px goes with D / p.
    assert small.aperture_diameter / small.pixel_pitch == full.aperture_diameter / full.pixel_pitch
    assert mitsuba.field_of_view(Camera(), 512) == pytest.approx(2 * np.degrees(np.arctan(2.56 / 20.0)))
    assert mitsuba.in_focus(Camera()) == pytest.approx(250.017, abs=1e-3)  # the thesis' s = 21.739 mm
    assert mitsuba.in_focus(Camera(focus_distance=400.0)) == pytest.approx(400.0)


@pytest.mark.slow
def test_errors_of_the_settings_that_differ_in_physics(
    session: Session, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    pytest.importorskip("numba")
    pytest.importorskip("scipy")
    monkeypatch.setattr(lens, "PSFS", {name: lens.PSFS[name] for name in TWO})
    monkeypatch.setattr(lens, "NOISE", 2e-3)
    steps: list[int] = []
    found = lens.run(session.device, 32, (), lambda: steps.append(1), tmp_path)
    assert len(steps) == lens.steps(())
    assert 0.0 < found.noise <= 2e-3
    assert len(list(tmp_path.iterdir())) == 1  # the traced frame
    thesis, default = found.rows
    assert (thesis.setting, default.setting) == TWO
    assert default.rms_error < 0.2 * thesis.rms_error  # 26 and more dB are between them in README
    assert thesis.psnr_db == pytest.approx(-20 * np.log10(thesis.rms_error))
    assert min(row.cpu_s for row in found.rows) > 0.0
    assert {row.times_less for row in found.rows} == {None}


@pytest.mark.skipif(not has_mitsuba(), reason="Mitsuba or its LLVM is not installed")
def test_mitsuba_sees_the_same() -> None:
    """Noise of 256 rays is some 1e-2 at most; what is turned over or mirrored is far from that."""
    pytest.importorskip("numba")
    pytest.importorskip("scipy")
    from benchmarks.truth.traced import rms, traced

    scene, (texture,) = load_scene_textures(sized(64))
    found = mitsuba.set_up(scene, texture.radiance)(256, 0)
    truth, errors = traced(scene, 5e-3)
    error = np.sqrt(np.mean((found - truth) ** 2))
    assert rms(errors) < 5e-3
    assert error < 1e-2
    for other in (found[::-1], found[:, ::-1], found.T):
        assert np.sqrt(np.mean((other - truth) ** 2)) > 4e-2


def test_mitsuba_without_llvm_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    def set_variant(_: str) -> None:
        raise ImportError("the LLVM shared library could not be found")

    monkeypatch.setattr(peers, "find_spec", lambda name: object())
    monkeypatch.setitem(sys.modules, "mitsuba", SimpleNamespace(set_variant=set_variant))
    tools, absent = peers.require_peers()
    assert tools == ["numba", "OpenCV"]
    assert list(absent) == ["Mitsuba"]
    assert "DRJIT_LIBLLVM_PATH" in absent["Mitsuba"]


@pytest.mark.parametrize("name", list(warp.SCENES))
@pytest.mark.slow
def test_stages_of_the_forward_warp(name: str, session: Session) -> None:
    """The device's winners are numba's and the reference's, and filling fills what the thesis' captions say."""
    pytest.importorskip("numba")
    scene, texture = warp.scene_at(name, 128)
    stages = MeasuredStages(session, scene, texture)
    stages.depth_test()
    winners = stages.winners()
    numba = warp.numba_depth_tests(scene)["numba, one thread"]()
    assert np.array_equal(winners, numba)
    rest, whose = warp.rest_inverse_depth(scene), np.zeros(winners.shape, np.uint8)
    target, moved = reproject_targets(scene, stages.sample.poses, rest, whose, 0)
    key = moved.astype(np.float32)
    exact = reproject_winner(target, key, reproject_depth(target, key, winners.size))
    assert np.array_equal(winners, exact.reshape(winners.shape))
    assert 0.02 < np.mean(winners == NO_WINNER) < 0.5
    stages.gather()
    stages.fill()
    filled = stages.filled()
    assert 0.05 < len(filled) / winners.size < 0.2  # at 512 px 19680 and 36993 of 262144, more in the guard band


@pytest.mark.slow
def test_a_copy_of_neighborhoods() -> None:
    pytest.importorskip("numba")
    from benchmarks.speed.zbuffer import copy_neighborhoods

    planes = [np.arange(1.0, 49.0).reshape(6, 8) + k for k in range(3)]
    copies = [np.zeros((6, 8)) for _ in planes]
    copy_neighborhoods(np.array([[1, 1], [4, 6]], np.int32), *planes, *copies)
    near = np.zeros((6, 8), bool)
    near[:3, :3] = near[3:, 5:] = True
    for plane, copy in zip(planes, copies, strict=True):
        assert np.array_equal(copy, np.where(near, plane, 0.0))


def test_the_report_has_frames_and_warps(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("matplotlib")
    row = BenchRow(
        512, 6.0, "varying", "sampled", 1, "double", "clsco", "gather", cost_ns=9.0, cpu_ns=9.0, wall_ns=5.0,
        device_ns=8.0, kernels_ns={"gather": 8.0}, first_call_s=0.5, crop_px=64, rms_error=1e-8, largest_error=1e-7,
        psnr_db=160.0, device_bytes=2**20, calls=3, taps=52.0, flop_per_byte=9.0, gflop_per_s=13.0, of_peak=0.2,
        on_front=True,
    )  # fmt: skip
    monkeypatch.setattr(report, "PLOTS", {})  # tests/benchmarks/test_blur.py has these
    frames = Lens("sphere", 512, 2e-4, compared(ROWS))
    device = {"name": "one", "platform": "some"}
    bench = Compared(device, {}, {}, Roof(10.0, 60.0), [row], [], None, frames, WARPS)
    compare.write(tmp_path, bench)
    content = json.loads((tmp_path / "bench.json").read_text())
    assert (tmp_path / "lens.png").stat().st_size > 10_000
    for name, key, rows, count in (
        ("lens.csv", "cpu_s", content["lens"]["rows"], len(ROWS)),
        ("warp.csv", "cpu_ns", content["warp"], len(WARPS)),
    ):
        with open(tmp_path / name, newline="") as file:
            lines = list(csv.DictReader(file))
        assert len(lines) == len(rows) == count
        assert [float(line[key]) for line in lines] == [row[key] for row in rows]
    assert len(compare.tables(bench)) == 3


def test_tables_mark_what_was_not_measured(capsys: pytest.CaptureFixture[str]) -> None:
    from rich.console import Console

    Console(width=200).print(lens_table(Lens("sphere", 512, 2e-4, compared(ROWS))))
    shown = capsys.readouterr().out
    assert "~250,000" in shown
    assert "~100" not in shown


def test_what_is_asked_for_alone_has_no_frames(session: Session) -> None:
    pytest.importorskip("numba")
    pytest.importorskip("scipy")
    grid, device = BenchGrid(sizes=(16,), radii=(0.0,)), session.device
    alone, whole = (Comparison(grid, frames, ["numba"], {}) for frames in (None, compare.QUICK))
    cases = measure.steps(grid, device, [peer for peer in peers.PEERS if peer.tool == "numba"])
    assert alone.steps(device) == cases > measure.steps(grid, device, [])
    assert whole.steps(device) == cases + lens.steps(()) + warp.steps() * (device.kind == "cpu")
    mitsuba_alone = replace(whole, tools=["Mitsuba"])
    assert mitsuba_alone.steps(device) == measure.steps(grid, device, []) + lens.steps(compare.QUICK.samples)


@pytest.mark.slow  # each peer takes its time
def test_a_comparison_has_the_rows_of_its_peers(session: Session) -> None:
    pytest.importorskip("cv2")
    grid = replace(BenchGrid(), sizes=(24,), radii=(2.0,), channels=(1,), rounds=1, longest_s=100.0, slowest=inf)
    task = Comparison(grid, None, ["OpenCV"], {})
    calls: list[int] = []
    found = task.measured(session.device, lambda: calls.append(1))
    assert len(calls) == task.steps(session.device)
    assert {(row.method, row.psf) for row in found.rows if row.tool == "OpenCV"} == {
        (peer.method, peer.psf) for peer in peers.PEERS if peer.tool == "OpenCV"
    }
    assert (found.lens, found.warp, found.settings["compare"]) == (None, [], ["OpenCV"])
    assert any(name.startswith("opencv") for name in found.versions)


def test_missing_peers_are_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    there = importlib.util.find_spec

    def without(*missing: str) -> None:
        monkeypatch.setattr(peers, "find_spec", lambda name: None if name in missing else there(name))

    without("numba", "cv2", "mitsuba")
    result = CliRunner().invoke(main, ["blur", "-o", str(tmp_path / "out"), "--quick", "--compare"])
    message = "error: --compare: needs numba or OpenCV or Mitsuba: pip install 'clsco[bench]'; got no such module"
    assert (result.exit_code, result.stdout, result.stderr.splitlines()) == (1, "", [message])
    assert not (tmp_path / "out").exists()
    without("cv2", "mitsuba")
    assert peers.require_peers() == (["numba"], dict.fromkeys(("OpenCV", "Mitsuba"), peers.NOT_INSTALLED))


# Numba compiles each for seconds.
@pytest.mark.parametrize(
    "peer",
    [pytest.param(peer, marks=pytest.mark.slow if peer.tool == "numba" else ()) for peer in peers.PEERS],
    ids=lambda peer: f"{peer.tool}-{peer.method}-{peer.psf}",
)
def test_peers_do_the_same(peer: Peer) -> None:
    pytest.importorskip(peers.MODULES[peer.tool])
    radii = radius_map(40, 3.3) if peer.scene == "varying" else np.full((40, 40), 3.3)
    image = np.random.default_rng(0).random((40, 40), dtype=np.float32)
    found = peer.set_up(image, radii)()
    exact = measure.reference(image[..., None], radii, PSFS[peer.psf])[..., 0]
    error = np.abs(found - exact).max()
    # GaussianBlur samples where clsco integrates; a table of floats is linear between its radii.
    assert error < (5e-3 if peer.method == "GaussianBlur" else 2e-5)
    assert np.abs(found - image).max() > 0.1
