"""Tables of mean lens points: their sizes, and the radii that they are for."""

from __future__ import annotations

import numpy as np
import pytest

from clsco.optics.point_spread import PointSpread
from clsco.optics.pupils.circle import Circle
from clsco.optics.pupils.ring import Ring
from clsco.optics.pupils.traced import Traced
from clsco.optics.pupils.wavefront import Wavefront
from clsco.optics.ray_means import SHEET_PLANES, RayMeans, ray_floats, ray_means, step_of


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


def test_two_branches_of_rays_in_a_pixel_have_means_of_their_own() -> None:
    """8 r - 5 r^3 = 3 px at r = 0.4 and 1; what lies between goes farther, up to r = 0.73."""
    psf = PointSpread(Traced(Circle(), wavefront=Wavefront(spherical=-0.625)), most=(-1.0, 8.0))
    rays = ray_means(psf, 8.0)
    numbers, parts, _ = rays.around(np.array([8.0]), np.zeros((1, 1), np.int64), np.ones((1, 1)))
    planes = rays.lens_points(numbers, parts, np.array([3.0]), np.zeros(1))[:, 0]
    at = np.linspace(-1.0, 1.0, 400)
    x, y = (each[np.hypot(*np.meshgrid(at, at)) < 1.0] for each in np.meshgrid(at, at))
    r = np.hypot(x, y)
    light = np.clip(1 - np.abs((8 - 5 * r * r) * x - 3), 0, 1) * np.clip(1 - np.abs((8 - 5 * r * r) * y), 0, 1)
    outer = r > (8 / 15) ** 0.5
    assert planes[0] == pytest.approx(light[outer].sum() / light.sum(), abs=0.02)
    for sheet, within in enumerate((~outer, outer)):
        mean = planes[1 + sheet * SHEET_PLANES :][:2] / (planes[0] if sheet else 1.0 - planes[0])
        assert mean == pytest.approx([np.average(x[within], weights=light[within]), 0.0], abs=0.02)
    assert rays.floats().size == ray_floats(psf, 8.0)
