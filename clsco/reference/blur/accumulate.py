"""Average of the sub-frames of one exposure, in linear radiance."""

from __future__ import annotations

from clsco.reference.common.geometry import Array


def accumulate(total: Array, frame: Array, weight: float) -> Array:
    """Running sum of an exposure: `total` plus `weight` x `frame`.

    Arrays (m, n, C), linear; the weights of one exposure sum to 1.
    """
    return total + weight * frame
