"""Visibility of the lens from surface points: the factor V(x, l) of the physics, in NumPy float64.

The line from a point at inverse depth w to lens point l meets a quadric Q at inverse depths w + v, v > 0, with C v^2 +
2 B v + F = 0, C = Q(lens point), F = w^2 Q(point). F does not depend on l. If F and C differ in sign, there is one
intersection for every l. Otherwise there are two if h = -B - sqrt(C F) > 0, with signs chosen such that C > 0, and none
if not. Taps represent cells of the lens; over a cell, the edge of the hidden part is softened to a cubic step, whose
variance is that of the boxes that overlap in the cell, so that V is continuous.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import ceil
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.constants import LEAST_OPENING
from clsco.optics.lens import Lens
from clsco.optics.point_spread import PointSpread
from clsco.optics.quadrics import PlacedSurface
from clsco.optics.ray_means import RayMeans, has_ray_means, ray_means
from clsco.optics.rims import rim_circle
from clsco.optics.visibility import OcclusionGroup
from clsco.reference.common.equation import (
    NEAR_LENS,
    Division,
    Equation,
    Points,
    crossing_place,
    discriminant,
    division_of,
    edge_width,
    equation_of,
    sees_by_cells,
    slopes_of,
    source_ways,
    tap_division,
)
from clsco.reference.common.geometry import (
    Array,
    Bounds,
    along_rays,
    difference_of_products,
    quarter_discriminant,
    turned,
)
from clsco.reference.common.occluder import TINY, Mask, Occluder, hides_all, strip_share

CLEAR, PARTLY, HIDDEN = (np.uint8(state) for state in range(3))
RIM_MARGIN = 1.5  # least distance, in cells, from the rim of the lens to a circle that cuts no tap
SHARP_EDGE = 2.0  # px, width up to which a blurred outline needs sub-pixel sources


def _limits(surface: PlacedSurface, bounds: Bounds | None, w: Array, rays: Array, equation: Equation) -> list[Array]:
    """Conditions (N, 4), as in `Occluder`, on an intersection: on the surface's nappe, and within the bounds."""
    e, limits, nappe = equation, [], float(surface.canonical.nappe)
    if nappe:
        ahead = np.full(w.shape, surface.offset[2])
        limits.append(np.stack([e.point[:, 2], ahead, e.along_x[:, 2], e.along_y[:, 2]], axis=-1) * nappe)
    own_points = surface.own_offset * w[:, None] + turned(surface.own_turn, rays)
    for axis, (low, high) in enumerate(bounds or ()):
        at, (x, y, _) = surface.own_offset[axis], surface.own_turn[axis]
        for limit, sign in ((low, 1.0), (high, -1.0)):
            if np.isfinite(limit):
                slopes = e.right * x + (at - limit) * e.grow_x, -e.right * y + (at - limit) * e.grow_y
                head = own_points[:, axis] - limit * w, np.full(w.shape, at - limit)
                limits.append(np.stack([*head, *slopes], axis=-1) * sign)
    return limits


def outline_slope(d: Array, root: Array, reach: Array, most: Array) -> Array:
    """Steepest slope (N,) of h per cell at the outline, if D has its lower curvature on the way to the outline.

    d (N, 6): from `slopes_of`; root, reach (N,): the root at the outline, and the range of h; most: as in `outline_of`.
    Without an outline, the slope is a thousandth of the range of h per cell, as on devices, where quotients would
    otherwise overflow.
    """
    height, x, y, xx, xy, yy = d.T
    curve = 0.5 * (xx + yy - np.hypot(xx - yy, xy))
    slope = np.sqrt(np.maximum(x * x + y * y - 4 * height * curve, 0.0))
    return np.maximum(slope / (2 * np.maximum(root, TINY)), np.maximum(1e-3 * reach / most, TINY))


