"""Scene files: TOML or JSON to a scene and back, with one message per fault."""

from __future__ import annotations

import difflib
import json
import os
import re
import stat
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, get_args, get_origin

from pydantic import BaseModel, ValidationError

from clsco.errors import SceneError
from clsco.scene.model import BUILT_IN_TEXTURES, AnyShape, CameraMotion, ObjectMotion, Psf, Scene
from clsco.scene.shapes import repeated_names
from clsco.scene.text import brief, key_name, shown

MAX_FILE_BYTES = 2**20
MAX_MESSAGES = 100
MAX_OUTPUTS = 4096  # of a sweep
MAX_DOTS = 100  # per line: tomllib needs memory with the square of the parts of a dotted key

SceneLike = Scene | Mapping[str, Any] | str | os.PathLike[str]
PsfLike = Psf | Mapping[str, Any] | str | None
Location = tuple[str | int, ...]  # of a key: ("object", 0, "motion", "velocity")

SHAPES: dict[str, type[BaseModel]] = {shape.model_fields["shape"].default: shape for shape in get_args(AnyShape)}
_SCENE_KEYS = [str(field.validation_alias or name) for name, field in Scene.model_fields.items()]
SECTIONS: dict[str, type[BaseModel]] = {
    name: part
    for name, field in Scene.model_fields.items()
    for part in (field.annotation, *get_args(field.annotation))
    if isinstance(part, type) and issubclass(part, BaseModel)
}
_PLACES: list[tuple[str, type[BaseModel]]] = [
    *SECTIONS.items(),
    *(("object[0]", shape) for shape in SHAPES.values()),
    ("object[0].motion", ObjectMotion),
    ("camera.motion", CameraMotion),
]

# Sections whose keys may have several values, except keys that hold tables.
SWEEPABLE = ("camera", "sequence", "motion")

# (key, its new value or None for any, key of the file that would contradict it)
_DISPLACED: tuple[tuple[str, str | None, str], ...] = (
    ("camera.f_number", None, "camera.aperture_diameter"),
    ("camera.aperture_diameter", None, "camera.f_number"),
    ("camera.focus_distance", None, "camera.sensor_distance"),
    ("camera.sensor_distance", None, "camera.focus_distance"),
    ("aperture.shape", "circle", "aperture.blades"),
    ("aperture.shape", "circle", "aperture.rotation"),
    ("psf.model", "pillbox", "psf.sigma_ratio"),
    ("psf.model", "pillbox", "psf.truncation"),
    ("motion.warp", "forward", "motion.texture_filter"),
    ("motion.warp", "inverse", "fill"),
)

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


def load_scene(path: str | os.PathLike[str], overrides: Sequence[str] = ()) -> Scene:
    """Read a scene from a .toml or .json file.

    Parameters
    ----------
    path : str or os.PathLike
        The file, at most 1 MiB.
    overrides : sequence of str
        Settings that replace the file's, like "camera.f_number=4" or "object.0.radius=30". A value is written as in
        TOML; a bare word is text. The other key of a pair (f_number and aperture_diameter, focus_distance and
        sensor_distance), and keys of a model or warp that is no longer chosen, are dropped.

    Returns
    -------
    Scene
        Paths of textures and depth maps are absolute; relative ones start at the folder of the file.

    Raises
    ------
    SceneError
        One message per fault, `file: key: rule; got value`. Keys with several values, which only `clsco.load_sweep`
        reads, are faults.
    """
    where = os.fspath(path)
    data = read_mapping(where, overrides)
    folder = Path(where).absolute().parent
    if swept := swept_keys(data):
        rule = "must be one value; clsco.load_sweep reads a list or range of them"
        raise SceneError(at_most(where, (f"{key_name(key)}: {rule}; got {shown(value)}" for key, value in swept)))
    try:
        scene = parse_scene(data, where)
    except SceneError as error:
        raise SceneError([*error.messages, *missing_files(data, folder, where)]) from error
    return absolute(scene, folder)


