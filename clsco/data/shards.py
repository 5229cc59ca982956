"""Makes a shard of a data set: draws, renders and writes its samples, and writes its part of the manifest."""

from __future__ import annotations

import hashlib
import math
import time
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass
from itertools import chain, count
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from clsco.data.containers import Container, container_named
from clsco.data.distribution import Distribution, Sample, ScriptedDistribution
from clsco.data.failures import is_of_machine
from clsco.data.manifest import CONFLICT, LOG, UNSPLIT, Identity, line, numbers_of, part_bytes, part_key
from clsco.data.record import Record, make_record
from clsco.data.sets import DataSet
from clsco.data.storage import Storage, remove_path
from clsco.engine.sequence import render_prepared
from clsco.errors import DeviceError, FileError, SceneError
from clsco.files.atomic import file_digests, naming
from clsco.frame.frame import Frame
from clsco.frame.outputs import ATTRIBUTES
from clsco.inputs.files import InputFiles
from clsco.opencl.device import Device
from clsco.opencl.session import session_on
from clsco.optics.resolved_view import without_lens
from clsco.plan.prepare import prepare_sweep
from clsco.plan.request import Request
from clsco.scene.model import Scene
from clsco.scene.sweep import Sweep

CACHE_BYTES = 2**28  # size of the cache on the device, and size of the cache on the host
MEASURED = ("depth", "coc", "flow")
MOST_MEASURED = 4096  # number of pixels of an array from which quantiles are computed
QUANTILES = (0.0, 0.05, 0.5, 0.95, 1.0)


@dataclass(frozen=True)
class SetJob:
    """A set to make; where: its folder or address. It is pickled and sent to worker processes."""

    distribution: Distribution | ScriptedDistribution
    identity: Identity
    samples: range
    where: str

    def numbers(self, shard: int) -> range:
        return numbers_of(shard, self.samples, self.identity.shard_size)


@dataclass(frozen=True)
class MadeShard:
    """A shard that is made, but not delivered to the set yet."""

    shard: int
    files: Mapping[str, Path]  # paths in the scratch folder, by key
    part: bytes  # content of the part of the manifest
    samples: int  # number of samples
    failed: int  # number of failed samples
    began: float  # s since 1970
    seconds: Mapping[str, float]  # time of each stage


def device_family(device: Device) -> str:
    """Name of the family of a device; all devices of a family give the same bits. Processors have no model in it."""
    if device.kind == "cpu":
        return f"cpu, {device.platform} {device.driver}, vectors of {device.vector_width} floats"
    return f"{device.kind}, {device.platform}, {device.name}, {device.driver}"


class SampleRenderer:
    """Renders samples on one device; keeps data that samples share in memory.

    arrays: names of arrays in files; if "color" is not among them, no image is rendered.
    """

    def __init__(self, device: Device, arrays: tuple[str, ...], precision: str) -> None:
        self.device = device
        self.session = session_on(device).with_cache(CACHE_BYTES)
        self.files = InputFiles(CACHE_BYTES)
        truth = tuple(ATTRIBUTES[name] for name in arrays if name != "color")
        self.request = Request(truth, precision=precision, color="color" in arrays)
        self._before: Scene | None = None

    def render(self, sample: Sample) -> list[list[Frame]]:
        """Frames of each variant of a sample. In a stereo pair, the left view is first. Raises as `clsco.render`."""
        sweep = Sweep(sample.labels, sample.scenes)
        prepared = prepare_sweep(sweep, self.request, self.device, self.files)
        bare = without_lens(sample.scenes[0])
        keeps, self._before = bare == self._before, bare  # rays are kept if samples differ only in lens and sensor
        frames: list[list[Frame]] = [[] for _ in sample.labels]
        for variant, frame in render_prepared(self.session, prepared, keeps_rays=keeps):
            frames[variant].append(frame)
        return frames


