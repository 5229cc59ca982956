"""Tables of pupils of any shape, as columns of sources read them: windows of intervals, outlines of groups of them."""

from __future__ import annotations

import numpy as np
import pytest

from clsco.constants import POWERS, TAP_LANES, WIDE_LANES
from clsco.optics.point_spread import PointSpread
from clsco.optics.psf_tables import psf_table
from clsco.optics.pupils.image import image_pupil
from clsco.optics.pupils.outline import CurvedPolygon, Ellipse
from clsco.optics.pupils.polygon import Polygon
from clsco.optics.pupils.pupil import Pupil
from tests.slow import mostly_slow

CELLS = np.random.default_rng(5).integers(0, 2, (5, 5)).astype(np.float64)  # not a part of what is wider
MASK = CELLS.repeat(8, axis=0).repeat(8, axis=1)
PUPILS: list[Pupil] = [Polygon(5, 8.0), CurvedPolygon(4, 20.0, -0.6), Ellipse(2.0, 0.4), image_pupil(MASK)]
LARGEST = 7.0


@pytest.mark.parametrize("pupil", mostly_slow(PUPILS, PUPILS[1::2]), ids=lambda pupil: pupil.name)
def test_groups_of_intervals(pupil: Pupil) -> None:
    """Any group that a window holds has the weights of rows, no light beyond its outline, and in its runs the weight
    that stands first."""
    table = psf_table(PointSpread(pupil), 0.0, LARGEST)
    reach = int(table.intervals[: table.count, 1].max())
    columns = 2 * reach + 1
    outlines = table.outlines[: table.count * columns].reshape(table.count, columns, 4)
    heads = table.outlines[table.count * columns :]
    assert len(heads) == -(-table.count // TAP_LANES)
    flat, runs = table.taps.ravel(), 0
    for low in range(0, table.count, 11):
        high = min(low + 15 - low % TAP_LANES, table.count - 1)
        place, side = (int(value) for value in heads[low // TAP_LANES, :2])
        window = flat[place:][: (side * side + 1) * POWERS * WIDE_LANES].reshape(-1, POWERS, WIDE_LANES)
        first, taps = window[0], window[1:].reshape(side, side, POWERS, WIDE_LANES)
        for number in (low, (low + high) // 2, high):
            lane, half = number - low // TAP_LANES * TAP_LANES, int(table.intervals[number, 1])
            start, lanes = int(table.intervals[number, 0]), (2 * half // TAP_LANES + 1) * TAP_LANES
            rows = table.coefficients[start:][: (2 * half + 1) * POWERS * lanes].reshape(-1, POWERS, lanes)
            inside = slice(side // 2 - half, side // 2 + half + 1)
            own = taps[inside, inside, :, lane]
            np.testing.assert_array_equal(own.transpose(1, 2, 0), rows[..., : 2 * half + 1])
            assert np.count_nonzero(taps[..., lane]) == np.count_nonzero(own)
            for dx in range(-half, half + 1):
                begin, end = outlines[high, reach + dx, :2]
                column = own[half + dx]
                assert not column[: max(half + begin, 0)].any()
                assert not column[half + end + 1 :].any()
                begin, end = outlines[low, reach + dx, 2:]
                runs += max(end - begin, 0)
                run = column[half + begin : half + end] if end > begin else column[:0]
                np.testing.assert_allclose(run, np.broadcast_to(first[:, lane], run.shape), rtol=0, atol=1e-9)
    assert runs > 0


def test_a_run_is_most_of_a_wide_polygon() -> None:
    table = psf_table(PointSpread(Polygon(5, 8.0)), 0.0, 20.0)
    reach = int(table.intervals[: table.count, 1].max())
    last = table.outlines[(table.end - 1 - table.first) * (2 * reach + 1) :][: 2 * reach + 1]
    of_runs, of_light = (last[:, 3] - last[:, 2]).sum(), (last[:, 1] - last[:, 0] + 1).sum()
    assert of_runs > 0.55 * of_light
