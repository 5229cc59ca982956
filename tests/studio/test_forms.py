"""Forms: the five panels of the thesis, and a field for every key."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from clsco.scene.schema import scene_schema
from clsco.scene.shapes import SHAPES
from clsco.studio.forms import Field, Panel, field_at, flat, panels
from clsco.studio.session import Document


def of_shape(session: Document, shape: str) -> dict[str, Panel]:
    """Panels of a shape, whether its object is complete or not."""
    session.patch("object.0.shape", shape)
    return {panel.title: panel for panel in panels(session)}


def keys(schema: dict[str, Any], entry: dict[str, Any], start: str) -> Iterator[str]:
    """Paths of all keys that a value of a schema may have; those of tables are of what is in them, of arrays of tables
    none where there are none."""
    if any("$ref" in form.get("items", {}) for form in [entry, *entry.get("anyOf", [])]):
        return
    forms = [form for form in [entry, *entry.get("anyOf", [])] if "$ref" in form]
    inner = [schema["$defs"][form["$ref"].rpartition("/")[2]] for form in forms]
    tables = [model for model in inner if "properties" in model and model.get("title") != "Range"]
    for model in tables:
        for key, value in model["properties"].items():
            yield from keys(schema, value, f"{start}.{key}")
    if not tables or any(form.get("type") == "array" for form in entry.get("anyOf", [])):
        yield start


def test_every_key_of_the_schema_has_a_field(session: Document) -> None:
    schema = scene_schema()
    session.patch("group", [{"name": "both"}])
    session.patch("object.0.group", "both")
    wanted = set()
    for key, entry in schema["properties"].items():
        if key not in ("object", "group", "variant"):
            wanted |= set(keys(schema, entry, key))
    wanted |= set(keys(schema, {"$ref": "#/$defs/Group"}, "group.0"))
    assert len(wanted) > 40
    for shape, model in SHAPES.items():
        of_object = set(keys(schema, {"$ref": f"#/$defs/{model.__name__}"}, "object.0"))
        found = [field for panel in of_shape(session, shape).values() for field in panel.fields]
        assert {field.path for field in found} == wanted | of_object, shape
        assert len(found) == len(wanted | of_object)
        for field in found:
            assert field.label
            if field.path != "title":
                assert field.help, field.path
            if field.kind in ("number", "vector"):
                assert field.least is not None
                assert field.most is not None
                assert field.unit or "mm" not in field.help.split(";")[0].split()[-1:], field.path


def test_keyframes_have_fields_for_those_that_there_are(session: Document) -> None:
    of_shape(session, "sphere")
    frames = [{"time": 0.0}, {"time": 2.0, "position": [1.0, 2.0, 3.0], "rotation": [0.0, 45.0, 0.0]}]
    session.patch("object.0.motion", {"keyframe": frames, "interpolation": "linear"})
    assert session.scene is not None
    start = "object.0.motion.keyframe.1"
    found = {field.path: field for panel in panels(session) for field in panel.fields if field.path.startswith(start)}
    assert [field.path.removeprefix(f"{start}.") for field in found.values()] == ["time", "position", "rotation"]
    assert [field.label for field in found.values()] == [
        "Time of keyframe 2", "Position of keyframe 2", "Rotation of keyframe 2",
    ]  # fmt: skip
    assert [field.unit for field in found.values()] == ["s", "mm", "deg"]
    assert session.patch(f"{start}.position.1", 5.0)
    assert session.scene.objects[0].motion.keyframe is not None
    assert session.scene.objects[0].motion.keyframe[1].position == (1.0, 5.0, 3.0)
    assert not session.patch(f"{start}.time", -1.0)


def test_the_five_panels_are_those_of_the_thesis(session: Document) -> None:
    titles = [panel.title for panel in panels(session)]
    assert titles[:5] == [
        "Input Image File", "Select Object Type", "Select Object Properties", "Motion parameters",
        "Camera Specifications",
    ]  # fmt: skip
    first = {panel.title: panel.fields for panel in panels(session)}
    assert [panel.is_open for panel in panels(session)] == [True] * 5 + [False] * (len(titles) - 5)
    session.patch("aperture.shape", "polygon")
    opened = [panel.title for panel in panels(session) if panel.is_open]
    assert opened == [*titles[:5], "PSF and method"]  # of which the scene says something now
    assert [field.path for field in first["Input Image File"]] == ["object.0.texture"]
    (kind,) = first["Select Object Type"]
    assert [label for _, label in kind.choices][:5] == ["Planar", "Cylindrical", "Spherical", "Conical", "Elliptical"]
    assert session.known(kind.path) == "plane" == kind.choices[0][0]
    camera = first["Camera Specifications"]
    symbols = [(field.symbol, field.unit, session.known(field.path)) for field in camera[:5]]
    assert symbols == [
        ("f", "mm", 20.0), ("D", "mm", 10.0), ("p", "mm", 0.01), ("s", "mm", 21.739), ("s0", "mm", 20.0),
    ]  # fmt: skip
    assert [field.default for field in camera[:5]] == [20.0, 10.0, 0.01, 21.739, 20.0]
    assert [field.key for field in camera[5:]] == ["focus_distance", "f_number", "resolution"]
    motion = first["Motion parameters"]
    assert [field.key for field in motion] == ["velocity", "angular_velocity", "frames", "interval"]
    boxes = [field.component(k).symbol + " " + field.unit for field in motion[:2] for k in range(3)]
    assert boxes == ["vx mm/s", "vy mm/s", "vz mm/s", "ωx deg/s", "ωy deg/s", "ωz deg/s"]
    assert [field.symbol for field in motion[2:]] == ["n", "t"]


@pytest.mark.parametrize(
    ("shape", "expected"),
    [
        ("plane", ["a", "b", "c"]), ("cylinder", ["ρ", "C", ""]), ("sphere", ["ρ", "C"]), ("cone", ["θ", "C", ""]),
        ("ellipsoid", ["", ""]),
    ],
)  # fmt: skip
def test_properties_follow_the_shape(session: Document, shape: str, expected: list[str]) -> None:
    fields = of_shape(session, shape)["Select Object Properties"].fields
    assert [field.symbol for field in fields] == expected
    assert {field.unit for field in fields if field.kind != "choice"} <= {"mm", "mm per mm", "deg", ""}
    for field in fields:
        assert session.known(field.path) == field.default


def test_defaults_follow_from_keys_beside(session: Document) -> None:
    session.patch("camera.focal_length", 30.0)
    session.patch("camera.f_number", 3.0)
    session.patch("sequence.interval", 0.5)
    found = {name: field_at(session, name) for name in ("camera.aperture_diameter", "sequence.shutter")}
    assert [field.default for field in found.values() if field] == [10.0, 0.5]
    assert field_at(session, "camera.nothing") is None


def test_components(session: Document) -> None:
    of_shape(session, "sphere")
    center = field_at(session, "object.0.center.2")
    assert center is not None
    z = center.component(2)
    assert (z.path, z.name, z.default, z.kind) == ("object.0.center.2", "Center z Cz (mm)", 280.0, "number")
    assert z.slider == (50.0, 1000.0)
    bounds = field_at(session, "object.0.bounds")
    assert bounds is not None
    assert bounds.component(3).path == "object.0.bounds.1.1"
    assert session.patch(bounds.path, [[-1.0, 1.0], [-2.0, 2.0], [-3.0, 3.0]])
    assert flat(session.known(bounds.path)) == [-1.0, 1.0, -2.0, 2.0, -3.0, 3.0]


@pytest.mark.parametrize(
    ("path", "value", "rotation"),
    [
        ("object.0.rotation.1", 30.0, [0.0, 30.0, 0.0]),
        ("object.0.rotation.angle", 30.0, {"axis": [0.0, 1.0, 0.0], "angle": 30.0}),
        ("object.0.rotation.axis.0", 1.0, {"axis": [1.0, 1.0, 0.0], "angle": 0.0}),
        ("object.0.rotation.quaternion", [1.0, 1.0, 0.0, 0.0], {"quaternion": [1.0, 1.0, 0.0, 0.0]}),
    ],
)
@pytest.mark.parametrize("before", [None, [5.0, 0.0, 0.0], {"quaternion": [0.0, 0.0, 1.0, 0.0]}])
def test_a_pose_takes_the_form_of_what_is_given(
    session: Document, path: str, value: Any, rotation: Any, before: Any
) -> None:
    of_shape(session, "sphere")
    session.patch("object.0.rotation", before)
    assert session.patch(path, value)
    if not (isinstance(before, list) and isinstance(rotation, list)):
        assert session.table["object"][0]["rotation"] == rotation


def test_sliders_are_within_what_is_valid(session: Document) -> None:
    def numbers(field: Field) -> list[Field]:
        return [field.component(k) for k in range(len(field.components))] or [field]

    for shape in SHAPES:
        for panel in of_shape(session, shape).values():
            for field in (part for each in panel.fields for part in numbers(each) if part.slider is not None):
                assert field.least is not None
                assert field.most is not None
                assert field.slider is not None
                assert field.least <= field.slider[0] < field.slider[1] <= field.most
                assert 0.0 < field.step <= field.slider[1] - field.slider[0]
