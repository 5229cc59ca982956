"""Point spread functions of a scene's lens, over depth, position and channel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from clsco.errors import SceneError
from clsco.optics.exposure import middle_time
from clsco.optics.lens import LARGEST_BLUR, Lens
from clsco.optics.lens_path import camera_at, lens_at, lenses_at
from clsco.optics.point_spread import PointSpread, spread_of_wavelength
from clsco.optics.psf_blocks import WeightBlock, weight_block
from clsco.optics.psf_tables import psf_table, table_weights
from clsco.optics.rays import ray_slopes
from clsco.optics.visibility import NO_GROUP
from clsco.plan.prepare import Prepared, prepare
from clsco.reference.common.equation import Points
from clsco.reference.common.visibility import HIDDEN, PARTLY, check_visibility
from clsco.reference.common.visibility_test import cell_visibility, cut_weights, tap_share
from clsco.scene.file import SceneLike, scene_of
from clsco.scene.model import Camera
from clsco.scene.text import shown

Array = NDArray[np.float64]
HALF = 4  # default number of depths on each side of the focal surface
FIELD = 4  # default number of places from the middle to the corner, if the blur depends on the place
LARGEST_STACK = 2**30  # largest size of the weights, bytes


@dataclass(frozen=True, eq=False)
class PsfStack:
    """Point spread functions of a lens, from the tables that frames are rendered with.

    Attributes
    ----------
    weights : ndarray of float32, (channels, places, depths, rows, columns)
        Fraction of a source's light that each pixel receives; the source is in the middle of (rows, columns). The
        weights of a source sum to 1 or, with aberrations that vary over the frame, to the factor by which these enlarge
        the image.
    depth : ndarray of float64, (depths,)
        Depth Z of the source, mm, from near to far.
    radius : ndarray of float64, (channels, places, depths)
        Signed blur radius R, px.
    at : ndarray of float64, (places, 2)
        Column and row of the source in the frame, px.
    channels : tuple of str
        "red", "green" and "blue"; "all", if all colors blur equally; or wavelengths, as "550 nm".
    name : str
        Name of the pupil, and how it is evaluated on pixels.
    """

    weights: NDArray[np.float32]
    depth: Array
    radius: Array
    at: Array
    channels: tuple[str, ...]
    name: str

    @property
    def reach(self) -> int:
        """Distance from the source to the border of `weights`, px."""
        return self.weights.shape[-1] // 2

    def arrays(self) -> dict[str, NDArray[np.generic]]:
        """Arrays as `clsco psf` writes them to an .npz file, with units in their names."""
        offset = np.arange(-self.reach, self.reach + 1)
        return {
            "weights": self.weights, "channel": np.array(self.channels), "at_px": self.at, "depth_mm": self.depth,
            "inverse_depth_per_mm": 1.0 / self.depth, "blur_radius_px": self.radius, "offset_px": offset,
        }  # fmt: skip


def psf(
    scene: SceneLike, at: Sequence[tuple[float, float]] | None = None, depths: Sequence[float] | None = None,
    index: int = 0, wavelengths: Sequence[float] | None = None,
) -> PsfStack:  # fmt: skip
    """Point spread functions of a scene's lens: the weights that its frames are made with.

    Parameters
    ----------
    scene : Scene, mapping or path
        As for `clsco.render_frame`.
    at : sequence of (column, row), optional
        Positions of sources in the frame, px. By default the middle; if the blur depends on the position, four
        positions from the middle to the corner.
    depths : sequence of float, optional
        Depths Z of sources, mm; may be infinite. By default nine about the focus, from near to far at equal steps of
        1/Z, up to the largest |R| of the scene.
    index : int
        Number of the frame; its lens at the middle of the shutter is used.
    wavelengths : sequence of float, optional
        Wavelengths of light, nm, instead of colors; only with psf.model = "wave" and without `axial` or `lateral`.

    Returns
    -------
    PsfStack

    Raises
    ------
    SceneError, FileError
        As `clsco.render_frame`; a position is outside the frame, a depth not in front of the lens, or its |R| too
        large.

    Notes
    -----
    The weights are read from the same tables as on the device: for one source, all of it visible, on a surface that
    faces the camera, in linear light. `clsco.response` includes occlusion, motion, tilt and the border.
    Validated: equal to the response of a source on such a plane.

    Examples
    --------
    >>> import clsco
    >>> camera = clsco.Camera(resolution=(32, 24), pixel_pitch=0.05)
    >>> stack = clsco.psf(clsco.Scene(camera=camera, objects=(clsco.Plane(distance=300),)), depths=[200, 300])
    >>> stack.weights.shape, stack.radius.round(2).tolist()
    ((1, 1, 2, 7, 7), [[[-2.0, 1.33]]])
    """
    return psf_of(prepare(scene_of(scene)), at, depths, index, wavelengths)


def psf_of(
    prepared: Prepared, at: Sequence[tuple[float, float]] | None = None, depths: Sequence[float] | None = None,
    index: int = 0, wavelengths: Sequence[float] | None = None,
) -> PsfStack:  # fmt: skip
    """`psf` of a prepared scene."""
    scene, plan = prepared.scene, prepared.plan
    if not 0 <= index < scene.sequence.frames:
        raise SceneError(f"psf: frame must be between 0 and {scene.sequence.frames - 1}; got {index}")
    time = middle_time(scene.sequence, index)
    camera, lenses, spreads = camera_at(scene, time), lenses_at(scene, time), plan.spreads or (plan.psf,)
    if wavelengths is not None:
        if scene.separates_colors:
            raise SceneError("psf: wavelengths need lens.axial and lens.lateral that are the same for all colors")
        if not wavelengths:
            raise SceneError("psf: wavelengths must be one or more, in nm; got none")
        spreads = tuple(spread_of_wavelength(spreads[0], scene.camera, wavelength) for wavelength in wavelengths)
    count = max(len(lenses), len(spreads))  # of separately blurred colors, or 1
    inverse = _inverse_depths(lens_at(scene, time), plan.largest_blur) if depths is None else _inverse(depths)
    places = _field(camera) if at is None else _places(camera, at)
    rays = np.stack(ray_slopes(camera, places[:, 1], places[:, 0]), axis=-1)
    lenses, spreads = lenses * (count // len(lenses)), spreads * (count // len(spreads))
    radius = np.empty((count, len(places), len(inverse)))
    for channel, lens in zip(radius, lenses, strict=True):
        channel[:] = lens.image_radius(inverse, rays[:, :1], rays[:, 1:])
    cuts, varies = any(spread.rims for spread in spreads), any(spread.varying for spread in spreads)
    if at is None and not (cuts or varies) and (radius == radius[:, :1]).all():
        places, rays, radius = places[:1], rays[:1], radius[:, :1]
    if (most := float(np.abs(radius).max())) > LARGEST_BLUR:
        raise SceneError(f"psf: |R| must be at most {LARGEST_BLUR:g} px; got {most:.4g} px")
    with np.errstate(divide="ignore"):
        depth = 1.0 / inverse
    names: tuple[str, ...] = ("red", "green", "blue") if count > 1 else ("all",)
    if wavelengths is not None:
        names = tuple(f"{wavelength:g} nm" for wavelength in wavelengths)
    weights = _stacked(spreads, radius, places)
    if cuts:
        for channel, spread, lens, radii in zip(weights, spreads, lenses, radius, strict=True):
            channel[:] = behind_rims(lens, spread, rays, inverse, radii, channel)
    return PsfStack(weights, depth, radius, places, names, plan.psf.name)


def behind_rims(
    lens: Lens, spread: PointSpread, slopes: Array, inverse: Array, radius: Array, weights: NDArray[np.float32]
) -> NDArray[np.float32]:  # fmt: skip
    """Weights (places, depths, n, n) of the light that passes the rims.

    slopes: (places, 2), X / Z and Y / Z; inverse: (depths,), 1 / Z; radius: (places, depths), px; weights: weights of
    the whole lens, of the shape of the result.
    """
    size, count, zero = weights.shape[-1], radius.size, np.zeros(radius.size)
    rays = np.repeat(np.pad(slopes, ((0, 0), (0, 1)), constant_values=1.0), len(inverse), axis=0)
    depths = np.tile(inverse, len(slopes))
    points = Points(rays, depths, radius.ravel(), zero, zero, 1.0, np.zeros((count, 2)))
    state, _, visibility = check_visibility(lens, (), (), NO_GROUP, spread, points)
    passed = np.where(state == HIDDEN, 0.0, 1.0)[:, None, None] * weights.reshape(count, size, size)
    if (partly := state == PARTLY).any():
        cells = cell_visibility(visibility)
        for row, column in np.ndindex(size, size):
            dx, dy, weight = column - size // 2, row - size // 2, passed[partly, row, column]
            weight = cut_weights(visibility, weight, dx, dy, spread.edge == "area")
            passed[partly, row, column] = weight * tap_share(visibility, cells, dx, dy)
    return passed.reshape(*radius.shape, size, size).astype(np.float32)


def _field(camera: Camera) -> Array:
    """Positions (FIELD, 2) from the middle of the frame to its lower right corner."""
    return np.linspace(0.5, 1.0, FIELD)[:, None] * (np.array(camera.frame_size) - 1)


def _places(camera: Camera, at: Sequence[tuple[float, float]]) -> Array:
    columns, rows = camera.frame_size
    positions = np.array(at, dtype=np.float64).reshape(-1, 2)
    for x, y in positions.tolist():
        if not (0.0 <= x <= columns - 1 and 0.0 <= y <= rows - 1):
            rule = f"must be in the frame, columns 0 to {columns - 1} and rows 0 to {rows - 1}"
            raise SceneError(f"psf: at: {rule}; got {shown([x, y])}")
    return positions


def _inverse(depths: Sequence[float]) -> Array:
    sorted_depths = np.array(sorted(depths), dtype=np.float64)
    if not sorted_depths.size or not (sorted_depths > 0.0).all():
        raise SceneError(f"psf: depths must be one or more distances in mm, above 0; got {shown(list(depths))}")
    return 1.0 / sorted_depths


def _inverse_depths(lens: Lens, largest: float) -> Array:
    """Inverse depths in 1/mm, from near to far, up to |R| = `largest` px on both sides of the focus."""
    power, margin = lens.focus_power, largest / lens.blur_scale
    near, far = power + margin, max(power - margin, 0.0)
    if not far < power < near:
        return np.linspace(max(near, far), far, 2 * HALF + 1) if near > far else np.array([far])
    return np.concatenate([np.linspace(near, power, HALF + 1), np.linspace(power, far, HALF + 1)[1:]])


def _stacked(spreads: Sequence[PointSpread], radius: Array, places: Array) -> NDArray[np.float32]:
    """Weights (channels, places, depths, n, n) at blur radii (channels, places, depths), by the PSF of each channel."""
    keys = [
        (spread, r, (x, y) if spread.varying else None)
        for spread, channel_radii in zip(spreads, radius, strict=True)
        for (x, y), radii in zip(places.tolist(), channel_radii.tolist(), strict=True)
        for r in radii
    ]
    weights_by_key = {key: spread_weights(*key) for key in dict.fromkeys(keys)}
    reach = max(key.shape[0] // 2 for key in weights_by_key.values())
    if (size := 4 * radius.size * (2 * reach + 1) ** 2) > LARGEST_STACK:
        rule = f"psf: must take at most {LARGEST_STACK >> 20} MiB"
        raise SceneError(f"{rule}; got {size >> 20} MiB: ask for fewer depths")
    stack = np.zeros((radius.size, 2 * reach + 1, 2 * reach + 1), np.float32)
    for square, key in zip(stack, keys, strict=True):
        far = weights_by_key[key].shape[0] // 2
        square[reach - far : reach + far + 1, reach - far : reach + far + 1] = weights_by_key[key]
    return stack.reshape(*radius.shape, *stack.shape[1:])


def spread_weights(spread: PointSpread, radius: float, place: tuple[float, float] | None = None) -> NDArray[np.float32]:
    """Weights (n, n) of a source with a signed blur radius in px, from the tables that a device reads.

    place: column and row of the source in the frame, if weights vary over the frame.
    """
    if spread.varying is None or place is None:
        return table_weights(psf_table(spread, abs(radius), abs(radius), blocks=_block), spread, radius)
    pairs = zip(*spread.varying.blend(*place), strict=True)
    parts = [np.float32(share) * spread_weights(spread.places[n], radius) for n, share in pairs]
    return np.asarray(sum(parts), np.float32)


@lru_cache(maxsize=64)
def _block(spread: PointSpread, first: int, subpixel: int) -> WeightBlock:
    return weight_block(spread, first, subpixel)
