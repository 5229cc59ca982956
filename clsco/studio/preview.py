"""Pictures of a tab: coarse pictures during a drag, then the exact picture. Stale states are skipped."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Awaitable, Callable, Sequence
from contextlib import aclosing
from dataclasses import asdict
from typing import Any, Protocol, TypeVar

from clsco.errors import CanceledError, ClscoError
from clsco.optics.motion import Eye
from clsco.scene.model import Scene
from clsco.studio.pictures import (
    DRAGGING,
    EXACT,
    NO_NUMBER,
    OUTLINED,
    PINNED,
    STACKED,
    VIEWS,
    ViewPicture,
    moment_of,
    packed_message,
)
from clsco.studio.renderer import PictureJob, Question, RendererEndedError, RenderProgress, Watch
from clsco.studio.renderers import kind_of

REST = 0.120  # s without a change after which the exact picture is rendered
LATEST = 1e9  # s, of a time sample
MEASURE = "measure"  # purpose of a question about the response of a source
OVERVIEW = "overview"  # purpose of a question about the whole frame
MOST_UNSEEN = 2  # largest number of pictures that are sent, but not painted yet
_MOST_CRASHES = 3  # crashes after which a scene is not tried again: of both renderers, and of a restarted one

T = TypeVar("T")
Report = Callable[[dict[str, Any]], Awaitable[None]]


class Edited(Protocol):
    """Interface of a `Document` that a preview uses."""

    @property
    def scene(self) -> Scene: ...
    @property
    def revision(self) -> int: ...


class Renders(Protocol):
    """Interface of a `RendererProcess` that a preview uses."""

    def pictures(self, job: PictureJob, watch: Watch | None = None) -> AsyncGenerator[ViewPicture, None]: ...
    async def inspect(self, question: Question, watch: Watch | None = None) -> dict[str, Any]: ...
    async def warm(self, scene: Scene) -> None: ...
    def cancel(self) -> None: ...


def _now() -> float:
    """Time of the event loop's clock, s; timeouts use this clock."""
    return asyncio.get_running_loop().time()


