"""Outlines along and across columns: the light in a row of pixels is the area beside an outline, in closed form."""

from __future__ import annotations

import math
from itertools import product
from typing import Any, Literal

import numpy as np
import pytest
from numpy.typing import NDArray

import clsco
from clsco.optics.lens import ray_step
from clsco.scene.model import Camera
from tests.pipeline.test_small_objects import BESIDE
from tests.scenes import scene_from
from tests.slow import combined, mostly_slow

SIDE, DISTANCE, HALF = 24, 250.0, 300.0  # px, mm, mm
CAMERA: dict[str, Any] = {
    "resolution": [SIDE, SIDE],
    "pixel_pitch": 0.1,
    "focus_distance": 245.0,
    "aperture_diameter": 2.0,
}
MIDDLE = slice(8, 16)  # rows that an outline at 45 degrees crosses inside of the frame
STEP = ray_step(Camera(**CAMERA))
Engine = Literal["device", "reference"]
ENGINES = combined(
    ("device", "reference"), (True, False), kept=[*product(["device"], [True, False]), ("reference", True)]
)


def light(item: dict[str, Any], samples: int, engine: Engine) -> NDArray[np.float64]:
    """Image (SIDE, SIDE) of a white thing that is blurred a little."""
    made = scene_from({"camera": CAMERA, "psf": {"silhouette_samples": samples}}, {**item, "texture": "#ffffff"})
    return rendered(made, engine)


def rendered(made: clsco.Scene, engine: Engine) -> NDArray[np.float64]:
    frame = next(iter(clsco.reference.render(made))) if engine == "reference" else clsco.render_frame(made, truth=())
    return np.asarray(frame.color, np.float64).reshape(frame.color.shape[:2])


ANGLES, BOTH = (0.0, 2.0, 9.0, 45.0), (True, False)


@pytest.mark.parametrize(
    ("samples", "engine", "angle", "upright"),
    combined(
        (4, 3), ("device", "reference"), ANGLES, BOTH,
        kept=[*product([4], ["device"], ANGLES, BOTH), (4, "reference", 9.0, True)],
    ),
)  # fmt: skip
def test_light_beside_a_straight_edge(angle: float, upright: bool, samples: int, engine: Engine) -> None:
    """A card ends in the frame, `angle` degrees from a column or row, anywhere between cells."""
    turn = angle if upright else angle + 90.0
    normal = np.array([math.cos(math.radians(turn)), math.sin(math.radians(turn))])
    at = (np.arange(SIDE) - 0.5 * (SIDE - 1))[MIDDLE]  # rows down or columns right of the middle, px
    for offset in (0.0, 0.06, 0.12, 0.19):
        end = np.array([offset, 0.0] if upright else [0.0, -offset])  # px right and up
        center = [*(end * STEP * DISTANCE - HALF * normal), DISTANCE]
        card = {"shape": "rectangle", "center": center, "size": [2 * HALF, 2 * HALF], "rotation": [0.0, 0.0, -turn]}
        found = light(card, samples, engine).sum(axis=1 if upright else 0)[MIDDLE]
        expected = 0.5 * SIDE + (offset if upright else -offset) + at * math.tan(math.radians(angle))
        np.testing.assert_allclose(found, expected, atol=0.015)


@pytest.mark.parametrize(("engine", "upright"), ENGINES)
def test_radiance_beside_a_straight_edge(upright: bool, engine: Engine) -> None:
    """Radiance falls from 1 to 0 along a card that ends anywhere between cells: the light is its integral."""
    end = 24.0  # px from the card's middle to its end
    ramp = np.linspace(1.0, 0.0, 257)[:-1] - 0.5 / 256
    texture = np.tile(ramp, (256, 1)).astype(np.float32)
    for offset in (0.03, 0.1, 0.16, 0.22):
        center = [offset - end, 0.0] if upright else [0.0, end - offset]  # px right and up
        card = {
            "shape": "rectangle",
            "center": [*(STEP * DISTANCE * np.array(center)), DISTANCE],
            "size": [2 * end * STEP * DISTANCE] * 2,
            "texture": texture if upright else texture.T.copy(),
            "texture_mapping": "surface",
        }
        made = scene_from({"camera": CAMERA | {"focus_distance": DISTANCE}}, card)
        found = rendered(made, engine)[MIDDLE if upright else slice(None)]
        found = found.sum(axis=1) if upright else found.sum(axis=0)[MIDDLE]
        seen = 0.5 * SIDE + offset
        np.testing.assert_allclose(found, seen * seen / (4 * end), atol=1e-4)


@pytest.mark.parametrize(("engine", "upright"), ENGINES)
def test_light_beside_the_outline_of_a_cylinder(upright: bool, engine: Engine) -> None:
    for offset in (0.0, 0.3, 0.6, 0.9):
        radius, aside = 8.0, offset * STEP * DISTANCE
        away = math.hypot(aside, DISTANCE)
        middle, half = math.atan2(aside, DISTANCE), math.asin(radius / away)
        expected = (math.tan(middle + half) - math.tan(middle - half)) / STEP
        center, axis = ([aside, 0.0], [0.0, 1.0, 0.0]) if upright else ([0.0, aside], [1.0, 0.0, 0.0])
        post = {"shape": "cylinder", "center": [*center, DISTANCE], "radius": radius, "axis": axis}
        found = light(post, 4, engine).sum(axis=1 if upright else 0)[MIDDLE]
        np.testing.assert_allclose(found, expected, atol=0.01)


