"""The renderers' processes: their pictures are those of `clsco.render`, and their end is no end of the studio."""

from __future__ import annotations

import asyncio
import io
import os
import re
import signal
from collections.abc import AsyncIterator
from contextlib import closing, suppress
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

import clsco
from clsco import Scene, parse_scene
from clsco.errors import CanceledError, DeviceError, SceneError
from clsco.files.transfer import encode
from clsco.optics.motion import Eye
from clsco.studio import renderer as renderer_module
from clsco.studio.inspector import figures_of
from clsco.studio.pictures import (
    DRAGGING,
    EXACT,
    FLOAT32,
    HEADER,
    JPEG,
    LOSSY,
    MESSAGE,
    PNG,
    UNBLURRED,
    VIEWS,
    ViewPicture,
)
from clsco.studio.preview import Preview
from clsco.studio.renderer import PictureJob, Question, RendererEndedError, RendererProcess, RenderProgress
from clsco.studio.renderers import Renderers
from tests.studio.test_preview import Browser, Session


def small() -> Scene:
    return parse_scene({
        "camera": {"resolution": [48, 40], "focus_distance": 262.0, "pixel_pitch": 0.1},
        "object": [{"shape": "sphere", "radius": 30.0, "center": [0.0, 0.0, 280.0], "texture": "checkerboard"}],
    })  # fmt: skip


def several() -> Scene:
    """Objects that move before one another, out of focus: what is the same without blur takes the least of the time."""
    ball = {"shape": "sphere", "radius": 12.0, "texture": "checkerboard"}
    return parse_scene({
        "camera": {"resolution": [48, 40], "focus_distance": 400.0, "pixel_pitch": 0.1},
        "object": [
            {"shape": "plane", "distance": 500.0, "slope_x": 0.3, "motion": {"velocity": [5.0, 0.0, 0.0]}},
            ball | {"center": [0.0, 0.0, 280.0], "motion": {"velocity": [9.0, 4.0, 30.0]}},
            ball | {"center": [9.0, 5.0, 300.0], "motion": {"angular_velocity": [0.0, 20.0, 5.0]}},
        ],
    })  # fmt: skip


class Pipe:
    """Keeps what the process says."""

    def __init__(self) -> None:
        self.said: list[tuple[int, Any]] = []

    def send(self, answer: tuple[int, Any]) -> None:
        self.said.append(answer)


@pytest.mark.parametrize("error", [MemoryError(), DeviceError("device: must go on; got -4", short_of_memory=True)])
def test_a_want_of_memory_is_told_with_the_number(error: Exception, monkeypatch: pytest.MonkeyPatch) -> None:
    pipe = Pipe()
    worker = renderer_module._RenderWorker(pipe, "pocl")  # type: ignore[arg-type]

    def short(*_: Any) -> None:
        raise error

    monkeypatch.setattr(worker, "_frame", short)
    worker.answer("render", 3, PictureJob(small(), 0, "color", EXACT))
    ((number, said),) = pipe.said
    assert number == 3
    rule = r"memory: must be about \d+ MiB for this frame, beside its arrays; got \d+ MiB"
    assert re.fullmatch(rule, said.messages[0])


async def all_of(pictures: AsyncIterator[ViewPicture]) -> list[ViewPicture]:
    return [picture async for picture in pictures]


def test_the_renderer_from_its_start_to_its_crash() -> None:
    async def run() -> None:
        with closing(RendererProcess("pocl")) as renderer:
            for part in (rungs, views, eyes, pixels, faults, progress, previews, crash):
                await part(renderer)

    asyncio.run(run())


async def rungs(renderer: RendererProcess) -> None:
    scene = small()
    (coarse,) = await all_of(renderer.pictures(PictureJob(scene, 0, "color", DRAGGING)))
    assert (coarse.rung, coarse.encoding, coarse.full) == (DRAGGING, JPEG, (48, 40))
    lossy, exact = await all_of(renderer.pictures(PictureJob(scene, 0, "color", EXACT)))
    assert (lossy.rung, lossy.encoding, lossy.size) == (LOSSY, JPEG, (48, 40))
    assert (exact.rung, exact.encoding, exact.size) == (EXACT, PNG, (48, 40))
    assert np.array_equal(np.asarray(Image.open(io.BytesIO(exact.payload))), codes(scene))


def codes(scene: Scene) -> NDArray[Any]:
    (frame,) = clsco.render(scene, truth=(), device="pocl")
    return encode(frame.color, min(frame.metadata["bits"], 16), "srgb")


