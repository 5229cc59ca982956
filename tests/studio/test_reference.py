"""The reference in a process of its own: its frame, what is too long for it, and its end."""

from __future__ import annotations

import asyncio
import io
import multiprocessing
import time

import numpy as np
import pytest
from PIL import Image

import clsco
from clsco.errors import SceneError
from clsco.files.transfer import encode
from clsco.scene.model import Scene
from clsco.studio.pictures import EXACT, PNG, REFERENCE, ViewPicture
from clsco.studio.reference import MOST_SECONDS, predicted_seconds, reference_picture
from clsco.studio.renderer import PictureJob
from tests.scenes import scene_from
from tests.studio.test_renderer import small


def referred(scene: Scene) -> tuple[ViewPicture, list[float]]:
    said: list[float] = []

    async def predicted(seconds: float) -> None:
        said.append(seconds)

    return asyncio.run(reference_picture(PictureJob(scene, 0, "color", EXACT), predicted)), said


def test_its_picture_is_that_of_the_reference() -> None:
    picture, said = referred(small())
    exact = next(clsco.reference.render(small()))
    assert (picture.rung, picture.encoding, picture.full) == (REFERENCE, PNG, (48, 40))
    assert np.array_equal(np.asarray(Image.open(io.BytesIO(picture.payload))), encode(exact.color, 8, "srgb"))
    assert len(said) == 1


def test_what_is_too_large_is_refused_with_the_number() -> None:
    long = small().replace("object.0.motion.velocity", [5.0, 0.0, 0.0]).replace("sequence.samples", 4095)
    for scene, message in (
        (
            long.replace("camera.resolution", [512, 512]),
            r"take at most 10 min; got \d+(\.\d)? (min|h|d) for this scene",
        ),
        (small().replace("camera.resolution", [16384, 8192]), r"fit into \d+ MiB; got about \d+ MiB for this scene"),
    ):
        with pytest.raises(SceneError, match=f"reference: must {message}"):
            referred(scene)


def test_the_prediction_counts_pixels_and_time_samples() -> None:
    moving = small().replace("object.0.motion.velocity", [5.0, 0.0, 0.0]).replace("camera.resolution", [480, 400])
    once, often = (predicted_seconds(moving.replace("sequence.samples", samples), 0) for samples in (1, 100))
    assert 10 < often / once < 1000
    depth = {"shape": "depth_map", "depth": np.full((40, 48), 250.0)}
    of_map = scene_from({"camera": {"resolution": [48, 40]}}, depth)
    assert 0.0 < predicted_seconds(of_map, 0) < MOST_SECONDS


def test_a_canceled_task_ends_its_process() -> None:
    async def predicted(seconds: float) -> None: ...

    async def run() -> None:
        long = small().replace("camera.resolution", [1024, 1024])
        task = asyncio.create_task(reference_picture(PictureJob(long, 0, "color", EXACT), predicted))
        await asyncio.sleep(0.2)
        assert len(multiprocessing.active_children()) == 1
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task

    asyncio.run(run())
    end = time.monotonic() + 5.0
    while multiprocessing.active_children():
        assert time.monotonic() < end
        time.sleep(0.01)
