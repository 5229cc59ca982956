"""Implementation of `clsco devices --warm`: kernels of usual scenes, images and masks compiled ahead, by several
processes."""

from __future__ import annotations

import shutil
import time
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from multiprocessing.connection import Connection

import numpy as np

from clsco.data.pool import stoppable
from clsco.engine.child import Child, how_ended
from clsco.engine.defocus import defocus
from clsco.engine.inpaint import inpaint
from clsco.engine.warm import run_near
from clsco.errors import DeviceError
from clsco.frame.frame import ALL_TRUTH
from clsco.opencl.pocl_cache import VARIABLE, adopt
from clsco.opencl.session import session_for
from clsco.plan.prepare import prepare
from clsco.plan.request import Request
from clsco.resources import processors, temporary_folder
from clsco.scene.examples import EXAMPLES, example

SIDE = 32  # px, of images
RADIUS = 9.0  # px: more than the smallest discs reach


@dataclass(frozen=True)
class Warmed:
    """Result of compiling ahead.

    Attributes
    ----------
    plans : int
        Scenes and images that were run.
    programs : int
        Compiled programs that the cache did not have.
    seconds : float
    """

    plans: int
    programs: int
    seconds: float


def warm_cache(device: str | None, processes: int | None = None) -> Warmed:
    """Compile what usual calls need into PoCL's cache, with a process for each core that this one may use; on other
    devices in this process.

    Parameters
    ----------
    device : str, optional
        As for `clsco.render`.
    processes : int, optional

    Raises
    ------
    DeviceError
        There is no such device, or a process ends with an error.
    """
    start, session = time.perf_counter(), session_for(device)
    if not session.device.is_pocl:
        return Warmed(work(device, 0, 1), len(session.programs), time.perf_counter() - start)
    with stoppable():
        plans, programs = _together(device, processes or processors())
    return Warmed(plans, programs, time.perf_counter() - start)


def _together(device: str | None, count: int) -> tuple[int, int]:
    """Have processes compile, each into a folder of its own; how many plans and programs there were."""
    base, running = temporary_folder("warm"), list[Child]()
    try:
        folders = [base / str(k) / "clsco" / "pocl" for k in range(count)]
        for k, folder in enumerate(folders):
            folder.mkdir(mode=0o700, parents=True)
            running.append(Child(_work, device, k, count, environ={VARIABLE: str(folder)}))
        plans = sum(map(_answer, running))
        return plans, sum(adopt(folder) for folder in folders)
    finally:
        for child in running:
            child.kill()
            child.end()
        shutil.rmtree(base, ignore_errors=True)


def _answer(child: Child) -> int:
    """Wait for the number of a process, which says why it has none."""
    try:
        got = child.pipe.recv()
    except EOFError:
        got = how_ended(child.end())
    if isinstance(got, str):
        raise DeviceError(f"device: PoCL must compile kernels ahead; got {got}")
    return int(got)


def _work(pipe: Connection, device: str | None, first: int, step: int) -> None:
    """Do a process' part of the work."""
    try:
        pipe.send(work(device, first, step))
    except Exception as error:
        pipe.send(f"{error!r}")


def work(device: str | None, first: int, step: int) -> int:
    """Run one of `step` parts of all calls, so that their kernels are compiled; how many there were."""
    session, count = session_for(device), 0
    for name in list(EXAMPLES)[first::step]:
        scene = example(name)
        for precision in ("double", "single") if session.device.has_fp64 else ("single",):
            request = Request(ALL_TRUTH, precision=precision)
            count += run_near(session, prepare(scene, request, session.device))
    for call in list(_calls())[first::step]:
        _run(call, device)
        count += 1
    return count


def _calls() -> Iterator[tuple[str, int, str]]:
    yield from product(("pillbox", "gaussian", "one radius"), (1, 3), ("layered", "none"))
    yield from product(("mean-median", "biharmonic", "texture"), (1, 3), ("",))


def _run(call: tuple[str, int, str], device: str | None) -> None:
    what, channels, occlusion = call
    shape = (SIDE, SIDE) if channels == 1 else (SIDE, SIDE, channels)
    image = np.random.default_rng(1).random(shape, dtype=np.float32)
    if not occlusion:
        mask = np.zeros((SIDE, SIDE), np.bool_)
        mask[10:14, 8:20] = True
        inpaint(image, mask, method=what, device=device)
        return
    radius = np.linspace(-RADIUS, RADIUS, SIDE * SIDE).reshape(SIDE, SIDE)
    radius = np.full_like(radius, RADIUS) if what == "one radius" else radius
    psf = {"model": "gaussian" if what == "gaussian" else "pillbox", "occlusion": occlusion}
    defocus(image, radius, psf, device=device)
