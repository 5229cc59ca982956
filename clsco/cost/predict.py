"""Seconds that a frame takes, predicted from its plan without running anything."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from math import ceil
from time import perf_counter

import numpy as np

from clsco.constants import BAND
from clsco.cost.rates import CORE_SECONDS, RATES
from clsco.cost.work import Work, frame_work
from clsco.plan.plan import Plan
from clsco.plan.prepare import Prepared
from clsco.resources import processors

METHODS = ("gather", "convolve", "none")  # of the blur, whose rates are known
SIDE, ROUNDS = 2**14, 16  # of what a core is measured by: values that fit its cache, and how often they are computed


@dataclass(frozen=True)
class Cost:
    """Predicted seconds of a frame.

    Attributes
    ----------
    views : tuple of dict
        Kind of pass -> seconds of all of that kind, as they are run; of each view.
    host : float
        Other work of the host.
    cores : int
        That were reckoned with.
    """

    views: tuple[dict[str, float], ...]
    host: float
    cores: int

    @property
    def seconds(self) -> float:
        """All of a frame, after kernels were compiled, without writing files."""
        return self.host + sum(sum(passes.values()) for passes in self.views)

    @property
    def dearest(self) -> tuple[str, float]:
        """The kind of pass that takes longest, with its share of the frame, 0 to 1."""
        kinds = dict.fromkeys(kind for passes in self.views for kind in passes)
        found = {kind: sum(passes.get(kind, 0.0) for passes in self.views) for kind in kinds}
        kind = max(found, key=found.__getitem__)
        return kind, found[kind] / self.seconds


def cost_of(prepared: Prepared, cores: int | None = None, slower: float | None = None) -> Cost | None:
    """Predict the seconds of a frame.

    Parameters
    ----------
    prepared : Prepared
        With plans for a processor.
    cores : int, optional
        That work on it; by default those that this process may use.
    slower : float, optional
        Time of a core as a multiple of that which the rates are of; by default measured (`core_seconds`), which takes
        some milliseconds once in a process.

    Returns
    -------
    Cost or None
        None where nothing was measured: on graphics cards, and for the methods that are for these.

    Notes
    -----
    Each pass is the number of its operations (`clsco.cost.work.frame_work`) times their rates, on cores that have
    nothing else to do. Validated within a factor of 2 of what frames take by benchmarks/speed/prediction.py.
    """
    plans = prepared.plans
    if any(plan.device.kind != "cpu" or plan.blur not in METHODS for plan in plans):
        return None
    cores = cores or min(processors(), plans[0].device.compute_units)
    slower = core_seconds() / CORE_SECONDS if slower is None else slower
    views, host = list[dict[str, float]](), 0.0
    for plan in plans:
        passes: dict[str, float] = {}
        with np.errstate(all="ignore"):  # of scenes beyond what numbers can hold
            found = frame_work(plan, prepared.maps)
        for each, work in found:
            abreast = min(cores, _abreast(plan, each.kind))
            passes[each.kind] = passes.get(each.kind, 0.0) + slower * _seconds(work) / abreast
        views.append(passes)
        host += slower * _seconds(host_work(plan))
    return Cost(tuple(views), host, cores)


def _seconds(work: Work) -> float:
    """On the core that the rates are of."""
    return sum(RATES[name] * count for name, count in work.items())


def host_work(plan: Plan) -> Work:
    """Work of a frame beside its passes."""
    pixels = float(plan.rows * plan.columns)
    return {"frame": 1.0, "read back": pixels * plan.channels * plan.color, "reference pose": pixels * plan.forward}


def _abreast(plan: Plan, kind: str) -> int:
    """Number of work-items of a pass that can run in parallel: one per row, with `gather` one per band of rows."""
    return ceil(plan.strips[0].rows / BAND) if kind == "blur" and plan.blur == "gather" else plan.rows


@cache
def core_seconds() -> float:
    """Seconds of a core for arithmetic on some thousand floats: the best of several, as other work may be going on."""
    values = np.linspace(0.5, 1.5, SIDE, dtype=np.float32)
    other = np.empty_like(values)

    def once() -> float:
        start = perf_counter()
        for _ in range(ROUNDS):
            np.multiply(values, values, out=other)
            np.add(other, values, out=other)
            np.sqrt(other, out=other)
        return perf_counter() - start

    return min(once() for _ in range(ROUNDS))


def duration(seconds: float) -> str:
    """A predicted time for people: two digits."""
    for unit, size in (("h", 3600.0), ("min", 60.0), ("s", 1.0), ("ms", 1e-3)):
        if seconds >= 1.5 * size or unit == "ms":
            break
    value = seconds / size
    return f"{value:.2g} {unit}" if value < 99.5 else f"{value:.0f} {unit}"