def _outline(
    b: Array, c: Array, h: Array, reach: Array, root: Array, f: Array | float, scale: Array, strip: Array | float = 0.0
) -> tuple[Occluder, Mask, Mask]:  # fmt: skip
    """The `Occluder`, and masks (N,) of points from which the whole lens is free, or hidden.

    h (N,): at the middle of the lens, and within `reach` (N,) of this all over the lens; f (N,): factor of C in the
    square of the root; scale (N,): 1 / width of the edge; other arguments as in `outline_of` and `Occluder`.
    """
    height = np.stack([h * scale, -b[:, 1] * scale, -b[:, 2] * scale], axis=-1)
    occluder = Occluder(height, root * scale, c[:, 1:] * (scale * scale * f)[:, None], strip=strip)
    return occluder, (h + reach) * scale <= -0.5, (h - reach) * scale >= 0.5


def outline_of(
    e: Equation, b: Array, c: Array, d: Array, soft: Array, most: Array
) -> tuple[Occluder, Mask, Mask]:  # fmt: skip
    """Outline of a surface that lines meet twice or not at all: as an `Occluder`, and masks as from `_outline`.

    b, c, d: from `slopes_of`; soft (N,): half width of the edge in cells (h is divided by the whole width); most (N,):
    distance to the farthest tap in cells.
    """
    under, (_, c_x, c_y, c_xx, c_xy, c_yy) = np.sqrt(e.C * e.F), c.T
    change = e.F * (np.hypot(c_x, c_y) + (np.abs(c_xx) + np.abs(c_xy) + np.abs(c_yy)) * most) * most
    reach = np.minimum(np.where(under > 0, change / under, np.inf), np.sqrt(change))
    reach = reach + np.hypot(b[:, 1], b[:, 2]) * most
    slope = outline_slope(d, under, reach, most)
    scale = 1 / (2 * soft * slope)
    x, y = c_x / (2 * e.C), c_y / (2 * e.C)  # derivatives of the root, over the root
    bent = under * np.hypot((c_xx - c_yy) / e.C - (x * x - y * y), c_xy / e.C - 2 * x * y)
    thin = np.minimum(bent * soft / slope, 15.0)
    h = np.where(e.B < 0.0, d[:, 0] / (under - e.B), -e.B - under) + strip_share(thin) / scale
    return _outline(b, c, h, reach, under, e.F, scale, thin)


def disc_outline(
    surface: PlacedSurface, e: Equation, points: Points, soft: Array, most: Array
) -> tuple[Occluder, Mask, Mask]:  # fmt: skip
    """Outline of a disc of radius r about the third axis; arguments and results as for `outline_of`.

    The line to the lens intersects the disc's plane at v = -p_z / o_z. The intersection is within the radius if h = r
    |w o_z - p_z| - |p o_z - p_z o|_xy >= 0, where p is the point times w, and o is the lens point. As o is linear in
    the tap, h has the same form as for other surfaces, with the first term for -B and the square of the second for C F.
    """
    radius, o, p = surface.canonical.radius, surface.offset, e.point
    ray = turned(surface.turn, points.rays)  # p = o w + ray
    away = np.stack([difference_of_products(ray[:, i], o[2], ray[:, 2], o[i]) for i in (0, 1)], axis=-1)
    shifts = (e.along_x, e.grow_x), (e.along_y, e.grow_y)
    b_x, b_y = (-e.sign * radius * (points.w * shift[:, 2] - p[:, 2] * grow) for shift, grow in shifts)
    a_x, a_y = (p[:, :2] * shift[:, 2:] - p[:, 2:] * shift[:, :2] for shift, _ in shifts)
    reach, under = -e.sign * radius * ray[:, 2], np.hypot(*away.T)
    b = np.stack([-reach, b_x, b_y], axis=-1)
    pairs = (away, away), (2 * away, a_x), (2 * away, a_y), (a_x, a_x), (2 * a_x, a_y), (a_y, a_y)
    c = np.stack([(first * second).sum(axis=-1) for first, second in pairs], axis=-1)
    d = discriminant(b, c, 1.0, (reach - under) * (reach + under))
    span = (np.hypot(b_x, b_y) + np.sqrt(c[:, 3] + c[:, 5])) * most
    scale = 1 / (2 * soft * outline_slope(d, reach, span, most))
    return _outline(b, c, reach - under, span, under, 1.0, scale)


