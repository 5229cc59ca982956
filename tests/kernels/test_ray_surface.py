"""solve_quadric on the device against exact arithmetic: far, turned, open, degenerate and bounded surfaces."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from decimal import Decimal, localcontext
from functools import cache
from itertools import product
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from clsco.opencl.buffers import download, empty
from clsco.opencl.session import Session
from clsco.records import REAL, Real, structs
from tests.kernels.launches import held, whole
from tests.kernels.test_geometry import FIELD, FLAT, NAPPE, SOURCE

Array = NDArray[Any]
Solve = Callable[[Real, dict[str, int], Array, Array, Array], tuple[Array, Array]]
UNIT = {"double": 2.0**-53, "float": 2.0**-24}  # relative error of an operation


@pytest.fixture
def solve(session: Session, run_source: Callable[..., None]) -> Solve:
    """Inverse depth, all its digits, and label of rays (x, y, 1): as many for each surface, one after the other."""

    def solved(real: Real, features: dict[str, int], surfaces: Array, x: Array, y: Array) -> tuple[Array, Array]:
        w, label = empty(session, 8 * x.size), empty(session, x.size)
        each = np.int32(x.size // surfaces.size)
        rays = surfaces.astype(structs(real)["surface_t"]), x.astype(REAL[real]), y.astype(REAL[real])
        run_source(SOURCE, "solve", real, features, x.size, *rays, np.int32(x.size), each, w, label)
        return whole(session, w, x.shape, real), download(session, label, x.shape, np.uint8)

    return solved


# Exact arithmetic


NOTHING: Any = Decimal(0)
ONE: Any = Decimal(1)
_decimal = np.vectorize(lambda value: Decimal(float(value)), otypes=[object])


@dataclass(frozen=True)
class Exact:
    """Answers for rays: label, inverse depth (Decimal), distance between the two roots relative to the larger; for
    `conditions` canonical rays d, A, D, t = -B -+ sqrt(D), sqrt(D), and whether w is A / t."""

    label: Array
    w: Array
    gap: Array
    d: Array
    a: Array
    discriminant: Array
    t: Array
    root: Array
    of_product: Array


def exactly(surfaces: Array, x: Array, y: Array) -> Exact:
    """C w^2 + 2 B w + A = 0 in 60 digits, from the numbers that the device has, by its definition."""
    each = x.size // surfaces.size

    def per_ray(name: str) -> Array:
        return np.repeat(_decimal(surfaces[name]), each, axis=0)

    turn, o, q, l, k = (per_ray(name) for name in ("turn", "offset", "q", "l", "k"))  # noqa: E741
    ray = np.stack([_decimal(x), _decimal(y), np.full(x.size, ONE)], axis=1)
    with localcontext() as context:
        context.prec = 60
        d = (turn.reshape(-1, 3, 3) * ray[:, None, :]).sum(axis=2)
        a, b = (q * d * d).sum(axis=1), ((q * o + l) * d).sum(axis=1)
        c = ((q * o + 2 * l) * o).sum(axis=1) - k
        discriminant = b * b - a * c
        root = np.array([v.sqrt() if v >= 0 else NOTHING for v in discriminant], dtype=object)
        # Where C = 0 the root t / C is at the lens; where t = 0 both are.
        first_is_sum = np.array(b < 0)
        t = np.where(first_is_sum, -b + root, -b - root)
        of_sum = np.where(c == 0, NOTHING, t / np.where(c == 0, ONE, c))
        of_product = np.where(t == 0, NOTHING, a / np.where(t == 0, ONE, t))
        roots = (np.where(first_is_sum, of_sum, of_product), np.where(first_is_sum, of_product, of_sum))
        nappe = np.repeat(surfaces["nappe"], each).astype(int)
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
    d, a, discriminant, t, root = (v.astype(float) for v in (d, a, discriminant, t, root))
    return Exact(label, w, gap, d, a, discriminant, t, root, (label == 1) != first_is_sum)


def _term_sizes(surfaces: Array, x: Array, y: Array, d: Array, real: Real) -> tuple[Array, Array, Array]:
    """Sizes of the terms of which A, B and D are sums, with what the rounding of a turned ray does to them.

    In double precision o_i d_j - o_j d_i does not feel the size of its products, in single it does.
    """
    each = x.size // surfaces.size
    o, q, l = (np.abs(np.repeat(surfaces[n], each, axis=0)) for n in ("offset", "q", "l"))  # noqa: E741
    k = np.abs(np.repeat(surfaces["k"], each))
    turn = np.repeat(surfaces["turn"], each, axis=0).reshape(-1, 3, 3)
    shares = np.abs(turn * np.stack([x, y, np.ones(x.size)], axis=1)[:, None, :])
    rounded = np.where((shares > 0).sum(axis=2) > 1, shares.sum(axis=2), 0.0)
    across = np.abs(np.cross(np.repeat(surfaces["offset"], each, axis=0), d))
    d = np.abs(d)
    a = (q * d * (d + rounded)).sum(axis=1)
    ld = (l * (d + rounded)).sum(axis=1)
    b = (q * o * (d + rounded)).sum(axis=1) + ld
    i, j = [1, 2, 0], [2, 0, 1]
    products = rounded + d if real == "float" else rounded
    m = across + o[:, i] * products[:, j] + o[:, j] * products[:, i]
    twist = (q[:, i] * q[:, j] * across * m).sum(axis=1)
    mixed = 2 * (q * (d + rounded) * (l[:, i] * m[:, j] + l[:, j] * m[:, i])).sum(axis=1)
    return a, b, k * a + twist + ld**2 + mixed


def conditions(surfaces: Array, x: Array, y: Array, exact: Exact, real: Real) -> tuple[Array, Array, Array]:
    """Condition numbers: what relative errors of one unit in the terms of A, B and D come to, relative to w;
    discriminant and leading coefficient, whose signs decide, relative to their terms."""
    a_size, b_size, d_size = _term_sizes(surfaces, x, y, exact.d, real)
    a, discriminant, t, root = (np.abs(v) for v in (exact.a, exact.discriminant, exact.t, exact.root))
    with np.errstate(divide="ignore", invalid="ignore"):
        least = np.maximum(root, np.sqrt(UNIT[real] * d_size))  # of a discriminant that is only rounding
        condition = 1 + b_size / t + d_size / (2 * least * t) + np.where(exact.of_product, a_size / a, 0.0)
        close_d = np.where(d_size > 0, discriminant / d_size, 0.0)
        close_a = np.where(a_size > 0, a / a_size, 0.0)
    return condition, close_d, close_a


# Surfaces of one kind each, with parameters that both precisions hold exactly, and rays at them


Case = tuple[Array, Array, Array]
RNG = np.random.default_rng


def empty_surfaces(count: int) -> Array:
    surfaces = np.zeros(count, structs("double")["surface_t"])
    surfaces["turn"] = np.eye(3).ravel()
    return surfaces


def finished(surfaces: Array, x: Array, y: Array) -> Case:
    """With the value at the lens, formed exactly as `surfaces.place` does its best to."""
    for name in ("turn", "offset", "q", "l", "k"):
        surfaces[name] = held(surfaces[name])
    with localcontext() as context:
        context.prec = 60
        o, q, l, k = (_decimal(surfaces[name]) for name in ("offset", "q", "l", "k"))  # noqa: E741
        surfaces["at_lens"] = (((q * o + 2 * l) * o).sum(axis=1) - k).astype(float)
    return surfaces, held(x).ravel(), held(y).ravel()


def spheres(count: int, each: int) -> Case:
    """c / rho from 1.0001 to 1e6, in all directions, rays around the limb and inside of it."""
    rng, s = RNG(1), empty_surfaces(count)
    rho = np.rint(64 * np.exp(rng.uniform(-2, 3, count))) / 64 + 1 / 64  # few enough bits for its square
    towards = np.array([0.0, 0.0, 4.0]) + rng.standard_normal((count, 3))
    towards[:, 2] = np.abs(towards[:, 2]) + 0.5
    towards /= np.linalg.norm(towards, axis=1)[:, None]
    ratio = np.exp(np.linspace(np.log(1.0001), np.log(1e6), count))
    center = held(towards * (rho * ratio)[:, None])
    s["q"], s["k"], s["offset"] = 1.0, rho**2, -center
    u = center / np.linalg.norm(center, axis=1)[:, None]
    aside = rng.standard_normal((count, each, 3))
    aside -= (aside * u[:, None]).sum(axis=2, keepdims=True) * u[:, None]
    aside /= np.linalg.norm(aside, axis=2)[:, :, None]
    sine = np.minimum(1 / ratio, 0.999)
    # Within the limb and a little outside, and a fifth of them next to it.
    off_limb = rng.choice([-1, 1], (count, each)) * 2.0 ** -rng.uniform(5, 40, (count, each))
    share = np.where(rng.random((count, each)) < 0.2, 1 + off_limb, np.sqrt(rng.uniform(0, 1.15, (count, each))))
    p = u[:, None] + aside * ((sine / np.sqrt(1 - sine**2))[:, None] * share)[..., None]
    return finished(s, p[..., 0] / p[..., 2], p[..., 1] / p[..., 2])


def turned_quadrics(signs: Callable[[np.random.Generator, int], Array], seed: int) -> Callable[[int, int], Case]:
    """Central quadrics, turned any way and placed before the lens; signs: of q (count, 3), 0 for none."""

    def make(count: int, each: int) -> Case:
        rng, s = RNG(seed), empty_surfaces(count)
        q = signs(rng, count) * np.exp(rng.uniform(-2, 2, (count, 3)))
        definite = (q >= 0).all()
        turn = np.linalg.qr(rng.standard_normal((count, 3, 3)))[0]
        s["turn"], s["q"] = turn.reshape(count, 9), q
        s["k"] = np.exp(rng.uniform(3, 8, count)) * (1 if definite else rng.choice([-1, 1], count))
        linear = np.where((q == 0) & (np.cumsum(q == 0, axis=1) == 1), rng.uniform(-30, 30, (count, 3)), 0.0)
        if not definite:
            s["l"] = linear
        center = rng.uniform([-60, -60, 100], [60, 60, 400], (count, 3))
        s["offset"] = -(turn @ center[:, :, None])[..., 0]
        at = center[:, None, :2] / center[:, None, 2:] + rng.uniform(-0.3, 0.3, (count, each, 2))
        return finished(s, at[..., 0], at[..., 1])

    return make


def asymptotes(count: int, each: int) -> Case:
    """X^2 - Y^2 + 2 l Z = 0 along rays with x = y to some units of float32: the leading coefficient is 0, or nearly."""
    rng, s = RNG(5), empty_surfaces(count)
    s["q"][:, 0], s["q"][:, 1] = 1.0, -1.0
    s["l"][:, 2] = rng.uniform(-30, 30, count)
    s["offset"] = rng.uniform([-60, -60, -400], [60, 60, -100], (count, 3))
    x: Array = rng.uniform(-0.4, 0.4, count * each).astype(np.float32)
    y: Array = x * (1 + rng.integers(-3, 4, x.size) * 2.0**-23).astype(np.float32)
    return finished(s, x, y)


def cones(count: int, each: int) -> Case:
    rng, s = RNG(6), empty_surfaces(count)
    s["q"] = np.array([1.0, 1.0, 0.0])
    s["q"][:, 2] = -(np.tan(np.radians(rng.uniform(3, 85, count))) ** 2)
    s["nappe"] = np.where(np.arange(count) % 2, 1, -1)
    apex = rng.uniform([-60, -60, 100], [60, 60, 400], (count, 3))
    s["offset"] = -apex
    at = apex[:, None, :2] / apex[:, None, 2:] + rng.uniform(-0.4, 0.4, (count, each, 2))
    return finished(s, at[..., 0], at[..., 1])


def any_signs(rng: np.random.Generator, count: int) -> Array:
    return rng.choice([-1.0, 1.0], (count, 3))


def one_missing(rng: np.random.Generator, count: int) -> Array:
    return np.where(np.arange(3) == np.arange(count)[:, None] % 3, 0.0, any_signs(rng, count))


# name: surfaces and rays, features of a program of test_geometry.py
FAMILIES: dict[str, tuple[Callable[[int, int], Case], dict[str, int]]] = {
    "spheres": (spheres, {}),
    "ellipsoids": (turned_quadrics(lambda rng, count: np.ones((count, 3)), 2), {}),
    "cylinders": (turned_quadrics(lambda rng, count: np.tile([1.0, 0.0, 1.0], (count, 1)), 3), {}),
    "central": (turned_quadrics(any_signs, 4), {}),
    "paraboloids": (turned_quadrics(one_missing, 7), FIELD),
    "asymptotes": (asymptotes, FIELD),
    "cones": (cones, NAPPE),
}


@cache
def family_case(family: str) -> tuple[Array, Array, Array, Exact]:
    surfaces, x, y = FAMILIES[family][0](200, 150)
    return surfaces, x, y, exactly(surfaces, x, y)


@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("real", ["double", "float"])
def test_depth_is_exact_but_for_rounding(solve: Solve, family: str, real: Real) -> None:
    _, features = FAMILIES[family]
    surfaces, x, y, exact = family_case(family)
    condition, close_d, close_a = conditions(surfaces, x, y, exact, real)
    w, label = solve(real, features, surfaces, x, y)
    assert 0.1 < (exact.label > 0).mean() < 0.97
    assert np.isfinite(w).all()
    assert (w[label == 0] == 0).all()

    # Hit or miss hangs on the signs of D and A, and a dozen roundings of terms leave at most 16 units of their sum.
    band = 16 * UNIT[real]
    sure = (close_d > band) & (close_a > band)
    assert sure.mean() > (0.95 if real == "double" else 0.75) or family == "asymptotes"
    wrong = sure & ((label > 0) != (exact.label > 0))
    assert not wrong.any(), f"{wrong.sum()} misclassified, the first at ({x[wrong][0]}, {y[wrong][0]})"
    # Two roots that are one but for rounding may change names.
    apart = sure & (exact.gap > 16 * UNIT[real])
    assert (label[apart] == exact.label[apart]).all()
    same = (label > 0) & (label == exact.label)
    difference = np.abs((_decimal(w[same]) - exact.w[same]).astype(float))
    truth, feels = exact.w[same].astype(float), condition[same]
    # First order: A, B and D are each good to some 3 units of their terms, which w feels as its condition says.
    units = difference / truth / UNIT[real] / feels
    worst = int(units.argmax())
    assert units.max() < 3.0, f"{units.max():.2f} units at w = {truth[worst]}, condition {feels[worst]:.3g}"
    if real == "float":
        return
    # The figure to reach: none beyond 2^-20 of the terms that D keeps where it is formed without cancellation.
    far = (close_d > 2.0**-20) & (close_a > 2.0**-20)
    assert far.mean() > 0.8 or family == "asymptotes"
    assert ((label > 0) == (exact.label > 0))[far].all()
    ordered = np.abs((_decimal(w[same].astype(np.float32)) - exact.w[same]).astype(float))
    steps = ordered / np.spacing(np.float32(truth)).astype(float)
    # At limbs and along asymptotes, too. To round otherwise than to the nearest float takes bad luck.
    assert steps.max() <= 1.0
    assert (steps > 0.5).mean() < 1e-3


def test_exact_arithmetic_would_notice_the_textbook_form() -> None:
    """B^2 - A C for far spheres loses in float64 what the test above demands, and in float32 everything."""
    surfaces, x, y = spheres(100, 100)
    exact = exactly(surfaces, x, y)
    condition, _, _ = conditions(surfaces, x, y, exact, "double")
    hit = exact.label > 0

    def textbook(number: type[np.floating[Any]]) -> tuple[Array, Array]:
        o = np.repeat(surfaces["offset"], 100, axis=0).astype(number)
        d = np.stack([x, y, np.ones(x.size)], axis=1).astype(number)
        a, b = (d * d).sum(axis=1), (o * d).sum(axis=1)
        c = np.repeat(surfaces["at_lens"], 100).astype(number)
        return (-b + np.sqrt(np.maximum(b * b - a * c, number(0)))) / c, b * b >= a * c

    w, _ = textbook(np.float64)
    units = np.abs(w[hit] / exact.w[hit].astype(float) - 1) / UNIT["double"] / condition[hit]
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
    w, label = solve(real, FIELD if linear else {}, surfaces, x, y)
    exact = exactly(surfaces, x, y)
    assert x.size > 5000
    assert (exact.discriminant == 0).sum() > 500  # tangent rays, planes through the lens, nothing at all
    wrong = np.flatnonzero(label != exact.label)
    assert wrong.size == 0, f"{wrong.size} of {x.size}, {surfaces[wrong[0] // 16]}, ({x[wrong[0]]}, {y[wrong[0]]})"
    # Root, sum and quotient: three roundings.
    truth = exact.w.astype(float)
    assert (np.abs(w - truth) <= 4 * UNIT[real] * truth).all()


@pytest.mark.parametrize("real", ["double", "float"])
def test_plane_at_the_horizon(solve: Solve, real: Real) -> None:
    """w = (1 - 100 x - 3 y) / 250 passes through 0 without a jump, and below it there is nothing."""
    surface = empty_surfaces(1)
    surface["l"], surface["offset"] = (-50.0, -1.5, 0.5), (0.0, 0.0, -250.0)
    x = np.float32(np.linspace(0.0095, 0.0105, 4001)).astype(float)
    surfaces, x, y = finished(surface, x, np.zeros(x.size))
    w, label = solve(real, FLAT, surfaces, x, y)
    expected = (1.0 - 100.0 * x) / 250.0  # one rounding of float64 each
    assert 0.4 < (expected > 0).mean() < 0.6
    sure = np.abs(1.0 - 100.0 * x) > 4 * UNIT[real]
    assert ((label == 1) == (expected > 0))[sure].all()
    # Two products, a sum and a quotient, relative to the terms 1 / 250.
    assert (np.abs(w - np.maximum(expected, 0)) <= 6 * UNIT[real] / 250.0).all()


def test_apex_and_wrong_nappe_of_a_cone(solve: Solve) -> None:
    surfaces = empty_surfaces(2)
    surfaces["q"], surfaces["offset"], surfaces["nappe"] = (1.0, 1.0, -1.0), (0.0, 0.0, -250.0), [1, -1]
    surfaces, x, y = finished(surfaces, np.tile([0.0, 0.3, 0.6, 0.8, 1.2], 2), np.tile([0.0, 0.4, 0.8, 0.6, 1.6], 2))
    w, label = solve("double", NAPPE, surfaces, x, y)
    # w = (1 -+ r) / 250 with r = 0, 1/2, 1, 1, 2 (those of float32): the far nappe ends at r = 1, the near one never.
    r = np.hypot(x, y)
    sign = np.repeat([-1.0, 1.0], 5)
    np.testing.assert_allclose(w, np.maximum(1.0 + sign * r, 0.0) / 250.0, rtol=1e-14, atol=1e-9)
    assert w[0] == w[5] == 1.0 / 250.0
    assert (label[:2] > 0).all()
    assert label[4] == 0
    assert (label[5:] > 0).all()
