"""Launches in pieces: the bits of a whole one, none of them long, and an end between any two of them."""

from __future__ import annotations

import gc
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pyopencl as cl
import pytest

import clsco
from clsco.errors import CanceledError
from clsco.opencl import pace
from clsco.opencl.buffers import filled_with
from clsco.opencl.program import launch
from clsco.opencl.session import session_for
from tests.slow import mostly_slow

WIDE: dict[str, Any] = {
    "camera": {
        "focal_length": 35.0, "f_number": 0.9, "focus_distance": 1000.0, "pixel_pitch": 0.01, "resolution": (640, 480),
    },
    "object": [
        {"shape": "rectangle", "center": (-60.0, 0.0, 1000.0), "size": (120.0, 150.0), "texture": "bricks"},
        {"shape": "sphere", "center": (50.0, 10.0, 700.0), "radius": 40.0, "texture": "checkerboard"},
        {"shape": "plane", "distance": 6000.0, "texture": "siemens_star"},
    ],
}  # fmt: skip
"""R up to 64 px behind what is in focus."""

LONG: dict[str, Any] = WIDE | {"camera": WIDE["camera"] | {"resolution": (2560, 1920)}}
"""Takes a quarter of a minute on two cores."""

SMALL: dict[str, Any] = WIDE | {"camera": WIDE["camera"] | {"resolution": (60, 45), "pixel_pitch": 0.04}}
MOMENT = 2.0  # s of a piece
SOON = 8.0  # s of waiting, on a machine that may have other work to do


def rows(seed: int, *shape: int) -> np.ndarray[Any, Any]:
    return np.random.default_rng(seed).random((40, 300, *shape), dtype=np.float32)


RADII = rows(1) * 2 + np.linspace(0, 12, 300, dtype=np.float32)
HOLES = rows(2) < 0.3
WORKS: dict[str, Callable[[], Any]] = {
    "occluded": lambda: clsco.render_frame(SMALL, truth=()).color,
    "layered": lambda: clsco.render_frame(SMALL | {"psf": {"occlusion": "layered"}}, truth=()).color,
    "discs": lambda: clsco.defocus(rows(0), RADII),
    "Gaussians": lambda: clsco.defocus(rows(0), RADII, "gaussian"),
    "sampled": lambda: clsco.defocus(rows(0, 3), RADII, {"edge": "sampled"}),
    "general": lambda: clsco.render_frame(SMALL | {"aperture": {"shape": "polygon"}}, truth=()).color,
    "one radius": lambda: clsco.defocus(rows(0), np.full_like(RADII, 5.0)),
    "scatter": lambda: clsco.defocus(rows(0), RADII, method="scatter"),
    "tiles": lambda: clsco.defocus(rows(0), RADII, method="tiles"),
    "texture": lambda: clsco.inpaint(rows(0), HOLES, method="texture"),
    "biharmonic": lambda: clsco.inpaint(rows(0), HOLES, method="biharmonic"),
    "mean-median": lambda: clsco.inpaint(rows(0), HOLES, method="mean-median"),
}


def recorded(patch: pytest.MonkeyPatch) -> list[float]:
    """Gets the time of every piece, s."""
    found: list[float] = []
    resized = pace.next_size

    def noted(size: int, seconds: float) -> int:
        found.append(seconds)
        return resized(size, seconds)

    patch.setattr(pace, "next_size", noted)
    return found


