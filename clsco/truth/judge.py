"""Comparison of a frame with rays through the lens: deviations by class of pixel and by object (float64)."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.frame.frame import Frame
from clsco.resources import processors
from clsco.scene.model import Scene
from clsco.truth.kernel import accumulate
from clsco.truth.pixels import CLASSES, SMALL_PX, Pixels, choose_pixels, extent_of, places_of
from clsco.truth.problem import Array, Problem, make_problem, not_judged
from clsco.truth.pupils import bend, lens_point
from clsco.truth.waves import HIDDEN, cells_of, spread_light

NOISE = 1e-3  # standard error to reach for a pixel, 1 = white
LIGHT_NOISE = 4e-3  # standard error to reach for the total light around a small object, in px of white
REPEATS = 16  # independent estimates of a pixel
FIRST, MOST_RAYS = 64, 2**16  # samples of each repeat at first; largest number of rays of a pixel
CELL_RAYS = 16  # number of rays of a cell whose light is spread by waves
RECORD_RAYS = 2**12  # number of rays of a pixel, for the record of a frame
ALLOWED, ALLOWED_ERRORS = 0.01, 5.0  # a deviation exceeds both 0.01 of white and 5 standard errors
COUNTED_ERRORS = 4.0  # `Row.beyond` counts pixels off by more than ALLOWED and so many standard errors


@dataclass(frozen=True)
class Row:
    """Deviations of a class of pixels, or of the pixels of an object; 1 = white.

    rms, noise: RMS of the differences between frame and rays, and of the rays' noise; mean: signed mean difference;
    beyond: number of pixels off by more than 0.01 and 4 standard errors. Of the pixel with the largest difference, if
    possible among those in `beyond`: column, row; right: value by rays, the expected one; got: value in the frame;
    errors: difference in standard errors.
    """

    name: str
    pixels: int
    rms: float
    noise: float
    mean: float
    beyond: int
    column: int
    row: int
    right: float
    got: float
    errors: float

    @property
    def decibels(self) -> float:
        return decibels_of(self.rms**2, self.noise**2)


def decibels_of(square: float, noise: float) -> float:
    """PSNR in dB of a mean square difference, minus the mean square `noise` of the rays, which may be as large."""
    return -10 * math.log10(max(square - noise, 1e-2 * noise, 1e-12))


@dataclass(frozen=True)
class Light:
    """Total light around a small object, in px of white.

    right: total light computed by rays, the expected value; error: its standard error; got: total light in the frame;
    own: the part of `right` that comes from the object, negative for an object darker than what it hides.
    """

    name: str
    right: float
    error: float
    got: float
    own: float


@dataclass(frozen=True, eq=False)
class Judgement:
    """Comparison of a view with rays: a `Row` per class and per object, light of small objects, and tested pixels.

    right (n, channels): values of the pixels by rays, the expected ones; got (n, channels): values in the frame; error
    (n, channels): standard errors of `right`; rays: number of rays that were cast; seconds: time that it took.
    """

    classes: tuple[Row, ...]
    objects: tuple[Row, ...]
    lights: tuple[Light, ...]
    pixels: Pixels
    right: Array
    got: Array
    error: Array
    rays: int
    seconds: float

    @property
    def deviations(self) -> NDArray[np.bool_]:
        """Mask (n,) of pixels that are off by more than 0.01 of white and 5 standard errors."""
        off = np.abs(self.got - self.right)
        return np.asarray(((off > ALLOWED) & (off > ALLOWED_ERRORS * self.error)).any(axis=1))

    @property
    def dim(self) -> tuple[Light, ...]:
        """Small objects whose |got - right| exceeds 2 % of |own|, 0.01 px of white, and 5 standard errors."""
        return tuple(
            light for light in self.lights
            if abs(light.got - light.right) > max(0.02 * abs(light.own), ALLOWED, ALLOWED_ERRORS * light.error)
        )  # fmt: skip

    @property
    def agrees(self) -> bool:
        """True if no pixel and no small object deviates."""
        return not (self.deviations.any() or self.dim)

    @property
    def wrong(self) -> str:
        """Text with the number of deviations, and the largest one."""
        off = np.where(self.deviations, np.abs(self.got - self.right).max(axis=1), -1.0)
        dim = f"{len(self.dim)} small objects of another light" if self.dim else ""
        if not self.deviations.any():
            return dim
        k = int(off.argmax())
        place = f"column {self.pixels.column[k]}, row {self.pixels.row[k]}"
        many = f"{int(self.deviations.sum())} of {len(off)} pixels beyond, by {off[k]:.3f} at {place}"
        return f"{many}, {dim}" if dim else many

    @property
    def figures(self) -> dict[str, Any]:
        """Summary: PSNR in dB after subtraction of the rays' noise, and PSNR of this noise; mean deviation, 1 = white;
        counts of pixels, deviations, small objects, and small objects with wrong light.
        """
        if not len(self.right):  # wave optics, if everything is hidden or tilted
            return {"pixels": 0, "deviations": 0}
        off, noise = self.got - self.right, max(float(np.mean(self.error**2)), 1e-18)
        psnr = decibels_of(float(np.mean(off**2)), noise)
        return {
            "psnr": round(psnr, 1), "psnr_noise": round(-10 * math.log10(noise), 1),
            "mean": round(float(off.mean()), 5), "pixels": len(off), "deviations": int(self.deviations.sum()),
            "lights": len(self.lights), "lights_off": len(self.dim),
        }  # fmt: skip

    def values(self) -> dict[str, Any]:
        """Figures and pixels as JSON types."""
        pixels, kinds = self.pixels, [CLASSES[k] for k in self.pixels.kind]
        numbers = (pixels.column, pixels.row, self.right, self.got, self.error)
        names = ("class", "column", "row", "right", "got", "error")
        table = zip(kinds, *(values.tolist() for values in numbers), strict=True)
        return {
            "classes": [asdict(row) | {"psnr": row.decibels} for row in self.classes],
            "objects": [asdict(row) | {"psnr": row.decibels} for row in self.objects],
            "lights": [asdict(light) for light in self.lights],
            "pixels": [dict(zip(names, values, strict=True)) for values in table],
            "deviations": int(self.deviations.sum()), "rays": self.rays, "seconds": round(self.seconds, 3),
        }  # fmt: skip


def judged_frame(scene: Scene, frame: Frame) -> Frame:
    """A frame with `check` in its metadata: figures from some rays at each tested pixel, or why there are none."""
    why = not_judged(scene)
    if why is None and (scene.sensor is not None or "color" not in frame.arrays()):
        why = "rays tell light, and not what a sensor or a scene without an image has"
    if why is None:
        check = judge(make_problem(scene, frame.index, frame.eye), frame.color, RECORD_RAYS, math.inf).figures
    else:
        check = {"not_judged": why}
    return replace(frame, metadata={**frame.metadata, "check": check})


def judge(
    problem: Problem, image: NDArray[Any], rays: int = MOST_RAYS, seconds: float = 20.0, seed: int = 0
) -> Judgement:  # fmt: skip
    """Compare a frame with rays.

    image: (rows, columns[, channels]), linear radiance; rays: largest number per pixel; seconds: limit, see `trace`;
    seed: for the choice of pixels and rays. Equal seeds give equal bits, unless the time runs out.
    """
    began, pixels = time.perf_counter(), choose_pixels(problem, seed)
    frame = np.asarray(image, float).reshape(*problem.size, -1)
    if problem.scene.psf.model == "wave":
        mean, error, hidden, cast = trace_waves(problem, seed)
        is_judged = hidden[pixels.row, pixels.column] < HIDDEN
        pixels = pixels.select(is_judged)
        mean, error = (each[pixels.row, pixels.column] for each in (mean, error))
        return _judgement(problem, pixels, frame, mean, error, (), cast, began)
    boxes, count = list(_boxes(problem)), len(pixels.row)
    pairs = [(-1, -1)] * count + [(n, -1) for n, *_ in boxes] + [(-1, n) for n, *_ in boxes]
    jobs = np.array(pairs, np.int64).reshape(-1, 2)
    corners = [(column, row, 1.0, 1.0, 0.0) for column, row in zip(pixels.column, pixels.row, strict=True)]
    places = np.array(corners + [box[k] for k in (1, 2) for box in boxes], float).reshape(-1, 5)
    enough = np.full(len(jobs), NOISE)
    enough[count : count + len(boxes)] = [LIGHT_NOISE / (box[2] * box[3]) for _, box, _ in boxes]
    mean, error, cast = trace(problem, jobs, places, rays, seconds, seed, lambda error: error > enough)
    lights = []
    for k, (n, (left, top, wide, high, _), _) in enumerate(boxes):
        area, base, own = wide * high, count + k, count + len(boxes) + k
        got = frame[int(top) : int(top + high), int(left) : int(left + wide)].sum(axis=(0, 1)).mean()
        right = area * mean[base].mean() + mean[own].mean()
        spread = math.hypot(area * error[base].mean(), error[own].mean())
        lights.append(Light(problem.scene.objects[n].name, float(right), spread, float(got), float(mean[own].mean())))
    return _judgement(problem, pixels, frame, mean[:count], error[:count], tuple(lights), cast, began)


def _judgement(
    problem: Problem, pixels: Pixels, frame: Array, mean: Array, error: Array, lights: tuple[Light, ...], cast: int,
    began: float,
) -> Judgement:  # fmt: skip
    got = np.broadcast_to(frame[pixels.row, pixels.column], mean.shape)
    names = [item.name for item in problem.scene.objects]
    by_class = [(name, pixels.kind == k) for k, name in enumerate(CLASSES)]
    by_object = [(name, pixels.item == n) for n, name in enumerate(names)] + [("nothing", pixels.item < 0)]
    classes, objects = (
        tuple(_row(name, of, pixels, mean, got, error) for name, of in masks if of.any())
        for masks in (by_class, by_object)
    )
    return Judgement(classes, objects, lights, pixels, mean, got, error, cast, time.perf_counter() - began)


def trace_waves(problem: Problem, seed: int = 0) -> tuple[Array, Array, Array, int]:
    """Results of `spread_light` for a frame by wave optics, and the number of rays."""
    cells = cells_of(problem)
    if cells.hidden[cells.shines].all():
        nothing = np.zeros((*problem.size, problem.surfaces.images.shape[1]))
        return nothing, nothing, np.ones(problem.size), 0
    jobs = np.full((len(cells.places), 2), -1)
    light, error, cast = trace(cells.problem, jobs, cells.places, CELL_RAYS, 0.0, seed, repeats=2)
    return *spread_light(problem, cells, light, error), cast


def trace(
    problem: Problem, jobs: NDArray[np.int64], places: Array, rays: int, seconds: float, seed: int,
    go_on: Callable[[Array], NDArray[np.bool_]] = lambda error: error > NOISE, repeats: int = REPEATS,
) -> tuple[Array, Array, int]:  # fmt: skip
    """Radiance (jobs, channels) by rays, its standard error, and the number of rays; arguments as for `accumulate`.

    rays: largest number per job; seconds: time, without compilation, after which no more rays are started; go_on:
    function that takes the jobs' errors and returns a mask of jobs that need more rays; repeats: number of estimates
    per job, whose differences give the errors.
    """
    from scipy.stats import qmc  # takes seconds to import

    channels = problem.surfaces.images.shape[1]
    sampler = qmc.Sobol(5, scramble=True, rng=np.random.default_rng(seed))
    sums, counts = np.zeros((len(jobs), repeats, channels)), np.zeros(len(jobs), np.int64)
    key = int(np.random.SeedSequence(seed).generate_state(1, np.uint64)[0] >> np.uint64(1))
    most = max(2 ** int(math.log2(max(rays, 2 * repeats) / repeats)), 1)
    arrays: tuple[Any, ...] = problem[1:]
    points, going, last = np.empty((0, 5)), np.arange(len(jobs)), min(FIRST, most)
    accumulate(sums, jobs, places, going[:0], points, (0, 0), key, *arrays)  # compiles
    until = time.perf_counter() + seconds
    with ThreadPoolExecutor(processors()) as pool:
        while len(going):
            begin, points = len(points), np.concatenate([points, sampler.random(last - len(points))])

            def add(part: NDArray[np.int64], span: tuple[int, int] = (begin, last), samples: Array = points) -> None:
                accumulate(sums, jobs, places, part, samples, span, key, *arrays)

            list(pool.map(add, np.array_split(going, min(len(going), 4 * processors()))))
            counts[going] = last
            means = sums / counts[:, None, None]
            error = means.std(axis=1, ddof=1) / math.sqrt(repeats)
            if 2 * last > most or time.perf_counter() > until:
                break
            going, last = going[go_on(error.max(axis=1))[going]], 2 * last
    return means.mean(axis=1), error, int(counts.sum()) * repeats


def _boxes(problem: Problem) -> Iterator[tuple[int, tuple[float, ...], tuple[float, ...]]]:
    """Numbers of objects that are narrow and entirely in the frame, each with two places for `accumulate`.

    The first place: left, top, width and height of the pixels that receive all light of the object. The second: half
    width and half height in mm, and middle, of a rectangle at which rays are aimed.
    """
    moments = sorted({0, len(problem.moments.poses) // 2, len(problem.moments.poses) - 1})
    if problem.moments.clock[1] > 0.0 and len(problem.moments.poses) > 1:
        return  # with a rolling shutter, pixels of a box have different times
    widest, bent = _reach(problem)
    for n in range(len(problem.scene.objects)):
        extent = extent_of(problem, n)
        if extent is None or not extent.width < SMALL_PX:
            continue
        middle = extent.places[len(extent.places) // 2]
        by_moment = [places_of(problem, n, moment, extent.places) for moment in moments]
        column, row, radius = (np.concatenate(part) for part in zip(*by_moment, strict=True))
        if len(column) < len(moments) * len(extent.places):
            continue
        depth = problem.moments.poses[moments[0], n, 11]
        reach = float(np.abs(radius).max()) * widest + bent + 5.0
        left, right = math.floor(column.min() - reach), math.ceil(column.max() + reach)
        top, bottom = math.floor(row.min() - reach), math.ceil(row.max() + reach)
        if left < 0 or top < 0 or right >= problem.size[1] or bottom >= problem.size[0]:
            continue
        half = 1.05 * extent.around * (1.0 + problem.moments.lenses[0, 1] / depth)
        yield n, (left, top, right - left + 1, bottom - top + 1, 0.0), (half, half, *middle)


def _reach(problem: Problem) -> tuple[float, float]:
    """Extent of a blur with R = 1 px, enlarged by a fifth, and px by which wavefront errors move rays at most."""
    pupil, (step, half, *_) = problem.optics.pupil, problem.moments.lenses[0]
    grid = np.linspace(0.0, 0.999, 24)
    at = np.array([lens_point(u, v, *pupil)[:2] for u in grid for v in grid])
    corners = [(x, y) for x in (-0.8, 0.0, 0.8) for y in (-0.6, 0.0, 0.6)]
    field: tuple[Any, ...] = problem.optics.wavefront
    bends = [np.hypot(*bend(x, y, *corner, *field)) for x, y in at for corner in corners]
    return 1.2 * float(np.hypot(*at.T).max()), 1.2 * max(bends) / (half * step)


def _row(name: str, of: NDArray[np.bool_], pixels: Pixels, right: Array, got: Array, error: Array) -> Row:
    off = got[of] - right[of]
    far = np.abs(off)
    errors = far / np.maximum(error[of], 1e-9)
    beyond = (far > ALLOWED) & (far > COUNTED_ERRORS * error[of])
    count = int(beyond.any(axis=1).sum())
    k, channel = np.unravel_index(int(np.where(beyond, 1e3 + far, far).argmax()), far.shape)
    at = np.nonzero(of)[0][k]
    return Row(
        name, int(of.sum()), math.sqrt(float(np.mean(off**2))), math.sqrt(float(np.mean(error[of] ** 2))),
        float(off.mean()), count, int(pixels.column[at]), int(pixels.row[at]), float(right[at, channel]),
        float(got[at, channel]), float(errors[k, channel]),
    )  # fmt: skip
