"""Plans of scenes and sweeps, with the files that they name read once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clsco.errors import ImageError, SceneError
from clsco.files.images import read_image
from clsco.frame.provenance import _views
from clsco.inputs.depth_files import read_depth
from clsco.inputs.depth_maps import map_inverse_depth
from clsco.inputs.textures import texture_size
from clsco.optics.motion import Eye
from clsco.plan.buffers import DeviceFacts
from clsco.plan.memory import fitted, limit_of
from clsco.plan.plan import Plan, make_plan
from clsco.plan.predict import Maps
from clsco.scene.faults import at_most
from clsco.scene.model import BUILT_IN_TEXTURES, DepthMap, Scene
from clsco.scene.sweep import Sweep

PlannedFile = tuple[Path, tuple[str, ...], tuple[Plan, ...]]  # with the labels of its scenes


def planned(
    scene: Scene,
    truth: tuple[str, ...],
    eye: Eye = "left",
    memory: int | None = None,
    device: DeviceFacts | None = None,
) -> Plan:
    """The plan of a scene for the outputs `truth` besides color; reads its textures and depths, computes nothing.

    eye: of a stereo pair; memory: as for `clsco.render`, device: as for `clsco.plan.plan.make_plan`.

    The plan's scene has its resolution, which the first texture gives where the scene does not, and three channels
    where any texture has color. Raises SceneError, all textures' and depths' faults at once, and what
    `clsco.plan.plan.make_plan` raises.
    """
    (plan,) = planned_sweep(Sweep(("",), (scene,)), truth, eye, memory, device=device)
    return plan


def planned_sweep(
    sweep: Sweep, truth: tuple[str, ...], eye: Eye = "left", memory: int | None = None, method: str = "auto",
    tolerance: float | None = None, device: DeviceFacts | None = None,
) -> tuple[Plan, ...]:  # fmt: skip
    """The plans of all scenes of a sweep, as `planned`; each file is read once. Raises SceneError for all of them.

    method, tolerance: as for `clsco.render`; device: as for `planned`.
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
                view: make_plan(sized, files.channels, truth, method, view, maps, tolerance, device)
                for view in _views(scene)
            }
            limit = replace(limit_of(memory, device), views=len(views))
            plans.append({view: fitted(plan, limit) for view, plan in views.items()}[eye])
        except SceneError as error:
            faults.update(dict.fromkeys(f"{message}{label and f' (with {label})'}" for message in error.messages))
    if faults:
        raise SceneError(list(faults))
    return tuple(plans)


def planned_files(
    loaded: Sequence[tuple[Path, Sweep | SceneError]], truth: tuple[str, ...] = (), memory: int | None = None,
    method: str = "auto", tolerance: float | None = None, device: DeviceFacts | None = None,
) -> list[PlannedFile]:  # fmt: skip
    """The plans of files that `clsco.scene.sweep.load_sweeps` gives; raises SceneError for all of them."""
    found: list[PlannedFile] = []
    messages: list[str] = []
    for path, sweep in loaded:
        if isinstance(sweep, SceneError):
            messages.extend(sweep.messages)
            continue
        try:
            plans = planned_sweep(sweep, truth, memory=memory, method=method, tolerance=tolerance, device=device)
            found.append((path, sweep.labels, plans))
        except SceneError as error:
            messages.extend(at_most(str(path), error.messages))
    if messages:
        raise SceneError(messages)
    return found


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
