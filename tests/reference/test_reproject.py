"""The forward warp: depth test, ties, half-pixel shifts, and the thesis' counts of missing pixels."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from clsco.motion import pose_at
from clsco.reference.fill import fill, mark_missing
from clsco.reference.reproject import (
    NO_WINNER,
    nearest_pixel,
    reproject,
    reproject_depth,
    reproject_gather,
    reproject_winner,
)
from clsco.scene import Object, ObjectMotion, Plane, Scene, Sphere
from clsco.surfaces import PlacedSurface

SceneMaker = Callable[..., Scene]
Placer = Callable[..., PlacedSurface]


def warp(make_scene: SceneMaker, at: Placer, item: Object, shape: tuple[int, int], guard: int = 0) -> tuple[Any, ...]:
    """Known, radiance and inverse depth after 1 s, and the texture."""
    texture = np.random.default_rng(3).random((*shape, 1))
    scene = make_scene(item, shape)
    pose = pose_at(item.motion, 1.0, "euler")
    found = reproject(scene, [texture], [at(item)], [None], [pose], guard)
    return found.known, found.radiance, found.inverse_depth, texture


@pytest.mark.parametrize(
    ("motion", "count"),
    [
        (ObjectMotion(velocity=(0.0, 0.0, -10.0)), 19680),  # figure 4.14
        (ObjectMotion(angular_velocity=(0.0, 0.0, 45.0)), 36993),  # figure 4.15
    ],
)
@pytest.mark.parametrize("guard", [0, 5])
def test_missing_pixels_of_the_thesis(
    motion: ObjectMotion, count: int, guard: int, make_scene: SceneMaker, at: Placer
) -> None:
    known, radiance, w, _ = warp(make_scene, at, Plane(motion=motion), (512, 512), guard)
    values = np.concatenate([radiance, w[..., None]], axis=-1)
    _, _, report = fill(values, known, None, "ait", guard)
    assert report.filled_first_sweep == count
    assert report.unfilled_pixels == 0
    # The crossings of 20 missing rows with 20 missing columns wait for the second sweep.
    crossings = 400 if motion.velocity[2] else 0
    assert (report.missing_pixels, report.sweeps) == (count + crossings, 2 if crossings else 1)


@pytest.mark.parametrize("shift_px", [0.0, 0.25, 0.5, 0.75, 1.0, -0.5, 2.5])
@pytest.mark.parametrize("shape", [(30, 41), (32, 40)])
def test_shift_leaves_no_holes(shift_px: float, shape: tuple[int, int], make_scene: SceneMaker, at: Placer) -> None:
    speed = shift_px * 0.125  # 1 px is 0.125 mm at 250 mm
    item = Plane(motion=ObjectMotion(velocity=(speed, -speed, 0.0)))
    known, radiance, w, texture = warp(make_scene, at, item, shape)
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
def test_quarter_turns_are_exact(angle: float, turns: int, side: int, make_scene: SceneMaker, at: Placer) -> None:
    item = Plane(motion=ObjectMotion(angular_velocity=(0.0, 0.0, angle)))
    known, radiance, _, texture = warp(make_scene, at, item, (side, side))
    assert known.all()
    assert (radiance == np.rot90(texture, turns)).all()  # rot90 turns against the clock


def test_guard_keeps_what_leaves_the_frame(make_scene: SceneMaker, at: Placer) -> None:
    item = Plane(motion=ObjectMotion(velocity=(0.375, 0.0, 0.0)))  # 3 px
    known, radiance, _, texture = warp(make_scene, at, item, (20, 30), guard=5)
    expected = np.zeros((30, 40), dtype=bool)
    expected[5:25, 8:38] = True
    assert (known == expected).all()
    assert (radiance[5:25, 8:38] == texture).all()


def test_nearer_surface_wins(make_scene: SceneMaker, at: Placer) -> None:
    """A sphere turned by a quarter: what was left and right of its pole projects to the same pixels."""
    item = Sphere(center=(0.0, 0.0, 280.0), radius=2.5, motion=ObjectMotion(angular_velocity=(0.0, 90.0, 0.0)))
    known, _, w, _ = warp(make_scene, at, item, (48, 48))
    assert known.sum() > 100
    # As many sources come to lie behind Z = 280 as before it. Through the gaps between the nearer a few show.
    assert (1 / w[known] < 280.0).mean() > 0.9


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


def test_depth_is_compared_in_float32() -> None:
    """Inverse depths that float32 does not tell apart are a tie, which the first source wins."""
    w = np.array([1 / 250.0, 1 / 250.0 * (1 + 1e-9)])
    key = w.astype(np.float32)
    target = np.zeros(2, dtype=np.int64)
    assert w[1] > w[0]
    assert reproject_winner(target, key, reproject_depth(target, key, 1))[0] == 0


def test_nearest_pixel_rounds_halves_up_and_ignores_the_last_digits() -> None:
    position = np.array([0.5, 0.5 - 1e-10, 0.5 + 1e-10, -0.5, -0.5 - 1e-10, 1.4998, 0.4997, -1.5, 1e300])
    assert nearest_pixel(position).tolist() == [1, 1, 1, 0, 0, 1, 0, -1, 10**9]


def test_what_moves_behind_the_lens_is_gone(make_scene: SceneMaker, at: Placer) -> None:
    item = Plane(motion=ObjectMotion(velocity=(0.0, 0.0, -300.0)))
    known, _, _, _ = warp(make_scene, at, item, (16, 16))
    assert not known.any()
    assert not mark_missing(known, None).any()
