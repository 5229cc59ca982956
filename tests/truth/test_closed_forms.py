"""Frames by rays against closed forms."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import clsco
from benchmarks.truth.traced import decibels, rms, trace_frame, traced
from clsco.truth.pixels import labels_at
from clsco.truth.poses import rotation_matrix
from clsco.truth.problem import make_problem
from tests.slow import mostly_slow

PITCH, S0, APERTURE = 0.01, 20.0, 10.0
FOCUS_TERM = 1 / 20.0 - 1 / 21.739
KAPPA = S0 * APERTURE / (2 * PITCH)  # px mm: R = KAPPA (K - 1/Z)
Array = NDArray[Any]


def plane(distance: float, texture: Any = "#ffffff", slope_x: float = 0.0, slope_y: float = 0.0, **keys: Any) -> Any:
    return {"shape": "plane", "distance": distance, "slope_x": slope_x, "slope_y": slope_y, "texture": texture} | keys


def turning(**motion: Any) -> dict[str, Any]:
    return {"motion": motion}


def scene(*objects: Any, size: tuple[int, int] = (64, 64), shutter: float = 1.0, **tables: Any) -> clsco.Scene:
    """A scene with the camera of the thesis; size: rows and columns."""
    camera: dict[str, Any] = {"focal_length": 20.0, "aperture_diameter": APERTURE, "sensor_distance": 21.739}
    camera |= {"pixel_pitch": PITCH, "normalization_distance": S0, "resolution": [size[1], size[0]]}
    painted = [{"texture": "#ffffff"} | item for item in objects]
    sequence = {"frames": 2, "shutter": shutter}
    return clsco.parse_scene({"camera": camera, "sequence": sequence, "object": painted, **tables})


def by_rays(given: clsco.Scene, rays: int, frame: int = 0) -> tuple[Array, float]:
    """Image of a frame by so many rays, and its noise."""
    image, error = trace_frame(make_problem(given, frame), 0.0, rays)
    return image, rms(error)


def depth_of(given: clsco.Scene, frame: int = 0) -> Array:
    return labels_at(make_problem(given, frame), 0)[0]


def distance_at(radius_px: float) -> float:
    """Distance (mm) at which the signed blur radius is `radius_px`."""
    return 1 / (FOCUS_TERM - radius_px / KAPPA)


def noise(rows: int, columns: int, *channels: int) -> Array:
    return np.random.default_rng(7).random((rows, columns, *channels)).astype(np.float32)


def moments(image: Array) -> tuple[float, Array, float]:
    """Energy, centroid (row, column) and mean square distance from it, px."""
    energy = float(image.sum())
    grid = np.indices(image.shape)
    center = (grid * image).sum(axis=(1, 2)) / energy
    spread = float((((grid - center[:, None, None]) ** 2).sum(0) * image).sum() / energy)
    return energy, center, spread


def test_a_plane_in_focus_reproduces_its_texture() -> None:
    texture = noise(20, 31, 3)
    image, error = by_rays(scene(plane(1 / FOCUS_TERM, texture), size=(20, 31)), 32)
    # All rays of a pixel end in its texel: sums of equal numbers round by 1e-15 at most.
    np.testing.assert_allclose(image, texture, rtol=0, atol=1e-14)
    assert error < 1e-14


def test_a_uniform_plane_gives_a_uniform_image_up_to_the_border() -> None:
    image, _ = by_rays(scene(plane(240.0, np.full((24, 24), 0.375), 0.7, -0.4), size=(24, 24)), 32)
    np.testing.assert_allclose(image, 0.375, rtol=0, atol=1e-14)  # as above


@pytest.mark.parametrize("radius", mostly_slow([6.0, -4.5], [-4.5]))
def test_a_bright_texel_becomes_a_disc(radius: float) -> None:
    texture = np.zeros((31, 33))
    texture[12, 18] = 1.0
    image, error = by_rays(scene(plane(distance_at(radius), texture), size=(31, 33)), 16384)
    energy, center, spread = moments(image)
    # The mean square error of the frame is `error`^2, that of the sum of its independent pixels 31 x 33
    # times as much: `sigma`^2. Light lies at most |R| + 1 from the center: a factor to errors of the moments.
    sigma, reach = math.sqrt(31 * 33) * error, abs(radius) + 1
    assert 0 < sigma < 0.01
    assert energy == pytest.approx(1.0, abs=5 * sigma)
    np.testing.assert_allclose(center, [12, 18], rtol=0, atol=5 * sigma * reach)
    # A disc's mean square radius is R^2 / 2; the boxes of source and detector pixel add 1/12 each per axis.
    assert spread == pytest.approx(radius**2 / 2 + 1 / 3, abs=5 * sigma * reach**2)
    # Far inside, every detector pixel sees the whole texel through a share 1 / (pi R^2) of the lens. The
    # error is in the pi R^2 lit pixels, 9 of which are averaged.
    deviation = sigma / math.sqrt(9 * math.pi * radius**2)
    assert image[11:14, 17:20].mean() == pytest.approx(1 / (math.pi * radius**2), abs=5 * deviation)
    rows, columns = np.indices(image.shape)
    assert not image[np.hypot(rows - 12, columns - 18) > abs(radius) + math.sqrt(2)].any()


@pytest.mark.parametrize("radius", mostly_slow([6.0, -6.0], [6.0]))
def test_a_tilted_plane_displaces_the_light_towards_larger_blur(radius: float) -> None:
    texture = np.zeros((35, 35))
    texture[17, 17] = 1.0
    slopes = 12.0, -8.0
    image, error = by_rays(scene(plane(distance_at(radius), texture, *slopes), size=(35, 35)), 16384)
    energy, center, _ = moments(image)
    # R is linear in the image, so x' = x + R(x) l has the Jacobian 1 + l . grad R exactly. Over the unit disc
    # the mean of l (l . grad R) is grad R / 4: the centroid moves by R grad R / 4. Rows count downwards.
    gradient = KAPPA * PITCH / S0 / distance_at(radius) * np.array([-slopes[1], slopes[0]])
    shift = radius * gradient / 4
    # As above; the light reaches |R| / (1 - |grad R|) < 9 px, and per axis 4 px at most in the mean square.
    sigma = 35 * error
    assert 0 < 5 * sigma * 4 < 0.5 * abs(shift).min()
    np.testing.assert_allclose(center - 17, shift, rtol=0, atol=5 * sigma * 4)
    assert energy == pytest.approx(1.0, abs=5 * sigma)


def test_a_moving_plane_is_blurred_by_a_box() -> None:
    length_px, distance = 5, 1 / FOCUS_TERM
    texture = np.zeros((7, 21))
    texture[3, 6] = 1.0
    speed = length_px * PITCH * distance / S0
    moved = plane(distance, texture) | turning(velocity=[speed, 0.0, 0.0])
    image, error = by_rays(scene(moved, size=(7, 21)), 4096)
    expected = np.zeros((7, 21))
    # The texel crosses a pixel box: half a step to enter and to leave, whole steps between.
    expected[3, 6:12] = np.array([0.5, 1, 1, 1, 1, 0.5]) / length_px
    assert 0 < error < 1e-3
    np.testing.assert_allclose(image, expected, rtol=0, atol=5 * 12 * error)  # 12 of 147 pixels hold the error


def test_beyond_the_frame_the_texture_is_mirrored() -> None:
    texture, distance = noise(9, 12), 1 / FOCUS_TERM
    step = PITCH * distance / S0
    moved = plane(distance, texture) | turning(velocity=[15 * step, -4 * step, 0.0])
    image, _ = by_rays(scene(moved, size=(9, 12), shutter=1e-9), 16, frame=1)
    expected = np.pad(texture, 15, mode="symmetric")[11:20, 0:12]  # 15 px to the right, 4 px down
    # The position rounds by 1e-13 px: a ray that close to a texel's edge does not occur.
    np.testing.assert_allclose(image, expected, rtol=0, atol=1e-14)


@pytest.mark.parametrize("rotation", ["euler", "axis"])
def test_a_positive_turn_about_z_is_clockwise(rotation: str) -> None:
    texture = noise(16, 16)
    turned = plane(1 / FOCUS_TERM, texture) | turning(angular_velocity=[0.0, 0.0, 90.0])
    given = scene(turned, size=(16, 16), shutter=1e-9, motion={"rotation": rotation})
    image, _ = by_rays(given, 16, frame=1)
    np.testing.assert_allclose(image, np.rot90(texture, -1), rtol=0, atol=1e-14)  # as above


def test_the_matrix_of_the_thesis_is_three_turns() -> None:
    angles = np.random.default_rng(3).uniform(-4, 4, (50, 3))
    turns = [Rotation.from_rotvec(-angle[:, None] * axis) for angle, axis in zip(angles.T, np.eye(3), strict=True)]
    flip = np.diag([1.0, 1.0, -1.0])
    expected = flip @ (turns[2] * turns[1] * turns[0]).as_matrix() @ flip
    # Products of three sines and cosines round by a few 1e-16.
    np.testing.assert_allclose(rotation_matrix(angles, False), expected, rtol=0, atol=2e-15)
    for axis in range(3):
        single = angles * np.eye(3)[axis]
        np.testing.assert_allclose(rotation_matrix(single, True), rotation_matrix(single, False), rtol=0, atol=2e-15)


CONE = {"shape": "cone", "apex": [1.0, 2.0, 250.0], "half_angle": 40.0}
SADDLE = [0.01, -0.02, 0.0, 0.003, 0.0, 0.002, 0.1, 0.0, 1.0, 2.0]
SOLIDS: dict[str, Any] = {
    "sphere": {"shape": "sphere", "center": [3.0, -5.0, 280.0], "radius": 30.0},
    "ellipsoid": {"shape": "ellipsoid", "center": [0.0, 1.0, 280.0], "semi_axes": [40.0, 25.0, 30.0]},
    "cylinder": {"shape": "cylinder", "center": [0.0, 0.0, 280.0], "radius": 30.0, "axis": [1.0, 2.0, 0.5]},
    "cone": CONE,
    "saddle": {"shape": "quadric", "center": [0.0, 0.0, 300.0], "coefficients": SADDLE},
    "plane": plane(250.0, slope_x=0.4, slope_y=-0.3),
    "rectangle": {"shape": "rectangle", "center": [0.0, 0.0, 250.0], "size": [60.0, 60.0], "offset": -3.0},
    "disc": {"shape": "disc", "center": [0.0, 0.0, 250.0], "offset": -3.0, "radius": 24.0},
}


def _implicit(item: Any, x: Any, y: Any, z: Any) -> Any:
    """The surface's equation as a text states it, in mm or without unit; 0 on the surface."""
    match item.shape:
        case "plane":
            return item.distance + item.slope_x * x + item.slope_y * y - z
        case "rectangle" | "disc":
            return item.center[2] + item.offset - z
        case "cone":
            x, y, z = x - item.apex[0], y - item.apex[1], z - item.apex[2]
            return math.tan(math.radians(item.half_angle)) * z - np.hypot(x, y)
    q = np.stack([x - item.center[0], y - item.center[1], z - item.center[2]])
    match item.shape:
        case "sphere":
            return np.sqrt((q**2).sum(0)) - item.radius
        case "ellipsoid":
            return sum((q[i] / item.semi_axes[i]) ** 2 for i in range(3)) - 1
        case "cylinder":
            axis = np.array(item.axis) / np.linalg.norm(item.axis)
            return np.linalg.norm(np.cross(q, axis, axisa=0), axis=-1) - item.radius
    u, v, w = q
    terms = (u * u, v * v, w * w, u * v, v * w, u * w, u, v, w, np.ones_like(u))
    return sum(k * term for k, term in zip(item.coefficients, terms, strict=True))


