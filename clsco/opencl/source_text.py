"""Texts of programs as compilers see them, and what compilers say of them."""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, Literal

import numpy as np
import pyopencl as cl

from clsco.errors import KernelError
from clsco.resources import folder

_C_TYPES = {
    "f4": "float", "f8": "double",
    "i1": "char", "i2": "short", "i4": "int", "i8": "long",
    "u1": "uchar", "u2": "ushort", "u4": "uint", "u8": "ulong",
}  # fmt: skip


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
    # Intel's compiler for processors, where it makes work-items the lanes of vectors, passes vectors of 3 wrongly to
    # functions that are not inlined, and from them; with the hint it leaves work-items alone.
    hinted = "#define __kernel __attribute__((intel_vec_len_hint(1))) __kernel"
    lines += ["#ifdef cl_intel_vec_len_hint", hinted, "#endif"]
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


@contextmanager
def without_output() -> Iterator[None]:
    """Builds in the block without pyopencl's warning of any output of the compiler; with it for whom asks by pyopencl's
    own variable."""
    with warnings.catch_warnings():
        if not os.environ.get("PYOPENCL_COMPILER_OUTPUT"):
            warnings.simplefilter("ignore", cl.CompilerWarning)
        yield
