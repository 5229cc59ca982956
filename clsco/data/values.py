"""Distributions of values: what a distribution file has in place of a value, and how words of 64 bits become one."""

from __future__ import annotations

import importlib
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from clsco.data.draws import LARGEST_NORMAL, Words, cube_root, exact_log, exp, name_hash, normal, philox, unit
from clsco.errors import SceneError

Column = NDArray[Any]  # (n,) or (n, size): numbers, or positions in a list
SOBOL_BITS = 32
SOBOL_BLOCK = 1024
MAX_SOBOL = 2**24  # samples: the way to one of them takes a time that grows with its number


@dataclass(frozen=True)
class Draw:
    """Input of a draw: random words (n, words), the name of the parameter, the seed, and for every sample its number
    (n,) and the position of its split (n,)."""

    words: Words
    name: str
    seed: int
    numbers: Words
    splits: NDArray[np.int64]


@dataclass(frozen=True)
class Form:
    """Distribution of one value, or of `size` numbers."""

    size: int | None
    designed: ClassVar[bool] = False
    """True if values follow from the number of the sample, and not from chance alone."""

    @property
    def words(self) -> int:
        """Number of random words that a draw takes."""
        return self.size or 1

    def column(self, draw: Draw) -> Column:
        """Values (n,), those of `size` numbers as (n, size)."""
        found = self._numbers(draw)
        return found if self.size else found[:, 0]

    def value(self, entry: Any) -> Any:
        """An entry of a column as a scene file has it."""
        return entry.tolist()

    def extremes(self) -> tuple[Any, ...]:
        """The lowest and the highest value, or all that there are, as a scene file has them."""
        return tuple([end] * self.size if self.size else end for end in self._ends())

    def _numbers(self, draw: Draw) -> Column:
        raise NotImplementedError

    def _ends(self) -> tuple[Any, ...]:
        raise NotImplementedError


@dataclass(frozen=True)
class Uniform(Form):
    """{ uniform = [low, high] }"""

    low: float
    high: float

    def _numbers(self, draw: Draw) -> Column:
        return _between(self.low, self.high, unit(draw.words))

    def _ends(self) -> tuple[Any, ...]:
        return self.low, self.high


@dataclass(frozen=True)
class LogUniform(Uniform):
    """{ log_uniform = [low, high] }: the logarithm is uniform."""

    def _numbers(self, draw: Draw) -> Column:
        start, end = exact_log(self.low), exact_log(self.high)
        return np.clip(exp(_between(start, end, unit(draw.words))), self.low, self.high)


@dataclass(frozen=True)
class Normal(Form):
    """{ normal = [mean, deviation], clip = [low, high] }: values beyond an end become that end."""

    mean: float
    deviation: float
    clip: tuple[float, float]

    def _numbers(self, draw: Draw) -> Column:
        return np.clip(self.mean + self.deviation * normal(draw.words), *self.clip)

    def _ends(self) -> tuple[Any, ...]:
        reach = LARGEST_NORMAL * self.deviation
        return tuple(min(max(end, self.clip[0]), self.clip[1]) for end in (self.mean - reach, self.mean + reach))


@dataclass(frozen=True)
class Integers(Form):
    """{ integers = [low, high] }, both ends among them."""

    low: int
    high: int

    def _numbers(self, draw: Draw) -> Column:
        count = self.high - self.low + 1
        return self.low + np.minimum((unit(draw.words) * count).astype(np.int64), count - 1)

    def _ends(self) -> tuple[Any, ...]:
        return self.low, self.high


@dataclass(frozen=True)
class ChoiceForm(Form):
    """{ choice = [...], weights = [...] }; below: what the weights are up to and including each entry, of 1."""

    entries: tuple[Any, ...]
    below: tuple[float, ...]

    def _numbers(self, draw: Draw) -> Column:
        return np.searchsorted(self.below[:-1], unit(draw.words), side="right")

    def value(self, entry: Any) -> Any:
        return self.entries[int(entry)]

    def extremes(self) -> tuple[Any, ...]:
        return self.entries


@dataclass(frozen=True)
class Files(Form):
    """{ files = "pattern", split = "by_file" }: one of some files.

    names: relative to the folder of the distribution file; of_split: positions of those that each split has.
    """

    names: tuple[str, ...]
    of_split: tuple[NDArray[np.int64], ...]

    def _numbers(self, draw: Draw) -> Column:
        found = np.zeros(draw.words.shape, np.int64)
        for number, own in enumerate(self.of_split):
            here = draw.splits == number
            found[here] = own[np.minimum((unit(draw.words[here]) * len(own)).astype(np.int64), len(own) - 1)]
        return found

    def value(self, entry: Any) -> Any:
        return self.names[int(entry)]

    def extremes(self) -> tuple[Any, ...]:
        return self.names[:1]


