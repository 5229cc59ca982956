"""Passes that a scene is given, and above all those that it is not."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from math import inf
from typing import Any

import numpy as np
import pytest

from clsco.constants import TAP_LANES
from clsco.errors import SceneError
from clsco.frame.outputs import TRUTH_NAMES
from clsco.optics.image_motion import MOST_SAMPLES
from clsco.optics.lens import LARGEST_BLUR, blur_radius
from clsco.optics.point_spread import point_spread
from clsco.optics.resolved_view import guard_band
from clsco.plan.device import ThisMachine
from clsco.plan.larger import widen_plan
from clsco.plan.memory import device_bytes
from clsco.plan.methods import MANY_RADII
from clsco.plan.plan import Plan
from clsco.scene.model import (
    Camera,
    Cone,
    DepthMap,
    Disc,
    Fill,
    Motion,
    ObjectMotion,
    Plane,
    Psf,
    Quadric,
    Scene,
    Sequence,
    Sphere,
)
from tests.scenes import plan_of, plan_scene, scene_of

STILL = Plane(distance=280.0)
TILTED = Plane(distance=280.0, slope_x=0.5)
TWO_CORES, GPU = ThisMachine(compute_units=2), ThisMachine(kind="gpu")
BALL = Sphere()
RIGHT = ObjectMotion(velocity=(0.5, 0.0, 0.0))
TURN = ObjectMotion(angular_velocity=(0.0, 20.0, 0.0))
SPIN = ObjectMotion(angular_velocity=(0.0, 0.0, 20.0))
AWAY = ObjectMotion(velocity=(0.0, 0.0, 20.0))


def moving(item: Any, motion: ObjectMotion) -> Any:
    return item.model_copy(update={"motion": motion})


# name, plan, passes taken, passes left out with a word of the reason
BASIC = {"trace", "blur", "guard band"}
LARGE: dict[str, Any] = {"size": (640, 480)}
FORWARD = Motion(warp="forward")
SCENES = [
    ("plane at rest", plan_of(STILL), BASIC,
     {"motion": "nothing moves", "texture sampling": "nothing moves", "reproject": "no forward warp",
      "fill": "only a forward warp", "silhouettes": "no silhouette in sight", "tilt": "one radius",
      "renormalize": "lose", "color": "gray", "occlusion": "one object", "ground truth": "nobody asked"}),
    ("tilted plane", plan_of(TILTED), BASIC | {"tilt"}, {"silhouettes": "no silhouette in sight"}),
    ("tilt off", plan_of(TILTED, psf=Psf(tilt=False)), BASIC, {"tilt": "tilt = false"}),
    ("color", plan_of(TILTED, channels=3), BASIC | {"tilt", "color"}, {"motion": "nothing moves"}),
    ("sphere with its limb", plan_of(BALL, **LARGE), BASIC | {"tilt", "silhouettes"}, {"motion": "nothing moves"}),
    ("sphere filling the view", plan_of(BALL), BASIC | {"tilt"}, {"silhouettes": "in sight"}),
    ("silhouettes off", plan_of(BALL, **LARGE, psf=Psf(silhouette_samples=1)), BASIC | {"tilt"},
     {"silhouettes": "silhouette_samples = 1"}),
    ("moving sphere", plan_of(moving(BALL, RIGHT), **LARGE),
     BASIC | {"motion", "texture sampling", "tilt", "silhouettes"},
     {"reproject": "no forward warp", "fill": "only a forward warp"}),
    ("forward warp", plan_of(moving(BALL, TURN), **LARGE, motion=FORWARD),
     {"motion", "reproject", "fill", "blur", "tilt", "guard band"},
     {"trace": "replaced by the forward warp", "texture sampling": "whole pixels", "silhouettes": "whole pixels"}),
    ("forward warp without filling", plan_of(moving(BALL, TURN), **LARGE, motion=FORWARD, fill=Fill(method="none")),
     {"motion", "reproject", "blur", "tilt", "guard band"}, {"fill": "fill.method is none"}),
    ("forward warp of nothing", plan_of(STILL, motion=FORWARD), BASIC, {"reproject": "no forward warp"}),
    ("plane in focus", plan_of(Plane(distance=280.0), camera={"focus_distance": 280.0}, psf=Psf(edge="area")),
     {"trace", "guard band"}, {"blur": "in focus"}),
    ("light given back", plan_of(TILTED, psf=Psf(border="renormalize")), {"trace", "blur", "tilt", "renormalize"},
     {"guard band": "light stays inside"}),
    ("some truth", plan_of(TILTED, truth=("depth", "blur_radius")), BASIC | {"tilt", "ground truth"},
     {"other outputs": "sharp, mask, filled, missing, object_id, normal, flow, hidden"}),
    ("plane that turns in itself", plan_of(moving(STILL, SPIN)), BASIC | {"motion", "texture sampling"},
     {"tilt": "one radius"}),
]  # fmt: skip


@pytest.mark.parametrize(("given", "taken", "left"), [case[1:] for case in SCENES], ids=[case[0] for case in SCENES])
def test_what_is_taken_is_compiled_and_stored_and_the_rest_left_out(
    given: Plan, taken: set[str], left: dict[str, str]
) -> None:
    every = {"motion", "trace", "texture sampling", "reproject", "fill", "silhouettes", "tilt", "blur", "renormalize"}
    every |= {"guard band", "color", "occlusion", "ground truth"}
    parameters = {name for each in given.passes for name, _ in each.parameters}
    names = {each.kind for each in given.passes} | parameters | ({"motion"} if given.moves else set())
    assert names & every == taken
    reasons = dict(given.choices.left_out)
    for name, why in left.items():
        assert why in reasons[name]
    assert taken & reasons.keys() == set()
    assert taken | reasons.keys() - {"other outputs", "still sources"} == every
    assert all(text for each in given.passes for _, text in each.parameters)
    assert all(text for _, text in given.choices.left_out)
    features = given.features()
    assert bool(features["TILT"]) == ("tilt" in taken)
    assert bool(features["SUBPIXELS"]) == ("silhouettes" in taken) == bool(given.slots)
    assert bool(features["MOVED"]) == ("texture sampling" in taken)
    assert features["CHANNELS"] == (3 if "color" in taken else 1)
    assert (given.guard_px > 0) == ("guard band" in taken)
    assert (given.blur == "none") == ("blur" not in taken)
    assert (given.samples > 1) == ("motion" in taken)
    assert given.forward == ("reproject" in taken)


@pytest.mark.parametrize(
    ("items", "needed"),
    [
        ((STILL,), set()),
        ((BALL,), {"QUADRATIC"}),
        ((Cone(half_angle=40.0),), {"QUADRATIC", "NAPPE"}),
        ((Quadric(coefficients=(1.0, 2.0, 3.0, 0, 0, 0, 0, 0, 0, -100.0)),), {"QUADRATIC"}),
        ((Quadric(coefficients=(1.0, 2.0, 0, 0, 0, 0, 0, 0, -40.0, 0)),), {"QUADRATIC", "LINEAR"}),
        ((Quadric(coefficients=(0.0, 0, 0, 0, 0, 0, 0.1, 0, 1.0, 0)),), set()),
        ((STILL.model_copy(update={"bounds": ((-5.0, 5.0), (-5.0, 5.0), (-1.0, 1.0))}),), {"BOUNDED", "NAPPE"}),
        ((Disc(),), {"BOUNDED", "NAPPE"}),
        ((STILL, BALL), {"SEVERAL", "QUADRATIC", "LINEAR"}),
        ((BALL, Cone(half_angle=40.0)), {"SEVERAL", "QUADRATIC", "LINEAR", "NAPPE"}),
        ((BALL, Disc()), {"SEVERAL", "QUADRATIC", "LINEAR", "NAPPE", "BOUNDED"}),
    ],
)
def test_geometry_is_compiled_for_the_shapes(items: tuple[Any, ...], needed: set[str]) -> None:
    features = plan_of(*items).features()
    assert {name for name in ("SEVERAL", "QUADRATIC", "LINEAR", "NAPPE", "BOUNDED") if features[name]} == needed


@pytest.mark.parametrize(("name", "number"), [("nearest", 0), ("bilinear", 1), ("bicubic", 2)])
def test_texture_filter_and_table_form(name: Any, number: int) -> None:
    given = plan_of(moving(BALL, RIGHT), motion=Motion(texture_filter=name), psf=Psf(edge="sampled")).features()
    assert (given["FILTER"], given["SAMPLED"]) == (number, 1)
    assert plan_of(BALL).features()["SAMPLED"] == 0


# Samples


def test_samples_as_asked_and_one_at_rest() -> None:
    assert plan_of(moving(STILL, RIGHT), sequence=Sequence(samples=4)).samples == 4
    still = plan_of(STILL, sequence=Sequence(samples="auto"))
    assert still.samples == plan_of(STILL).samples == 1


def test_very_fast_motion_does_not_ask_for_endless_samples() -> None:
    item = moving(STILL, ObjectMotion(velocity=(1e6, 0.0, 0.0)))
    given = plan_of(item, sequence=Sequence(samples="auto"))
    assert given.samples == MOST_SAMPLES == 4095


# Blur


def test_radii_of_a_constant_plane_are_exact_and_others_have_a_margin() -> None:
    given = plan_of(STILL)
    radius = abs(float(blur_radius(given.scene.camera, 1.0 / 280.0)))
    assert given.smallest_blur == pytest.approx(radius, rel=1e-12)
    assert given.largest_blur == pytest.approx(radius, rel=1e-12)
    ball = plan_of(BALL, size=(640, 480))
    nearest = abs(float(blur_radius(ball.scene.camera, 1.0 / 250.0)))
    assert 0.0 <= ball.smallest_blur < nearest < ball.largest_blur


@pytest.mark.parametrize("depth", [200.0, 500.0])
def test_no_depth_of_a_map_is_missed(depth: float) -> None:
    """A single pixel that is nearer, or farther, than all others, and not one of those that are looked at; and no
    depth of pixels that show nothing is made up."""
    inverse_depth = np.full((300, 300), 1.0 / 280.0)
    inverse_depth[200:] = 0.0
    inverse_depth[13, 27] = 1.0 / depth
    item = DepthMap(depth="map.npy", center=(0.0, 0.0, 280.0))
    given = plan_scene(scene_of(item, size=(300, 300)), 1, maps=(inverse_depth,))
    radius = abs(float(blur_radius(given.scene.camera, 1.0 / depth)))
    assert radius < given.largest_blur <= 1.1 * radius + 1.0


def test_guard_band_holds_every_source_that_lights_the_frame() -> None:
    asked = Psf()
    given, psf = plan_of(TILTED, psf=asked), point_spread(asked)
    held, largest = given.guard_px, given.largest_blur
    assert held == guard_band(psf, "lose", largest)
    assert held % TAP_LANES == 0
    assert held < psf.reach(largest, True) + 3 + TAP_LANES  # 2 px to see silhouettes in
    assert (given.width, given.height) == (64 + 2 * held, 48 + 2 * held)
    assert guard_band(psf, "renormalize", 5.0) == 0
    flat = plan_of(STILL, psf=asked)
    assert flat.blur == "convolve"
    band = guard_band(psf, "lose", flat.largest_blur)
    assert flat.guard_px == band + 2 * TAP_LANES  # two vectors of sources may hang over


def test_widened() -> None:
    given = plan_of(BALL, size=(640, 480))
    wider = widen_plan(given, 0.25, given.largest_blur + 7.0)
    assert wider.smallest_blur == 0.25
    assert wider.largest_blur == given.largest_blur + 7.0
    assert wider.guard_px == guard_band(point_spread(Psf()), Psf().border, wider.largest_blur) > given.guard_px
    assert widen_plan(given, 0.0, 0.1).guard_px == given.guard_px
    with pytest.raises(SceneError, match=r"^camera: the blur radius must be at most 512 px; got 600 px$"):
        widen_plan(given, 0.0, 600.0)
    assert widen_plan(plan_of(BALL), 0.0, LARGEST_BLUR).largest_blur == LARGEST_BLUR


def test_too_large_a_blur_is_refused_with_its_number() -> None:
    item = Plane(distance=0.5)
    with pytest.raises(SceneError) as caught:
        plan_of(item)
    radius = abs(float(blur_radius(Camera(), 2.0)))
    assert radius > LARGEST_BLUR
    assert f"must be at most 512 px; got {radius:.4g} px (the surface comes as near as 0.5 mm;" in str(caught.value)


def test_too_large_tables_are_refused_with_their_size() -> None:
    wide = {"aperture_diameter": 400.0, "pixel_pitch": 0.006}
    with pytest.raises(SceneError, match=r"^psf: the tables of weights must take at most 1024 MiB; got \d{4,} MiB for"):
        plan_of(Sphere(), size=(640, 480), camera=wide, psf=Psf(silhouette_samples=8))


@pytest.mark.parametrize(
    ("psf", "helps"),
    [
        ({"model": "wave"}, "a larger psf.tail, less of psf.seidel, a smaller range of depths around the focus"),
        ({}, "less of psf.seidel, a smaller range of depths around the focus"),
    ],
)
def test_what_takes_less_of_too_large_tables_is_named(psf: dict[str, str], helps: str) -> None:
    """A wall has no silhouette whose samples might be fewer."""
    seidel = {"W040": 6.0, "W131": 8.0, "W222": 6.0}
    with pytest.raises(SceneError, match=rf"\(what takes less: {helps}\)$"):
        plan_of(
            Plane(distance=250.0, slope_x=0.3),
            camera={"f_number": 8.0},
            psf=Psf.model_validate(psf | {"seidel": seidel}),
        )


@pytest.mark.parametrize(("distance", "slope", "side"), [(400.0, 1.0, 1), (180.0, 0.2, -1), (250.0, 1.0, 0)])
def test_waves_have_tables_for_one_side_of_the_focus_where_there_is_one(
    distance: float, slope: float, side: int
) -> None:
    """Two terms of Seidel over a tilted wall took 1.4 GiB with tables for both."""
    psf = Psf.model_validate({"model": "wave", "seidel": {"W131": 2.0, "W222": 1.0 if side else 0.0}})
    camera = {"f_number": 8.0, "pixel_pitch": 0.01}
    plan = plan_of(Plane(distance=distance, slope_x=slope), size=(256, 256), camera=camera, psf=psf)
    assert tuple(most > 0.0 for most in plan.psf.most) == (side <= 0, side >= 0)
    assert widen_plan(plan, 0.0, 1.1 * plan.largest_blur).psf.most == (inf, inf)


def test_a_plan_needs_a_resolution() -> None:
    with pytest.raises(SceneError, match=r"^camera\.resolution: must be known"):
        plan_scene(Scene(objects=(STILL,)), 1)


# Methods


def test_method_by_itself() -> None:
    assert plan_of(STILL).blur == "convolve"
    assert plan_of(moving(STILL, AWAY)).blur == "convolve"
    assert plan_of(TILTED).blur == "gather"
    assert plan_of(moving(STILL, TURN)).blur == "gather"
    assert plan_of(STILL, psf=Psf(border="renormalize")).blur == "gather"
    assert plan_of(STILL.model_copy(update={"bounds": ((-2.0, 2.0), (-2.0, 2.0), (-1.0, 1.0))})).blur == "gather"
    assert plan_of(STILL, camera={"focus_distance": 280.0}, psf=Psf(edge="sampled")).blur == "none"


@pytest.mark.parametrize("method", ["gather", "scatter", "tiles"])
def test_method_as_asked(method: str) -> None:
    for item in (STILL, TILTED, BALL):
        assert plan_of(item, method=method).blur == method


@pytest.mark.parametrize(
    ("item", "sections"),
    [(TILTED, {}), (BALL, {}), (moving(STILL, TURN), {}), (STILL, {"psf": Psf(border="renormalize")})],
)
def test_convolve_is_refused_where_it_cannot_be(item: Any, sections: dict[str, Any]) -> None:
    with pytest.raises(SceneError, match=r"^method: convolve needs one blur radius"):
        plan_of(item, method="convolve", **sections)


CARD = Plane(distance=230.0, bounds=((-2.0, 2.0), (-2.0, 2.0), (-1.0, 1.0)))


def cards(occlusion: Any, method: str = "auto", gpu: bool = True) -> Plan:
    """Plan of a card before a plane."""
    return plan_of(CARD, TILTED, psf=Psf(occlusion=occlusion), method=method, device=GPU if gpu else None)


def method_of(given: Plan) -> str:
    """Method of the blur, in words."""
    return next(dict(each.parameters)["method"] for each in given.passes if each.kind == "blur")


def test_tiles_are_for_gpus() -> None:
    for item, gpu, expected in ((TILTED, False, "gather"), (TILTED, True, "tiles"), (STILL, True, "convolve")):
        assert plan_of(item, device=GPU if gpu else None).blur == expected
    assert plan_of(STILL, camera={"focus_distance": 280.0}, psf=Psf(edge="sampled"), device=GPU).blur == "none"


def test_what_is_in_the_way_is_tested_by_scatter_on_a_gpu() -> None:
    assert cards("visibility").groups[1].occluders
    assert method_of(cards("visibility")).endswith(
        "scatter: atomic, fixed point, as tiles do not test what is in the way"
    )
    assert [cards(way, gpu=False).blur for way in ("visibility", "layered", "none")] == ["gather"] * 3
    assert [cards(way).blur for way in ("layered", "none")] == ["tiles"] * 2
    assert method_of(cards("none")).endswith("tiles: many radii, a work-item per pixel")
    with pytest.raises(SceneError, match=r"^method: tiles needs sources with nothing in their way; got objects that"):
        cards("visibility", "tiles")
    with pytest.raises(SceneError, match=r"^method: gather needs a processor, .*; got a graphics card$"):
        cards("visibility", "gather")


@pytest.mark.parametrize("method", ["fast", "", "none", "Gather"])
def test_unknown_methods_are_refused(method: str) -> None:
    with pytest.raises(
        SceneError, match=rf"^method: must be one of auto, gather, scatter, tiles, convolve; got {method}$"
    ):
        plan_of(STILL, method=method)


@pytest.mark.parametrize(
    ("psf", "largest", "sharp"),
    [
        (Psf(edge="sampled"), 0.49, True),
        (Psf(edge="sampled"), 0.99, True),  # no other pixel center within the circle
        (Psf(edge="sampled"), 1.0, False),
        (Psf(model="gaussian", edge="sampled"), 0.7, True),  # 2 sigma = 0.99 px
        (Psf(model="gaussian", edge="sampled"), 0.72, False),
        (Psf(edge="area"), 0.5, True),
        (Psf(edge="area"), 0.51, False),
        (Psf(), 0.0, True),
        (Psf(), 1e-6, False),
    ],
)
def test_what_stays_sharp(psf: Psf, largest: float, sharp: bool) -> None:
    assert point_spread(psf).is_sharp(largest) == sharp
    assert (point_spread(psf).reach(largest) == 0) == sharp


def test_memory_and_work_grow_with_what_is_done() -> None:
    def memory(given: Plan) -> int:
        return device_bytes(replace(given, device=TWO_CORES))

    small, large = plan_of(BALL, size=(64, 48)), plan_of(BALL, size=(640, 480))
    assert 0 < memory(small) < memory(large)
    assert small.taps < large.taps
    gray, color, truth = (plan_of(BALL, channels=c, truth=t) for c, t in ((1, ()), (3, ()), (3, TRUTH_NAMES)))
    assert memory(gray) < memory(color) < memory(truth)
    moved = plan_of(moving(BALL, RIGHT), sequence=Sequence(samples=7))
    assert moved.taps == pytest.approx(7 * small.taps, rel=0.1)  # the ball goes 4 px
    # Pixels of frame and guard band, each spread over its disc of about pi (R + 0.7)^2 px.
    flat = plan_of(STILL)
    assert flat.taps == pytest.approx(flat.width * flat.height * 3.14159 * (flat.largest_blur + 0.7) ** 2, rel=1e-3)


def test_what_is_left_out_is_not_needed_elsewhere() -> None:
    """Depth layers are of whole pixels, whatever else a scene asks for: sub-pixel sources have no place in them."""
    box = ((-60.0, 60.0), (-60.0, 60.0), (-5.0, 60.0))
    cut = [item.model_copy(update={"bounds": box}) for item in (BALL, TILTED)]
    seen = set()
    for items in (*((item,) for item in cut), (cut[0], STILL), (moving(cut[0], TURN),)):
        warps = [("visibility", "inverse"), *product(("layered", "none"), ("inverse", "forward"))]
        for (occlusion, warp), samples in product(warps, (1, 4)):
            psf = {"occlusion": occlusion, "silhouette_samples": samples}
            found = plan_of(*items, psf=psf, motion={"warp": warp})
            seen.add((found.occlusion, bool(found.silhouettes)))
            if found.occlusion == "layered":
                assert found.silhouettes == 0
                assert found.blur in MANY_RADII
            assert found.occlusion in (occlusion, "none")
    assert seen == {("visibility", True), ("visibility", False), ("layered", False), ("none", True), ("none", False)}
