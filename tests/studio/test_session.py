"""A session: patches, what is wrong with them, and the way back."""

from __future__ import annotations

import random
from pathlib import Path
from typing import Any

import pytest
from pydantic import BaseModel

from clsco import SceneError, parse_scene
from clsco.scene.schema import scene_schema
from clsco.studio.editing import STEPS, THESIS
from clsco.studio.session import Document
from clsco.studio.tables import placed

EXAMPLES = Path(__file__).parents[2] / "examples"


def test_a_patch_changes_the_scene_and_leaves_the_old_table(session: Document) -> None:
    before, told = session.table, []
    end = session.subscribe(lambda: told.append(session.revision))
    assert session.patch("object.0.distance", 300.0)
    assert session.scene == parse_scene({"object": [{"shape": "plane", "distance": 300.0}]})
    assert before == THESIS
    assert not session.patch("object.0.distance", 300.0)
    end()
    session.patch("object.0.distance", 310.0)
    assert told == [1, 1]
    assert session.revision == 2


@pytest.mark.parametrize(
    ("path", "value", "rule"),
    [
        ("object.0.distance", -3, "must be greater than 0 mm; got -3"),
        ("object.0.distance", "far", 'must be a number; got "far"'),
        ("object.0.radius", 3.0, "belongs to disc, cylinder or sphere, not to plane"),
        ("object.7.radius", 3.0, "object has 1 entries, counted from 0"),
        ("stereo.baseline.0", 8, "must be given as a whole; got 8"),
        ("camera.resolution", [0, 8], "must be between 1 and 65536 px"),
        ("sequence.frames", 0, "must be between 1 and 1000000"),
        ("psf.sigma_ratio", 0.5, 'belongs to psf.model = "gaussian"'),
        ("fill.method", "none", 'belongs to motion.warp = "forward"'),
        ("nothing.of.this", 1, "unknown key"),
        ("object.0.texture", "../secret.png", "must be a file below the folder of the studio"),
        ("object.0.texture", "/etc/passwd", "must be relative to the folder of the scene"),
        ("object.0.texture", "no.png", "must be an existing file, a built-in pattern or a color"),
        ("object.0.texture", "a\0b", "must be one line of text"),
        ("", 1, "must be the path of a key"),
        ("a." * 200 + "b", 1, "must be the path of a key"),
    ],
)
def test_what_is_not_valid_is_said_at_its_field(session: Document, path: str, value: Any, rule: str) -> None:
    before = session.scene
    assert not session.patch(path, value)
    at_field = [message for key, message in session.faults.items() if f"{key}.".startswith(f"{path}.")]
    assert rule in at_field[0]
    assert session.refused == {path: value}
    assert session.scene is before
    assert session.revision == 0
    assert session.can_undo
    assert session.undo()
    assert not session.refused
    assert not session.faults
    assert session.scene is before
    assert not session.undo()


def test_messages_are_those_of_the_command(session: Document) -> None:
    with pytest.raises(SceneError) as stated:
        parse_scene({"object": [{"shape": "sphere", "radius": -1.0, "center": [0.0, 0.0]}]})
    session.patch("object.0.shape", "sphere")
    session.patch("object.0.radius", -1.0)
    session.patch("object.0.center", [0.0, 0.0])
    assert session.faults == placed(stated.value)
    assert session.patch("object.0.radius", 20.0)
    assert session.faults == {"object.0.center": "must be a list of 3 numbers; got [0.0, 0.0]"}
    assert session.patch("object.0.center", [0.0, 0.0, 200.0])
    assert not session.faults


def test_values_that_need_each_other_are_taken_together(session: Document) -> None:
    session.patch("camera.focus_distance", 250.0)
    assert not session.patch("camera.focal_length", 300.0)
    assert "must be greater than focal_length = 300 mm" in session.faults["camera.focus_distance"]
    assert "focus_distance" in session.faults["camera.focal_length"]
    assert session.patch("camera.focus_distance", 400.0)
    assert session.scene.camera.focal_length == 300.0
    assert not session.faults
    assert session.undo()
    assert session.scene.camera.focal_length == 20.0


