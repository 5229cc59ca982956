"""Distortion of the image from scene to frame."""

from __future__ import annotations

from functools import partial
from typing import Any

import cv2
import numpy as np
import pytest

import clsco
from clsco.optics.distortion import Distortion
from clsco.plan.prepare import prepare
from clsco.scene.model import Scene
from tests.pipeline.common import SLOPE, assert_strips_agree, lens_points, waves
from tests.scenes import assert_agree, reference_frames, rendered, scene_from
from tests.slow import mostly_slow

CAMERA: dict[str, Any] = {
    "resolution": [40, 32],
    "pixel_pitch": 0.4,
    "aperture_diameter": 30.0,
    "focus_distance": 180.0,
}
BALL: dict[str, Any] = {"shape": "sphere", "center": [20.0, 10.0, 270.0], "radius": 60.0, "texture": "bricks"}
WALL: dict[str, Any] = {"shape": "plane", "distance": 290.0, "texture": "siemens_star", "slope_x": 0.3}
MOVING = {"motion": {"velocity": [40.0, 15.0, 0.0], "angular_velocity": [0.0, 0.0, 20.0]}}
EXPOSED = {"samples": 3, "shutter": 0.1, "interval": 0.1}
D: dict[str, Any] = {"distortion": [-0.25, 0.05, 0.0], "tangential": [0.01, -0.02]}
CURVED: dict[str, Any] = {"field_curvature": -1 / 150, "focus_surface": "sphere", "vignetting": "natural"}
COLORS: dict[str, Any] = {"axial": [0.2, 0.0, -0.15], "lateral": [1.02, 1.0, 0.97]}
BARREL: dict[str, Any] = {"distortion": [-0.1, 0.02, 0.0]}
WIDE = CAMERA | {"resolution": [40, 72], "pixel_pitch": 0.4, "aperture_diameter": 80.0}  # R from 1 to 7 px, two bands
WIDEST = WIDE | {"resolution": [22, 16], "pixel_pitch": 1.0}
WIDER = {"distortion": [-0.2, 0.03, 0.0], "tangential": [0.01, -0.02]}
NEARER: dict[str, Any] = {"center": [10.0, 5.0, 250.0], "radius": 40.0}
SMALL: dict[str, Any] = {"center": [10.0, 5.0, 215.0], "radius": 20.0}
CHECKS = {"texture": "checkerboard", "texture_mapping": "surface"}
RIMS = {"rim": [{"distance": 20.0, "diameter": 30.0}, {"distance": -10.0, "diameter": 30.0}]}
FORWARD = {"warp": "forward"}
WAVES = (0.6, 0.5)
scene = partial(scene_from, {"camera": CAMERA})
SCENES: dict[str, Scene] = {
    "still": scene(BALL, WALL, lens=D),
    "pincushion": scene(BALL, WALL, lens={"distortion": [0.3, 0.2, 0.1]}),
    "one depth": scene(WALL | {"slope_x": 0.0}, lens=D),
    "forward": scene(BALL | MOVING, WALL, lens=D, sequence=EXPOSED, motion=FORWARD),
    "curved": scene(BALL | MOVING, WALL, lens=D | CURVED, sequence=EXPOSED),
    "colors": scene(BALL, WALL, lens=D | CURVED | COLORS),
    "layered": scene(BALL, WALL, lens=D, psf={"occlusion": "layered"}),
    "gaussian": scene(BALL, WALL, lens=D, psf={"model": "gaussian"}),
    "rims": scene(BALL, WALL, lens=D, aperture=RIMS),
    "mapped": scene(BALL | CHECKS, WALL, lens=D),
    "renormalize": scene(BALL, WALL, lens=D, psf={"border": "renormalize"}),
    "hidden ellipses": scene(BALL | NEARER, WALL | {"distance": 330.0}, lens=WIDER, camera=WIDEST),
    "narrow ellipses": scene(BALL | SMALL, WALL | {"distance": 230.0}, lens=WIDER, camera=WIDEST),
    "ellipses, renormalize": scene(BALL | NEARER, WALL, lens=WIDER, camera=WIDEST, psf={"border": "renormalize"}),
    "wide": scene(WALL | {"distance": 330.0}, lens=BARREL, camera=WIDE),
    "map": scene(SLOPE, lens=D | CURVED, sequence=EXPOSED),
    "map, moving": scene(SLOPE | MOVING, lens=D | CURVED, sequence=EXPOSED),
    "map along rays": scene(SLOPE | {"depth_kind": "ray"}, lens=D | CURVED, sequence=EXPOSED),
}


@pytest.mark.parametrize("name", mostly_slow(SCENES, ["hidden ellipses", "map along rays"]))
def test_device_against_reference(name: str) -> None:
    assert_agree(rendered(SCENES[name]), reference_frames(SCENES[name]))


