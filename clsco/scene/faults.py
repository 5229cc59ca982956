"""Faults of a scene's mapping: one message each, `where: key: rule; got value`."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from functools import lru_cache
from typing import Any, TypeVar, get_args, get_origin

from pydantic import BaseModel, ValidationError

from clsco.errors import SceneError
from clsco.scene.groups import unknown_groups
from clsco.scene.objects import repeated_names
from clsco.scene.quantities import Location
from clsco.scene.shapes import SHAPES
from clsco.scene.text import any_of, key_name, meant, shown

MAX_MESSAGES = 100
ALIASES = {"objects": "object", "groups": "group"}  # arrays of tables in a file, by their attributes

Root = TypeVar("Root", bound=BaseModel)

_RULES = {
    "bool_type": "must be true or false",
    "float_type": "must be a number",
    "int_type": "must be an integer",
    "string_type": "must be text",
    "string_unicode": "must be valid Unicode text",
    "string_too_short": "must not be empty",
    "string_too_long": "must have at most {max_length} characters",
    "literal_error": "must be {expected}",
    "model_type": "must be a table",
    "model_attributes_type": "must be a table",
    "invalid_key": "keys must be text",
}


@lru_cache(maxsize=1)
def tables(root: type[BaseModel]) -> list[tuple[Location, type[BaseModel]]]:
    """Location and model of every table of a scene, the scene itself first; root: its model.

    Locations are as in faults of pydantic, with 0 for each index: ("object", 0, "sphere", "motion").
    """
    return list(_tables_in(root, ()))


def _tables_in(annotation: Any, place: Location) -> Iterator[tuple[Location, type[BaseModel]]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        if place == ("object", 0):
            place = (*place, annotation.model_fields["shape"].default)
        yield place, annotation
        for name, field in annotation.model_fields.items():
            yield from _tables_in(field.annotation, (*place, str(field.validation_alias or name)))
    inner = (*place, 0) if get_origin(annotation) is tuple else place
    for part in get_args(annotation):
        yield from _tables_in(part, inner)


def parsed(root: type[Root], mapping: Any, where: str) -> Root:
    """Validate the mapping of a scene; root: its model. Raises SceneError, one message per fault."""
    if not isinstance(mapping, Mapping):
        raise SceneError(f"{where}: must be a table; got {shown(mapping)}")
    try:
        return root.model_validate(dict(mapping), by_alias=True, by_name=False)
    except ValidationError as error:
        lines = messages(error, root)
    names, members = (_texts(items(mapping), key) for key in ("name", "group"))
    unknown = unknown_groups(members, _texts(items(mapping, "group"), "name"))
    for loc, rule, name in (*repeated_names(names), *unknown):
        place = key_name(("object", *loc)) + ": "
        if not any(message.startswith(place) for message in lines):
            lines.append(f"{place}{rule}; got {shown(name)}")
    raise SceneError(at_most(where, lines))


def messages(error: ValidationError, root: type[BaseModel], place: Location = ()) -> list[str]:
    """Messages on the faults that pydantic found in a scene, or in the scene's table at the location `place`."""
    faults = error.errors(include_url=False)
    # A default is not computed if it depends on a key that is faulty itself.
    own = [fault for fault in faults if fault["type"] != "default_factory_not_called"]
    return [_message({**fault, "loc": (*place, *fault["loc"])}, root) for fault in own]


def refusal(root: type[BaseModel], model: type[BaseModel], error: ValidationError) -> SceneError:
    """SceneError for an invalid model that was constructed in Python, such as `Sphere(radius=-1)`.

    Each line is like "Sphere: radius: rule; got value". root: class of the scene's model.
    """
    place = next(place for place, known in tables(root) if known is model)
    start = key_name(_without_shape(place))
    lines = (message.removeprefix(f"{start}.").removeprefix(f"{start}: ") for message in messages(error, root, place))
    return SceneError(at_most(model.__name__, lines))


def at_most(where: str, messages: Iterable[str]) -> list[str]:
    """Messages as `where: message`; of more than MAX_MESSAGES, only the first, and the number of the others."""
    listed = list(messages)
    if len(listed) > MAX_MESSAGES:
        listed[MAX_MESSAGES:] = [f"and {len(listed) - MAX_MESSAGES} more faults"]
    return [f"{where}: {message}" for message in listed]


def _texts(tables: Iterable[Mapping[str, Any]], key: str) -> list[str | None]:
    """Texts under a key of each table, None if a value is not text."""
    return [text if isinstance(text := table.get(key), str) else None for table in tables]


def items(data: Mapping[str, Any], key: str = "object") -> list[Mapping[str, Any]]:
    """Tables in the array `key` of a scene's content, {} for each entry that is not a table; [] without an array."""
    items = data.get(key)
    return [item if isinstance(item, Mapping) else {} for item in items] if isinstance(items, list) else []


def _without_shape(loc: Location) -> Location:
    """A location as in a file: pydantic's location without the shape that follows the index of an object."""
    return loc[:2] + loc[3:] if len(loc) > 2 and loc[0] == "object" and loc[2] in SHAPES else loc


def _message(fault: Mapping[str, Any], root: type[BaseModel]) -> str:
    """Message `key: rule; got value` of one fault that pydantic found."""
    kind, value, context, loc = fault["type"], fault["input"], fault.get("ctx", {}), tuple(fault["loc"])
    if len(loc) > 1 or kind != "extra_forbidden":  # arguments of a constructor, and faulty defaults
        loc = (*(ALIASES.get(part, part) for part in loc[:1]), *loc[1:])
    key = key_name(_without_shape(loc))
    if kind == "missing":
        return f"{key}: must be given; got nothing"
    if kind == "extra_forbidden":
        rule = _unknown(loc, root)
    elif kind == "rule":
        rule = context["rule"]
    elif kind == "float_type" and type(value) is int:
        rule = "must be a finite number"  # an integer beyond float64
    else:
        rule = _RULES[kind].format(**context).replace("'", "") if kind in _RULES else fault["msg"]
    return f"{key}: {rule}; got {context.get('got') or shown(value)}"


def _unknown(loc: Location, root: type[BaseModel]) -> str:
    """Rule for an unknown key: the shapes that it belongs to, or the key that is probably meant."""
    key, place = str(loc[-1]), tuple(0 if isinstance(part, int) else part for part in loc[:-1])
    homes = [name for name, model in SHAPES.items() if key in model.model_fields]
    if homes and len(place) == 3 and place[2] in SHAPES:
        return f"belongs to {any_of(homes)}, not to {place[2]}"
    if loc == ("vary",):
        return "belongs to a distribution, from which clsco dataset make draws scenes"
    table = next(model for at, model in tables(root) if at == place)
    names = [str(field.validation_alias or name) for name, field in table.model_fields.items()]
    others = [(*at, key) for at, model in tables(root)[1:] if key in model.model_fields]
    others.sort(key=lambda at: (len(at) > 2, at[0] != "object", len(at)))
    elsewhere = f" (did you mean {key_name(_without_shape(others[0]))}?)" if others else ""
    return f"unknown key{meant(key, names) or elsewhere}"
