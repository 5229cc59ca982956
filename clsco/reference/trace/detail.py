"""Sub-pixel sources for pixels whose texture is too fine for one source, in NumPy float64.

The formulas are at the head of kernels/trace/detail.clh.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clsco.optics.quadrics import PlacedSurface
from clsco.reference.common.equation import WIDE_LENS
from clsco.reference.common.geometry import Array
from clsco.reference.trace.footprint import blended_images, sharpening
from clsco.reference.trace.mapping import MappedTexture
from clsco.scene.model import Camera

REACHING = 2.0  # slope with which the exchange of light between parts begins as the blur grows


def detailed_texture(
    texture: MappedTexture, surface: PlacedSurface, camera: Camera, rays: Array, w: Array, radius: Array,
    samples: int, parts: int,
) -> Array:  # fmt: skip
    """Values (n, parts, parts, channels) of the parts of pixels whose rays (n, 3) hit a surface.

    w: (n,), inverse depths; radius: (n,), signed, px; samples: number of sub-pixel sources per axis; parts: number of
    parts per axis.
    """
    values = np.zeros((len(w), parts, parts, texture.levels[0].shape[3]))
    size = texture.spread * np.abs(radius)
    exchanged = sharpening(texture, parts * radius) * np.clip(REACHING * (2 * samples * size - 1.0), 0.0, 1.0)
    places = np.arange(parts + 2) - 0.5 * (parts + 1)
    for mask, blend, _, mean_of in blended_images(texture, surface, camera, rays, w, 1, parts):
        mean = np.stack([np.stack([mean_of(a, b) for a in places], axis=1) for b in places], axis=1)
        inner, share = mean[:, 1:-1, 1:-1], exchanged[mask, None, None, None]
        value = inner + share * (2.0 * inner - mean[:, 1:-1, :-2] - mean[:, 1:-1, 2:])
        value += share * (2.0 * inner - mean[:, :-2, 1:-1] - mean[:, 2:, 1:-1])
        values[mask] += blend[:, None, None, None] * value
    return values


def is_shared(radius: Array, extent: float, gradient: Array) -> NDArray[np.bool_]:
    """True (N,) if all sub-pixel sources of one surface in a pixel can share the visibility test at the pixel's middle.

    This requires that their blur radius changes little, and that the lens is narrow for all of them. radius (N,), px,
    and gradient (N, 2), px per px: of the pixel.
    """
    most = (np.abs(radius) + 0.5 * np.abs(gradient).sum(axis=-1)) * extent
    return np.asarray((most < WIDE_LENS) & (np.hypot(*gradient.T) * extent <= 1.0))
