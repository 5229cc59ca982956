"""Weights of pupils without symmetry for any blur radius, by differences of integrals (float64, pure)."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from functools import partial

import numpy as np

from clsco.optics.pupils.pupil import Array, Pupil

# px: weights of smaller radii follow from those of this radius, where differences are exact to 1e-14.
SMALL = 0.25
ROUNDING = 1e-14  # of an integral over a whole pupil: smaller shares are rounding errors, and count as 0
SMALL_POINT = 1e-2  # px: smaller radii of point sources are replaced by this; pixel edges are 1 / 32 px or more away


class Asymmetric(Pupil):
    """Aperture without symmetry, whose x is divided by `squeeze`, the height over width of its blur."""

    squeeze: float
    signed = True

    @property
    @abstractmethod
    def label(self) -> str:
        """Name without the squeeze."""

    @property
    def name(self) -> str:
        return self.label if self.squeeze == 1.0 else f"{self.label}, squeezed {self.squeeze:g} times"

    @property
    def extent(self) -> float:
        return max(1.0, 1.0 / self.squeeze)

    @abstractmethod
    def running_integral(self, radius: Array, x: Array, y: Array, tent: bool) -> Array:
        """Integral for `grid_share`."""

    def share(self, dx: Array, dy: Array, radius: Array, tent: bool) -> Array:
        running = partial(self.running_integral, tent=tent)
        return share_at(partial(corner_share, running, tent=tent, extent=self.extent), dx, dy, radius, tent)

    def rows(self, radii: Array, dx: Array, dy: Array, tent: bool) -> Array:
        return grid_share(partial(self.running_integral, tent=tent), radii, dx, dy, tent)


def share_at(share: Callable[[Array, Array, Array], Array], dx: Array, dy: Array, radius: Array, tent: bool) -> Array:
    """Fraction of the light in pixels, see `Pupil.share`, from a function `share` for radii that are not small.

    With `tent`, offsets are integers; else, the radius or the distance of the source from pixel edges is SMALL_POINT or
    more.
    """
    dx, dy, radius = (np.asarray(v, np.float64) for v in np.broadcast_arrays(dx, dy, radius))
    at, part = _hold(radius, tent)
    shares = share(dx, dy, at)
    small = part < 1.0
    if tent and small.any():
        x, y, r = dx[small], dy[small], at[small]
        beside = (-1.0, 0.0, 1.0)
        across = np.sum([share(x, np.full_like(y, j), r) for j in beside], axis=0)
        down = np.sum([share(np.full_like(x, i), y, r) for i in beside], axis=0)
        shares[small] = _shrunk(shares[small], across, down, 1.0 * (x == 0), 1.0 * (y == 0), part[small])
    return shares


def corner_share(
    running_integral: Callable[[Array, Array, Array], Array], dx: Array, dy: Array, radius: Array, tent: bool,
    extent: float,
) -> Array:  # fmt: skip
    """Fractions of the light in pixels at any (dx, dy) px, from the integral of `grid_share` at each pixel's corners.

    extent: extent of the blur for R = 1 px; weights beyond it are set to 0, as they are rounding errors. A negative
    radius mirrors the pupil in its center.
    """
    shape = np.broadcast_shapes(np.shape(dx), np.shape(dy), np.shape(radius))
    dx, dy, radius = (v.ravel() for v in np.broadcast_arrays(dx, dy, radius))
    far = np.abs(radius) * extent + 1.0
    near = np.flatnonzero(np.maximum(np.abs(dx), np.abs(dy)) < far)
    turn, size = np.where(radius < 0.0, -1.0, 1.0)[near], np.abs(radius[near])
    x, y = turn * dx[near], turn * dy[near]
    steps = ((-1.0, 1.0), (0.0, -2.0), (1.0, 1.0)) if tent else ((-0.5, -1.0), (0.5, 1.0))
    shares = np.zeros(near.shape)
    for down, factor_y in steps:
        for right, factor_x in steps:
            shares += factor_x * factor_y * running_integral(size, x + right, y + down)
    share = np.zeros(dx.shape)
    share[near] = np.where(shares < ROUNDING * far[near] * far[near], 0.0, shares)
    return share.reshape(shape)


def grid_share(
    running_integral: Callable[[Array, Array, Array], Array], radii: Array, dx: Array, dy: Array, tent: bool
) -> Array:
    """Fractions of the light (radii, dy, dx) for dx and dy in steps of 1 px, see `Pupil.rows`.

    running_integral(radius, x, y): integral of the normalized pupil left of x and above y; with `tent`, times the
    distances from x and y. It is evaluated once per corner: first differences over a pixel give its area in the pupil,
    second differences the overlap of a square source and a square detector.
    """
    half, order = (1.0, 2) if tent else (0.5, 1)
    at, part = _hold(radii[:, None, None], tent)
    x, y = (axis[0] - half + np.arange(len(axis) + order) for axis in (dx, dy))
    integral = running_integral(at, x[None, None, :], y[None, :, None])
    share = np.diff(np.diff(integral, order, axis=1), order, axis=2)
    share = np.where(share < ROUNDING * integral.max(axis=(1, 2), keepdims=True), 0.0, share)
    if tent:
        sums = share.sum(axis=1, keepdims=True), share.sum(axis=2, keepdims=True)
        share = np.where(part < 1.0, _shrunk(share, *sums, 1.0 * (dx == 0), 1.0 * (dy == 0)[:, None], part), share)
    return np.asarray(share)


def _hold(radius: Array, tent: bool) -> tuple[Array, Array]:
    """Radii for which integrals are computed, and the ratios of the requested radii to these."""
    least = SMALL if tent else SMALL_POINT
    used = np.where(np.abs(radius) < least, np.where(radius < 0.0, -least, least), radius)
    return used, np.abs(radius) / np.abs(used)


def _shrunk(share: Array, across: Array, down: Array, center_x: Array, center_y: Array, part: Array) -> Array:
    """Weights for the radius `part` times R, |R| = SMALL, from the weights `share` for R.

    across, down: sums of `share` over each column and over each row; center_x, center_y: 1 where dx or dy is 0, else 0.

    Within |u| < 1 px, the tents at -1, 0 and 1 are linear in u on either side of 0. So along each axis, scaling the
    blur by s gives the weights (1 - s) p + s w, where p are the weights of a point and w those of the unscaled blur.
    """
    remainder = 1.0 - part
    inner = remainder * (center_x * down + center_y * across) + part * share
    return np.asarray(remainder * remainder * center_x * center_y + part * inner)
