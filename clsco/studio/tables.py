"""Changes of the mapping of a scene that leave the old one as it is, and faults of it by their keys."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

from clsco.errors import SceneError
from clsco.scene.changes import displace, key_parts, put
from clsco.scene.file import SECTIONS, swept_keys
from clsco.scene.groups import Group
from clsco.scene.shapes import SHAPES
from clsco.scene.text import brief, key_name
from clsco.scene.texture_keys import Textured

Table = dict[str, Any]
DEEPEST = 8  # parts of a path
LONGEST = 200  # characters of one
_ALIKE = {*Textured.model_fields, "name", "motion", "group"}  # keys that an object keeps when its shape changes
_SEEDS: dict[str, list[Any]] = {  # of vectors that have no default, of which a component is given
    "direction": [0.0, 0.0, 1.0],
    "bounds": [[-1000.0, 1000.0]] * 3,
    "position": [0.0, 0.0, 0.0],
    "origin": [0.0, 0.0, 0.0],
    "texture_offset": [0.0, 0.0],
}
_ALL_ALIKE = ("resolution", "texture_size", "texture_repeats")  # of these the others are what the one is
_START: dict[str, Table] = {  # of shapes that have no defaults
    "quadric": {"coefficients": [1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -900.0], "center": [0.0, 0.0, 280.0]}
}


def is_path(path: str) -> bool:
    """Test whether something can be the path of a key."""
    try:
        path_parts(path)
    except SceneError:
        return False
    return True


def path_parts(path: str) -> list[str]:
    """Parts of the path of a key, "object.0.radius". Raises SceneError for what cannot be one."""
    parts = key_parts(path) if len(path) <= LONGEST else []
    if not all(parts) or not 1 <= len(parts) <= DEEPEST:
        raise SceneError(f"scene: {brief(path)}: must be the path of a key, like object.0.radius")
    return parts


def at(node: Any, parts: Sequence[str]) -> Any:
    """The entry at `parts`, None where there is none."""
    for part in parts:
        if isinstance(node, list | tuple):
            node = node[int(part)] if part.isdecimal() and len(part) < 10 and int(part) < len(node) else None
        else:
            node = node.get(part) if isinstance(node, Mapping) else None
    return node


def with_value(table: Table, parts: list[str], value: Any) -> Table:
    """The table with another value, and without the keys that contradict it. Raises SceneError."""
    changed: Table = _copied({key: _shallow(entry) for key, entry in table.items()}, parts)
    displace(changed, ".".join(parts), value)
    if (fault := put(changed, parts, value)) is not None:
        raise SceneError(f"scene: {brief('.'.join(parts))}: {fault}")
    return changed


def without(table: Table, parts: list[str]) -> Table:
    """The table without a key, and without tables that are empty then."""
    if at(table, parts) is None:
        return table
    changed: Table = _copied(table, parts)
    *outer, last = parts
    node = at(changed, outer)
    if not isinstance(node, dict):
        raise SceneError(f"scene: {brief('.'.join(parts))}: must be one of several keys; got a component")
    del node[last]
    return without(changed, outer) if outer and not node and not outer[-1].isdecimal() else changed


def _shallow(node: Any) -> Any:
    return dict(node) if isinstance(node, Mapping) else node


def _copied(node: Any, parts: Sequence[str]) -> Any:
    """A copy of the tables and lists along `parts`; all else is shared."""
    if not isinstance(node, dict | list):
        return node
    copy = node.copy()
    if parts and (inner := at(node, parts[:1])) is not None:
        key: Any = int(parts[0]) if isinstance(node, list) else parts[0]
        copy[key] = _copied(inner, parts[1:])
    return copy


def reshaped(item: Table, shape: Any, kept: Mapping[str, Table]) -> tuple[Table, dict[str, Table]]:
    """An object of another shape, and the keys that the old one had, to come back to.

    Parameters
    ----------
    item : mapping
        Table of the object.
    shape : str
        The new shape; any other value is left for the rules of scenes to refuse.
    kept : mapping
        Keys of the shapes that the object has had, by shape.
    """
    own = {key: value for key, value in item.items() if key not in _ALIKE}
    alike = {key: value for key, value in item.items() if key in _ALIKE}
    old = str(item.get("shape"))
    if isinstance(shape, str) and shape in SHAPES:
        mapping = alike.get("texture_mapping", "projected")
        fits = mapping == "projected" or mapping in SHAPES[shape].MAPPINGS
        known = SHAPES[shape].model_fields
        alike = {
            key: value
            for key, value in alike.items()
            if key in known and (fits or key == "texture" or key not in Textured.model_fields)
        }
    back = kept.get(shape, _START.get(shape, {})) if isinstance(shape, str) else {}
    return {"shape": shape} | alike | back | {"shape": shape}, {**kept, old: own}


def seed(key: str, value: Any) -> list[Any] | None:
    """Start value of a vector without a default when one component is given; None for a key that is no vector."""
    return [value, value] if key in _ALL_ALIKE else _SEEDS.get(key)


def pose_for(rotation: Any, part: str) -> Any:
    """A static rotation in the form that a part of it belongs to: an angle, axis and angle, or a quaternion."""
    if part.isdecimal():
        return rotation if isinstance(rotation, list) else [0.0, 0.0, 0.0]
    if part in ("axis", "angle"):
        is_one = isinstance(rotation, Mapping) and "axis" in rotation
        return rotation if is_one else {"axis": [0.0, 1.0, 0.0], "angle": 0.0}
    is_one = isinstance(rotation, Mapping) and "quaternion" in rotation
    return rotation if is_one else {"quaternion": [1.0, 0.0, 0.0, 0.0]}


def placed(error: SceneError) -> dict[str, str]:
    """Messages of a SceneError by the paths of their keys; "" for a message about no key."""
    found: dict[str, str] = {}
    for message in error.messages:
        match = re.fullmatch(r"[^:]*: ([^:]+): (.*)", message)
        key, rule = match.groups() if match else ("scene", message)
        found.setdefault("" if key == "scene" else ".".join(key_parts(key)), rule)
    return found


def written(place: Sequence[str]) -> str:
    """A place in a table as messages have it: object[0].texture."""
    return key_name([int(part) if part.isdecimal() else part for part in place])


def sparse(table: Mapping[str, Any]) -> Table:
    """The valid table of a scene without the keys that have their defaults.

    Defaults follow from keys of the same table alone, so that each is looked at by itself; tables with several values
    for a key stay whole.
    """
    swept = {location[:2] if location[0] in ("object", "group") else location[:1] for location, _ in swept_keys(table)}
    found: Table = {}
    for key, value in table.items():
        if key in ("object", "group"):
            found[key] = [
                dict(item)
                if (key, index) in swept
                else _sparse(SHAPES[item["shape"]] if key == "object" else Group, item)
                for index, item in enumerate(value)
            ]
        elif key in SECTIONS:
            if part := dict(value) if (key,) in swept else _sparse(SECTIONS[key], value):
                found[key] = part
        elif value != "":  # the title
            found[key] = value
    return found


def _sparse(model: Any, table: Mapping[str, Any]) -> Table:
    """A table without keys that have their defaults."""
    whole, left = model.model_validate(dict(table)), dict(table)
    leaves = [[key] for key in table if key not in ("shape", "name", "motion")]
    leaves += [["motion", key] for key in table.get("motion", ())]
    for leaf in leaves:
        fewer = without(left, leaf)
        try:
            if model.model_validate(fewer) == whole:
                left = fewer
        except ValueError:  # it must be given
            continue
    return left
