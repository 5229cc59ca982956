"""Base of openings as waves see them: their rims diffract light (float64, pure)."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from math import pi
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from clsco.optics.pupils.pupil import Array, Edges, Pupil

LAW = 1.1  # light beyond d px outside of the rim is at most so many times 2 Q / (pi^2 d), for an open circle
LEAST_MARGIN = 1.0  # px
MOST_STEPS = 32  # intervals of tables per px
PANEL_NODES = 10


@dataclass(frozen=True)
class Diffracted(Pupil):
    """Opening whose blur is that of waves: its rim diffracts light.

    Attributes
    ----------
    opening : Pupil
    bands : tuple of (float, float)
        Q = wavelength s0 / (D pitch), px, and share of the light, of each wavelength.
    tail : float
        Share of the light that is left out, far from the rim.
    keeps : bool
        Light that is left out is spread over the blur, so that it has all of the light.
    """

    STEPS: ClassVar[tuple[tuple[float, int], ...]]  # intervals of tables per px, from a Q on

    opening: Pupil
    bands: tuple[tuple[float, float], ...]
    tail: float = 0.01
    keeps: bool = True

    @property
    def signed(self) -> bool:
        return self.opening.signed

    @property
    def extent(self) -> float:
        """Largest |l| of the opening; light goes `margin` px farther than that."""
        return self.opening.extent

    @property
    def edges(self) -> Edges:
        return self.opening.edges

    @property
    def lengths(self) -> Mapping[str, float]:
        return self.opening.lengths

    @property
    def name(self) -> str:
        return f"{self.opening.name}, waves"

    @property
    def light(self) -> float:
        return self.opening.light

    @property
    def second_moment(self) -> float:
        """Mean of l_x^2 and l_y^2 of the opening: diffraction adds to the blur what does not grow with R."""
        return self.opening.second_moment

    @property
    @abstractmethod
    def rim(self) -> float:
        """Length of its rims per area, as a multiple of that of an open circle."""

    @property
    def widest(self) -> float:
        """Largest Q of its wavelengths, px."""
        return max(unit for unit, _ in self.bands)

    @property
    def narrowest(self) -> float:
        """Smallest Q of its wavelengths, px."""
        return min(unit for unit, _ in self.bands)

    @property
    def steps(self) -> int:
        """Intervals per px of R, over which weights are cubics to 1e-5: they turn once in 4 Q, or a pixel."""
        return next((steps for unit, steps in self.STEPS if self.narrowest >= unit), MOST_STEPS)

    @property
    def margin(self) -> float:
        """Distance from the rim of the blur at which what is left ends, px: beyond is `tail` of the light, at most.

        By the law of straight edges it is in proportion to the length of the rim.
        """
        return max(LAW * 2.0 * self.widest * self.rim / (pi**2 * self.tail), LEAST_MARGIN) + 0.5

    def transmission(self, x: Array, y: Array) -> Array:
        return self.opening.transmission(x, y)

    def cells(self, count: int) -> Array:
        return self.opening.cells(count)

    def waves(self, radius: float) -> float:
        """Defocus of a blur radius in px at the edge of the opening, in waves of the shortest wavelength."""
        return abs(radius) / (4.0 * self.narrowest)

    @abstractmethod
    def left_out(self, radius: float) -> float:
        """Share of the light of a blur radius in px that is cut off."""

    def within(self, light: Array, distance: Array, end: Array, area: Array) -> Array:
        """Light (places, radii), less what fades out over the last px before `end`; where it `keeps` all, that goes
        back in proportion to the squared distance.

        Far light is nearly the mean of an image: a blur that were brighter by it in its middle would have too much
        contrast, by the same share, whatever the detail.
        """
        held = np.clip(end - distance, 0.0, 1.0)
        inside = held**3 * (10.0 + held * (6.0 * held - 15.0))
        light = light * inside
        if self.keeps:
            haze = area * distance**2 * inside
            light += haze * ((1.0 - light.sum(axis=0)) / haze.sum(axis=0))
        return np.asarray(light)


def panels_of(
    radii: Array, panel: float, count: int = PANEL_NODES
) -> tuple[NDArray[np.int64], NDArray[np.int64], Array]:  # fmt: skip
    """Polynomials in R that give weights at signed radii, each for a panel of so many px, of `count` nodes.

    Returns
    -------
    numbers : ndarray of int
        Panels, rising; one from n panel on has the number n, and nodes by `panel_nodes`.
    which : ndarray of int (radii,)
        Index of each radius' panel.
    factors : ndarray (radii, count)
        Weights of the values at the nodes of its panel.
    """
    angles = (np.arange(count) + 0.5) * pi / count
    barycentric = np.where(np.arange(count) % 2, -1.0, 1.0) * np.sin(angles)
    numbers, which = np.unique(np.floor(radii / panel).astype(np.int64), return_inverse=True)
    away = radii[:, None] - panel_nodes(numbers, panel, count)[which]
    factors = barycentric / np.where(away == 0.0, 1e-300, away)
    return numbers, which, factors / factors.sum(axis=1, keepdims=True)


def panel_nodes(numbers: NDArray[np.int64], panel: float, count: int = PANEL_NODES) -> Array:
    """Radii (panels, count) at the nodes of panels of so many px, Chebyshev's."""
    at = -np.cos((np.arange(count) + 0.5) * pi / count)
    return np.asarray((numbers[:, None] + 0.5 * (at + 1.0)) * panel)