def out_of_the_way(lens: Lens, surface: PlacedSurface, rays: Array, w: Array, extent: float) -> Mask:
    """Mask of points (N,) that a surface cannot occlude.

    The test: with increasing inverse depth, the line to lens point l moves in the image by lens_radius l per 1/mm.
    """
    shift = lens.radius * extent * (surface.extent.w[1] - w)
    far = shift <= 0
    for axis, (low, high) in enumerate((surface.extent.x, surface.extent.y)):
        far = far | (rays[:, axis] + shift < low) | (rays[:, axis] - shift > high)
    return np.asarray(far)


def meet_occluder(
    lens: Lens, surface: PlacedSurface, bounds: Bounds | None, points: Points, division: Division, on_surface: bool
) -> tuple[NDArray[np.uint8], Mask, Occluder, Array]:
    """Compute how a surface hides the lens from N points.

    on_surface: True if the points are on the surface itself, another part of which may be between them and the lens.
    Returns the state CLEAR, PARTLY or HIDDEN (N,); a mask (N,) of points that are behind the surface, or at an outline
    that is blurred by SHARP_EDGE px or less; the `Occluder` for tests per tap; and `crossing_place` (N,).
    """
    rays, w = points.rays, points.w
    far = out_of_the_way(lens, surface, rays, w, division.extent)
    e = equation_of(lens, surface, rays, w, division.cells, on_surface)
    # All points of a ray have equal D; this form avoids the cancellation in B^2 - C F. On the surface F is 0.
    d = e.B * e.B if on_surface else quarter_discriminant(surface, turned(surface.turn, rays))
    limits = _limits(surface, bounds, w, rays, e)
    with np.errstate(all="ignore"):  # with one intersection, terms for two are not used, and vice versa
        place = crossing_place(lens, e, d)
        soft = edge_width(division, place)
        behind = (e.F < 0) & ~far
        if surface.canonical.radius < np.inf:
            occluder, clear, hidden = disc_outline(surface, e, points, soft, division.most)
            state = np.select([far | ~e.once | clear, hidden], [CLEAR, HIDDEN], PARTLY)
            return state, behind, occluder, place
        if not surface.canonical.q.any():
            l, none = surface.canonical.l, np.zeros((w.size, 5))  # noqa: E741
            change = (float(l @ surface.offset), e.along_x @ l, e.along_y @ l)
            state, limits, needed = flatten_limits(lens, limits, e.linear, change, division)
            occluder = Occluder(none[:, :3], none[:, 0], none, limits=tuple(limits), needed=needed)
            return np.where(e.once & ~far, state, CLEAR), behind, occluder, place
        b, c, d = slopes_of(surface, e, w, d)
        occluder, clear, hidden = outline_of(e, b, c, d, soft, division.most)
    clear, hidden = far | ~e.once & clear, e.once | hidden
    state = np.where(clear, CLEAR, np.where(hidden & (not limits), HIDDEN, PARTLY))
    edge = behind & e.once | ~e.once & ~clear & ~hidden & (place * division.extent <= SHARP_EDGE)
    if limits:
        all_needed = tuple(np.ones(w.shape, dtype=bool) for _ in limits)
        equation = {"crossings": np.where(e.once, 1, 2), "b": b, "f0": e.F, "c": c, "d": d, "soft": 1 / (2 * soft)}
        occluder = replace(occluder, **equation, limits=tuple(limits), needed=all_needed)
        all_hidden, needed = hides_all(occluder, division.most)
        state, occluder = np.where(~clear & all_hidden, HIDDEN, state), replace(occluder, needed=needed)
    return state, edge, occluder, place


