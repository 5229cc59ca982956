"""Whole scenes: what does not move, what moves by whole pixels, and the two warps against each other."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
import pytest
from numpy.typing import NDArray

from clsco.frame.frame import Frame
from clsco.optics.point_spread import point_spread
from clsco.reference.inpainting.fill import Method
from clsco.reference.sequence import render
from clsco.scene.model import Cylinder, Fill, Motion, ObjectMotion, Plane, Psf, Quadric, Scene, Sequence, Sphere
from tests.scenes import scene_of
from tests.slow import mostly_slow
from tests.spreads import convolve

SHAPE = (24, 32)
SIZE = SHAPE[::-1]
SHARP = {"focus_distance": 250.0}


def truth(frame: Frame, name: str) -> NDArray[Any]:
    """One array of ground truth, which the reference always gives."""
    array = getattr(frame, name)
    assert array is not None
    return np.asarray(array)


def only(scene: Scene) -> Frame:
    """The one frame of a scene."""
    (frame,) = render(scene)
    return frame


def test_facing_plane_is_one_convolution() -> None:
    frame = only(scene_of(Plane(distance=280.0), size=SIZE))
    radius = float(truth(frame, "blur_radius")[0, 0])
    assert np.ptp(truth(frame, "blur_radius")) == 0
    assert 4 < radius < 5
    sharp = truth(frame, "sharp").reshape(*SHAPE, -1)
    wide = np.pad(sharp, ((6, 6), (6, 6), (0, 0)), mode="symmetric")
    expected = convolve(point_spread(Psf()), wide, radius, 6).reshape(frame.color.shape)
    np.testing.assert_allclose(frame.color, expected, atol=1e-12)
    assert np.abs(expected - truth(frame, "sharp")).max() > 0.05


@pytest.mark.parametrize("warp", ["inverse", "forward"])
def test_motion_by_whole_pixels_is_a_mean_of_shifts(warp: str) -> None:
    item = Plane(distance=250.0, motion=ObjectMotion(velocity=(1.0, 0.0, 0.0)))  # 8 px in 1 s
    sequence = Sequence(frames=2, interval=1.0, shutter=1.0, samples=4)
    scene = scene_of(item, size=SIZE, camera=SHARP, motion=Motion.model_validate({"warp": warp}), sequence=sequence)
    still = truth(only(scene_of(Plane(distance=250.0), size=SIZE, camera=SHARP)), "sharp")
    first, second = render(scene)
    assert (first.index, second.index) == (0, 1)
    for frame, shifts in ((first, (1, 3, 5, 7)), (second, (9, 11, 13, 15))):
        expected = np.mean([np.roll(still, shift, axis=1) for shift in shifts], axis=0)
        # Positions are eps of a few hundred px off; the forward warp has no source left of the frame.
        np.testing.assert_allclose(frame.color[:, 15:], expected[:, 15:], atol=1e-9)
        sharp = np.roll(still, 4 + 8 * frame.index, axis=1)
        np.testing.assert_allclose(truth(frame, "sharp")[:, 15:], sharp[:, 15:], atol=1e-9)
        np.testing.assert_allclose(truth(frame, "flow")[..., 0], 8.0, atol=1e-9)
        assert not truth(frame, "filled").any()
        steps = frame.metadata["intermediate"]
        np.testing.assert_allclose([s["time"] for s in steps], frame.index + np.array([1, 3, 5, 7]) / 8)
        assert [s["weight"] for s in steps] == [0.25] * 4
        assert [s["missing_pixels"] for s in steps] == [0] * 4


@pytest.mark.parametrize("method", mostly_slow(["ait", "mean_median"], ["ait"]))
def test_warps_agree_where_nothing_was_hidden(method: Method) -> None:
    motion = ObjectMotion(angular_velocity=(0.0, 1.0, 10.0), velocity=(0.0, 0.0, -20.0))
    of: dict[str, Any] = {"size": (64, 48), "sequence": Sequence(samples=3)}
    item = Cylinder(center=(0.0, 0.0, 285.0), motion=motion)
    inverse = only(scene_of(item, **of))
    forward = only(scene_of(item, **of, motion=Motion(warp="forward"), fill=Fill(method=method)))
    for name in ("depth", "blur_radius", "mask", "normal", "flow", "hidden"):
        assert (truth(inverse, name) == truth(forward, name)).all()
    steps = forward.metadata["intermediate"]
    assert sum(step["filled_pixels"] for step in steps) > 100
    assert all(s["missing_pixels"] == s["filled_pixels"] + s["unfilled_pixels"] for s in steps)
    assert (truth(forward, "filled") == 1).sum() > 20
    # The forward warp displaces a pixel by at most half a pixel either way, so that the two differ less than
    # images one pixel apart do. The border lacks what came from outside of the frame.
    middle = (slice(12, -12), slice(12, -12))
    difference = inverse.color[middle] - forward.color[middle]
    apart = inverse.color[middle] - np.roll(inverse.color, 1, axis=1)[middle]
    assert 0 < np.sqrt(np.mean(difference**2)) < np.sqrt(np.mean(apart**2))


def test_domain_surface_leaves_the_gap_between_two_sheets() -> None:
    # x^2 - y^2 - z^2 = 1: a bowl on the left, one on the right, and 16 px of nothing between them.
    sheets, motion = (1.0, -1.0, -1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0), ObjectMotion(velocity=(0.0, 0.0, -50.0))
    item = Quadric(center=(0.0, 0.0, 250.0), coefficients=sheets, motion=motion)
    domains: tuple[Literal["surface", "span"], ...] = ("surface", "span")
    surface, span = (
        only(scene_of(item, size=SIZE, motion=Motion(warp="forward"), fill=Fill(domain=domain))) for domain in domains
    )
    gap = ~truth(span, "mask")
    assert gap[:, 14:18].all()
    assert not gap[:, [0, -1]].all()
    assert (truth(surface, "filled") == 1).sum() > 10
    assert not truth(surface, "filled")[gap].any()
    assert (truth(span, "filled")[gap] == 1).sum() > 50


def test_what_does_not_move_needs_no_filling() -> None:
    item = Sphere(center=(0.0, 0.0, 280.0), radius=1.5)
    inverse = only(scene_of(item, size=SIZE, sequence=Sequence(samples=7)))
    forward = only(scene_of(item, size=SIZE, motion=Motion(warp="forward")))
    assert (inverse.color == forward.color).all()
    assert truth(inverse, "mask").any()
    assert not truth(inverse, "mask").all()
    assert inverse.metadata["intermediate"][0]["time"] == 0.0


def test_motion_that_is_nothing_is_standing_still() -> None:
    """A full turn about the axis of symmetry, sampled at its end, is the image at rest."""
    still = Plane(distance=260.0)
    turning = still.model_copy(update={"motion": ObjectMotion(angular_velocity=(0.0, 0.0, 360.0))})
    sequence = Sequence(samples=1, sampling="endpoint")
    expected = only(scene_of(still, size=SIZE)).color
    found = only(scene_of(turning, size=SIZE, sequence=sequence)).color
    np.testing.assert_allclose(found, expected, atol=1e-10)  # eps of the pixel numbers, times the texture's slope
