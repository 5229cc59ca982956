"""Counter-based random streams, and transcendental functions that give the same bits on all machines.

A 64-bit word depends only on the seed, the sample number, the parameter's name, the element of a population, the
attempt and the position. So samples can be drawn in any order, and a new parameter changes no other. Functions of words
use only sums, products, quotients and square roots, which IEEE 754 rounds exactly: all machines give the same bits.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
from bisect import bisect_right
from collections.abc import Mapping, Sequence
from decimal import Decimal, localcontext
from fractions import Fraction
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.data.manifest import CONFLICT, LOG, PARTS, UNSPLIT
from clsco.errors import SceneError
from clsco.scene.text import shown

Words = NDArray[np.uint64]
Floats = NDArray[np.float64]
MAX_SEED = 2**64 - 1
_LN2 = (6.93147180369123816490e-01, 1.90821492927058770002e-10)  # high part with 32 bits of 0, and the rest
_LOG2E = 1.44269504088896338700
# Coefficients, highest power first: of e^r for |r| <= ln(2) / 2, and of 2 artanh(q) / q in q^2 for |q| <= 0.1716.
_EXP = [1.0 / math.factorial(k) for k in range(13, -1, -1)]
_ARTANH = [2.0 / k for k in range(23, 0, -2)]


def stream_words(seed: int, number: int, name: str, count: int, attempt: int = 1, element: int = 0) -> Words:
    """Random words (count,) of Philox4x64-10 for a parameter of a sample; element: number of an object in a population.

    The key is (seed, number), the counter (block of four words, element + 2^32 attempt, 128 bits of the SHA-256 of the
    name).
    """
    name_hash = int.from_bytes(hashlib.sha256(name.encode()).digest()[:16], "little")
    counter = (element + (attempt << 32)) << 64 | name_hash << 128
    # NumPy adds 1 to the counter before it makes a block.
    return np.random.Philox(key=seed | number << 64, counter=(counter - 1) % 2**256).random_raw(count)


def unit(words: Words) -> Floats:
    """Convert words to uniform numbers in [0, 1), which are multiples of 2^-53."""
    return (words >> np.uint64(11)).astype(np.float64) * 2.0**-53


def exp(x: Floats) -> Floats:
    """e^x for |x| <= 700, within 2 units of the last place of the true value."""
    whole = np.rint(x * _LOG2E)
    rest = (x - whole * _LN2[0]) - whole * _LN2[1]
    return np.ldexp(np.polyval(_EXP, rest), whole.astype(np.int32))


def log(x: Floats) -> Floats:
    """Natural logarithm of positive numbers. Its error is at most 2 units of the last place; 2^-53 near 1."""
    part, power = np.frexp(x)
    small = part < np.sqrt(0.5)
    part, power = np.where(small, 2.0 * part, part), power - small
    ratio = (part - 1.0) / (part + 1.0)
    return power * _LN2[0] + (ratio * np.polyval(_ARTANH, ratio * ratio) + power * _LN2[1])


def cube_root(x: Floats) -> Floats:
    """Cube root of positive numbers."""
    root = exp(log(x) / 3.0)
    return root - (root * root * root - x) / (3.0 * root * root)


# Coefficients of Wichura's algorithm AS 241, PPND16 (1988): numerator and denominator, highest power first.
_CENTRAL = (
    (2.5090809287301226727e3, 3.3430575583588128105e4, 6.7265770927008700853e4, 4.5921953931549871457e4,
     1.3731693765509461125e4, 1.9715909503065514427e3, 1.3314166789178437745e2, 3.3871328727963666080e0),
    (5.2264952788528545610e3, 2.8729085735721942674e4, 3.9307895800092710610e4, 2.1213794301586595867e4,
     5.3941960214247511077e3, 6.8718700749205790830e2, 4.2313330701600911252e1, 1.0),
)  # fmt: skip
_TAIL = (
    (7.74545014278341407640e-4, 2.27238449892691845833e-2, 2.41780725177450611770e-1, 1.27045825245236838258e0,
     3.64784832476320460504e0, 5.76949722146069140550e0, 4.63033784615654529590e0, 1.42343711074968357734e0),
    (1.05075007164441684324e-9, 5.47593808499534494600e-4, 1.51986665636164571966e-2, 1.48103976427480074590e-1,
     6.89767334985100004550e-1, 1.67638483018380384940e0, 2.05319162663775882187e0, 1.0),
)  # fmt: skip
_FAR_TAIL = (
    (2.01033439929228813265e-7, 2.71155556874348757815e-5, 1.24266094738807843860e-3, 2.65321895265761230930e-2,
     2.96560571828504891230e-1, 1.78482653991729133580e0, 5.46378491116411436990e0, 6.65790464350110377720e0),
    (2.04426310338993978564e-15, 1.42151175831644588870e-7, 1.84631831751005468180e-5, 7.86869131145613259100e-4,
     1.48753612908506148525e-2, 1.36929880922735805310e-1, 5.99832206555887937690e-1, 1.0),
)  # fmt: skip
LARGEST_NORMAL = 8.3  # bound of |z|, which the smallest and the largest word nearly reach


def _ratio(coefficients: tuple[tuple[float, ...], tuple[float, ...]], x: Floats) -> Floats:
    return np.polyval(coefficients[0], x) / np.polyval(coefficients[1], x)


def normal(words: Words) -> Floats:
    """Convert words to standard normal numbers, by AS 241 as in `NormalDist.inv_cdf`, but with a portable logarithm."""
    p = ((words >> np.uint64(12)).astype(np.float64) + 0.5) * 2.0**-52  # in (0, 1), symmetric
    q = p - 0.5
    middle = q * _ratio(_CENTRAL, 0.180625 - q * q)
    r = np.sqrt(-log(np.where(q < 0.0, p, 1.0 - p)))
    tail = np.where(r <= 5.0, _ratio(_TAIL, r - 1.6), _ratio(_FAR_TAIL, r - 5.0))
    return np.where(np.abs(q) <= 0.425, middle, np.where(q < 0.0, -tail, tail))


def exact_log(value: float) -> float:
    """Natural logarithm, correctly rounded; that of the C library differs between machines."""
    with localcontext() as context:
        context.prec = 40
        return float(Decimal(value).ln())


def shuffled(seed: int, name: str, count: int, turn: int) -> NDArray[np.int64]:
    """A random order of 0 ... count - 1 that depends on the seed, a name, and the number `turn`."""
    return np.argsort(stream_words(seed, turn, name, count), kind="stable")


Splits = tuple[tuple[str, float], ...]
SplitsLike = Mapping[str, float] | Sequence[tuple[str, float]] | str | None
MAX_SPLITS = 32
MOST_BLOCK = 1000  # samples among which each split has exactly its share
TAKEN = (PARTS, LOG, UNSPLIT, CONFLICT)  # names of other folders of a set, which no split may have
_NAME = re.compile(r"[A-Za-z0-9_-]{1,64}")


def splits_of(splits: SplitsLike) -> Splits:
    """Parse splits, such as "train=0.9,val=0.05,test=0.05" or "train=80,test=20"; None and "" give no splits.

    Raises SceneError for invalid shares, names that are no folder names, and names that differ only in case.
    """
    if not splits:
        return ()
    if isinstance(splits, str):
        splits = [_parsed_split(part) for part in splits.split(",")]
    pairs: list[tuple[Any, Any]] = list(splits.items() if isinstance(splits, Mapping) else splits)
    if all(type(share) is int and share > 0 for _, share in pairs):  # numbers of samples
        pairs = [(name, share / sum(each for _, each in pairs)) for name, share in pairs]
    if len(pairs) > MAX_SPLITS:
        raise SceneError(f"split: must be at most {MAX_SPLITS} splits; got {len(pairs)}")
    messages, seen = [], set()
    for name, share in pairs:
        if not isinstance(name, str) or not _NAME.fullmatch(name):
            messages.append(f"split: a name must be 1 to 64 letters, digits, _ or -; got {shown(name)}")
        elif name.lower() in seen:
            messages.append(f"split: names must differ; got {shown(name)} twice")
        elif name in TAKEN:
            messages.append(f"split: names must be others than {', '.join(TAKEN)}; got {name}")
        else:
            seen.add(name.lower())
        if isinstance(share, bool) or not isinstance(share, int | float) or not 0.0 < share <= 1.0:
            messages.append(f"split: a share must be between 0 and 1, 0 excluded; got {shown(share)}")
    if not messages and abs(math.fsum(share for _, share in pairs) - 1.0) > 1e-9:
        messages.append(f"split: shares must be 1 in all; got {math.fsum(share for _, share in pairs):.9g}")
    if messages:
        raise SceneError(messages)
    return tuple((name, float(share)) for name, share in pairs)


def _parsed_split(part: str) -> tuple[str, float]:
    """Parse a split from NAME=SHARE."""
    name, _, share = part.partition("=")
    try:
        return name.strip(), int(share) if share.strip().isdecimal() else float(share)
    except ValueError:
        raise SceneError(f"split: must be NAME=SHARE,..., like train=0.9,test=0.1; got {shown(part)}") from None


def split_of(splits: Splits, seed: int, number: int) -> int:
    """Position of a sample's split, which depends only on splits, seed and number.

    Sample numbers are divided into blocks, in each of which every split has exactly its share of the samples, in random
    order. With 80 % and 20 %, a block has 5 samples. Blocks are as short as the shares allow, at most 1000 samples;
    shares are rounded to fractions with denominators up to 1000.
    """
    if not splits:
        return 0
    ends = _split_ends(splits)
    block, place = divmod(number, ends[-1])
    return bisect_right(ends, int(_split_order(seed, ends[-1], block)[place]))


def split_of_value(splits: Splits, seed: int, value: Any) -> int:
    """Position of the split of all samples with a value of a parameter, which is of JSON types.

    Integers from 0 on are divided as sample numbers are, in exact shares; the split of another value is random.
    """
    if type(value) is int and 0 <= value <= MAX_SEED:
        return split_of(splits, seed, value)
    return int(of_files(splits, [hashlib.sha256(f"{seed} {json.dumps(value)}".encode()).hexdigest()])[0])


@lru_cache(maxsize=16)
def _split_ends(splits: Splits) -> tuple[int, ...]:
    """For each split, the number of samples of a block in this split and all before it."""
    shares = [Fraction(share).limit_denominator(MOST_BLOCK) for _, share in splits]
    size = min(math.lcm(*(share.denominator for share in shares)), MOST_BLOCK)
    ends = [math.floor(sum(shares[: k + 1]) * size + Fraction(1, 2)) for k in range(len(shares) - 1)]
    return (*ends, size)


@lru_cache(maxsize=16)
def _split_order(seed: int, size: int, block: int) -> NDArray[np.int64]:
    return shuffled(seed, "split", size, block)


def of_files(splits: Splits, digests: Sequence[str]) -> NDArray[np.int64]:
    """For each file, the position of its split (n,). It depends only on the file's SHA-256, so copies share a split."""
    words = np.array([int(digest[:16], 16) for digest in digests], np.uint64)
    ends = [math.fsum(share for _, share in splits[: k + 1]) for k in range(len(splits) - 1)]
    return np.searchsorted(ends, unit(words), side="right")
