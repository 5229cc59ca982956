"""Predictions of a plan before a scene is rendered: ranges of the blur radius, ways over the image, work."""

from __future__ import annotations

from math import cos, sin
from typing import Any

import numpy as np
import pytest

from clsco.errors import SceneError
from clsco.optics.lens import Lens as LensOptics
from clsco.optics.lens import blur_radius
from clsco.optics.motion import poses_at
from clsco.optics.rays import slopes_at
from clsco.optics.resolved_view import _moved_map, guard_band
from clsco.scene.model import DepthMap, Lens, ObjectMotion, Plane, Psf, Scene, Sequence, Sphere
from tests.scenes import plan_of, plan_scene, scene_of

STEP = 0.01 / 20.0  # slope between the rays of neighbors: pixel pitch over normalization distance
SIDES = [("slope_x", 1), ("slope_x", -1), ("slope_y", 1), ("slope_y", -1)]


def radius(given: Scene, depth: float) -> float:
    return abs(float(blur_radius(given.camera, 1.0 / depth)))


# Blur


@pytest.mark.parametrize(("axis", "side"), SIDES)
def test_radii_are_predicted_out_to_the_surface_that_lights_the_frame_from_outside(axis: str, side: int) -> None:
    """A plane that is sharp on one side; on the other, R px beyond the edge with its R, radii are larger still."""
    slope = 2.5
    distance = 250.0 * (1.0 - slope * 31.5 * STEP)
    blurred = scene_of(
        Plane.model_validate({"distance": distance, axis: side * slope}),
        size=(64, 64),
        camera={"aperture_diameter": 90.0},
    )

    def at(px: float) -> float:
        return radius(blurred, distance / (1.0 + slope * px * STEP))

    assert at(-31.5) < 0.1
    edge = at(31.5)
    outside = at(31.5 + edge)
    assert outside > 1.3 * edge + 1.0
    assert plan_scene(blurred, 1).largest_blur >= outside


def test_a_guard_band_holds_what_it_shows_where_the_field_is_curved() -> None:
    """|R| grows toward the corners: a wider band meets a wider blur, which asks for a wider one, up to 36 px here."""
    curved = Lens(field_curvature=-1 / 30, focus_surface="sphere")
    camera = {"pixel_pitch": 0.4, "aperture_diameter": 60.0, "focal_length": 20.0, "focus_distance": 180.0}
    given = plan_of(Plane(distance=180.0), lens=curved, size=(40, 32), camera=camera)
    optics = LensOptics.of(given.scene.camera, given.scene.lens)
    right, down = (0.5 * (n - 1) + given.guard_px for n in (40, 32))
    x, y = (np.array(each) for each in slopes_at(given.scene.camera, np.array([right]), np.array([down])))
    met = float(np.abs(optics.image_radius(np.array([1.0 / 180.0]), x, y))[0])
    assert 30.0 < met <= given.largest_blur
    assert guard_band(given.psf, "lose", met) <= given.guard_px


def test_radii_are_predicted_to_the_end_of_the_last_exposure() -> None:
    leaving = Plane(distance=280.0, motion=ObjectMotion(velocity=(0.0, 0.0, 20.0)))
    given = plan_of(leaving, sequence=Sequence(frames=3, interval=0.5, shutter=0.25))
    end = 280.0 + 20.0 * (2 * 0.5 + 0.25)
    assert given.smallest_blur == pytest.approx(radius(given.scene, 280.0), rel=1e-12)
    assert given.largest_blur == pytest.approx(radius(given.scene, end), rel=1e-12)


def test_nothing_in_sight_is_not_blurred_and_takes_no_work() -> None:
    aside = ((900.0, 910.0), (-1.0, 1.0), (-1.0, 1.0))
    card = plan_of(Plane(distance=280.0, bounds=aside))
    assert (card.smallest_blur, card.largest_blur, card.taps) == (0.0, 0.0, 0.0)
    tilted = plan_of(Plane(distance=280.0, slope_x=0.1, bounds=aside))
    assert tilted.smallest_blur == 0.0
    assert tilted.largest_blur <= 1.0
    assert tilted.taps == 0.0


def test_a_refused_blur_tells_of_the_nearest_point() -> None:
    card = Plane(distance=0.5, bounds=((-0.004, 0.004), (-1.0, 1.0), (-1.0, 1.0)))
    for items in ((card,), (card, Plane(distance=900.0))):
        with pytest.raises(SceneError, match=r"the surface comes as near as 0\.5 mm;"):
            plan_of(*items)


