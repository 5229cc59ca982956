"""Measures the cases: their error on a crop, their first call, and their warm time and memory in full size."""

from __future__ import annotations

import platform
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from importlib.metadata import PackageNotFoundError, version
from itertools import groupby
from math import log10
from operator import attrgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.blur.cases import (
    PSFS,
    BenchGrid,
    Case,
    Peer,
    Scene,
    channels_of,
    crop_of,
    grid_cases,
    mean_taps,
    picture,
    scene_radii,
)
from benchmarks.blur.paces import Paces
from benchmarks.blur.passes import MeasuredPass
from benchmarks.blur.roofline import Roof, intensity, measure_roof, tap_rate
from clsco import __version__
from clsco.errors import DeviceError, SceneError
from clsco.opencl.device import Device
from clsco.opencl.program import Events
from clsco.opencl.session import Session
from clsco.optics.point_spread import point_spread
from clsco.optics.stencil import stencils
from clsco.passes.tables import shared_tables
from clsco.plan.methods import BlurSpec
from clsco.records import Real
from clsco.reference.blur.blur import prepare_sources, scatter
from clsco.reference.trace.trace import Sources
from clsco.scene.model import Psf

Array = NDArray[Any]
REALS: dict[str, Real] = {"double": "double", "single": "float"}
TAP_BY_TAP = ("scatter", "tiles", "private", "bands")  # ways that leave out what goes beyond a crop
# Cases are held together up to this part of the device's memory; those of peers take about so many bytes per pixel.
BATCH_SHARE, PEER_BYTES = 8, 32


@dataclass(frozen=True)
class BenchRow(Case):
    """Measurements of one case; ns are medians per pixel and channel, None where there is no such figure.

    cost_ns: cpu_ns, but device_ns on a device that is no processor; cpu_ns: process CPU time; device_ns, kernels_ns:
    between the events of the kernels; first_call_s: with programs and tables, on the crop; rms_error, largest_error: of
    white, on the crop of crop_px a side; psnr_db: of white, None without
    error; calls: that were timed; taps: per pixel, mean; gflop_per_s: two per tap, by device_ns; of_peak: of the
    measured multiply-adds; on_front: no other row of the same task is as fast and as close, and better in one of them.
    """

    cost_ns: float
    cpu_ns: float
    wall_ns: float
    device_ns: float | None
    kernels_ns: dict[str, float]
    first_call_s: float
    crop_px: int
    rms_error: float
    largest_error: float
    psnr_db: float | None
    device_bytes: int | None
    calls: int
    taps: float
    flop_per_byte: float
    gflop_per_s: float | None
    of_peak: float | None
    on_front: bool


@dataclass(frozen=True)
class Bench:
    """A whole run: device and versions, ceilings, rows, and cases that were left out, with the reason."""

    device: dict[str, Any]
    versions: dict[str, str]
    settings: dict[str, Any]
    roof: Roof
    rows: list[BenchRow]
    left_out: list[dict[str, Any]]
    peak_rss_bytes: int | None


@dataclass(frozen=True)
class _FirstCall:
    """Measurements of a case on its crop."""

    first_call_s: float
    crop_px: int
    rms: float
    largest: float
    warm_s: float


@dataclass(frozen=True)
class _Ready:
    """A case that is set up and warm in full size."""

    case: Case
    first: _FirstCall
    call: Callable[[Events], Array]
    device_bytes: int | None
    cpu: list[float]
    wall: list[float]
    kernels: list[dict[str, float]]

    @property
    def bytes(self) -> int:
        """Bytes that the case holds until it is timed, with its own copy of the image, approximately."""
        pixels = self.case.size**2
        own = PEER_BYTES * pixels if self.device_bytes is None else self.device_bytes
        return own + 4 * self.case.channels * pixels


def run(grid: BenchGrid, device: Device, peers: Sequence[Peer], advance: Callable[[], object]) -> Bench:
    """Measure a grid on a device, beside its peers.

    advance: called `steps` times on the way. Raises DeviceError, KernelError.
    """
    rows: list[BenchRow] = []
    left_out: list[dict[str, Any]] = []
    batch: list[_Ready] = []
    paces = Paces(grid)
    with Session(device) as session:
        roof = measure_roof(session)
        for case in _cases(grid, device, peers):
            ready = paces.objection(case) or _ready(case, session, grid.longest_s, paces, peers)
            advance()
            if isinstance(ready, str):
                left_out.append(asdict(case) | {"why": ready})
                for _ in range(grid.rounds):
                    advance()
                continue
            batch.append(ready)
            if sum(held.bytes for held in batch) > device.global_mem // BATCH_SHARE:
                rows += _timed(batch, grid, roof, device, advance)
                batch = []
        rows += _timed(batch, grid, roof, device, advance)
    settings = asdict(grid) | {"psfs": {name: psf.model_dump() for name, psf in PSFS.items()}}
    return Bench(described(device), versions(), settings, roof, with_fronts(rows), left_out, _peak_rss())


