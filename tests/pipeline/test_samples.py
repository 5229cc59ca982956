"""Outputs of the time samples of a frame: their images by themselves, and the pixels that were missing in any."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import clsco
from clsco import reference
from clsco.engine.renderer import Renderer
from clsco.frame.channels import exr_channels
from clsco.passes.warp import ForwardWarp
from clsco.plan.prepare import prepare
from clsco.plan.request import Request
from clsco.scene.model import Scene
from tests.pipeline.common import PLAIN, assert_strips_agree
from tests.pipeline.test_scenes import BALL, GOING
from tests.scenes import scene_from
from tests.slow import mostly_slow

CAMERA = {"resolution": [56, 40], "pixel_pitch": 0.08, "aperture_diameter": 20.0}
MOVING = BALL | {"motion": GOING}
NEAR = {"shape": "sphere", "center": [12.0, 6.0, 240.0], "radius": 10.0, "texture": "#c06020"}
TIMES = {"frames": 2, "interval": 0.6, "samples": 3}
FORWARD = {"motion": {"warp": "forward"}, "fill": {"domain": "span"}}
NO_FILL = FORWARD | {"fill": {"method": "none", "domain": "span"}}


def scene(sections: dict[str, Any], *items: dict[str, Any]) -> Scene:
    return scene_from({"camera": CAMERA, "psf": PLAIN}, *items, **sections)


CASES: dict[str, Scene] = {
    "inverse": scene({"sequence": TIMES}, MOVING),
    "forward": scene({"sequence": TIMES} | FORWARD, MOVING),
    "not filled": scene({"sequence": TIMES} | NO_FILL, MOVING),
    "color": scene({"sequence": TIMES}, MOVING, NEAR),
    "still": scene({}, BALL),
    "stereo": scene({"sequence": TIMES, "stereo": {"baseline": 5.0}} | FORWARD, MOVING),
}


def rendered(wanted: Scene, *truth: str, **options: Any) -> list[Any]:
    return list(clsco.render(wanted, truth=truth, **options))


@pytest.mark.parametrize("name", mostly_slow(CASES, ["inverse", "forward", "still"]))
def test_they_agree_with_the_reference(name: str) -> None:
    wanted = CASES[name]
    exact: list[Any] = [*reference.render(wanted, subframes=True)]
    for frame, expected in zip(rendered(wanted, "missing", "subframes"), exact, strict=True):
        assert frame.subframes.dtype == np.float32
        assert frame.subframes.shape == (len(frame.metadata["intermediate"]), *frame.color.shape)
        np.testing.assert_allclose(frame.subframes, expected.subframes, atol=1e-5)
        np.testing.assert_array_equal(frame.missing, expected.missing)
        assert np.ptp(frame.subframes[0]) > 0.1


@pytest.mark.parametrize("name", ["inverse", "forward"])
def test_a_subframe_is_the_frame_of_one_time_sample(name: str) -> None:
    """Bit by bit, and the frame is their mean, with the bits that it has without them."""
    wanted = CASES[name]
    alone = {"frames": 6, "interval": 0.2, "shutter": 0.2, "samples": 1}
    single = rendered(wanted.replace("sequence", alone))
    frames = rendered(wanted, "subframes")
    found: list[Any] = []
    for frame in frames:
        found += list(frame.subframes)
        np.testing.assert_allclose(frame.subframes.mean(axis=0), frame.color, atol=1e-6)
    times = [sample["time"] for frame in frames for sample in frame.metadata["intermediate"]]
    assert times == pytest.approx([sample["time"] for one in single for sample in one.metadata["intermediate"]])
    for image, one in zip(found, single, strict=True):
        np.testing.assert_array_equal(image, one.color)
    for frame, without in zip(frames, rendered(wanted), strict=True):
        np.testing.assert_array_equal(frame.color, without.color)
        assert without.subframes is None
        assert frame.metadata["intermediate"] == without.metadata["intermediate"]


def test_missing_is_what_the_samples_count() -> None:
    """All pixels that one sample counts are missing, of several samples their union, whether they are filled or not."""
    for wanted in (CASES["forward"], CASES["not filled"]):
        for frame in rendered(wanted, "missing"):
            counts = [sample["missing_pixels"] for sample in frame.metadata["intermediate"]]
            assert frame.missing.dtype == np.bool_
            assert max(counts) <= frame.missing.sum() <= sum(counts)
        last = wanted.replace("sequence", {"samples": 1, "sampling": "endpoint"})
        (frame,) = rendered(last, "missing", "filled")
        assert frame.missing.sum() == frame.metadata["intermediate"][0]["missing_pixels"] > 20
    (filled,), (left,) = (rendered(CASES[name], "missing", frames=[0]) for name in ("forward", "not filled"))
    np.testing.assert_array_equal(filled.missing, left.missing)


def test_nothing_is_missing_where_no_pixel_is_moved() -> None:
    for frame in rendered(CASES["inverse"], "missing"):
        assert not frame.missing.any()


def test_holes_of_a_static_depth_map_are_missing() -> None:
    depth = np.full((40, 56), 260.0)
    depth[10:20, 30:33] = 0.0
    item = {"shape": "depth_map", "depth": depth, "texture": np.full((40, 56), 0.5, np.float32)}
    wanted = scene(NO_FILL | {"psf": {"occlusion": "none"}}, item)
    assert prepare(wanted).plan.static_map
    (frame,), (exact,) = rendered(wanted, "missing"), reference.render(wanted)
    np.testing.assert_array_equal(frame.missing, depth == 0.0)
    np.testing.assert_array_equal(exact.missing, depth == 0.0)


def test_who_does_not_ask_for_them_pays_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """No kernel is run for them, nothing is read back, and no buffer is there; sub-frames are read, not made again."""
    calls: list[str] = []

    def counted(kind: type[Any], name: str) -> None:
        method = getattr(kind, name)

        def call(*args: Any) -> Any:
            calls.append(name)
            return method(*args)

        monkeypatch.setattr(kind, name, call)

    counted(ForwardWarp, "missing")
    counted(Renderer, "add")
    rendered(CASES["forward"], "filled", frames=[0])
    assert calls == ["add"] * 3
    calls.clear()
    rendered(CASES["forward"], "missing", "subframes", frames=[0])
    assert calls == ["add", "missing"] * 3
    with_them, without = (prepare(CASES["forward"], Request(t)).plan for t in (("missing", "subframes"), ()))
    assert with_them.features() == without.features()
    assert with_them.taps == without.taps > 0


@pytest.mark.parametrize("occlusion", mostly_slow(["visibility", "layered"], ["visibility"]))
def test_in_strips(occlusion: str) -> None:
    """With layers too, which are those of the whole frame."""
    high = {"camera": CAMERA | {"resolution": [56, 100]}, "psf": PLAIN | {"occlusion": occlusion}}
    whole = assert_strips_agree(scene(high | {"sequence": TIMES | {"frames": 1}}, MOVING, NEAR), ("alpha", "subframes"))
    assert whole.subframes.shape == (3, 100, 56, 3)


def test_a_shutter_with_a_curve_is_the_weighted_mean_of_its_subframes() -> None:
    """The ground truth belongs to the middle of its shutter, from wherever it opens."""
    sequence = {"samples": 3, "shutter": 0.6, "shutter_start": -0.3}
    wanted = scene({"sequence": sequence | {"shutter_curve": [0.0, 1.0, 0.5]}}, MOVING)
    (frame,), (exact,) = rendered(wanted, "subframes", "depth"), reference.render(wanted)
    np.testing.assert_allclose(frame.color, exact.color, atol=1e-5)
    weights = [sample["weight"] for sample in frame.metadata["intermediate"]]
    assert sum(weights) == 1.0
    assert weights == pytest.approx([8 / 45, 7 / 15, 16 / 45])
    summed = np.einsum("t,trc->rc", weights, frame.subframes.astype(np.float64))
    np.testing.assert_allclose(frame.color, summed, atol=1.2e-7)
    (reposed,) = rendered(CASES["still"], "depth")
    np.testing.assert_array_equal(frame.depth, reposed.depth)


def test_one_image_is_not_summed() -> None:
    """A frame of a single time sample runs no pass more and has no buffer more; one of several has these two."""
    once = {"sequence": {"samples": 1}}
    for sections, item, summed in (({}, BALL, False), (once, MOVING, False), ({}, MOVING, True)):
        plan = prepare(scene(sections, item)).plan
        found = {name: size for each in plan.passes for name, size in each.buffers.items() if name.startswith("frame")}
        assert any(each.kind == "accumulate" for each in plan.passes) == summed
        assert found == ({"frame sum": 4 * 56 * 40, "frame lost": 4 * 56 * 40} if summed else {})


def test_an_exr_has_them_as_layers() -> None:
    frame = rendered(CASES["color"], "alpha", "subframes", frames=[0])[0]
    channels = exr_channels(frame.arrays())
    assert [name for name in channels if name.startswith("sample_")] == [
        f"sample_0{number}.{color}" for number in range(3) for color in "RGB"
    ]
    np.testing.assert_array_equal(channels["sample_02.G"], frame.subframes[2, ..., 1])
