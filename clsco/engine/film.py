"""The state of a frame while its strips and time samples are rendered."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from clsco.frame.strips import Strip
from clsco.opencl.pace import event_seconds
from clsco.opencl.session import Session
from clsco.optics.depth_layers import LayerBounds
from clsco.optics.exposure import frame_exposure
from clsco.passes.blur import Events, Plane
from clsco.passes.job import SourcePart
from clsco.plan.plan import Plan

if TYPE_CHECKING:
    from clsco.passes.sensor import Codes

NOTHING_MISSING = {"missing_pixels": 0, "filled_pixels": 0, "unfilled_pixels": 0, "sweeps": 0}


@dataclass(frozen=True, eq=False)
class Step:
    """One run of a plan's passes, for all sources of a time sample or for some of them.

    Attributes
    ----------
    number : int
        Number of the time sample at whose time objects are.
    weights : ndarray of float64, (lines,)
        Weight of the blurred plane in each row of the frame, or in each column if columns are exposed in turn.
    still : bool, optional
        True for a run with only the still sources, False for one with only the moving sources, None for all sources.
    """

    number: int
    weights: NDArray[np.float64]
    still: bool | None = None


def _strip_parts(plan: Plan, strip: Strip, steps: Sequence[Step]) -> dict[int, Strip]:
    """Part of a strip that each step renders, by the step's number; steps that do not affect the strip are absent."""
    parts = {}
    for number, step in enumerate(steps):
        part = strip if step.still else plan.part(strip, step.weights)
        if part is not None:
            parts[number] = part
    return parts


class Film:
    """The arrays of one frame, and records of how they were computed.

    Parameters
    ----------
    plan : Plan
    index : int
        Number of the frame.

    Attributes
    ----------
    times : list of float
        Times of the time samples, s.
    steps : tuple of Step
        Runs of the passes; the frame is the weighted sum of their planes.
    color : ndarray of float32 (rows, columns[, channels])
    code, saturated : ndarray of uint16, of bool (rows, columns, planes)
        Codes of a sensor, and True where it is saturated; 0 planes without a sensor.
    subframes : ndarray of float32 (samples or 0, rows, columns[, channels])
        Blurred planes of the time samples, if they are requested.
    missing : ndarray of bool (rows, columns)
        Pixels that were missing at any time sample, filled or not.
    bounds : dict
        Bounds of the depth layers by number of the time sample, if they were computed from all strips.
    strip_parts : dict
        For each strip, the part of it that each step renders, by the number of the step.
    source_parts : dict
        Still and moving sources, by `Step.still`.
    events : list
        Events of kernel launches.
    reports : dict
        Reports on time samples, by their number.
    """

    def __init__(self, plan: Plan, index: int) -> None:
        exposure = frame_exposure(plan.scene, index, plan.samples)
        shape = (plan.rows, plan.columns)
        image = shape if plan.channels == 1 else (*shape, plan.channels)
        lines = plan.columns if exposure.by_columns else plan.rows
        self.index, self.times, weights = index, exposure.times.tolist(), exposure.line_weights(lines)
        still = None if not plan.splits_still else False
        self.steps = tuple(Step(number, line_weights, still) for number, line_weights in enumerate(weights))
        if plan.splits_still:
            self.steps = (Step(0, weights.sum(axis=0), True), *self.steps)
        self.shares = exposure.weights.reshape(len(self.times), -1).mean(axis=1).tolist()
        self.strip_parts = {strip: _strip_parts(plan, strip, self.steps) for strip in plan.strips}
        self.color = np.empty(image, np.float32)
        planes = 0 if plan.sensor_model is None else len(plan.sensor_model.filters)
        self.code = np.empty((*shape, planes), np.uint16)
        self.saturated = np.empty((*shape, planes), np.bool_)
        self.subframes = np.empty((len(self.times) if "subframes" in plan.truth else 0, *image), np.float32)
        self.missing = np.zeros(shape, np.bool_)
        self.bounds: dict[int, tuple[LayerBounds, ...] | None] = {}
        self.source_parts: dict[bool | None, SourcePart] = {}
        self.events: Events = []
        self.reports: dict[int, dict[str, Any]] = {}
        self.began = perf_counter()
        self._planes: list[tuple[Plane, NDArray[np.float32]]] = []
        self._codes: list[tuple[Codes, slice]] = []
        self._needs_light = plan.needs_light

    def add(self, session: Session, strip: Strip, count: int, outputs: Mapping[str, Any]) -> None:
        """Add the outputs of a step's passes for a strip; count: number of the step; outputs: named as in `Pass`."""
        number = self.steps[count].number
        report = {"time": self.times[number], "weight": self.shares[number]} | NOTHING_MISSING
        self.reports[number] = (
            report | outputs.get("counts", {}) | {name: outputs[name] for name in ("depth_layers",) if name in outputs}
        )
        if "missing" in outputs:
            self.missing |= outputs["missing"]
        if "plane" not in outputs:
            return
        if len(self.subframes):
            outputs["plane"].read(session, self.subframes[number][strip.inside])
        if outputs.get("codes") is not None:
            self._codes.append((outputs["codes"], strip.inside))
        if count == [*self.strip_parts[strip]][-1] and self._needs_light:
            self._planes.append((outputs.get("frame", outputs["plane"]), self.color[strip.inside]))

    def read(self, session: Session) -> None:
        """Read back the strips of which all time samples have been added; waits for the device."""
        for plane, out in self._planes:
            plane.read(session, out)
        for codes, rows in self._codes:
            codes.read(session, self.code[rows], self.saturated[rows])
        self._codes.clear()
        self._planes.clear()

    def seconds(self) -> dict[str, float]:
        """Seconds on the device by kernel name, and as "host" the other seconds since the frame was begun."""
        seconds: dict[str, float] = {}
        for name, event in self.events:
            seconds[name] = seconds.get(name, 0.0) + event_seconds(event)
        return seconds | {"host": perf_counter() - self.began - sum(seconds.values())}
