"""Renders that follow each other: the bits of renders alone, nothing made anew, bounded memory, an end at will."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pyopencl as cl
import pytest

import clsco
from clsco.engine.film import Film
from clsco.engine.live import Live
from clsco.engine.renderer import Renderer
from clsco.frame.frame import Frame
from clsco.opencl.device import choose
from clsco.opencl.program import Target
from clsco.opencl.session import Session
from clsco.passes.blur import Scatter
from clsco.passes.gather import Gather
from clsco.plan.prepare import prepare
from clsco.scene.model import Scene
from tests.scenes import assert_same as same
from tests.scenes import scene_from

COMPLETE = cl.command_execution_status.COMPLETE
TABLES: dict[str, Any] = {
    "camera": {"resolution": [72, 56], "pixel_pitch": 0.06, "aperture_diameter": 12.0},
    "sequence": {"samples": 3, "shutter": 0.2},
}
BALL = {"shape": "sphere", "center": [0.0, 0.0, 280.0], "radius": 16.0, "texture": "bricks"}
WALL = {"shape": "plane", "distance": 330.0, "texture": "checkerboard"}
CARD = {"shape": "plane", "distance": 240.0, "bounds": [[-9, 0], [-9, 9], [-1, 1]], "texture": "siemens_star"}
SCENES = {
    "ball": scene_from(TABLES, BALL),
    "visibility": scene_from(TABLES, BALL, WALL, CARD),
    "moving": scene_from(TABLES, BALL | {"motion": {"velocity": [30.0, 0.0, 0.0]}}, WALL),
    "gaussian": scene_from(TABLES, BALL, psf={"model": "gaussian"}),
    "layered": scene_from(TABLES, BALL, CARD, psf={"occlusion": "layered"}),
    "forward": scene_from(TABLES, BALL | {"motion": {"velocity": [30.0, 0.0, 0.0]}}, motion={"warp": "forward"}),
    "one radius": scene_from(TABLES, WALL),
}
CHANGES: list[tuple[str, Any]] = [
    ("camera.focus_distance", 260.0),
    ("camera.focus_distance", 300.0),
    ("camera.aperture_diameter", 30.0),
    ("object[0].texture", "slanted_edge"),
    ("camera.focus_distance", 260.0),
]


@pytest.fixture
def live() -> Iterator[Live]:
    with Live() as opened:
        yield opened


def alone(scene: Scene, **options: Any) -> Frame:
    """As a process renders that has rendered nothing yet, but for its kernels."""
    with Session(choose()) as session:
        return clsco.render_frame(scene, device=session.queue, **options)


@pytest.mark.slow
@pytest.mark.parametrize("name", list(SCENES))
def test_frames_have_the_bits_of_frames_alone(live: Live, name: str) -> None:
    scene = SCENES[name]
    for key, value in CHANGES:
        scene = scene.replace(key, value)
        same(live.render(scene), clsco.render_frame(scene))
    same(live.render(scene, precision="single"), clsco.render_frame(scene, precision="single"))
    same(live.render(scene), alone(scene))


@pytest.fixture
def launched(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of the kernels that are run."""
    names, run = list[str](), Target.run

    def noted(self: Any, name: str, *args: Any, **options: Any) -> None:
        names.append(name)
        run(self, name, *args, **options)

    monkeypatch.setattr(Target, "run", noted)
    return names


def test_a_lens_casts_no_rays_again(live: Live, launched: list[str]) -> None:
    scene, bands = SCENES["moving"], set[int]()

    def cast(wanted: Scene) -> int:
        launched.clear()
        live.render(wanted, truth=())
        plan = prepare(wanted).plan
        bands.add(plan.guard_px)
        assert launched.count("aim") == plan.subframes * len(plan.groups)  # rendered once, if in a wider band than that
        return launched.count("cast")

    assert (first := cast(scene)) >= 3
    for distance, number in ((250.0, 2.0), (265.0, 1.0), (200.0, 0.5)):
        assert cast(scene.replace("camera.focus_distance", distance).replace("camera.f_number", number)) == 0
    assert len(bands) > 1
    moved = scene.replace("object[0].motion.velocity", (40.0, 0.0, 0.0))
    groups = len(prepare(scene).plan.groups)
    assert 0 < cast(moved) <= first
    assert groups == 1 or cast(scene.replace("object[0].motion.velocity", (20.0, 0.0, 0.0))) < first
    assert cast(scene.replace("object[0].texture", "slanted_edge")) > 0


