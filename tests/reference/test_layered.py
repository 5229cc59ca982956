"""Layered occlusion: what a jump is, where layers are cut, what goes on behind an edge, what the layers add up to."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from clsco.constants import DISCONTINUITY, LAYER_BIN, LAYER_TILE
from clsco.optics.depth_layers import MOST_LAYERS, bins_of, layer_bounds, level_count
from clsco.reference.blur.blur import prepare_sources, scatter
from clsco.reference.layered.layered import (
    composite,
    composite_quadrants,
    find_discontinuities,
    find_edges,
    label_depth_layers,
    layered,
    mark_tiles,
    over,
    pull,
    push,
    take_sheet,
    unmix,
)
from clsco.reference.trace.trace import Sources
from clsco.scene.model import Psf
from tests.spreads import spec_of

Array = NDArray[Any]
Mask = NDArray[np.bool_]
Labels = NDArray[np.uint8]
PILLBOX = spec_of(Psf())
RNG = np.random.default_rng


def blob(shape: tuple[int, int]) -> Array:
    """A region (rows, columns) with curved and straight edges, corners and a hole."""
    y, x = np.indices(shape) - np.array(shape).reshape(2, 1, 1) // 2
    return (np.hypot(x + 6, y - 4) < 15) & ~(np.hypot(x + 8, y) < 4) | (np.abs(x - 14) < 5) & (y < 9)


def cuts(coc: Array, valid: Mask, largest: float) -> list[int]:
    reach = PILLBOX.psf.reach(largest)
    return layer_bounds(find_discontinuities(coc, valid, *bins_of(largest), 2 * reach + 1).astype(np.int32))


def unsliced(radiance: Array, coc: Array, shape: tuple[int, int], guard: int) -> Array:
    there = np.ones(coc.shape, dtype=bool)
    sources = Sources(radiance, np.ones(coc.shape), there.astype(np.uint8), coc, prepare_sources(coc, there), there)
    return scatter(PILLBOX, sources, None, shape, guard)


def test_jumps_lie_between_neighbors_of_a_line() -> None:
    low, bins = bins_of(8.0)
    there = np.ones((1, 4), dtype=bool)

    def found(coc: list[float], valid: Array = there, far: int = 9) -> Array:
        return np.argwhere(find_discontinuities(np.array([coc]), valid, low, bins, far))

    assert found([0.0, 0.0, DISCONTINUITY, DISCONTINUITY]).size == 0  # as much as allowed
    ((kind, far_bin),) = found([0.1, 0.1, 1.2, 1.2])
    assert (kind, far_bin) == (0, (1.2 - low) // LAYER_BIN)
    assert found([3.0, 3.0, -3.0, -3.0])[0, 0] == 2  # beyond 4 DISCONTINUITY
    assert len(found([-6.0, 0.0, 7.0, 7.0])) == 2
    gap = np.array([[True, False, True, False]])
    assert len(found([0.0, 99.0, 5.0, 0.0], gap)) == 1
    assert len(found([0.0, 99.0, 5.0, 0.0], gap, far=1)) == 0
    assert find_discontinuities(np.array([[0.0], [-0.5], [2.2], [2.9]]), there.T, low, bins, 9).any()


def test_jumps_of_a_class_are_remembered_by_the_latest_near_side() -> None:
    low, bins = bins_of(8.0)
    coc = np.array([[0.0, 3.0], [0.9, 3.0]])
    latest = find_discontinuities(coc, np.ones((2, 2), dtype=bool), low, bins, 9)
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
    bounds = layer_bounds(find_discontinuities(coc, there, low, bins, 9).astype(np.int32))
    assert 0 < len(bounds) < MOST_LAYERS
    layer = label_depth_layers(coc, there, low, bins, bounds)[0]
    assert layer[30] < layer[32] < layer[34]  # -18.5, 0, 5
    stairs = np.repeat(np.arange(12) * 3.0 - 18.0, 2)[None].repeat(2, axis=0)  # all of one class
    assert len(cuts(stairs, np.ones(stairs.shape, dtype=bool), 20.0)) == MOST_LAYERS - 1
    noise = RNG(5).uniform(-20, 20, (30, 30))
    assert len(cuts(noise, np.ones(noise.shape, dtype=bool), 20.0)) < MOST_LAYERS


def test_sides_of_edges_are_the_layers_that_meet() -> None:
    coc = np.array([[0.0, 0.5, 1.0, 5.0], [0.0, 0.5, 1.0, 5.0]])
    layer = np.array([[1, 1, 2, 3], [1, 1, 2, 0]], dtype=np.uint8)
    near, far, edge = find_edges(coc, layer)
    # Between 0.5 and 1.0 there is a cut and no jump; the last pixel of the second row holds nothing.
    assert near.tolist() == [[0, 0, 2, 2], [0, 0, 0, 0]]
    assert far.tolist() == [[0, 0, 3, 3], [0, 0, 0, 0]]
    assert edge.tolist() == [[True, True, True, True], [True, True, True, False]]  # 0.5 px are uneven
    assert not find_edges(0.02 * coc, layer)[2][0, :3].any()
    assert find_edges(0.02 * coc - 0.005, layer)[2][0].tolist() == [True, True, False, True]  # the focus between them


def test_tiles_in_reach_of_an_edge_are_marked() -> None:
    edge = np.zeros((80, 112), np.bool_)
    edge[20, 20] = True
    tiles = np.array([[1, 1, 1, 0, 0, 0, 0]] * 3 + [[0] * 7] * 2, np.bool_)
    for reach, marked in ((1, tiles), (16, tiles), (0, tiles & (np.indices(tiles.shape) == 1).all(axis=0))):
        found = mark_tiles(np.full(edge.shape, reach), edge)
        np.testing.assert_array_equal(found, marked.repeat(LAYER_TILE, 0).repeat(LAYER_TILE, 1))
    wide = np.ones(edge.shape, np.int64)
    wide[:, 100] = 60  # reaches the tiles that the edge is within 60 px of
    assert mark_tiles(wide, edge)[0, ::LAYER_TILE].tolist() == [True] * 6 + [False]
    assert not mark_tiles(wide, edge & False).any()


@pytest.mark.parametrize("angle", [0.0, 0.4])
def test_mixed_pixels_are_parted(angle: float) -> None:
    """Two textures that meet in a line, seen by pixels that average 16 x 16 points: the share of one comes back."""
    size, fine = 40, 16
    y, x = (np.indices((size * fine, size * fine)) + 0.5) / fine - 0.5
    inside = ((x - 19.2) * np.cos(angle) + (y - 20.1) * np.sin(angle) < 0).reshape(size, fine, size, fine).mean((1, 3))
    grain = RNG(4).normal(0, 0.01, (size, size, 3))
    colors = np.array([0.8, 0.2, 0.1]) + grain, np.array([0.1, 0.3, 0.6]) + grain[::-1]
    radiance = inside[..., None] * colors[0] + (1 - inside[..., None]) * colors[1]
    layer = np.where(inside > 0.5, 1, 2).astype(np.uint8)
    near, far, _ = find_edges(np.where(layer == 1, -3.0, 3.0), layer)
    first, second, share = unmix(radiance, layer, near, far)
    at = near > 0
    assert np.abs(share - inside)[at].max() < 0.04
    mixed = share[..., None] * first + (1 - share[..., None]) * second
    np.testing.assert_allclose(mixed[at], radiance[at], rtol=0, atol=0.03)  # but for the grain
    assert np.abs(first - colors[0])[at & (inside > 0.2)].max() < 0.1
    assert np.abs(second - colors[1])[at & (inside < 0.8)].max() < 0.1


@pytest.mark.parametrize("shape", [(16, 16), (7, 9), (1, 5), (2, 1)])
def test_a_pyramid_interpolates_what_is_missing(shape: tuple[int, int]) -> None:
    """Values between those known, known ones as they are, down to levels of one pixel."""
    rng = RNG(8)
    layer = (rng.random(shape) < 0.3) * 1.0
    layer.ravel()[0] = 1.0
    radiance, coc = rng.uniform(2, 3, (*shape, 2)), rng.uniform(4, 5, shape)
    levels: list[Array] = [np.concatenate([radiance, coc[..., None], np.ones((*shape, 1))], axis=-1) * layer[..., None]]
    while max(levels[-1].shape[:2]) > 1:
        levels.append(push(levels[-1]))
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
    """One pixel of a layer: all up to `deep` px away look like it; what is far away changes no bit."""
    size, step = 160, 1 << level_count(deep)
    y, x = np.indices((size, size))
    for row, column in ((70, 71), (79, 80), (87, 88), (83, 69)):
        layer = ((y == row) & (x == column)).astype(np.uint8)
        near = np.maximum(abs(y - row), abs(x - column)) <= deep
        found = sheet_of(np.where(layer, 0.3, 0.0), np.where(layer, -2.0, 9.0), layer, level_count(deep))
        np.testing.assert_allclose(found[near][:, 1], -2.0, rtol=0, atol=1e-14)
        away = np.maximum(abs(y - row), abs(x - column)) > deep + 2 * step
        layer = np.where(away & (RNG(9).random(layer.shape) < 0.5), 1, layer).astype(np.uint8)
        other = sheet_of(np.where(away, 1.0, 0.3), np.where(away, 1.0, -2.0), layer, level_count(deep))
        assert away.any()
        np.testing.assert_array_equal(other[near], found[near])


def sheet_of(light: Array, coc: Array, layer: Labels, levels: int, which: int = 1) -> Array:
    """Radiance and radius (H, W, 2) of a layer."""
    none = np.zeros_like(layer)
    parts = np.zeros((*layer.shape, 1)), np.zeros((*layer.shape, 1)), np.zeros(layer.shape)
    sheet, radius = take_sheet(light[..., None], np.ones(layer.shape), coc, layer, (none, none), parts, which, levels)
    return np.stack([sheet[..., 0], radius], axis=-1)


def test_an_outline_goes_on_behind_what_is_nearer() -> None:
    """A bar before a plane, both behind a disc: the bar's outline is joined, farther layers leave it free."""
    y, x = np.indices((64, 64))
    layer = np.where(np.hypot(y - 31.5, x - 31.5) < 7, 1, np.where(abs(x - 31.5) < 12, 2, 3)).astype(np.uint8)
    none, parts = np.zeros_like(layer), (np.zeros((64, 64, 1)), np.zeros((64, 64, 1)), np.zeros((64, 64)))
    coc = np.choose(layer, [0.0, -6.0, 0.5, 5.0])
    second, radius = take_sheet(np.ones((64, 64, 1)), np.ones((64, 64)), coc, layer, (none, none), parts, 2, 6)
    np.testing.assert_array_equal(second[..., 1], layer < 3)
    np.testing.assert_allclose(radius, 0.5, rtol=0, atol=1e-12)
    last, _ = take_sheet(np.ones((64, 64, 1)), np.ones((64, 64)), coc, layer, (none, none), parts, 3, 6)
    assert last[31, 31, 1] == 1
    wall = np.where(layer == 1, 1, 2).astype(np.uint8)
    pixels = np.ones((64, 64, 1)), np.ones((64, 64)), np.choose(wall, [0.0, 0.1, 0.0]), wall
    behind, _ = take_sheet(*pixels, (none, none), parts, 2, 6)
    np.testing.assert_array_equal(behind[..., 1], 1.0)  # 0.1 and 0 px are one surface


