"""Arithmetic of wide.clh against exact rational numbers, in both precisions."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from math import isqrt
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from clsco.opencl.buffers import download, empty
from clsco.opencl.session import Session
from clsco.records import Real, in_parts, packed, structs
from tests.kernels.wide_numbers import PARTS, held, whole

Array = NDArray[Any]
Run = Callable[..., None]
RNG = np.random.default_rng

SOURCE = (
    PARTS
    + """
__kernel void compute(__global const real *numbers, const int count, __global real *out, __global int *less,
                      __global real *floors)
{
    const int i = get_global_id(0);
    if (i >= count)
        return;
    wide_t v[6];
    for (int k = 0; k < 6; ++k)
        v[k] = GET(numbers, 6 * i + k);
    const wide3_t a = wide_vector(v[0], v[1], v[2]), b = wide_vector(v[3], v[4], v[5]);
    const wide_t all[7] = {wide_add(v[0], v[1]), wide_sub(v[0], v[1]), wide_mul(v[0], v[1]), wide_div(v[0], v[1]),
                         wide_sqrt(narrow(v[0]) < 0 ? wide_minus(v[0]) : v[0]),
                         wide_determinant(v[0], v[1], v[2], v[3]), wide3_dot(a, b)};
    for (int k = 0; k < 7; ++k)
        PUT(out, 7 * i + k, all[k]);
    less[i] = wide_less(v[0], v[1]);
    floors[i] = wide_floor(v[0]);
}

