"""Approximation of wide blur on coarser grids: which sources they hold, at which radius, and with which error (float64,
pure).

Host and kernels: clsco/passes/multigrid.py, kernels/blur/multigrid.cl.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.errors import SceneError
from clsco.optics.multigrid import FADE, MOST_LEVELS, loss
from clsco.optics.psf import psf_extent, shape_of
from clsco.scene.model import Psf

Array = NDArray[np.float64]

# Methods by name, the fastest first, with the smallest radius that a coarser grid holds, in its own px.
METHODS = {"coarse2": 2.0, "coarse4": 4.0, "coarse8": 8.0, "coarse16": 16.0}
# Taps per pixel that the way to coarser grids and back costs as much as; the more, the faster the exact way is at them.
DISC_TAPS, MOVING_TAPS, SOFT_TAPS = 1200.0, 450.0, 400.0
PIXELS_PER_PLACE, FEWEST_PLACES, MOST_PLACES = 1024, 256, 512  # where errors are sampled


@dataclass(frozen=True)
class ApproximationReport:
    """Report on how the blur of an image was computed, with the measured error of an approximation.

    Attributes
    ----------
    method : str
        Name in METHODS, or "exact".
    tolerance : float or None
        The requested one.
    rms_error : float
        Of white, against the exact blur.
    at_most : float
        The RMS error and two standard errors more, which is compared with the tolerance.
    pixels : int
        At which the error was measured.
    tried : tuple of (str, float)
        Method and `at_most` of each approximation that exceeded the tolerance.
    """

    method: str
    tolerance: float | None
    rms_error: float
    at_most: float
    pixels: int
    tried: tuple[tuple[str, float], ...] = ()

    def line(self) -> str:
        """The same in a line."""
        if self.method == "exact":
            if not self.tried:
                return "exact: nothing that fits the memory is faster"
            return f"exact: {self.tried[-1][0]} is off by up to {self.tried[-1][1]:.2g}"
        return f"{self.method}: RMS error {self.rms_error:.2g} of white, measured at {self.pixels} pixels"


def asked_alike(report: Mapping[str, Any] | None, method: str, tolerance: float | None) -> bool:
    """True if a frame with this report (an `ApproximationReport` as a mapping, or None) has the same request."""
    if report is None:
        return tolerance is None and method not in METHODS
    return report.get("tolerance") == tolerance and (tolerance is not None or report.get("method") == method)


def checked_tolerance(tolerance: float, method: str) -> float:
    """The tolerance; raises SceneError where it is no number above 0, or a method is named besides."""
    if not (isfinite(tolerance) and tolerance > 0.0):
        raise SceneError(f"tolerance: must be a number above 0, RMS of white; got {tolerance}")
    if method != "auto":
        raise SceneError(f"tolerance: chooses the method, which must then be auto; got {method}")
    return tolerance


def can_convolve(psf: Psf) -> bool:
    """True if `convolve` and coarser grids can blur by this PSF: the same one everywhere, and for -R."""
    return psf.border == "lose" and not shape_of(psf).signed


def check_border(psf: Psf, method: str) -> None:
    """Raises SceneError where a method cannot keep the light within the frame, or take the shape of the lens."""
    if method in (*METHODS, "convolve") and shape_of(psf).signed:
        raise SceneError(f'method: {method} needs aperture.shape = "circle"; got {psf.aperture.shape}')
    if method in METHODS and psf.border != "lose":
        raise SceneError(f'method: {method} needs psf.border = "lose"; got {psf.border}')


def candidates(psf: Psf, radii: Array) -> tuple[str, ...]:
    """Names in METHODS that are faster than the exact way for |blur radii| in px (any shape), the fastest first.

    By the number of taps: per pixel they must be fewer by at least DISC_TAPS for sampled discs, SOFT_TAPS for
    Gaussians, MOVING_TAPS for others; there is none for a polygon (measured: benchmarks/optimisation_log.md).
    """
    shape = shape_of(psf)
    if radii.size == 0 or not can_convolve(psf):
        return ()
    moving = SOFT_TAPS if shape.soft else MOVING_TAPS
    exact, least_saved = _taps(psf, radii), DISC_TAPS if shape.kind == "disc" else moving
    return tuple(
        name for name, least in METHODS.items() if (exact - _coarse_taps(psf, radii, least)).mean() >= least_saved
    )


def _taps(psf: Psf, radii: Array) -> Array:
    return np.asarray(np.pi * (psf_extent(psf, radii) + 0.7) ** 2)


def _coarse_taps(psf: Psf, radii: Array, least: float) -> Array:
    """Taps per pixel where sources are on the coarsest grid that holds them; nodes are fewer than pixels."""
    taps, square, nodes = _taps(psf, radii), np.asarray(radii, np.float64) ** 2, 1.0
    for level in range(MOST_LEVELS):
        square, nodes = 0.25 * np.maximum(square - loss(psf, level == 0), 0.0), nodes / 4.0
        taps = np.where(square >= (FADE * least) ** 2, nodes * _taps(psf, np.sqrt(square)), taps)
    return taps


def place_count(rows: int, columns: int) -> int:
    """At how many pixels of a frame errors are sampled."""
    return int(np.clip(rows * columns // PIXELS_PER_PLACE, FEWEST_PLACES, MOST_PLACES))


def sample_places(rows: int, columns: int) -> NDArray[np.int32]:
    """Rows and columns (places, 2) of pixels spread evenly over a frame: the same ones each time.

    The additive recurrence R2 (M. Roberts 2018), whose points keep away from each other.
    """
    ratio = 1.32471795724474602596  # the root of x^3 = x + 1
    count = place_count(rows, columns)
    step = np.arange(1, count + 1)[:, None] * np.array([1 / ratio, 1 / ratio**2]) % 1.0
    return np.floor(step * [rows, columns]).astype(np.int32)


def estimate(missed: NDArray[np.float32]) -> tuple[float, float]:
    """RMS error from errors at sampled pixels (pixels, channels), and two standard errors more of its square."""
    square = np.mean(missed.astype(np.float64) ** 2, axis=1)
    mean = float(square.mean())
    spread = float(square.std(ddof=1)) / sqrt(len(square)) if len(square) > 1 else 0.0
    return sqrt(mean), sqrt(mean + 2.0 * spread)