def test_a_slanted_surface_goes_on_beyond_a_cut_wherever_that_is() -> None:
    for cut in range(64, 130):
        below = np.indices((160, 8))[0] - cut
        sheet = sheet_of(np.ones((160, 8)), 0.1 * below, (1 + (below >= 0)).astype(np.uint8), 6, which=2)
        np.testing.assert_array_equal(sheet[cut - 1, :, 1], -0.1)


def test_composite_takes_the_room_that_is_left() -> None:
    total, room = np.zeros((1, 3, 1)), np.array([[1.0, 1.0, 0.5]])
    total, room = composite(total, room, np.array([[[0.4, 0.5, 1.0], [0.9, 1.2, 1.2], [0.2, 0.5, 0.5]]]))
    np.testing.assert_allclose(total[0, :, 0], [0.4, 0.75, 0.2], atol=1e-15)
    np.testing.assert_allclose(room[0], [0.5, 0.0, 0.0], atol=1e-15)
    total, room = composite(total, room, np.array([[[0.3, 0.5, 0.5], [0.6, 1.2, 1.0], [0.0, 0.0, 0.0]]]))
    np.testing.assert_allclose(total[0, :, 0], [0.7, 0.75, 0.2], atol=1e-15)
    np.testing.assert_allclose(room[0], [0.0, 0.0, 0.0], atol=1e-15)


