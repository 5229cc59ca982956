"""What is told of a scene: its parameters with their units, its hash, and keys that it has no use for."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from clsco import __version__
from clsco.depthmaps import map_inverse_depth, read_depth
from clsco.errors import ImageError, SceneError
from clsco.files import refuse, sha256
from clsco.images import read_image
from clsco.memory import fitted, limit_of
from clsco.motion import Eye
from clsco.plan import Maps, Plan, make_plan
from clsco.scene import BUILT_IN_TEXTURES, DepthMap, Scene, Within
from clsco.scenefile import at_most, dump
from clsco.sweep import Sweep
from clsco.textures import texture_size

PlannedFile = tuple[Path, tuple[str, ...], tuple[Plan, ...]]  # with the labels of its scenes
# What parameters derived from a scene, and the metadata of a frame, are measured in, where the name does not say it.
DERIVED_UNITS = {"derived.aperture_diameter": "mm", "derived.sensor_distance": "mm"}
FRAME_UNITS = {"intermediate[].time": "s", "seconds": "s, by pass on the device"}


def planned(
    scene: Scene, truth: tuple[str, ...], eye: Eye = "left", memory: int | None = None, gpu: bool = False
) -> Plan:
    """The plan of a scene for the outputs `truth` besides color; reads its textures and depths, computes nothing.

    eye: of a stereo pair; memory: as for `clsco.render`, on a device like this machine's processor; gpu: as for
    `clsco.plan.make_plan`.

    The plan's scene has its resolution, which the first texture gives where the scene does not, and three channels
    where any texture has color. Raises SceneError, all textures' and depths' faults at once, and what
    `clsco.plan.make_plan` raises.
    """
    (plan,) = planned_sweep(Sweep(("",), (scene,)), truth, eye, memory, gpu=gpu)
    return plan


def planned_sweep(
    sweep: Sweep, truth: tuple[str, ...], eye: Eye = "left", memory: int | None = None, method: str = "auto",
    tolerance: float | None = None, gpu: bool = False,
) -> tuple[Plan, ...]:  # fmt: skip
    """The plans of all scenes of a sweep, as `planned`; each file is read once. Raises SceneError for all of them.

    method, tolerance: as for `clsco.render`; gpu: as for `planned`.
    """
    files = _read_files(sweep.scenes[0])  # the same for all: no key of theirs can have several values
    plans, faults = [], dict[str, None]()
    for label, scene in zip(sweep.labels, sweep.scenes, strict=True):
        camera = scene.camera
        if camera.resolution is None:
            camera = camera.model_copy(update={"resolution": files.size})
        sized = scene.model_copy(update={"camera": camera})
        try:
            maps = _inverse_depths(sized, files.depths)
            views = {
                view: make_plan(sized, files.channels, truth, method, view, maps, tolerance, gpu)
                for view in _views(scene)
            }
            limit = replace(limit_of(memory), views=len(views))
            plans.append({view: fitted(plan, limit) for view, plan in views.items()}[eye])
        except SceneError as error:
            faults.update(dict.fromkeys(f"{message}{label and f' (with {label})'}" for message in error.messages))
    if faults:
        raise SceneError(list(faults))
    return tuple(plans)


def planned_files(
    loaded: Sequence[tuple[Path, Sweep | SceneError]], truth: tuple[str, ...] = (), memory: int | None = None,
    method: str = "auto", tolerance: float | None = None, gpu: bool = False,
) -> list[PlannedFile]:  # fmt: skip
    """The plans of files that `clsco.sweep.load_sweeps` gives; raises SceneError for all of them."""
    found: list[PlannedFile] = []
    messages: list[str] = []
    for path, sweep in loaded:
        if isinstance(sweep, SceneError):
            messages.extend(sweep.messages)
            continue
        try:
            plans = planned_sweep(sweep, truth, memory=memory, method=method, tolerance=tolerance, gpu=gpu)
            found.append((path, sweep.labels, plans))
        except SceneError as error:
            messages.extend(at_most(str(path), error.messages))
    if messages:
        raise SceneError(messages)
    return found


def _views(scene: Scene) -> tuple[Eye, ...]:
    return ("left",) if scene.stereo is None else ("left", "right")


@dataclass(frozen=True, eq=False)
class _Files:
    """Of a scene's files: size of the first texture in px, channels of the image, and depths by their paths."""

    size: tuple[int, int]
    channels: int
    depths: dict[str, NDArray[np.float64]]


