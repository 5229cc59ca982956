"""Preview of a data set before it is made: parameters, measures of samples, size and time, and some pictures."""

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

MOST_DRAWN = 128  # samples that are drawn, and at which rays are cast
MOST_RENDERED, RENDER_S = 16, 30.0  # samples that are rendered, and s after which no further one is
VALUES = 8  # values of a choice that are listed
_MEMBER = re.compile(r"^(object\.[^.]+\.)\d+\.")  # name of a parameter of an object of a population


@dataclass(frozen=True)
class Summary:
    """Values of a parameter or measure: lowest, mean and highest number, shares of texts, or number of values."""

    name: str
    low: float | None
    mean: float | None
    high: float | None
    note: str = ""


@dataclass(frozen=True)
class DryRun:
    """Forecast for a set of `count` samples from `looked_at` of them, evenly spaced."""

    count: int
    splits: dict[str, float]  # share of each split
    looked_at: int
    parameters: tuple[Summary, ...]
    attempts: int  # number of draws
    failed: tuple[str, ...]  # messages of samples that cannot be drawn or rendered
    measures: tuple[Summary, ...]
    frames: float  # mean number per sample, over all variants and views
    bytes: dict[str, float]  # mean size of a rendered sample by array, before compression
    seconds: float | None  # for the set with one process
    basis: str  # samples that bytes and seconds come from, or why these are unknown
    sheet: Path | None
    fails: bool  # each sample that was rendered failed


def dry_run(
    distribution: Distribution, seed: int, count: int, *, arrays: Sequence[str], sheet_path: Path | None = None
) -> DryRun:
    """Draw and render some samples to forecast a data set; sheet_path: PNG for their pictures, if there is a device.

    Raises SceneError if no sample can be drawn.
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
        count=count,
        parameters=parameters,
        splits=dict(distribution.splits),
        looked_at=many,
        attempts=sum(sample.attempts for sample in samples),
        failed=tuple(failed),
        measures=measures,
        frames=fmean(frames),
        bytes=_sizes(records, arrays),
        seconds=fmean(seconds[1:] or seconds) * count if seconds else None,  # the first one is compiled for
        basis=basis,
        sheet=sheet_path if records else None,
        fails=len(failed) > drawn and not records,
    )


def _summaries(samples: Sequence[Sample]) -> tuple[Summary, ...]:
    """Summaries of all parameters; objects of a population are summarized together, components of vectors apart."""
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
    """Summaries of depth, blur and motion over samples without depth maps, at which rays cannot be cast."""
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
    """Records of the samples that were rendered in the allowed time, the seconds of each, and a text on their source;
    messages of failed samples are added to `failed`.
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
    """Mean bytes of a sample by array, all frames together."""
    sizes = dict.fromkeys(arrays, 0.0) if records else {}
    for record in records:
        for name, array in record.arrays.items():
            sizes[name.rpartition(".")[2]] += array.nbytes / len(records)
    return sizes
