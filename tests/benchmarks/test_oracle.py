"""The oracle: its arithmetic against fractions, its depths against mpmath, and whether it notices a bad solution."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction

import mpmath
import numpy as np
import pytest
from numpy.typing import NDArray

from benchmarks.stability import oracle
from benchmarks.stability.doubledouble import Wide, rounded, wide
from benchmarks.stability.hardgeometry import textbook
from benchmarks.stability.rays import (
    DOUBTFUL,
    FAMILIES,
    RayTarget,
    Window,
    certain,
    closer,
    random_target,
    single_depth,
    ulps,
)
from clsco.scene.model import ObjectMotion, Sphere
from tests.slow import mostly_slow

U = Fraction(1, 2**53)


def fractions(values: Wide) -> list[Fraction]:
    return [Fraction(h) + Fraction(low) for h, low in zip(values.high.tolist(), values.low.tolist(), strict=True)]


def some(rng: np.random.Generator) -> Wide:
    high = rng.standard_normal(400) * np.exp(rng.uniform(-40, 40, 400))
    return wide(high) + wide(high * rng.uniform(-1, 1, 400) * 2.0**-54)


@pytest.mark.parametrize(
    ("name", "bound"), [("add", 3), ("subtract", 3), ("multiply", 7), ("divide", 15), ("root", 4), ("cancel", 3)]
)
def test_arithmetic_of_106_bits(name: str, bound: int) -> None:
    """Bounds in u^2 of Joldes, Muller, Popescu (2017), tables 1 and 2; also where nearly all of a sum cancels."""
    rng = np.random.default_rng(7)
    a, b = some(rng), some(rng)
    if name == "cancel":
        b = -a * wide(1.0 + 2.0**-60 * np.arange(400))
    calls: dict[str, Callable[[], Wide]] = {
        "add": lambda: a + b,
        "cancel": lambda: a + b,
        "subtract": lambda: a - b,
        "multiply": lambda: a * b,
        "divide": lambda: a / b,
        "root": lambda: (a * a).sqrt(),
    }
    found = fractions(calls[name]())
    for x, y, z, square in zip(fractions(a), fractions(b), found, fractions(a * a), strict=True):
        if name == "root":
            assert abs(z * z - square) <= 2 * bound * U**2 * square
            continue
        exact = {"subtract": x - y, "multiply": x * y, "divide": x / y}.get(name, x + y)
        assert abs(z - exact) <= bound * U**2 * abs(exact)


def test_numbers_of_more_digits_are_rounded() -> None:
    with mpmath.workdps(oracle.DIGITS):
        third = rounded([mpmath.mpf(1) / 3])
    assert abs(fractions(third)[0] - Fraction(1, 3)) < Fraction(1, 2**106)


@pytest.mark.parametrize("family", mostly_slow(FAMILIES, ["plane", "cone", "indefinite quadric"]))
def test_depths_are_those_of_mpmath(family: str) -> None:
    """On and off outlines: 106 bits, less those that cancel at c / rho = 1e6 (40) and at an outline (20)."""
    rng = np.random.default_rng(11)
    hits = compared = 0
    for _ in range(6):
        target: RayTarget | None = random_target(family, rng)
        for _ in range(2):
            assert target is not None
            of = oracle.surface(target.item, target.motion)
            x, y = target.window.slopes()
            found = oracle.solve(of, x, y)
            sure = certain(target, of, found, DOUBTFUL)
            for i, j in rng.integers(64, size=(25, 2)).tolist():
                if not sure[i, j]:
                    continue
                slopes = (oracle.exactly(v.high[i, j], v.low[i, j]) for v in (x, y))
                exact = oracle.solve_mp(of, *slopes)
                assert (exact > 0) == found.hit[i, j]
                assert oracle.agreement(oracle.exactly(found.w.high[i, j], found.w.low[i, j]), exact) > 46
                hits, compared = hits + bool(exact > 0), compared + 1
            target = closer(target, found.hit, rng) or random_target(family, rng)
    assert compared > 200
    assert 20 < hits < compared


def test_agreement_counts_bits() -> None:
    one, zero = oracle.exactly(1.0, 0.0), oracle.exactly(0.0, 0.0)
    assert oracle.agreement(one, one) == 106.0
    assert oracle.agreement(one, oracle.exactly(1.0, 2.0**-60)) == pytest.approx(60.0)
    assert oracle.agreement(one, zero) == oracle.agreement(zero, one) == 0.0


def test_the_textbook_form_is_found() -> None:
    """A sphere of 1 mm at 1e4 mm in float32: most rays are of another class, and the band hides none of it."""
    target = RayTarget(Sphere(radius=1.0, center=(0.0, 0.0, 1e4)), ObjectMotion(), Window(2.4e-4 / 64))
    of = oracle.surface(target.item, target.motion)
    x, y = target.window.slopes()
    exact = oracle.solve(of, x, y)
    sure: NDArray[np.bool_] = certain(target, of, exact, DOUBTFUL)
    hit, z = textbook(target.item, x.high.astype(np.float32), y.high.astype(np.float32))
    assert sure.mean() > 0.99
    assert 0.4 < exact.hit.mean() < 0.7
    assert (sure & (hit != exact.hit)).mean() > 0.3
    both = hit & exact.hit
    assert ulps(z[both], Wide(exact.w.high[both], exact.w.low[both])).max(initial=0.0) > 100
    # A depth that is rounded to float32 once is half a unit off at most.
    right = single_depth(exact.hit, exact.w.high)[exact.hit]
    at = Wide(exact.w.high[exact.hit], exact.w.low[exact.hit])
    assert 0.4 < ulps(right, at).max() <= 0.5 + 1e-6
