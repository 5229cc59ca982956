"""Oclgrind, which interprets kernels and sees what they read and write: how to start it, and what to spare it."""

from __future__ import annotations

import ctypes
import os
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from functools import lru_cache
from importlib import import_module
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import pyopencl as cl

from clsco.opencl import source_text
from clsco.opencl.device import choose
from clsco.opencl.session import Session

LIBRARIES = sorted(Path("/usr/lib").glob("**/oclgrind/liboclgrind-rt.so"))
INSTALL = (
    "oclgrind: must be installed (Debian and Ubuntu: apt-get install oclgrind); got no liboclgrind-rt.so in /usr/lib"
)
INSTEAD = Path(__file__).with_name("simulator.clh")
MOST_REPORTS = 100_000  # of a process, after which it is silent, whatever else it runs
CHECKS = {
    "races": {"OCLGRIND_DATA_RACES": "1", "OCLGRIND_UNIFORM_WRITES": "1"},
    "uninitialized": {"OCLGRIND_UNINITIALIZED": "1"},
}
"""One at a time: with both it tells of no race."""


def environ(log: Path, check: str) -> dict[str, str]:
    """Variables of a process in which Oclgrind is one of the platforms; check: what it looks for besides bounds."""
    if not LIBRARIES:
        raise FileNotFoundError(INSTALL)
    return os.environ | {
        "LD_PRELOAD": str(LIBRARIES[0]),
        **CHECKS[check],
        "OCLGRIND_LOG": str(log),
        "OCLGRIND_MAX_ERRORS": str(MOST_REPORTS),
        "OCLGRIND_NUM_THREADS": "1",
        "OCLGRIND_GLOBAL_MEM_SIZE": str(2**31),
        # Its optimizer makes intrinsics that its interpreter does not know, such as llvm.abs.
        "OCLGRIND_BUILD_OPTIONS": "-cl-opt-disable",
        "PYOPENCL_NO_CACHE": "1",
    }


def without_intrinsics() -> None:
    """The inliner of its compiler marks restrict pointers by an intrinsic that its interpreter does not know."""
    options = (b"oclgrind", b"-use-noalias-intrinsic-during-inlining=0")
    ctypes.CDLL(None).LLVMParseCommandLineOptions(len(options), (ctypes.c_char_p * len(options))(*options), None)


def in_single_lanes(text: str) -> str:
    """A text in which nothing writes some lanes of a vector, or makes one of shorter ones.

    It takes the other lanes for uninitialized then, or ends by a signal.
    """

    def two(match: re.Match[str]) -> str:
        indent, vector, first, second, value = match.groups()
        lanes = f"const __typeof__({vector}.{first}{second}) lanes_ = {value};"
        return f"{indent}{{ {lanes} {vector}.{first} = lanes_.x; {vector}.{second} = lanes_.y; }}"

    def every_other(match: re.Match[str]) -> str:
        indent, vector, which, value = match.groups()
        lanes = " ".join(f"{vector}[{2 * k + (which == 'odd')}] = lanes_[{k}];" for k in range(4))
        return f"{indent}{{ const float4 lanes_ = {value}; {lanes} }}"

    def one_by_one(line: re.Match[str]) -> str:
        return re.sub(r"(\(\w\))\.s([\da-f]{2,})\b", lambda m: ", ".join(f"{m[1]}.s{k}" for k in m[2]), line[0])

    # Of sixteen; a shuffle with element 11, see simulator.clh.
    text = re.sub(r"(\(\w\)|\b\w+)\.odd\b(?! =)", r"__builtin_shufflevector(\1, \1, 1, 3, 5, 7, 9, 11, 13, 15)", text)
    text = re.sub(r"^.*\(float8\)\(\(a\).*$", one_by_one, text, flags=re.MULTILINE)
    text = re.sub(r"^( *)([\w>.-]+)\.([xyzw])([xyzw]) = (.+);$", two, text, flags=re.MULTILINE)
    return re.sub(r"^( *)(\w+)\.(even|odd) = (.+);$", every_other, text, flags=re.MULTILINE)


