"""Two renderers: one for previews during a drag, and one for everything else."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from contextlib import aclosing, suppress
from dataclasses import replace
from typing import Any

from clsco.errors import ClscoError
from clsco.scene.model import Scene
from clsco.studio.pictures import DRAGGING, EXACT, ViewPicture
from clsco.studio.renderer import PictureJob, Question, RendererEndedError, RendererProcess, Watch


class Renderers:
    """Two processes, so that previews are not delayed by other renders or compilations, of this tab or another.

    The preview process starts after the first exact frame, and then reuses the kernels that were compiled for it.
    """

    def __init__(self, device: str | None = None) -> None:
        self._main, self._quick = RendererProcess(device), RendererProcess(device)
        self._rehearsed: set[Any] = set()  # kinds of scenes
        self._cold: dict[Any, Scene] = {}  # scenes to rehearse, by kind
        self._rehearsal: asyncio.Task[None] | None = None
        self._took: dict[Any, float] = {}  # times of exact frames, s, by kind and view

    async def pictures(self, job: PictureJob, watch: Watch | None = None) -> AsyncGenerator[ViewPicture, None]:
        """Pictures of a job, as they are finished; arguments and errors as for `RendererProcess.pictures`."""
        kind = kind_of(job.scene)
        renderer, key = self._main, (kind, job.view)
        if job.rung == DRAGGING:
            is_free = self._rehearsal is None or self._rehearsal.done()
            renderer = self._quick if is_free and kind in self._rehearsed else self._main
            job = replace(job, took=self._took.get(key, 0.0))
        try:
            async with aclosing(renderer.pictures(job, watch)) as pictures:
                async for picture in pictures:
                    if picture.rung == EXACT:
                        self._took[key] = picture.seconds
                    yield picture
        except RendererEndedError:
            if renderer is self._quick:
                self._rehearsed.clear()
            raise

    async def inspect(self, question: Question, watch: Watch | None = None) -> dict[str, Any]:
        """Ask for the figures of a pixel; arguments, result and errors as for `RendererProcess.inspect`."""
        return await self._main.inspect(question, watch)

    async def warm(self, scene: Scene) -> None:
        """Rehearse previews of the scene in the background, then compile the kernels of it and of similar scenes."""
        self._cold[kind_of(scene)] = scene
        if self._rehearsal is None or self._rehearsal.done():
            self._rehearsal = asyncio.create_task(self._rehearse())

    async def _rehearse(self) -> None:
        while self._cold:
            kind, scene = self._cold.popitem()  # the latest one, which is being displayed
            took = self._took.get((kind, "color"), 0.0)
            with suppress(ClscoError):  # pictures report faults of the scene
                await self._quick.rehearse(PictureJob(scene, 0, "color", DRAGGING, took=took))
                self._rehearsed.add(kind)
                await self._main.warm(scene)

    def cancel(self) -> None:
        """Cancel the job of the main process before its next pass; the process for previews goes on."""
        self._main.cancel()

    def close(self) -> None:
        """End the processes."""
        if self._rehearsal is not None:
            self._rehearsal.cancel()
        for renderer in (self._main, self._quick):
            renderer.close()


def kind_of(scene: Scene) -> Any:
    """Key that scenes with the same kernels share."""
    return tuple(item.shape for item in scene.objects), scene.psf.model, scene.aperture.shape, scene.motion.warp
