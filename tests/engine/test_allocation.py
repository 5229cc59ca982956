"""The memory of a plan is what its frames allocate, to the byte."""

from __future__ import annotations

import gc
import weakref
from collections import Counter
from dataclasses import replace
from typing import Any

import pyopencl as cl
import pytest

import clsco
from clsco.engine.renderer import Renderer, expose
from clsco.opencl.session import Session
from clsco.passes.tables import shared_tables
from clsco.passes.trace import LatestHits
from clsco.plan.memory import buffer_bytes, device_bytes, fit_strips, lens_bytes, limit_of
from clsco.plan.prepare import prepare
from clsco.plan.request import Request
from clsco.scene.model import Scene
from tests.slow import mostly_slow

PLANE: dict[str, Any] = {"shape": "plane", "distance": 280.0, "slope_x": 0.4}
BALL: dict[str, Any] = {"shape": "sphere", "radius": 8.0, "center": [0.0, 0.0, 240.0], "texture": "checkerboard"}
MOVING: dict[str, Any] = {"motion": {"velocity": [2.0, 0.0, 0.0]}}
CAMERA: dict[str, Any] = {"resolution": [96, 64], "pixel_pitch": 0.1, "aperture_diameter": 30.0}
SCENES: dict[str, tuple[dict[str, Any], str]] = {
    "plane": ({"object": [PLANE]}, "auto"),
    "constant radius": ({"object": [{"shape": "plane", "distance": 280.0}]}, "auto"),
    "gaussian": ({"object": [PLANE], "psf": {"model": "gaussian"}}, "auto"),
    "sampled": ({"object": [PLANE], "psf": {"edge": "sampled"}}, "auto"),
    "polygon": ({"object": [PLANE], "aperture": {"shape": "polygon"}}, "auto"),
    "ball before a plane": ({"object": [BALL, PLANE]}, "auto"),
    "layered": ({"object": [BALL, PLANE], "psf": {"occlusion": "layered"}}, "auto"),
    "distorted": ({"object": [PLANE], "lens": {"distortion": [-0.1, 0.0, 0.0], "focus_surface": "sphere"}}, "auto"),
    "scatter": ({"object": [BALL, PLANE]}, "scatter"),
    "tiles": ({"object": [PLANE]}, "tiles"),
    "forward": ({"object": [PLANE | MOVING], "motion": {"warp": "forward"}}, "auto"),
    "forward, several": ({"object": [BALL | MOVING, PLANE], "motion": {"warp": "forward"}}, "auto"),
    "forward, ait": ({"object": [PLANE | MOVING], "motion": {"warp": "forward"}, "fill": {"method": "ait"}}, "auto"),
    "forward, not filled": (
        {"object": [PLANE | MOVING], "motion": {"warp": "forward"}, "fill": {"method": "none"}},
        "auto",
    ),
}


@pytest.fixture
def allocated(monkeypatch: pytest.MonkeyPatch) -> list[weakref.ref[Any]]:
    """Weak references to all buffers that are made."""
    found: list[weakref.ref[Any]] = []

    class Recorded(cl.Buffer):
        def __init__(self, *args: Any, **kwargs: Any) -> None:
            super().__init__(*args, **kwargs)
            found.append(weakref.ref(self))

    monkeypatch.setattr(cl, "Buffer", Recorded)
    return found


TABLES = ("intervals", "coefficients", "taps", "outlines")


def scene_of(data: dict[str, Any]) -> Scene:
    sequence = {"samples": 2, "frames": 1, "interval": 0.1, "shutter": 0.05}
    return clsco.parse_scene({"camera": CAMERA, "sequence": sequence} | data)


def forget(session: Session, allocated: list[weakref.ref[Any]]) -> None:
    """Release all buffers that a session keeps, as if nothing had been rendered before."""
    session.cache.clear()
    shared_tables().clear()
    gc.collect()
    allocated.clear()


def alive(allocated: list[weakref.ref[Any]]) -> list[int]:
    """Sizes of the buffers that are still there."""
    gc.collect()
    return [buffer.size for buffer in (reference() for reference in allocated) if buffer is not None]


@pytest.mark.parametrize("name", mostly_slow(SCENES, ["plane", "ball before a plane"]))
def test_the_plan_is_what_is_allocated(session: Session, allocated: list[weakref.ref[Any]], name: str) -> None:
    data, method = SCENES[name]
    prepared = prepare(scene_of(data), Request(("depth",), method), session.device)
    plan = prepared.plan
    limit = limit_of(None, session.device)
    expected = {name: size for name, size in buffer_bytes(plan).items() if not name.startswith("truth")}
    forget(session, allocated)
    renderer = Renderer(session, fit_strips(plan, limit), prepared, limit)
    (film,) = expose([renderer], 0)
    renderer.finish(film)
    found, wanted = Counter(alive(allocated)), Counter(size for size in expected.values() if size)
    tables = Counter(size for name, size in expected.items() if name.split()[-1] in TABLES)
    # Nothing beyond the plan; less where two blurs have one table of weights.
    assert (found - wanted, wanted - found - tables) == (Counter(), Counter()), expected


def test_lenses_have_one_set_of_hits_for_each_group(session: Session, allocated: list[weakref.ref[Any]]) -> None:
    scene = scene_of(SCENES["ball before a plane"][0])
    prepared = [
        prepare(scene.replace("camera.focus_distance", focus), Request((), "auto"), session.device)
        for focus in (250.0, 300.0)
    ]
    limit, guard = limit_of(None, session.device), max(each.plan.guard_px for each in prepared)
    plans, hits = [replace(each.plan, guard_px=guard) for each in prepared], LatestHits(session)
    assert plans[0].groups == plans[1].groups
    forget(session, allocated)
    renderers = [Renderer(session, plan, each, limit, hits) for plan, each in zip(plans, prepared, strict=True)]
    expose(renderers, 0)
    sizes, depth = alive(allocated), buffer_bytes(plans[0])["depth"]
    assert sizes.count(depth) == len(plans[0].groups) > 1
    assert sum(sizes) <= lens_bytes(plans) < sum(device_bytes(plan) for plan in plans) + len(plans[0].groups) * depth
