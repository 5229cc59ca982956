"""Preview of a data set before it is made: parameters, measures of samples, size and time, and some pictures."""

from __future__ import annotations

import re
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean, median
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.data.acceptance import Look, looks_of
from clsco.data.dataset import TILE, shrunk
from clsco.data.distribution import Distribution, Sample
from clsco.errors import ClscoError, DeviceError, SceneError
from clsco.files.images import write_png
from clsco.files.transfer import encode
from clsco.frame.contact_sheet import contact_sheet, split_into_rows
from clsco.frame.frame import Frame
from clsco.frame.provenance import views
from clsco.frame.truth_files import ATTRIBUTES
from clsco.optics.exposure import frame_lines
from clsco.plan.prepare import prepare
from clsco.plan.request import Request
from clsco.scene.model import Scene

LOOKED_AT = 128  # samples that rays are cast at
SHOWN = 16  # on the contact sheet
TIMED = 2  # samples of which a frame is rendered, twice: the first time to compile
LONG, LONGEST = 20.0, 120.0  # s, after which the second time has one sample, or is left out
TIME_SAMPLES = 8  # of a frame with motion blur on the contact sheet, at most
BINS = 12
VALUES = 8  # of a choice that are listed
_MEMBER = re.compile(r"^(object\.[^.]+\.)\d+\.")  # name of a parameter of an object of a population
BYTES = {"color": 2, "sharp": 2, "alpha": 2, "normal": 12, "flow": 8, "flow_backward": 8, "uv": 8}
"""Bytes of a pixel; of the first three for each channel. Masks have 1 byte, all other arrays 4."""
MASKS = ("mask", "filled", "missing", "hidden", "flow_occluded", "occluded")


@dataclass(frozen=True)
class Summary:
    """Values of one parameter: lowest, mean and highest of numbers, or the shares of texts, or how many there are."""

    name: str
    low: float | None
    mean: float | None
    high: float | None
    note: str


@dataclass(frozen=True)
class SeenHistogram:
    """Shares of values in BINS bins, or in one where all are the same; edges: one more."""

    name: str
    edges: tuple[float, ...]
    shares: tuple[float, ...]


@dataclass(frozen=True)
class DryRun:
    """Result of `dry_run`: what a set of `count` samples will be, by those that are looked at, at equal distances in
    it.

    `splits` has the share of each split, `attempts` the number of draws, `failed` the messages of samples that cannot
    be drawn, `frames` the mean number of a sample, all variants and views counted, `bytes` the mean size of a sample by
    array before compression, `weights` the predicted work of a frame in weights of its blur, the median. `seconds` are
    for the set, with one process on the device that was found, and `basis` says from what, or why they are not known.
    """

    count: int
    splits: dict[str, float]
    looked_at: int
    parameters: tuple[Summary, ...]
    attempts: int
    failed: tuple[str, ...]
    histograms: tuple[SeenHistogram, ...]
    frames: float
    bytes: dict[str, float]
    weights: float
    seconds: float | None
    basis: str
    sheet: Path | None


