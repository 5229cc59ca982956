"""The renderer. It is a separate process, so that a crash of a driver or a long render does not stop the studio."""

from __future__ import annotations

import asyncio
import threading
import time
import traceback
from collections.abc import AsyncGenerator, Callable, Coroutine
from contextlib import aclosing, suppress
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from typing import Any

from clsco.engine.child import Child, how_ended
from clsco.errors import CanceledError, ClscoError, DeviceError, SceneError
from clsco.frame.frame import Frame
from clsco.frame.outputs import ALL_TRUTH
from clsco.optics.motion import Eye
from clsco.plan.memory import device_bytes
from clsco.plan.prepare import prepare, with_resolution
from clsco.plan.request import Request
from clsco.resources import machine_bytes
from clsco.scene.model import Scene
from clsco.studio.inspector import figures_of, focus_point, inspected, overview, source_of
from clsco.studio.ladder import Ladders, choices_of, coarser, plan_line, unblurred, work_of
from clsco.studio.pictures import (
    DRAGGING,
    EXACT,
    IMAGES,
    LOSSY,
    UNBLURRED,
    ViewPicture,
    exposure_of,
    picture_of,
    truth_of,
)  # fmt: skip

TICK = 0.5  # s between reports on long work
REHEARSED = (3, 4)  # eighths of the pictures that are rendered ahead, twice: the first of a size allocates buffers
POINT = "depth", "blur_radius", "object_id", "mask", "normal"  # outputs of exact frames, for the point in focus
PATIENCE = 1.0  # s that one of these pictures may take
SILENCE = 30.0  # s without an answer or report after which the process is killed, as it is stopped, or its driver hangs


class RendererEndedError(ClscoError):
    """The renderer's process ended during its work; another one is started for the next job."""


@dataclass(frozen=True)
class PictureJob:
    """Request for a picture."""

    scene: Scene
    index: int  # number of the frame
    view: str  # one of `pictures.VIEWS`
    # DRAGGING: a preview as large as the time budget allows. EXACT: the exact frame, for images after a lossy picture
    rung: int
    eye: Eye = "left"  # view of a stereo pair
    took: float = 0.0  # s that an exact frame of a similar scene took, an upper bound for previews; 0 if unknown


@dataclass(frozen=True)
class Question:
    """Request for the figures of a pixel."""

    scene: Scene
    index: int
    # x, y: pixel; -1 for the point in focus
    x: int
    y: int
    eye: Eye = "left"
    measures: bool = False  # True for the response of the pixel's source, which needs another rendering
    is_overview: bool = False  # True for small views of the whole frame, whatever the pixel

    @property
    def frame(self) -> tuple[Scene, int, Eye]:
        """Scene, number and view of the frame in question."""
        return self.scene, self.index, self.eye


@dataclass(frozen=True)
class RenderProgress:
    """Progress of long work."""

    doing: str  # current work: a pass, a compilation, or work for another tab
    # done, total: time samples; of a compilation, kernels
    done: int
    total: int
    still: float  # s since any of these last changed


Watch = Callable[[RenderProgress], Coroutine[Any, Any, None]]


