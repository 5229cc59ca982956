"""A frame in strips has the bits of the whole frame, and takes the memory that was predicted."""

from __future__ import annotations

import sys
from dataclasses import replace
from typing import Any

import numpy as np
import pyopencl as cl
import pytest

import clsco
from clsco.constants import BAND
from clsco.engine.sequence import render_sweep
from clsco.errors import SceneError
from clsco.frame.frame import Frame
from clsco.frame.outputs import ALL_TRUTH
from clsco.frame.strips import cut_strips
from clsco.opencl.device import choose
from clsco.opencl.session import session_for
from clsco.plan.memory import buffer_bytes, device_bytes
from clsco.plan.plan import Plan, make_plan
from clsco.plan.prepare import prepare
from clsco.plan.request import Request
from clsco.scene.model import Scene
from tests.scenes import assert_same, rendered, scene_from
from tests.slow import mostly_slow

ROWS, COLUMNS = 3 * BAND + 23, 50
MOVING = {"velocity": [3.0, -9.0, -20.0], "angular_velocity": [0.0, 15.0, 25.0]}
BALL = {"shape": "sphere", "center": [1.0, 0.0, 280.0], "radius": 12.0, "texture": "checkerboard", "motion": MOVING}
CARD = {"shape": "plane", "distance": 230.0, "bounds": [[-5.0, 4.0], [-15.0, 4.0], [-1.0, 1.0]]}
FLOOR = {"shape": "plane", "distance": 300.0, "slope_y": 0.4}
WALL = {"shape": "plane", "distance": 330.0}
SCENES: dict[str, tuple[str, dict[str, Any]]] = {
    "moving ball": ("gather", {"object": [BALL], "sequence": {"samples": 2, "frames": 2}}),
    "card before a floor": ("gather", {"object": [CARD, FLOOR]}),
    "pair": ("gather", {"object": [BALL, FLOOR], "stereo": {"baseline": 6.0}, "psf": {"occlusion": "none"}}),
    "fixed point": ("scatter", {"object": [BALL], "psf": {"edge": "area"}}),
    "fixed point, card": ("scatter", {"object": [CARD, FLOOR]}),
    "tiles": ("tiles", {"object": [BALL]}),
    "light given back": ("gather", {"object": [BALL], "psf": {"border": "renormalize", "edge": "sampled"}}),
    "one radius": ("convolve", {"object": [WALL]}),
    "in focus": ("auto", {"object": [WALL], "camera": {"focus_distance": 330.0}}),
}
# Buffers that the views of a pair share, and the plan counts for each.
SHARED = ("texture", *(f"blur {sub}{table}" for sub in ("", "subpixel ") for table in ("intervals", "coefficients")))
SHARED += ("blur taps", "blur outlines")
CAMERA = {"resolution": [COLUMNS, ROWS], "pixel_pitch": 0.04, "aperture_diameter": 45.0}


def named(name: str) -> Scene:
    return scene_from({"camera": CAMERA}, **SCENES[name][1])


def memory_for(scene: Scene, rows: int, truth: tuple[str, ...] = ALL_TRUTH, method: str = "auto") -> int:
    """Just as much as strips of so many rows need."""
    session_for(None).cache.clear()  # what other renders have left is let go of before it is measured
    eyes = ("left",) if scene.stereo is None else ("left", "right")
    plans = [replace(plan_of(scene, truth, method, eye), strip_rows=rows) for eye in eyes]
    return max(device_bytes(replace(plan, device=choose()), len(eyes)) for plan in plans)


def plan_of(scene: Scene, truth: tuple[str, ...], method: str, eye: Any) -> Plan:
    known = prepare(scene, Request(truth, method), choose())
    return known.plans[eye == "right"]


def assert_cut(
    scene: Scene, rows: int, count: int, whole: list[Frame], peak: list[int], method: str = "auto", shared: int = 0
) -> list[Frame]:
    """Frames in `count` strips of so many rows, with the bits of whole ones and the predicted memory; gives them.

    shared: bytes that the views of a pair share.
    """
    limit, before = memory_for(scene, rows, method=method), peak[0]
    peak[1] = before
    tiled = list(clsco.render(scene, method=method, memory=limit))
    # The plan counts no structs and no statistics: some kB.
    assert peak[1] - before + shared == pytest.approx(limit, rel=0.05)
    assert {frame.metadata["strips"] for frame in tiled} == {count}
    assert_all_same(whole, tiled)
    return tiled