def swept_keys(mapping: Mapping[str, Any]) -> list[tuple[Location, Any]]:
    """Find keys that have a list or a range of values in place of one value.

    Parameters
    ----------
    mapping : mapping
        Content of a scene file, valid or not.

    Returns
    -------
    list of (location, value)
        In the order of the file.
    """
    found: list[tuple[Location, Any]] = []

    def search(table: Any, model: type[BaseModel], location: Location) -> None:
        for key, value in table.items() if isinstance(table, Mapping) else ():
            annotation = model.model_fields[key].annotation if key in model.model_fields else BaseModel
            if isinstance(annotation, type) and issubclass(annotation, BaseModel):
                if annotation is not BaseModel:
                    search(value, annotation, (*location, key))
            elif isinstance(value, Mapping) or (
                isinstance(value, list) and (not _is_vector(annotation) or any(isinstance(v, list) for v in value))
            ):
                found.append(((*location, key), value))

    for section, table in mapping.items():
        if section in SWEEPABLE:
            search(table, SECTIONS[section], (section,))
        elif section == "object":
            for index, item in enumerate(_items(mapping)):
                search(item.get("motion"), ObjectMotion, ("object", index, "motion"))
    return found


def _is_vector(annotation: Any) -> bool:
    """Whether a key holds several numbers, so that a flat list is one value."""
    return get_origin(annotation) is tuple or any(map(_is_vector, get_args(annotation)))


def absolute(scene: Scene, folder: Path) -> Scene:
    """Make the paths of textures and depth maps absolute.

    Parameters
    ----------
    scene : Scene
    folder : Path
        Start of relative paths.

    Returns
    -------
    Scene
    """

    def placed(item: AnyShape) -> AnyShape:
        return item.model_copy(update={key: str(folder / path) for key, path in item.files().items()})

    return scene.model_copy(update={"objects": tuple(map(placed, scene.objects))})


def missing_files(data: Mapping[str, Any], folder: Path, where: str) -> list[str]:
    """Messages on files that do not exist, for a scene with other faults: files of a valid scene are read anyway."""
    rules = {"texture": "must be an existing file or a built-in pattern", "depth": "must be an existing file"}
    return [
        f"{where}: object[{index}].{key}: {rule}; got {shown(name)}"
        for index, item in enumerate(_items(data)[:MAX_MESSAGES])
        for key, rule in rules.items()
        if isinstance(name := item.get(key), str) and name and not _exists(folder, name)
        if key != "texture" or name not in BUILT_IN_TEXTURES
    ]


