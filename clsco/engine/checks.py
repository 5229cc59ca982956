"""Checks of the arrays that `clsco.defocus` is given."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.errors import ArgumentError
from clsco.files.images import LARGEST
from clsco.opencl.arrays import check_image
from clsco.optics.lens import LARGEST_BLUR

MOST_IMAGES = 8  # that lie over each other


def layer_arrays(image: Any, blur_radius: Any, layers: Sequence[tuple[Any, Any]]) -> tuple[list[str], list[Any]]:
    """Arrays of all layers, or of one image, and their names for messages."""
    if not isinstance(layers, tuple | list):
        raise ArgumentError(f"layers: must be a list of pairs; got {type(layers).__name__}")
    if bool(layers) != (image is None and blur_radius is None):
        raise ArgumentError("layers: must be given in place of image and blur_radius; got both or none of them")
    if len(layers) > MOST_IMAGES:
        raise ArgumentError(f"layers: must be at most {MOST_IMAGES}; got {len(layers)}")
    if any(not isinstance(pair, tuple | list) or len(pair) != 2 for pair in layers):
        raise ArgumentError("layers: must be pairs of an image and its blur radii; got something else")
    begins = [f"layers[{number}]: " for number in range(len(layers))] or [""]
    names = [f"{begin}{array}" for begin in begins for array in ("image", "blur_radius")]
    return names, [array for pair in layers or [(image, blur_radius)] for array in pair]


def check_layer(name: str, picture: NDArray[Any], radii: NDArray[Any], shape: tuple[int, ...], alpha: bool) -> None:
    """Raise ArgumentError for an image with its radii that cannot be blurred, or that has not the first one's shape."""
    check_image(picture, name)
    if alpha and (picture.shape != shape or picture.ndim != 3 or picture.shape[2] < 2):
        rule = f"must have the shape {shape} of the first one" if picture.shape != shape else "must have alpha"
        raise ArgumentError(f"{name}image: {rule}; got {picture.shape}")
    if radii.shape != picture.shape[:2]:
        rule = f"must have the rows and columns of the image, {picture.shape[:2]}"
        raise ArgumentError(f"{name}blur_radius: {rule}; got {radii.shape}")
    ends = []
    for what, array in (("image", picture), ("blur_radius", radii)):
        if array.dtype.kind not in "fiu":
            raise ArgumentError(f"{name}{what}: must hold real numbers; got {array.dtype}")
        ends.append((float(array.min()), float(array.max())))  # NaN if a value is; needs no mask
        if not max(map(abs, ends[-1])) <= LARGEST:
            bad = int((~(np.abs(array.astype(np.float64)) <= LARGEST)).sum())
            rule = f"must be finite, and at most {LARGEST:g} in size"
            raise ArgumentError(f"{name}{what}: {rule}; got {bad} others")
    if picture.dtype.kind != "f":
        kinds = "floats" if alpha else "floats, uint8 or uint16"
        raise ArgumentError(f"{name}image: must be {kinds}; got {picture.dtype}")
    if alpha and not 0.0 <= picture[..., -1].min() <= picture[..., -1].max() <= 1.0:
        raise ArgumentError(f"{name}image: alpha must be from 0 to 1; got {picture[..., -1].max():.4g}")
    largest = max(map(abs, ends[1]))
    if largest > LARGEST_BLUR:
        raise ArgumentError(f"{name}blur_radius: must be at most {LARGEST_BLUR:g} px; got {largest:.4g} px")
