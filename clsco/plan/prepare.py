"""Prepares scenes and sweeps for rendering: reads their input files once, and plans them."""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cache, cached_property
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from clsco.errors import FileError, MissingDependencyError, SceneError
from clsco.files.color import SRGB, Color
from clsco.frame.provenance import views
from clsco.inputs.files import InputFiles, Maps, shared_files
from clsco.inputs.textures import Texture, add_coverage, image_files, is_gray, mapped_size, texture_size, to_color
from clsco.optics.resolved_view import without_lens
from clsco.plan.device import DeviceFacts
from clsco.plan.memory import fit_strips, limit_of
from clsco.plan.plan import Plan, make_plan
from clsco.plan.request import Request
from clsco.scene.arrays import LayerInput
from clsco.scene.faults import at_most
from clsco.scene.model import DepthMap, Scene
from clsco.scene.sweep import Sweep
from clsco.scene.texture_keys import is_drawn

if TYPE_CHECKING:
    from clsco.plan.approximation import ApproximationReport, Samples


@dataclass(frozen=True, eq=False)
class Prepared:
    """A scene ready to render: with a resolution, by default that of the first texture.

    plans: plan of its view, or plans of the left and the right view; images have three channels if any texture has
    color or the lens separates colors; approximation: None unless the request has a tolerance and color.
    """

    scene: Scene
    plans: tuple[Plan, ...]
    request: Request
    files: InputFiles
    approximation: ApproximationReport | None = None

    @cached_property
    def textures(self) -> tuple[Texture, ...]:
        """Textures of all objects; with `alpha`, coverage is an additional last channel."""
        textures = self.files.textures(self.scene)
        if self.plan.spreads:
            textures = tuple(map(cache(to_color), textures))
        if not self.plan.alpha:
            return textures
        covers = [not item.is_background for item in self.scene.objects]
        wider = cache(lambda texture, covering: add_coverage(texture, self.plan.channels - 1, covering))
        return tuple(wider(*pair) for pair in zip(textures, covers, strict=True))

    @cached_property
    def maps(self) -> Maps:
        """Depth maps of all objects, None for analytic objects; see `InputFiles.maps`."""
        return self.files.maps(self.scene)

    @cached_property
    def color(self) -> Color:
        """Color space of the frames: that of the image files if all share it and it suits the channels, else sRGB."""
        spaces = set(self.colors.values())
        color = spaces.pop() if len(spaces) == 1 else SRGB
        colored = self.plan.channels - self.plan.alpha == 3
        return SRGB if color.channels not in (0, 3 if colored else 1) else color

    @cached_property
    def colors(self) -> dict[str | LayerInput, Color]:
        """Color space of each image file, or layer of a file, by its name in the scene."""
        return {image: self.files.about(image).color for image in image_files(self.scene)}

    @property
    def plan(self) -> Plan:
        """The plan of the view, or of the left view of a stereo pair."""
        return self.plans[0]


PreparedFile = tuple[Path, tuple[str, ...], tuple[Prepared, ...]]  # file, labels of its scenes, scenes


def prepare(
    scene: Scene, request: Request | None = None, device: DeviceFacts | None = None, files: InputFiles | None = None
) -> Prepared:
    """Read the files of a scene and plan its rendering; nothing is rendered.

    request: by default only color; files: by default the cache that all renderings of this process share. Raises
    SceneError for textures and depth maps that cannot be used, with all faults, and as `clsco.plan.plan.make_plan`.
    """
    (prepared,) = prepare_sweep(Sweep(("",), (scene,)), request, device, files)
    return prepared


def prepare_sweep(
    sweep: Sweep, request: Request | None = None, device: DeviceFacts | None = None, files: InputFiles | None = None
) -> tuple[Prepared, ...]:
    """`prepare` for all scenes of a sweep. Raises SceneError with the faults of all scenes.

    With a tolerance, consecutive scenes that differ only in the lens or the sensor share rays. So they all use the
    numbers of samples of the most demanding one.
    """
    request, files = request or Request(), files or shared_files()
    prepared, faults, channels = list[Prepared](), dict[str, None](), dict[Hashable, int]()

    def channels_of(scene: Scene) -> int:
        names = scene.separates_colors, *(tuple(item.inputs().items()) for item in scene.objects)
        if names not in channels:  # scenes of a sweep mostly have the same files and arrays
            channels[names] = _channels(scene, files)
        return channels[names]

    for label, scene in zip(sweep.labels, sweep.scenes, strict=True):
        count = channels_of(scene)
        try:
            prepared.append(_prepare_scene(scene, count, request, device, files))
        except SceneError as error:
            faults.update(dict.fromkeys(f"{message}{label and f' (with {label})'}" for message in error.messages))
    if faults:
        raise SceneError(list(faults))
    reduces = request.tolerance is not None and request.color
    for group in lens_groups([entry.scene for entry in prepared]) if reduces else ():
        counts = [report.counts for report in (prepared[k].approximation for k in group) if report is not None]
        most = max(samples for samples, _ in counts), max(silhouettes for _, silhouettes in counts)
        for k, samples_used in zip(group, counts, strict=True):
            if samples_used != most:
                scene = prepared[k].scene
                prepared[k] = _prepare_scene(scene, channels_of(scene), request, device, files, most)
    return tuple(prepared)


