"""OpenCL devices: which there are, which one is used and why, what it can do, and a queue on it."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from dataclasses import dataclass, field
from functools import lru_cache
from types import TracebackType
from typing import Literal, Self, TypeAlias

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from clsco import poclcache, poclcpu
from clsco.errors import DeviceError

NO_DEVICE = (
    "device: OpenCL needs a driver, and none with a device was found; "
    'install PoCL for the processor with `pip install "clsco[pocl]"`, or your GPU vendor\'s OpenCL driver'
)
_POCL = "Portable Computing Language"
_SHORT_OF_MEMORY = ("ALLOCATION_FAILURE", "OUT_OF_RESOURCES", "OUT_OF_HOST_MEMORY", "INVALID_BUFFER_SIZE")
_REASONS = (
    "the first GPU",
    "PoCL, as there is no GPU",
    "the first processor, as there is neither a GPU nor PoCL",
    "the first device, as there is neither a GPU nor a processor",
)

Program: TypeAlias = dict[str, cl.Kernel]
"""A built program: its kernels by name. Looking a kernel up in OpenCL costs 0.2 ms, so they are kept."""


@dataclass(frozen=True)
class Device:
    """An OpenCL device and what clsco has to know about it; sizes in bytes."""

    name: str
    platform: str
    platform_version: str
    driver: str
    kind: Literal["gpu", "cpu", "accelerator"]
    has_fp64: bool
    has_int64_atomics: bool
    correctly_rounded: bool
    """float32 division and square root can be had correctly rounded, as in NumPy."""
    unified_memory: bool
    """The device works in the host's memory, so that an aligned array needs no copy."""
    alignment: int
    max_alloc: int
    global_mem: int
    compute_units: int
    vector_width: int
    """Floats in the widest vector that it computes at once."""
    max_work_group: int
    handle: cl.Device = field(repr=False)

    @property
    def is_pocl(self) -> bool:
        return self.platform == _POCL

    def __str__(self) -> str:
        return f"{self.name} ({self.platform})"


@dataclass(frozen=True)
class Choice:
    """The device that would be used (None: there is no usable one) and the reason, in words."""

    device: Device | None
    reason: str


def list_devices(name: str | None = None) -> tuple[tuple[Device, ...], Choice]:
    """All OpenCL devices in the platforms' order, and which one `choose(name)` would use and why.

    Raises nothing: where no device can be chosen, the reason says so.
    """
    devices = _devices()
    try:
        return devices, pick(devices, name, os.environ, _by_pyopencl)
    except DeviceError as error:
        return devices, Choice(None, str(error))


def choose(name: str | None = None) -> Device:
    """The device to use: `name` > CLSCO_DEVICE > PYOPENCL_CTX > a GPU > PoCL > any other processor.

    Never prompts.
    `name` is a part of the device's or platform's name or version in any case, or "gpu" or "cpu".
    Raises DeviceError when no device is there or none matches.
    """
    chosen = pick(_devices(), name, os.environ, _by_pyopencl).device
    if chosen is None:
        raise DeviceError(NO_DEVICE)
    return chosen


def pick(
    devices: Sequence[Device],
    name: str | None,
    environ: Mapping[str, str],
    by_pyopencl: Callable[[str], cl.Device],
) -> Choice:
    """The rule of `choose`, on a given list and environment; `by_pyopencl` resolves a PYOPENCL_CTX."""
    if not devices:
        return Choice(None, NO_DEVICE)
    for source, wanted in (("--device", name), ("CLSCO_DEVICE", environ.get("CLSCO_DEVICE"))):
        if wanted:
            return Choice(_matching(devices, source, wanted), f'{source} is "{wanted}"')
    if specification := environ.get("PYOPENCL_CTX"):
        handle = by_pyopencl(specification)
        return Choice(described(handle), f'PYOPENCL_CTX is "{specification}"')
    best = min(devices, key=_rank)  # the first of equals, so the platforms' order decides
    return Choice(best, _REASONS[_rank(best)])


