"""Passes of a plan hand on what they name; a plan that was too small is made larger in one place."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from clsco.constants import STATISTIC_BEYOND, STATISTIC_LARGEST, STATISTIC_SMALLEST
from clsco.optics.point_spread import point_spread
from clsco.plan.buffers import STATISTICS
from clsco.plan.device import ThisMachine
from clsco.plan.image import ImagePlan
from clsco.plan.larger import SourceStatistics, larger_plan
from clsco.plan.memory import limit_of
from clsco.plan.methods import BlurSpec, Choice
from clsco.plan.passes import Pass, run_passes
from clsco.plan.plan import Plan
from clsco.scene.model import DepthMap, Motion, ObjectMotion, Plane, Psf, Sequence, Sphere
from tests.scenes import plan_of, plan_scene, scene_of

BALL, WALL = Sphere(name="ball", center=(0.0, 0.0, 200.0), radius=20.0), Plane(name="wall", distance=300.0)
MOVING = Sphere(center=(0.0, 0.0, 200.0), radius=20.0, motion=ObjectMotion(velocity=(9.0, 0.0, 0.0)))
MAP = DepthMap(texture=np.ones((8, 12), np.float32), depth=np.full((8, 12), 250.0))
SPEC = BlurSpec(point_spread(Psf()), "gather", 1.0, 4.0)
PLANS: dict[str, Plan | ImagePlan] = {
    "rays": plan_of(BALL),
    "groups": plan_of(BALL, WALL),
    "depth layers": plan_of(BALL, WALL, psf=Psf(occlusion="layered")),
    "one radius": plan_of(Plane(distance=300.0)),
    "in focus": plan_of(Plane(distance=250.0), camera={"focus_distance": 250.0}),
    "moving": plan_of(MOVING, sequence=Sequence(samples=3)),
    "forward warp": plan_of(
        MOVING, truth=("missing",), sequence=Sequence(samples=3), motion=Motion(warp="forward"), psf=Psf(tilt=False)
    ),
    "missing pixels alone": plan_of(MOVING, truth=("missing",), color=False, motion=Motion(warp="forward")),
    "static map": plan_scene(scene_of(MAP, size=(12, 8)), 1, maps=(np.full((8, 12), 1 / 300.0),)),
    "image": ImagePlan(SPEC, ThisMachine(), 40, 30, 3, 5),
    "image with layers": ImagePlan(replace(SPEC, layered=True), ThisMachine(), 40, 30, 3, 5),
    "image of one radius": ImagePlan(replace(SPEC, method="convolve"), ThisMachine(), 40, 30, 3, 5),
}


@pytest.mark.parametrize("name", PLANS)
def test_each_pass_is_handed_what_it_takes(name: str) -> None:
    """By an earlier one; in the end there is a plane, and of several time samples a frame."""
    passes = [step for step in PLANS[name].passes if step.kind != "ground truth"]
    ran: list[Pass] = []

    def run(step: Pass, *given: str) -> list[str]:
        assert [name.split()[0] for name in given] == list(step.takes)
        ran.append(step)
        return [f"{name} of {step.kind}" for name in step.gives]

    found = run_passes(passes, run)
    assert ran == passes
    assert len({step.gives for step in passes if step.gives}) > 0
    if name != "missing pixels alone":
        assert found["plane"].split(" of ")[1] in ("blur", "depth layers", "trace")
    assert ("frame" in found) == (name in ("moving", "forward warp"))
    assert ("missing" in found) == (name in ("forward warp", "missing pixels alone"))


def test_a_pass_that_lacks_what_it_takes_is_refused() -> None:
    with pytest.raises(KeyError, match="image"):
        run_passes([Pass("sources", (), {}, ("image",), ("sources",))], lambda step, *given: given)
    with pytest.raises(ValueError, match="argument 2 is longer"):
        run_passes([Pass("pinhole", (), {})], lambda step: ["more than it names"])


def met(plan: Plan, **changes: Any) -> SourceStatistics:
    """Statistics of sources that a plan has just room for, with some changes."""
    return replace(SourceStatistics(plan.smallest_blur, plan.largest_blur, False), **changes)


def test_a_plan_grows_where_a_frame_has_met_more() -> None:
    plan, limit = plan_of(BALL, WALL), limit_of(None)
    assert plan.silhouettes > 0
    assert larger_plan(plan, met(plan), limit) is None
    assert larger_plan(plan, SourceStatistics(0.0, 0.0, True), limit) is None  # no source at all
    wider = larger_plan(plan, met(plan, largest=plan.largest_blur + 9.0), limit)
    assert wider is not None
    assert wider.largest_blur >= plan.largest_blur + 9.0
    assert wider.guard_px > plan.guard_px
    sharper = larger_plan(plan, met(plan, smallest=plan.smallest_blur / 2.0), limit)
    assert sharper is not None
    assert sharper.smallest_blur <= plan.smallest_blur / 2.0
    assert sharper.guard_px == plan.guard_px
    anywhere = larger_plan(plan, met(plan, beyond=True), limit)
    assert anywhere is not None
    assert [group.occluders for group in anywhere.groups] == [2, 1]
    assert (anywhere.occlusion, anywhere.extents) == ("visibility", ())


def test_a_plan_of_a_graphics_card_tests_what_is_in_the_way_where_a_frame_has_met_more() -> None:
    scattered = plan_of(BALL, WALL, device=ThisMachine(kind="gpu"))
    assert scattered.blur == "scatter"
    apart = replace(scattered, choices=replace(scattered.choices, blur=Choice("tiles")))
    anywhere = larger_plan(apart, met(apart, beyond=True), limit_of(None))
    assert anywhere is not None
    assert anywhere.blur == "scatter"


def test_what_a_frame_has_met_is_read_from_its_statistics() -> None:
    found = np.zeros(STATISTICS, np.int32)
    found.view(np.float32)[[STATISTIC_SMALLEST, STATISTIC_LARGEST]] = 0.5, 7.25
    assert SourceStatistics.parse(found) == SourceStatistics(0.5, 7.25, False)
    found[STATISTIC_BEYOND] = 1
    assert SourceStatistics.parse(found).beyond