@pytest.mark.parametrize("engine", ["device", "reference"])
@pytest.mark.parametrize("depth", [205.0, 290.0])
def test_an_open_lens_sees_behind_the_outline_of_a_sphere(depth: float, engine: Engine) -> None:
    """From points of the lens (l, 0, 0) a sphere covers ellipses of the plane in focus: d^T A d <= 0 of directions d =
    (x, y, focus). Their mean is larger than what the middle of the lens sees, which alone has sources."""
    focus, radius, lens = 245.0, 6.0, 20.0  # mm
    found, expected = [], []
    for size in (0.01, lens):
        camera = CAMERA | {"aperture_diameter": 2 * size, "focus_distance": focus}
        ball = {"shape": "sphere", "center": [0.0, 0.0, depth], "radius": radius, "texture": "#ffffff"}
        made = scene_from({"camera": camera}, ball)
        found.append(rendered(made, engine).sum())
        areas = []
        for aside in size * np.sqrt((np.arange(32) + 0.5) / 32):  # of rings of equal areas
            to = np.array([-aside, 0.0, depth])
            a = (to @ to - radius**2) * np.eye(3) - np.outer(to, to)
            middle = np.linalg.solve(a[:2, :2], -focus * a[:2, 2])
            rest = focus**2 * a[2, 2] + focus * a[:2, 2] @ middle
            areas.append(-math.pi * rest / math.sqrt(np.linalg.det(a[:2, :2])))
        expected.append(float(np.mean(areas)) / (ray_step(Camera(**camera)) * focus) ** 2)
    assert found[0] == pytest.approx(expected[0], rel=2e-3)
    assert found[1] - found[0] == pytest.approx(expected[1] - expected[0], rel=0.1)


@pytest.mark.parametrize("engine", mostly_slow(["device", "reference"], ["device"]))
def test_wires_hide_as_much_as_they_are_wide(engine: Engine) -> None:
    """Also where the soft edges are wider than the wire."""
    angle = 30.0
    camera = {"resolution": [80, 12], "pixel_pitch": 0.4, "f_number": 2.0, "focal_length": 50.0}
    camera |= {"focus_distance": 600.0}
    wall = {"shape": "plane", "distance": 6000.0, "texture": "#ffffff"}
    for radius in (0.2, 0.8):
        axis = [math.sin(math.radians(angle)), math.cos(math.radians(angle)), 0.0]
        wire = {"shape": "cylinder", "center": [0.3, 0.0, 245.0], "radius": radius, "axis": axis, "texture": "#000000"}
        made = scene_from({"camera": camera}, wire, wall)
        light = rendered(made, engine)
        width = 2.0 * radius / 245.0 / math.cos(math.radians(angle)) * 50.0 / 0.4
        assert 80.0 * (1.0 - light.mean()) == pytest.approx(width, rel=0.05)


@pytest.mark.parametrize("engine", ["device", "reference"])
@pytest.mark.parametrize(("low", "radius"), mostly_slow([(2.85, 0.01), (2.6, 10.0), (3.3, 10.0)], [(2.85, 0.01)]))
def test_a_face_seen_edge_on_between_rays(low: float, radius: float, engine: Engine) -> None:
    """A level card, so many px down in the image, is less than a pixel high between the middles of two rows. Before it
    is a black one, which hides it from those points of the lens that are below it."""
    near, far, pinhole = 240.0, 260.0, radius < 1.0  # mm
    below = low * STEP * far
    level = {"center": [0.0, -below, 250.0], "size": [60.0, far - near], "rotation": [90.0, 0.0, 0.0]}
    upright = {"center": [0.0, -below - 50.0, near], "size": [60.0, 100.0]}
    cards = {"shape": "rectangle", "texture": "#ffffff"} | level, {"shape": "rectangle", "texture": "#000000"} | upright
    psf = {"silhouette_samples": 4, "occlusion": "none"} if pinhole else {"silhouette_samples": 8}
    keys = {"camera": CAMERA | {"aperture_diameter": 2 * radius}, "psf": psf}
    # Others out of sight, with which programs are those of test_small_objects.py.
    made = scene_from(keys, *((cards[0], *BESIDE) if pinhole else cards))
    lens = radius * np.sin(np.linspace(-1.0, 1.0, 2001) * math.pi / 2)  # places along y, of equal angles
    area = radius**2 - lens**2
    height = low * (far / near - 1.0) * float((np.maximum(1.0 + lens / below, 0.0) * area).sum() / area.sum())
    found = rendered(made, engine)[:, 6:18].sum(axis=0)
    np.testing.assert_allclose(found, height, rtol=2e-3 if pinhole else 0.08)