def flatten_limits(
    lens: Lens, limits: Sequence[Array], near: Array, far: tuple[float, Array, Array], division: Division
) -> tuple[NDArray[np.uint8], list[Array], tuple[Mask, ...]]:
    """Turn conditions on the single intersection with a plane into edges that are linear in the tap.

    The intersection is at v = -near / (far_0 + far_1 x + far_2 y). limits: (N, 4) each, as in `Occluder`. Returns the
    state of the lens (N,); the conditions of a plane (N, 4), as in `Occluder`; and for each condition a mask (N,),
    False for points that satisfy it over the whole lens.
    """
    clear, conditions, needed = np.zeros(near.shape, dtype=bool), [], []
    side = -1.0 if far[0] < 0 else 1.0
    for limit in limits:
        base, x, y = (side * (limit[:, 0] * far[k] - near * limit[:, 1 + k]) for k in range(3))
        square = np.maximum(x * x + y * y, TINY)
        slope = np.sqrt(square)
        # Cells by which the edge moves if the source moves by 1 px across it: as in `edge_width`, with v at the edge.
        over_v = sum(u * (far[0] * limit[:, 1 + k] - limit[:, 1] * far[k]) for k, u in ((1, x), (2, y)))
        shift = side * division.cells / lens.blur_scale * over_v / square
        moved = np.abs(shift - division.wide)
        # It moves by fewer cells if the source's surface is tilted, and by none if that surface ends at this limit.
        tilted = base / division.cells
        along = np.hypot(x - tilted * division.gradient[:, 0], y - tilted * division.gradient[:, 1])
        width = division.width * moved * np.minimum(along, slope)
        ratio, across = width * width / square, x * x / square
        squares, source = 1 - 2 * across * (1 - across), (division.width * shift) ** 2
        boxes = squares * (1 + ratio * ratio) / (1 + ratio) ** 2
        disc = (4 / 1.2 + squares * source * source) / (2 + source) ** 2
        boxes = np.maximum(division.part * boxes + (1 - division.part) * disc, 0.5)
        clamped = np.minimum(boxes, 0.999999)
        second = np.where(boxes < 0.999999, np.sqrt((clamped - np.sqrt(2 * clamped - 1)) / (1 - clamped)), 0.0)
        part = np.maximum(second / (1 + second), 1e-3)
        soft = 0.5 * np.hypot(slope, width) / np.hypot(part, 1 - part)
        clear |= base + division.most * slope <= -soft
        needed.append(base - division.most * slope < soft)
        conditions.append(np.stack([*(term / (2 * soft) for term in (base, x, y)), part], axis=-1))
    state = np.where(clear, CLEAR, np.where(np.any(needed, axis=0), PARTLY, HIDDEN))
    return state, conditions, tuple(needed)


@dataclass(frozen=True, eq=False)
class Circle:
    """A rim as seen from M sources, in the plane of the lens.

    cuts (M,): True for sources whose light the rim cuts. x, y (M,): center of the rim, right and down of the middle of
    the lens. radius (M,): radius of the rim. These three are in px if weights are computed by chords, else in cells.
    scale (M,): 2 / width of the rim's soft edge.
    """

    cuts: Mask
    x: Array
    y: Array
    radius: Array
    scale: Array

    def select(self, chosen: NDArray[Any]) -> Circle:
        return Circle(*(values[chosen] for values in vars(self).values()))


def meet_rims(
    lens: Lens, psf: PointSpread, points: Points, division: Division
) -> tuple[NDArray[np.uint8], list[Circle]]:  # fmt: skip
    """Compute how rims (`rim_circle`) cut the light from N points.

    Returns the state HIDDEN, CLEAR or PARTLY (N,), and a `Circle` per rim for tests per tap.
    """
    state, circles = np.full(points.w.shape, CLEAR), []
    cells, margin = division.cells, RIM_MARGIN
    if psf.cut_by_chords:
        size = np.maximum(np.abs(points.radius), LEAST_OPENING)
        cells, margin = np.where(points.radius < 0.0, -size, size), 0.0
    reach = division.extent * np.abs(cells)
    scale = np.where(division.wide & (division.width == 1), 1.0, np.sqrt(2.0))
    for rim in psf.rims:
        right, down, unit = rim_circle(lens, rim, points.rays[:, :2], points.w, points.radius)
        x, y, size = right * cells, down * cells, unit * np.abs(cells)
        away = np.hypot(x, y)
        cuts = size - away < reach + margin
        state = np.maximum(state, np.where(away >= reach + size, HIDDEN, np.where(cuts, PARTLY, CLEAR)))
        circles.append(Circle(cuts, x, y, size, scale))
    return state.astype(np.uint8), circles


