"""Rays against closed forms, and frames with planted faults against rays."""

from __future__ import annotations

import math
import sys
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import clsco
import clsco.truth
from benchmarks.truth.traced import trace_frame
from benchmarks.truth.wave import hopkins
from clsco.errors import ClscoError
from clsco.optics.lens_path import camera_at
from clsco.optics.motion import poses_at
from clsco.truth.judge import NOISE, Judgement, judge, trace, trace_waves
from clsco.truth.kernel import accumulate
from clsco.truth.pixels import choose_pixels
from clsco.truth.poses import lens_at
from clsco.truth.problem import make_problem, not_judged
from tests.slow import mostly_slow

SIZE = 48
WALL = {"shape": "plane", "distance": 320.0, "texture": "#ffffff"}
BALL = {"shape": "sphere", "center": [1.0, -0.5, 230.0], "radius": 2.2, "texture": "#ffffff"}


def scene(*objects: Any, **tables: Any) -> clsco.Scene:
    camera = {"pixel_pitch": 0.02, "resolution": [SIZE, SIZE], "focus_distance": 250.0}
    return clsco.parse_scene({"camera": camera | tables.pop("camera", {}), "object": list(objects), **tables})


def traced(given: clsco.Scene, rays: int, seed: int = 5, **place: int) -> tuple[Any, Any]:
    """Image (rows, columns, channels) by rays and its standard error, or a pixel of it."""
    problem = make_problem(given)
    if not place:
        image, error = trace_frame(problem, NOISE, rays, seed)
        return np.atleast_3d(image), np.atleast_3d(error)
    places = np.array([[place["column"], place["row"], 1.0, 1.0, 0.0]])
    mean, error, _ = trace(problem, np.full((1, 2), -1), places, rays, 99.0, seed)
    return mean[0], error[0]


def judged(given: clsco.Scene, image: NDArray[Any], seed: int = 0, rays: int = 2048) -> Judgement:
    return judge(make_problem(given), image, rays=rays, seconds=99.0, seed=seed)


@pytest.mark.parametrize(
    "tables",
    [
        {"aperture": {"shape": "polygon", "blades": 3, "blade_curvature": -0.4, "squeeze": 1.5}},
        {"psf": {"seidel": {"W040": 9.0}, "zernike": {"3,1": 2.0}}},
        {"lens": {"distortion": [-0.2, 0.0, 0.0], "field_curvature": -0.03, "focus_surface": "sphere"}},
        {"psf": {"model": "gaussian"}},
    ],
)
def test_a_wall_is_even_through_any_lens(tables: Any) -> None:
    image, _ = traced(scene(WALL, **tables), 256, row=3, column=40)
    np.testing.assert_allclose(image, 1.0, atol=0.01)


def test_exposure_by_area_is_that_of_the_opening() -> None:
    tables = {"aperture": {"shape": "ring", "obstruction": 0.5, "exposure": "area"}}
    assert traced(scene(WALL, **tables), 64, row=9, column=9)[0][0] == pytest.approx(0.75, abs=1e-12)


@pytest.mark.parametrize("distance", [16.0, -6.0])
def test_a_rim_cuts_what_its_circle_leaves(distance: float) -> None:
    """In the middle of a wall in focus: the cone of light has the width D (1 - d / u), or D (1 + d / s), at the rim."""
    wall, rim = WALL | {"distance": 250.0}, {"distance": distance, "diameter": 6.0}
    image, error = traced(scene(wall, aperture={"rim": [rim]}), 16384, row=24, column=24)
    way = 1 - distance / 250 if distance > 0 else 1 + distance * (1 / 20 - 1 / 250)
    assert image[0] == pytest.approx(0.36 / way**2, abs=max(5 * error[0], 1e-3))


def test_natural_vignetting_goes_by_the_angle() -> None:
    image, _ = traced(scene(WALL, lens={"vignetting": "natural"}, camera={"pixel_pitch": 0.5}), 256, row=0, column=0)
    slope = 23.5 * 0.5 / 20 * math.sqrt(2)
    assert image[0] == pytest.approx((1 + slope**2) ** -2, rel=2e-3)


