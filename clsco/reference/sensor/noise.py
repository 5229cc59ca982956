"""Random numbers of a sensor's pixels in NumPy float32, with the bits of kernels/sensor/noise.clh.

The operations and their order are the same, and each is rounded by IEEE 754. Random words are uint32; results are
float32 or int64.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clsco.constants import FEW_ELECTRONS, LEAST_NORMAL

Floats = NDArray[np.float32]
Words = NDArray[np.uint32]
Counts = NDArray[np.int64]
HALF, LOW = 32, np.uint64(0xFFFFFFFF)
MULTIPLIERS = np.uint64(0xD2511F53), np.uint64(0xCD9E8D57)
KEY_STEPS = 0x9E3779B9, 0xBB67AE85
ROUNDS = 10
# Coefficients of polynomials, highest power first: 2^x and ln(1 + x) / x for x in [0, 1), and z of sqrt(-ln p) - 2.75.
EXP2 = (0.00187758, 0.00898934, 0.05582632, 0.24015362, 0.69315307, 0.99999993)
LOG = (0.01078772, -0.05522881, 0.13479359, -0.22598266, 0.32827333, -0.49947725, 0.99998148)
NORMAL = (
    3.224159445380792e-05, -9.325092105427757e-05, -3.067326542804949e-05, 1.2974268429388758e-05,
    0.0011222464963793755, -0.0034385970793664455, 0.010057924315333366, -0.03612663224339485, 1.5518583059310913,
    3.2796878814697266,
)  # fmt: skip


def philox(first: ArrayLike, second: int, third: int, fourth: int, key: tuple[int, int]) -> tuple[Words, ...]:
    """Philox4x32-10 (Salmon et al. 2011): four random words for each counter (first, second, third, fourth) and a key
    of two words.

    Examples
    --------
    >>> from clsco.reference.sensor.noise import philox
    >>> [f"{int(word):08x}" for word in philox(0, 0, 0, 0, (0, 0))]
    ['6627e8d5', 'e169c58d', 'bc57ac4c', '9b00dbd8']
    """
    a = np.asarray(first, np.uint64)
    b, c, d = (np.full(a.shape, word, np.uint64) for word in (second, third, fourth))
    for number in range(ROUNDS):
        low, high = ((word + number * step) % 2**HALF for word, step in zip(key, KEY_STEPS, strict=True))
        ab, cd = a * MULTIPLIERS[0], c * MULTIPLIERS[1]
        a, b, c, d = (cd >> HALF) ^ b ^ low, cd & LOW, (ab >> HALF) ^ d ^ high, ab & LOW
    return tuple(word.astype(np.uint32) for word in (a, b, c, d))


def uniform_of(word: Words) -> Floats:
    """Number in (0, 1] from a random word: (word + 1/2) / 2^32, rounded; never 0."""
    numbers: Floats = (np.asarray(word).astype(np.float32) + np.float32(0.5)) * np.float32(2.0**-32)
    return numbers


def square_root(x: Floats) -> Floats:
    """Square root of x >= 0 with relative error 5e-6, from 1 / sqrt(x) by Newton's method."""
    half = np.float32(0.5)
    y = (np.uint32(0x5F375A86) - (x.view(np.uint32) >> np.uint32(1))).view(np.float32)
    for _ in range(2):
        y = y * (np.float32(1.5) - half * x * y * y)
    return x * y


def minus_log(x: Floats) -> Floats:
    """-ln x for x in (0, 1], to 3e-7: from the exponent, and a polynomial in the mantissa."""
    bits = x.view(np.int32)
    exponent = ((bits >> 23) - 127).astype(np.float32)
    m = ((bits & 0x7FFFFF) | 0x3F800000).view(np.float32) - np.float32(1.0)
    return -(exponent * np.float32(0.693147182) + _polynomial(LOG, m) * m)


def exp_minus(x: Floats) -> Floats:
    """exp(-x) for x in [0, 80]. The relative error is 2e-7 at small x, and 1e-6 at 30 because x is rounded."""
    y = x * np.float32(-1.44269504)
    integer = np.floor(y).astype(np.int32)
    fraction = y - integer.astype(np.float32)
    return _polynomial(EXP2, fraction) * ((integer + 127) << 23).astype(np.int32).view(np.float32)


def _polynomial(coefficients: tuple[float, ...], x: Floats) -> Floats:
    """Polynomial by Horner's rule, each step rounded."""
    first, *lower = (np.float32(coefficient) for coefficient in coefficients)
    values = np.full_like(x, first)
    for coefficient in lower:
        values = values * x + coefficient
    return values


def normal_of(word: Words) -> Floats:
    """Standard normal number from a random word, by the inverse distribution function, to 4e-5.

    It is a polynomial in sqrt(-ln p), where p <= 1/2 is the tail probability; |z| < 6.4.
    """
    word = np.asarray(word, np.uint32)
    upper = word >= np.uint32(2**31)
    tail = np.where(upper, ~word, word)
    z = _polynomial(NORMAL, square_root(minus_log(uniform_of(tail))) - np.float32(2.75))
    return np.where(upper, z, -z)


def few_electrons(mean: Floats, word: Words, reciprocals: Floats) -> Counts:
    """Poisson count for a small mean, by the inverse distribution function, with u from a random word.

    The count is the number of k = 0, 1, ... with P(count > k) > u. reciprocals: 1 / k for k < FEW_ELECTRONS; entry 0 is
    unused.
    """
    u = uniform_of(word)
    term = exp_minus(mean)
    one, sixth, small = np.float32(1.0), np.float32(0.166666672), np.float32(0.0416666679)
    little = mean * (one - mean * (np.float32(0.5) - mean * (sixth - mean * small)))
    above = np.where(mean < np.float32(0.125), little, one - term)
    count = np.zeros(mean.shape, np.int64)
    for k in range(1, FEW_ELECTRONS):
        above_count = u < above
        if not above_count.any():
            break
        count += above_count
        term = term * (mean * reciprocals[k])
        above = above - term
    # This bound is needed if rounding leaves `above` greater than u after all terms.
    return np.minimum(count, (np.float32(12.0) + np.float32(2.2) * mean).astype(np.int64))


def many_electrons(mean: Floats, word: Words) -> Counts:
    """Poisson count for a large mean: a normal number with the first correction of Cornish and Fisher for skewness.

    The integer and the fractional part of the mean are added separately, as float32 has no halves beyond 2^23.
    """
    z = normal_of(word)
    integer = mean.astype(np.int64)
    fraction = mean - integer.astype(np.float32)
    sixth = np.float32(0.166666672)
    deviation = fraction + z * square_root(mean) + (z * z - np.float32(1.0)) * sixth + np.float32(0.5)
    return np.maximum(integer + np.floor(deviation).astype(np.int64), 0)


def poisson(mean: Floats, word: Words, reciprocals: Floats) -> Counts:
    """Poisson count for a mean in [0, 2^24], from a random word."""
    least = np.float32(LEAST_NORMAL)
    few = mean < least
    many = many_electrons(np.where(few, least, mean), word)
    return np.where(few, few_electrons(np.where(few, mean, np.float32(0.0)), word, reciprocals), many)
