"""The renderer: a process of its own, so that a window outlives its driver, and is not held up by it."""

from __future__ import annotations

import asyncio
import multiprocessing
import os
import threading
import time
import traceback
from collections.abc import AsyncGenerator
from contextlib import aclosing, suppress
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from typing import Any

from clsco.errors import CanceledError, ClscoError, SceneError
from clsco.frame.frame import Frame
from clsco.optics.motion import Eye
from clsco.scene.model import Scene
from clsco.studio.ladder import Ladders, coarser, work_of
from clsco.studio.pictures import DRAGGING, EXACT, IMAGES, LOSSY, Picture


class RendererEndedError(ClscoError):
    """The renderer's process ended in the middle of its work; another one is started for the next."""


@dataclass(frozen=True)
class Job:
    """A picture that is wanted.

    Attributes
    ----------
    scene : Scene
    index : int
        Number of the frame.
    view : str
        One of `pictures.VIEWS`.
    rung : int
        DRAGGING: one picture, as large as the time for it allows. EXACT: the frame, lossy first where that is quicker.
    eye : {"left", "right"}
        Of a stereo pair.
    """

    scene: Scene
    index: int
    view: str
    rung: int
    eye: Eye = "left"


@dataclass(frozen=True)
class Question:
    """What is known of a pixel is asked for; frames of one `key` are the same."""

    scene: Scene
    index: int
    key: tuple[int, int, int, float | None, Eye]
    x: int
    y: int
    eye: Eye = "left"


class Renderer:
    """What the server has of the renderer: jobs go in, one at a time, and pictures come out.

    Parameters
    ----------
    device : str, optional
        As for `clsco.render`.
    """

    def __init__(self, device: str | None = None) -> None:
        self._device = device
        self._turn = asyncio.Lock()
        self._process: multiprocessing.process.BaseProcess | None = None
        self._pipe: Connection | None = None
        self._number = 0
        self._answers: asyncio.Queue[tuple[int, Any]] = asyncio.Queue()

    @property
    def pid(self) -> int | None:
        """Of the process, if there is one."""
        return self._process.pid if self._process is not None else None

    def start(self) -> None:
        """Start the process, if there is none."""
        if self._process is not None:
            return
        context = multiprocessing.get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=_work, args=(theirs, self._device), daemon=True)
        self._process.start()
        theirs.close()
        self._answers = asyncio.Queue()
        loop = asyncio.get_running_loop()
        threading.Thread(target=_listen, args=(self._pipe, loop, self._answers), daemon=True).start()

    async def pictures(self, job: Job) -> AsyncGenerator[Picture, None]:
        """Pictures of a job, as they come.

        Raises
        ------
        CanceledError
            `cancel` was called meanwhile.
        RendererEndedError
            The process ended, of a fault or because it was killed.
        SceneError, ImageError, DeviceError, KernelError
            As `clsco.render`.
        """
        async with aclosing(self._ask("render", job)) as answers:
            async for answer in answers:
                yield answer

    async def inspect(self, question: Question) -> dict[str, Any]:
        """What `clsco.studio.inspector.inspected` gives for a pixel. Raises as `pictures`."""
        async with aclosing(self._ask("inspect", question)) as answers:
            return await anext(answers)

    async def warm(self, scene: Scene) -> None:
        """Have compiled, in the background, what the scene and those near it need."""
        async for _ in self._ask("warm", scene):
            pass

    async def _ask(self, what: str, content: Any) -> AsyncGenerator[Any, None]:
        async with self._turn:
            self.start()
            assert self._pipe is not None
            self._number += 1
            number, is_whole = self._number, False
            try:
                self._pipe.send((what, number, content))
                while True:
                    of, answer = await self._answers.get()
                    if of < 0:
                        raise EOFError
                    if of != number:
                        continue  # of a job that nobody waits for any more
                    if answer is None or isinstance(answer, ClscoError):
                        is_whole = True
                    if isinstance(answer, ClscoError):
                        raise answer
                    if answer is None:
                        return
                    yield answer
            except (OSError, EOFError):
                is_whole = True
                raise RendererEndedError(self._buried()) from None
            finally:
                if not is_whole:
                    self.cancel()

    def cancel(self) -> None:
        """End the job that is worked on before its next pass."""
        if self._pipe is not None:
            with suppress(OSError):
                self._pipe.send(("cancel", self._number, None))

    def close(self) -> None:
        """End the process."""
        if self._process is not None:
            self._process.terminate()
            self._buried()

    def _buried(self) -> str:
        """Let go of a process that has ended, and say how."""
        process, pipe = self._process, self._pipe
        assert process is not None
        assert pipe is not None
        self._process = self._pipe = None
        process.join(1.0)
        with suppress(OSError):
            pipe.close()
        code = process.exitcode
        how = f"signal {-code}" if code is not None and code < 0 else f"status {code}"
        return f"renderer: must not end by itself; got {how}; it is started again"


def _listen(pipe: Connection, loop: asyncio.AbstractEventLoop, answers: asyncio.Queue[tuple[int, Any]]) -> None:
    """Hand on what the process says, until it ends."""
    with suppress(RuntimeError):  # the loop is closed
        try:
            while True:
                loop.call_soon_threadsafe(answers.put_nowait, pipe.recv())
        except (EOFError, OSError):
            loop.call_soon_threadsafe(answers.put_nowait, (-1, None))