def steps(grid: BenchGrid, device: Device, peers: Sequence[Peer]) -> int:
    """Number of times that `run` calls `advance`."""
    return len(_cases(grid, device, peers)) * (1 + grid.rounds)


def _cases(grid: BenchGrid, device: Device, peers: Sequence[Peer]) -> list[Case]:
    """Cases of a grid that the device can do: `gather` is made for processors."""
    found = grid_cases(grid, device.has_fp64, peers)
    return [case for case in found if device.kind != "gpu" or case.method != "gather"]


def front(costs: Sequence[float], errors: Sequence[float]) -> list[bool]:
    """Mark the points that no other point beats: none is as good in both and better in one (Pareto)."""
    on = [False] * len(costs)
    best = (np.inf, np.inf)
    for error, cost, k in sorted(zip(errors, costs, range(len(costs)), strict=True), key=lambda point: point[1::-1]):
        if error < best[0] or (error, cost) == best:
            on[k], best = True, (error, cost)
    return on


def with_fronts(rows: Sequence[BenchRow]) -> list[BenchRow]:
    """The rows, with those marked that are on the front of their task."""
    of_task = attrgetter("task")
    found: list[BenchRow] = []
    for _, group in groupby(sorted(rows, key=of_task), key=of_task):
        alike = list(group)
        marks = front([row.cost_ns for row in alike], [row.rms_error for row in alike])
        found += [replace(row, on_front=on) for row, on in zip(alike, marks, strict=True)]
    return found


def _set_up(
    case: Case, image: Array, radii: Array, session: Session, peers: Sequence[Peer]
) -> Callable[[Events], Array]:
    if case.tool == "clsco":
        return MeasuredPass(session, image, radii, PSFS[case.psf], case.method, REALS[case.precision])
    (peer,) = (one for one in peers if (one.tool, one.method, one.psf) == (case.tool, case.method, case.psf))
    call = peer.set_up(image, radii)
    return lambda _: call()


def _first(case: Case, session: Session, first_call_s: float | None, peers: Sequence[Peer] = ()) -> _FirstCall:
    """Run a case on its crop, the first time with nothing made before, and compare it with the reference.

    first_call_s: of the same at another size, which is not measured again.
    """
    crop = crop_of(case.size, case.radius, PSFS[case.psf])
    image = channels_of(picture(case.size)[crop], case.channels)
    radii = np.ascontiguousarray(scene_radii(case.size, case.radius, case.scene)[crop])
    if first_call_s is None:
        shared_tables().clear()
        stencils.cache_clear()
        start = time.perf_counter()
        with Session(session.device) as alone:
            _set_up(case, image, radii, alone, peers)([])
            first_call_s = time.perf_counter() - start
    call = _set_up(case, image, radii, session, peers)
    found = call([])
    warm = min(_seconds(call), _seconds(call))  # what slows the machine briefly must not leave a case out
    exact = _exact(case.size, case.radius, case.scene, case.psf)
    error = found.astype(np.float64) - channels_of(exact, case.channels)
    rms, largest = float(np.sqrt(np.mean(error**2))), float(np.abs(error).max())
    return _FirstCall(first_call_s, len(radii), rms, largest, warm)


@lru_cache(maxsize=1)
def _exact(size: int, radius: float, scene: Scene, psf: str) -> Array:
    """The reference's crop (rows, columns, 3), which all methods, precisions and channels share."""
    crop = crop_of(size, radius, PSFS[psf])
    return reference(picture(size)[crop], scene_radii(size, radius, scene)[crop], PSFS[psf])


def reference(image: Array, radii: Array, psf: Psf) -> Array:
    """Linear radiance (rows, columns, channels) blurred by radii in px (rows, columns), in float64."""
    valid = np.ones(radii.shape, bool)
    gradient = prepare_sources(radii, valid)
    sources = Sources(image.astype(np.float64), np.ones(radii.shape), valid.astype(np.uint8), radii, gradient, valid)
    spec = BlurSpec(point_spread(psf), "gather", 0.0, float(np.abs(radii).max()), tilt=psf.tilt)
    return scatter(spec, sources, None, (image.shape[0], image.shape[1]), 0)