def dry_run(
    distribution: Distribution, seed: int, count: int, *, wanted: Sequence[str], sheet_path: Path | None = None
) -> DryRun:
    """Find out what a data set will be. Raises SceneError where no sample can be drawn.

    wanted: names of arrays as in files; sheet_path: PNG with pictures of 16 samples, where there is a device.
    """
    many = min(count, LOOKED_AT)
    samples, failed = list[Sample](), list[str]()
    for k in range(many):
        try:
            samples.append(distribution.draw(seed, k * count // many))
        except SceneError as error:
            failed += error.messages
    if not samples:
        raise SceneError(failed)
    planned = [_planned(sample, wanted) for sample in samples[:SHOWN]]
    frames = [len(s.scenes) * s.scenes[0].sequence.frames * len(views(s.scenes[0])) for s in samples]
    sizes = {name: fmean(frames) * fmean(size[name] for size, _ in planned) for name in wanted}
    seconds, basis = _seconds(samples[:TIMED], wanted)
    sheet = None
    if sheet_path is not None and seconds is not None:
        write_png(sheet_path, sample_sheet(samples[:SHOWN]))
        sheet = sheet_path
    return DryRun(
        count=count,
        parameters=_summaries(samples),
        splits=dict(distribution.splits),
        looked_at=many,
        attempts=sum(sample.attempts for sample in samples),
        failed=tuple(failed),
        histograms=_histograms(samples),
        frames=fmean(frames),
        bytes=sizes,
        weights=median(weights for _, weights in planned),
        seconds=None if seconds is None else seconds * fmean(frames) * count,
        basis=basis,
        sheet=sheet,
    )


def _summaries(samples: Sequence[Sample]) -> tuple[Summary, ...]:
    """Summaries of all parameters, those of the objects of a population together."""
    values: dict[str, list[Any]] = {}
    for sample in samples:
        for name, value in sample.parameters.items():
            values.setdefault(_MEMBER.sub(r"\1", name), []).append(value)
    return tuple(_summary(name, own) for name, own in values.items())


def _summary(name: str, values: list[Any]) -> Summary:
    numbers = [each for value in values for each in (value if isinstance(value, list) else [value])]
    if all(isinstance(number, int | float) for number in numbers):
        return Summary(name, min(numbers), fmean(numbers), max(numbers), "")
    counts = Counter(map(str, values))
    listed = ", ".join(f"{text}: {n / len(values):.1%}" for text, n in sorted(counts.items()))
    return Summary(name, None, None, None, listed if len(counts) <= VALUES else f"{len(counts)} values")


def _histograms(samples: Sequence[Sample]) -> tuple[SeenHistogram, ...]:
    """Histograms of depth, blur and motion over samples; samples with depth maps, at which no rays are cast, are left
    out."""
    looks = list[Look]()
    for sample in samples:
        if all(scene.is_analytic for scene in sample.scenes):
            looks += looks_of([_sized(scene) for scene in sample.scenes])
    if not looks:
        return ()
    depth = np.concatenate([1.0 / look.inverse_depth for look in looks])
    found = [
        _histogram("depth Z, mm", depth),
        _histogram("blur radius |R|, px", np.concatenate([look.blur for look in looks])),
        _histogram("flow, px", np.concatenate([look.flow for look in looks])),
        _histogram("share of valid pixels", np.array([look.valid for look in looks])),
    ]
    return tuple(one for one in found if one is not None)


def _histogram(name: str, values: NDArray[np.float64]) -> SeenHistogram | None:
    if not values.size:
        return None
    low, high = float(values.min()), float(values.max())
    edges = np.linspace(low, high, BINS + 1) if high > low else np.array([low, high])
    shares = np.histogram(values, edges)[0] / values.size if high > low else np.ones(1)
    return SeenHistogram(name, tuple(edges.tolist()), tuple(shares.tolist()))


def _sized(scene: Scene) -> Scene:
    """The scene with its resolution."""
    return scene if scene.camera.resolution is not None else prepare(scene).scene


def _planned(sample: Sample, wanted: Sequence[str]) -> tuple[dict[str, float], float]:
    """Bytes of each array of a frame of a sample, and the predicted weights."""
    plan = prepare(sample.scenes[0], Request(_truth(wanted), color="color" in wanted)).plan
    pixels, found = plan.rows * plan.columns, {}
    for name in wanted:
        channels = plan.channels if name in ("color", "sharp") else 1
        found[name] = float(pixels * channels * (1 if name in MASKS else BYTES.get(name, 4)))
        if name == "row_time":
            found[name] = 8.0 * frame_lines(plan.scene)
    return found, plan.taps


def _truth(wanted: Sequence[str]) -> tuple[str, ...]:
    return tuple(ATTRIBUTES[name] for name in wanted if name != "color")


def _seconds(samples: Sequence[Sample], wanted: Sequence[str]) -> tuple[float | None, str]:
    """Seconds per frame where there is a device, with what they are from."""
    try:
        from clsco.engine.sequence import render
        from clsco.opencl.device import choose

        device = choose(None)
        seconds, made = 0.0, 0
        for _ in range(2):
            if seconds < LONGEST:
                timed = samples if seconds < LONG else samples[:1]  # most of a long first time may be compilation
                start, made = time.perf_counter(), 0
                for one in timed:
                    found = render(one.scenes[0], truth=_truth(wanted), color="color" in wanted, frames=(0,))
                    made += len(list(found))
                seconds = time.perf_counter() - start
    except ImportError:
        return None, "pyopencl is not installed"
    except DeviceError as error:
        return None, str(error)
    return seconds / made, f"{made} frames rendered by one process on {device.name}, without writing files"


def sample_sheet(samples: Sequence[Sample]) -> NDArray[np.uint8]:
    """Pictures of samples, rendered small: first frame, left view, first and last variant; (rows, columns, 3)."""
    tiles = []
    for sample in samples:
        ends = [sample.scenes[0], sample.scenes[-1]] if len(sample.scenes) > 1 else [sample.scenes[0]]
        variants = f", {len(sample.scenes)} variants" if len(sample.scenes) > 1 else ""
        label = f"{sample.number} {sample.split}".rstrip() + variants
        tiles.append((np.concatenate([_picture(scene) for scene in ends], axis=1), label))
    return contact_sheet(split_into_rows(tiles))


def _picture(scene: Scene) -> NDArray[np.uint8]:
    """The first frame of a scene, at most TILE px long, as 8-bit sRGB (rows, columns, 3); gray where it fails."""
    from clsco.engine.sequence import render

    sized = _sized(scene)
    assert sized.camera.resolution is not None
    columns, rows = sized.camera.resolution
    scale = min(1.0, TILE / max(columns, rows))
    small = (max(1, round(columns * scale)), max(1, round(rows * scale)))
    camera: dict[str, Any] = {"resolution": small, "pixel_pitch": sized.camera.pixel_pitch * columns / small[0]}
    if sized.is_analytic:
        sized = sized.model_copy(update={"camera": sized.camera.model_copy(update=camera)})
    if sized.moves:
        few = {"samples": TIME_SAMPLES}
        sized = sized.model_copy(update={"sequence": sized.sequence.model_copy(update=few)})
    try:
        frame: Frame = next(iter(render(sized, truth=(), frames=(0,))))
    except ClscoError:
        return np.full((small[1], small[0], 3), 128, np.uint8)
    color = frame.color if frame.color.ndim == 3 else np.repeat(frame.color[..., None], 3, axis=2)
    codes = encode(color, 8, "srgb").astype(np.uint8)
    return shrunk(codes)
