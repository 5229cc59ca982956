"""Inpainting methods by name, and the choice for `auto`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.errors import SceneError
from clsco.inpainting.biharmonic import fill_biharmonic
from clsco.inpainting.choice import choose_method
from clsco.inpainting.fse import fill_texture
from clsco.inpainting.mean_median import Mask, Progress, Stages, fill_mean_median
from clsco.inpainting.rules import MeanMedian, value_span
from clsco.opencl.session import Session

THESIS = "mean-median"
SOLVERS: dict[str, Callable[..., NDArray[np.float32]]] = {"biharmonic": fill_biharmonic, "texture": fill_texture}


@dataclass(frozen=True, eq=False)
class Filled:
    """Numbers (N,) and values (N, K) of the filled pixels, the method used, and results of mean-median's stages."""

    pixels: NDArray[np.int64]
    values: NDArray[np.float32]
    method: str
    stages: Stages | None = None


def check_method(name: str) -> None:
    """Raise SceneError for an unknown method."""
    if name not in ("auto", THESIS, *SOLVERS):
        raise SceneError(f"method: must be one of auto, {', '.join((THESIS, *SOLVERS))}; got {name}")


def fill(
    session: Session, method: str, image: NDArray[Any], missing: Mask, options: MeanMedian, progress: Progress
) -> Filled:
    """Fill the missing pixels of an image (rows, columns, K) of codes or floats.

    method: with "auto", the method that is better on known pixels is used; missing: (rows, columns), some but not all
    True; options: options of the mean-median method; progress: called with the fraction done.
    """
    if method == "auto":
        method = choose_method(session, image, missing)
    if method in SOLVERS:
        return Filled(np.flatnonzero(missing), SOLVERS[method](session, image, missing, progress), method)
    stages = fill_mean_median(session, image, missing, value_span(image, missing), options, progress)
    blended = np.flatnonzero(stages.is_blended)
    pixels = np.concatenate([stages.pixels, stages.border[blended]])
    return Filled(pixels, np.concatenate([stages.smoothed, stages.blended.take(blended, axis=0)]), method, stages)
