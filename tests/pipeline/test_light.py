"""Surfaces in a light: the reference, closed forms, what moves, and rays that are kept."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import clsco
from clsco.scene.model import Scene
from tests.pipeline.common import PLAIN
from tests.pipeline.test_scenes import BALL, GOING, scene
from tests.scenes import assert_agree, reference_frames, rendered
from tests.slow import combined

WHITE = BALL | {"texture": "#ffffff"}
SKY = {"shape": "background", "texture": "#808080"}
WALL = {"shape": "plane", "distance": 330.0, "slope_x": 0.4}
TUBE = {"shape": "cylinder", "radius": 25.0, "axis": [0.3, 1.0, 0.2], "bounds": [[-40, 40], [-20, 20], [-40, 40]]}
FAR = {"direction": [0.3, 0.8, 1.0], "ambient": 0.2}
ALONE = PLAIN | {"occlusion": "none"}
NEAR = {"position": [-60.0, 90.0, 150.0]}
TURNING = {"motion": {"velocity": [5.0, 0.0, 0.0], "angular_velocity": [0.0, 8.0, 3.0]}}
TWO = {"sequence": {"samples": 2, "shutter": 0.2}}
CASES: dict[str, Any] = {
    "alone": ((BALL | {"motion": GOING},), {"light": NEAR, "camera": TURNING, "psf": PLAIN, **TWO}),
    "moving, near": ((BALL | {"motion": GOING}, WALL), {"light": NEAR, **TWO}),
    "tube": ((TUBE, SKY), {"light": NEAR | {"ambient": 0.1}, "psf": PLAIN}),
    "layered": ((BALL, WALL), {"light": FAR, "psf": {"occlusion": "layered", "silhouette_samples": 1}}),
    "on the surface": ((BALL | {"texture_mapping": "surface", "motion": GOING},), {"light": NEAR, **TWO}),
    "forward at rest": ((BALL,), {"light": NEAR, "motion": {"warp": "forward"}}),
}


@pytest.mark.parametrize(("name", "precision"), combined(list(CASES), ["double", "single"], kept=[("alone", "double")]))
def test_agrees_with_the_reference(name: str, precision: Any) -> None:
    items, sections = CASES[name]
    wanted = scene(*items, **sections)
    frames, exact = rendered(wanted, precision=precision), reference_frames(wanted)
    assert_agree(frames, exact)
    without = rendered(wanted.replace("light", None), truth=(), precision=precision)
    assert np.abs(without[0].color - frames[0].color).max() > 0.05


def sharp(wanted: Scene) -> Any:
    """The first frame with what is compared here."""
    return clsco.render_frame(wanted, truth=("sharp", "normal", "depth", "mask"), color=False)


def test_a_white_sphere_has_the_cosine() -> None:
    """In a far light behind the camera n . l is the normal's part along the axis."""
    frame = sharp(scene(WHITE, light={"direction": [0.0, 0.0, 9.0]}, psf=PLAIN))
    np.testing.assert_allclose(frame.sharp[frame.mask], -frame.normal[frame.mask][:, 2], atol=1e-6)
    assert frame.sharp[~frame.mask].max() == 0.0
    behind = sharp(scene(WHITE, light={"direction": [0.0, 0.0, -1.0], "ambient": 0.25}, psf=PLAIN))
    np.testing.assert_allclose(behind.sharp[behind.mask], 0.25, atol=1e-6)


def test_a_white_sphere_has_the_cosine_towards_a_near_light() -> None:
    place = np.array([20.0, -10.0, 240.0])
    frame = sharp(scene(WHITE, light={"position": place, "ambient": 0.5}, psf=PLAIN))
    rows, columns = frame.sharp.shape
    x, y = np.arange(columns) - 0.5 * (columns - 1), 0.5 * (rows - 1) - np.arange(rows)
    rays = np.stack([*np.meshgrid(x * 0.08 / 20.0, y * 0.08 / 20.0), np.ones((rows, columns))], axis=-1)
    towards = place - rays[frame.mask] * frame.depth[frame.mask][:, None]
    cosine = (frame.normal[frame.mask] * towards).sum(axis=-1) / np.linalg.norm(towards, axis=-1)
    assert cosine.min() < -0.1
    np.testing.assert_allclose(frame.sharp[frame.mask], 0.5 + 0.5 * np.maximum(cosine, 0.0), atol=1e-5)


@pytest.mark.slow
def test_the_background_is_not_shaded() -> None:
    frame = sharp(scene(WHITE, SKY, light={"direction": [0.0, 0.0, 9.0]}, psf=ALONE))
    without = sharp(scene(WHITE, SKY, psf=ALONE))
    np.testing.assert_array_equal(frame.sharp[~frame.mask], without.sharp[~frame.mask])
    assert frame.sharp[~frame.mask].min() > 0.1


def test_a_light_stands_still_where_the_camera_turns() -> None:
    """After a turn by 30 degrees about the lens, a light that was behind the camera is 30 degrees off."""
    camera = {"motion": {"angular_velocity": [0.0, 30.0, 0.0]}}
    sequence = {"frames": 2, "interval": 1.0, "shutter": 1e-6, "samples": 1}
    shell = WHITE | {"center": [0.0, 0.0, 0.0], "radius": 300.0}
    wanted = scene(shell, camera=camera, sequence=sequence, light={"direction": [0.0, 0.0, 1.0]}, psf=PLAIN)
    frames: Any = clsco.render(wanted, truth=("sharp", "normal"), color=False)
    for frame, angle in zip(frames, np.radians([0.0, 30.0]), strict=True):
        towards = np.array([np.sin(angle), 0.0, -np.cos(angle)])
        np.testing.assert_allclose(frame.sharp, frame.normal @ towards, atol=1e-6)


@pytest.mark.slow
def test_turned_surfaces_are_lit_where_they_are() -> None:
    """A card that turns away from the light, at one time."""
    card: dict[str, Any] = {
        "shape": "rectangle",
        "center": [0.0, 0.0, 300.0],
        "size": [900.0, 900.0],
        "texture": "#ffffff",
    }
    card["motion"] = {"angular_velocity": [0.0, 60.0, 0.0]}
    sequence = {"frames": 1, "shutter": 1.0, "samples": 1}
    frame = sharp(scene(card, light={"direction": [0.0, 0.0, 1.0]}, sequence=sequence, psf=PLAIN))
    np.testing.assert_allclose(frame.sharp[frame.mask], np.cos(np.radians(30.0)), atol=1e-6)


@pytest.mark.slow
def test_alpha_is_not_shaded() -> None:
    wanted = scene(WHITE, light=FAR, psf=PLAIN)
    two: Any = (clsco.render_frame(each, truth=("alpha",)) for each in (wanted, wanted.replace("light", None)))
    lit, without = two
    np.testing.assert_array_equal(lit.alpha, without.alpha)
    np.testing.assert_array_equal(without.alpha, without.color)
    assert np.abs(lit.color - lit.alpha).max() > 0.1


def test_kept_rays_know_the_light() -> None:
    wanted = scene(BALL, light=FAR, psf=PLAIN)
    with clsco.Live() as live:
        lights = ("light.ambient", 0.7), ("light.direction", [1, 0, 0]), ("light", None)
        for key, value in (("camera.focus_distance", 260.0), *lights):
            wanted = wanted.replace(key, value)
            found, alone = live.render(wanted, truth=()), clsco.render_frame(wanted, truth=())
            np.testing.assert_array_equal(found.color, alone.color)
