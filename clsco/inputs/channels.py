"""Channels of textures: gray ones converted to color, and selected channels of color ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from clsco.inputs.textures import Texture


def to_color(texture: Texture) -> Texture:
    """A texture converted to three channels."""
    if texture.radiance.ndim == 3:
        return texture
    images = [np.broadcast_to(image[..., None], (*image.shape, 3)) for image in texture.images]
    content = None if texture.content is None else ("color", texture.content)
    return replace(texture, radiance=images[0], others=tuple(images[1:]), content=content)


def select_channels(texture: Texture, channels: tuple[int, ...]) -> Texture:
    """A texture of selected channels; a gray one is returned unchanged."""
    if texture.radiance.ndim == 2:
        return texture
    images = [
        np.ascontiguousarray(image[..., channels[0] if len(channels) == 1 else channels]) for image in texture.images
    ]
    for image in images:
        image.flags.writeable = False
    content = None if texture.content is None else ("channels", texture.content, channels)
    return replace(texture, radiance=images[0], others=tuple(images[1:]), content=content)
