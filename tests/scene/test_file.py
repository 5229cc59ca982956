"""Scene files: reading, overrides, the way back, the examples."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Any

import pytest

from clsco.scene.changes import dump
from clsco.scene.faults import MAX_MESSAGES
from clsco.scene.file import MAX_DOTS, MAX_FILE_BYTES, load_scene, parse_scene
from clsco.scene.model import Sphere
from clsco.scene.schema import scene_schema
from clsco.scene.shapes import SHAPES
from clsco.scene.sweep import load_sweep
from tests.scene.schema_file import generate_schema
from tests.scenes import EXAMPLES, refusals, scene_file

THESIS = [path for path in EXAMPLES if path.parent.name == "thesis"]
BALL = """
title = "Turning ball"
[camera]
f_number = 4
resolution = [320, 200]
[psf]
model = "gaussian"
sigma_ratio = 0.65
[motion]
warp = "forward"
[fill]
domain = "span"
[[object]]
name = "ball"
shape = "sphere"
radius = 25
[object.motion]
angular_velocity = [0, 10, 0]
"""
SPHERE = {"shape": "sphere"}


@pytest.fixture
def ball(tmp_path: Path) -> Path:
    return scene_file(tmp_path / "ball.toml", BALL)


def load_message(path: Path, *overrides: str) -> str:
    (message,) = refusals(load_scene, path, overrides)
    assert "\n" not in message
    return message.removeprefix(f"{path}: ")


def test_a_file_says_what_it_says(ball: Path) -> None:
    scene = load_scene(ball)
    assert scene.title == "Turning ball"
    assert scene.camera.aperture_diameter == 5.0
    assert scene.camera.resolution == (320, 200)
    assert (scene.psf.model, scene.psf.sigma_ratio, scene.psf.truncation) == ("gaussian", 0.65, 3.0)
    assert (scene.motion.warp, scene.fill.domain) == ("forward", "span")
    (item,) = scene.objects
    assert isinstance(item, Sphere)
    assert (item.name, item.radius, item.center) == ("ball", 25.0, (0.0, 0.0, 280.0))
    assert item.motion.angular_velocity == (0.0, 10.0, 0.0)


def test_json_and_toml_say_the_same(ball: Path) -> None:
    other = ball.with_suffix(".json")
    other.write_text(json.dumps(tomllib.loads(BALL)), encoding="utf-8")
    assert load_scene(other) == load_scene(ball)


def test_a_byte_order_mark_is_no_fault(ball: Path) -> None:
    expected = load_scene(ball)
    ball.write_text(BALL, encoding="utf-8-sig")
    assert load_scene(ball) == expected


def test_textures_are_sought_beside_the_scene_file(ball: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def texture(given: str) -> str:
        return str(load_scene("ball.toml", [f"object.0.texture={given}"]).objects[0].texture)

    monkeypatch.chdir(tmp_path)
    assert texture("wall.png") == str(tmp_path / "wall.png")
    assert texture("images/wall.png") == str(tmp_path / "images" / "wall.png")
    assert texture(str(tmp_path / "wall.png")) == str(tmp_path / "wall.png")
    assert texture("siemens_star") == "siemens_star"
    scene_file(tmp_path / "map.toml", '[[object]]\nshape = "depth_map"\ndepth = "z.exr"\n')
    for given, path in (("z.exr", tmp_path / "z.exr"), ("/other/z.exr", "/other/z.exr")):
        assert load_scene("map.toml", [f"object.0.depth={given}"]).objects[0].files() == {"depth": str(path)}
    assert parse_scene({"object": [{"shape": "plane", "texture": "wall.png"}]}).objects[0].texture == "wall.png"


@pytest.mark.parametrize(
    ("overrides", "path", "expected"),
    [
        (["camera.f_number=8"], "camera.f_number", 8.0),
        (["camera.aperture_diameter=3"], "camera.f_number", None),
        (["camera.aperture_diameter=3"], "camera.aperture_diameter", 3.0),
        (["camera.sensor_distance=22", "camera.focus_distance=300"], "camera.focus_distance", 300.0),
        (["camera.focus_distance=300", "camera.sensor_distance=22"], "camera.focus_distance", None),
        (["camera.resolution=[64, 48]"], "camera.resolution", (64, 48)),
        (["object.0.radius=31"], "objects.0.radius", 31.0),
        (["object[0].radius = 32"], "objects.0.radius", 32.0),
        (["object.0.motion.velocity=[1, 0, 0]"], "objects.0.motion.velocity", (1.0, 0.0, 0.0)),
        (["object.0.name=moon"], "objects.0.name", "moon"),
        (["object.0.name='3'"], "objects.0.name", "3"),
        (["title=A = B"], "title", "A = B"),
        (["sequence.samples=auto"], "sequence.samples", "auto"),
        (["sequence.samples=9"], "sequence.samples", 9),
        (["psf.tilt=false"], "psf.tilt", False),
        (["psf.model=pillbox"], "psf.model", "pillbox"),
        (["motion.warp=inverse"], "motion.warp", "inverse"),
        (["motion.warp=inverse", "motion.texture_filter=nearest", "motion.warp=forward"], "motion.warp", "forward"),
    ],
)
def test_overrides(ball: Path, overrides: list[str], path: str, expected: Any) -> None:
    value: Any = load_scene(ball, overrides)
    for part in path.split("."):
        value = value[int(part)] if part.isdecimal() else getattr(value, part)
    assert value == expected
    assert type(value) is type(expected)


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("camera..f_number=3", 'override must be KEY=VALUE, like camera.f_number=4; got "camera..f_number=3"'),
        ("object.1.radius=3", "override object.1.radius=3: object has 1 entries, counted from 0; got 1"),
        ("title.x=3", 'override title.x=3: title must be a table; got "Turning ball"'),
        ("camera.resolution=[64,", 'camera.resolution: must be a list of 2 integers; got "[64,"'),
    ],
)
def test_bad_overrides(ball: Path, override: str, message: str) -> None:
    assert load_message(ball, override) == message


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.txt", b"", "a scene file must end in .toml or .json"),
        ("a.toml", b"\xff", "must be UTF-8 text; got byte 0xff"),
        ("a.toml", b"camera = ", "not valid TOML: Invalid value (at end of document)"),
        ("a.toml", b"a = 1\na = 2", "not valid TOML: Cannot overwrite a value (at end of document)"),
        ("a.toml", b"a = " + b"[" * 100_000, "nested too deeply"),
        ("a.toml", b"a" + b".a" * 100_000 + b" = 1", f"a line must have at most {MAX_DOTS} dots"),
        ("a.toml", b"#" * (MAX_FILE_BYTES + 1), f"a scene file must have at most {MAX_FILE_BYTES} bytes"),
        ("a.json", b"[" * 100_000, "nested too deeply"),
        ("a.json", b"", "not valid JSON: Expecting value: line 1 column 1 (char 0)"),
        ("a.json", b"[1]", "must be a table; got [1]"),
        ("a.json", b'{"camera": {"f_number": 1, "f_number": 2}}', "f_number: key given twice"),
    ],
)
def test_bad_files(tmp_path: Path, name: str, content: bytes, message: str) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    assert load_message(path) == message


def test_numbers_beyond_all_measure(tmp_path: Path) -> None:
    path = tmp_path / "a.toml"
    path.write_text("object = [{shape = 'plane'}]\n[camera]\nf_number = 0x1" + "0" * 5000, encoding="utf-8")
    assert load_message(path) == "camera.f_number: must be a finite number; got an integer of about 6021 digits"
    path.write_text(f"object = [{{shape = 'plane'}}]\n[camera]\nf_number = {'1' * 80}", encoding="utf-8")
    message = "must be between 0.001 and 1000000; got an integer of about 80 digits"
    assert load_message(path) == f"camera.f_number: {message}"
    path.write_text(f"a = {'9' * 5000}", encoding="utf-8")
    assert load_message(path).startswith("not valid TOML: Exceeds the limit")
    path = tmp_path / "a.json"
    path.write_text('{"object": [{"shape": "plane"}], "camera": {"f_number": 1e999}}', encoding="utf-8")
    assert load_message(path) == "camera.f_number: must be a finite number; got inf"


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    assert load_message(tmp_path / "none.toml") == "cannot be read: No such file or directory"
    (tmp_path / "folder.toml").mkdir()
    assert load_message(tmp_path / "folder.toml") == "cannot be read: Is a directory"


def test_all_faults_are_listed_at_once() -> None:
    assert refusals(
        parse_scene,
        {
            "camera": {"focal_length": -3, "focal_lenght": 20.0, "f_number": "x", "aperture_diameter": 2},
            "psf": {"tilt": 1, "truncation": 2},
            "sequence": {"shutter": 2.0, "samples": 0},
            "motion": {"warp": "inverse"},
            "fill": {"method": "none", "domain": "span"},
            "object": [{"shape": "sphere", "radius": 0, "half_angle": 3, "motion": {"velocity": [0, 0]}}],
        },
    ) == (
        "scene: camera.focal_length: must be greater than 0 mm; got -3",
        'scene: camera.f_number: must be a number; got "x"',
        "scene: camera.aperture_diameter: give f_number or aperture_diameter, not both; got 2",
        "scene: camera.focal_lenght: unknown key (did you mean focal_length?); got 20.0",
        "scene: psf.tilt: must be true or false; got 1",
        'scene: psf.truncation: belongs to psf.model = "gaussian", not "pillbox"; got 2',
        "scene: sequence.shutter: must be at most interval = 1 s; got 2.0",
        'scene: sequence.samples: must be an integer between 1 and 4096, or "auto"; got 0',
        'scene: fill.domain: belongs to motion.warp = "forward", not "inverse"; got "span"',
        'scene: fill.method: belongs to motion.warp = "forward", not "inverse"; got "none"',
        "scene: object[0].motion.velocity: must be a list of 3 numbers; got [0, 0]",
        "scene: object[0].radius: must be greater than 0 mm; got 0",
        "scene: object[0].half_angle: belongs to cone, not to sphere; got 3",
    )


def test_very_many_faults_are_counted() -> None:
    messages = refusals(parse_scene, {"object": [SPHERE], **{f"key{i}": i for i in range(MAX_MESSAGES + 20)}})
    assert len(messages) == MAX_MESSAGES + 1
    assert messages[-1] == "scene: and 20 more faults"


def test_what_only_python_code_can_say() -> None:
    assert refusals(parse_scene, 3) == ("scene: must be a table; got 3",)
    assert refusals(parse_scene, {5: 6, "object": [SPHERE]}) == ("scene: [5]: keys must be text; got 5",)
    assert refusals(parse_scene, {"object": [SPHERE], "camera": {"f_number": 10**5000}}) == (
        "scene: camera.f_number: must be a finite number; got an integer of about 5001 digits",
    )
    assert refusals(parse_scene, {"object": [{"shape": 10**5000}]})[0].endswith("got an integer of about 5001 digits")
    assert refusals(parse_scene, {"object": [SPHERE], "title": "\ud800"}) == (
        'scene: title: must be valid Unicode text; got "\\ud800"',
    )
    mapping: dict[str, Any] = {"object": [SPHERE]}
    mapping["camera"] = mapping
    assert refusals(parse_scene, mapping)[0].startswith("scene: camera.object: unknown key")


def test_parsing_leaves_the_mapping_as_it_was() -> None:
    mapping = {"object": [{"shape": "sphere", "center": [0, 0, 300]}]}
    parse_scene(mapping)
    assert mapping == {"object": [{"shape": "sphere", "center": [0, 0, 300]}]}


def test_dump_spells_out_what_applies() -> None:
    data = dump(parse_scene({"object": [SPHERE]}))
    assert data["camera"] == {
        "focal_length": 20.0,
        "aperture_diameter": 10.0,
        "sensor_distance": 21.739,
        "normalization_distance": 20.0,
        "pixel_pitch": 0.01,
        "motion": {"velocity": [0.0, 0.0, 0.0], "angular_velocity": [0.0, 0.0, 0.0]},
    }
    assert data["object"][0]["center"] == [0.0, 0.0, 280.0]
    absent = "sigma_ratio fill sensor group rotation keyframe interpolation outside acceleration"
    assert not any(f'"{key}"' in json.dumps(data | {"motion": {}}) for key in absent.split())


def test_schema_documents_every_key() -> None:
    schema = scene_schema()
    assert schema == json.loads(json.dumps(generate_schema(), allow_nan=False)), "python -m tests.scene.schema_file"
    assert schema["required"] == ["object"]
    sections = "title camera aperture psf lens sequence motion fill image light stereo sensor group object variant"
    assert list(schema["properties"]) == sections.split()
    for definition in schema["$defs"].values():
        assert definition["additionalProperties"] is False
        for key, entry in definition["properties"].items():
            assert entry.get("description") or key == "shape", key
    assert schema["$defs"]["Sphere"]["required"] == ["shape"]
    assert schema["$defs"]["Quadric"]["required"] == ["shape", "coefficients"]
    assert schema["$defs"]["Cone"]["properties"]["half_angle"]["exclusiveMaximum"] == 90.0
    assert schema["$defs"]["Sphere"]["properties"]["radius"]["minimum"] == 1e-6


@pytest.mark.parametrize("path", THESIS, ids=lambda path: path.stem)
def test_figures_have_the_settings_of_the_thesis(path: Path) -> None:
    scene = load_scene(path)
    number = path.stem.split("_")
    assert f"{number[1]}.{int(number[2])}" in scene.title
    lens = scene.camera
    assert (lens.focal_length, lens.aperture_diameter, lens.sensor_distance) == (20.0, 10.0, 21.739)
    assert (lens.normalization_distance, lens.pixel_pitch, lens.resolution) == (20.0, 0.01, (512, 512))
    psf = scene.psf
    assert (psf.edge, psf.tilt, psf.silhouette_samples, psf.occlusion) == ("sampled", False, 1, "none")
    assert psf.truncation == 2.0 or psf.model == "pillbox"
    assert scene.image.transfer == "linear"
    seen_by_another = path.with_name("road.jpg")  # of the road that figure 4.18 shows in bricks
    assert scene.objects[0].texture == (str(seen_by_another) if path.stem == "fig_4_19" else "bricks")
    if scene.objects[0].motion.moves:
        assert scene.sequence.sampling == "endpoint"
        assert (scene.motion.warp, scene.motion.rotation, scene.fill.domain) == ("forward", "euler", "span")


def test_there_are_examples() -> None:
    figures = {path.stem[4:8] for path in THESIS}
    assert figures >= {"3_04", "3_05", "3_08", "3_09", "3_12", "3_13", "3_15", "3_17", "4_02", "4_03", "4_06"}
    assert figures >= {"3_03", *(f"4_{number:02d}" for number in (8, 9, 10, 11, 12, 13, 14, 15, 16, 17, 18, 19))}
    shapes = {item.shape for path in EXAMPLES for item in load_sweep(path).scenes[0].objects}
    assert shapes == SHAPES.keys() - {"box"}  # which is six rectangles


def test_a_missing_texture_is_reported_with_the_other_faults(tmp_path: Path) -> None:
    path = scene_file(
        tmp_path / "two.toml",
        '[[object]]\nshape = "sphere"\nradius = -1\ntexture = "nothere.png"\n'
        '[[object]]\nshape = "depth_map"\ndepth = "z.exr"\n',
    )
    assert [message.split(": ", 1)[1] for message in refusals(load_scene, path)] == [
        "object[0].radius: must be greater than 0 mm; got -1",
        'object[0].texture: must be an existing file, a built-in pattern or a color #rrggbb; got "nothere.png"',
        'object[1].depth: must be an existing file; got "z.exr"',
    ]
