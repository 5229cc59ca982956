"""Angles without a library against NumPy's, in both precisions."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from clsco.opencl.buffers import empty
from clsco.opencl.session import Session
from clsco.records import REAL, Real
from clsco.resources import folder
from tests.kernels.launches import held, whole

SOURCE = """
__kernel void angles(__global const real *y, __global const real *x, const int count, __global real *out)
{
    const int i = get_global_id(0);
    if (i >= count)
        return;
    const real angle = polar_angle(y[i], x[i]);
    const real3 turn = cos_sin(angle);
    out[3 * i] = angle, out[3 * i + 1] = turn.x, out[3 * i + 2] = turn.y;
}
"""
EXACT: dict[Real, float] = {"double": 1e-15, "float": 4e-7}


@pytest.mark.parametrize("real", ["double", "float"])
def test_angles_and_their_cosines_and_sines(session: Session, run_source: Callable[..., None], real: Real) -> None:
    rng = np.random.default_rng(6)
    angle = np.concatenate(
        [rng.uniform(-np.pi, np.pi, 500), np.arctan(np.arange(-32, 33) / 32), [0.0, 1e-9, np.pi / 2]]
    )
    size = np.exp(rng.uniform(-6, 6, angle.size))
    y, x = (held(size * part) for part in (np.sin(angle), np.cos(angle)))
    y, x = np.append(y, [0.0, 0.0, 3.0, -3.0, -0.0]), np.append(x, [0.0, -2.0, 0.0, 0.0, 5.0])
    text = (folder("kernels") / "common/angles.clh").read_text("utf-8") + SOURCE
    out = empty(session, 8 * 3 * y.size)
    given = (values.astype(REAL[real]) for values in (y, x))
    run_source(text, "angles", real, {"OCCLUDED": 0}, y.size, *given, np.int32(y.size), out)
    found = whole(session, out, (y.size, 3), real)
    exact = np.arctan2(y, x)
    assert np.abs(found[:, 0] - exact).max() < 4 * EXACT[real]
    assert np.abs(found[:, 1] - np.cos(exact)).max() < 4 * EXACT[real]
    assert np.abs(found[:, 2] - np.sin(exact)).max() < 4 * EXACT[real]
