"""A whole scene in NumPy float64: what the device is checked against."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.frame import Frame
from clsco.motion import middle_time, pose_at, sample_times
from clsco.plan import make_plan
from clsco.reference.accumulate import accumulate
from clsco.reference.blur import prepare_sources, scatter
from clsco.reference.fill import FillReport, fill
from clsco.reference.geometry import Array, blur_radius
from clsco.reference.reproject import reproject
from clsco.reference.trace import (
    Sources,
    SubpixelSources,
    ground_truth,
    mark_silhouettes,
    trace,
    trace_subpixels,
)
from clsco.scene import Scene
from clsco.surfaces import place
from clsco.textures import load_scene_textures


def _cast_sources(scene: Scene, texture: Array, guard: int, time: float) -> tuple[Sources, SubpixelSources | None]:
    """Sources at one moment from rays cast at the surface: the inverse warp, and every scene at rest."""
    item = scene.objects[0]
    surface = place(item, pose_at(item.motion, time, scene.motion.rotation))
    moved = item.motion.moves and time != 0.0
    sources = trace(scene, surface, texture, guard, moved)
    if scene.psf.silhouette_samples == 1:
        return sources, None
    marked = mark_silhouettes(sources.label)
    return sources, trace_subpixels(scene, surface, texture, guard, moved, marked) if marked.any() else None


def _warped_sources(
    scene: Scene, texture: Array, guard: int, time: float
) -> tuple[Sources, NDArray[np.uint8], FillReport]:
    """Sources at one moment from the pixels at rest: the forward warp, with its holes filled."""
    item = scene.objects[0]
    start, pose = (pose_at(item.motion, t, scene.motion.rotation) for t in (0.0, time))
    known, radiance, inverse_depth = reproject(scene, texture, place(item, start), pose, guard)
    allowed = None
    if scene.fill.domain == "surface":
        allowed = trace(scene, place(item, pose), texture, guard, True).label > 0
    values = np.concatenate([radiance, inverse_depth[..., None]], axis=-1)
    values, status, report = fill(values, known, allowed, scene.fill.method, guard)
    valid = known | (status == 1)
    inverse_depth = values[..., -1]
    radius = np.where(valid, blur_radius(scene.camera, inverse_depth), 0.0)
    gradient = prepare_sources(radius, valid)
    return Sources(values[..., :-1], inverse_depth, valid.astype(np.uint8), radius, gradient), status, report


def _without_channel(image: Array) -> Any:
    """Gray images have no channel axis."""
    return image[..., 0] if image.shape[-1] == 1 else image


def _crop(array: NDArray[Any], guard: int) -> NDArray[Any]:
    """The frame's part of the padded grid."""
    return array[guard : array.shape[0] - guard, guard : array.shape[1] - guard]


def render(scene: Scene) -> Iterator[Frame]:
    """Frames of a scene, each with all its ground truth; float arrays are float64.

    Errors: those of the plan and of the textures. Metadata: {"intermediate": [...]}, one mapping per
    intermediate frame with its time in s, its weight and the counts of `clsco.reference.fill.FillReport`.
    """
    scene, textures = load_scene_textures(scene)
    texture = np.asarray(textures[0].radiance, dtype=np.float64)
    texture = texture[..., None] if texture.ndim == 2 else texture
    plan = make_plan(scene, texture.shape[2])
    scene, guard = plan.scene, plan.guard_px
    moves = scene.objects[0].motion.moves
    forward = moves and scene.motion.warp == "forward"
    shape = texture.shape[:2]
    for frame in range(scene.sequence.frames):
        times, weights = sample_times(scene.sequence, frame, plan.samples) if moves else (np.zeros(1), np.ones(1))
        color = np.zeros(texture.shape)
        intermediate = []
        for time, weight in zip(times.tolist(), weights.tolist(), strict=True):
            if forward:
                sources, _, report = _warped_sources(scene, texture, guard, time)
                image = scatter(scene.psf, sources, None, shape, guard)
            else:
                sources, sub = _cast_sources(scene, texture, guard, time)
                report = FillReport()
                image = scatter(scene.psf, sources, sub, shape, guard)
            color = accumulate(color, image, weight)
            intermediate.append({"time": time, "weight": weight, **asdict(report)})
        truth = ground_truth(scene, texture, frame)
        sharp, filled = truth.sharp, np.zeros(shape, dtype=np.uint8)
        if forward:
            middle, status, _ = _warped_sources(scene, texture, guard, middle_time(scene.sequence, frame))
            sharp, filled = _crop(middle.radiance, guard), _crop(status, guard)
        arrays: dict[str, Any] = {name: getattr(truth, name) for name in vars(truth) if name != "sharp"}
        yield Frame(
            index=frame,
            color=_without_channel(color),
            sharp=_without_channel(sharp),
            filled=filled,
            metadata={"intermediate": intermediate},
            **arrays,
        )
