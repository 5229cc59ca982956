"""Base of pupils with wave optics: their edges diffract light (float64, pure)."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from math import pi
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from clsco.optics.pupils.pupil import Array, Pupil

LAW = 1.1  # light beyond d px outside of the rim is at most LAW times 2 Q / (pi^2 d), for an open circle
LEAST_MARGIN = 1.0  # px
MOST_STEPS = 32  # intervals of tables per px
PANEL_NODES = 10


def _of_opening(name: str) -> Any:
    """Property or method of a pupil that is that of its opening."""
    return property(lambda pupil: getattr(pupil.opening, name))


@dataclass(frozen=True)
class Diffracted(Pupil):
    """Aperture with wave-optics blur: its edge diffracts light.

    bands: Q = wavelength s0 / (D pitch) in px, and fraction of the light, for each wavelength. tail: fraction of the
    light that is cut off, far from the blur's edge. keeps: True to spread the light that is cut off over the blur, so
    that the total is preserved.
    """

    STEPS: ClassVar[tuple[tuple[float, int], ...]]  # least Q, and intervals of tables per px from this Q on

    opening: Pupil
    bands: tuple[tuple[float, float], ...]
    tail: float = 0.01
    keeps: bool = True

    # Light spreads `margin` px farther than `extent`; diffraction adds to the blur's second moment, independently of R.
    extent, light, second_moment, edges = map(_of_opening, ("extent", "light", "second_moment", "edges"))
    signed, lengths, transmission, cells = map(_of_opening, ("signed", "lengths", "transmission", "cells"))

    @property
    def name(self) -> str:
        return f"{self.opening.name}, waves"

    @property
    @abstractmethod
    def rim(self) -> float:
        """Length of the aperture's edges per area, relative to an open circle."""

    @property
    def widest(self) -> float:
        """Largest unit of diffraction Q of all wavelengths, px."""
        return max(unit for unit, _ in self.bands)

    @property
    def narrowest(self) -> float:
        """Smallest unit of diffraction Q of all wavelengths, px."""
        return min(unit for unit, _ in self.bands)

    @property
    def steps(self) -> int:
        """Intervals per px of R within which weights are cubics to 1e-5: they oscillate once per 4 Q, or per pixel."""
        return next((steps for unit, steps in self.STEPS if self.narrowest >= unit), MOST_STEPS)

    @property
    def margin(self) -> float:
        """Distance in px from the geometric blur's edge at which light is cut off: at most the fraction `tail` of it.

        By the law of straight edges, the light beyond this distance is proportional to the length of the aperture's
        edge.
        """
        return max(LAW * 2.0 * self.widest * self.rim / (pi**2 * self.tail), LEAST_MARGIN) + 0.5

    def waves(self, radius: float) -> float:
        """Defocus of a blur radius in px, at the edge of the opening, in waves of the shortest wavelength."""
        return abs(radius) / (4.0 * self.narrowest)

    @abstractmethod
    def left_out(self, radius: float) -> float:
        """Fraction of the light that is cut off for a blur radius in px."""

    def within(self, light: Array, distance: Array, end: Array, area: Array) -> Array:
        """Light (places, radii) faded out over the last px before `end`; with `keeps`, the lost light is added back
        with a weight that is quadratic in the distance.

        distance, area: distance of each place from the source, px, and area of the place; end: where light ends, px.
        Far light is nearly the mean of an image: if it were added in the middle of the blur, contrast would be too
        high, by the same fraction for any detail.
        """
        shares = np.clip(end - distance, 0.0, 1.0)
        inside = shares**3 * (10.0 + shares * (6.0 * shares - 15.0))
        light = light * inside
        if self.keeps:
            haze = area * distance**2 * inside
            light += haze * ((1.0 - light.sum(axis=0)) / haze.sum(axis=0))
        return np.asarray(light)


def panels_of(
    radii: Array, panel: float, count: int = PANEL_NODES
) -> tuple[NDArray[np.int64], NDArray[np.int64], Array]:  # fmt: skip
    """Interpolation in R of weights at signed radii, by polynomials with `count` nodes on panels of `panel` px.

    Returns the numbers of the panels, increasing; for each radius, the index of its panel among these (radii,), and the
    weights of the values at the panel's nodes (radii, count). Panel n begins at n `panel`, with nodes by `panel_nodes`.
    """
    angles = (np.arange(count) + 0.5) * pi / count
    barycentric = np.where(np.arange(count) % 2, -1.0, 1.0) * np.sin(angles)
    numbers, which = np.unique(np.floor(radii / panel).astype(np.int64), return_inverse=True)
    away = radii[:, None] - panel_nodes(numbers, panel, count)[which]
    factors = barycentric / np.where(away == 0.0, 1e-300, away)
    return numbers, which, factors / factors.sum(axis=1, keepdims=True)


def panel_nodes(numbers: NDArray[np.int64], panel: float, count: int = PANEL_NODES) -> Array:
    """Chebyshev nodes (panels, count), as radii in px, of panels of `panel` px."""
    at = -np.cos((np.arange(count) + 0.5) * pi / count)
    return np.asarray((numbers[:, None] + 0.5 * (at + 1.0)) * panel)
