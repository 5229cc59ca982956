"""Motions that are not uniform, from scene to frame: device against reference, and what a plan misses of them."""

from __future__ import annotations

from functools import partial
from math import cos, pi, sin
from typing import Any

import numpy as np
import pytest

import clsco
from clsco.errors import SceneError
from clsco.plan.prepare import prepare
from clsco.scene.model import Scene
from tests.pipeline.common import BALL, CAMERA, PLAIN, WALL
from tests.scenes import assert_agree, assert_same, plan_scene, reference_frames, rendered, scene_from
from tests.slow import mostly_slow

WAY = [
    {"time": 0.0},
    {"time": 0.4, "position": [6.0, -4.0, 12.0], "rotation": [30.0, 20.0, -10.0]},
    {"time": 1.0, "position": [-2.0, 3.0, 0.0], "rotation": [0.0, 170.0, 25.0]},
]
SWAY = [{"time": 0.0}, {"time": 0.7, "position": [4.0, 0.0, 9.0], "rotation": [2.0, 3.0, 10.0]}, {"time": 1.1}]
FASTER = {"acceleration": [40.0, -20.0, 30.0], "angular_acceleration": [20.0, 90.0, 0.0]}
scene = partial(scene_from, {"camera": CAMERA, "psf": PLAIN, "sequence": {"samples": 4, "frames": 2, "interval": 0.5}})
SCENES: dict[str, Scene] = {
    "object": scene(BALL | {"motion": {"keyframe": WAY}}, WALL),
    "camera": scene(BALL, WALL, camera=CAMERA | {"motion": {"keyframe": SWAY, "interpolation": "linear"}}),
    "group": scene(
        BALL | {"group": "a"}, WALL,
        group=[{"name": "a", "motion": {"keyframe": WAY[::2], "interpolation": "bspline", "outside": "linear"}}],
    ),
    "accelerated": scene(BALL | {"motion": FASTER}, WALL, camera={"motion": {"acceleration": [9.0, 0.0, 0.0]}}),
    "shake": scene(BALL, WALL, camera={"shake": {"rotation_rms": 0.8, "translation_rms": 2.0, "band": [1.0, 4.0]}}),
}  # fmt: skip


@pytest.mark.parametrize("name", mostly_slow(SCENES, ("camera",)))
def test_device_against_reference(name: str) -> None:
    frames = rendered(SCENES[name])
    assert_agree(frames, reference_frames(SCENES[name]))
    assert np.abs(frames[0].flow).max() > 1.0
    assert np.abs(frames[0].color - frames[1].color).max() > 0.1


def test_constant_velocity_by_keys_renders_the_frames_of_velocity() -> None:
    velocity, turn = [8.0, -3.0, 20.0], [0.0, 40.0, 0.0]
    keys = [{"time": 0.0}, {"time": 2.0, "position": [16.0, -6.0, 40.0], "rotation": [0.0, 80.0, 0.0]}]
    even = scene(BALL | {"motion": {"velocity": velocity, "angular_velocity": turn}}, WALL)
    keyed = scene(BALL | {"motion": {"keyframe": keys, "interpolation": "linear"}}, WALL)
    assert_same(clsco.render_frame(even, 1), clsco.render_frame(keyed, 1))


@pytest.mark.parametrize("warp", mostly_slow(["inverse", "forward"], ["inverse"]))
def test_a_group_of_one_is_a_motion_of_its_own(warp: str) -> None:
    """The same bits."""
    going, options = {"velocity": [6.0, -4.0, 12.0], "angular_velocity": [5.0, 20.0, -10.0]}, {"motion": {"warp": warp}}
    group = {"name": "cart", "motion": going}
    carried: Any = clsco.render_frame(scene(BALL | {"group": "cart"}, WALL, group=[group], **options))
    own = clsco.render_frame(scene(BALL | {"motion": going}, WALL, **options))
    assert_same(carried, own)
    assert np.abs(carried.flow).max() > 1.0


