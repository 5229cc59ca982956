"""Drawings beside keys: they are what the keys do."""

from __future__ import annotations

import base64

import numpy as np
import pytest
from numpy.typing import NDArray

from clsco import parse_scene
from clsco.studio.drawings import PUPIL_PX, SPREAD_PX, drawings


def plot(text: str, side: int) -> NDArray[np.uint8]:
    return np.frombuffer(base64.b64decode(text), np.uint8).reshape(side, side)


def test_drawings_show_what_the_keys_do() -> None:
    scene = parse_scene({
        "camera": {"resolution": [400, 300], "pixel_pitch": 0.05},
        "sequence": {"shutter_curve": "triangle"},
        "object": [{"shape": "sphere"}],
    })  # fmt: skip
    found = drawings(scene)
    curve, side = np.array(found["curve"]), found["side"]
    assert curve.max() == 1.0
    assert np.allclose(curve, curve[::-1], atol=1e-3)
    assert np.all(np.diff(curve[: len(curve) // 2]) > 0)
    assert np.count_nonzero(plot(found["pupil"], side)) == pytest.approx(np.pi * PUPIL_PX**2, rel=0.1)
    assert len({text for row in found["spreads"] for text in row}) == 1  # the same over the field
    assert np.count_nonzero(plot(found["spreads"][0][0], side)) == pytest.approx(np.pi * SPREAD_PX**2, rel=0.2)
    ring = drawings(scene.replace("aperture", {"shape": "ring", "obstruction": 0.5}))
    assert plot(ring["pupil"], side)[side // 2, side // 2] == 0
    rims = drawings(scene.replace("aperture.rim", [{"distance": 60.0, "diameter": 14.0}]))
    assert rims["spreads"][0][0] != rims["spreads"][1][1]
