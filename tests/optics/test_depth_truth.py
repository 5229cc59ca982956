"""Truth from depth alone against the truth of the surfaces that the depth is of."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from clsco.optics.depth_truth import MapPoints, map_flow, map_normal, map_occluded, map_stereo
from clsco.optics.exposure import middle_time
from clsco.optics.motion import Eye, Pose, poses_at
from clsco.reference.trace.truth import Truth, ground_truth
from clsco.scene.model import Camera, CameraMotion, ObjectMotion, Plane, Scene, Sequence, Sphere, Stereo
from tests.scenes import scene_of

Array = NDArray[Any]
SHAPE = (40, 52)
LENS: dict[str, Any] = {"pixel_pitch": 0.1}
CAMERA = Camera(resolution=(52, 40), **LENS)
GOING = ObjectMotion(velocity=(8.0, -4.0, 10.0), angular_velocity=(3.0, -8.0, 12.0))
BALL = Sphere(center=(-8.0, 3.0, 200.0), radius=16.0, motion=GOING)
WALL = Plane(distance=300.0, slope_x=0.5, slope_y=-0.3)
CARD = Plane(distance=260.0, slope_x=-0.4, bounds=((-14.0, 30.0), (-20.0, 12.0), (-60.0, 60.0)))
STILL = Pose(np.eye(3), np.zeros(3))
scene = partial(scene_of, size=(52, 40), camera=LENS, sequence=Sequence(shutter=0.5, interval=0.6))


def truth_of(wanted: Scene, eye: Eye = "left") -> Truth:
    return ground_truth(wanted, (np.zeros((*SHAPE, 1)),) * len(wanted.objects), 0, eye)


def poses(wanted: Scene, frame: int, eye: Eye = "left") -> tuple[Pose, ...]:
    return poses_at(wanted, middle_time(wanted.sequence, frame), eye)


def points(wanted: Scene, depth: Array, number: Array, frame: int, eye: Eye = "left") -> MapPoints:
    return MapPoints(wanted.objects, depth, number, CAMERA, poses(wanted, frame, eye))


def test_normals_of_planes_are_exact_up_to_their_edges() -> None:
    """Differences stay within the surface where another one begins: a card before a wall, with nothing beside it."""
    for items in ((CARD, WALL), (CARD,)):
        truth = truth_of(scene(*items))
        assert len(np.unique(truth.object_id)) == 2
        found = map_normal(CAMERA, truth.depth)
        assert found.dtype == np.float32
        assert not found[~truth.mask].any()
        # Rounding to float32, of differences of float64 points some 1e-3 of their size.
        np.testing.assert_allclose(found[truth.mask], truth.normal[truth.mask], rtol=0, atol=1e-7)


def test_normals_of_a_ball() -> None:
    truth = truth_of(scene(BALL.model_copy(update={"motion": ObjectMotion()}), WALL))
    found = map_normal(CAMERA, truth.depth)
    np.testing.assert_allclose(np.linalg.norm(found, axis=-1), 1.0, atol=1e-6)
    # A difference is the chord of an arc: its normal is that half a step of 200 mm x 0.005 / cos aside, on 16 mm.
    facing = (truth.object_id == 0) & (truth.normal[..., 2] < -0.6)
    angle = np.degrees(np.arccos(np.clip((found * truth.normal).sum(axis=-1)[facing], -1, 1)))
    assert facing.sum() > 100
    assert angle.max() < np.degrees(np.hypot(0.5, 0.5) * 200 * 0.005 / 16 / 0.6)


def test_a_normal_without_neighbors_points_to_the_lens() -> None:
    depth = np.full(SHAPE, np.inf)
    depth[7, 40] = 100.0
    found = map_normal(CAMERA, depth)
    ray = np.array([(40 - 25.5) * 0.005, (19.5 - 7) * 0.005, 1.0])
    np.testing.assert_allclose(found[7, 40], -ray / np.linalg.norm(ray), atol=1e-7)
    assert np.count_nonzero(found.any(axis=-1)) == 1
    one = map_normal(Camera(resolution=(1, 1)), np.array([[50.0]]))
    np.testing.assert_array_equal(one, [[[0.0, 0.0, -1.0]]])


@pytest.mark.parametrize("camera", [CameraMotion(), CameraMotion(velocity=(-5.0, 2.0, 20.0))], ids=["still", "moving"])
def test_flow_is_that_of_the_surfaces(camera: CameraMotion) -> None:
    wanted = scene(BALL, WALL, camera=LENS | {"motion": camera})
    truth = truth_of(wanted)
    found = map_flow(points(wanted, truth.depth, truth.object_id, 0), CAMERA, poses(wanted, 1))
    assert np.abs(truth.flow[truth.object_id == 0]).max() > 3.0
    assert (np.abs(truth.flow[truth.object_id == 1]).max() > 1.0) == (camera.velocity[2] > 0)
    np.testing.assert_allclose(found, truth.flow, rtol=2e-7, atol=1e-9)  # rounded to float32


def test_nothing_flows_to_behind_the_lens_or_where_nothing_is() -> None:
    depth = np.full(SHAPE, 200.0)
    depth[:, :20] = np.inf
    number = np.where(np.isfinite(depth), 0, -1).astype(np.int32)
    forth = (Pose(np.eye(3), np.array([3.0, 0.0, 0.0])),)
    shown = MapPoints((BALL,), depth, number, CAMERA, (STILL,))
    flow = map_flow(shown, CAMERA, forth)
    assert not flow[:, :20].any()
    np.testing.assert_allclose(flow[:, 20:], np.broadcast_to([3.0, 0.0], (40, 32, 2)), atol=1e-6)  # 20 / 200 / 0.1
    behind = (Pose(np.eye(3), np.array([0.0, 0.0, -250.0])),)
    assert not map_flow(shown, CAMERA, behind).any()
    longer = CAMERA.model_copy(update={"normalization_distance": 2.0 * CAMERA.normalization_distance})
    column = np.arange(52) - 25.5  # a zoom to twice the focal length takes each point twice as far from the axis
    zoomed = map_flow(shown, longer, (STILL,))[:, 20:]
    np.testing.assert_allclose(zoomed[..., 0], np.broadcast_to(column[20:], (40, 32)), atol=1e-6)


@pytest.mark.parametrize("eye", ["left", "right"])
@pytest.mark.parametrize("toe_in", [0.0, 2.0])
def test_stereo_is_that_of_the_surfaces(toe_in: float, eye: Eye) -> None:
    wanted = scene(BALL, WALL, stereo=Stereo(baseline=15.0, toe_in=toe_in))
    other: Eye = "right" if eye == "left" else "left"
    truth, opposite = truth_of(wanted, eye), truth_of(wanted, other)
    assert truth.disparity is not None
    assert truth.occluded is not None
    shown = points(wanted, truth.depth, truth.object_id, 0, eye)
    disparity, occluded = map_stereo(shown, poses(wanted, 0, other), opposite.depth, eye)
    np.testing.assert_allclose(disparity, truth.disparity, rtol=2e-7, atol=1e-9)
    assert np.abs(disparity).max() > 3.0
    # The other view is looked at in its pixel centers: what is hidden may differ where that rounds over an outline.
    assert 0.03 < truth.occluded.mean() < 0.5
    assert (occluded != truth.occluded).mean() < 0.02


def test_occlusion_in_the_next_frame_is_that_of_the_surfaces() -> None:
    wanted = scene(BALL, WALL)
    now, then = (ground_truth(wanted, (np.zeros((*SHAPE, 1)),) * 2, k) for k in (0, 1))
    shown = points(wanted, now.depth, now.object_id, 0)
    found = map_occluded(shown, CAMERA, poses(wanted, 1), then.depth)
    assert found.dtype == np.bool_
    assert 0.01 < now.flow_occluded.mean() < 0.5
    assert (found != now.flow_occluded).mean() < 0.02  # pixel centers, as of the other view
    back = map_flow(shown, CAMERA, poses(wanted, -1))
    np.testing.assert_allclose(back, now.flow_backward, rtol=2e-7, atol=1e-9)


def test_a_point_outside_of_the_other_frame_is_occluded() -> None:
    depth, number = np.full(SHAPE, 200.0), np.zeros(SHAPE, np.int32)
    there = (Pose(np.eye(3), np.array([-5.0, 0.0, 0.0])),)  # 5 px to the left
    disparity, occluded = map_stereo(MapPoints((BALL,), depth, number, CAMERA, (STILL,)), there, depth, "left")
    np.testing.assert_allclose(disparity, 5.0, atol=1e-6)
    assert occluded[:, :5].all()
    assert not occluded[:, 5:].any()
    near = depth.copy()
    near[:, 10] = 190.0  # more than 2 percent nearer
    near[:, 20] = 199.0
    _, occluded = map_stereo(MapPoints((BALL,), depth, number, CAMERA, (STILL,)), there, near, "left")
    assert np.flatnonzero(occluded[0]).tolist() == [0, 1, 2, 3, 4, 15]
