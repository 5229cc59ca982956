"""Numbers of 106 bits in NumPy: the unevaluated sum of two float64 (pure).

Dekker (1971), Knuth; the algorithms and their bounds are those of Joldes, Muller, Popescu (2017), ACM TOMS 44(2): with
u = 2^-53 the relative errors are at most 3 u^2 for a sum, 7 u^2 for a product, 15 u^2 for a quotient and about 4 u^2
for a root. Products of numbers beyond 1e290 or below 1e-250 lose that.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
SPLITTER = 2.0**27 + 1.0


@dataclass(frozen=True, eq=False)
class Wide:
    """high + low, arrays of one shape, |low| <= ulp(high) / 2."""

    high: Array
    low: Array

    def __add__(self, other: Wide) -> Wide:
        """The sum; terms of opposite sign cancel without harm to what is left (AccurateDWPlusDW)."""
        sum_high, sum_low = _two_sum(self.high, other.high)
        low_high, low_low = _two_sum(self.low, other.low)
        high, low = _fast_two_sum(sum_high, sum_low + low_high)
        return Wide(*_fast_two_sum(high, low_low + low))

    def __neg__(self) -> Wide:
        """The negative."""
        return Wide(-self.high, -self.low)

    def __sub__(self, other: Wide) -> Wide:
        """The difference."""
        return self + -other

    def __mul__(self, other: Wide) -> Wide:
        """The product."""
        high, low = _two_product(self.high, other.high)
        return Wide(*_fast_two_sum(high, low + (self.high * other.low + self.low * other.high)))

    def __truediv__(self, other: Wide) -> Wide:
        """The quotient; it is not finite where the divisor is 0."""
        first = self.high / other.high
        left = self - other * wide(first)
        return Wide(*_fast_two_sum(first, left.high / other.high))

    def sqrt(self) -> Wide:
        """The root, 0 of numbers that are not above 0."""
        positive = self.high > 0.0
        root = np.sqrt(np.where(positive, self.high, 1.0))
        left = self - wide(root) * wide(root)
        high, low = _fast_two_sum(root, left.high / (2.0 * root))
        return Wide(np.where(positive, high, 0.0), np.where(positive, low, 0.0))

    def where(self, condition: NDArray[np.bool_], other: Wide) -> Wide:
        """This where a condition holds, the other elsewhere."""
        return Wide(np.where(condition, self.high, other.high), np.where(condition, self.low, other.low))


def wide(values: ArrayLike) -> Wide:
    """Numbers that float64 holds."""
    high = np.asarray(values, dtype=np.float64)
    return Wide(high, np.zeros_like(high))


def rounded(values: Sequence[Any]) -> Wide:
    """The numbers of 106 bits nearest to those of more digits, such as mpmath's, (n,)."""
    high = [float(value) for value in values]
    return Wide(np.array(high), np.array([float(value - first) for value, first in zip(values, high, strict=True)]))


def _two_sum(a: Array, b: Array) -> tuple[Array, Array]:
    """a + b and its rounding error."""
    total = a + b
    part = total - a
    return total, (a - (total - part)) + (b - part)


def _fast_two_sum(a: Array, b: Array) -> tuple[Array, Array]:
    """The same where |a| >= |b|."""
    total = a + b
    return total, b - (total - a)


def _halves(a: Array) -> tuple[Array, Array]:
    """Two parts of 26 bits, whose products are exact (Veltkamp)."""
    scaled = SPLITTER * a
    high = scaled - (scaled - a)
    return high, a - high


def _two_product(a: Array, b: Array) -> tuple[Array, Array]:
    """a b and its rounding error."""
    product = a * b
    (a_high, a_low), (b_high, b_low) = _halves(a), _halves(b)
    return product, a_low * b_low - (((product - a_high * b_high) - a_low * b_high) - a_high * b_low)
