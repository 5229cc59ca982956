"""Provenance of a frame: its scene's parameters with their units, and hashes."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, get_args

from clsco import __version__
from clsco.files.atomic import refuse, sha256
from clsco.optics.motion import Eye
from clsco.scene.file import dump
from clsco.scene.model import BUILT_IN_TEXTURES, DepthMap, Scene, Within

# What parameters derived from a scene, and the metadata of a frame, are measured in, where the name does not say it.
DERIVED_UNITS = {"derived.aperture_diameter": "mm", "derived.sensor_distance": "mm"}
FRAME_UNITS = {"intermediate[].time": "s", "seconds": "s, by pass on the device"}


def _views(scene: Scene) -> tuple[Eye, ...]:
    return ("left",) if scene.stereo is None else ("left", "right")


def units(scene: Scene) -> dict[str, str]:
    """Unit of every parameter that has one: {"camera.focal_length": "mm", "object[0].radius": "mm", ...}."""
    sections = [(name, getattr(scene, name)) for name in type(scene).model_fields if name != "objects"]
    sections += [(f"object[{index}]", item) for index, item in enumerate(scene.objects)]
    found: dict[str, str] = {}
    while sections:
        place, model = sections.pop(0)
        for name, field in getattr(type(model), "model_fields", {}).items():
            key = f"{place}.{name}"
            sections.append((key, getattr(model, name)))
            if unit := _unit((field.annotation, *field.metadata)):
                found[key] = unit
    return found


def _record_units(scene: Scene) -> dict[str, str]:
    """Units of what a frame's JSON file has besides the scene's parameters; of a stereo pair those of each view."""
    views = [""] if scene.stereo is None else [f"views.{view}." for view in _views(scene)]
    return DERIVED_UNITS | {view + key: unit for view in views for key, unit in FRAME_UNITS.items()}


def _unit(parts: Iterable[Any]) -> str:
    """Unit of the first constraint that names one, however deep in the types it is."""
    for part in parts:
        if unit := part.unit if isinstance(part, Within) else _unit(get_args(part)):
            return unit
    return ""


def file_digests(scenes: Iterable[Scene]) -> dict[str, str]:
    """SHA-256 by path of all textures and depths that are files. Raises ImageError where one cannot be read."""
    items = [item for scene in scenes for item in scene.objects]
    paths = [item.texture for item in items if item.texture not in BUILT_IN_TEXTURES]
    paths += [item.depth for item in items if isinstance(item, DepthMap)]
    return {path: _digest(path) for path in dict.fromkeys(paths)}


def _digest(path: str) -> str:
    try:
        return sha256(Path(path))
    except OSError as error:
        refuse(Path(path), "must be a file that can be read", error, error)


def scene_sha256(scene: Scene, digests: Mapping[str, str] | None = None) -> str:
    """SHA-256 of what decides the image: all parameters, and the content of texture and depth files, not their paths.

    scene: with its resolution. digests: what `file_digests` gives, where that is known. Raises ImageError where a file
    cannot be read.
    """
    known = file_digests([scene]) if digests is None else digests
    content = dump(scene)
    for item in content["object"]:
        for key in ("texture", "depth"):
            if key in item:
                item[key] = known.get(item[key], item[key])
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def record(scene: Scene, digests: Mapping[str, str] | None = None) -> dict[str, Any]:
    """What the JSON file of a frame says of its scene, besides what the rendering adds.

    scene: with its resolution. digests: as in `scene_sha256`. Returns the parameters as a scene file has them, those
    derived from them in mm, the units, the hashes and the version. Raises ImageError where a file cannot be read.
    """
    camera = scene.camera
    known = file_digests([scene]) if digests is None else digests
    textures = [item.texture for item in scene.objects]
    depths = [item.depth for item in scene.objects if isinstance(item, DepthMap)]
    return {
        "version": __version__,
        "scene_sha256": scene_sha256(scene, known),
        "scene": dump(scene),
        "derived": {
            "aperture_diameter": camera.aperture_diameter,
            "sensor_distance": camera.sensor_distance,
        },
        "textures_sha256": {name: known[name] for name in textures if name not in BUILT_IN_TEXTURES},
        "depths_sha256": {name: known[name] for name in depths},
        "units": units(scene) | _record_units(scene),
    }