def lens_groups(scenes: Sequence[Scene]) -> list[list[int]]:
    """Groups of consecutive scenes that differ only in the lens or the sensor, as lists of scene numbers."""
    groups = groupby(range(len(scenes)), key=lambda k: without_lens(scenes[k]))
    return [list(group) for _, group in groups]


def prepare_files(
    loaded: Sequence[tuple[Path, Sweep | SceneError]], request: Request | None = None,
    device: DeviceFacts | None = None,
) -> list[PreparedFile]:  # fmt: skip
    """`prepare_sweep` for all files from `clsco.scene.sweep.load_sweeps`. Raises SceneError with all faults."""
    prepared: list[PreparedFile] = []
    messages: list[str] = []
    for path, sweep in loaded:
        if isinstance(sweep, SceneError):
            messages.extend(sweep.messages)
            continue
        try:
            prepared.append((path, sweep.labels, prepare_sweep(sweep, request, device)))
        except SceneError as error:
            messages.extend(at_most(str(path), error.messages))
    if messages:
        raise SceneError(messages)
    return prepared


def with_resolution(scene: Scene) -> Scene:
    """The scene with its resolution: its own, or that of the first texture. Raises FileError as `texture_size`."""
    camera = scene.camera
    if camera.resolution is None:
        camera = camera.model_copy(update={"resolution": texture_size(scene.objects[0].inputs()["texture"])})
    return scene.model_copy(update={"camera": camera})


def _prepare_scene(
    scene: Scene, channels: int, request: Request, device: DeviceFacts | None, files: InputFiles,
    least: Samples = (1, 1),
) -> Prepared:  # fmt: skip
    """Plan one scene; least: lower bounds of its numbers of samples if the request has a tolerance."""
    sized = with_resolution(scene)
    maps = _maps(sized, files)

    def plans_of(scene: Scene) -> list[Plan]:
        psf = files.point_spread(scene)
        return [make_plan(scene, psf, channels, request, eye, maps, device) for eye in views(scene)]

    plans, report = plans_of(sized), None
    if request.tolerance is not None and request.color:
        from clsco.plan.approximation import fewer_samples

        fewer, report = fewer_samples(plans[0], request.tolerance, lambda: files.textures(sized), maps, least)
        plans = plans if fewer is sized else plans_of(fewer)
    limit = replace(limit_of(request.memory, device), views=len(plans))
    return Prepared(sized, tuple(fit_strips(plan, limit) for plan in plans), request, files, report)


def _channels(scene: Scene, files: InputFiles) -> int:
    """Number of channels of a scene's image: 1 if all its textures are gray and the lens does not separate colors, else
    3. Raises SceneError with the faults of all its files and arrays.
    """
    faults, gray = dict[str, str](), True
    for index, item in enumerate(scene.objects):
        sources = item.inputs()
        for key, texture in sources.items():
            if key == "depth":
                continue
            with _collect_faults(faults, f"object[{index}].{key}"):
                texture_size(texture)
                gray = gray and (is_gray(str(texture)) if is_drawn(texture) else files.about(texture).is_gray)
        if item.mapped == "cube":
            with _collect_faults(faults, f"object[{index}].texture"):
                mapped_size(item.textures())
        if "depth" in sources:
            with _collect_faults(faults, f"object[{index}].depth"):
                files.depth(sources["depth"])
    messages = [f"{where}: {fault}" for fault, where in faults.items()]
    try:
        files.point_spread(scene)
    except (FileError, MissingDependencyError) as error:
        messages.append(str(error))
    if messages:
        raise SceneError(messages)
    return 1 if gray and not scene.separates_colors else 3


def _maps(scene: Scene, files: InputFiles) -> Maps:
    """Inverse depths of the objects that are depth maps, None for others. Raises SceneError for maps that do not fit
    the frame or the camera.
    """
    faults, maps = dict[str, str](), list[NDArray[np.float64] | None]()
    for index, item in enumerate(scene.objects):
        with _collect_faults(faults, f"object[{index}].depth"):
            maps.append(files.map(scene, item) if isinstance(item, DepthMap) else None)
    if faults:
        raise SceneError([f"{where}: {fault}" for fault, where in faults.items()])
    return tuple(maps)


@contextmanager
def _collect_faults(faults: dict[str, str], where: str) -> Iterator[None]:
    """Catch a file's error raised in the block, and add its message and `where` to `faults`. A message that another
    object or face of a box has already added is not added again.
    """
    try:
        yield
    except (FileError, MissingDependencyError) as error:
        faults.setdefault(str(error), where)
