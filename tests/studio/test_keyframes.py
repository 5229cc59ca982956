"""Keyframes of the time line: added with the pose at a time, moved, and removed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from clsco.errors import SceneError
from clsco.optics.lens_path import camera_at
from clsco.optics.motion import pose_at, poses_at
from clsco.studio.keyframes import add_keyframe, remove_keyframe, tracks
from clsco.studio.session import Document

BALL = "object.0.motion.keyframe"
CURVE = [
    {"time": 0.0, "position": [0.0, 1.0, 0.0]},
    {"time": 1.0, "position": [5.0, 0.0, -3.0], "rotation": [10.0, 20.0, 0.0]},
    {"time": 2.0, "position": [7.0, 4.0, 0.0], "rotation": [0.0, 90.0, 30.0]},
]


def session_of(root: Path, **sections: Any) -> Document:
    session = Document(root)
    objects = [{"shape": "sphere", "name": "ball", "center": [0.0, 0.0, 280.0]}, {"shape": "background"}]
    session.load_table({"object": objects, "sequence": {"frames": 3}} | sections, root)
    return session


def times(session: Document) -> dict[str, tuple[float | None, ...]]:
    return {track.path: track.times for track in tracks(session)}


def test_everything_that_can_have_keyframes_has_a_track(tmp_path: Path) -> None:
    session = session_of(tmp_path)
    session.patch("group", [{"name": "both"}])
    session.patch("object.0.group", "both")
    assert [(track.path, track.name) for track in tracks(session)] == [
        ("camera.motion.keyframe", "Camera"), ("lens.keyframe", "Lens"), ("group.0.motion.keyframe", "Group both"),
        (BALL, "1 ball"),
    ]  # fmt: skip
    for track in tracks(session):
        add_keyframe(session, track.path, 0.25)
    assert set(times(session).values()) == {(0.25,)}


@pytest.mark.parametrize("rotation", ["euler", "axis"])
@pytest.mark.parametrize("interpolation", ["cubic", "linear"])
def test_a_key_between_others_leaves_the_path_of_positions_as_it_is(
    tmp_path: Path, interpolation: str, rotation: str
) -> None:
    motion = {"keyframe": CURVE, "interpolation": interpolation}
    session = session_of(tmp_path, motion={"rotation": rotation})
    session.patch("object.0.motion", motion)
    before = session.scene.objects[0].motion
    add_keyframe(session, BALL, 0.6)
    after = session.scene.objects[0].motion
    assert times(session)[BALL] == (0.0, 0.6, 1.0, 2.0)
    for time in np.linspace(-0.5, 2.5, 13):
        old, new = pose_at(before, time, rotation), pose_at(after, time, rotation)
        np.testing.assert_allclose(new.shift, old.shift, atol=1e-8)
    old, new = pose_at(before, 0.6, rotation), pose_at(after, 0.6, rotation)
    np.testing.assert_allclose(new.rotation, old.rotation, atol=1e-9)
    assert session.undo()
    assert session.scene.objects[0].motion == before


@pytest.mark.parametrize("turn", [[0.0, 200.0, 0.0], [150.0, 0.0, 90.0]])
def test_velocities_become_keys_with_the_same_poses(tmp_path: Path, turn: list[float]) -> None:
    session = session_of(tmp_path, motion={"rotation": "axis"})
    session.patch("object.0.motion", {"velocity": [3.0, 0.0, -1.0], "angular_velocity": turn})
    before = session.scene
    add_keyframe(session, BALL, 1.25)
    assert "velocity" not in session.table["object"][0]["motion"]
    for time in (0.0, 0.4, 1.25, 2.0, 3.0, 4.0):
        (old, _), (new, _) = poses_at(before, time), poses_at(session.scene, time)
        np.testing.assert_allclose(new.shift, old.shift, atol=1e-8)
        np.testing.assert_allclose(new.rotation, old.rotation, atol=1e-6)
    found = times(session)[BALL]
    assert {0.0, 1.25, 3.0} <= set(found)
    assert (len(found) == 3) == (turn[1] != 0.0)


def test_the_first_key_of_the_lens_has_both_quantities_and_later_ones_those_of_the_others(tmp_path: Path) -> None:
    session = session_of(tmp_path, camera={"f_number": 4.0, "focus_distance": 300.0})
    add_keyframe(session, "lens.keyframe", 0.5)
    assert session.table["lens"]["keyframe"] == [{"time": 0.5, "focus_distance": 300.0, "f_number": 4.0}]
    assert session.patch("lens.keyframe.0.f_number", None)
    assert session.patch("lens.keyframe", [*session.table["lens"]["keyframe"], {"time": 1.5, "focus_distance": 200.0}])
    before = session.scene
    add_keyframe(session, "lens.keyframe", 1.0)
    assert session.table["lens"]["keyframe"][1] == {"time": 1.0, "focus_distance": 240.0}  # 1/u is on a line
    for time in (0.0, 0.75, 1.2, 2.0):
        assert camera_at(session.scene, time).sensor_distance == pytest.approx(camera_at(before, time).sensor_distance)


def test_the_last_key_takes_what_belongs_to_keys_with_it(tmp_path: Path) -> None:
    session = session_of(tmp_path)
    session.patch("object.0.motion", {"keyframe": CURVE[:2], "interpolation": "linear", "outside": "linear"})
    remove_keyframe(session, BALL, 0)
    assert times(session)[BALL] == (1.0,)
    remove_keyframe(session, BALL, 0)
    assert "motion" not in session.table["object"][0]
    add_keyframe(session, "lens.keyframe", 0.0)
    remove_keyframe(session, "lens.keyframe", 0)
    assert "lens" not in session.table
    for _ in range(4):
        assert session.undo()
    assert times(session)[BALL] == (0.0, 1.0)


@pytest.mark.parametrize(
    ("path", "time", "message"),
    [
        (BALL, 1.0, "keyframe: there must be none at this time; got one at 1 s"),
        (BALL, float("nan"), "keyframe: time must be within 1e+09 s; got nan"),
        (BALL, 10**400, "keyframe: time must be within 1e+09 s; got 1"),
        ("object.1.motion.keyframe", 0.0, "must be of the camera, its lens, a group or an object; got object.1"),
        ("object.0.motion", 0.0, "must be of the camera, its lens, a group or an object; got object.0.motion"),
    ],
)
def test_what_cannot_be_added(tmp_path: Path, path: str, time: float, message: str) -> None:
    session = session_of(tmp_path)
    session.patch("object.0.motion.keyframe", CURVE)
    before = session.state
    with pytest.raises(SceneError) as caught:
        add_keyframe(session, path, time)
    assert message in str(caught.value)
    assert session.state is before


def test_splines_of_even_times_refuse_a_key_between(tmp_path: Path) -> None:
    session = session_of(tmp_path)
    session.patch("object.0.motion", {"keyframe": CURVE, "interpolation": "bspline"})
    with pytest.raises(SceneError, match="equal intervals"):
        add_keyframe(session, BALL, 0.5)
    with pytest.raises(SceneError, match="keyframe: must be one of 3, counted from 0; got 3"):
        remove_keyframe(session, BALL, 3)


def test_a_time_that_is_refused_stays_at_its_mark(tmp_path: Path) -> None:
    session = session_of(tmp_path)
    session.patch(BALL, CURVE)
    assert not session.patch(f"{BALL}.1.time", 2.5, 7)
    assert {f"{BALL}.1.time", f"{BALL}.2.time"} & session.faults.keys()
    assert times(session)[BALL] == (0.0, 2.5, 2.0)
    assert session.patch(f"{BALL}.1.time", 0.5, 7)
    assert times(session)[BALL] == (0.0, 0.5, 2.0)
    assert not session.patch(f"{BALL}.1.time", "soon", 8)
    assert times(session)[BALL] == (0.0, 0.5, 2.0)
