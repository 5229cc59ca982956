"""Base of all pupils: what a blur, its tables and its visibility tests ask of one."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Symmetry = Literal["octant", "none"]
Edges = tuple[tuple[float, float, float], ...]


@dataclass(frozen=True)
class Borders:
    """Edges and circles around an opening of one transmission: it is convex, but for holes.

    Attributes
    ----------
    columns : tuple of float
        Places of its ends and corners from left to right, in aperture radii.
    edges : tuple of (x, y, distance)
        Straight ones, as `Pupil.edges`.
    circles, holes : tuple of (x, y, radius)
        Circles that light passes within, and that cover parts of it, none of which overlap; x times `squeeze`.
    squeeze : float
    """

    columns: tuple[float, ...] = (-1.0, 1.0)
    edges: Edges = ()
    circles: Edges = ()
    holes: Edges = ()
    squeeze: float = 1.0


class Pupil(ABC):
    """Opening of a lens: its transmission over lens points l in units of the aperture's radius, x right and y down.

    A ray through l arrives at the offset R l, R the signed blur radius in px, so that a blur is the pupil scaled by R.
    Subclasses are frozen and hashable: tables of weights are kept by their fields.

    Attributes
    ----------
    symmetry : str
        "octant": mirrored in x, in y and in the diagonals, so that R and -R blur alike. "none".
    uniform : bool
        The transmission is constant inside the rim.
    soft : bool
        The transmission falls off towards the rim.
    hollow : bool
        The transmission is constant between an inner and an outer rim.
    separable : bool
        The transmission is a product of one along each axis.
    """

    symmetry: ClassVar[Symmetry] = "octant"
    uniform: ClassVar[bool] = False
    soft: ClassVar[bool] = False
    hollow: ClassVar[bool] = False

    @property
    def separable(self) -> bool:
        return False

    @property
    def signed(self) -> bool:
        """R and -R blur differently."""
        return self.symmetry == "none"

    @property
    def steps(self) -> int:
        """Intervals of tables per px of R where weights are smooth in R whatever it is, as of waves; else 0."""
        return 0

    @property
    def margin(self) -> float:
        """Distance from the rim of the blur at which its light ends, px."""
        return 0.0

    @property
    def lengths(self) -> Mapping[str, float]:
        """Lengths in aperture radii that describe it, by name; of blur radius R they are R times as long."""
        return {}

    @property
    def extent(self) -> float:
        """Largest |l| that light passes at."""
        return 1.0

    @property
    def bends_rays(self) -> bool:
        """Rays arrive beside R l, by errors of the wavefront."""
        return False

    @property
    def has_plain_rim(self) -> bool:
        """The rim is a circle, or straight edges: mean lens points of pixels at it follow from their places."""
        return True

    @property
    def edges(self) -> Edges:
        """Straight edges (x, y, distance), inside where x l_x + y l_y <= distance; none where the rim is round."""
        return ()

    @property
    def borders(self) -> Borders | None:
        """Edges and circles around the opening, where weights can be made of its chords."""
        return None

    @property
    @abstractmethod
    def name(self) -> str:
        """Name for reports."""

    @property
    def amplitude(self) -> Pupil:
        """Opening whose transmission is the square root of this one's: what waves come through."""
        return self

    @property
    @abstractmethod
    def light(self) -> float:
        """Light that passes, as a part of what an open circle of radius 1 lets through."""

    @property
    @abstractmethod
    def second_moment(self) -> float:
        """Mean of l_x^2 and l_y^2 over the light that passes."""

    @abstractmethod
    def transmission(self, x: Array, y: Array) -> Array:
        """Transmission at lens points, 0 to 1; x and y broadcast."""

    @abstractmethod
    def share(self, dx: Array, dy: Array, radius: Array, tent: bool) -> Array:
        """Share of the energy that a pixel at (dx, dy) px gets of a blur of radius R, not 0, in px; sums to 1.

        tent: of a square source instead of a point; the pixel's response is then the square convolved with itself.
        The three arrays broadcast. The sign of R matters where the symmetry is "none".
        """

    def rows(self, radii: Array, dx: Array, dy: Array, tent: bool) -> Array:
        """`share` (radii, dy, dx) for positive radii, where dx and dy rise by 1 px."""
        return self.share(dx[None, None, :], dy[None, :, None], radii[:, None, None], tent)

    def cells(self, count: int) -> Array:
        """Light through each cell of a square around the lens, 2 count a side, up to a factor."""
        at = np.arange(2.0 * count) + 0.5 - count
        return self.share(at[None, :], at[:, None], np.asarray(count / self.extent), tent=False)
