"""Rims in front of and behind a lens: circles through which points of a scene see its aperture (float64, pure)."""

from __future__ import annotations

import numpy as np

from clsco.optics.chords import Array, open_share
from clsco.optics.lens import Lens
from clsco.optics.lens_path import camera_at, lens_at
from clsco.optics.point_spread import PointSpread, Rim
from clsco.optics.rays import ray_slopes
from clsco.optics.vignetting import throughput
from clsco.scene.model import Scene

LEAST_SPREAD = 1e-6  # least width in a rim, relative to the lens, of the rays from a point through the lens
CELLS = 24  # cells per lens radius over which light is summed
POINTS = 1024  # number of points at a time, so that their data stays in the caches
NODES = 257  # positions along each side of a frame between which `frame_throughput` is linear


def rim_circle(lens: Lens, rim: Rim, slopes: Array, w: Array, radius: Array) -> tuple[Array, Array, Array]:
    """Circle in lens coordinates inside which light from points passes a rim: x, y of its center, right and down, and
    its radius (N,), in lens radii; the radius is infinite for points between rim and lens.

    slopes: X / Z and Y / Z (N, 2) of the points, right and up; w: 1 / Z, 1/mm; radius: signed blur radius, px. A ray to
    lens point l (of radius D / 2) passes a rim at distance d in front of the lens at l D/2 (1 - d w) + d slope, and
    behind it, d < 0, on its way to the detector, at l D/2 (1 + d / s + d R / kappa) + d slope.
    """
    d = rim.distance
    spread = 1 + d * (-w if d > 0 else lens.detector_power + radius / lens.blur_scale)
    across = lens.radius * np.where(spread < 0, np.minimum(spread, -LEAST_SPREAD), np.maximum(spread, LEAST_SPREAD))
    size = np.where((d > 0) & (spread <= 0), np.inf, rim.radius / np.abs(across))
    return -d * slopes[:, 0] / across, d * slopes[:, 1] / across, size


def frame_throughput(scene: Scene, time: float, psf: PointSpread) -> Array:
    """Irradiance (rows, columns) of each pixel relative to the middle of the frame, by vignetting and rims; time in s.

    A pixel sees the same part of the lens through the rims at any depth of the scene: the part that its own point in
    focus sees. In frames of more than 257 pixels along a side, it is computed at 257 positions and interpolated
    linearly, with errors of up to 1e-3 between positions where rims begin to cut and where they block all light.
    """
    camera = camera_at(scene, time)
    image = throughput(camera, "none" if scene.lens is None else scene.lens.vignetting)
    if not psf.rims:
        return image
    (columns, rows), lens = camera.frame_size, lens_at(scene, time)
    down, across = (np.linspace(0.0, n - 1.0, min(n, NODES)) for n in (rows, columns))
    slopes = np.stack(ray_slopes(camera, down[:, None], across), axis=-1).reshape(-1, 2)
    in_focus = lens.blur_radius(0.0, (slopes * slopes).sum(axis=1)) / lens.blur_scale + np.zeros(len(slopes))
    share = rim_throughput(lens, psf, slopes, in_focus, np.zeros(len(slopes))).reshape(down.size, across.size)
    lines = np.stack([np.interp(np.arange(columns), across, line) for line in share])
    return np.asarray(image * np.stack([np.interp(np.arange(rows), down, line) for line in lines.T], axis=1))


def rim_throughput(lens: Lens, psf: PointSpread, slopes: Array, w: Array, radius: Array) -> Array:
    """Fraction (N,) of the light through the aperture that passes all rims; arguments as for `rim_circle`.

    Computed as an area if the PSF is `cut_by_chords`, else as a sum over cells of the lens, to 0.5 %.
    """
    shares = np.ones(w.shape)
    parts = [slice(start, start + POINTS) for start in range(0, w.size, POINTS)]
    if psf.cut_by_chords:
        for part in parts:
            circles = [rim_circle(lens, rim, slopes[part], w[part], radius[part]) for rim in psf.rims]
            shares[part] = open_share(circles, psf.pupil.borders) / psf.pupil.light
        return shares
    at = (np.arange(2.0 * CELLS) + 0.5 - CELLS) * psf.extent / CELLS
    x, y = (axis.ravel() for axis in np.meshgrid(at, at))
    cells = psf.pupil.cells(CELLS).ravel()
    x, y, cells = x[cells > 0], y[cells > 0], cells[cells > 0] / cells.sum()
    for part in parts:
        passes = np.ones((shares[part].size, x.size))
        for rim in psf.rims:
            right, down, size = rim_circle(lens, rim, slopes[part], w[part], radius[part])
            away = np.hypot(x - right[:, None], y - down[:, None])
            passes *= np.clip((size[:, None] - away) * CELLS / psf.extent + 0.5, 0.0, 1.0)
        shares[part] = passes @ cells
    return shares