def test_what_hides_one_side_of_the_lens_leaves_the_other_free() -> None:
    sums = np.array([[[[0.9, 0.5, 1.0]]], [[[0.5, 0.25, 0.5]]]]).repeat(2, axis=0) / 4.0
    total, room = composite_quadrants(np.zeros((1, 1, 2)), np.ones((1, 1, 4)), sums, np.full((1, 1), 9.0))
    np.testing.assert_allclose(total[0, 0], [0.7 / 0.75, 0.375 / 0.75], atol=1e-15)
    np.testing.assert_allclose(room[0, 0], 0.5, atol=1e-15)
    # Two edges above each other hide the same half of the lens from the wall, each of them alone.
    shape, guard = (5, 40), 14
    size = (shape[0] + 2 * guard, shape[1] + 2 * guard)
    mask = (np.indices(size)[1] < guard + 20)[..., None] * 1.0
    near = [(np.concatenate([0.0 * mask, mask], axis=-1), np.full(size, radius)) for radius in (-8.0, -6.5)]
    wall = np.ones((*size, 2)), np.full(size, 5.0)
    for cells, light in ((1, 0.25), (2, 0.5)):
        image = over(spec_of(Psf(), 8.0, cells=cells), [*near, wall], shape, guard)
        np.testing.assert_allclose(image[..., 19:21, 0].mean(axis=-1), light, rtol=0, atol=0.05)
        np.testing.assert_allclose(image[..., 1], 1.0, rtol=0, atol=1e-12)


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
        np.testing.assert_allclose(image[..., 0], np.broadcast_to(bright, shape), rtol=0, atol=4e-5)