def test_keys_that_must_cover_all_exposures() -> None:
    keys = {"keyframe": [{"time": 0.0}, {"time": 0.9, "position": [1.0, 0.0, 0.0]}], "outside": "error"}
    for wanted, place in (
        (scene(BALL | {"motion": keys}), "object[0]"),
        (scene(BALL, camera=CAMERA | {"motion": keys}), "camera"),
        (scene(BALL | {"group": "a"}, group=[{"name": "a", "motion": keys}]), "group[0]"),
    ):
        with pytest.raises(SceneError) as error:
            prepare(wanted)
        rule = f"{place}.motion.outside: keyframes must cover all exposures, 0 to 1 s; got 0 to 0.9 s"
        assert error.value.messages == (rule,)
    lens = {"keyframe": [{"time": 0.2, "f_number": 2.0}, {"time": 0.9, "f_number": 3.0}], "outside": "error"}
    with pytest.raises(
        SceneError, match=r"lens.outside: keyframes must cover all exposures, 0 to 1 s; got 0.2 to 0.9 s"
    ):
        prepare(scene(BALL, lens=lens))
    keys["keyframe"][1]["time"] = 1.0  # type: ignore[index]
    assert prepare(scene(BALL | {"motion": keys})).plan.moves


def test_a_jump_has_the_light_of_the_times_before_and_after() -> None:
    keys = [{"time": 0.0}, {"time": 0.3, "position": [9.0, 0.0, 0.0]}]
    jumps = scene(
        BALL | {"motion": {"keyframe": keys, "interpolation": "step"}}, WALL,
        sequence={"samples": "auto", "frames": 1, "interval": 1.0},
    )  # fmt: skip
    there = scene(BALL | {"motion": {"keyframe": [keys[1]]}}, WALL, sequence={"frames": 1})
    (frame,), (first,), (then,) = rendered(jumps), rendered(scene(BALL, WALL, sequence={"frames": 1})), rendered(there)
    assert frame.metadata["samples"] == 2
    assert np.abs(first.color - then.color).max() > 0.1
    np.testing.assert_allclose(frame.color, 0.3 * first.color + 0.7 * then.color, rtol=0, atol=1e-6)
    np.testing.assert_array_equal(frame.object_id, then.object_id)  # in the middle of the exposure


def orbit(radius: float, count: int = 12) -> list[dict[str, Any]]:
    """Keys of a circle in a second, from x = 0 away from the camera and back."""
    turns = [2.0 * pi * k / count for k in range(count + 1)]
    return [
        {"time": k / count, "position": [radius * sin(turn), 0.0, radius * (cos(turn) - 1.0)]}
        for k, turn in enumerate(turns)
    ]


def orbiting(frames: int, **motion: Any) -> Scene:
    """A ball that passes before a wall once a second, and is far behind it at all whole seconds."""
    ball = {"shape": "sphere", "center": [0.0, 0.0, 340.0], "radius": 9.0, "texture": "#ffffff", "motion": motion}
    wall = {"shape": "rectangle", "center": [0.0, 0.0, 290.0], "size": [50.0, 40.0], "texture": "checkerboard"}
    sequence = {"samples": 9, "frames": frames, "interval": 1.0}
    return scene_from({"camera": CAMERA, "psf": {"tilt": False}, "sequence": sequence}, ball, wall)


@pytest.mark.slow
@pytest.mark.parametrize("way", ["cubic", "step"])
def test_an_orbit_between_the_times_that_are_predicted(way: str) -> None:
    """Its group of occluders and its radii are found on the device, whatever the times that the plan looked at."""
    keys = orbit(90.0)
    if way == "step":
        keys = [{"time": 0.0}, {"time": 0.3, "position": [10.0, 0.0, -180.0]}, {"time": 0.7}]
    # A plan of many frames looks at whole seconds; the orbit is over before the first of them.
    long, short = (orbiting(frames, keyframe=keys, interpolation=way) for frames in (32, 1))
    known, missed = plan_scene(short, 1), plan_scene(long, 1)
    assert known.largest_blur > missed.largest_blur + 1.0
    assert known.groups != missed.groups
    (frame,) = clsco.render(long, frames=[0], truth=())
    np.testing.assert_allclose(frame.color, reference_frames(short)[0].color, rtol=0, atol=1e-5)


@pytest.mark.slow
def test_a_shake_between_the_times_that_are_predicted() -> None:
    """Few predicted times of many frames miss how far it goes; the frame is right, whatever the plan was."""
    shake = {"rotation_rms": 2.0, "translation_rms": 12.0, "band": [1.0, 6.0], "seed": 3}
    ball = {"shape": "sphere", "center": [0.0, 0.0, 230.0], "radius": 9.0, "texture": "#ffffff"}
    tables: dict[str, Any] = {"camera": CAMERA | {"shake": shake}, "psf": {"tilt": False}}
    short, long = (
        scene_from(tables, ball, WALL, sequence={"samples": 9, "frames": frames, "interval": 1.0}) for frames in (1, 33)
    )
    (frame,) = clsco.render(long, frames=[0], truth=())
    np.testing.assert_allclose(frame.color, reference_frames(short)[0].color, rtol=0, atol=1e-5)