class Preview:
    """Renders the pictures of a session for one tab, and sends them by `send`.

    Only the latest state is rendered: a waiting picture is discarded when the state changes. At most two pictures are
    in flight, so that a slow browser gets fewer pictures, not late ones.
    """

    def __init__(self, session: Edited, renderer: Renders, send: Callable[[bytes], Awaitable[None]]) -> None:
        self._session, self._renderer, self._send = session, renderer, send
        self._revision = session.revision
        self._view, self._index = "color", 0
        self._time: float | None = None  # time of the only time sample to show, s; None for the whole frame
        self._eye: Eye = "left"  # of a stereo pair
        self._state = 1  # counts changes of scene, view, frame and eye; a revision counts those of the scene
        self._done = (0, EXACT)  # state and rung of the latest picture
        self._changed_at = 0.0
        self._news = asyncio.Event()
        self._unseen: list[tuple[int, int]] = []
        self._is_exact_underway = self._is_hidden = False
        self._work: asyncio.Future[Any] | None = None  # the renderer's work that is awaited
        self._stops, self._is_stopped = 0, False  # stops by the user; True until the change after a stop
        self._crashes = 0
        self._asked: dict[str, tuple[int, int, Report]] = {}
        self._other: Scene | None = None
        self._stack: list[tuple[int, Scene]] = []  # frames still to send, with their numbers
        self.small: tuple[int, bytes] = (-1, b"")  # revision and small picture of the latest exact frame
        self._outlines, self._outlined = False, 0  # True to send object numbers; state for which they were sent
        self._warm: set[Any] = set()  # kinds of scenes for which kernels were compiled ahead

    def edited(self) -> None:
        """Render again if the scene has changed, and not only a refused value."""
        if self._revision != self._session.revision:
            self.changed()

    def changed(self) -> None:
        """Render again."""
        self._revision = self._session.revision
        self._state += 1
        self._is_stopped = False
        self._changed_at, self._crashes = _now(), 0
        self._stack = []
        self._news.set()
        self._give_up()

    def _give_up(self) -> None:
        """Cancel stale work, and stop waiting for it at once."""
        if self._is_exact_underway:
            self._renderer.cancel()
            if self._work is not None:
                self._work.cancel()

    async def _answer(self, work: Awaitable[T]) -> T:
        """The renderer's answer; raises CanceledError if it is no longer needed."""
        self._work = asyncio.ensure_future(work)
        try:
            await asyncio.wait({self._work})
            if self._work.cancelled():
                raise CanceledError("render: must go on to be done; got a later state")
            found: T = self._work.result()
            return found
        finally:
            if self._work.cancel():  # still running, because this task is canceled
                await asyncio.wait({self._work})
            self._work = None

    def stop(self) -> None:
        """Cancel long work. The picture stays until the next change."""
        is_done = self._done == (self._state, EXACT)
        if is_done and not self._is_exact_underway:
            return
        self._stops += 1
        self._asked.clear()
        self._other, self._stack = None, []
        if not is_done:
            self._state += 1
            self._done, self._is_stopped = (self._state, EXACT), True
        self._give_up()

    def look(
        self, view: str | None = None, index: int | None = None, time: float | None = None, eye: Eye | None = None
    ) -> None:
        """Show another view, another frame (whole, or only the sample at `time`, s), or the other eye."""
        before = self._view, self._index, self._time, self._eye
        if view in VIEWS:
            self._view = view
        if index is not None:
            self._index = min(max(index, 0), self._session.scene.sequence.frames - 1)
            self._time = time if time is not None and abs(time) <= LATEST else None
        self._eye = eye or self._eye
        if before != (self._view, self._index, self._time, self._eye):
            self.changed()

    def acknowledge(self, revision: int, rung: int) -> None:
        """Handle the browser's message that it has painted or discarded a picture."""
        if (revision, rung) in self._unseen:
            self._unseen.remove((revision, rung))
            self._news.set()

    def hide(self, is_hidden: bool) -> None:
        """Pause pictures of a hidden tab, or resume them: the renderer serves the visible tabs."""
        self._is_hidden = is_hidden
        self._news.set()
        if is_hidden:
            self._give_up()

    def inspect(self, x: int, y: int, report: Report, purpose: str = "") -> None:
        """Call `report` with the figures for a purpose, by default those of the pixel, when the exact frame is ready.

        Only the latest request with each purpose is answered; after `stop`, no pixel under the cursor and no overview.
        """
        if self._is_stopped and purpose in ("", OVERVIEW):
            return
        self._asked[purpose] = x, y, report
        self._news.set()

    def pin(self, scene: Scene) -> None:
        """Send the exact frame of another scene for comparison, after the exact frame of the session."""
        self._other = scene
        self._news.set()

    def stack(self, scenes: Sequence[Scene]) -> None:
        """Send the exact frames of a focal stack, until the state changes."""
        self._stack = list(enumerate(scenes))
        self._news.set()

    def outline(self, is_wanted: bool) -> None:
        """Start or stop sending the object numbers of each exact frame after the frame."""
        self._outlines, self._outlined = is_wanted, 0
        self._news.set()

    async def tell(self, **content: Any) -> None:
        """Send a message without a picture."""
        await self._send(packed_message(self._session.revision, content))

    async def run(self) -> None:
        """Send pictures and answers until canceled."""
        while True:
            await self._room()
            done, rung = self._done
            if done < self._state:
                await self._show(DRAGGING)
            elif rung < EXACT:
                if not await self._changes_within(self._changed_at + REST - _now()):
                    await self._show(EXACT)
            elif self._other is not None:
                await self._show(PINNED)
            elif self._stack:
                await self._show(STACKED)
            elif self._outlines and self._outlined < self._state:
                self._outlined = self._state
                await self._show(OUTLINED)
            elif self._asked:  # before programs for later, which take long
                await self._ask(next(iter(self._asked)))
            elif (kind := kind_of(self._session.scene)) not in self._warm:
                self._warm.add(kind)
                await self._renderer.warm(self._session.scene)
            else:
                self._news.clear()
                await self._news.wait()

    @property
    def _is_full(self) -> bool:
        return self._is_hidden or len(self._unseen) >= MOST_UNSEEN

    def _at_rest(self, scene: Scene) -> tuple[Scene, int]:
        """The scene to render for the chosen frame or time sample of a scene, and the number of the frame."""
        index = min(self._index, scene.sequence.frames - 1)
        if self._time is not None and scene.moves:
            scene = moment_of(scene, index, self._time)
        return scene, index

    async def _watch(self, progress: RenderProgress) -> None:
        await self.tell(progress=asdict(progress))

    async def _room(self) -> None:
        """Wait until another picture may be sent."""
        while self._is_full:
            self._news.clear()
            await self._news.wait()

    async def _changes_within(self, seconds: float) -> bool:
        """Wait for a change of the state, at most this time; returns True if there was one."""
        state, end = self._state, _now() + seconds
        while self._state == state and (left := end - _now()) > 0:
            self._news.clear()
            try:
                async with asyncio.timeout(left):
                    await self._news.wait()
            except TimeoutError:
                break
        return self._state != state

    async def _show(self, rung: int) -> None:
        """Render and send the pictures of a rung, or the reason why there are none."""
        state, stops, revision = self._state, self._stops, self._session.revision
        other, step = self._other if rung == PINNED else None, self._stack.pop(0) if rung == STACKED else None
        if other is not None:
            self._other = None
        job, number = self._next_job(rung, other, step)
        try:
            if await self._post_all(job, revision, number) and self._stops == stops:
                self._done = (state, min(rung, EXACT))
        except CanceledError:
            if self._stops == stops:
                self._other = self._other or other
                if rung == OUTLINED:
                    self._outlined = 0
                if step is not None and self._state == state:  # the tab was hidden meanwhile
                    self._stack.insert(0, step)
        except RendererEndedError as error:
            self._crashes += 1
            if self._crashes >= _MOST_CRASHES:
                self._done = (state, EXACT)
            await self.tell(error=[str(error)])
        except ClscoError as error:
            self._done = (state, EXACT)
            await self.tell(error=list(getattr(error, "messages", None) or [str(error)]))
        finally:
            self._is_exact_underway = False

    def _next_job(self, rung: int, other: Scene | None, step: tuple[int, Scene] | None) -> tuple[PictureJob, int]:
        """Job for the session's scene, another scene or a step of a focal stack, and the number of its pictures."""
        whole = step[1] if step is not None else other or self._session.scene
        scene, index = self._at_rest(whole)
        number = step[0] if step is not None else index if scene is whole else NO_NUMBER
        return PictureJob(scene, index, "id" if rung == OUTLINED else self._view, rung, self._eye), number

    async def _post_all(self, job: PictureJob, revision: int, number: int) -> bool:
        """Send the pictures of a job; False if the state changes before the last one."""
        state, late = self._state, list[ViewPicture]()
        self._is_exact_underway = job.rung != DRAGGING
        async with aclosing(self._renderer.pictures(job, self._watch)) as pictures:
            while (picture := await self._answer(anext(pictures, None))) is not None:
                if job.rung != DRAGGING and self._state != state:
                    return False
                if late or self._is_full:
                    late.append(picture)  # sent later, so that the renderer is free for other tabs
                else:
                    await self._post(picture, revision, number)
        self._is_exact_underway = False
        for picture in late:
            await self._room()
            if job.rung != DRAGGING and self._state != state:
                return False
            await self._post(picture, revision, number)
        return True

    async def _post(self, picture: ViewPicture, revision: int, number: int) -> None:
        self._unseen.append((revision, picture.rung))
        if picture.small:
            self.small = revision, picture.small
        await self._send(picture.packed(revision, number))
        if picture.about is not None:
            await self.tell(about=picture.about | {"revision": revision, "is_whole": number != NO_NUMBER})

    async def _ask(self, purpose: str) -> None:
        """Answer a question about a pixel; if the state changes meanwhile, it is asked again."""
        x, y, report = asked = self._asked.pop(purpose)
        stops = self._stops
        self._is_exact_underway = True
        scene, index = self._at_rest(self._session.scene)
        try:
            question = Question(scene, index, x, y, self._eye, purpose == MEASURE, purpose == OVERVIEW)
            await report(await self._answer(self._renderer.inspect(question, self._watch)))
        except CanceledError:
            if self._stops == stops:
                self._asked.setdefault(purpose, asked)
        except ClscoError as error:
            await self.tell(error=[str(error)])
        finally:
            self._is_exact_underway = False
