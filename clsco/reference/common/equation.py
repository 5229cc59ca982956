"""Intersections of lines from a source to the lens with an occluding surface, and lens cells, in NumPy float64."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.constants import LENS_CELLS
from clsco.optics.lens import Lens
from clsco.optics.quadrics import PlacedSurface
from clsco.reference.common.geometry import Array, turned
from clsco.reference.common.occluder import TINY, Mask

SOFT_BOX = (5.0 / 12.0) ** 0.5  # half width of the cubic step with the variance of a box of width 1
WIDE_LENS = 3.2  # px, blur radius from which on visibility is tested once per tap, not on a grid of lens cells
TAP_LENS = 1.2  # px, as WIDE_LENS, for point sources in the blur
NEAR_LENS = 1.7  # px, blur radius below which sources that are whole pixels count as near the focus
FAR_PLACE, FOCUSED, FAR_RADII = 4.0, 0.1, 3.0  # see `sees_by_cells`
PIXEL_CELLS = (2.0 / 3.0) ** 0.5  # cells per lens radius for pixels in focus: radius of a disc with a tent's variance


@dataclass(frozen=True, eq=False)
class Points:
    """Surface points of visibility tests.

    rays: (N, 3). w (N,): inverse depth, 1/mm. radius (N,): signed blur radius, px. x, y (N,): position of the source in
    its pixel, px. width: width of the sources in px, 1 for whole pixels. gradient (N, 2): gradient of the blur radius,
    px per px, right and down, 0 if surface tilt is ignored. limb (N,): True at a limb. place (2, N): row and column of
    the pixel in the frame, px. shared (N,): True for a pixel center that is tested for all sub-pixel sources of its
    pixel.
    """

    rays: Array
    w: Array
    radius: Array
    x: Array
    y: Array
    width: Array | float
    gradient: Array
    limb: Mask | bool = False
    place: NDArray[Any] | None = None
    shared: Mask | bool = False


@dataclass(frozen=True, eq=False)
class Division:
    """Division of the lens into cells, for N sources.

    cells (N,): number of cells per lens radius, with the sign of the blur radius. wide (N,): True if a cell is a pixel
    of the blur. blur (N,): |R| times `extent`, px. extent: largest distance from the lens center at which light passes,
    in lens radii. width: width of the sources, px. gradient (N, 2): gradient of their blur radius. part (N,): px per
    cell for `wide` sources, less than 1 in focus. bent: True if wavefront errors bend the rays.
    """

    cells: Array
    blur: Array
    extent: float
    width: Array | float
    wide: Mask
    gradient: Array
    part: Array | float = 1.0
    bent: bool = False

    @property
    def most(self) -> Array:
        """Distance (N,) from the middle of the lens to the farthest tap, in cells."""
        return np.asarray(self.extent * np.abs(self.cells) + 1.5)


def division_of(radius: Array, extent: float, width: Array | float, gradient: Array) -> Division:
    """Division of the lens for sources with blur radii (N,) px."""
    blur = np.abs(radius) * extent
    wide = blur >= WIDE_LENS
    cells = np.where(wide, radius, np.where(radius < 0, -LENS_CELLS, LENS_CELLS) / extent)
    return Division(cells, blur, extent, width, wide, gradient)


def tap_division(division: Division, radius: Array, by_cells: Mask) -> Division:
    """Division of the lens for the blur, where more sources than in `division` are tested once per tap.

    Sources tested once per tap are points with a blur of at least TAP_LENS px, and all whole pixels, because a tap's
    view of the lens depends on where in the source pixel its light comes from. by_cells (N,): True for sources that
    keep their lens cells.
    """
    wide = ((np.asarray(division.width) >= 1.0) | (division.blur >= TAP_LENS)) & ~by_cells
    cells = np.where(radius < 0.0, np.minimum(radius, -PIXEL_CELLS), np.maximum(radius, PIXEL_CELLS))
    part = np.where(wide, radius / cells, 1.0)
    return replace(division, wide=wide, cells=np.where(wide, cells, division.cells), part=part)


def sees_by_cells(division: Division, place: Array) -> Mask:
    """True (N,) for pixels with narrow blur that use lens cells, because all of their occluders are far.

    place (N,): smallest `crossing_place` of the pixel's occluders. kernels/common/visibility_test.clh gives the reason.
    """
    least = np.maximum(FAR_PLACE * np.minimum(division.blur / FOCUSED, 1.0), FAR_RADII * division.blur)
    is_pixel = (np.asarray(division.width) == 1.0) & (division.blur < WIDE_LENS)
    return np.asarray(is_pixel & (place >= least))


def source_ways(division: Division, place: Array) -> tuple[Array, Array, Array]:
    """The fields `follows`, `narrows` and `trails` (N,) of an `Occluder`, whose `crossing_place` is `place` (N,).

    If a source moves by 1 px, an edge moves by 2 g cells, g = cells / (2 place). follows: g for whole pixels, 0 for
    points. narrows, trails: fractions of the edge's variance that are due to the part of the lens and to the part of
    the source that a tap sees. For pixels they are (1 - g part)^2 and g^2, divided by (1 - g)^2 + g^2; for points, 1
    and the square of width (2 g - 1), divided by the sum of the two. With bent rays, the numerators for pixels are 1
    and 2 g^2, and the covariance of lens and source has the numerator -2 g.
    """
    g = np.minimum(0.5 * np.abs(division.cells) / place, 100.0) * np.where(division.cells < 0.0, -1.0, 1.0)
    width = np.asarray(division.width)
    point = np.where(width < 1.0, 1.0 / (1.0 + (width * (2.0 * g - 1.0)) ** 2), 0.0)
    lens_part, total = np.where(division.bent, 1.0, (1 - g * division.part) ** 2), (1 - g) ** 2 + g * g
    narrows = np.where(width == 1.0, lens_part / total, point)
    return np.where(width == 1.0, g, 0.0), narrows, np.where(width == 1.0, g * g / total, 1.0 - narrows)


@dataclass(frozen=True, eq=False)
class Equation:
    """Coefficients of C v^2 + 2 B v + F = 0 for one surface, N points and the middle of the lens, with C > 0.

    B, F: (N,). point (N, 3): points times w, in the canonical frame. right (N,): mm per cell. along_x, along_y (N, 3):
    displacement of the lens point per cell, right and down. linear (N,): l . point. sign: factor applied to the
    surface's own equation. once (N,): True if there is at most one intersection. grow_x, grow_y (N,): change of the
    lens point's last homogeneous coordinate per cell; 0 unless K changes over the image. If K changes, the blur of an
    occluder depends on K at the occluder's own position, as if lines ended at l / (1 + l . grad R).
    """

    B: Array
    F: Array
    C: float
    point: Array
    along_x: Array
    along_y: Array
    right: Array
    linear: Array
    sign: float
    once: Mask
    grow_x: Array
    grow_y: Array


def equation_of(lens: Lens, surface: PlacedSurface, rays: Array, w: Array, cells: Array, on_surface: bool) -> Equation:
    """The equation of a surface and points on rays (N, 3); on_surface: True if the points are on it, so that F = 0."""
    q, l, k, o = surface.canonical.q, surface.canonical.l, surface.canonical.k, surface.offset  # noqa: E741
    p = o * w[:, None] + turned(surface.turn, rays)
    right = lens.radius / cells
    rise = lens.focus_rise((rays[:, :2] ** 2).sum(axis=-1)) if lens.is_curved else np.zeros_like(w)
    grow_x, grow_y = right * rise * rays[:, 0], -right * rise * rays[:, 1]
    shifts = (right, grow_x), (-right, grow_y)
    along_x, along_y = (
        shift[:, None] * surface.turn[:, i] + grow[:, None] * o for i, (shift, grow) in enumerate(shifts)
    )
    sign, linear = -1.0 if surface.constant < 0 else 1.0, p @ l
    f = np.zeros_like(w) if on_surface else sign * (p * p @ q + w * (2 * linear - k * w))
    b = sign * (p * o @ q + linear + w * (l @ o - k))
    return Equation(b, f, sign * surface.constant, p, along_x, along_y, right, linear, sign, f <= 0, grow_x, grow_y)


def slopes_of(surface: PlacedSurface, e: Equation, w: Array, d: Array) -> tuple[Array, Array, Array]:
    """Coefficients of B (N, 3), C (N, 6) and D = B^2 - C F (N, 6) for 1, x, y, x^2, x y, y^2 of the tap.

    D is 0 at the outline. d (N,): D at the middle of the lens.
    """
    q, l, k, o, side = surface.canonical.q, surface.canonical.l, surface.canonical.k, surface.offset, e.sign  # noqa: E741
    ways = (ex, gx), (ey, gy) = (e.along_x, e.grow_x), (e.along_y, e.grow_y)
    bx, by = (side * (e.point * u @ q + w * (u @ l) + g * (e.linear - k * w)) for u, g in ways)
    cx, cy = (side * 2 * (o * u @ q + u @ l + g * (l @ o - k)) for u, g in ways)
    cxx, cyy = (side * (u * u @ q + g * (2 * (u @ l) - k * g)) for u, g in ways)
    cxy = side * 2 * (ex * ey @ q + gx * (ey @ l - k * gy) + gy * (ex @ l))
    b, c = np.stack([e.B, bx, by], axis=-1), np.stack([np.full_like(w, e.C), cx, cy, cxx, cxy, cyy], axis=-1)
    return b, c, discriminant(b, c, e.F, d)


def discriminant(b: Array, c: Array, f: Array | float, middle: Array) -> Array:
    """Coefficients (N, 6) of D = B^2 - C F. b, c: those of B and C; f, middle (N,): F, D at the middle of the lens."""
    (b0, bx, by), (_, cx, cy, cxx, cxy, cyy) = b.T, c.T
    slopes = middle, 2 * b0 * bx - cx * f, 2 * b0 * by - cy * f
    return np.stack([*slopes, bx * bx - cxx * f, 2 * bx * by - cxy * f, by * by - cyy * f], axis=-1)


def crossing_place(lens: Lens, e: Equation, d: Array) -> Array:
    """Image displacement (N,), px per lens radius, of the point where the line meets the surface or passes closest."""
    root = np.sqrt(np.maximum(d, 0.0))
    # The outline is at v = sqrt(F / C); half of this as the lower bound keeps the edge from growing without limit if
    # the line passes the surface next to the point.
    passed = np.maximum(np.abs(e.B), 0.5 * np.sqrt(np.maximum(e.C * e.F, 0.0))) / e.C
    v = np.where(e.once, np.where(e.B < 0, (root - e.B) / e.C, -e.F / (e.B + root)), passed)
    return np.maximum(np.abs(lens.blur_scale * v), TINY)


def edge_width(division: Division, place: Array) -> Array:
    """Half width (N,) of an occluder's soft edge in cells; it depends on the cell size and on the source's width."""
    away = division.cells / place
    return np.asarray(SOFT_BOX * np.hypot(1.0, division.width * np.where(division.wide, away - 1, away)))
