"""Focus: describes the blur of depth maps, and focuses lenses on a point or on a quantile of the depths."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from clsco.errors import SceneError
from clsco.inputs.depth_maps import FARTHEST
from clsco.optics.lens import SHARP
from clsco.optics.lens_path import camera_at, lens_at, reference_camera
from clsco.optics.motion import poses_at
from clsco.optics.quadrics import place, predict_inverse_depth
from clsco.optics.rays import ray_slopes
from clsco.scene.model import DepthMap, Scene
from clsco.scene.quantities import MAX_LENGTH_MM, MIN_LENGTH_MM

Array = NDArray[np.float64]
MOST_POINTS = 2**20  # largest number of pixels from which a quantile of depth is computed


Focus = tuple[int, int] | float
"""Target of the focus: a pixel (column, row), or the share of surface pixels that are nearer, 0 to 1."""


def lens_line(scene: Scene, w: Array) -> str:
    """Text about a depth map: the range of its blur radius R, the share of pixels in focus, and warnings.

    w: inverse depth (rows, columns), 1/mm, 0 for pixels without a surface; at least one pixel has a surface. Example:
    "R -0.1 to 33 px; in focus: 12 % of the picture". A pixel is in focus if |R| is at most `SHARP`.
    """
    seen = w[w > 0]
    near, far, camera = float(seen.max()), float(seen.min()), scene.camera
    x, y = ray_slopes(reference_camera(scene), *np.ogrid[: w.shape[0], : w.shape[1]])
    radii = lens_at(scene, 0.0).image_radius(seen, x[w > 0], y[w > 0])
    sharp = int(np.count_nonzero(np.abs(radii) <= SHARP))
    low, high = (round(float(end), 2) + 0.0 for end in (radii.min(), radii.max()))
    percent = "under 1" if 0 < 100 * sharp < w.size else f"{100 * sharp // w.size}"
    line = f"R {low:.3g} to {high:.3g} px; in focus: {percent} % of the picture"
    depths = f"depths {_distance(near)} to {_distance(far)}, focus at {camera.focused_distance:.6g} mm"
    if sharp == 0:
        line += f" ({depths}; a pixel or a share of the depths can be focused on)"
    elif sharp == seen.size:
        lengths = f"focal length {camera.focal_length:g} mm, pixel pitch {camera.pixel_pitch:g} mm"
        line += f" (nothing is blurred by more than a pixel: {depths}, {lengths}; is the unit of each right?)"
    return line


def _distance(w: float) -> str:
    return f"{1.0 / w:.6g}" if w > FARTHEST else "infinity"


def focus_scene(scene: Scene, load: Callable[[Scene], Sequence[Array | None]], focus: Focus) -> Scene:
    """The scene with its lens focused, at t = 0, on the surface at a point or at a quantile of the depths.

    scene: a scene with a resolution. load: `InputFiles.maps`, or a replacement. The lens gets a focus distance or, for
    infinity, its detector moves to the focal length. Raises SceneError if the point is outside of the picture, shows no
    surface, or is within the focal length; also if a depth map stores blur radii, because their depths depend on the
    focus. Raises FileError if a depth map cannot be read. Quantiles use at most 2^20 pixels at equal steps. Validated
    on planes, spheres and depth maps of known depth.
    """
    columns, rows = scene.camera.frame_size
    if any(isinstance(item, DepthMap) and item.unit == "coc" for item in scene.objects):
        raise SceneError('focus: depths must be known; got unit = "coc", whose radii say what is in focus')
    pinhole = scene.camera.model_copy(update={"aperture_diameter": MIN_LENGTH_MM})  # so that no blur is too large
    maps = load(scene.model_copy(update={"camera": pinhole}))
    if isinstance(focus, tuple):
        x, y = focus
        if not (0 <= x < columns and 0 <= y < rows):
            raise SceneError(f"focus: must be a pixel of the {columns} x {rows}, counted from 0; got {x},{y}")
        nearest, whose = find_visible(scene, maps, np.array([y]), np.array([x]))
        w = float(nearest[0, 0])
        if whose[0, 0] < 0:
            raise SceneError(f"focus: must be on a surface; got nothing at {x},{y}")
    else:
        step = 1 + int(np.sqrt(rows * columns / MOST_POINTS))
        depths, _ = find_visible(scene, maps, np.arange(0, rows, step), np.arange(0, columns, step))
        if not (depths > 0).any():
            raise SceneError("focus: must be on a surface; got nothing in the picture")
        w = float(np.quantile(depths[depths > 0], 1.0 - focus, method="nearest"))
    if w * scene.camera.focal_length >= 1.0:
        rule = f"focus: must be on a surface beyond the focal length, {scene.camera.focal_length:g} mm"
        raise SceneError(f"{rule}; got a depth of {1.0 / w:.4g} mm (is it in another unit, such as m?)")
    if w * MAX_LENGTH_MM < 1.0:
        return scene.replace("camera.sensor_distance", scene.camera.focal_length)
    return scene.replace("camera.focus_distance", 1.0 / w)


def find_visible(
    scene: Scene, maps: Sequence[Array | None], i: NDArray[np.intp], j: NDArray[np.intp]
) -> tuple[Array, NDArray[np.intp]]:
    """Inverse depth in 1/mm and object number (len(i), len(j)) of what is visible in rows i and columns j at t = 0.

    maps: as returned by `InputFiles.maps`. For a pixel without a surface, the inverse depth is 0, and the number is
    that of the background, or -1 if there is none. With a depth map, i and j must be in the frame.
    """
    x, y = ray_slopes(camera_at(scene, 0.0), i[:, None], j)
    behind = next((number for number, item in enumerate(scene.objects) if item.is_background), -1)
    nearest, whose = np.zeros(x.shape), np.full(x.shape, behind)
    for number, (item, pose, depth) in enumerate(zip(scene.objects, poses_at(scene, 0.0), maps, strict=True)):
        w = predict_inverse_depth(item, place(item, pose), x, y) if depth is None else depth[np.ix_(i, j)]
        whose[w > nearest] = number
        np.maximum(nearest, w, out=nearest)
    return nearest, whose
