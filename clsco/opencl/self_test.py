"""Small kernels that check what clsco relies on."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from clsco.errors import DeviceError
from clsco.opencl.device import Device
from clsco.opencl.program import without_output
from clsco.opencl.session import Session


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
        with without_output():
            kernel = cl.Kernel(cl.Program(session.context, "\n".join(lines)).build(), "probe")
        kernel(session.queue, (64,), (64,), *buffers)
        cl.enqueue_copy(session.queue, got, buffers[1], is_blocking=True)
    return got
