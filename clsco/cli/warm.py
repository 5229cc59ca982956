"""Implementation of `clsco devices --warm`: compiles the kernels of usual scenes, images and masks ahead of time."""

from __future__ import annotations

from itertools import product

import numpy as np

from clsco.engine.defocus import defocus
from clsco.engine.inpaint import inpaint
from clsco.engine.warm import run_plausible_plans
from clsco.frame.outputs import ALL_TRUTH
from clsco.opencl.session import session_for
from clsco.plan.prepare import prepare
from clsco.plan.request import Request
from clsco.scene.examples import EXAMPLES, example

SIDE = 32  # px, of images
RADIUS = 9.0  # px: more than the smallest discs reach


def compile_usual_kernels(device: str | None) -> tuple[int, int]:
    """Render small frames of usual scenes, so that their kernels are compiled and cached.

    device: as for `clsco.render`. Returns the number of scenes and images, and of programs compiled. Raises DeviceError
    if there is no such device.
    """
    session, count = session_for(device), 0
    precisions = ("double", "single") if session.device.has_fp64 else ("single",)
    for name, precision in product(EXAMPLES, precisions):
        request = Request(ALL_TRUTH, precision=precision)
        count += run_plausible_plans(session, prepare(example(name), request, session.device))
    radii = np.linspace(-RADIUS, RADIUS, SIDE * SIDE).reshape(SIDE, SIDE)
    one_radius = np.full_like(radii, RADIUS)
    hole = np.zeros((SIDE, SIDE), np.bool_)
    hole[10:14, 8:20] = True
    for channels in ((), (3,)):
        image = np.random.default_rng(1).random((SIDE, SIDE, *channels), dtype=np.float32)
        for model, occlusion, radius in product(("pillbox", "gaussian"), ("layered", "none"), (radii, one_radius)):
            defocus(image, radius, {"model": model, "occlusion": occlusion}, device=device)
            count += 1
        for method in ("mean-median", "biharmonic", "texture"):
            inpaint(image, hole, method=method, device=device)
            count += 1
    return count, len(session.programs)
