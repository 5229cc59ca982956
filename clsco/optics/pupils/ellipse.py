"""Elliptic pupil of an anamorphic lens, open or with a central obstruction (float64, pure)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import pi

from clsco.optics.pupils.outline import Arc, Outline, arc
from clsco.optics.pupils.pupil import Borders


@dataclass(frozen=True)
class Ellipse(Outline):
    """Ellipse as high as the unit circle; squeeze: height over width; obstruction: size of a central obstruction of the
    same shape, relative to the opening, 0 for none.
    """

    squeeze: float
    obstruction: float = 0.0

    @property
    def label(self) -> str:
        return f"ring, {self.obstruction:g} covered" if self.obstruction else "circle"

    @cached_property
    def borders(self) -> Borders:
        holes = ((0.0, 0.0, self.obstruction),) if self.obstruction else ()
        return Borders((-1.0 / self.squeeze, 1.0 / self.squeeze), (), ((0.0, 0.0, 1.0),), holes, self.squeeze)

    @cached_property
    def arcs(self) -> tuple[Arc, ...]:
        hole = arc((0.0, 0.0), self.obstruction, 2.0 * pi, 0.0) if self.obstruction else []
        return (*arc((0.0, 0.0), 1.0, 0.0, 2.0 * pi), *hole)
