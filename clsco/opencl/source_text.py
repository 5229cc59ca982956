"""Preprocessing of program texts, and filtering of compiler messages.

A kernel file includes another by its path below kernels/, as in `#include "common/sources.clh"`. For processors, a file
of the same name in a subfolder `cpu`, if there is one, replaces the included file. Text that the features exclude does
not reach the compiler, so requests that lead to the same text share one program.
"""

from __future__ import annotations

import os
import re
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

import numpy as np
import pyopencl as cl

from clsco.errors import KernelError
from clsco.records import Real
from clsco.resources import folder

Structs = Mapping[str, np.dtype[Any]]

_C_TYPES = {
    "f4": "float", "f8": "double",
    "i1": "char", "i2": "short", "i4": "int", "i8": "long",
    "u1": "uchar", "u2": "ushort", "u4": "uint", "u8": "ulong",
}  # fmt: skip


def program_text(
    sources: Sequence[str], structs: Structs, real: Real, has_fp64: bool, has_int64_atomics: bool,
    macros: Mapping[str, float] | None = None, on_cpu: bool = False,
) -> str:  # fmt: skip
    """The whole text of a program for the compiler, with #line directives so that the compiler's errors name files.

    macros: values of names in the preprocessor's conditions, such as features; on_cpu: True to use the files for
    processors; other arguments: as for `clsco.opencl.program.build`. Raises KernelError for a missing file.
    """
    lines = ["#pragma OPENCL FP_CONTRACT OFF"]  # a * b + c is rounded twice, as in NumPy; only fma() is fused
    # PoCL prints the number of warnings. This one, on passing wide vectors, is irrelevant because every function is
    # inlined. Compilers for GPUs do not know it, and would warn of the unknown name.
    lines += ["#ifdef __x86_64__", '#pragma clang diagnostic ignored "-Wpsabi"', "#endif"]
    # When Intel's compiler for processors vectorizes over work-items, it passes vectors of 3 wrongly to and from
    # functions that are not inlined; the hint disables this vectorization.
    hinted = "#define __kernel __attribute__((intel_vec_len_hint(1))) __kernel"
    lines += ["#ifdef cl_intel_vec_len_hint", hinted, "#endif"]
    if has_fp64:
        lines.append("#pragma OPENCL EXTENSION cl_khr_fp64 : enable")
    if has_int64_atomics:
        lines.append("#pragma OPENCL EXTENSION cl_khr_int64_base_atomics : enable")
        lines.append("#pragma OPENCL EXTENSION cl_khr_int64_extended_atomics : enable")
    device_macros = {"HAS_FP64": has_fp64, "HAS_INT64_ATOMICS": has_int64_atomics, "REAL_IS_DOUBLE": real == "double"}
    lines += [f"#define {name} {int(value)}" for name, value in device_macros.items()]
    lines += [f"typedef {real}{width} real{width};" for width in ("", 2, 3, 4, 8, 16)]
    lines += [struct_text(name, dtype, structs) for name, dtype in structs.items()]
    preprocessor = _Preprocessor(device_macros | dict(macros or {}), on_cpu)
    return "\n".join([*lines, *(preprocessor.text(source) for source in sources)])


@dataclass
class _Condition:
    """State of an #if whose #endif has not been reached yet.

    active: True if the current branch is included; done: True if a branch has been included; deferred: True if the
    condition is left to the compiler, because it has an unknown name.
    """

    active: bool
    done: bool
    deferred: bool = False


