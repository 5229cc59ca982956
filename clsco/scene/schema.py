"""JSON Schema of scene files, for editors and other programs."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel

from clsco.scene.file import MAX_OUTPUTS, SECTIONS, SWEEPABLE
from clsco.scene.model import CameraMotion, ObjectMotion, Scene
from clsco.scene.shapes import SHAPES

_END = {"anyOf": [{"type": "number"}, {"type": "array", "items": {"type": "number"}}]}
_RANGE_SCHEMA = {
    "title": "Range",
    "description": "Values at equal distances, both ends among them; one output each.",
    "type": "object",
    "properties": {
        "from": {"description": "First value.", **_END},
        "to": {"description": "Last value.", **_END},
        "steps": {"description": "Number of values.", "type": "integer", "minimum": 2, "maximum": MAX_OUTPUTS},
    },
    "required": ["from", "to", "steps"],
    "additionalProperties": False,
}


def scene_schema() -> dict[str, Any]:
    """JSON Schema (draft 2020-12) of a scene file.

    Returns
    -------
    dict
        Units stand in the descriptions. Keys that may be swept also take a list or a range of values.
    """
    schema = Scene.model_json_schema(by_alias=True)
    definitions = schema["$defs"]
    for shape in SHAPES.values():
        definition = definitions[shape.__name__]
        definition["required"] = ["shape", *definition.get("required", [])]
    swept: list[type[BaseModel]] = [CameraMotion, ObjectMotion, *(SECTIONS[name] for name in SWEEPABLE)]
    for model in swept:
        for key, entry in definitions[model.__name__]["properties"].items():
            annotation = model.model_fields[key].annotation
            if not (isinstance(annotation, type) and issubclass(annotation, BaseModel)):
                about = {name: entry.pop(name) for name in ("title", "description", "default") if name in entry}
                several = {"type": "array", "items": entry, "minItems": 1, "description": "All of them in turn."}
                choice = {"anyOf": [entry, several, {"$ref": "#/$defs/Range"}]}
                definitions[model.__name__]["properties"][key] = about | choice
    definitions["Range"] = _RANGE_SCHEMA
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema, "required": ["object"]}
