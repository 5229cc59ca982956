"""Notes on scenes whose images may not be what was meant: they are true of what is rendered."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import clsco
from clsco.plan.notes import close_focus_note, sight_notes
from clsco.plan.prepare import prepare
from clsco.scene.model import Camera
from tests.command import clsco_
from tests.scenes import scene_file

CAMERA = {"resolution": [40, 30], "pixel_pitch": 0.1}
PLAIN = {"occlusion": "none", "silhouette_samples": 1, "tilt": False, "edge": "sampled"}  # compiled in little time
BALL: dict[str, Any] = {"shape": "sphere", "center": [0.0, 0.0, 280.0], "radius": 20.0, "texture": "#ffffff"}
BESIDE = BALL | {"center": [300.0, 0.0, 280.0], "name": "far off"}
DOT = BALL | {"radius": 0.6, "name": "dot"}
WALL: dict[str, Any] = {"shape": "plane", "distance": 400.0, "texture": "#ffffff"}
UNSEEN = "objects that are not in sight, beside or behind the picture or hidden: "
BLACK = "nothing is in sight, and all is black, in "
BACKS = "light: falls on no side that is in sight, so that all of them are black without light.ambient"
GOING = BALL | {"motion": {"velocity": [40.0, 0.0, 0.0]}}
CROSSING = BALL | {"center": [-500.0, 0.0, 280.0], "motion": {"velocity": [100.0, 0.0, 0.0]}}
WIDE = CAMERA | {"f_number": 1.0, "focus_distance": 280.0}
CARD = {"shape": "rectangle", "center": [0.0, 0.0, 100.0], "size": [6.0, 6.0], "texture": "#202020"}
SCENES: dict[str, tuple[dict[str, Any], list[str]]] = {
    "a ball": ({"object": [BALL, WALL]}, []),
    "beside the picture": ({"object": [BESIDE, BALL]}, [f"{UNSEEN}far off"]),
    "alone beside the picture": ({"object": [BESIDE]}, [f"{UNSEEN}far off", f"{BLACK}all frames"]),
    "behind a wall": ({"object": [BALL, WALL | {"distance": 200.0}]}, [f"{UNSEEN}sphere"]),
    "a dot": ({"object": [DOT, WALL]}, ["objects whose image is less than a pixel wide: dot (0.86 px)"]),
    "a dot between rays": ({"object": [DOT | {"center": [3.7, 2.2, 280.0], "radius": 0.75}, WALL]}, []),
    "a light from behind": ({"object": [BALL, WALL], "light": {"direction": [0.1, 0.0, -1.0]}}, [BACKS]),
    "a lamp behind": ({"object": [BALL], "light": {"position": [0.0, 0.0, 600.0]}}, [BACKS]),
    "a lamp beside": ({"object": [BALL], "light": {"position": [90.0, 0.0, 300.0]}}, []),
    "a light with some ambient": ({"object": [BALL], "light": {"direction": [0.0, 0.0, -1.0], "ambient": 0.1}}, []),
    "a box": ({"object": [{"shape": "box"}, {"shape": "box", "center": [300.0, 0.0, 280.0]}]}, [f"{UNSEEN}box 2"]),
    "going away": ({"object": [GOING], "sequence": {"frames": 3}}, [f"{BLACK}frame 2"]),
    "in one frame of twelve": ({"object": [CROSSING, WALL], "sequence": {"frames": 12, "shutter": 0.01}}, []),
    "past a card": ({"camera": WIDE, "object": [DOT | {"radius": 3.0}, CARD]}, []),
    "behind a card": ({"camera": WIDE | {"f_number": 8.0}, "object": [DOT | {"radius": 3.0}, CARD]}, [f"{UNSEEN}dot"]),
    "right eye alone": ({"object": [BALL | {"center": [45.0, 0.0, 280.0]}], "stereo": {"baseline": 40.0}}, []),
}


@pytest.mark.parametrize("name", SCENES)
def test_what_is_said_is_true(name: str) -> None:
    tables, notes = SCENES[name]
    scene = clsco.parse_scene({"camera": CAMERA} | tables)
    assert sight_notes(prepare(scene).plans) == notes
    dark = [frame.index for frame in clsco.render(scene.replace("psf", PLAIN), truth=()) if not frame.color.any()]
    if any(note == BACKS or note.endswith("all frames") for note in notes):
        assert dark == list(range(scene.sequence.frames))
    else:
        assert [f"{BLACK}frame {index}" for index in dark] == [note for note in notes if note.startswith(BLACK)]


@pytest.mark.parametrize(("distance", "percent"), [(100.0, "20"), (250.0, "8"), (999.0, "2"), (1001.0, None)])
def test_a_close_focus(distance: float, percent: str | None) -> None:
    note = close_focus_note(Camera(focus_distance=distance))
    assert (note is None) == (percent is None)
    assert note is None or f" {percent} % (f/u) smaller" in note
    for chosen in ("sensor", 20.0):
        camera = Camera.model_validate({"focus_distance": distance, "normalization_distance": chosen})
        assert close_focus_note(camera) is None


def test_commands_say_it_once_and_succeed(tmp_path: Path) -> None:
    text = (
        "[camera]\nresolution = [20, 14]\nf_number = [2.0, 4.0]\n[[object]]\nshape = 'sphere'\ncenter = [0, 400, 280]\n"
    )
    path = scene_file(tmp_path / "s.toml", text)
    for command in (["validate"], ["plan"], ["render", "--quiet", "-o", str(tmp_path / "out")]):
        result = clsco_(*command, path)
        assert result.exit_code == 0
        lines = [line.rpartition(": ")[2] for line in result.stderr.splitlines() if line.startswith(str(path))]
        assert lines[:2] == ["sphere", "nothing is in sight, and all is black, in all frames".rpartition(": ")[2]]
        assert (len(lines) == 3) == (command[0] != "render")  # of the close focus