@dataclass(frozen=True)
class Frustum(Form):
    """{ frustum = { depth = [near, far], margin = px, density = "volume" } }: a point that is seen.

    A column has (across, up, depth), across and up from -1 to 1 within the frame without its margin.
    """

    near: float
    far: float
    margin: float
    by_volume: bool

    @property
    def words(self) -> int:
        return 3

    def column(self, draw: Draw) -> Column:
        place = unit(draw.words)
        depth = place[:, 2]
        if self.by_volume:
            depth = cube_root(_between(self.near**3, self.far**3, depth))
            depth = np.clip(depth, self.near, self.far)
        else:
            depth = _between(self.near, self.far, depth)
        return np.stack([2.0 * place[:, 0] - 1.0, 2.0 * place[:, 1] - 1.0, depth], axis=-1)

    def value(self, entry: Any) -> Any:
        across, up, depth = entry.tolist()
        return Placed(across, up, depth, self.margin)

    def extremes(self) -> tuple[Any, ...]:
        return Placed(-1.0, -1.0, self.near, self.margin), Placed(1.0, 1.0, self.far, self.margin)


@dataclass(frozen=True)
class Placed:
    """A point in the frustum of a camera that is not known yet."""

    across: float
    up: float
    depth: float
    margin: float

    def point(self, columns: int, rows: int, step: float) -> list[float]:
        """The point (x, y, z) in mm; step: slope between rays of neighboring pixels."""
        x, y = (share * (0.5 * n - self.margin) * step for share, n in ((self.across, columns), (self.up, rows)))
        return [x * self.depth, y * self.depth, self.depth]


@dataclass(frozen=True)
class Turned(Form):
    """{ direction = "sphere" } with 3 numbers, { rotation = "uniform" } with 4: uniform on a sphere."""

    def column(self, draw: Draw) -> Column:
        vectors = normal(draw.words)
        return vectors / np.sqrt(sum(part * part for part in vectors.T))[:, None]

    def value(self, entry: Any) -> Any:
        return entry.tolist() if self.size == 3 else {"quaternion": entry.tolist()}

    def extremes(self) -> tuple[Any, ...]:
        first = np.zeros(self.words)
        first[0] = 1.0
        return self.value(first), self.value(first[::-1])


@dataclass(frozen=True)
class Sobol(Form):
    """{ sobol = [low, high] }: all such keys are the dimensions of one sequence, shifted by the seed."""

    low: float
    high: float
    dimension: int
    designed = True

    @property
    def words(self) -> int:
        return 0

    def column(self, draw: Draw) -> Column:
        if len(draw.numbers) and draw.numbers.max() >= MAX_SOBOL:
            raise SceneError(f"sobol: the number of a sample must be below {MAX_SOBOL}; got {draw.numbers.max()}")
        points = np.empty(len(draw.numbers), np.uint64)
        blocks = draw.numbers // np.uint64(SOBOL_BLOCK)
        for block in np.unique(blocks).tolist():
            here = blocks == block
            points[here] = _sobol(self.dimension, block)[draw.numbers[here] % np.uint64(SOBOL_BLOCK)]
        shift = _shift(draw.seed, draw.name) >> np.uint64(64 - SOBOL_BITS)
        return _between(self.low, self.high, (points ^ shift).astype(np.float64) * 2.0**-SOBOL_BITS)

    def _ends(self) -> tuple[Any, ...]:
        return self.low, self.high


def _between(low: float, high: float, share: NDArray[np.float64]) -> NDArray[np.float64]:
    """From `low`, share 0, to `high`, share 1, and never beyond."""
    return np.clip(low + (high - low) * share, low, high)


@lru_cache(maxsize=1024)
def _shift(seed: int, name: str) -> np.uint64:
    """Bits by which a dimension of a Sobol sequence is shifted, which keeps how evenly it is spread."""
    parts = [np.full(1, part, np.uint64) for part in (seed, 2**64 - 1, 0, 2**64 - 2, *name_hash(name))]
    return np.uint64(philox((parts[0], parts[1]), (parts[2], parts[3], parts[4], parts[5]))[0, 0])


@lru_cache(maxsize=256)
def _sobol(dimension: int, block: int) -> Words:
    """Coordinates of some points of the sequence, as integers of SOBOL_BITS bits."""
    sequence = qmc().Sobol(dimension + 1, scramble=False, bits=SOBOL_BITS)
    if block:
        sequence.fast_forward(block * SOBOL_BLOCK)
    return (sequence.random(SOBOL_BLOCK)[:, dimension] * 2.0**SOBOL_BITS).astype(np.uint64)


def qmc() -> Any:
    """The module scipy.stats.qmc. Raises SceneError where it is not installed."""
    try:
        return importlib.import_module("scipy.stats.qmc")
    except ImportError:
        rule = "needs scipy: pip install 'clsco[data]'; got no such module"
        raise SceneError(f"sobol: {rule}") from None


def shares(weights: Sequence[float]) -> tuple[float, ...]:
    """Cumulative shares of positive weights, up to 1."""
    total = math.fsum(weights)
    return tuple(math.fsum(weights[: k + 1]) / total for k in range(len(weights)))
