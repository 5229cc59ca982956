"""Common parts of the benchmarks of errors: a traced picture with its noise per pixel, errors in dB, files of
figures."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.truth.problem import Textures
from benchmarks.truth.raytracer import trace_converged

Array = NDArray[np.float64]


def trace_twice(scene: Any, textures: Textures, size: int, noise: float, cache: Path | None) -> tuple[Array, Array]:
    """Trace the first frame of a scene, size x size px, to the RMS `noise`.

    Two independent pictures; returns their mean and half their difference, (size, size[, channels]) each: the RMS
    of the latter over any set of pixels is the noise of the former there. Arguments otherwise as `trace_converged`.
    """
    pair = [trace_converged(scene, textures, size, size, noise * 2**0.5, seed, cache=cache)[0] for seed in (0, 1)]
    return (pair[0] + pair[1]) / 2, (pair[0] - pair[1]) / 2


def rms(difference: Array) -> float:
    """Root mean square of an array of any shape."""
    return math.sqrt(float(np.mean(difference**2)))


def decibels(error: float) -> float:
    """Peak signal-to-noise ratio in dB of an RMS error, the peak being 1.0."""
    return -20 * math.log10(error)


def update(
    path: Path, report: dict[str, Any], order: Iterable[str], markdown: Callable[[Mapping[str, Any]], str]
) -> None:
    """Write `report` to `path` (JSON) and as Markdown beside it, its scenes in `order`.

    Scenes and settings that were not measured now keep their figures, where all else (size, engine, ...) is as
    it was.
    """
    if path.exists():
        before = json.loads(path.read_text())
        if {**before, "scenes": {}} == {**report, "scenes": {}}:
            for name, scene in before["scenes"].items():
                now = report["scenes"].setdefault(name, scene)
                now["settings"] = {**scene["settings"], **now["settings"]}
    report["scenes"] = {name: report["scenes"][name] for name in order if name in report["scenes"]}
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(report, indent=1) + "\n")
    path.with_suffix(".md").write_text(markdown(report))