def test_half_of_the_exposure_is_half_of_the_light() -> None:
    """A card comes into a pixel after a quarter of the exposure: a triangle has let 1/8 of its light pass."""
    keys = [{"time": 0.0}, {"time": 0.25, "position": [0.0, 50.0, 0.0]}]
    card = {"shape": "rectangle", "center": [0.0, 0.0, 250.0], "size": [20.0, 20.0], "texture": "#ffffff"}
    motion = {"motion": {"keyframe": keys, "interpolation": "step"}}
    given = scene(card | motion, sequence={"shutter_curve": "triangle"})
    assert traced(given, 4096, row=24, column=24)[0][0] == pytest.approx(0.125, abs=2e-3)


def test_poses_and_lenses_are_those_of_the_engine() -> None:
    keys = [{"time": t, "position": [t, -t * t, 5 * t], "rotation": [20 * t, -50 * t, 30 * t * t]} for t in (0, 0.4, 1)]
    spline = [{"time": 0.2 * k, "position": [k % 3, 0.0, 0.0], "rotation": [0.0, 9.0 * k, 0.0]} for k in range(5)]
    zoom = [{"time": 0.0, "focus_distance": 240.0, "f_number": 2.0}, {"time": 0.8, "focal_length": 25.0}]
    zoom.append({"time": 1.0, "f_number": 3.0})
    moved = {
        "camera": {
            "motion": {"velocity": [1.0, 2.0, 3.0], "angular_velocity": [3.0, 5.0, 7.0], "acceleration": [1.0, 0, 2]},
            "shake": {"rotation_rms": 0.5, "translation_rms": 0.4},
        },
        "group": [{"name": "g", "motion": {"angular_velocity": [0.0, 40.0, 5.0]}}],
        "stereo": {"baseline": 30.0, "toe_in": 3.0},
        "lens": {"keyframe": zoom, "outside": "linear"},
    }
    objects: list[Any] = [
        BALL | {"group": "g", "rotation": [10.0, 20.0, 30.0], "motion": {"keyframe": keys}},
        BALL | {"motion": {"keyframe": spline, "interpolation": "bspline", "outside": "linear"}},
        BALL | {"motion": {"keyframe": keys, "interpolation": "linear"}},
    ]  # fmt: skip
    given = scene(*objects, **moved, sequence={"frames": 2})
    problem = make_problem(given, 1, "right")
    for moment in (0, 5000):
        at = 1 + (moment + 0.5) / 8192
        for n, pose in enumerate(poses_at(given, at, "right")):
            found = problem.moments.poses[moment, n]
            np.testing.assert_allclose(found[9:] - objects[n]["center"], pose.shift, atol=1e-9)
            rest = problem.surfaces.shapes[2, n, :9].reshape(3, 3)
            np.testing.assert_allclose(found[:9].reshape(3, 3).T, pose.rotation @ rest, atol=1e-9)
    for at in (0.1, 0.7):
        camera = camera_at(given, at)
        step, half, power, detector = lens_at(given, np.array([at]))[0]
        assert step == pytest.approx(camera.pixel_pitch / camera.normalization_distance)
        assert (2 * half, 1 / detector) == pytest.approx((camera.aperture_diameter, camera.sensor_distance))
        assert power == pytest.approx(1 / camera.focal_length - detector)


def test_frames_by_rays_pass_and_planted_faults_are_found() -> None:
    given = scene(BALL, WALL | {"texture": "#808080"})
    image, _ = traced(given, 1024)
    found = judged(given, image)
    assert found.agrees, found.classes
    assert {row.name for row in found.objects} == {"sphere", "plane"}
    noise = found.classes[0].noise
    assert found.classes[0].rms < 5 * noise
    larger, _ = traced(given.replace("object[0].radius", 2.4), 1024)
    for wrong in (np.roll(image, 1, axis=1), larger, image * 1.03):
        assert not judged(given, wrong).agrees
    assert judged(given, image * 1.03).objects[-1].mean > 0.005


def test_the_same_seed_has_the_same_bits_and_another_one_agrees() -> None:
    given = scene(BALL, WALL | {"texture": "bricks"})
    image, _ = traced(given, 256)
    first, again = (judged(given, image, seed=3) for _ in range(2))
    assert first.values() | {"seconds": 0} == again.values() | {"seconds": 0}
    one, error = traced(given, 256, seed=1)
    other, _ = traced(given, 256, seed=2)
    assert np.sqrt(np.mean((one - other) ** 2)) < 2 * np.sqrt(2 * np.mean(error**2))


