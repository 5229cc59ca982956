"""Coverage of cells by surfaces with narrow images, in NumPy float64.

The formulas are at the head of kernels/trace/small.clh. A conic is an array (6, ...) of its coefficients of 1, x, y,
x^2, x y, y^2 relative to the middles of pixels, px right and down.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from clsco.constants import NARROW_IMAGE
from clsco.optics.lens import ray_step
from clsco.optics.quadrics import PlacedSurface
from clsco.optics.visibility import OcclusionGroup
from clsco.reference.common.geometry import (
    Array,
    Bounds,
    blur_gradient,
    blur_radius,
    pixel_ray,
    quarter_discriminant,
    solve_quadric,
    turned,
)
from clsco.reference.trace.light import shade
from clsco.reference.trace.view import Cast, View, cast

LINES, END_LINES = 8, 2  # number of lines in a pixel; number of these at each end if sides of a card end there
CLEARLY, SMALL_REACH = 1.001, 2.0  # factor that exceeds rounding errors; distance from an occluder's image, px
Mask = NDArray[np.bool_]
Index = NDArray[np.intp]


def conditions(surface: PlacedSurface, bounds: Bounds | None, rays: Array) -> list[Array]:
    """Values (...) along rays (..., 3), one array per condition of second degree; >= 0 where rays hit a surface."""
    shape, d = surface.canonical, turned(surface.turn, rays)
    if shape.q.any():
        return [quarter_discriminant(surface, d)]
    w, forms = -2.0 * (d @ shape.l) / surface.constant, []
    for axis, (low, high) in enumerate(bounds or ()):
        place = surface.own_offset[axis] * w + rays @ surface.own_turn[axis]
        if np.isfinite((low, high)).any():
            forms.append((place - low * w if low > -np.inf else w) * (high * w - place if high < np.inf else w))
    if shape.radius < np.inf:
        at = surface.offset * w[..., None] + d
        forms.append(shape.radius**2 * w * w - at[..., 0] ** 2 - at[..., 1] ** 2)
    return forms


def conics_of(view: View, k: int, row: Index, column: Index) -> Array:
    """Conics (conditions, 6, ...) of object k, relative to the pixels in rows and columns (...)."""
    places = ((0, 0), (0, -1), (0, 1), (-1, 0), (1, 0), (1, 1))
    middle, left, right, above, below, corner = (
        np.stack(conditions(view.surfaces[k], view.bounds[k], pixel_ray(view.camera, row + down, column + aside)))
        for down, aside in places
    )
    first = middle, 0.5 * (right - left), 0.5 * (below - above)
    second = 0.5 * (right + left) - middle, corner - right - below + middle, 0.5 * (below + above) - middle
    return np.stack([*first, *second], axis=1)


def is_small(view: View, k: int, row: Index, column: Index, reach: float = 0.5) -> Mask:
    """True for pixels whose middles may be within `reach` px of the image of object k, if it is narrow there.

    Rows and columns broadcast, px.
    """
    (row, column), surface, size = np.broadcast_arrays(row, column), view.surfaces[k], ray_step(view.camera)
    if not surface.width < NARROW_IMAGE * size:
        return np.zeros(row.shape, dtype=bool)
    rays, step = pixel_ray(view.camera, row, column), (reach + 0.5) * size
    ends = (surface.extent.x, surface.extent.y)
    near = [(rays[..., i] + step >= low) & (rays[..., i] - step <= high) for i, (low, high) in enumerate(ends)]
    near_image = near[0] & near[1]
    inside = np.ones(int(near_image.sum()), dtype=bool)
    for value, x, y, xx, xy, yy in conics_of(view, k, row[near_image], column[near_image]):
        beyond = reach * reach * (np.maximum(xx, 0.0) + np.maximum(yy, 0.0) + np.abs(xy))
        inside &= value + reach * (np.abs(x) + np.abs(y)) + beyond >= 0.0
        if surface.width < 0.0:
            bend = -(xx + yy)
            inside &= (bend > 0.0) & (4.0 * value * bend + x * x + y * y < (NARROW_IMAGE * bend) ** 2)
    near_image[near_image] = inside
    return np.asarray(near_image)


def small_members(view: View, group: OcclusionGroup, row: Index, column: Index) -> Mask:
    """Mask (objects, ...) of the members of an occlusion group that have small images at pixels.

    Rows and columns of the pixels broadcast.
    """
    mask = np.zeros((len(view.surfaces), *np.broadcast(row, column).shape), dtype=bool)
    for k in range(len(mask)):
        if group.members >> k & 1:
            mask[k] = is_small(view, k, row, column)
    return mask


def hidden_by_small(view: View, group: OcclusionGroup, row: Index, column: Index, inverse_depth: Array) -> Mask:
    """Mask (...) of pixels that have a small occluder of their sources inside, or so near that whole pixels would show
    its edge.

    inverse_depth (...): of the sources, 1/mm, 0 for no source.
    """
    rays, mask = pixel_ray(view.camera, row, column), np.zeros(inverse_depth.shape, dtype=bool)
    for k, surface in enumerate(view.surfaces):
        if group.occluders >> k & 1:
            nearest = outline_plane(surface, rays)[0] if surface.canonical.q.any() else surface.extent.w[1]
            mask |= (nearest > inverse_depth) & is_small(view, k, row, column, SMALL_REACH)
    return mask


def narrow(a: Array, b: Array, c: Array, low: Array, high: Array) -> tuple[Array, Array]:
    """Intervals low..high, narrowed to those x with a + 2 b x + c x^2 >= 0 if these x form one interval (c < 0)."""
    square, bent = b * b - a * c, c < 0.0
    root, c = np.sqrt(np.maximum(square, 0.0)), np.where(bent, c, -1.0)
    begin = np.maximum(low, (root - b) / c)
    end = np.where(square > 0.0, np.minimum(high, (-root - b) / c), begin)
    return np.where(bent, begin, low), np.where(bent, end, high)


def small_cover(view: View, group: OcclusionGroup, k: int, place: tuple[Index, Index], samples: int) -> Array:
    """Area of the cells of pixels (M,) that the image of member k covers, and moments of this area: (M, S, S, 4).

    place: rows and columns (M,). For each cell: the area in cells; the area times its position to the right and down
    from the pixel's middle in px; and the area times the shaded fraction of the texture.
    """
    row, column = place
    conics = conics_of(view, k, row, column)
    bend = -(conics[:, 3] + conics[:, 5])
    size = conics[:, 0] * bend + 0.25 * (conics[:, 1] ** 2 + conics[:, 2] ** 2)
    ratio = np.where(bend > 0.0, bend * bend / np.where(bend > 0.0, np.maximum(size, 1e-6 * bend * bend), 1.0), 0.0)
    narrowest, most = np.zeros(row.shape, dtype=np.intp), np.zeros(row.shape)
    for i, value in enumerate(ratio):
        narrowest, most = (np.where(value > CLEARLY * most, new, old) for new, old in ((i, narrowest), (value, most)))
    pixel = np.arange(len(row))
    chosen = conics[narrowest, :, pixel].T
    over = np.abs(chosen[5]) > CLEARLY * np.abs(chosen[3])
    conics = np.where(over, conics[:, [0, 2, 1, 5, 4, 3]], conics)
    value, x, y, xx, xy, yy = conics[narrowest, :, pixel].T
    square, ends = x * x - 4.0 * xx * value, (np.full(row.shape, -0.5), np.full(row.shape, 0.5))
    low, high = narrow(square, xy * x - 2.0 * xx * y, xy * xy - 4.0 * xx * yy, *ends)
    closed = (low > -0.5) | (high < 0.5)
    inner = [low, high]
    for i, (p, px, py, pxx, pxy, pyy) in enumerate(conics):
        first, last, others = high, low, narrowest != i
        for side in (-1.0, 1.0):
            along, at = -xy / (2.0 * xx), (side * np.sqrt(np.maximum(square, 0.0)) - x) / (2.0 * xx)
            half = 0.5 * (py + px * along + at * (2.0 * along * pxx + pxy))
            begin, end = narrow(p + at * (px + pxx * at), half, pyy + along * (pxy + pxx * along), low, high)
            inner[0] = np.where(others, np.maximum(inner[0], np.minimum(begin, high)), inner[0])
            inner[1] = np.where(others, np.minimum(inner[1], np.maximum(end, low)), inner[1])
            overlap = begin < end
            first = np.where(overlap, np.minimum(first, begin), first)
            last = np.where(overlap, np.maximum(last, end), last)
        low, high = np.where(others, np.maximum(low, first), low), np.where(others, np.minimum(high, last), high)
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
        for p, px, py, pxx, pxy, pyy in conics:
            value, half = p + line * (py + pyy * line), 0.5 * (px + pxy * line)
            begin, end = narrow(value, half, pxx, begin, np.maximum(end, begin))
        points = 16 if len(view.surfaces) > 1 else 4
        for j in range(points):
            at = begin + (end - begin) * (j + (5 * i % LINES + 0.5) / LINES) / points
            right, down = np.where(over, line, at), np.where(over, at, line)
            rays = pixel_ray(view.camera, row + down, column + right)
            w, _, number = view.nearest(group, rays)
            light = np.ones(w.shape) if view.light is None else shade(view.light, view.surfaces[k], k, rays, w)
            part_of = np.where((low < high) & (begin < end) & (number == k), share * (end - begin), 0.0)
            part_of = part_of * samples**2 / points
            value = part_of[:, None] * np.stack([np.ones_like(right), right, down, light], axis=-1)
            # Divided between cells, so that their sources keep the mean position of the light.
            y, x = (np.clip((n + 0.5) * samples - 0.5, 0.0, samples - 1.001) for n in (down, right))
            for next_row, below in enumerate((1.0 - y % 1.0, y % 1.0)):
                for next_column, aside in enumerate((1.0 - x % 1.0, x % 1.0)):
                    cell = pixel, y.astype(np.intp) + next_row, x.astype(np.intp) + next_column
                    np.add.at(cover, cell, (below * aside)[:, None] * value)
    return cover


def outline_plane(surface: PlacedSurface, rays: Array) -> tuple[Array, Array]:
    """Inverse depth (...) along rays (..., 3) of the plane through a surface's outline, and its slope (..., 2)."""
    shape = surface.canonical
    normal = (shape.q * surface.offset + shape.l) @ surface.turn
    normal = normal * ((-1.0 if shape.q.any() else -2.0) / surface.constant)
    return rays @ normal, np.broadcast_to(normal[:2], (*rays.shape[:-1], 2))