def _ready(case: Case, session: Session, longest_s: float, paces: Paces, peers: Sequence[Peer] = ()) -> _Ready | str:
    """Set a case up in full size and call it a first time; or why it is left out."""
    first = _first(case, session, paces.first_call_s.get(case.kind), peers)
    paces.first_call_s[case.kind] = first.first_call_s
    if why_not := paces.crop_objection(case, first.warm_s):
        return why_not
    about = _by_crop(case, first)
    paces.note(case, about)
    if about > longest_s:
        return f"a call must take {longest_s:g} s at most; got about {about:.2g} s, by its crop"
    image = channels_of(picture(case.size), case.channels)
    try:
        call = _set_up(case, image, scene_radii(case.size, case.radius, case.scene), session, peers)
        warm = _seconds(call)
        if warm > longest_s:
            warm = _seconds(call)  # the first one may compile
        paces.note(case, warm)
        if warm > longest_s:
            return f"a call must take {longest_s:g} s at most; got {warm:.2g} s"
    except (DeviceError, SceneError) as error:
        return str(error)
    return _Ready(case, first, call, call.bytes if isinstance(call, MeasuredPass) else None, [], [], [])


def _by_crop(case: Case, first: _FirstCall) -> float:
    """About how long a call in full size takes: taps that leave the crop cost as much, or nothing."""
    psf, crop = PSFS[case.psf], first.crop_px
    if case.method in TAP_BY_TAP:
        return first.warm_s * (case.size / crop) ** 2 * max(1.0, mean_taps(psf, case.radius, case.scene) / crop**2)
    return first.warm_s * (case.size / (crop + 2.0 * float(case.radius * point_spread(psf).extent))) ** 2


def _seconds(call: Callable[[Events], Array]) -> float:
    start = time.perf_counter()
    call([])
    return time.perf_counter() - start


def _timed(
    batch: Sequence[_Ready], grid: BenchGrid, roof: Roof, device: Device, advance: Callable[[], object]
) -> list[BenchRow]:
    """Call all of a batch once, then all again, and so on: what slows the machine for a while slows all alike."""
    for _ in range(grid.rounds):
        for ready in batch:
            if ready.wall and ready.wall[0] > grid.once_s:
                advance()
                continue
            events: Events = []
            wall, cpu = time.perf_counter(), time.process_time()
            ready.call(events)
            ready.cpu.append(time.process_time() - cpu)
            ready.wall.append(time.perf_counter() - wall)
            spent: dict[str, float] = defaultdict(float)
            for name, event in events:
                spent[name] += event.profile.end - event.profile.start
            ready.kernels.append(spent)
            advance()
    return [_row(ready, roof, device) for ready in batch]


def _row(ready: _Ready, roof: Roof, device: Device) -> BenchRow:
    case, first = ready.case, ready.first
    values = case.size**2 * case.channels
    cpu, wall = (1e9 * float(np.median(seconds)) / values for seconds in (ready.cpu, ready.wall))
    kernels = {name: float(np.median([spent[name] for spent in ready.kernels])) / values for name in ready.kernels[0]}
    on_device = sum(kernels.values()) if kernels else None
    taps = mean_taps(PSFS[case.psf], case.radius, case.scene)
    rate = tap_rate(taps, on_device) if on_device else None
    return BenchRow(
        **asdict(case),
        cost_ns=cpu if on_device is None or device.kind == "cpu" else on_device,
        cpu_ns=cpu,
        wall_ns=wall,
        device_ns=on_device,
        kernels_ns=kernels,
        first_call_s=first.first_call_s,
        crop_px=first.crop_px,
        rms_error=first.rms,
        largest_error=first.largest,
        psnr_db=-20.0 * log10(first.rms) if first.rms else None,
        device_bytes=ready.device_bytes,
        calls=len(ready.wall),
        taps=taps,
        flop_per_byte=intensity(taps),
        gflop_per_s=rate,
        of_peak=rate / roof.gflop_per_s if rate else None,
        on_front=False,
    )


def described(device: Device) -> dict[str, Any]:
    """Entries of a report on a device."""
    names = ("name", "platform", "platform_version", "driver", "kind", "compute_units", "global_mem", "has_fp64")
    return {name: getattr(device, name) for name in names}


def versions(packages: Sequence[str] = ()) -> dict[str, str]:
    """Versions of what a benchmark used: Python, NumPy, pyopencl, and `packages` as far as they are installed."""
    found = {"clsco": __version__, "python": platform.python_version()}
    for package in ("numpy", "pyopencl", *packages):
        with suppress(PackageNotFoundError):
            found[package] = version(package)
    return found


def _peak_rss() -> int | None:
    """Most memory in bytes that the process has had at a time; None on Windows, which does not report it this way."""
    if sys.platform == "win32":
        return None
    import resource

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)
