"""Rays through the pixels of a camera, and positions in its image (float64, pure)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from clsco.optics.distortion import Array, distortion_of
from clsco.optics.lens import ray_step
from clsco.scene.model import Camera


def ray_slopes(camera: Camera, row: ArrayLike, column: ArrayLike) -> tuple[Array, Array]:
    """Slopes X / Z right and Y / Z up of rays through pixels (3.1, 3.2), which may be fractional or off the frame."""
    columns, rows = camera.frame_size
    return slopes_at(camera, np.asarray(column) - 0.5 * (columns - 1), 0.5 * (rows - 1) - np.asarray(row))


def slopes_at(camera: Camera, right: ArrayLike, up: ArrayLike) -> tuple[Array, Array]:
    """Slopes x, y of the rays through image points; right, up: px from the middle of the image, which broadcast."""
    step, distortion = ray_step(camera), distortion_of(camera)
    x, y = np.broadcast_arrays(*(step * np.asarray(offset, dtype=np.float64) for offset in (right, up)))
    return (x, y) if distortion is None else distortion.undistorted(x, y)


def places_of(camera: Camera, x: ArrayLike, y: ArrayLike) -> tuple[Array, Array]:
    """Positions in px right of and above the middle of the image for rays of slopes x and y (2.4, 2.5)."""
    step, (across, up) = ray_step(camera), image_slopes(camera, x, y)
    return across / step, up / step


def image_slopes(camera: Camera, x: ArrayLike, y: ArrayLike) -> tuple[Array, Array]:
    """Distorted slopes of rays whose slopes in the scene are x and y; without distortion, x and y."""
    distortion = distortion_of(camera)
    return (np.asarray(x), np.asarray(y)) if distortion is None else distortion.image(x, y)


def ray_changes(camera: Camera, x: Array, y: Array) -> tuple[Array, Array, Array]:
    """Derivatives of a ray's slopes by its image position, per px: dx/d(right), dy/d(right) = dx/d(up), dy/d(up)."""
    step, distortion = ray_step(camera), distortion_of(camera)
    if distortion is None:
        return np.full(x.shape, step), np.zeros(x.shape), np.full(x.shape, step)
    xx, xy, yy = distortion.jacobian(x, y)
    over = step / (xx * yy - xy * xy)
    return yy * over, -xy * over, xx * over
