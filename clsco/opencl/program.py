"""Kernel text to built program, launches, and arrays to the device and back."""

from __future__ import annotations

import logging
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import cache
from math import prod
from typing import Any, Literal, TypeAlias

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from clsco.constants import definitions
from clsco.errors import DeviceError, KernelError
from clsco.opencl import pace, source_text
from clsco.opencl.device import failure
from clsco.opencl.pieces import in_pieces
from clsco.opencl.self_test import require_right_arguments
from clsco.opencl.session import Program, Session
from clsco.opencl.source_text import without_output
from clsco.resources import folder

_LOG = logging.getLogger("clsco")
Argument: TypeAlias = cl.Buffer | np.generic | NDArray[np.void] | None
HEADERS = ("common/distortion.clh", "common/geometry.clh")
# Built before all others: in OpenCL C 1.2, or for a processor in what its compiler makes more of.
BUILTINS, CPU_BUILTINS = "common/builtins.clh", "common/cpu/builtins.clh"
# On processors with PoCL before these, for its own header, which the option leaves out.
POCL_DECLARATIONS, WITHOUT_HEADER = "common/cpu/pocl.clh", "-D_OPENCL_H_"
# With the feature OCCLUDED, after one of two: taps one by one, or in the vectors of `gather`.
SINGLE_TAPS, GATHERED_TAPS = "common/lanes.clh", "common/cpu/lanes.clh"
TAP_BLOCKS = "common/cpu/blocks.clh"
OCCLUSION_HEADERS = tuple(f"common/{name}.clh" for name in ("occluder", "visibility", "rims", "visibility_test"))
SPREAD_HEADERS = ("common/chords.clh", "common/psf.clh", "common/source_visibility.clh")
OF_SOURCES = ("taps", "ellipses", "gaussians", "columns")
GATHER_HEADERS = tuple(f"blur/cpu/{name}.clh" for name in ("vectors", "many", *OF_SOURCES, "spans"))
# With the feature TEXTURED.
MAPPING_HEADERS = ("common/angles.clh", *(f"trace/{name}.clh" for name in ("mapping", "footprint", "detail")))
HEADERS_OF = {
    "trace/trace.cl": (
        "common/sources.clh",
        *MAPPING_HEADERS,
        "trace/light.clh",
        "trace/texture.clh",
        "trace/outline.clh",
        "trace/small.clh",
        "trace/still.clh",
    ),
    "trace/truth.cl": (*MAPPING_HEADERS, "trace/light.clh", "trace/texture.clh"),
    "blur/blur.cl": ("common/sources.clh", *SPREAD_HEADERS),
    "blur/cpu/gather.cl": (
        "common/sources.clh",
        *SPREAD_HEADERS,
        *GATHER_HEADERS,
    ),
    "blur/tiles.cl": ("common/sources.clh", *SPREAD_HEADERS),
    "sensor/sensor.cl": ("sensor/noise.clh",),
    "inpainting/fill.cl": ("inpainting/lanes.clh", "inpainting/estimate.clh"),
    "inpainting/mean_median.cl": ("inpainting/lanes.clh", "inpainting/estimate.clh"),
    "inpainting/fse.cl": ("inpainting/lanes.clh",),
}
# What processors have in a form of their own.
CPU_FORMS = {BUILTINS: CPU_BUILTINS, "inpainting/lanes.clh": "inpainting/cpu/lanes.clh"}


@cache
def _constants() -> tuple[str, ...]:
    """Options that define the numbers of `clsco.constants`."""
    return tuple(f"-D{name}={value}" for name, value in definitions().items())


def build(
    session: Session,
    sources: Sequence[str],
    features: Mapping[str, int | bool],
    structs: Mapping[str, np.dtype[Any]],
    real: Literal["double", "float"],
) -> Program:
    """Build kernel files, after the shared headers, into a program; the same request gives the same program, although
    files have changed since.

    sources: names of files in kernels/, such as "trace/trace.cl". features: NAME -> small integer or bool, given to
    the compiler as -DNAME=value; structure only, since each set of values is compiled anew. structs: C name
    -> NumPy dtype, as `struct_text` takes them, nested ones after their parts. real: what `real` and `real2`
    to `real16` mean.

    Defined for the kernels: the numbers of `clsco.constants`, real, real2, real3, real4, real8, real16, REAL_IS_DOUBLE,
    HAS_FP64, HAS_INT64_ATOMICS, VECTOR_WIDTH (floats of the device's widest vector, which may change the time and no
    result).
    Raises KernelError with the compiler's log, DeviceError where `real` is double and the device has none, or where the
    driver, of another one than PoCL, fails `require_right_arguments` at the first program.
    """
    request = folder("kernels"), tuple(sources), tuple(features.items()), tuple(structs.items()), real
    with session.lock:
        if not session.programs and not session.device.is_pocl:
            require_right_arguments(session)
        if request not in session.programs:
            session.programs[request] = _program(session, sources, features, structs, real)
        return session.programs[request]


