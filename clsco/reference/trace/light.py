"""Shading of a texture by a light: Lambert's law, without shadows or fall-off."""

from __future__ import annotations

import numpy as np

from clsco.optics.light import PlacedLight
from clsco.optics.quadrics import PlacedSurface
from clsco.reference.common.geometry import Array, surface_normal


def shade(light: PlacedLight, surface: PlacedSurface, number: int, rays: Array, w: Array) -> Array:
    """Fraction (...) of a texture's radiance at hits on object `number`, for the side that faces the lens.

    It is 1 for objects that the light does not affect. w: (...) 1/mm, 0 without a hit.
    """
    if not light.members >> number & 1:
        return np.ones(w.shape)
    towards = light.place * w[..., None] - rays if light.is_near else np.broadcast_to(light.place, rays.shape)
    along = (towards * surface_normal(surface, rays, w)).sum(axis=-1)
    size = np.sqrt((towards**2).sum(axis=-1))
    return light.ambient + (1.0 - light.ambient) * np.where(along > 0.0, along, 0.0) / np.where(size > 0.0, size, 1.0)
