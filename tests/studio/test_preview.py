"""Previews with a renderer that the tests command: which pictures are made, and which are never sent."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncGenerator, Callable, Coroutine
from contextlib import aclosing, suppress
from dataclasses import dataclass, field
from typing import Any

from clsco import Scene, parse_scene
from clsco.errors import CanceledError, ClscoError, SceneError
from clsco.studio.pictures import DRAGGING, EXACT, HEADER, LOSSY, MESSAGE, PINNED, STACKED, ViewPicture
from clsco.studio.preview import MEASURE, MOST_UNSEEN, REST, Preview
from clsco.studio.renderer import PictureJob, Question, RendererEndedError, RenderProgress, Watch
from tests.studio import fast_forward


class Session:
    """A scene whose focus is dragged."""

    def __init__(self) -> None:
        self.scene, self.revision = scene(), 0

    def step(self) -> None:
        self.revision += 1
        self.scene = self.scene.replace("camera.focus_distance", 250.0 + self.revision)


def scene(**camera: Any) -> Scene:
    return parse_scene({"camera": {"resolution": [64, 48], **camera}, "object": [{"shape": "sphere"}]})


@dataclass
class Renderer:
    """Takes `seconds` for a picture, and notes what it was asked for."""

    seconds: float = 0.001
    jobs: list[PictureJob] = field(default_factory=list)
    canceled: int = 0
    faults: list[ClscoError] = field(default_factory=list)
    questions: list[Question] = field(default_factory=list)
    warmed: list[Scene] = field(default_factory=list)

    async def pictures(self, job: PictureJob, watch: Watch | None = None) -> AsyncGenerator[ViewPicture, None]:
        self.jobs.append(job)
        for rung in (LOSSY, EXACT) if job.rung == EXACT else (job.rung,):
            count = self.canceled
            if watch is not None and self.seconds > 0.1:
                await watch(RenderProgress("blur", 1, 60, 0.0))
            await asyncio.sleep(self.seconds)
            if self.faults:
                raise self.faults.pop(0)
            if self.canceled > count:
                raise CanceledError("canceled")
            yield ViewPicture(rung, job.view, (64, 48), (64, 48), 1, b"", self.seconds)

    async def inspect(self, question: Question, watch: Watch | None = None) -> dict[str, Any]:
        self.questions.append(question)
        await asyncio.sleep(self.seconds)
        if self.faults:
            raise self.faults.pop(0)
        return {"at": [question.x, question.y]}

    async def warm(self, scene: Scene) -> None:
        self.warmed.append(scene)

    def cancel(self) -> None:
        self.canceled += 1


@dataclass
class Browser:
    """Gets pictures, and acknowledges those it has painted unless it is slow."""

    is_slow: bool = False
    got: list[tuple[int, int]] = field(default_factory=list)
    said: list[dict[str, Any]] = field(default_factory=list)
    preview: Preview | None = None

    async def send(self, data: bytes) -> None:
        revision, rung, _, _, _, encoding, *_ = HEADER.unpack_from(data)
        if encoding == MESSAGE:
            self.said.append(json.loads(data[HEADER.size :]))
            return
        self.got.append((revision, rung))
        if not self.is_slow:
            asyncio.get_running_loop().call_later(0.001, self.seen, revision, rung)

    def seen(self, revision: int, rung: int) -> None:
        assert self.preview is not None
        self.preview.acknowledge(revision, rung)


Play = Callable[[Session, Renderer, Browser, Preview], Coroutine[Any, Any, None]]


def played(play: Play, **renderer: Any) -> tuple[Session, Renderer, Browser]:
    """A session that somebody works with."""

    async def run() -> tuple[Session, Renderer, Browser]:
        session, renders, browser = Session(), Renderer(**renderer), Browser()
        browser.preview = preview = Preview(session, renders, browser.send)
        running = asyncio.create_task(preview.run())
        await play(session, renders, browser, preview)
        running.cancel()
        with suppress(asyncio.CancelledError):
            await running
        return session, renders, browser

    return fast_forward.run(run())


async def rests(session: Session, renders: Renderer, browser: Browser, preview: Preview) -> None:
    await asyncio.sleep(3 * REST)


class Answers(list[dict[str, Any]]):
    """Reports of pixels."""

    async def add(self, answer: dict[str, Any]) -> None:
        self.append(answer)


def test_a_scene_at_rest_is_shown_once_by_each_rung() -> None:
    _, renders, browser = played(rests)
    assert browser.got == [(0, DRAGGING), (0, LOSSY), (0, EXACT)]
    assert [job.rung for job in renders.jobs] == [DRAGGING, EXACT]
    assert len(renders.warmed) == 1  # afterwards


def test_a_click_before_the_first_picture_is_answered_before_programs_for_later() -> None:
    warmed: list[int] = []

    async def play(session: Session, renders: Renderer, browser: Browser, preview: Preview) -> None:
        async def focus(answer: dict[str, Any]) -> None:
            warmed.append(len(renders.warmed))

        preview.inspect(1, 2, focus, "focus")
        await rests(session, renders, browser, preview)

    played(play)
    assert warmed == [0]


def test_of_many_changes_the_latest_is_shown_and_none_after_it() -> None:
    async def play(session: Session, renders: Renderer, browser: Browser, preview: Preview) -> None:
        for _ in range(60):
            session.step()
            preview.changed()
            await asyncio.sleep(0.002)
        await asyncio.sleep(0.3)

    session, renders, browser = played(play, seconds=0.01)
    revisions = [revision for revision, _ in browser.got]
    assert revisions == sorted(revisions)
    assert browser.got[-3:] == [(60, DRAGGING), (60, LOSSY), (60, EXACT)]
    assert 5 < len(renders.jobs) < 30  # of 60 steps those that there was time for
    assert renders.jobs[-1].scene == session.scene


def test_the_exact_frame_waits_for_rest_and_ends_with_a_change() -> None:
    async def play(session: Session, renders: Renderer, browser: Browser, preview: Preview) -> None:
        await asyncio.sleep(0.01)
        assert [job.rung for job in renders.jobs] == [DRAGGING]
        preview.changed()  # while the first picture is made
        await asyncio.sleep(REST - 0.03)
        assert [job.rung for job in renders.jobs] == [DRAGGING, DRAGGING]
        await asyncio.sleep(0.06)
        assert [job.rung for job in renders.jobs] == [DRAGGING, DRAGGING, EXACT]
        session.step()
        preview.changed()
        await asyncio.sleep(0.4)

    _, renders, browser = played(play, seconds=0.05)
    assert renders.canceled == 1
    assert browser.got == [(0, DRAGGING), (0, DRAGGING), (1, DRAGGING), (1, LOSSY), (1, EXACT)]


def test_nothing_piles_up_before_a_slow_browser() -> None:
    async def play(session: Session, renders: Renderer, browser: Browser, preview: Preview) -> None:
        browser.is_slow = True
        for _ in range(40):
            session.step()
            preview.changed()
            await asyncio.sleep(0.004)
        assert len(browser.got) == MOST_UNSEEN
        assert len(renders.jobs) == MOST_UNSEEN  # nor is anything rendered in vain
        browser.is_slow = False
        for picture in list(browser.got):
            preview.acknowledge(*picture)
        await asyncio.sleep(2 * REST)

    _, _, browser = played(play)
    assert browser.got[MOST_UNSEEN:] == [(40, DRAGGING), (40, LOSSY), (40, EXACT)]


def test_a_browser_that_sees_nothing_leaves_the_renderer_to_others() -> None:
    class InTurns(Renderer):
        """Works for one tab at a time."""

        turn: asyncio.Lock

        async def pictures(self, job: PictureJob, watch: Watch | None = None) -> AsyncGenerator[ViewPicture, None]:
            async with self.turn, aclosing(super().pictures(job, watch)) as found:
                async for picture in found:
                    yield picture

    async def run() -> tuple[Browser, Browser, Browser]:
        renders = InTurns()
        renders.turn = asyncio.Lock()
        slow, hidden, quick = Browser(is_slow=True), Browser(), Browser()
        running = []
        for browser in (slow, hidden, quick):
            session = Session()
            browser.preview = Preview(session, renders, browser.send)
            browser.preview.hide(browser is hidden)
            browser.preview.changed()
            running.append(asyncio.create_task(browser.preview.run()))
        await asyncio.sleep(3 * REST)
        assert hidden.preview is not None
        assert hidden.got == []
        hidden.preview.hide(False)
        await asyncio.sleep(2 * REST)
        for task in running:
            task.cancel()
        await asyncio.gather(*running, return_exceptions=True)
        return slow, hidden, quick

    slow, hidden, quick = fast_forward.run(run())
    assert len(slow.got) == MOST_UNSEEN
    assert [rung for _, rung in quick.got] == [DRAGGING, LOSSY, EXACT]
    assert [rung for _, rung in hidden.got] == [DRAGGING, LOSSY, EXACT]


def test_views_and_frames_are_states_of_their_own() -> None:
    async def play(session: Session, renders: Renderer, browser: Browser, preview: Preview) -> None:
        session.scene = session.scene.replace("sequence.frames", 3)
        for view, index in (("depth", 1), ("depth", 1), ("no such view", 7), ("color", None)):
            preview.look(view, index)
            await asyncio.sleep(0.02)

    _, renders, _ = played(play)
    assert [(job.view, job.index) for job in renders.jobs] == [("depth", 1), ("depth", 2), ("color", 2)]


def test_pixels_are_told_of_when_the_exact_frame_is_there() -> None:
    found: list[dict[str, Any]] = []

    async def play(session: Session, renders: Renderer, browser: Browser, preview: Preview) -> None:
        async def told(answer: dict[str, Any]) -> None:
            assert browser.got[-1] == (0, EXACT)
            found.append(answer)

        for x in range(5):
            preview.inspect(x, 2, told)
        await asyncio.sleep(2 * REST)

    _, renders, _ = played(play)
    assert found == [{"at": [4, 2]}]  # the latest
    assert [(question.x, question.index) for question in renders.questions] == [(4, 0)]


def test_a_response_is_measured_after_all_else_and_again_after_a_change() -> None:
    found = Answers()

    async def play(session: Session, renders: Renderer, browser: Browser, preview: Preview) -> None:
        await asyncio.sleep(2 * REST)
        renders.seconds = 0.05
        preview.inspect(3, 2, found.add, MEASURE)
        await asyncio.sleep(0.02)
        session.step()
        preview.changed()
        renders.faults = [CanceledError("canceled")]
        await asyncio.sleep(4 * REST)

    _, renders, browser = played(play)
    assert [question.measures for question in renders.questions] == [True, True]
    assert renders.canceled == 1
    assert found == [{"at": [3, 2]}]
    assert browser.got[-1] == (1, EXACT)


def test_another_scene_is_pinned_once() -> None:
    async def play(session: Session, renders: Renderer, browser: Browser, preview: Preview) -> None:
        preview.pin(session.scene.replace("psf.model", "gaussian"))
        await asyncio.sleep(2 * REST)

    _, renders, browser = played(play)
    assert browser.got == [(0, DRAGGING), (0, LOSSY), (0, EXACT), (0, PINNED)]
    assert renders.jobs[-1].scene.psf.model == "gaussian"


def test_a_focal_stack_is_whole_although_its_tab_was_hidden_meanwhile() -> None:
    async def play(session: Session, renders: Renderer, browser: Browser, preview: Preview) -> None:
        await asyncio.sleep(2 * REST)
        renders.seconds = 0.05
        preview.stack([session.scene] * 3)
        await asyncio.sleep(0.02)
        preview.hide(True)
        await asyncio.sleep(0.05)
        preview.hide(False)
        await asyncio.sleep(2 * REST + 0.2)

    _, renders, browser = played(play)
    assert renders.canceled == 1
    assert browser.got[3:] == [(0, STACKED)] * 3


def test_what_takes_long_says_how_far_it_is_and_is_left_when_it_is_canceled() -> None:
    async def play(session: Session, renders: Renderer, browser: Browser, preview: Preview) -> None:
        async def told(answer: dict[str, Any]) -> None:
            raise AssertionError(answer)

        await asyncio.sleep(REST + 0.05)
        renders.seconds = 0.3
        await asyncio.sleep(REST)
        assert browser.said[-1] == {"progress": {"doing": "blur", "done": 1, "total": 60, "still": 0.0}}
        preview.inspect(1, 1, told)
        preview.stop()
        await asyncio.sleep(0.5)
        preview.inspect(1, 1, told)  # would take as long
        await asyncio.sleep(0.1)
        assert browser.got == [(0, DRAGGING), (0, LOSSY)]
        renders.seconds = 0.001
        session.step()
        preview.changed()
        await asyncio.sleep(2 * REST)

    _, renders, browser = played(play, seconds=0.1)
    assert renders.canceled == 1
    assert browser.got == [(0, DRAGGING), (0, LOSSY), (1, DRAGGING), (1, LOSSY), (1, EXACT)]


def test_a_cancel_of_nothing_changes_nothing() -> None:
    found = Answers()

    async def play(session: Session, renders: Renderer, browser: Browser, preview: Preview) -> None:
        await asyncio.sleep(2 * REST)
        preview.stop()
        preview.inspect(1, 1, found.add)
        await asyncio.sleep(0.05)
        renders.seconds = 0.2
        preview.inspect(2, 2, found.add)
        await asyncio.sleep(0.05)
        renders.faults = [CanceledError("canceled")]
        preview.stop()
        await asyncio.sleep(0.3)
        renders.seconds = 0.001
        preview.inspect(3, 3, found.add)
        await asyncio.sleep(0.05)

    _, renders, _ = played(play)
    assert found == [{"at": [1, 1]}, {"at": [3, 3]}]
    assert renders.canceled == 1


def test_a_fault_of_the_scene_is_told_once() -> None:
    _, renders, browser = played(rests, faults=[SceneError("scene: must fit; got none")])
    assert browser.said == [{"error": ["scene: must fit; got none"]}]
    assert len(renders.jobs) == 1


def test_a_renderer_that_ends_is_asked_again_but_not_for_ever() -> None:
    _, renders, browser = played(rests, faults=[RendererEndedError("ended")])
    assert browser.said == [{"error": ["ended"]}]
    assert browser.got[-1] == (0, EXACT)
    _, renders, browser = played(rests, faults=[RendererEndedError("ended") for _ in range(9)])
    assert len(renders.jobs) == 3