@dataclass
class _Preprocessor:
    """Evaluates conditions on known macros in kernel files, and includes each file once. on_cpu: True to include the
    files in subfolders `cpu`, where there are some, in place of others of their name.
    """

    macros: dict[str, float]
    on_cpu: bool
    files_read: set[str] = field(default_factory=set)

    def text(self, source: str) -> str:
        """Text of a file and of the files that it includes; empty if the file has been read before. Blank lines replace
        excluded text.
        """
        name = _cpu_form(source) if self.on_cpu else source
        if name in self.files_read:
            return ""
        self.files_read.add(name)
        text, pieces, conditionals, end = _read(folder("kernels"), name), [f'#line 1 "{name}"\n'], list[_Condition](), 0
        for line in _DIRECTIVE.finditer(text):
            active = all(conditional.active for conditional in conditionals)
            between = text[end : line.start()]
            pieces.append(between if active else "\n" * between.count("\n"))
            word, condition, included, joined, sides = line.groups()
            if joined:
                if active and (value := self._value(sides)) is not None:
                    self.macros[joined] = value
                pieces.append(line[0] if active else "")
            elif word:
                pieces.append(self._decide(word, condition, line[0], conditionals, active))
            elif active:
                number = text.count("\n", 0, line.start()) + 2
                pieces.append(f'{self.text(included)}\n#line {number} "{name}"')
            end = line.end()
        return "".join([*pieces, text[end:]])

    def _decide(self, word: str, condition: str, line: str, conditionals: list[_Condition], active: bool) -> str:
        """Line of a directive for the compiler, empty if evaluated here; active: True if it is in included text."""
        if word.startswith("if"):
            value = self._value(condition) if word == "if" and active else None
            deferred = active and value is None
            conditionals.append(_Condition(bool(value) or deferred, bool(value) or not active, deferred))
            return line if deferred else ""
        current = conditionals[-1]
        if word == "endif":
            conditionals.pop()
            return line if current.deferred and active else ""
        if current.deferred:
            return line
        value = None if current.done else self._value(condition) if word == "elif" else 1.0
        if value is None and not current.done:
            current.active = current.done = current.deferred = True
            return line.replace("elif", "if", 1)
        current.active, current.done = bool(value), current.done or bool(value)
        return ""

    def _value(self, condition: str) -> float | None:
        """Value of a condition; None if it has an unknown name."""
        names, python = _in_python(condition)
        return float(eval(python, {"__builtins__": {}}, self.macros)) if names <= self.macros.keys() else None


# Matches conditionals, includes, and definitions of a name by a condition on features.
_DIRECTIVE = re.compile(
    r"^#(?:(ifdef|ifndef|if|elif|else|endif) *(.*)|include \"(.*)\"|define (\w+) (\([^?\n]*(?:&&|\|\|)[^?\n]*\)).*)$",
    re.MULTILINE,
)


@cache
def _in_python(condition: str) -> tuple[frozenset[str], str]:
    """The names in a condition of a kernel file, and the condition as a Python expression."""
    text = re.sub(r"//.*", "", condition)
    python = re.sub(r"!(?!=)", " not ", text.replace("&&", " and ").replace("||", " or "))
    return frozenset(re.findall(r"[A-Za-z_]\w*", text)), python.strip()


def _cpu_form(source: str) -> str:
    """Name of a file's variant for processors; the name itself if there is no variant."""
    variant = re.sub(r"[^/]+$", r"cpu/\g<0>", source)
    return variant if (folder("kernels") / variant).is_file() else source


@cache
def kernel_names(kernels: Path, source: str) -> tuple[str, ...]:
    """Names of the kernels in a file of the folder `kernels`, whatever the features; KernelError for a missing file."""
    return tuple(re.findall(r"^__kernel void (\w+)\(", _read(kernels, source), re.MULTILINE))


def _read(kernels: Traversable, source: str) -> str:
    try:
        return (kernels / source).read_text("utf-8")
    except FileNotFoundError as error:
        raise KernelError(f"kernels: must hold every file that is asked for; got no {source}") from error


def struct_text(name: str, dtype: np.dtype[Any], structs: Structs) -> str:
    """The C typedef `name` of an aligned structured dtype, with a compile-time check of its size.

    `np.dtype(..., align=True)` has the layout that OpenCL C prescribes, so equal sizes mean equal offsets. pyopencl's
    match_dtype_to_c_struct would run a kernel for each struct, which takes 0.3 s if PoCL's cache is empty, else 35 ms.
    """
    if dtype.fields is None or not dtype.isalignedstruct:
        raise KernelError(f"struct {name}: must be a structured dtype with align=True; got {dtype}")
    names = {dtype_: c_name for c_name, dtype_ in structs.items()}
    members = []
    for member, entry in dtype.fields.items():
        base, shape = entry[0].base, entry[0].shape
        c_type = names.get(base) or _C_TYPES.get(base.str[1:])
        if c_type is None:
            raise KernelError(f"struct {name}: fields must be numbers or known structs; got {member}: {base}")
        members.append(f"{c_type} {member}{''.join(f'[{count}]' for count in shape)};")
    check = f"typedef char {name}_has_the_size_of_its_dtype[sizeof({name}) == {dtype.itemsize} ? 1 : -1];"
    return f"typedef struct {{ {' '.join(members)} }} {name};\n{check}"


@contextmanager
def without_output() -> Iterator[None]:
    """Suppress pyopencl's warning of compiler output in the block, unless the user has set PYOPENCL_COMPILER_OUTPUT."""
    with warnings.catch_warnings():
        if not os.environ.get("PYOPENCL_COMPILER_OUTPUT"):
            warnings.simplefilter("ignore", cl.CompilerWarning)
        yield