@pytest.mark.parametrize("real", mostly_slow(["double", "single"], ["double"]))
def test_spots_are_where_opencv_has_them(real: Any) -> None:
    center, z = np.array([[60.0, 45.0], [-75.0, 20.0], [10.0, -50.0]]), 250.017
    spots = [{"shape": "disc", "center": [x, y, z], "radius": 5.0, "texture": "#ffffff"} for x, y in center.tolist()]
    matrix = np.array([[50.0, 0.0, 19.5], [0.0, 50.0, 15.5], [0.0, 0.0, 1.0]])
    points = np.concatenate([center * (1.0, -1.0), np.full((3, 1), z)], axis=1)
    wanted, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix, np.array([-0.25, 0.05, 0.01, -0.02, 0.0]))
    for spot, (column, row) in zip(spots, wanted[:, 0].tolist(), strict=True):
        frame = clsco.render_frame(scene(spot, lens=D), truth=(), precision=real)
        light = frame.color.astype(np.float64)
        assert light.sum(axis=0) @ np.arange(40) / light.sum() == pytest.approx(column, abs=0.02)
        assert light.sum(axis=1) @ np.arange(32) / light.sum() == pytest.approx(row, abs=0.02)


def test_flow_follows_opencv() -> None:
    """A point of a wall goes where OpenCV projects it after the move."""
    wall = {"shape": "plane", "distance": 300.0, "motion": {"velocity": [50.0, -20.0, 100.0]}}
    frame: Any = clsco.render_frame(
        scene(wall, lens=D, sequence=EXPOSED | {"frames": 2, "samples": 1}), truth=("flow", "depth"), color=False
    )
    matrix, keys = (
        np.array([[50.0, 0.0, 19.5], [0.0, 50.0, 15.5], [0.0, 0.0, 1.0]]),
        np.array([-0.25, 0.05, 0.01, -0.02, 0]),
    )
    place = np.stack(np.meshgrid(np.arange(40.0), np.arange(32.0)), axis=-1).reshape(-1, 1, 2)
    lens = Distortion.of(SCENES["still"].lens)
    assert lens is not None
    x, y = lens.undistorted(*(np.array([[0.02], [-0.02]]) * (place[:, 0].T - [[19.5], [15.5]])))
    slopes = np.stack([x, -y], axis=-1)
    z = frame.depth.reshape(-1, 1).astype(np.float64)
    points = np.concatenate([slopes * z, z], axis=1) + np.array([5.0, 2.0, 10.0])
    later, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix, keys)
    np.testing.assert_allclose(frame.flow.reshape(-1, 2), (later - place)[:, 0], atol=1e-4)


def test_radii_are_those_of_discs_of_the_same_area() -> None:
    frame = clsco.render_frame(scene(WALL | {"slope_x": 0.0}, lens=D), truth="blur_radius", color=False)
    x, y = np.meshgrid((np.arange(40) - 19.5) * 0.02, (15.5 - np.arange(32)) * 0.02)
    lens = Distortion.of(SCENES["still"].lens)
    assert lens is not None
    alone = clsco.render_frame(scene(WALL | {"slope_x": 0.0}), truth="blur_radius", color=False)
    wanted = alone.blur_radius * lens.stretch(*lens.undistorted(x, y))  # type: ignore[operator]
    np.testing.assert_allclose(frame.blur_radius, wanted, rtol=1e-6)  # type: ignore[arg-type]


@pytest.mark.parametrize("method", mostly_slow(["gather", "scatter"], ["gather"]))
@pytest.mark.parametrize("lens", [{"distortion": [-0.25, 0.05, 0.0]}, D | {"distortion": [0.3, 0.0, 0.0]}], ids=str)
def test_blur_is_the_ellipse_that_the_jacobian_makes_of_the_disc(lens: dict[str, Any], method: str) -> None:
    """Second moments of a point are R^2/4 J J^T, and what both pixels add; its light is kept."""
    texture, (row, column) = np.zeros((81, 97), np.float32), (24, 20)
    texture[row, column] = 1.0
    wide = CAMERA | {"resolution": [97, 81], "pixel_pitch": 0.2, "aperture_diameter": 80.0}
    given = scene({"shape": "plane", "distance": 330.0}, lens=lens, camera=wide, psf={"tilt": False})
    given = given.replace("object[0].texture", texture)
    frame = clsco.render_frame(given, truth="blur_radius", method=method)
    y, x = (at - middle for at, middle in zip(np.indices(texture.shape), (row, column), strict=True))
    light = frame.color.astype(np.float64)
    found = [(light * one).sum() for one in (1.0, x, y, x * x, x * y, y * y)]
    distortion = Distortion.of(given.lens)
    assert distortion is not None
    step = 0.2 / given.camera.normalization_distance
    xx, xy, yy = distortion.jacobian(*distortion.undistorted((column - 48) * step, (40 - row) * step))
    size = frame.blur_radius[row, column] ** 2 / (4.0 * (xx * yy - xy * xy))  # type: ignore[index]
    wanted = [size * (xx * xx + xy * xy) + 1 / 6, -size * xy * (xx + yy), size * (yy * yy + xy * xy) + 1 / 6]
    assert 16.0 < size < 100.0
    np.testing.assert_allclose(found, [1.0, 0.0, 0.0, *wanted], rtol=2e-4, atol=2e-3)


