"""What is told of a scene: its parameters with their units, its hash, and keys that it has no use for."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any, get_args

from clsco import __version__
from clsco.files import refuse, sha256
from clsco.images import read_image
from clsco.plan import Plan, make_plan
from clsco.scene import BUILT_IN_TEXTURES, Scene, Within
from clsco.scenefile import dump
from clsco.textures import texture_size

# What `Frame.metadata` and the parameters of a frame are measured in, where the name does not say it.
RECORD_UNITS = {
    "derived.aperture_diameter": "mm",
    "derived.sensor_distance": "mm",
    "intermediate[].time": "s",
    "seconds": "s, by pass on the device",
}


def planned(scene: Scene, truth: tuple[str, ...]) -> Plan:
    """The plan of a scene for the outputs `truth` besides color; reads its textures, and computes nothing.

    The plan's scene has its resolution, which the first texture gives where the scene does not. Raises
    SceneError and ImageError, as `clsco.plan.make_plan` and `clsco.images.read_image` do.
    """
    camera, texture = scene.camera, scene.objects[0].texture
    size = texture_size(texture)
    gray = texture in BUILT_IN_TEXTURES or read_image(texture).data.ndim == 2
    if camera.resolution is None:
        camera = camera.model_copy(update={"resolution": size})
    return make_plan(scene.model_copy(update={"camera": camera}), 1 if gray else 3, truth)


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


def _unit(parts: Iterable[Any]) -> str:
    """Unit of the first constraint that names one, however deep in the types it is."""
    for part in parts:
        if unit := part.unit if isinstance(part, Within) else _unit(get_args(part)):
            return unit
    return ""


def scene_sha256(scene: Scene) -> str:
    """SHA-256 of what decides the image: all parameters, and the content of texture files instead of paths.

    scene: with its resolution. Raises ImageError where a texture cannot be read.
    """
    content = dump(scene)
    for item in content["object"]:
        item["texture"] = _texture_digest(item["texture"])
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def _texture_digest(texture: str) -> str:
    if texture in BUILT_IN_TEXTURES:
        return texture
    try:
        return sha256(Path(texture))
    except OSError as error:
        refuse(Path(texture), "must be a file that can be read", error, error)


def record(scene: Scene) -> dict[str, Any]:
    """What the JSON file of a frame says of its scene, besides what the rendering adds.

    scene: with its resolution. Returns the parameters as a scene file has them, those derived from them in
    mm, the units, the hash and the version. Raises ImageError where a texture cannot be read.
    """
    camera, names = scene.camera, [item.texture for item in scene.objects]
    return {
        "version": __version__,
        "scene_sha256": scene_sha256(scene),
        "scene": dump(scene),
        "derived": {
            "aperture_diameter": camera.aperture_diameter,
            "sensor_distance": camera.sensor_distance,
        },
        "textures_sha256": {name: _texture_digest(name) for name in names if name not in BUILT_IN_TEXTURES},
        "units": units(scene) | RECORD_UNITS,
    }


def unused_keys(plan: Plan) -> list[tuple[str, str]]:
    """Keys that the scene gives although nothing depends on them, and why: (key, reason)."""
    scene, item = plan.scene, plan.scene.objects[0]
    reasons: dict[str, str] = {}

    def give(section: str, keys: Iterable[str], why: str) -> None:
        reasons.update({f"{section}.{key}": why for key in keys})

    if not plan.moves:
        give("sequence", ("samples", "sampling", "shutter"), "nothing moves")
        give("motion", type(scene.motion).model_fields, "nothing moves")
        give("fill", type(scene.fill).model_fields, "nothing moves")
    elif sum(map(bool, item.motion.angular_velocity)) < 2:
        give("motion", ("rotation",), "euler and axis differ only for turns about several axes")
    if plan.forward and scene.fill.method == "none":
        give("fill", ("domain",), "fill.method is none")
    if plan.blur == "none":
        keys = [key for key in type(scene.psf).model_fields if key != "silhouette_samples"]
        give("psf", keys, "everything is in focus")
    left_out = dict(plan.left_out)
    if not plan.tilt and scene.psf.tilt:
        give("psf", ("tilt",), left_out["tilt"])
    if not plan.silhouettes and scene.psf.silhouette_samples > 1:
        give("psf", ("silhouette_samples",), left_out["silhouettes"])
    give("psf", ("occlusion",), left_out["occlusion"])
    sections = (
        ("psf", scene.psf),
        ("sequence", scene.sequence),
        ("motion", scene.motion),
        ("fill", scene.fill),
    )
    given = [f"{place}.{key}" for place, model in sections for key in sorted(model.model_fields_set)]
    return [(key, reasons[key]) for key in given if key in reasons]
