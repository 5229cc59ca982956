"""Builds programs from kernel text, and launches kernels."""

from __future__ import annotations

import logging
import re
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import partial
from math import prod
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from clsco.constants import definitions
from clsco.errors import DeviceError, KernelError
from clsco.opencl import pace, source_text
from clsco.opencl.device import failure
from clsco.opencl.features import FEATURES
from clsco.opencl.self_test import require_right_arguments
from clsco.opencl.session import Kernels, Session
from clsco.opencl.source_text import Structs, without_output
from clsco.records import Real, structs
from clsco.resources import folder

_LOG = logging.getLogger("clsco")
FIRST = 8  # the first piece is at most 1 / FIRST of a launch, because its parts may take different times
Argument: TypeAlias = cl.Buffer | np.generic | NDArray[np.void] | None
Events: TypeAlias = list[tuple[str, cl.Event]]  # names of kernels, and the events of their launches
# Files that precede all others: common functions, of which processors have a form of their own, and declarations that
# replace the header of PoCL's compiler. WITHOUT_HEADER is the option that omits this header.
BUILTINS, POCL_DECLARATIONS, WITHOUT_HEADER = "common/builtins.clh", "common/cpu/pocl.clh", "-D_OPENCL_H_"


def build(session: Session, source: str, features: Mapping[str, int | bool], structs: Structs, real: Real) -> Kernels:
    """Build a kernel file with all that it includes; equal requests share kernels, even if files have changed since.

    source: name of a file in kernels/, such as "trace/cast.cl". features: small integers or bools by names from
    `clsco.opencl.features.FEATURES`, by default 0; not for values that often change, as a new value needs a
    compilation. structs: NumPy dtypes by C names, as for `struct_text`; a struct follows the structs that it contains.
    real: element type of `real` and of `real2` to `real16`.

    Kernels get these definitions: the numbers of `clsco.constants`, features, real, real2, real3, real4, real8, real16,
    REAL_IS_DOUBLE, HAS_FP64, HAS_INT64_ATOMICS, VECTOR_WIDTH (floats in the device's widest vector; affects only time).

    Raises KernelError with the compiler's log. Raises DeviceError if `real` is "double" and the device lacks it, or if
    a driver other than PoCL fails `require_right_arguments` at the first program of a session.
    """
    request = folder("kernels"), source, tuple(features.items()), tuple(structs.items()), real
    with session.lock:
        if not session.programs and not session.device.is_pocl:
            require_right_arguments(session)
        if request not in session.requests:
            macros = dict.fromkeys(FEATURES, 0) | {name: int(value) for name, value in features.items()}
            session.requests[request] = _built(session, source, macros, structs, real)
        return session.requests[request]


def _built(session: Session, source: str, macros: dict[str, int], structs: Structs, real: Real) -> Kernels:
    """`build` without the cache of requests; requests that lead to the same text still share a program."""
    device = session.device
    if real == "double" and not device.has_fp64:
        raise DeviceError(f"precision: double needs a device with fp64, use single; got {device}")
    files = [*[POCL_DECLARATIONS] * device.is_pocl * (device.kind == "cpu"), BUILTINS, source]
    facts = device.has_fp64, device.has_int64_atomics, macros | definitions(), device.kind == "cpu"
    text = source_text.program_text(files, structs, real, *facts)
    words = set(re.findall("[A-Z][A-Z_]+", re.sub("//.*", "", text)))
    values = definitions() | {name: macros[name] for name in sorted(macros.keys() & words)}
    options = [f"-D{name}={value}" for name, value in values.items()]
    options.append("-cl-std=CL1.2")
    if real == "float":  # otherwise constants such as 0.5 would make expressions double
        options.append("-cl-single-precision-constant")
    options.append(f"-DVECTOR_WIDTH={device.vector_width}")
    if device.correctly_rounded:
        options.append("-cl-fp32-correctly-rounded-divide-sqrt")
    key = text, *options
    if key not in session.programs:
        session.doing(f"compiling {source}")
        with session.compiling():
            session.programs[key] = _compile_for_device(session, source, text, options)
    return session.programs[key]


