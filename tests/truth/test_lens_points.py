"""Points of the lens, its wavefront and its distortion, against closed forms."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import clsco
from clsco.truth.kernel import distorted, undistorted
from clsco.truth.pupils import _rim, bend, lens_point, pupil_of, wavefront_of

HALF = np.zeros((64, 64), np.float32)
HALF[:, 32:] = 1.0


def scene(**tables: Any) -> clsco.Scene:
    camera = {"resolution": [64, 48]}
    return clsco.parse_scene({"camera": camera, "object": [{"shape": "plane", "texture": "#ffffff"}], **tables})


def points(given: clsco.Scene) -> tuple[np.ndarray, np.ndarray]:
    """Points (n, 2) of the lens, and their weights."""
    pupil = pupil_of(given)
    even = (np.arange(4096)[:, None] * [0.7548776662466927, 0.5698402909980532]) % 1.0  # Roberts' sequence R2
    found = [lens_point(u, v, *pupil[:3]) for u, v in even]
    return np.array(found)[:, :2], np.array(found)[:, 2]


PENTAGON = (2 + math.cos(2 * math.pi / 5)) / 12


@pytest.mark.parametrize(
    ("aperture", "light", "moments"),
    [
        ({}, 1.0, (0.25, 0.25)),
        ({"squeeze": 2.0}, 0.5, (0.0625, 0.25)),
        ({"shape": "ring", "obstruction": 0.5}, 0.75, (0.3125, 0.3125)),
        ({"shape": "polygon", "blades": 5, "rotation": 17.0}, 0.75683, (PENTAGON, PENTAGON)),
        ({"shape": "polygon", "blades": 5, "blade_curvature": 1.0}, 1.0, (0.25, 0.25)),
        ({"shape": "image", "image": HALF}, 0.5, (0.25, 0.25)),
        ({"shape": "image", "image": HALF, "rotation": 90.0}, 0.5, (0.25, 0.25)),
    ],
)
def test_light_and_second_moments_of_openings(aperture: Any, light: float, moments: tuple[float, float]) -> None:
    given = scene(aperture=aperture)
    at, weight = points(given)
    assert weight.mean() == pytest.approx(1.0, abs=1e-3)
    assert pupil_of(given).light == pytest.approx(light, abs=2e-3)
    np.testing.assert_allclose((at**2 * weight[:, None]).mean(axis=0), moments, atol=2e-3)
    if "image" in aperture:  # the half that is open is on the right, and turned by a right angle above
        assert (at[:, 1 if "rotation" in aperture else 0] > -0.05).all()


def test_concave_blades_have_their_rise_and_corners_on_the_circle() -> None:
    numbers = pupil_of(scene(aperture={"shape": "polygon", "blades": 6, "blade_curvature": -0.5})).numbers
    middle = math.cos(math.pi / 6)
    assert _rim(0.0, numbers) == pytest.approx(middle - 0.5 * (1 - middle), rel=1e-12)
    assert _rim(math.pi / 6, numbers) == pytest.approx(1.0, rel=1e-12)


def test_a_gaussian_is_one() -> None:
    at, _ = points(scene(psf={"model": "gaussian", "sigma_ratio": 0.5, "truncation": 3.0}))
    left = math.exp(-4.5)  # of r^2 / 2: its mean up to the cut
    assert (at**2).mean() == pytest.approx(0.25 * (1 - 4.5 * left / (1 - left)), rel=5e-3)


@pytest.mark.parametrize(
    ("psf", "wavefront"),
    [
        ({"zernike": {"3,1": 2.0}}, lambda x, y: 2 * math.sqrt(8) * (3 * (x * x + y * y) - 2) * x),
        ({"zernike": {"2,-2": 1.5}}, lambda x, y: 1.5 * math.sqrt(6) * 2 * x * y),
        ({"zernike": {"4,0": 1.0}}, lambda x, y: math.sqrt(5) * (6 * (x * x + y * y) ** 2 - 6 * (x * x + y * y) + 1)),
        ({"seidel": {"W040": 3.0}}, lambda x, y: 3 * (x * x + y * y) ** 2),
        ({"seidel": {"W131": 2.0}}, lambda x, y: 2 * (0.6 * x - 0.3 * y) * (x * x + y * y)),
        ({"seidel": {"W222": 2.0, "W220": 1.0}}, lambda x, y: 2 * (0.6 * x - 0.3 * y) ** 2 + 0.45 * (x * x + y * y)),
    ],
)
def test_rays_lean_by_the_gradient_of_the_wavefront(psf: Any, wavefront: Any) -> None:
    found, step = wavefront_of(scene(psf=psf)), 1e-5
    for x, y in ((0.3, -0.5), (-0.7, 0.1)):
        right = (wavefront(x + step, y) - wavefront(x - step, y)) / (2 * step)
        above = (wavefront(x, y + step) - wavefront(x, y - step)) / (2 * step)
        got = np.array(bend(x, y, 0.6, -0.3, *found))
        np.testing.assert_allclose(got, 540e-6 * np.array([right, above]), rtol=1e-6, atol=1e-11)


def test_distortion_and_its_inverse() -> None:
    numbers = np.zeros(19)
    numbers[6:11] = -0.25, 0.06, -0.006, 0.001, -0.0015
    x, y = 0.4, -0.3
    seen = distorted(x, y, numbers)
    square, (k1, k2, k3, p1, p2) = x * x + y * y, numbers[6:11]
    q = 1 + k1 * square + k2 * square**2 + k3 * square**3
    assert seen[0] == pytest.approx(x * q + 2 * p1 * x * y + p2 * (square + 2 * x * x), rel=1e-14)
    assert seen[1] == pytest.approx(y * q + p1 * (square + 2 * y * y) + 2 * p2 * x * y, rel=1e-14)
    np.testing.assert_allclose(undistorted(seen[0], seen[1], numbers), (x, y), rtol=1e-13)
    near = distorted(x + 1e-7, y, numbers)
    np.testing.assert_allclose(((near[0] - seen[0]) / 1e-7, (near[1] - seen[1]) / 1e-7), seen[2:4], rtol=1e-6)
