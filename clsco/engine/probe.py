"""Predicts the time of a frame from a part of it: as many strips and time samples as take half a second."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import ceil
from operator import itemgetter
from time import perf_counter, process_time

from clsco.constants import BAND
from clsco.engine.film import Film
from clsco.engine.renderer import Renderer
from clsco.frame.strips import Strip
from clsco.opencl.session import Session
from clsco.plan.memory import fit_strips, limit_of
from clsco.plan.passes import ONCE_A_FRAME, Kind
from clsco.plan.plan import Plan
from clsco.plan.prepare import Prepared

SECONDS = 0.5  # time in s after which no further step is run
BY_HEIGHT: frozenset[Kind] = frozenset({"trace", "silhouettes"})
"""Passes whose time grows with the rows of a strip's source grid; the time of others grows with the strip's rows."""

GOLDEN = 0.618034  # multiples of this number modulo 1 are spread evenly


@dataclass(frozen=True)
class _FramePart:
    """A step of a measurement: time sample `number` on a strip, of which it renders `part`.

    still: True for the still sources that follow all time samples. last: True for the last step of the strip, whose
    result also goes through the passes in `ONCE_A_FRAME`.
    """

    strip: Strip
    number: int
    part: Strip
    still: bool
    last: bool


@dataclass(frozen=True)
class FrameTime:
    """Predicted seconds that a frame takes, without the compilation of kernels and the writing of files."""

    views: tuple[dict[Kind, float], ...]  # for each view, the seconds of its passes by kind
    share: float  # fraction of the frame's work that was measured

    @property
    def seconds(self) -> float:
        return sum(sum(passes.values()) for passes in self.views)

    @property
    def longest(self) -> tuple[Kind, float]:
        """The kind of pass that takes the most time, with its fraction of the frame's time, 0 to 1."""
        kinds = dict.fromkeys(kind for passes in self.views for kind in passes)
        sums = {kind: sum(passes.get(kind, 0.0) for passes in self.views) for kind in kinds}
        kind = max(sums, key=sums.__getitem__)
        return kind, sums[kind] / self.seconds


def measure_frame(session: Session, prepared: Prepared, seconds: float = SECONDS) -> FrameTime:
    """Render a part of a frame on the device that will render it, and scale the time by rows and time samples.

    seconds: a view runs no further step when its steps have taken this time, without compilation. Ground truth is
    always computed for the whole frame. Validated against whole frames by benchmarks/speed/prediction.py.
    """
    with session.reporting():
        views, shares = zip(*(_measure_view(session, prepared, plan, seconds) for plan in prepared.plans), strict=True)
    return FrameTime(views, min(shares))


def _measure_view(session: Session, prepared: Prepared, plan: Plan, seconds: float) -> tuple[dict[Kind, float], float]:
    """Seconds of each kind of pass in a frame, and the fraction of its steps that was measured."""
    limit = limit_of(prepared.request.memory, session.device)
    strip_plan, index = fit_strips(plan, limit), plan.scene.sequence.frames // 2
    clock = _Clock(session, ceil(strip_plan.grid.rows / BAND))
    # A processor renders the shortest strips, each on one core, if the frame can be rendered in such strips.
    indivisible = plan.forward or plan.spec.layered or plan.rows <= BAND or not clock.per_core
    plan = strip_plan if indivisible else replace(strip_plan, strip_rows=BAND)
    renderer = Renderer(session, plan, prepared, limit)
    while True:
        film, spent, steps = _run_steps(renderer, index, seconds, clock)
        if not renderer.enlarge():
            break
    all_steps = _steps(Film(strip_plan, index))
    seconds_by_kind = dict[Kind, float]()
    for (kind, still), time in spent.items():
        scale = _rows(all_steps, kind, still) / _rows(steps, kind, still)
        seconds_by_kind[kind] = seconds_by_kind.get(kind, 0.0) + time * scale
    if renderer.plan.truth:
        clock.lap()
        for _ in range(2):  # twice if compilation may have taken much of the first run's time
            renderer.truth.compute(index, film.events)
            seconds_by_kind["ground truth"] = clock.lap()
            if seconds_by_kind["ground truth"] > SECONDS:
                break
    renderer.scene.release()
    return seconds_by_kind, sum(step.part.rows for step in steps) / sum(step.part.rows for step in all_steps)


class _Clock:
    """Measures the time between passes; on a processor, its CPU time divided by the number of cores.

    Other processes do not affect the CPU time. most: number of cores that can work on a frame at the same time.
    """

    def __init__(self, session: Session, most: int) -> None:
        self.queue, self.per_core = session.queue, session.device.kind == "cpu"
        self._now = process_time if self.per_core else perf_counter
        self._cores = min(most, session.device.compute_units) if self.per_core else 1
        self._last = self._now()

    def lap(self) -> float:
        """Seconds since the previous call; waits until all enqueued work is done."""
        self.queue.finish()
        last, self._last = self._last, self._now()
        return (self._last - last) / self._cores


def _steps(film: Film) -> list[_FramePart]:
    """All steps of a frame on all strips, in the order in which they are measured.

    The first round has the last step of each strip, which runs all passes; each later round has one more step of each
    strip. However few strips of a round are measured, they are spread evenly over the frame.
    """
    strips = sorted(film.strip_parts.items(), key=lambda item: _spread(item[0].top // max(item[0].rows, 1)))
    rounds = list[tuple[int, _FramePart]]()
    for strip, parts in strips:
        *earlier, last = parts
        numbers = enumerate((last, *sorted(earlier, key=_spread)))
        for turn, number in numbers:
            part = _FramePart(strip, number, parts[number], number == film.samples, number == last)
            rounds.append((turn, part))
    return [step for _, step in sorted(rounds, key=itemgetter(0))]


def _spread(number: int) -> float:
    return (0.5 + number * GOLDEN) % 1.0


def _run_steps(
    renderer: Renderer, index: int, seconds: float, clock: _Clock
) -> tuple[Film, dict[tuple[Kind, bool], float], list[_FramePart]]:
    """Run steps for `seconds`; returns the film, seconds by kind of pass and `still`, and the steps measured.

    The first step runs once before it is measured, because kernels are compiled at their first run.
    """
    film, done, spent = renderer.begin(index), list[_FramePart](), dict[tuple[Kind, bool], float]()
    steps = _steps(film)
    for step in steps:

        def note(kind: Kind, step: _FramePart = step) -> None:
            if step.last or kind not in ONCE_A_FRAME:
                spent[kind, step.still] = spent.get((kind, step.still), 0.0) + clock.lap()

        if not done:
            renderer.add(film, step.strip, step.number)
        clock.lap()
        renderer.add(film, step.strip, step.number, note)
        done.append(step)
        if sum(spent.values()) > seconds and {step.still for step in done} == {step.still for step in steps}:
            break
    return film, spent, done


def _rows(steps: list[_FramePart], kind: Kind, still: bool) -> int:
    """Number of rows that passes of a kind process in those of these steps with this value of `still`."""
    parts = [step.part for step in steps if step.still == still and (step.last or kind not in ONCE_A_FRAME)]
    return sum(part.height if kind in BY_HEIGHT else part.rows for part in parts)