@pytest.mark.parametrize("hidden", mostly_slow([False, True], [False]))
def test_ellipses_against_rays_through_the_lens(hidden: bool) -> None:
    """Each pixel is the mean of what rays through its point in focus meet on a plane, as the distorted image has it, or
    on a black disc before it."""
    columns, rows, depth = 96, 72, 500.0
    camera = clsco.Camera(resolution=(columns, rows), pixel_pitch=0.25, focus_distance=180.0, aperture_diameter=50.0)
    row, column = np.indices((rows, columns)).astype(np.float64)
    wall = clsco.Plane(distance=depth, texture=waves(WAVES, row, column, 0).astype(np.float32))
    black = clsco.Disc(center=(60.0, 40.0, 300.0), radius=55.0, texture="#000000")
    objects = (wall, black) if hidden else (wall,)
    given = clsco.Scene(camera=camera, objects=objects, lens=clsco.Lens(distortion=(-0.25, 0.05, 0.0)))
    found, distortion = clsco.render_frame(given, truth=()).color, Distortion.of(given.lens)
    assert distortion is not None
    step = 0.25 / camera.normalization_distance
    x, y = distortion.undistorted(step * (column - 47.5), step * (35.5 - row))
    traced = np.zeros((rows, columns))
    away, nearer = 1.0 / depth - 1.0 / 180.0, 1.0 / 300.0 - 1.0 / 180.0
    for right, up in lens_points(25.0):
        across, upwards = distortion.image(x + right * away, y + up * away)
        seen = np.hypot(300.0 * (x + right * nearer) - 60.0, 300.0 * (y + up * nearer) - 40.0) > 55.0
        traced += np.where(hidden & ~seen, 0.0, waves(WAVES, 35.5 - upwards / step, 47.5 + across / step, 1)) / 800
    error = np.abs(found - traced)[10:-10, 10:-10]
    # 54 dB, with discs of the same area 47, 2.9e-3 and 2.1e-2; with a disc in the way 53, and 47.
    assert error.mean() < 2e-3
    assert error.max() < (1.5e-2 if hidden else 6e-3)


def test_a_single_surface_has_ellipses_whatever_hides() -> None:
    for occlusion in ("visibility", "layered", "none"):
        assert prepare(scene(WALL, lens=D, psf={"occlusion": occlusion})).plan.psf.stretched > 0.0


def test_tiles_make_no_ellipses() -> None:
    with pytest.raises(clsco.SceneError, match="ellipses"):
        clsco.render_frame(scene(WALL, lens=D), method="tiles")


@pytest.mark.parametrize("psf", mostly_slow([{}, {"occlusion": "layered"}], [{}]), ids=["visibility", "layered"])
def test_strips_have_the_same_bits(psf: dict[str, Any]) -> None:
    tall = scene(BALL, WALL, lens=D, psf=psf, camera=CAMERA | {"resolution": [24, 200], "pixel_pitch": 0.1})
    assert_strips_agree(tall, ("blur_radius",))


def test_rays_of_a_lens_that_does_not_change_are_made_once() -> None:
    frames = [clsco.render_frame(SCENES["still"], truth=()) for _ in range(3)]
    assert not any("bend" in frame.metadata["seconds"] for frame in frames[1:])
    np.testing.assert_array_equal(frames[0].color, frames[2].color)


def test_without_it_nothing_of_it_is_compiled() -> None:
    thin, given = scene(BALL, WALL), scene(BALL, WALL, lens={"distortion": [0.0, 0.0, 0.0], "tangential": [0.0, 0.0]})
    assert Distortion.of(given.lens) is None
    plans = [prepare(each).plan for each in (thin, given)]
    assert plans[0].features() == plans[1].features()
    assert plans[0].features()["CURVED"] == 0


@pytest.mark.parametrize(
    ("lens", "key"),
    [({"distortion": [-1.0, 0.0, 0.0]}, "distortion"), ({"tangential": [0.4, 0.0]}, "tangential")],
    ids=str,
)
def test_an_image_that_folds_back_is_refused(lens: dict[str, Any], key: str) -> None:
    with pytest.raises(
        clsco.SceneError, match=rf"lens.{key}: frame and guard band must end where the image folds back, "
    ):
        prepare(scene(WALL, lens=lens))


def test_the_band_counts_as_the_frame_does() -> None:
    """The frame alone would do."""
    sharp, blurred = (
        scene(WALL, lens={"distortion": [-0.2, 0, 0]}, camera=CAMERA | {"aperture_diameter": d}) for d in (1.0, 90.0)
    )
    prepare(sharp)
    with pytest.raises(clsco.SceneError, match="guard band must end"):
        prepare(blurred)
