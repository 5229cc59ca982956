"""Parts of a scene that are made in Python: errors are clsco's, all of them at once."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import clsco
from tests.scenes import refusals

BAD: list[tuple[Callable[[], Any], list[str]]] = [
    (
        lambda: clsco.Sphere(radius="a", texture=np.zeros((3, 3, 7))),  # type: ignore[arg-type]
        [
            "Sphere: texture: an array must have the shape (rows, columns) or (rows, columns, 3); got (3, 3, 7)",
            'Sphere: radius: must be a number; got "a"',
        ],
    ),
    (lambda: clsco.Sphere(half_angle=3), ["Sphere: half_angle: belongs to cone, not to sphere; got 3"]),  # type: ignore[call-arg]
    (
        lambda: clsco.Sphere(motion={"velocit": 1}),  # type: ignore[arg-type]
        ["Sphere: motion.velocit: unknown key (did you mean velocity?); got 1"],
    ),
    (lambda: clsco.ObjectMotion(velocity=3), ["ObjectMotion: velocity: must be a list of 3 numbers; got 3"]),  # type: ignore[arg-type]
    (lambda: clsco.CameraShake(seed=-1), ["CameraShake: seed: must be between 0 and 9.223372e+18; got -1"]),
    (
        lambda: clsco.Scene(objects=[{"shape": "sphere", "radiu": 1}], groups=[{"name": "a", "orign": 1}]),  # type: ignore[arg-type]
        [
            "Scene: group[0].orign: unknown key (did you mean origin?); got 1",
            "Scene: object[0].radiu: unknown key (did you mean radius?); got 1",
        ],
    ),
    (lambda: clsco.Light(), ["Light: must have a direction or a position; got neither"]),
    (
        lambda: clsco.Scene(objects=(clsco.Plane(name="a"), clsco.Plane(name="a"))),
        ['Scene: object[1].name: names must differ; object[0] has the same; got "a"'],
    ),
    (
        lambda: clsco.Scene(camera={"f_numbr": 2}, objects=[{"shape": "sphere", "radius": "a"}]),  # type: ignore[arg-type]
        [
            "Scene: camera.f_numbr: unknown key (did you mean f_number?); got 2",
            'Scene: object[0].radius: must be a number; got "a"',
        ],
    ),
]


@pytest.mark.parametrize(("make", "messages"), BAD)
def test_faults_of_constructors_are_scene_errors(make: Callable[[], Any], messages: list[str]) -> None:
    assert list(refusals(make)) == messages


def test_parts_of_a_model_are_made_without_its_constructor(monkeypatch: pytest.MonkeyPatch) -> None:
    """Or the first fault of a part would hide all others, and scenes would take longer."""

    def called(self: object, **values: object) -> None:
        raise AssertionError("a constructor was called")

    monkeypatch.setattr(clsco.Camera, "__init__", called)
    with pytest.raises(AssertionError):
        clsco.Camera()
    assert clsco.parse_scene({"camera": {"f_number": 4}, "object": [{"shape": "sphere"}]}).camera.f_number == 4


def test_every_section_of_a_scene_has_a_public_class() -> None:
    parts = [type(part) for part in clsco.Scene(objects=(clsco.Plane(),)).__dict__.values()]
    named = {part for part in parts if part.__module__.startswith("clsco.")}
    assert len(named) >= 7
    assert named | {clsco.Light, clsco.Stereo} <= {getattr(clsco, name) for name in clsco.__all__}
