"""Reference renderer: a whole scene in NumPy float64, which the device is checked against."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.frame.frame import MAPPING_NAMES, MOTION_NAMES, Frame
from clsco.inputs.depth_maps import load_scene_depths
from clsco.inputs.pupils import scene_point_spread
from clsco.inputs.textures import Texture as TextureImage
from clsco.inputs.textures import load_scene_textures, radiance_span
from clsco.optics.depth_truth import map_flow, map_normal, map_occluded, map_stereo
from clsco.optics.exposure import frame_exposure, middle_time
from clsco.optics.lens import Lens
from clsco.optics.motion import Eye, Pose, poses_at, rest_poses
from clsco.optics.point_spread import PointSpread
from clsco.optics.quadrics import PlacedSurface, place
from clsco.optics.texture_mapping import texture_map
from clsco.optics.visibility import OcclusionGroup
from clsco.plan.plan import Plan, make_plan
from clsco.plan.predict import Maps
from clsco.reference.blur.accumulate import accumulate
from clsco.reference.blur.blur import prepare_sources, scatter
from clsco.reference.common.geometry import Array, blur_radius
from clsco.reference.inpainting.fill import FILLED, UNFILLED, FillReport, fill_objects
from clsco.reference.layered.layered import layered
from clsco.reference.trace.mapping import MappedTexture, mapped_texture
from clsco.reference.trace.trace import (
    Sources,
    SubpixelSources,
    Texture,
    View,
    everything,
    mark_silhouettes,
    sharpen,
    spread_sources,
    trace,
    trace_subpixels,
    view_at,
)
from clsco.reference.trace.truth import ground_truth
from clsco.reference.warp.warp import extend_border, fill_entered, reproject
from clsco.scene.model import Object, Scene


def _cast_sources(
    view: View, group: OcclusionGroup, guard: int, detail: bool
) -> tuple[Sources, SubpixelSources | None]:
    """Sources of one occlusion group from rays cast at its objects: the inverse warp, and every static scene. detail:
    with sub-pixel sources where textures need them."""
    sources = trace(view, group, guard)
    spread = spread_sources(sources) if view.scene.psf.tilt else sources
    if view.scene.psf.silhouette_samples == 1:
        return spread, None
    marked = mark_silhouettes(sources.label)
    if not detail:
        sources = replace(sources, parts=None)
    several = marked if sources.parts is None else marked | (sources.parts > 0)
    finer = trace_subpixels(view, group, guard, marked, sources) if several.any() else None
    return sharpen(spread, several) if detail else spread, finer


@dataclass(frozen=True, eq=False)
class _Warped:
    """Result of a forward warp: sources, the object of each (H, W), status of the filling (H, W), its report."""

    sources: Sources
    objects: NDArray[np.uint8]
    status: NDArray[np.uint8]
    report: FillReport


def _warped_sources(
    scene: Scene, textures: tuple[Texture, ...], maps: Maps, guard: int, time: float, eye: Eye
) -> _Warped:
    """Sources of one time sample from the pixels of the reference pose: the forward warp, with its holes filled."""
    poses, mapped = poses_at(scene, time, eye), any(depth is not None for depth in maps)
    reference_pose = _placed(scene, rest_poses(scene))
    images = tuple(texture for texture in textures if not isinstance(texture, MappedTexture))  # all of them
    new = reproject(scene, images, reference_pose, maps, poses, guard)
    allowed = None
    if scene.fill.domain == "surface" and not mapped:
        view = view_at(scene, textures, time, eye, True)
        allowed = trace(view, everything(scene), guard).label > 0
    values = np.concatenate([new.radiance, new.inverse_depth[..., None]], axis=-1)
    far = mapped or len(scene.objects) > 1
    brightest = max(map(radiance_span, images))
    values, objects, status, report = fill_objects(
        values, new.object, new.known, allowed, scene.fill.method, guard, far, brightest
    )
    valid = new.known | (status == 1)
    if new.entered.any() and scene.fill.method != "none":
        values, objects, valid = fill_entered(values, objects, valid, new.entered, guard)
    status = np.where(new.entered & ~new.known, np.where(valid, FILLED, UNFILLED), status)
    if mapped:
        values, valid = extend_border(values, valid, guard)
    return _Warped(_sources(scene, values[..., :-1], values[..., -1], valid), objects, status, report)


def _placed(scene: Scene, poses: Sequence[Pose]) -> tuple[PlacedSurface | None, ...]:
    """The objects in their poses, None for depth maps."""
    pairs = zip(scene.objects, poses, strict=True)
    return tuple(place(item, pose) if item.is_analytic else None for item, pose in pairs)


def _sources(scene: Scene, radiance: Array, w: Array, valid: NDArray[np.bool_]) -> Sources:
    """Sources of an image with inverse depths; the gradient of the radius from its differences."""
    radius = np.where(valid, blur_radius(Lens.of(scene.camera), w), 0.0)
    gradient = prepare_sources(radius, valid)
    return Sources(radiance, w, valid.astype(np.uint8), radius, gradient, valid)


def _image_of_planes(plan: Plan, sources: Sources) -> tuple[Array, dict[str, int]]:
    """Blur a pinhole image: (m, n, C), and with `layered` occlusion the number of depth layers for the metadata."""
    shape = plan.rows, plan.columns
    if plan.occlusion != "layered":
        return scatter(plan.spec, sources, None, shape, plan.guard_px), {}
    planes = (sources.radiance, sources.radius, sources.lit)
    image, count = layered(plan.spec, *planes, shape, plan.guard_px)
    return image, {"depth_layers": count}


def _without_channel(image: Array) -> Any:
    """Gray images have no channel axis."""
    return image[..., 0] if image.shape[-1] == 1 else image


def _crop(array: NDArray[Any], guard: int) -> NDArray[Any]:
    """The frame's part of the padded grid."""
    return array[guard : array.shape[0] - guard, guard : array.shape[1] - guard]


