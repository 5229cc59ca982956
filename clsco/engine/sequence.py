"""Renders the frames of scenes on a device."""

from __future__ import annotations

import operator
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import SupportsIndex, TypedDict, Unpack

from clsco.engine.renderer import Renderer, expose
from clsco.engine.shrinking import Shrinking
from clsco.errors import DeviceError, SceneError
from clsco.frame.frame import Frame
from clsco.frame.outputs import ALL_TRUTH, IMAGE_NAMES, SENSOR_NAMES, truth_names
from clsco.opencl.session import DeviceLike, Session, session_for
from clsco.passes.tables import forget_others
from clsco.passes.trace import CachedHits, LatestHits
from clsco.plan.memory import Limit, device_bytes, fit_strips, lens_bytes, limit_of, parse_size
from clsco.plan.methods import MANY_RADII, check_method
from clsco.plan.plan import Plan
from clsco.plan.prepare import Prepared, lens_groups, prepare_sweep
from clsco.plan.request import Request, check_tolerance
from clsco.scene.file import SceneLike, scene_of
from clsco.scene.model import Scene
from clsco.scene.sweep import Sweep
from clsco.scene.text import shown


class Options(TypedDict, total=False):
    """Options of a rendering, see `render`."""

    truth: str | Iterable[str]
    color: bool
    precision: str | None
    method: str
    tolerance: float | None
    memory: str | int | None


GUARD_STEP = 32  # px: widths of guard bands for cached rays are rounded up to multiples of this or more


def render(
    scene: SceneLike,
    *,
    device: DeviceLike = None,
    frames: Iterable[SupportsIndex] | None = None,
    **options: Unpack[Options],
) -> Iterator[Frame]:
    """Render the frames of a scene.

    Parameters
    ----------
    scene : Scene, mapping or path
        A scene, the content of a scene file, or the file.
    truth : str or iterable of str
        Names of the outputs besides color, which are attributes of `Frame`; by default "all" of them. Outputs that you
        omit cost nothing.
    color : bool
        True by default. False renders ground truth only: `Frame.color` is None, and the blur, most of the work, is
        skipped.
    device : str, pyopencl.Device, Context or CommandQueue, optional
        Part of a device's name, "cpu" or "gpu", or a pyopencl object to render with.
    precision : {"double", "single"}, optional
        Precision of the geometry; by default double if the device has it.
    method : str
        Method of the blur: "auto", the default, or "gather", "scatter", "tiles" or "convolve" if it can blur the
        scene.
    tolerance : float, optional
        Largest estimated RMS error, 1 = white. Within it, rendering takes fewer time samples and silhouette samples;
        `Frame.metadata["approximation"]` has the numbers and the estimated error. By default rendering takes all
        samples of the scene.
    frames : iterable of int, optional
        Numbers of the frames to render, from 0; by default all.
    memory : int or str, optional
        Limit of the buffers on the device, in bytes or like "1.5GiB"; by default half of the processor's free memory,
        or of a GPU's memory.

    Returns
    -------
    iterator of Frame
        Frames in order, with the left view of a stereo pair before the right one; each is rendered when requested.

    Raises
    ------
    SceneError, DeviceError
        At the call, for invalid arguments.
    FileError, SceneError, DeviceError, KernelError
        From the iterator, for unreadable files, and for scenes that the device or the method cannot render.

    Notes
    -----
    A frame that needs more than `memory` is rendered in horizontal strips, with the same bits.
    Validated against `clsco.reference.render` on every scene in examples/, and a ray tracer
    (benchmarks/truth/accuracy.py).

    Examples
    --------
    >>> import clsco
    >>> ball = clsco.Sphere(center=(0, 0, 280), radius=30)
    >>> scene = clsco.Scene(camera=clsco.Camera(resolution=(32, 24), pixel_pitch=0.2), objects=(ball,))
    >>> for frame in clsco.render(scene, truth=("depth", "mask")):
    ...     print(frame.index, frame.color.shape, frame.depth.dtype, frame.flow)
    0 (24, 32) float32 None
    """
    rendered = render_sweep((scene_of(scene),), device=device, frames=frames, **options)
    return (frame for _, frame in rendered)


def render_frame(scene: SceneLike, index: int = 0, *, device: DeviceLike = None, **options: Unpack[Options]) -> Frame:
    """Render one frame of a scene.

    Parameters
    ----------
    scene : Scene, mapping or path
        As for `render`, but not with a stereo pair, which has two views per frame.
    index : int
        Number of the frame, from 0.
    truth, color, device, precision, method, tolerance, memory
        As for `render`.

    Returns
    -------
    Frame

    Raises
    ------
    SceneError, FileError, DeviceError, KernelError
        As `render`, but all at the call.

    Examples
    --------
    >>> import clsco
    >>> ball = clsco.Sphere(center=(0, 0, 280), radius=30)
    >>> scene = clsco.Scene(camera=clsco.Camera(resolution=(32, 24), pixel_pitch=0.2), objects=(ball,))
    >>> frame = clsco.render_frame(scene, truth="depth")
    >>> bool(abs(frame.depth.min() - 250) < 0.1)  # mm
    True
    """
    scene = scene_of(scene)
    if scene.stereo is not None:
        raise SceneError(f"scene: must have one view; got a stereo pair, which render(scene, frames=[{index}]) gives")
    (frame,) = render(scene, device=device, frames=(index,), **options)
    return frame


