"""Pupils: transmission of a lens's aperture as a function on [-1, 1]^2 (float64, pure).

Each file holds kinds of one form, with closed forms for their blur if known, and is imported when a lens uses it. A
pupil without a closed form is an `image`. `clsco.optics.point_spread.PointSpread` computes weights for any pupil.
"""

from __future__ import annotations

from collections.abc import Callable

from clsco.optics.pupils.circle import Circle
from clsco.optics.pupils.pupil import Pupil
from clsco.scene.spread import Aperture


def _round(aperture: Aperture) -> Pupil:
    covered = aperture.obstruction if aperture.shape == "ring" else 0.0
    if aperture.squeeze != 1.0:
        from clsco.optics.pupils.outline import Ellipse

        return Ellipse(aperture.squeeze, covered)
    if not covered:
        return Circle()
    from clsco.optics.pupils.ring import Ring

    return Ring(covered)


def _polygon(aperture: Aperture) -> Pupil:
    if aperture.blade_curvature:
        from clsco.optics.pupils.outline import CurvedPolygon

        return CurvedPolygon(aperture.blades, aperture.rotation, aperture.blade_curvature, aperture.squeeze)
    from clsco.optics.pupils.polygon import Polygon

    return Polygon(aperture.blades, aperture.rotation, aperture.squeeze)


FORMULAS: dict[str, Callable[[Aperture], Pupil]] = {"circle": _round, "polygon": _polygon, "ring": _round}
"""Functions that return the pupil of an aperture, by its shape; the pupil of an image is read from its file."""
