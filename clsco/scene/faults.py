"""Faults of a scene's mapping: one message each, `where: key: rule; got value`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from typing import Any, TypeVar, get_args

from pydantic import BaseModel, ValidationError

from clsco.errors import SceneError
from clsco.scene.aberrations import Seidel, Zernike
from clsco.scene.groups import Group, unknown_groups
from clsco.scene.motions import Keyframe, LensKeyframe, ObjectMotion
from clsco.scene.objects import repeated_names
from clsco.scene.shapes import SHAPES
from clsco.scene.text import key_name, shown

MAX_MESSAGES = 100

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
def sections(root: type[BaseModel]) -> dict[str, type[BaseModel]]:
    """Model of each table of a scene, by the table's key; root: the scene's model."""
    return {
        str(field.validation_alias or name): part
        for name, field in root.model_fields.items()
        for part in (field.annotation, *get_args(field.annotation))
        if isinstance(part, type) and issubclass(part, BaseModel)
    }


@lru_cache(maxsize=1)
def _places(root: type[BaseModel]) -> list[tuple[str, type[BaseModel]]]:
    """Location and model of every table of a scene; root: the scene's model."""
    known = {name: model for name, model in sections(root).items() if model is not Group}
    shapes = (("object[0]", shape) for shape in SHAPES.values())
    moving: Any = known["camera"].model_fields["motion"].annotation
    moved = (("object[0].motion", ObjectMotion), ("camera.motion", moving), ("object[0].motion.keyframe[0]", Keyframe))
    errors = (("psf.seidel", Seidel), ("psf.zernike", Zernike))
    return [*known.items(), *shapes, *moved, ("lens.keyframe[0]", LensKeyframe), ("group[0]", Group), *errors]


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
    for key, faults in (("name", repeated_names(names)), ("group", unknown)):
        for index, fault, name in faults:
            place = f"object[{index}].{key}: "
            if not any(message.startswith(place) for message in lines):
                lines.append(f"{place}{fault.message()}; got {shown(name)}")
    raise SceneError(at_most(where, lines))


def messages(error: ValidationError, root: type[BaseModel], place: tuple[str | int, ...] = ()) -> list[str]:
    """Messages on the faults that pydantic found in a scene, or in the scene's table at the location `place`."""
    return [_message({**fault, "loc": (*place, *fault["loc"])}, root) for fault in _faults(error)]


def refusal(root: type[BaseModel], model: type[BaseModel], error: ValidationError) -> SceneError:
    """SceneError for an invalid model that was constructed in Python, such as `Sphere(radius=-1)`.

    Each line is like "Sphere: radius: rule; got value". root: class of the scene's model; model: class that was
    constructed; error: its faults, as found by pydantic.
    """
    motion = ("object", 0, "sphere", "motion")
    known: dict[Any, tuple[str | int, ...]] = {ObjectMotion: motion, Keyframe: (*motion, "keyframe", 0)}
    known |= {LensKeyframe: ("lens", "keyframe", 0)}
    place = ({root: (), Group: ("group", 0)} | known).get(model)
    if place is None:
        shapes = {shape: ("object", 0, name) for name, shape in SHAPES.items()}
        tables = {table: tuple(path.split(".")) for path, table in _places(root)}
        place = (tables | shapes)[model]
    start = key_name(tuple(part for part in place if part not in SHAPES))
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


def _faults(error: ValidationError) -> list[Mapping[str, Any]]:
    """Faults found by pydantic, except defaults that depend on another faulty key."""
    return [fault for fault in error.errors(include_url=False) if fault["type"] != "default_factory_not_called"]


def _message(fault: Mapping[str, Any], root: type[BaseModel]) -> str:
    """Message `key: rule; got value` of one fault that pydantic found."""
    kind, value, context = fault["type"], fault["input"], fault.get("ctx", {})
    loc, shape = tuple(fault["loc"]), None
    if loc[:1] == ("objects",) and kind != "extra_forbidden":  # argument of a constructor, or a faulty default
        loc = ("object", *loc[1:])
    if len(loc) > 2 and loc[0] == "object" and loc[2] in SHAPES:
        shape, loc = loc[2], loc[:2] + loc[3:]
    if kind == "missing":
        return f"{key_name(loc)}: must be given; got nothing"
    if kind == "extra_forbidden":
        rule = _unknown(loc, shape, root)
    elif kind == "rule":
        rule = context["rule"]
    elif kind == "float_type" and type(value) is int:
        rule = "must be a finite number"  # an integer beyond float64
    else:
        rule = _RULES[kind].format(**context).replace("'", "") if kind in _RULES else fault["msg"]
    return f"{key_name(loc)}: {rule}; got {context.get('got') or shown(value)}"


def _unknown(loc: tuple[Any, ...], shape: str | None, root: type[BaseModel]) -> str:
    """Rule for an unknown key: the shapes that it belongs to, or the key that is probably meant."""
    key = str(loc[-1])
    if shape is not None and len(loc) == 3:
        known = list(SHAPES[shape].model_fields)
        homes = [name for name, model in SHAPES.items() if key in model.model_fields]
        if homes:
            return f"belongs to {_listed(homes)}, not to {shape}"
    elif shape is not None:
        known = list(_table_at(SHAPES[shape], loc[2:-1]).model_fields)
    else:
        keys = [str(field.validation_alias or name) for name, field in root.model_fields.items()]
        known = list(_table_at(sections(root)[loc[0]], loc[1:-1]).model_fields) if len(loc) > 1 else keys
    if loc == ("vary",):
        return "belongs to a distribution, from which clsco dataset make draws scenes"
    from difflib import get_close_matches

    near = get_close_matches(key[:64], known, n=1)
    near += [f"{path}.{key}" for path, model in _places(root) if key in model.model_fields]
    return f"unknown key (did you mean {near[0]}?)" if near else "unknown key"


def _table_at(model: type[BaseModel], loc: Sequence[str | int]) -> type[BaseModel]:
    """Model of the table at the location `loc` in a table of the class `model`; `loc` may hold indices of arrays."""
    for key in loc:
        waiting: list[Any] = [model.model_fields[key].annotation] if isinstance(key, str) else []
        while waiting:
            part = waiting.pop()
            if isinstance(part, type) and issubclass(part, BaseModel):
                model = part
            waiting += get_args(part)
    return model


def _listed(words: Sequence[str]) -> str:
    return " or ".join(filter(None, (", ".join(words[:-1]), words[-1])))
