"""Elliptic pupil of an anamorphic lens, open or with a central obstruction (float64, pure)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import pi

from clsco.optics.pupils.outline import Arc, Outline, arc
from clsco.optics.pupils.pupil import Borders


@dataclass(frozen=True)
class Ellipse(Outline):
    """Ellipse as high as the unit circle.

    Attributes
    ----------
    squeeze : float
        Height over width.
    obstruction : float
        Size of the central obstruction, an ellipse of the same shape, relative to the opening; 0 for none.

    Examples
    --------
    >>> from clsco.optics.pupils.ellipse import Ellipse
    >>> Ellipse(2.0).name, round(Ellipse(2.0).light, 12)
    ('circle, squeezed 2 times', 0.5)
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
