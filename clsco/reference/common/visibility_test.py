"""Fraction of the lens visible from single taps: V(x, l) from the results of `visibility.check_visibility`."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.constants import LEAST_OPENING, LENS_CELLS
from clsco.optics.chords import chord_weights
from clsco.optics.ellipses import across_of
from clsco.optics.ray_means import SHEET_PLANES, SHEETS
from clsco.reference.common.equation import PIXEL_CELLS
from clsco.reference.common.geometry import Array, tilt_share
from clsco.reference.common.occluder import Cut, Part, leave_free, occluded_part
from clsco.reference.common.visibility import Visibility

MOST_INWARDS = 0.7  # px, largest inward displacement of a tap along an axis, at the corners of a lens mask
BEYOND = 0.5  # px outside of the blur's edge; with waves and whole pixels, taps farther out are moved to there
DISC_NODES = 8  # number of nodes of integrals over the width of a disc (Gauss, Chebyshev)
LEAST_CELL = 1e-3  # px, least width of a lens cell for sources that are whole pixels
LEAST_PART = 1e-6  # share of a tap's light below which a sheet is ignored
PIXEL_CORNER, PIXELS_CORNER = 0.7072, 1.4143  # px, distance of a pixel's corner from its middle, and twice this
CELL_MIDDLES = np.arange(2 * LENS_CELLS) + 0.5 - LENS_CELLS  # along an axis, from the middle of the lens
NARROW_MIDDLE = 7  # px along an axis; taps of a narrow lens that are farther out see what a tap at this distance sees


def bend_visibility(visibility: Visibility, shape: Array) -> Visibility:
    """Copy of `visibility` for sources with elliptic blurs; shape (M, 3): see `clsco.optics.ellipses.shape_of`."""
    across = across_of(shape)
    bent = np.where(visibility.wide[:, None], across, across[:, ::-1] * (1.0, -1.0, 1.0))
    return replace(visibility, bent=bent, lean=np.stack(_bent(bent, *visibility.lean.T), axis=-1))


def _bent(by: Array, x: NDArray[Any], y: NDArray[Any]) -> tuple[Array, Array]:
    xx, xy, yy = np.moveaxis(by, -1, 0)
    return xx * x + xy * y, xy * x + yy * y


def free_share(visibility: Visibility, x: Array, y: Array) -> Array:
    """Visible fraction (M,) of the lens, averaged over the cell of one tap per source.

    x, y (M,): position of the tap relative to its source, in px for wide lenses and in cells for narrow ones. A tap at
    the edge of a wide lens's blur sees only the part of its cell inside the lens, see `inwards_of`. With waves but
    without `rays`, a tap beyond the edge of the blur is moved to that edge.
    """
    rim = np.maximum(np.abs(visibility.radius) * visibility.psf.extent, 1.0)
    if visibility.bent is not None:
        x, y = (np.where(visibility.wide, *values) for values in zip(_bent(visibility.bent, x, y), (x, y), strict=True))
    tap_x, tap_y = x, y
    if visibility.rays is not None and visibility.psf.diffracted:
        return _free_by_sheets(visibility, x, y)
    if visibility.rays is not None:
        right, down, *narrow = visibility.rays.lens_points(visibility.ray_numbers, visibility.ray_parts, x, y)
        lens_point = visibility.ray_scale * right, visibility.ray_scale * down
        x, y = (np.where(visibility.wide, *pair) for pair in zip(lens_point, (x, y), strict=True))
    elif visibility.psf.pupil.edges:
        x, y, *narrow = _inside(visibility, x, y)
    else:
        square = x * x + y * y
        moved, less = inwards_of(visibility, 0.5 * rim - square / (2 * rim))
        inwards, less = np.where(visibility.wide, 1 - moved / rim, 1.0), less / (square + 1e-30)
        narrow = [less * x * x, less * x * y, less * y * y]
        x, y = x * inwards, y * inwards
    if visibility.psf.diffracted:
        distance = np.hypot(x, y)
        within = np.where(visibility.wide & (distance > rim), rim / np.maximum(distance, rim), 1.0)
        x, y = x * within, y * within
        narrow = [np.zeros_like(x)] * 3
    none, (xx, xy, yy) = np.zeros_like(x), narrow
    aside_x, aside_y = (none, none) if visibility.psf.diffracted else (tap_x - x, tap_y - y)
    axes = np.array([[x, xx, none, aside_x], [y, yy, none, aside_y]])
    if visibility.near is not None and visibility.rays is None:
        near = np.stack([near_focus(visibility, tap) for tap in (tap_x, tap_y)])
        axes, xy = np.where(visibility.near, near, axes), np.where(visibility.near, 0.0, xy)
    (x, xx, trail_x, aside_x), (y, yy, trail_y, aside_y) = axes
    narrow = [np.where(visibility.wide, part, 0.0) for part in (xx, xy, yy, trail_x, trail_y)]
    return _free_of_all(visibility, x, y, Cut(aside_x, aside_y, *narrow))


def _free_of_all(visibility: Visibility, x: Array, y: Array, cut: Cut) -> Array:
    """Fraction (M,) of the lens left free by occluders and rims; x, y: taps, at the middle of their visible part."""
    share, across, down = np.ones_like(x), np.zeros_like(x), np.zeros_like(x)
    for mask, occluder in visibility.occluders:
        free = Part(share[mask], across[mask], down[mask])
        free = leave_free(free, occluded_part(occluder, x[mask], y[mask], cut.select(mask)))
        share[mask], across[mask], down[mask] = free.share, free.x, free.y
    share = share * rim_share(visibility, x, y)
    return share if visibility.behind is None else np.where(visibility.behind, 0.0, share)


def inwards_of(visibility: Visibility, s: Array) -> tuple[Array, Array]:
    """Displacement (M,) in px of the mean of a response inwards, if its outer part is cut off, and reduction of its
    variance.

    The aperture's edge cuts off the response of a tap s (M,) px farther out than the tap. The reduction (M,) is 0 for
    none to 1. The response is a tent, or for a point a box; kernels/common/visibility_test.clh has the formulas.
    """
    t, b = np.clip(s, -1.0, 1.0), np.clip(s, -0.5, 0.5)
    tent = np.where(t > 0, (1 - t) ** 2, 1 - 2 * t) / 3
    narrow = np.where(t > 0, (1 - t) * 2.0 / 3.0, 1.0 - (1 + t) ** 2 / 3)
    return np.where(visibility.point, 0.5 * (0.5 - b), tent), np.where(visibility.point, 1.0 - (0.5 + b) ** 2, narrow)


def near_focus(visibility: Visibility, t: Array) -> Array:
    """Description (4, M) of the light at taps t (M,) px along one axis, for pixels' sources near the focus.

    The rows are the mean lens position in cells and three entries of `Cut` for this axis: xx or yy, trail and aside.
    Light that arrives at v px has the weight max(0, 1 - |t - v|).
    """
    assert visibility.part is not None
    size = np.abs(visibility.radius) * visibility.psf.extent
    cells = visibility.psf.extent * np.where(visibility.part < 1.0, PIXEL_CELLS, np.abs(visibility.radius))
    angle = np.arange(1, DISC_NODES + 1) * (np.pi / (DISC_NODES + 1))
    node = np.cos(angle)
    tent = np.maximum(1.0 - np.abs(t[:, None] - size[:, None] * node), 0.0)
    share = tent * np.sin(angle) ** 2
    share /= share.sum(axis=-1, keepdims=True) + 1e-20
    mean, second, trail = share @ node, share @ node**2, (share * tent**2).sum(axis=-1)
    return np.stack([cells * mean, 1.0 - 6.0 * cells**2 * (second - mean**2), 1.0 - 2.0 * trail, t - size * mean])


def response(t: Array, width: Array) -> Array:
    """Response of a pixel, up to a factor, to light through a lens cell that arrives t px from the pixel's middle.

    width: of this light, in px. The light of a point source fills the image of the cell, so this is the image's width.
    For the source of a pixel, only light through the middle of the cell is considered, so this is 1 px.
    """
    return np.clip(0.5 * (1.0 + width) - np.abs(t), 0.0, width)


def lens_share(visibility: Visibility, x: Array, y: Array) -> Array:
    """Visible fraction (M,) of cells x, y (M,) of narrow lenses, times the tilt of surfaces that partly face away.

    A round edge at the distance s from the middle of a cell leaves a part of the cell whose mean is (s - 1/2) / 2 from
    the cell's middle.
    """
    psf = visibility.psf
    if not (psf.signed or psf.diffracted or psf.pupil.edges):
        away = np.hypot(x, y)
        inwards = 1.0 - 0.5 * np.clip(away - (LENS_CELLS - 0.5), 0.0, 1.0) / away
        x, y = x * inwards, y * inwards
    tilt = tilt_share(1.0 + x * visibility.lean[:, 0] + y * visibility.lean[:, 1], visibility.limb)
    return np.asarray(tilt * free_share(visibility, x, y))


def rim_share(visibility: Visibility, x: Array, y: Array) -> Array:
    """Fraction (M,) of the light of taps that passes the rims; 1 if `cut_weights` includes the rims.

    The edge of a rim is as soft as the response of a pixel.
    """
    share = np.ones_like(x)
    for circle in visibility.circles * (not visibility.psf.cut_by_chords):
        t = np.clip((circle.radius - np.hypot(x - circle.x, y - circle.y)) * circle.scale, -1.0, 1.0)
        soft = np.where(t < 0, 0.5 * (1 + t) ** 2, 1 - 0.5 * (1 - t) ** 2)
        share *= np.where(circle.cuts, soft, 1.0)
    return share


def _free_by_sheets(visibility: Visibility, x: Array, y: Array) -> Array:
    """`free_share` with bent rays: the sum over the sheets of rays, each weighted by its share of the tap's light."""
    assert visibility.rays is not None
    second, *planes = visibility.rays.lens_points(visibility.ray_numbers, visibility.ray_parts, x, y)
    scale, free = visibility.ray_scale, np.zeros_like(x)
    for part, sheet in zip((1.0 - second, second), np.reshape(planes, (SHEETS, SHEET_PLANES, -1)), strict=True):
        right, down, xx, xy, yy, aside_x, aside_y, *covariance = sheet / np.maximum(part, LEAST_PART)
        cut = Cut(aside_x, aside_y, xx, xy, yy, 0.0 * xx, 0.0 * xx, np.stack(covariance))
        free += part * _free_of_all(visibility, scale * right, scale * down, cut)
    return free


