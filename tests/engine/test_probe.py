"""Predicted time of a frame beside the processor time that it takes."""

from __future__ import annotations

from time import process_time

import pytest

from clsco.constants import BAND
from clsco.engine.probe import _Clock, measure_frame
from clsco.engine.sequence import render_prepared
from clsco.opencl.session import Session
from clsco.plan.prepare import prepare
from clsco.plan.request import Request
from clsco.scene.examples import example
from clsco.scene.model import Scene

BALLS = example("occlusion_three").replace("camera.f_number", 2.0).replace("camera.resolution", (512, 256))
MOVING = example("sphere_moving").replace("sequence.samples", 9)


@pytest.mark.processor
@pytest.mark.parametrize(("scene", "seconds"), [(BALLS, 10.0), (BALLS, 0.0), (MOVING, 0.0)])
def test_a_part_of_a_frame_predicts_the_whole(session: Session, scene: Scene, seconds: float) -> None:
    prepared = prepare(scene, Request(("depth",)), session.device)
    time = measure_frame(session, prepared, seconds)
    assert (time.share == 1.0) == (seconds > 0.0)
    assert {*time.views[0]} == {step.kind for step in prepared.plan.passes}
    begin = process_time()
    list(render_prepared(session, [prepared], [0]))
    whole = (process_time() - begin) / session.device.compute_units
    assert 0.4 < time.seconds / whole < 2.5


def test_views_are_measured_each(session: Session) -> None:
    scene = example("stereo").replace("camera.resolution", (64, 48))
    time = measure_frame(session, prepare(scene, device=session.device))
    left, right = (sum(view.values()) for view in time.views)
    assert time.seconds == left + right
    assert left > 0.0 < right
    kind, share = time.longest
    assert share == sum(view[kind] for view in time.views) / time.seconds


@pytest.mark.processor
@pytest.mark.parametrize("seconds", [0.0, 1e9])
def test_time_goes_by_the_runs_of_a_pass(session: Session, monkeypatch: pytest.MonkeyPatch, seconds: float) -> None:
    monkeypatch.setattr(_Clock, "lap", lambda clock: 1.0)
    prepared = prepare(MOVING.replace("sensor", {}).replace("camera.resolution", (64, 4 * BAND)), device=session.device)
    (passes,) = measure_frame(session, prepared, seconds).views
    strips = prepared.plan.rows // BAND
    assert passes["sensor"] == strips
    assert passes["blur"] == passes["accumulate"] == strips * prepared.plan.subframes
