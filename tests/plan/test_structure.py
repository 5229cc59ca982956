"""Structure of a scene in its plan: features of kernels, methods, layers, strips, and its words."""

from __future__ import annotations

from dataclasses import fields, replace
from itertools import product
from math import floor
from typing import Any

import numpy as np
import pytest

from clsco.constants import BAND
from clsco.frame.outputs import TRUTH_NAMES
from clsco.optics.lens import Lens
from clsco.optics.point_spread import point_spread
from clsco.optics.resolved_view import guard_band, is_forward, shifts_view
from clsco.plan.device import ThisMachine
from clsco.scene.model import Camera, CameraMotion, DepthMap, ObjectMotion, Plane, Psf, Sphere, Stereo
from tests.plan.test_plan import method_of
from tests.scenes import plan_of, plan_scene, scene_of

STILL = Plane(distance=280.0)
TILTED = Plane(distance=280.0, slope_x=0.5)
BALL = Sphere()
CARD = Plane(distance=230.0, bounds=((-2.0, 2.0), (-2.0, 2.0), (-1.0, 1.0)))
MOVING = Plane(distance=280.0, motion=ObjectMotion(velocity=(0.5, 0.0, 0.0)))
MODELS = [(model, edge) for model in ("pillbox", "gaussian") for edge in ("sampled", "area", "integrated")]


def test_rays_are_asked_for_motion_where_something_moves_or_is_seen_twice() -> None:
    motion = {"flow", "hidden"}
    still = plan_of(BALL, STILL, truth=TRUTH_NAMES)
    assert motion < {*still.truth}
    assert motion & {*still.device_truth} == set()
    assert motion <= {*plan_of(BALL, MOVING, truth=TRUTH_NAMES).device_truth}
    assert motion <= {*plan_of(BALL, STILL, truth=TRUTH_NAMES, stereo=Stereo(baseline=6.0)).device_truth}


def test_kernels_have_room_for_all_that_may_be_in_the_way_of_a_layer() -> None:
    """Nothing is before the card; before the plane is the card."""
    given = plan_of(CARD, TILTED)
    assert sorted(group.occluders for group in given.groups) == [0b00, 0b01]
    assert (given.spec.occluders, given.spec.limited) == (4, True)  # four at least
    assert (plan_of(TILTED).spec.occluders, plan_of(TILTED).spec.limited) == (0, False)


@pytest.mark.parametrize("occlusion", ["none", "layered"])
def test_without_rays_to_the_lens_all_objects_are_in_one_layer(occlusion: Any) -> None:
    groups = plan_of(CARD, TILTED, BALL, psf=Psf(occlusion=occlusion)).groups
    assert [(group.members, group.occluders) for group in groups] == [(0b111, 0)]


def test_a_map_among_others_is_moved_pixel_by_pixel() -> None:
    for items in ((DepthMap(depth="map.npy"), STILL), (STILL, DepthMap(depth="map.npy"))):
        assert is_forward(scene_of(*items), "left")
    assert not is_forward(scene_of(DepthMap(depth="map.npy")), "left")


def test_which_eye_sees_the_scene_from_elsewhere() -> None:
    """The left one is the scene's camera, unless both are turned inwards."""
    for eye in ("left", "right"):
        assert not shifts_view(scene_of(STILL), eye)
        assert shifts_view(scene_of(STILL, stereo=Stereo(baseline=6.0)), eye) == (eye == "right")
        assert shifts_view(scene_of(STILL, stereo=Stereo(baseline=6.0, toe_in=0.5)), eye)


def test_which_cameras_see_a_plane_with_one_radius() -> None:
    """It stays parallel to the detector if the camera only turns about its axis, and stands beside another."""
    assert plan_of(STILL, camera={"motion": CameraMotion(angular_velocity=(0.0, 0.0, 20.0))}).blur == "convolve"
    assert plan_of(STILL, camera={"motion": CameraMotion(angular_velocity=(0.0, 20.0, 0.0))}).blur == "gather"
    assert plan_of(STILL, stereo=Stereo(baseline=6.0)).blur == "convolve"
    assert plan_of(STILL, stereo=Stereo(baseline=6.0, toe_in=0.5)).blur == "gather"


