"""Random small scenes agree with the reference as `clsco check` asks, in double precision.

A case draws every key that changes what is computed (`drawn.py`), and the method; keys that do not go together make it
one of those that are refused.
"""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np
import pytest

import clsco
from clsco import reference
from clsco.cli.check import compare
from clsco.errors import ClscoError, SceneError
from clsco.plan.methods import MANY_RADII
from clsco.scene.file import parse_scene
from clsco.scene.model import Scene
from clsco.scene.texture_keys import RULES
from tests.hostile.drawn import WRAPS, sections

MANY = 20  # cases of a test


def scene_of(number: int) -> tuple[Scene, str]:
    """Scene and method of a case. Raises SceneError where its keys do not go together."""
    content, rng = sections(number), np.random.default_rng([11, number])
    while True:
        try:
            return parse_scene(content), str(rng.choice(["auto", *MANY_RADII]))
        except SceneError as error:  # keys that have no use in this scene, which a scene file may not have
            if not remove_key(content, str(error).split(": ")[1]):
                raise


def remove_key(content: dict[str, Any], key: str) -> bool:
    """Take a key out of the sections, "object[1].bounds" of the second object; whether it was there."""
    *path, last = key.replace("[", ".").replace("]", "").split(".")
    at: Any = content
    for part in path:
        at = at[int(part)] if isinstance(at, list) else at.get(part, {})
    return isinstance(at, dict) and at.pop(last, None) is not None


def faults_of(number: int) -> list[str]:
    """Differences of the first frame, or frames of a stereo pair, of a case."""
    scene, method = scene_of(number)
    try:
        frames = list(clsco.render(scene, method=method, precision="double"))
    except ClscoError as error:
        return [] if "; got " in str(error) else [f"message: {error}"]
    faults = []
    for frame, exact in zip(frames, reference.render(scene), strict=True):
        faults += [f"{number} {frame.eye}: {difference}" for difference in compare(frame, exact) if difference.count]
    return faults


def test_cases_are_valid_and_of_every_kind() -> None:
    seen: Counter[str] = Counter()
    for number in range(200):
        scene, method = scene_of(number)
        seen.update((method, scene.psf.occlusion, scene.motion.warp, scene.psf.edge, f"{len(scene.objects)} objects"))
        seen.update(item.shape for item in scene.objects)
        seen.update(each for item in scene.objects if item.mapped for each in (item.mapped, item.wrap))
        kinds = {"cut": any(item.bounds for item in scene.objects), "moves": scene.moves, "pair": scene.stereo}
        kinds |= {"rotated": any(item.rotation for item in scene.objects), "lit": scene.light is not None}
        kinds |= {"grouped": any(item.group for item in scene.objects)}
        seen.update(kind for kind, is_there in kinds.items() if is_there)
    expected = {"auto", "gather", "scatter", "tiles", "visibility", "layered", "none", "inverse", "forward", "sampled"}
    expected |= {"plane", "sphere", "cylinder", "cone", "ellipsoid", "quadric", "1 objects", "2 objects", "3 objects"}
    expected |= {"rectangle", "disc", "background", "cut", "moves", "pair", "rotated", "lit", "grouped"}
    expected |= {*RULES, *WRAPS}
    assert expected <= seen.keys()
    assert min(seen[name] for name in expected) >= 5


@pytest.mark.parametrize(
    "first",
    [pytest.param(first, marks=pytest.mark.slow if first == 0 else pytest.mark.soak) for first in range(0, 1000, MANY)],
)
def test_random_scenes_agree_with_the_reference(first: int) -> None:
    assert [fault for number in range(first, first + MANY) for fault in faults_of(number)] == []
