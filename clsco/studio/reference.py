"""Frames by the NumPy reference, to compare with: slow, so in a process of its own that nobody waits for."""

from __future__ import annotations

import asyncio
import os
import time
from collections.abc import Callable, Coroutine
from dataclasses import replace
from multiprocessing.connection import Connection
from typing import Any

from clsco.engine.child import Child
from clsco.errors import ClscoError, SceneError
from clsco.resources import machine_bytes
from clsco.scene.formatting import format_seconds
from clsco.scene.model import Scene
from clsco.studio.pictures import REFERENCE, ViewPicture, picture_of
from clsco.studio.renderer import PictureJob, RendererEndedError

MOST_SECONDS = 600.0
PROBE = 32  # px, sides of the frame whose time is measured to predict that of the whole
BYTES = 1100  # per pixel of frame and apron
OF_MAPS = 15e-6  # s per pixel and time sample of a scene with depth maps, which cannot be cut
NICE = 10  # the preview comes first


async def reference_picture(job: PictureJob, predicted: Callable[[float], Coroutine[Any, Any, None]]) -> ViewPicture:
    """The picture of a job by the reference; canceling the task ends its process.

    Parameters
    ----------
    job : PictureJob
        Job of any rung.
    predicted : coroutine function of float
        Is given about how many seconds it will take.

    Raises
    ------
    SceneError
        It would take longer than MOST_SECONDS, or too much memory, or as `clsco.reference.render`.
    RendererEndedError
        The process ended before it was done.
    """
    child = Child(_work, job)
    try:
        while True:
            said = await asyncio.to_thread(child.pipe.recv)
            if isinstance(said, ViewPicture):
                return said
            if isinstance(said, ClscoError):
                raise said
            await predicted(said)
    except EOFError:
        raise RendererEndedError("reference: its process must not end by itself; got an end") from None
    finally:
        child.terminate()


def _work(pipe: Connection, job: PictureJob) -> None:
    """The process."""
    from clsco import reference
    from clsco.inputs.textures import load_scene_textures

    if hasattr(os, "nice"):
        os.nice(NICE)
    try:
        check_memory(job.scene)
        seconds = predicted_seconds(job.scene, job.index)
        if seconds > MOST_SECONDS:
            rule = f"must take at most {format_seconds(MOST_SECONDS)}"
            raise SceneError(f"reference: {rule}; got {format_seconds(seconds)} for this scene")
        pipe.send(seconds)
        start = time.perf_counter()
        frames = reference.render(job.scene, frames=(job.index,))
        frame = next(frame for frame in frames if frame.eye in ("", job.eye))
        bits = max(texture.bits for texture in load_scene_textures(job.scene)[1])
        frame = replace(frame, metadata={**frame.metadata, "bits": bits})
        rows, columns = frame.color.shape[:2]
        seconds = time.perf_counter() - start
        pipe.send(picture_of(frame, job.scene, job.view, REFERENCE, (columns, rows), seconds))
    except ClscoError as error:
        pipe.send(error)
    except MemoryError:
        pipe.send(SceneError("reference: must hold the arrays of the scene; got too little memory"))


def check_memory(scene: Scene) -> None:
    """Raise SceneError where half of the free memory is too little for the reference."""
    from clsco.plan.prepare import prepare

    plan, free = prepare(scene).plan, machine_bytes(free=True)
    needed = BYTES * plan.width * plan.height
    if needed > free // 2:
        raise SceneError(f"reference: must fit into {free >> 21} MiB; got about {needed >> 20} MiB for this scene")


def predicted_seconds(scene: Scene, index: int) -> float:
    """About how long the reference takes for a frame, from the middle of its first time sample."""
    from clsco import reference
    from clsco.plan.prepare import prepare

    plan = prepare(scene).plan
    work = plan.width * plan.height * plan.subframes
    if not scene.is_analytic:
        return OF_MAPS * work
    size = min(PROBE, plan.columns), min(PROBE, plan.rows)
    camera = scene.camera.model_copy(update={"resolution": size})
    once = scene.sequence.model_copy(update={"samples": 1})
    small = scene.model_copy(update={"camera": camera, "sequence": once})
    start = time.perf_counter()
    next(reference.render(small, frames=(index,)))
    probe = prepare(small).plan
    return (time.perf_counter() - start) * work / (probe.width * probe.height)
