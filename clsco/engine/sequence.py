"""Rendering of scenes to frames on a device."""

from __future__ import annotations

import operator
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise
from typing import SupportsIndex, TypedDict, Unpack

from clsco.engine.renderer import Renderer, expose
from clsco.engine.shrinking import Shrinking
from clsco.errors import DeviceError, SceneError
from clsco.frame.frame import Frame
from clsco.frame.outputs import ALL_TRUTH, IMAGE_NAMES, SENSOR_NAMES, truth_names
from clsco.opencl.session import DeviceLike, Session, session_for
from clsco.passes.tables import forget_others
from clsco.passes.trace import KeptHits, LatestHits
from clsco.plan.memory import Limit, device_bytes, fitted, lens_bytes, limit_of, parse_size
from clsco.plan.methods import MANY_RADII, check_method
from clsco.plan.plan import Plan
from clsco.plan.prepare import Prepared, lens_groups, prepare_sweep
from clsco.plan.request import Request
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


KEPT_GUARD = 32  # px, of aprons of rays that are kept


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
        Names of the outputs besides color, which are attributes of `Frame`; by default, and by "all", all of them.
        Outputs that you omit cost nothing.
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
        Largest estimated RMS error, 1 = white: fewer time samples and silhouette samples are taken, and hidden sources
        of wide blur merged. By default all samples of the scene. `Frame.metadata["approximation"]` has the numbers and
        the estimated error.
    frames : iterable of int, optional
        Numbers of the frames to render, from 0; by default all.
    memory : int or str, optional
        Limit of the buffers on the device, in bytes or like "1.5GiB"; by default half of what is free.

    Returns
    -------
    iterator of Frame
        Frames in order, of a stereo pair the left and then the right one; each is rendered when it is requested.

    Raises
    ------
    SceneError, DeviceError
        At the call, for invalid arguments.
    FileError, SceneError, DeviceError, KernelError
        From the iterator, for unreadable files, and for work that a device or a method cannot do.

    Notes
    -----
    A frame that needs more than `memory` is made in horizontal strips, with the same bits.
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
    found = render_sweep((scene_of(scene),), device=device, frames=frames, **options)
    return (frame for _, frame in found)


def render_frame(
    scene: SceneLike,
    index: int = 0,
    *,
    device: DeviceLike = None,
    **options: Unpack[Options],
) -> Frame:
    """Render one frame of a scene.

    Parameters
    ----------
    scene : Scene, mapping or path
        As for `render`, but no stereo pair, whose frames are two views.
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
    known = scene_of(scene)
    if known.stereo is not None:
        raise SceneError(f"scene: must have one view; got a stereo pair, which render(scene, frames=[{index}]) gives")
    (frame,) = render(known, device=device, frames=(index,), **options)
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
        Each scene has the noise of its `noise_seed`; in a Sweep this increases by 1 from scene to scene.
    truth, color, device, precision, method, tolerance, frames, memory
        As for `render`, for each scene.

    Returns
    -------
    iterator of (int, Frame)
        Number of a scene and one of its frames: scene by scene, but frame by frame if scenes share rays.

    Raises
    ------
    SceneError, FileError, DeviceError, KernelError
        As `render`.

    Notes
    -----
    If consecutive scenes differ only in the lens, rays are cast at their surfaces once for all of them (at sub-pixels
    near silhouettes once for each). Validated: the same bits as from `render` for each scene
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
    found = [scene_of(scene) for scene in (scenes.scenes if isinstance(scenes, Sweep) else scenes)]
    chosen = None if frames is None else frame_numbers(found, frames)
    return _render_scenes(session_for(device), found, checked_request(**options), chosen)


def checked_request(
    truth: str | Iterable[str] = ALL_TRUTH, color: bool = True, precision: str | None = None, method: str = "auto",
    tolerance: float | None = None, memory: str | int | None = None,
) -> Request:  # fmt: skip
    """Check a user's request for a rendering: `Options` by name. Raises SceneError for invalid values."""
    if precision not in (None, "single", "double"):
        raise SceneError(f"precision: must be single or double; got {precision}")
    check_method(method)
    if tolerance is not None:
        from clsco.plan.approximation import checked_tolerance

        checked_tolerance(tolerance)
    if memory is not None:
        parse_size(memory)
    names = truth_names(truth)
    if not color and (set(names) & {*IMAGE_NAMES} or set(names) <= {*SENSOR_NAMES}):
        what = "the image, what a sensor gives, alpha and subframes"
        raise SceneError(f"color: must be True for {what}; got {color} and {shown(names)}")
    return Request(names, method, tolerance, precision, memory, color)


def render_prepared(
    session: Session, prepared: Sequence[Prepared], frames: Sequence[int] | None = None, keeps_rays: bool = False
) -> Iterator[tuple[int, Frame]]:
    """`render_sweep` for prepared scenes in a session, all with one request.

    keeps_rays: keep ray hits in the session, for later renderings of the same objects. Plans made for a processor
    before a device was opened are made again if the device is not one.
    """
    known = prepared
    if any(each.plan.device.kind != session.device.kind for each in prepared):
        sweep = Sweep(("",) * len(prepared), tuple(each.scene for each in prepared))
        known = prepare_sweep(sweep, prepared[0].request, session.device, prepared[0].files)
    with session.reporting():
        for group in lens_groups([each.scene for each in known]):
            for k, frame in _render_group(session, [known[k] for k in group], frames, keeps_rays):
                yield group[k], frame


def _render_scenes(
    session: Session, scenes: Sequence[Scene], request: Request, frames: Sequence[int] | None
) -> Iterator[tuple[int, Frame]]:
    """As `render_prepared`; scenes that share their rays are prepared together, just before they are rendered."""
    for group in lens_groups(scenes):
        sweep = Sweep(("",) * len(group), tuple(scenes[k] for k in group))
        for k, frame in render_prepared(session, prepare_sweep(sweep, request, session.device), frames):
            yield group[k], frame