def test_pairs_of_the_camera_displace_each_other_and_amount_to_each_other(session: Document) -> None:
    assert session.known("camera.f_number") == 2.0
    assert session.known("camera.focus_distance") == pytest.approx(250.0, abs=0.02)
    assert session.patch("camera.f_number", 4.0)
    assert session.known("camera.aperture_diameter") == 5.0
    assert session.patch("camera.aperture_diameter", 8.0)
    assert session.table["camera"] == {"aperture_diameter": 8.0}
    assert session.patch("camera.focus_distance", 300.0)
    assert session.patch("camera.sensor_distance", 22.0)
    assert session.known("camera.focus_distance") == pytest.approx(220.0)
    assert session.patch("camera.aperture_diameter", None)
    assert session.patch("camera.sensor_distance", None)
    assert session.table == THESIS


def test_components_of_defaults(session: Document) -> None:
    session.patch("object.0.shape", "sphere")
    assert session.patch("object.0.center.2", 300.0)
    assert session.table["object"][0]["center"] == [0.0, 0.0, 300.0]
    assert not session.patch("object.0.center.0", "left")
    assert session.shown("object.0.center") == ["left", 0.0, 300.0]
    assert session.faults["object.0.center.0"] == 'must be a number; got "left"'
    assert session.patch("object.0.motion.angular_velocity.1", 5.0)
    assert session.known("object.0.motion") == {"angular_velocity": [0.0, 5.0, 0.0]}


@pytest.mark.parametrize(
    ("path", "value", "whole"),
    [
        ("camera.resolution.0", 64, [64, 64]),
        ("light.direction.0", 1.0, [1.0, 0.0, 1.0]),
        ("object.0.bounds.2.1", 300.0, [[-1000.0, 1000.0], [-1000.0, 1000.0], [-1000.0, 300.0]]),
        ("object.0.motion.velocity.1", 2.0, [0.0, 2.0, 0.0]),
    ],
)
def test_components_of_vectors_that_have_no_default(session: Document, path: str, value: Any, whole: Any) -> None:
    assert session.patch(path, value)
    vector = path.rpartition(".")[0].removesuffix(".2")
    assert session.known(vector) == whole
    assert session.patch(vector, None)
    assert session.table == THESIS


def test_a_drag_is_one_step(session: Document) -> None:
    session.patch("object.0.distance", 260.0)
    for k in range(50):
        session.patch("object.0.distance", 300.0 + k, drag=17)
    session.patch("object.0.distance", 400.0, drag=18)
    assert session.undo()
    assert session.known("object.0.distance") == 349.0
    assert session.undo()
    assert session.known("object.0.distance") == 260.0
    assert session.redo()
    assert session.redo()
    assert session.known("object.0.distance") == 400.0
    assert not session.redo()


def test_a_drag_that_is_taken_back_is_no_step(session: Document) -> None:
    session.patch("object.0.distance", 260.0)
    for value in (300.0, 310.0, 260.0):
        session.patch("object.0.distance", value, drag=17)
    assert session.undo()
    assert not session.can_undo


def test_undo_has_its_number_of_steps(session: Document) -> None:
    for k in range(STEPS + 5):
        session.patch("object.0.distance", 200.0 + k)
    count = 0
    while session.undo():
        count += 1
    assert count == STEPS
    assert session.known("object.0.distance") == 204.0


def test_shapes_come_back_with_their_values(session: Document) -> None:
    session.patch("object.0.texture", "checkerboard")
    session.patch("object.0.distance", 300.0)
    session.patch("object.0.motion.velocity", [1.0, 0.0, 0.0])
    for shape in ("cylinder", "sphere", "cone", "ellipsoid", "quadric"):
        assert session.patch("object.0.shape", shape), session.faults
        assert session.known("object.0.texture") == "checkerboard"
        assert session.known("object.0.motion.velocity") == [1.0, 0.0, 0.0]
        if shape == "sphere":
            session.patch("object.0.radius", 12.0)
    session.patch("object.0.shape", "sphere")
    assert session.known("object.0.radius") == 12.0
    session.patch("object.0.shape", "plane")
    assert session.known("object.0.distance") == 300.0
    assert session.known("object.0.radius") is None


