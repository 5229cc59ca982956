"""Pupils: what the opening of a lens lets through, as functions on [-1, 1]^2 (float64, pure).

Each file holds one kind: its transmission, what is known of its blur in closed form, and an example. A pupil that has
no closed form is an `image`. `clsco.optics.point_spread.PointSpread` makes weights of any of them.
"""

from __future__ import annotations

from collections.abc import Callable

from clsco.optics.pupils.blades import CurvedPolygon
from clsco.optics.pupils.circle import Circle
from clsco.optics.pupils.ellipse import Ellipse
from clsco.optics.pupils.polygon import Polygon
from clsco.optics.pupils.pupil import Pupil
from clsco.optics.pupils.ring import Ring
from clsco.scene.spread import Aperture


def _circle(aperture: Aperture) -> Pupil:
    return Circle() if aperture.squeeze == 1.0 else Ellipse(aperture.squeeze)


def _polygon(aperture: Aperture) -> Pupil:
    if aperture.blade_curvature:
        return CurvedPolygon(aperture.blades, aperture.rotation, aperture.blade_curvature, aperture.squeeze)
    return Polygon(aperture.blades, aperture.rotation, aperture.squeeze)


def _ring(aperture: Aperture) -> Pupil:
    covered = aperture.obstruction
    return Ring(covered) if aperture.squeeze == 1.0 else Ellipse(aperture.squeeze, covered)


FORMULAS: dict[str, Callable[[Aperture], Pupil]] = {"circle": _circle, "polygon": _polygon, "ring": _ring}
"""Pupil by the shape of an aperture; that of an image is read from its file."""
