"""Tables of mean lens points: their sizes, and the radii that they are for."""

from __future__ import annotations

import numpy as np
import pytest

from clsco.optics.point_spread import PointSpread
from clsco.optics.pupils.ring import Ring
from clsco.optics.ray_means import RayMeans, ray_floats, ray_means, step_of


@pytest.fixture(scope="module")
def means() -> RayMeans:
    return ray_means(PointSpread(Ring(0.5)), 7.3)


def test_tables_are_as_large_as_predicted_and_grow_less_than_the_cube_of_the_radius(means: RayMeans) -> None:
    psf = PointSpread(Ring(0.5))
    assert means.floats().size == ray_floats(psf, 7.3)
    assert 4 * ray_floats(psf, 60.0) < 75 * 2**20


@pytest.mark.parametrize("radius", [-6.25, -4.0, 2.5, 4.0, 5.0625])
def test_means_are_those_of_a_radius_that_they_are_made_for(means: RayMeans, radius: float) -> None:
    numbers, parts, scale = means.around(np.array([radius]), np.zeros((1, 1), np.int64), np.ones((1, 1)))
    first = int(step_of(np.array(radius))) - means.first
    assert parts[numbers == first] == pytest.approx(1.0)
    assert scale == pytest.approx(radius, rel=2e-3)
    right, *_ = means.lens_points(numbers, parts, np.array([0.7 * radius]), np.zeros(1))
    assert right == pytest.approx(0.7, abs=0.05)
