"""Static rotations of objects: Euler angles, an axis with an angle, or a quaternion."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache
from typing import Annotated, Any

from pydantic import BeforeValidator, TypeAdapter

from clsco.scene.quantities import Angle, Direction, Quaternion, Strict, Triple, Vector, as_python, fault

Rows = tuple[Vector, Vector, Vector]  # rows of a matrix
EulerAngles = Annotated[tuple[Angle, Angle, Angle], Triple]


class AxisAngle(Strict):
    """A rotation about one axis."""

    axis: Direction
    """Axis: right, up, towards the camera; of any length."""
    angle: Angle
    """Angle, in the sense of an angular velocity along the axis; deg."""


class UnitQuaternion(Strict):
    """A rotation as a quaternion."""

    quaternion: Quaternion
    """w, x, y, z = cos(angle / 2), sin(angle / 2) axis; of any length, as it is normalized."""


@cache
def _euler_angles() -> TypeAdapter[Any]:
    return TypeAdapter(EulerAngles)


def _one_form(value: Any) -> Any:
    """Validate a rotation only in the form in which it is given, so that faults in other forms are not reported."""
    value = as_python(value)
    if isinstance(value, AxisAngle | UnitQuaternion):
        return value
    if isinstance(value, Mapping) and value:
        if value.keys() <= AxisAngle.model_fields.keys():
            return AxisAngle.model_validate(dict(value))
        if value.keys() == UnitQuaternion.model_fields.keys():
            return UnitQuaternion.model_validate(dict(value))
    if isinstance(value, list | tuple) and len(value) == 3:
        return _euler_angles().validate_python(value, strict=True)
    raise fault("must be a list of 3 angles, {axis, angle} or {quaternion}")


Rotation = Annotated[EulerAngles | AxisAngle | UnitQuaternion, BeforeValidator(_one_form)]


def rotation_rows(rotation: EulerAngles | AxisAngle | UnitQuaternion | None) -> Rows:
    """Rows of the matrix of a static rotation, in the frame x right, y up, z away from the camera; None: no rotation.

    Exact for quarter turns about x, y and z. Euler angles are applied in the order x, y, z, in the sense of a motion
    (2.14 to 2.23), whose z axis points to the camera: seen from the camera, a positive angle about x turns the top
    away, about y it brings the right side nearer, about z it turns clockwise. Validated against
    `clsco.optics.motion.rotation_matrix`.
    """
    if rotation is None:
        return ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    if isinstance(rotation, AxisAngle):
        return _about(rotation.axis, rotation.angle)
    if isinstance(rotation, UnitQuaternion):
        w, *axis = rotation.quaternion
        size = math.hypot(*rotation.quaternion)
        return quaternion_rows(w / size, axis[0] / size, axis[1] / size, -axis[2] / size)
    about_x, about_y, about_z = (
        _about((float(k == 0), float(k == 1), float(k == 2)), angle) for k, angle in enumerate(rotation)
    )
    return _product(about_z, _product(about_y, about_x))


def depth_row(rotation: EulerAngles | AxisAngle | UnitQuaternion | None) -> Vector:
    """Last row of `rotation_rows`: its scalar product with a point is z of the rotated point, away from the camera."""
    return rotation_rows(rotation)[2]


def after(first: Vector | None, then: EulerAngles | AxisAngle | UnitQuaternion | None) -> Any:
    """Rotation by Euler angles `first`, deg, followed by the rotation `then`; None if both are None."""
    if first is None or then is None:
        return then if first is None else first
    (a, b, c), (d, e, f), (g, h, i) = _product(rotation_rows(then), rotation_rows(first))
    # The lines are 4 (w, x, y, z), multiplied by w, x, y and z; the line with the largest factor is used, as it has the
    # least rounding errors. Here z points away from the camera.
    lines = (
        (1.0 + a + e + i, h - f, c - g, d - b),
        (h - f, 1.0 + a - e - i, d + b, c + g),
        (c - g, d + b, 1.0 - a + e - i, h + f),
        (d - b, c + g, h + f, 1.0 - a - e + i),
    )
    w, x, y, z = max(enumerate(lines), key=lambda line: line[1][line[0]])[1]
    size = math.hypot(w, x, y, z)
    return UnitQuaternion(quaternion=(w / size, x / size, y / size, -z / size))


def _about(axis: Vector, degrees: float) -> Rows:
    """Rotation matrix by Rodrigues' formula; axis: right, up, towards the camera, of any length."""
    size = math.hypot(*axis)
    x, y, z = axis[0] / size, axis[1] / size, -axis[2] / size
    sine, cosine = _sine_cosine(math.fmod(degrees, 360.0))
    rest = 1.0 - cosine
    return (
        (1.0 - rest * (y * y + z * z), rest * x * y - sine * z, rest * x * z + sine * y),
        (rest * x * y + sine * z, 1.0 - rest * (x * x + z * z), rest * y * z - sine * x),
        (rest * x * z - sine * y, rest * y * z + sine * x, 1.0 - rest * (x * x + y * y)),
    )


def _sine_cosine(degrees: float) -> tuple[float, float]:
    """Sine and cosine, exact for quarter turns; pi/2 in float64 is slightly off, which would tilt a plane."""
    quarter = {0.0: (0.0, 1.0), 90.0: (1.0, 0.0), 180.0: (0.0, -1.0), 270.0: (-1.0, 0.0)}
    angle = math.radians(degrees)
    return quarter.get(math.fmod(degrees + 360.0, 360.0), (math.sin(angle), math.cos(angle)))


def quaternion_rows(w: float, x: float, y: float, z: float) -> Rows:
    """Matrix of a unit quaternion; x, y, z: right, up, away from the camera."""
    return (
        (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)),
        (2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)),
        (2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)),
    )


def _product(first: Rows, second: Rows) -> Rows:
    columns = tuple(zip(*second, strict=True))
    one, two, three = (tuple(sum(map(float.__mul__, row, column)) for column in columns) for row in first)
    return one, two, three  # type: ignore[return-value]
