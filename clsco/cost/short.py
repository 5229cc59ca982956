"""A look at a plan that knows short frames without a prediction, which takes longer than to read a small scene."""

from __future__ import annotations

from clsco.plan.plan import Plan

LONG_FRAME = 60.0  # s of a frame, from which on people are warned
PIXEL = 2e-5  # s for a pixel, an object and a time sample: ten times that of the dearest scene of `benchmarks`
TAP = 1e-8  # s for a weight, four times the dearest of `clsco.cost.rates`


def most_seconds(plan: Plan) -> float:
    """Seconds of a frame that its plan does not exceed, by its pixels, objects and weights alone.

    Parameters
    ----------
    plan : Plan

    Returns
    -------
    float
        s
    """
    pixels = plan.width * plan.height * plan.repeats
    return pixels * len(plan.scene.objects) * PIXEL + plan.taps * TAP
