"""Sources that all time samples share are blurred once: the frames are those of the plain sum over time samples."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from clsco.constants import BAND
from clsco.frame.frame import Frame
from clsco.opencl.device import choose
from clsco.plan import decisions
from clsco.plan.memory import device_bytes
from clsco.plan.methods import Choice
from clsco.plan.prepare import prepare
from clsco.plan.request import Request
from clsco.scene.model import Scene
from tests.scenes import rendered, scene_from

CAMERA = {"resolution": [144, 96], "pixel_pitch": 0.04, "focal_length": 20.0, "aperture_diameter": 6.0}
CAMERA |= {"focus_distance": 260.0}
WALL = {"shape": "plane", "distance": 330.0, "texture": "checkerboard"}
CARD: dict[str, Any] = {"shape": "rectangle", "center": [-14.0, 4.0, 262.0], "size": [46.0, 50.0], "texture": "bricks"}
BALL: dict[str, Any] = {"shape": "sphere", "center": [4.0, -2.0, 200.0], "radius": 8.0, "texture": "checkerboard"}
BALL |= {"motion": {"velocity": [20.0, 6.0, -9.0]}}
# Between the card and the lens at the middle of the exposure alone.
PASSING = BALL | {"center": [-60.0, 0.0, 215.0], "radius": 3.0, "motion": {"velocity": [120.0, 0.0, 0.0]}}
WIRE = {"shape": "cylinder", "center": [0.0, 0.0, 190.0], "radius": 0.25, "axis": [0.3, 1.0, 0.0]}
WIRE |= {"bounds": [[-20.0, 20.0], [-20.0, 20.0], [-9.0, 9.0]], "motion": {"velocity": [15.0, 0.0, 0.0]}}
MAPPED = CARD | {"texture_mapping": "surface", "texture_size": 9.0}
SCENES: dict[str, tuple[dict[str, Any], list[dict[str, Any]]]] = {
    "a ball that passes": ({}, [CARD, PASSING, WALL]),
    "a wire": ({}, [WIRE, MAPPED, WALL]),
    "a rolling shutter": ({"sequence": {"samples": 4, "readout": 0.5}}, [CARD, BALL, WALL]),
    "light given back": ({"psf": {"border": "renormalize"}}, [CARD, BALL, WALL]),
}


def scene(name: str, **sections: Any) -> Scene:
    own, items = SCENES[name]
    return scene_from({"camera": CAMERA, "sequence": {"samples": 4}} | own, *items, **sections)


@pytest.fixture
def always(monkeypatch: pytest.MonkeyPatch) -> None:
    """Splits the sources even if most may change, as in small frames."""
    monkeypatch.setattr(decisions, "LEAST_SAVED", 0.0)


@pytest.fixture
def plain(monkeypatch: pytest.MonkeyPatch) -> Callable[..., list[Frame]]:
    """Frames with all sources of each time sample."""

    def render(chosen: Scene) -> list[Frame]:
        with monkeypatch.context() as patched:
            patched.setattr(decisions, "choose_still_sources", lambda *_: Choice(False, "for a test"))
            return rendered(chosen, truth=())

    return render


@pytest.mark.usefixtures("always")
@pytest.mark.parametrize("name", SCENES)
def test_the_frames_are_those_of_the_plain_sum(name: str, plain: Callable[..., list[Frame]]) -> None:
    chosen = scene(name)
    assert prepare(chosen, Request(())).plan.splits_still
    (frame,), (expected,) = rendered(chosen, truth=()), plain(chosen)
    np.testing.assert_allclose(frame.color, expected.color, rtol=0, atol=2e-6)
    assert frame.metadata["intermediate"] == expected.metadata["intermediate"]


@pytest.mark.usefixtures("always")
def test_strips_have_the_bits_of_the_whole_frame() -> None:
    camera = {"resolution": [40, 200], "pixel_pitch": 0.05, "aperture_diameter": 14.0}
    chosen = scene("a ball that passes", camera=camera)
    plan = prepare(chosen, Request(truth=()), choose()).plan
    assert plan.splits_still
    memory = device_bytes(replace(plan, strip_rows=BAND))
    (whole,), (frame,) = (rendered(chosen, truth=(), **options) for options in ({}, {"memory": memory}))
    assert whole.metadata["strips"] == 1 < frame.metadata["strips"]
    np.testing.assert_array_equal(frame.color, whole.color)


REASONS: dict[str, tuple[dict[str, Any], list[dict[str, Any]]]] = {
    "the camera": ({"camera": {**CAMERA, "motion": {"velocity": [1.0, 0.0, 0.0]}}}, [BALL, WALL]),
    "one by one": ({"psf": {"occlusion": "layered"}}, [BALL, WALL]),
    "of 2 samples": ({"sequence": {"samples": 2}}, [BALL, WALL]),
    "100%": ({}, [{"shape": "plane", "distance": 200.0, "motion": {"velocity": [0.0, 0.0, 9.0]}}, WALL]),
    "needs all sources": ({}, [BALL, WALL]),
}


@pytest.mark.parametrize("reason", REASONS)
def test_scenes_whose_sources_are_all_made_at_each_time_sample(reason: str) -> None:
    sections, items = REASONS[reason]
    truth = ("subframes",) if "all sources" in reason else ()
    plan = prepare(scene_from({"camera": CAMERA, "sequence": {"samples": 4}} | sections, *items), Request(truth)).plan
    assert not plan.splits_still
    assert reason in dict(plan.choices.left_out)["still sources"]