# Vectors of 16 in halves, as kernels/common/builtins.clh has them for devices that are no processors, lane by lane.
BY_HALVES = {
    "return (type##16)(vload8(0, p), vload8(1, p));":
        "type##16 v_; for (int k_ = 0; k_ < 16; ++k_) ((type *)&v_)[k_] = p[k_]; return v_;",
    "vstore8(v.lo, 0, p);": "for (int k_ = 0; k_ < 16; ++k_) p[k_] = ((type *)&v)[k_];",
    "vstore8(v.hi, 1, p);": "",
    "((type##16)(convert_##type##8((v).lo), convert_##type##8((v).hi)))":
        "({ const __typeof__(v) v_ = (v); type##16 w_; "
        "for (int k_ = 0; k_ < 16; ++k_) ((type *)&w_)[k_] = (type)v_[k_]; w_; })",
}  # fmt: skip


# A load of 32 bits is atomic on every device, but OpenCL C 1.2 has no name for it.
PLAIN_LOAD, ATOMIC_LOAD = "#define RELAXED_LOAD(p) (*(p))", "#define RELAXED_LOAD(p) atomic_or(p, 0)"


def by_lanes(text: str) -> str:
    """A text whose vectors of 16 are not made of halves, and whose atomic loads are named so."""
    given = [halves for halves in BY_HALVES if halves in text]
    assert given in ([], [*BY_HALVES]), "as in kernels/common/builtins.clh"
    for halves in given:
        text = text.replace(halves, BY_HALVES[halves])
    return text.replace(PLAIN_LOAD, ATOMIC_LOAD)


def _text(*given: Any) -> str:
    return INSTEAD.read_text("utf-8") + in_single_lanes(by_lanes(_program_text(*given)))


_program_text = source_text.program_text


PUT = """__kernel void put(__global uchar *to, const int at, __global const uchar *from)
{ to[at + get_global_id(0)] = from[get_global_id(0)]; }"""
_enqueue_copy = cl.enqueue_copy


def _copy(queue: cl.CommandQueue, to: Any, source: Any, **options: Any) -> Any:
    """Copy by a kernel: where the host writes a part of a buffer, the simulator takes the rest for uninitialized."""
    if not isinstance(to, _Buffer) or isinstance(source, _Buffer) or source.nbytes == to.size:
        return _enqueue_copy(queue, to, source, **options)
    data = np.frombuffer(source.tobytes(), np.uint8)
    given = _buffer(queue.context, cl.mem_flags.READ_ONLY | cl.mem_flags.COPY_HOST_PTR, hostbuf=data)
    put = cl.Kernel(_put_program(queue.context), "put")
    return put(queue, (data.size,), None, to, np.int32(options.get("dst_offset", 0)), given)


@lru_cache(maxsize=1)
def _put_program(context: cl.Context) -> cl.Program:
    return cl.Program(context, PUT).build()


def _fill(queue: cl.CommandQueue, buffer: cl.Buffer, pattern: Any, offset: int, size: int) -> None:
    """It takes what clEnqueueFillBuffer writes for uninitialized, and not what is copied."""
    if size:
        repeated = np.resize(np.frombuffer(np.asarray(pattern).tobytes(), np.uint8), size)
        _copy(queue, buffer, repeated, dst_offset=offset)


_held: list[cl.Buffer] = []
_Buffer = cl.Buffer


def _buffer(*args: Any, **options: Any) -> cl.Buffer:
    """It takes for uninitialized what is written where another buffer has been, so none is let go of."""
    _held.append(_Buffer(*args, **options))
    return _held[-1]


@lru_cache(maxsize=1)
def _queue() -> cl.CommandQueue:
    """Queue of all cases: a second context's memory is uninitialized for the simulator where the first had some."""
    context = cl.Context([choose("oclgrind").handle])
    return cl.CommandQueue(context, properties=cl.command_queue_properties.PROFILING_ENABLE)


@contextmanager
def sessions(**changes: Any) -> Iterator[None]:
    """Has clsco work on Oclgrind; changes: what its device is to be taken for, such as kind = "gpu"."""
    # What a kernel reads of the host's own memory it takes for uninitialized, hence no unified memory.
    given: Mapping[str, Any] = {"unified_memory": False, **changes}
    device = replace(choose("oclgrind"), **given)
    render, arrays = import_module("clsco.engine.sequence"), import_module("clsco.opencl.arrays")

    def session(*_: Any, **__: Any) -> Session:
        return Session(device, queue=_queue())

    with (
        patch.object(source_text, "program_text", _text),
        patch.object(cl, "enqueue_fill_buffer", _fill),
        patch.object(cl, "enqueue_copy", _copy),
        patch.object(cl, "Buffer", _buffer),
        patch.object(render, "session_for", session),
        patch.object(arrays, "session_for", session),
    ):
        yield
