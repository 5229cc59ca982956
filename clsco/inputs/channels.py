"""Channels of textures: gray ones converted to color, and selected channels of color ones."""

from __future__ import annotations

import numpy as np

from clsco.inputs.textures import Texture


def to_color(texture: Texture) -> Texture:
    """A texture converted to three channels."""
    if texture.radiance.ndim == 3:
        return texture
    images = (np.broadcast_to(image[..., None], (*image.shape, 3)) for image in texture.images)
    return texture.with_images(images, ("color", texture.content))


def select_channels(texture: Texture, channels: tuple[int, ...]) -> Texture:
    """A texture of selected channels; a gray one is returned unchanged."""
    if texture.radiance.ndim == 2:
        return texture
    chosen = channels[0] if len(channels) == 1 else channels
    images = [np.ascontiguousarray(image[..., chosen]) for image in texture.images]
    for image in images:
        image.flags.writeable = False
    return texture.with_images(images, ("channels", texture.content, channels))