async def views(renderer: RendererProcess) -> None:
    for scene, view in [*((small(), view) for view in VIEWS), *((several(), view) for view in UNBLURRED)]:
        if view in ("color", "sharp"):
            continue
        scene = scene.replace("sensor", {}) if view in ("raw", "noise") else scene
        (frame,) = clsco.render(scene, device="pocl")
        (exact,) = await all_of(renderer.pictures(PictureJob(scene, 0, view, EXACT)))
        expected = np.asarray(getattr(frame, VIEWS[view]), np.float32)
        if view == "blur radius" and frame.mask is not None:  # which files have as 0 where nothing is
            assert not expected[~frame.mask].any()
            expected[~frame.mask] = np.nan
        assert (exact.encoding, exact.size) == (FLOAT32, (48, 40))
        assert np.array_equal(np.frombuffer(exact.payload, "<f4").reshape(expected.shape), expected, equal_nan=True)


async def eyes(renderer: RendererProcess) -> None:
    scene = small().replace("stereo", {"baseline": 6.0})
    frames = {frame.eye: frame for frame in clsco.render(scene, truth=(), device="pocl")}
    shown = []
    for eye in get_args(Eye):
        _, exact = await all_of(renderer.pictures(PictureJob(scene, 0, "color", EXACT, eye)))
        shown.append(np.asarray(Image.open(io.BytesIO(exact.payload))))
        frame = frames[eye]
        assert np.array_equal(shown[-1], encode(frame.color, min(frame.metadata["bits"], 16), "srgb"))
        assert exact.packed(3, 0)[15] == (2 if eye == "right" else 0)
    assert not np.array_equal(shown[0], shown[1])


async def pixels(renderer: RendererProcess) -> None:
    scene = small()
    (frame,) = clsco.render(scene, device="pocl")
    found = await renderer.inspect(Question(scene, 0, 20, 15))
    assert found["values"]["depth"] == float(frame.depth[15, 20])  # type: ignore[index]
    assert found["seconds"] > 0.0
    measured = await renderer.inspect(Question(scene, 0, 20, 15, measures=True))
    expected = figures_of(clsco.response(scene, 20, 15, device="pocl"), 20, 15)
    assert measured == {"x": 20, "y": 15, "response": expected}
    beside = await renderer.inspect(Question(scene, 0, 99, 99, measures=True))
    assert beside == {"x": 47, "y": 39, "unmeasured": "no surface"}
    other = await renderer.inspect(Question(scene.replace("object.0.center", [0.0, 0.0, 290.0]), 0, 20, 15))
    assert other["values"]["depth"] > found["values"]["depth"]


async def faults(renderer: RendererProcess) -> None:
    wrong = small().replace("object.0.texture", "/no/such/file.png")
    with pytest.raises(SceneError, match="texture"):
        await all_of(renderer.pictures(PictureJob(wrong, 0, "color", EXACT)))
    large = small().replace("camera.resolution", [2048, 2048])
    waiting = asyncio.ensure_future(all_of(renderer.pictures(PictureJob(large, 0, "color", EXACT))))
    await asyncio.sleep(0.1)
    renderer.cancel()
    with pytest.raises(CanceledError):
        await waiting


async def progress(renderer: RendererProcess) -> None:
    said: list[RenderProgress] = []

    async def watch(found: RenderProgress) -> None:
        said.append(found)

    long = small().replace("object.0.motion.velocity", [2.0, 0.0, 0.0]).replace("sequence.samples", 4000)
    job = PictureJob(long.replace("camera.resolution", [256, 256]), 0, "color", EXACT)
    first = asyncio.ensure_future(all_of(renderer.pictures(job, watch)))
    await asyncio.sleep(0)
    second = asyncio.ensure_future(all_of(renderer.pictures(PictureJob(small(), 0, "color", DRAGGING), watch)))
    while not any(found.done for found in said):
        assert not first.done()
        await asyncio.sleep(0.05)
    renderer.cancel()
    with pytest.raises(CanceledError):
        await first
    assert len(await second) == 1
    counts = [found.done for found in said if found.total == 4000]
    assert counts == sorted(counts)
    assert "another tab" in [found.doing for found in said]


