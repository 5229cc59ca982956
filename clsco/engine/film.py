"""The state of a frame while its strips and time samples are rendered."""

from __future__ import annotations

from collections.abc import Mapping
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from clsco.frame.strips import Strip
from clsco.opencl.pace import event_seconds
from clsco.opencl.program import Events
from clsco.opencl.session import Session
from clsco.optics.exposure import frame_exposure
from clsco.passes.blur import Plane
from clsco.plan.plan import Plan

if TYPE_CHECKING:
    import pyopencl as cl

    from clsco.optics.visibility import OcclusionGroup
    from clsco.passes.sensor import Codes

NOTHING_MISSING = {"missing_pixels": 0, "filled_pixels": 0, "unfilled_pixels": 0, "sweeps": 0}


class Film:
    """The arrays of frame number `index`, and records of how they were computed."""

    def __init__(self, plan: Plan, index: int) -> None:
        exposure = frame_exposure(plan.scene, index, plan.samples)
        shape = (plan.rows, plan.columns)
        image = shape if plan.channels == 1 else (*shape, plan.channels)
        lines = plan.columns if exposure.by_columns else plan.rows
        self.index, self.times = index, exposure.times.tolist()  # s
        # Weight (samples, lines) of each time sample's blurred plane in each row of the frame, or in each column if
        # columns are exposed in turn; the frame is the weighted sum of the planes.
        self.weights = exposure.line_weights(lines)
        self.samples = len(self.times)  # time samples
        if plan.splits_still:  # after all time samples, the still sources follow as one more
            self.times.append(self.times[0])
            self.weights = np.concatenate([self.weights, self.weights.sum(axis=0, keepdims=True)])
        self.shares = exposure.weights.reshape(self.samples, -1).mean(axis=1).tolist()
        # For each strip, the part of the strip that each time sample renders, by the number of the time sample; time
        # samples that do not affect the strip are absent.
        self.strip_parts: dict[Strip, dict[int, Strip]] = {}
        for strip in plan.strips:
            parts = ((number, plan.part(strip, weights)) for number, weights in enumerate(self.weights))
            self.strip_parts[strip] = {number: part for number, part in parts if part is not None}
        self.color = np.empty(image, np.float32)  # (rows, columns[, channels])
        planes = 0 if plan.sensor_model is None else len(plan.sensor_model.filters)
        self.code = np.empty((*shape, planes), np.uint16)
        self.saturated = np.empty((*shape, planes), np.bool_)
        self.subframes = np.empty((self.samples if "subframes" in plan.truth else 0, *image), np.float32)
        self.missing = np.zeros(shape, np.bool_)  # True if missing at any time sample, whether filled or not
        # Bounds of the depth layers by number of the time sample, if they were computed from all strips.
        self.bounds: dict[int, tuple[tuple[int, ...], ...] | None] = {}
        self.events: Events = []
        self.changes: dict[OcclusionGroup, tuple[cl.Buffer, bool]] = {}  # maps of changes, and if any source may change
        self.reports: dict[int, dict[str, Any]] = {}  # by number of the time sample
        self.began = perf_counter()
        self._planes: list[tuple[Plane, NDArray[np.float32]]] = []
        self._codes: list[tuple[Codes, slice]] = []
        self._needs_light = plan.needs_light

    def add(self, session: Session, strip: Strip, number: int, outputs: Mapping[str, Any]) -> None:
        """Add the outputs of a time sample's passes for a strip. number: number of the time sample; outputs: named as
        in `Pass`.
        """
        if number < self.samples:
            report = {"time": self.times[number], "weight": self.shares[number]} | NOTHING_MISSING
            self.reports[number] = report | outputs.get("counts", {})
        if "depth_layers" in outputs:
            self.reports[number]["depth_layers"] = outputs["depth_layers"]
        if "missing" in outputs:
            self.missing |= outputs["missing"]
        if "plane" not in outputs:
            return
        if len(self.subframes):
            outputs["plane"].read(session, self.subframes[number][strip.inside])
        if outputs.get("codes") is not None:
            self._codes.append((outputs["codes"], strip.inside))
        if number == max(self.strip_parts[strip]) and self._needs_light:
            self._planes.append((outputs.get("frame", outputs["plane"]), self.color[strip.inside]))

    def read(self, session: Session) -> None:
        """Read back the strips to which all time samples have been added; waits for the device."""
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
