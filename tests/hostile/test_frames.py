"""Cases of `tests.hostile.frames` are valid scenes of every kind, and a wrong frame is reported; a few are rendered."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import clsco
from clsco import reference
from clsco.errors import SceneError
from clsco.scene.model import Scene
from clsco.scene.texture_keys import RULES
from tests.hostile import frames
from tests.hostile.drawn import WRAPS


def test_cases_are_valid_and_of_every_kind(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: Counter[str] = Counter()

    def noted(scene: Scene, method: str) -> list[str]:
        seen.update((method, scene.psf.occlusion, scene.motion.warp, scene.psf.edge, f"{len(scene.objects)} objects"))
        seen.update(item.shape for item in scene.objects)
        seen.update(each for item in scene.objects if item.mapped for each in (item.mapped, item.wrap))
        kinds = {"cut": any(item.bounds for item in scene.objects), "moves": scene.moves, "pair": scene.stereo}
        kinds |= {"rotated": any(item.rotation for item in scene.objects), "lit": scene.light is not None}
        kinds |= {"grouped": any(item.group for item in scene.objects)}
        seen.update(kind for kind, found in kinds.items() if found)
        return []

    monkeypatch.setattr(frames, "agrees", noted)
    tally = {"cases": 0, "refused": 0}
    for number in range(200):
        assert frames.outcome(number, tally) == []
    assert tally == {"cases": 200, "refused": 0}
    wanted = {"auto", "gather", "scatter", "tiles", "visibility", "layered", "none", "inverse", "forward", "sampled"}
    wanted |= {"plane", "sphere", "cylinder", "cone", "ellipsoid", "quadric", "1 objects", "2 objects", "3 objects"}
    wanted |= {"rectangle", "disc", "background", "cut", "moves", "pair", "rotated", "lit", "grouped"}
    wanted |= {*RULES, *WRAPS}
    assert wanted <= seen.keys()
    assert min(seen[name] for name in wanted) >= 5


def test_what_is_wrong_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    def brighter(scene: Scene, **_: Any) -> list[clsco.Frame]:
        return [replace(frame, color=frame.color + np.float32(2e-5)) for frame in reference.render(scene)]

    def refused(scene: Scene, **_: Any) -> list[clsco.Frame]:
        raise SceneError("something")

    tally = {"cases": 0, "refused": 0}
    monkeypatch.setattr(clsco, "render", brighter)
    assert all("color" in fault for fault in frames.outcome(25, tally))
    assert len(frames.outcome(25, tally)) == 1
    monkeypatch.setattr(clsco, "render", refused)
    assert frames.outcome(25, tally) == ["message: something"]


@pytest.mark.slow
@pytest.mark.parametrize("number", range(20))
def test_random_scenes_agree_with_the_reference(number: int) -> None:
    assert frames.outcome(number, {"cases": 0, "refused": 0}) == []