def cast_behind(
    view: View, group: OcclusionGroup, small: Mask, row: Array, column: Array, texel: tuple[Index, Index], samples: int
) -> Cast:  # fmt: skip
    """`cast` at cells (M, S, S) without the objects that are small in their pixels; small: (objects, M)."""
    hits = cast(view, group, row, column, texel, samples)
    for absent in np.unique(small[:, small.any(axis=0)], axis=1).T:
        behind = replace(group, members=group.members & ~sum(1 << k for k in np.flatnonzero(absent).tolist()))
        pixels = np.flatnonzero((absent == small.T).all(axis=1))
        part = cast(view, behind, row[pixels], column[pixels], (texel[0][pixels], texel[1][pixels]), samples)
        for name, values in vars(hits).items():
            values[pixels] = getattr(part, name)
    return hits


def with_small(
    view: View, group: OcclusionGroup, hit: Cast, small: Mask, place: tuple[Index, Index]
) -> tuple[Cast, Index]:  # fmt: skip
    """Hits (N, S, S) of the cells of M pixels, including small surfaces, and the pixel number (N,) of each entry.

    The first M entries are `hit`, reduced by the area that small surfaces cover; the hits of each small surface in each
    of its pixels follow. small: (objects, M); place: rows and columns (M,).
    """
    pixels, free, hits, samples = [np.arange(small.shape[1])], np.ones(hit.label.shape), [], hit.label.shape[1]
    for k in np.flatnonzero(small.any(axis=1)).tolist():
        at, surface = np.flatnonzero(small[k]), view.surfaces[k]
        cover = small_cover(view, group, k, (place[0][at], place[1][at]), samples)
        covered = cover[..., 0]
        free[at] -= covered
        right, down, light = np.moveaxis(cover[..., 1:] / np.where(covered > 0.0, covered, 1.0)[..., None], -1, 0)
        texel = (place[0][at, None, None], place[1][at, None, None])
        row, column = texel[0] + down, texel[1] + right
        rays = pixel_ray(view.camera, row, column)
        w, slope = outline_plane(surface, rays)
        if view.bounds[k] is not None and surface.canonical.q.any():  # the surface itself, if bounds cut it
            depth, root = solve_quadric(surface, view.bounds[k], rays, group.root)
            w = np.where(root > 0, depth, w)
        alone = cast(replace(view, light=None), replace(group, members=1 << k), row, column, texel, samples)
        size, label = blur_radius(view.lens, rays, w), np.where(covered > 0.0, 2 * k + 1, 0).astype(np.uint8)
        gradient = blur_gradient(view.camera, view.lens, slope, rays, w)
        radiance = alone.radiance * (light * covered)[..., None]
        hits.append(replace(alone, w=w, label=label, radius=size, gradient=gradient, radiance=radiance))
        pixels.append(at)
    hits = [replace(hit, radiance=hit.radiance * free[..., None]), *hits]
    return Cast(*map(np.concatenate, zip(*(vars(part).values() for part in hits), strict=True))), np.concatenate(pixels)
