"""Tables of a distribution file that stand for a value, as distributions: { uniform = [1, 2] }."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path, PureWindowsPath
from typing import Any

from clsco.data.draws import Splits, of_files
from clsco.data.values import (
    ChoiceForm,
    Files,
    Form,
    Frustum,
    Integers,
    LogUniform,
    Normal,
    Turned,
    Uniform,
    shares,
)
from clsco.files.atomic import sha256
from clsco.scene.text import shown

MAX_NAME = 1024
MAX_FILES = 100_000
MAX_LOOKED_AT = 1_000_000  # of folders that a pattern makes us look at
MAX_DEEP = 32  # folders in each other
MAX_BYTES = 2**31  # of a file
MAX_TOTAL = 2**37


class RefusedError(Exception):
    """A value is not what it must be: the rule, and the value if another one than was looked at."""

    def __init__(self, rule: str, got: Any = None) -> None:
        self.rule, self.got = rule, got
        super().__init__(rule)

    def message(self, key: str, value: Any) -> str:
        """`key: rule; got value`."""
        return f"{key}: {self.rule}; got {shown(value) if self.got is None else self.got}"


class Folder:
    """The folder of a distribution file; nothing outside of it is read, whatever links say."""

    def __init__(self, path: Path) -> None:
        self.path = path.resolve()
        self.digests: dict[str, str] = {}
        """SHA-256 by name, of all files that have been taken."""
        self._bytes = self._entries = 0

    def inside(self, name: Any) -> Path:
        """The path of a file here by its name, links resolved. Raises RefusedError."""
        if not isinstance(name, str) or not 0 < len(name) <= MAX_NAME or not name.isprintable():
            raise RefusedError(f"must be the name of a file, of at most {MAX_NAME} characters")
        windows = PureWindowsPath(name)
        if Path(name).is_absolute() or windows.drive or windows.root or ".." in windows.parts:
            raise RefusedError("must be a path inside the folder of the distribution file, without ..")
        try:
            path = (self.path / name).resolve(strict=True)
            if not path.is_relative_to(self.path):
                raise RefusedError("must not lead out of the folder of the distribution file by a link")
            if not path.is_file():
                raise RefusedError("must be a file")
        except (OSError, ValueError, RuntimeError):  # the last: links that go round in a circle, before Python 3.13
            raise RefusedError("must be an existing file") from None
        return path

    def take(self, name: Any) -> str:
        """Note a file that samples may need; returns its SHA-256. Raises RefusedError."""
        if name in self.digests:
            return self.digests[name]
        path = self.inside(name)
        try:
            size = path.stat().st_size
            self._bytes += size
            if size > MAX_BYTES or self._bytes > MAX_TOTAL:
                raise RefusedError(f"a file must have at most {MAX_BYTES} bytes, and all of them {MAX_TOTAL}", size)
            if len(self.digests) == MAX_FILES:
                raise RefusedError(f"must be at most {MAX_FILES} files in all", "more")
            self.digests[name] = sha256(path)
        except OSError as error:
            raise RefusedError("must be readable", error.strerror) from None
        return self.digests[name]

    def match(self, pattern: Any) -> list[str]:
        """Names of the files that a pattern like "textures/**/*.png" fits, in order. Raises RefusedError."""
        if not isinstance(pattern, str) or not 0 < len(pattern) <= MAX_NAME or not pattern.isprintable():
            raise RefusedError('must be a pattern of files, like "textures/**/*.png"')
        windows = PureWindowsPath(pattern)
        parts = pattern.split("/")
        if windows.drive or windows.root or ".." in windows.parts or "" in parts:
            raise RefusedError("must be a pattern inside the folder of the distribution file, without ..")
        if parts.count("**") > 1 or len(parts) > MAX_DEEP:
            raise RefusedError(f"must have ** at most once, and at most {MAX_DEEP} parts")
        names = sorted(self._found(self.path, parts, ""))
        if not names:
            raise RefusedError("must fit a file")
        return names

    def _found(self, folder: Path, parts: list[str], before: str) -> Iterator[str]:
        """Names of files under `folder` that the parts of a pattern fit; before: what their names begin with."""
        if before.count("/") > MAX_DEEP:
            raise RefusedError(f"must not go through more than {MAX_DEEP} folders in each other")
        try:
            with os.scandir(folder) as listed:
                entries = list(self._counted(listed))
        except OSError as error:
            raise RefusedError("its folders must be readable", error.strerror) from None
        part, rest = (parts[1], parts[2:]) if parts[0] == "**" and len(parts) > 1 else (parts[0], parts[1:])
        for entry in entries:
            if entry.name.startswith(".") and not part.startswith("."):
                continue
            name = before + entry.name
            if parts[0] == "**" and entry.is_dir(follow_symlinks=False):
                yield from self._found(folder / entry.name, parts, f"{name}/")
            if not fnmatchcase(entry.name, part):
                continue
            if rest and entry.is_dir(follow_symlinks=False):
                yield from self._found(folder / entry.name, rest, f"{name}/")
            elif not rest and entry.is_file():
                yield name

    def _counted(self, entries: Iterator[os.DirEntry[str]]) -> Iterator[os.DirEntry[str]]:
        for entry in entries:
            self._entries += 1
            if self._entries > MAX_LOOKED_AT:
                raise RefusedError(f"folders must have at most {MAX_LOOKED_AT} entries in all", "more")
            yield entry


LARGEST = 1e30  # of a number, so that sums and cubes are finite
MAX_INTEGER = 2**53
MAX_ENTRIES = 10_000
MAX_SIZE = 16


@dataclass
class FormContext:
    """Context that the forms of a file share: its folder and splits."""

    folder: Folder
    splits: Splits


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


def _size(given: Mapping[str, Any]) -> int | None:
    return None if "size" not in given else _at("size", given, lambda value: _whole(value, 1, MAX_SIZE))


def _at(key: str, given: Mapping[str, Any], check: Callable[[Any], Any]) -> Any:
    """An option, checked; RefusedError names it."""
    try:
        return check(given[key])
    except RefusedError as error:
        raise RefusedError(f"{key} {error.rule}", shown(given[key]) if error.got is None else error.got) from None


def _word(word: str) -> Callable[[Any], str]:
    def check(value: Any) -> str:
        if value != word:
            raise RefusedError(f'must be "{word}"')
        return word

    return check


def _uniform(given: Mapping[str, Any], _: FormContext) -> Form:
    return Uniform(_size(given), *_at("uniform", given, _range))


def _log_uniform(given: Mapping[str, Any], _: FormContext) -> Form:
    low, high = _at("log_uniform", given, _range)
    if low < 1e-30:
        raise RefusedError("log_uniform must be [low, high] of numbers above 0", shown(given["log_uniform"]))
    return LogUniform(_size(given), low, high)


def _normal(given: Mapping[str, Any], _: FormContext) -> Form:
    mean, deviation = _at("normal", given, lambda value: _pair(value, "[mean, standard deviation]"))
    if deviation <= 0:
        raise RefusedError("normal must be [mean, standard deviation], the latter above 0", shown(given["normal"]))
    clip = _at("clip", given, _range) if "clip" in given else (-LARGEST, LARGEST)
    return Normal(_size(given), mean, deviation, clip)


def _integers(given: Mapping[str, Any], _: FormContext) -> Form:
    value = given["integers"]
    if not isinstance(value, list) or len(value) != 2:
        raise RefusedError("integers must be [low, high]", shown(value))
    low, high = (_whole(end, -MAX_INTEGER, MAX_INTEGER) for end in value)
    if not 0 <= high - low < MAX_INTEGER:
        raise RefusedError("integers must be [low, high], low at most high", shown(value))
    return Integers(_size(given), low, high)


def _entries(value: Any) -> tuple[Any, ...]:
    if not isinstance(value, list) or not 1 <= len(value) <= MAX_ENTRIES:
        raise RefusedError(f"must be a list of 1 to {MAX_ENTRIES} values")
    if any(isinstance(entry, Mapping) or _deep(entry) for entry in value):
        raise RefusedError("must be a list of numbers, texts, or lists of numbers", "a table or a list of lists in it")
    return tuple(value)


def _deep(entry: Any) -> bool:
    """True if a list holds more than a vector, or than the bounds of an object."""
    inner = [part for part in entry if isinstance(part, list)] if isinstance(entry, list) else []
    tables = isinstance(entry, list) and any(isinstance(part, Mapping) for part in entry)
    return tables or any(isinstance(part, list | Mapping) for one in inner for part in one)


def _choice(given: Mapping[str, Any], _: FormContext) -> Form:
    entries = _at("choice", given, _entries)
    if "weights" not in given:
        return ChoiceForm(None, entries, shares([1.0] * len(entries)))
    weights = given["weights"]
    if not isinstance(weights, list) or len(weights) != len(entries):
        raise RefusedError(f"weights must be a list of {len(entries)} numbers", shown(weights))
    numbers = [_at("weights", {"weights": weight}, _number) for weight in weights]
    if min(numbers) < 0 or not math.fsum(numbers) > 0:
        raise RefusedError("weights must be at least 0, and one above it", shown(weights))
    return ChoiceForm(None, entries, shares(numbers))


def _files(given: Mapping[str, Any], found: FormContext) -> Form:
    names = _at("files", given, found.folder.match)
    digests = [_at("files", {"files": name}, found.folder.take) for name in names]
    count = max(1, len(found.splits))
    if "split" not in given:
        return Files(None, tuple(names), (tuple(range(len(names))),) * count)
    _at("split", given, _word("by_file"))
    place = of_files(found.splits, digests)
    of_split = tuple(tuple((place == number).nonzero()[0].tolist()) for number in range(count))
    empty = [name for (name, _), own in zip(found.splits, of_split, strict=False) if not len(own)]
    if empty:
        rule = f"files must be more, so that each split has one: there is none for {', '.join(empty)}"
        raise RefusedError(rule, f"{len(names)} files")
    return Files(None, tuple(names), of_split)


def _frustum(given: Mapping[str, Any], _: FormContext) -> Form:
    table = given["frustum"]
    if not isinstance(table, Mapping) or "depth" not in table:
        raise RefusedError("frustum must be { depth = [near, far], margin = px }", shown(table))
    if unknown := sorted(table.keys() - {"depth", "margin", "density"}):
        raise RefusedError("frustum must have depth, margin and density only", shown(unknown[0]))
    near, far = _at("depth", table, _range)
    if near < 1e-9:
        raise RefusedError("depth must be above 0", shown(table["depth"]))
    margin = _at("margin", table, _number) if "margin" in table else 0.0
    density = table.get("density", "volume")
    if density not in ("volume", "depth"):
        raise RefusedError('density must be "volume" or "depth"', shown(density))
    return Frustum(None, near, far, margin, density == "volume")


def _direction(given: Mapping[str, Any], _: FormContext) -> Form:
    _at("direction", given, _word("sphere"))
    return Turned(3)


def _rotation(given: Mapping[str, Any], _: FormContext) -> Form:
    _at("rotation", given, _word("uniform"))
    return Turned(4)


FORMS: dict[str, tuple[Callable[[Mapping[str, Any], FormContext], Form], tuple[str, ...]]] = {
    "uniform": (_uniform, ("size",)),
    "log_uniform": (_log_uniform, ("size",)),
    "normal": (_normal, ("size", "clip")),
    "integers": (_integers, ("size",)),
    "choice": (_choice, ("weights",)),
    "files": (_files, ("split",)),
    "frustum": (_frustum, ()),
    "direction": (_direction, ()),
    "rotation": (_rotation, ()),
}
"""Distributions by the key that names them, each with its options."""


def is_form(value: Any) -> bool:
    """True if a table stands for a value."""
    return isinstance(value, Mapping) and any(key in FORMS for key in value)


def form_of(given: Mapping[str, Any], found: FormContext) -> Form:
    """The distribution that a table states. Raises RefusedError."""
    names = [key for key in given if key in FORMS]
    if len(names) > 1:
        raise RefusedError("must be one distribution", " and ".join(names))
    make, options = FORMS[names[0]]
    if unknown := [key for key in given if key != names[0] and key not in options]:
        takes = f"takes {' and '.join(options)} only" if options else "stands alone"
        raise RefusedError(f"{names[0]} {takes}", shown(unknown[0]))
    return make(given, found)
