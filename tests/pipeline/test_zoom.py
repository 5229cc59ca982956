"""A lens that zooms, from scene to frame: device against reference, and closed forms."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import pytest

import clsco
from clsco.frame.cameras import pinhole
from clsco.inputs.pupils import scene_point_spread
from clsco.optics.image_motion import motion_needs
from clsco.optics.lens_path import camera_at
from clsco.plan.prepare import prepare
from clsco.scene.model import Scene
from clsco.studio.inspector import source_of
from tests.pipeline.common import BALL, PLAIN, STEP, WALL
from tests.scenes import assert_agree, reference_frames, rendered, scene_from
from tests.slow import mostly_slow

CAMERA: dict[str, Any] = {"resolution": [48, 36], "pixel_pitch": 0.1, "f_number": 1.0, "focus_distance": 250.0}
NEARER = {"keyframe": [{"time": 0.0, "focal_length": 20.0}, {"time": 1.0, "focal_length": 35.0, "f_number": 2.0}]}
WIDER = {"keyframe": [{"time": 0.0, "focal_length": 20.0}, {"time": 1.0, "focal_length": 9.0}]}
DOLLY = [{"time": 0.0, "focal_length": 20.0}, {"time": 1.0, "focal_length": 14.0, "focus_distance": 180.0}]
GOING = {"motion": {"velocity": [8.0, 3.0, -4.0]}}
BREATHING = {"keyframe": [{"time": 0.0, "focus_distance": 100.0}, {"time": 1.0, "focus_distance": "inf"}]}
BY_SENSOR = CAMERA | {"f_number": 4.0, "normalization_distance": "sensor"}
scene = partial(
    scene_from, {"camera": CAMERA, "lens": NEARER, "sequence": {"samples": 3, "frames": 2, "interval": 0.5}}
)
SCENES: dict[str, Scene] = {
    "plain": scene(BALL, WALL, psf=PLAIN),
    "moving": scene(BALL | GOING, WALL),
    "wider": scene(BALL, WALL, lens=WIDER, psf={"model": "gaussian"}),
    "dolly": scene(BALL, WALL, lens={"keyframe": DOLLY}, camera=CAMERA | {"motion": {"velocity": [0.0, 0.0, 75.0]}}),
    "one radius": scene(WALL, psf=PLAIN),
    "forward": scene(BALL, WALL, psf=PLAIN, motion={"warp": "forward"}),
    "rolling": scene(BALL, WALL, psf=PLAIN, sequence={"shutter": 0.2, "readout": 0.2}),
    "stereo": scene(BALL, WALL, psf=PLAIN, stereo={"baseline": 20.0, "toe_in": 1.0}),
    "breathing": scene(BALL, WALL, psf=PLAIN, lens=BREATHING, camera=BY_SENSOR),
    "map": scene({"shape": "depth_map", "depth": STEP, "texture": "checkerboard"}, psf=PLAIN),
}


@pytest.mark.parametrize("name", mostly_slow(SCENES, ["plain", "map"]))
def test_device_against_reference(name: str) -> None:
    frames = rendered(SCENES[name])
    assert_agree(frames, reference_frames(SCENES[name]))
    assert np.abs(frames[0].flow).max() > 1.0
    assert name != "map" or np.any(frames[0].filled == 1)  # gaps that the growth leaves


def still(wanted: Scene, time: float) -> Scene:
    """The scene before a camera that has the lens of a time for good."""
    lens = camera_at(wanted, time)
    changed = {"focal_length": lens.focal_length, "focus_distance": lens.focused_distance, "f_number": lens.f_number}
    camera = clsco.Camera(**(wanted.camera.model_dump(exclude_unset=True) | changed))
    return wanted.model_copy(update={"lens": None, "camera": camera})


@pytest.mark.slow
def test_textures_on_surfaces_look_as_through_a_camera_of_that_focal_length() -> None:
    """They do not depend on the reference pose, so that each time sample is a frame of a scene without a zoom."""
    on = {"texture_mapping": "surface"}
    wanted = scene(BALL | on, WALL | on | {"texture_size": [90.0, 70.0]}, sequence={"frames": 1, "interval": 1.0})
    (frame,), (middle,) = rendered(wanted), rendered(still(wanted, 0.5))
    each = [rendered(still(wanted, time), truth=())[0].color for time in (1 / 6, 0.5, 5 / 6)]
    assert np.abs(each[0] - each[2]).max() > 0.1
    np.testing.assert_allclose(frame.color, np.mean(each, axis=0), rtol=0, atol=1e-5)
    for name in ("sharp", "depth", "blur_radius", "object_id", "normal", "uv"):
        np.testing.assert_allclose(getattr(frame, name), getattr(middle, name), rtol=1e-6, atol=1e-5)


def test_a_focus_that_is_pulled_breathes_where_sizes_are_those_on_the_sensor() -> None:
    wall = WALL | {"texture_mapping": "surface", "texture_size": [90.0, 70.0]}
    breathing = scene(wall, lens=BREATHING, camera=BY_SENSOR, psf=PLAIN, sequence={"samples": 1, "interval": 1.0})
    for index, frame in enumerate(rendered(breathing)):
        (alone,) = rendered(still(breathing, index + 0.5).replace("sequence.frames", 1))
        np.testing.assert_allclose(frame.color, alone.color, rtol=0, atol=1e-5)
    assert not scene(wall, lens=BREATHING, camera=BY_SENSOR | {"normalization_distance": 20.0}).zooms


def test_a_plane_that_faces_the_lens_is_magnified() -> None:
    """The radiance of a point goes outwards along a line from the middle, in proportion to the focal length."""
    rows, columns = np.indices((36, 48)) - np.array([17.5, 23.5])[:, None, None]
    waves = 0.5 + 0.25 * np.sin(0.1 * columns + 0.05 * rows) + 0.2 * np.cos(0.07 * columns - 0.12 * rows)
    plane = clsco.Plane(distance=250.0, texture=waves.astype(np.float32))
    wanted = scene(sequence={"samples": 1, "interval": 1.0}, object=[WALL]).model_copy(update={"objects": (plane,)})
    frame, after = rendered(wanted, color=False)
    grown, later = 27.5 / 20.0, 35.0 / 20.0  # at the middles of the exposures, of which the second comes after the keys
    x, y = columns / grown, rows / grown
    expected = 0.5 + 0.25 * np.sin(0.1 * x + 0.05 * y) + 0.2 * np.cos(0.07 * x - 0.12 * y)
    np.testing.assert_allclose(frame.sharp, expected, rtol=0, atol=1e-3)  # the bicubic filter
    flow = np.stack([columns, rows], axis=-1) * (later / grown - 1.0)
    np.testing.assert_allclose(frame.flow, flow, rtol=0, atol=1e-5)
    back = np.stack([columns, rows], axis=-1) * (1.0 / grown - 1.0)
    np.testing.assert_allclose(frame.flow_backward, back, rtol=0, atol=1e-5)
    assert not after.hidden.any()
    # What is behind the frame's edge by then is occluded, and comes into view as long as the image shrinks.
    outside = (np.abs(columns * later / grown) > 24.0) | (np.abs(rows * later / grown) > 18.0)
    np.testing.assert_array_equal(frame.flow_occluded, outside)


def test_what_a_wider_view_shows_beside_the_reference_pose_is_hidden_there() -> None:
    (frame, _) = rendered(scene(WALL, lens=WIDER, sequence={"interval": 1.0}), truth=("hidden",), color=False)
    rows, columns = np.indices((36, 48)) - np.array([17.5, 23.5])[:, None, None]
    beside = (np.abs(columns) * 20.0 / 14.5 > 24.0) | (np.abs(rows) * 20.0 / 14.5 > 18.0)
    np.testing.assert_array_equal(frame.hidden, beside)


def test_samples_follow_the_way_over_the_image() -> None:
    wanted = scene(WALL, sequence={"samples": "auto", "frames": 1, "interval": 1.0})
    (need,) = motion_needs(wanted, scene_point_spread(wanted), guard=1)
    corner = np.hypot(23.5, 17.5)
    assert need.speed == pytest.approx(corner * 0.75, rel=0.02)
    assert prepare(wanted).plan.samples >= need.speed
    assert (
        motion_needs(scene(WALL, lens={"keyframe": [{"time": 0.0, "f_number": 2.0}]}), scene_point_spread(wanted)) == []
    )


def test_cameras_of_frames_have_their_focal_lengths() -> None:
    wanted = SCENES["plain"]
    for index, focal in enumerate((23.75, 31.25)):
        assert pinhole(wanted, index).focal == pytest.approx(focal / 0.1)
    for index, focus in enumerate((1 / 0.0075, 1 / 0.0025)):
        assert pinhole(SCENES["breathing"], index).focal == pytest.approx(1 / (1 / 20.0 - 1 / focus) / 0.1)


def test_a_pixel_leads_back_to_its_texel() -> None:
    wanted = SCENES["one radius"]
    frame = clsco.render_frame(wanted, color=False)
    column, row = np.rint(np.array([23.5, 17.5]) + (np.array([40, 30]) - [23.5, 17.5]) * 20.0 / 23.75).astype(int)
    assert source_of(frame, wanted, 40, 30) == (column, row, 0)