class ShardMaker:
    """Makes shards of a set on one device; overlapped: True to render the next sample while a sample is encoded."""

    def __init__(self, job: SetJob, storage: Storage, device: Device, overlapped: bool) -> None:
        self.job, self.storage, self.overlapped = job, storage, overlapped
        identity = job.identity
        if device_family(device) != identity.device_family:
            rule = f"device: all of a set must be of the family {identity.device_family}"
            raise DeviceError(f"{rule}; got {device_family(device)}") from OSError()  # so that it ends the run
        self.data_set = DataSet(storage, identity, job.samples)
        self.container: Container = container_named(identity.format)
        self.arrays, self.types = identity.arrays, dict(identity.types)
        self.every = job.distribution.tables.check.get("every", 0) if isinstance(job.distribution, Distribution) else 0
        self.renderer = SampleRenderer(device, self.arrays, identity.precision)

    def make(
        self, shard: int, numbers: Iterable[int] | None = None, failed: Mapping[int, str] | None = None,
        advance: Callable[[], object] = lambda: None,
    ) -> MadeShard:  # fmt: skip
        """Make the files of a shard in the scratch folder, with all samples, or only those in `numbers`.

        failed: numbers and messages of samples to skip; advance: called after each sample. Raises ClscoError if the
        machine fails (`is_of_machine`), or files cannot be written. All other failures are recorded for their samples.
        """
        began, spent = time.time(), {"draw": 0.0, "render": 0.0, "all": time.perf_counter()}
        rows: dict[int, dict[str, Any]] = {}
        failures: dict[int, dict[str, Any]] = {}
        splits: dict[str, list[Sample]] = {}
        for number in self.job.numbers(shard) if numbers is None else numbers:
            start = time.perf_counter()
            try:
                sample = self.job.distribution.draw(self.job.identity.seed, number)
            except (SceneError, FileError) as error:
                if is_of_machine(error):
                    raise
                failures[number] = {"number": number, "error": self._portable(error), "scene": None}
                advance()
                continue
            finally:
                spent["draw"] += time.perf_counter() - start
            if failed and number in failed:
                failures[number] = _failure(sample, self._portable(failed[number]))
                advance()
                continue
            splits.setdefault(sample.split, []).append(sample)

        def records(samples: Sequence[Sample], key: str) -> Generator[Record, None, None]:
            offsets = count()
            for sample in samples:
                start = time.perf_counter()
                try:
                    frames = self.renderer.render(sample)
                    if self.every and sample.number % self.every == 0:
                        from clsco.truth.judge import judged_frame

                        frames[0][0] = judged_frame(sample.scenes[0], frames[0][0])
                    spent["render"] += time.perf_counter() - start
                    record = make_record(sample, self.job.identity.seed, frames, self.arrays, self.types)
                except (SceneError, FileError) as error:
                    if is_of_machine(error):
                        raise
                    failures[sample.number] = _failure(sample, self._portable(error))
                    advance()
                    continue
                rows[sample.number] = _row(sample, key, next(offsets), record)
                yield record
                advance()

        files, folder = dict[str, Path](), self.storage.scratch()
        for split in sorted(splits):
            key = f"{split or UNSPLIT}/{shard:06d}{self.container.suffix}"
            path = folder / key.replace("/", "_")
            produced = records(splits[split], key)
            with closing(prefetch(produced) if self.overlapped else produced) as source:
                first = next(source, None)
                if first is None:
                    continue
                remove_path(path)
                with naming(path):
                    self.container.write(path, chain([first], source))
            files[key] = path
        described = {name: about for key, path in files.items() for name, about in file_digests(key, path).items()}
        part = part_bytes(
            shard, self.job.identity.digest, self.job.numbers(shard), described,
            [rows[number] for number in sorted(rows)], [failures[number] for number in sorted(failures)],
        )  # fmt: skip
        spent["all"] = time.perf_counter() - spent["all"]
        return MadeShard(shard, files, part, len(rows), len(failures), began, spent)

    def _portable(self, error: object) -> str:
        """Message of an error, without the path that the distribution's folder has on this machine."""
        distribution = self.job.distribution
        text = str(error).replace(distribution.where, Path(distribution.where).name)
        return text.replace(f"{distribution.folder}/", "")

    def deliver(self, made: MadeShard, about: Mapping[str, Any]) -> None:
        """Move the files of a shard to the set, then write its part, and log how long it took.

        about: entries of the log on this process. Raises FileError if another process has made the same shard with
        other bytes; both shards stay.
        """
        key = part_key(made.shard)
        present = self.storage.read(key)
        if present is not None and present != made.part:
            if self.data_set.done([made.shard], True, []):  # the device of one of the two processes is broken
                beside = f"{CONFLICT}/{hashlib.sha256(made.part).hexdigest()[:16]}"
                for name, path in made.files.items():
                    self.storage.put(f"{beside}/{name}", path)
                self.storage.write(f"{beside}/{key}", made.part)
                rule = "all that make a shard must make the same bytes"
                raise FileError(f"{key}: {rule}; got others, which are in {beside}") from OSError(rule)
            self.storage.remove(key)  # files that this part names are about to change
        for name, path in made.files.items():
            self.storage.put(name, path)
        self.storage.write(key, made.part)
        took = {name: round(value, 3) for name, value in made.seconds.items()}
        log: dict[str, Any] = {"shard": made.shard, "samples": made.samples, "failed": made.failed}
        log |= {"began": round(made.began, 3), "ended": round(time.time(), 3), "seconds": took, **about}
        self.storage.write(f"{LOG}/{made.shard:06d}.jsonl", f"{line(log)}\n".encode())


def _failure(sample: Sample, error: str) -> dict[str, Any]:
    return {"number": sample.number, "split": sample.split, "error": error, "scene": sample.table}


def _row(sample: Sample, key: str, offset: int, record: Record) -> dict[str, Any]:
    """The manifest line of a sample; key: the file that has it; offset: its position among the records of this file."""
    return {
        "number": sample.number, "split": sample.split, "file": key, "offset": offset, "attempts": sample.attempts,
        "parameters": sample.parameters, "arrays": record.sha256(), "statistics": statistics(record.arrays),
    }  # fmt: skip


def statistics(arrays: Mapping[str, NDArray[Any]]) -> dict[str, list[float | None]]:
    """For each array of depth, R and flow: the share of finite pixels, and quantiles of Z, |R| or the flow's length.

    They are computed from a regular grid of pixels, to take less time.
    """
    quantiles: dict[str, list[float | None]] = {}
    for name, array in arrays.items():
        kind = name.rpartition(".")[2]
        if kind not in MEASURED:
            continue
        step = max(1, math.isqrt(array.shape[0] * array.shape[1] // MOST_MEASURED))
        some = np.asarray(array[::step, ::step], np.float64)
        sizes = (np.hypot(some[..., 0], some[..., 1]) if kind == "flow" else np.abs(some)).ravel()
        finite = np.sort(sizes[np.isfinite(sizes)])
        places = [round(share * (finite.size - 1)) for share in QUANTILES] if finite.size else []
        quantiles[name] = [float(f"{finite.size / sizes.size:.4g}"), *(float(f"{finite[at]:.6g}") for at in places)]
    return quantiles


V = TypeVar("V")


def prefetch(produced: Generator[V, None, None]) -> Generator[V, None, None]:
    """Yield the items of a generator; meanwhile a thread computes the next item. Its errors are raised here."""
    end = object()
    with ThreadPoolExecutor(1) as thread:
        following = thread.submit(next, produced, end)
        while (value := following.result()) is not end:
            following = thread.submit(next, produced, end)
            yield value  # type: ignore[misc]
