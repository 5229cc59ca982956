"""Random rays over every shape against the oracle: errors of depth, and of hit or miss."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import inf

import numpy as np

from benchmarks.stability import oracle
from benchmarks.stability.doubledouble import Wide
from benchmarks.stability.rays import (
    DOUBTFUL,
    FAMILIES,
    MOST_ZOOMS,
    REALS,
    SIDE,
    Caster,
    RayTarget,
    certain,
    closer,
    random_target,
    single_depth,
    ulps,
)
from clsco.opencl.session import Session
from clsco.records import Real

ALL_RAYS, QUICK_RAYS = 10_000_000, 100_000
CHECKED_RAYS = 4  # of each window that mpmath, too, is asked about
FIGURES: dict[Real, float] = {"double": 1.0, "float": inf}  # units in the last place of float32


@dataclass(frozen=True)
class Surveyed:
    """One family in one precision.

    rays, hits; certain: rays outside of the band around a change of class; worst_ulp: largest error of depth there, in
    float32's, at most `figure`; misclassified: there, misclassified_in_band: within it; oracle_bits: how far the
    oracle and mpmath agree.
    """

    family: str
    precision: Real
    rays: int
    hits: int
    certain: int
    worst_ulp: float
    figure: float
    misclassified: int
    misclassified_in_band: int
    oracle_bits: float

    @property
    def reached(self) -> bool:
        """True if the errors are within the family's figure."""
        return self.figure == inf or (self.worst_ulp <= self.figure and self.misclassified == 0)


def run(session: Session, rays: int, advance: Callable[[], object], seed: int = 1) -> list[Surveyed]:
    """At least so many rays over all families, the same ones in every precision that the device has.

    advance: called once for every family. Raises DeviceError, KernelError.
    """
    found = []
    casters = [Caster(session, real) for real in REALS if real == "float" or session.device.has_fp64]
    for family in FAMILIES:
        rng = np.random.default_rng(seed)
        rows = [Surveyed(family, c.real, 0, 0, 0, 0.0, FIGURES[c.real], 0, 0, 106.0) for c in casters]
        while rows[0].rays < rays / len(FAMILIES):
            target: RayTarget | None = random_target(family, rng)
            for _ in range(1 + int(rng.integers(MOST_ZOOMS + 1))):
                if target is None:
                    break
                rows, target = _window(target, casters, rows, rng)
        found += rows
        advance()
    return found


def _window(
    target: RayTarget, casters: list[Caster], rows: list[Surveyed], rng: np.random.Generator
) -> tuple[list[Surveyed], RayTarget | None]:
    """The rows with one more window, and the window to measure next."""
    of = oracle.surface(target.item, target.motion)
    x, y = target.window.slopes()
    exact = oracle.solve(of, x, y)
    sure = certain(target, of, exact, DOUBTFUL)
    bits = min(_bits(of, x, y, exact.w, at) for at in rng.integers(SIDE, size=(CHECKED_RAYS, 2)).tolist())
    counted = []
    for row, cast in zip(rows, casters, strict=True):
        hit, w = cast(target)
        wrong, both = hit != exact.hit, hit & exact.hit & sure
        at = Wide(exact.w.high[both], exact.w.low[both])
        worst = float(ulps(single_depth(hit, w)[both], at).max(initial=0.0))
        counted.append(
            replace(
                row,
                rays=row.rays + sure.size,
                hits=row.hits + int(exact.hit.sum()),
                certain=row.certain + int(sure.sum()),
                worst_ulp=max(row.worst_ulp, worst),
                misclassified=row.misclassified + int((wrong & sure).sum()),
                misclassified_in_band=row.misclassified_in_band + int((wrong & ~sure).sum()),
                oracle_bits=min(row.oracle_bits, bits),
            )
        )
    return counted, closer(target, exact.hit, rng)


def _bits(of: oracle.Surface, x: Wide, y: Wide, w: Wide, at: list[int]) -> float:
    """Count the bits in which the oracle's and mpmath's inverse depths agree; 0 where one of them misses."""
    place = tuple(at)
    slopes = [oracle.exactly(v.high[place], v.low[place]) for v in (x, y)]
    return oracle.agreement(oracle.exactly(w.high[place], w.low[place]), oracle.solve_mp(of, *slopes))