def launch(
    session: Session, kernel: cl.Kernel, global_size: tuple[int, ...], local_size: tuple[int, ...], *args: Argument,
    work: float = 1.0, origin: tuple[int, ...] = (),
) -> list[cl.Event]:  # fmt: skip
    """Enqueue a kernel over at least `global_size` work-items; returns the events of its pieces, in order.

    Long launches are cut into pieces of whole groups that take a fraction of a second, so that Ctrl-C and cancellation
    act quickly; a kernel must not depend on the number of groups. global_size is rounded up to whole groups of
    local_size, so the kernel must ignore work-items beyond it. Use the same local_size for all launches of a kernel, as
    the driver compiles the kernel again for each new one. args: arguments in the kernel's order. work: units of work
    per work-item, 1 for about the usual work of a pixel. origin: number of the first work-item along each axis, by
    default 0. Raises DeviceError if the device cannot run the kernel, and CanceledError before a piece.
    """
    groups = tuple([-(-size // group) for size, group in zip(global_size, local_size, strict=True)])
    padded = tuple([count * group for count, group in zip(groups, local_size, strict=True)])
    work, most = work * prod(padded), max(groups)
    expected = session.pace.expected(kernel, work)
    if expected <= pace.PIECE or most <= 1:
        event = launch_whole(session, kernel, padded, local_size, *args, offset=origin if any(origin) else None)
        session.pace.record_launch(kernel, work, [event], expected)
        return [event]
    axis, events, begin, end = groups.index(most), list[cl.Event](), 0, 0
    piece = max(1, min(most // FIRST, int(most * pace.PIECE / expected)))
    while end < most:
        session.go_on()
        before, begin, end = end - begin, end, min(end + piece, most)
        size, offset = list(padded), list(origin or (0,) * len(padded))
        size[axis], offset[axis] = (end - begin) * local_size[axis], offset[axis] + begin * local_size[axis]
        begins = tuple(offset) if any(offset) else None
        events.append(launch_whole(session, kernel, tuple(size), local_size, *args, offset=begins))
        if len(events) > 1:  # one piece is enqueued while the previous one runs
            events[-2].wait()
            piece = pace.next_size(before, pace.event_seconds(events[-2]))
        if session.progress is not None:
            session.progress.share = end / most
    session.pace.record_launch(kernel, work, events, pace.PIECE)
    return events


def launch_whole(
    session: Session, kernel: cl.Kernel, size: tuple[int, ...], local_size: tuple[int, ...], *args: Argument,
    offset: tuple[int, ...] | None = None,
) -> cl.Event:  # fmt: skip
    """Enqueue a kernel in one piece over `size` work-items, a multiple of local_size, from work-item `offset` on."""
    # PoCL compiles a kernel at its first launch with a local size and, if the user has enabled these variants, at its
    # first one with a small grid or an offset (clsco.opencl.pocl_cache).
    shape = (kernel, local_size, max(size) < 2**16, offset is None)
    try:
        with session.lock:  # no other thread may set arguments before the launch
            if shape in session.compiled:
                return kernel(session.queue, size, local_size, *args, global_offset=offset)
            session.doing(f"compiling {kernel.function_name}")
            with session.compiling():
                event = kernel(session.queue, size, local_size, *args, global_offset=offset)
                session.queue.finish()  # the compiler runs in the queue, not in the call
            session.compiled.add(shape)
            return event
    except cl.Error as error:
        raise failure(session.device, f"run {kernel.function_name}", error) from error


class Target:
    """Kernels of some files in a session; each file is built when one of its kernels is first used.

    So a file that a scene does not need is not compiled, and scenes share what depends on none of their differences.
    `target[name]` is the kernel `name`; it raises what `build` raises, and KernelError if no file has the kernel.
    features: as for `build`; real: precision of the geometry.
    """

    def __init__(self, session: Session, files: Sequence[str], features: Mapping[str, int | bool], real: Real) -> None:
        self.session, self.real = session, real
        self._kernels: Kernels = {}
        self._builds = {
            name: partial(build, session, file, features, structs(real), real)
            for file in files
            for name in source_text.kernel_names(Path(str(folder("kernels"))), file)
        }
        session.offered.update((name, real, *features.values()) for name in self._builds)

    def __getitem__(self, name: str) -> cl.Kernel:
        if name not in self._kernels:
            self._kernels |= self._builds[name]() if name in self._builds else {}
        if name not in self._kernels:
            raise KernelError(f"kernel: must be one of {', '.join(sorted(self._builds))}; got {name}")
        return self._kernels[name]

    def run(
        self, name: str, size: tuple[int, ...], local: tuple[int, ...], events: Events, *args: Any, work: float = 1.0,
        origin: tuple[int, ...] = (),
    ) -> None:  # fmt: skip
        """Enqueue a kernel by `launch`; append pairs of its name and an event to `events`."""
        for event in launch(self.session, self[name], size, local, *args, work=work, origin=origin):
            events.append((name, event))


def _compile_for_device(session: Session, where: str, text: str, options: list[str]) -> Kernels:
    if session.device.is_pocl and session.device.kind == "cpu":
        with suppress(KernelError):  # with another version of PoCL, or an undeclared function
            return _compile(session, where, text, [*options, WITHOUT_HEADER])
    return _compile(session, where, text, options)


def _compile(session: Session, where: str, text: str, options: list[str]) -> Kernels:
    with without_output():
        try:
            began = time.perf_counter()
            kernels = cl.Program(session.context, text).build(options).all_kernels()
            if not kernels:  # PoCL 3.0 fails silently to read some programs in its cache
                anew = [*options, f"-DBUILT_ANEW={time.time_ns()}"]
                kernels = cl.Program(session.context, text).build(anew).all_kernels()
            _LOG.info("%s: built in %.2f s", where, time.perf_counter() - began)
            return {kernel.function_name: kernel for kernel in kernels}
        except cl.Error as error:
            _LOG.info("%s", error)  # the full error contains about 80 options
            raise KernelError(f"{where}: must build on {session.device}; got\n{_fault_of(error)}") from error


def _fault_of(error: cl.Error) -> str:
    """The compiler's log in an OpenCL error, without the compiler's options and the text before the log."""
    head, _, log = str(error).partition("(options:")[0].partition(">:\n\n")
    return (log or head).strip()