def cut_weights(visibility: Visibility, weight: Array, dx: float, dy: float, point: bool) -> Array:
    """Weights (M,) of the tap (dx, dy) px from each source's pixel, for the part of the opening inside the rims.

    weight (M,): weights of the whole opening, which are returned unless the rims are cut by chords; point: True for
    point sources.
    """
    pupil, cut = visibility.psf.pupil, np.any([circle.cuts for circle in visibility.circles], axis=0)
    if not (visibility.psf.cut_by_chords and cut.any()):
        return weight
    size = np.maximum(np.abs(visibility.radius), LEAST_OPENING)
    x, y, far = dx - visibility.x, dy - visibility.y, PIXEL_CORNER if point else PIXELS_CORNER
    borders, open_weight = pupil.borders, 1.0 / (np.pi * size * size)
    inside = size - np.hypot(x, y)
    if borders is not None:
        size, open_weight = np.where(visibility.radius < 0.0, -size, size), weight
        inside = np.full_like(size, np.inf)
    for circle in visibility.circles:
        within = circle.radius - np.hypot(x - circle.x, y - circle.y)
        inside = np.minimum(inside, np.where(circle.cuts, within, np.inf))
    weights = np.where(cut, np.where(inside > 0.0, open_weight, 0.0), weight)
    at_edge = cut & (np.abs(inside) < far) & ((weight > 0.0) | (borders is None))
    rims = [(circle.x[at_edge], circle.y[at_edge], circle.radius[at_edge]) for circle in visibility.circles]
    if at_edge.any():
        light = chord_weights(x[at_edge], y[at_edge], size[at_edge], rims=rims, point=point, borders=borders)
        weights[at_edge] = light / pupil.light
    return weights


