"""Distributions of values: what a distribution file has in place of a value, and how words of 64 bits become one."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.data.draws import LARGEST_NORMAL, Words, cube_root, exact_log, exp, normal, unit


@dataclass(frozen=True)
class Form:
    """Distribution of one value, or of `size` numbers."""

    size: int | None

    @property
    def words(self) -> int:
        """Number of random words that a draw takes."""
        return self.size or 1

    def value(self, words: Words, split: int) -> Any:  # noqa: ARG002, files depend on the split
        """The value that words give in a sample of a split, as a scene file has it."""
        numbers = self._numbers(words).tolist()
        return numbers if self.size else numbers[0]

    def extremes(self) -> tuple[Any, ...]:
        """The lowest and the highest value, or all that there are, as a scene file has them."""
        return tuple([end] * self.size if self.size else end for end in self._ends())

    def _numbers(self, words: Words) -> NDArray[Any]:
        raise NotImplementedError

    def _ends(self) -> tuple[Any, ...]:
        raise NotImplementedError


@dataclass(frozen=True)
class Uniform(Form):
    """{ uniform = [low, high] }"""

    low: float
    high: float

    def _numbers(self, words: Words) -> NDArray[Any]:
        return _between(self.low, self.high, unit(words))

    def _ends(self) -> tuple[Any, ...]:
        return self.low, self.high


@dataclass(frozen=True)
class LogUniform(Uniform):
    """{ log_uniform = [low, high] }: the logarithm is uniform."""

    def _numbers(self, words: Words) -> NDArray[Any]:
        start, end = exact_log(self.low), exact_log(self.high)
        return np.clip(exp(_between(start, end, unit(words))), self.low, self.high)


@dataclass(frozen=True)
class Normal(Form):
    """{ normal = [mean, deviation], clip = [low, high] }: values beyond an end become that end."""

    mean: float
    deviation: float
    clip: tuple[float, float]

    def _numbers(self, words: Words) -> NDArray[Any]:
        return np.clip(self.mean + self.deviation * normal(words), *self.clip)

    def _ends(self) -> tuple[Any, ...]:
        reach = LARGEST_NORMAL * self.deviation
        return tuple(min(max(end, self.clip[0]), self.clip[1]) for end in (self.mean - reach, self.mean + reach))


@dataclass(frozen=True)
class Integers(Form):
    """{ integers = [low, high] }, both ends among them."""

    low: int
    high: int

    def _numbers(self, words: Words) -> NDArray[Any]:
        count = self.high - self.low + 1
        return self.low + np.minimum((unit(words) * count).astype(np.int64), count - 1)

    def _ends(self) -> tuple[Any, ...]:
        return self.low, self.high


@dataclass(frozen=True)
class ChoiceForm(Form):
    """{ choice = [...], weights = [...] }; below: what the weights are up to and including each entry, of 1."""

    entries: tuple[Any, ...]
    below: tuple[float, ...]

    def value(self, words: Words, split: int) -> Any:  # noqa: ARG002
        return self.entries[int(np.searchsorted(self.below[:-1], unit(words)[0], side="right"))]

    def extremes(self) -> tuple[Any, ...]:
        return self.entries


@dataclass(frozen=True)
class Files(Form):
    """{ files = "pattern", split = "by_file" }: one of some files.

    names: relative to the folder of the distribution file; of_split: positions of those that each split has.
    """

    names: tuple[str, ...]
    of_split: tuple[tuple[int, ...], ...]

    def value(self, words: Words, split: int) -> Any:
        own = self.of_split[split]
        return self.names[own[min(int(unit(words)[0] * len(own)), len(own) - 1)]]

    def extremes(self) -> tuple[Any, ...]:
        return self.names[:1]


@dataclass(frozen=True)
class Frustum(Form):
    """{ frustum = { depth = [near, far], margin = px, density = "volume" } }: a point that is seen.

    Across and up are from -1 to 1 within the frame without its margin.
    """

    near: float
    far: float
    margin: float
    by_volume: bool

    @property
    def words(self) -> int:
        return 3

    def value(self, words: Words, split: int) -> Placed:  # noqa: ARG002
        across, up, depth = unit(words)
        if self.by_volume:
            depth = cube_root(_between(self.near**3, self.far**3, depth))
            depth = np.clip(depth, self.near, self.far)
        else:
            depth = _between(self.near, self.far, depth)
        return Placed(float(2.0 * across - 1.0), float(2.0 * up - 1.0), float(depth), self.margin)

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

    def value(self, words: Words, split: int) -> Any:  # noqa: ARG002
        vector = normal(words)
        return self._written(vector / np.sqrt(sum(part * part for part in vector)))

    def extremes(self) -> tuple[Any, ...]:
        first = np.zeros(self.words)
        first[0] = 1.0
        return self._written(first), self._written(first[::-1])

    def _written(self, vector: NDArray[np.float64]) -> Any:
        return vector.tolist() if self.size == 3 else {"quaternion": vector.tolist()}


def _between(low: float, high: float, share: NDArray[np.float64]) -> NDArray[np.float64]:
    """From `low`, share 0, to `high`, share 1, and never beyond."""
    return np.clip(low + (high - low) * share, low, high)


def shares(weights: Sequence[float]) -> tuple[float, ...]:
    """Cumulative shares of positive weights, up to 1."""
    total = math.fsum(weights)
    return tuple(math.fsum(weights[: k + 1]) / total for k in range(len(weights)))