def frame_numbers(scenes: Sequence[Scene], frames: Iterable[SupportsIndex]) -> list[int]:
    """The numbers of frames, all of which every scene must have. Raises SceneError."""
    count = min((scene.sequence.frames for scene in scenes), default=0)
    try:
        found = [operator.index(number) for number in frames]
    except TypeError:
        raise SceneError(f"frames: must be whole numbers from 0 to {count - 1}; got {shown(frames)}") from None
    wrong = [number for number in found if not 0 <= number < count]
    if wrong and scenes:
        raise SceneError(f"frames: must lie from 0 to {count - 1}; got {wrong[0]}")
    return found


def _render_group(
    session: Session, prepared: Sequence[Prepared], frames: Sequence[int] | None, keeps_rays: bool
) -> Iterator[tuple[int, Frame]]:
    """Frames of scenes that differ in the lens or the sensor only."""
    request, views = prepared[0].request, len(prepared[0].plans)
    wanted = range(prepared[0].scene.sequence.frames) if frames is None else frames
    limit = replace(limit_of(request.memory, session.device), views=views)
    if limit.given:
        forget_others(session)
    numbers, done = list(wanted), 0
    try:
        with session.reporting():
            for found in _in_turns(session, prepared, limit, numbers):
                done += 1
                yield from found
    except DeviceError as error:
        if not error.short_of_memory:
            raise
    left = numbers[done:]
    for k, each in enumerate(prepared if left else ()):
        for of_views in _in_strips(session, each, limit, left, keeps_rays):
            yield from ((k, frame) for frame in of_views)


def _in_turns(
    session: Session, prepared: Sequence[Prepared], limit: Limit, wanted: Sequence[int]
) -> Iterator[list[tuple[int, Frame]]]:
    """Frames with each number, of all scenes that share their rays; yields nothing if they cannot share them."""
    together = []
    for of_lenses in _in_lockstep([each.plans for each in prepared], limit):
        hits = LatestHits(session)
        pairs = zip(of_lenses, prepared, strict=True)
        together.append([Renderer(session, plan, each, limit, hits) for plan, each in pairs])
    for index in wanted if together else ():
        rendered = [_together(renderers, index) for renderers in together]
        yield [(k, frame) for k, views in enumerate(zip(*rendered, strict=True)) for frame in views]


def _in_strips(
    session: Session, prepared: Prepared, limit: Limit, wanted: Sequence[int], keeps_rays: bool
) -> Iterator[list[Frame]]:
    """The views of each frame of one scene; strips shrink if the device has less memory than it reports."""
    renderers: list[Renderer] = []

    def renderer(plan: Plan) -> Renderer:
        if keeps_rays and casts_for_lenses(plan) and len(plan.strips) == 1:
            wide = fitted(replace(plan, guard_px=_kept_guard(plan.guard_px)), memory.limit)
            return Renderer(session, wide, prepared, memory.limit, KeptHits(session))
        return Renderer(session, plan, prepared, memory.limit)

    def views(plans: list[Plan], index: int) -> list[Frame]:
        try:
            renderers[:] = renderers or [renderer(plan) for plan in plans]
            return [_together([renderer], index)[0] for renderer in renderers]
        except DeviceError:
            renderers.clear()  # before those for smaller strips take memory
            raise

    def fit(limit: Limit) -> list[Plan]:
        return [fitted(plan, limit) for plan in prepared.plans]

    memory = Shrinking(session, limit, fit, lambda plans: device_bytes(plans[0], limit.views))
    for index in wanted:
        yield memory.run(partial(views, index=index))


def _kept_guard(guard: int) -> int:
    """An apron for cached rays: rounded to one of few widths, so that lenses with similar blur share it."""
    step = max(1 << guard.bit_length() >> 2, KEPT_GUARD)
    return -(-guard // step) * step


def _in_lockstep(plans: Sequence[tuple[Plan, ...]], limit: Limit) -> list[list[Plan]]:
    """Plans per eye and lens that share their rays, with one guard band; empty if they cannot share them or do not
    fit.
    """
    if len(plans) == 1 or not all(_shares_rays(one, other) for one, other in pairwise(plans)):
        return []
    found = []
    for of_lenses in zip(*plans, strict=True):
        guard = max(plan.guard_px for plan in of_lenses)
        alike = [replace(plan, guard_px=guard) for plan in of_lenses]
        if lens_bytes(alike) * limit.views > limit.total or any(
            fitted(plan, limit).strip_rows < plan.rows for plan in alike
        ):
            return []
        found.append(alike)
    return found


def _shares_rays(one: tuple[Plan, ...], other: tuple[Plan, ...]) -> bool:
    """True if ray hits of one lens serve another one."""
    return all(
        casts_for_lenses(a)
        and casts_for_lenses(b)
        and (a.blur, a.groups, a.silhouettes, a.samples, a.divided)
        == (b.blur, b.groups, b.silhouettes, b.samples, b.divided)
        for a, b in zip(one, other, strict=True)
    )


def casts_for_lenses(plan: Plan) -> bool:
    """True if the plan casts rays and uses their hits only for sources."""
    return not plan.apart and plan.blur in MANY_RADII and "trace" in {step.kind for step in plan.passes}


def _together(renderers: Sequence[Renderer], index: int) -> list[Frame]:
    """One frame of each renderer, rendered in lockstep, time sample by time sample."""
    films = expose(renderers, index)
    return [renderer.finish(film) for renderer, film in zip(renderers, films, strict=True)]
