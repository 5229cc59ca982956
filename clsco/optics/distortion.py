"""Distortion of the image by a lens, its inverse and its Jacobian (float64, pure)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clsco.records import START
from clsco.scene.lens import Lens
from clsco.scene.model import Camera

Array = NDArray[np.float64]
FOLDED = 1e-9  # least determinant of the Jacobian: it is smaller where the image folds back
NEGLIGIBLE = 1e-30  # of a polynomial's largest coefficient: smaller ones only add roots at slopes that no ray has
LEAST_STRETCH = 0.05  # local scale of the image along some direction below which the image is about to fold back
MOST_STEPS = 30  # largest number of steps of Newton's method
CLOSE = 1e-14  # change of slopes by the last step of Newton's method
NEARLY = 1e-7  # change of slopes after which one more step ends at CLOSE: convergence is quadratic
NODES = 64  # number of positions at which `Distortion.start` is fitted


@dataclass(frozen=True)
class Distortion:
    """Polynomial distortion of Brown and Conrady, in the direction of OpenCV: from undistorted to distorted slopes.

    With x = X / Z to the right, y = Y / Z up, r^2 = x^2 + y^2 and q = 1 + k1 r^2 + k2 r^4 + k3 r^6

        x_d = x q + 2 p1 x y + p2 (r^2 + 2 x^2),   y_d = y q + p1 (r^2 + 2 y^2) + 2 p2 x y.

    `radial` is k1, k2, k3, `tangential` p1, p2: p1 for y up, the negative of OpenCV's, whose y goes down. The mapping
    is the gradient of a potential: its Jacobian is symmetric, and has no eigenvalue below min(q, q + 2 r^2 dq/d(r^2)) -
    6 |p| r (Weyl). The mapping is one-to-one up to the r at which this bound reaches 0. Beyond `reach`, which is
    slightly smaller, it is continued linearly, so that points far outside of the frame stay outside.
    """

    radial: tuple[float, float, float]
    tangential: tuple[float, float] = (0.0, 0.0)

    @classmethod
    def of(cls, lens: Lens | None) -> Self | None:
        """The distortion of a scene's lens, or None."""
        if lens is None or not lens.distorts:
            return None
        return cls._cached(tuple(lens.radial), tuple(lens.tangential))

    @classmethod
    @lru_cache(maxsize=64)
    def _cached(cls, radial: tuple[float, float, float], tangential: tuple[float, float]) -> Self:
        """The distortion for OpenCV's coefficients, cached with its `reach` for all frames."""
        return cls(radial, (-tangential[0], tangential[1]))

    @cached_property
    def reach(self) -> float:
        """Undistorted slope up to which the polynomials are valid; infinite if the image never folds back."""
        (k1, k2, k3), turn = self.radial, -6.0 * float(np.hypot(*self.tangential))
        ends = []
        for a, b, c in ((k1, k2, k3), (3.0 * k1, 5.0 * k2, 7.0 * k3)):
            terms = np.array([c, 0.0, b, 0.0, a, turn, 1.0 - LEAST_STRETCH])
            roots = np.roots(np.where(np.abs(terms) < NEGLIGIBLE * np.abs(terms).max(), 0.0, terms))
            ends += roots.real[(np.abs(roots.imag) <= 1e-9 * np.abs(roots)) & (roots.real > 0.0)].tolist()
        return min(ends, default=np.inf)

    @property
    def image_reach(self) -> float:
        """Distorted slope within which every point is the image of a point within `reach`."""
        if self.reach == np.inf:
            return np.inf
        squared = self.reach**2
        return float(self.reach * self._q(squared)[0] - 3.0 * np.hypot(*self.tangential) * squared)

    def _q(self, squared: Array | float) -> tuple[Array, Array, Array]:
        """The factor q, and its first and second derivatives with respect to r^2."""
        (k1, k2, k3), s = self.radial, np.asarray(squared, dtype=np.float64)
        return 1.0 + s * (k1 + s * (k2 + s * k3)), k1 + s * (2.0 * k2 + s * (3.0 * k3)), 2.0 * k2 + s * (6.0 * k3)

    def image(self, x: ArrayLike, y: ArrayLike) -> tuple[Array, Array]:
        """Distorted slopes from undistorted slopes x and y, which broadcast."""
        x, y = (np.asarray(slope, dtype=np.float64) for slope in (x, y))
        within = np.minimum(1.0, self.reach / np.maximum(np.hypot(x, y), 1e-300))
        at_x, at_y = x * within, y * within
        across, up = self._polynomial(at_x, at_y)
        return across + (x - at_x), up + (y - at_y)

    def _polynomial(self, x: Array, y: Array) -> tuple[Array, Array]:
        (up, across), squared = self.tangential, x * x + y * y
        q, along = self._q(squared)[0], 2.0 * (across * x + up * y)
        return x * q + along * x + across * squared, y * q + along * y + up * squared

    def undistorted(self, x: ArrayLike, y: ArrayLike) -> tuple[Array, Array]:
        """Undistorted slopes from distorted slopes x and y, which broadcast, by Newton's method, starting at (x, y).

        Accurate to 1e-14 within `image_reach`; beyond it, the method does not converge, and the result is a slope
        beyond `reach`.
        """
        target_x, target_y = np.broadcast_arrays(*(np.asarray(slope, dtype=np.float64) for slope in (x, y)))
        at_x, at_y = target_x.copy(), target_y.copy()
        for _ in range(MOST_STEPS):
            within = np.minimum(1.0, self.reach / np.maximum(np.hypot(at_x, at_y), 1e-300))
            at_x, at_y = at_x * within, at_y * within
            step_x, step_y = self._step(at_x, at_y, target_x, target_y)
            at_x, at_y = at_x + step_x, at_y + step_y
            if max(np.abs(step_x).max(initial=0.0), np.abs(step_y).max(initial=0.0)) <= CLOSE:
                break
        return at_x, at_y

    def _step(self, x: Array, y: Array, target_x: Array, target_y: Array) -> tuple[Array, Array]:
        """Step of Newton's method from (x, y) towards the target's distorted slopes."""
        across, up = self._polynomial(x, y)
        return self.solved(x, y, target_x - across, target_y - up)

    def start(self, radius: float) -> Array:
        """Coefficients (START,) of a polynomial in r_d^2, with which devices start Newton's method.

        Distorted slopes up to `radius`, times the polynomial, are nearly the undistorted slopes without the tangential
        part.
        """
        squared = (radius * np.sin(0.25 * np.pi * (2.0 * np.arange(NODES) + 1.0) / NODES)) ** 2
        distorted = np.sqrt(squared)
        scale = type(self)(self.radial).undistorted(distorted, np.zeros(NODES))[0] / distorted
        fitted = np.polynomial.Chebyshev.fit(squared, scale, START - 1, domain=[0.0, radius**2])
        return np.asarray(fitted.convert(domain=[-1.0, 1.0], kind=np.polynomial.Polynomial).coef)

    def steps_to(self, radius: float) -> int:
        """Number of steps of Newton's method from `start` to CLOSE, for distorted slopes up to `radius`."""
        angle = np.linspace(0.0, 2.0 * np.pi, 65 if any(self.tangential) else 2)
        distorted = np.linspace(0.0, radius, 65)[:, None]
        target_x, target_y = distorted * np.cos(angle), distorted * np.sin(angle)
        scale = np.polynomial.polynomial.polyval(target_x**2 + target_y**2, self.start(radius))
        x, y = target_x * scale, target_y * scale
        bent_x, bent_y = type(self)((0.0, 0.0, 0.0), self.tangential)._polynomial(x, y)
        x, y = x - (bent_x - x), y - (bent_y - y)
        for count in range(1, MOST_STEPS):
            step_x, step_y = self._step(x, y, target_x, target_y)
            x, y = x + step_x, y + step_y
            if max(np.abs(step_x).max(), np.abs(step_y).max()) <= NEARLY:
                return count
        return MOST_STEPS

    def jacobian(self, x: ArrayLike, y: ArrayLike) -> tuple[Array, Array, Array]:
        """Derivatives xx, xy, yy of distorted with respect to undistorted slopes, at undistorted slopes."""
        x, y = (np.asarray(slope, dtype=np.float64) for slope in (x, y))
        (up, across), (q, slope, _) = self.tangential, self._q(x * x + y * y)
        along = 2.0 * (across * x + up * y)
        return (
            q + 2.0 * x * x * slope + along + 4.0 * across * x,
            2.0 * (x * y * slope + across * y + up * x),
            q + 2.0 * y * y * slope + along + 4.0 * up * y,
        )

    def solved(self, x: Array, y: Array, right: Array, upwards: Array) -> tuple[Array, Array]:
        """Change of undistorted slopes that changes distorted slopes by (right, upwards); x, y: undistorted slopes."""
        xx, xy, yy = self.jacobian(x, y)
        over = 1.0 / (xx * yy - xy * xy)
        return (yy * right - xy * upwards) * over, (xx * upwards - xy * right) * over

    def stretch(self, x: ArrayLike, y: ArrayLike) -> Array:
        """Square root of the Jacobian's determinant: sizes in the image relative to those without distortion."""
        xx, xy, yy = self.jacobian(x, y)
        return np.asarray(np.sqrt(xx * yy - xy * xy))

    def ellipticity(self, x: ArrayLike, y: ArrayLike) -> Array:
        """Relative excess of the longer axis of a small disc's image over the disc of the same area as the image."""
        xx, xy, yy = self.jacobian(x, y)
        size, half = np.sqrt(np.maximum(xx * yy - xy * xy, FOLDED)), np.hypot(0.5 * (xx - yy), xy)
        return np.asarray((0.5 * (xx + yy) + half) / size - 1.0)

    def stretch_slope(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Relative change of `stretch` per unit of undistorted slope, along x and y."""
        (up, across), (_, slope, bend) = self.tangential, self._q(x * x + y * y)
        xx, xy, yy = self.jacobian(x, y)
        xxx, yyy = (6.0 * slope + 4.0 * x * x * bend) * x, (6.0 * slope + 4.0 * y * y * bend) * y
        xxy, xyy = 2.0 * y * (slope + 2.0 * x * x * bend), 2.0 * x * (slope + 2.0 * y * y * bend)
        xxx, xxy, xyy, yyy = xxx + 6.0 * across, xxy + 2.0 * up, xyy + 2.0 * across, yyy + 6.0 * up
        half = 0.5 / (xx * yy - xy * xy)
        return half * (xxx * yy + xx * xyy - 2.0 * xy * xxy), half * (xxy * yy + xx * yyy - 2.0 * xy * xyy)


class DistortedCamera(Camera):
    """A camera whose lens distorts the image."""

    distortion: Distortion
    """Distortion of the slopes of the camera's rays."""


def with_distortion(camera: Camera, lens: Lens | None) -> Camera:
    """The camera with the distortion of its lens; unchanged if the lens does not distort."""
    distortion = Distortion.of(lens)
    if distortion is None:
        return camera
    return DistortedCamera.model_construct(**dict(camera) | {"distortion": distortion})


def distortion_of(camera: Camera) -> Distortion | None:
    """Distortion of a camera, or None."""
    return camera.distortion if isinstance(camera, DistortedCamera) else None
