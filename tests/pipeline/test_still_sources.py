"""Sources that all time samples share are blurred once: the frames of the plain sum over time samples."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import clsco
from clsco.constants import BAND
from clsco.frame.frame import Frame
from clsco.opencl.device import choose
from clsco.optics.still import StillSplit
from clsco.plan import decisions
from clsco.plan.choice import Choice
from clsco.plan.memory import device_bytes
from clsco.plan.prepare import prepare
from clsco.plan.request import Request
from clsco.scene.model import Scene
from tests.scenes import reference_frames, rendered, scene_from
from tests.slow import mostly_slow

Make = Callable[..., list[Frame]]
CAMERA = {"resolution": [72, 48], "pixel_pitch": 0.08, "focal_length": 20.0, "aperture_diameter": 14.0}
CAMERA |= {"focus_distance": 260.0}
WALL = {"shape": "plane", "distance": 330.0, "texture": "checkerboard"}
PHOTO = {"shape": "background", "texture": "siemens_star"}
CARD: dict[str, Any] = {"shape": "rectangle", "center": [-14.0, 4.0, 262.0], "size": [46.0, 50.0], "texture": "bricks"}
BALL: dict[str, Any] = {"shape": "sphere", "center": [4.0, -2.0, 200.0], "radius": 8.0, "texture": "checkerboard"}
BALL |= {"motion": {"velocity": [20.0, 6.0, -9.0]}}
TURNING: dict[str, Any] = {"motion": {"angular_velocity": [0.0, 40.0, 0.0]}, "texture_mapping": "surface"}
# Cut by bounds, so that its inside is seen: each of its roots is a group.
TUBE: dict[str, Any] = {
    "shape": "cylinder",
    "center": [26.0, 0.0, 240.0],
    "radius": 9.0,
    "texture": "bricks",
    **TURNING,
}
TUBE |= {"bounds": [[-10.0, 10.0], [-12.0, 12.0], [-10.0, 10.0]]}
WIRE = {"shape": "cylinder", "center": [0.0, 0.0, 190.0], "radius": 0.25, "axis": [0.3, 1.0, 0.0]}
WIRE |= {"bounds": [[-20.0, 20.0], [-20.0, 20.0], [-9.0, 9.0]], "motion": {"velocity": [15.0, 0.0, 0.0]}}
# Between the card and the lens at the middle of the exposure alone.
PASSING: dict[str, Any] = {
    **BALL,
    "center": [-60.0, 0.0, 215.0],
    "radius": 3.0,
    "motion": {"velocity": [120.0, 0.0, 0.0]},
}
# Beside it, where its outlines are near those of a card at the same depth, in one occlusion group.
ASIDE: dict[str, Any] = {"shape": "rectangle", "center": [28.0, 12.0, 262.0], "size": [30.0, 20.0]}
ASIDE |= {"motion": {"velocity": [-7.0, 0.0, 0.0]}}
SPINNING: dict[str, Any] = {"shape": "disc", "center": [24.0, -10.0, 250.0], "radius": 9.0, **TURNING}
SPINNING |= {"motion": {"angular_velocity": [0.0, 0.0, 70.0]}}
SCENES: dict[str, tuple[dict[str, Any], list[dict[str, Any]]]] = {
    "ball before a card, a tube and a photo": ({}, [CARD, TUBE, BALL, PHOTO]),
    "ball that passes": ({}, [CARD, PASSING, WALL]),
    "spinning disc": ({}, [SPINNING, CARD, WALL]),
    "card beside a card": ({}, [CARD, ASIDE, WALL]),
    "wire": ({}, [WIRE, CARD, WALL]),
    "texture on a card": ({}, [{**CARD, "texture_mapping": "surface", "texture_size": 9.0}, BALL, WALL]),
    "sampled discs": ({"psf": {"edge": "sampled", "tilt": False}}, [CARD, BALL, WALL]),
    "light given back": ({"psf": {"border": "renormalize"}}, [CARD, BALL, WALL]),
    "two views": ({"stereo": {"baseline": 6.0}}, [CARD, BALL, WALL]),
}


def scene(name: str, **sections: Any) -> Scene:
    found, items = SCENES[name]
    return scene_from({"camera": CAMERA, "sequence": {"samples": 4}} | found, *items, **sections)


def divided(wanted: Scene, **options: Any) -> bool:
    return prepare(wanted, Request(**options)).plan.splits_still


@pytest.fixture
def plainly(monkeypatch: pytest.MonkeyPatch) -> Make:
    """Frames with all sources of each time sample."""

    def render(wanted: Scene, **options: Any) -> list[Frame]:
        with monkeypatch.context() as patched:
            patched.setattr(decisions, "choose_still_sources", lambda *_: Choice(False, "as a test wants it"))
            assert not divided(wanted)
            return rendered(wanted, truth=(), **options)

    return render


def assert_alike(found: list[Frame], wanted: list[Frame], most: float = 2e-6) -> None:
    assert len(found) == len(wanted)
    for one, other in zip(found, wanted, strict=True):
        np.testing.assert_allclose(one.color, other.color, rtol=0, atol=most)


@pytest.mark.parametrize("name", mostly_slow(SCENES, []))  # one of them in a sequence, below
def test_the_same_frames(name: str, plainly: Make) -> None:
    wanted = scene(name)
    assert divided(wanted)
    assert_alike(rendered(wanted, truth=()), plainly(wanted))


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENES)
def test_the_frames_of_the_reference(name: str) -> None:
    wanted = scene(name, sequence={"samples": 3})
    assert divided(wanted)
    assert_alike(rendered(wanted, truth=()), reference_frames(wanted), 1e-5)


def test_what_passes_at_the_middle_is_seen(plainly: Make) -> None:
    wanted = scene("ball that passes", sequence={"samples": 5})
    (found,) = rendered(wanted, truth=("subframes",))
    assert found.subframes is not None
    first, middle = (found.subframes[k] for k in (0, 2))
    assert np.abs(first - middle)[18:30, 20:40].max() > 0.1  # it is before the card at the middle alone
    assert_alike(rendered(wanted, truth=()), plainly(wanted))


@pytest.mark.slow
def test_each_frame_of_a_sequence(plainly: Make) -> None:
    wanted = scene("ball before a card, a tube and a photo", sequence={"frames": 2, "interval": 0.9, "shutter": 0.5})
    first, second = rendered(wanted, truth=())
    assert_alike([first, second], plainly(wanted))
    (alone,) = clsco.render(wanted, frames=[1], truth=())
    np.testing.assert_array_equal(alone.color, second.color)


@pytest.mark.slow
def test_alpha_and_ground_truth_are_those_of_the_plain_sum(plainly: Make) -> None:
    wanted = scene("ball before a card, a tube and a photo")
    (found,), (plain,) = rendered(wanted, truth=("alpha", "depth", "flow", "object_id")), plainly(wanted)
    assert_alike([found], [plain])
    (exact,) = reference_frames(wanted)
    for name in ("depth", "flow", "object_id"):
        np.testing.assert_allclose(getattr(found, name), getattr(exact, name), rtol=1e-5, atol=1e-5)
    assert found.alpha is not None


@pytest.mark.slow
def test_strips_have_the_bits_of_the_whole_frame() -> None:
    wanted = scene("ball before a card, a tube and a photo", camera={"resolution": [40, 200], "pixel_pitch": 0.05})
    plan = prepare(wanted, Request(truth=()), choose()).plan
    assert plan.splits_still
    little = device_bytes(replace(plan, strip_rows=BAND))
    (whole,), (found,) = (rendered(wanted, truth=(), **options) for options in ({}, {"memory": little}))
    assert whole.metadata["strips"] == 1 < found.metadata["strips"]
    np.testing.assert_array_equal(found.color, whole.color)


@pytest.mark.parametrize("window", [None, (0, 0, 40, 70)])
def test_a_frame_is_made_again_where_a_still_source_was_not(
    window: tuple[int, ...] | None, monkeypatch: pytest.MonkeyPatch, plainly: Make
) -> None:
    wanted = scene("ball that passes")
    exact = plainly(wanted)
    monkeypatch.setattr(StillSplit, "window", lambda *_: window)
    (found,) = rendered(wanted, truth=())
    np.testing.assert_array_equal(found.color, exact[0].color)


def test_time_samples_are_reported_once() -> None:
    (frame,) = rendered(scene("ball that passes"), truth=())
    assert frame.metadata["samples"] == len(frame.metadata["intermediate"]) == 4
    assert sum(each["weight"] for each in frame.metadata["intermediate"]) == pytest.approx(1.0)


REASONS: dict[str, tuple[dict[str, Any], list[dict[str, Any]]]] = {
    "the camera moves": ({"camera": {**CAMERA, "motion": {"velocity": [1.0, 0.0, 0.0]}}}, [BALL, WALL]),
    "only sources from rays": ({"psf": {"occlusion": "layered"}}, [BALL, WALL]),
    "no source is sure to be still": ({}, [BALL]),
    "needs all sources": ({}, [BALL, WALL]),
}


@pytest.mark.parametrize("reason", REASONS)
def test_scenes_that_are_not_divided(reason: str) -> None:
    sections, items = REASONS[reason]
    truth = ("subframes",) if "all sources" in reason else ()
    wanted = scene_from({"camera": CAMERA} | sections, *items)
    plan = prepare(wanted, Request(truth)).plan
    assert not plan.splits_still
    assert reason in dict(plan.choices.left_out)["still sources"]


def test_what_moves_without_bounds_leaves_nothing_still() -> None:
    nearer = {"shape": "plane", "distance": 200.0, "motion": {"velocity": [0.0, 0.0, 9.0]}}
    assert not divided(scene_from({"camera": CAMERA}, nearer, WALL))
