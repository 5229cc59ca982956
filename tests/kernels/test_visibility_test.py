"""visibility.clh against its twin for made-up occluders, whose numbers reach what few scenes do."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.opencl.buffers import download, empty
from clsco.opencl.session import Session
from clsco.optics.point_spread import point_spread
from clsco.optics.visibility import lens_floats
from clsco.reference.common.equation import SOFT_BOX
from clsco.reference.common.occluder import Occluder
from clsco.reference.common.visibility import Visibility
from clsco.reference.common.visibility_test import cell_visibility, tap_share
from clsco.scene.model import Psf

Array = NDArray[Any]
Runner = Callable[..., None]
FEATURES = {"OCCLUDED": 2, "LIMITED": 1, "GATHER": 1}
ALONG = """
// States of seven blocks of taps from place (x, y) on: 0 hidden, 1 free, else 1/2. unmoved: the first and the last
// block whose taps the rim does not move. counts: occluders; per occluder limits and crossings.
// height: per occluder base, bx, by, slack, rim; limit: per occluder seven of (constant, x, y).
__kernel void say_along(const int rows, __global const float2 *place, __global const int2 *unmoved,
                        __global const int *counts,
                        __global const float *height, __global const float *limit, __global float *state)
{
    const int i = get_global_id(0);
    if (i >= rows)
        return;
    visibility_t both[2];  // the other one's share is what is before the occluders
    for (int row = 0; row < NARROW_ROWS; ++row)
        for (int lane = 0; lane < NARROW_LANES; ++lane)
            both[0].share[row][lane] = 0;
    visibility_t *visibility = both + 1;
    visibility->count = counts[5 * i];
    for (int k = 0; k < 2; ++k) {
        occluder_t *m = visibility->occluder + k;
        __global const float *h = height + 5 * (2 * i + k);
        m->base = h[0], m->bx = h[1], m->by = h[2], m->slack = h[3], m->rim = h[4];
        m->root = m->fx = m->fy = m->fxx = m->fxy = m->fyy = 0;
        m->limits = counts[5 * i + 1 + 2 * k], m->crossings = counts[5 * i + 2 + 2 * k];
        for (int n = 0; n < 7; ++n)
            for (int c = 0; c < 3; ++c)
                m->limit[n][c] = limit[3 * (7 * (2 * i + k) + n) + c];
    }
    conics_t conics[OCCLUDED];
    const blocks_t blocks = classify_blocks(visibility, place[i].x, place[i].y, 7, unmoved[i].x, unmoved[i].y, conics);
    for (int n = 0; n < 7; ++n)
        state[8 * i + n] = blocks.hidden >> n & 1 ? 0 : blocks.free >> n & 1 ? 1 : 0.5f;
}
"""
THROUGH = """
// Shares of all taps for one edge over the lens; source: radius, ox, oy, and h: base, bx, by.
__kernel void see_through(const int sources, __constant float *lens, const float extent, __global const float *source,
                          __global float *share)
{
    const int i = get_global_id(0);
    if (i >= sources)
        return;
    __global const float *s = source + 6 * i;
    visibility_t visibility;
    visibility.count = 1;
    visibility.wide = visibility.behind = false;
    visibility.limb = i & 1;
    visibility.point = i >> 1 & 1;
    visibility.lean_x = 0.03125f, visibility.lean_y = -0.25f;
    occluder_t *m = visibility.occluder;
    m->base = s[3], m->bx = s[4], m->by = s[5];
    m->root = m->fx = m->fy = m->fxx = m->fxy = m->fyy = 0;
    m->limits = 0, m->crossings = 0;
    cell_visibility(&visibility, lens, s[0], extent, s[1], s[2], NARROW_MIDDLE);
    for (int row = 0; row < NARROW_ROWS; ++row)
        for (int column = 0; column < NARROW_ROWS; ++column)
            share[(NARROW_ROWS * i + row) * NARROW_ROWS + column] = visibility.share[row][column];
}
"""


def test_blocks_are_decided_where_all_of_them_is_clear_or_hidden(session: Session, run_source: Runner) -> None:
    """A row of seven blocks of 8 x 8 taps: 0 where one occluder hides all of it, 1 where none hides any, else between.

    A block goes from half a px before its first tap to half a px behind its last, along both axes. Of a card, it is
    hidden where all limits are half a width of the soft edge away at its corners, and clear where any is; others have a
    slack besides. What the rim may do to taps is one width, or what others say.
    """
    rng, count = np.random.default_rng(5), 300
    place = rng.uniform([-20, -6], [4, 6], (count, 2)).astype(np.float32)
    occluders = rng.integers(0, 3, count)
    kind = rng.choice(["card", "whole"], (count, 2), p=[0.6, 0.4])
    limits = np.where(kind == "whole", 0, rng.integers(1, 5, (count, 2)))
    crossings = np.zeros((count, 2), int)
    edges = rng.uniform(-1, 1, (count, 2, 7, 3)) * np.array([15.0, 0.5 / SOFT_BOX, 0.5 / SOFT_BOX])
    edges[..., 0] += 4  # so that all of some are met
    edges[: count // 8, ..., 1:] = 0
    edges[: count // 8, ..., 0] *= 0.4
    height = edges[..., 6, :] - np.array([4, 0, 0])
    slack, rim = rng.uniform(0, 2, (2, count, 2, 1))
    unmoved = rng.integers([-1, 2], [4, 8], (count, 2))
    state = empty(session, 4 * 8 * count)
    run_source(
        ALONG, "say_along", "double", FEATURES, count, np.int32(count), place,
        unmoved.astype(np.int32),
        np.stack([occluders, limits[:, 0], crossings[:, 0], limits[:, 1], crossings[:, 1]], axis=-1).astype(np.int32),
        np.concatenate([height, slack, rim], axis=-1).astype(np.float32), edges.astype(np.float32), state,
    )  # fmt: skip
    found = download(session, state, (count, 8), np.float32)[:, :7]

    ends = place[:, :1] - 0.5 + 8 * np.arange(8)
    both = np.stack([ends[:, :-1], ends[:, 1:]] * 2)[..., None, None]  # (corners, rows, blocks, 1, 1)
    y = place[:, 1, None, None, None] + np.array([-0.5, -0.5, 7.5, 7.5])[:, None, None, None, None]
    part = edges[:, None]
    g = part[..., 0] + part[..., 1] * both + part[..., 2] * y  # (corners, rows, blocks, occluders, limits)
    there = np.arange(7) < limits[:, None, :, None]
    block = np.arange(7)
    moved = ((block < unmoved[:, :1]) | (block > unmoved[:, 1:]))[..., None]  # (rows, blocks, 1)
    least = 0.5 + moved[..., None]
    card_hides = ((g.min(axis=0) >= least) | ~there).all(axis=-1)
    card_clears = ((g.max(axis=0) <= -least) & there).any(axis=-1)
    h = height[:, None, :, 0] + height[:, None, :, 1] * both[..., 0] + height[:, None, :, 2] * y[..., 0]
    reach = slack[:, None, :, 0] + moved * rim[:, None, :, 0]
    low, high = h.min(axis=0) - reach, h.max(axis=0) + reach
    assert min(np.abs(np.abs(g) - least).min(), np.abs(low - 0.5).min(), np.abs(high + 0.5).min()) > 1e-5  # no ties
    whole, card = (np.broadcast_to((kind == name)[:, None], low.shape) for name in ("whole", "card"))
    hidden = (whole & (low >= 0.5)) | (card & card_hides)
    clear = (whole & (high <= -0.5)) | (card & card_clears)
    states = np.where(hidden, 0.0, np.where(clear, 1.0, 0.5))
    there = np.where(np.arange(2) < occluders[:, None, None], states, 1.0)
    expected = np.where((there == 0).any(axis=-1), 0.0, np.where((there == 1).all(axis=-1), 1.0, 0.5))
    for one in (whole, card):
        assert min((states[one] == value).mean() for value in (0.0, 0.5, 1.0)) > 0.1
    np.testing.assert_array_equal(found, expected)


def test_a_lens_larger_than_the_aperture_through_its_cells(session: Session, run_source: Runner) -> None:
    """The lens of a Gaussian has twice the radius, and so have its cells: an edge across it, from every tap, of
    pixels and of points."""
    psf, rng, count = Psf(model="gaussian"), np.random.default_rng(7), 20
    extent, turn = point_spread(psf).extent, rng.uniform(0, 2 * np.pi, count)
    radius = rng.choice([-1.0, 1.0], count) * rng.uniform(0.3, 4.0, count) / extent
    offset = rng.integers(-2, 3, (count, 2)) / 8
    slope = 0.5 / SOFT_BOX * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    h = np.concatenate([rng.uniform(-4, 4, (count, 1)), slope], axis=-1)
    source = np.concatenate([radius[:, None], offset, h], axis=-1).astype(np.float32)
    shares = empty(session, 4 * count * 15 * 15)
    run_source(
        THROUGH, "see_through", "double", FEATURES, count, np.int32(count),
        lens_floats(point_spread(psf)).astype(np.float32),
        np.float32(extent), source, shares,
    )  # fmt: skip
    found = download(session, shares, (count, 15, 15), np.float32)

    zero, none = np.zeros(count), np.zeros((count, 6))
    edge = Occluder(h, zero, none[:, :5], np.full(count, 2), none[:, :3], zero, none, none, zero, (), ())
    there = np.ones(count, dtype=bool)
    x, y = offset.T
    lean, limb = np.tile([0.03125, -0.25], (count, 1)), np.arange(count) % 2 == 1
    point = np.arange(count) // 2 % 2 == 1
    lens = extent, point_spread(psf).lens_cells(), none[:0, :3], lean, limb, zero
    visibility = Visibility(np.arange(count), radius, ~there, point, x, y, ((there, edge),), *lens)
    cells = cell_visibility(visibility)
    taps = range(-7, 8)
    expected = np.array([[tap_share(visibility, cells, float(dx), float(dy)) for dx in taps] for dy in taps])
    assert np.ptp(expected[7, 7]) > 0.5
    # Sums of 256 float32 each.
    np.testing.assert_allclose(found, np.moveaxis(expected, -1, 0), rtol=0, atol=1e-5)
