"""Round apertures with wave optics, by distance from the source (float64, pure)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from math import ceil

import numpy as np

from clsco.optics.pupils.circle import Circle
from clsco.optics.pupils.diffracted import PANEL_NODES, Diffracted, panel_nodes, panels_of
from clsco.optics.pupils.diffraction import cell_width, pixel_rings, round_light
from clsco.optics.pupils.pupil import Array, Pupil
from clsco.optics.pupils.ring import Ring

DIRECT = 64  # largest number of radii whose weights are not interpolated
PANEL = 0.25  # px of R that one polynomial covers; less if half a period of the oscillations, 2 Q, is shorter


@dataclass(frozen=True)
class HankelDiffracted(Diffracted):
    """Circle or ring without aberrations, see `Diffracted`."""

    STEPS = ((1.6, 2), (0.8, 4), (0.2, 8), (0.05, 16))

    @property
    def inner(self) -> float:
        """Radius of the central obstruction, in radii of the opening."""
        return self.opening.obstruction if isinstance(self.opening, Ring) else 0.0

    @property
    def rim(self) -> float:
        return 1.0 / (1.0 - self.inner)

    def share(self, dx: Array, dy: Array, radius: Array, tent: bool) -> Array:
        a, b, r = np.broadcast_arrays(np.abs(dx), np.abs(dy), radius if self.signed else np.abs(radius))
        if not a.size:
            return np.zeros(a.shape)
        places, place = np.unique(np.maximum(a, b) + 1j * np.minimum(a, b), return_inverse=True)
        radii, which = np.unique(r, return_inverse=True)
        weights = self._weights if len(radii) <= DIRECT else self._interpolated
        shares = weights(places, radii, tent)
        return np.asarray(shares[place.reshape(a.shape), which.reshape(a.shape)])

    def left_out(self, radius: float) -> float:
        return 1.0 - float(replace(self, keeps=False)._light(np.array([radius])).sum())

    def _weights(self, places: NDArrayComplex, radii: Array, tent: bool) -> Array:
        """Weights (places, radii); places: a + b i for pixels at offsets a >= b >= 0 px."""
        rings, width = _rings(self, radii.tobytes()), cell_width(self.narrowest)
        weights = np.empty((len(places), len(radii)))
        for k, (a, b) in enumerate(zip(places.real.tolist(), places.imag.tolist(), strict=True)):
            first, shares = pixel_rings(a, b, tent, width)
            light = rings[first : first + len(shares)]
            weights[k] = shares[: len(light)] @ light
        return np.maximum(weights, 0.0)

    def _interpolated(self, places: NDArrayComplex, radii: Array, tent: bool) -> Array:
        """Weights, interpolated by polynomials in the blur radius; exact to 1e-9 for Q of 0.1 px or more."""
        panel = min(PANEL, 2.0 * self.narrowest)
        numbers, which, factors = panels_of(radii, panel)
        nodes = panel_nodes(numbers, panel)
        values = self._weights(places, nodes.ravel(), tent).reshape(len(places), -1, PANEL_NODES)
        return np.maximum(np.einsum("prn,rn->pr", values[:, which], factors), 0.0)

    def _light(self, radii: Array) -> Array:
        """Light in each ring (rings, radii)."""
        width, end = cell_width(self.narrowest), np.abs(radii) * self.extent + self.margin
        count = 2 * ceil(0.5 * float(end.max()) / width)
        light = sum(
            share * round_light(radii, unit, self.inner, np.zeros_like, width, count) for unit, share in self.bands
        )
        distance: Array = (np.arange(float(count))[:, None] + 0.5) * width
        return self.within(np.asarray(light), distance, end, distance)


NDArrayComplex = np.ndarray[tuple[int, ...], np.dtype[np.complex128]]


def is_round(opening: Pupil) -> bool:
    """True for an aperture whose light has rotational symmetry."""
    return isinstance(opening, Circle | Ring)


@lru_cache(maxsize=32)
def _rings(pupil: HankelDiffracted, radii: bytes) -> Array:
    """Light in each ring (rings, radii); radii: bytes of an array of float64."""
    return pupil._light(np.frombuffer(radii))