@dataclass(frozen=True, eq=False)
class Visibility:
    """Occluders of the lens for each source; create it with `check_visibility`.

    row: (sources,) number of each source in the arrays (M,) of partly visible sources, -1 if it is fully visible or
    fully hidden. Arrays (M,): radius: signed blur radius, px; wide: True to test each tap; point: True if smaller than
    a pixel; x, y: position of the source in its pixel, px; limb: True at a limb; nearest: smallest `crossing_place` of
    partial occluders; behind: True if fully hidden in the test with the blur's cells; near: True for a pixel's source
    near the focus; part: px per cell; ray_numbers, ray_parts, ray_scale: from `RayMeans.around`, if there are `rays`.

    lean (M, 2): change of the tilt per cell of a narrow lens if a part of the lens is behind the source's own surface,
    else 0; bent (M, 3): xx, xy, yy of the map from taps to an ellipse's disc, or from a narrow lens's cells to the
    ellipse, None for discs.

    Common to all sources: occluders: per surface, a mask (M,) of sources that it hides in part, and its `Occluder` for
    these; cells: `lens_cells` (L, L) of `psf`; circles: rims that cut light; rays: mean lens points of wide lenses.
    """

    row: NDArray[np.int64]
    radius: Array
    wide: Mask
    point: Mask
    x: Array
    y: Array
    occluders: tuple[tuple[Mask, Occluder], ...]
    psf: PointSpread
    cells: Array
    lean: Array
    limb: Mask
    nearest: Array
    circles: tuple[Circle, ...] = ()
    bent: Array | None = None
    rays: RayMeans | None = None
    ray_numbers: Any = None
    ray_parts: Any = None
    ray_scale: Any = None
    behind: Mask | None = None
    near: Mask | None = None
    part: Array | None = None

    def select(self, chosen: NDArray[Any] | slice) -> Visibility:
        row = self.row[chosen]
        rows = row[row >= 0]
        occluders = tuple(
            (mask[rows], occluder.select(np.cumsum(mask)[rows[mask[rows]]] - 1)) for mask, occluder in self.occluders
        )
        circles, new = [circle.select(rows) for circle in self.circles], np.where(row >= 0, np.cumsum(row >= 0) - 1, -1)
        arrays = ((name, v) for name, v in vars(self).items() if isinstance(v, np.ndarray) and name != "cells")
        planes: dict[str, Any] = {name: array[rows] for name, array in arrays if name != "row"}
        return replace(self, row=new, occluders=occluders, circles=tuple(circles), **planes)


