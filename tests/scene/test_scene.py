"""The models of a scene: defaults, derived values, what Python code can rely on."""

from __future__ import annotations

import subprocess
import sys
from typing import Any

import pytest
from pydantic import ValidationError

import clsco
from clsco.errors import SceneError
from clsco.scene.model import AnyShape
from clsco.scene.shapes import origin

COEFFICIENTS = (1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -900.0)


def test_a_camera_given_by_f_number_and_focus_has_numbers_for_both_distances() -> None:
    camera = clsco.Camera(focal_length=50.0, f_number=2.5, focus_distance=1000.0)
    assert camera.aperture_diameter == 20.0
    assert camera.normalization_distance == 50.0
    # One rounding each in the product, the difference and the quotient: below 4 units in the last place.
    assert 1.0 / camera.sensor_distance == pytest.approx(1.0 / 50.0 - 1.0 / 1000.0, rel=4 * 2.0**-52)


def test_the_default_focus_is_at_250_mm() -> None:
    camera = clsco.Camera()
    focus = 1.0 / (1.0 / camera.focal_length - 1.0 / camera.sensor_distance)
    assert round(focus, 3) == 250.017


@pytest.mark.parametrize(
    ("shape", "expected"),
    [
        (clsco.Plane(distance=230.0, slope_x=1.0), (0.0, 0.0, 230.0)),
        (clsco.Cone(apex=(1.0, 2.0, -3.0)), (1.0, 2.0, -3.0)),
        (clsco.Sphere(center=(1.0, 2.0, 300.0)), (1.0, 2.0, 300.0)),
        (clsco.Cylinder(center=(1.0, 2.0, 300.0)), (1.0, 2.0, 300.0)),
        (clsco.Ellipsoid(center=(1.0, 2.0, 300.0)), (1.0, 2.0, 300.0)),
        (clsco.Quadric(coefficients=COEFFICIENTS, center=(1.0, 2.0, 300.0)), (1.0, 2.0, 300.0)),
        (clsco.DepthMap(depth="z.npy"), (0.0, 0.0, 0.0)),
    ],
)
def test_origin(shape: AnyShape, expected: tuple[float, float, float]) -> None:
    assert origin(shape) == expected


def test_moves() -> None:
    assert not clsco.ObjectMotion().moves
    assert not clsco.ObjectMotion(velocity=(0.0, -0.0, 0.0)).moves
    assert clsco.ObjectMotion(velocity=(0.0, 0.0, 1e-9)).moves
    assert clsco.ObjectMotion(angular_velocity=(0.0, -1.0, 0.0)).moves
    assert not clsco.ObjectMotion(acceleration=(0.0, 0.0, 0.0)).moves
    assert clsco.ObjectMotion(acceleration=(0.0, 0.0, 1e-9)).moves
    assert clsco.ObjectMotion(angular_acceleration=(0.0, -1.0, 0.0)).turns == (False, True, False)
    assert clsco.ObjectMotion(angular_acceleration=(0.0, -1.0, 0.0)).moves


def test_a_scene_moves_where_anything_does() -> None:
    moving: dict[str, Any] = {"velocity": (0.0, 1.0, 0.0)}
    assert not clsco.Scene(objects=(clsco.Sphere(), clsco.Plane())).moves
    assert clsco.Scene(objects=(clsco.Plane(), clsco.Sphere(motion=clsco.ObjectMotion(**moving)))).moves
    assert clsco.Scene(camera=clsco.Camera(motion=clsco.CameraMotion(**moving)), objects=(clsco.Plane(),)).moves


def test_rays_meet_what_is_analytic_and_not_warped_forward() -> None:
    forward, moving = clsco.Motion(warp="forward"), clsco.ObjectMotion(velocity=(0.0, 1.0, 0.0))
    assert clsco.Scene(objects=(clsco.Sphere(), clsco.Plane()), motion=forward).is_ray_castable
    assert clsco.Scene(objects=(clsco.Sphere(motion=moving), clsco.Plane())).is_ray_castable
    assert not clsco.Scene(objects=(clsco.Sphere(motion=moving), clsco.Plane()), motion=forward).is_ray_castable
    assert not clsco.Scene(objects=(clsco.Plane(), clsco.DepthMap(depth="z.npy"))).is_ray_castable


def test_python_code_may_say_object_or_objects() -> None:
    assert clsco.Scene(objects=(clsco.Sphere(),)) == clsco.Scene.model_validate({"object": [{"shape": "sphere"}]})


def test_objects_without_a_name_are_numbered() -> None:
    scene = clsco.Scene(
        objects=(
            clsco.Sphere(),
            clsco.Plane(),
            clsco.Sphere(),
            clsco.Sphere(name="sphere 2"),
            clsco.Sphere(name="plane"),
        )
    )
    assert [item.name for item in scene.objects] == ["sphere", "plane 2", "sphere 3", "sphere 2", "plane"]
    again = clsco.Scene(objects=(*scene.objects[1:3], *clsco.Scene(objects=(clsco.Sphere(), clsco.Sphere())).objects))
    assert [item.name for item in again.objects] == ["plane", "sphere", "sphere 2", "sphere 3"]
    with pytest.raises(SceneError, match="names must differ"):
        clsco.Scene(objects=(clsco.Sphere(name="ball"), clsco.Plane(name="ball")))
    assert len(clsco.Scene(objects=(clsco.Sphere(),) * 64).objects) == 64


def test_scenes_are_frozen_and_hashable() -> None:
    scene = clsco.Scene(objects=(clsco.Sphere(),))
    with pytest.raises(ValidationError, match="frozen"):
        scene.title = "other"
    assert hash(scene) == hash(clsco.Scene(objects=(clsco.Sphere(),)))


MANY_THREADS = """
import sys
from threading import Barrier, Thread
from clsco.scene.file import parse_scene
from clsco.scene.shapes import SHAPES

def work():
    for name in ("plane", "sphere", "cone", "box", "background"):
        start.wait()
        dumped.append(parse_scene({"object": [{"shape": name}]}).model_dump_json())
        SHAPES[name]()

sys.setswitchinterval(1e-6)
start, dumped = Barrier(8), []
threads = [Thread(target=work) for _ in range(8)]
for step in (Thread.start, Thread.join):
    for thread in threads:
        step(thread)
print(len(dumped), len(set(dumped)))
"""


def test_models_are_built_once_whatever_threads_meet_a_shape_first() -> None:
    process = subprocess.run([sys.executable, "-c", MANY_THREADS], capture_output=True, text=True, timeout=60)
    assert (process.stdout, process.stderr) == ("40 5\n", "")