def _program(
    session: Session,
    sources: Sequence[str],
    features: Mapping[str, int | bool],
    structs: Mapping[str, np.dtype[Any]],
    real: Literal["double", "float"],
) -> Program:
    """See `build`."""
    device = session.device
    if real == "double" and not device.has_fp64:
        raise DeviceError(f"precision: double needs a device with fp64, use single; got {device}")
    headers = [BUILTINS, *HEADERS]
    if features.get("OCCLUDED"):
        gathers = features.get("GATHER")
        headers += [GATHERED_TAPS if gathers else SINGLE_TAPS, *OCCLUSION_HEADERS, *[TAP_BLOCKS] * bool(gathers)]
    others = dict.fromkeys(header for source in sources for header in HEADERS_OF.get(source, ()))
    headers += (header for header in others if features.get("TEXTURED") or header not in MAPPING_HEADERS)
    if device.kind == "cpu":
        headers = [*[POCL_DECLARATIONS] * device.is_pocl, *(CPU_FORMS.get(header, header) for header in headers)]
    text = source_text.program_text([*headers, *sources], structs, real, device.has_fp64, device.has_int64_atomics)
    options = [*_constants()]
    options += [f"-D{name}={int(value)}" for name, value in sorted(features.items())]
    options.append("-cl-std=CL1.2")
    if real == "float":  # else 0.5 is a double, and so is the arithmetic around it
        options.append("-cl-single-precision-constant")
    options.append(f"-DVECTOR_WIDTH={device.vector_width}")
    if device.correctly_rounded:
        options.append("-cl-fp32-correctly-rounded-divide-sqrt")
    session.doing(f"compiling {', '.join(sources)}")
    with session.compiling():
        return _built(session, ", ".join(sources), text, options)


def kernel(program: Program, name: str) -> cl.Kernel:
    """The kernel `name` of a built program. Raises KernelError when it has none of this name."""
    if name not in program:
        raise KernelError(f"kernel: must be one of {', '.join(sorted(program))}; got {name}")
    return program[name]


def launch(
    session: Session,
    kernel: cl.Kernel,
    global_size: tuple[int, ...],
    local_size: tuple[int, ...],
    *args: Argument,
    work: float = 1.0,
    origin: tuple[int, ...] = (),
) -> list[cl.Event]:
    """Enqueue a kernel over at least `global_size` work-items and return its events; in order with all others.

    What takes long is cut into pieces of whole groups (`clsco.opencl.pieces`), so a kernel must not depend on how many
    there are. global_size is rounded up to whole groups of local_size, so the kernel's first statement has to be a
    guard. local_size is fixed by the kernel, since each new one is compiled anew. args: buffers or None, NumPy
    scalars, scalars of a structured dtype, in the kernel's order. work: of a work-item, 1 where it does about as much
    as others do for a pixel. origin: number of the first work-item along each axis, by default 0. Raises DeviceError
    when the device cannot run it, CanceledError between two pieces.
    """
    groups = tuple([-(-size // group) for size, group in zip(global_size, local_size, strict=True)])
    padded = tuple([count * group for count, group in zip(groups, local_size, strict=True)])
    work, most = work * prod(padded), max(groups)
    expected = session.pace.expected(kernel, work)
    if expected <= pace.PIECE or most <= 1:
        event = launch_whole(session, kernel, padded, local_size, *args, offset=origin if any(origin) else None)
        session.pace.launched(kernel, work, [event], expected)
        return [event]
    axis = groups.index(most)

    def enqueue(begin: int, end: int) -> cl.Event:
        size, offset = list(padded), list(origin or (0,) * len(padded))
        size[axis], offset[axis] = (end - begin) * local_size[axis], offset[axis] + begin * local_size[axis]
        begins = tuple(offset) if any(offset) else None
        return launch_whole(session, kernel, tuple(size), local_size, *args, offset=begins)

    return in_pieces(session, kernel, most, work, expected, enqueue)


def launch_whole(
    session: Session, kernel: cl.Kernel, size: tuple[int, ...], local_size: tuple[int, ...], *args: Argument,
    offset: tuple[int, ...] | None = None,
) -> cl.Event:  # fmt: skip
    """Enqueue a kernel at once over `size` work-items, whole groups; offset: number of the first one. As `launch`."""
    # PoCL compiles a kernel at its first launch, for a local size, and other times for small grids and an offset where
    # the user has it do so (clsco.opencl.pocl_cache).
    shape = (kernel, local_size, max(size) < 2**16, offset is None)
    try:
        with session.lock:  # a kernel's arguments and its launch belong together
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


def _built(session: Session, where: str, text: str, options: list[str]) -> Program:
    if session.device.is_pocl and session.device.kind == "cpu":
        with suppress(KernelError):  # of a version whose header is another one, or a kernel that calls something else
            return _compiled(session, where, text, [*options, WITHOUT_HEADER])
    return _compiled(session, where, text, options)


def _compiled(session: Session, where: str, text: str, options: list[str]) -> Program:
    with without_output():
        try:
            began = time.perf_counter()
            kernels = cl.Program(session.context, text).build(options).all_kernels()
            if not kernels:  # PoCL 3.0 cannot read some of the programs that it has kept, and says nothing
                anew = [*options, f"-DBUILT_ANEW={time.time_ns()}"]
                kernels = cl.Program(session.context, text).build(anew).all_kernels()
            _LOG.info("%s: built in %.2f s", where, time.perf_counter() - began)
            return {kernel.function_name: kernel for kernel in kernels}
        except cl.Error as error:
            raise KernelError(f"{where}: must build on {session.device}; got\n{error}") from error
