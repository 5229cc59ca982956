"""Common parts of the benchmarks of errors: a traced picture with its noise per pixel, errors in dB, files of
figures."""

from __future__ import annotations

import hashlib
import json
import math
import tempfile
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter

from clsco.truth.judge import trace
from clsco.truth.pixels import labels_at
from clsco.truth.problem import Problem, make_problem

Array = NDArray[np.float64]
MOST_RAYS = 2**17  # of a pixel
REPEATS = 4  # independent estimates of a pixel
CACHE_FORMAT = 3  # part of the key of cached images; a change of what is computed must change it


def traced(
    scene: Any, noise: float, cache: Path | None = None, frame: int = 0, report: Callable[[str], object] = print,
    seed: int = 0,
) -> tuple[Array, Array]:  # fmt: skip
    """Trace a frame of a scene with its resolution until the RMS of its standard errors is below `noise`.

    Returns the image (rows, columns[, channels]), linear, and its standard errors, whose RMS over any pixels is the
    noise there. `cache`: folder of earlier results, keyed by what rays know of the scene.
    """
    problem = make_problem(scene, frame)
    path = None if cache is None else cache / f"traced_{_key(problem, noise)}_{seed}.npz"
    if path is not None and path.exists():
        with np.load(path, allow_pickle=False) as stored:
            return stored["image"], stored["error"]
    began = time.perf_counter()
    image, error = trace_frame(problem, noise, MOST_RAYS, seed)
    report(f"traced {image.shape[0]} x {image.shape[1]}: {rms(error):.2e} RMS, {time.perf_counter() - began:.1f} s")
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=path.parent, suffix=".tmp", delete=False) as file:
            np.savez_compressed(file, image=image, error=error)
        Path(file.name).replace(path)
    return image, error


def trace_frame(problem: Problem, noise: float, rays: int, seed: int = 0) -> tuple[Array, Array]:
    """Radiance (rows, columns[, channels]) of all pixels by rays, and its standard error; the error's RMS is below
    `noise`, if `rays` rays per pixel are enough.
    """
    row, column = np.indices(problem.size).reshape(2, -1)
    places = np.stack([column, row, *np.ones((2, len(row))), np.zeros(len(row))], axis=-1).astype(float)

    def go_on(error: Array) -> NDArray[np.bool_]:  # a pixel near others with an error may have missed a surface
        near = maximum_filter(error.reshape(problem.size), 5).ravel()
        return np.asarray((near > noise / 4) & (math.sqrt(np.mean(error**2)) > noise))

    jobs = np.full((len(row), 2), -1)
    image, error, _ = trace(problem, jobs, places, rays, math.inf, seed, go_on, REPEATS)
    size = problem.size if image.shape[1] == 1 else (*problem.size, image.shape[1])
    return image.reshape(size), error.reshape(size)


def _key(problem: Problem, noise: float) -> str:
    digest = hashlib.sha256(f"{CACHE_FORMAT} {noise!r} {MOST_RAYS} {problem.surfaces.background}".encode())
    for part in problem[1:]:
        for value in (each for field in part for each in (field if isinstance(field, tuple) else (field,))):
            digest.update(str(np.shape(value)).encode() + np.asarray(value).tobytes())
    return digest.hexdigest()[:32]


def pinhole_view(scene: Any, times: Sequence[float]) -> tuple[NDArray[np.int64], Array]:
    """Nearest object, -1 for none, and its depth in mm, inf for none, at pixel centers, both (times, rows, columns),
    at shares of the exposure from 0 to 1; of equally near objects the first."""
    problem = make_problem(scene)
    last = len(problem.moments.poses) - 1
    views = [labels_at(problem, round(time * last)) for time in times]
    return np.stack([label for _, label in views]), np.stack([depth for depth, _ in views])


def rms(difference: Array) -> float:
    """Root mean square of an array of any shape."""
    return math.sqrt(float(np.mean(difference**2)))


def decibels(error: float) -> float:
    """Peak signal-to-noise ratio in dB of an RMS error, the peak being 1.0; infinite without any."""
    return -20 * math.log10(error) if error > 0.0 else math.inf


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