class RendererProcess:
    """Handle of the renderer's process: takes jobs, one at a time, and returns pictures."""

    def __init__(self, device: str | None = None) -> None:
        self._device = device
        self._turn = asyncio.Lock()
        self._child: Child | None = None
        self._number = 0
        self._answers: asyncio.Queue[tuple[int, Any]] = asyncio.Queue()

    @property
    def pid(self) -> int | None:
        """Id of the process, if there is one."""
        return self._child.pid if self._child is not None else None

    def start(self) -> None:
        """Start the process, if there is none."""
        if self._child is not None:
            return
        self._child, self._answers = Child(_work, self._device), asyncio.Queue()
        loop = asyncio.get_running_loop()
        threading.Thread(target=_listen, args=(self._child.pipe, loop, self._answers), daemon=True).start()

    async def pictures(self, job: PictureJob, watch: Watch | None = None) -> AsyncGenerator[ViewPicture, None]:
        """Pictures of a job, as they are finished; `watch` is called twice a second during long work.

        Raises CanceledError after `cancel`, RendererEndedError if the process crashed or was killed, and errors as
        `clsco.render`.
        """
        async with aclosing(self._ask("render", job, watch)) as answers:
            async for answer in answers:
                yield answer

    async def inspect(self, question: Question, watch: Watch | None = None) -> dict[str, Any]:
        """Ask for the figures of a pixel; `watch` and errors are as for `pictures`.

        Returns those of `inspector.inspected`, and `seconds`, the time that a measurement would take; if the question
        measures, `x`, `y`, and `response` from `inspector.figures_of`, or the reason `unmeasured` why it was not
        measured; or those of `inspector.overview`.
        """
        async with aclosing(self._ask("inspect", question, watch)) as answers:
            return await anext(answers)

    async def warm(self, scene: Scene) -> None:
        """Compile, in the background, the kernels that the scene and similar ones need."""
        async for _ in self._ask("warm", scene):
            pass

    async def rehearse(self, job: PictureJob) -> None:
        """Compile and time previews of a job's scene. Errors are as for `pictures`."""
        async for _ in self._ask("rehearse", job):
            pass

    async def _wait_for_turn(self, watch: Watch | None) -> None:
        start, turn = time.monotonic(), asyncio.ensure_future(self._turn.acquire())
        try:
            while not (await asyncio.wait({turn}, timeout=TICK))[0]:
                if watch is not None:
                    await watch(RenderProgress("another tab", 0, 0, time.monotonic() - start))
        except BaseException:
            if not turn.cancel():
                self._turn.release()
            raise

    async def _ask(self, what: str, content: Any, watch: Watch | None = None) -> AsyncGenerator[Any, None]:
        await self._wait_for_turn(watch)
        try:
            self.start()
            assert self._child is not None
            self._number += 1
            number, is_whole = self._number, False
            try:
                self._child.send((what, number, content))
                while (answer := await self._answer(number, watch)) is not None:
                    if is_whole := isinstance(answer, ClscoError):
                        raise answer
                    yield answer
                is_whole = True
            except TimeoutError:  # it is also an OSError
                is_whole = True
                self._child.kill()  # a stopped process does not end by itself
                self._end()
                rule = f"renderer: must say something within {SILENCE:g} s; got nothing; it is started again"
                raise RendererEndedError(rule) from None
            except (OSError, EOFError):
                is_whole = True
                rule = f"renderer: must not end by itself; got {self._end()}; it is started again"
                raise RendererEndedError(rule) from None
            finally:
                if not is_whole:
                    self.cancel()
        finally:
            self._turn.release()

    async def _answer(self, number: int, watch: Watch | None) -> Any:
        """The next answer to a job; a ClscoError or None ends it. Raises TimeoutError and EOFError."""
        while True:
            async with asyncio.timeout(SILENCE):  # wait_for loses a cancellation that comes with the answer
                of, answer = await self._answers.get()
            if of < 0:
                raise EOFError
            if of != number:
                continue  # an answer to a job that was given up
            if not isinstance(answer, RenderProgress):
                return answer
            if watch is not None:
                await watch(answer)

    def cancel(self) -> None:
        """Cancel the current job before its next pass."""
        if self._child is not None:
            self._child.send(("cancel", self._number, None))

    def close(self) -> None:
        """End the process."""
        if self._child is not None:
            self._child.terminate()
            self._end()

    def _end(self) -> str:
        """Release the process, which has ended or is about to; returns how it ended."""
        child, self._child = self._child, None
        assert child is not None
        return how_ended(child.end())


def _listen(pipe: Connection, loop: asyncio.AbstractEventLoop, answers: asyncio.Queue[tuple[int, Any]]) -> None:
    """Forward messages of the process to the queue, until it ends."""
    with suppress(RuntimeError):  # the loop is closed
        try:
            while True:
                loop.call_soon_threadsafe(answers.put_nowait, pipe.recv())
        except (EOFError, OSError):
            loop.call_soon_threadsafe(answers.put_nowait, (-1, None))


def _work(pipe: Connection, device: str | None) -> None:
    """Main function of the process: a thread receives jobs, another reports progress, and this one renders."""
    import queue

    jobs: queue.SimpleQueue[tuple[str, int, Any]] = queue.SimpleQueue()
    worker = _RenderWorker(pipe, device)

    def listen() -> None:
        with suppress(EOFError, OSError):  # the server has ended
            while True:
                what, number, content = pipe.recv()
                if what == "cancel":
                    worker.cancel(number)
                else:
                    jobs.put((what, number, content))

    for task in (listen, worker.watch):
        threading.Thread(target=task, daemon=True).start()
    while True:
        worker.answer(*jobs.get())