def test_a_shape_that_needs_a_file_waits_for_it(session: Document) -> None:
    assert not session.patch("object.0.shape", "depth_map")
    assert session.faults["object.0.depth"] == "must be given; got nothing"
    assert session.shown("object.0.shape") == "depth_map"
    (session.root / "depth.png").write_bytes((EXAMPLES / "depth_map_depth.png").read_bytes())
    assert session.patch("object.0.depth", "depth.png")
    assert session.scene.objects[0].shape == "depth_map"
    assert session.scene.objects[0].files() == {"depth": str(session.root / "depth.png")}
    assert session.patch("object.0.shape", "sphere")
    assert not session.faults


def test_a_choice_puts_aside_what_it_has_no_use_for(session: Document) -> None:
    session.patch("object.0.shape", "sphere")
    assert session.patch("object.0.texture_mapping", "surface")
    assert session.patch("object.0.texture_repeats", [2.0, 1.0])
    assert session.patch("object.0.texture_mapping", "cube")
    assert "texture_repeats" not in session.table["object"][0]
    session.undo()
    assert session.known("object.0.texture_repeats") == [2.0, 1.0]


def test_several_objects(session: Document) -> None:
    assert session.add_object("sphere") == 1
    session.patch("object.1.name", "ball")
    assert session.copy_object(1) == 2
    session.move_object(2, 0)
    assert [item.name for item in session.scene.objects] == ["sphere", "plane", "ball"]
    session.patch("group", [{"name": "both"}])
    session.patch("object.0.group", "both")
    session.delete_object(0)
    assert "group" not in session.table
    session.delete_object(0)
    with pytest.raises(SceneError, match="must hold 1 to 64 objects"):
        session.delete_object(0)
    assert [item.name for item in session.scene.objects] == ["ball"]
    for _ in range(8):
        session.undo()
    assert session.table == THESIS


def test_semi_axes_are_linked_where_wanted(session: Document) -> None:
    session.patch("object.0.shape", "ellipsoid")
    session.patch("object.0.semi_axes.1", 20.0)
    assert session.known("object.0.semi_axes") == [30.0, 20.0, 50.0]
    session.is_linked = True
    session.patch("object.0.semi_axes.2", 25.0, drag=1)
    session.patch("object.0.semi_axes.1", 26.0, drag=1)
    assert session.known("object.0.semi_axes") == [30.0, 26.0, 26.0]
    session.undo()
    assert session.known("object.0.semi_axes") == [30.0, 20.0, 50.0]


def test_reset_leaves_the_image(session: Document) -> None:
    session.patch("object.0.texture", "siemens_star")
    changes = {
        "object.0.shape": "sphere", "object.0.radius": 12.0, "object.0.motion.velocity.0": 3.0, "camera.f_number": 4.0,
        "sequence.frames": 5, "camera.resolution": [64, 64], "psf.model": "gaussian",
    }  # fmt: skip
    for path, value in changes.items():
        assert session.patch(path, value)
    before = session.table
    session.reset()
    assert session.table == {
        "object": [{"shape": "plane", "texture": "siemens_star"}],
        "psf": {"model": "gaussian"},
        "camera": {"resolution": [64, 64]},
    }
    assert session.undo()
    assert session.table == before