def render(scene: Scene, *, subframes: bool = False, frames: Iterable[int] | None = None) -> Iterator[Frame]:
    """Frames of a scene, each with all its ground truth, and with `subframes` if asked; float arrays are float64.

    frames: numbers of the wanted frames, by default all. Errors: those of the plan and of the textures. Metadata:
    {"intermediate": [...]}, one mapping per time sample with its time in s, its weight and the counts of
    `clsco.reference.inpainting.fill.FillReport`.

    Examples
    --------
    >>> import clsco
    >>> ball = clsco.Sphere(center=(0, 0, 280), radius=30)
    >>> scene = clsco.Scene(camera=clsco.Camera(resolution=(32, 24), pixel_pitch=0.2), objects=(ball,))
    >>> (exact,) = clsco.reference.render(scene)
    >>> bool(abs(clsco.render_frame(scene).color - exact.color).max() < 1e-5)
    True
    """
    scene, loaded = load_scene_textures(scene)
    images = [image for texture in loaded for image in texture.images]
    psf = scene_point_spread(scene)
    channels = max(image.shape[2] if image.ndim == 3 else 1 for image in images)
    textures = tuple(_texture(scene, psf, *pair, channels) for pair in zip(scene.objects, loaded, strict=True))
    maps = load_scene_depths(scene)
    eyes: tuple[Eye, ...] = ("left",) if scene.stereo is None else ("left", "right")
    plans = [make_plan(scene, channels, eye=eye, maps=maps, psf=psf) for eye in eyes]
    for frame in range(scene.sequence.frames) if frames is None else frames:
        for plan in plans:
            yield _frame(plan, textures, maps, frame, subframes)


def _texture(scene: Scene, psf: PointSpread, item: Object, texture: TextureImage, channels: int) -> Texture:
    """The texture of an object in so many channels."""
    if item.mapped is None:
        return _with_channels(texture.radiance, channels)
    images = [_with_channels(image, channels).astype(np.float32) for image in texture.images]
    rows, columns = images[0].shape[:2]
    return mapped_texture(images, texture_map(item, columns, rows), psf, scene.motion.texture_filter)


def _with_channels(radiance: NDArray[np.float32], channels: int) -> Array:
    """A texture (rows, columns, channels); gray ones serve color scenes as well."""
    image = radiance.astype(np.float64).reshape(*radiance.shape[:2], -1)
    return np.broadcast_to(image, (*image.shape[:2], channels))


def _moves_pixels(plan: Plan) -> bool:
    """True if pixels of the reference pose are warped forward; those of a static depth map stay where they are."""
    return plan.forward or plan.static_map


def _time_sample(
    plan: Plan, textures: tuple[Texture, ...], maps: Maps, time: float
) -> tuple[Array, NDArray[np.bool_], dict[str, int]]:
    """The blurred image (m, n, C) of one time sample, what was missing of it (m, n), and its metadata."""
    scene, guard, shape = plan.scene, plan.guard_px, (plan.rows, plan.columns)
    none = np.zeros(shape, dtype=bool)
    if _moves_pixels(plan):
        warped = _warped_sources(scene, textures, maps, guard, time, plan.eye)
        image, count = _image_of_planes(plan, warped.sources)
        return image, _crop(warped.status, guard) > 0, asdict(warped.report) | count
    view = view_at(scene, textures, time, plan.eye, plan.moves or plan.eye_moved, plan.psf)
    if plan.occlusion == "layered":
        visible = trace(view, plan.groups[0], guard)
        image, count = _image_of_planes(plan, visible)
        return image, none, asdict(FillReport()) | count
    image = np.zeros((*shape, plan.channels))
    for group in plan.groups:
        sources, sub = _cast_sources(view, group, guard, plan.silhouettes > 0)
        image = image + scatter(plan.spec, sources, sub, shape, guard)
    return image, none, asdict(FillReport())


