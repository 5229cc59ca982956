"""Wavefront errors of a lens as Zernike polynomials and Seidel's terms (float64, pure).

Optical paths W are in px, waves times Q, so that one wavefront serves all wavelengths; a ray through l arrives at R l +
2 grad W px. Axes of an image: x to the right, y down.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from math import factorial, sqrt

import numpy as np

from clsco.optics.pupils.pupil import Array

ON_RADIUS, ON_CIRCLE = 65, 128  # positions where the steepest slope is searched; for most terms, it is at the rim
LEAST_AREA = 1e-3  # least area of the image of a small patch, relative to its area without aberrations
STEP, BESIDE = 1e-4, 1e-3  # steps of finite differences, for slopes of polynomials and for changes of slopes


@dataclass(frozen=True)
class Wavefront:
    """Optical path through a lens, minus that of a sphere around the image of a point.

    zernike: n, m and the rms over the lens in px of each polynomial. spherical: Seidel's W040 in px, coefficient of the
    fourth power of the distance from the lens's center. coma: Seidel's W131 in px, right and down: path (x^2 + y^2)
    (coma . (x, y)). bend: xx, xy and yy of the path xx x^2 + 2 xy x y + yy y^2 in px: astigmatism and field curvature
    at a position in the frame. change: derivatives over the frame, px per px: of coma, in the direction away from the
    middle; half of the derivative of astigmatism, right and down; half of that of field curvature, right and down.
    """

    zernike: tuple[tuple[int, int, float], ...] = ()
    spherical: float = 0.0
    coma: tuple[float, float] = (0.0, 0.0)
    bend: tuple[float, float, float] = (0.0, 0.0, 0.0)
    change: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)

    @property
    def is_flat(self) -> bool:
        """True for a perfect lens."""
        return not (self.zernike or self.spherical or any(self.coma) or any(self.bend))

    @property
    def upright(self) -> Wavefront:
        """The wavefront in an orientation that all its mirror images share; itself if it has Zernike polynomials."""
        if self.zernike:
            return self
        (right, down), (xx, xy, yy), (coma, *others) = self.coma, self.bend, self.change
        x, y = (-1.0 if turned else 1.0 for turned in self.mirrored)
        change = coma, x * others[0], y * others[1], x * others[2], y * others[3]
        return replace(self, coma=(x * right, y * down), bend=(xx, x * y * xy, yy), change=change)

    @property
    def mirrored(self) -> tuple[bool, bool]:
        """Two flags: True if `upright` is this wavefront mirrored horizontally; True if vertically."""
        _, *ways = self.change
        right, down = next((way for way in (self.coma, ways[:2], ways[2:]) if any(way)), (0.0, 0.0))
        return right < 0.0 or (right == down == 0.0 and self.bend[1] < 0.0), down < 0.0

    def path(self, x: Array, y: Array) -> Array:
        """Optical path in px at lens points, which broadcast."""
        square, (right, down), (xx, xy, yy) = x * x + y * y, self.coma, self.bend
        total = square * (self.spherical * square + right * x + down * y) + xx * x * x + 2.0 * xy * x * y + yy * y * y
        return np.asarray(total + self._polynomials(x, y) if self.zernike else total)

    def gradient(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Derivatives of the path to the right and down at lens points, px per lens radius."""
        square, (right, down), (xx, xy, yy) = x * x + y * y, self.coma, self.bend
        along = 4.0 * self.spherical * square + 2.0 * (right * x + down * y)
        across = along * x + right * square + 2.0 * (xx * x + xy * y)
        below = along * y + down * square + 2.0 * (xy * x + yy * y)
        if not self.zernike:
            return across, below
        changes = self._polynomials(x + STEP, y) - self._polynomials(x - STEP, y)
        deeper = self._polynomials(x, y + STEP) - self._polynomials(x, y - STEP)
        return across + changes / (2.0 * STEP), below + deeper / (2.0 * STEP)

    def grown(self, x: Array, y: Array) -> Array:
        """Factor by which a small part of the image is enlarged for rays through lens points: the determinant of
        `_stretch`. Light times this factor keeps a uniform image uniform.
        """
        xx, xy, yx, yy = self._stretch(x, y)
        return np.maximum(xx * yy - xy * yx, 0.0)

    def crossings(self, x: Array, y: Array) -> tuple[Array, Array]:
        """For rays through lens points: the displacement from their source to where they pass an occluder, divided by
        (R - R of the occluder).

        The occluder's image is displaced by the wavefront at its own position in the frame.
        """
        xx, xy, yx, yy = self._stretch(x, y)
        area = np.maximum(xx * yy - xy * yx, LEAST_AREA)  # no light arrives where the image folds
        return (yy * x - xy * y) / area, (xx * y - yx * x) / area

    def _stretch(self, x: Array, y: Array) -> tuple[Array, Array, Array, Array]:
        """Derivatives xx, xy, yx, yy, over the frame, of the positions at which rays through lens points arrive."""
        coma, right, down, outward, below = self.change
        even = 1.0 + 2.0 * coma * (x * x + y * y) + 4.0 * (right * x + down * y)
        at_x, at_y = 4.0 * (coma * x + right), 4.0 * (coma * y + down)
        return (
            even + (at_x + 8.0 * outward) * x,
            at_x * y + 8.0 * below * x,
            at_y * x + 8.0 * outward * y,
            even + (at_y + 8.0 * below) * y,
        )

    def curvature(self, x: Array, y: Array) -> tuple[Array, Array, Array]:
        """Second derivatives xx, xy, yy of the path at lens points, x right and y down, px per squared lens radius."""
        right, down = self.gradient(x, y)
        (beside, lower), (_, below) = self.gradient(x + BESIDE, y), self.gradient(x, y + BESIDE)
        return (beside - right) / BESIDE, (lower - down) / BESIDE, (below - down) / BESIDE

    def _polynomials(self, x: Array, y: Array) -> Array:
        return np.asarray(sum(size * zernike(n, m, x, y) for n, m, size in self.zernike))

    @property
    def slope(self) -> float:
        """Largest derivative of the path along the lens, px per radius."""
        return 0.0 if self.is_flat else _slope(self)


@lru_cache(maxsize=64)
def _slope(wavefront: Wavefront) -> float:
    radius, angle = np.linspace(0.0, 1.0, ON_RADIUS)[:, None], np.arange(ON_CIRCLE) * (2.0 * np.pi / ON_CIRCLE)
    x, y = radius * np.cos(angle), radius * np.sin(angle)
    return float(np.hypot(*wavefront.gradient(x, y)).max())


def zernike(n: int, m: int, x: Array, y: Array) -> Array:
    """Zernike polynomial in the standard of OSA and ANSI Z80.28, with rms 1 over the unit circle.

    n: radial order; m: angular frequency, |m| <= n and n - m even: cosines if positive, sines if negative. Angles are
    counter-clockwise from the right, in the image of a far light. x, y: lens points, right and down.
    """
    order, square = abs(m), x * x + y * y
    radial: Array | float = 0.0
    for k in range((n - order) // 2 + 1):
        factor = factorial(n - k) // (factorial(k) * factorial((n + order) // 2 - k) * factorial((n - order) // 2 - k))
        radial = radial + (-1) ** k * factor * square ** ((n - order) // 2 - k)
    turned = (x - 1j * y) ** order  # rho^order at the angle counter-clockwise
    return np.asarray(sqrt((2.0 if m else 1.0) * (n + 1)) * radial * (turned.real if m >= 0 else turned.imag))
