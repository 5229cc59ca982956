"""Distortion against OpenCV, differences and closed forms."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

import clsco
from clsco.optics.distortion import Distortion, distortion_of, with_distortion
from clsco.optics.rays import places_of, ray_changes, ray_slopes

RNG = np.random.default_rng
KEYS: list[dict[str, tuple[float, ...]]] = [
    {"distortion": (-0.3, 0.0, 0.0)},
    {"distortion": (-0.25, 0.08, -0.01), "tangential": (0.004, -0.003)},
    {"distortion": (0.4, 0.1, 0.02), "tangential": (-0.02, 0.01)},
    {"tangential": (0.03, 0.05)},
]
SIZE = (640, 480)


def camera_of(keys: dict[str, tuple[float, ...]], pitch: float = 0.03) -> clsco.Camera:
    return with_distortion(clsco.Camera(resolution=SIZE, pixel_pitch=pitch), clsco.Lens(**keys))  # type: ignore[arg-type]


@pytest.mark.parametrize("keys", KEYS, ids=str)
def test_places_are_those_of_opencv(keys: dict[str, tuple[float, ...]]) -> None:
    camera = camera_of(keys)
    row, column = RNG(1).uniform([[0.0], [0.0]], [[479.0], [639.0]], (2, 1000))
    x, y = ray_slopes(camera, row, column)
    (k1, k2, k3), (p1, p2) = keys.get("distortion", (0.0, 0.0, 0.0)), keys.get("tangential", (0.0, 0.0))
    matrix = np.array([[20 / 0.03, 0.0, 319.5], [0.0, 20 / 0.03, 239.5], [0.0, 0.0, 1.0]])
    points = 300.0 * np.stack([x, -y, np.ones_like(x)], axis=-1)
    seen, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix, np.array([k1, k2, p1, p2, k3]))
    np.testing.assert_allclose(seen[:, 0, 0], column, atol=1e-9)
    np.testing.assert_allclose(seen[:, 0, 1], row, atol=1e-9)
    right, up = places_of(camera, x, y)
    np.testing.assert_allclose(right, column - 319.5, atol=1e-9)
    np.testing.assert_allclose(up, 239.5 - row, atol=1e-9)


@pytest.mark.parametrize("keys", KEYS, ids=str)
def test_jacobian_and_slope_of_the_stretch(keys: dict[str, tuple[float, ...]]) -> None:
    found = Distortion.of(clsco.Lens(**keys))  # type: ignore[arg-type]
    assert found is not None
    (x, y), h = RNG(2).uniform(-0.5, 0.5, (2, 200)), 1e-6
    right = (np.array(found.image(x + h, y)) - found.image(x - h, y)) / (2 * h)
    up = (np.array(found.image(x, y + h)) - found.image(x, y - h)) / (2 * h)
    xx, xy, yy = found.jacobian(x, y)
    np.testing.assert_allclose([xx, xy, xy, yy], [*right, *up], atol=1e-8)
    sizes = [[found.stretch(x + h * i, y + h * j) for i, j in pair] for pair in (((1, 0), (-1, 0)), ((0, 1), (0, -1)))]
    wanted = [np.log(one / other) / (2 * h) for one, other in sizes]
    np.testing.assert_allclose(found.stretch_slope(x, y), wanted, atol=1e-7)
    camera = camera_of(keys)
    along, aside, upwards = ray_changes(camera, x, y)
    step = 0.03 / 20
    np.testing.assert_allclose(xx * along + xy * aside, step, atol=1e-12)
    np.testing.assert_allclose(xy * along + yy * aside, 0.0, atol=1e-12)
    np.testing.assert_allclose(xy * aside + yy * upwards, step, atol=1e-12)


@pytest.mark.parametrize("keys", KEYS, ids=str)
def test_inverse_up_to_the_reach(keys: dict[str, tuple[float, ...]]) -> None:
    found = Distortion.of(clsco.Lens(**keys))  # type: ignore[arg-type]
    assert found is not None
    radius, angle = np.linspace(0.0, min(0.9999 * found.image_reach, 2.0), 400), RNG(3).uniform(0, 7, 400)
    x, y = radius * np.cos(angle), radius * np.sin(angle)
    there = found.undistorted(x, y)
    np.testing.assert_allclose(found.image(*there), [x, y], atol=1e-12)
    assert (np.hypot(*there) <= found.reach).all()
    step = RNG(4).normal(0.0, 1e-7, (2, 400))  # on one side of an order-free start the other is not found
    np.testing.assert_allclose(found.undistorted(x + step[0], y + step[1])[0], there[0], atol=1e-5)
    assert found.steps_to(0.5 * min(found.image_reach, 2.0)) <= 9


def test_reach_and_what_lies_beyond() -> None:
    barrel = Distortion((-0.3, 0.0, 0.0))
    assert barrel.reach == pytest.approx(np.sqrt(0.95 / 0.9))
    assert Distortion((0.3, 0.1, 0.0)).reach == np.inf
    radius = np.linspace(0.0, 30.0, 3001)
    seen, _ = barrel.image(radius, 0.0)
    assert (np.diff(seen) > 0.0).all()  # nothing folds back
    tilted = Distortion((-0.3, 0.05, 0.0), (0.02, -0.03))
    x, y = tilted.reach * np.cos(np.linspace(0, 7, 99)), tilted.reach * np.sin(np.linspace(0, 7, 99))
    xx, xy, yy = tilted.jacobian(x, y)
    least = 0.5 * (xx + yy) - np.sqrt(0.25 * (xx - yy) ** 2 + xy**2)
    assert least.min() > 0.05 - 1e-12
    assert np.hypot(*tilted.image(x, y)).min() >= tilted.image_reach


def test_terms_that_are_next_to_nothing_have_no_root() -> None:
    """The last one divides the others."""
    assert Distortion((-0.2, 0.0, 1e-320)).reach == Distortion((-0.2, 0.0, 0.0)).reach


def test_a_lens_without_it_has_none() -> None:
    camera = clsco.Camera(resolution=SIZE)
    assert with_distortion(camera, clsco.Lens(lateral=(1.01, 1.0, 1.0))) is camera
    assert distortion_of(camera) is None
    faster = camera_of(KEYS[0]).model_copy(update={"f_number": 2.0})
    assert distortion_of(faster) == Distortion((-0.3, 0.0, 0.0), (-0.0, 0.0))
