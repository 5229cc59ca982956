"""Surfaces as ten coefficients in their own frames, cut by bounds: textbook formulas of each shape."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
TOUCHING = 1e-7  # tolerance of bounds, as a share of the largest bound
FARTHEST = 1e12  # mm, distance of a background


def surface_of(item: Any) -> tuple[Array, Any, tuple[float, float]]:
    """Coefficients (10,), center (3) in mm, and z range (2) of an object's surface.

    The coefficients are a200 a020 a002 a110 a011 a101 a100 a010 a001 a000, relative to the center, x right, y up, z
    away from the camera. Raises ValueError for an unknown shape.
    """
    k = np.zeros(10)
    everywhere = (-np.inf, np.inf)
    match item.shape:
        case "plane":  # b x + c y - z = 0 about (0, 0, a)
            k[6:9] = item.slope_x, item.slope_y, -1.0
            return k, (0.0, 0.0, item.distance), everywhere
        case "rectangle" | "disc":  # z = offset about its center
            k[8:] = 1.0, -item.offset
            return k, item.center, everywhere
        case "sphere":
            k[[0, 1, 2, 9]] = 1.0, 1.0, 1.0, -(item.radius**2)
            return k, item.center, everywhere
        case "ellipsoid":
            k[:3], k[9] = 1.0 / np.asarray(item.semi_axes, float) ** 2, -1.0
            return k, item.center, everywhere
        case "cylinder":  # |q|^2 - (q . axis)^2 = radius^2
            x, y, z = np.asarray(item.axis, float) / np.linalg.norm(item.axis)
            k[:6] = 1 - x * x, 1 - y * y, 1 - z * z, -2 * x * y, -2 * y * z, -2 * x * z
            k[9] = -(item.radius**2)
            return k, item.center, everywhere
        case "cone":
            k[:3] = 1.0, 1.0, -(math.tan(math.radians(item.half_angle)) ** 2)
            return k, item.apex, (0.0, np.inf) if item.nappe == "away" else (-np.inf, 0.0)
        case "quadric":
            return np.asarray(item.coefficients, float), item.center, everywhere
        case "background":  # no surface: rays that meet no surface show it
            return k, (0.0, 0.0, FARTHEST), everywhere
    raise ValueError(f"rays: shape must be analytic; got {item.shape!r}")


def bounds_of(item: Any, span: tuple[float, float]) -> Array:
    """Bounds (7,) of an object: x0 x1 y0 y1 z0 z1 in its frame, and largest x^2 + y^2; span: z range of the shape."""
    box = np.array([-np.inf, np.inf] * 3 + [np.inf])
    if item.bounds is not None:
        box[:6] = np.ravel(item.bounds)
        slack = TOUCHING * np.abs(box[:6][np.isfinite(box[:6])]).max(initial=0.0)
        box[:6] += np.array([-slack, slack] * 3)
    box[4:6] = max(box[4], span[0]), min(box[5], span[1])
    if item.shape == "disc":
        box[6] = item.radius**2
    return box