class Session:
    """A context and an in-order queue that times its commands, on one device, with the programs built in it;
    released by `close` or `with`.

    Not to be carried over a fork: PoCL would wait for ever, even with a new session, so that DeviceError is raised.
    Start processes by spawning. Safe to share between threads. `queue`: work in this queue and its context, for arrays
    that live there. Raises DeviceError when the device refuses a context.
    """

    def __init__(self, device: Device, queue: cl.CommandQueue | None = None) -> None:
        _not_forked()
        self.device = device
        self.lock = threading.RLock()
        self.programs: dict[str, Program] = {}
        """What `program.build` has built here, by text and options."""
        self.compiled: set[tuple[cl.Kernel, tuple[int, ...], bool]] = set()
        """Kernels and launch shapes that the driver has compiled already, kept by `program.launch`."""
        if device.is_pocl:
            poclcache.check()
            poclcpu.ensure_known(device.handle.version, device.handle.int_ptr)
        try:
            if queue is not None:
                self.context, self._queue = queue.context, queue
                return
            self.context = cl.Context([device.handle])
            timed = cl.command_queue_properties.PROFILING_ENABLE
            self._queue = cl.CommandQueue(self.context, properties=timed)
        except cl.Error as error:
            raise failure(device, "open a context and a queue", error) from error

    @property
    def queue(self) -> cl.CommandQueue:
        """The queue; raises DeviceError in a fork of the process that has opened it."""
        _not_forked()
        return self._queue

    def compiling(self) -> AbstractContextManager[None]:
        """To be held while the driver may compile: no other process then writes to its cache.

        Raises DeviceError where the disk is so full that PoCL would abort.
        """
        if not self.device.is_pocl:
            return nullcontext()
        if not poclcache.has_room():
            rule = f"the folder {os.environ[poclcache.VARIABLE]} must have {poclcache.ROOM >> 20} MiB for kernels"
            raise DeviceError(f"device {self.device}: {rule}; got a full disk")
        return poclcache.exclusive()

    def close(self) -> None:
        """Wait for the queue and let go of the programs; the context goes when its last buffer does."""
        with self.lock:
            self.queue.finish()
            self.compiled.clear()
            self.programs.clear()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is None:
            with self.telling():
                self.close()
            return
        with suppress(cl.Error, DeviceError):  # what came first is told
            self.close()
        if isinstance(error, cl.Error):
            raise failure(self.device, "go on", error) from error

    @contextmanager
    def telling(self) -> Iterator[None]:
        """Have what OpenCL raises in the block told as a DeviceError, when nothing runs any more that reads arrays.

        After an error other than a want of memory the context may be lost, so that `session_on` opens another one.
        """
        try:
            yield
        except BaseException as error:
            self.settle()
            told = failure(self.device, "go on", error) if isinstance(error, cl.Error) else error
            if isinstance(told, DeviceError) and not told.short_of_memory:
                session_on.cache_clear()
            if told is not error:
                raise told from error
            raise

    def settle(self) -> None:
        """Wait for the queue, whatever has come of it: arrays and buffers may go then."""
        with suppress(cl.Error, DeviceError):
            self.queue.finish()


# A context and its built programs, kept because they take longer than a small image does, and because PoCL does not
# give back the memory of a program that is released (2 MiB each).
@lru_cache(maxsize=4)
def session_on(device: Device) -> Session:
    """A session on a device, the same one as long as it is among the last four."""
    return Session(device)


@lru_cache(maxsize=4)
def session_of(queue: cl.CommandQueue) -> Session:
    """A session that works in a queue, the same one as long as it is among the last four."""
    return Session(described(queue.device), queue=queue)


def failure(device: Device, what: str, error: cl.Error | OSError) -> DeviceError:
    """The error to raise where a device fails: `what` it must do, and what OpenCL raised."""
    short = isinstance(error, cl.MemoryError | OSError) or any(word in str(error) for word in _SHORT_OF_MEMORY)
    return DeviceError(f"device {device}: must {what}; got {error}", short_of_memory=short)


_process: int | None = None  # the one in which OpenCL was asked for the first time


def _not_forked() -> None:
    """Raise DeviceError in a fork of a process that has asked OpenCL for anything: PoCL would wait for ever."""
    global _process
    _process = _process or os.getpid()
    if _process != os.getpid():
        rule = "OpenCL must be used in the process that began to, or in others that are started by spawning"
        raise DeviceError(f"device: {rule}; got a fork of process {_process}")


def _rank(device: Device) -> int:
    if device.kind == "gpu":
        return 0
    if device.is_pocl:
        return 1
    return 2 if device.kind == "cpu" else 3


def _matching(devices: Sequence[Device], source: str, wanted: str) -> Device:
    def matches(device: Device) -> bool:
        texts = (device.name, device.platform, device.platform_version)
        return wanted.lower() == device.kind or any(wanted.lower() in text.lower() for text in texts)

    found = [device for device in devices if matches(device)]
    if not found:
        there = ", ".join(map(str, devices))
        raise DeviceError(f'{source}: must be a part of the name of one of {there}; got "{wanted}"')
    return min(found, key=_rank)


def _by_pyopencl(specification: str) -> cl.Device:
    try:
        return cl.choose_devices(interactive=False, answers=specification.split(":"))[0]
    except (RuntimeError, cl.Error) as error:
        raise DeviceError(f'PYOPENCL_CTX: must name a platform and device; got "{specification}": {error}') from error


def _devices() -> tuple[Device, ...]:
    _not_forked()
    try:
        poclcache.prepare()  # PoCL reads the variable when its platform is first asked for
    except OSError as error:
        raise DeviceError(f"device: PoCL must have a folder for compiled kernels; got {error}") from error
    try:
        platforms = cl.get_platforms()
    except cl.LogicError:  # the loader's word for no driver at all
        return ()
    handles = []
    for platform in platforms:
        try:
            handles.extend(platform.get_devices())
        except cl.Error:  # a driver without its hardware
            continue
    return tuple(described(handle) for handle in handles)


