"""Rules of mean/median filling (thesis, chapter 5), shared by host and reference: constants, scores, threshold.

Decisions use integers, so that every device and the reference agree: scores are exact sums of squared differences
between values rounded to about 2^-16 of their range.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import comb, frexp
from numbers import Real
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from clsco.errors import SceneError

COUNTS = range(4, 9)
"""Counts of known neighbors for which mean and median are scored; with fewer neighbors, the mean is used."""
STEPS = 2**16  # largest number of steps in the range of the values, for scores; sums of 4096 pixels fit into 53 bits
LEAST_EXPONENT, MOST_EXPONENT = -126, 126  # range of the exponent of the scale, a float32


@dataclass(frozen=True)
class MeanMedian:
    """Options of `clsco.inpaint` with method "mean-median", the thesis' method.

    Parameters
    ----------
    estimator : {"scored", "mean", "median"}
        Estimate of a pixel from its neighbors; "scored" chooses mean or median by their errors at known pixels.
    minimum : int
        Known neighbors that a pixel needs, 1 to 8; fewer only if no pixel has that many.
    smoothing_rounds : int
        Rounds of the median over filled pixels, 0 (none) to 1000.
    border_share : float
        Share of the known pixels beside holes that a 3 x 3 median replaces, 0 (none) to 1; steepest gradients first.

    Raises
    ------
    SceneError
        An option has a value that is not listed above.

    Examples
    --------
    >>> import clsco
    >>> options = clsco.MeanMedian(estimator="median", smoothing_rounds=0)  # inpaint(image, mask, options=options)
    >>> options.minimum
    4
    """

    estimator: Literal["scored", "mean", "median"] = "scored"
    minimum: int = 4
    smoothing_rounds: int = 20
    border_share: float = 0.4

    def __post_init__(self) -> None:
        if self.estimator not in ("scored", "mean", "median"):
            raise SceneError(f"estimator: must be scored, mean or median; got {self.estimator}")
        for name, least, most in (("minimum", 1, 8), ("smoothing_rounds", 0, 1000)):
            value = getattr(self, name)
            if not isinstance(value, int) or not least <= value <= most:
                raise SceneError(f"{name}: must be a whole number from {least} to {most}; got {value}")
        if not (isinstance(self.border_share, Real) and 0.0 <= self.border_share <= 1.0):
            raise SceneError(f"border_share: must be from 0 to 1; got {self.border_share}")


def most_sweeps(rows: int, columns: int) -> int:
    """Number of sweeps that require the minimum of known neighbors; in later sweeps one known neighbor is enough.

    Each later sweep fills all pixels beside known ones, so that max(rows, columns) of these sweeps suffice, and stage 1
    takes fewer than 4 (rows + columns) sweeps for any mask. Without this limit, 1 of 10,000 random masks takes more
    sweeps (4.09 times rows + columns for 61 x 51 pixels, of which 55 are known). About 40 of 10,000 masks reach the
    limit.
    """
    return 3 * (rows + columns)


@dataclass(frozen=True)
class Score:
    """Errors of the mean and the median of k known neighbors as estimates of known pixels (figure 5.3).

    mean, median: squared errors by k, summed over all pixels with eight known neighbors, all channels and all subsets
    of k neighbors, and multiplied by (2 k scale)^2 to be integers; entries for k < 4 are 0. samples: pixels times
    channels; scale: from `score_scale`.
    """

    mean: tuple[int, ...]
    median: tuple[int, ...]
    samples: int
    scale: float

    def median_wins(self, estimator: str = "scored") -> NDArray[np.bool_]:
        """Mask over k (9,): True where the median has the smaller error; ties go to the mean."""
        if estimator != "scored":
            return (np.arange(9) >= COUNTS.start) & (estimator == "median")
        return np.array([median < mean for mean, median in zip(self.mean, self.median, strict=True)])

    def mean_square_errors(self) -> tuple[list[float], list[float]]:
        """Mean square errors of mean and median for k = 4..8, in the squared unit of the values; [] without samples."""
        if not self.samples:
            return [], []
        share = {k: 1.0 / ((2.0 * k * self.scale) ** 2 * comb(8, k) * self.samples) for k in COUNTS}
        return [self.mean[k] * share[k] for k in COUNTS], [self.median[k] * share[k] for k in COUNTS]


def score_scale(span: float) -> float:
    """Factor by which values are multiplied before they are rounded for scores.

    It is the largest power of two by which the range of the values, `span`, becomes at most 2^16.
    """
    mantissa, exponent = frexp(span)
    above = exponent - (mantissa == 0.5)  # span is at most 2^above
    return float(2.0 ** min(max(16 - above, LEAST_EXPONENT), MOST_EXPONENT))


def score_of_sums(sums: NDArray[np.int64], scale: float) -> Score:
    """The score from the kernel `score_mean_median`'s partial sums (n, SCORE_SUMS), for any n.

    Binomial coefficients count the subsets of k neighbors that contain one particular neighbor or pair of neighbors,
    and, for sorted neighbors, the subsets whose median is the i-th or lies between the i-th and the j-th.
    """
    # In two halves, since the sum over a large image may need more than 64 bits.
    high, low = (half.sum(axis=0).tolist() for half in (sums >> 32, sums & 0xFFFFFFFF))
    whole = [(a << 32) + b for a, b in zip(high, low, strict=True)]
    squares, squared_sum, products, samples = whole[:8], whole[8], whole[9:12], whole[12]
    mean, median = [0] * 9, [0] * 9
    for k in COUNTS:
        mean[k] = 4 * (comb(6, k - 2) * squared_sum + comb(6, k - 1) * sum(squares))
        below = (k - 1) // 2
        lower, upper = [comb(i, below) for i in range(8)], [comb(7 - i, below) for i in range(8)]
        if k % 2:
            twice_squared = 4 * sum(lower[i] * upper[i] * squares[i] for i in range(8))
        else:
            pairs = [(i, j) for j in range(8) for i in range(j)]
            twice_squared = 2 * products[below - 1]
            twice_squared += sum(lower[i] * upper[j] * (squares[i] + squares[j]) for i, j in pairs)
        median[k] = k * k * twice_squared
    return Score(tuple(mean), tuple(median), samples, scale)


def bits_of(wins: NDArray[np.bool_]) -> int:
    """Bit mask for kernels: bit k is set if wins[k] is True."""
    return int((wins << np.arange(wins.size)).sum())


@dataclass(frozen=True)
class Histogram:
    """Histogram of the border pixels' gradients (figure 5.6), and the threshold from which on pixels are blended.

    counts: entry n is the number of gradients from n step to below (n + 1) step; step: in the unit of the values;
    least, most: smallest and largest gradient; threshold: a multiple of step, or None if no pixel is blended.
    """

    counts: NDArray[np.int64]
    step: float
    least: float
    most: float
    threshold: float | None


def border_histogram(gradients: NDArray[Any], step: float, share: float) -> Histogram:
    """Histogram of gradient magnitudes (N,), N > 0, with a threshold that the fraction `share` of them reaches.

    The threshold is the largest multiple of `step` that at least this fraction reaches; None for a share of 0.
    """
    place = (gradients.astype(np.float64) / step).astype(np.int64) if step else np.zeros(gradients.size, np.int64)
    counts = np.bincount(place)
    above = np.cumsum(counts[::-1])[::-1]
    reached = np.flatnonzero(above >= share * gradients.size)
    threshold = float(reached[-1] * step) if share else None
    return Histogram(counts, step, float(gradients.min()), float(gradients.max()), threshold)


def value_span(image: NDArray[Any], missing: NDArray[np.bool_]) -> float:
    """Range of the values of an image (rows, columns[, K]): for codes the largest code, else that of known values."""
    if image.dtype.kind != "f":
        return float(np.iinfo(image.dtype).max)
    known = ~missing if image.ndim == 2 else ~missing[..., None]
    low, high = (float(f(image, where=known, initial=start)) for f, start in ((np.min, np.inf), (np.max, -np.inf)))
    return high - low


def as_stored(values: NDArray[np.float32], dtype: np.dtype[Any]) -> NDArray[Any]:
    """Values converted to the type of an image; codes are rounded, halves to even."""
    if dtype.kind == "f":
        return values.astype(dtype)
    return np.clip(np.rint(values), 0, np.iinfo(dtype).max).astype(dtype)
