"""Response of a frame to one source: renders scenes in which only that source is lit."""

from __future__ import annotations

import math
import operator
from dataclasses import dataclass
from typing import Any, SupportsIndex

import numpy as np
from numpy.typing import NDArray

from clsco.engine.sequence import frame_numbers, render_frame
from clsco.errors import SceneError
from clsco.frame.frame import GREEN, Frame
from clsco.inputs.files import InputFiles
from clsco.inputs.focus import find_visible
from clsco.opencl.session import DeviceLike
from clsco.optics.exposure import middle_time, shutter_span
from clsco.optics.lens_path import camera_at, reference_camera
from clsco.optics.motion import poses_at, rest_center, rest_poses
from clsco.optics.quadrics import place, predict_inverse_depth
from clsco.optics.rays import places_of, slopes_at
from clsco.optics.vignetting import throughput
from clsco.plan.prepare import Prepared, prepare
from clsco.scene.arrays import ArrayInput
from clsco.scene.file import SceneLike, scene_of
from clsco.scene.model import Object, Scene
from clsco.scene.text import shown
from clsco.scene.texture_keys import SixSided, Textured

BLACK = "#000000"
GRID = 33  # points of an object per axis of the frame at which its motion is evaluated
TIMES = 9  # times of an exposure at which motions are evaluated
FILTER_REACH = 2  # texels of a bicubic filter


@dataclass(frozen=True, eq=False)
class IsolatedSource:
    """A scene in which one source is lit."""

    scene: Scene  # its frame includes the margin
    margin: int  # width on each side of the frame, px
    share: NDArray[np.float32] | None = None  # vignetting, by which to multiply the frame without its margin

    def inside(self, frame: Frame) -> NDArray[np.float32]:
        """Response (rows, columns) from a frame of the scene, without the margin; of green if the frame has color."""
        image = frame.color if frame.color.ndim == 2 else frame.color[..., GREEN]
        rows, columns = image.shape
        inside = image[self.margin : rows - self.margin, self.margin : columns - self.margin]
        return inside if self.share is None else inside * self.share


def response(
    scene: SceneLike,
    x: int,
    y: int,
    index: int = 0,
    *,
    item: int | None = None,
    device: DeviceLike = None,
    precision: str | None = None,
) -> NDArray[np.float32]:
    """Response of a frame to one source: its point spread function with occlusion, motion and border.

    Parameters
    ----------
    scene : Scene, mapping or path
        As for `render_frame`.
    x, y : int
        Column and row of the source in the image at t = 0, px. The source may be outside the frame, as far as the blur
        reaches, except with `border = "renormalize"` and for scenes with depth maps.
    index : int
        Number of the frame, from 0.
    item : int, optional
        Number of the object with the source, from 0; by default the object visible there at t = 0.
    device, precision
        As for `render_frame`.

    Returns
    -------
    ndarray of float32, (rows, columns)
        Irradiance in the frame if the source has radiance 1 and all else is black; of green light if the lens separates
        colors.

    Raises
    ------
    SceneError, FileError, DeviceError, KernelError
        As `render_frame`; SceneError also if x, y or `item` is out of range, or no object is visible at x, y.

    Notes
    -----
    A frame is the sum of radiance times response over all its sources, unless missing pixels are filled. The response
    does not include a sensor, which comes after the blur. The source is a pixel of a texture projected from the camera
    at t = 0, and moves with its surface; the scene's own texture mapping and light are ignored. Validated against that
    sum and the response of `clsco.reference` (tests/engine/test_response.py).

    Examples
    --------
    >>> import clsco
    >>> ball = clsco.Sphere(center=(0, 0, 280), radius=30)
    >>> scene = clsco.Scene(camera=clsco.Camera(resolution=(32, 24), pixel_pitch=0.2), objects=(ball,))
    >>> spread = clsco.response(scene, 16, 12)
    >>> spread.shape, round(float(spread.sum()), 4)
    ((24, 32), 1.0)
    """
    isolated = isolate_source(scene_of(scene), x, y, index, item)
    return isolated.inside(render_frame(isolated.scene, index, truth=(), device=device, precision=precision))


