"""Distributions of values, such as { uniform = [1, 2] }: parses them, and turns random 64-bit words into values."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.data.draws import LARGEST_NORMAL, Splits, Words, cube_root, exact_log, exp, normal, of_files, unit
from clsco.data.folder import Folder, RefusedError
from clsco.scene.text import shown

LARGEST = 1e30  # largest number: its sums and cubes are finite
MAX_INTEGER = 2**53
MAX_ENTRIES = 10_000
MAX_SIZE = 16

Table = Mapping[str, Any]
"""A table that replaces a value in a distribution file."""


def _number(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= LARGEST:
        raise RefusedError(f"must be a finite number, at most {LARGEST:g}", shown(value))
    return float(value)


def _pair(value: Any, what: str = "[low, high]") -> tuple[float, float]:
    if not isinstance(value, list) or len(value) != 2:
        raise RefusedError(f"must be {what}")
    return _number(value[0]), _number(value[1])


def _range(value: Any) -> tuple[float, float]:
    low, high = _pair(value)
    if not low < high:
        raise RefusedError("must be [low, high], low less than high")
    return low, high


def _whole(value: Any, least: int, most: int) -> int:
    if type(value) is not int or not least <= value <= most:
        raise RefusedError(f"must be an integer between {least} and {most}")
    return value


def _size(table: Table) -> int | None:
    return None if "size" not in table else _at("size", table, lambda value: _whole(value, 1, MAX_SIZE))


def _at(key: str, table: Table, check: Callable[[Any], Any]) -> Any:
    """The value of a key, after a check. A RefusedError of the check gets the key in its message."""
    try:
        return check(table[key])
    except RefusedError as error:
        raise RefusedError(f"{key} {error.rule}", shown(table[key]) if error.got is None else error.got) from None


def _require_word(key: str, table: Table, *words: str) -> None:
    if table[key] not in words:
        allowed = " or ".join(map('"{}"'.format, words))
        raise RefusedError(f"{key} must be {allowed}", shown(table[key]))


def _entries(value: Any) -> tuple[Any, ...]:
    if not isinstance(value, list) or not 1 <= len(value) <= MAX_ENTRIES:
        raise RefusedError(f"must be a list of 1 to {MAX_ENTRIES} values")
    if not _is_plain(value, 3):  # the bounds of an object are the deepest: a list of pairs, within the choice's list
        raise RefusedError("must be a list of numbers, texts, or lists of numbers", "a table or a list of lists in it")
    return tuple(value)


def _is_plain(value: Any, levels: int) -> bool:
    """True if a value contains no tables, and at most `levels` nested lists."""
    if isinstance(value, list):
        return levels > 0 and all(_is_plain(part, levels - 1) for part in value)
    return not isinstance(value, Mapping)


@dataclass(frozen=True)
class Form(ABC):
    """Distribution of a value; size: number of its drawn components, None if the value is drawn as a whole."""

    size: int | None

    @property
    def words(self) -> int:
        """Number of random words that a draw uses."""
        return self.size or 1

    @abstractmethod
    def value(self, words: Words, split: int) -> Any:
        """Convert random words to a value as in a scene file; split: position of the sample's split."""

    @abstractmethod
    def extremes(self) -> tuple[Any, ...]:
        """The lowest and the highest value, or all values, as in a scene file."""


@dataclass(frozen=True)
class Numbers(Form):
    """Distribution of a number from `low` to `high`, or of `size` such numbers; draw: converts words to numbers."""

    low: float
    high: float
    draw: Callable[[Words], NDArray[Any]]

    def value(self, words: Words, split: int) -> Any:  # noqa: ARG002, files depend on the split
        numbers = self.draw(words).tolist()
        return numbers if self.size else numbers[0]

    def extremes(self) -> tuple[Any, ...]:
        return tuple([end] * self.size if self.size else end for end in (self.low, self.high))


def _between(low: float, high: float, share: NDArray[np.float64]) -> NDArray[np.float64]:
    """Interpolate from `low` (share 0) to `high` (share 1), clipped to this range."""
    return np.clip(low + (high - low) * share, low, high)


def _parse_uniform(table: Table, *_: Any) -> Form:
    """{ uniform = [low, high] }"""
    low, high = _at("uniform", table, _range)
    return Numbers(_size(table), low, high, partial(_draw_uniform, low, high))


def _draw_uniform(low: float, high: float, words: Words) -> NDArray[np.float64]:
    return _between(low, high, unit(words))


def _parse_log_uniform(table: Table, *_: Any) -> Form:
    """{ log_uniform = [low, high] }: the logarithm is uniform."""
    low, high = _at("log_uniform", table, _range)
    if low < 1e-30:
        raise RefusedError("log_uniform must be [low, high] of numbers above 0", shown(table["log_uniform"]))
    return Numbers(_size(table), low, high, partial(_draw_log_uniform, low, high))