def described(handle: cl.Device) -> Device:
    extensions = handle.extensions.split()
    kinds = cl.device_type
    return Device(
        name=handle.name.strip(),
        platform=handle.platform.name.strip(),
        platform_version=handle.platform.version.strip(),
        driver=handle.driver_version.strip(),
        # A simulator claims every kind at once: not to be mistaken for a GPU.
        kind="cpu" if handle.type & kinds.CPU else "gpu" if handle.type & kinds.GPU else "accelerator",
        has_fp64="cl_khr_fp64" in extensions,
        has_int64_atomics={"cl_khr_int64_base_atomics", "cl_khr_int64_extended_atomics"} <= set(extensions),
        correctly_rounded=bool(handle.single_fp_config & cl.device_fp_config.CORRECTLY_ROUNDED_DIVIDE_SQRT),
        unified_memory=bool(handle.type & kinds.CPU),
        alignment=handle.mem_base_addr_align // 8,
        max_alloc=handle.max_mem_alloc_size,
        global_mem=handle.global_mem_size,
        compute_units=handle.max_compute_units,
        vector_width=handle.native_vector_width_float,
        max_work_group=handle.max_work_group_size,
        handle=handle,
    )


@dataclass(frozen=True)
class Check:
    """One answer of `self_test`; `detail` says what came instead where it did not pass."""

    name: str
    passed: bool
    detail: str = ""


@dataclass(frozen=True)
class _Probe:
    name: str
    body: str
    """Statements of work-item i of 64, from `in` (float, in[i] = i) to `out` (long, zeros)."""
    expected: Callable[[NDArray[np.int64]], NDArray[np.int64]]
    needs: str | None = None


# (1 + i e)^2 - (1 + 2 i e) = i^2 e^2 with e = 2^-23: exact when fused, 0 when the square is rounded first,
# since i^2 e^2 < 2^-24 for i < 64.
_SQUARE = "float x = 1.0f + in[i] * 0x1p-23f, y = -(1.0f + in[i] * 0x1p-22f);"

_PROBES = (
    _Probe("float32 addition", "out[i] = (long)(in[i] + 1.0f);", lambda i: i + 1),
    _Probe(
        "int32 atomics",
        "atomic_add((volatile __global int *)out, i);",
        lambda i: np.where(i == 0, i.sum(), 0),
    ),
    _Probe(
        "int64 atomics",
        "atom_max(out, (long)i << 40);",
        lambda i: np.where(i == 0, i.max() << 40, 0),
        "has_int64_atomics",
    ),
    _Probe("fp64", "out[i] = (long)((1.0 + in[i] * 0x1p-50) * 0x1p50);", lambda i: 2**50 + i, "has_fp64"),
    _Probe("exact fma", f"{_SQUARE} out[i] = (long)(fma(x, x, y) * 0x1p46f);", lambda i: i * i),
    _Probe("no contraction", f"{_SQUARE} out[i] = (long)((x * x + y) * 0x1p46f);", lambda i: 0 * i),
)


def self_test(device: Device) -> list[Check]:
    """Build and run small kernels on a device: whether it computes what clsco relies on. Raises nothing of
    OpenCL's."""
    checks = []
    for probe in _PROBES:
        if probe.needs is not None and not getattr(device, probe.needs):
            continue  # not claimed, so not used
        try:
            got = _ran(device, probe.body)
        except (cl.Error, DeviceError) as error:
            checks.append(Check(probe.name, False, str(error).splitlines()[0]))
            continue
        wanted = probe.expected(np.arange(64, dtype=np.int64))
        wrong = np.flatnonzero(got != wanted)
        detail = f"work-item {wrong[0]}: must be {wanted[wrong[0]]}; got {got[wrong[0]]}" if wrong.size else ""
        checks.append(Check(probe.name, not wrong.size, detail))
    return checks


def _ran(device: Device, body: str) -> NDArray[np.int64]:
    pragmas = ["OPENCL FP_CONTRACT OFF"]
    if device.has_fp64:
        pragmas.append("OPENCL EXTENSION cl_khr_fp64 : enable")
    if device.has_int64_atomics:
        pragmas.append("OPENCL EXTENSION cl_khr_int64_extended_atomics : enable")
    lines = [f"#pragma {pragma}" for pragma in pragmas]
    lines.append("__kernel void probe(__global const float *in, __global long *out)")
    lines.append(f"{{ int i = get_global_id(0); {body} }}")
    given, got = np.arange(64, dtype=np.float32), np.zeros(64, np.int64)
    flags = cl.mem_flags.READ_WRITE | cl.mem_flags.COPY_HOST_PTR
    with Session(device) as session, session.compiling():
        buffers = [cl.Buffer(session.context, flags, hostbuf=array) for array in (given, got)]
        kernel = cl.Kernel(cl.Program(session.context, "\n".join(lines)).build(), "probe")
        kernel(session.queue, (64,), (64,), *buffers)
        cl.enqueue_copy(session.queue, got, buffers[1], is_blocking=True)
    return got
