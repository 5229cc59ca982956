"""Base class of pupils: the interface for blur, tables and visibility tests; quadrature for several of them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Edges = tuple[tuple[float, float, float], ...]


@dataclass(frozen=True)
class Borders:
    """Edges and circles that bound an opening of constant transmission; without its holes, the opening is convex.

    columns: x of the opening's ends and corners from left to right, in aperture radii. edges: straight edges, as in
    `Pupil.edges`. circles: (x, y, radius); light passes only inside all of them. holes: circles that cover parts of the
    opening; within the opening, they do not overlap. squeeze: circles and holes are given before the squeeze: in the
    opening, their x is divided by this factor.
    """

    columns: tuple[float, ...] = (-1.0, 1.0)
    edges: Edges = ()
    circles: Edges = ()
    holes: Edges = ()
    squeeze: float = 1.0


class Pupil(ABC):
    """Aperture of a lens: its transmission at lens points l in units of the aperture's radius, x right and y down.

    A ray through l arrives at the offset R l, R the signed blur radius in px, so that a blur is the pupil scaled by R.
    Subclasses are frozen and hashable: tables of weights are cached by their fields.
    """

    uniform: ClassVar[bool] = False  # constant transmission inside the edge
    soft: ClassVar[bool] = False  # a Gaussian that falls off towards the edge, with `lengths["sigma"]`
    hollow: ClassVar[bool] = False  # constant transmission between an inner and an outer edge
    has_plain_rim: ClassVar[bool] = True  # constant inside a circle or straight edges, which give mean lens points
    bends_rays: ClassVar[bool] = False  # rays do not arrive at R l, because of wavefront errors

    @property
    def separable(self) -> bool:
        """True if the transmission is a product of one function along each axis."""
        return False

    @property
    def signed(self) -> bool:
        """True if R and -R give different blur; otherwise, the blur is symmetric in x, in y and in the diagonals."""
        return False

    @property
    def steps(self) -> int:
        """Intervals of tables per px of R, if weights are smooth in R at every scale, as for waves; else 0."""
        return 0

    @property
    def margin(self) -> float:
        """Distance in px beyond the geometric blur at which the light ends."""
        return 0.0

    @property
    def lengths(self) -> Mapping[str, float]:
        """Named lengths that describe the pupil, in aperture radii; in a blur they are R times as long."""
        return {}

    @property
    def extent(self) -> float:
        """Largest |l| at which light passes."""
        return 1.0

    @property
    def edges(self) -> Edges:
        """Straight edges (x, y, distance): inside is where x l_x + y l_y <= distance; empty for a round edge."""
        return ()

    @property
    def borders(self) -> Borders | None:
        """Edges and circles around the opening if weights can be computed from its chords, else None."""
        return None

    @property
    @abstractmethod
    def name(self) -> str:
        """Name for reports."""

    @property
    def amplitude(self) -> Pupil:
        """Aperture whose transmission is the square root of this one's: the amplitude for wave optics."""
        return self

    @property
    @abstractmethod
    def light(self) -> float:
        """Light that passes, relative to an open circle of radius 1."""

    @property
    @abstractmethod
    def second_moment(self) -> float:
        """Half of the mean of l_x^2 + l_y^2 over the light that passes."""

    @abstractmethod
    def transmission(self, x: Array, y: Array) -> Array:
        """Transmission at lens points, 0 to 1; x and y broadcast."""

    @abstractmethod
    def share(self, dx: Array, dy: Array, radius: Array, tent: bool) -> Array:
        """Fraction of the light that a pixel at (dx, dy) px receives in a blur of `radius` R; sums to 1.

        radius: px, not 0; its sign matters if `signed`. tent: True for a square source instead of a
        point; the pixel's response is then the square convolved with itself. The three arrays broadcast.
        """

    def rows(self, radii: Array, dx: Array, dy: Array, tent: bool) -> Array:
        """`share` (radii, dy, dx) for positive radii, with dx and dy in steps of 1 px."""
        return self.share(dx[None, None, :], dy[None, :, None], radii[:, None, None], tent)

    def cells(self, count: int) -> Array:
        """Light through each cell of a square around the lens, 2 count cells per side, up to a factor."""
        at = np.arange(2.0 * count) + 0.5 - count
        return self.share(at[None, :], at[:, None], np.asarray(count / self.extent), tent=False)


@cache
def unit_nodes(count: int) -> tuple[Array, Array]:
    """Gauss-Legendre nodes and weights on [0, 1].

    Computed at the first use: importing numpy's polynomials takes as long as reading a small scene.
    """
    nodes, weights = np.polynomial.legendre.leggauss(count)
    return 0.5 + 0.5 * nodes, 0.5 * weights


def pixel_integral(t: Array, tent: bool) -> Array:
    """Integral of a pixel's response up to t px from its middle, minus 1/2; tent: see `Pupil.share`."""
    if not tent:
        return np.clip(t, -0.5, 0.5)
    t = np.clip(t, -1.0, 1.0)
    return t - 0.5 * t * np.abs(t)