def _draw_log_uniform(low: float, high: float, words: Words) -> NDArray[np.float64]:
    return np.clip(exp(_between(exact_log(low), exact_log(high), unit(words))), low, high)


def _parse_normal(table: Table, *_: Any) -> Form:
    """{ normal = [mean, deviation], clip = [low, high] }: values are clipped to the limits."""
    mean, deviation = _at("normal", table, lambda value: _pair(value, "[mean, standard deviation]"))
    if deviation <= 0:
        rule = "normal must be [mean, standard deviation], the latter above 0"
        raise RefusedError(rule, shown(table["normal"]))
    clip = _at("clip", table, _range) if "clip" in table else (-LARGEST, LARGEST)
    reach = LARGEST_NORMAL * deviation
    low, high = (min(max(end, clip[0]), clip[1]) for end in (mean - reach, mean + reach))
    return Numbers(_size(table), low, high, partial(_draw_normal, mean, deviation, clip))


def _draw_normal(mean: float, deviation: float, clip: tuple[float, float], words: Words) -> NDArray[np.float64]:
    return np.clip(mean + deviation * normal(words), *clip)


def _parse_integers(table: Table, *_: Any) -> Form:
    """{ integers = [low, high] }, limits included."""
    value = table["integers"]
    if not isinstance(value, list) or len(value) != 2:
        raise RefusedError("integers must be [low, high]", shown(value))
    low, high = (_whole(end, -MAX_INTEGER, MAX_INTEGER) for end in value)
    if not 0 <= high - low < MAX_INTEGER:
        raise RefusedError("integers must be [low, high], low at most high", shown(value))
    return Numbers(_size(table), low, high, partial(_draw_integers, low, high))


def _draw_integers(low: int, high: int, words: Words) -> NDArray[np.int64]:
    return low + np.minimum((unit(words) * (high - low + 1)).astype(np.int64), high - low)


@dataclass(frozen=True)
class ChoiceForm(Form):
    """{ choice = [...], weights = [...] }; below: for each entry, the sum of weights up to it, divided by the total."""

    entries: tuple[Any, ...]
    below: tuple[float, ...]

    @classmethod
    def parse(cls, table: Table, *_: Any) -> Form:
        entries = _at("choice", table, _entries)
        weights = table.get("weights", [1.0] * len(entries))
        if not isinstance(weights, list) or len(weights) != len(entries):
            raise RefusedError(f"weights must be a list of {len(entries)} numbers", shown(weights))
        numbers = [_at("weights", {"weights": weight}, _number) for weight in weights]
        if min(numbers) < 0 or not (total := math.fsum(numbers)) > 0:
            raise RefusedError("weights must be at least 0, and one above it", shown(weights))
        return cls(None, entries, tuple(math.fsum(numbers[: k + 1]) / total for k in range(len(numbers))))

    def value(self, words: Words, split: int) -> Any:  # noqa: ARG002
        return self.entries[int(np.searchsorted(self.below[:-1], unit(words)[0], side="right"))]

    def extremes(self) -> tuple[Any, ...]:
        return self.entries


@dataclass(frozen=True)
class Files(Form):
    """{ files = "pattern", split = "by_file" }: one of the files that match.

    names: of all files, relative to the folder of the distribution file; of_split: for each split, positions in `names`
    of the files that its samples may have.
    """

    names: tuple[str, ...]
    of_split: tuple[tuple[int, ...], ...]

    @classmethod
    def parse(cls, table: Table, folder: Folder, splits: Splits | None) -> Form:
        names = _at("files", table, folder.match)
        digests = [_at("files", {"files": name}, folder.take) for name in names]
        numbers = range(max(1, len(splits or ())))
        if "split" not in table:
            return cls(None, tuple(names), (tuple(range(len(names))),) * len(numbers))
        _require_word("split", table, "by_file")
        if splits is None:
            raise RefusedError("files must be without split where a parameter decides the split", '"by_file"')
        split = of_files(splits, digests)
        of_split = tuple(tuple((split == number).nonzero()[0].tolist()) for number in numbers)
        empty = [name for (name, _), own in zip(splits, of_split, strict=False) if not own]
        if empty:
            rule = f"files must be more, so that each split has one: there is none for {', '.join(empty)}"
            raise RefusedError(rule, f"{len(names)} files")
        return cls(None, tuple(names), of_split)

    def value(self, words: Words, split: int) -> Any:
        own = self.of_split[split]
        return self.names[own[min(int(unit(words)[0] * len(own)), len(own) - 1)]]

    def extremes(self) -> tuple[Any, ...]:
        return self.names[:1]


