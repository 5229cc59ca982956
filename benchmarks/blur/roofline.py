"""Roofline of the device, measured by two small kernels, and the share of it that a number of taps in a time
reaches."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pyopencl as cl

from clsco.opencl.buffers import empty
from clsco.opencl.pace import event_seconds
from clsco.opencl.program import launch
from clsco.opencl.session import Session
from clsco.opencl.source_text import without_output

ACCUMULATORS, LANES = 10, 8  # ten chains hide the latency of an addition, and with two factors fit 16 registers
FLOP_PER_TAP = 2.0  # a product and a sum
BYTES_PER_VALUE = 12.0  # that must move per pixel and channel: a color and a radius in, a color out
TRIAD_BYTES = 2**26  # of each of the three arrays: more than a cache holds
REPETITIONS = 5  # of which the fastest counts: it is a ceiling
LONG_ENOUGH_NS = 1e7

_CHAINS = [f"a{k}" for k in range(ACCUMULATORS)]
# a * x + y and not fma(a, x, y): the compiler fuses whole vectors of it, while PoCL calls fma lane by lane.
SOURCE = f"""
#pragma OPENCL FP_CONTRACT ON
__kernel void multiply_add(const float x, const float y, const int count, __global float8 *out)
{{
    const float8 first = (float8)(0, 1, 2, 3, 4, 5, 6, 7) + (float)get_global_id(0);
    float8 {", ".join(f"{a} = first + {k}" for k, a in enumerate(_CHAINS))};
    for (int i = 0; i < count; ++i) {{
        {" ".join(f"{a} = {a} * x + y;" for a in _CHAINS)}
    }}
    out[get_global_id(0)] = {" + ".join(_CHAINS)};
}}

__kernel void triad(__global float4 *a, __global const float4 *b, __global const float4 *c, const float s)
{{
    const size_t i = get_global_id(0);
    a[i] = b[i] + s * c[i];
}}
"""


@dataclass(frozen=True)
class Roof:
    """Measured ceilings: gb_per_s of memory (10^9 bytes), gflop_per_s of fused multiply-adds in float32."""

    gb_per_s: float
    gflop_per_s: float

    def at(self, flop_per_byte: float) -> float:
        """GFLOP/s that can be reached at an arithmetic intensity."""
        return min(self.gflop_per_s, self.gb_per_s * flop_per_byte)


def triad_rate(array_bytes: int, nanoseconds: float) -> float:
    """GB/s of a triad: two arrays are read and one is written."""
    return 3 * array_bytes / nanoseconds


def multiply_add_rate(items: int, count: int, nanoseconds: float) -> float:
    """GFLOP/s of `count` steps of `items` work-items."""
    return FLOP_PER_TAP * LANES * ACCUMULATORS * items * count / nanoseconds


def tap_rate(taps: float, nanoseconds: float) -> float:
    """GFLOP/s of a pass with so many taps per pixel that takes so long per pixel and channel."""
    return FLOP_PER_TAP * taps / nanoseconds


def intensity(taps: float) -> float:
    """Flop per byte that must move, of a pass with so many taps per pixel."""
    return FLOP_PER_TAP * taps / BYTES_PER_VALUE


def measure_roof(session: Session) -> Roof:
    """Run both kernels on a device."""
    device = session.device
    with session.compiling(), without_output():
        program = cl.Program(session.context, SOURCE).build()
    multiply_add, triad = (cl.Kernel(program, name) for name in ("multiply_add", "triad"))
    local, items = (1, 64 * device.compute_units) if device.kind == "cpu" else (64, 2048 * device.compute_units)
    out, count, fastest_ns = empty(session, 4 * LANES * items), 500, 0.0
    while fastest_ns < LONG_ENOUGH_NS and count < 2**28:
        count *= 2
        sizes, args = ((items,), (local,)), (np.float32(0.999), np.float32(0.001), np.int32(count), out)
        fastest_ns = _fastest(session, multiply_add, *sizes, *args)
    size = min(TRIAD_BYTES, device.max_alloc // 1024 * 1024)
    arrays = [empty(session, size) for _ in range(3)]
    for array in arrays:
        cl.enqueue_fill_buffer(session.queue, array, np.ones(1, np.float32), 0, size)
    moved = _fastest(session, triad, (size // 16,), (64,), *arrays, np.float32(0.5))
    return Roof(triad_rate(size, moved), multiply_add_rate(items, count, fastest_ns))


def _fastest(
    session: Session, kernel: cl.Kernel, size: tuple[int], local: tuple[int], *args: cl.Buffer | np.generic
) -> float:
    """Shortest time of some launches in ns."""
    events = [launch(session, kernel, size, local, *args) for _ in range(1 + REPETITIONS)]
    session.queue.finish()
    return 1e9 * min(sum(map(event_seconds, pieces)) for pieces in events[1:])
