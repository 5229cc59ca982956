"""Pupils: what the opening of a lens lets through, as functions on [-1, 1]^2 (float64, pure).

Each file holds one kind: its transmission, what is known of its blur in closed form, and an example. A pupil that has
no closed form is an `image`. `clsco.optics.point_spread.PointSpread` makes weights of any of them.
"""

from __future__ import annotations

from collections.abc import Callable

from clsco.optics.pupils.circle import Circle
from clsco.optics.pupils.polygon import Polygon
from clsco.optics.pupils.pupil import Pupil
from clsco.optics.pupils.ring import Ring
from clsco.scene.spread import Aperture

FORMULAS: dict[str, Callable[[Aperture], Pupil]] = {
    "circle": lambda _: Circle(),
    "polygon": lambda aperture: Polygon(aperture.blades, aperture.rotation),
    "ring": lambda aperture: Ring(aperture.obstruction),
}
"""Pupil by the shape of an aperture; that of an image is read from its file."""