def render_sweep(
    scenes: Sweep | Iterable[SceneLike],
    *,
    device: DeviceLike = None,
    frames: Iterable[SupportsIndex] | None = None,
    **options: Unpack[Options],
) -> Iterator[tuple[int, Frame]]:
    """Render the frames of several scenes, such as those of `clsco.load_sweep`.

    Parameters
    ----------
    scenes : Sweep or iterable of Scene, mapping or path
        Each scene has the sensor noise of its `noise_seed`; in a Sweep, the seed increases by 1 from scene to scene.
    truth, color, device, precision, method, tolerance, frames, memory
        As for `render`, for each scene.

    Returns
    -------
    iterator of (int, Frame)
        Number of a scene, and one of its frames. Frames come scene by scene; scenes that share rays take turns frame by
        frame.

    Raises
    ------
    SceneError, FileError, DeviceError, KernelError
        As `render`.

    Notes
    -----
    If consecutive scenes differ only in the lens, rays through pixels are cast once for all of them; rays of sub-pixel
    sources near silhouettes are cast for each. Validated: the same bits as from `render` for each scene
    (tests/cli/test_sweep.py).

    Examples
    --------
    >>> import clsco
    >>> ball = clsco.Sphere(center=(0, 0, 280), radius=30)
    >>> scene = clsco.Scene(camera=clsco.Camera(resolution=(32, 24), pixel_pitch=0.2), objects=(ball,))
    >>> lenses = [scene.replace("camera.f_number", number) for number in (2, 4)]
    >>> [number for number, frame in clsco.render_sweep(lenses, truth=())]
    [0, 1]
    """
    models = [scene_of(scene) for scene in (scenes.scenes if isinstance(scenes, Sweep) else scenes)]
    numbers = None if frames is None else frame_numbers(models, frames)
    return _render_scenes(session_for(device), models, checked_request(**options), numbers)


def checked_request(
    truth: str | Iterable[str] = ALL_TRUTH, color: bool = True, precision: str | None = None, method: str = "auto",
    tolerance: float | None = None, memory: str | int | None = None,
) -> Request:  # fmt: skip
    """The request for a rendering with these `Options`. Raises SceneError for invalid values."""
    if precision not in (None, "single", "double"):
        raise SceneError(f"precision: must be single or double; got {precision}")
    check_method(method)
    if tolerance is not None:
        check_tolerance(tolerance)
    if memory is not None:
        parse_size(memory)
    names = truth_names(truth)
    if not color and (set(names) & {*IMAGE_NAMES} or set(names) <= {*SENSOR_NAMES}):
        outputs = "the image, what a sensor gives, alpha and subframes"
        raise SceneError(f"color: must be True for {outputs}; got {color} and {shown(names)}")
    return Request(names, method, tolerance, precision, memory, color)


def render_prepared(
    session: Session, prepared: Sequence[Prepared], frames: Sequence[int] | None = None, keeps_rays: bool = False
) -> Iterator[tuple[int, Frame]]:
    """`render_sweep` for prepared scenes in a session; all of them have the same request.

    keeps_rays: True to cache ray hits in the session, for later renderings of the same objects. Plans that were made
    for another kind of device, because none was open yet, are made again.
    """
    if any(entry.plan.device.kind != session.device.kind for entry in prepared):
        sweep = Sweep(("",) * len(prepared), tuple(entry.scene for entry in prepared))
        prepared = prepare_sweep(sweep, prepared[0].request, session.device, prepared[0].files)
    with session.reporting():
        for group in lens_groups([entry.scene for entry in prepared]):
            for k, frame in _render_group(session, [prepared[k] for k in group], frames, keeps_rays):
                yield group[k], frame


def _render_scenes(
    session: Session, scenes: Sequence[Scene], request: Request, frames: Sequence[int] | None
) -> Iterator[tuple[int, Frame]]:
    """Prepare and render scenes; those that share rays are prepared together, just before they are rendered."""
    for group in lens_groups(scenes):
        sweep = Sweep(("",) * len(group), tuple(scenes[k] for k in group))
        for k, frame in render_prepared(session, prepare_sweep(sweep, request, session.device), frames):
            yield group[k], frame


def frame_numbers(scenes: Sequence[Scene], frames: Iterable[SupportsIndex]) -> list[int]:
    """The numbers of frames as ints. Raises SceneError unless every scene has all of these frames."""
    count = min((scene.sequence.frames for scene in scenes), default=0)
    try:
        numbers = [operator.index(number) for number in frames]
    except TypeError:
        raise SceneError(f"frames: must be whole numbers from 0 to {count - 1}; got {shown(frames)}") from None
    wrong = [number for number in numbers if not 0 <= number < count]
    if wrong and scenes:
        raise SceneError(f"frames: must lie from 0 to {count - 1}; got {wrong[0]}")
    return numbers


