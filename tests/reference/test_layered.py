"""Layered occlusion: what a jump is, where layers are cut, what goes on behind an edge, what the layers add up to."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from clsco.constants import DISCONTINUITY, LAYER_BIN, NO_SEED
from clsco.optics.depth_layers import MOST_LAYERS, bins_of, layer_bounds, level_count
from clsco.reference.blur.blur import prepare_sources, scatter
from clsco.reference.layered.layered import (
    column_seeds,
    composite,
    extend_depth_layer,
    find_discontinuities,
    label_depth_layers,
    layered,
    open_depth_layer,
    pull,
    push,
    reach_hidden,
    seed_hidden,
    spread_depth_layers,
)
from clsco.reference.trace.trace import Sources
from clsco.scene.model import Psf
from tests.spreads import spec_of

Array = NDArray[Any]
Mask = NDArray[np.bool_]
PILLBOX = spec_of(Psf())
RNG = np.random.default_rng


def blob(shape: tuple[int, int]) -> Array:
    """A region (rows, columns) with curved and straight edges, corners and a hole."""
    y, x = np.indices(shape) - np.array(shape).reshape(2, 1, 1) // 2
    return (np.hypot(x + 6, y - 4) < 15) & ~(np.hypot(x + 8, y) < 4) | (np.abs(x - 14) < 5) & (y < 9)


def cuts(coc: Array, valid: Mask, largest: float) -> list[int]:
    reach = PILLBOX.psf.reach(largest)
    return layer_bounds(find_discontinuities(coc, valid, *bins_of(largest), 2 * reach + 1)[0].astype(np.int32))


def unsliced(radiance: Array, coc: Array, shape: tuple[int, int], guard: int) -> Array:
    there = np.ones(coc.shape, dtype=bool)
    sources = Sources(radiance, np.ones(coc.shape), there.astype(np.uint8), coc, prepare_sources(coc, there), there)
    return scatter(PILLBOX, sources, None, shape, guard)


def test_jumps_lie_between_neighbors_of_a_line() -> None:
    low, bins = bins_of(8.0)
    there = np.ones((1, 4), dtype=bool)

    def found(coc: list[float], valid: Array = there, far: int = 9) -> Array:
        return np.argwhere(find_discontinuities(np.array([coc]), valid, low, bins, far)[0])

    assert found([0.0, 0.0, DISCONTINUITY, DISCONTINUITY]).size == 0  # as much as allowed
    ((kind, far_bin),) = found([0.1, 0.1, 1.2, 1.2])
    assert (kind, far_bin) == (0, (1.2 - low) // LAYER_BIN)
    assert found([3.0, 3.0, -3.0, -3.0])[0, 0] == 2  # beyond 4 DISCONTINUITY
    assert len(found([-6.0, 0.0, 7.0, 7.0])) == 2
    gap = np.array([[True, False, True, False]])
    assert len(found([0.0, 99.0, 5.0, 0.0], gap)) == 1
    assert len(found([0.0, 99.0, 5.0, 0.0], gap, far=1)) == 0
    latest, largest_sum = find_discontinuities(np.array([[0.0], [-0.5], [2.2], [2.9]]), there.T, low, bins, 9)
    assert latest.any()
    assert largest_sum == 3  # 0.5 + 2.2, rounded up


def test_jumps_of_a_class_are_remembered_by_the_latest_near_side() -> None:
    low, bins = bins_of(8.0)
    coc = np.array([[0.0, 3.0], [0.9, 3.0]])
    latest, _ = find_discontinuities(coc, np.ones((2, 2), dtype=bool), low, bins, 9)
    ((_, far_bin),) = np.argwhere(latest)
    assert latest.max() - 1 == (0.9 - low) // LAYER_BIN
    assert far_bin == (3.0 - low) // LAYER_BIN


def test_bounds_split_every_jump_and_are_few() -> None:
    rng = RNG(3)
    low, bins = bins_of(16.0)
    for surfaces in (2, 3, 5):
        radii = np.linspace(-15, 15, surfaces)
        coc = radii[rng.integers(0, surfaces, (20, 24))] + rng.uniform(-0.4, 0.4, (20, 24))
        valid = rng.random(coc.shape) < 0.9
        bounds = cuts(coc, valid, 16.0)
        assert len(bounds) == surfaces - 1
        layer = label_depth_layers(coc, valid, low, bins, bounds)
        for axis in (0, 1):
            jump = (np.abs(np.diff(coc, axis=axis)) > DISCONTINUITY) & valid.take(range(1, coc.shape[axis]), axis)
            jump &= valid.take(range(coc.shape[axis] - 1), axis)
            assert (np.diff(layer.astype(int), axis=axis)[jump] != 0).all()
        assert (layer[~valid] == 0).all()
        assert layer.max() == surfaces


def test_without_a_jump_there_is_one_layer() -> None:
    y, x = np.indices((40, 40))
    assert cuts(np.asarray(0.9 * x - 18.0), np.ones((40, 40), dtype=bool), 20.0) == []
    assert cuts(np.asarray(9.0 * x), y < 0, 400.0) == []


def test_too_many_jumps_leave_the_smallest_alone() -> None:
    coc = np.repeat(np.array([-20.0, -18.5] * 8 + [0.0, 5.0, 6.5, 8.0, 9.5, 11, 12.5, 14, 15.5, 17]), 2)[None]
    there, (low, bins) = np.ones(coc.shape, dtype=bool), bins_of(20.0)
    bounds = layer_bounds(find_discontinuities(coc, there, low, bins, 9)[0].astype(np.int32))
    assert 0 < len(bounds) < MOST_LAYERS
    layer = label_depth_layers(coc, there, low, bins, bounds)[0]
    assert layer[30] < layer[32] < layer[34]  # -18.5, 0, 5
    noise = RNG(5).uniform(-20, 20, (30, 30))
    assert len(cuts(noise, np.ones(noise.shape, dtype=bool), 20.0)) < MOST_LAYERS


def test_seeds_lie_on_the_near_side_of_jumps_only() -> None:
    coc = np.array([[0.0, 0.5, 1.0, 5.0], [0.0, 0.5, 1.0, 5.0]])
    layer = np.array([[1, 1, 2, 3], [1, 1, 2, 0]], dtype=np.uint8)
    # Between 0.5 and 1.0 there is a cut and no jump; the last pixel of the second row holds nothing.
    assert seed_hidden(coc, layer).tolist() == [[0, 0, 3, 0], [0, 0, 0, 0]]


def test_the_nearest_seed_is_found() -> None:
    rng = RNG(7)
    seed = ((rng.random((30, 26)) < 0.02) * rng.integers(2, 4, (30, 26))).astype(np.uint8)
    layer = np.ones(seed.shape, dtype=np.uint8)
    deep = 6
    offset = column_seeds(seed)
    hidden, edge = reach_hidden(layer, seed, offset, deep)
    rows, columns = np.nonzero(seed)
    for y in range(30):
        for x in range(26):
            square = (rows - y) ** 2 + (columns - x) ** 2
            nearest = seed[rows, columns][square == square.min()]
            assert (hidden[y, x] in nearest) if square.min() <= deep**2 else hidden[y, x] == 0
            assert edge[y, x] == (np.maximum(abs(rows - y), abs(columns - x)).min() <= 2 * deep)
            same = rows[columns == x]
            assert abs(offset[y, x]) == (abs(same - y).min() if same.size else NO_SEED)
    assert reach_hidden(3 * layer, seed, offset, deep)[0].max() == 0  # nothing goes on in front of a pixel


@pytest.mark.parametrize("shape", [(16, 16), (7, 9), (1, 5), (2, 1)])
def test_a_pyramid_interpolates_what_is_missing(shape: tuple[int, int]) -> None:
    """Values between those known, known ones as they are, down to levels of one pixel."""
    rng = RNG(8)
    layer = (rng.random(shape) < 0.3).astype(np.uint8)
    layer.ravel()[0] = 1
    radiance, coc = rng.uniform(2, 3, (*shape, 2)), rng.uniform(4, 5, shape)
    levels = [open_depth_layer(radiance, coc, layer, 1)]
    while max(levels[-1].shape[:2]) > 1:
        levels.append(push(levels[-1], last=max(levels[-1].shape[:2]) == 2))
        assert levels[-1].shape[:2] == tuple(-(-n // 2) for n in levels[-2].shape[:2])
    assert levels[-1][..., -1].min() == 1
    coarse = levels.pop()
    while levels:
        coarse = pull(levels.pop(), coarse)
    np.testing.assert_array_equal(coarse[..., -1], 1.0)
    np.testing.assert_array_equal(coarse[layer > 0][:, :2], radiance[layer > 0])
    assert coarse[..., :2].min() > 2 - 1e-12
    assert coarse[..., :2].max() < 3 + 1e-12
    assert coarse[..., 2].min() > 4 - 1e-12
    assert coarse[..., 2].max() < 5 + 1e-12


@pytest.mark.parametrize("deep", [1, 2, 3, 6, 7])
def test_a_pyramid_shows_what_is_near_and_nothing_else(deep: int) -> None:
    """One pixel of a layer: all up to deep + 1 px away look like it; what is far away changes no bit."""
    size, step = 160, 1 << level_count(deep)
    assert deep + 2 <= step < 2 * (deep + 2)
    y, x = np.indices((size, size))
    for row, column in ((70, 71), (79, 80), (87, 88), (83, 69)):
        layer = ((y == row) & (x == column)).astype(np.uint8)
        radiance, coc = np.where(layer, 0.3, 0.0)[..., None], np.where(layer, -2.0, 9.0)
        near = np.maximum(abs(y - row), abs(x - column)) <= deep + 1
        hidden = ((layer == 0) & near).astype(np.uint8)
        value, radius, there = extend_depth_layer(radiance, coc, layer, hidden, 1, deep)
        assert (there == near).all()
        np.testing.assert_allclose(value[there], [[0.3, 1.0]] * int(there.sum()), rtol=0, atol=1e-15)
        np.testing.assert_allclose(radius[there], -2.0, rtol=0, atol=1e-14)
        away = abs(y - row) > deep + 1 + 4 * step
        layer = np.where(away & (RNG(9).random(layer.shape) < 0.5), 1, layer).astype(np.uint8)
        lit = np.where(away, 1.0, radiance[..., 0])[..., None]
        other, _, _ = extend_depth_layer(lit, coc, layer, hidden, 1, deep)
        assert away.any()
        np.testing.assert_array_equal(other[~away], value[~away])


def test_composite_fills_the_room_that_is_left() -> None:
    zero = np.zeros((1, 4))
    total, covered = composite(zero[..., None], zero, np.array([[[0.4, 0.5], [0.9, 1.2], [0.0, 0.0], [0.2, 1.0]]]))
    np.testing.assert_array_equal(total[0, :, 0], [0.4, 0.9, 0.0, 0.2])  # nothing dims the nearest
    total, covered = composite(total, covered, np.array([[[0.3, 0.5], [0.6, 1.2], [0.8, 1.0], [0.7, 0.0]]]))
    np.testing.assert_allclose(total[0, :, 0], [0.7, 0.9, 0.8, 0.9], atol=1e-15)  # beside, behind, alone, uncounted
    np.testing.assert_allclose(covered[0], [1.0, 1.2, 1.0, 1.0], atol=1e-15)


@pytest.mark.parametrize("texture", ["noise", "ramp"])
def test_a_cut_through_a_continuous_surface_leaves_no_seam(texture: str) -> None:
    guard, shape = 12, (40, 44)
    size = (shape[0] + 2 * guard, shape[1] + 2 * guard)
    y, x = np.indices(size)
    coc = 0.13 * (x - 30) + 0.06 * (y - 30)
    radiance = (RNG(1).random(size) if texture == "noise" else x / 70.0)[..., None]
    layer = (1 + np.searchsorted(np.quantile(coc, [0.25, 0.5, 0.75]), coc)).astype(np.uint8)
    cut, count = spread_depth_layers(PILLBOX, radiance, coc, layer, shape, guard, 20)
    assert count == 4
    np.testing.assert_array_equal(cut, unsliced(radiance, coc, shape, guard))  # nothing is covered: light adds up


def test_an_edge_before_a_plane_is_its_closed_form() -> None:
    """A dark half-plane before a bright plane: 1 - the disc's area beyond the edge, averaged over each pixel."""
    guard, shape = 22, (5, 60)
    size = (shape[0] + 2 * guard, shape[1] + 2 * guard)
    near = np.broadcast_to(np.arange(size[1]) < guard + 30, size)
    radius, behind = 7.3, 6.1
    for sign in (1, -1):
        coc = np.where(near, -radius, sign * behind) if sign > 0 else np.where(near, -radius, -radius + 3)
        image, count = layered(spec_of(Psf(), 8.0), np.where(near, 0.0, 1.0)[..., None], coc, near | True, shape, guard)
        assert count == 2
        # Across the edge at 29.5, a mean of the edge's spread over 400 points per pixel, which is right to 1e-6.
        at = np.arange(shape[1])[:, None] + (np.arange(400) + 0.5) / 400 - 0.5 - 29.5
        t = np.clip(at / radius, -1, 1)
        bright = (0.5 + (t * np.sqrt(1 - t * t) + np.arcsin(t)) / np.pi).mean(axis=1)
        np.testing.assert_allclose(image[..., 0], np.broadcast_to(bright, shape), rtol=0, atol=3e-6)


