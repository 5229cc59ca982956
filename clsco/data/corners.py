"""Extreme values of a distribution, as scenes: a file that can give an invalid one is refused when it is read."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from clsco.data.build import Builder, Values
from clsco.data.parts import Parameter, Parts
from clsco.errors import SceneError

MAX_CORNERS = 400
MAX_EXTREMES = 48  # of one distribution
Pick = Callable[[Parameter], Any]


def corner_faults(parts: Parts, folder: Path) -> list[str]:
    """Messages on scenes of extreme values, each once: the lowest of all, the highest of all, and each extreme of one
    parameter with the lowest and the highest values of the others."""
    found: dict[str, None] = {}
    for corner in _corners(parts):
        try:
            Builder(parts, folder).build(corner, derive=False)
        except SceneError as error:
            found.update(dict.fromkeys(error.messages))
    return list(found)


def _corners(parts: Parts) -> Iterator[Values]:
    every = [*parts.parameters, *(rows.parameter for rows in parts.rows)]
    every += [one for population in parts.populations for one in population.parameters]
    extremes = {id(one): _some(one.form.extremes()) for one in every}
    yield _values(parts, lambda one: _end(one, extremes, 0), 0)
    yield _values(parts, lambda one: _end(one, extremes, -1), -1)
    made = 2
    for varied in every:
        for value in extremes[id(varied)]:
            for end in (0, -1):
                if made == MAX_CORNERS:
                    return
                made += 1
                yield _values(parts, lambda one, v=value, e=end, p=varied: v if one is p else _end(one, extremes, e), None)  # type: ignore[misc]


def _values(parts: Parts, pick: Pick, many: int | None) -> Values:
    """Values that are picked; many: which extreme of the size of each population, None for one object of each."""
    members = []
    for population in parts.populations:
        counts = population.count.form.extremes()
        count = min(1, max(counts)) if many is None else sorted(counts)[many]
        members.append([[pick(one) for one in population.parameters]] * count)
    return Values([pick(one) for one in parts.parameters], [pick(rows.parameter) for rows in parts.rows], members)


def _end(one: Parameter, extremes: dict[int, list[Any]], which: int) -> Any:
    return extremes[id(one)][which]


def _some(values: tuple[Any, ...]) -> list[Any]:
    """At most MAX_EXTREMES of the values, the first and the last among them."""
    count = min(len(values), MAX_EXTREMES)
    return [values[(len(values) - 1) * k // max(1, count - 1)] for k in range(count)]
