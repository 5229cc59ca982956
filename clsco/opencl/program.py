"""Kernel text to built program, launches, and arrays to the device and back."""

from __future__ import annotations

import logging
import os
import time
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import cache
from math import prod
from typing import Any, Literal, TypeAlias

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from clsco.constants import definitions
from clsco.errors import DeviceError, KernelError
from clsco.opencl import pace
from clsco.opencl.device import failure
from clsco.opencl.pieces import in_pieces
from clsco.opencl.session import Program, Session
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
OCCLUSION_HEADERS = ("common/occluder.clh", "common/visibility.clh", "common/visibility_test.clh")
OF_SOURCES = ("discs", "quadrants", "cut", "shapes", "ellipses", "gaussians", "columns")
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
        "trace/still.clh",
    ),
    "trace/truth.cl": (*MAPPING_HEADERS, "trace/light.clh", "trace/texture.clh"),
    "blur/blur.cl": ("common/sources.clh", "common/psf.clh"),
    "blur/cpu/gather.cl": (
        "common/sources.clh",
        "common/psf.clh",
        *GATHER_HEADERS,
    ),
    "blur/tiles.cl": ("common/sources.clh", "common/psf.clh"),
    "sensor/sensor.cl": ("sensor/noise.clh",),
    "inpainting/fill.cl": ("inpainting/lanes.clh", "inpainting/estimate.clh"),
    "inpainting/mean_median.cl": ("inpainting/lanes.clh", "inpainting/estimate.clh"),
    "inpainting/fse.cl": ("inpainting/lanes.clh",),
}
# What processors have in a form of their own.
CPU_FORMS = {BUILTINS: CPU_BUILTINS, "inpainting/lanes.clh": "inpainting/cpu/lanes.clh"}
_C_TYPES = {
    "f4": "float", "f8": "double",
    "i1": "char", "i2": "short", "i4": "int", "i8": "long",
    "u1": "uchar", "u2": "ushort", "u4": "uint", "u8": "ulong",
}  # fmt: skip


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
    Raises KernelError with the compiler's log, DeviceError where `real` is double and the device has none.
    """
    request = folder("kernels"), tuple(sources), tuple(features.items()), tuple(structs.items()), real
    with session.lock:
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
    text = program_text([*headers, *sources], structs, real, device.has_fp64, device.has_int64_atomics)
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


def program_text(
    sources: Sequence[str],
    structs: Mapping[str, np.dtype[Any]],
    real: Literal["double", "float"],
    has_fp64: bool,
    has_int64_atomics: bool,
) -> str:
    """The whole text that the compiler sees, with #line before each file, so that errors name it."""
    lines = ["#pragma OPENCL FP_CONTRACT OFF"]  # a * b + c as NumPy has it; fma where a kernel says fma
    # How wide vectors are passed is of no interest where every function is inlined, but PoCL counts on the terminal.
    # Compilers for GPUs do not know the warning, and count that.
    lines += ["#ifdef __x86_64__", '#pragma clang diagnostic ignored "-Wpsabi"', "#endif"]
    if has_fp64:
        lines.append("#pragma OPENCL EXTENSION cl_khr_fp64 : enable")
    if has_int64_atomics:
        lines.append("#pragma OPENCL EXTENSION cl_khr_int64_base_atomics : enable")
        lines.append("#pragma OPENCL EXTENSION cl_khr_int64_extended_atomics : enable")
    lines += [f"#define HAS_FP64 {int(has_fp64)}", f"#define HAS_INT64_ATOMICS {int(has_int64_atomics)}"]
    lines.append(f"#define REAL_IS_DOUBLE {int(real == 'double')}")
    lines += [f"typedef {real}{width} real{width};" for width in ("", 2, 3, 4, 8, 16)]
    lines += [struct_text(name, dtype, structs) for name, dtype in structs.items()]
    kernels = folder("kernels")
    for source in sources:
        try:
            lines += [f'#line 1 "{source}"', (kernels / source).read_text("utf-8")]
        except FileNotFoundError as error:
            raise KernelError(f"kernels: must hold every file that is asked for; got no {source}") from error
    return "\n".join(lines)


def struct_text(name: str, dtype: np.dtype[Any], structs: Mapping[str, np.dtype[Any]]) -> str:
    """The C typedef `name` of an aligned structured dtype, with a check of its size by the compiler itself.

    Fields are scalars, arrays of them, or dtypes in `structs`. `np.dtype(..., align=True)` gives the layout
    that OpenCL C prescribes, so equal sizes mean equal offsets. (pyopencl's match_dtype_to_c_struct asks the
    device with a kernel per struct: 35 ms each from a warm cache, 0.3 s from a cold one.)
    """
    if dtype.fields is None or not dtype.isalignedstruct:
        raise KernelError(f"struct {name}: must be a structured dtype with align=True; got {dtype}")
    names = {other: c_name for c_name, other in structs.items()}
    members = []
    for field, entry in dtype.fields.items():
        base, shape = entry[0].base, entry[0].shape
        c_type = names.get(base) or _C_TYPES.get(base.str[1:])
        if c_type is None:
            raise KernelError(f"struct {name}: fields must be numbers or known structs; got {field}: {base}")
        members.append(f"{c_type} {field}{''.join(f'[{count}]' for count in shape)};")
    check = f"typedef char {name}_has_the_size_of_its_dtype[sizeof({name}) == {dtype.itemsize} ? 1 : -1];"
    return f"typedef struct {{ {' '.join(members)} }} {name};\n{check}"


def _built(session: Session, where: str, text: str, options: list[str]) -> Program:
    if session.device.is_pocl and session.device.kind == "cpu":
        with suppress(KernelError):  # of a version whose header is another one, or a kernel that calls something else
            return _compiled(session, where, text, [*options, WITHOUT_HEADER])
    return _compiled(session, where, text, options)


@contextmanager
def without_output() -> Iterator[None]:
    """Builds in the block without pyopencl's warning of any output of the compiler; with it for whom asks by pyopencl's
    own variable."""
    with warnings.catch_warnings():
        if not os.environ.get("PYOPENCL_COMPILER_OUTPUT"):
            warnings.simplefilter("ignore", cl.CompilerWarning)
        yield


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
