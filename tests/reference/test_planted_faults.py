"""Faults that are planted in what the device decides, prepares or is handed: `clsco check` finds each of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from pkgutil import resolve_name
from typing import Any

import numpy as np
import pytest

import clsco
from clsco import reference
from clsco.cli.check import compare_frames
from clsco.constants import BAND
from clsco.frame.frame import Frame
from clsco.frame.strips import Strip
from clsco.optics.quadrics import Extent
from clsco.optics.visibility import OcclusionGroup
from clsco.plan.methods import Choice
from clsco.scene.model import Scene
from tests.scenes import scene_from

Tables = dict[str, Any]
Fault = Callable[..., Any]
"""Makes the faulty function: gets the right one, and what it is called with."""

CAMERA = {"resolution": [24, 18], "pixel_pitch": 0.33, "f_number": 0.6, "focus_distance": 220.0}
BALL: Tables = {"shape": "sphere", "center": [-6.0, 3.0, 150.0], "radius": 8.0, "texture": "#a0a0a0"}
CARD: Tables = {"shape": "rectangle", "center": [9.0, -4.0, 165.0], "size": [18.0, 11.0], "rotation": [0.0, 40.0, 10.0]}
WALL: Tables = {"shape": "plane", "distance": 300.0, "slope_x": 0.4, "texture": "bricks"}
TURNED = {"velocity": [120.0, 20.0, 0.0], "angular_velocity": [0.0, 90.0, 0.0]}
GOING = CARD | {"motion": TURNED}
MOVING: Tables = {"sequence": {"shutter": 0.1, "samples": 3, "shutter_curve": "triangle"}}
LAID = CARD | {"texture_mapping": "surface", "texture": np.random.default_rng(5).random((48, 48)).astype(np.float32)}
TWO: Tables = {"camera": CAMERA, "psf": {"silhouette_samples": 2}}
# Most have the same objects, and so the same programs, which take far longer than their frames.
SCENES: dict[str, Scene] = {
    "still": scene_from(TWO, BALL, CARD, WALL),
    "moving": scene_from(TWO | MOVING, BALL, GOING, WALL),
    "auto": scene_from(TWO, BALL, GOING, WALL, sequence={"shutter": 0.05}),
    "rolling": scene_from(TWO | MOVING, BALL, GOING, WALL, sequence={"readout": 0.05}),
    "high": scene_from(TWO, BALL, CARD, WALL, camera=CAMERA | {"resolution": [12, BAND + 16]}),
    "stereo": scene_from(TWO, BALL, CARD, WALL, stereo={"baseline": 10.0}),
    "rims": scene_from(TWO, BALL, CARD, WALL, aperture={"rim": [{"distance": 25.0, "diameter": 30.0}]}),
    "laid": scene_from(TWO, LAID, WALL),
    "color": scene_from({"camera": CAMERA}, {"shape": "plane", "distance": 300.0, "texture": "#ff8040"}),
    "layered": scene_from(TWO, BALL, WALL, psf={"occlusion": "layered"}),
}


def always(value: Any) -> Fault:
    return lambda right, *arguments, **named: value


def changed(**fields: Callable[[Any], Any]) -> Fault:
    """The right result with other values of some fields."""

    def fault(right: Fault, *arguments: Any, **named: Any) -> Any:
        result = right(*arguments, **named)
        return replace(result, **{name: change(getattr(result, name)) for name, change in fields.items()})

    return fault


def altered(change: Callable[[Any], Any]) -> Fault:
    return lambda right, *arguments, **named: change(right(*arguments, **named))


def half(ends: tuple[float, float]) -> tuple[float, float]:
    middle, size = 0.5 * sum(ends), 0.25 * (ends[1] - ends[0])
    return middle - size, middle + size


def smaller(surface: Any) -> Any:
    if not np.isfinite(surface.ball[3]):
        return surface
    extent = Extent(half(surface.extent.x), half(surface.extent.y), surface.extent.w)
    return replace(surface, extent=extent, ball=surface.ball * [1.0, 1.0, 1.0, 0.5])


def without_apron(strips: tuple[Strip, ...]) -> tuple[Strip, ...]:
    return tuple(replace(one, above=one.above if one.top == 0 else 0) for one in strips)


def without_occluders(groups: tuple[OcclusionGroup, ...]) -> tuple[OcclusionGroup, ...]:
    return tuple(replace(group, occluders=0) for group in groups)


def boxed(right: Fault, curve: Any, time: Any) -> Any:
    return np.clip(time, 0.0, 1.0)


def mirrored(planes: Any) -> Any:
    return planes[:, ::-1].copy()


def regrouped(change: Callable[[Any], Any]) -> Fault:
    """The right occlusion with other groups."""
    return altered(lambda parts: (parts[0], change(parts[1]), parts[2]))


def coarser(right: Fault, images: Any, out: Any = None) -> Any:
    """Levels that are blurred twice as much."""
    levels = right(images, out)
    for fine, level in zip(levels[1:], levels, strict=False):
        level[...] = np.repeat(np.repeat(fine, 2, axis=1), 2, axis=2)[:, : level.shape[1], : level.shape[2]]
    return levels


PLAN, SEEN, PLACED = "clsco.plan.decisions", "clsco.plan.plan", "clsco.passes.placed"
TOGETHER = Choice("none"), (OcclusionGroup(7, 0),), ()
NO_SECOND_LOOK: dict[str, Fault] = {"clsco.engine.renderer.larger_plan": always(None)}
NOT_KEPT: dict[str, Fault] = {f"{PLACED}.PlacedScene.content": always(None)}  # textures of other tests, and theirs
IN_STRIPS: dict[str, Fault] = {"clsco.engine.sequence.fit_strips": changed(strip_rows=lambda _: BAND)}
FAULTS: dict[str, tuple[str, dict[str, Fault]]] = {
    "no occlusion": ("still", {f"{PLAN}.choose_occlusion": always(TOGETHER)}),
    "no occluders": ("still", {f"{PLAN}.choose_occlusion": regrouped(without_occluders)}),
    "no guard band": ("still", {"clsco.optics.resolved_view.guard_band": always(0)}),
    "no silhouettes": ("still", {f"{PLAN}.choose_silhouettes": always(Choice(0))}),
    "one time sample": ("auto", {f"{PLAN}.choose_samples": always(Choice(1))}),
    "half the time samples": ("auto", {f"{PLAN}.choose_samples": changed(value=lambda count: count // 2)}),
    "objects that are smaller": ("still", {f"{PLACED}.place": altered(smaller)}),
    "no tilt": ("still", {f"{PLAN}.choose_tilt": always(Choice(False))}),
    "radii that are clipped": (
        "still", {f"{SEEN}.resolve": changed(largest=lambda size: 0.6 * size)} | NO_SECOND_LOOK,
    ),
    "a group that is dropped": ("still", {f"{PLAN}.choose_occlusion": regrouped(lambda groups: groups[1:])}),
    "strips without an apron": ("high", IN_STRIPS | {f"{SEEN}.strips_of": altered(without_apron)}),
    "a shutter without its curve": ("moving", {"clsco.optics.exposure.curve_integral": boxed}),
    "lines in the other order": ("rolling", {"clsco.optics.exposure.line_openings": altered(np.flip)}),
    "half an exposure": ("moving", {"clsco.engine.film.frame_exposure": changed(times=lambda times: 0.5 * times)}),
    "the left eye twice": ("stereo", {f"{PLACED}.poses_at": lambda right, scene, time, eye: right(scene, time)}),
    "what moves is still": ("moving", {"clsco.optics.still._differ": always(False)}),
    "no rims": ("rims", {"clsco.optics.resolved_view.elliptic_spread": changed(rims=lambda _: ())}),
    "mipmaps that are coarser": ("laid", {"clsco.inputs.textures.mipmap": coarser} | NOT_KEPT),
    "red and blue exchanged": ("color", {f"{PLACED}.texture_planes": altered(mirrored)} | NOT_KEPT),
    "four cells of the lens for one": ("layered", {"clsco.plan.plan.lens_cells": always(2)}),
    "depth layers taken for one": ("layered", {f"{PLAN}.choose_occlusion": always(TOGETHER)}),
}  # fmt: skip


@cache
def reference_of(name: str) -> tuple[Frame, ...]:
    """Frames of a scene by the reference, which no fault is planted in."""
    return tuple(reference.render(SCENES[name]))


def disagreeing(name: str, monkeypatch: pytest.MonkeyPatch, faults: dict[str, Fault]) -> set[str]:
    """Outputs in which the check finds that a device with these faults differs from the reference."""
    exact = reference_of(name)
    plant(monkeypatch, faults)
    monkeypatch.setattr("clsco.cli.check.reference.render", lambda scene: iter(exact))
    # Without ground truth, whose kernels take long to compile.
    monkeypatch.setattr("clsco.cli.check.render", partial(clsco.render, truth=()))
    checked = compare_frames(SCENES[name], None, None)
    return {each.output for outcome in checked for each in outcome.differences if not each.agrees}


def plant(monkeypatch: pytest.MonkeyPatch, faults: dict[str, Fault]) -> None:
    for target, fault in faults.items():
        right = resolve_name(target)
        planted = partial(fault, right)
        monkeypatch.setattr(target, property(planted) if isinstance(right, property) else planted)


@pytest.mark.parametrize("name", SCENES)
def test_without_a_fault_all_agree(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    assert disagreeing(name, monkeypatch, IN_STRIPS if name == "high" else {}) == set()


@pytest.mark.parametrize("name", FAULTS)
def test_each_fault_is_found(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    scene, faults = FAULTS[name]
    assert "color" in disagreeing(scene, monkeypatch, faults)
