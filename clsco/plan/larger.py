"""Makes a larger plan if a frame exceeded the predictions of its plan."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf
from typing import Self

import numpy as np
from numpy.typing import NDArray

from clsco.constants import STATISTIC_BEYOND, STATISTIC_LARGEST, STATISTIC_SMALLEST
from clsco.errors import SceneError
from clsco.optics.lens import LARGEST_BLUR
from clsco.optics.lens_path import widest_camera
from clsco.optics.resolved_view import guard_band
from clsco.optics.visibility import separate_groups
from clsco.plan.memory import Limit, fit_strips
from clsco.plan.methods import TESTED_SCATTER, Choice
from clsco.plan.plan import Plan

SLACK = 1.0 + 1e-6  # the host's float64 and the device's float round differently


@dataclass(frozen=True)
class SourceStatistics:
    """Statistics of a frame's sources, measured on the device."""

    smallest: float  # smallest |R|, px
    largest: float  # largest |R|, px; 0 without sources
    beyond: bool  # True if a ray hit an object outside of its extent, so that its group may lack occluders

    @classmethod
    def parse(cls, values: NDArray[np.int32]) -> Self:
        """Unpack the statistics of a frame from the ints that kernels write."""
        radii = values.view(np.float32)
        smallest, largest = float(radii[STATISTIC_SMALLEST]), float(radii[STATISTIC_LARGEST])
        return cls(smallest, largest, bool(values[STATISTIC_BEYOND]))


def larger_plan(plan: Plan, statistics: SourceStatistics, limit: Limit) -> Plan | None:
    """A plan with room for the measured statistics within the limit; None if the given plan is large enough.

    Raises SceneError if the blur radius exceeds LARGEST_BLUR, or the memory limit is too small.
    """
    smallest, largest = statistics.smallest, statistics.largest
    fits = largest <= plan.largest_blur * SLACK + 1e-6 and smallest >= plan.smallest_blur / SLACK - 1e-6
    if largest == 0.0 or (fits and not statistics.beyond):
        return None
    wider = _for_any_place(plan) if statistics.beyond else plan
    if fits:
        return fit_strips(wider, limit)
    smallest, largest = min(smallest / SLACK, plan.smallest_blur), max(largest * SLACK, plan.largest_blur)
    return fit_strips(widen_plan(wider, smallest, largest), limit)


def _for_any_place(plan: Plan) -> Plan:
    """The plan with occlusion groups that are valid wherever objects are, and a blur that supports visibility tests."""
    scene, choices = plan.scene, replace(plan.choices, occlusion=Choice("visibility"))
    if plan.blur == "tiles":
        choices = replace(choices, blur=TESTED_SCATTER)
    groups = separate_groups(scene.objects, widest_camera(scene), plan.psf)
    return replace(plan, groups=groups, extents=(), choices=choices)


def widen_plan(plan: Plan, smallest: float, largest: float) -> Plan:
    """The plan for |R| from `smallest` to `largest` px, a wider range. Raises SceneError beyond LARGEST_BLUR."""
    if largest > LARGEST_BLUR:
        raise SceneError(f"camera: the blur radius must be at most {LARGEST_BLUR:g} px; got {largest:.4g} px")
    guard = max(plan.guard_px, guard_band(plan.psf, plan.scene.psf.border, largest))
    psf, spreads = plan.psf.between(-inf, inf), tuple(spread.between(-inf, inf) for spread in plan.spreads)
    plan = replace(plan, psf=psf, spreads=spreads, guard_px=guard, spare_px=0)
    return replace(plan, smallest_blur=smallest, largest_blur=largest)
