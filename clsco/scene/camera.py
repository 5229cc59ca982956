"""Camera: section [camera] of a scene file."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Annotated, Any, Literal

from pydantic import Field, PlainSerializer, ValidationInfo, WrapValidator, field_validator

from clsco.errors import SceneError
from clsco.scene.motions import CameraMotion, CameraShake
from clsco.scene.quantities import (
    MAX_LENGTH_MM,
    MIN_LENGTH_MM,
    Deferred,
    FNumber,
    FocusDistance,
    Length,
    Resolution,
    Strict,
    fault,
    instead_of,
)


def _aperture_mm(data: dict[str, Any]) -> float:
    """Default of the aperture diameter D, mm; data: values of the keys before `aperture_diameter`."""
    return 10.0 if data["f_number"] is None else float(data["focal_length"] / data["f_number"])


def _sensor_distance_mm(data: dict[str, Any]) -> float:
    """Default of the sensor distance s, mm: 1/s = 1/f - 1/u, or without u the thesis' 21.739 mm times f / 20."""
    f, u = data["focal_length"], data["focus_distance"]
    return float(21.739 * f / 20.0 if u is None else image_distance(f, u))


def image_distance(f: float, u: float) -> float:
    """Image distance behind a lens of focal length f for an object at distance u, all in mm; 1/s = 1/f - 1/u."""
    return f if math.isinf(u) else f * u / (u - f)


class FollowedDistance(float):
    """A normalization distance that always equals the sensor distance: "sensor" in scene files."""

    __hash__ = float.__hash__

    def __eq__(self, other: object) -> bool:
        """True only for another `FollowedDistance`, since a number does not follow changes of the lens."""
        return isinstance(other, FollowedDistance) and float(self) == float(other)

    __ne__ = object.__ne__  # the negation of __eq__, unlike that of float


def _followed(value: Any, check: Callable[[Any], float], info: ValidationInfo) -> float:
    """The sensor distance as a `FollowedDistance` if the value is "sensor", else the checked value."""
    if isinstance(value, FollowedDistance) or (type(value) is str and value == "sensor"):
        return FollowedDistance(info.data.get("sensor_distance", 1.0))  # missing if it was rejected
    return float(check(value))


Normalization = Annotated[
    Length,
    WrapValidator(_followed, json_schema_input_type=Length | Literal["sensor"]),
    PlainSerializer(lambda value: "sensor" if isinstance(value, FollowedDistance) else value, when_used="json"),
]


class Camera(Strict):
    """Thin lens and detector. Give `f_number` or `aperture_diameter`, and `focus_distance` or `sensor_distance`."""

    focal_length: Length = 20.0
    """Focal length f, mm."""
    f_number: FNumber | None = None
    """f / D; instead of aperture_diameter."""
    focus_distance: FocusDistance | None = None
    """Distance u in focus, mm, greater than f, or inf; instead of sensor_distance: 1/s = 1/f - 1/u."""
    aperture_diameter: Length = Field(default_factory=_aperture_mm)
    """Aperture diameter D, mm. Default 10, or from f_number."""
    sensor_distance: Length = Field(default_factory=_sensor_distance_mm)
    """Distance s from lens to detector, mm. Default: from focus_distance, or 1.08695 f, in focus at 12.5 f."""
    normalization_distance: Normalization = Field(default_factory=lambda data: data["focal_length"])
    """Magnification normalization distance s0, mm, or "sensor" for the sensor distance, as in textbooks: x = s0 X / Z.
    Default: focal_length."""
    pixel_pitch: Length = 0.01
    """Pixel pitch p, mm."""
    resolution: Resolution | None = None
    """Columns and rows, px. Default: size of the first object's texture."""
    motion: CameraMotion = CameraMotion.model_construct()
    """Velocities of the camera itself; static if none are given."""
    shake: Annotated[CameraShake | None, Deferred()] = None
    """Shake of the camera; none if not given."""

    @property
    def moves(self) -> bool:
        """True if the camera moves or shakes."""
        return self.motion.moves or (self.shake is not None and self.shake.moves)

    @property
    def frame_size(self) -> tuple[int, int]:
        """Columns and rows, px. Raises SceneError while the resolution is unknown."""
        if self.resolution is None:
            raise SceneError("camera.resolution: must be known before a scene is planned; got None")
        return self.resolution

    @property
    def opening(self) -> float:
        """F-number f / D, from `f_number` or `aperture_diameter`."""
        return self.focal_length / self.aperture_diameter

    @property
    def focused_distance(self) -> float:
        """Distance in focus, mm, from `focus_distance` or `sensor_distance`; infinite if the detector is not beyond the
        focal length."""
        if self.focus_distance is not None:
            return self.focus_distance
        power = 1.0 / self.focal_length - 1.0 / self.sensor_distance
        return 1.0 / power if power > 0 else math.inf

    @field_validator("f_number")
    @classmethod
    def _opening_within_limits(cls, value: float | None, info: ValidationInfo) -> float | None:
        f = info.data.get("focal_length")
        if value is not None and f is not None and not MIN_LENGTH_MM <= f / value <= MAX_LENGTH_MM:
            raise fault(f"must leave an aperture between {MIN_LENGTH_MM:g} and {MAX_LENGTH_MM:g} mm")
        return value

    @field_validator("focus_distance")
    @classmethod
    def _beyond_focal_length(cls, value: float | None, info: ValidationInfo) -> float | None:
        f = info.data.get("focal_length")
        if value is None or f is None:
            return value
        if value <= f:
            hint = f"{value:g} mm ({value:g} m?)" if value < f else None
            raise fault(f"must be greater than focal_length = {f:g} mm", hint)
        if image_distance(f, value) > MAX_LENGTH_MM:
            raise fault(f"too close to focal_length = {f:g} mm: detector beyond {MAX_LENGTH_MM:g} mm")
        return value

    _one_of_a_pair = instead_of(aperture_diameter="f_number", sensor_distance="focus_distance")
