"""The sequence of a scene: its frames, and when and how the shutter of each is open."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, ValidationInfo, field_validator

from clsco.scene.quantities import Duration, Samples, Strict, Within, as_python, fault, refuse_if

CURVES = {"box": (1.0, 1.0), "trapezoid": (0.0, 1.0, 1.0, 1.0, 0.0), "triangle": (0.0, 1.0, 0.0)}
"""Weights of the named shutter curves, at equal time steps from opening to closing."""
MOST_WEIGHTS, LARGEST_WEIGHT = 256, 1e9  # largest number of weights of a shutter curve, and largest weight


def _curve(value: Any) -> Any:
    """Reject any value but the name of a shutter curve, or a list of weights with at least one above 0."""
    value = as_python(value)
    if type(value) is str and value in CURVES:
        return value
    numbers = tuple(value) if isinstance(value, list | tuple) else ()
    if not 2 <= len(numbers) <= MOST_WEIGHTS or any(type(each) not in (int, float) for each in numbers):
        raise fault(f"must be {', '.join(CURVES)}, or a list of 2 to {MOST_WEIGHTS} weights")
    if not all(0 <= each <= LARGEST_WEIGHT for each in numbers) or not any(numbers):
        raise fault(f"must have weights between 0 and {LARGEST_WEIGHT:g}, one of them above 0")
    return numbers


_is_open = refuse_if(
    lambda value: type(value) in (int, float) and value == 0,
    "must be greater than 0 s; for an instant give a short one, such as 1e-6",
)
_forwards = refuse_if(
    lambda value: type(value) in (int, float) and value < 0,
    "must be at least 0 s; for the other order of the rows change scan",
)
Start = Annotated[float, Within(-1e9, 1e9, "s")]
Shutter = Annotated[Duration, BeforeValidator(_is_open)]
Readout = Annotated[float, Within(0.0, 1e9, "s"), BeforeValidator(_forwards)]
Scan = Literal["top_to_bottom", "bottom_to_top", "left_to_right", "right_to_left"]
Weight = Annotated[float, Within(0.0, LARGEST_WEIGHT)]
ShutterCurve = Annotated[
    Literal["box", "trapezoid", "triangle"]
    | Annotated[tuple[Weight, ...], Field(json_schema_extra={"minItems": 2, "maxItems": MOST_WEIGHTS})],
    BeforeValidator(_curve),
]


class Sequence(Strict):
    """Video frames, and the time samples (sub-frames) of each exposure."""

    frames: Annotated[int, Within(1, 1_000_000)] = 1
    """Number of frames."""
    interval: Duration = 1.0
    """Time from frame to frame, s."""
    shutter: Shutter = Field(default_factory=lambda data: data["interval"])
    """Time that the shutter is open, s, at most interval. Default: interval."""
    samples: Samples = "auto"
    """Time samples per frame, or "auto": as many as the motion needs, at most about one per px."""
    sampling: Literal["midpoint", "endpoint"] = "midpoint"
    """Position of each time sample in its share of the exposure."""
    shutter_curve: ShutterCurve = "box"
    """Share of the light that the shutter lets through from its opening to its closing: box; trapezoid, which opens
    over the first quarter and closes over the last; triangle; or weights at equal times, linear between them, the first
    as it opens and the last as it closes."""
    shutter_start: Start = 0.0
    """Time at which the shutter of a frame opens, s after the frame's own; -shutter / 2 centers it there."""

    readout: Readout = 0.0
    """Time from the opening of the shutter for the first row to that for the last one, s; 0: for all at once."""
    scan: Scan = "top_to_bottom"
    """Order in which rows, or columns, are exposed, each of them for shutter; only with a readout."""

    @field_validator("shutter")
    @classmethod
    def _within_interval(cls, value: float, info: ValidationInfo) -> float:
        interval = info.data.get("interval", math.inf)
        if value > interval:
            raise fault(f"must be at most interval = {interval:g} s")
        return value

    @property
    def rolls(self) -> bool:
        """True if rows or columns are exposed one after another (rolling shutter)."""
        return self.readout > 0.0

    @property
    def by_columns(self) -> bool:
        """True if the shutter exposes columns, not rows, one after another."""
        return self.scan in ("left_to_right", "right_to_left")

    @field_validator("shutter_curve", "readout")
    @classmethod
    def _at_midpoints(cls, value: ShutterCurve | float, info: ValidationInfo) -> ShutterCurve | float:
        if value not in ("box", 0.0) and info.data.get("sampling") == "endpoint":
            raise fault('belongs to sequence.sampling = "midpoint", not "endpoint"')
        return value
