"""Images on surfaces for rays: the position of an object's point in its image, and the value there.

The formulas follow the text of docs/scene_files.md, independently of `clsco.optics`. An image is a continuous function,
its texels interpolated by the cubic of Keys (1981, a = -1/2) along each axis, or by the scene's texture filter.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
PROJECTED, FLAT, ROUND, GLOBE, ROLLED, THREE, CUBE = range(7)
WRAPS = ("repeat", "mirror", "clamp", "none")
MIRROR = 1  # number in WRAPS
FILTERS = ("nearest", "bilinear", "bicubic")
# Numbers of a mapping: kind, first texel, rows, columns, wrap, width and height of a copy, cosine and sine of its turn,
# shift right and up in copies, a radius or the sine of a half angle; then right, up and front vector, and the filter.
NUMBERS = 12
SIZE = NUMBERS + 10


def lies(item: Any) -> bool:
    """True if the texture of an object is mapped onto its surface, not projected."""
    return getattr(item, "texture_mapping", "projected") != "projected"


def mapping_of(item: Any, shape: tuple[int, int], first: int, texture_filter: str = "bicubic") -> Array:
    """Mapping numbers (SIZE,) of an object whose image has this shape and begins at texel `first`."""
    rows, columns = shape
    numbers = np.zeros(SIZE)
    right, up, towards = np.eye(3)[0], np.eye(3)[1], -np.eye(3)[2]
    extra, extent = 0.0, None
    kind = FLAT
    if item.texture_mapping == "triplanar" or item.shape == "quadric":
        kind = THREE
    elif item.shape == "plane":
        normal = np.array([item.slope_x, item.slope_y, -1.0])
        right = np.array([1.0, 0.0, item.slope_x]) / math.hypot(1.0, item.slope_x)
        up = np.cross(right, normal / np.linalg.norm(normal)) * -1.0
        up *= math.copysign(1.0, up[1])
    elif item.shape == "rectangle":
        extent = item.size
    elif item.shape == "disc":
        extent = (2.0 * item.radius, 2.0 * item.radius)
    elif item.shape == "cylinder":
        kind, extra = ROUND, item.radius
        up = np.asarray(item.axis, float) / np.linalg.norm(item.axis)
        towards = towards - (towards @ up) * up
        if np.linalg.norm(towards) < 1e-6:
            towards = np.array([0.0, 1.0, 0.0]) - up[1] * up
        towards /= np.linalg.norm(towards)
        right = np.cross(towards, up)
        extent = (2.0 * math.pi * item.radius, None)
    elif item.shape in ("sphere", "ellipsoid"):
        kind = CUBE if item.texture_mapping == "cube" else GLOBE
        a, b, c = (1.0, 1.0, 1.0) if item.shape == "sphere" else item.semi_axes
        right, up, towards = right / a, up / b, towards / c
        extent = (2.0, 2.0) if kind == CUBE else (2.0 * math.pi, math.pi)
    elif item.shape == "cone":
        kind, extra = ROLLED, math.sin(math.radians(item.half_angle))
    proportion = rows / columns
    if item.texture_size is not None:
        width, height = (*item.texture_size, item.texture_size[0] * proportion)[:2]
    else:
        assert extent is not None
        copies = item.texture_repeats or (1.0,) * (1 + (extent[1] is not None))
        width = extent[0] / copies[0]
        height = extent[1] / copies[1] if len(copies) > 1 else width * proportion
    wrap = item.texture_wrap
    if wrap is None:
        alone = item.shape in ("rectangle", "disc") and item.texture_size is None and item.texture_repeats is None
        wrap = "clamp" if alone else "repeat"
    turn, (shift_x, shift_y) = math.radians(item.texture_angle or 0.0), item.texture_offset or (0.0, 0.0)
    numbers[:NUMBERS] = (
        kind, first, rows, columns, WRAPS.index(wrap), width, height, math.cos(turn), math.sin(turn), shift_x, shift_y,
        extra,
    )  # fmt: skip
    numbers[NUMBERS:] = *right, *up, *towards, FILTERS.index(texture_filter)
    return numbers


@njit(cache=True, inline="always")
def texel(index, count, wrap):  # type: ignore[no-untyped-def]
    """Number of the texel at an index along an axis of `count` texels, -1 for none; wrap: number in WRAPS."""
    if 0 <= index < count:
        return index
    if wrap == 0:
        return index % count
    if wrap == MIRROR:
        index %= 2 * count
        return index if index < count else 2 * count - 1 - index
    if wrap == 2:
        return 0 if index < 0 else count - 1
    return -1


@njit(cache=True, inline="always")
def _weight(t, kind):  # type: ignore[no-untyped-def]
    """Weight of a texel at a distance of t texels; kind: number of the filter in FILTERS."""
    if kind == 0:
        return 1.0 if -0.5 < t <= 0.5 else 0.0
    t = abs(t)
    if kind == 1:
        return max(1.0 - t, 0.0)
    if t < 1.0:
        return (1.5 * t - 2.5) * t * t + 1.0
    return ((2.5 - 0.5 * t) * t - 4.0) * t + 2.0 if t < 2.0 else 0.0


@njit(cache=True)
def _add_image(total, share, s, t, m, images, side=0):  # type: ignore[no-untyped-def]
    """Add `share` times the image's values at a point, s right of and t above the image's middle, to `total`.

    m: numbers of the mapping; side: number of a cube map's image.
    """
    first, rows, columns, wrap = int(m[1]), int(m[2]), int(m[3]), int(m[4])
    turned_s, turned_t = m[7] * s + m[8] * t, m[7] * t - m[8] * s
    column = columns * (0.5 + turned_s / m[5] - m[9]) - 0.5
    row = rows * (0.5 - turned_t / m[6] + m[10]) - 0.5
    left, top, kind = math.floor(column) - 1, math.floor(row) - 1, int(m[21])
    first += side * rows * columns
    wrap_rows = wrap
    if int(m[0]) == GLOBE and abs(m[6] - math.pi) < 1e-12 and m[10] == 0.0:
        wrap_rows = MIRROR
    for i in range(top, top + 4):
        line = texel(i, rows, wrap_rows)
        across = _weight(row - i, kind)
        for j in range(left, left + 4):
            at = texel(j, columns, wrap)
            if line < 0 or at < 0:
                continue
            weight = share * across * _weight(column - j, kind)
            for channel in range(images.shape[1]):
                total[channel] += weight * images[first + line * columns + at, channel]


@njit(cache=True)
def shade(total, x, y, z, normal, m, images):  # type: ignore[no-untyped-def]
    """Write the radiance at a point of an object's frame, with its unit normal there, to `total` (channels,)."""
    for channel in range(total.size):
        total[channel] = 0.0
    kind = int(m[0])
    right = m[12] * x + m[13] * y + m[14] * z
    up = m[15] * x + m[16] * y + m[17] * z
    towards = m[18] * x + m[19] * y + m[20] * z
    if kind == FLAT:
        _add_image(total, 1.0, right, up, m, images)
    elif kind == ROUND:
        _add_image(total, 1.0, m[11] * math.atan2(right, towards), up, m, images)
    elif kind == GLOBE:
        latitude = math.asin(min(max(up / math.sqrt(right * right + up * up + towards * towards), -1.0), 1.0))
        _add_image(total, 1.0, math.atan2(right, towards), latitude, m, images)
    elif kind == ROLLED:  # the axis is z, and the middle of the image is towards y
        length, angle = math.sqrt(x * x + y * y + z * z), m[11] * math.atan2(x, y)
        _add_image(total, 1.0, length * math.sin(angle), length * math.cos(angle), m, images)
    elif kind == CUBE:
        largest = max(abs(right), abs(up), abs(towards))
        right, up, towards = right / largest, up / largest, towards / largest
        if abs(towards) >= 1.0:
            _add_image(total, 1.0, right * towards, up, m, images, 5 if towards > 0.0 else 4)
        elif abs(right) >= 1.0:
            _add_image(total, 1.0, -towards * right, up, m, images, 0 if right > 0.0 else 1)
        else:
            _add_image(total, 1.0, right, -towards * up, m, images, 2 if up > 0.0 else 3)
    else:
        shares = np.empty(3)
        for axis in range(3):
            shares[axis] = max(normal[axis] * normal[axis] - 0.1, 0.0) ** 2
        sum_of = shares[0] + shares[1] + shares[2]
        _add_image(total, shares[0] / sum_of, z, y, m, images)
        _add_image(total, shares[1] / sum_of, x, z, m, images)
        _add_image(total, shares[2] / sum_of, x, y, m, images)
