"""Vignetting against its formulas at single pixels."""

from __future__ import annotations

import math

import numpy as np
import pytest

from clsco.optics.vignetting import throughput
from clsco.scene.model import Camera


def test_natural_vignetting_is_the_fourth_power_of_the_cosine() -> None:
    camera = Camera(resolution=(512, 512))
    share = throughput(camera, "natural")
    for row, column in ((0, 0), (511, 100), (256, 255), (30, 511)):
        angle = math.atan(math.hypot(column - 255.5, row - 255.5) * 0.01 / 20.0)
        assert share[row, column] == pytest.approx(math.cos(angle) ** 4, abs=1e-12)
    assert share.max() == pytest.approx(1.0, abs=3e-7)
    assert share[0, 0] == pytest.approx(0.9378, abs=5e-5)  # in the corner of the thesis' frame


def test_the_cosine_is_that_of_the_normalization_distance() -> None:
    camera = Camera(resolution=(3, 3), normalization_distance=1.0, pixel_pitch=1.0)
    assert throughput(camera, "natural").tolist() == [[1 / 9, 0.25, 1 / 9], [0.25, 1.0, 0.25], [1 / 9, 0.25, 1 / 9]]


def test_a_polynomial_is_of_the_distance_in_half_diagonals() -> None:
    share = throughput(Camera(resolution=(8, 6)), (-0.4, 0.2, -0.3))
    r = math.hypot(3.5, 2.5) / 5.0
    assert share[0, 0] == pytest.approx(1 - 0.4 * r**2 + 0.2 * r**4 - 0.3 * r**6, abs=1e-15)
    assert share.shape == (6, 8)
    assert (share == share[::-1]).all()
    assert (share == share[:, ::-1]).all()


def test_without_vignetting_all_pixels_get_the_same() -> None:
    assert (throughput(Camera(resolution=(5, 4)), "none") == np.ones((4, 5))).all()