def _work(pipe: Connection, device: str | None) -> None:
    """The process: a thread that listens, and this one that renders."""
    import queue
    import signal

    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the server, which ends this
    jobs: queue.SimpleQueue[tuple[str, int, Any]] = queue.SimpleQueue()
    worker = _Worker(pipe, device)

    def listen() -> None:
        try:
            while True:
                what, number, content = pipe.recv()
                if what == "cancel":
                    worker.cancel(number)
                else:
                    jobs.put((what, number, content))
        except (EOFError, OSError):
            os._exit(0)  # the server has ended

    threading.Thread(target=listen, daemon=True).start()
    while True:
        worker.answer(*jobs.get())


class _Worker:
    """Renders in the process."""

    def __init__(self, pipe: Connection, device: str | None) -> None:
        self._pipe, self._device = pipe, device
        self._canceled = 0
        self._ladders: dict[Any, Ladders] = {}
        self._live: Any = None
        self._known: tuple[Any, Any] | None = None  # key and frame with all of its ground truth

    def cancel(self, number: int) -> None:
        self._canceled = max(self._canceled, number)
        if self._live is not None:
            self._live.cancel()

    def answer(self, what: str, number: int, content: Any) -> None:
        """Do a job, and say that it is done, or why not."""
        error: ClscoError | None = None
        try:
            if self._live is None:
                from clsco.engine.live import Live

                self._live = Live(self._device)
            if what == "warm":
                self._live.warm(content)
            elif what == "inspect":
                self._pipe.send((number, self._inspect(number, content)))
            elif content.rung == DRAGGING:
                self._coarse(number, content)
            else:
                self._exact(number, content)
        except ClscoError as raised:
            error = raised
        except MemoryError:
            error = SceneError("memory: must hold the arrays of the scene; got too little of it")
        except Exception as raised:  # a fault of ours, which is no reason to lose what is kept
            traceback.print_exc()
            error = ClscoError(f"renderer: must not fail; got {type(raised).__name__}: {raised}")
        self._pipe.send((number, error))

    def _coarse(self, number: int, job: Job) -> None:
        from clsco.inputs.textures import texture_size
        from clsco.studio.pictures import picture_of, truth_of

        size = job.scene.camera.resolution or texture_size(job.scene.objects[0].inputs()["texture"])
        work = work_of(job.scene, size)
        ladders = self._ladders_of(job)
        ladder, eighths = ladders.choose(job.scene, work)
        is_plain = ladder is ladders.plain
        start = time.perf_counter()
        scene = coarser(job.scene, size, eighths, is_plain)
        frame = self._frame(scene, job, truth_of(job.view))
        picture = picture_of(frame, scene, job.view, DRAGGING, size, time.perf_counter() - start)
        ladder.measured(work, eighths, time.perf_counter() - start)
        self._pipe.send((number, replace(picture, is_plain=is_plain)))

    def _exact(self, number: int, job: Job) -> None:
        from clsco.studio.pictures import picture_of, truth_of

        self._check(number)
        start = time.perf_counter()
        frame = self._frame(job.scene, job, truth_of(job.view))
        seconds, (rows, columns) = time.perf_counter() - start, frame.color.shape[:2]
        self._ladders_of(job).whole.bounded(work_of(job.scene, (columns, rows)), seconds)
        rungs = (LOSSY, EXACT) if job.view in IMAGES and job.rung == EXACT else (job.rung,)
        for rung in rungs:
            self._check(number)
            picture = picture_of(frame, job.scene, job.view, rung, (columns, rows), seconds)
            if rung == EXACT:
                picture = replace(picture, about=self._about(job, frame, seconds))
            self._pipe.send((number, picture))

    def _about(self, job: Job, frame: Frame, seconds: float) -> dict[str, Any]:
        from clsco.plan.prepare import prepare
        from clsco.plan.request import Request
        from clsco.studio.moments import exposure_of
        from clsco.studio.pictures import truth_of
        from clsco.studio.planned import plan_line

        prepared = prepare(job.scene, Request(truth_of(job.view)), self._live.session.device, self._live.files)
        return {"plan": plan_line(prepared, seconds)} | exposure_of(frame, job.scene)

    def _ladders_of(self, job: Job) -> Ladders:
        return self._ladders.setdefault((job.view, len(job.scene.objects), job.scene.moves), Ladders())

    def _inspect(self, number: int, question: Question) -> dict[str, Any]:
        from clsco.frame.frame import ALL_TRUTH
        from clsco.studio.inspector import inspected

        if self._known is None or self._known[0] != question.key:
            self._check(number)
            self._known = None
            self._known = question.key, self._frame(question.scene, question, ALL_TRUTH)
        frame = self._known[1]
        rows, columns = frame.color.shape[:2]
        return inspected(frame, question.scene, min(question.x, columns - 1), min(question.y, rows - 1))

    def _frame(self, scene: Scene, of: Job | Question, truth: tuple[str, ...]) -> Frame:
        from clsco.engine.sequence import render

        if scene.stereo is not None:
            views = render(scene, truth=truth, device=self._device, frames=(of.index,))
            return next(frame for frame in views if frame.eye == of.eye)
        frame: Frame = self._live.render(scene, of.index, truth=truth)
        return frame

    def _check(self, number: int) -> None:
        if self._canceled >= number:
            raise CanceledError("canceled")
