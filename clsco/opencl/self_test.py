"""Self-test: small kernels that check whether a device computes as clsco expects."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from clsco.errors import DeviceError
from clsco.opencl import source_text
from clsco.opencl.device import Device
from clsco.opencl.session import Session
from clsco.resources import ExposedFolderError, private_folder


@dataclass(frozen=True)
class Check:
    """Result of one check of `self_test`; detail: if it failed, the expected and the wrong value, or the error."""

    name: str
    passed: bool
    detail: str = ""


@dataclass(frozen=True)
class _Probe:
    name: str
    body: str  # statements of work-item i of 64; `in`: floats, in[i] = i; `out`: longs, 0 at first
    expected: Callable[[NDArray[np.int64]], NDArray[np.int64]]
    needs: str | None = None
    functions: str = ""  # functions that `body` calls


# (1 + i e)^2 - (1 + 2 i e) = i^2 e^2 with e = 2^-23: exact when fused, 0 when the square is rounded first,
# since i^2 e^2 < 2^-24 for i < 64.
_SQUARE = "float x = 1.0f + in[i] * 0x1p-23f, y = -(1.0f + in[i] * 0x1p-22f);"

_ARGUMENTS = _Probe(
    "vectors of 3 as arguments",
    "out[i] = (long)weighted_sum((float3)(in[i], in[i] + 1.0f, in[i] + 2.0f));",
    lambda i: 7 * i + 10,
    functions="__attribute__((noinline)) float weighted_sum(float3 a) { return a.x + 2.0f * a.y + 4.0f * a.z; }",
)
_PROBES = (
    _Probe("float32 addition", "out[i] = (long)(in[i] + 1.0f);", lambda i: i + 1),
    _Probe("int32 atomics", "atomic_add((volatile __global int *)out, i);", lambda i: np.where(i == 0, i.sum(), 0)),
    _Probe(
        "int64 atomics",
        "atom_max(out, (long)i << 40);",
        lambda i: np.where(i == 0, i.max() << 40, 0),
        "has_int64_atomics",
    ),
    _Probe("fp64", "out[i] = (long)((1.0 + in[i] * 0x1p-50) * 0x1p50);", lambda i: 2**50 + i, "has_fp64"),
    _Probe("exact fma", f"{_SQUARE} out[i] = (long)(fma(x, x, y) * 0x1p46f);", lambda i: i * i),
    _Probe("no contraction", f"{_SQUARE} out[i] = (long)((x * x + y) * 0x1p46f);", lambda i: 0 * i),
    _ARGUMENTS,
)


def self_test(device: Device) -> list[Check]:
    """Build and run the kernels of the self-test on a device. An error of OpenCL is reported as a failed check."""
    checks = []
    for probe in _PROBES:
        if probe.needs is not None and not getattr(device, probe.needs):
            continue  # clsco does not use features that a device does not claim to have
        try:
            with Session(device) as session:
                checks.append(_run_check(session, probe))
        except (cl.Error, DeviceError) as error:
            checks.append(Check(probe.name, False, str(error).splitlines()[0]))
    return checks


def require_right_arguments(session: Session) -> None:
    """Raise DeviceError if functions in kernels get wrong arguments, as with some drivers: frames would then be noise.

    A driver that passes the test is recorded in the user's cache folder, and not tested again.
    """
    device, passed = session.device, None
    driver_key = device.name, device.platform, device.platform_version, device.driver, _text(device, _ARGUMENTS)
    with suppress(ExposedFolderError, OSError, RuntimeError):  # without such a folder, each process runs the test
        passed = private_folder("clsco", "drivers") / hashlib.sha256(repr(driver_key).encode()).hexdigest()
    if passed is not None and passed.exists():
        return
    with session.reporting():
        check = _run_check(session, _ARGUMENTS)
    if not check.passed:
        rule = f"driver {device.driver} must pass the self-test, or another one be used, such as PoCL's"
        raise DeviceError(f"device {device}: {rule}; got a failure in {check.name}, {check.detail}")
    if passed is not None:
        with suppress(OSError):
            passed.touch()


def _run_check(session: Session, probe: _Probe) -> Check:
    results, expected = _run_probe(session, probe), probe.expected(np.arange(64, dtype=np.int64))
    wrong = np.flatnonzero(results != expected)
    detail = f"work-item {wrong[0]}: must be {expected[wrong[0]]}; got {results[wrong[0]]}" if wrong.size else ""
    return Check(probe.name, not wrong.size, detail)


def _text(device: Device, probe: _Probe) -> str:
    """Text of the program of a probe, which begins like the texts of all other programs."""
    begin = source_text.program_text([], {}, "float", device.has_fp64, device.has_int64_atomics)
    kernel = "__kernel void probe(__global const float *in, __global long *out)"
    return f"{begin}\n{probe.functions}\n{kernel}\n{{ int i = get_global_id(0); {probe.body} }}"


def _run_probe(session: Session, probe: _Probe) -> NDArray[np.int64]:
    inputs, results = np.arange(64, dtype=np.float32), np.zeros(64, np.int64)
    flags = cl.mem_flags.READ_WRITE | cl.mem_flags.COPY_HOST_PTR
    with session.compiling():
        buffers = [cl.Buffer(session.context, flags, hostbuf=array) for array in (inputs, results)]
        with source_text.without_output():
            kernel = cl.Kernel(cl.Program(session.context, _text(session.device, probe)).build(), "probe")
        kernel(session.queue, (64,), (64,), *buffers)
        cl.enqueue_copy(session.queue, results, buffers[1], is_blocking=True)
    return results
