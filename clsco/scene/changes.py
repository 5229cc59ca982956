"""Changes of single keys of a scene's mapping."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping, Sequence
from functools import reduce
from operator import getitem
from typing import Any, cast, get_args

from pydantic import BaseModel

from clsco.errors import SceneError
from clsco.scene.faults import ALIASES, Root, parsed
from clsco.scene.sensor import EXPOSURE_KEYS
from clsco.scene.spread import APERTURE_KEYS, MODEL_KEYS, ApertureShape, SpreadModel
from clsco.scene.text import brief, shown

MAX_VARIANTS = 4096
MOST_JOINED = 8  # depth of tables that are joined; deeper nesting is rejected later
VARIANT = "variant"  # array of tables; each has the keys of one scene that differ from the rest of the file
# (section, its key, values of this key, other keys of the section that are allowed only with some of these values)
_CHOICES: tuple[tuple[str, str, tuple[str, ...], Mapping[str, tuple[str, ...]]], ...] = (
    ("aperture", "shape", get_args(ApertureShape), APERTURE_KEYS),
    ("psf", "model", get_args(SpreadModel), MODEL_KEYS),
    ("sensor", "exposure", ("normalized", "physical"), EXPOSURE_KEYS),
)
# (key that is set, its new value or None for any, other key that contradicts this value)
_DISPLACED: tuple[tuple[str, str | None, str], ...] = (
    ("camera.f_number", None, "camera.aperture_diameter"),
    ("camera.aperture_diameter", None, "camera.f_number"),
    ("camera.focus_distance", None, "camera.sensor_distance"),
    ("camera.sensor_distance", None, "camera.focus_distance"),
    ("light.direction", None, "light.position"),
    ("light.position", None, "light.direction"),
    ("sensor.gain", None, "sensor.iso"),
    ("sensor.gain", None, "sensor.iso_base"),
    ("sensor.iso", None, "sensor.gain"),
    ("sensor.mosaic", "none", "sensor.demosaic"),
    *(
        (f"{section}.{selector}", value, f"{section}.{key}")
        for section, selector, values, homes in _CHOICES
        for key, own in homes.items()
        for value in values
        if value not in own
    ),
    ("motion.warp", "forward", "motion.texture_filter"),
    ("motion.warp", "inverse", "fill"),
)


def key_parts(key: str) -> list[str]:
    """Parts of a key like object.0.radius, or object[0].radius."""
    return re.sub(r"\[(\d+)\]", r".\1", key).split(".")


def override(data: dict[str, Any], overrides: Sequence[str], where: str) -> None:
    """Apply overrides to `data` in order, see `clsco.load_scene`; raises SceneError for text that is not KEY=VALUE."""
    messages = []
    for text in overrides:
        key, equals, value = text.partition("=")
        parts = key_parts(key.strip())
        if not equals or not all(parts):
            messages.append(f"{where}: override must be KEY=VALUE, like camera.f_number=4; got {shown(text)}")
            continue
        parsed = _value(value.strip())
        displace(data, ".".join(parts), parsed)
        if (fault := put(data, parts, parsed)) is not None:
            messages.append(f"{where}: override {brief(text)}: {fault}")
    if messages:
        raise SceneError(messages)


def _value(text: str) -> Any:
    """The TOML value of a text, or the text itself if it is not valid TOML."""
    try:
        parsed = tomllib.loads(f"value = {text}")
    except (ValueError, RecursionError):
        return text
    return parsed["value"] if len(parsed) == 1 else text


def put(data: dict[str, Any], parts: list[str], value: Any) -> str | None:
    """Set the entry at the key `parts`, creating tables as needed; returns None, or why that is impossible."""
    node: Any = data
    for position, part in enumerate(parts):
        place = brief(".".join(parts[:position]))
        key: Any = part
        if isinstance(node, list):
            if not (part.isdecimal() and len(part) < 10 and int(part) < len(node)):
                return f"{place} has {len(node)} entries, counted from 0; got {brief(part)}"
            key = int(part)
        elif not isinstance(node, dict):
            return f"{place} must be a table; got {shown(node)}"
        if position == len(parts) - 1:
            node[key] = value
        else:
            node = node.setdefault(key, {}) if isinstance(node, dict) else node[key]
    return None


def variant_tables(data: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Content of a separate scene file for each [[variant]]; [] if they are missing, too many, or not all tables."""
    tables, shared = data.get(VARIANT), {key: value for key, value in data.items() if key != VARIANT}
    if not isinstance(tables, list) or len(tables) > MAX_VARIANTS or not all(isinstance(t, Mapping) for t in tables):
        return []
    return [_changed(shared, table) for table in tables]


