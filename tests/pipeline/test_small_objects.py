"""Small things give their light: radiance times the area of the image, wherever they are between rays."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import clsco
from clsco.optics.lens import ray_step
from clsco.scene.model import Camera
from tests.scenes import plan_scene, scene_from
from tests.slow import mostly_slow

SIDE, DEPTH = 32, 250.0  # px, mm
SHARP, BLURRED, WIDE = 250.0, 166.667, 83.333  # mm in focus, by which R is 0, 2 and 8 px at DEPTH
Array = NDArray[np.float64]
# Places of the middle within its pixel, px right and up; and of 16 of them in one image, in the middles of blocks.
PLACES = np.random.default_rng(5).uniform(-0.5, 0.5, (16, 2))
BLOCK = 24
APART = PLACES + BLOCK * np.array([[x, y] for y in (1.5, 0.5, -0.5, -1.5) for x in (-1.5, -0.5, 0.5, 1.5)]) + 0.5
WALL: dict[str, Any] = {"shape": "plane", "distance": 260.0}
# Out of sight: with shapes of all kinds most scenes have the same programs, which take far longer than their frames.
BESIDE: list[dict[str, Any]] = [
    {"shape": "sphere", "center": [900.0, 0.0, DEPTH], "radius": 0.1},
    {"shape": "rectangle", "center": [901.0, 0.0, DEPTH], "size": [0.1, 0.1]},
    {"shape": "cone", "apex": [902.0, 0.0, DEPTH], "half_angle": 1.0, "nappe": "towards"},
]


def camera(focus: float = SHARP, side: int = SIDE) -> dict[str, Any]:
    return {"resolution": [side, side], "pixel_pitch": 0.02, "focus_distance": focus, "aperture_diameter": 2.0}


def mm_per_px(focus: float, depth: float = DEPTH) -> float:
    """Length at a depth whose image is 1 px."""
    return ray_step(Camera(**camera(focus))) * depth


def image(
    *items: dict[str, Any], focus: float = SHARP, engine: str = "device", side: int = SIDE, occlusion: str = "none"
) -> Array:  # fmt: skip
    items += () if occlusion == "visibility" else tuple(BESIDE)
    white = [{"texture": "#ffffff"} | {key: value for key, value in item.items() if key != "area"} for item in items]
    made = scene_from({"camera": camera(focus, side), "psf": {"occlusion": occlusion}}, *white)
    frame = next(iter(clsco.reference.render(made))) if engine == "reference" else clsco.render_frame(made, truth=())
    return np.asarray(frame.color, np.float64).reshape(side, side)


def ball(size: float, place: Array, focus: float = SHARP, depth: float = DEPTH, **keys: Any) -> dict[str, Any]:
    """A ball of so many px of diameter."""
    px = mm_per_px(focus, depth)
    center = np.array([*(px * place), depth])
    area = math.pi / 4.0 * size**2 * float(np.linalg.norm(center)) / depth  # px^2
    return {"shape": "sphere", "center": center.tolist(), "radius": 0.5 * size * px, "area": area} | keys


def card(width: float, height: float, lean: float, place: Array, focus: float) -> dict[str, Any]:
    px = mm_per_px(focus)
    turn = {"center": [*(px * place), DEPTH], "rotation": [0.0, 0.0, lean]}
    return {"shape": "rectangle", "size": [width * px, height * px], "area": width * height} | turn


def check(light: Array | list[float]) -> None:
    """2 % of each, and 0.5 % of their mean."""
    np.testing.assert_allclose(light, 1.0, atol=0.02)
    assert abs(np.mean(light) - 1.0) < 0.005


def by_block(frame: Array) -> Array:
    """Light (16,) of the blocks of an image."""
    return frame.reshape(4, BLOCK, 4, BLOCK).sum(axis=(1, 3)).ravel()


def lights(item: Callable[[Array], dict[str, Any]], focus: float, occlusion: str = "none") -> Array:
    """Light of 16 of a thing, each somewhere in a pixel and far from the others, over its area, in one image."""
    items = [item(place) for place in APART]
    frame = image(*items, focus=focus, side=4 * BLOCK, occlusion=occlusion)
    return by_block(frame) / np.array([each["area"] for each in items])


@pytest.mark.parametrize("focus", [SHARP, BLURRED, WIDE])
@pytest.mark.parametrize("size", mostly_slow([0.05, 0.45, 1.6, 5.0], [0.05, 0.45, 1.6]))
def test_balls(size: float, focus: float) -> None:
    check(lights(lambda place: ball(size, place, focus), focus, "visibility"))


@pytest.mark.parametrize(("width", "height", "lean"), [(0.2, 10.0, 0.0), (0.2, 10.0, 7.0), (0.3, 0.3, 30.0)])
@pytest.mark.parametrize("focus", [SHARP, BLURRED])
def test_cards(width: float, height: float, lean: float, focus: float) -> None:
    check(lights(lambda place: card(width, height, lean, place, focus), focus))


@pytest.mark.parametrize("size", [0.1, 0.8, 3.0])
def test_discs_that_lean(size: float) -> None:
    px, normal = mm_per_px(SHARP), np.array([0.0, -math.sin(math.radians(50.0)), math.cos(math.radians(50.0))])

    def disc(place: Array) -> dict[str, Any]:
        center = np.array([*(px * place), DEPTH])
        # The projection of a small area: A (normal . P) / Z^3, in px^2.
        area = math.pi * size**2 / 4.0 * abs(float(normal @ center)) / DEPTH
        turned = {"center": center.tolist(), "rotation": [50.0, 0.0, 0.0]}
        return {"shape": "disc", "radius": 0.5 * size * px, "area": area} | turned

    check(lights(disc, SHARP))


@pytest.mark.parametrize("lean", [0.0, 5.0, 45.0, 88.0])
@pytest.mark.parametrize("width", [0.1, 0.4, 2.0])
def test_wires_row_by_row(width: float, lean: float) -> None:
    """Each row, or column, of the frame has the same light."""
    px, angle = mm_per_px(SHARP), math.radians(lean)
    for place in PLACES[:2]:
        axis = [math.sin(angle), math.cos(angle), 0.0]
        frame = image({"shape": "cylinder", "center": [*(px * place), DEPTH], "radius": 0.5 * width * px, "axis": axis})
        along = frame.sum(axis=1 if lean <= 45.0 else 0)[4:-4]
        np.testing.assert_allclose(along, width / max(math.sin(angle), math.cos(angle)), rtol=0.01)


@pytest.mark.parametrize("half_angle", [2.0, 8.0])
def test_tips_of_cones(half_angle: float) -> None:
    """Down to the tip each row has the light of the two lines there."""
    px = mm_per_px(SHARP)
    for place in PLACES[:2]:
        item = {"shape": "cone", "apex": [*(px * place), DEPTH], "half_angle": half_angle, "rotation": [90.0, 0.0, 0.0]}
        along = image(item).sum(axis=1)
        up = along[0] < along[-1]
        rows = (SIDE - 1) / 2.0 - place[1] - np.arange(SIDE)
        rows = -rows if up else rows
        # Mean over a row of the width, 0 above the tip; lines of a cone that stands upright lean by half_angle.
        low, high = np.maximum(rows - 0.5, 0.0), np.maximum(rows + 0.5, 0.0)
        expected = math.tan(math.radians(half_angle)) * (high**2 - low**2)
        np.testing.assert_allclose(along[4:-4], expected[4:-4], atol=0.01, rtol=0.01)


def test_what_is_in_front_in_one_pixel() -> None:
    """A ball hides what is behind it in a pixel, as much as the two discs have in common."""
    size, half = 0.8, 0.4
    away = np.linspace(0.1, 1.0, 16)
    shifted = APART + away[:, None] * [1.0, 0.0]
    near = [ball(size, place, depth=240.0, texture="#000000") for place in shifted]
    common = 2.0 * half**2 * np.arccos(np.minimum(away / size, 1.0))
    common -= 0.5 * away * np.sqrt(np.maximum(size**2 - away**2, 0.0))
    lit = by_block(image(*(ball(size, place) for place in APART), *near, side=4 * BLOCK))
    np.testing.assert_allclose(lit, math.pi * half**2 - common, atol=0.02 * math.pi * half**2)


@pytest.mark.parametrize(("size", "focus"), [(0.45, SHARP), (2.0, SHARP), (0.45, WIDE)])
def test_black_before_white(size: float, focus: float) -> None:
    """A ball hides the area of its image of a wall, although no ray through the middle of a pixel may meet it."""
    balls = [ball(size, place, focus, texture="#000000") for place in APART]
    whole, cut = (image(WALL, *items, focus=focus, side=4 * BLOCK) for items in ([], balls))
    check(by_block(whole - cut) / np.array([each["area"] for each in balls]))


@pytest.mark.parametrize("method", mostly_slow(["gather", "scatter", "tiles"], ["gather"]))
def test_moving_over_pixels_with_alpha(method: Any) -> None:
    """Every time sample has the light of the ball, and coverage is that light."""
    size = 0.45
    item = ball(size, PLACES[0], BLURRED, motion={"velocity": [100.0 * mm_per_px(BLURRED), 30.0, 0.0]})
    item = {key: value for key, value in item.items() if key != "area"} | {"texture": "#ffffff"}
    made = scene_from({"camera": camera(BLURRED), "sequence": {"samples": 4, "interval": 0.04}}, item)
    frame = clsco.render_frame(made, truth=("alpha",), method=method)
    for plane in (frame.color, frame.alpha):
        assert float(np.asarray(plane, np.float64).sum()) == pytest.approx(math.pi * size**2 / 4.0, rel=0.01)


def test_a_ball_in_a_wide_lens_keeps_its_light() -> None:
    """Nine times larger than life at f/1.8, where slopes of R are 1/4 px per px and more."""
    close: dict[str, Any] = {
        "focal_length": 9.0,
        "aperture_diameter": 5.0,
        "pixel_pitch": 0.01,
        "sensor_distance": 90.0,
    }
    light = []
    for place in PLACES[:8]:
        step = ray_step(Camera(**close, resolution=(64, 64))) * 9.7
        item = {"shape": "sphere", "center": [*(step * place), 9.7], "radius": 0.5 * step, "texture": "#ffffff"}
        made = scene_from({"camera": close | {"resolution": [64, 64]}}, item)
        light.append(float(np.sum(clsco.render_frame(made, truth=()).color, dtype=np.float64)) / (math.pi / 4.0))
    check(light)


def test_the_plan_knows_of_what_rays_miss() -> None:
    """A ball between the rays of the plan's coarse grid has a radius of blur, and silhouettes."""
    made = scene_from({"camera": camera(WIDE)}, {"shape": "sphere", "center": [3.0, 2.0, DEPTH], "radius": 0.001})
    plan = plan_scene(made, 1)
    assert plan.small
    assert plan.largest_blur > 5.0
    assert plan.blur != "none"


def test_light_is_at_its_place() -> None:
    side = np.arange(SIDE) - (SIDE - 1) / 2.0
    for size, place in zip((0.45, 0.9, 1.6, 3.0), PLACES, strict=False):
        found = image(ball(size, place, BLURRED), focus=BLURRED)
        middle = np.array([found.sum(axis=0) @ side, -found.sum(axis=1) @ side]) / found.sum()
        np.testing.assert_allclose(middle, place, atol=0.02)


def test_the_reference_agrees() -> None:
    for item in (ball(0.45, PLACES[1], BLURRED), card(0.3, 5.0, 20.0, PLACES[2], BLURRED)):
        ours, theirs = (image(item, focus=BLURRED, engine=engine) for engine in ("device", "reference"))
        np.testing.assert_allclose(ours, theirs, atol=1e-6)
