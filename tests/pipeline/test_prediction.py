"""Frames that meet larger blur than was predicted of the scene."""

from typing import Any

import numpy as np
import pytest

import clsco
from clsco import reference
from clsco.optics.quadrics import Extent
from clsco.optics.visibility import extent
from clsco.scene.file import parse_scene
from clsco.scene.model import Object, Scene
from tests.scenes import plan_scene

BOUNDS = [[-100.0, 100.0], [-50.0, 50.0], [-1.0, 1.0]]


def turning(item: dict[str, Any], warp: str, frames: int = 64, aperture: float = 40.0) -> Scene:
    """An object that makes whole turns between two of the moments that are looked at ahead, 2 s apart."""
    return parse_scene(
        {
            "camera": {"resolution": [36, 24], "pixel_pitch": 0.13, "aperture_diameter": aperture},
            "psf": {"occlusion": "none", "silhouette_samples": 1, "tilt": False},
            "sequence": {"frames": frames, "samples": 3},
            "motion": {"warp": warp},
            "object": [{**item, "motion": {"angular_velocity": [0.0, 180.0, 0.0]}}],
        }
    )


@pytest.mark.slow
@pytest.mark.parametrize("warp", ["forward", "inverse"])
def test_a_card_that_turns_between_the_moments_looked_at(warp: str) -> None:
    scene = turning({"shape": "plane", "distance": 280.0, "bounds": BOUNDS}, warp)
    frame, twin = next(iter(clsco.render(scene))), next(iter(reference.render(scene)))
    np.testing.assert_allclose(frame.color, twin.color, rtol=0, atol=1e-6)
    # A short sequence is looked at more closely, and its one frame has the bits of the first of the long one.
    short = turning({"shape": "plane", "distance": 280.0, "bounds": BOUNDS}, warp, 1)
    known, missed = plan_scene(short, 1), plan_scene(scene, 1)
    assert known.largest_blur > 1.5 * missed.largest_blur
    np.testing.assert_allclose(frame.color, next(iter(clsco.render(short))).color, rtol=0, atol=1e-6)


CROSSING: dict[str, Any] = {
    "camera": {"resolution": [36, 24], "pixel_pitch": 0.13, "aperture_diameter": 30.0},
    "object": [
        {"shape": "sphere", "center": [0.0, 0.0, 230.0], "radius": 8.0, "texture": "checkerboard"},
        {"shape": "plane", "distance": 290.0, "texture": "#ffffff"},
    ],
}


@pytest.mark.parametrize("number", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_objects_that_are_not_where_they_were_predicted(monkeypatch: pytest.MonkeyPatch, number: int) -> None:
    """A plan that takes the ball for far, or the wall for near, has no occluders of the wall: it is made again."""
    scene = parse_scene(CROSSING)
    (exact,), planned = clsco.render(scene, truth=()), plan_scene(scene, 1)
    elsewhere = Extent((3.0, 3.1), (3.0, 3.1), ((1e-3, 1.1e-3), (0.1, 0.11))[number])

    def wrong(item: Object, *others: Any) -> Extent:
        return elsewhere if item == scene.objects[number] else extent(item, *others)

    monkeypatch.setattr("clsco.optics.resolved_view.extent", wrong)
    assert plan_scene(scene, 1).groups != planned.groups
    (frame,) = clsco.render(scene, truth=())
    np.testing.assert_allclose(frame.color, exact.color, rtol=0, atol=2e-6)
    monkeypatch.setattr("clsco.engine.renderer.larger_plan", lambda *_: None)
    (unchecked,) = clsco.render(scene, truth=())
    assert np.abs(unchecked.color - exact.color).max() > 0.01


@pytest.mark.slow
def test_a_depth_map_that_turns_between_the_moments_looked_at() -> None:
    depth = 280.0 + np.tile(np.linspace(0.0, 4.0, 36, dtype=np.float32), (24, 1))
    item = {"shape": "depth_map", "depth": depth, "center": [0.0, 0.0, 280.0]}
    long, short = (turning(item, "forward", frames, 150.0) for frames in (64, 1))
    (first,), (only,) = clsco.render(long, frames=[0]), clsco.render(short)
    np.testing.assert_allclose(first.color, only.color, rtol=0, atol=1e-6)