def _needed(job: PictureJob) -> Scene:
    """The scene to render for a job. If it is analytic and the view shows no blur, blur, which is slow, is removed."""
    return unblurred(job.scene) if job.view in UNBLURRED and job.scene.is_analytic else job.scene


@dataclass
class _Known:
    """A frame with all of its ground truth, kept for further questions."""

    asked: tuple[Scene, int, Eye]
    frame: Any
    is_tilted: bool  # weights depend on the gradient of R
    seconds: float  # time that a measurement takes


class _RenderWorker:
    """Renders inside the process."""

    def __init__(self, pipe: Connection, device: str | None) -> None:
        self._pipe, self._device = pipe, device
        self._canceled = 0
        self._ladders: dict[Any, Ladders] = {}
        self._live: Any = None
        self._known: _Known | None = None
        self._sending = threading.Lock()
        self._current: tuple[int, float] | None = None  # number of the job, and when it began

    def cancel(self, number: int) -> None:
        self._canceled = max(self._canceled, number)
        if self._live is not None:
            self._live.cancel()

    def answer(self, what: str, number: int, content: Any) -> None:
        """Do a job of the kind `what`: send its answers, and then None, or the error that ended it."""
        error: ClscoError | None = None
        self._current = number, time.monotonic()
        try:
            if self._live is None:
                from clsco.engine.live import Live

                self._live = Live(self._device)
            if what == "warm":
                self._live.warm(content)
            elif what == "rehearse":
                self._rehearse(content)
            elif what == "inspect":
                self._send(number, self._inspect(number, content))
            elif content.rung == DRAGGING:
                size = with_resolution(content.scene).camera.frame_size
                choice = self._ladders_of(content).choose(_needed(content), size)
                self._send(number, self._coarse_picture(content, size, *choice))
            else:
                self._exact(number, content)
        except MemoryError:
            error = self._short_of_memory(content)
        except DeviceError as raised:
            error = self._short_of_memory(content) if raised.short_of_memory else raised
        except ClscoError as raised:
            error = raised
        except Exception as raised:  # a bug: the process continues, with its caches
            traceback.print_exc()
            error = ClscoError(f"renderer: must not fail; got {type(raised).__name__}: {raised}")
        self._current = None
        self._send(number, error)

    def _short_of_memory(self, content: PictureJob | Question | Scene) -> ClscoError:
        """Error for too little memory: of the device even for strips, or of the host for the frame."""
        scene = content if isinstance(content, Scene) else content.scene
        try:
            needed = device_bytes(prepare(scene, None, self._live.session.device, self._live.files).plan)
        except (MemoryError, ClscoError):
            return SceneError("memory: must hold the textures of the scene; got too little of it")
        got = f"{machine_bytes(free=True) >> 20} MiB"
        return SceneError(f"memory: must be about {needed >> 20} MiB for this frame, beside its arrays; got {got}")

    def _send(self, number: int, answer: Any) -> None:
        with self._sending:
            self._pipe.send((number, answer))

    def watch(self) -> None:
        """Report the progress of long jobs, forever."""
        before, since = None, 0.0
        while True:
            time.sleep(TICK)
            current, live, now = self._current, self._live, time.monotonic()
            if current is None or now - current[1] < TICK:
                continue
            progress = live.session.progress if live is not None else None
            state = RenderProgress("starting the device", 0, 0, 0.0)
            if progress is not None:
                state = RenderProgress(progress.doing, progress.done, progress.total, 0.0)
                if progress.doing.startswith("compiling"):
                    compiled = {shape[0] for shape in tuple(live.session.compiled)}
                    state = replace(state, done=len(compiled), total=len(live.session.offered))
            if before != (current, state):
                before, since = (current, state), now
            with suppress(OSError):
                self._send(current[0], replace(state, still=now - since))

    def _coarse_picture(
        self, job: PictureJob, size: tuple[int, int], is_still: bool, eighths: int, learns: bool = True
    ) -> ViewPicture:
        """Render a preview; learns: True to learn from its time."""
        exact, start = _needed(job), time.perf_counter()
        scene = coarser(exact, size, eighths, is_still)
        frame = self._frame(scene, job, truth_of(job.view))
        picture = picture_of(frame, scene, job.view, DRAGGING, size, time.perf_counter() - start)
        if learns:
            work = work_of(exact, size, is_still)
            self._ladders_of(job).of[is_still].measured(work, eighths, time.perf_counter() - start)
        return replace(picture, is_still=is_still)

    def _rehearse(self, job: PictureJob) -> None:
        size, ladders, exact = with_resolution(job.scene).camera.frame_size, self._ladders_of(job), _needed(job)
        for is_still in choices_of(exact):
            ladder, work = ladders.of[is_still], work_of(exact, size, is_still)
            if job.took:
                ladder.bounded(work, job.took)
            for eighths in REHEARSED:
                if ladder.predicted(work, eighths) <= PATIENCE:
                    for learns in (False, True):
                        self._coarse_picture(job, size, is_still, eighths, learns)

    def _exact(self, number: int, job: PictureJob) -> None:
        self._check(number)
        start = time.perf_counter()
        scene = _needed(job)
        truth = truth_of(job.view) + POINT * (job.rung == EXACT and scene is job.scene)
        frame = self._frame(scene, job, tuple(dict.fromkeys(truth)))
        seconds, (rows, columns) = time.perf_counter() - start, frame.color.shape[:2]
        self._ladders_of(job).of[False].bounded(work_of(scene, (columns, rows)), seconds)
        rungs = (LOSSY, EXACT) if job.view in IMAGES and job.rung == EXACT else (job.rung,)
        for rung in rungs:
            self._check(number)
            picture = picture_of(frame, job.scene, job.view, rung, (columns, rows), seconds)
            if rung == EXACT:
                picture = replace(picture, about=self._about(job, scene, frame, seconds))
            self._send(number, picture)

    def _about(self, job: PictureJob, rendered: Scene, frame: Frame, seconds: float) -> dict[str, Any]:
        request, device, files = Request(truth_of(job.view)), self._live.session.device, self._live.files
        prepared = prepare(rendered, request, device, files)
        whole = prepared if rendered is job.scene else prepare(job.scene, request, device, files)
        took = sum(frame.metadata["seconds"].values()) * len(whole.plans) if rendered is job.scene else None
        about = {"plan": plan_line(prepared, seconds), "took": took} | exposure_of(frame, job.scene, whole.plan.samples)
        if rendered is job.scene:
            is_tilted = whole.plan.tilt and whole.plan.occlusion != "layered"
            about["point"] = inspected(frame, job.scene, *focus_point(frame), is_tilted)
        return about

    def _ladders_of(self, job: PictureJob) -> Ladders:
        return self._ladders.setdefault((job.view, len(job.scene.objects), job.scene.moves), Ladders())

    def _inspect(self, number: int, question: Question) -> dict[str, Any]:
        known, scene = self._frame_of(number, question), question.scene
        if question.is_overview:
            return overview(known.frame, scene)
        rows, columns = known.frame.color.shape[:2]
        x, y = min(question.x, columns - 1), min(question.y, rows - 1)
        x, y = (x, y) if x >= 0 else focus_point(known.frame)
        if not question.measures:
            return inspected(known.frame, scene, x, y, known.is_tilted) | {"seconds": known.seconds}
        source = source_of(known.frame, scene, x, y)
        if isinstance(source, str):
            return {"x": x, "y": y, "unmeasured": source}
        self._check(number)
        start = time.perf_counter()
        response = self._live.response(scene, *source[:2], question.index, item=source[2])
        known.seconds = time.perf_counter() - start
        return {"x": x, "y": y, "response": figures_of(response, x, y)}

    def _frame_of(self, number: int, question: Question) -> _Known:
        if self._known is None or self._known.asked != question.frame:
            self._check(number)
            self._known = None
            plan = prepare(question.scene, None, self._live.session.device, self._live.files).plan
            frame = self._frame(question.scene, question, ALL_TRUTH)
            seconds = sum(frame.metadata["seconds"].values())  # time of kernels, without compilation
            self._known = _Known(question.frame, frame, plan.tilt and plan.occlusion != "layered", seconds)
        return self._known

    def _frame(self, scene: Scene, of: PictureJob | Question, truth: tuple[str, ...]) -> Frame:
        from clsco.engine.sequence import render

        if scene.stereo is not None:
            views = render(scene, truth=truth, device=self._device, frames=(of.index,))
            return next(frame for frame in views if frame.eye == of.eye)
        frame: Frame = self._live.render(scene, of.index, truth=truth)
        return frame

    def _check(self, number: int) -> None:
        if self._canceled >= number:
            raise CanceledError("canceled")
