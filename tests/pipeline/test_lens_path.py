"""A lens that changes while the shutter is open, from scene to frame."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import pytest

import clsco
from clsco.optics.lens_path import camera_at
from clsco.scene.model import Scene
from tests.pipeline.common import CAMERA, PLAIN, STEP, WALL
from tests.scenes import assert_agree, reference_frames, rendered, scene_from
from tests.slow import mostly_slow

BALL: dict[str, Any] = {"shape": "sphere", "center": [3.0, 4.0, 245.0], "radius": 9.0, "texture": "bricks"}
PULL = {
    "keyframe": [
        {"time": 0.0, "focus_distance": 220.0},
        {"time": 0.5, "focus_distance": 330.0, "f_number": 1.0},
        {"time": 1.0, "f_number": 3.0},
    ]
}
scene = partial(scene_from, {"camera": CAMERA, "sequence": {"samples": 3}, "lens": PULL})
SCENES: dict[str, Scene] = {
    "before a wall": scene(BALL, WALL),
    "one radius": scene(WALL),
    "layered": scene(BALL, WALL, psf={"occlusion": "layered"}),
    "forward": scene(BALL | {"motion": {"velocity": [9.0, 4.0, 0.0]}}, WALL, motion={"warp": "forward"}),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENES)
def test_device_against_reference(name: str) -> None:
    frames = rendered(SCENES[name])
    assert_agree(frames, reference_frames(SCENES[name]))
    assert frames[0].metadata["f_number"] == pytest.approx(1.0)


def alone(wanted: Scene, time: float) -> Scene:
    """The scene with the lens of a time."""
    lens = camera_at(wanted, time)
    plain = wanted.model_copy(update={"lens": None})
    return plain.replace("camera.focus_distance", lens.focus_distance).replace(
        "camera.aperture_diameter", lens.aperture_diameter
    )


@pytest.mark.parametrize(
    "name", mostly_slow(["before a wall", "one radius", "layered"], ("before a wall", "one radius"))
)
def test_a_frame_is_the_mean_of_frames_with_the_lenses_of_its_time_samples(name: str) -> None:
    wanted = SCENES[name]
    (frame,) = rendered(wanted, truth=())
    each = [rendered(alone(wanted, time), truth=())[0].color for time in (1 / 6, 0.5, 5 / 6)]
    assert np.abs(each[0] - each[2]).max() > 0.1
    np.testing.assert_allclose(frame.color, np.mean(each, axis=0), rtol=0, atol=1e-5)


def test_ground_truth_is_of_the_lens_at_the_middle() -> None:
    wanted, truth = SCENES["before a wall"], ("blur_radius", "depth", "object_id", "sharp", "flow")
    (frame,), (middle,) = (rendered(each, truth=truth, color=False) for each in (wanted, alone(wanted, 0.5)))
    for name in ("blur_radius", "depth", "object_id"):
        np.testing.assert_allclose(getattr(frame, name), getattr(middle, name), rtol=0, atol=1e-5)
    np.testing.assert_allclose(frame.sharp, middle.sharp, rtol=0, atol=1e-5)
    assert np.abs(frame.flow).max() < 1e-5


def test_a_depth_map_is_pulled_into_focus() -> None:
    wanted = scene({"shape": "depth_map", "depth": STEP, "texture": "checkerboard"}, psf=PLAIN)
    (frame,) = rendered(wanted)
    each = [rendered(alone(wanted, time), truth=())[0].color for time in (1 / 6, 0.5, 5 / 6)]
    np.testing.assert_allclose(frame.color, np.mean(each, axis=0), rtol=0, atol=2e-2)


def test_rolling_shutters_see_lenses_of_their_own_times() -> None:
    """The upper rows are exposed by the first lens, the lower ones by the last."""
    steps = {"keyframe": [{"time": 0.0, "focus_distance": 220.0}, {"time": 1.0, "focus_distance": 330.0}]}
    wanted = scene(
        WALL,
        sequence={"samples": 8, "readout": 1.2, "shutter": 0.2, "interval": 1.4},
        lens=steps | {"interpolation": "step"},
    )
    (frame,) = rendered(wanted, truth=())
    first, last = (rendered(alone(wanted, time), truth=())[0].color for time in (0.0, 1.0))
    assert np.abs(first - last).max() > 0.1
    np.testing.assert_allclose(frame.color[:20], first[:20], rtol=0, atol=1e-5)
    np.testing.assert_allclose(frame.color[-4:], last[-4:], rtol=0, atol=1e-5)


def test_sweeps_keep_their_rays_apart() -> None:
    """Rays are shared by scenes that differ in the lens; each has its own lens at each time."""
    scenes = [SCENES["before a wall"].replace("camera.aperture_diameter", size) for size in (20.0, 10.0)]
    other = [each.model_copy(update={"lens": scene(BALL, lens=FOCUS).lens}) for each in scenes]
    for wanted in (scenes, other):
        together = [frame.color for _, frame in clsco.render_sweep(wanted, truth=())]
        apart = [rendered(each, truth=())[0].color for each in wanted]
        for one, two in zip(together, apart, strict=True):
            np.testing.assert_array_equal(one, two)


FOCUS = {"keyframe": [{"time": 0.0, "focus_distance": 220.0}, {"time": 1.0, "focus_distance": 330.0}]}
