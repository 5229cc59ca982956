"""The forward warp: depth test, ties, half-pixel shifts, and the thesis' counts of missing pixels."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from clsco.constants import NO_WINNER
from clsco.optics.motion import Pose, pose_at
from clsco.optics.quadrics import PlacedSurface, place
from clsco.reference.common.geometry import Array, pixel_ray, rest_pixel, sample_texture, solve_quadric
from clsco.reference.inpainting.fill import Method, fill_objects, mark_missing
from clsco.reference.trace.trace import padded_grid
from clsco.reference.warp.warp import (
    Reprojected,
    nearest_pixel,
    reproject,
    reproject_depth,
    reproject_gaps,
    reproject_gather,
    reproject_rest,
    reproject_winner,
)
from clsco.scene.model import Camera, DepthMap, Motion, Object, ObjectMotion, Plane, Scene
from tests.scenes import scene_of
from tests.slow import mostly_slow

Placer = Callable[..., PlacedSurface]


def warp(at: Placer, item: Object, shape: tuple[int, int], guard: int = 0) -> tuple[Any, ...]:
    """Known, radiance and inverse depth after 1 s, and the texture."""
    texture = np.random.default_rng(3).random((*shape, 1))
    scene = scene_of(item, size=shape[::-1])
    pose = pose_at(item.motion, 1.0, "euler")
    found = reproject(scene, [texture], [at(item)], [None], [pose], guard)
    return found.known, found.radiance, found.inverse_depth, texture


@pytest.mark.parametrize(
    ("motion", "count", "guard"),
    [
        (ObjectMotion(velocity=(0.0, 0.0, -10.0)), 19680, 5),  # figure 4.14
        (ObjectMotion(angular_velocity=(0.0, 0.0, 45.0)), 36993, 0),  # figure 4.15
    ],
)
def test_missing_pixels_of_the_thesis(motion: ObjectMotion, count: int, guard: int, at: Placer) -> None:
    known, radiance, w, _ = warp(at, Plane(motion=motion), (512, 512), guard)
    values = np.concatenate([radiance, w[..., None]], axis=-1)
    *_, report = fill_objects(values, np.zeros(known.shape, np.uint8), known, None, "ait", guard, far=False)
    assert report.filled_first_sweep == count
    assert report.unfilled_pixels == 0
    # The crossings of 20 missing rows with 20 missing columns wait for the second sweep.
    crossings = 400 if motion.velocity[2] else 0
    assert (report.missing_pixels, report.sweeps) == (count + crossings, 2 if crossings else 1)


@pytest.mark.parametrize("shift_px", [0.0, 0.25, 0.5, 0.75, 1.0, -0.5, 2.5])
@pytest.mark.parametrize("shape", [(30, 41), (32, 40)])
def test_shift_leaves_no_holes(shift_px: float, shape: tuple[int, int], at: Placer) -> None:
    speed = shift_px * 0.125  # 1 px is 0.125 mm at 250 mm
    item = Plane(motion=ObjectMotion(velocity=(speed, -speed, 0.0)))
    known, radiance, w, texture = warp(at, item, shape)
    pixels = int(np.floor(shift_px + 0.5))  # right and down
    inside = np.zeros(shape, dtype=bool)
    rows, columns = (slice(max(pixels, 0), n + min(pixels, 0)) for n in shape)
    inside[rows, columns] = True
    assert (known == inside).all()
    shifted = np.roll(texture, (pixels, pixels), axis=(0, 1))
    assert (radiance[inside] == shifted[inside]).all()
    np.testing.assert_allclose(w[inside], 1 / 250.0, rtol=1e-15)
    assert not radiance[~inside].any()
    assert not w[~inside].any()


@pytest.mark.parametrize(("angle", "turns"), [(90.0, -1), (180.0, -2), (-90.0, 1)])
@pytest.mark.parametrize("side", [24, 25])
def test_quarter_turns_are_exact(angle: float, turns: int, side: int, at: Placer) -> None:
    item = Plane(motion=ObjectMotion(angular_velocity=(0.0, 0.0, angle)))
    known, radiance, _, texture = warp(at, item, (side, side))
    assert known.all()
    assert (radiance == np.rot90(texture, turns)).all()  # rot90 turns against the clock


def test_guard_keeps_what_leaves_the_frame(at: Placer) -> None:
    item = Plane(motion=ObjectMotion(velocity=(0.375, 0.0, 0.0)))  # 3 px
    known, radiance, _, texture = warp(at, item, (20, 30), guard=5)
    expected = np.zeros((30, 40), dtype=bool)
    expected[5:25, 8:38] = True
    assert (known == expected).all()
    assert (radiance[5:25, 8:38] == texture).all()


def test_depth_test_by_hand() -> None:
    target = np.array([0, 2, 2, 2, -1, 1, 1])
    key = np.array([0.5, 0.1, 0.3, 0.3, 0.9, 0.2, 0.1], dtype=np.float32)
    depth = reproject_depth(target, key, 4)
    assert depth.tolist() == [0.5, np.float32(0.2), np.float32(0.3), 0.0]
    winner = reproject_winner(target, key, depth)
    assert winner.tolist() == [0, 5, 2, NO_WINNER]  # of the equal sources 2 and 3 the first
    known, values = reproject_gather(winner, np.arange(14.0).reshape(7, 2))
    assert known.tolist() == [True, True, True, False]
    assert values.tolist() == [[0.0, 1.0], [10.0, 11.0], [4.0, 5.0], [0.0, 0.0]]


def test_nearest_pixel_rounds_halves_up_and_ignores_the_last_digits() -> None:
    position = np.array([0.5, 0.5 - 1e-10, 0.5 + 1e-10, -0.5, -0.5 - 1e-10, 1.4998, 0.4997, -1.5, 1e300])
    assert nearest_pixel(position).tolist() == [1, 1, 1, 0, 0, 1, 0, -1, 10**9]


def test_what_moves_behind_the_lens_is_gone(at: Placer) -> None:
    item = Plane(motion=ObjectMotion(velocity=(0.0, 0.0, -300.0)))
    known, _, _, _ = warp(at, item, (16, 16))
    assert not known.any()
    assert not mark_missing(known, None).any()


def test_gaps_by_hand() -> None:
    """A row of targets: sources 0 to 4 of a surface at 1, source 5 of one at 2 beside it, 6 and 7 far behind at 9."""
    no, near, other, far = NO_WINNER, 1.0, 0.5, 1 / 9.0
    for winner, expected in (
        ([0, 6, 1, 2], [1, 0, 1, 1]),  # between neighbors at rest
        ([0, 6, 2, 1], [1, 1, 1, 1]),  # between others
        ([0, no, 6, 1], [1, 0, 0, 1]),
        ([0, 6, 7, no, 1], [1, 0, 0, 0, 1]),
        ([0, 6, no, no, no, 1], [1, 1, 0, 0, 0, 1]),  # too wide
        ([4, 6, 5], [1, 1, 1]),  # two surfaces: what lies behind is seen between them
        ([6, 0, 7, 5], [1, 1, 1, 1]),
    ):
        depth = [{5: other, 6: far, 7: far, no: 0.0}.get(k, near) for k in winner]
        planes = np.array([winner]), np.array([depth], dtype=np.float32)
        for turned in (planes, tuple(plane.T for plane in planes), tuple(np.diag(plane[0]) for plane in planes)):
            wins = np.where(turned[1] > 0, turned[0], no)
            valid = reproject_gaps(wins, turned[1], 8)
            line = np.diag(valid) if valid.shape[0] == valid.shape[1] else valid.ravel()
            assert line.tolist() == [bool(k) for k in expected], winner


CARD = ((-1.5, 1.5), (-1.5, 1.5), (-1.0, 1.0))


def two_objects(side: int, motion: ObjectMotion, *, mapped: bool = False) -> tuple[Scene, list[Array], list[Any]]:
    """A card at 200 mm before a plane at 380 mm with smooth textures, and inverse depths where they are depth maps."""
    card = Plane(name="card", distance=200.0, bounds=CARD, motion=motion)
    items: tuple[Object, ...] = (card, Plane(name="far", distance=380.0, slope_x=0.3))
    camera = Camera(resolution=(side, side))
    i, j = np.indices((side, side))
    waves = 0.25 + 0.1 * np.sin(i / 17) + 0.1 * np.cos(j / 23)
    textures = [(waves + 0.45)[..., None], waves[..., None]]
    maps: list[Any] = [None, None]
    if mapped:
        rays = pixel_ray(camera, *padded_grid(camera, 0))
        maps[0] = solve_quadric(place(card, pose_at(motion, 0.0, "euler")), CARD, rays)[0]
        items = (DepthMap(name="card", depth="card.npy", center=(0.0, 0.0, 200.0), motion=motion), items[1])
    return Scene(camera=camera, objects=items, motion=Motion(warp="forward")), textures, maps


def poses_of(scene: Scene, time: float) -> list[Pose]:
    return [pose_at(item.motion, time, "euler") for item in scene.objects]


def warped(scene: Scene, textures: list[Array], maps: list[Any]) -> tuple[Reprojected, Array, Array, Array]:
    """Pixels after 1 s, their values, and radiance and object (rows, columns) by rays cast at the moved surfaces."""
    still = [place(item, pose) for item, pose in zip(scene.objects, poses_of(scene, 0.0), strict=True)]
    new = reproject(scene, textures, still, maps, poses_of(scene, 1.0), 0)
    return new, np.concatenate([new.radiance, new.inverse_depth[..., None]], axis=-1), *seen_truth(scene, textures)


def seen_truth(scene: Scene, textures: list[Array]) -> tuple[Array, Array]:
    """Radiance and object (rows, columns) by rays cast at the moved surfaces."""
    poses = poses_of(scene, 1.0)
    rays = pixel_ray(scene.camera, *padded_grid(scene.camera, 0))
    nearest, radiance, seen = np.zeros(rays.shape[:2]), np.zeros(rays.shape[:2]), np.full(rays.shape[:2], 255)
    for k, (item, pose) in enumerate(zip(scene.objects, poses, strict=True)):
        surface = place(item, pose)
        w = solve_quadric(surface, item.bounds, rays)[0]
        row, column, _ = rest_pixel(surface, scene.camera, rays, w)
        value = sample_texture(textures[k][..., 0], row, column, "bicubic")
        nearer = w > nearest
        nearest, radiance = np.where(nearer, w, nearest), np.where(nearer, value, radiance)
        seen = np.where(nearer, k, seen)
    return radiance, seen


def decibels(found: Array, truth: Array) -> float:
    return float(-10 * np.log10(((found - truth) ** 2).mean()))


@pytest.mark.parametrize("mapped", [False, True])
def test_each_source_moves_with_its_object(mapped: bool) -> None:
    scene, textures, maps = two_objects(80, ObjectMotion(velocity=(0.6, 0.0, 0.0)), mapped=mapped)
    triples = zip(scene.objects, poses_of(scene, 0.0), maps, strict=True)
    rest = [None if depth is not None else place(item, pose) for item, pose, depth in triples]
    w, whose = reproject_rest(scene, rest, maps)
    assert (whose == 0).sum() == 30 * 30  # 3 mm at 200 mm
    assert (1 / w[whose == 0] == pytest.approx(200.0)) is True
    found = reproject(scene, textures, rest, maps, poses_of(scene, 1.0), 0)
    moved = np.roll(whose == 0, 6, axis=1)  # 0.6 mm at 200 mm
    uncovered = (whose == 0) & ~moved
    assert (found.known == ~uncovered).all()
    assert (found.object == np.where(moved, 0, np.where(uncovered, 255, 1))).all()
    assert (found.radiance[moved] == np.roll(textures[0], 6, axis=1)[moved]).all()
    assert (found.radiance[found.object == 1] == textures[1][found.object == 1]).all()


RIGHT, DIAGONAL = ObjectMotion(velocity=(1.2, 0.0, 0.0)), ObjectMotion(velocity=(1.5, 0.9, 0.0))
TURNING, RECEDING = ObjectMotion(angular_velocity=(0.0, 40.0, 0.0)), ObjectMotion(velocity=(0.0, 0.0, 60.0))


@pytest.mark.parametrize(
    ("motion", "after", "method"),
    mostly_slow(
        [(RIGHT, 31.0, "ait"), (DIAGONAL, 31.0, "mean_median"), (TURNING, 42.0, "ait"), (RECEDING, 42.0, "mean_median"),
         (RIGHT, 31.0, "mean_median"), (DIAGONAL, 31.0, "ait")],
        [(DIAGONAL, 31.0, "mean_median"), (TURNING, 42.0, "ait")],
    ),
)  # fmt: skip
def test_what_is_uncovered_shows_what_is_behind(motion: ObjectMotion, after: float, method: Method) -> None:
    """Against rays cast at the moved surfaces, in dB of the uncovered pixels: filled across the edge, and from afar.

    Across it 10 to 16 dB. From afar what smooth textures leave, of which so much is guessed from the border of the
    hole: 32 to 33 dB of 12 and 15 px, 43 to 45 dB of 3 and 4 px.
    """
    scene, textures, maps = two_objects(120, motion)
    new, values, truth, seen = warped(scene, textures, maps)
    uncovered = ~new.known
    assert uncovered.sum() > 150
    found = {}
    for far in (False, True):
        filled, objects, status, _ = fill_objects(values, new.object, new.known, None, method, 0, far)
        assert (status == uncovered).all()
        found[far] = decibels(filled[..., 0][uncovered], truth[uncovered])
    assert (objects == seen)[uncovered].all()
    assert found[False] < 17.0
    assert found[True] > after


@pytest.mark.parametrize("depth_mm", [170.0, 100.0])
def test_a_card_that_comes_nearer_stays_closed(depth_mm: float) -> None:
    """Otherwise the plane behind shows in every gap between its pixels, where a pixel of the plane happens to come."""
    scene, textures, maps = two_objects(120, ObjectMotion(velocity=(0.0, 0.0, depth_mm - 200.0)))
    new, values, truth, seen = warped(scene, textures, maps)
    filled, objects, status, _ = fill_objects(values, new.object, new.known, None, "ait", 0)
    # The outermost pixels of the card at rest end half a pixel, as large as it is now, inside its outline.
    inner = seen == 0
    for _ in range(2):
        inner &= np.roll(inner, 1, 0) & np.roll(inner, -1, 0) & np.roll(inner, 1, 1) & np.roll(inner, -1, 1)
    assert inner.sum() > 600
    assert (status[inner] == 1).any()
    assert (objects[inner] == 0).all()
    assert decibels(filled[..., 0][inner], truth[inner]) > 50
