"""Scene files: TOML or JSON to a scene and back, with one message per fault."""

from __future__ import annotations

import errno
import json
import os
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import Any, TypeVar, get_args, get_origin

from pydantic import BaseModel, ValidationError

from clsco.errors import SceneError
from clsco.resources import read_regular
from clsco.scene.changes import VARIANT, override, variant_tables
from clsco.scene.faults import MAX_MESSAGES, at_most, items, messages, parsed
from clsco.scene.model import AnyShape, Aperture, Camera, ObjectMotion, Psf, Scene
from clsco.scene.quantities import Location
from clsco.scene.spread import misfit
from clsco.scene.text import key_name, shown
from clsco.scene.texture_keys import SixSided, is_drawn, missing_texture

MAX_FILE_BYTES = 2**20
FILES_ONLY = ("depth", "image")  # keys whose value is always a file, never a built-in pattern
FILE_KEYS = ("texture", "depth", *SixSided.__annotations__, "image")
MAX_OUTPUTS = 4096  # largest number of scenes in a sweep
MAX_DOTS = 100  # dots per line of TOML: memory of tomllib grows with the square of the number of parts of a dotted key

SceneLike = Scene | Mapping[str, Any] | str | os.PathLike[str]
ApertureLike = Aperture | Mapping[str, Any] | str | None
CameraLike = Camera | Mapping[str, Any] | None
PsfLike = Psf | Mapping[str, Any] | str | None
Owner = TypeVar("Owner", AnyShape, Aperture)
Parsed = TypeVar("Parsed")
Section = TypeVar("Section", Psf, Aperture, Camera)

SECTIONS: dict[str, type[BaseModel]] = {
    str(field.validation_alias or name): model
    for name, field in Scene.model_fields.items()
    for model in (field.annotation, *get_args(field.annotation))
    if isinstance(model, type) and issubclass(model, BaseModel)
}
# Sections whose keys may have several values, except keys that hold tables.
SWEEPABLE = ("camera", "sequence", "motion", "light", "sensor")


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

    Examples
    --------
    >>> import clsco
    >>> from clsco.resources import folder
    >>> scene = clsco.load_scene(folder("examples") / "sphere.toml", ["camera.f_number=4"])
    >>> scene.camera.f_number, scene.objects[0].radius
    (4.0, 30.0)
    """
    where = os.fspath(path)
    data = read_mapping(where, overrides)
    if swept := swept_keys(data):
        rule = "must be one value; clsco.load_sweep reads a list or range of them"
        raise SceneError(at_most(where, (f"{key_name(key)}: {rule}; got {shown(value)}" for key, value in swept)))
    return absolute(parse_file(data, where, parse_scene), Path(where).absolute().parent)


def swept_keys(mapping: Mapping[str, Any]) -> list[tuple[Location, Any]]:
    """Find the keys in a scene file's content, valid or not, that have a list or a range in place of a single value."""
    swept: list[tuple[Location, Any]] = []

    def search(table: Any, model: type[BaseModel], location: Location) -> None:
        for key, value in table.items() if isinstance(table, Mapping) else ():
            if key not in model.model_fields:
                continue
            annotation = model.model_fields[key].annotation
            if isinstance(annotation, type) and issubclass(annotation, BaseModel):
                search(value, annotation, (*location, key))
            elif not holds_tables(annotation) and _has_several(value, annotation):
                swept.append(((*location, key), value))

    for section, table in mapping.items():
        if section in SWEEPABLE:
            search(table, SECTIONS[section], (section,))
        elif section in ("object", "group"):
            for index, item in enumerate(items(mapping, section)):
                search(item.get("motion"), ObjectMotion, (section, index, "motion"))
        elif section == VARIANT:
            swept.append(((section,), table))
    return swept


def _has_several(value: Any, annotation: Any) -> bool:
    """True if a value is a range, or a list that a key with this type annotation does not take as a single value."""
    is_list = isinstance(value, list) and (not _is_vector(annotation) or any(isinstance(v, list | str) for v in value))
    return is_list or isinstance(value, Mapping)


def holds_tables(annotation: Any) -> bool:
    """True if a key with this type annotation holds a table, or an array of tables."""
    is_table = isinstance(annotation, type) and issubclass(annotation, BaseModel)
    return is_table or any(map(holds_tables, get_args(annotation)))


