"""Backgrounds, infinitely far away: seen by the lens with the blur of infinity, and no surface in the ground truth."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import clsco
from clsco.files.transfer import decode
from clsco.scene.model import Background, Plane, Scene
from tests.pipeline.common import PLAIN
from tests.pipeline.test_scenes import BALL, GOING, assert_agrees, scene
from tests.scenes import assert_agree, reference_frames, rendered
from tests.slow import mostly_slow

SKY = {"shape": "background", "texture": "checkerboard"}
TURNING = {"velocity": [5.0, 0.0, 0.0], "angular_velocity": [0.0, 4.0, 3.0]}
SMALL = {"aperture_diameter": 6.0}
CASES: dict[str, Any] = {
    "still": ((BALL, SKY), {}),
    "first": ((SKY, BALL), {"psf": {"model": "gaussian"}}),
    "moving": ((BALL | {"motion": GOING}, SKY), {"sequence": {"frames": 2, "interval": 0.2, "samples": 2}}),
    "forward": (
        (BALL | {"motion": GOING}, SKY),
        {"motion": {"warp": "forward"}, "psf": PLAIN, "sequence": {"frames": 1, "samples": 1, "interval": 0.5}},
    ),
    "layered": ((BALL, SKY), {"psf": {"occlusion": "layered", "silhouette_samples": 1}}),
    "stereo": ((BALL, SKY), {"stereo": {"baseline": 6.0}, "psf": PLAIN}),
}


@pytest.mark.parametrize(
    ("items", "sections"), mostly_slow(CASES.values(), [CASES["still"], CASES["layered"]]), ids=CASES
)
def test_agrees_with_the_reference(items: Any, sections: Any) -> None:
    wanted = scene(*items, camera=SMALL, **sections)
    frames, exact = rendered(wanted), reference_frames(wanted)
    assert_agree(frames, exact)
    number = items.index(SKY)
    for truth in frames:
        assert 0.05 < truth.mask.mean() < 0.95
        assert (truth.object_id[~truth.mask] == -1).all()
        assert (truth.object_id != number).all()
        assert np.isinf(truth.depth[~truth.mask]).all()
        assert truth.sharp[~truth.mask].max() > 0.5


def test_a_turning_camera_sees_another_part_of_it() -> None:
    sequence = {"frames": 2, "interval": 1.0, "shutter": 0.01, "samples": 1}
    turned = scene(SKY, camera=SMALL | {"motion": TURNING}, sequence=sequence, psf=PLAIN)
    first, second = assert_agrees(turned)
    assert np.abs(first.color - second.color).max() > 0.08


def test_beside_a_depth_map() -> None:
    depth = np.full((40, 56), 300.0)
    depth[:, :20] = 0.0  # nothing there
    card = {"shape": "depth_map", "depth": depth, "texture": "bricks"}
    how = {"motion": {"warp": "forward"}, "fill": {"method": "none"}, "psf": PLAIN | {"occlusion": "layered"}}
    (frame,) = assert_agrees(scene(card, SKY, camera=SMALL, **how))
    assert (frame.mask.mean(axis=0) == (np.arange(56) >= 20)).all()


def test_its_blur_is_that_of_infinity() -> None:
    wanted = scene(BALL, SKY, camera=SMALL)
    camera = wanted.camera
    (frame,) = rendered(wanted, truth=["blur_radius", "mask"], color=False)
    power = 1.0 / camera.focal_length - 1.0 / camera.sensor_distance
    expected = camera.normalization_distance * camera.aperture_diameter / (2.0 * camera.pixel_pitch) * power
    np.testing.assert_allclose(frame.blur_radius[~frame.mask], expected, rtol=1e-6)
    assert abs(expected) > 2.5


def test_it_is_a_plane_as_far_away_as_planes_can_be() -> None:
    far = {"shape": "plane", "distance": 1e9, "texture": "checkerboard"}
    sky, plane = (clsco.render_frame(scene(BALL, item, camera=SMALL), truth=()) for item in (SKY, far))
    np.testing.assert_allclose(sky.color, plane.color, atol=1e-6)


@pytest.mark.parametrize(("color", "shape"), [("#204080", (40, 56, 3)), ("#808080", (40, 56))])
def test_a_color_is_the_same_everywhere(color: str, shape: tuple[int, ...]) -> None:
    given = Scene(objects=(Background(texture=color),), camera=scene(SKY).camera)
    (frame,) = rendered(given, truth=["sharp"])
    codes = np.frombuffer(bytes.fromhex(color[1:]), np.uint8)[: shape[2] if len(shape) == 3 else 1]
    expected = np.broadcast_to(decode(codes, "srgb").reshape(-1)[: len(codes)], (*shape[:2], len(codes)))
    assert frame.color.shape == shape
    np.testing.assert_allclose(frame.sharp, expected.reshape(shape), rtol=1e-6)
    np.testing.assert_allclose(frame.color, expected.reshape(shape), rtol=1e-5)  # light from beyond the frame too


def test_a_color_is_a_texture_of_any_shape() -> None:
    (frame,) = clsco.render(Scene(objects=(Plane(texture="#ff0000"),), camera=scene(SKY).camera))
    np.testing.assert_allclose(frame.color, np.broadcast_to([1.0, 0.0, 0.0], (40, 56, 3)), atol=1e-5)


def test_what_is_no_color_is_named() -> None:
    with pytest.raises(
        clsco.SceneError, match=r"object\[0\].texture: .*a color #rrggbb, or an image file; got '#12345'"
    ):
        list(clsco.render(Scene(objects=(Plane(texture="#12345"),))))


def test_one_background_is_enough() -> None:
    rule = r"object\[2\].shape: one background is enough; object\[1\] is one already; got \"background\""
    with pytest.raises(clsco.SceneError, match=rule):
        scene(BALL, SKY, SKY)