def _frame(plan: Plan, textures: tuple[Texture, ...], maps: Maps, index: int, subframes: bool) -> Frame:
    scene, guard = plan.scene, plan.guard_px
    color, samples = np.zeros((plan.rows, plan.columns, plan.channels)), []
    missing, alone = np.zeros(color.shape[:2], dtype=bool), []
    exposure = frame_exposure(scene, index, plan.samples)
    for time, weights in zip(exposure.times.tolist(), exposure.weights, strict=True):
        image, unknown, report = _time_sample(plan, textures, maps, time)
        color, missing = accumulate(color, image, weights), missing | unknown
        if subframes:
            alone.append(_without_channel(image))
        samples.append({"time": time, "weight": float(weights.mean()), **report})
    arrays = _truth(plan, textures, maps, index) | {"filled": np.zeros(color.shape[:2], dtype=np.uint8)}
    arrays |= {"missing": missing, "subframes": np.stack(alone) if alone else None}
    if _moves_pixels(plan):
        time = middle_time(scene.sequence, index) if plan.moves else 0.0
        middle = _warped_sources(scene, textures, maps, guard, time, plan.eye)
        arrays |= {"sharp": _crop(middle.sources.radiance, guard), "filled": _crop(middle.status, guard)}
        if any(depth is not None for depth in maps):
            arrays |= _map_truth(plan, textures, maps, middle, index)
    sharp = _without_channel(arrays.pop("sharp"))
    eye = plan.eye if scene.stereo else ""
    about = {"intermediate": samples, "f_number": scene.camera.opening}
    return Frame(index=index, color=_without_channel(color), sharp=sharp, metadata=about, eye=eye, **arrays)


def _truth(plan: Plan, textures: tuple[Texture, ...], maps: Maps, index: int) -> dict[str, Any]:
    """Ground truth from rays; empty where the scene has depth maps, which are not ray-castable."""
    if any(depth is not None for depth in maps):
        return {}
    found = vars(ground_truth(plan.scene, textures, index, plan.eye))
    others = (*(() if plan.moves else MOTION_NAMES), *(() if plan.mapped else MAPPING_NAMES))
    return {name: array for name, array in found.items() if name not in others}


def _depth(sources: Sources) -> Array:
    """Depth in mm of sources, +inf where there are none."""
    return np.where(sources.lit, 1.0 / np.where(sources.lit, sources.inverse_depth, 1.0), np.inf)


def _map_truth(plan: Plan, textures: tuple[Texture, ...], maps: Maps, middle: _Warped, index: int) -> dict[str, Any]:
    """Ground truth of a scene with depth maps: of the pixels in their new places."""
    scene, guard = plan.scene, plan.guard_px
    valid = _crop(middle.sources.lit, guard)
    w = _crop(middle.sources.inverse_depth, guard)
    seen = _crop(middle.objects, guard).astype(np.int32) if len(scene.objects) > 1 else 0
    known = [k for k, item in enumerate(scene.objects) if item.is_background]
    surface = valid & ~np.isin(seen, known)  # the background has radiance and blur, and is no surface
    number = np.where(surface, seen, -1).astype(np.int32)
    depth = np.where(surface, 1.0 / np.where(surface, w, 1.0), np.inf)
    times = [middle_time(scene.sequence, k) if plan.moves else 0.0 for k in (index, index + 1, index - 1)]
    now, then, before = (poses_at(scene, time, plan.eye) for time in times)
    stereo: dict[str, Any] = {}
    moving: dict[str, Any] = {}
    if plan.moves:
        following = _depth(_warped_sources(scene, textures, maps, guard, times[1], plan.eye).sources)
        where = (scene.camera, scene.objects, depth, number, now)
        moving["flow_backward"] = map_flow(*where, before)
        moving["flow_occluded"] = map_occluded(*where, then, _crop(following, guard))
    if scene.stereo is not None:
        opposite: Eye = "left" if plan.eye == "right" else "right"
        there = poses_at(scene, times[0], opposite)
        other = _warped_sources(scene, textures, maps, guard, times[0], opposite).sources
        args = (scene.camera, scene.objects, depth, number, now, there, _crop(_depth(other), guard), plan.eye)
        stereo = dict(zip(("disparity", "occluded"), map_stereo(*args), strict=True))
    found = {
        "depth": depth,
        "blur_radius": _crop(middle.sources.radius, guard),
        "mask": surface,
        "object_id": number,
        "normal": map_normal(scene.camera, depth),
        "flow": map_flow(scene.camera, scene.objects, depth, number, now, then),
        "hidden": (_crop(middle.status, guard) > 0) & (surface | ~valid),
    }
    return found | stereo | moving
