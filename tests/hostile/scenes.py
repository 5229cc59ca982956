"""Bad scenes, listed: of each key of the schema the values that it must not have; the message has to name the key."""

from __future__ import annotations

import copy
import datetime
import math
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from clsco.scene.schema import scene_schema
from clsco.scene.text import key_name

SCHEMA = scene_schema()
# Keys that a table needs, by its model.
NEEDED: dict[str, dict[str, Any]] = {
    "DepthMap": {"depth": "z.png"},
    "Group": {"name": "cart"},
    "Keyframe": {"time": 0.0},
    "LensKeyframe": {"time": 0.0, "focus_distance": 300.0},
    "Light": {"direction": [0.3, 0.8, 1.0]},
    "Quadric": {"coefficients": [1, 1, 1, 0, 0, 0, 0, 0, 0, -900]},
    "Rim": {"distance": 20.0, "diameter": 30.0},
    "Stereo": {"baseline": 65.0},
}
VALUES = ("AxisAngle", "UnitQuaternion", "Range")  # tables that stand for a value
NO_TABLE: tuple[Any, ...] = (1, "", True, math.nan, [{}], [[1]], datetime.date(1979, 5, 27))
NO_VALUE: tuple[Any, ...] = ({"a": 1}, [[[1.0]]], [[{}]], math.nan, datetime.date(1979, 5, 27), datetime.time(7, 32))
NO_TEXT = (1, "a\nb", "\0", "\x1b[31m", "\x7f", "a" * 4097)
NO_WORD = ("", "x", " midpoint", "Pillbox", "a\nb", "\0")
TOO_FAR = (1e308, -1e308, 10**80, -(10**80), -math.inf)
SWEPT = ("camera.f_number", "camera.focus_distance", "sequence.shutter", "object[0].motion.velocity")
# Ranges and lists that are none, of keys that may have several values.
SWEEPS = (
    "[]", "[3.0, 3.0]", '["a", "b"]', "[[], []]", "[1, {}]", "{ from = 1 }", "{ to = 1 }", "{ steps = 3 }",
    "{ from = 2, to = 4, steps = 1 }", "{ from = 2, to = 2, steps = 3 }", "{ from = 2, to = 4, steps = 4097 }",
    "{ from = 2, to = 4, steps = 2.0 }", '{ from = "2", to = 4, steps = 3 }', "{ from = nan, to = 4, steps = 3 }",
    "{ from = 2, to = inf, steps = 3 }", "{ from = 2, to = 4, steps = 3, by = 1 }", "{ from = [1], to = 4, steps = 3 }",
    "{ from = 1e308, to = -1e308, steps = 3 }",
)  # fmt: skip


@dataclass(frozen=True)
class Bad:
    """A scene with one fault; `key` is what the message must name."""

    mapping: dict[str, Any]
    key: str
    about: str


def listed() -> Iterator[Bad]:
    """Bad values of all keys of the schema, and of keys that may have several values."""
    plane = {"object": [{"shape": "plane"}]}
    for section, entry in SCHEMA["properties"].items():
        yield from _of_entry(plane, (section,), entry)
    for key in SWEPT:
        path = tuple(int(part) if part == "0" else part for part in key.replace("[0]", ".0").split("."))
        for value in SWEEPS:
            yield _bad(plane, path, tomllib.loads(f"value = {value}")["value"])


def _of_entry(scene: Mapping[str, Any], path: tuple[str | int, ...], entry: Mapping[str, Any]) -> Iterator[Bad]:
    """Bad values of a key, or of all keys of a table."""
    forms = list(_forms(entry))
    models = [form["$ref"].rpartition("/")[2] for form in forms if "$ref" in form]
    tables = [name for name in models if name not in VALUES]
    if not tables:
        yield from (_bad(scene, path, value) for value in _bad_values(forms))
        return
    is_array = any(form.get("type") == "array" for form in forms)
    yield from (_bad(scene, path, value) for value in NO_TABLE if not (is_array and value == [{}] and len(tables) > 1))
    place = (*path, 0) if is_array else path
    for name in tables:
        model = SCHEMA["$defs"][name]
        shape = {"shape": model["properties"]["shape"]["const"]} if path == ("object",) else {}
        whole = _with(scene, place, NEEDED.get(name, {}) | shape)
        for key, inner in model["properties"].items():
            if key != "shape":
                yield from _of_entry(whole, (*place, key), inner)


def _forms(entry: Mapping[str, Any]) -> Iterator[Mapping[str, Any]]:
    """Forms that a value may have, those of a sweep and no value left out."""
    if "anyOf" in entry or "oneOf" in entry:
        for form in entry.get("anyOf", entry.get("oneOf", ())):
            if form.get("type") != "null" and "All of them" not in form.get("description", ""):
                yield from _forms(form)
        return
    if {"$ref", "oneOf"} & entry.get("items", {}).keys():
        yield from _forms(entry["items"])
    yield entry


def _bad_values(forms: list[Mapping[str, Any]]) -> Iterator[Any]:
    types = {str(form.get("type", "")) for form in forms}
    words = [word for form in forms for word in form.get("enum", [form["const"]] if "const" in form else [])]
    yield from NO_VALUE
    if types == {"boolean"}:
        yield from (0, 1, "true", "yes")
        return
    yield True
    yield from NO_WORD if words or "string" not in types else NO_TEXT
    for form in forms:
        if form.get("type") in ("number", "integer"):
            yield from TOO_FAR
            yield from _beside(form)
        for number, inner in enumerate(form.get("prefixItems", ())):
            good = [each.get("minimum", 0) for each in form["prefixItems"]]
            yield from (good[:-1], [*good, good[0]])
            for value in ("3", *_beside(inner)):
                yield [*good[:number], value, *good[number + 1 :]]


def _beside(form: Mapping[str, Any]) -> Iterator[Any]:
    """Numbers just outside of an interval."""
    step = 1 if form.get("type") == "integer" else 0
    for name, way in (("minimum", -1), ("maximum", 1)):
        if name in form:
            yield form[name] + way if step else math.nextafter(form[name], way * math.inf)
        elif (excluded := f"exclusive{name.capitalize()}") in form:
            yield form[excluded]
    yield from [1.5] if step else []


def _bad(scene: Mapping[str, Any], path: tuple[str | int, ...], value: Any) -> Bad:
    key = key_name(path)
    return Bad(_with(scene, path, value), key, f"{scene['object'][0]['shape']}: {key} = {str(value)[:60]}")


def _with(scene: Mapping[str, Any], path: tuple[str | int, ...], value: Any) -> dict[str, Any]:
    """A copy of a scene with another value; an array gets its first table."""
    changed = copy.deepcopy(dict(scene))
    node: Any = changed
    for part, after in pairwise(path):
        node = node[part] if isinstance(part, int) else node.setdefault(part, [{}] if after == 0 else {})
    node[path[-1]] = value
    return changed
