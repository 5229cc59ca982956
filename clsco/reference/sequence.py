"""Reference renderer: renders scenes in NumPy float64, so that results of devices can be checked against it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.frame.frame import Frame
from clsco.frame.outputs import MAPPING_NAMES, MOTION_NAMES, SENSOR_NAMES
from clsco.inputs.depth_maps import load_scene_depths
from clsco.inputs.pupils import scale_radiance, scene_point_spread
from clsco.inputs.textures import Texture as TextureImage
from clsco.inputs.textures import load_scene_textures
from clsco.optics.depth_truth import MapPoints, map_flow, map_normal, map_occluded, map_stereo
from clsco.optics.exposure import middle_time
from clsco.optics.lens_path import camera_at, lenses_at
from clsco.optics.motion import Eye, poses_at
from clsco.optics.point_spread import PointSpread, exposure_factor
from clsco.optics.rims import frame_throughput
from clsco.optics.sensor import camera_word, sensor_model
from clsco.optics.texture_mapping import texture_map
from clsco.reference.common.geometry import Array, blur_radius, pixel_ray
from clsco.reference.exposure import exposure_of, least_samples
from clsco.reference.inpainting.fill import FillReport
from clsco.reference.passes import Warped, crop, run, warped_image
from clsco.reference.plan import ReferencePlan
from clsco.reference.sensor.sensor import sensor_outputs
from clsco.reference.trace.line_truth import line_truth
from clsco.reference.trace.mapping import mapped_texture
from clsco.reference.trace.trace import padded_grid
from clsco.reference.trace.truth import ground_truth, middle_of
from clsco.reference.trace.view import Texture
from clsco.scene.model import Object, Scene


def _without_channel(image: Array) -> Any:
    """An image without its channel axis if it is gray."""
    return image[..., 0] if image.shape[-1] == 1 else image


def render(scene: Scene, *, subframes: bool = False, frames: Iterable[int] | None = None) -> Iterator[Frame]:
    """Render frames of a scene in NumPy and float64, without OpenCL, each with all its ground truth.

    Parameters
    ----------
    scene : Scene
    subframes : bool
        Also compute `Frame.subframes`.
    frames : iterable of int, optional
        Numbers of the frames to render, from 0; by default all.

    Returns
    -------
    iterator of Frame
        Float arrays are float64. `metadata["intermediate"]` has a mapping per time sample with its time in s, its
        weight and the counts of `clsco.reference.inpainting.fill.FillReport`.

    Raises
    ------
    SceneError, FileError
        As `clsco.render`.

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
    loaded = scale_radiance(loaded, exposure_factor(scene.aperture, psf))
    channels = 3 if scene.separates_colors else max(image.shape[2] if image.ndim == 3 else 1 for image in images)
    textures = tuple(_texture(scene, psf, *pair, channels) for pair in zip(scene.objects, loaded, strict=True))
    maps = load_scene_depths(scene)
    eyes: tuple[Eye, ...] = ("left",) if scene.stereo is None else ("left", "right")
    plans = [ReferencePlan.of(scene, channels, eye, maps, psf) for eye in eyes]
    for frame in range(scene.sequence.frames) if frames is None else frames:
        for plan in plans:
            yield _frame(plan, textures, frame, subframes)


def _texture(scene: Scene, psf: PointSpread, item: Object, texture: TextureImage, channels: int) -> Texture:
    """The texture of an object, with `channels` channels."""
    if item.mapped is None:
        return _with_channels(texture.radiance, channels)
    images = [_with_channels(image, channels).astype(np.float32) for image in texture.images]
    rows, columns = images[0].shape[:2]
    return mapped_texture(images, texture_map(item, columns, rows), psf, scene.motion.texture_filter)


def _with_channels(radiance: NDArray[np.float32], channels: int) -> Array:
    """A texture (rows, columns, channels); gray ones are repeated in color scenes."""
    image = radiance.astype(np.float64).reshape(*radiance.shape[:2], -1)
    return np.broadcast_to(image, (*image.shape[:2], channels))


