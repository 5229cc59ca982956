"""Request: what a user asks for besides the scene."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite
from numbers import Real

from clsco.errors import SceneError


def check_tolerance(tolerance: float) -> None:
    """Raise SceneError unless a tolerance is a positive number."""
    if not (isinstance(tolerance, Real) and isfinite(tolerance) and tolerance > 0.0):
        raise SceneError(f"tolerance: must be a number above 0, RMS of white; got {tolerance}")


@dataclass(frozen=True)
class Request:
    """Requested outputs besides color, and how to compute them."""

    truth: tuple[str, ...] = ()
    method: str = "auto"  # method of the blur, see `clsco.plan.methods.check_method`
    tolerance: float | None = None  # largest RMS error, 1 = white, due to fewer samples; None for all samples
    precision: str | None = None  # precision of the geometry, "single" or "double"; by default double if possible
    memory: str | int | None = None  # limit of the buffers, by default as in `clsco.plan.memory.limit_of`
    color: bool = True  # True if the image is requested