def _inside(visibility: Visibility, x: Array, y: Array) -> tuple[Array, ...]:
    """Taps of wide lenses moved to the mean of what each edge of the lens mask leaves, and xx, xy, yy of a `Cut`."""
    right, down, xx, xy, yy = np.zeros((5, *x.shape))
    turn = np.where(visibility.radius < 0, -1.0, 1.0)
    for nx, ny, distance in visibility.psf.pupil.edges:
        inwards, narrow = inwards_of(visibility, distance * np.abs(visibility.radius) - turn * (nx * x + ny * y))
        right, down = right + nx * inwards * turn, down + ny * inwards * turn
        xx, xy, yy = xx + nx * nx * narrow, xy + nx * ny * narrow, yy + ny * ny * narrow
    right, down = (np.where(visibility.wide, np.clip(v, -MOST_INWARDS, MOST_INWARDS), 0.0) for v in (right, down))
    return x - right, y - down, xx, xy, yy


def cell_visibility(visibility: Visibility) -> Array:
    """Visible fraction (N, L, L) of each lens cell for the N sources with a narrow lens, times the tilt by `lean`."""
    narrow, side = np.flatnonzero(~visibility.wide), len(CELL_MIDDLES)
    share = np.ones((narrow.size, side, side))
    if narrow.size:
        there = np.flatnonzero(visibility.row >= 0)
        sources = there[np.argsort(visibility.row[there])]
        cells, across = visibility.select(np.repeat(sources[narrow], side)), np.tile(CELL_MIDDLES, narrow.size)
        for i, down in enumerate(CELL_MIDDLES):  # a row of cells of all sources at a time
            share[:, i] = lens_share(cells, across, np.full_like(across, down)).reshape(narrow.size, -1)
    return share


