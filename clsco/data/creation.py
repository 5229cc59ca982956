"""The function `clsco.data.make`, which the command `clsco dataset make` calls."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clsco import __version__
from clsco.data.containers import DEFAULT, container_named
from clsco.data.distribution import Distribution, DrawScene, ScriptedDistribution, load_distribution, scripted
from clsco.data.draws import SplitsLike
from clsco.data.manifest import Identity, shard_numbers
from clsco.data.pool import Place, places, run_pool
from clsco.data.record import parse_stored
from clsco.data.sets import DataSet, Status, check_resumable, finish
from clsco.data.storage import open_storage
from clsco.errors import ClscoError, DeviceError, SceneError
from clsco.frame.outputs import ATTRIBUTES, OF_THE_IMAGE
from clsco.frame.truth_files import array_names
from clsco.resources import machine_bytes
from clsco.scene.text import shown

if TYPE_CHECKING:
    from clsco.data.shards import SetJob

WORKER_SHARE = 0.5  # fraction of the machine's memory for all processes together
TRUTH = ("sharp", "depth", "coc")
MOST_SAMPLES = 10**12

DistributionLike = str | os.PathLike[str] | Mapping[str, Any] | DrawScene
Progress = Callable[[int], AbstractContextManager[Callable[[int], object]]]


class FailedSamplesError(ClscoError):
    """More samples of a set failed than allowed; status: progress of the set."""

    def __init__(self, message: str, status: Status) -> None:
        super().__init__(message)
        self.status = status


@dataclass(frozen=True)
class Workers:
    """Workers that make the shards of a set: processes of this machine, or workers of a cluster."""

    places: Sequence[Place]  # places of the processes; empty for a cluster
    family: str  # device family
    precision: str
    scheduler: str = ""  # address of the cluster's scheduler


def make(  # noqa: PLR0913, a parameter for each option
    distribution: DistributionLike, data: str | os.PathLike[str], *, count: int | None = None, seed: int = 0,
    truth: str | Iterable[str] = TRUTH, color: bool = True, types: str | Mapping[str, str] = "",
    splits: SplitsLike = None, split_by: str = "", format: str = DEFAULT, shard_size: int = 256,  # noqa: A002
    devices: str | Sequence[str] = (), workers: int | None = None, scheduler: str = "", precision: str | None = None,
    resume: bool = False, only: range | None = None, part: tuple[int, int] | None = None, overrides: Sequence[str] = (),
    folder: str | os.PathLike[str] | None = None, license: str = "", allow_failures: int = 0,  # noqa: A002
    progress: Progress | None = None,
) -> Status:  # fmt: skip
    """Make a data set of scenes drawn from a distribution.

    Parameters
    ----------
    distribution : path, mapping or callable
        A distribution file, its content, or a function `draw(rng, sample)`. `sample` is the number of a sample, and
        `rng` is a `numpy.random.Generator` seeded by `seed` and this number. The function returns a scene, as for
        `clsco.render`, or a list of scenes, the variants of the sample; or a tuple of either and a mapping of
        parameters. Define the function at the top of a module or script, because other processes import it.
    data : path
        Folder of the set, or an address like "s3://bucket/set".
    count : int
        Samples of the set.
    seed : int
        0 to 2^63 - 1.
    truth : str or iterable of str
        Names in files of the arrays besides color, such as "depth" and "coc".
    color : bool
        False makes only the arrays of `truth`; the image, which is most of the work, is not computed.
    types : str or mapping
        Stored type of each array: {"color": "float32"}, or "color=float32", stores linear radiance, not 16-bit codes.
    splits : str or mapping, optional
        Shares of the splits, such as {"train": 0.9, "test": 0.1} or "train=90,test=10".
    split_by : str
        Name of a parameter; samples with equal values of it are in the same split.
    format : str
        Format of the files: "webdataset", "npz", "hdf5" and so on, see docs/loading.md.
    shard_size : int
        Number of samples in a shard, which is one file (or folder) for each split.
    devices : str or sequence of str
        Parts of the names of the devices that render, or "all" for all devices of the best kind; by default the best
        device.
    workers : int, optional
        Number of processes; by default one for each graphics card, or for each core of a processor.
    scheduler : str
        Address of a dask.distributed cluster, like "tcp://host:8786", that renders instead of this machine.
    precision : {"double", "single"}, optional
        Precision of the geometry; by default double if the devices support it.
    resume : bool
        Continue the set in `data`.
    only : range, optional
        Numbers of the samples to make, instead of 0 to `count` - 1.
    part : (int, int), optional
        (I, N): make only every N-th shard, beginning with shard I; for array jobs.
    overrides : sequence of str
        Keys and values as for `clsco.load_scene`, unless the distribution is a function.
    folder : path, optional
        Base folder of relative paths of textures, unless the distribution is a file; by default the current folder.
    license : str
        Name of the license, for the data card.
    allow_failures : int
        Number of samples that may fail without an error.
    progress : callable, optional
        Called with the number of samples to make; returns a context manager. The manager returns a function that is
        called with the number of samples made since its last call.

    Returns
    -------
    Status
        Progress of the set: `made`, `failed`, `bytes`. `clsco.data.open(data)` opens it.

    Raises
    ------
    SceneError, DeviceError
        An argument is invalid; nothing is written.
    FailedSamplesError
        More than `allow_failures` samples failed. Finished shards stay, and the set can be resumed.
    ClscoError
        The set cannot be written, or devices fail. Finished shards stay, and the set can be resumed.

    Notes
    -----
    The same distribution, seed and version give the same bytes on all devices of a family. Processes are spawned, so a
    script must call this function under `if __name__ == "__main__":`.

    Examples
    --------
    >>> import clsco.data
    >>> ball = {"shape": "sphere", "center": [0, 0, 280], "radius": 30}
    >>> camera = {"resolution": [24, 16], "pixel_pitch": 0.2}
    >>> vary = {"camera": {"focus_distance": {"uniform": [220, 320]}}}
    >>> distribution = {"camera": camera, "object": [ball], "vary": vary}
    >>> clsco.data.make(distribution, "BALLS", count=2, workers=1)  # doctest: +SKIP
    <Status: 2 of 2 samples made, 0 failed>
    """
    from clsco.data.shards import SetJob

    container_named(format)
    samples, arrays = sample_numbers(count, only), stored_arrays(truth, color)
    base = None if folder is None else Path(folder)
    drawn: Distribution | ScriptedDistribution
    if not callable(distribution):
        drawn = load_distribution(distribution, overrides, splits, base, split_by)
    elif overrides:
        raise SceneError(f"overrides: are for files and their content, not for a function; got {overrides[0]}")
    else:
        drawn = scripted(distribution, splits, base, split_by)
    text = types if isinstance(types, str) else ",".join(f"{name}={each}" for name, each in types.items())
    stored = tuple(sorted(parse_stored(text).items()))
    if scheduler:
        from clsco.data.cluster import cluster_device

        makers = Workers((), *cluster_device(scheduler), scheduler)
    else:
        makers = workers_of([devices] if isinstance(devices, str) else devices, workers)
    precision = precision or makers.precision
    if precision not in ("double", "single"):
        raise SceneError(f'precision: must be "double" or "single"; got {shown(precision)}')
    for name, value, least, most in (("seed", seed, 0, 2**63 - 1), ("shard_size", shard_size, 1, 10**6)):
        if type(value) is not int or not least <= value <= most:
            raise SceneError(f"{name}: must be an integer between {least} and {most}; got {shown(value)}")
    identity = Identity(
        distribution=drawn.digest, seed=seed, first=samples.start, shard_size=shard_size, format=format, arrays=arrays,
        precision=precision, splits=tuple(drawn.splits), version=__version__, device_family=makers.family, types=stored,
    )  # fmt: skip
    job = SetJob(drawn, identity, samples, open_storage(data).where)
    index, parts = part or (0, 1)
    shards = [shard for shard in shard_numbers(samples, shard_size) if shard % parts == index]
    status, failures = _make_shards(job, shards, makers, resume or part is not None, license, progress)
    if len(failures) > allow_failures:
        first = f"the first, sample {failures[0]['number']}: {failures[0]['error']}"
        rule = f"at most {allow_failures} samples may fail" if allow_failures else "every sample must be made"
        of = sum(len(job.numbers(shard)) for shard in shards)
        raise FailedSamplesError(f"{os.fspath(data)}: {rule}; got {len(failures)} of {of} that failed; {first}", status)
    return status


def stored_arrays(truth: str | Iterable[str], color: bool = True) -> tuple[str, ...]:
    """Names in files of the arrays of a sample, in order. Raises SceneError."""
    names = {*array_names(truth)}
    if not color and (named := OF_THE_IMAGE.intersection(names) - {"color"}):
        raise SceneError(f"truth: without color no image is made, so it must be without {min(named)}; got it")
    names = names | {"color"} if color else names - {"color"}
    if not names:
        raise SceneError("truth: must name arrays, as without color nothing else is written; got none")
    return tuple(name for name in ATTRIBUTES if name in names)


def sample_numbers(count: int | None, only: range | None) -> range:
    """Numbers of the samples of a set. Raises SceneError."""
    if only is None:
        if type(count) is not int or not 0 < count <= MOST_SAMPLES:
            got = "nothing" if count is None else shown(count)
            raise SceneError(f"count: must be an integer between 1 and {MOST_SAMPLES}; got {got}")
        return range(count)
    if not only or only.step != 1 or only.start < 0:
        raise SceneError(f"only: must be a range of numbers from 0 on, one by one; got {only}")
    if count is not None and only.stop > count:
        raise SceneError(f"only: must lie within 0:{count}; got {only.start}:{only.stop}")
    return only


def workers_of(names: Sequence[str], count: int | None) -> Workers:
    """Processes of this machine on some devices; count: number of processes, None for the default number.

    names: parts of the names of devices; ("all",) for all devices of the best kind, () for the best device. Raises
    DeviceError if there is no such device, or the devices are of several families.
    """
    from clsco.data.shards import device_family
    from clsco.opencl.device import choose, list_devices

    devices, _ = list_devices()
    every = tuple(names) == ("all",)
    best = choose(names[0] if names and not every else None, "device")
    if every:
        chosen = [k for k, device in enumerate(devices) if (device.kind, device.platform) == (best.kind, best.platform)]
    else:
        chosen = [devices.index(choose(name, "device")) for name in names] or [devices.index(best)]
    families = {device_family(devices[k]): k for k in chosen}
    if len(families) > 1:
        raise DeviceError(f"device: all must be of one family, as bits are; got {' and '.join(families)}")
    where = places([(k, devices[k].kind == "cpu") for k in chosen], count)
    return Workers(where, next(iter(families)), "double" if best.has_fp64 else "single")


def _make_shards(
    job: SetJob, shards: Sequence[int], makers: Workers, resume: bool, license_text: str, progress: Progress | None
) -> tuple[Status, list[dict[str, Any]]]:
    """Make the missing shards among `shards`; returns the progress and the manifest lines of their failed samples."""
    storage = open_storage(job.where)
    storage.tidy()
    new = DataSet(storage, job.identity, job.samples)
    try:
        card = check_resumable(new, resume)
        by = {"split_by": job.distribution.split_by} if job.distribution.split_by else {}
        new.write({"license": license_text or card.get("license", ""), **job.distribution.about, **by})
        done = new.done(shards, storage.is_local, [])
        left = [shard for shard in shards if shard not in done]
        opened = nullcontext(lambda _: None) if progress is None else progress(sum(map(len, map(job.numbers, left))))
        with opened as advance:
            if left and makers.scheduler:
                from clsco.data.cluster import run_cluster

                run_cluster(job, left, makers.scheduler, advance)
            elif left:
                memory = int(WORKER_SHARE * machine_bytes() / len(makers.places))
                run_pool(job, left, makers.places, advance, memory)
        status = finish(new, shards)
        failures = [row for shard in shards if shard in status.done for row in new.lines(shard)[1]]
    finally:
        storage.tidy()  # removes the files of processes that had not ended at the first call
        storage.close()
    return status, failures