def _read_files(scene: Scene) -> _Files:
    faults: list[str] = []
    depths: dict[str, NDArray[np.float64]] = {}
    gray = True
    size = (0, 0)
    for index, item in enumerate(scene.objects):
        try:
            found = texture_size(item.texture)
            gray = gray and (item.texture in BUILT_IN_TEXTURES or read_image(item.texture).data.ndim == 2)
            size = size if index else found
        except ImageError as error:
            faults.append(f"object[{index}].texture: {error}")
        if isinstance(item, DepthMap) and item.depth not in depths:
            try:
                depths[item.depth] = read_depth(item.depth)
            except ImageError as error:
                faults.append(f"object[{index}].depth: {error}")
    if faults:
        raise SceneError(faults)
    return _Files(size, 1 if gray else 3, depths)


def _inverse_depths(scene: Scene, depths: Mapping[str, NDArray[np.float64]]) -> Maps:
    """Inverse depth of the objects that are depth maps; refuses what does not fit the frame or the camera."""
    faults: list[str] = []
    maps: list[NDArray[np.float64] | None] = [None] * len(scene.objects)
    for index, item in enumerate(scene.objects):
        if isinstance(item, DepthMap):
            try:
                maps[index] = map_inverse_depth(scene, item, depths[item.depth])
            except ImageError as error:
                faults.append(f"object[{index}].depth: {error}")
    if faults:
        raise SceneError(faults)
    return tuple(maps)


def units(scene: Scene) -> dict[str, str]:
    """Unit of every parameter that has one: {"camera.focal_length": "mm", "object[0].radius": "mm", ...}."""
    sections = [(name, getattr(scene, name)) for name in type(scene).model_fields if name != "objects"]
    sections += [(f"object[{index}]", item) for index, item in enumerate(scene.objects)]
    found: dict[str, str] = {}
    while sections:
        place, model = sections.pop(0)
        for name, field in getattr(type(model), "model_fields", {}).items():
            key = f"{place}.{name}"
            sections.append((key, getattr(model, name)))
            if unit := _unit((field.annotation, *field.metadata)):
                found[key] = unit
    return found


def _record_units(scene: Scene) -> dict[str, str]:
    """Units of what a frame's JSON file has besides the scene's parameters; of a stereo pair those of each view."""
    views = [""] if scene.stereo is None else [f"views.{view}." for view in _views(scene)]
    return DERIVED_UNITS | {view + key: unit for view in views for key, unit in FRAME_UNITS.items()}


def _unit(parts: Iterable[Any]) -> str:
    """Unit of the first constraint that names one, however deep in the types it is."""
    for part in parts:
        if unit := part.unit if isinstance(part, Within) else _unit(get_args(part)):
            return unit
    return ""


def file_digests(scenes: Iterable[Scene]) -> dict[str, str]:
    """SHA-256 by path of all textures and depths that are files. Raises ImageError where one cannot be read."""
    items = [item for scene in scenes for item in scene.objects]
    paths = [item.texture for item in items if item.texture not in BUILT_IN_TEXTURES]
    paths += [item.depth for item in items if isinstance(item, DepthMap)]
    return {path: _digest(path) for path in dict.fromkeys(paths)}


def _digest(path: str) -> str:
    try:
        return sha256(Path(path))
    except OSError as error:
        refuse(Path(path), "must be a file that can be read", error, error)