# Depth maps


@pytest.mark.parametrize("turn", [(30.0, 0.0, 0.0), (0.0, 30.0, 0.0)], ids=["about x", "about y"])
def test_every_point_of_a_small_map_is_moved_as_it_is_in_the_scene(turn: tuple[float, float, float]) -> None:
    """Z of each point after it turned about the center and moved by 13 mm; a pixel without surface stays without."""
    z = np.random.default_rng(1).uniform(200.0, 400.0, (24, 32))
    z[0, :2] = 450.0, 150.0  # the farthest and the nearest
    motion = ObjectMotion(velocity=(5.0, -7.0, 13.0), angular_velocity=turn)
    item = DepthMap(depth="map.npy", center=(3.0, -2.0, 290.0), motion=motion)
    row, column = np.indices(z.shape)
    x, y = (column - 15.5) * STEP * z - 3.0, (11.5 - row) * STEP * z + 2.0
    # 2.14 to 2.23, with the z axis towards the camera
    about_x, about_y = np.radians(turn[:2]).tolist()
    moved = 290.0 + 13.0 + sin(about_x) * y - sin(about_y) * x + cos(about_x + about_y) * (z - 290.0)
    inverse_depth = 1.0 / z
    inverse_depth[5, 7] = 0.0
    wanted = 1.0 / moved
    wanted[5, 7] = 0.0
    given = scene_of(item)
    found = _moved_map(given, item, inverse_depth, poses_at(given, 1.0)[0])
    apart = np.abs(found.reshape(-1, 1) - wanted.reshape(1, -1))
    assert apart.min(axis=0).max() < 1e-12
    assert apart.min(axis=1).max() < 1e-12


@pytest.mark.parametrize(("depth", "expected"), [(0.5, 2.0), (0.0, 0.0), (-0.5, 0.0)])
def test_a_map_is_seen_up_to_the_lens_and_no_farther(depth: float, expected: float) -> None:
    item = DepthMap(depth="map.npy", motion=ObjectMotion(velocity=(0.0, 0.0, depth - 256.0)))
    given = scene_of(item)
    found = _moved_map(given, item, np.full((48, 64), 1.0 / 256.0), poses_at(given, 1.0)[0])
    assert np.unique(found).tolist() == [expected]


# Silhouettes and work


BOX = ((-60.0, 60.0), (-60.0, 60.0), (-60.0, 60.0))


@pytest.mark.parametrize(
    "items",
    [
        (Plane(distance=280.0, slope_x=0.1, bounds=BOX),),
        (Plane(distance=280.0), Plane(distance=300.0)),
        (Sphere(motion=ObjectMotion(velocity=(40.0, 0.0, 0.0))),),
    ],
    ids=["cut by bounds", "two surfaces", "a ball that leaves"],
)
def test_silhouettes_may_be_in_sight_of_what_fills_the_view_at_rest(items: tuple[Any, ...]) -> None:
    assert plan_of(*items).silhouettes == 4


def test_room_for_the_pixels_along_the_limb_of_a_ball_that_fills_the_frame() -> None:
    """Pixels within 2 px of the limb, on both sides, need room."""
    given = plan_of(Sphere(), size=(480, 480))
    assert isinstance(given.slots, int)
    assert given.slots >= 4 * 3.15 * given.grid.height


def test_work_is_counted_where_something_is_seen() -> None:
    """Half of a plane takes half of the weights, as does the other half, and both together all of them."""
    whole, left, right = (
        Plane(distance=280.0, bounds=((low, high), (-60.0, 60.0), (-1.0, 1.0)))
        for low, high in ((-60.0, 60.0), (-60.0, 0.0), (0.0, 60.0))
    )
    all_of_it = plan_of(whole).taps
    assert plan_of(left).taps == pytest.approx(0.5 * all_of_it, rel=0.05)
    assert plan_of(right).taps == pytest.approx(0.5 * all_of_it, rel=0.05)
    assert plan_of(left, right).taps == pytest.approx(all_of_it, rel=0.05)


def test_what_is_in_focus_takes_no_work() -> None:
    given = plan_of(Plane(distance=250.0), psf=Psf(edge="sampled"))
    assert (given.blur, given.taps) == ("none", 0.0)
