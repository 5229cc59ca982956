"""Motions of objects, groups and the camera, as scene files give them."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, Field, ValidationInfo, field_validator, model_validator

from clsco.scene.quantities import (
    Acceleration,
    AngularAcceleration,
    AngularVelocity,
    Band,
    FNumber,
    FocusDistance,
    Length,
    Point,
    Strict,
    Time,
    Vector,
    Velocity,
    Within,
    array_of_tables,
    fault,
    raise_faults,
)
from clsco.scene.rotations import EulerAngles

NONE: Vector = (0.0, 0.0, 0.0)
MAX_KEYFRAMES = 256
EVEN = 1e-6  # relative tolerance of the equal time intervals of a B-spline

Interpolation = Literal["step", "linear", "cubic", "bspline"]
Outside = Literal["hold", "linear", "error"]


class Keyframe(Strict):
    """Pose of an object or camera at one time."""

    time: Time
    """Time, s; later than that of the keyframe before."""
    position: Point = NONE
    """Displacement from the reference pose, in the directions of velocity; mm."""
    rotation: EulerAngles = NONE
    """Rotation from the reference pose as motion.rotation says, about the axes of angular_velocity; deg."""


def in_order(value: Any) -> Any:
    """Reject keyframes that are not later than the previous keyframe."""
    late = [k for k, (one, next_one) in enumerate(pairwise(value), 1) if not next_one.time > one.time]
    raise_faults(*(((k, "time"), "must be later than that of the keyframe before", value[k].time) for k in late))
    return value


def default_of_keyframes(value: str) -> Any:
    """Field of a key that belongs to the table's keyframes: by default `value`, or None if there are none."""
    return Field(default_factory=lambda data: None if data["keyframe"] is None else value)


def check_interpolation(value: Any, info: ValidationInfo) -> Any:
    """Reject `interpolation` and `outside` without keyframes, and "bspline" at unequal intervals of time."""
    if value is None or "keyframe" not in info.data:  # missing if it was rejected
        return value
    if (keyframes := info.data["keyframe"]) is None:
        raise fault("belongs to keyframes; there are none")
    steps = [later.time - earlier.time for earlier, later in pairwise(keyframes)]
    if value == "bspline" and steps and max(steps) - min(steps) > EVEN * min(steps):
        raise fault("bspline needs keyframes at equal intervals of time")
    return value


LISTED = array_of_tables("...keyframe", "keyframes", MAX_KEYFRAMES, least=1)
SCHEMA = Field(json_schema_extra={"minItems": 1, "maxItems": MAX_KEYFRAMES})
Keyframes = Annotated[tuple[Keyframe, ...], SCHEMA, AfterValidator(in_order), LISTED]


class ObjectMotion(Strict):
    """Motion of an object, which rotates about its origin: velocities at t = 0 and accelerations, or keyframes."""

    velocity: Velocity = NONE
    """Right, up, away from the camera; mm/s."""
    angular_velocity: AngularVelocity = NONE
    """About the object's axes right, up, towards the camera; deg/s."""
    acceleration: Acceleration | None = None
    """Right, up, away from the camera; mm/s^2. Default: none."""
    angular_acceleration: AngularAcceleration | None = None
    """About the axes of angular_velocity; deg/s^2. Default: none."""
    keyframe: Keyframes | None = None
    """Poses at 1 to 256 times, instead of velocities and accelerations; none if not given."""
    interpolation: Interpolation | None = default_of_keyframes("cubic")
    """Path between keyframes: natural cubic splines through all of them, lines, steps, or uniform cubic B-splines,
    which pass near them. Default: cubic."""
    outside: Outside | None = default_of_keyframes("hold")
    """Path before the first and after the last keyframe: hold their poses, go on as fast as there, or refuse exposures
    at such times. Default: hold."""

    @field_validator("keyframe")
    @classmethod
    def _instead_of_velocities(cls, value: Keyframes | None, info: ValidationInfo) -> Keyframes | None:
        keys = ("velocity", "angular_velocity", "acceleration", "angular_acceleration")
        others = [key for key in keys if any(info.data.get(key) or NONE)]
        if value is not None and others:
            raise fault(f"give keyframes or {others[0]}, not both", got=f"{len(value)} keyframes")
        return value

    _of_keyframes = field_validator("interpolation", "outside")(check_interpolation)

    @property
    def moves(self) -> bool:
        """True if any component of a velocity, an acceleration or a keyframe differs from 0."""
        if not self.model_fields_set:  # fast path, as each frame calls this dozens of times
            return False
        shifts = (key.position for key in self.keyframe or ())
        return any(map(any, (self.velocity, self.acceleration or NONE, *shifts))) or any(self.turns)

    @property
    def is_uniform(self) -> bool:
        """True if velocities are constant."""
        return self.keyframe is None and not any((*(self.acceleration or NONE), *(self.angular_acceleration or NONE)))

    @property
    def turns(self) -> tuple[bool, bool, bool]:
        """For each axis x, y, z: True if the object rotates about it."""
        turned = (key.rotation for key in self.keyframe or ())
        x, y, z = map(any, zip(self.angular_velocity, self.angular_acceleration or NONE, *turned, strict=True))
        return x, y, z


class CameraMotion(ObjectMotion):
    """Motion of the camera, which rotates about the center of its lens: velocities at t = 0 and constant accelerations,
    or keyframes."""

    velocity: Velocity = NONE
    """Right, up, forwards; mm/s."""
    angular_velocity: AngularVelocity = NONE
    """About the axes right, up, backwards, in the sense of an object's; deg/s."""
    acceleration: Acceleration | None = None
    """Right, up, forwards; mm/s^2. Default: none."""


class CameraShake(Strict):
    """Shake of a camera that is held by hand, besides its motion: sums of sines with frequencies in a band."""

    rotation_rms: Annotated[float, Within(0.0, 45.0, "deg")] = 0.02
    """Root mean square of the angle by which it is turned, over a long time; deg."""
    translation_rms: Annotated[float, Within(0.0, 1e6, "mm")] = 0.0
    """Root mean square of the distance by which it is moved, over a long time; mm."""
    band: Band = (2.0, 15.0)
    """Least and largest frequency, Hz."""
    seed: Annotated[int, Within(0, 2**63 - 1)] = 1
    """Seed of the frequencies and phases: another one is another path."""

    @property
    def moves(self) -> bool:
        """True if the shake turns or moves the camera."""
        return self.rotation_rms > 0.0 or self.translation_rms > 0.0


class LensKeyframe(Strict):
    """Focal length, focus distance or f-number of the lens at one time."""

    time: Time
    """Time, s; later than that of the keyframe before."""
    focal_length: Length | None = None
    """Focal length, mm: a zoom, which scales the image in proportion. Default: interpolated between other keyframes."""
    focus_distance: FocusDistance | None = None
    """Distance in focus, mm, greater than the focal length. Default: interpolated between other keyframes."""
    f_number: FNumber | None = None
    """Focal length / aperture diameter. Default: interpolated between other keyframes."""

    @model_validator(mode="after")
    def _something(self) -> Self:
        if self.focal_length is None and self.focus_distance is None and self.f_number is None:
            raise fault("must have focal_length, focus_distance or f_number", got="none")
        return self


LensKeyframes = Annotated[tuple[LensKeyframe, ...], SCHEMA, AfterValidator(in_order), LISTED]
