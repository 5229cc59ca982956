"""Openings as waves see them: the point spread by diffraction at a round opening (float64, pure)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from math import ceil, pi

import numpy as np

from clsco.optics.pupils.circle import Circle
from clsco.optics.pupils.diffraction import cell_width, pixel_rings, round_light
from clsco.optics.pupils.pupil import Array, Edges, Pupil
from clsco.optics.pupils.ring import Ring

LAW = 1.1  # light beyond d px outside of the rim is at most so many times 2 Q / (pi^2 d), for an open circle
LEAST_MARGIN = 1.0  # px
DIRECT = 64  # radii up to which each has weights of its own; of more they are interpolated
STEPS, MOST_STEPS = ((1.6, 2), (0.8, 4), (0.2, 8), (0.05, 16)), 32  # intervals of tables per px, from a Q on
PANEL_NODES = 10
PANEL = 0.25  # px of R that one polynomial is for, at most; half a period of the fastest oscillation, 4 Q
ANGLES = (np.arange(PANEL_NODES) + 0.5) * pi / PANEL_NODES
CHEBYSHEV = -np.cos(ANGLES)
BARYCENTRIC = np.where(np.arange(PANEL_NODES) % 2, -1.0, 1.0) * np.sin(ANGLES)


@dataclass(frozen=True)
class Diffracted(Pupil):
    """Opening whose blur is that of waves: its rim diffracts light.

    Attributes
    ----------
    opening : Pupil
        A circle or a ring.
    bands : tuple of (float, float)
        Q = wavelength s0 / (D pitch), px, and share of the light, of each wavelength.
    tail : float
        Share of the light that is left out, far from the rim.
    keeps : bool
        The rest has all of the light.

    Examples
    --------
    >>> import numpy as np
    >>> from clsco.optics.pupils.circle import Circle
    >>> from clsco.optics.pupils.diffracted import Diffracted
    >>> lens = Diffracted(Circle(), ((0.5, 1.0),))
    >>> lens.share(np.array([0.0, 1.0]), np.zeros(2), np.array(0.0), tent=True).round(4)
    array([0.6151, 0.0695])
    """

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
    def inner(self) -> float:
        """Radius of what is covered in the middle, in radii of the opening."""
        return self.opening.obstruction if isinstance(self.opening, Ring) else 0.0

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
        return next((steps for unit, steps in STEPS if self.narrowest >= unit), MOST_STEPS)

    @property
    def margin(self) -> float:
        """Distance from the rim of the blur at which what is left ends, px: beyond is `tail` of the light, at most.

        By the law of straight edges it is in proportion to the length of the rim.
        """
        rim = 1.0 / (1.0 - self.inner)
        return max(LAW * 2.0 * self.widest * rim / (pi**2 * self.tail), LEAST_MARGIN) + 0.5

    def transmission(self, x: Array, y: Array) -> Array:
        return self.opening.transmission(x, y)

    def cells(self, count: int) -> Array:
        return self.opening.cells(count)

    def share(self, dx: Array, dy: Array, radius: Array, tent: bool) -> Array:
        a, b, r = np.broadcast_arrays(np.abs(dx), np.abs(dy), radius if self.signed else np.abs(radius))
        if not a.size:
            return np.zeros(a.shape)
        places, place = np.unique(np.maximum(a, b) + 1j * np.minimum(a, b), return_inverse=True)
        radii, which = np.unique(r, return_inverse=True)
        weights = self._weights if len(radii) <= DIRECT else self._interpolated
        found = weights(places, radii, tent)
        return np.asarray(found[place.reshape(a.shape), which.reshape(a.shape)])

    def waves(self, radius: float) -> float:
        """Defocus of a blur radius in px at the edge of the opening, in waves of the shortest wavelength."""
        return abs(radius) / (4.0 * self.narrowest)

    def left_out(self, radius: float) -> float:
        """Share of the light of a blur radius in px that is cut off."""
        light, inside = self._light(np.array([radius]))
        return float(1.0 - (light * inside).sum())

    def _weights(self, places: NDArrayComplex, radii: Array, tent: bool) -> Array:
        """Weights (places, radii)."""
        rings, width = _rings(self, radii.tobytes()), self._width
        found = np.empty((len(places), len(radii)))
        for k, (a, b) in enumerate(zip(places.real.tolist(), places.imag.tolist(), strict=True)):
            first, shares = pixel_rings(a, b, tent, width)
            light = rings[first : first + len(shares)]
            found[k] = shares[: len(light)] @ light
        return np.maximum(found, 0.0)

    def _interpolated(self, places: NDArrayComplex, radii: Array, tent: bool) -> Array:
        """The same by polynomials in the radius, which the weights are smooth in: to 1e-9 where Q is 0.1 px or more."""
        panel = min(PANEL, 2.0 * self.narrowest)
        panels, number = np.unique(np.floor(radii / panel), return_inverse=True)
        nodes = (panels[:, None] + 0.5 * (CHEBYSHEV + 1.0)) * panel
        values = self._weights(places, nodes.ravel(), tent).reshape(len(places), *nodes.shape)
        away = radii[:, None] - nodes[number]
        factor = BARYCENTRIC / np.where(away == 0.0, 1e-300, away)
        factor /= factor.sum(axis=1, keepdims=True)
        return np.maximum(np.einsum("prn,rn->pr", values[:, number], factor), 0.0)

    @property
    def _width(self) -> float:
        return cell_width(self.narrowest)

    def _light(self, radii: Array) -> tuple[Array, Array]:
        """Light in each ring (rings, radii), and what part of it is inside of the margin."""
        width, end = self._width, np.abs(radii) * self.extent + self.margin
        count = 2 * ceil(0.5 * float(end.max()) / width)
        light = sum(
            share * round_light(radii, unit, self.inner, np.zeros_like, width, count) for unit, share in self.bands
        )
        depth = np.clip(end - (np.arange(count)[:, None] + 0.5) * width, 0.0, 1.0)
        return np.asarray(light), depth**3 * (10.0 + depth * (6.0 * depth - 15.0))


NDArrayComplex = np.ndarray[tuple[int, ...], np.dtype[np.complex128]]


def is_round(opening: Pupil) -> bool:
    """True of an opening that rings of light are made of."""
    return isinstance(opening, Circle | Ring)


@lru_cache(maxsize=32)
def _rings(pupil: Diffracted, radii: bytes) -> Array:
    """Light in each ring (rings, radii), for radii as float64."""
    light, inside = pupil._light(np.frombuffer(radii))
    light = light * inside
    return np.asarray(light / light.sum(axis=0) if pupil.keeps else light)