def test_a_wide_gaussian_is_blurred_from_half_a_pixel_on() -> None:
    """There no radius is too small any more, and its cut is 10 px away."""
    wide = point_spread(Psf(model="gaussian", edge="sampled", sigma_ratio=10.0))
    assert wide.is_sharp(0.499)
    assert not wide.is_sharp(0.5)
    assert wide.reach(0.5) == 10


@pytest.mark.parametrize(("model", "edge"), MODELS)
def test_guard_bands_hold_what_lights_the_frame_and_two_pixels_more(model: Any, edge: Any) -> None:
    psf = point_spread(Psf(model=model, edge=edge))
    for tenths in range(1, 300):
        largest = 0.1 * tenths
        assert guard_band(psf, "lose", largest) >= max(psf.reach(largest), psf.reach(largest, True)) + 2


@pytest.mark.parametrize("edge", ["sampled", "area", "integrated"])
@pytest.mark.parametrize("radius", [3.4, 4.4])
def test_strips_have_as_many_rows_around_them_as_may_matter(radius: float, edge: Any) -> None:
    """Sources anywhere in their pixels light pixels less than R + 1 px away; 2 px more are to see silhouettes in."""
    camera = Camera()
    lens = Lens.of(camera)
    distance = 1.0 / (lens.focus_power - radius / lens.blur_scale)
    whole = plan_of(Plane(distance=distance), size=(16, 4 * BAND), psf=Psf(edge=edge, border="renormalize"))
    assert whole.largest_blur == pytest.approx(radius)
    given, far = replace(whole, strip_rows=BAND), floor(radius + 1.0) + 2
    assert given.reach_px == far
    assert [(strip.above, strip.below) for strip in given.strips] == [(0, far), (far, far), (far, far), (far, 0)]


# Words


def test_why_scatter_is_only_reported_where_tiles_would_do_but_for_what_is_in_the_way() -> None:
    why = "as tiles do not test what is in the way"
    visible, plain = Psf(occlusion="visibility"), Psf(occlusion="none")
    gpu = ThisMachine(kind="gpu")
    for psf, device, method in product((visible, plain), (gpu, None), ("auto", "scatter")):
        reported = method_of(plan_of(CARD, TILTED, method=method, device=device, psf=psf))
        assert (why in reported) == (psf is visible and device is gpu and method == "auto")


def test_outputs_that_nobody_asked_for_are_reported_beside_some_that_are_wanted() -> None:
    for truth in ((), TRUTH_NAMES):
        assert "other outputs" not in dict(plan_of(STILL, truth=truth).choices.left_out)
    assert "depth" in dict(plan_of(STILL, truth=("blur_radius",)).choices.left_out)["other outputs"]


def test_reasons_are_those_that_were_decided_by() -> None:
    """Words that were told of other scenes are not told of these."""
    flat = dict(plan_of(CARD, TILTED, BALL, psf=Psf(occlusion="layered")).choices.left_out)
    assert flat["silhouettes"] == "depth layers have whole pixels"
    still = plan_scene(scene_of(DepthMap(depth="map.npy")), 1, maps=(np.full((48, 64), 1.0 / 280.0),))
    assert dict(still.choices.left_out)["fill"] == "a depth map is filled as it is read"
    assert dict(plan_of(STILL, truth=("flow_backward",)).choices.left_out)["ground truth"] == "nothing moves"
    assert dict(plan_of(STILL, color=False).choices.left_out).keys() == {"image"}


def test_a_part_is_left_out_by_its_own_decision() -> None:
    """Every decision of a plan is named once, and has a reason where it leaves a part out."""
    for given in (plan_of(STILL), plan_of(MOVING), plan_of(CARD, TILTED), plan_of(BALL, size=(640, 480))):
        decided = {field.name: getattr(given.choices, field.name) for field in fields(given.choices)}
        left = {name.replace("_", " "): one.reason for name, one in decided.items() if one.left_out}
        assert dict(given.choices.left_out) == left
        assert all(left.values())
