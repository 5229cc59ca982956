"""Coverage of cells by surfaces whose images are narrow, in NumPy float64.

The formulas stand at the head of kernels/trace/small.clh. A conic is an array (6, ...) of its coefficients of 1, x, y,
x^2, x y, y^2 about the middles of pixels, px right and down.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from clsco.constants import NARROW_IMAGE
from clsco.optics.lens import ray_step
from clsco.optics.quadrics import PlacedSurface, cutting_bounds
from clsco.optics.visibility import OcclusionGroup
from clsco.reference.common.geometry import (
    Array,
    Bounds,
    blur_gradient,
    blur_radius,
    nearest_surface,
    pixel_ray,
    quarter_discriminant,
    solve_root,
    turned,
)
from clsco.reference.trace.light import shade
from clsco.reference.trace.view import Cast, View
from clsco.scene.model import Camera

LINES, END_LINES = 8, 2
CLEARLY = 1.001
LEFT = 1e-3  # of a cell: what is less has no cell
Mask = NDArray[np.bool_]
Index = NDArray[np.intp]
Labels = NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class Divided:
    """Cells of pixels (M, S, S): the small surface that has each, -1 for none; (M, S, S, 4) of what it has the size,
    times the place in px right and down, and times what light leaves of the texture; the size left of all else."""

    owner: Index
    own: Array
    left: Array


def conditions(surface: PlacedSurface, bounds: Bounds | None) -> list[Callable[[Array], Array]]:
    """Functions of rays (..., 3) that are >= 0 where these hit a surface, as far as they are of second degree."""
    shape = surface.canonical
    if shape.q.any():
        return [lambda rays: quarter_discriminant(surface, turned(surface.turn, rays))]

    def depth(rays: Array) -> Array:
        return np.asarray(-2.0 * (turned(surface.turn, rays) @ shape.l) / surface.constant)

    def within(axis: int, low: float, high: float) -> Callable[[Array], Array]:
        def product(rays: Array) -> Array:
            w = depth(rays)
            place = surface.own_offset[axis] * w + rays @ surface.own_turn[axis]
            return (place - low * w if low > -np.inf else w) * (high * w - place if high < np.inf else w)

        return product

    def on_disc(rays: Array) -> Array:
        w = depth(rays)
        at = surface.offset * w[..., None] + turned(surface.turn, rays)
        return np.asarray(shape.radius**2 * w * w - at[..., 0] ** 2 - at[..., 1] ** 2)

    found = [within(axis, *ends) for axis, ends in enumerate(bounds or ()) if np.isfinite(ends).any()]
    return found + ([on_disc] if shape.radius < np.inf else [])


def conics_of(camera: Camera, surface: PlacedSurface, bounds: Bounds | None, row: Index, column: Index) -> Array:
    """Conics (conditions, 6, ...) of a surface about pixels, rows and columns (...)."""
    found = []
    for form in conditions(surface, bounds):
        places = ((0, 0), (0, -1), (0, 1), (-1, 0), (1, 0), (1, 1))
        middle, left, right, above, below, corner = (
            form(pixel_ray(camera, row + down, column + aside)) for down, aside in places
        )
        first = middle, 0.5 * (right - left), 0.5 * (below - above)
        second = 0.5 * (right + left) - middle, corner - right - below + middle, 0.5 * (below + above) - middle
        found.append(np.stack([*first, *second]))
    return np.stack(found)


def is_small(
    camera: Camera, surface: PlacedSurface, bounds: Bounds | None, row: NDArray[np.int64], column: NDArray[np.int64]
) -> Mask:  # fmt: skip
    """True of pixels about which the image of a surface is narrow, and in which it may be; rows and columns broadcast,
    px."""
    row, column = np.broadcast_arrays(row, column)
    if not surface.width < NARROW_IMAGE * ray_step(camera):
        return np.zeros(row.shape, dtype=bool)
    rays, step = pixel_ray(camera, row, column), ray_step(camera)
    ends = (surface.seen.x, surface.seen.y)
    near = [(rays[..., k] + step >= low) & (rays[..., k] - step <= high) for k, (low, high) in enumerate(ends)]
    found = near[0] & near[1]
    here = np.ones(int(found.sum()), dtype=bool)
    for one, x, y, xx, xy, yy in conics_of(camera, surface, bounds, row[found], column[found]):
        beyond = 0.25 * (np.maximum(xx, 0.0) + np.maximum(yy, 0.0) + np.abs(xy))
        here &= one + 0.5 * (np.abs(x) + np.abs(y)) + beyond >= 0.0
        if surface.width < 0.0:
            bend = -(xx + yy)
            here &= (bend > 0.0) & (4.0 * one * bend + x * x + y * y < (NARROW_IMAGE * bend) ** 2)
    found[found] = here
    return np.asarray(found)


def small_members(
    camera: Camera, surfaces: Sequence[PlacedSurface], bounds: Sequence[Bounds | None], group: OcclusionGroup,
    row: NDArray[np.int64], column: NDArray[np.int64],
) -> NDArray[np.bool_]:  # fmt: skip
    """True (objects, ...) of the members of an occlusion group that are small in pixels; rows and columns broadcast."""
    none = np.zeros(np.broadcast(row, column).shape, dtype=bool)
    each = zip(surfaces, bounds, strict=True)
    return np.stack(
        [is_small(camera, *one, row, column) if group.members >> k & 1 else none for k, one in enumerate(each)]
    )


def narrow(a: Array, b: Array, c: Array, low: Array, high: Array) -> tuple[Array, Array]:
    """Intervals narrowed to where a + 2 b x + c x^2 >= 0, if that is one."""
    square, bent = b * b - a * c, c < 0.0
    root, c = np.sqrt(np.maximum(square, 0.0)), np.where(bent, c, -1.0)
    begin = np.maximum(low, (root - b) / c)
    end = np.where(square > 0.0, np.minimum(high, (-root - b) / c), begin)
    return np.where(bent, begin, low), np.where(bent, end, high)


def small_cover(
    view: View, bounds: Sequence[Bounds | None], group: OcclusionGroup, k: int, place: tuple[Index, Index], samples: int
) -> Array:  # fmt: skip
    """Parts of the cells of pixels (M,) that the image of member k covers: (M, S, S, 4) as `Divided.own`; place: their
    rows and columns."""
    camera, (row, column) = view.scene.camera, place
    each = conics_of(camera, view.surfaces[k], bounds[k], row, column)
    bend = -(each[:, 3] + each[:, 5])
    size = each[:, 0] * bend + 0.25 * (each[:, 1] ** 2 + each[:, 2] ** 2)
    ratio = np.where(bend > 0.0, bend * bend / np.where(bend > 0.0, np.maximum(size, 1e-6 * bend * bend), 1.0), 0.0)
    narrowest, most = np.zeros(row.shape, dtype=np.intp), np.zeros(row.shape)
    for i, one in enumerate(ratio):
        narrowest, most = (np.where(one > CLEARLY * most, new, old) for new, old in ((i, narrowest), (one, most)))
    pixel = np.arange(len(row))
    chosen = each[narrowest, :, pixel].T
    over = np.abs(chosen[5]) > CLEARLY * np.abs(chosen[3])
    each = np.where(over, each[:, [0, 2, 1, 5, 4, 3]], each)
    one, x, y, xx, xy, yy = each[narrowest, :, pixel].T
    square, ends = x * x - 4.0 * xx * one, (np.full(row.shape, -0.5), np.full(row.shape, 0.5))
    low, high = narrow(square, xy * x - 2.0 * xx * y, xy * xy - 4.0 * xx * yy, *ends)
    closed = (low > -0.5) | (high < 0.5)
    inner = [low, high]
    for i, (p, px, py, pxx, pxy, pyy) in enumerate(each):
        first, last, other = high, low, narrowest != i
        for side in (-1.0, 1.0):
            along, at = -xy / (2.0 * xx), (side * np.sqrt(np.maximum(square, 0.0)) - x) / (2.0 * xx)
            half = 0.5 * (py + px * along + at * (2.0 * along * pxx + pxy))
            begin, end = narrow(p + at * (px + pxx * at), half, pyy + along * (pxy + pxx * along), low, high)
            inner[0] = np.where(other, np.maximum(inner[0], np.minimum(begin, high)), inner[0])
            inner[1] = np.where(other, np.minimum(inner[1], np.maximum(end, low)), inner[1])
            met = begin < end
            first, last = np.where(met, np.minimum(first, begin), first), np.where(met, np.maximum(last, end), last)
        low, high = np.where(other, np.maximum(low, first), low), np.where(other, np.minimum(high, last), high)
    limits = np.stack([low, np.minimum(*inner), np.maximum(*inner), high])
    few = np.where((limits[1] > low) | (limits[2] < high), END_LINES, 0)
    nodes, weights = (0.5 * n for n in np.polynomial.legendre.leggauss(LINES))
    cover = np.zeros((len(row), samples, samples, 4))
    for i in range(LINES):
        part = np.where(i < few, 0, np.where(i < LINES - few, 1, 2))
        lines, before = np.where(part == 1, LINES - 2 * few, few), np.choose(part, [0 * few, few, LINES - few])
        length, node = limits[part + 1, pixel] - limits[part, pixel], 0.5 + nodes[i]
        u = np.where(closed, node * node * (3.0 - 2.0 * node), (i - before + 0.5) / lines)
        share = length * np.where(closed, 6.0 * node * (1.0 - node) * weights[i], 1.0 / lines)
        line, (begin, end) = limits[part, pixel] + length * u, ends
        for p, px, py, pxx, pxy, pyy in each:
            begin, end = narrow(
                p + line * (py + pyy * line), 0.5 * (px + pxy * line), pxx, begin, np.maximum(end, begin)
            )
        points = 16 if len(bounds) > 1 else 4
        for j in range(points):
            at = begin + (end - begin) * (j + (5 * i % LINES + 0.5) / LINES) / points
            right, down = np.where(over, line, at), np.where(over, at, line)
            rays = pixel_ray(camera, row + down, column + right)
            w, _, number = nearest_surface(view.surfaces, bounds, group, rays)
            shown = np.ones(w.shape) if view.light is None else shade(view.light, view.surfaces[k], k, rays, w)
            part_of = np.where((low < high) & (begin < end) & (number == k), share * (end - begin), 0.0)
            part_of = part_of * samples**2 / points
            cells = (np.clip(((n + 0.5) * samples).astype(np.intp), 0, samples - 1) for n in (down, right))
            value = np.stack([np.ones_like(right), right, down, shown], axis=-1)
            np.add.at(cover, (pixel, *cells), part_of[:, None] * value)
    return cover


def nearest_cell(owner: Index, label: Labels, wanted: int, place: int) -> int:
    """The cell nearest to another of those (S, S) that an owner has, -1 for none; where that is no small surface, one
    of the same label if any is."""
    samples = len(owner)
    row, column = np.indices(owner.shape)
    away = np.asarray((row - place // samples) ** 2 + (column - place % samples) ** 2)
    if wanted < 0:
        away = away + np.where(label != label.flat[place], 2 * owner.size, 0)
    there = owner == wanted
    return int(np.where(there, away, 8 * owner.size).argmin()) if there.any() else -1


def take_cells(found: Divided, label: Labels, k: int, at: int, cover: Array) -> None:
    """Give cells of pixel `at` to member k, and what it covers of any to its own; label: (S, S), without the small
    ones; cover: (S, S, 4), from `small_cover`."""
    owner, left, own = found.owner[at], found.left[at], found.own[at].reshape(-1, 4)
    left -= cover[..., 0]
    free, some = owner < 0, cover[..., 0] > 0.0
    if some.any() and free.any():
        best = nearest_cell(owner, label, -1, int(cover[..., 0].argmax()))
        taken, others = free & some & (cover[..., 0] > left), free.copy()
        taken.flat[best], others.flat[best] = True, False
        if not (free & ~taken).any() and others.any() and left.sum() > LEFT:
            taken.flat[np.where(others, left, -np.inf).argmax()] = False
        owner[taken] = k
    for cell in np.flatnonzero(some).tolist():
        to = nearest_cell(owner, label, k, cell)
        own[cell if to < 0 else to] += cover.reshape(-1, 4)[cell]


def divide_cells(found: Divided, label: Labels, covers: dict[int, tuple[Index, Array]]) -> None:
    """Divide the cells of pixels (M, S, S) between small surfaces and all else; covers: of each surface its pixels, and
    what it covers of their cells."""
    for k, (pixels, cover) in covers.items():
        for at, one in zip(pixels.tolist(), cover, strict=True):
            take_cells(found, label[at], k, at, one)
    for at, cell in np.argwhere((found.owner >= 0).reshape(len(label), -1)).tolist():
        to = nearest_cell(found.owner[at], label[at], -1, cell)
        if to >= 0:
            found.left[at].flat[to] += found.left[at].flat[cell]


def outline_plane(surface: PlacedSurface, rays: Array) -> tuple[Array, Array]:
    """Inverse depth (n,) along rays (n, 3) of the plane of the outline of a surface, and its slope (n, 2)."""
    shape = surface.canonical
    normal = (shape.q * surface.offset + shape.l) @ surface.turn
    normal = normal * ((-1.0 if shape.q.any() else -2.0) / surface.constant)
    return rays @ normal, np.broadcast_to(normal[:2], (len(rays), 2))


def small_depth(surface: PlacedSurface, bounds: Bounds | None, group: OcclusionGroup, rays: Array) -> Array:
    """The same depth, or where bounds cut a curved surface its own."""
    plane, _ = outline_plane(surface, rays)
    if bounds is None or not surface.canonical.q.any():
        return plane
    w, root = solve_root(surface, bounds, rays, group.root)
    return np.where(root > 0, w, plane)


def cast_behind(
    cast: Callable[..., Cast], view: View, group: OcclusionGroup, small: Mask, row: Array, column: Array,
    texel: tuple[Index, Index], samples: int,
) -> Cast:  # fmt: skip
    """`cast` at cells (M, S, S) with what is not small in their pixels; small: (objects, M)."""
    found = cast(view, group, row, column, texel, samples)
    for number in {*map(tuple, small.T.tolist())} - {(False,) * len(small)}:
        behind = replace(group, members=group.members & ~sum(1 << k for k, one in enumerate(number) if one))
        here = np.nonzero((np.array(number) == small.T).all(axis=1))[0]
        part = cast(view, behind, row[here], column[here], tuple(n[here] for n in texel), samples)
        for field in fields(found):
            getattr(found, field.name)[here] = getattr(part, field.name)
    return found


def with_small(
    cast: Callable[..., Cast], view: View, group: OcclusionGroup, hit: Cast, label: Labels, covered: Array, small: Mask,
    place: tuple[Index, Index],
) -> tuple[Cast, Mask]:  # fmt: skip
    """Hits of cells (M, S, S) of which small surfaces have some, and which those are.

    label: of the cells without these; covered: (M, S, S), of them; small: (objects, M); place: rows and columns (M,).
    """
    camera, samples = view.scene.camera, label.shape[1]
    bounds, covers = [cutting_bounds(item) for item in view.scene.objects], {}
    for k in np.flatnonzero(small.any(axis=1)).tolist():
        at = np.flatnonzero(small[k])
        covers[k] = at, small_cover(view, bounds, group, k, (place[0][at], place[1][at]), samples)
    found = Divided(np.full(label.shape, -1), np.zeros((*label.shape, 4)), covered.copy())
    divide_cells(found, label, covers)
    left = np.where(covered > 0.0, found.left / np.where(covered > 0.0, covered, 1.0), 0.0)
    copies = {name: getattr(hit, name).copy() for name in ("w", "label", "radius", "gradient")}
    hit = replace(hit, radiance=hit.radiance * left[..., None], **copies)
    for k in covers:
        cells = np.nonzero(found.owner == k)
        own, surface, pixel = found.own[cells], view.surfaces[k], [n[cells[0]] for n in place]
        row, column = pixel[0] + own[:, 2] / own[:, 0], pixel[1] + own[:, 1] / own[:, 0]
        rays = pixel_ray(camera, row, column)
        w, slope = small_depth(surface, bounds[k], group, rays), outline_plane(surface, rays)[1]
        shown = cast(replace(view, light=None), replace(group, members=1 << k), row, column, pixel, samples)
        size = blur_radius(view.lens, rays, w)
        hit.w[cells], hit.label[cells], hit.radius[cells] = w, 2 * k + 1, size
        reached = np.minimum(np.abs(size), 1.0)[:, None]
        hit.gradient[cells] = blur_gradient(camera, view.lens, slope, rays, w) * reached
        hit.radiance[cells] = shown.radiance * own[:, 3:]
    return hit, found.owner >= 0