def test_one_brightness_everywhere_stays_so() -> None:
    """Two facing planes of the same brightness: what one covers, the other lacks, whatever the outline is."""
    shape, largest = (40, 44), 5.0
    guard = PILLBOX.psf.reach(largest)
    size = (shape[0] + 2 * guard, shape[1] + 2 * guard)
    for near_radius, far_radius in ((-4.0, 5.0), (-0.3, 4.5), (1.0, 4.0), (-5.0, -1.2)):
        coc = np.where(blob(size), near_radius, far_radius)
        light, there = np.full((*size, 1), 0.6), np.ones(size, dtype=bool)
        image, count = layered(spec_of(Psf(), largest), light, coc, there, shape, guard)
        assert count == 2
        np.testing.assert_allclose(image, 0.6, rtol=0, atol=1e-12)


def test_a_sharp_object_before_a_blurred_plane_keeps_its_edge() -> None:
    guard, shape = 12, (40, 44)
    near = blob((shape[0] + 2 * guard, shape[1] + 2 * guard))
    light, coc = np.where(near, 0.0, 1.0)[..., None], np.where(near, 0.0, 8.0)
    image, _ = layered(spec_of(Psf(), 8.0), light, coc, near | True, shape, guard)
    np.testing.assert_allclose(image[..., 0], ~near[guard:-guard, guard:-guard], rtol=0, atol=1e-12)
