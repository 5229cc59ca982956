"""What `clsco devices --warm` does: kernels of usual scenes, images and masks compiled ahead, by several processes."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np

from clsco.engine.defocus import defocus
from clsco.engine.inpaint import inpaint
from clsco.engine.warm import run_near
from clsco.errors import DeviceError
from clsco.frame.frame import ALL_TRUTH
from clsco.opencl.pocl_cache import VARIABLE, adopt
from clsco.opencl.session import session_for
from clsco.plan.prepare import prepare
from clsco.plan.request import Request
from clsco.scene.examples import EXAMPLES, example

SIDE = 32  # px, of images
RADIUS = 9.0  # px: more than the smallest discs reach


@dataclass(frozen=True)
class Warmed:
    """What was compiled.

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
    """Compile what usual calls need into PoCL's cache, with a process for each core; on other devices in this process.

    Parameters
    ----------
    device : str, optional
        As for `clsco.render`.
    processes : int, optional

    Returns
    -------
    Warmed

    Raises
    ------
    DeviceError
        There is no such device, or a process ends with an error.
    """
    start, session = time.perf_counter(), session_for(device)
    count = processes or os.cpu_count() or 1
    if not session.device.is_pocl:
        return Warmed(work(device, 0, 1), len(session.programs), time.perf_counter() - start)
    with tempfile.TemporaryDirectory(prefix="clsco-warm-") as base:
        found = [Path(base) / str(k) / "clsco" / "pocl" for k in range(count)]
        for folder in found:
            folder.mkdir(mode=0o700, parents=True)
        running = [
            subprocess.Popen(
                [sys.executable, "-c", f"from clsco.cli.warm import work; print(work({device!r}, {k}, {count}))"],
                env=os.environ | {VARIABLE: str(folder)}, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
            )
            for k, folder in enumerate(found)
        ]  # fmt: skip
        plans = 0
        for process in running:
            out, error = process.communicate()
            if process.returncode:
                last = (error.strip().splitlines() or [f"status {process.returncode}"])[-1]
                raise DeviceError(f"device {session.device}: must compile kernels ahead; got {last}")
            plans += int(out.split()[-1])
        programs = sum(adopt(folder) for folder in found)
    return Warmed(plans, programs, time.perf_counter() - start)


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
