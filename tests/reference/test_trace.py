"""Sources, silhouettes and ground truth, against closed forms and against each other."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from clsco.optics.lens import blur_radius, ray_step
from clsco.optics.point_spread import subpixel_offsets
from clsco.optics.quadrics import PlacedSurface
from clsco.optics.visibility import OcclusionGroup
from clsco.reference.common.geometry import pixel_ray, rest_pixel, solve_quadric
from clsco.reference.trace.trace import SILHOUETTE_RANGE, mark_silhouettes, padded_grid, trace, trace_subpixels, view_at
from clsco.reference.trace.truth import ground_truth
from clsco.reference.trace.view import View
from clsco.scene.model import Ellipsoid, ObjectMotion, Plane, Psf, Scene, Sequence, Sphere
from tests.scenes import scene_of

Placer = Callable[..., PlacedSurface]

SMALL_SPHERE = Sphere(center=(0.3, -0.2, 280.0), radius=2.5)
SHAPE = (40, 48)
SIZE = SHAPE[::-1]
ALONE = OcclusionGroup(1, 0)  # one object, and nothing in its way
EPS = np.finfo(np.float64).eps


def random_texture(channels: int = 1) -> NDArray[np.float64]:
    """Texture of SHAPE."""
    return np.random.default_rng(11).random((*SHAPE, channels))


def seen(scene: Scene, texture: NDArray[np.float64], time: float = 0.0, moved: bool = False) -> View:
    """A scene of one object as the camera sees it."""
    return view_at(scene, (texture,), time, "left", moved)


def test_sources_at_rest_are_the_texels() -> None:
    scene, texture = scene_of(Plane(distance=280.0, slope_x=0.5), size=SIZE), random_texture(3)
    sources = trace(seen(scene, texture), ALONE, 5)
    assert (sources.label > 0).all()
    assert (sources.radiance == np.pad(texture, ((5, 5), (5, 5), (0, 0)), mode="symmetric")).all()
    assert (sources.radius == blur_radius(scene.camera, sources.inverse_depth)).all()
    # R is linear over a plane: its differences are the gradient, but for eps of R.
    np.testing.assert_allclose(np.diff(sources.radius, axis=1), sources.gradient[:, :-1, 0], atol=1e-11)
    np.testing.assert_allclose(np.diff(sources.radius, axis=0), sources.gradient[:-1, :, 1], atol=1e-11)


def test_guard_sees_the_same_surface() -> None:
    scene, texture = scene_of(SMALL_SPHERE, size=SIZE), random_texture()
    wide, narrow = (trace(seen(scene, texture), ALONE, guard) for guard in (7, 0))
    assert 0.1 < (narrow.label > 0).mean() < 0.9
    for name in ("radiance", "inverse_depth", "label", "radius", "gradient"):
        assert (getattr(wide, name)[7:-7, 7:-7] == getattr(narrow, name)).all()
    assert not wide.radiance[wide.label == 0].any()
    assert not wide.radius[wide.label == 0].any()


def test_silhouettes_by_plain_search() -> None:
    label = (np.random.default_rng(9).random((20, 23)) < 0.01).astype(np.uint8) * 2
    marked = mark_silhouettes(label)
    assert 0.1 < marked.mean() < 0.9
    r = SILHOUETTE_RANGE
    for i, j in np.ndindex(label.shape):
        window = label[max(i - r, 0) : i + r + 1, max(j - r, 0) : j + r + 1]
        assert marked[i, j] == (window != label[i, j]).any()


@pytest.mark.parametrize("moved", [False, True])
def test_subpixels_are_rays_of_their_own(moved: bool, at: Placer) -> None:
    item = SMALL_SPHERE.model_copy(update={"motion": ObjectMotion(angular_velocity=(0.0, 30.0, 0.0))})
    scene, texture = scene_of(item, size=SIZE, psf=Psf(silhouette_samples=3)), random_texture(3)
    surface = at(item, 1.0 if moved else 0.0)
    view = seen(scene, texture, 1.0 if moved else 0.0, moved)
    own = trace(view, ALONE, 4)
    sub = trace_subpixels(view, ALONE, 4, mark_silhouettes(own.label))
    assert sub.hit.shape == (mark_silhouettes(own.label).sum(), 3, 3)
    assert 0.2 < sub.hit.mean() < 0.8
    np.testing.assert_allclose(subpixel_offsets(3), [-1 / 3, 0.0, 1 / 3])
    # Sources that no outline is beside: their cell and those around it are hit, or none of them.
    cells = np.repeat(np.repeat(own.label > 0, 3, axis=0), 3, axis=1)
    at_cell = (sub.row[:, None, None] * 3 + np.arange(3)[:, None], sub.column[:, None, None] * 3 + np.arange(3))
    cells[at_cell] = sub.hit
    around = np.lib.stride_tricks.sliding_window_view(np.pad(cells, 1, mode="edge"), (3, 3))
    whole = (around == cells[..., None, None]).all(axis=(-1, -2))[at_cell]
    assert 0.5 < whole.mean() < 0.9
    # The middle one is the pixel's own ray.
    at_pixel, middle = (sub.row, sub.column), whole[:, 1, 1]
    assert (sub.hit[:, 1, 1] == (own.label[at_pixel] > 0)).all()
    assert (sub.radius[:, 1, 1] == own.radius[at_pixel])[middle].all()
    hit = sub.hit[:, 1, 1] & middle
    assert (sub.radiance[hit, 1, 1] == own.radiance[at_pixel][hit]).all()
    # One row up and one column right of it: a grid three times as fine sees the same.
    i, j = 0, 2
    rays = pixel_ray(scene.camera, sub.row - 4 + (i - 1) / 3, sub.column - 4 + (j - 1) / 3)
    w, label = solve_quadric(surface, None, rays)
    assert (sub.hit[:, i, j] == (label > 0)).all()
    expected = np.where(label > 0, blur_radius(scene.camera, w), 0.0)
    there = whole[:, i, j]
    np.testing.assert_allclose(sub.radius[there, i, j], expected[there], atol=1e-6)
    if not moved:
        # They share the pixel's texel, times the cells that they cover, and have no light where nothing is hit.
        texel = np.pad(texture, ((4, 4), (4, 4), (0, 0)), mode="symmetric")[at_pixel][:, None, None]
        assert (sub.radiance[whole] == np.where(sub.hit[..., None], texel, 0.0)[whole]).all()
        covered = np.where(sub.hit, (sub.radiance / texel).mean(axis=-1), 0.0)
        assert covered.min() >= 0.0
        assert 0.6 < (covered[sub.hit & ~whole] != 1.0).mean() < 0.9
        # The area of the ball's outline, an ellipse, in cells: its sections by the tangent cone.
        x, y, z = item.center
        away, slant = np.hypot(np.hypot(x, y), z), np.hypot(x, y) / z
        cone = np.arcsin(item.radius / away)
        tilt = np.arctan(slant)
        across = 0.5 * (np.tan(tilt + cone) - np.tan(tilt - cone))
        along = across * np.sqrt(1.0 - (np.sin(tilt) / np.cos(cone)) ** 2)
        area = np.pi * across * along / ray_step(scene.camera) ** 2
        replaced = np.where(mark_silhouettes(own.label), 0.0, own.label > 0).sum()
        assert abs(replaced + covered.sum() / 9 - area) < 0.15


def test_truth_of_a_plane() -> None:
    item = Plane(distance=250.0, motion=ObjectMotion(velocity=(10.0, 0.0, 35.0)))
    scene = scene_of(item, size=SIZE, sequence=Sequence(shutter=1.0, interval=1.0))
    truth = ground_truth(scene, (random_texture(),), 0)
    middle = 250.0 + 17.5
    np.testing.assert_allclose(truth.depth, middle, rtol=8 * EPS)
    np.testing.assert_allclose(truth.blur_radius, blur_radius(scene.camera, 1 / middle), atol=1e-11)
    assert truth.mask.all()
    assert not truth.object_id.any()
    np.testing.assert_allclose(truth.normal, np.broadcast_to([0.0, 0.0, -1.0], truth.normal.shape), atol=EPS)
    # From t = 0.5 to 1.5 s: X + 10, Z + 35.
    _, column = padded_grid(scene.camera, 0)
    x = (column - 23.5) * 0.01 / 20.0 * middle
    expected = (x + 10.0) / (middle + 35.0) * 2000.0 - (column - 23.5)
    np.testing.assert_allclose(truth.flow[..., 0], np.broadcast_to(expected, SHAPE), atol=1e-10)


def test_flow_leads_to_the_same_point_of_the_object(at: Placer) -> None:
    motion = ObjectMotion(velocity=(0.3, 0.2, 5.0), angular_velocity=(5.0, -8.0, 12.0))
    item = Ellipsoid(center=(0.0, 0.0, 290.0), semi_axes=(3.0, 2.0, 4.0), motion=motion)
    scene = scene_of(item, size=SIZE)
    truth = ground_truth(scene, (random_texture(),), 1)
    row, column = padded_grid(scene.camera, 0)
    camera = scene.camera
    start, end = at(item, 1.5), at(item, 2.5)
    then = pixel_ray(camera, row + truth.flow[..., 1], column + truth.flow[..., 0])
    w_then, label = solve_quadric(end, None, then)
    now = pixel_ray(camera, row, column)
    w_now, _ = solve_quadric(start, None, now)
    found = np.stack(rest_pixel(end, camera, then, w_then)[:2])
    expected = np.stack(rest_pixel(start, camera, now, w_now)[:2])
    # Points that turn out of visibility come out elsewhere; of the others, those well off the limb must agree to
    # the amplified rounding of the two ray casts.
    facing = truth.mask & (label > 0) & ((truth.normal * now).sum(axis=-1) < -0.4)
    agree = np.abs(found - expected).max(axis=0) < 1e-8
    assert facing.sum() > 100
    assert agree[facing].mean() > 0.98
    assert np.abs(truth.flow[truth.mask]).max() > 3.0


def test_a_wall_is_occluded_where_a_card_goes() -> None:
    """The wall stands still: its pixels are occluded in the next frame where that one has the card."""
    going = ObjectMotion(velocity=(0.8, 0.0, 0.0))
    card = Plane(distance=200.0, bounds=((-1.0, 0.6), (-0.9, 0.7), (-1.0, 1.0)), motion=going)
    scene = scene_of(card, Plane(distance=400.0), size=SIZE)
    now, then = (ground_truth(scene, (random_texture(),) * 2, k) for k in (0, 1))
    on_wall, arrives = now.object_id == 1, (now.object_id == 1) & (then.object_id == 0)
    assert 50 < arrives.sum() < 200
    assert (now.flow_occluded[on_wall] == arrives[on_wall]).all()
    assert not now.flow_occluded[~on_wall].any()
    # X / Z s0 / p = 0.8 / 200 x 20 / 0.01 px, there and back.
    np.testing.assert_allclose(now.flow[~on_wall], np.broadcast_to([8.0, 0.0], ((~on_wall).sum(), 2)), atol=1e-10)
    np.testing.assert_allclose(then.flow_backward[then.object_id == 0], -now.flow[now.object_id == 0], atol=1e-10)
    assert np.abs(then.flow_backward[then.object_id == 1]).max() < 1e-10
    out = scene.replace("object[0].motion.velocity", (3.0, 0.0, 0.0))
    gone = ground_truth(out, (random_texture(),) * 2, 0)
    right = np.broadcast_to(np.arange(SIZE[0]) + 30 > SIZE[0] - 0.5, SHAPE)  # 3.0 / 200 x 20 / 0.01 px
    assert (gone.flow_occluded & (gone.object_id == 0) == right & (gone.object_id == 0)).all()
    assert (right & (gone.object_id == 0)).sum() > 10


def test_what_turns_away_is_occluded_in_the_next_frame() -> None:
    """A ball at a great distance turns by 90 deg from frame to frame: half of what is visible is occluded."""
    turning = ObjectMotion(angular_velocity=(0.0, 90.0, 0.0))
    ball = SMALL_SPHERE.model_copy(update={"center": (0.0, 0.0, 280.0), "motion": turning})
    truth = ground_truth(scene_of(ball, size=SIZE), (random_texture(),), 0)
    left, right = (truth.flow_occluded[:, half][truth.mask[:, half]].mean() for half in (slice(24), slice(24, 48)))
    assert left > 0.95  # a turn about y brings the right side nearer
    assert right < 0.05


def test_nothing_flows_and_nothing_is_hidden_at_rest() -> None:
    truth = ground_truth(scene_of(SMALL_SPHERE, size=SIZE), (random_texture(),), 3)
    assert truth.mask.any()
    assert not truth.mask.all()
    assert max(np.abs(truth.flow).max(), np.abs(truth.flow_backward).max()) < 1e-10
    assert not (truth.hidden | truth.flow_occluded).any()
    assert np.isinf(truth.depth[~truth.mask]).all()
    assert not truth.blur_radius[~truth.mask].any()
    assert (truth.object_id == np.where(truth.mask, 0, -1)).all()


def test_back_of_a_turned_sphere_was_hidden() -> None:
    motion = ObjectMotion(angular_velocity=(0.0, 180.0, 0.0))
    item = SMALL_SPHERE.model_copy(update={"center": (0.0, 0.0, 280.0), "motion": motion})
    truth = ground_truth(scene_of(item, size=SIZE), (random_texture(),), 0)  # turned by 90 deg about y
    # At a distance of 112 radii half of the disc, within 1/112 of its width, shows what was behind the limb.
    left, right = (truth.hidden[:, half][truth.mask[:, half]].mean() for half in (slice(24), slice(24, 48)))
    assert sorted((left > 0.95, right > 0.95)) == [False, True]
    assert min(left, right) < 0.05


@pytest.mark.parametrize(
    ("velocity", "outside"),
    [
        ((1.0, 0.0, 0.0), (slice(None), slice(None, 4))),
        ((-1.0, 0.0, 0.0), (slice(None), slice(-4, None))),
        ((0.0, -1.0, 0.0), (slice(None, 4), slice(None))),
        ((0.0, 1.0, 0.0), (slice(-4, None), slice(None))),
    ],
)
def test_surface_from_outside_of_the_frame_was_hidden(
    velocity: tuple[float, float, float], outside: tuple[slice, slice]
) -> None:
    item = Plane(motion=ObjectMotion(velocity=velocity))  # 8 px/s: 4 px at the middle
    expected = np.zeros(SHAPE, dtype=bool)
    expected[outside] = True
    assert (ground_truth(scene_of(item, size=SIZE), (random_texture(),), 0).hidden == expected).all()
