"""Which cases of the benchmark are left out: by what they took at smaller sizes, and as time is over."""

from __future__ import annotations

import time
from math import inf

from clsco.bench.cases import Case, Grid


class Paces:
    """Seconds per pixel that the cases of a grid took, smaller sizes first; first_call_s: at whatever size."""

    def __init__(self, grid: Grid) -> None:
        self.grid = grid
        self.end = time.monotonic() + 60.0 * (inf if grid.minutes is None else grid.minutes)
        self.known: dict[Case, tuple[int, float]] = {}
        self.slow: dict[Case, str] = {}
        self.first_call_s: dict[Case, float] = {}

    def note(self, case: Case, seconds: float) -> None:
        """How long a call in full size takes, or at least."""
        self.known[case.kind] = (case.size, seconds / case.size**2)

    def objection(self, case: Case) -> str:
        """Why a case is left out before it was called; empty: it is not."""
        if time.monotonic() > self.end:
            return f"no case is begun after {self.grid.minutes:g} minutes"
        if case.kind in self.slow:
            return self.slow[case.kind]
        size, pace = self.known.get(case.kind, (0, 0.0))
        least = 0.5 * pace * case.size**2  # a pixel may take less in a larger image
        if least > self.grid.longest_s:
            return f"a call must take {self.grid.longest_s:g} s at most; got at least {least:.2g} s, by {size} px"
        task = case.kind.task
        alike = [other for of, other in self.known.items() if of.tool == "clsco" and of.task == task]
        fastest = min((other for at, other in alike if at == size), default=pace)
        if case.tool == "clsco" and pace > self.grid.slowest * fastest:
            times = f"got {pace / fastest:.2g} at {size} px"
            self.slow[case.kind] = (
                f"a way must take {self.grid.slowest:g} times as long as the fastest at most; {times}"
            )
            return self.slow[case.kind]
        return ""
