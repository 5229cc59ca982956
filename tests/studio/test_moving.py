"""Objects that are dragged stay under the pointer."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import clsco
from clsco import SceneError
from clsco.optics.exposure import middle_time
from clsco.optics.motion import Eye, poses_at, rest_center
from clsco.reference.common.geometry import pixel_ray, project
from clsco.studio.moving import ALONG, grip
from clsco.studio.session import Document

SIZE = 64
ROUND: list[dict[str, Any]] = [
    {"shape": "sphere", "center": [3.0, -2.0, 280.0], "radius": 20.0},
    {"shape": "ellipsoid", "center": [3.0, -2.0, 280.0]},
    {"shape": "cylinder", "center": [3.0, -2.0, 280.0]},
    {"shape": "disc", "center": [3.0, -2.0, 280.0], "radius": 5.0},
    {"shape": "cone", "apex": [3.0, -2.0, 250.0]},
]


def session_of(root: Path, *objects: dict[str, Any], **sections: Any) -> Document:
    session = Document(root)
    camera = {"resolution": [SIZE, SIZE]} | sections.pop("camera", {})
    session.load_table({"object": list(objects), "camera": camera, **sections}, root)
    return session


@pytest.mark.parametrize("item", ROUND, ids=lambda item: item["shape"])
def test_the_point_that_is_held_stays_under_the_pointer(tmp_path: Path, item: dict[str, Any]) -> None:
    session = session_of(tmp_path, {"shape": "background"}, item)
    before = rest_center(session.scene.objects[1])
    held = grip(session, 0, 1, 260.0)
    assert session.patch(held.path, held.value(session.scene.camera, 7.0, -3.5, False), 5)
    after = rest_center(session.scene.objects[1])
    assert after[2] == before[2]
    point = 260.0 * pixel_ray(session.scene.camera, np.array(20.0), np.array(30.0))  # any point at that depth
    row, column = project(session.scene.camera, point + after - before)
    assert (float(row), float(column)) == pytest.approx((20.0 - 3.5, 30.0 + 7.0), abs=1e-3)


def test_along_z_the_depth_is_multiplied(tmp_path: Path) -> None:
    session = session_of(tmp_path, ROUND[0])
    held = grip(session, 0, 0, 260.0)
    value = held.value(session.scene.camera, 9.0, -ALONG, True)
    assert value == pytest.approx([3.0, -2.0, 280.0 + 260.0 * (np.e - 1)], abs=1e-3)
    assert held.value(session.scene.camera, 9.0, 1e6, True) == pytest.approx([3.0, -2.0, 20.0])


def test_planes_move_by_their_distance(tmp_path: Path) -> None:
    plane = {"shape": "plane", "distance": 250.0, "slope_x": 0.4, "slope_y": -0.2, "rotation": [0.0, 10.0, 0.0]}
    session = session_of(tmp_path, plane)
    depth = clsco.render_frame(session.scene, truth=("depth",)).depth
    assert depth is not None
    held = grip(session, 0, 0, float(depth[30, 20]))
    assert session.patch(held.path, held.value(session.scene.camera, 5.0, -2.0, False))
    moved = clsco.render_frame(session.scene, truth=("depth",)).depth
    assert moved is not None
    assert moved[28, 25] == pytest.approx(depth[30, 20], rel=1e-6)


TURNED = {
    "camera": {"motion": {"angular_velocity": [0.0, 8.0, 4.0], "velocity": [0.0, 0.0, 10.0]}},
    "sequence": {"frames": 3, "interval": 1.0},
}
PAIR = {"stereo": {"baseline": 8.0, "toe_in": 6.0}}


@pytest.mark.parametrize(("sections", "index", "eye"), [(TURNED, 2, "left"), (PAIR, 0, "left"), (PAIR, 0, "right")])
def test_a_camera_that_turned_and_each_eye_move_things_along_their_own_axes(
    tmp_path: Path, sections: dict[str, Any], index: int, eye: Eye
) -> None:
    session = session_of(tmp_path, ROUND[0], **sections)

    def seen() -> Any:
        pose = poses_at(session.scene, middle_time(session.scene.sequence, index), eye)[0]
        return rest_center(session.scene.objects[0]) + pose.shift

    before = seen()
    held = grip(session, index, 0, float(before[2]), eye)
    session.patch(held.path, held.value(session.scene.camera, 4.0, 6.0, False))
    row, column = project(session.scene.camera, np.stack([before, seen()]))
    assert column[1] - column[0] == pytest.approx(4.0, abs=1e-3)
    assert row[1] - row[0] == pytest.approx(6.0, abs=1e-3)


def test_faces_of_a_box_are_the_box(tmp_path: Path) -> None:
    session = session_of(tmp_path, {"shape": "background"}, {"shape": "box", "size": [9, 9, 9]}, ROUND[0])
    assert session.object_entries == [0, *[1] * 6, 2]
    assert grip(session, 0, 4, 280.0).path == "object.1.center"
    assert grip(session, 0, 7, 280.0).path == "object.2.center"


@pytest.mark.parametrize(
    ("object_id", "rule"),
    [(0, "an object with a place of its own; got a background"), (-1, "got none"), (9, "got none")],
)
def test_what_cannot_be_moved_is_said(tmp_path: Path, object_id: int, rule: str) -> None:
    session = session_of(tmp_path, {"shape": "background"}, ROUND[0])
    with pytest.raises(SceneError, match=rule):
        grip(session, 0, object_id, 280.0)
