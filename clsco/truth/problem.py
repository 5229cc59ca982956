"""A scene as arrays for rays: surfaces by textbook formulas, images, and their state at many times (float64)."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from clsco.inputs.files import shared_files
from clsco.scene.model import Scene
from clsco.scene.sequence import CURVES
from clsco.truth.images import CUBE, SIZE, lies, mapping_of
from clsco.truth.poses import camera_at, lens_at, poses_at, static_rotation
from clsco.truth.pupils import Pupil, Wavefront, pupil_of, wavefront_of

Array = NDArray[np.float64]
TOUCHING = 1e-7  # tolerance of bounds, as a share of the largest bound
FARTHEST = 1e12  # mm, distance of a background
MOMENTS = 8192  # number of moments from the first opening to the last closing of the shutter
QUANTILES = 4096  # number of quantiles of the light through a shutter


class Surfaces(NamedTuple):
    """Surfaces and their images.

    `shapes` (3, objects, 12): coefficients (10), bounds (7), and rotation and center in the reference pose; `mappings`
    (objects, SIZE): numbers of texture mappings; `images` (texels, channels); `background`: number of the background,
    or -1; `light` (5,): position of the light or direction to it, 1 for a position, else 0, and the ambient fraction;
    empty without a light.
    """

    shapes: Array
    mappings: Array
    images: Array
    background: int
    light: Array


class Moments(NamedTuple):
    """Time-dependent values at the middles of equal intervals.

    `poses` (times, objects, 12); `cameras` (times, 12): rotation, and position of the light or direction to it in the
    camera's frame; `lenses` (times, 4); `quantiles` of the light through the shutter, whose duration is 1; `clock`:
    shutter and readout as fractions of the whole time; 1 if columns are exposed in turn, else 0; 1 if the last line is
    exposed first, else 0.
    """

    poses: Array
    cameras: Array
    lenses: Array
    quantiles: Array
    clock: Array


class Optics(NamedTuple):
    """The lens, as numbers for rays.

    `pupil`: numbers, rows and columns of `Pupil`; `wavefront`: see `Wavefront`; `rims` (n, 2): distance and radius in
    mm; `bands` (1 or 3, 2): magnification and addition to K; `numbers`: columns, rows, pitch / s0 in the reference
    pose, pitch, field curvature, 1 if a sphere is in focus, k1, k2, k3, p1, p2 (y up), vignetting (0 none, 1 natural, 2
    by the next three), a1, a2, a3, exposure, 1/f - 1/s of the camera, number of times that each ray is cast (3 if the
    lens varies over the frame, else 1), and 1 if the wavefront has errors.
    """

    pupil: tuple[Array, Array, Array]
    wavefront: Wavefront
    rims: Array
    bands: Array
    numbers: Array


class Problem(NamedTuple):
    """A frame of a scene in one view, as input for rays."""

    scene: Scene
    surfaces: Surfaces
    moments: Moments
    optics: Optics

    @property
    def size(self) -> tuple[int, int]:
        """Rows and columns of the frame."""
        columns, rows = self.scene.camera.frame_size
        return rows, columns


def surface_of(item: Any) -> tuple[Array, Any, tuple[float, float]]:
    """Coefficients (10,), center (3) in mm, and z range (2) of an object's surface.

    The coefficients are a200 a020 a002 a110 a011 a101 a100 a010 a001 a000, relative to the center, x right, y up, z
    away from the camera. Raises ValueError for an unknown shape.
    """
    k = np.zeros(10)
    everywhere = (-np.inf, np.inf)
    match item.shape:
        case "plane":  # b x + c y - z = 0 about (0, 0, a)
            k[6:9] = item.slope_x, item.slope_y, -1.0
            return k, (0.0, 0.0, item.distance), everywhere
        case "rectangle" | "disc":  # z = offset about its center
            k[8:] = 1.0, -item.offset
            return k, item.center, everywhere
        case "sphere":
            k[[0, 1, 2, 9]] = 1.0, 1.0, 1.0, -(item.radius**2)
            return k, item.center, everywhere
        case "ellipsoid":
            k[:3], k[9] = 1.0 / np.asarray(item.semi_axes, float) ** 2, -1.0
            return k, item.center, everywhere
        case "cylinder":  # |q|^2 - (q . axis)^2 = radius^2
            x, y, z = np.asarray(item.axis, float) / np.linalg.norm(item.axis)
            k[:6] = 1 - x * x, 1 - y * y, 1 - z * z, -2 * x * y, -2 * y * z, -2 * x * z
            k[9] = -(item.radius**2)
            return k, item.center, everywhere
        case "cone":
            k[:3] = 1.0, 1.0, -(math.tan(math.radians(item.half_angle)) ** 2)
            return k, item.apex, (0.0, np.inf) if item.nappe == "away" else (-np.inf, 0.0)
        case "quadric":
            return np.asarray(item.coefficients, float), item.center, everywhere
        case "background":  # no surface: rays that meet no surface show it
            return k, (0.0, 0.0, FARTHEST), everywhere
    raise ValueError(f"rays: shape must be analytic; got {item.shape!r}")


def bounds_of(item: Any, span: tuple[float, float]) -> Array:
    """Bounds (7,) of an object: x0 x1 y0 y1 z0 z1 in its frame, and largest x^2 + y^2; span: z range of the shape."""
    box = np.array([-np.inf, np.inf] * 3 + [np.inf])
    if item.bounds is not None:
        box[:6] = np.ravel(item.bounds)
        slack = TOUCHING * np.abs(box[:6][np.isfinite(box[:6])]).max(initial=0.0)
        box[:6] += np.array([-slack, slack] * 3)
    box[4:6] = max(box[4], span[0]), min(box[5], span[1])
    if item.shape == "disc":
        box[6] = item.radius**2
    return box


def not_judged(scene: Scene) -> str | None:
    """Reason why rays cannot predict a frame of the scene; None if they can."""
    if not scene.is_analytic:
        return "depth maps have no surfaces that rays could meet behind others"
    varies = set(scene.psf.seidel.model_dump(exclude_unset=True)) - {"W040"} or scene.lens is not None
    if scene.psf.model == "wave" and (varies or scene.moves):
        return "waves are summed through a lens that is the same all over the field, and of what stands still"
    return None


def make_problem(scene: Scene, frame: int = 0, eye: str = "") -> Problem:
    """Read a scene that rays can predict, with its resolution; frame: index; eye: view of a stereo pair."""
    aperture, pupil = scene.aperture.model_copy(update={"exposure": "normalized"}), pupil_of(scene)
    textures = shared_files().textures(scene.model_copy(update={"aperture": aperture}))
    exposure = pupil.light if scene.aperture.exposure == "area" else 1.0
    surfaces = _surfaces(scene, [texture.images for texture in textures])
    return Problem(scene, surfaces, _moments(scene, frame, eye, surfaces.light), _optics(scene, pupil, exposure))


def _surfaces(scene: Scene, textures: Any) -> Surfaces:
    color = scene.separates_colors or any(image.ndim == 3 for images in textures for image in images)
    texels, mappings, count, stored = [], np.zeros((len(scene.objects), SIZE)), 0, list[tuple[Any, int]]()
    for n, (item, images) in enumerate(zip(scene.objects, textures, strict=True)):
        rows, columns = images[0].shape[:2]
        begin = next((place for image, place in stored if image is images[0]), count)
        if begin == count:
            stored.append((images[0], count))
            for image in images:
                wide = image.reshape(rows * columns, -1)
                texels.append(np.broadcast_to(wide, (rows * columns, 3 if color else 1)))
                count += rows * columns
        mappings[n, :4] = 0, begin, rows, columns
        if lies(item):
            mappings[n] = mapping_of(item, (rows, columns), begin, scene.motion.texture_filter)
            assert len(images) == 1 or mappings[n, 0] == CUBE
    surfaces = [surface_of(item) for item in scene.objects]
    background = next((n for n, item in enumerate(scene.objects) if item.is_background), -1)
    light = np.zeros(0)
    if scene.light is not None:
        place = scene.light.position or np.multiply(scene.light.direction or (), [1.0, 1.0, -1.0])
        light = np.array([*place, float(scene.light.position is not None), scene.light.ambient])
    shapes = np.zeros((3, len(surfaces), 12))
    for n, (item, (coefficients, center, span)) in enumerate(zip(scene.objects, surfaces, strict=True)):
        shapes[0, n, :10], shapes[1, n, :7] = coefficients, bounds_of(item, span)
        shapes[2, n, :9], shapes[2, n, 9:] = static_rotation(item.rotation).ravel(), center
    return Surfaces(shapes, mappings, np.ascontiguousarray(np.concatenate(texels), np.float32), background, light)


def poses_of(scene: Scene, eye: str, times: Array) -> tuple[Array, tuple[Array, Array]]:
    """Poses of all objects in the frame of a camera, as from `poses_at`, and poses of the camera."""
    centers = np.array([surface_of(item)[1] for item in scene.objects], float)
    rotations = np.array([static_rotation(item.rotation) for item in scene.objects])
    camera = camera_at(scene, eye, times)
    return poses_at(scene, centers, rotations, camera, times), camera


def _moments(scene: Scene, frame: int, eye: str, light: Array) -> Moments:
    sequence = scene.sequence
    span = sequence.shutter + sequence.readout
    begins = frame * sequence.interval + sequence.shutter_start
    times = begins + span * (np.arange(MOMENTS) + 0.5) / MOMENTS if scene.moves else np.zeros(1)
    poses, camera = poses_of(scene, eye, times)
    cameras = np.concatenate([camera[0].reshape(-1, 9), np.zeros((len(times), 3))], axis=1)
    if light.size:
        cameras[:, 9:] = np.einsum("tji,tj->ti", camera[0], light[:3] - light[3] * camera[1])
    curve = sequence.shutter_curve
    weights = np.asarray(CURVES[curve] if isinstance(curve, str) else curve, float)
    at = np.linspace(0.0, 1.0, 64 * QUANTILES + 1)
    open_at = np.interp(at, np.linspace(0.0, 1.0, len(weights)), weights / weights.max())
    passed = np.concatenate([[0.0], np.cumsum(open_at[1:] + open_at[:-1])])
    quantiles = np.interp(np.linspace(0.0, passed[-1], QUANTILES + 1), passed, at)
    backwards = sequence.scan in ("bottom_to_top", "right_to_left")
    clock = np.array([sequence.shutter / span, sequence.readout / span, sequence.by_columns, backwards])
    return Moments(poses, cameras, lens_at(scene, times), quantiles, clock)


def _optics(scene: Scene, pupil: Pupil, exposure: float) -> Optics:
    camera, lens = scene.camera, scene.lens
    rims = np.array([(rim.distance, rim.diameter / 2) for rim in scene.aperture.rim], float).reshape(-1, 2)
    bands, numbers = np.array([[1.0, 0.0]]), np.zeros(19)
    columns, rows = camera.frame_size
    pitch, f = camera.pixel_pitch, camera.focal_length
    numbers[:4] = columns, rows, pitch / camera.normalization_distance, pitch
    numbers[15:18] = exposure, 1 / f - 1 / camera.sensor_distance, 1
    if lens is not None:
        numbers[4:6] = lens.field_curvature, lens.focus_surface == "sphere"
        numbers[6:9], numbers[9], numbers[10] = lens.radial, -lens.tangential[0], lens.tangential[1]
        if isinstance(lens.vignetting, str):
            numbers[11] = 1 if lens.vignetting == "natural" else 0
        else:
            numbers[11:15] = 2, *lens.vignetting
        if scene.separates_colors:
            bands = np.array([(size, 1 / (f + longer) - 1 / f) for size, longer in zip(lens.lateral, lens.axial)])  # noqa: B905
    wavefront = wavefront_of(scene)
    numbers[18] = any(part.any() for part in wavefront)
    if numbers[4] or numbers[5] or wavefront.field.any():
        numbers[17] = 3
    return Optics(pupil[:3], wavefront, rims, bands, numbers)