def check_visibility(
    lens: Lens, surfaces: Sequence[PlacedSurface], bounds: Sequence[Bounds | None], group: OcclusionGroup,
    psf: PointSpread, points: Points,
) -> tuple[NDArray[np.uint8], Mask, Visibility]:  # fmt: skip
    """Visibility of the lens from N points.

    surfaces, bounds: one per object of the scene; group: the occlusion group, whose occluders are tested. Returns the
    state CLEAR, PARTLY or HIDDEN (N,); a mask (N,), True for points behind an odd number of occluders, so that it
    changes where surfaces meet; and the `Visibility` for tests per tap. In the mask, a point at an outline that is
    blurred by SHARP_EDGE px or less counts as behind that occluder.
    """
    lens = along_rays(lens, points.rays)
    meet = partial(_meet_occluders, lens, surfaces, bounds, group, points)
    division = division_of(points.radius, psf.extent, points.width, points.gradient)
    state, edge, hits, nearest = meet(division)
    cut, circles = meet_rims(lens, psf, points, division)
    state = np.maximum(state, cut)
    partly, width = state == PARTLY, np.broadcast_to(points.width, state.shape)
    taps: dict[str, Any] = {}
    if partly.any() and (has_ray_means(psf) or not psf.diffracted):
        pixel_division, by_cells = division, np.broadcast_to(points.shared, partly.shape)
        while True:
            division = pixel_division if psf.diffracted else tap_division(pixel_division, points.radius, by_cells)
            if has_ray_means(psf):
                division, taps = _by_rays(psf, points, division)
            again, _, hits, place = meet(division)
            hidden = np.any([mask for mask, _ in hits], axis=0)
            far = hidden & sees_by_cells(division, place) & ~by_cells
            if psf.diffracted or not far.any():
                break
            by_cells = by_cells | far
        _, circles = meet_rims(lens, psf, points, division)
        near = division.wide & (width == 1.0) & (division.blur < NEAR_LENS)
        taps |= {"behind": again == HIDDEN, "near": near, "part": np.broadcast_to(division.part, near.shape)}
    # Hiding and tilt are combined, as both remove the part of the lens behind a surface seen edge-on.
    leans = (np.hypot(*division.gradient.T) * division.extent > 1.0) & ~division.wide & (width < 1.0)
    taps |= {
        "radius": points.radius, "wide": division.wide, "point": (width < 1.0) | points.shared, "x": points.x,
        "y": points.y, "limb": np.broadcast_to(points.limb, partly.shape), "nearest": nearest,
        "lean": np.where(leans[:, None], division.gradient, 0.0) / division.cells[:, None],
    }  # fmt: skip
    return state, edge, Visibility(
        row=np.where(partly, np.cumsum(partly) - 1, -1), psf=psf, cells=psf.lens_cells(),
        occluders=tuple((mask[partly], occluder.select(mask & partly)) for mask, occluder in hits),
        circles=tuple(circle.select(partly) for circle in circles),
        **{name: value if name == "rays" else value[partly] for name, value in taps.items()},
    )  # fmt: skip


def _meet_occluders(
    lens: Lens, surfaces: Sequence[PlacedSurface], bounds: Sequence[Bounds | None], group: OcclusionGroup,
    points: Points, division: Division,
) -> tuple[NDArray[np.uint8], Mask, list[tuple[Mask, Occluder]], Array]:  # fmt: skip
    """State of the lens (N,), mask (N,) of `check_visibility`, occluders, and their smallest `crossing_place` (N,)."""
    shape = points.w.shape
    state, edge, occluders, nearest = np.full(shape, CLEAR), np.zeros(shape, dtype=bool), [], np.full(shape, np.inf)
    for k, surface in enumerate(surfaces):
        # The nearer of two roots is not hidden by its own surface.
        if group.occluders >> k & 1 and not (k == group.own and group.root == (2 if surface.constant < 0 else 1)):
            hides = meet_occluder(lens, surface, bounds[k], points, division, k == group.own)
            surface_state, changes, occluder, place = hides
            follows, narrows, trails = source_ways(division, place)
            occluder = replace(occluder, follows=follows, narrows=narrows, trails=trails)
            nearest = np.where(surface_state == PARTLY, np.minimum(nearest, place), nearest)
            state, edge = np.maximum(state, surface_state), edge ^ changes
            occluders.append((surface_state == PARTLY, occluder))
    return state, edge, occluders, nearest


def _by_rays(psf: PointSpread, points: Points, division: Division) -> tuple[Division, dict[str, Any]]:
    """`division` with the cells of wide lenses at the scale of `RayMeans`; with bent rays, of all lenses.

    Also returns the fields of `Visibility` that concern rays.
    """
    rays, count = ray_means(psf, ceil(float(np.abs(points.radius).max()))), len(points.w)
    places, shares = np.zeros((1, count), dtype=np.int64), np.ones((1, count))
    if psf.varying is not None and points.place is not None:
        places, shares = psf.varying.blend(points.place[1], points.place[0])
    numbers, parts, scale = rays.around(points.radius, places, shares)
    wide = np.ones(count, dtype=bool) if psf.diffracted else division.wide
    division = replace(division, wide=wide, cells=np.where(wide, scale, division.cells), bent=psf.diffracted)
    return division, {"rays": rays, "ray_numbers": numbers, "ray_parts": parts, "ray_scale": scale}
