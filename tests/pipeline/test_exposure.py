"""Frames whose time samples have weights of their own in each row, as of a shutter that runs over the detector."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import clsco
from clsco import reference
from clsco.opencl.device import choose
from clsco.optics.exposure import Exposure, frame_exposure
from clsco.plan.memory import device_bytes
from clsco.plan.prepare import prepare
from clsco.plan.request import Request
from clsco.scene.model import Scene
from tests.pipeline.test_scenes import BALL, GOING, PLAIN
from tests.scenes import scene_from
from tests.slow import mostly_slow

Array = NDArray[np.float64]
ROWS, SAMPLES = 200, 3
CAMERA = {"resolution": [56, ROWS], "pixel_pitch": 0.08, "aperture_diameter": 20.0}
CARD = {"shape": "plane", "distance": 300.0, "texture": "checkerboard"}
MOVING = BALL | {"motion": GOING}
# Of each way to make a plane of a time sample.
CASES: dict[str, dict[str, Any]] = {
    "visibility": {},
    "layered": {"psf": PLAIN | {"occlusion": "layered"}},
    "forward": {"motion": {"warp": "forward"}, "psf": PLAIN | {"occlusion": "none"}},
}


def scene(sections: dict[str, Any], *items: dict[str, Any]) -> Scene:
    return scene_from({"camera": CAMERA, "psf": PLAIN, "sequence": {"samples": SAMPLES}} | sections, *items)


@pytest.fixture
def exposed(monkeypatch: pytest.MonkeyPatch) -> Callable[[Callable[[int], Array]], None]:
    """Gives frames other weights, (samples, rows), of a number of samples."""

    def expose(weights: Callable[[int], Array]) -> None:
        def changed(scene: Scene, frame: int, samples: int) -> Exposure:
            times = frame_exposure(scene, frame, samples).times
            return Exposure(times, weights(len(times)))

        for name, module in list(sys.modules.items()):
            if name.startswith("clsco.") and vars(module).get("frame_exposure") is frame_exposure:
                monkeypatch.setattr(module, "frame_exposure", changed)

    return expose


def rolling(samples: int) -> Array:
    """One time sample for each row, later ones further down."""
    return np.equal.outer(np.arange(samples), np.arange(ROWS) * samples // ROWS).astype(np.float64)


def ramp(samples: int) -> Array:
    """Later samples weigh more further down, 1 in all."""
    later = np.linspace(-1.0, 1.0, samples)[:, None] if samples > 1 else np.zeros((1, 1))
    return (1.0 + later * np.linspace(-1.0, 1.0, ROWS)) / samples


@pytest.mark.parametrize("name", mostly_slow(CASES, ["visibility"]))
def test_rows_are_those_of_their_time_samples(name: str, exposed: Callable[[Callable[[int], Array]], None]) -> None:
    """To the bit."""
    wanted, row = scene(CASES[name], MOVING, CARD), np.arange(ROWS)
    exposed(rolling)
    (frame,) = clsco.render(wanted, truth=("subframes",))
    assert frame.subframes is not None
    np.testing.assert_array_equal(frame.color, frame.subframes[row * SAMPLES // ROWS, row])
    assert (frame.subframes[0] != frame.subframes[-1]).any()


def test_a_still_scene_is_as_bright_as_its_weights(exposed: Callable[[Callable[[int], Array]], None]) -> None:
    still = scene({}, CARD)
    (plain,) = clsco.render(still, truth=())
    exposed(lambda samples: np.linspace(0.25, 1.75, ROWS)[None])
    (frame,) = clsco.render(still, truth=())
    gain = np.linspace(0.25, 1.75, ROWS)[:, None]
    np.testing.assert_allclose(frame.color, gain * plain.color, rtol=2.0**-22)


def test_weights_of_a_row_are_those_of_the_frame_in_strips(
    exposed: Callable[[Callable[[int], Array]], None],
) -> None:
    wanted = scene({}, MOVING, CARD)
    exposed(ramp)
    (whole,) = clsco.render(wanted, truth=("subframes",))
    memory = device_bytes(prepare(wanted, Request(("subframes",)), choose()).plan) - 1
    (tight,) = clsco.render(wanted, truth=("subframes",), memory=memory)
    assert tight.metadata["strips"] > whole.metadata["strips"] == 1
    assert whole.subframes is not None
    np.testing.assert_array_equal(tight.color, whole.color)
    np.testing.assert_array_equal(tight.subframes, whole.subframes)
    summed = np.einsum("tr,trc->rc", ramp(SAMPLES), whole.subframes.astype(np.float64))
    np.testing.assert_allclose(whole.color, summed, atol=1.2e-7)
    assert np.abs(whole.color - whole.subframes.mean(axis=0)).max() > 0.01


def test_a_shutter_with_a_curve_is_the_weighted_mean_of_its_subframes() -> None:
    """The ground truth belongs to the middle of its shutter, from wherever it opens."""
    sequence = {"samples": SAMPLES, "shutter": 0.6, "shutter_start": -0.3}
    wanted = scene({"sequence": sequence | {"shutter_curve": [0.0, 1.0, 0.5]}}, MOVING, CARD)
    (frame,), (exact,) = clsco.render(wanted, truth=("subframes", "depth")), reference.render(wanted)
    np.testing.assert_allclose(frame.color, exact.color, atol=1e-5)
    weights = [sample["weight"] for sample in frame.metadata["intermediate"]]
    assert sum(weights) == 1.0
    assert weights == pytest.approx([8 / 45, 7 / 15, 16 / 45])
    assert frame.subframes is not None
    summed = np.einsum("t,trc->rc", weights, frame.subframes.astype(np.float64))
    np.testing.assert_allclose(frame.color, summed, atol=1.2e-7)
    (reposed,) = clsco.render(scene({}, BALL, CARD), truth=("depth",))
    np.testing.assert_array_equal(frame.depth, reposed.depth)


def test_one_image_is_not_summed() -> None:
    """A frame of a single time sample runs no pass more and has no buffer more; one of several has these two."""
    still, moving = (prepare(scene({}, item, CARD)).plan for item in (BALL, MOVING))
    once = prepare(scene({"sequence": {"samples": 1}}, MOVING, CARD)).plan
    for plan, summed in ((still, False), (once, False), (moving, True)):
        found = {name: size for each in plan.passes for name, size in each.buffers.items() if name.startswith("frame")}
        assert any(each.kind == "accumulate" for each in plan.passes) == summed
        pixels = 4 * 56 * ROWS
        assert found == ({"frame sum": pixels, "frame lost": pixels} if summed else {})
    (frame,) = clsco.render(scene({}, BALL), truth=())
    assert "accumulate" not in frame.metadata["seconds"]
