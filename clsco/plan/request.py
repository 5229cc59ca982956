"""Request: what a user asks for besides the scene."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite

from clsco.errors import SceneError


def check_tolerance(tolerance: float) -> None:
    """Raise SceneError unless a tolerance is a positive number."""
    if not (isfinite(tolerance) and tolerance > 0.0):
        raise SceneError(f"tolerance: must be a number above 0, RMS of white; got {tolerance}")


@dataclass(frozen=True)
class Request:
    """Requested outputs besides color, and how to compute them."""

    truth: tuple[str, ...] = ()
    method: str = "auto"  # of the blur, as for `clsco.plan.methods.check_method`
    tolerance: float | None = None  # largest RMS error (1 = white) that fewer samples may cause; None for all samples
    precision: str | None = None  # "single" or "double", of the geometry; by default double if the device has it
    memory: str | int | None = None  # limit of the buffers, by default as in `clsco.plan.memory.limit_of`
    color: bool = True  # True if the image is requested
