"""Real numbers in buffers of the device, of either precision."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from clsco.opencl.buffers import download
from clsco.opencl.session import Session
from clsco.records import REAL, Real

Array = NDArray[Any]


def whole(session: Session, buffer: cl.Buffer, shape: tuple[int, ...], real: Real) -> Array:
    """Download real numbers as float64 (...)."""
    return download(session, buffer, shape, REAL[real]).astype(np.float64)


def held(values: Array) -> Array:
    """Numbers near `values`, float64, that both precisions hold exactly."""
    return np.asarray(values, dtype=np.float32).astype(np.float64)
