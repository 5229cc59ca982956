"""Laws of whole frames, through `clsco.render`: what must not change an image, or must change it in a known way."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import clsco
from clsco.scene.model import Camera, Ellipsoid, Motion, Object, ObjectMotion, Plane, Psf, Quadric, Scene, Sphere
from clsco.scene.model import Sequence as Exposure
from clsco.scene.quantities import Vector
from tests.laws.scenes import (
    BOX,
    CAMERA,
    FILTERS,
    LIGHT,
    OCCLUSIONS,
    PRECISIONS,
    bodies,
    centers,
    hit,
    law,
    pairs,
    radii,
    rendered,
    same_bits,
    scene,
    speeds,
)

ROUNDING = 4e-6  # of white: sums of some hundred weights of float32 in another order
MOTION = ObjectMotion(velocity=(1.0, 2.0, 3.0))

pytestmark = pytest.mark.laws


def changed(item: Object, **update: object) -> Object:
    """An object with other values."""
    return type(item).model_validate(item.model_dump(exclude_unset=True) | update)


def moved_at(item: Object, velocity: tuple[float, ...]) -> Object:
    """An object of another velocity."""
    return changed(item, motion={"velocity": velocity})


def times(vector: tuple[float, ...], factor: float) -> tuple[float, ...]:
    """A multiple of a vector."""
    return tuple(factor * value for value in vector)


def mirrored(item: Object) -> Object:
    """An object on the other side of the plane x = 0."""
    assert isinstance(item, Sphere | Ellipsoid)
    (x, y, z), (u, v, w) = item.center, item.motion.velocity
    return moved_at(changed(item, center=(-x, y, z)), (-u, v, w))


def scaled(item: Object, factor: float) -> Object:
    """An object of another size and as many times as far away."""
    assert isinstance(item, Sphere | Ellipsoid)
    lengths: dict[str, Any] = {"radius": factor * item.radius} if isinstance(item, Sphere) else {}
    lengths |= {"semi_axes": times(item.semi_axes, factor)} if isinstance(item, Ellipsoid) else {}
    assert item.bounds is not None
    box = tuple(times(side, factor) for side in item.bounds)
    larger = changed(item, center=times(item.center, factor), bounds=box, **lengths)
    return moved_at(larger, times(item.motion.velocity, factor))


@law
@given(pairs, st.integers(-6, 6))
def test_another_unit_of_length_changes_no_bit(light: Path, objects: tuple[Object, ...], exponent: int) -> None:
    factor = 2.0**exponent
    camera = {name: factor * length for name, length in CAMERA.items()}
    one = rendered(scene(light, objects))
    other = rendered(scene(light, tuple(scaled(item, factor) for item in objects), camera=camera))
    assert same_bits(one.color, other.color)
    assert same_bits(one.blur_radius, other.blur_radius)
    assert same_bits(one.normal, other.normal)
    assert same_bits(one.depth * np.float32(factor), other.depth)  # type: ignore[operator]


@law
@given(pairs)
def test_a_mirrored_scene_is_mirrored(light: Path, objects: tuple[Object, ...]) -> None:
    one = rendered(scene(light, objects))
    other = rendered(scene(light, tuple(mirrored(item) for item in objects), "mirrored"))
    assert same_bits(hit(one)[:, ::-1], hit(other))
    np.testing.assert_allclose(np.asarray(one.depth)[:, ::-1], np.asarray(other.depth), rtol=2e-7)
    np.testing.assert_allclose(one.color[:, ::-1], other.color, atol=ROUNDING)


@law
@given(centers, radii, bodies(), PRECISIONS)
def test_a_sphere_is_an_ellipsoid(light: Path, center: Vector, radius: float, other: Object, precision: str) -> None:
    ball = Sphere(center=center, radius=radius, bounds=BOX, motion=MOTION)
    same = Ellipsoid(center=center, semi_axes=(radius,) * 3, bounds=BOX, motion=MOTION)
    a, b = (rendered(scene(light, (item, other)), precision=precision) for item in (ball, same))
    assert same_bits(hit(a), hit(b))
    np.testing.assert_allclose(np.asarray(a.depth), np.asarray(b.depth), rtol=1.2e-7)
    np.testing.assert_allclose(a.color, b.color, atol=ROUNDING)


@law
@given(centers, radii, bodies(), st.integers(-40, 40))
def test_a_multiple_of_an_equation_is_the_same_surface(
    light: Path, center: Vector, radius: float, other: Object, exponent: int
) -> None:
    coefficients = (1.0, 2.0, 0.5, 0.25, 0.0, -0.5, 0.0, 0.0, 0.0, -(radius**2))
    item = Quadric(coefficients=coefficients, center=center, bounds=BOX, motion=MOTION)
    multiple = changed(item, coefficients=times(coefficients, 2.0**exponent))
    one, same = (rendered(scene(light, (each, other))) for each in (item, multiple))
    assert same_bits(one.color, same.color)
    assert same_bits(one.depth, same.depth)


@law
@given(pairs, st.integers(2, 9))
def test_what_does_not_move_is_still(light: Path, objects: tuple[Object, ...], samples: int) -> None:
    still = tuple(moved_at(item, (0.0, 0.0, 0.0)) for item in objects)
    one = rendered(scene(light, still))
    for frame in (0, 1):
        many = scene(light, still, sequence=Exposure(samples=samples, frames=2))
        other = rendered(many, frame)
        assert same_bits(one.color, other.color)
        assert same_bits(one.depth, other.depth)
        assert np.abs(np.asarray(other.flow)).max() < 1e-9  # px


@law
@given(pairs, speeds)
def test_a_moving_camera_sees_what_moves_the_other_way(
    light: Path, objects: tuple[Object, ...], velocity: tuple[float, float, float]
) -> None:
    camera = {"motion": {"velocity": velocity}}
    back = tuple(moved_at(item, tuple(np.subtract(item.motion.velocity, velocity).tolist())) for item in objects)
    one, other = rendered(scene(light, objects, camera=camera)), rendered(scene(light, back))
    assert same_bits(hit(one), hit(other))
    np.testing.assert_allclose(np.asarray(one.depth), np.asarray(other.depth), rtol=1.2e-7)
    np.testing.assert_allclose(one.color, other.color, atol=ROUNDING)


@law
@given(pairs, st.integers(65, 10_000))
def test_a_box_around_an_object_cuts_nothing(light: Path, objects: tuple[Object, ...], half: int) -> None:
    box = ((-float(half), float(half)),) * 3
    wider = tuple(changed(item, bounds=box) for item in objects)
    one, other = rendered(scene(light, objects)), rendered(scene(light, wider))
    assert same_bits(one.color, other.color)
    assert same_bits(one.depth, other.depth)


@law
@given(pairs, OCCLUSIONS)
def test_objects_may_come_in_any_order(light: Path, objects: tuple[Object, ...], occlusion: str) -> None:
    psf = Psf.model_validate({"silhouette_samples": 1, "occlusion": occlusion})
    one, other = (rendered(scene(light, given, psf=psf)) for given in (objects, objects[::-1]))
    np.testing.assert_allclose(one.color, other.color, atol=ROUNDING)
    assert occlusion != "none" or same_bits(one.color, other.color)
    assert same_bits(one.depth, other.depth)
    numbers = np.asarray(one.object_id)
    equal = objects[0] == objects[1]  # then the first is shown in both
    assert equal or same_bits(np.where(numbers < 0, -1, 1 - numbers), other.object_id)


@law
@given(pairs, st.integers(1, 3))
def test_only_speed_times_time_matters(light: Path, objects: tuple[Object, ...], frame: int) -> None:
    faster = tuple(moved_at(item, times(item.motion.velocity, 2.0 * frame + 1.0)) for item in objects)
    one = rendered(scene(light, objects, sequence=Exposure(samples=1, frames=4)), frame)
    other = rendered(scene(light, faster))
    assert same_bits(one.color, other.color)
    assert same_bits(one.depth, other.depth)


@law
@given(pairs, st.sampled_from(LIGHT), FILTERS)
def test_brighter_textures_are_brighter_images(
    light: Path, objects: tuple[Object, ...], exponent: int, texture_filter: str
) -> None:
    motion = Motion.model_validate({"texture_filter": texture_filter})
    one, other = (rendered(scene(light, objects, texture, motion=motion)) for texture in ("plain", f"times_{exponent}"))
    assert same_bits(one.color * np.float32(2.0**exponent), other.color)


@pytest.mark.parametrize(
    ("model", "occlusion", "steepness", "error"),
    [
        ("pillbox", "none", 0.1, 2e-3),
        ("pillbox", "visibility", 0.24, 6e-3),
        ("pillbox", "none", 0.4, 1.3e-2),
        ("gaussian", "none", 0.24, 1.3e-2),
    ],
)
def test_an_even_white_plane_through_the_focus_is_white(
    model: str, occlusion: str, steepness: float, error: float
) -> None:
    lens = {"focal_length": 20.0, "focus_distance": 250.0, "aperture_diameter": 10.0}
    camera = Camera.model_validate(lens | {"pixel_pitch": 0.02, "resolution": (32, 24)})
    psf, far = Psf.model_validate({"model": model, "occlusion": occlusion}), Plane(distance=500.0, texture="#000000")
    for right, up in ((1.0, 0.0), (0.6, -0.8)):
        slope_x, slope_y = 50.0 * steepness * right, 50.0 * steepness * up
        plane = Plane(distance=250.0, slope_x=slope_x, slope_y=slope_y, texture="#ffffff")
        items = (plane, far) if occlusion == "visibility" else (plane,)
        color = clsco.render_frame(Scene(camera=camera, objects=items, psf=psf)).color[4:-4, 4:-4]
        np.testing.assert_allclose(color, 1.0, atol=error)
