"""Point spread functions whose pupil may be an image, and textures scaled by the light that the aperture transmits."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import PurePath
from typing import TYPE_CHECKING

import numpy as np

from clsco.errors import FileError
from clsco.files.transfer import decode
from clsco.inputs.resampling import resample
from clsco.inputs.textures import Texture, picture_of
from clsco.optics.point_spread import PointSpread, point_spread
from clsco.scene.arrays import Input
from clsco.scene.model import Aperture, Camera, Psf, Scene

if TYPE_CHECKING:
    from clsco.files.images import Picture
    from clsco.optics.pupils.image import Image

Load = Callable[[Input], "Picture"]


def load_point_spread(
    psf: Psf, aperture: Aperture, transfer: str = "srgb", load: Load = picture_of, camera: Camera | None = None
) -> PointSpread:  # fmt: skip
    """Point spread function for a PSF section and an aperture; if the aperture has an image, it is loaded as the pupil.

    transfer: curve of images with 8 and 16 bits, as for textures. load: `clsco.inputs.textures.picture_of`, or a
    replacement. camera: required by psf.model = "wave". Raises FileError if the image of the aperture cannot be read,
    is not square, is not gray, or is black.
    """
    source = aperture.inputs().get("image")
    if source is None:
        return point_spread(psf, aperture, camera=camera)
    if isinstance(source, str) and not PurePath(source).suffix:
        raise FileError(f"aperture.image: must be an image file; got {source!r}")
    try:
        return point_spread(psf, aperture, _pupil(load(source), transfer, aperture), camera)
    except FileError as error:
        raise FileError(f"aperture.image: {error}") from None


def scene_point_spread(scene: Scene, load: Load = picture_of) -> PointSpread:
    """Point spread function of a scene, see `load_point_spread`."""
    return load_point_spread(scene.psf, scene.aperture, scene.image.transfer, load, scene.camera)


def scale_radiance(textures: Sequence[Texture], factor: float) -> tuple[Texture, ...]:
    """Textures with their radiance multiplied by a factor."""
    if factor == 1.0:
        return tuple(textures)
    scaled = {}
    for texture in dict.fromkeys(textures):
        images = [image * np.float32(factor) for image in texture.images]
        scaled[texture] = texture.with_images(images, (texture.content, factor))
    return tuple(scaled[texture] for texture in textures)


def _pupil(picture: Picture, transfer: str, aperture: Aperture) -> Image:
    """Pupil from a picture, reduced to at most MOST_CELLS cells a side."""
    from clsco.optics.pupils.image import MOST_CELLS, image_pupil

    rows, columns = picture.data.shape[:2]
    if rows != columns:
        raise FileError(f"must be a square; got {columns} x {rows} px")
    linear = decode(picture.data, picture.color.transfer(transfer))
    if linear.ndim == 3:
        if (linear != linear[..., :1]).any():
            raise FileError("must be gray; got colors")
        linear = linear[..., 0]
    if linear.min() < 0.0:
        raise FileError(f"must be at least 0 everywhere; got {linear.min():g}")
    side = min(rows, MOST_CELLS)
    cells = resample(linear, (side, side))
    at = (np.arange(side) + 0.5) / side - 0.5
    if not cells[at[:, None] ** 2 + at**2 < 0.25].any():
        raise FileError("must let light pass inside its circle; got black")
    return image_pupil(cells, aperture.rotation, aperture.squeeze)