def _render_group(
    session: Session, prepared: Sequence[Prepared], frames: Sequence[int] | None, keeps_rays: bool
) -> Iterator[tuple[int, Frame]]:
    """Render scenes that differ only in the lens or the sensor; yields pairs of a scene's number and a frame of it."""
    limit = replace(limit_of(prepared[0].request.memory, session.device), views=len(prepared[0].plans))
    if limit.set_by_user:
        forget_others(session)
    numbers, done = list(range(prepared[0].scene.sequence.frames) if frames is None else frames), 0
    try:
        with session.reporting():
            for rendered in _render_lenses(session, prepared, limit, numbers):
                done += 1
                yield from rendered
    except DeviceError as error:
        if not error.short_of_memory:
            raise
    remaining = numbers[done:]
    for k, entry in enumerate(prepared if remaining else ()):
        for view_frames in _render_views(session, entry, limit, remaining, keeps_rays):
            yield from ((k, frame) for frame in view_frames)


def _render_lenses(
    session: Session, prepared: Sequence[Prepared], limit: Limit, numbers: Sequence[int]
) -> Iterator[list[tuple[int, Frame]]]:
    """Render scenes that share their rays; yields for each frame number the frames of all scenes with the scenes'
    numbers. Yields nothing if the scenes cannot share rays.
    """
    lockstep = []
    for lens_plans in _lockstep_plans([entry.plans for entry in prepared], limit):
        hits = LatestHits(session)
        pairs = zip(lens_plans, prepared, strict=True)
        lockstep.append([Renderer(session, plan, entry, limit, hits) for plan, entry in pairs])
    for index in numbers if lockstep else ():
        rendered = [_render_lockstep(renderers, index) for renderers in lockstep]
        yield [(k, frame) for k, views in enumerate(zip(*rendered, strict=True)) for frame in views]


def _render_views(
    session: Session, prepared: Prepared, limit: Limit, numbers: Sequence[int], keeps_rays: bool
) -> Iterator[list[Frame]]:
    """Render one scene; yields the views of each frame. Strips shrink if the device has less memory than it reports."""
    renderers: list[Renderer] = []

    def renderer(plan: Plan) -> Renderer:
        if keeps_rays and casts_for_lenses(plan) and len(plan.strips) == 1:
            wide = fit_strips(with_guard(plan, _round_guard(plan.guard_px)), memory.limit)
            return Renderer(session, wide, prepared, memory.limit, CachedHits(session))
        return Renderer(session, plan, prepared, memory.limit)

    def views(plans: list[Plan], index: int) -> list[Frame]:
        try:
            renderers[:] = renderers or [renderer(plan) for plan in plans]
            return [_render_lockstep([renderer], index)[0] for renderer in renderers]
        except DeviceError:
            renderers.clear()  # releases memory for those with smaller strips
            raise

    def fit(limit: Limit) -> list[Plan]:
        return [fit_strips(plan, limit) for plan in prepared.plans]

    memory = Shrinking(session, limit, fit, lambda plans: device_bytes(plans[0], limit.views))
    for index in numbers:
        yield memory.run(partial(views, index=index))


def _round_guard(guard: int) -> int:
    """Round up a guard band for cached rays to one of few widths, so that lenses with similar blur share the rays."""
    step = max(1 << guard.bit_length() >> 2, GUARD_STEP)
    return -(-guard // step) * step


def with_guard(plan: Plan, guard: int) -> Plan:
    """The plan with a guard band of `guard` px, a width that other plans share; the added pixels have no sources."""
    return replace(plan, guard_px=guard, spare_px=guard - plan.guard_px)


def _lockstep_plans(plans: Sequence[tuple[Plan, ...]], limit: Limit) -> list[list[Plan]]:
    """Plans of lenses that share their rays, widened to one guard band: for each view, the plans of all lenses. Empty
    if the lenses cannot share rays, or their buffers do not fit. plans: for each lens, the plans of its views.
    """
    keys = {tuple((plan.blur, plan.groups, plan.silhouettes, plan.samples) for plan in views) for views in plans}
    if len(plans) == 1 or len(keys) > 1 or not all(casts_for_lenses(plan) for views in plans for plan in views):
        return []
    plans_by_eye = []
    for lens_plans in zip(*plans, strict=True):
        guard = max(plan.guard_px for plan in lens_plans)
        widened = [with_guard(plan, guard) for plan in lens_plans]
        if lens_bytes(widened) * limit.views > limit.total:
            return []
        if any(fit_strips(plan, limit).strip_rows < plan.rows for plan in widened):
            return []
        plans_by_eye.append(widened)
    return plans_by_eye


def casts_for_lenses(plan: Plan) -> bool:
    """True if the plan casts rays whose hits are only made into sources, so that several lenses can share the hits."""
    return not plan.color_plans and plan.blur in MANY_RADII and "trace" in {step.kind for step in plan.passes}


def _render_lockstep(renderers: Sequence[Renderer], index: int) -> list[Frame]:
    """Render frame `index` with all renderers in turn for each time sample; returns a frame of each renderer."""
    films = expose(renderers, index)
    return [renderer.finish(film) for renderer, film in zip(renderers, films, strict=True)]