def _is_vector(annotation: Any) -> bool:
    """True if a key with this type annotation holds several numbers, so that a flat list is a single value."""
    return get_origin(annotation) is tuple or any(map(_is_vector, get_args(annotation)))


def absolute(scene: Scene, folder: Path) -> Scene:
    """Copy of a scene in which the paths of all input files are absolute; relative paths start at `folder`."""

    def placed(item: Owner) -> Owner:
        return item.model_copy(update={key: str(folder / path) for key, path in item.files().items()})

    return scene.model_copy(update={"aperture": placed(scene.aperture), "objects": tuple(map(placed, scene.objects))})


def names_file(key: str, name: str) -> bool:
    """True if a value under one of FILE_KEYS names a file, False for a pattern or a color."""
    return key in FILES_ONLY or not is_drawn(name)


def named_files(data: Mapping[str, Any]) -> Iterator[tuple[Location, str]]:
    """Location and name of each file that the content of a scene file names, for objects and the aperture."""
    tables: list[tuple[Location, Any]] = [(("object", index), item) for index, item in enumerate(items(data))]
    for place, table in (*tables, (("aperture",), data.get("aperture"))):
        for key in FILE_KEYS if isinstance(table, Mapping) else ():
            if isinstance(name := table.get(key), str) and names_file(key, name):
                yield (*place, key), name


def relocated(data: Mapping[str, Any], name: Callable[[Location, str], str]) -> dict[str, Any]:
    """Copy of a scene file's content with other file names; name: returns the new name, from location and old name."""
    if tables := variant_tables(data):
        return {VARIANT: [relocated(table, name) for table in tables]}
    copy = dict(data)
    if isinstance(aperture := data.get("aperture"), Mapping):
        copy["aperture"] = dict(aperture)
    if "object" in data:
        copy["object"] = [dict(item) for item in items(data)]
    for place, known in named_files(data):
        table = copy["object"][place[1]] if len(place) > 2 else copy["aperture"]
        table[place[-1]] = name(place, known)
    return copy


def parse_file(data: dict[str, Any], where: str, parse: Callable[[dict[str, Any], str], Parsed]) -> Parsed:
    """Parse the content of the file `where`. A SceneError also lists files that do not exist; in a valid scene, these
    are reported when they are read.
    """
    try:
        return parse(data, where)
    except SceneError as error:
        folder = Path(where).absolute().parent
        # Unlike Path.exists, this is False for what is no file name: too long, or with a null character.
        missing = ((place, name) for place, name in named_files(data) if name and not os.path.exists(folder / name))  # noqa: PTH110
        rules = ((place, name, missing_input(str(place[-1]), name)) for place, name in islice(missing, MAX_MESSAGES))
        messages = [f"{where}: {key_name(place)}: {rule}; got {shown(name)}" for place, name, rule in rules]
        raise SceneError([*error.messages, *messages]) from error


def missing_input(key: str, name: str) -> str:
    """The rule of an error message about a missing file that a scene names under a key."""
    return "must be an existing file" if key in FILES_ONLY else missing_texture(name)


def parse_scene(mapping: Mapping[str, Any] | str, where: str = "scene") -> Scene:
    """Validate a scene given as nested mappings and lists with the keys of a scene file, or as its text.

    Parameters
    ----------
    mapping : mapping or str
        Content of a scene file as a mapping, which is not changed, or as TOML text. In a mapping, textures and depths
        may also be NumPy arrays.
    where : str
        Name of the scene in messages.

    Returns
    -------
    Scene
        Relative paths of files remain relative.

    Raises
    ------
    SceneError
        One message per fault, `where: key: rule; got value`.

    Examples
    --------
    >>> import clsco
    >>> scene = clsco.parse_scene({"object": [{"shape": "sphere", "center": [0, 0, 280], "radius": 30}]})
    >>> scene == clsco.parse_scene('object = [{ shape = "sphere", center = [0, 0, 280], radius = 30 }]')
    True
    >>> clsco.parse_scene({"object": [{"shape": "sphere", "radius": -1}]})
    Traceback (most recent call last):
    clsco.errors.SceneError: scene: object[0].radius: must be greater than 0 mm; got -1
    """
    return parsed(Scene, table_of(mapping, where), where)