def _random_patch(draw: random.Random, session: Document) -> tuple[str, Any]:
    index = draw.randrange(len(session.table["object"]))
    number = round(draw.uniform(-50.0, 400.0), 3)
    return draw.choice(
        [
            (f"object.{index}.shape", draw.choice(["plane", "sphere", "cone", "box", "cylinder", "depth_map", "none"])),
            (f"object.{index}.radius", number),
            (f"object.{index}.center.{draw.randrange(4)}", number),
            (f"object.{index}.texture_mapping", draw.choice(["projected", "surface", "cube", "triplanar"])),
            (f"object.{index}.texture", draw.choice(["bricks", "#102030", "gone.png"])),
            (f"object.{index}.motion.velocity", draw.choice([None, [1.0, 0.0, 0.0], 3])),
            ("camera.f_number", abs(number) / 50.0),
            ("camera.aperture_diameter", number),
            ("camera.focus_distance", draw.choice([None, number, {"from": 200, "to": 300, "steps": 3}])),
            ("camera.sensor_distance", draw.choice([None, 21.0, 22.0])),
            ("motion.warp", draw.choice(["inverse", "forward"])),
            ("fill.method", draw.choice(["none", "ait", None])),
            ("psf.model", draw.choice(["pillbox", "gaussian", 3])),
            ("psf.sigma_ratio", number / 100.0),
            ("light.direction", draw.choice([None, [0.0, 1.0, 1.0], [0, 0, 0]])),
            ("stereo.baseline", draw.choice([None, 10.0])),
            ("aperture.shape", draw.choice(["circle", "polygon"])),
            ("title", draw.choice(["", "x", "y"])),
        ]
    )


def test_a_random_walk_leads_back(session: Document) -> None:
    draw = random.Random(1)
    for step in range(200):
        if draw.random() < 0.05:
            if len(session.table["object"]) < 3:
                session.add_object(draw.choice(["sphere", "cone"]))
            else:
                session.delete_object(draw.randrange(3))
        path, value = _random_patch(draw, session)
        session.patch(path, value, drag=draw.choice([None, step // 7]))
        assert bool(session.refused) == bool(session.faults)
        if draw.random() < 0.3:
            table, scene = session.table, session.scene
            if session.refused:
                assert session.undo()
                assert session.table == table
            back = sum(session.undo() for _ in range(draw.randrange(1, 6)))
            for _ in range(back):
                assert session.redo()
            assert session.table == table
            assert session.scene == scene
            assert not session.faults
    last = session.table
    while session.undo():
        pass
    while session.redo():
        pass
    assert session.table == last


def test_defaults_in_force_are_those_of_the_schema(session: Document) -> None:
    definitions = scene_schema()["$defs"]
    for section in ("psf", "sequence", "motion", "fill"):
        for key, entry in definitions[section.capitalize()]["properties"].items():
            if "default" in entry:
                known = session.known(f"{section}.{key}")
                assert (known.model_dump() if isinstance(known, BaseModel) else known) == entry["default"]


def test_each_scene_of_a_sweep_can_be_shown(tmp_path: Path) -> None:
    session = Document(tmp_path)
    assert session.state.labels == ("",)
    session.patch("camera.f_number", [2.0, 4.0])
    session.patch("camera.focus_distance", {"from": 200.0, "to": 300.0, "steps": 2})
    labels = session.state.labels
    assert len(labels) == 4
    assert focus(session) == (2.0, pytest.approx(200.0))
    revision = session.revision
    session.show_scene(labels[3])
    assert focus(session) == (4.0, pytest.approx(300.0))
    assert session.revision > revision
    session.patch("object.0.distance", 240.0)  # which leaves it shown
    assert focus(session) == (4.0, pytest.approx(300.0))
    session.save(Path("sweep.toml"))
    assert session.state.shown == 3
    session.patch("camera.f_number", 8.0)  # the labels are others now
    assert session.state.shown == 0
    session.undo()
    assert focus(session) == (4.0, pytest.approx(300.0))
    with pytest.raises(SceneError, match="must be one of the 4 of the file"):
        session.show_scene("other")


def focus(session: Document) -> tuple[float, float]:
    """F-number and focus distance of the scene that is shown."""
    camera = session.scene.camera
    return camera.focal_length / camera.aperture_diameter, camera.focused_distance
