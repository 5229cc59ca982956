"""The same scene gives the same bytes: run again, in other groups of work-items, with other threads."""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Iterable
from typing import Any

import numpy as np
import pytest

import clsco
from clsco.frame.frame import Frame
from clsco.frame.outputs import TRUTH_NAMES
from clsco.reference.sequence import render as reference
from clsco.scene.file import parse_scene
from tests.pipeline.common import printed_with_threads
from tests.slow import mostly_slow

TURNING = {"velocity": [3.0, 0.0, -20.0], "angular_velocity": [0.0, 15.0, 25.0]}
IN_PLANE = TURNING | {"angular_velocity": [0.0, 0.0, 25.0]}
OBJECTS: dict[str, dict[str, Any]] = {
    "sphere": {"shape": "sphere", "center": [0.0, 0.0, 280.0], "motion": TURNING},
    "plane": {"shape": "plane", "distance": 260.0, "motion": IN_PLANE},
    "card": {"shape": "plane", "distance": 230.0, "bounds": [[-9.0, 12.0], [-15.0, 4.0], [-1.0, 1.0]]},
    "wall": {"shape": "plane", "distance": 330.0},
}


def digest(frames: Iterable[Frame]) -> str:
    """SHA-256 of every array of every frame."""
    found = hashlib.sha256()
    for frame in frames:
        for name in ("color", *TRUTH_NAMES):
            found.update(getattr(frame, name).tobytes())
    return found.hexdigest()


def outcome(name: str, warp: str, method: str) -> str:
    scene = parse_scene(
        {
            # Some 300 rows, so that there are several bands and groups for the threads to share.
            "camera": {"resolution": [200, 300], "pixel_pitch": 0.02, "aperture_diameter": 20.0},
            "sequence": {"samples": 2},
            "motion": {"warp": warp},
            "object": [OBJECTS[each] for each in name.split()],
        }
    )
    return digest(clsco.render(scene, method=method))


CASES = [
    ("sphere", "inverse", "gather"),
    ("sphere", "inverse", "scatter"),
    ("plane", "inverse", "convolve"),
    ("sphere card wall", "forward", "gather"),
]
OTHERS = [("sphere", "inverse", "tiles"), ("sphere", "forward", "gather"), ("sphere card wall", "inverse", "gather")]
Known = dict[tuple[str, str, str], str]


pytestmark = pytest.mark.processor  # of which there are more or fewer threads


@pytest.fixture(scope="module", params=[CASES, pytest.param(OTHERS, marks=pytest.mark.slow)], ids=["some", "others"])
def known(request: pytest.FixtureRequest) -> Known:
    found = {case: outcome(*case) for case in request.param}
    assert len(set(found.values())) == len(request.param)
    return found


def test_again(known: Known) -> None:
    assert {case: outcome(*case) for case in known} == known


@pytest.mark.parametrize("local", [(16, 4), pytest.param((1, 1), marks=pytest.mark.slow)])
def test_in_other_groups(local: tuple[int, int], known: Known, monkeypatch: pytest.MonkeyPatch) -> None:
    changed = [
        module for name, module in sys.modules.items() if name.startswith("clsco.") and hasattr(module, "PIXELS")
    ]
    assert len(changed) >= 2
    for module in changed:
        monkeypatch.setattr(module, "PIXELS", local)
    assert {case: outcome(*case) for case in known} == known


@pytest.mark.parametrize("threads", mostly_slow(["1", "3"], ["3"]))
def test_with_other_threads(threads: str, known: Known) -> None:
    cases = f"(outcome(*case) for case in {list(known)})"
    code = f"from tests.pipeline.test_same_bits import outcome; print(*{cases}, sep='\\n')"
    assert printed_with_threads(threads, code).split() == list(known.values())


@pytest.mark.parametrize(
    ("motion", "sequence"),
    [
        ({}, {"frames": 1}),
        ({"texture_filter": "nearest"}, {"frames": 2, "samples": 4, "shutter": 1.0}),
        ({"warp": "forward"}, {"frames": 2, "samples": 4, "shutter": 1.0, "sampling": "endpoint"}),
    ],
    ids=["still", "inverse", "forward"],
)
def test_where_arithmetic_is_exact_the_reference_has_the_same_bits(
    motion: dict[str, Any], sequence: dict[str, Any]
) -> None:
    """A plane in focus with light in steps of a 256th, and means of four moments."""
    light = (np.arange(48 * 80).reshape(48, 80) * 37 % 256 / 256).astype(np.float32)
    moving = {"velocity": [2.0, 1.0, 0.0]} if motion else {}
    scene = parse_scene(
        {
            "camera": {"resolution": [80, 48], "focus_distance": 250.0},
            "image": {"transfer": "linear"},
            "psf": {"edge": "sampled"},
            "sequence": sequence,
            "motion": motion,
            "object": [{"shape": "plane", "distance": 250.0, "texture": light, "motion": moving}],
        }
    )
    for found, expected in zip(clsco.render(scene), reference(scene), strict=True):
        for name in ("color", "sharp", "depth", "mask", "object_id", "normal", "filled", "hidden"):
            array = getattr(found, name)
            assert array.tobytes() == np.asarray(getattr(expected, name)).astype(array.dtype).tobytes(), name