@pytest.mark.slow
def test_too_little_room_for_subpixel_sources_is_found_before_the_blur(
    live: Live, launched: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = SCENES["visibility"]
    expected = live.render(scene)
    launched.clear()
    for blur in (Gather, Scatter):  # of processors, and of cards where objects hide each other
        monkeypatch.setattr(blur, "spread", _blur_noted(launched, blur))
    monkeypatch.setattr("clsco.plan.plan.SILHOUETTE_SLOTS", 0)
    same(live.render(scene), expected)
    assert launched[: launched.index("blur")].count("mark_silhouettes") == 2


def _blur_noted(launched: list[str], blur: Any) -> Any:
    spread = blur.spread

    def noted(self: Any, *args: Any) -> None:
        launched.append("blur")
        spread(self, *args)

    return noted


def test_what_is_kept_is_bounded() -> None:
    with Live(keep="400kB") as live:
        for distance in np.linspace(230.0, 330.0, 4):
            live.render(SCENES["moving"].replace("object[1].distance", float(distance + 60)))
            assert live.session.cache.bytes <= 400_000
            assert live.files.cache.bytes <= 400_000
        same(live.render(SCENES["moving"]), clsco.render_frame(SCENES["moving"]))


def test_a_render_ends_when_it_is_canceled(live: Live, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = SCENES["moving"].replace("sequence.samples", 12)
    live.cancel()  # of nothing
    expected = live.render(scene, truth=())
    go_on, count = live.session.go_on, [0]

    def counted() -> None:
        count[0] += 1
        if count[0] == 5:
            thread = threading.Thread(target=live.cancel)
            thread.start()
            thread.join()
        go_on()

    monkeypatch.setattr(live.session, "go_on", counted)
    with pytest.raises(clsco.CanceledError, match="render: must go on to be done; got a call of cancel"):
        live.render(scene, truth=())
    assert count[0] == 5
    monkeypatch.undo()
    same(live.render(scene, truth=()), expected)


def test_the_host_runs_ahead_by_a_time_sample_at_most(live: Live, monkeypatch: pytest.MonkeyPatch) -> None:
    add, unfinished, latest = Renderer.add, list[int](), list[int]()

    def noted(self: Renderer, film: Film, *of_sample: Any) -> None:
        earlier = film.events[: latest[-1]] if latest else []
        unfinished.append(sum(event.command_execution_status != COMPLETE for _, event in earlier))
        latest.append(len(film.events))
        add(self, film, *of_sample)

    monkeypatch.setattr(Renderer, "add", noted)
    live.render(SCENES["moving"].replace("sequence.samples", 16), truth=())
    assert unfinished == [0] * 17  # the still sources are one more
    progress = live.session.progress
    assert progress is not None
    assert (progress.doing, progress.done, progress.total) == ("accumulate", 16, 16)


def test_threads_have_the_bits_of_one(live: Live) -> None:
    wanted = [scene.replace("camera.focus_distance", 270.0) for scene in (SCENES["ball"], SCENES["visibility"])]
    expected = [clsco.render_frame(scene) for scene in wanted]
    found: dict[int, list[Frame]] = {k: [] for k in range(4)}

    def run(k: int) -> None:
        if k % 2:
            found[k] = [clsco.render_frame(scene) for scene in wanted]
        else:
            with Live() as own:
                found[k] = [own.render(scene) for scene in wanted]

    threads = [threading.Thread(target=run, args=(k,)) for k in found]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for frames in found.values():
        assert len(frames) == 2
        for frame, exact in zip(frames, expected, strict=True):
            same(frame, exact)


def test_warming_compiles_what_a_render_needs() -> None:
    scene = scene_from(TABLES, BALL)
    with Session(choose()) as session, Live(session.queue) as live:
        live.warm(scene).join()
        programs, compiled = len(live.session.programs), len(live.session.compiled)
        assert programs > 1
        start = time.process_time()
        live.render(scene)
        assert time.process_time() - start < 1.0
        assert (len(live.session.programs), len(live.session.compiled)) == (programs, compiled)


def test_wrong_calls(live: Live) -> None:
    with pytest.raises(clsco.SceneError, match="keep: must be a size greater than 0"):
        Live(keep="much")
    with pytest.raises(clsco.SceneError, match="frames: must lie from 0 to 0; got 1"):
        live.render(SCENES["ball"], 1)
    with pytest.raises(clsco.SceneError, match="stereo pair"):
        live.render(SCENES["ball"].replace("stereo.baseline", 6.0))
    with pytest.raises(clsco.SceneError, match="truth"):
        live.render(SCENES["ball"], truth="depht")
