"""`clsco.render`, `clsco.render_frame` and `clsco.render_sweep`: what they take, and what they refuse at the call."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import clsco
from clsco.errors import ClscoError, SceneError
from clsco.frame.frame import Frame
from clsco.frame.outputs import ALL_TRUTH, TRUTH_NAMES, truth_names
from clsco.frame.truth_files import array_names
from clsco.opencl.session import DeviceLike, Session

SMALL = {"resolution": [24, 16], "pixel_pitch": 0.1}
DATA: dict[str, Any] = {"camera": SMALL, "sequence": {"frames": 2}, "object": [{"shape": "sphere"}]}
SCENE = clsco.parse_scene(DATA)
MOVING = SCENE.replace("object[0].motion.velocity", [5, 0, 0]).replace("sequence.samples", 2)
STEREO = clsco.parse_scene(DATA | {"stereo": {"baseline": 10.0}})


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"truth": ["depht"]}, 'truth: must be "all" or some of sharp, depth, coc, '),
        ({"truth": "depths"}, "got 'depths' (did you mean depth?)"),
        ({"truth": "depth,flwo"}, "got 'flwo' (did you mean flow?)"),
        ({"truth": ["color"]}, "got 'color'"),
        ({"truth": [1.5]}, "got 1.5"),
        ({"truth": 5}, "truth: must be names of outputs; got 5"),
        ({"frames": [5]}, "frames: must lie from 0 to 1; got 5"),
        ({"frames": [-1]}, "frames: must lie from 0 to 1; got -1"),
        ({"frames": [1.5]}, "frames: must be whole numbers from 0 to 1; got [1.5]"),
        ({"frames": "0"}, "frames: must be whole numbers from 0 to 1; got"),
        ({"frames": 0}, "frames: must be whole numbers from 0 to 1; got 0"),
        ({"precision": "half"}, "precision: must be single or double; got half"),
        ({"method": "best"}, "method: must be one of auto, gather"),
        ({"tolerance": 0.0}, "tolerance: must be a number above 0"),
        ({"tolerance": float("nan")}, "tolerance: must be a number above 0"),
        ({"tolerance": "x"}, "tolerance: must be a number above 0, RMS of white; got x"),
        ({"memory": "much"}, "memory: must be a size"),
        ({"device": "no such device"}, "device: must be a part of the name of one of"),
        ({"device": 7}, "device: must be a part of a name, or a Device, Context or CommandQueue of pyopencl; got int"),
    ],
)
def test_wrong_arguments_are_refused_at_the_call(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ClscoError) as caught:
        clsco.render(SCENE, **options)
    assert message in str(caught.value)


def test_what_is_no_scene_is_refused_at_the_call(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match=r"^scene: must be a Scene, a mapping or the path of a file; got int"):
        clsco.render(5)  # type: ignore[arg-type]
    with pytest.raises(SceneError, match=r"cannot be read"):
        clsco.render(tmp_path / "none.toml")
    with pytest.raises(SceneError, match=r"object\[0\]\.radius"):
        clsco.render({"object": [{"shape": "sphere", "radius": -1.0}]})


def same(one: Frame, other: Frame) -> bool:
    pairs = [(getattr(one, name), getattr(other, name)) for name in ("color", *ALL_TRUTH)]
    return all(a is b is None or np.array_equal(a, b) for a, b in pairs)


def test_scenes_mappings_and_paths_are_rendered_alike(tmp_path: Path) -> None:
    path = tmp_path / "ball.toml"
    path.write_text('camera = {resolution = [24, 16], pixel_pitch = 0.1}\n[[object]]\nshape = "sphere"\n', "utf-8")
    first, second = clsco.render(SCENE)
    for given in (DATA, path, str(path)):
        assert same(next(clsco.render(given)), first)
    assert same(clsco.render_frame(SCENE, 1), second)
    assert same(clsco.render_frame(DATA), first)
    found = dict(clsco.render_sweep([DATA, path], frames=[np.int64(0)]))
    assert found.keys() == {0, 1}
    assert same(found[1], first)
    assert [k for k, _ in clsco.render_sweep(clsco.load_sweep(path))] == [0]


def test_truth_is_named_one_by_one_or_all_at_once() -> None:
    def names(truth: Any, scene: clsco.Scene = SCENE) -> set[str]:
        frame = clsco.render_frame(scene, truth=truth)
        return {name for name in ALL_TRUTH if getattr(frame, name) is not None}

    assert names("depth") == {"depth"}
    assert names(iter(["depth", "flow"])) == {"depth", "flow"}
    assert names(()) == set()
    assert names("all") == set(TRUTH_NAMES)
    assert names("all", MOVING) == set(TRUTH_NAMES) | {"flow_backward", "flow_occluded"}
    assert names("flow_occluded", MOVING) == {"flow_occluded"}


def test_one_frame_of_a_stereo_pair_is_refused() -> None:
    with pytest.raises(SceneError, match=r"^scene: must have one view; got a stereo pair"):
        clsco.render_frame(STEREO)
    with pytest.raises(SceneError, match=r"^frames: must lie from 0 to 1; got 2"):
        clsco.render_frame(SCENE, 2)


def test_devices_contexts_and_queues_of_pyopencl_are_worked_on(session: Session) -> None:
    import pyopencl as cl

    expected = clsco.render_frame(SCENE)
    image = np.random.default_rng(3).random((12, 9)).astype(np.float32)
    radii, holes = np.full(image.shape, 2.5), np.eye(12, 9, dtype=np.bool_)
    unordered = cl.command_queue_properties.OUT_OF_ORDER_EXEC_MODE_ENABLE
    queues = [cl.CommandQueue(session.context), cl.CommandQueue(session.context, properties=unordered)]
    places: list[DeviceLike] = [session.context.devices[0], session.context, session.queue, *queues]
    for place in places:
        assert same(clsco.render_frame(SCENE, device=place), expected)
        assert np.array_equal(clsco.defocus(image, radii, device=place), clsco.defocus(image, radii))
        assert np.array_equal(clsco.inpaint(image, holes, device=place), clsco.inpaint(image, holes))


def test_outputs_have_the_names_of_files_as_well() -> None:
    for truth in ("blur_radius,depth", "coc,depth,", ("coc", "depth", "blur_radius")):
        assert truth_names(truth) == ("blur_radius", "depth")
    assert array_names("depth,blur_radius") == array_names(["coc", "depth"]) == ("depth", "coc")