def _items(data: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Tables of objects, with an empty one in place of what is not a table."""
    items = data.get("object")
    return [item if isinstance(item, Mapping) else {} for item in items] if isinstance(items, list) else []


def _exists(folder: Path, name: str) -> bool:
    """Whether a file of this name exists."""
    try:
        return (folder / name).exists()
    except (OSError, ValueError):  # not a file name: too long, or with a null character
        return False


def parse_scene(mapping: Mapping[str, Any], where: str = "scene") -> Scene:
    """Validate a scene given as nested mappings and lists with the keys of a scene file.

    Parameters
    ----------
    mapping : mapping
        Content of a scene file; not changed.
    where : str
        Name for messages.

    Returns
    -------
    Scene
        Paths of textures stay as they are.

    Raises
    ------
    SceneError
        One message per fault, `where: key: rule; got value`.
    """
    if not isinstance(mapping, Mapping):
        raise SceneError(f"{where}: must be a table; got {shown(mapping)}")
    try:
        return Scene.model_validate(dict(mapping), by_alias=True, by_name=False)
    except ValidationError as error:
        messages = [_message(fault) for fault in _faults(error)]
    names = [name if isinstance(name := item.get("name"), str) else None for item in _items(mapping)]
    for index, fault, name in repeated_names(names):
        message = f"object[{index}].name: {fault.message()}; got {shown(name)}"
        messages += [message] if message not in messages else []
    raise SceneError(at_most(where, messages))


def at_most(where: str, messages: Iterable[str]) -> list[str]:
    """Messages as `where: message`; of more than MAX_MESSAGES the first ones, and the number of the others."""
    listed = list(messages)
    if len(listed) > MAX_MESSAGES:
        listed[MAX_MESSAGES:] = [f"and {len(listed) - MAX_MESSAGES} more faults"]
    return [f"{where}: {message}" for message in listed]


def scene_of(scene: SceneLike) -> Scene:
    """Scene of any form that users may pass.

    Parameters
    ----------
    scene : Scene, mapping, str or os.PathLike
        A mapping as for `parse_scene`, a path as for `load_scene`.

    Returns
    -------
    Scene

    Raises
    ------
    SceneError
        As `parse_scene` and `load_scene`, and for other types.
    """
    if isinstance(scene, Scene):
        return scene
    if isinstance(scene, str | os.PathLike):
        return load_scene(scene)
    if isinstance(scene, Mapping):
        return parse_scene(scene)
    raise SceneError(f"scene: must be a Scene, a mapping or the path of a file; got {type(scene).__name__}")


def psf_of(psf: PsfLike) -> Psf:
    """PSF of any form that users may pass.

    Parameters
    ----------
    psf : Psf, mapping, str or None
        A mapping with the keys of [psf], or the name of a model; None: the default PSF.

    Returns
    -------
    Psf

    Raises
    ------
    SceneError
        As `parse_scene`, and for other types.
    """
    if isinstance(psf, Psf):
        return psf
    given = {"model": psf} if isinstance(psf, str) else {} if psf is None else psf
    if not isinstance(given, Mapping):
        raise SceneError(f"psf: must be a Psf, a mapping or the name of a model; got {type(given).__name__}")
    try:
        return Psf.model_validate(dict(given))
    except ValidationError as error:
        messages = [_message({**fault, "loc": ("psf", *fault["loc"])}) for fault in _faults(error)]
    raise SceneError(messages)


def dump(scene: Scene) -> dict[str, Any]:
    """Content of the scene file that describes a scene, with all keys that apply to it written out.

    Parameters
    ----------
    scene : Scene

    Returns
    -------
    dict
        Plain dicts, lists, strings, numbers and booleans; `parse_scene` makes an equal scene of them.
    """
    data: dict[str, Any] = scene.model_dump(mode="json", by_alias=True, exclude_none=True)
    if scene.camera.f_number is not None:
        del data["camera"]["aperture_diameter"]
    if scene.camera.focus_distance is not None:
        del data["camera"]["sensor_distance"]
    for key, section in (("aperture.shape", "aperture"), ("psf.model", "psf"), ("motion.warp", "motion")):
        _displace(data, key, data[section][key.rpartition(".")[2]])
    if scene.psf.occlusion == "visibility" and not scene.is_ray_castable:
        del data["psf"]["occlusion"]  # the default, which only the plan can resolve
    return data


def read_mapping(where: str, overrides: Sequence[str]) -> dict[str, Any]:
    """Content of a scene file with overrides applied, see `load_scene`; raises SceneError."""
    data = _read(where)
    override(data, overrides, where)
    return data


def _read(where: str) -> dict[str, Any]:
    """Content of a scene file, unchecked but for its size, form and repeated keys."""
    kind = Path(where).suffix.lower()
    if kind not in (".toml", ".json"):
        raise SceneError(f"{where}: a scene file must end in .toml or .json")
    try:
        mode = Path(where).stat().st_mode
        if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):  # opening a pipe would block for ever
            raise SceneError(f"{where}: must be a file; got a device or a pipe")
        with open(where, "rb") as file:
            content = file.read(MAX_FILE_BYTES + 1)
    except (OSError, ValueError) as error:
        raise SceneError(f"{where}: cannot be read: {getattr(error, 'strerror', None) or error}") from None
    if len(content) > MAX_FILE_BYTES:
        raise SceneError(f"{where}: a scene file must have at most {MAX_FILE_BYTES} bytes")

    def unique(pairs: Iterable[tuple[str, Any]]) -> dict[str, Any]:
        table: dict[str, Any] = {}
        for key, value in pairs:
            if key in table:
                raise SceneError(f"{where}: {key_name((key,))}: key given twice")
            table[key] = value
        return table

    try:
        text = content.decode("utf-8-sig")
        if kind == ".toml" and any(line.count(".") > MAX_DOTS for line in text.splitlines()):
            raise SceneError(f"{where}: a line must have at most {MAX_DOTS} dots")
        data = tomllib.loads(text) if kind == ".toml" else json.loads(text, object_pairs_hook=unique)
    except UnicodeDecodeError as error:
        raise SceneError(f"{where}: must be UTF-8 text; got byte {content[error.start]:#04x}") from None
    except RecursionError:
        raise SceneError(f"{where}: nested too deeply") from None
    except ValueError as error:
        raise SceneError(f"{where}: not valid {kind[1:].upper()}: {str(error).split(';')[0]}") from None
    if not isinstance(data, dict):
        raise SceneError(f"{where}: must be a table; got {shown(data)}")
    return data


def override(data: dict[str, Any], overrides: Sequence[str], where: str) -> None:
    """Apply overrides to `data` in their order, see `load_scene`; raises SceneError for text that is not KEY=VALUE."""
    messages = []
    for text in overrides:
        key, equals, value = text.partition("=")
        parts = re.sub(r"\[(\d+)\]", r".\1", key.strip()).split(".")
        if not equals or not all(parts):
            messages.append(f"{where}: override must be KEY=VALUE, like camera.f_number=4; got {shown(text)}")
            continue
        parsed = _value(value.strip())
        _displace(data, ".".join(parts), parsed)
        if (fault := _put(data, parts, parsed)) is not None:
            messages.append(f"{where}: override {brief(text)}: {fault}")
    if messages:
        raise SceneError(messages)


def _value(text: str) -> Any:
    """The TOML value of a text, or the text itself where it is not one."""
    try:
        parsed = tomllib.loads(f"value = {text}")
    except (ValueError, RecursionError):
        return text
    return parsed["value"] if len(parsed) == 1 else text


def _put(data: dict[str, Any], parts: list[str], value: Any) -> str | None:
    """Set the entry at `parts`, making tables on the way; returns the reason where that is impossible."""
    node: Any = data
    for position, part in enumerate(parts):
        last = position == len(parts) - 1
        if isinstance(node, list):
            if not (part.isdecimal() and len(part) < 10 and int(part) < len(node)):
                place = brief(".".join(parts[:position]))
                return f"{place} has {len(node)} entries, counted from 0; got {brief(part)}"
            key: Any = int(part)
        elif isinstance(node, dict):
            key = part
            if not last:
                node.setdefault(key, {})
        else:
            return f"{brief('.'.join(parts[:position]))} must be a table; got {shown(node)}"
        if last:
            node[key] = value
        else:
            node = node[key]
    return None


def _displace(data: dict[str, Any], key: str, value: Any) -> None:
    """Remove the keys that contradict `key` = `value`."""
    for cause, condition, other in _DISPLACED:
        if key == cause and condition in (None, value):
            section, _, entry = other.partition(".")
            if not entry:
                data.pop(section, None)
            elif isinstance(data.get(section), dict):
                data[section].pop(entry, None)


def _faults(error: ValidationError) -> list[Mapping[str, Any]]:
    """Faults that pydantic found, except defaults that could not be formed because another key is at fault."""
    return [fault for fault in error.errors(include_url=False) if fault["type"] != "default_factory_not_called"]


def _message(fault: Mapping[str, Any]) -> str:
    """Message `key: rule; got value` of one fault that pydantic found."""
    kind, given, context = fault["type"], fault["input"], fault.get("ctx", {})
    loc, shape = tuple(fault["loc"]), None
    if kind == "rule" and loc == ("objects",):  # pydantic's name where the default is at fault
        loc = ("object",)
    if len(loc) > 2 and loc[0] == "object" and loc[2] in SHAPES:
        shape, loc = loc[2], loc[:2] + loc[3:]
    if kind == "missing":
        return f"{key_name(loc)}: must be given; got nothing"
    if kind == "extra_forbidden":
        rule = _unknown(loc, shape)
    elif kind == "rule":
        rule = context["rule"]
    elif kind == "float_type" and type(given) is int:
        rule = "must be a finite number"  # an integer beyond float64
    else:
        rule = _RULES[kind].format(**context).replace("'", "") if kind in _RULES else fault["msg"]
    return f"{key_name(loc)}: {rule}; got {context.get('got') or shown(given)}"


def _unknown(loc: tuple[Any, ...], shape: str | None) -> str:
    """Rule for an unknown key: the shapes that it belongs to, or the key that is probably meant."""
    key = str(loc[-1])
    if shape is not None and len(loc) == 3:
        known = list(SHAPES[shape].model_fields)
        homes = [name for name, model in SHAPES.items() if key in model.model_fields]
        if homes:
            return f"belongs to {_listed(homes)}, not to {shape}"
    elif shape is not None:
        known = list(SHAPES[shape].model_fields[loc[-2]].annotation.model_fields)  # type: ignore[union-attr]
    else:
        known = list(_model_at(loc[:-1]).model_fields) if len(loc) > 1 else _SCENE_KEYS
    near = difflib.get_close_matches(key[:64], known, n=1)
    near += [f"{path}.{key}" for path, model in _PLACES if key in model.model_fields]
    return f"unknown key (did you mean {near[0]}?)" if near else "unknown key"


def _model_at(loc: Sequence[str]) -> type[BaseModel]:
    """Model of a section, or of a table inside it."""
    model = SECTIONS[loc[0]]
    for part in loc[1:]:
        model = model.model_fields[part].annotation  # type: ignore[assignment]
    return model


def _listed(words: Sequence[str]) -> str:
    return " or ".join(filter(None, (", ".join(words[:-1]), words[-1])))