def test_light_of_a_ball_below_a_pixel() -> None:
    """0.45 px in radius, which no pixel's middle meets: its light is the area of its image."""
    radius = 0.45 * 0.02 / 20 * 260
    given = scene(BALL | {"center": [0.13, 0.07, 260.0], "radius": radius})
    found = judged(given, np.zeros((SIZE, SIZE)), rays=16384)
    (light,) = found.lights
    assert light.right == pytest.approx(math.pi * 0.45**2, rel=0.01)
    assert found.dim == (light,)
    assert not found.agrees
    assert {row.name for row in found.classes} >= {"small"}
    image, _ = traced(given, 16384)
    assert not judged(given, image, rays=16384).dim


def test_light_of_a_card_that_is_long_and_narrow() -> None:
    mm = 0.02 / 20 * 260
    card = {"shape": "rectangle", "center": [0.73 * mm, 0.2 * mm, 260.0], "size": [0.2 * mm, 8 * mm]}
    (light,) = judged(scene(card | {"texture": "#ffffff"}), np.zeros((SIZE, SIZE)), rays=16384).lights
    assert light.right == pytest.approx(1.6, rel=0.01)


WAVES = {"model": "wave", "wavelengths": [550.0, 550.0, 550.0]}
SMALL = {"resolution": [32, 32], "aperture_diameter": 2.0, "pixel_pitch": 0.01}  # Q = 0.55 px


@pytest.mark.parametrize("distance", mostly_slow([250.0, 312.5], [312.5]))
def test_points_by_waves_are_those_of_hopkins_transfer_function(distance: float) -> None:
    point = np.zeros((32, 32), np.float32)
    point[15, 16] = 1.0
    given = scene({**WALL, "distance": distance, "texture": point}, camera=SMALL, psf=WAVES)
    image, error, hidden, _ = trace_waves(make_problem(given))
    weights = hopkins(0.55, 2000.0 * (1 / 250.0 - 1 / distance), 8)
    np.testing.assert_allclose(image[15:24, 16:25, 0], weights, atol=5e-5)
    assert error.max() < 1e-6
    assert not hidden.any()


def test_waves_are_judged_where_nothing_hides() -> None:
    card = {"shape": "rectangle", "center": [-2.5, 0.0, 240.0], "size": [5.0, 9.0], "texture": "#e0e0e0"}
    given = scene(card, WALL, camera=SMALL, psf=WAVES)
    (frame,) = clsco.render(given)
    found = judged(given, frame.color)
    assert found.agrees
    assert 0 < len(found.pixels.row) < len(choose_pixels(make_problem(given), 0).row)
    assert np.abs(found.pixels.column - 15.5).min() > 2.0  # the outline is in the middle
    assert not judged(given, frame.color * 0.97).agrees
    tilted = scene({**WALL, "slope_x": 9.0}, camera=SMALL, psf=WAVES)
    assert judged(tilted, frame.color).figures == {"pixels": 0, "deviations": 0}


def test_scenes_without_rays_say_so() -> None:
    assert "waves" in str(not_judged(scene(WALL, psf={"model": "wave", "seidel": {"W131": 1.0}})))
    assert not_judged(scene(WALL)) is None


def test_an_error_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    clsco.truth.require_rays()
    monkeypatch.setattr("clsco.errors.find_spec", lambda name: None)
    with pytest.raises(ClscoError, match=r"check: needs numba: pip install 'clsco\[check\]'"):
        clsco.truth.require_rays()


def test_seconds_are_those_of_rays_and_not_of_the_compiler(monkeypatch: pytest.MonkeyPatch) -> None:
    module, clock = sys.modules["clsco.truth.judge"], [0.0]

    def compiled_first(*arguments: Any, right: Any = accumulate) -> None:
        clock[0] += 0.0 if clock[0] else 100.0
        right(*arguments)

    monkeypatch.setattr(module, "accumulate", compiled_first)
    monkeypatch.setattr(module, "time", SimpleNamespace(perf_counter=lambda: clock[0]))
    place = np.array([[37.0, 24.0, 1.0, 1.0, 0.0]])
    _, _, cast = trace(make_problem(scene(BALL)), np.full((1, 2), -1), place, 2048, 1.0, 5)
    assert cast == 2048
