"""Motions of objects, groups and the camera, as scene files give them."""

from __future__ import annotations

from clsco.scene.quantities import Acceleration, AngularAcceleration, AngularVelocity, Strict, Vector, Velocity

NONE: Vector = (0.0, 0.0, 0.0)


class ObjectMotion(Strict):
    """Velocities of an object at t = 0, which rotates about its origin, and constant accelerations."""

    velocity: Velocity = NONE
    """Right, up, away from the camera; mm/s."""
    angular_velocity: AngularVelocity = NONE
    """About the object's axes right, up, towards the camera; deg/s."""
    acceleration: Acceleration | None = None
    """Right, up, away from the camera; mm/s^2. Default: none."""
    angular_acceleration: AngularAcceleration | None = None
    """About the axes of angular_velocity; deg/s^2. Default: none."""

    @property
    def moves(self) -> bool:
        """True if any component of a velocity or an acceleration differs from 0."""
        return any(self.velocity) or any(self.acceleration or NONE) or any(self.turns)

    @property
    def turns(self) -> tuple[bool, bool, bool]:
        """True for each axis about which it rotates."""
        x, y, z = map(any, zip(self.angular_velocity, self.angular_acceleration or NONE, strict=True))
        return x, y, z


class CameraMotion(ObjectMotion):
    """Velocities of the camera at t = 0, which rotates about the center of its lens, and constant accelerations."""

    velocity: Velocity = NONE
    """Right, up, forwards; mm/s."""
    angular_velocity: AngularVelocity = NONE
    """About the axes right, up, backwards, in the sense of an object's; deg/s."""
    acceleration: Acceleration | None = None
    """Right, up, forwards; mm/s^2. Default: none."""