@pytest.mark.parametrize("name", SOLIDS)
def test_hits_lie_on_the_surface(name: str) -> None:
    size = 256
    given = scene(SOLIDS[name], size=(size, size)).replace("camera.pixel_pitch", 2 * PITCH)
    item, depth = given.objects[0], depth_of(given)
    offset = (np.arange(size) - (size - 1) / 2) * 2 * PITCH / S0
    seen = np.isfinite(depth)
    rows, columns = np.nonzero(seen)
    z = depth[seen]
    x, y = offset[columns] * z, -offset[rows] * z
    assert seen.sum() > 12_500
    # Depths near 300 round by 1e-13; at the limb the root of a discriminant that rounds by 1e-16 of b^2 gives
    # 1e-8 of the depth, along a ray that touches the surface: second order in its distance again.
    assert abs(_implicit(item, x, y, z)).max() < 1e-9
    if isinstance(item, clsco.Disc):
        assert 23.7 < np.hypot(x, y).max() <= item.radius
    if isinstance(item, clsco.Sphere | clsco.Ellipsoid):
        assert z.max() < item.center[2]  # the near side, before the center


def test_nappes_and_bounds_choose_the_root() -> None:
    away = depth_of(scene(CONE | {"nappe": "away"}))
    towards = depth_of(scene(CONE | {"nappe": "towards"}))
    assert away.min() >= 250
    assert towards.max() <= 250
    half = {"bounds": [[-99.0, 99.0], [-99.0, 99.0], [0.0, 99.0]]}
    depth = depth_of(scene(SOLIDS["sphere"] | half | {"center": [0.0, 0.0, 280.0]}, size=(65, 65)))
    # On the axis 280 + 30, exact but for the rounding of the root.
    assert depth[32, 32] == pytest.approx(310.0, abs=1e-10)


