"""Choice of the benchmark's cases that are left out: by their times at smaller sizes, and when time is over."""

from __future__ import annotations

import time
from collections.abc import Mapping
from math import inf

from benchmarks.blur.cases import BenchGrid, Case


class Paces:
    """Seconds per pixel that the cases of a grid took, smaller sizes first; first_call_s: at whatever size.

    Ways of clsco that take `slowest` times as long as its fastest one, on a crop or at a smaller size, are left out.
    """

    def __init__(self, grid: BenchGrid) -> None:
        self.grid = grid
        self.end = time.monotonic() + 60.0 * (inf if grid.minutes is None else grid.minutes)
        self.known: dict[Case, tuple[int, float]] = {}
        self.crops: dict[Case, float] = {}
        self.slow: dict[Case, str] = {}
        self.first_call_s: dict[Case, float] = {}

    def note(self, case: Case, seconds: float) -> None:
        """Record how long a call in full size takes, or at least."""
        self.known[case.kind] = (case.size, seconds / case.size**2)

    def objection(self, case: Case) -> str:
        """Why a case is left out before it was called; empty: it is not."""
        if time.monotonic() > self.end:
            return f"no case is begun after {self.grid.minutes:g} minutes"
        if case.kind in self.slow:
            return self.slow[case.kind]
        if case.kind not in self.known:
            return ""
        size, pace = self.known[case.kind]
        least = 0.5 * pace * case.size**2  # a pixel may take less in a larger image
        if least > self.grid.longest_s:
            return f"a call must take {self.grid.longest_s:g} s at most; got at least {least:.2g} s, by {size} px"
        beside = {of: other for of, (at, other) in self.known.items() if at == size}
        return self._too_slow(case, pace, beside, f"{size} px")

    def crop_objection(self, case: Case, seconds: float) -> str:
        """The same of one that took so long on its crop, most of whose taps leave it where PSFs are wide."""
        self.crops[case.kind] = seconds
        return self._too_slow(case, seconds, self.crops, "its crop")

    def _too_slow(self, case: Case, seconds: float, known: Mapping[Case, float], where: str) -> str:
        task = case.kind.task
        fastest = min((other for of, other in known.items() if of.tool == "clsco" and of.task == task), default=seconds)
        if case.tool != "clsco" or seconds <= self.grid.slowest * fastest:
            return ""
        times = f"got {seconds / fastest:.2g} at {where}"
        self.slow[case.kind] = f"a way must take {self.grid.slowest:g} times as long as the fastest at most; {times}"
        return self.slow[case.kind]