def _frame(plan: ReferencePlan, textures: tuple[Texture, ...], index: int, subframes: bool) -> Frame:
    scene, guard, maps, samples = plan.scene, plan.claimed[1], plan.maps, []
    color, missing, alone = np.zeros((*plan.shape, plan.channels)), np.zeros(plan.shape, dtype=bool), []
    least = least_samples(scene, maps, plan.eye, index, guard)
    for time, weights in zip(*exposure_of(scene, index, plan.claimed[0], least), strict=True):
        outputs = run(plan, textures, float(time))
        color = color + (weights if scene.sequence.by_columns else weights[:, None])[..., None] * outputs["plane"]
        missing = missing | outputs.get("missing", False)
        if subframes:
            alone.append(_without_channel(outputs["plane"]))
        report = outputs.get("counts") or asdict(FillReport())
        report |= {name: value for name, value in outputs.items() if name == "depth_layers"}
        samples.append({"time": float(time), "weight": float(weights.mean()), **report})
    arrays = _truth(plan, textures, index) | {"filled": np.zeros(color.shape[:2], dtype=np.uint8)}
    if plan.forward or plan.static_map:
        middle = warped_image(scene, textures, maps, guard, middle_of(scene, index), plan.eye)
        arrays |= {"sharp": crop(middle.sources.radiance, guard), "filled": crop(middle.status, guard)}
        missing = arrays["filled"] > 0 if plan.static_map else missing
        if not scene.is_analytic:
            arrays |= _map_truth(plan, textures, middle, index)
    arrays |= {"missing": missing, "subframes": np.stack(alone) if alone else None}
    if scene.darkens or scene.aperture.rim:
        arrays["throughput"] = frame_throughput(scene, middle_of(scene, index), plan.psf)
    arrays |= {"sharp": _without_channel(arrays["sharp"]), "color": _without_channel(color)}
    if scene.sensor is not None:
        model = sensor_model(scene, plan.channels)
        arrays |= sensor_outputs(model, color, camera_word(index, plan.eye), SENSOR_NAMES)
    metadata = {"intermediate": samples, "f_number": camera_at(scene, middle_time(scene.sequence, index)).opening}
    return Frame(index=index, metadata=metadata, eye=plan.eye if scene.stereo else "", **arrays)


def _truth(plan: ReferencePlan, textures: tuple[Texture, ...], index: int) -> dict[str, Any]:
    """Ground truth from rays; empty if the scene has depth maps, at which rays cannot be cast."""
    scene = plan.scene
    if not scene.is_analytic:
        return {}
    compute = line_truth if scene.rolls else ground_truth
    arrays = vars(compute(scene, textures, index, plan.eye))
    absent = (*(() if scene.moves else MOTION_NAMES), *(() if scene.has_mapped_textures else MAPPING_NAMES))
    return {name: array for name, array in arrays.items() if name not in absent}


def _map_truth(plan: ReferencePlan, textures: tuple[Texture, ...], middle: Warped, index: int) -> dict[str, Any]:
    """Ground truth of a scene with depth maps, from the moved pixels."""
    scene, guard = plan.scene, plan.claimed[1]
    times = [middle_of(scene, k) for k in (index, index + 1, index - 1)]
    now, then, before = ((camera_at(scene, time), poses_at(scene, time, plan.eye)) for time in times)
    valid, w = crop(middle.sources.lit, guard), crop(middle.sources.inverse_depth, guard)
    rays = pixel_ray(now[0], *padded_grid(scene.camera, 0))
    radii = [np.where(valid, blur_radius(lens, rays, w), 0.0) for lens in lenses_at(scene, times[0])]
    numbers = crop(middle.objects, guard).astype(np.int32) if len(scene.objects) > 1 else 0
    backgrounds = [k for k, item in enumerate(scene.objects) if item.is_background]
    surface = valid & ~np.isin(numbers, backgrounds)  # the background has radiance and blur, but is no surface
    number = np.where(surface, numbers, -1).astype(np.int32)
    depth = np.where(surface, 1.0 / np.where(surface, w, 1.0), np.inf)
    points = MapPoints(scene.objects, depth, number, *now)
    arrays = {
        "depth": depth,
        "blur_radius": radii[0] if len(radii) == 1 else np.stack(radii, axis=-1),
        "mask": surface,
        "object_id": number,
        "normal": map_normal(now[0], depth),
        "flow": map_flow(points, *then),
        "hidden": (crop(middle.status, guard) > 0) & (surface | ~valid),
    }

    def depth_at(time: float, eye: Eye) -> Array:
        sources = warped_image(scene, textures, plan.maps, guard, time, eye).sources
        return crop(np.where(sources.lit, 1.0 / np.where(sources.lit, sources.inverse_depth, 1.0), np.inf), guard)

    if scene.moves:
        arrays["flow_backward"] = map_flow(points, *before)
        arrays["flow_occluded"] = map_occluded(points, *then, depth_at(times[1], plan.eye))
    if scene.stereo is not None:
        opposite: Eye = "left" if plan.eye == "right" else "right"
        other = poses_at(scene, times[0], opposite), depth_at(times[0], opposite)
        arrays["disparity"], arrays["occluded"] = map_stereo(points, *other, plan.eye)
    return arrays
