"""From scenes to frames on a device."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

from clsco.engine.renderer import Hits, Renderer, expose
from clsco.errors import DeviceError
from clsco.frame.frame import STEREO_NAMES, TRUTH_NAMES, Frame
from clsco.inputs.depth_maps import load_scene_depths
from clsco.inputs.textures import Texture, load_scene_textures
from clsco.opencl.device import choose
from clsco.opencl.session import Session, session_on
from clsco.optics.motion import Eye
from clsco.plan.memory import Limit, device_bytes, fitted, hit_bytes, limit_of, parse_size
from clsco.plan.plan import Plan, make_plan
from clsco.plan.predict import Maps
from clsco.scene.model import Scene

# Keys of the camera that change what a lens makes of a hit, and not what a ray hits.
LENS_KEYS = ("f_number", "aperture_diameter", "focus_distance", "sensor_distance")


def render(
    scene: Scene,
    *,
    truth: Sequence[str] = (*TRUTH_NAMES, *STEREO_NAMES),
    device: str | None = None,
    precision: str | None = None,
    method: str = "auto",
    tolerance: float | None = None,
    frames: Iterable[int] | None = None,
    memory: str | int | None = None,
) -> Iterator[Frame]:
    """Render frames of a scene.

    truth: names of the outputs besides color (`clsco.frame.frame`), none of which costs anything when it is
    left out; device: part of the name of an OpenCL device; precision: "double" or "single" for geometry, by default
    double where the device has it; method: of the blur, see `plan.make_plan`; tolerance: RMS error of white up to
    which an approximation may be taken where it is faster, None for the exact blur (its name and the error measured are
    in `Frame.metadata["approximation"]`, see `approximation.Told`); frames: numbers of the frames wanted, by default
    all; memory: most that the buffers on the device may take, bytes or a size like "1.5GiB", by default half of what is
    free: a frame that needs more is made in horizontal strips, with the same bits, but for an approximation, which
    needs the whole frame (where a tolerance leaves the choice, the exact blur is taken).
    Yields frames in order, of a stereo pair the left and then the right one. Raises SceneError, ImageError,
    DeviceError, KernelError.
    Validated against `clsco.reference.render` on every scene in examples/ and a ray tracer (benchmarks/accuracy.py).
    """
    options: dict[str, Any] = {"truth": truth, "device": device, "precision": precision, "method": method}
    for _, frame in render_sweep((scene,), **options, tolerance=tolerance, frames=frames, memory=memory):
        yield frame


def render_sweep(
    scenes: Sequence[Scene],
    *,
    truth: Sequence[str] = (*TRUTH_NAMES, *STEREO_NAMES),
    device: str | None = None,
    precision: str | None = None,
    method: str = "auto",
    tolerance: float | None = None,
    frames: Iterable[int] | None = None,
    memory: str | int | None = None,
) -> Iterator[tuple[int, Frame]]:
    """Render frames of several scenes, such as those of `clsco.load_sweep`.

    Arguments as for `render`. Where scenes that follow each other differ in nothing but the lens, rays are cast at
    their surfaces once for all of them (at sub-pixels near silhouettes once for each). Yields (number of the scene,
    frame): scene by scene, and where rays are shared frame by frame. Raises as `render`.
    Validated: the same bits as from `render` for each scene (tests/pipeline/test_sweep.py).
    """
    chosen = None if frames is None else list(frames)
    if memory is not None:
        parse_size(memory)
    session = session_on(choose(device))
    with session.telling():
        for group in _groups(scenes):
            members = [scenes[k] for k in group]
            options = (tuple(truth), precision, (method, tolerance), chosen, memory)
            for k, frame in _render_group(session, members, *options):
                yield group[k], frame


def _groups(scenes: Sequence[Scene]) -> list[list[int]]:
    """Numbers of scenes that follow each other and differ in the lens only."""
    found: list[list[int]] = []
    for k, scene in enumerate(scenes):
        if k and _without_lens(scenes[k - 1]) == _without_lens(scene):
            found[-1].append(k)
        else:
            found.append([k])
    return found


def _without_lens(scene: Scene) -> Scene:
    return scene.model_copy(update={"camera": scene.camera.model_copy(update=dict.fromkeys(LENS_KEYS))})


def _render_group(
    session: Session, scenes: Sequence[Scene], truth: tuple[str, ...], precision: str | None,
    method: tuple[str, float | None], frames: Sequence[int] | None, memory: str | int | None,
) -> Iterator[tuple[int, Frame]]:  # fmt: skip
    """method: with the tolerance."""
    first, textures = load_scene_textures(scenes[0])
    channels = max(texture.radiance.shape[2] if texture.radiance.ndim == 3 else 1 for texture in textures)
    eyes: tuple[Eye, ...] = ("left",) if first.stereo is None else ("left", "right")
    plans: list[tuple[Plan, ...]] = []
    maps = []
    for scene in scenes:
        camera = scene.camera.model_copy(update={"resolution": first.camera.resolution})
        sized = scene.model_copy(update={"camera": camera})
        maps.append(load_scene_depths(sized))
        how = (maps[-1], method[1], session.device.kind == "gpu")
        plans.append(tuple(make_plan(sized, channels, truth, method[0], eye, *how) for eye in eyes))
    wanted = range(first.sequence.frames) if frames is None else frames
    device = session.device
    whole = limit_of(memory, device.global_mem, device.max_alloc, device.compute_units, device.unified_memory)
    limit = replace(whole, views=len(eyes))
    numbers, done = list(wanted), 0
    try:
        with session.telling():
            for found in _in_turns(session, _in_lockstep(plans, limit), textures, maps, limit, precision, numbers):
                done += 1
                yield from found
    except DeviceError as error:
        if not error.short_of_memory:
            raise
    left = numbers[done:]
    for k, of_eyes in enumerate(plans if left else ()):
        for views in _in_strips(session, of_eyes, textures, maps[k], limit, precision, left):
            yield from ((k, frame) for frame in views)


def _in_turns(
    session: Session, lockstep: Sequence[Sequence[Plan]], textures: Sequence[Texture], maps: Sequence[Maps],
    limit: Limit, precision: str | None, wanted: Sequence[int],
) -> Iterator[list[tuple[int, Frame]]]:  # fmt: skip
    """Of plans per eye and lens that share their rays, all frames of each number; of no plans none."""
    together = []
    for of_lenses in lockstep:
        hits = Hits(session)
        pairs = zip(of_lenses, maps, strict=True)
        together.append([Renderer(session, plan, textures, m, limit, precision, hits) for plan, m in pairs])
    for index in wanted if together else ():
        rendered = [_together(renderers, index) for renderers in together]
        yield [(k, frame) for k, views in enumerate(zip(*rendered, strict=True)) for frame in views]


def _in_strips(
    session: Session, of_eyes: Sequence[Plan], textures: Sequence[Texture], maps: Maps, limit: Limit,
    precision: str | None, wanted: Sequence[int],
) -> Iterator[list[Frame]]:  # fmt: skip
    """The views of each frame of one scene; in smaller strips where the device has less memory than it told."""
    renderers: list[Renderer] = []
    fitting = [fitted(plan, limit) for plan in of_eyes]
    for index in wanted:
        views: list[Frame] = []
        while not views:
            try:
                with session.telling():
                    renderers = renderers or [Renderer(session, p, textures, maps, limit, precision) for p in fitting]
                    views = [_together([renderer], index)[0] for renderer in renderers]
            except DeviceError as error:
                renderers = []  # before those for smaller strips take memory
                taken = device_bytes(fitting[0], limit.cores, limit.views)
                limit = replace(limit, total=min(limit.total, taken) // 2, given=False)
                before, fitting = fitting, [fitted(plan, limit) for plan in of_eyes]
                if not error.short_of_memory or fitting == before:
                    raise
        yield views


def _in_lockstep(plans: Sequence[tuple[Plan, ...]], limit: Limit) -> list[list[Plan]]:
    """Plans per eye and lens that share their rays, with one guard band; none where they cannot, or do not fit."""
    if len(plans) == 1 or not all(_shares_rays(one, other) for one, other in pairwise(plans)):
        return []
    found = []
    for of_lenses in zip(*plans, strict=True):
        guard = max(plan.guard_px for plan in of_lenses)
        alike = [replace(plan, guard_px=guard) for plan in of_lenses]
        needed = sum(device_bytes(plan, limit.cores) for plan in alike) + hit_bytes(alike[0])
        if needed * limit.views > limit.total or any(fitted(plan, limit).strip_rows < plan.rows for plan in alike):
            return []
        found.append(alike)
    return found


def _shares_rays(one: tuple[Plan, ...], other: tuple[Plan, ...]) -> bool:
    """Whether what rays hit for one lens serves another one."""
    return all(
        a.blur == b.blur in ("gather", "tiles")
        and not (a.forward or b.forward or a.still_map or b.still_map)
        and "layered" not in (a.occlusion, b.occlusion)
        and (a.layers, a.silhouettes, a.samples) == (b.layers, b.silhouettes, b.samples)
        for a, b in zip(one, other, strict=True)
    )


def _together(renderers: Sequence[Renderer], index: int) -> list[Frame]:
    """One frame of each renderer, moment by moment."""
    expose(renderers, index)
    return [renderer.finish(index) for renderer in renderers]
