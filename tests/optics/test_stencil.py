"""Stencils: their runs and rectangles together are the PSF."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from clsco.constants import LONGEST_RUN
from clsco.optics.point_spread import point_spread
from clsco.optics.stencil import Stencil, stencils
from clsco.scene.model import Psf
from tests.optics.grids import square
from tests.spreads import PSFS, name_of


def summed_up(stencil: Stencil, far: int) -> NDArray[np.float64]:
    """The weights (2 far + 1, 2 far + 1) as the kernel adds them up."""
    out = np.zeros((2 * far + 1, 2 * far + 1))
    for dx, dy, count, start in stencil.runs:
        assert 0 < count <= LONGEST_RUN
        rows = slice(far + dy, far + dy + count)
        out[rows, far - dx] += stencil.weights[start : start + count]
        out[rows, far + dx] += stencil.weights[start : start + count]
    inside = np.zeros_like(out)
    y, x = np.indices(out.shape) - far
    for to_y, to_x, from_y, from_x in stencil.pairs:
        inside += 1.0 * ((y <= to_y) & (x <= to_x)) - ((y <= from_y) & (x <= from_x))
    assert set(np.unique(inside)) <= {0.0, 1.0}
    assert inside.sum() == stencil.area
    return out + stencil.share * inside


@pytest.mark.parametrize("radius", [0.0, 0.4, 1.0, 2.7, 9.3, 12.0, 12.6, 20.0, 33.3, 60.0])
@pytest.mark.parametrize("psf", PSFS, ids=name_of)
def test_a_stencil_is_its_psf(psf: Psf, radius: float) -> None:
    far = point_spread(psf).reach(radius)
    each = [summed_up(stencil, far) for stencil in stencils(point_spread(psf), radius)]
    found = each[0]
    if point_spread(psf).layout == "separable":
        across, down = each
        assert not np.delete(across, far, 0).any()
        assert not np.delete(down, far, 1).any()
        found = down[:, far, None] * across[far]
    # Rounded to float32 once, or a product of two that are.
    expected = square(point_spread(psf), radius, far)
    np.testing.assert_allclose(found, expected, rtol=2.5 * 2.0**-24, atol=1e-14)
