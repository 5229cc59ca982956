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
from clsco.inpainting.rules import MeanMedian
from clsco.opencl.session import Session

THESIS = "mean-median"


@dataclass(frozen=True, eq=False)
class Task:
    """An image (rows, columns, K) of codes or floats with missing pixels (rows, columns), some but not all.

    span: range of the values; constants: options of the mean-median method; progress: called with the fraction done.
    """

    image: NDArray[Any]
    missing: Mask
    span: float
    constants: MeanMedian
    progress: Progress


@dataclass(frozen=True, eq=False)
class Filled:
    """Result of a method: numbers (N,) and values (N, K) of the filled pixels, and the stages of mean-median."""

    pixels: NDArray[np.int64]
    values: NDArray[np.float32]
    stages: Stages | None = None


def _mean_median(session: Session, task: Task) -> Filled:
    stages = fill_mean_median(session, task.image, task.missing, task.span, task.constants, task.progress)
    taken = np.flatnonzero(stages.is_blended)
    pixels = np.concatenate([stages.pixels, stages.border[taken]])
    return Filled(pixels, np.concatenate([stages.smoothed, stages.blended.take(taken, axis=0)]), stages)


def _solver(fill: Callable[..., NDArray[np.float32]]) -> Callable[[Session, Task], Filled]:
    """Make a method from a function that fills an image with a mask."""

    def method(session: Session, task: Task) -> Filled:
        return Filled(np.flatnonzero(task.missing), fill(session, task.image, task.missing, task.progress))

    return method


METHODS: dict[str, Callable[[Session, Task], Filled]] = {
    THESIS: _mean_median,
    "biharmonic": _solver(fill_biharmonic),
    "texture": _solver(fill_texture),
}


def check_method(name: str) -> None:
    """Raise SceneError for an unknown method."""
    if name != "auto" and name not in METHODS:
        raise SceneError(f"method: must be one of auto, {', '.join(METHODS)}; got {name}")


def method_for(session: Session, task: Task, name: str) -> str:
    """The method to use: `name`, or for "auto" the method that is better on known pixels."""
    return choose_method(session, task.image, task.missing) if name == "auto" else name
