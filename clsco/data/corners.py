"""Extreme values of a distribution, as scenes: a file that can give an invalid one is refused when it is read."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any

from clsco.data.build import Builder, Values
from clsco.data.parts import Parts
from clsco.errors import SceneError

MAX_CORNERS = 400
MAX_EXTREMES = 48  # of one distribution


def corner_faults(parts: Parts, folder: Path) -> list[str]:
    """Messages on scenes of extreme values, each once: the lowest of all, the highest of all, and each extreme of one
    parameter with the lowest and the highest values of the others."""
    found: dict[str, str] = {}  # by what is asked for
    for corner in _corners(parts):
        try:
            Builder(parts, folder).build(corner, derive=False)
        except SceneError as error:
            for message in error.messages:
                found.setdefault(message.partition("; got ")[0], message)
    return list(found.values())


def _corners(parts: Parts) -> Iterator[Values]:
    every = [*parts.parameters, *(rows.parameter for rows in parts.rows)]
    every += [one for population in parts.populations for one in population.parameters]
    extremes = {one.name: _some(one.form.extremes()) for one in every}
    lowest, highest = ({name: values[end] for name, values in extremes.items()} for end in (0, -1))
    yield _values(parts, lowest, 0)
    yield _values(parts, highest, -1)
    varied = ((name, value, others) for name in extremes for value in extremes[name] for others in (lowest, highest))
    for name, value, others in islice(varied, MAX_CORNERS):
        yield _values(parts, others | {name: value}, None)


def _values(parts: Parts, picked: dict[str, Any], many: int | None) -> Values:
    """Values by the names of their parameters; many: which extreme of the size of each population, None for one object
    of each."""
    members = []
    for population in parts.populations:
        counts = population.count.form.extremes()
        count = min(1, max(counts)) if many is None else sorted(counts)[many]
        members.append([[picked[one.name] for one in population.parameters]] * count)
    rows = [picked[one.parameter.name] for one in parts.rows]
    return Values([picked[one.name] for one in parts.parameters], rows, members)


def _some(values: tuple[Any, ...]) -> list[Any]:
    """At most MAX_EXTREMES of the values, the first and the last among them."""
    count = min(len(values), MAX_EXTREMES)
    return [values[(len(values) - 1) * k // max(1, count - 1)] for k in range(count)]