def isolate_source(
    scene: Scene,
    x: SupportsIndex,
    y: SupportsIndex,
    index: int = 0,
    item: int | None = None,
    files: InputFiles | None = None,
) -> IsolatedSource:
    """The scene in which only one source is lit; arguments and errors are those of `response`.

    files: as for `clsco.plan.prepare.prepare`.
    """
    frame_numbers([scene], [index])
    number = None if item is None else _within("item", item, 0, len(scene.objects) - 1)
    prepared = prepare(scene, files=files)
    plan = prepared.plan
    widens = scene.is_analytic and scene.psf.border == "lose"
    guard = plan.guard_px if widens else 0
    column = _within("x", x, -guard, plan.columns - 1 + guard)
    row = _within("y", y, -guard, plan.rows - 1 + guard)
    number = _visible_object(prepared, column, row) if number is None else number
    # Beyond the frame, textures continue as mirror images. A margin moves the source's images too far away to be seen.
    inward = min(column, row, plan.columns - 1 - column, plan.rows - 1 - row)
    far = plan.guard_px + FILTER_REACH + (_longest_displacement(plan.scene, number, index) if scene.moves else 0)
    margin = far - min(inward, 0) if widens and inward < far else 0
    columns, rows = plan.columns + 2 * margin, plan.rows + 2 * margin
    texture = np.zeros((rows, columns) if plan.channels == 1 else (rows, columns, 3), np.float32)
    texture[row + margin, column + margin] = 1.0
    objects = [_project_texture(object_, BLACK) for object_ in scene.objects]
    objects[number] = _project_texture(scene.objects[number], ArrayInput(texture, "texture"))
    camera = scene.camera.model_copy(update={"resolution": (columns, rows)})
    share, update = None, dict[str, Any](camera=camera, objects=tuple(objects), light=None, sensor=None)
    if scene.lens is not None and scene.darkens:  # for the frame without its margin, in mid-exposure
        middle = middle_time(scene.sequence, index) if scene.moves else 0.0
        share = throughput(camera_at(prepared.scene, middle), scene.lens.vignetting).astype(np.float32)
        update["lens"] = scene.lens.model_copy(update={"vignetting": "none"})
    return IsolatedSource(scene.model_copy(update=update), margin, share)


def _visible_object(prepared: Prepared, column: int, row: int) -> int:
    """Number of the object visible in a pixel at t = 0. Raises SceneError if there is none."""
    number = int(find_visible(prepared.scene, prepared.maps, np.array([row]), np.array([column]))[1][0, 0])
    if number < 0:
        raise SceneError(f"x, y: must be on a surface at t = 0; got nothing at {column}, {row}")
    return number


def _within(name: str, value: SupportsIndex, least: int, most: int) -> int:
    """Convert a value to an int; raises SceneError unless it is a whole number from `least` to `most`."""
    try:
        number = operator.index(value)
    except TypeError:
        number = least - 1
    if not least <= number <= most:
        raise SceneError(f"{name}: must be a whole number from {least} to {most}; got {shown(value)}")
    return number


def _project_texture(item: Object, texture: str | ArrayInput) -> Object:
    """The object with `texture` in place of its own, projected from the camera at t = 0."""
    keys = {*Textured.model_fields, *SixSided.model_fields} & type(item).model_fields.keys()
    plain = {key: type(item).model_fields[key].default for key in keys}
    return item.model_copy(update=plain | {"texture": texture})


def _longest_displacement(scene: Scene, number: int, index: int) -> int:
    """Largest displacement in the image of a point of an object from its place in the reference pose, px, rounded up.

    number: number of the object; index: number of the frame during whose exposure the object moves.
    """
    item, camera = scene.objects[number], reference_camera(scene)
    x, y = slopes_at(camera, *np.meshgrid(*(np.linspace(-0.5, 0.5, GRID) * side for side in camera.frame_size)))
    w = predict_inverse_depth(item, place(item, rest_poses(scene)[number]), x, y)
    hit = (w > 0) | item.is_background
    if not hit.any():
        return 0
    rays, center = np.stack([x, y, np.ones_like(x)])[:, hit], rest_center(item)[:, None]
    body = rays - w[hit] * center  # homogeneous: a point at infinity has w = 0
    longest = 0.0
    for time in np.linspace(*shutter_span(scene.sequence, index), TIMES).tolist():
        pose = poses_at(scene, time)[number]
        point = w[hit] * (center + pose.shift[:, None]) + pose.rotation @ body
        image_place = places_of(camera_at(scene, time), *(point[:2] / np.maximum(point[2], 1e-3)))
        longest = max(longest, float(np.hypot(*np.subtract(image_place, places_of(camera, *rays[:2]))).max()))
    return math.ceil(min(longest, max(scene.camera.frame_size)))