def assert_all_same(frames: list[Frame], others: list[Frame]) -> None:
    assert len(frames) == len(others) > 0
    for one, other in zip(frames, others, strict=True):
        assert_same(other, one)


@pytest.fixture
def peak(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """[bytes of all buffers that are there now, the most so far]."""
    seen = [0, 0]

    class Counted(cl.Buffer):
        def __init__(self, *args: Any, **options: Any) -> None:
            super().__init__(*args, **options)
            self.bytes = int(self.size)
            seen[0] += self.bytes
            seen[1] = max(seen)

        def __del__(self) -> None:
            seen[0] -= self.bytes

    monkeypatch.setattr(cl, "Buffer", Counted)
    return seen


@pytest.mark.parametrize("name", mostly_slow(SCENES, ["card before a floor", "one radius", "in focus"]))
def test_strips_have_the_bits_of_the_whole_frame(name: str, peak: list[int]) -> None:
    scene, method = named(name), SCENES[name][0]
    whole = list(clsco.render(scene, method=method))
    assert {frame.metadata["strips"] for frame in whole} == {1}
    assert len(np.unique(whole[0].color)) > 100
    sizes = buffer_bytes(plan_of(scene, ALL_TRUTH, method, "left"))
    twice = sum(sizes[one] for one in SHARED if name == "pair")
    for rows, count in ((BAND, 4), (2 * BAND, 2)):
        assert_cut(scene, rows, count, whole, peak, method, twice)


TALL = 17 * BAND + 23
CARDS = [CARD | {"bounds": [[-5.0, 4.0], [-75.0 + k, 75.0], [-1.0, 1.0]], "distance": 230.0 + 9 * k} for k in (0, 7)]


@pytest.mark.parametrize(
    ("method", "sections"),
    mostly_slow([
        ("gather", {"object": [*CARDS, FLOOR]}),
        ("gather", {"object": [BALL, WALL], "sequence": {"samples": 2}}),
        ("scatter", {"object": [*CARDS, FLOOR], "psf": {"model": "gaussian"}}),
        ("gather", {"object": [*CARDS, WALL], "psf": {"border": "renormalize"}}),
        ("gather", {"object": [CARDS[0], FLOOR], "camera": {"aperture_diameter": 24.0}}),
    ], [("gather", {"object": [*CARDS, FLOOR]})]),
)  # fmt: skip
def test_layers_in_strips(method: str, sections: dict[str, Any], peak: list[int]) -> None:
    """All strips have a say in where depth layers begin; what goes on behind an edge is made from what is near."""
    camera = {"resolution": [COLUMNS, TALL], "pixel_pitch": 0.04, "aperture_diameter": 8.0}
    scene = scene_from({"camera": camera, "psf": {"occlusion": "layered"}}, **sections)
    whole = list(clsco.render(scene, method=method))
    assert {frame.metadata["strips"] for frame in whole} == {1}
    assert whole[0].metadata["intermediate"][0]["depth_layers"] > 1
    for rows in (BAND, 4 * BAND):
        tiled = assert_cut(scene, rows, -(-TALL // rows), whole, peak, method)
        assert tiled[0].metadata["intermediate"] == whole[0].metadata["intermediate"]


@pytest.mark.parametrize("holes", [False, pytest.param(True, marks=pytest.mark.slow)])
@pytest.mark.parametrize("occlusion", ["layered", "none"])
def test_a_depth_map_in_strips(occlusion: str, holes: bool, peak: list[int]) -> None:
    """The mirror image around it is wider than the strips' own part of the last one."""
    rows, columns = 9 * BAND + 5, 40
    rng, (i, j) = np.random.default_rng(4), np.indices((rows, columns))
    depth = np.where(np.sin(i / 30.0) * np.cos(j / 9.0) > 0.3, 260.0, 320.0) + i / 20
    depth = np.where(rng.random(depth.shape) < 0.02 * holes, 0.0, depth).astype(np.float32)
    item = {"shape": "depth_map", "texture": rng.random((rows, columns), np.float32), "depth": depth}
    camera = {"pixel_pitch": 0.04, "aperture_diameter": 7.0}
    fill = {"motion": {"warp": "forward"}, "fill": {"method": "none"}} if holes else {}
    scene = scene_from(fill, item, camera=camera, psf={"occlusion": occlusion})
    whole = rendered(scene)
    assert whole[0].mask.all() == (not holes)
    for tall in (BAND, 3 * BAND):
        assert_cut(scene, tall, -(-rows // tall), whole, peak)


def test_a_plan_that_was_too_small(monkeypatch: pytest.MonkeyPatch, peak: list[int]) -> None:
    """Radii beyond the prediction: the whole frame again, in strips of the wider plan."""
    scene, least = named("moving ball"), 2.0
    limit = memory_for(scene, BAND)

    def short(*args: Any, **options: Any) -> Plan:
        plan = make_plan(*args, **options)
        assert plan.largest_blur > 2 * least
        return replace(plan, largest_blur=least, guard_px=0)

    monkeypatch.setattr(sys.modules["clsco.plan.prepare"], "make_plan", short)
    whole = list(clsco.render(scene, frames=[0]))
    before = peak[1] = peak[0]
    tiled = list(clsco.render(scene, frames=[0], memory=limit))
    assert peak[1] - before < 1.05 * limit
    assert whole[0].metadata["strips"] == 1
    assert tiled[0].metadata["strips"] > 1
    assert tiled[0].metadata["guard_px"] > 0
    assert_all_same(whole, tiled)


def test_a_sweep_in_strips() -> None:
    """Lenses share their rays where there is memory for all of them at a time, and else do not."""
    base = named("moving ball")
    cameras = [base.camera.model_copy(update={"aperture_diameter": opening}) for opening in (45.0, 44.0)]
    scenes = [base.model_copy(update={"camera": camera}) for camera in cameras]
    whole = [frame for _, frame in render_sweep(scenes, truth=(), frames=[0])]
    tiled = [frame for _, frame in render_sweep(scenes, truth=(), frames=[0], memory=memory_for(scenes[0], BAND, ()))]
    assert [frame.metadata["strips"] for frame in whole] == [1, 1]
    assert min(frame.metadata["strips"] for frame in tiled) > 1
    assert_all_same(whole, tiled)


def test_the_forward_warp_needs_the_whole_frame(peak: list[int]) -> None:
    scene = scene_from({"camera": CAMERA, "object": [BALL]}, motion={"warp": "forward"})
    needed, before = memory_for(scene, ROWS, ()), peak[0]
    with pytest.raises(SceneError, match="as the forward warp needs the whole"):
        next(clsco.render(scene, truth=(), memory=needed // 2))
    peak[1] = before
    frame = next(clsco.render(scene, truth=(), memory=needed))
    assert frame.metadata["strips"] == 1
    assert peak[1] - before == pytest.approx(needed, rel=0.05)


@pytest.mark.parametrize(("rows", "tallest"), [(1, 1), (64, 64), (65, 64), (500, 128), (500, 500)])
@pytest.mark.parametrize(("guard", "reach", "step"), [(0, 7, 1), (9, 7, 1), (200, 190, 1), (9, 7, 8), (0, 77, 128)])
def test_strips_cover_the_frame(rows: int, tallest: int, guard: int, reach: int, step: int) -> None:
    strips = cut_strips(rows, tallest, guard, reach, step)
    assert [row for strip in strips for row in range(strip.top, strip.top + strip.rows)] == list(range(rows))
    for strip in strips:
        first, last = strip.top - strip.above, strip.top + strip.rows + strip.below
        assert first % step == -guard % step
        assert 0 <= max(-guard, strip.top - max(guard, reach)) - first < step
        assert last == min(rows + guard, strip.top + strip.rows + max(guard, reach))
        assert strip.height == last - first
