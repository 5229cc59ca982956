"""Weights of a pupil given by an image: against its own sums, closed forms of other pupils, and brute force."""

from __future__ import annotations

import numpy as np
import pytest

from clsco.optics.point_spread import PointSpread, point_spread
from clsco.optics.pupils.image import Image, image_pupil
from clsco.optics.pupils.polygon import Polygon
from clsco.scene.model import Psf
from tests.optics.test_point_spread import Array


def heart(count: int = 96) -> Image:
    """(x^2 + y^2 - a)^3 < b x^2 y^3, upright."""
    at = (np.arange(count) + 0.5) * 2 / count - 1
    x, y = at[None, :], 0.1 - at[:, None]
    return image_pupil(((x * x + y * y - 0.35) ** 3 < 1.2 * x * x * y**3).astype(np.float64))


def grid(half: int) -> tuple[Array, Array]:
    span = np.arange(-half, half + 1.0)
    return span[None, :], span[:, None]


@pytest.mark.parametrize("radius", [0.0, 1e-6, 0.2, -0.26, 1.0, -3.3, 14.4])
def test_light_and_moments_are_the_sums_of_the_image(radius: float) -> None:
    pupil = heart()
    cells, at = pupil.image, (np.arange(pupil.count) + 0.5) * 2 / pupil.count - 1
    (x, y), size = grid(int(abs(radius)) + 2), np.asarray(radius)
    psf = PointSpread(pupil)
    found = psf.weights(x, y, size)
    assert found.min() >= 0.0
    assert found.sum() == pytest.approx(1.0, abs=1e-10)
    assert psf.subpixel_weights(x - 0.375, y + 0.125, size).sum() == pytest.approx(1.0, abs=1e-12)
    # The tent sums to the place of a source, so that the mean is that of the image, turned over for negative radii.
    assert (found * x).sum() == pytest.approx(radius * (cells.sum(axis=0) @ at) / cells.sum(), abs=1e-8)
    assert (found * y).sum() == pytest.approx(radius * (cells.sum(axis=1) @ at) / cells.sum(), abs=1e-8)
    if abs(radius) > 10.0:
        width = (2 / pupil.count) ** 2 / 12
        mean = 0.5 * ((cells.sum(axis=0) + cells.sum(axis=1)) @ (at * at + width)) / cells.sum()
        moment = 0.5 * ((found * x * x).sum() + (found * y * y).sum())
        assert moment == pytest.approx(radius**2 * mean + 1 / 6, rel=1e-3)
        assert moment == pytest.approx(psf.second_moment(radius), rel=1e-3)


def test_a_heart_stands_upright_behind_the_focus_and_on_its_tip_before_it() -> None:
    (x, y), psf = grid(22), PointSpread(heart())
    behind, before = (psf.weights(x, y, np.asarray(radius)) for radius in (20.0, -20.0))
    np.testing.assert_allclose(before, behind[::-1, ::-1], rtol=0, atol=1e-12)
    np.testing.assert_allclose(behind, behind[:, ::-1], rtol=0, atol=1e-9)
    rows = np.flatnonzero(behind.sum(axis=1) > 1e-6)
    widths = (behind[rows] > 1e-6).sum(axis=1)
    assert widths[0] > 3 * widths[-1]  # lobes above, the tip below


def test_an_image_of_a_polygon_is_the_polygon() -> None:
    """Cells across the rim are wrong by half of them: 2 / count of the radius along it."""
    count, polygon = 512, Polygon(6, 20.0)
    at = (np.arange(4 * count) + 0.5) / (2 * count) - 1
    fine = polygon.transmission(at[None, :], at[:, None])
    image = image_pupil(fine.reshape(count, 4, count, 4).mean(axis=(1, 3)))
    x, y = grid(12)
    for radius in (1.0, -5.0, 10.0):
        a, b = (PointSpread(pupil).weights(x, y, np.asarray(radius)) for pupil in (image, polygon))
        assert np.abs(a - b).sum() < 2e-3
    assert image.second_moment == pytest.approx(polygon.second_moment, rel=1e-3)


def test_what_lies_outside_of_the_rim_is_dark() -> None:
    whole = image_pupil(np.ones((64, 64)))
    assert whole.second_moment == pytest.approx(0.25, rel=2e-3)
    assert whole.image[0, 0] == 0.0
    assert whole.image[32, 2] == 1.0


def test_pupils_of_other_cells_are_others() -> None:
    one, two = image_pupil(np.ones((8, 8))), image_pupil(np.eye(8))
    assert one != two
    assert repr(one) != repr(two)
    assert PointSpread(one) == PointSpread(image_pupil(np.full((8, 8), 0.3)))  # scaled to 1
    assert hash(PointSpread(one)) == hash(PointSpread(image_pupil(np.ones((8, 8)))))
    assert PointSpread(one) != point_spread(Psf())
