"""Cells of narrow lenses against sums over lens points, and edges in one cell."""

from __future__ import annotations

import numpy as np
import pytest

from clsco.optics.lens import Lens, blur_radius
from clsco.optics.motion import Pose
from clsco.optics.point_spread import point_spread
from clsco.optics.quadrics import place
from clsco.optics.visibility import OcclusionGroup
from clsco.reference.common.equation import Points
from clsco.reference.common.occluder import Part, leave_free, soft_step
from clsco.reference.common.visibility import check_visibility
from clsco.reference.common.visibility_test import cell_visibility, tap_share
from clsco.scene.model import Camera, Plane, Psf

CAMERA = Camera(pixel_pitch=0.15, aperture_diameter=10.0, resolution=(64, 64))
STILL = Pose(np.eye(3), np.zeros(3))


@pytest.mark.parametrize("width", [0.0, 1.0])
def test_narrow_lenses_are_weighed_cell_by_cell(width: float) -> None:
    """Points' taps weigh the cells of the lens, pixels' have means of what they see: against 400 x 400 lens points.

    The response is the box of a pixel to a point, and to a source that is a pixel a tent.
    """
    item = Plane(distance=200.0, bounds=((0.4, 60.0), (-60.0, 60.0), (-1.0, 1.0)))
    rays, w = np.array([[0.0, 0.0, 1.0]]), np.array([1 / 400.0])
    radius = blur_radius(CAMERA, w)
    assert 0.5 < radius[0] < 2.0
    zero, surfaces = np.zeros(1), [place(item, STILL)]
    _, _, visibility = check_visibility(
        Lens.of(CAMERA),
        surfaces,
        [item.bounds],
        OcclusionGroup(0, 1),
        point_spread(Psf()),
        Points(rays, w, radius, zero, zero, width, np.zeros((1, 2))),
    )
    assert (visibility.row == 0).all()
    cells = cell_visibility(visibility)
    fine = (np.arange(400) + 0.5) / 200 - 1
    x, y = np.meshgrid(fine, fine)
    # The line crosses the card's plane half way to the lens point 5 mm x, from a place in the pixel that is 1.5 mm wide
    # there; light of a lens point that arrives in another pixel comes from a part of it alone.
    for dx, dy in ((0, 0), (1, 0), (-1, 0), (0, 1), (1, 1)):
        first = np.maximum(dx - x * radius, 0.0) - 0.5
        part = np.maximum(np.minimum(dx - x * radius, 0.0) + 0.5 - first, 1e-9)
        free = np.clip(((0.4 - 2.5 * x) / 1.5 - first) / part, 0.0, 1.0) if width else 2.5 * x < 0.4
        away = np.abs([x * radius - dx, y * radius - dy])
        response = np.prod(np.maximum(0, 1 - away) if width else away <= 0.5, axis=0)
        response = np.where(x * x + y * y <= 1, response, 0.0)
        # The grid of points has 16 cells across, whose edges are soft; pixels have the means of taps.
        expected = (response * free).sum() / response.sum()
        assert tap_share(visibility, cells, dx, dy)[0] == pytest.approx(expected, abs=0.07 if width else 0.02)
    if not width:
        assert tap_share(visibility, cells, 5.0, 0.0)[0] == 1.0  # no light goes there: nothing to divide by


def test_soft_step_is_a_step() -> None:
    t = np.linspace(-1.0, 1.0, 2001)
    step = soft_step(t)
    assert (np.diff(step) >= 0).all()
    assert step[t <= -0.5].max() == 0.0
    assert step[t >= 0.5].min() == 1.0
    np.testing.assert_allclose(step + soft_step(-t), 1.0, atol=1e-15)
    # As a spread over [-a, a], a = 1/2, its slope has the variance a^2 / 5.
    middle, slope = 0.5 * (t[1:] + t[:-1]), np.diff(step)
    assert (middle**2 * slope).sum() == pytest.approx(0.25 / 5, rel=1e-5)


@pytest.mark.parametrize(
    ("hidden", "degrees", "expected"),
    [((0.7, 0.4), 0.0, 0.3), ((0.7, 0.4), 180.0, 0.0), ((0.7, 0.4), 90.0, 0.3 * 0.6), ((0.3, 0.2), 180.0, 0.5)],
)
def test_edges_in_one_cell_hide_by_their_directions(
    hidden: tuple[float, float], degrees: float, expected: float
) -> None:
    """Two half planes leave the less of a cell if both hide the same side, the gap between them if they hide opposite
    ones, nothing if they overlap, the product if their edges are perpendicular; in any order, and alone each its own.
    """
    turn, one = np.radians(degrees), np.ones(1)
    first = Part(hidden[0] * one, 3.0 * one, 0.0 * one)
    second = Part(hidden[1] * one, np.cos(turn) * one, np.sin(turn) * one)
    for a, b in ((first, second), (second, first)):
        alone = leave_free(Part(one, 0 * one, 0 * one), a)
        np.testing.assert_array_equal(alone.share, 1 - a.share)
        np.testing.assert_allclose(leave_free(alone, b).share, expected, atol=1e-12)