def test_the_nearest_of_several_objects_wins_whatever_their_order() -> None:
    card = plane(240.0, bounds=[[-1.0, 1.0], [-1.0, 1.0], [-1.0, 1.0]])
    wall = plane(250.0, np.full((32, 32), 0.25))
    first, _ = by_rays(scene(card, wall, size=(32, 32)), 256)
    second, _ = by_rays(scene(wall, card, size=(32, 32)), 256)
    np.testing.assert_array_equal(first, second)
    # 2 mm at 240 mm are 16.7 px, blurred by 1.7 px: the middle is the card alone, the corner the wall alone.
    assert first[16, 16] == 1.0
    assert first[0, 0] == 0.25
    assert len(np.unique(first)) > 10


def test_a_cache_has_the_frame_as_it_was_traced(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ball = scene({"shape": "sphere", "center": [0.0, 0.0, 280.0], "radius": 3.0})
    image, error = traced(ball, 4e-3, tmp_path)
    assert 0 < rms(error) < 4e-3
    assert "RMS" in capsys.readouterr().out
    for one, other in zip(traced(ball, 4e-3, tmp_path), (image, error), strict=True):
        np.testing.assert_array_equal(one, other)
    assert capsys.readouterr().out == ""
    traced(ball.replace("object[0].radius", 3.1), 4e-3, tmp_path)
    assert len(list(tmp_path.iterdir())) == 2
    assert math.isinf(decibels(rms(image - image)))


def test_depth_maps_are_refused() -> None:
    card = {"shape": "depth_map", "texture": np.ones((4, 4)), "depth": np.full((4, 4), 250.0)}
    with pytest.raises(ValueError, match=r"shape must be analytic; got 'depth_map'"):
        make_problem(scene(card, size=(4, 4)))


EGG = {"shape": "ellipsoid", "center": [9.0, 4.0, 280.0], "semi_axes": [40.0, 15.0, 25.0]}


@pytest.mark.parametrize(
    "rotation",
    [[35.0, -50.0, 110.0], {"axis": [1.0, 2.0, -0.5], "angle": 140.0}, {"quaternion": [0.9, 0.4, 0.1, 0.3]}],
    ids=["euler", "axis", "quaternion"],
)
def test_a_rotated_object_is_one_that_has_turned_so_far(rotation: Any) -> None:
    """But for its texture, which a static rotation does not take along."""
    box = {"bounds": [[-30.0, 30.0], [-20.0, 4.0], [-30.0, 14.0]]}
    if isinstance(rotation, list):
        turn = np.array(rotation)
    elif "axis" in rotation:
        turn = rotation["angle"] * np.array(rotation["axis"]) / np.linalg.norm(rotation["axis"])
    else:
        w, *axis = np.array(rotation["quaternion"]) / np.linalg.norm(rotation["quaternion"])
        turn = np.degrees(2 * math.acos(w)) * np.array(axis) / np.linalg.norm(axis)
    kind = "euler" if isinstance(rotation, list) else "axis"
    static = scene(EGG | box | {"rotation": rotation}, size=(96, 96))
    moved = EGG | box | turning(angular_velocity=turn.tolist())
    turned = scene(moved, size=(96, 96), shutter=1e-9, motion={"rotation": kind})
    depth, expected = depth_of(static), depth_of(turned, 1)
    seen = np.isfinite(expected)
    assert seen.sum() > 1000
    assert (np.isfinite(depth) != seen).sum() <= 1
    both = seen & np.isfinite(depth)
    np.testing.assert_allclose(depth[both], expected[both], rtol=1e-7)


def test_the_texture_of_a_rotated_object_is_its_image() -> None:
    """In focus and static, each pixel shows its texel, whatever the rotation."""
    texture = noise(20, 24)
    image, _ = by_rays(scene(plane(1 / FOCUS_TERM, texture, rotation=[0.0, 0.0, 70.0]), size=(20, 24)), 16)
    np.testing.assert_allclose(image, texture, rtol=0, atol=1e-14)


def test_a_group_carries_what_moves_in_it() -> None:
    """A ball on an arm of 20 mm: turned by 90 deg about y it is nearer by 20 mm, and has gone 20 mm to the left."""
    ball = {"shape": "sphere", "center": [20.0, 0.0, 280.0], "radius": 5.0, "group": "arm"}
    motion = {"velocity": [1.0, 0.0, 0.0], "angular_velocity": [0.0, 90.0, 0.0]}
    arm = {"name": "arm", "origin": [0.0, 0.0, 280.0], "motion": motion}
    depth = depth_of(scene(ball, group=[arm], shutter=1e-9), 1)
    still = {"shape": "sphere", "center": [1.0, 0.0, 260.0], "radius": 5.0}
    np.testing.assert_allclose(depth, depth_of(scene(still)), rtol=1e-7)


@pytest.mark.parametrize("turn", [(0.0, 0.0, 0.0), (0.0, 0.0, 90.0)])
def test_a_light_gives_the_cosine(turn: Any) -> None:
    """On a plane in focus of half the radiance, from a near light and from a far one."""
    z, place = distance_at(0.0), (3.0, -2.0, 240.0)
    wall = plane(z, np.full((7, 9), 0.5)) | turning(angular_velocity=turn)

    def lit(**light: Any) -> Array:
        return by_rays(scene(wall, size=(7, 9), shutter=1e-9, light=light | {"ambient": 0.2}), 256)[0]

    x, y = (np.arange(9) - 4) * PITCH / S0 * z, (3 - np.arange(7)) * PITCH / S0 * z
    apart = np.stack(np.broadcast_arrays(place[0] - x, place[1] - y[:, None], place[2] - z), axis=-1)
    cosines = -apart[..., 2] / np.linalg.norm(apart, axis=-1)
    np.testing.assert_allclose(lit(position=place), 0.1 + 0.4 * cosines, atol=1e-4)
    for towards, cosine in ((2.0, 1.0 / math.sqrt(3.0)), (-2.0, 0.0)):
        image = lit(direction=(2.0, -2.0, towards))
        np.testing.assert_allclose(image, 0.1 + 0.4 * cosine, atol=1e-12)