// Every number of a struct, as the kernels get at it.
__kernel void fields(const grid_t grid, __constant surface_t *surface, __global real *out)
{
    if (get_global_id(0) > 0)
        return;
    const wide3_t row = wide_row(surface->turn, 1), column = wide_column(surface->turn, 1), q = wide_load(surface->q);
    const wide_t all[10] = {WIDE_FIELD(grid.step), wide_part(surface->offset, 3, 2), row.x, row.y, row.z,
                          column.x, column.y, column.z, q.y, WIDE_FIELD(surface->k)};
    for (int k = 0; k < 10; ++k)
        PUT(out, k, all[k]);
}
"""
)


def numbers(count: int) -> Array:
    """(count, 6): of any size and sign; pairs that nearly cancel, that are integers, equal, or 0."""
    rng = RNG(11)
    v = rng.choice([-1, 1], (count, 6)) * np.exp(rng.uniform(-9, 9, (count, 6)))
    near = slice(0, count // 3)
    v[near, 1] = v[near, 0] * (1 + rng.choice([-1, 1], count // 3) * 2.0 ** -rng.uniform(10, 47, count // 3))
    v[near, 3] = v[near, 0] * v[near, 1] / v[near, 2]  # of the determinant
    v[near, 5] = -(v[near, 0] * v[near, 3] + v[near, 1] * v[near, 4]) / v[near, 2]  # of the dot product
    whole_numbers = slice(count // 3, count // 2)
    v[whole_numbers] = rng.integers(-40, 40, (count // 2 - count // 3, 6))
    v[whole_numbers, 1] += v[whole_numbers, 1] == 0
    v[-9:, 0] = [0.0, 5.0, -5.0, 3 + 2.0**-40, 3 - 2.0**-40, -3 - 2.0**-40, -3 + 2.0**-40, 2.0**23 + 0.5, -0.25]
    v[-9:, 1] = [1.0, 5.0, -5.0, 3.0, 3.0, -3.0, -3.0, 2.0**23, 1.0]
    return held(v)


def root(a: Fraction) -> Fraction:
    """Square root, exact to 2^-120 of itself or better for a in [2^-40, 2^40]."""
    return Fraction(isqrt((a.numerator << 400) // a.denominator), 1 << 200)


@pytest.mark.parametrize("real", ["double", "float"])
def test_operations_keep_their_bounds(session: Session, run_source: Run, real: Real) -> None:
    count = 6000
    v = numbers(count)
    out, less, floors = (empty(session, size * count) for size in (56, 4, 8))
    run_source(SOURCE, "compute", real, {}, count, in_parts(v, real), np.int32(count), out, less, floors)
    found = whole(session, out, (count, 7), real)
    number = np.float64 if real == "double" else np.float32
    np.testing.assert_array_equal(download(session, less, (count,), np.int32), v[:, 0] < v[:, 1])
    np.testing.assert_array_equal(download(session, floors, (count,), number), np.floor(v[:, 0]))
    # wide.clh: u^2 of what the errors are relative to; a sum of n products has n products' errors and n - 1 sums'. For
    # doubles a sum, product, quotient or root is rounded once, a determinant keeps 3 half units of itself (4 u here).
    u = Fraction(1, 1 << 53) if real == "double" else Fraction(1, 1 << 48)
    bounds = [1.0, 1.0, 1.0, 1.0, 1.0, 4.0, 5.0] if real == "double" else [3.0, 3.0, 5.0, 10.0, 25 / 8, 8.0, 11.0]
    worst = [Fraction(0)] * 7
    for values, results in zip(v.tolist(), found.tolist(), strict=True):
        a, b, c, d, e, f = (Fraction(x) for x in values)
        exact = [a + b, a - b, a * b, a / b, root(abs(a)), a * b - c * d, a * d + b * e + c * f]
        sizes = [abs(a) + abs(b), abs(a) + abs(b), *(abs(x) for x in exact[2:5])]
        sizes += [abs(a * b) + abs(c * d), abs(a * d) + abs(b * e) + abs(c * f)]
        if real == "double":
            sizes[0], sizes[1], sizes[5] = abs(exact[0]), abs(exact[1]), abs(exact[5])
        for k, (result, right, size) in enumerate(zip(results, exact, sizes, strict=True)):
            error = abs(Fraction(result) - right)
            assert size > 0 or error == 0
            worst[k] = max(worst[k], error / size if size else Fraction(0))
    units = [float(w / u) for w in worst]
    assert all(w <= bound for w, bound in zip(units, bounds, strict=True)), units
    assert min(units) > 0.4, units  # the numbers are not so simple that nothing is rounded


@pytest.mark.parametrize("real", ["double", "float"])
def test_the_same_bits_without_instructions(session: Session, run_source: Run, tmp_path: Path, real: Real) -> None:
    """Devices other than an x86 processor with FMA call the builtin functions, which PoCL rounds alike."""
    count, found = 600, []
    v = in_parts(numbers(count), real)
    header = tmp_path / "common/wide.clh"
    for before in ("", "#undef __FMA__\n"):
        header.write_text(before + header.read_text("utf-8"), "utf-8")
        out, less, floors = (empty(session, size * count) for size in (56, 4, 8))
        run_source(SOURCE, "compute", real, {}, count, v, np.int32(count), out, less, floors)
        number = np.float64 if real == "double" else np.float32
        found.append((whole(session, out, (count, 7), real), download(session, floors, (count,), number)))
    for usual, builtin in zip(*found, strict=True):
        np.testing.assert_array_equal(builtin, usual)


@pytest.mark.parametrize("real", ["double", "float"])
def test_fields_of_structs_keep_their_digits(session: Session, run_source: Run, real: Real) -> None:
    rng = RNG(12)
    grid, surface = (np.zeros(1, structs("double")[name]) for name in ("grid_t", "surface_t"))
    for record in (grid, surface):
        for name in record.dtype.names or ():
            if record[name].dtype.kind == "f":
                record[name] = held(rng.standard_normal(record[name].shape))
    surface["bounds_low"] = -np.inf
    single = packed("surface_t", surface, "float")
    assert (single["bounds_low"] == [-np.inf] * 3 + [0.0] * 3).all()
    out = empty(session, 80)
    arguments = (packed("grid_t", grid, real)[0], packed("surface_t", surface, real))
    run_source(SOURCE, "fields", real, {}, 1, *arguments, out)
    turn = surface["turn"][0].reshape(3, 3)
    expected = [grid["step"][0], surface["offset"][0, 2], *turn[1], *turn[:, 1], surface["q"][0, 1], surface["k"][0]]
    np.testing.assert_array_equal(whole(session, out, (10,), real), expected)
