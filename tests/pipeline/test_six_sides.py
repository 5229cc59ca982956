"""Images on the six sides of boxes and cube maps: each reads right from outside, however the object is turned."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from clsco.optics.motion import poses_at
from clsco.scene.model import Scene
from clsco.scene.rotations import rotation_rows
from tests.pipeline.common import PLAIN
from tests.scenes import assert_agree, reference_frames, rendered, scene_from

# A letter; the turn that brings the side to the front: about y the right side comes nearer, about x the top goes away
# (scene_files.md); what is to the right and up for who looks at it upright: with the front beside, below or above it.
SIDES: dict[str, tuple[str, list[float], tuple[int, ...], tuple[int, ...]]] = {
    "front": ("F", [0.0, 0.0, 0.0], (1, 0, 0), (0, 1, 0)),
    "back": ("K", [0.0, 180.0, 0.0], (-1, 0, 0), (0, 1, 0)),
    "left": ("L", [0.0, -90.0, 0.0], (0, 0, -1), (0, 1, 0)),
    "right": ("R", [0.0, 90.0, 0.0], (0, 0, 1), (0, 1, 0)),
    "top": ("P", [-90.0, 0.0, 0.0], (1, 0, 0), (0, 0, 1)),
    "bottom": ("G", [90.0, 0.0, 0.0], (1, 0, 0), (0, 0, -1)),
}
SHOWN = {side: turn for side, (_, turn, *_) in SIDES.items()}
CAMERA: dict[str, Any] = {"resolution": [40, 40], "pixel_pitch": 0.1, "f_number": 4.0, "focus_distance": 262.0}
TRUTH = ("uv", "depth", "object_id", "sharp")
SIZE, CENTER = [30.0, 24.0, 20.0], [0.0, 0.0, 280.0]


def letter(side: str) -> NDArray[np.float32]:
    """A letter that no mirror keeps."""
    image = Image.new("L", (32, 32), 40)
    ImageDraw.Draw(image).text((16, 16), SIDES[side][0], 255, ImageFont.load_default(28), "mm")
    return (np.asarray(image) / 255).astype(np.float32)


def lettered(**keys: Any) -> dict[str, Any]:
    """Keys of an object with a letter on each side."""
    images = {"texture" if side == "front" else f"texture_{side}": letter(side) for side in SHOWN}
    return {"center": CENTER, "texture_mapping": "surface", **images, **keys}


def scene(*items: dict[str, Any], **sections: Any) -> Scene:
    return scene_from({"camera": CAMERA, "psf": PLAIN}, *items, **sections)


def box(**keys: Any) -> dict[str, Any]:
    return lettered(shape="box", size=SIZE, **keys)


def card(side: str, **keys: Any) -> dict[str, Any]:
    """A card where the side of the box is that faces the camera."""
    x, y, z = SIZE
    width, height, deep = {"front": (x, y, z), "back": (x, y, z), "left": (z, y, x), "right": (z, y, x)}.get(
        side, (x, z, y)
    )
    place = [0.0, 0.0, CENTER[2] - deep / 2]
    return {"shape": "rectangle", "size": [width, height], "center": place, "texture": letter(side), **keys}


def test_letters_have_no_mirror_images() -> None:
    for side in SHOWN:
        image = letter(side)
        for other in (image[:, ::-1], image[::-1], image[::-1, ::-1]):
            assert np.abs(image - other).mean() > 0.02


@pytest.mark.parametrize("side", SHOWN)
def test_a_side_of_a_box_is_a_card_with_its_letter(side: str) -> None:
    given = scene(box(rotation=SHOWN[side])), scene(card(side, texture_mapping="surface"))
    (found,), (wanted,) = (rendered(each, truth=TRUTH, color=False) for each in given)
    # Beside its edges a pixel shows the next sides of a box.
    inner = (slice(14, 26),) * 2
    np.testing.assert_allclose(found.sharp[inner], wanted.sharp[inner], rtol=0, atol=2e-6)
    assert np.ptp(found.sharp[inner]) > 0.3
    np.testing.assert_allclose(found.uv, wanted.uv, rtol=0, atol=1e-6)


@pytest.mark.slow
def test_a_turning_box_shows_its_sides_one_after_the_other() -> None:
    """A quarter turn per frame: front, right, back, left."""
    sequence = {"frames": 4, "interval": 1.0, "shutter": 1e-9, "samples": 1}
    turning = box(motion={"angular_velocity": [0.0, 90.0, 0.0]})
    frames = rendered(scene(turning, sequence=sequence), truth=TRUTH)
    for side, frame in zip(("front", "right", "back", "left"), frames, strict=True):
        (still,) = rendered(scene(box(rotation=SHOWN[side])), truth=TRUTH)
        np.testing.assert_allclose(frame.color, still.color, rtol=0, atol=2e-6)


@pytest.mark.parametrize("rotation", [[20.0, 30.0, 10.0], [200.0, 30.0, 100.0]])
def test_uv_of_a_box_is_right_and_up_from_the_corner_of_each_side(rotation: list[float]) -> None:
    """Points from the depth, in the frame of the box, moved: a second way to the same coordinates."""
    motion = {"velocity": [3.0, -2.0, 4.0], "angular_velocity": [25.0, -40.0, 60.0]}
    wanted = scene(
        box(rotation=rotation, motion=motion), sequence={"frames": 2, "interval": 1.0, "shutter": 1e-9, "samples": 1}
    )
    (frame,) = rendered(wanted, frames=[1], truth=TRUTH, color=False)
    names = [item.name.split()[1] for item in wanted.objects]
    pose = poses_at(wanted, 1.0 + 0.5e-9)[0]
    turn = pose.rotation @ np.array(rotation_rows((rotation[0], rotation[1], rotation[2])))
    step = 0.1 / wanted.camera.focal_length
    i, j = np.nonzero(frame.object_id >= 0)
    z = frame.depth[i, j].astype(float)
    points = np.stack([(j - 19.5) * step * z, (19.5 - i) * step * z, z], axis=1)
    own = (points - np.array(CENTER) - pose.shift) @ turn
    sides = [names[number] for number in frame.object_id[i, j]]
    assert len(set(sides)) == 3
    right, up = (np.array([SIDES[side][k] for side in sides], float) for k in (2, 3))
    size = np.array(SIZE)
    expected = [0.5 + (own * axis).sum(axis=1) / np.abs(axis @ size) for axis in (right, up)]
    np.testing.assert_allclose(frame.uv[i, j], np.stack(expected, axis=1), rtol=0, atol=1e-4)


@pytest.mark.parametrize("side", SHOWN)
def test_a_side_of_a_cube_map_reads_as_the_front_does(side: str) -> None:
    ball = {"shape": "sphere", "radius": 14.0, "texture_mapping": "cube"}
    given = lettered(rotation=SHOWN[side]) | ball, {"center": CENTER, "texture": letter(side)} | ball
    found, wanted = (rendered(scene(item), truth=TRUTH, color=False)[0].sharp for item in given)
    # Other sides differ, which begin 45 degrees off the middle.
    middle = np.hypot(*np.indices((40, 40)) - 19.5) < 6.0
    np.testing.assert_allclose(found[middle], wanted[middle], rtol=0, atol=1e-3)
    assert np.ptp(found[middle]) > 0.3


@pytest.mark.slow
def test_lettered_boxes_on_all_devices() -> None:
    moving = box(rotation=[20.0, 150.0, 10.0], motion={"angular_velocity": [30.0, 40.0, 0.0]})
    wanted = scene(moving, psf={"tilt": True}, sequence={"samples": 2, "shutter": 0.2})
    exact = reference_frames(wanted)
    assert_agree(rendered(wanted, precision="double"), exact)
    assert_agree(rendered(wanted, precision="single"), exact)
