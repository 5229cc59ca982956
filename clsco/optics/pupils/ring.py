"""Ring pupil: a lens with a central obstruction, such as a mirror lens; the difference of two discs (float64, pure)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clsco.optics.pupils.circle import disc_coverage
from clsco.optics.pupils.pupil import Array, Borders, Pupil


@dataclass(frozen=True)
class Ring(Pupil):
    """Light passes at obstruction < |l| <= 1, with the obstruction between 0 and 1."""

    obstruction: float

    hollow = True
    has_plain_rim = False

    @property
    def borders(self) -> Borders:
        return Borders(circles=((0.0, 0.0, 1.0),), holes=((0.0, 0.0, self.obstruction),))

    @property
    def name(self) -> str:
        return f"ring, {self.obstruction:g} covered"

    @property
    def light(self) -> float:
        return 1.0 - self.obstruction**2

    @property
    def second_moment(self) -> float:
        return 0.25 * (1.0 + self.obstruction**2)

    def transmission(self, x: Array, y: Array) -> Array:
        square = x * x + y * y
        return np.asarray(((square > self.obstruction**2) & (square <= 1.0)).astype(np.float64))

    def share(self, dx: Array, dy: Array, radius: Array, tent: bool) -> Array:
        outer = np.abs(radius)
        inner = self.obstruction * outer
        ring = disc_coverage(dx, dy, outer, tent) - disc_coverage(dx, dy, inner, tent)
        return np.asarray(np.maximum(ring, 0.0) / (np.pi * (outer * outer - inner * inner)))