ROUGH: dict[str, Callable[[Any, Any], Any]] = {
    "noise": lambda y, x: RNG(6).uniform(-4, 4, y.shape),
    "stairs": lambda y, x: np.floor(x / 8) * 2.0 - 5.0,
    "lines": lambda y, x: np.where((x % 9 == 4) | (y % 11 == 5), -4.0, 3.0),
    "a ramp through the focus behind a step": lambda y, x: np.where(x < 15, -3.0, 0.3 * (x - 30)),
    "a blob": lambda y, x: np.where(blob(y.shape), -0.3, 4.5),
}


@pytest.mark.parametrize("cells", [1, 2])
@pytest.mark.parametrize("name", ROUGH)
def test_one_brightness_everywhere_stays_so(name: str, cells: int) -> None:
    shape, guard = (40, 44), 8
    coc = ROUGH[name](*np.indices((shape[0] + 2 * guard, shape[1] + 2 * guard)))
    spec = spec_of(Psf(), float(np.abs(coc).max()), cells=cells)
    image, count = layered(spec, np.full((*coc.shape, 1), 0.6), coc, np.ones(coc.shape, bool), shape, guard)
    assert count >= 2
    marked = np.abs(image[..., 0] - unsliced(np.full((*coc.shape, 1), 0.6), coc, shape, guard)[..., 0]) > 0
    assert marked.any()
    np.testing.assert_allclose(image[marked], 0.6, rtol=0, atol=1e-12)


def test_plain_colors_do_not_bleed() -> None:
    """A red disc before a gray wall, seen by pixels that average: one of both is sharp."""
    side, fine = 64, 16
    y, x = (np.indices((side * fine, side * fine)) + 0.5) / fine - 0.5
    share = (np.hypot(x - 31.3, y - 32.2) < 17.4).reshape(side, fine, side, fine).mean((1, 3))[..., None]
    red, gray = np.array([0.8, 0.05, 0.05]), np.array([0.4, 0.45, 0.5])
    light, there = share * red + (1 - share) * gray, np.ones((side, side), np.bool_)
    for near, far in ((0.0, 8.0), (-8.0, 0.0)):
        coc = np.where(share[..., 0] > 0.5, near, far)
        image, _ = layered(spec_of(Psf(), 8.0), light, coc, there, (side - 20, side - 20), 10)
        alpha = unsliced(share, np.full(coc.shape, near), (side - 20, side - 20), 10) if near else share[10:-10, 10:-10]
        assert np.abs(image - (alpha * red + (1 - alpha) * gray)).max() < 0.005


def test_a_sharp_object_before_a_blurred_plane_keeps_its_edge() -> None:
    guard, shape = 12, (40, 44)
    near = blob((shape[0] + 2 * guard, shape[1] + 2 * guard))
    light, coc = np.where(near, 0.0, 1.0)[..., None], np.where(near, 0.0, 8.0)
    image, _ = layered(spec_of(Psf(), 8.0), light, coc, near | True, shape, guard)
    np.testing.assert_allclose(image[..., 0], ~near[guard:-guard, guard:-guard], rtol=0, atol=1e-3)


def test_images_over_each_other_are_one_picture_in_parts() -> None:
    """A foreground before a wall that goes on behind it: what it leaves free, the wall fills."""
    shape, guard = (40, 44), 10
    size = (shape[0] + 2 * guard, shape[1] + 2 * guard)
    mask, wall = blob(size)[..., None] * 1.0, RNG(3).uniform(0.2, 1.0, (*size, 1))
    front = np.concatenate([0.7 * mask, mask], axis=-1), np.full(size, -4.0)
    back = np.concatenate([wall, np.ones_like(wall)], axis=-1), np.full(size, 3.0)
    spec = spec_of(Psf(), 4.0)
    image = over(spec, [front, back], shape, guard)
    alpha, behind = (unsliced(*each, shape, guard) for each in ((mask, front[1]), (wall, back[1])))
    np.testing.assert_allclose(image[..., :1], 0.7 * alpha + (1 - alpha) * behind, rtol=0, atol=1e-12)
    np.testing.assert_allclose(image[..., 1], 1.0, rtol=0, atol=1e-12)
    alone = over(spec, [front], shape, guard)
    np.testing.assert_allclose(alone, np.concatenate([0.7 * alpha, alpha], axis=-1), rtol=0, atol=1e-12)
