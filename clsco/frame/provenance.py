"""Provenance of a frame: its scene's parameters with their units, and hashes."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, get_args

from clsco import __version__
from clsco.files.atomic import raise_file_error, sha256
from clsco.optics.motion import Eye
from clsco.scene.arrays import HasInputs
from clsco.scene.changes import dump, table_at
from clsco.scene.model import Scene
from clsco.scene.quantities import Within

# Units of derived parameters and of a frame's metadata whose names do not state their units.
DERIVED_UNITS = {"derived.aperture_diameter": "mm", "derived.sensor_distance": "mm"}
FRAME_UNITS = {
    "intermediate[].time": "s",
    "seconds": "s, by pass on the device, and of the host besides; not what prepares the scene or writes files",
}


def views(scene: Scene) -> tuple[Eye, ...]:
    """The views of a scene: one, or two of a stereo pair."""
    return ("left",) if scene.stereo is None else ("left", "right")


def units(scene: Scene) -> dict[str, str]:
    """Unit of every parameter that has one: {"camera.focal_length": "mm", "object[0].radius": "mm", ...}."""
    sections = [(name, getattr(scene, name)) for name in type(scene).model_fields if name not in ("groups", "objects")]
    sections += [(f"group[{index}]", group) for index, group in enumerate(scene.groups)]
    sections += [(f"object[{index}]", item) for index, item in enumerate(scene.objects)]
    units_of_keys: dict[str, str] = {}
    while sections:
        place, model = sections.pop(0)
        for name, field in getattr(type(model), "model_fields", {}).items():
            key = f"{place}.{name}"
            value = getattr(model, name)
            listed = enumerate(value) if isinstance(value, tuple) else ()
            sections += [(key, value), *((f"{key}[{k}]", each) for k, each in listed)]
            is_table = hasattr(type(value), "model_fields")  # the keys of the table have units of their own
            if (unit := _unit((field.annotation, *field.metadata))) and not is_table:
                units_of_keys[key] = unit
    return units_of_keys


def _unit(parts: Iterable[Any]) -> str:
    """The first unit in nested constraints of an annotation."""
    for part in parts:
        if unit := part.unit if isinstance(part, Within) else _unit(get_args(part)):
            return unit
    return ""


def file_digests(scenes: Iterable[Scene]) -> dict[str, str]:
    """SHA-256 in hexadecimal of all input files of scenes, by path. Raises FileError if a file cannot be read."""
    paths = [path for scene in scenes for _, item in scene.inputs for path in item.files().values()]
    digests = {}
    for path in dict.fromkeys(paths):
        try:
            digests[path] = sha256(Path(path))
        except OSError as error:
            raise_file_error(Path(path), "must be a file that can be read", error, error)
    return digests


def _digests(item: HasInputs, known: Mapping[str, str]) -> dict[str, str]:
    """SHA-256 of the files and arrays of a table, by key; known: SHA-256 of files, by path."""
    files = {key: known[path] for key, path in item.files().items()}
    return files | {key: array.sha256 for key, array in item.arrays().items()}


def scene_sha256(scene: Scene, digests: Mapping[str, str] | None = None) -> str:
    """SHA-256 of all that determines the image: parameters, and contents of input files but not their paths.

    scene: one with a resolution. digests: those of `file_digests`, if known. Raises FileError if a file cannot be read.
    """
    known = file_digests([scene]) if digests is None else digests
    content = dump(scene)
    for place, item in scene.inputs:
        table_at(content, place).update(_digests(item, known))
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def record(scene: Scene, digests: Mapping[str, str] | None = None) -> dict[str, Any]:
    """Entries of a frame's JSON file that come from its scene, with a description in place of each array.

    Arguments and errors are those of `scene_sha256`.
    """
    camera = scene.camera
    known = file_digests([scene]) if digests is None else digests
    digests_of = [(item, _digests(item, known)) for _, item in scene.inputs]

    def of(what: str) -> dict[str, str]:
        return {str(item.inputs()[what]): hashes[what] for item, hashes in digests_of if what in hashes}

    content = dump(scene)
    for place, item in scene.inputs:
        table_at(content, place).update({key: str(array) for key, array in item.arrays().items()})
    places = [""] if scene.stereo is None else [f"views.{view}." for view in views(scene)]
    units_of_frame = {place + key: unit for place in places for key, unit in FRAME_UNITS.items()}
    return {
        "version": __version__,
        "scene_sha256": scene_sha256(scene, known),
        "scene": content,
        "derived": {"aperture_diameter": camera.aperture_diameter, "sensor_distance": camera.sensor_distance},
        "textures_sha256": of("texture"),
        "depths_sha256": of("depth"),
        **({"apertures_sha256": pupils} if (pupils := of("image")) else {}),
        "units": units(scene) | DERIVED_UNITS | units_of_frame,
    }