def _changed(data: Mapping[str, Any], table: Mapping[str, Any]) -> dict[str, Any]:
    """Content of a scene file with the values of `table`, and without keys that contradict these values.

    Tables are joined key by key. A table in place of a list changes the list's entries by number, as "object.0.radius"
    does; other values are replaced.
    """
    copy = {key: dict(value) if isinstance(value, Mapping) else value for key, value in data.items()}
    for section, keys in table.items():
        for key, value in keys.items() if isinstance(keys, Mapping) else ():
            displace(copy, f"{section}.{key}", value)
    return cast("dict[str, Any]", _joined(copy, table))


def _joined(old: Any, new: Any, depth: int = 0) -> Any:
    if not isinstance(new, Mapping) or depth == MOST_JOINED:
        return new
    if isinstance(old, list) and new.keys() <= {str(number) for number in range(len(old))}:
        return [_joined(entry, new[str(k)], depth + 1) if str(k) in new else entry for k, entry in enumerate(old)]
    if not isinstance(old, Mapping):
        return new
    return {**old, **{key: _joined(old.get(key), value, depth + 1) for key, value in new.items()}}


def displace(data: dict[str, Any], key: str, value: Any) -> None:
    """Remove the keys from `data` that contradict `key` = `value`."""
    for cause, condition, other in _DISPLACED:
        if key == cause and (condition is None or (isinstance(value, str) and value == condition)):
            section, _, entry = other.partition(".")
            if not entry:
                data.pop(section, None)
            elif isinstance(data.get(section), dict):
                data[section].pop(entry, None)


def dump(scene: Any) -> dict[str, Any]:
    """Content of the scene file that describes a scene, with all keys that apply to it written out.

    It consists of dicts, lists, strings, numbers and booleans, and of the scene's arrays; `parse_scene` turns it into
    an equal scene.
    """
    data: dict[str, Any] = scene.model_dump(mode="json", by_alias=True, exclude_none=True)
    for key in ("camera.f_number", "camera.focus_distance", *(f"{section}.{key}" for section, key, *_ in _CHOICES)):
        if (value := entry_at(data, key.split("."))) is not None:
            displace(data, key, value)
    displace(data, "motion.warp", scene.motion.warp)
    if scene.sensor is not None and scene.sensor.iso is None:
        del data["sensor"]["iso_base"]
    if not scene.groups:
        del data["group"]
    if scene.psf.occlusion == "visibility" and not scene.is_ray_castable:
        del data["psf"]["occlusion"]  # not set, and its default depends on the plan
    for place, item in scene.inputs:
        table_at(data, place).update(item.arrays())
    return data


def table_at(data: Any, place: Sequence[str | int]) -> dict[str, Any]:
    """Table of a scene's mapping at a location from `Scene.inputs`."""
    return reduce(getitem, place, data)


def given_keys(value: Any) -> Any:
    """Content of a scene file with only the keys that were set explicitly, so that defaults are derived again.

    value: a scene or one of its tables, a list or mapping of these, or the value of a key, which is returned unchanged.
    """
    if isinstance(value, BaseModel):
        fields = type(value).model_fields
        names_set = value.model_fields_set - {name for name, field in fields.items() if field.exclude}
        names = [name for name in fields if name in names_set or name == "shape"]
        values = {fields[name].serialization_alias or name: getattr(value, name) for name in names}
        return {key: given_keys(entry) for key, entry in values.items() if entry is not None}
    if isinstance(value, Mapping):
        return {key: given_keys(entry) for key, entry in value.items()}
    return [given_keys(entry) for entry in value] if isinstance(value, list | tuple) else value


def replaced(scene: Root, path: str, value: Any) -> Root:
    """A scene with another value of one key. Raises SceneError if the key or the value is invalid."""
    try:
        data, parts, new = given_keys(scene), key_parts(path), given_keys(value)
    except RecursionError:
        raise SceneError(f"scene: {brief(path)}: nested too deeply; got {shown(value)}") from None
    parts = [ALIASES.get(parts[0], parts[0]), *parts[1:]]
    known = dump(scene)
    for end in range(1, len(parts)):  # a path to one component of a default, say of a vector, keeps the others
        default = entry_at(known, parts[:end])
        if default is not None and not isinstance(default, dict) and entry_at(data, parts[:end]) is None:
            put(data, parts[:end], default)
    displace(data, ".".join(parts), new)
    if (fault := put(data, parts, new)) is not None:
        raise SceneError(f"scene: {brief(path)}: {fault}")
    return parsed(type(scene), data, "scene")


def entry_at(node: Any, parts: Sequence[str]) -> Any:
    """The entry at the key `parts`, None if there is none."""
    for part in parts:
        if isinstance(node, list):
            node = node[int(part)] if part.isdecimal() and len(part) < 10 and int(part) < len(node) else None
        else:
            node = node.get(part) if isinstance(node, dict) else None
    return node
