"""Numbers of a `wide_t` in buffers: doubles, or two floats each (kernels/common/wide.clh)."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from clsco.opencl.buffers import download
from clsco.opencl.session import Session
from clsco.records import WIDE, Real, in_parts, together

Array = NDArray[Any]

PARTS = """\
#if REAL_IS_DOUBLE
#define GET(p, i) p[i]
#define PUT(p, i, a) p[i] = a
#else
#define GET(p, i) wide_pair(p[2 * (i)], p[2 * (i) + 1])
#define PUT(p, i, a) p[2 * (i)] = (a).high, p[2 * (i) + 1] = (a).low
#endif
"""


def whole(session: Session, buffer: cl.Buffer, shape: tuple[int, ...], real: Real) -> Array:
    """Download what PUT wrote, float64 (...): the sum of the parts, the first of which is that sum rounded to float."""
    if real == "double":
        return download(session, buffer, shape, np.float64)
    parts = download(session, buffer, shape, WIDE[real])
    np.testing.assert_array_equal(parts["high"], parts["high"] + parts["low"])
    return together(parts, real)


def held(values: Array) -> Array:
    """Numbers near `values` that both precisions hold exactly: 48 bits."""
    return together(in_parts(np.asarray(values, dtype=np.float64), "float"), "float")
