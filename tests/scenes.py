"""Scenes that tests build: of objects, of tables as a scene file has them, and files; their plans and frames."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import clsco
from clsco import reference
from clsco.cli.check import compare
from clsco.errors import SceneError
from clsco.frame.frame import Frame
from clsco.frame.outputs import (
    LENS_NAMES,
    MAPPING_NAMES,
    MOTION_NAMES,
    ROLLING_NAMES,
    SENSOR_NAMES,
    STEREO_NAMES,
    TRUTH_NAMES,
)
from clsco.inputs.pupils import scene_point_spread
from clsco.plan.device import DeviceFacts
from clsco.plan.plan import Plan, make_plan
from clsco.plan.request import Request
from clsco.scene.file import FILE_KEYS, parse_scene
from clsco.scene.model import Camera, Scene

EXAMPLES = sorted(p for p in (Path(__file__).parents[1] / "examples").rglob("*.toml") if p.parent.name != "sets")
Table = Mapping[str, Any]
# A scene file for tests that look at files and messages: its frame takes no time.
PLANE = '[camera]\nresolution = [12, 9]\nnormalization_distance = 20.0\n[[object]]\nshape = "plane"\n'


def bare(scene: Scene) -> dict[str, Any]:
    """Content of a scene, with names of files in place of their paths."""
    content = scene.model_dump()
    for item in (*content["objects"], content["aperture"]):
        item |= {key: Path(item[key]).name for key in (*FILE_KEYS, "image") if isinstance(item.get(key), str)}
    return content


def scene_of(*items: Any, size: tuple[int, int] = (64, 48), camera: Table | None = None, **sections: Any) -> Scene:
    """A scene of objects in a frame of `size`, columns by rows; camera: its other keys."""
    return Scene(camera=Camera(resolution=size, **(camera or {})), objects=items, **sections)


def plan_of(
    *items: Any, channels: int = 1, truth: tuple[str, ...] = (), method: str = "auto",
    color: bool = True, device: DeviceFacts | None = None, **scene: Any,
) -> Plan:  # fmt: skip
    """The plan of such a scene, without ground truth unless `truth` names some; scene: what `scene_of` takes."""
    return plan_scene(scene_of(*items, **scene), channels, Request(truth, method, color=color), device=device)


def plan_scene(scene: Scene, channels: int, *arguments: Any, **options: Any) -> Plan:
    """`make_plan` with the PSF of the scene."""
    return make_plan(scene, scene_point_spread(scene), channels, *arguments, **options)


def scene_from(tables: Table, *items: Table, **sections: Any) -> Scene:
    """A scene of tables as a file has them, with these objects if any; keys of `sections` replace the tables' own."""
    found = {**tables, **({"object": list(items)} if items else {})}
    for name, section in sections.items():
        found[name] = {**found.get(name, {}), **section} if isinstance(section, Mapping) else section
    return parse_scene(found)


def refusals(call: Callable[..., object], *arguments: Any) -> tuple[str, ...]:
    """Messages of the SceneError that a call raises."""
    with pytest.raises(SceneError) as caught:
        call(*arguments)
    return caught.value.messages


def scene_file(path: Path, text: str) -> Path:
    """Write a scene file; gives its path."""
    path.write_text(text, "utf-8")
    return path


def rendered(wanted: Scene, **options: Any) -> list[Any]:
    """All frames of a scene; of any type, as types do not say which arrays a frame has."""
    return list(clsco.render(wanted, **options))


@lru_cache(maxsize=64)
def reference_frames(wanted: Scene) -> list[Any]:
    """All frames of a scene by the reference, which renders it once for all tests of a process."""
    return list(reference.render(wanted))


def outputs_of(scene: Scene) -> set[str]:
    """Names of a frame's outputs, color among them, that a scene has unless fewer or more are asked for."""
    found = {"color", *TRUTH_NAMES}
    found |= {*STEREO_NAMES} if scene.stereo is not None else set()
    found |= {*MOTION_NAMES} if scene.moves else set()
    found |= {*MAPPING_NAMES} if scene.has_mapped_textures else set()
    found |= {*ROLLING_NAMES} if scene.rolls else set()
    found |= {*LENS_NAMES} if scene.darkens or scene.aperture.rim else set()
    return found | ({*SENSOR_NAMES} if scene.sensor is not None else set())


def assert_same(one: Frame, other: Frame) -> None:
    """Two frames have the same outputs, to the bit."""
    found, expected = one.arrays(), other.arrays()
    assert found.keys() == expected.keys()
    for name, array in expected.items():
        np.testing.assert_array_equal(found[name].view(np.uint8), array.view(np.uint8), name, strict=True)


def assert_agree(frames: list[Frame], exact: list[Frame], least: float = 0.02) -> None:
    """All outputs of frames are those of others, which may be the reference's, and there is something to compare.

    least: share of pixels that show a surface.
    """
    assert len(frames) == len(exact) > 0
    found = [difference for pair in zip(frames, exact, strict=True) for difference in compare(*pair)]
    assert [difference for difference in found if not difference.agrees] == []
    for frame in frames:
        assert np.ptp(frame.color) > 0.05
        assert frame.mask is not None
        assert frame.mask.mean() >= least
