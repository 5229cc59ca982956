"""Peers that blur by a radius map or by one radius: numba's direct scatter and OpenCV; the extra `bench` has both.

Mitsuba, the other peer, makes whole frames (`benchmarks.speed.lens`).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from importlib.util import find_spec
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.blur.cases import PSFS, Peer
from benchmarks.truth import mitsuba
from clsco.errors import ClscoError
from clsco.optics.point_spread import point_spread
from clsco.scene.model import Psf

Array = NDArray[Any]

MODULES = {"numba": "numba", "OpenCV": "cv2", "Mitsuba": "mitsuba"}
NOT_INSTALLED = "it is not installed: pip install 'clsco[bench]'"
PACKAGES = {
    "numba": ("numba",),
    "OpenCV": ("opencv-contrib-python-headless", "opencv-python-headless", "opencv-python"),
    "Mitsuba": ("mitsuba", "drjit"),
}
# Of numba's table per px of radius, fewer for large radii, where weights change slowly and tables grow with R^3.
MOST_STEPS, TABLE_WEIGHTS = 128, 2.0e6


def require_peers() -> tuple[list[str], dict[str, str]]:
    """Tools that can be used, and why the others cannot. Raises ClscoError where none is installed."""
    absent = {tool: NOT_INSTALLED for tool, module in MODULES.items() if find_spec(module) is None}
    if len(absent) == len(MODULES):
        raise ClscoError(f"--compare: needs {' or '.join(MODULES)}: pip install 'clsco[bench]'; got no such module")
    if "Mitsuba" not in absent and (why := mitsuba.unusable()):
        absent["Mitsuba"] = why
    return [tool for tool in MODULES if tool not in absent], absent


def _set_up_numba(way: str, psf: str, image: Array, radii: Array) -> Callable[[], Array]:
    call = _numba(way, psf, image.reshape(*radii.shape, -1), radii)
    return lambda: call().reshape(image.shape)


def _set_up_opencv(method: str, psf: str, image: Array, radii: Array) -> Callable[[], Array]:
    return opencv(method, PSFS[psf], image, float(radii[0, 0]))


def _numba(way: str, psf: str, image: Array, radii: Array) -> Callable[[], Array]:
    from benchmarks.speed.direct import THREADS, dense_table, scatter

    single, ways = radii.astype(np.float32), scatter(image.shape[2])
    if psf == "sampled":
        sampled = ways.sampled_private if way == "private" else ways.sampled_bands
        return lambda: sampled(image, single, THREADS)
    exact = ways.exact_private if way == "private" else ways.exact_bands
    gy, gx = (gradient.astype(np.float32) for gradient in np.gradient(radii))
    largest = float(radii.max())
    steps = int(min(MOST_STEPS, TABLE_WEIGHTS / (largest + 2.0) ** 3 + 1.0))
    table = dense_table(largest, steps)
    return lambda: exact(image, single, gx, gy, table, float(steps), THREADS)


def opencv(method: str, psf: Psf, image: Array, radius: float) -> Callable[[], Array]:
    """filter2D with a radius' weights, or GaussianBlur with its sigma; linear radiance (rows, columns[, channels])."""
    import cv2

    far = point_spread(psf).reach(radius)
    if method == "GaussianBlur":
        size, sigma = (2 * far + 1, 2 * far + 1), psf.sigma_ratio * radius
        return lambda: cv2.GaussianBlur(image, size, sigma, borderType=cv2.BORDER_CONSTANT)
    offset = np.arange(-far, far + 1.0)
    kernel = point_spread(psf).weights(offset[None, :], offset[:, None], np.asarray(radius)).astype(np.float32)
    return lambda: cv2.filter2D(image, -1, kernel, borderType=cv2.BORDER_CONSTANT)


PEERS = (
    *(
        Peer("numba", way, "varying", psf, partial(_set_up_numba, way, psf))
        for psf in ("sampled", "integrated, tilt")
        for way in ("private", "bands")
    ),
    *(Peer("OpenCV", "filter2D", "constant", psf, partial(_set_up_opencv, "filter2D", psf)) for psf in PSFS),
    Peer("OpenCV", "GaussianBlur", "constant", "gaussian", partial(_set_up_opencv, "GaussianBlur", "gaussian")),
)