def scene_sha256(scene: Scene, digests: Mapping[str, str] | None = None) -> str:
    """SHA-256 of what decides the image: all parameters, and the content of texture and depth files, not their paths.

    scene: with its resolution. digests: what `file_digests` gives, where that is known. Raises ImageError where a file
    cannot be read.
    """
    known = file_digests([scene]) if digests is None else digests
    content = dump(scene)
    for item in content["object"]:
        for key in ("texture", "depth"):
            if key in item:
                item[key] = known.get(item[key], item[key])
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def record(scene: Scene, digests: Mapping[str, str] | None = None) -> dict[str, Any]:
    """What the JSON file of a frame says of its scene, besides what the rendering adds.

    scene: with its resolution. digests: as in `scene_sha256`. Returns the parameters as a scene file has them, those
    derived from them in mm, the units, the hashes and the version. Raises ImageError where a file cannot be read.
    """
    camera = scene.camera
    known = file_digests([scene]) if digests is None else digests
    textures = [item.texture for item in scene.objects]
    depths = [item.depth for item in scene.objects if isinstance(item, DepthMap)]
    return {
        "version": __version__,
        "scene_sha256": scene_sha256(scene, known),
        "scene": dump(scene),
        "derived": {
            "aperture_diameter": camera.aperture_diameter,
            "sensor_distance": camera.sensor_distance,
        },
        "textures_sha256": {name: known[name] for name in textures if name not in BUILT_IN_TEXTURES},
        "depths_sha256": {name: known[name] for name in depths},
        "units": units(scene) | _record_units(scene),
    }


def unused_keys(plan: Plan) -> list[tuple[str, str]]:
    """Keys that the scene gives although nothing depends on them, and why: (key, reason)."""
    scene = plan.scene
    reasons: dict[str, str] = {}

    def give(section: str, keys: Iterable[str], why: str) -> None:
        reasons.update({f"{section}.{key}": why for key in keys})

    motions = [scene.camera.motion, *(item.motion for item in scene.objects)]
    if not plan.moves:
        give("sequence", ("samples", "sampling", "shutter"), "nothing moves")
        mapped = plan.forward or plan.still_map
        used = ["warp"] * mapped + ["texture_filter"] * (scene.stereo is not None)
        give("motion", [key for key in type(scene.motion).model_fields if key not in used], "nothing moves")
        if not mapped:
            give("fill", type(scene.fill).model_fields, "nothing moves")
    elif all(sum(map(bool, motion.angular_velocity)) < 2 for motion in motions):
        give("motion", ("rotation",), "euler and axis differ only for turns about several axes")
    if plan.still_map:
        give("fill", ("domain",), "nothing moves")
    if plan.forward and scene.fill.method == "none":
        give("fill", ("domain",), "fill.method is none")
    if plan.blur == "none":
        keys = [key for key in type(scene.psf).model_fields if key != "silhouette_samples"]
        give("psf", keys, "everything is in focus")
    left_out = dict(plan.left_out)
    if not plan.tilt and scene.psf.tilt:
        give("psf", ("tilt",), left_out["tilt"])
    if not plan.silhouettes and scene.psf.silhouette_samples > 1:
        give("psf", ("silhouette_samples",), left_out["silhouettes"])
    if "occlusion" in left_out:
        give("psf", ("occlusion",), left_out["occlusion"])
    sections: list[tuple[str, Any]] = [(name, getattr(scene, name)) for name in ("psf", "sequence", "motion", "fill")]
    for index, item in enumerate(scene.objects):
        if isinstance(item, DepthMap) and not any(item.motion.angular_velocity):
            give(f"object[{index}]", ("center",), "the depth map does not turn")
            sections.append((f"object[{index}]", item))
    given = [f"{place}.{key}" for place, model in sections for key in sorted(model.model_fields_set)]
    return [(key, reasons[key]) for key in given if key in reasons]
