"""Previews: how small they are, and what they leave out; and the line of what a picture takes."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from click.testing import CliRunner
from numpy.typing import NDArray

import clsco
from clsco.cli.main import main
from clsco.engine.probe import measure_frame
from clsco.files.transfer import encode
from clsco.plan.prepare import prepare, with_resolution
from clsco.studio.ladder import BUDGET, SLOW, Ladder, Ladders, choices_of, coarser, plan_line, work_of
from tests.studio.browser import EXAMPLES
from tests.studio.test_preview import scene


@pytest.mark.parametrize("fixed", [0.001, 0.006])
def test_the_ladder_keeps_to_its_budget(fixed: float) -> None:
    ladder, work = Ladder(), 512.0 * 512.0
    for seconds_full in (0.010, 0.130, 0.190):
        for _ in range(30):
            size = ladder.eighths(work)
            ladder.measured(work, size, fixed + seconds_full * (size / 8) ** 2)
        assert ladder.predicted(work, size) == pytest.approx(fixed + seconds_full * (size / 8) ** 2, rel=0.05)
        assert ladder.predicted(work, size) <= BUDGET
        assert size == 8 or ladder.predicted(work, size + 1) > BUDGET
    assert size == 3
    for seconds, least in ((0.9 * SLOW, 3), (2.0 * SLOW, 1)):  # smaller ones would be unlike the frame
        for _ in range(30):
            ladder.measured(work, 3, seconds)
        assert ladder.eighths(work) == least


def test_the_ladder_believes_a_stall_the_third_time() -> None:
    ladder, work = Ladder(), 1e5
    ladder.measured(work, 8, 0.020)
    for _ in range(2):
        ladder.measured(work, 8, 2.0)  # a compilation
        assert ladder.eighths(work) == 8
    ladder.measured(work, 8, 2.0)
    assert ladder.eighths(work) < 8


def test_the_ladder_climbs_step_by_step_and_not_on_noise() -> None:
    """Small pictures that happen to take as long as larger ones do not tell that the largest one fits."""
    ladder, work = Ladder(), 512.0 * 512.0
    for size, seconds in ((4, 0.127), (4, 0.132), (3, 0.350)):
        ladder.measured(work, size, seconds)
    assert ladder.eighths(work) <= 3
    ladder = Ladder()
    ladder.measured(work, 4, 0.001)
    assert ladder.eighths(work) == 5


def test_motion_is_left_out_where_the_budget_needs_it() -> None:
    """But never occlusion: lights behind a ball must not shine through it."""
    ladders, size, known = Ladders(), (512, 512), scene().replace("object.0.motion.velocity", [5.0, 0.0, 0.0])
    work, still = work_of(known, size), work_of(known, size, True)
    assert (work, still) == (3 * 512 * 512, 512 * 512)
    ladders.of[False].measured(work, 8, 0.5 * BUDGET)
    ladders.of[True].measured(still, 8, 0.5 * BUDGET)
    assert ladders.choose(known, size) == (False, 8)
    for _ in range(30):
        ladders.of[False].measured(work, 8, 6.0 * BUDGET)
    assert ladders.choose(known, size) == (True, 8)
    coarse = coarser(known, (64, 48), 8, True)
    assert (coarse.psf.occlusion, coarse.sequence.samples) == (known.psf.occlusion, 1)
    ladders.of[False].bounded(work, 0.9 * BUDGET)  # an exact frame came in time
    assert not ladders.choose(known, size)[0]
    assert choices_of(scene()) == choices_of(known.replace("sequence.samples", 1)) == (False,)


def test_a_small_picture_that_gains_nothing_is_not_taken() -> None:
    """If the time of every picture is beyond the budget, larger ones cost hardly more."""
    ladder, work = Ladder(), 512.0 * 512.0
    for _ in range(30):
        size = ladder.eighths(work)
        ladder.measured(work, size, 2.0 * BUDGET + 0.040 * (size / 8) ** 2)
    assert size >= 5


@pytest.mark.parametrize("name", ["evening", "occlusion_three"])
def test_previews_are_like_the_frame(name: str) -> None:
    known = clsco.load_scene(EXAMPLES / f"{name}.toml")
    columns, rows = size = with_resolution(known).camera.frame_size

    def codes(shown: clsco.Scene) -> NDArray[np.float64]:
        return encode(clsco.render_frame(shown, truth=(), device="pocl").color, 8, "srgb").astype(np.float64)

    exact = codes(known).reshape(rows // 2, 2, columns // 2, 2, -1).mean(axis=(1, 3))
    error = np.mean((codes(coarser(known, size, 4)).reshape(exact.shape) - exact) ** 2)
    assert 10.0 * np.log10(255.0**2 / error) >= 41.0


@pytest.mark.parametrize("eighths", [1, 3, 8])
def test_coarser_scenes_have_the_same_field_of_view(eighths: int) -> None:
    full = scene(pixel_pitch=0.02).replace("object.0.motion.velocity", [5.0, 0.0, 0.0])
    small = coarser(full, (64, 48), eighths)
    assert small.camera.resolution == (8 * eighths, 6 * eighths)
    assert small.camera.pixel_pitch * 8 * eighths == pytest.approx(0.02 * 64)
    assert small.psf.silhouette_samples == 1
    assert small.sequence.samples == 3
    assert work_of(full, (64, 48)) == 3 * 64 * 48


@pytest.mark.parametrize(("name", "views"), [("sphere", 1), ("stereo", 2)])
def test_the_line_is_that_of_the_command(name: str, views: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("clsco.engine.probe.measure_frame", partial(measure_frame, seconds=0.0))  # the first steps
    path = EXAMPLES / f"{name}.toml"
    passes, time, memory = plan_line(prepare(clsco.load_scene(path)), 0.0414).split(", ")
    assert passes == "3 passes"
    assert time == "41 ms"
    printed = CliRunner().invoke(main, ["plan", str(path)], env={"COLUMNS": "200"}).output
    (line,) = (line for line in printed.splitlines() if "memory on the device" in line)
    assert float(memory.removesuffix(" MiB")) == pytest.approx(views * float(line.split("MiB")[0].split()[-1]), abs=0.6)
