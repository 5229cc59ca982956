"""Paths through keyframes, evaluated directly at any time (float64, pure).

Between two keys a path is a polynomial of degree 3 or less. Orientations are unit quaternions q_k, and their path is
q(t) = q_0 exp(c_1(t) w_1) ... exp(c_n(t) w_n) with the rotation vectors w_k = log(q_(k-1)^-1 q_k), where c_k is the
path through the numbers 0 at keys before key k and 1 from key k on (Kim, Kim and Shin, "A general construction scheme
for unit quaternion curves with simple high order derivatives", SIGGRAPH 1995). With linear paths this is spherical
linear interpolation; with cubics and B-splines it is as smooth as the path of positions, through the same keys.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import acos, asin, atan2, cos, degrees, fmod, hypot, radians, sin

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clsco.scene.motions import Interpolation, Outside
from clsco.scene.quantities import Vector
from clsco.scene.rotations import quaternion_rows

Array = NDArray[np.float64]
Quaternion = tuple[float, float, float, float]
"""w, x, y, z; the z axis points away from the camera, and rotations about the axes are by the right-hand rule."""
LOCKED = 1e-12  # least 1 - |sine| of a rotation about y without gimbal lock: 1e-4 deg from 90 deg
HALF_TURN = 1e-9  # least |w| of a rotation whose direction is defined: 1e-7 deg from 180 deg


@dataclass(frozen=True, eq=False)
class Path:
    """Path of a vector through keys at `times` (n,) in s.

    pieces: coefficients (n + 1, 4, size) of the polynomials before the first key, between keys, and after the last one,
    in powers of the time since the preceding key (before the first key: relative to the first).
    """

    times: Array
    pieces: Array

    def at(self, time: float) -> Array:
        """Value (size,) at a time in s."""
        piece = int(np.searchsorted(self.times, time, side="right"))
        since, (c0, c1, c2, c3) = time - self.times[max(piece - 1, 0)], self.pieces[piece]
        return np.asarray(c0 + since * (c1 + since * (c2 + since * c3)))


def path_through(times: ArrayLike, values: ArrayLike, interpolation: Interpolation, outside: Outside) -> Path:
    """Path through keys with `values` (n, size) at `times` (n,) in s, increasing; equally spaced for a B-spline.

    "step": the value of the latest key. "linear": lines. "cubic": the natural spline, whose second derivative is
    continuous, and 0 at the ends. "bspline": a uniform cubic B-spline with the keys as control points; it passes
    through the first and the last. Outside of the keys, "hold": the value of the first or the last key; "linear",
    "error": a line with the velocity at that key.
    """
    t, v = np.asarray(times, dtype=np.float64), np.asarray(values, dtype=np.float64)
    pieces = np.zeros((len(t) + 1, 4, v.shape[1]))
    pieces[1:, 0], pieces[0, 0] = v, v[0]
    if interpolation == "step" or len(t) == 1:
        return Path(t, pieces)
    steps = np.diff(t)[:, None]
    if interpolation == "linear":
        pieces[1:-1, 1] = np.diff(v, axis=0) / steps
    elif interpolation == "cubic":
        bends = _second_derivatives(steps, v)
        pieces[1:-1, 1] = np.diff(v, axis=0) / steps - steps * (2.0 * bends[:-1] + bends[1:]) / 6.0
        pieces[1:-1, 2], pieces[1:-1, 3] = 0.5 * bends[:-1], np.diff(bends, axis=0) / (6.0 * steps)
    else:
        # Control points beyond the ends extend lines: paths begin at the first key, with the mean velocity to the next.
        a, b, c, d = (np.concatenate([[2 * v[0] - v[1]], v, [2 * v[-1] - v[-2]]])[k : k + len(steps)] for k in range(4))
        pieces[1:-1, 0], pieces[1:-1, 1] = (a + 4.0 * b + c) / 6.0, (c - a) / (2.0 * steps)
        pieces[1:-1, 2] = (a - 2.0 * b + c) / (2.0 * steps**2)
        pieces[1:-1, 3] = (d - a + 3.0 * (b - c)) / (6.0 * steps**3)
    if outside != "hold":
        _, c1, c2, c3 = pieces[-2]
        pieces[0, 1], pieces[-1, 1] = pieces[1, 1], c1 + steps[-1] * (2.0 * c2 + 3.0 * steps[-1] * c3)
    return Path(t, pieces)


def _second_derivatives(steps: Array, values: Array) -> Array:
    """Second derivatives (n, size) of the natural cubic spline at its keys, by elimination (Thomas).

    steps: times between keys, s, (n - 1, 1).
    """
    slopes, bends = np.diff(values, axis=0) / steps, np.zeros_like(values)
    right, diagonal = 6.0 * np.diff(slopes, axis=0), 2.0 * (steps[:-1] + steps[1:])
    for k in range(1, len(right)):
        share = steps[k] / diagonal[k - 1]
        diagonal[k] -= share * steps[k]
        right[k] -= share * right[k - 1]
    for k in reversed(range(len(right))):
        bends[k + 1] = (right[k] - steps[k + 1] * bends[k + 2]) / diagonal[k]
    return bends


@dataclass(frozen=True, eq=False)
class Orientations:
    """Path of an orientation through keys.

    first: orientation of the first key; turns: rotation vector from each key to the next along the shorter way, rad;
    shares: path of the completed fraction (n - 1,) of each rotation.
    """

    first: Quaternion
    turns: tuple[Vector, ...]
    shares: Path

    def at(self, time: float) -> Array:
        """Rotation matrix (3, 3) at a time in s, in the axes of the camera."""
        return _matrix(self._quaternion_at(time))

    def angles_at(self, time: float, rotation: str) -> Vector:
        """Rotation at a time in s in the form of `Keyframe.rotation`, deg; a rotation vector is at most half a turn."""
        return _angles(self._quaternion_at(time), rotation)

    def _quaternion_at(self, time: float) -> Quaternion:
        quaternion = self.first
        for turn, share in zip(self.turns, self.shares.at(time).tolist(), strict=True):
            quaternion = _product(quaternion, _exponential(turn, share))
        return quaternion


def orientations_through(
    times: ArrayLike, angles: Sequence[Vector], rotation: str, interpolation: Interpolation, outside: Outside
) -> Orientations:  # fmt: skip
    """Path of an orientation through keys.

    angles: rotation of each key, deg, as Euler angles or as a rotation vector; other arguments as for `path_through`. A
    quaternion and its negative are one orientation, so from one key to the next the path turns by at most 180 deg; a
    turn of exactly 180 deg is positive about the axis whose largest component is positive (right, up, to the camera).
    """
    keys = [_quaternion(key_angles, rotation) for key_angles in angles]
    turns = [_logarithm(_product((a[0], -a[1], -a[2], -a[3]), b)) for a, b in pairwise(keys)]
    done = np.tri(len(keys), len(keys), -1)[:, : len(turns)]
    return Orientations(keys[0], tuple(turns), path_through(times, done, interpolation, outside))


def _quaternion(angles: Vector, rotation: str) -> Quaternion:
    """Quaternion of angles in deg: Euler angles about x, y and z in turn, or a rotation vector."""
    if rotation == "axis":
        size = hypot(*angles)
        scale = radians(fmod(size, 360.0)) / size if size > 0.0 else 0.0
        return _exponential((scale * angles[0], scale * angles[1], -scale * angles[2]), 1.0)
    x, y, z = (0.5 * radians(fmod(angle, 360.0)) for angle in angles)
    about_x, about_y, about_z = (cos(x), sin(x), 0.0, 0.0), (cos(y), 0.0, sin(y), 0.0), (cos(z), 0.0, 0.0, -sin(z))
    return _product(about_z, _product(about_y, about_x))


def _angles(q: Quaternion, rotation: str) -> Vector:
    """Angles in deg of an orientation, the inverse of `_quaternion`.

    If the Euler angle about y is a quarter turn, the angle about x is set to 0, as x and z are then not unique.
    """
    if rotation == "axis":
        x, y, z = _logarithm(q)
        return degrees(x), degrees(y), -degrees(z)
    m = _matrix(q)
    sine = -float(m[2, 0])
    if abs(sine) > 1.0 - LOCKED:
        return 0.0, 90.0 if sine > 0.0 else -90.0, degrees(atan2(m[0, 1], m[1, 1]))
    return degrees(atan2(m[2, 1], m[2, 2])), degrees(asin(sine)), -degrees(atan2(m[1, 0], m[0, 0]))


def _exponential(turn: Vector, share: float) -> Quaternion:
    """Quaternion of the fraction `share` of a rotation vector in rad."""
    angle = hypot(*turn)
    half = 0.5 * share * angle
    scale = sin(half) / angle if angle > 0.0 else 0.0
    return cos(half), scale * turn[0], scale * turn[1], scale * turn[2]


def _logarithm(q: Quaternion) -> Vector:
    """Rotation vector of a quaternion, rad, of at most half a turn."""
    w, x, y, z = q
    back = max((x, y, -z), key=abs) < 0.0 if abs(w) < HALF_TURN else w < 0.0
    sign, size = (-1.0 if back else 1.0), hypot(x, y, z)
    angle = 2.0 * acos(min(max(sign * w, -1.0), 1.0)) if size > 0.5 else 2.0 * float(np.arcsin(size))
    scale = sign * angle / size if size > 0.0 else 0.0
    return scale * x, scale * y, scale * z


def _product(p: Quaternion, q: Quaternion) -> Quaternion:
    """Quaternion of the rotation q followed by p."""
    (a, b, c, d), (e, f, g, h) = p, q
    return (
        a * e - b * f - c * g - d * h,
        a * f + b * e + c * h - d * g,
        a * g - b * h + c * e + d * f,
        a * h + b * g - c * f + d * e,
    )


def _matrix(q: Quaternion) -> Array:
    """Rotation matrix (3, 3) of a quaternion."""
    size = hypot(*q)
    return np.array(quaternion_rows(*(part / size for part in q)))