def tap_share(visibility: Visibility, cells: Array, dx: float | Array, dy: float | Array) -> Array:
    """Visible fraction (M,) of the lens for the tap (dx, dy) px from each source's pixel.

    cells: (N, L, L) from `cell_visibility`. With a narrow lens, cells are weighted by the tap's response. With waves, a
    tap beyond the blur's edge is moved to that edge, or for a narrow lens's pixel source to BEYOND px outside of the
    edge.
    """
    limit = NARROW_MIDDLE if visibility.psf.diffracted or visibility.bent is not None else np.inf
    share, narrow = np.ones_like(visibility.x), ~visibility.wide
    if visibility.wide.any():
        share = free_share(visibility, dx - visibility.x, dy - visibility.y)
    if narrow.any():
        step = np.abs(visibility.radius[narrow]) * visibility.psf.extent / LENS_CELLS
        point = visibility.point[narrow]
        width = np.where(point, np.maximum(step, LEAST_CELL), 1.0)
        away = [(np.clip(d, -limit, limit) - place)[narrow] for place, d in ((visibility.x, dx), (visibility.y, dy))]
        if visibility.psf.diffracted:
            rim = LENS_CELLS * step + np.where(point, 0.0, BEYOND)
            part = np.minimum(rim / np.maximum(np.hypot(*away), 1e-6), 1.0)
            away = [part * center for center in away]
        middles = step[:, None, None] * CELL_MIDDLES
        places = middles, middles.swapaxes(1, 2)
        if visibility.bent is not None:
            bent = visibility.bent[narrow] * step[:, None]
            places = _bent(bent[:, None, None], CELL_MIDDLES, CELL_MIDDLES[:, None])
        across, down = (
            response(place - center[:, None, None], width[:, None, None])
            for place, center in zip(places, away, strict=True)
        )
        turned = visibility.psf.signed & (visibility.radius[narrow, None, None] < 0)
        weights = np.where(turned, visibility.cells[::-1, ::-1], visibility.cells) * across * down
        total, free = weights.sum(axis=(1, 2)), (weights * cells).sum(axis=(1, 2))
        share[narrow] = np.divide(free, total, out=np.ones_like(total), where=total > 0)
    return share
