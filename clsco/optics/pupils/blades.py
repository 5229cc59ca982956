"""Pupil of curved blades: arcs through neighboring corners of a polygon (float64, pure)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import cos, pi

from clsco.optics.pupils.outline import Arc, Outline, bulging
from clsco.optics.pupils.polygon import Polygon, vertices
from clsco.optics.pupils.pupil import Borders


@dataclass(frozen=True)
class CurvedPolygon(Outline):
    """Aperture of curved blades, with corners on the unit circle; blades, rotation, squeeze: as for `Polygon`.

    curvature: height of an arc over its chord, relative to the height of the unit circle: 1 for the circle, negative
    for concave blades.
    """

    blades: int
    rotation: float
    curvature: float
    squeeze: float = 1.0

    @property
    def label(self) -> str:
        return f"{self.blades} blades, curved by {self.curvature:g}"

    @cached_property
    def _blades(self) -> list[list[Arc]]:
        corners = [(float(x), float(y)) for x, y in vertices(self.blades, self.rotation)]
        sagitta = self.curvature * (1.0 - cos(pi / self.blades))
        return [bulging(corners[k - 1], corners[k], sagitta) for k in range(self.blades)]

    @cached_property
    def borders(self) -> Borders:
        ends = sorted({x / self.squeeze for arc in self.arcs for x, _ in (arc.start, arc.end)})
        circles = tuple((*blade[0].center, blade[0].radius) for blade in self._blades if blade[0].radius)
        edges = () if circles and self.curvature > 0.0 else Polygon(self.blades, self.rotation, self.squeeze).edges
        convex, holes = ((), circles) if edges else (circles, ())
        return Borders(tuple(ends), edges, convex, holes, self.squeeze)

    @cached_property
    def arcs(self) -> tuple[Arc, ...]:
        return tuple(arc for blade in self._blades for arc in blade)
