"""solve_quadric on the device against exact arithmetic: far, turned, open, degenerate and bounded surfaces."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from decimal import Decimal, localcontext
from itertools import product
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from clsco.device import Session
from clsco.layout import Real, structs, surface_structs
from clsco.motion import pose_at
from clsco.program import download, empty
from clsco.scene import ObjectMotion, Sphere
from clsco.surfaces import place

Array = NDArray[Any]
Solve = Callable[[Real, dict[str, int], Array, Array, Array], tuple[Array, Array]]
UNIT = {"double": 2.0**-53, "float": 2.0**-24}  # largest relative error of one rounding
NUMBER: dict[str, type[np.floating[Any]]] = {"double": np.float64, "float": np.float32}

SOURCE = """\
__kernel void solve(__constant surface_t *surfaces, __global const real *x, __global const real *y, const int count,
                    const int each, __global real *w, __global uchar *label)
{
    const int i = get_global_id(0);
    if (i >= count)
        return;
    uchar root;
    w[i] = solve_quadric(surfaces + i / each, (real3)(x[i], y[i], 1), &root);
    label[i] = root;
}
"""


@pytest.fixture
def solve(session: Session, run_source: Callable[..., None]) -> Solve:
    """Inverse depth and label of rays (x, y, 1): as many for each of the surfaces, one after the other."""

    def solved(real: Real, features: dict[str, int], surfaces: Array, x: Array, y: Array) -> tuple[Array, Array]:
        number, count = NUMBER[real], np.int32(x.size)
        w, label = (empty(session, x.size * size) for size in (number().itemsize, 1))
        slopes = (x.astype(number), y.astype(number))
        each = np.int32(x.size // surfaces.size)
        run_source(SOURCE, "solve", real, features, x.size, surfaces, *slopes, count, each, w, label)
        return download(session, w, x.shape, number), download(session, label, x.shape, np.uint8)

    return solved


# Exact arithmetic


NOTHING: Any = Decimal(0)
ONE: Any = Decimal(1)
_decimal = np.vectorize(lambda value: Decimal(float(value)), otypes=[object])


@dataclass(frozen=True)
class Exact:
    """Answers for rays: label, inverse depth (Decimal), and how much of it rounding may change.

    condition: what relative errors of one unit in the terms of A, B and D come to, relative to w; close_d, close_a:
    discriminant and leading coefficient relative to their terms, whose signs decide; gap: between the two roots.
    """

    label: Array
    w: Array
    condition: Array
    close_d: Array
    close_a: Array
    gap: Array


def exactly(surfaces: Array, x: Array, y: Array, real: Real) -> Exact:
    """C w^2 + 2 B w + A = 0 in 60 digits, from the numbers that the device has, by its definition."""
    each = x.size // surfaces.size

    def per_ray(name: str) -> Array:
        return np.repeat(surfaces[name], each, axis=0)

    turn, o, q, l, k = (_decimal(per_ray(name)) for name in ("turn", "offset", "q", "l", "k"))  # noqa: E741
    ray = np.stack([_decimal(x), _decimal(y), _decimal(np.ones(x.size))], axis=1)
    with localcontext() as context:
        context.prec = 60
        d = (turn.reshape(-1, 3, 3) * ray[:, None, :]).sum(axis=2)
        a, b = (q * d * d).sum(axis=1), ((q * o + l) * d).sum(axis=1)
        c = ((q * o + 2 * l) * o).sum(axis=1) - k
        discriminant = b * b - a * c
        root = np.array([v.sqrt() if v >= 0 else Decimal(0) for v in discriminant], dtype=object)
        # Where C = 0 the root t / C is at the lens; where t = 0 both are.
        first_is_sum = np.array(b < 0)
        t = np.where(first_is_sum, -b + root, -b - root)
        of_sum = np.where(c == 0, NOTHING, t / np.where(c == 0, ONE, c))
        of_product = np.where(t == 0, NOTHING, a / np.where(t == 0, ONE, t))
        roots = (np.where(first_is_sum, of_sum, of_product), np.where(first_is_sum, of_product, of_sum))
        nappe = per_ray("nappe").astype(int)
        counts = [
            np.array(discriminant >= 0) & np.array(w > 0) & np.array(w < 10**6)
            & np.array(nappe * (o[:, 2] * w + d[:, 2]) >= 0)
            for w in roots
        ]  # fmt: skip
        first = counts[0] & (~counts[1] | np.array(roots[0] >= roots[1]))
        w = np.where(first, roots[0], np.where(counts[1], roots[1], NOTHING))
        label = np.where(first, 1, np.where(counts[1], 2, 0))
        gap = np.array(
            [float(abs(r - s) / max(abs(r), abs(s), Decimal(10) ** -30)) for r, s in zip(*roots, strict=True)]
        )
    sizes = _term_sizes(surfaces, x, y, d.astype(float))
    return Exact(label, w, *_conditions(sizes, a, discriminant, t, root, (label == 1) != first_is_sum, real), gap)


def _term_sizes(surfaces: Array, x: Array, y: Array, d: Array) -> tuple[Array, Array, Array]:
    """Sizes of the terms of which A, B and D are sums, with what the rounding of a turned ray does to them."""
    each = x.size // surfaces.size
    o, q, l = (np.abs(np.repeat(surfaces[n].astype(float), each, axis=0)) for n in ("offset", "q", "l"))  # noqa: E741
    k = np.abs(np.repeat(surfaces["k"].astype(float), each))
    turn = np.repeat(surfaces["turn"].astype(float), each, axis=0).reshape(-1, 3, 3)
    shares = np.abs(turn * np.stack([x, y, np.ones(x.size)], axis=1)[:, None, :])
    rounded = np.where((shares > 0).sum(axis=2) > 1, shares.sum(axis=2), 0.0)
    d = np.abs(d)
    a = (q * d * (d + rounded)).sum(axis=1)
    ld = (l * (d + rounded)).sum(axis=1)
    b = (q * o * (d + rounded)).sum(axis=1) + ld
    signed = np.repeat(surfaces["offset"].astype(float), each, axis=0)
    across = np.abs(np.cross(signed, (turn * np.stack([x, y, np.ones(x.size)], 1)[:, None, :]).sum(2)))
    i, j = [1, 2, 0], [2, 0, 1]
    m = across + o[:, i] * rounded[:, j] + o[:, j] * rounded[:, i]
    twist = (q[:, i] * q[:, j] * across * m).sum(axis=1)
    mixed = 2 * (q * (d + rounded) * (l[:, i] * m[:, j] + l[:, j] * m[:, i])).sum(axis=1)
    return a, b, k * a + twist + ld**2 + mixed


def _conditions(
    sizes: tuple[Array, Array, Array],
    a: Array,
    discriminant: Array,
    t: Array,
    root: Array,
    of_product: Array,
    real: Real,
) -> tuple[Array, Array, Array]:
    a_size, b_size, d_size = sizes
    a, t, root, discriminant = (np.abs(v.astype(float)) for v in (a, t, root, discriminant))
    with np.errstate(divide="ignore", invalid="ignore"):
        least = np.maximum(root, np.sqrt(UNIT[real] * d_size))  # of a discriminant that is only rounding
        condition = 1 + b_size / t + d_size / (2 * least * t) + np.where(of_product, a_size / a, 0.0)
        close_d = np.where(d_size > 0, discriminant / d_size, 0.0)
        close_a = np.where(a_size > 0, a / a_size, 0.0)
    return condition, close_d, close_a


# Surfaces of one kind each, with parameters that float32 holds exactly, and rays at them


Case = tuple[Array, Array, Array]
RNG = np.random.default_rng


def empty_surfaces(count: int, real: Real) -> Array:
    surfaces = np.zeros(count, structs(real)["surface_t"])
    surfaces["turn"] = np.eye(3).ravel()
    return surfaces


def finished(surfaces: Array, x: Array, y: Array) -> Case:
    """With the value at the lens, formed exactly as `surfaces.place` does its best to."""
    with localcontext() as context:
        context.prec = 60
        o, q, l, k = (_decimal(surfaces[name]) for name in ("offset", "q", "l", "k"))  # noqa: E741
        surfaces["at_lens"] = (((q * o + 2 * l) * o).sum(axis=1) - k).astype(float)
    return surfaces, np.float32(x).astype(float).ravel(), np.float32(y).astype(float).ravel()


def spheres(count: int, each: int, real: Real) -> Case:
    """c / rho from 1.01 to 1e6, in all directions, rays around the limb and inside of it."""
    rng, s = RNG(1), empty_surfaces(count, real)
    rho = np.rint(64 * np.exp(rng.uniform(-2, 3, count))) / 64 + 1 / 64  # few enough bits for its square
    towards = np.array([0.0, 0.0, 4.0]) + rng.standard_normal((count, 3))
    towards[:, 2] = np.abs(towards[:, 2]) + 0.5
    towards /= np.linalg.norm(towards, axis=1)[:, None]
    ratio = np.exp(np.linspace(np.log(1.01), np.log(1e6), count))
    center = np.float32(towards * (rho * ratio)[:, None]).astype(float)
    s["q"], s["k"], s["offset"] = 1.0, rho**2, -center
    u = center / np.linalg.norm(center, axis=1)[:, None]
    aside = rng.standard_normal((count, each, 3))
    aside -= (aside * u[:, None]).sum(axis=2, keepdims=True) * u[:, None]
    aside /= np.linalg.norm(aside, axis=2)[:, :, None]
    sine = np.minimum(1 / ratio, 0.999)
    p = u[:, None] + aside * (sine / np.sqrt(1 - sine**2))[:, None, None] * np.sqrt(
        rng.uniform(0, 1.15, (count, each, 1))
    )
    return finished(s, p[..., 0] / p[..., 2], p[..., 1] / p[..., 2])


def turned_quadrics(signs: Callable[[np.random.Generator, int], Array], seed: int) -> Callable[[int, int, Real], Case]:
    """Central quadrics, turned any way and placed before the lens; signs: of q (count, 3), 0 for none."""

    def make(count: int, each: int, real: Real) -> Case:
        rng, s = RNG(seed), empty_surfaces(count, real)
        q = signs(rng, count) * np.exp(rng.uniform(-2, 2, (count, 3)))
        definite = (q >= 0).all()
        turn = np.float32(np.linalg.qr(rng.standard_normal((count, 3, 3)))[0]).astype(float)
        s["turn"], s["q"] = turn.reshape(count, 9), np.float32(q)
        s["k"] = np.float32(np.exp(rng.uniform(3, 8, count)) * (1 if definite else rng.choice([-1, 1], count)))
        linear = np.where((q == 0) & (np.cumsum(q == 0, axis=1) == 1), rng.uniform(-30, 30, (count, 3)), 0.0)
        if not definite:
            s["l"] = np.float32(linear)
        center = rng.uniform([-60, -60, 100], [60, 60, 400], (count, 3))
        s["offset"] = np.float32(-(turn @ center[:, :, None])[..., 0])
        at = center[:, None, :2] / center[:, None, 2:] + rng.uniform(-0.3, 0.3, (count, each, 2))
        return finished(s, at[..., 0], at[..., 1])

    return make


def asymptotes(count: int, each: int, real: Real) -> Case:
    """X^2 - Y^2 + 2 l Z = 0 along rays with x = y to some units of float32: the leading coefficient is 0, or nearly."""
    rng, s = RNG(5), empty_surfaces(count, real)
    s["q"][:, 0], s["q"][:, 1] = 1.0, -1.0
    s["l"][:, 2] = np.float32(rng.uniform(-30, 30, count))
    s["offset"] = np.float32(rng.uniform([-60, -60, -400], [60, 60, -100], (count, 3)))
    x: Array = rng.uniform(-0.4, 0.4, count * each).astype(np.float32)
    y: Array = x * (1 + rng.integers(-3, 4, x.size) * 2.0**-23).astype(np.float32)
    return finished(s, x, y)


def cones(count: int, each: int, real: Real) -> Case:
    rng, s = RNG(6), empty_surfaces(count, real)
    s["q"] = np.array([1.0, 1.0, 0.0])
    s["q"][:, 2] = -np.float32(np.tan(np.radians(rng.uniform(3, 85, count))) ** 2)
    s["nappe"] = np.where(np.arange(count) % 2, 1, -1)
    apex = np.float32(rng.uniform([-60, -60, 100], [60, 60, 400], (count, 3))).astype(float)
    s["offset"] = -apex
    at = apex[:, None, :2] / apex[:, None, 2:] + rng.uniform(-0.4, 0.4, (count, each, 2))
    return finished(s, at[..., 0], at[..., 1])


def any_signs(rng: np.random.Generator, count: int) -> Array:
    return rng.choice([-1.0, 1.0], (count, 3))


def one_missing(rng: np.random.Generator, count: int) -> Array:
    return np.where(np.arange(3) == np.arange(count)[:, None] % 3, 0.0, any_signs(rng, count))


# name: surfaces and rays, features, whether all q have one sign
FAMILIES: dict[str, tuple[Callable[[int, int, Real], Case], dict[str, int], bool]] = {
    "spheres": (spheres, {}, True),
    "ellipsoids": (turned_quadrics(lambda rng, count: np.ones((count, 3)), 2), {}, True),
    "cylinders": (turned_quadrics(lambda rng, count: np.tile([1.0, 0.0, 1.0], (count, 1)), 3), {}, True),
    "central": (turned_quadrics(any_signs, 4), {}, False),
    "paraboloids": (turned_quadrics(one_missing, 7), {"LINEAR": 1}, False),
    "asymptotes": (asymptotes, {"LINEAR": 1}, False),
    "cones": (cones, {"NAPPE": 1}, False),
}


@pytest.mark.parametrize("real", ["double", "float"])
@pytest.mark.parametrize("family", FAMILIES)
def test_depth_is_exact_but_for_rounding(solve: Solve, family: str, real: Real) -> None:
    make, features, definite = FAMILIES[family]
    surfaces, x, y = make(100, 100, real)
    w, label = solve(real, features, surfaces, x, y)
    exact = exactly(surfaces, x, y, real)
    assert 0.1 < (exact.label > 0).mean() < 0.97
    assert np.isfinite(w).all()
    assert (w[label == 0] == 0).all()

    # Hit or miss hangs on the signs of D and A. A dozen roundings of terms leave at most 2^-20 of their sum in float32,
    # the figure to reach, and 2^-49 in float64.
    band = 16 * UNIT[real]
    sure = (exact.close_d > band) & (exact.close_a > band)
    assert sure.mean() > 0.9 or family == "asymptotes"
    wrong = sure & ((label > 0) != (exact.label > 0))
    assert not wrong.any(), f"{wrong.sum()} misclassified, the first at ({x[wrong][0]}, {y[wrong][0]})"
    # Two roots that are one but for rounding may change names.
    apart = sure & (exact.gap > 16 * UNIT[real])
    assert (label[apart] == exact.label[apart]).all()

    same = (label > 0) & (label == exact.label)
    difference = np.abs((_decimal(w[same]) - exact.w[same]).astype(float))
    truth, condition = exact.w[same].astype(float), exact.condition[same]
    # First order: A, B and D are each good to some 3 units of their terms, which w feels as its condition says.
    units = difference / truth / UNIT[real] / condition
    worst = int(units.argmax())
    assert units.max() < 3.0, f"{units.max():.2f} units at w = {truth[worst]}, condition {condition[worst]:.3g}"
    steps = difference / np.spacing(np.float32(truth)).astype(float)
    if real == "double":
        well = condition < 2.0**26  # float32 keeps a digit less than float64 loses
        ordered = np.abs(_decimal(w[same].astype(np.float32)) - exact.w[same]).astype(float)
        assert (ordered / np.spacing(np.float32(truth)).astype(float))[well].max() <= 1.0
        assert well.mean() > 0.99 or family == "asymptotes"
    else:  # the figures to reach, away from limbs, grazing rays and asymptotes
        assert steps[condition < 6].max() <= (5.0 if definite else 16.0)
        assert (condition < 6).mean() > (0.5 if family != "asymptotes" else 0.3)


def test_exact_arithmetic_would_notice_the_textbook_form() -> None:
    """B^2 - A C for far spheres loses in float64 what the test above demands, and in float32 everything."""
    surfaces, x, y = spheres(100, 100, "double")
    exact = exactly(surfaces, x, y, "double")
    hit = exact.label > 0

    def textbook(number: type[np.floating[Any]]) -> tuple[Array, Array]:
        o = np.repeat(surfaces["offset"], 100, axis=0).astype(number)
        d = np.stack([x, y, np.ones(x.size)], axis=1).astype(number)
        a, b = (d * d).sum(axis=1), (o * d).sum(axis=1)
        c = np.repeat(surfaces["at_lens"], 100).astype(number)
        return (-b + np.sqrt(np.maximum(b * b - a * c, number(0)))) / c, b * b >= a * c

    w, _ = textbook(np.float64)
    units = np.abs(w[hit] / exact.w[hit].astype(float) - 1) / UNIT["double"] / exact.condition[hit]
    assert units.max() > 30
    _, found = textbook(np.float32)
    assert (found != hit).mean() > 0.1


def small_integers(linear: bool) -> tuple[Array, Array, Array]:
    """Every small quadric against every small ray: touching, double and missing roots, the lens on the surface."""
    values = (-1.0, 0.0, 1.0)
    rows = []
    for q in product(values, repeat=3):
        if not any(q):
            continue
        free = [i for i in range(3) if q[i] == 0]
        if linear != bool(free):
            continue
        for k, l, o in product(values, (0.5, 1.0) if linear else (0.0,), product((-2.0, 0.0, 1.0), repeat=3)):  # noqa: E741
            rows.append((q, tuple(l * (i == free[0]) for i in range(3)) if free else (0.0,) * 3, k, o))
    surfaces = np.zeros(len(rows), structs("double")["surface_t"])
    surfaces["turn"] = np.eye(3).ravel()
    for name, column in zip(("q", "l", "k", "offset"), zip(*rows, strict=True), strict=True):
        surfaces[name] = np.array(column)
    rays = np.array(list(product((-1.0, 0.0, 1.0, 2.0), repeat=2)))
    x, y = np.tile(rays, (len(rows), 1)).T
    return finished(surfaces, x, y)


@pytest.mark.parametrize("real", ["double", "float"])
@pytest.mark.parametrize("linear", [False, True])
def test_degenerate_cases_are_exact(solve: Solve, linear: bool, real: Real) -> None:
    """Small integers leave no rounding in A, B, C and D: every class must be right, and nothing is NaN."""
    surfaces, x, y = small_integers(linear)
    packed = surfaces.astype(structs(real)["surface_t"])
    w, label = solve(real, {"LINEAR": int(linear)}, packed, x, y)
    exact = exactly(surfaces, x, y, real)
    assert x.size > 5000
    assert (exact.close_d == 0).sum() > 500  # tangent rays, planes through the lens, nothing at all
    wrong = np.flatnonzero(label != exact.label)
    assert wrong.size == 0, f"{wrong.size} of {x.size}, {surfaces[wrong[0] // 16]}, ({x[wrong[0]]}, {y[wrong[0]]})"
    # Root, sum and quotient: three roundings.
    truth = exact.w.astype(float)
    assert (np.abs(w - truth) <= 4 * UNIT[real] * truth).all()


@pytest.mark.parametrize("real", ["double", "float"])
def test_plane_at_the_horizon(solve: Solve, real: Real) -> None:
    """w = (1 - 100 x - 3 y) / 250 passes through 0 without a jump, and below it there is nothing."""
    surface = empty_surfaces(1, real)
    surface["l"], surface["offset"] = (-50.0, -1.5, 0.5), (0.0, 0.0, -250.0)
    x = np.float32(np.linspace(0.0095, 0.0105, 4001)).astype(float)
    surfaces, x, y = finished(surface, x, np.zeros(x.size))
    w, label = solve(real, {"QUADRATIC": 0}, surfaces, x, y)
    expected = (1.0 - 100.0 * x) / 250.0  # one rounding of float64 each
    assert 0.4 < (expected > 0).mean() < 0.6
    sure = np.abs(1.0 - 100.0 * x) > 4 * UNIT[real]
    assert ((label == 1) == (expected > 0))[sure].all()
    # Two products, a sum and a quotient, relative to the terms 1 / 250.
    assert (np.abs(w - np.maximum(expected, 0)) <= 6 * UNIT[real] / 250.0).all()


def test_apex_and_wrong_nappe_of_a_cone(solve: Solve) -> None:
    surfaces = empty_surfaces(2, "double")
    surfaces["q"], surfaces["offset"], surfaces["nappe"] = (1.0, 1.0, -1.0), (0.0, 0.0, -250.0), [1, -1]
    surfaces, x, y = finished(surfaces, np.tile([0.0, 0.3, 0.6, 0.8, 1.2], 2), np.tile([0.0, 0.4, 0.8, 0.6, 1.6], 2))
    w, label = solve("double", {"NAPPE": 1}, surfaces, x, y)
    # w = (1 -+ r) / 250 with r = 0, 1/2, 1, 1, 2 (those of float32): the far nappe ends at r = 1, the near one never.
    r = np.hypot(x, y)
    sign = np.repeat([-1.0, 1.0], 5)
    np.testing.assert_allclose(w, np.maximum(1.0 + sign * r, 0.0) / 250.0, rtol=1e-14, atol=1e-9)
    assert w[0] == w[5] == 1.0 / 250.0
    assert (label[:2] > 0).all()
    assert label[4] == 0
    assert (label[5:] > 0).all()


@pytest.mark.parametrize("real", ["double", "float"])
def test_bounds_give_way_and_do_not_cut_what_they_touch(solve: Solve, real: Real) -> None:
    ball = ((-30.0, 30.0),) * 3
    boxes: list[tuple[Any, list[float]]] = [
        (ball, [250.0, 251.0]),  # it touches the box at its nearest point
        (((-30.0, 30.0), (-30.0, 30.0), (0.0, 31.0)), [310.0, 309.0]),
        (((5.0, 30.0), (-30.0, 30.0), (-30.0, 30.0)), [0.0, 251.0]),
    ]
    for bounds, depths in boxes:
        item = Sphere(bounds=bounds)
        placed = surface_structs([item], [place(item, pose_at(ObjectMotion(), 0.0, "euler"))], real)
        w, label = solve(real, {"BOUNDED": 1}, placed, np.array([0.0, 0.03]), np.zeros(2))
        found = np.where(label > 0, 1 / np.where(label > 0, w, 1), 0)
        np.testing.assert_allclose(found, depths, rtol=3e-3)  # which surface, not how exactly
        assert (found > 0).tolist() == [d > 0 for d in depths]
