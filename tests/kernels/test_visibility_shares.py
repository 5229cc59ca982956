"""occluder.clh, one occluder at a time, of any numbers: what it hides of the lens, tap by tap.

Of made-up numbers every term counts, while those of a scene's surfaces are often far smaller than others, or 0.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from clsco.opencl.buffers import download, empty
from clsco.opencl.session import Session
from clsco.reference.common import occluder as twin
from clsco.reference.common.visibility import PARTLY
from clsco.scene.model import Plane, Sphere
from tests.kernels.test_visibility import assert_same, see

Array = NDArray[Any]
Runner = Callable[..., None]
LIMITS, TAPS, COUNT = 7, 64, 400  # conditions at most; taps of each surface; surfaces of each kind
MOST = 9.5  # cells to the farthest tap
SOURCE = """
// Surface i of 26 numbers, with `limits` conditions of 4: shares of its taps; then what hides_all says, and which
// conditions it leaves.
__kernel void hidden_shares(__global const float *number, __global const float *limit, __global const int *limits,
                            __global const int *crossings, __global const float *x, __global const float *y,
                            __global float *share, __global int *all, __global float *left, __global int *count)
{
    const int i = get_global_id(0);
    if (i >= SURFACES)
        return;
    __global const float *n = number + 26 * i;
    occluder_t m;
    m.base = n[0], m.bx = n[1], m.by = n[2], m.root = n[3];
    m.fx = n[4], m.fy = n[5], m.fxx = n[6], m.fxy = n[7], m.fyy = n[8];
    m.b = n[9], m.b_x = n[10], m.b_y = n[11], m.f = n[12];
    m.c = n[13], m.c_x = n[14], m.c_y = n[15], m.c_xx = n[16], m.c_xy = n[17], m.c_yy = n[18];
    m.d = n[19], m.d_x = n[20], m.d_y = n[21], m.d_xx = n[22], m.d_xy = n[23], m.d_yy = n[24];
    m.soft = n[25];
    m.limits = 0;
    m.crossings = crossings[i];
    for (int k = 0; k < 7; ++k)
        for (int j = 0; j < 4; ++j)
            m.limit[k][j] = -9;  // never met: not to be looked at
    for (int k = 0; k < limits[i]; ++k) {
        __global const float *one = limit + (7 * i + k) * 4;
        add_limit(&m, one[0], one[1], one[2], one[3]);
    }
    if (limits[i] < 7)
        add_limit(&m, INFINITY, INFINITY, 1, 1);  // none
    for (int t = 0; t < TAPS; t += LANE_COUNT) {
        const int at = i * TAPS + t;
        *(__global unaligned_lanes_t *)(share + at) = occluded_part(&m, *(__global const unaligned_lanes_t *)(x + at),
                                                              *(__global const unaligned_lanes_t *)(y + at)).share;
    }
    all[i] = m.limits && m.crossings ? hides_all(&m, MOST) : 0;
    count[i] = m.limits;
    for (int k = 0; k < 7; ++k)
        for (int j = 0; j < 4; ++j)
            left[(7 * i + k) * 4 + j] = m.limit[k][j];
}
"""


@dataclass(frozen=True)
class Surfaces:
    """N surfaces, as the twin and the device have them; limits: (N, LIMITS, 4), `count` of which are conditions."""

    occluder: twin.Occluder
    limits: Array
    count: Array
    x: Array
    y: Array

    def numbers(self) -> Array:
        m = self.occluder
        single = (m.h, m.root[:, None], m.f, m.b, m.f0[:, None], m.c, m.d, m.soft[:, None])
        return np.concatenate(single, axis=1).astype(np.float32)

    def shares(self) -> Array:
        """Shares of the twin."""
        columns = [twin.occluded_part(self.occluder, x, y).share for x, y in zip(self.x.T, self.y.T, strict=True)]
        return np.stack(columns, axis=-1)


def rounded(array: Array) -> Array:
    """To what float32 has."""
    return array.astype(np.float32).astype(np.float64)


def surfaces(b: Array, c: Array, f: Array, limits: Array, count: Array, rng: np.random.Generator) -> Surfaces:
    """With B (N, 3), C (N, 6) and F (N,), from which all follows but h, of surfaces without conditions."""
    points = len(f)
    b, c, f, limits = (rounded(array) for array in (b, c, f, limits))
    linear = 2 * b[:, :1] * b[:, 1:] - c[:, 1:3] * f[:, None]
    square = np.stack([b[:, 1] ** 2, 2 * b[:, 1] * b[:, 2], b[:, 2] ** 2], axis=-1) - c[:, 3:] * f[:, None]
    d = np.concatenate([(b[:, :1] ** 2 - c[:, :1] * f[:, None]), linear, square], axis=-1)
    x, y = rng.integers(-8, 9, (2, points, TAPS)) + rounded(rng.choice([0.0, 0.125, -0.25], (2, points, 1)))
    x[:, 0] = y[:, 0] = 0
    occluder = twin.Occluder(
        h=rounded(rng.uniform(-1, 1, (points, 3)) * [1, 0.2, 0.2]),
        root=rounded(rng.uniform(0, 1, points) * (rng.random(points) < 0.8)),
        f=rounded(rng.uniform(-1, 1, (points, 5)) * [0.2, 0.2, 0.02, 0.02, 0.02]),
        crossings=np.where(f > 0, 2, 1), b=b, f0=f, c=c, d=d,
        soft=rounded(rng.uniform(0.03, 0.3, points)),
        limits=tuple(np.moveaxis(limits, 1, 0)), needed=tuple(count > k for k in range(LIMITS)),
    )  # fmt: skip
    return Surfaces(occluder, limits, count, x, y)


def drawn(kind: str) -> Surfaces:
    """Surfaces of random numbers, such that C > 0 all over the lens."""
    rng = np.random.default_rng(29)
    b = rng.uniform(-1, 1, (COUNT, 3)) * [0.5, 0.05, 0.05]
    c = [1.5, 0, 0, 0, 0, 0] + rng.uniform(-1, 1, (COUNT, 6)) * [0.5, 0.02, 0.02, 0.0015, 0.0015, 0.0015]
    sign = {"once": -1.0, "own": 0.0, "twice": 1.0, "no conditions": 1.0}[kind]
    f = sign * rng.uniform(0.02, 0.5, COUNT)
    f[:40] = sign  # of two crossings at 1, which is no special number
    if kind == "twice":
        b[:, 0] -= np.sqrt(c[:, 0] * f)  # near the outline, some behind the point
        b[::8, 0] *= -1
    limits = rng.uniform(-1, 1, (COUNT, LIMITS, 4)) * [1, 1, 0.1, 0.1]
    limits[:, :, 0] += rng.choice([0.0, 1.0, 3.0], (COUNT, 1))
    if kind == "once":  # points close to the surface, whose other crossing is far behind them
        b[60:120, 0] = np.abs(b[60:120, 0]) + 0.3
        f[60:120] *= 1e-3
        limits[60:120, :, 0] = rng.uniform(-3, 3, (60, LIMITS)) * f[60:120, None]
    # A surface around the axis, with conditions across it: at its middle nothing changes with the tap.
    b[40:60, 1:] = c[40:60, 1:3] = limits[40:60, :, 2:] = 0
    count = rng.integers(1, LIMITS + 1, COUNT) if kind != "no conditions" else np.zeros(COUNT, int)
    return surfaces(b, c, f, limits, count, rng)


@dataclass(frozen=True)
class Found:
    share: Array
    all_hidden: Array
    left: Array
    count: Array


def found(session: Session, run: Runner, given: Surfaces, gather: int) -> Found:
    points = len(given.count)
    features = {"OCCLUDED": 1, "LIMITED": 1, "GATHER": gather, "SURFACES": points, "TAPS": TAPS}
    sizes = (points * TAPS, points, points * LIMITS * 4, points)
    share, all_hidden, left, count = (empty(session, 4 * size) for size in sizes)
    integers = (given.count.astype(np.int32), given.occluder.crossings.astype(np.int32))
    floats = (array.astype(np.float32) for array in (given.x, given.y))
    run(
        SOURCE.replace("MOST", f"{MOST}f"), "hidden_shares", "double", features, points, given.numbers(),
        given.limits.astype(np.float32), *integers, *floats, share, all_hidden, left, count,
    )  # fmt: skip
    return Found(
        download(session, share, (points, TAPS), np.float32),
        download(session, all_hidden, (points,), np.int32) != 0,
        download(session, left, (points, LIMITS, 4), np.float32),
        download(session, count, (points,), np.int32),
    )


def step(t: Array) -> Array:
    return np.asarray(np.polyval([-2.0, 3.0, 0.0, 0.0], np.clip(t + 0.5, 0, 1)))


def at_taps(p: Array, x: Array, y: Array) -> Array:
    """Polynomials (N, 1 to 6) at taps (N, T)."""
    terms = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y])
    return np.einsum("nk,knt->nt", p, terms[: p.shape[1]])


def independent(given: Surfaces) -> tuple[Array, Array]:
    """Shares (N, T), and how far inside of outlines, over the width of the edge: roots, and what changes from tap to
    tap."""
    m, far = given.occluder, 1e-4
    own, f, soft = m.f0[:, None] == 0, m.f0[:, None], m.soft[:, None]

    def discriminant(x: Array, y: Array) -> Array:
        return at_taps(m.b, x, y) ** 2 - at_taps(m.c, x, y) * f

    def crossing(x: Array, y: Array, sign: float) -> Array:
        b, c, root = at_taps(m.b, x, y), at_taps(m.c, x, y), np.sqrt(np.maximum(discriminant(x, y), 0))
        return np.where(own, -2 * b, -b + sign * root) / c

    def inside(height: Callable[[Array, Array], Array]) -> Array:
        x, y = given.x, given.y
        across, down = height(x + far, y) - height(x - far, y), height(x, y + far) - height(x, y - far)
        return np.asarray(height(x, y) * soft / np.maximum(np.hypot(across, down) / (2 * far), 1e-30))

    def condition(limit: Array, sign: float) -> Array:
        return step(inside(lambda x, y: limit[:, :1] + crossing(x, y, sign) * at_taps(limit[:, 1:], x, y)))

    best = np.zeros_like(given.x)
    for sign in (1.0, -1.0):
        least = np.ones_like(best)
        for k in range(LIMITS):
            share = condition(given.limits[:, k], sign)
            least = np.where(given.count[:, None] > k, np.minimum(least, share), least)
        best = np.maximum(best, np.where(own | (crossing(given.x, given.y, sign) > 0), least, 0))
    away = inside(discriminant)
    return np.where(f > 0, best * step(away), best), away


@pytest.mark.parametrize("gather", [1, 0])
@pytest.mark.parametrize("kind", ["once", "own", "twice", "no conditions"])
def test_shares(session: Session, run_source: Runner, kind: str, gather: int) -> None:
    given = drawn(kind)
    expected, share = given.shares(), found(session, run_source, given, gather).share
    if kind != "no conditions":
        exact, inside = independent(given)
        clear = (inside > 0.25) | (kind != "twice")  # at an outline the crossings change by any amount
        np.testing.assert_allclose(expected[clear], exact[clear], rtol=0, atol=1e-7)
    # Some ten roundings of 6e-8 of numbers around 1, of which the step makes up to some 5 times as much. A little
    # outside of an outline all depends on a difference that is 0 but for rounding.
    error = np.abs(share - expected)
    assert np.quantile(error, 0.999) < 1e-5
    assert error.max() < (3e-4 if kind == "twice" else 1e-5)
    assert ((expected > 0.1) & (expected < 0.9)).mean() > 0.05


@pytest.mark.parametrize("gather", [1, 0])
def test_shares_of_planes(session: Session, run_source: Runner, gather: int) -> None:
    """Each condition is the h of an edge, of which the least share counts."""
    given = drawn("once")
    planes = replace(given, occluder=replace(given.occluder, crossings=np.zeros(COUNT, int)))
    shares = [step(at_taps(given.limits[:, k, :3], given.x, given.y)) for k in range(LIMITS)]
    there = np.arange(LIMITS)[:, None, None] < given.count[:, None]
    expected = np.where(there, shares, 1).min(axis=0)
    np.testing.assert_allclose(found(session, run_source, planes, gather).share, expected, rtol=0, atol=2e-6)
    assert ((expected > 0.1) & (expected < 0.9)).mean() > 0.05


@pytest.mark.parametrize("gather", [1, 0])
@pytest.mark.parametrize("kind", ["once", "own", "twice"])
def test_conditions_that_are_needed(session: Session, run_source: Runner, kind: str, gather: int) -> None:
    """Conditions are left that are not met wherever the lens is looked at, in their order, and with one crossing the
    first.

    Left out is what rounding may decide: where it makes a difference to move conditions by a thousandth.
    """
    given = drawn(kind)
    seen = found(session, run_source, given, gather)
    most = np.full(COUNT, MOST)
    answers = []
    for moved in (-1e-3, 0.0, 1e-3):
        limits = tuple(limit * [1 + moved, 1, 1, 1] for limit in given.occluder.limits)
        all_hidden, kept = twin.hides_all(replace(given.occluder, limits=limits), most)
        answers.append(np.stack([all_hidden, *kept], axis=-1))
    sure = np.all((answers[0] == answers[1]) & (answers[2] == answers[1]), axis=-1)
    all_hidden, needed = answers[1][:, 0], answers[1][:, 1:] & (np.arange(LIMITS) < given.count[:, None])
    assert sure.mean() > 0.95
    np.testing.assert_array_equal(seen.all_hidden[sure], all_hidden[sure])
    np.testing.assert_array_equal(seen.count[sure], needed.sum(axis=1)[sure])
    for i in np.flatnonzero(sure):
        np.testing.assert_array_equal(seen.left[i, : seen.count[i]], given.limits[i][needed[i]].astype(np.float32))


def test_outlines_close_before_a_wall(session: Session, run_source: Runner) -> None:
    """They ask for sub-pixel sources where the wall is so near behind them that they are blurred by 2 px at most."""
    ball, wall = Sphere(center=(-3.0, 4.0, 300.0), radius=25.0), Plane(distance=331.0, slope_x=0.8)
    seen = see(session, run_source, (ball, wall))
    partly = seen.state == PARTLY
    assert_same(seen)
    assert 0.3 < seen.edge[partly].mean() < 0.7


def test_taps_around_a_source_have_room(session: Session, run_source: Runner) -> None:
    """As many rows and columns on each side of a source, and whole vectors from any of them on."""
    size = empty(session, 4 * 4)
    text = """
__kernel void sizes(__global int *size)
{
    if (get_global_id(0) > 0)
        return;
    size[0] = NARROW_MIDDLE, size[1] = NARROW_ROWS, size[2] = NARROW_LANES, size[3] = LANE_COUNT;
}
"""
    run_source(text, "sizes", "double", {"OCCLUDED": 1, "GATHER": 1}, 1, size)
    middle, rows, lanes, vector = download(session, size, (4,), np.int32)
    assert 2 * middle < rows
    assert 2 * middle + vector <= lanes
