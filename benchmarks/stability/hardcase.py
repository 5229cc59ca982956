"""Hard cases of numerics: their values, their measurement, and their bounds (pure)."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import isfinite, nan

from clsco.records import Real

FORMS = ("naive", "single", "double")
TIMED = 5  # rounds, of which the median counts


@dataclass(frozen=True)
class Point:
    """Errors at one value of what makes a case hard; nan: not measured there."""

    condition: float
    naive: float
    single: float = nan
    double: float = nan


@dataclass(frozen=True)
class HardCase:
    """One hard case, as the thesis has it and by the package.

    name: that of the table; condition: what makes it hard, the points' abscissa; unit: of errors; values: how many were
    compared; points: errors, of which the rows show the largest; bounds: of the package's errors in single and double
    precision, infinite for none. wrong: values of another class (hit or miss, root, winner) per form, None where there
    are no classes; ns: time per value and form, process CPU time; remedy: what the package does.
    """

    name: str
    condition: str
    unit: str
    values: int
    points: tuple[Point, ...]
    bounds: tuple[float, float]
    remedy: str
    wrong: tuple[int, int, int] | None = None
    ns: tuple[float, float, float] = (nan, nan, nan)

    def worst(self, form: str) -> float:
        """Largest error of a form, infinite where something is no number; nan where it was not measured."""
        found = [getattr(point, form) for point in self.points]
        known = [value for value in found if value == value]
        return max(known, default=nan)

    @property
    def reached(self) -> bool:
        """True if every error of the package is within its bound, and nothing with a bound is of another class."""
        own = [self.worst(form) for form in FORMS[1:]]
        within = all(not error > bound for error, bound in zip(own, self.bounds, strict=True))
        wrong = [n for n, bound in zip((self.wrong or (0, 0, 0))[1:], self.bounds, strict=True) if isfinite(bound)]
        return within and any(isfinite(error) for error in own) and not any(wrong)


@dataclass(frozen=True)
class Compared:
    """Comparison of one form: its largest error, nan where all values are of another class, their count, and that of
    all."""

    error: float
    wrong: int
    values: int


Measured = dict[str, Compared]  # by form
SINGLE_OR_DOUBLE: dict[Real, str] = {"float": "single", "double": "double"}


def hard_case(
    name: str, condition: str, unit: str, found: Sequence[tuple[float, Measured]], bounds: tuple[float, float],
    remedy: str, ns: dict[str, float] | None = None, classes: bool = True,
) -> HardCase:  # fmt: skip
    """A case of what was found at each value of the condition; classes: whether there are any."""
    points = tuple(Point(at, **{form: one.error for form, one in measured.items()}) for at, measured in found)

    def total(form: str) -> int:
        return sum(measured[form].wrong for _, measured in found if form in measured)

    times = ns or {}
    return HardCase(
        name=name,
        condition=condition,
        unit=unit,
        values=sum(max(one.values for one in measured.values()) for _, measured in found),
        points=points,
        bounds=bounds,
        remedy=remedy,
        wrong=(total("naive"), total("single"), total("double")) if classes else None,
        ns=(times.get("naive", nan), times.get("single", nan), times.get("double", nan)),
    )


def ns_per_value(call: Callable[[], object], values: int) -> float:
    """Median process CPU time of a call per value, in ns, after a call that does not count."""
    call()
    spent = []
    for _ in range(TIMED):
        start = time.process_time_ns()
        call()
        spent.append(time.process_time_ns() - start)
    return sorted(spent)[TIMED // 2] / values
