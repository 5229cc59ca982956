"""Forecast of a data set before it is made: parameters, measures of samples, size, time, and some pictures."""

from __future__ import annotations

import re
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean
from typing import Any

import numpy as np

from clsco.data.acceptance import looks_of
from clsco.data.dataset import record_sheet
from clsco.data.distribution import Distribution, Sample
from clsco.data.record import Record, make_record
from clsco.errors import ClscoError, DeviceError, SceneError
from clsco.files.images import write_png
from clsco.frame.provenance import views
from clsco.plan.prepare import prepare

MOST_DRAWN = 128  # samples that are drawn and measured with rays
MOST_RENDERED, RENDER_S = 16, 30.0  # largest number of rendered samples, and s after which no other one is rendered
VALUES = 8  # values of a choice that are listed
_MEMBER = re.compile(r"^(object\.[^.]+\.)\d+\.")  # name of a parameter of an object of a population


@dataclass(frozen=True)
class Summary:
    """Summary of the values of a parameter or measure."""

    name: str
    low: float | None  # lowest, mean and highest value; None unless values are numbers
    mean: float | None
    high: float | None
    note: str = ""  # for other values: the share of each, or, if there are many, how many differ


@dataclass(frozen=True)
class DryRun:
    """Forecast for a set of `count` samples, from `looked_at` evenly spaced samples of it."""

    count: int
    splits: dict[str, float]  # share of each split
    looked_at: int
    parameters: tuple[Summary, ...]
    attempts: int  # number of draws
    failed: tuple[str, ...]  # messages of samples that cannot be drawn or rendered
    measures: tuple[Summary, ...]
    frames: float  # mean number of frames per sample, in all variants and views together
    bytes: dict[str, float]  # by array, mean size in a rendered sample before compression
    seconds: float | None  # time to render the whole set in one process
    basis: str  # samples that bytes and seconds come from, or why these are unknown
    sheet: Path | None
    fails: bool  # True if samples were rendered, and all failed


def dry_run(
    distribution: Distribution, seed: int, count: int, *, arrays: Sequence[str], sheet_path: Path | None = None
) -> DryRun:
    """Draw and render some samples to forecast a data set. Without a device, none is rendered.

    sheet_path: PNG to which pictures of the rendered samples are written. Raises SceneError if no sample can be drawn.
    """
    many = min(count, MOST_DRAWN)
    samples, failed = list[Sample](), list[str]()
    for k in range(many):
        try:
            samples.append(distribution.draw(seed, k * count // many))
        except SceneError as error:
            failed += error.messages
    if not samples:
        raise SceneError(failed)
    frames = [len(s.scenes) * s.scenes[0].sequence.frames * len(views(s.scenes[0])) for s in samples]
    parameters, measures = _summaries(samples), _measures(samples)
    drawn = len(failed)
    records, seconds, basis = _render(samples[:MOST_RENDERED], seed, arrays, failed)
    if sheet_path is not None and records:
        write_png(sheet_path, record_sheet(records))
    return DryRun(
        count=count, parameters=parameters, splits=dict(distribution.splits), looked_at=many,
        attempts=sum(sample.attempts for sample in samples), failed=tuple(failed), measures=measures,
        frames=fmean(frames), bytes=_sizes(records, arrays),
        seconds=fmean(seconds[1:] or seconds) * count if seconds else None,  # the first one includes compilation
        basis=basis, sheet=sheet_path if records else None, fails=len(failed) > drawn and not records,
    )  # fmt: skip


def _summaries(samples: Sequence[Sample]) -> tuple[Summary, ...]:
    """Summaries of all parameters: one for all objects of a population together, and one per component of a vector."""
    values: dict[str, list[Any]] = {}
    for sample in samples:
        for name, value in sample.parameters.items():
            own = _MEMBER.sub(r"\1", name)
            for k, each in enumerate(value) if isinstance(value, list) else [(None, value)]:
                values.setdefault(own if k is None else f"{own}[{k}]", []).append(each)
    return tuple(_summary(name, own) for name, own in values.items())


def _summary(name: str, values: list[Any]) -> Summary:
    if all(isinstance(value, int | float) for value in values):
        return Summary(name, min(values), fmean(values), max(values))
    counts = Counter(map(str, values))
    listed = ", ".join(f"{text}: {n / len(values):.1%}" for text, n in sorted(counts.items()))
    short = len(counts) <= VALUES and not any(isinstance(value, dict) for value in values)
    return Summary(name, None, None, None, listed if short else f"{len(counts)} values")


def _measures(samples: Sequence[Sample]) -> tuple[Summary, ...]:
    """Summaries of depth, blur and motion, without samples with depth maps, because rays cannot be cast at these."""
    analytic = [sample for sample in samples if all(scene.is_analytic for scene in sample.scenes)]
    scenes = [[s if s.camera.resolution is not None else prepare(s).scene for s in each.scenes] for each in analytic]
    looks = [look for variants in scenes for look in looks_of(variants)]
    if not looks:
        return ()
    values = {
        "depth Z, mm": np.concatenate([1.0 / look.inverse_depth for look in looks]),
        "blur radius |R|, px": np.concatenate([look.blur for look in looks]),
        "flow, px": np.concatenate([look.flow for look in looks]),
        "share of valid pixels": np.array([look.valid for look in looks]),
    }
    return tuple(Summary(name, float(v.min()), float(v.mean()), float(v.max())) for name, v in values.items() if v.size)


def _render(
    samples: Sequence[Sample], seed: int, arrays: Sequence[str], failed: list[str]
) -> tuple[list[Record], list[float], str]:
    """Render samples for at most about RENDER_S. Returns their records, the seconds of each, and a text that says how
    they were rendered, or why not; messages of failed samples are added to `failed`.
    """
    try:
        from clsco.data.shards import SampleRenderer
        from clsco.opencl.device import choose

        device = choose(None)
    except ImportError:
        return [], [], "pyopencl is not installed"
    except DeviceError as error:
        return [], [], str(error)
    renderer = SampleRenderer(device, tuple(arrays), "double" if device.has_fp64 else "single")
    records, seconds = list[Record](), list[float]()
    for sample in samples:
        start = time.perf_counter()
        try:
            records.append(make_record(sample, seed, renderer.render(sample), arrays))
        except ClscoError as error:
            failed += [f"{message} (sample {sample.number}, seed {seed})" for message in str(error).splitlines()]
            continue
        seconds.append(time.perf_counter() - start)
        if sum(seconds[1:]) > RENDER_S:  # most of the first may be compilation
            break
    return records, seconds, f"{len(records)} samples rendered by one process on {device.name}, without writing files"


def _sizes(records: Sequence[Record], arrays: Sequence[str]) -> dict[str, float]:
    """By array, its mean size in bytes in a sample, all frames together."""
    sizes = dict.fromkeys(arrays, 0.0) if records else {}
    for record in records:
        for name, array in record.arrays.items():
            sizes[name.rpartition(".")[2]] += array.nbytes / len(records)
    return sizes