def table_of(content: Any, where: str) -> Any:
    """Content of a scene file from its TOML text; other content stays unchanged. Raises SceneError."""
    if not isinstance(content, str):
        return content
    if len(content) > MAX_FILE_BYTES:
        raise SceneError(f"{where}: a scene must have at most {MAX_FILE_BYTES} characters")
    return _table(content, ".toml", where)


def scene_of(scene: SceneLike) -> Scene:
    """The scene for a user's argument: a Scene, a mapping or the path of a file. Raises SceneError."""
    if isinstance(scene, Scene):
        return scene
    if isinstance(scene, str | os.PathLike):
        return load_scene(scene)
    if isinstance(scene, Mapping):
        return parse_scene(scene)
    raise SceneError(f"scene: must be a Scene, a mapping or the path of a file; got {type(scene).__name__}")


def psf_of(psf: PsfLike) -> Psf:
    """The PSF for a user's argument: a Psf, a mapping with the keys of [psf], a model's name, or None (the default)."""
    return _section(Psf, psf, "psf", "model")


def aperture_of(aperture: ApertureLike, psf: Psf) -> Aperture:
    """The aperture for a user's argument: an Aperture, a mapping with the keys of [aperture], a shape's name, or None
    for a circle. Raises SceneError, also if it does not fit the PSF.
    """
    section = _section(Aperture, aperture, "aperture", "shape")
    if section.rim:
        raise SceneError("aperture.rim: needs a camera, which an image has none of; got rims")
    if fault := misfit(psf, section):
        key, rule, value = fault
        raise SceneError(f"aperture.{key}: {rule}; got {value}")
    return section


def camera_of(camera: CameraLike) -> Camera | None:
    """The camera for a user's argument; None for None. Raises SceneError."""
    return None if camera is None else _section(Camera, camera, "camera")


def _section(model: type[Section], value: Any, name: str, shorthand: str = "") -> Section:
    """Section of a scene from a section, a mapping, None (all defaults), or text: the value of the key `shorthand`."""
    if isinstance(value, model):
        return value
    table = {shorthand: value} if shorthand and isinstance(value, str) else {} if value is None else value
    if not isinstance(table, Mapping):
        others = f", a mapping or the name of a {shorthand}" if shorthand else " or a mapping"
        raise SceneError(f"{name}: must be {model.__name__}{others}; got {type(table).__name__}")
    try:
        return model.model_validate(dict(table))
    except ValidationError as error:
        raise SceneError(messages(error, Scene, (name,))) from None


def read_mapping(where: str, overrides: Sequence[str]) -> dict[str, Any]:
    """Content of a scene file with overrides applied, see `load_scene`; raises SceneError.

    Only its size, syntax and repeated keys are checked.
    """
    kind = Path(where).suffix.lower()
    if kind not in (".toml", ".json"):
        raise SceneError(f"{where}: a scene file must end in .toml or .json")
    try:
        content = read_regular(where, MAX_FILE_BYTES, follow=True)
    except (OSError, ValueError) as error:
        if getattr(error, "errno", None) == errno.EFBIG:
            raise SceneError(f"{where}: a scene file must have at most {MAX_FILE_BYTES} bytes") from None
        raise SceneError(f"{where}: cannot be read: {getattr(error, 'strerror', None) or error}") from None
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise SceneError(f"{where}: must be UTF-8 text; got byte {content[error.start]:#04x}") from None
    data = _table(text, kind, where)
    override(data, overrides, where)
    return data


def _table(text: str, kind: str, where: str) -> dict[str, Any]:
    """The table in a TOML or JSON text; only syntax and repeated keys are checked."""

    def unique(pairs: Iterable[tuple[str, Any]]) -> dict[str, Any]:
        table: dict[str, Any] = {}
        for key, value in pairs:
            if key in table:
                raise SceneError(f"{where}: {key_name((key,))}: key given twice")
            table[key] = value
        return table

    try:
        if kind == ".toml" and any(line.count(".") > MAX_DOTS for line in text.splitlines()):
            raise SceneError(f"{where}: a line must have at most {MAX_DOTS} dots")
        data = tomllib.loads(text) if kind == ".toml" else json.loads(text, object_pairs_hook=unique)
    except RecursionError:
        raise SceneError(f"{where}: nested too deeply") from None
    except ValueError as error:
        raise SceneError(f"{where}: not valid {kind[1:].upper()}: {str(error).split(';')[0]}") from None
    if not isinstance(data, dict):
        raise SceneError(f"{where}: must be a table; got {shown(data)}")
    return data