async def previews(renderer: RendererProcess) -> None:
    session, pictures = Session(), list[bytes]()
    session.scene = small()
    browser = Browser()

    async def send(data: bytes) -> None:
        if HEADER.unpack_from(data)[5] != MESSAGE:
            pictures.append(data)
        await browser.send(data)

    browser.preview = preview = Preview(session, renderer, send)
    running = asyncio.create_task(preview.run())
    for _ in range(20):
        session.step()
        preview.changed()
        await asyncio.sleep(0.01)
    for _ in range(200):
        await asyncio.sleep(0.02)
        if browser.got and browser.got[-1] == (20, EXACT):
            break
    running.cancel()
    with suppress(asyncio.CancelledError):
        await running
    revisions = [revision for revision, _ in browser.got]
    assert revisions == sorted(revisions)
    assert browser.got[-1] == (20, EXACT)
    assert np.array_equal(np.asarray(Image.open(io.BytesIO(pictures[-1][HEADER.size :]))), codes(session.scene))


async def crash(renderer: RendererProcess) -> None:
    before = renderer.pid
    assert before is not None
    large = small().replace("camera.resolution", [1024, 1024])
    waiting = asyncio.ensure_future(all_of(renderer.pictures(PictureJob(large, 0, "color", EXACT))))
    await asyncio.sleep(0.05)
    os.kill(before, signal.SIGKILL)
    with pytest.raises(RendererEndedError, match="signal 9"):
        await waiting
    _, exact = await all_of(renderer.pictures(PictureJob(small(), 0, "color", EXACT)))
    assert renderer.pid != before
    assert np.array_equal(np.asarray(Image.open(io.BytesIO(exact.payload))), codes(small()))


def test_a_process_that_is_stopped_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    async def play() -> None:
        renderer = RendererProcess("pocl")
        try:
            _, exact = await all_of(renderer.pictures(PictureJob(small(), 0, "color", EXACT)))
            before = renderer.pid
            assert before is not None
            os.kill(before, signal.SIGSTOP)
            monkeypatch.setattr(renderer_module, "SILENCE", 0.5)
            with pytest.raises(RendererEndedError, match="must say something within"):
                await all_of(renderer.pictures(PictureJob(small(), 0, "color", EXACT)))
            monkeypatch.undo()
            _, again = await all_of(renderer.pictures(PictureJob(small(), 0, "color", EXACT)))
            assert again.payload == exact.payload
            assert renderer.pid != before
            assert not Path(f"/proc/{before}").exists()
            assert renderer.pid is not None
            os.kill(renderer.pid, signal.SIGSTOP)
        finally:
            renderer.close()  # and does not wait for ever

    asyncio.run(play())


def test_previews_come_while_a_frame_is_rendered() -> None:
    async def run() -> None:
        renderers = Renderers("pocl")
        try:
            await all_of(renderers.pictures(PictureJob(several(), 0, "color", EXACT)))
            await renderers.warm(several())
            assert renderers._rehearsal is not None
            await renderers._rehearsal
            long = several().replace("sequence.samples", 4000).replace("camera.resolution", [512, 512])
            exact = asyncio.ensure_future(all_of(renderers.pictures(PictureJob(long, 0, "color", EXACT))))
            await asyncio.sleep(0.2)
            (coarse,) = await all_of(renderers.pictures(PictureJob(several(), 0, "color", DRAGGING)))
            assert (coarse.rung, coarse.full) == (DRAGGING, (48, 40))
            assert not exact.done()
            exact.cancel()
            (other,) = await all_of(renderers.pictures(PictureJob(small(), 0, "color", DRAGGING)))  # by the first
            assert other.full == (48, 40)
        finally:
            renderers.close()

    asyncio.run(run())


def test_every_kind_is_rehearsed_the_latest_first(monkeypatch: pytest.MonkeyPatch) -> None:
    done: list[tuple[str, int]] = []

    async def rehearse(job: PictureJob) -> None:
        await asyncio.sleep(0)
        done.append(("rehearsed", len(job.scene.objects)))

    async def warm(scene: Scene) -> None:
        done.append(("warmed", len(scene.objects)))

    async def run() -> None:
        renderers = Renderers("pocl")
        monkeypatch.setattr(renderers._quick, "rehearse", rehearse)
        monkeypatch.setattr(renderers._main, "warm", warm)
        one, two = small(), several()
        three = two.model_copy(update={"objects": (*two.objects, one.objects[0])})
        for scene in (one, two, three):
            await renderers.warm(scene)
        assert renderers._rehearsal is not None
        await renderers._rehearsal

    asyncio.run(run())
    counts = [len(several().objects) + 1, len(several().objects), 1]
    assert done == [(what, count) for count in counts for what in ("rehearsed", "warmed")]
