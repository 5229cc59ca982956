"""Two renderers: previews come while the other one is busy."""

from __future__ import annotations

import asyncio

import pytest

from clsco.scene.model import Scene
from clsco.studio.pictures import DRAGGING, EXACT
from clsco.studio.renderer import PictureJob
from clsco.studio.renderers import Renderers
from tests.studio.test_renderer import all_of, several, small


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
