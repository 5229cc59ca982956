"""Stencils of a single blur radius for convolve.cl: runs of weights, and rectangles of equal weight (pure)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from clsco.constants import LONGEST_RUN
from clsco.optics.point_spread import PointSpread

SUMMED = 12  # px, least half-width of discs for which rectangles save more time than their sums cost
# Relative times of a pair of sums, and of a weight of the quadrant, which is four taps.
PAIR_COST, WEIGHT_COST = 4.0, 2.0

Weights = NDArray[np.float32]
Rectangle = tuple[int, int]


@dataclass(frozen=True)
class Stencil:
    """The PSF of one radius, or one of its two factors, as a sum of runs and rectangles, exact up to float32.

    runs: int32 (count, 4): |dx|, first dy, number of weights, index of the first in `weights`. The kernel adds every
    run at -dx and at dx, so weights of runs with dx = 0 are halved. weights: of all runs, concatenated. rectangles:
    half-widths in x and in y, ordered from wide to narrow, which is from low to high. Their union has the weight
    `share`; runs add to this weight or subtract from it.
    """

    runs: NDArray[np.int32]
    weights: Weights
    rectangles: tuple[Rectangle, ...] = ()
    share: float = 0.0

    @property
    def reach(self) -> tuple[int, int]:
        """Largest |dx| and |dy| of a run."""
        dx, dy, count, _ = self.runs.T
        return int(dx.max(initial=0)), int((dy + count - 1).max(initial=0))

    @property
    def area(self) -> int:
        """Pixels in the union of the rectangles."""
        below = [-1, *(b for _, b in self.rectangles)]
        bands = (2 * b + 1 - max(2 * inner + 1, 0) for inner, b in pairwise(below))
        return sum((2 * a + 1) * rows for (a, _), rows in zip(self.rectangles, bands, strict=True))

    @property
    def pairs(self) -> NDArray[np.int32]:
        """Terms of the union in a summed-area table: int32 (count, 4), (dy, dx) to add and (dy, dx) to subtract."""
        pairs, inner = list[tuple[int, int, int, int]](), -1
        for a, b in self.rectangles:
            pairs += [(b, a, b, -a - 1), (-b - 1, -a - 1, -b - 1, a)]
            if inner >= 0:
                pairs += [(inner, -a - 1, inner, a), (-inner - 1, a, -inner - 1, -a - 1)]
            inner = b
        return np.array(pairs, np.int32).reshape(-1, 4)


def is_summed(psf: PointSpread, half_width: int) -> bool:
    """True if PSFs with this half-width in px use rectangles."""
    return psf.uniform and half_width >= SUMMED


def is_by_axes(psf: PointSpread) -> bool:
    """True if a PSF has two stencils, one for rows and one for columns."""
    return psf.layout == "separable"


def stencil_sizes(psf: PointSpread, far: int) -> dict[str, int]:
    """Upper bounds in bytes of the arrays of `stencils` for PSFs that reach at most `far` px, by name and stencil.

    A column of a disc has at most two pieces, above and below the rectangles, and each is cut into runs.
    """
    half, row = far + 1, 2 * far + 1
    runs = -(-row // LONGEST_RUN)
    if is_by_axes(psf):
        return {"runs 0": 16 * half, "weights 0": 4 * half, "runs 1": 16 * runs, "weights 1": 4 * row}
    sizes = {"runs 0": 16 * half * (runs + 1), "weights 0": 4 * half * row}
    return sizes | ({"pairs 0": 16 * (4 * half - 2)} if is_summed(psf, far) else {})


@lru_cache(maxsize=64)
def stencils(psf: PointSpread, radius: float) -> tuple[Stencil, ...]:
    """Stencils whose convolution is the PSF of one |R| in px: one, or for a separable PSF one per axis."""
    far = psf.reach(radius)
    offset = np.arange(far + 1.0)
    if is_by_axes(psf):
        line = psf.axis_weights(offset, np.asarray(radius)).astype(np.float32)
        return Stencil(*_runs(line[None, :])), Stencil(*_runs(line[:, None]))
    quadrant = psf.weights(offset[None, :], offset[:, None], np.asarray(radius)).astype(np.float32)
    share = quadrant[0, 0]
    rectangles = _rectangles(quadrant == share, quadrant >= share / 2) if is_summed(psf, far) else ()
    inside = np.zeros_like(quadrant)
    for a, b in rectangles:
        inside[: b + 1, : a + 1] = share
    # The difference is exact, as weights inside rectangles are at least half of the share.
    return (Stencil(*_runs(quadrant - inside), rectangles, float(share)),)


def _rectangles(same: NDArray[np.bool_], half: NDArray[np.bool_]) -> tuple[Rectangle, ...]:
    """Rectangles for a quadrant of a disc with a constant weight in its middle, chosen to minimize time.

    same: mask of pixels with that weight; half: mask of pixels with at least half of it. Rectangles may cover `half`,
    because runs that subtract the excess are needed anyway. The optimum is a shortest path over rows where they end.
    """
    filled, allowed = same.sum(axis=1), half.sum(axis=1)
    count = int((allowed > 0).sum())
    cost, before = np.zeros(count + 1), np.zeros(count + 1, np.intp)
    for end in range(1, count + 1):
        missing = np.maximum(filled[:end] - allowed[end - 1], 0)[::-1].cumsum()[::-1]
        costs = cost[:end] + 4 * PAIR_COST + WEIGHT_COST * missing
        before[end] = costs.argmin()
        cost[end] = costs.min()
    above = np.append(filled[:count][::-1].cumsum()[::-1], 0)
    end, rectangles = int((cost + WEIGHT_COST * above).argmin()), list[Rectangle]()
    while end:
        rectangles.append((int(allowed[end - 1]) - 1, end - 1))
        end = int(before[end])
    return tuple(rectangles[::-1])


def _runs(quadrant: Weights) -> tuple[NDArray[np.int32], Weights]:
    """Runs of a PSF (|dy|, |dx|) and their weights, as in Stencil."""
    runs, weights, start = list[tuple[int, int, int, int]](), [np.zeros(0, np.float32)], 0
    for dx, half in enumerate(quadrant.T):
        column = np.concatenate([half[:0:-1], half]) * np.float32(1.0 if dx else 0.5)
        lit = np.flatnonzero(column)
        for together in np.split(lit, np.flatnonzero(np.diff(lit) > 1) + 1):
            for run in np.array_split(together, -(-len(together) // LONGEST_RUN)) if len(together) else ():
                runs.append((dx, int(run[0]) - len(half) + 1, len(run), start))
                weights.append(column[run])
                start += len(run)
    return np.array(runs, np.int32).reshape(-1, 4), np.concatenate(weights)