@dataclass(frozen=True)
class Frustum(Form):
    """{ frustum = { depth = [near, far], margin = px, density = "volume" } }: a point in the camera's field of view.

    near, far: range of the depth, mm. margin: px at each border without points. by_volume: True if points are uniform
    in the volume, False if they are uniform in depth.
    """

    near: float
    far: float
    margin: float
    by_volume: bool

    @classmethod
    def parse(cls, outer: Table, *_: Any) -> Form:
        table = outer["frustum"]
        if not isinstance(table, Mapping) or "depth" not in table:
            raise RefusedError("frustum must be { depth = [near, far], margin = px }", shown(table))
        if unknown := sorted(table.keys() - {"depth", "margin", "density"}):
            raise RefusedError("frustum must have depth, margin and density only", shown(unknown[0]))
        near, far = _at("depth", table, _range)
        if near < 1e-9:
            raise RefusedError("depth must be above 0", shown(table["depth"]))
        margin = _at("margin", table, _number) if "margin" in table else 0.0
        if "density" in table:
            _require_word("density", table, "volume", "depth")
        return cls(3, near, far, margin, table.get("density") != "depth")

    def value(self, words: Words, split: int) -> Placed:  # noqa: ARG002
        across, up, depth = unit(words)
        if self.by_volume:
            depth = np.clip(cube_root(_between(self.near**3, self.far**3, depth)), self.near, self.far)
        else:
            depth = _between(self.near, self.far, depth)
        return Placed(float(2.0 * across - 1.0), float(2.0 * up - 1.0), float(depth), self.margin)

    def extremes(self) -> tuple[Any, ...]:
        return Placed(-1.0, -1.0, self.near, self.margin), Placed(1.0, 1.0, self.far, self.margin)


@dataclass(frozen=True)
class Placed:
    """A point in the frustum of a camera that is not known yet."""

    across: float  # from -1 to 1 over the frame without its margin
    up: float  # likewise
    depth: float  # mm
    margin: float  # px

    def point(self, columns: int, rows: int, step: float) -> list[float]:
        """The point (x, y, z) in mm for a camera; step: difference in slope between rays of neighboring pixels."""
        x, y = (share * (0.5 * n - self.margin) * step for share, n in ((self.across, columns), (self.up, rows)))
        return [x * self.depth, y * self.depth, self.depth]


@dataclass(frozen=True)
class Rotated(Form):
    """{ direction = "sphere" }: a unit vector; { rotation = "uniform" }: a unit quaternion. Both are uniform on their
    sphere, in 3 and 4 dimensions.
    """

    @classmethod
    def parse(cls, table: Table, *_: Any) -> Form:
        key, word, size = ("direction", "sphere", 3) if "direction" in table else ("rotation", "uniform", 4)
        _require_word(key, table, word)
        return cls(size)

    def value(self, words: Words, split: int) -> Any:  # noqa: ARG002
        vector = normal(words)
        return self._written(vector / np.sqrt(sum(part * part for part in vector)))

    def extremes(self) -> tuple[Any, ...]:
        first = np.zeros(self.words)
        first[0] = 1.0
        return self._written(first), self._written(first[::-1])

    def _written(self, vector: NDArray[np.float64]) -> Any:
        return vector.tolist() if self.size == 3 else {"quaternion": vector.tolist()}


FORMS: dict[str, tuple[Callable[[Table, Folder, Splits | None], Form], tuple[str, ...]]] = {
    "uniform": (_parse_uniform, ("size",)),
    "log_uniform": (_parse_log_uniform, ("size",)),
    "normal": (_parse_normal, ("size", "clip")),
    "integers": (_parse_integers, ("size",)),
    "choice": (ChoiceForm.parse, ("weights",)),
    "files": (Files.parse, ("split",)),
    "frustum": (Frustum.parse, ()),
    "direction": (Rotated.parse, ()),
    "rotation": (Rotated.parse, ()),
}
"""Distributions by the key that names them, each with its options."""


def is_form(value: Any) -> bool:
    """True if a value is a table that states a distribution."""
    return isinstance(value, Mapping) and any(key in FORMS for key in value)


def form_of(table: Table, folder: Folder, splits: Splits | None) -> Form:
    """The distribution that a table states; splits: None if they depend on a parameter. Raises RefusedError."""
    names = [key for key in table if key in FORMS]
    if len(names) > 1:
        raise RefusedError("must be one distribution", " and ".join(names))
    parse, options = FORMS[names[0]]
    if unknown := [key for key in table if key != names[0] and key not in options]:
        takes = f"takes {' and '.join(options)} only" if options else "stands alone"
        raise RefusedError(f"{names[0]} {takes}", shown(unknown[0]))
    return parse(table, folder, splits)