@pytest.fixture
def counted(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Record the time of every piece; all but the smallest launches are cut."""
    monkeypatch.setattr(pace, "PIECE", 2e-5)
    return recorded(monkeypatch)


@pytest.mark.parametrize("name", mostly_slow(WORKS, ["discs", "mean-median"]))
def test_pieces_have_the_bits_of_the_whole(name: str, counted: list[float], monkeypatch: pytest.MonkeyPatch) -> None:
    WORKS[name]()  # before, nothing is known of the time of a launch
    found = WORKS[name]()
    assert len(counted) > 4
    monkeypatch.undo()
    assert (found == WORKS[name]()).all()


@contextmanager
def interrupted(after: float) -> Iterator[list[float]]:
    """SIGINT after so many seconds; gives when it came, and checks that KeyboardInterrupt does soon after.

    The collector rests meanwhile: hypothesis times it by a callback, and what is raised there is lost.
    """
    came: list[float] = []

    def interrupt() -> None:
        came.append(time.perf_counter())
        os.kill(os.getpid(), signal.SIGINT)

    timer = threading.Timer(after, interrupt)
    given = signal.signal(signal.SIGINT, signal.default_int_handler)  # shells ignore it behind an &
    gc.disable()
    timer.start()
    try:
        with pytest.raises(KeyboardInterrupt):
            yield came
        assert time.perf_counter() - came[0] < SOON
    finally:
        gc.enable()
        timer.cancel()
        timer.join()
        signal.signal(signal.SIGINT, given)


@pytest.fixture(scope="module")
def warm() -> None:
    """Kernels are compiled to their end, whatever comes meanwhile."""
    part = LONG | {"camera": LONG["camera"] | {"resolution": (160, 120)}}  # as wide a blur has the same kernels
    clsco.render_frame(part, truth=())
    with clsco.Live() as live:
        live.render(part, truth=())


@pytest.mark.usefixtures("warm")
@pytest.mark.parametrize("after", mostly_slow([0.3, 1.0, 2.5], [1.0]))
def test_a_frame_of_a_minute_ends_with_ctrl_c_and_the_next_one_has_its_bits(after: float) -> None:
    expected = clsco.render_frame(SMALL).color
    with interrupted(after):
        clsco.render_frame(LONG, truth=())
    assert (clsco.render_frame(SMALL).color == expected).all()


@pytest.mark.slow
@pytest.mark.usefixtures("warm")
def test_other_long_calls_end_with_ctrl_c() -> None:
    image, radii = np.ones((2000, 3000, 3), np.float32), np.full((2000, 3000), 60.0, np.float32)
    radii[::2] = 50.0
    with interrupted(1.0):
        clsco.defocus(image, radii, "gaussian")
    with interrupted(1.0):
        clsco.inpaint(image[..., 0], np.tile(HOLES, (50, 10)), method="texture")
    with interrupted(1.0):
        next(clsco.reference.render(clsco.parse_scene(LONG)))
    with interrupted(1.0), clsco.Live() as live:
        live.render(LONG, truth=())


@pytest.mark.processor  # a card ends the frame before
@pytest.mark.usefixtures("warm")
def test_a_cancel_ends_a_launch_that_is_under_way() -> None:
    with clsco.Live() as live:
        expected = live.render(SMALL, truth=()).color
        timer = threading.Timer(1.0, live.cancel)
        began = time.perf_counter()
        timer.start()
        with pytest.raises(CanceledError):
            live.render(LONG, truth=())
        assert time.perf_counter() - began < 1.0 + SOON
        assert (live.render(SMALL, truth=()).color == expected).all()


@pytest.mark.processor
def test_no_piece_of_a_heavy_frame_is_long() -> None:
    """Time by the processor's clock of the device, whatever else the machine does: a few pieces may be slower."""
    for stop in (2.0, 0.9):  # the second where many cores are soon done with the first
        heavy = WIDE | {"camera": WIDE["camera"] | {"f_number": stop}}
        with pytest.MonkeyPatch.context() as patch:
            sizes = recorded(patch)
            clsco.render_frame(heavy, truth=())
        if len(sizes) > 5:
            break
    assert len(sizes) > 5
    assert np.median(sizes) < 0.2
    assert max(sizes) < MOMENT


SPIN = """
__kernel void spin(const int count, __global float *out)
{
    const int i = get_global_id(0);
    float sum = i;
    for (int k = 0; k < count; ++k)
        sum = sqrt(sum + k);
    out[i] += sum;
}
"""


@pytest.mark.processor  # these launches take a card no time
def test_the_host_stays_a_moment_ahead_of_the_device_and_what_is_short_is_not_waited_for() -> None:
    session = session_for(None)
    run = cl.Program(session.context, SPIN).build().all_kernels()[0]
    out = filled_with(session, 4 * 4096)
    assert {len(launch(session, run, (4096,), (64,), np.int32(10), out)) for _ in range(20)} == {1}
    events = launch(session, run, (4096,), (64,), np.int32(1000), out)  # expected to be as short
    events[-1].wait()
    for _ in range(100):
        events += launch(session, run, (4096,), (64,), np.int32(1000), out)
    assert sum(event.command_execution_status > 0 for event in events) < len(events) / 2
    session.queue.finish()
