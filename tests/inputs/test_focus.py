"""Reports on what the lens does to depth maps, and lenses that are focused on a point or a share of a scene."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from clsco.inputs.files import InputFiles
from clsco.inputs.focus import Focus, focus_scene, lens_line
from clsco.scene.model import Background, Camera, DepthMap, Plane, Scene, Sphere
from tests.scenes import refusals, scene_of

CAMERA = Camera()  # kappa = 10,000 px mm, in focus at 250.017 mm, 39.997 px at infinity
FAR = "focus: must be on a surface beyond the focal length, "
FOCUS_AT = "; a pixel or a share of the depths can be focused on)"


SHARP = (
    "(nothing is blurred by more than a pixel: depths 250 to {}, focus at 250.017 mm, focal length 20 mm, "
    "pixel pitch {} mm; is the unit of each right?)"
).format


@pytest.mark.parametrize(("depths", "camera", "line"), [
    ([[200.0, 250.0], [300.0, 1e13]], CAMERA, "R -10 to 40 px; in focus: 25 % of the picture"),
    ([[200.0] * 199 + [250.0]], CAMERA, "R -10 to 0 px; in focus: under 1 % of the picture"),
    ([[1000.0, 1e13]], CAMERA,
     "R 30 to 40 px; in focus: 0 % of the picture (depths 1000 to infinity, focus at 250.017 mm" + FOCUS_AT),
    ([[250.0, 251.0]], CAMERA, "R 0 to 0.16 px; in focus: 100 % of the picture " + SHARP(251, 0.01)),
    ([[250.0, 300.0]], Camera(pixel_pitch=4.5),
     f"R 0 to 0.01 px; in focus: 100 % of the picture {SHARP(300, 4.5)}"),
    ([[np.inf, 250.0]], CAMERA, f"R 0 to 0 px; in focus: 50 % of the picture {SHARP(250, 0.01)}"),
])  # fmt: skip
def test_a_line_says_what_the_lens_does(depths: list[list[float]], camera: Camera, line: str) -> None:
    w = 1.0 / np.array(depths)
    w[w == 1e-13] = 1e-12  # as what is infinitely far has it
    scene = Scene(camera=camera, objects=(Plane(),)).replace("camera.resolution", w.shape[::-1])
    assert lens_line(scene, w) == line


def focus_of(scene: Scene, on: Focus) -> float | None:
    return focus_scene(scene, InputFiles().maps, on).camera.focus_distance


def depth_map(**keys: Any) -> DepthMap:
    depth = np.linspace(300.0, 500.0, 48 * 64).reshape(48, 64)
    return DepthMap(texture="bricks", **{"depth": depth, **keys})


def test_a_point_of_a_depth_map_is_in_focus() -> None:
    scene = scene_of(depth_map())
    assert focus_of(scene, (0, 0)) == pytest.approx(300.0, rel=1e-12)
    assert focus_of(scene, (63, 47)) == pytest.approx(500.0, rel=1e-12)
    assert focus_of(scene, 0.0) == pytest.approx(300.0, rel=1e-12)
    assert focus_of(scene, 0.25) == pytest.approx(350.0, abs=0.1)  # depths are 0.065 mm apart
    assert focus_of(scene, 1.0) == pytest.approx(500.0, rel=1e-12)
    assert focus_scene(scene, InputFiles().maps, (0, 0)).objects == scene.objects


def test_a_lens_that_would_blur_too_much_is_focused() -> None:
    camera = {"focal_length": 50.0, "f_number": 1.4, "pixel_pitch": 0.006, "focus_distance": 60.0}
    assert focus_of(scene_of(depth_map(unit="mm", scale=10.0), camera=camera), (0, 0)) == pytest.approx(3000.0)


def test_the_nearest_surface_of_a_pixel_counts() -> None:
    sphere, wall = Sphere(center=(0.0, 0.0, 280.0), radius=30.0), Plane(distance=400.0)
    scene = scene_of(sphere, wall, depth_map(), size=(65, 49), camera={"pixel_pitch": 0.2})
    scene = scene.model_copy(update={"objects": (sphere, wall)})
    assert focus_of(scene, (32, 24)) == pytest.approx(250.0, rel=1e-12)
    assert focus_of(scene, (0, 0)) == pytest.approx(400.0, rel=1e-12)
    assert focus_of(scene, 0.0) == pytest.approx(250.0, rel=1e-12)
    assert focus_of(scene, 1.0) == pytest.approx(400.0, rel=1e-12)


def test_what_is_infinitely_far_has_the_detector_at_the_focal_length() -> None:
    for item in (Background(texture="bricks"), depth_map(depth=np.full((48, 64), np.inf))):
        scene = scene_of(Plane(distance=300.0, bounds=((-1, 1), (-1, 1), (-1, 1))), item)
        camera = focus_scene(scene, InputFiles().maps, (0, 0)).camera
        assert (camera.focus_distance, camera.sensor_distance) == (None, camera.focal_length)


@pytest.mark.parametrize(("scene", "focus", "message"), [
    (scene_of(depth_map()), (64, 0), "focus: must be a pixel of the 64 x 48, counted from 0; got 64,0"),
    (scene_of(Plane(bounds=((-1, 1), (-1, 1), (-1, 1)))), (0, 0),
     "focus: must be on a surface; got nothing at 0,0"),
    (scene_of(Sphere(center=(900.0, 0.0, 280.0))), 0.5,
     "focus: must be on a surface; got nothing in the picture"),
    (scene_of(depth_map(depth=np.zeros((48, 64)), unit="coc")), (0, 0),
     'focus: depths must be known; got unit = "coc", whose radii say what is in focus'),
    (scene_of(depth_map(), camera={"focal_length": 350.0, "sensor_distance": 2000.0}), (0, 0),
     FAR + "350 mm; got a depth of 300 mm (is it in another unit, such as m?)"),
])  # fmt: skip
def test_what_cannot_be_in_focus_is_refused(scene: Scene, focus: Focus, message: str) -> None:
    assert refusals(focus_scene, scene, InputFiles().maps, focus) == (message,)
