"""Generator of `clsco/scene/schema.json`, the JSON Schema of scene files: `python -m tests.scene.schema_file`.

The file is shipped, as generating it takes five times as long as a command needs to start.
"""

from __future__ import annotations

import ast
import json
import sys
from functools import cache
from inspect import cleandoc, getsource
from itertools import pairwise
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from clsco.scene.changes import MAX_VARIANTS, VARIANT
from clsco.scene.faults import tables
from clsco.scene.file import MAX_OUTPUTS, SECTIONS, SWEEPABLE, holds_tables
from clsco.scene.model import CameraMotion, ObjectMotion, Scene
from clsco.scene.shapes import SHAPES
from clsco.scene.sweep import DIOPTERS

_END = {"anyOf": [{"type": "number"}, {"type": "array", "items": {"type": "number"}}]}
_RANGE_SCHEMA = {
    "title": "Range",
    "description": "Values at equal distances, both ends among them; one output each.",
    "type": "object",
    "properties": {
        "from": {"description": "First value.", **_END},
        "to": {"description": "Last value.", **_END},
        "steps": {"description": "Number of values.", "type": "integer", "minimum": 2, "maximum": MAX_OUTPUTS},
        "spacing": {"description": "Equal steps of 1 / value instead of the value.", "const": DIOPTERS},
    },
    "required": ["from", "to", "steps"],
    "additionalProperties": False,
}
_VARIANTS_SCHEMA = {
    "title": "Variants",
    "description": "Scenes of one file: keys of each that differ from the rest of the file.",
    "type": "array",
    "items": {"type": "object"},
    "minItems": 1,
    "maxItems": MAX_VARIANTS,
}


def generate_schema() -> dict[str, Any]:
    """Generate the schema; units stand in the descriptions, and keys that may be swept also take several values."""
    schema = Scene.model_json_schema(by_alias=True)
    definitions = schema["$defs"]
    for model in {model for _, model in tables(Scene)}:
        _describe(schema if model is Scene else definitions[model.__name__], model)
    for shape in SHAPES.values():
        definition = definitions[shape.__name__]
        definition["required"] = ["shape", *definition.get("required", [])]
    swept: list[type[BaseModel]] = [CameraMotion, ObjectMotion, *(SECTIONS[name] for name in SWEEPABLE)]
    for model in swept:
        for key, entry in definitions[model.__name__]["properties"].items():
            annotation = model.model_fields[key].annotation
            if not holds_tables(annotation):
                about = {name: entry.pop(name) for name in ("title", "description", "default") if name in entry}
                several = {"type": "array", "items": entry, "minItems": 1, "description": "All of them in turn."}
                choice = {"anyOf": [entry, several, {"$ref": "#/$defs/Range"}]}
                definitions[model.__name__]["properties"][key] = about | choice
    definitions["Range"] = _RANGE_SCHEMA
    schema["properties"][VARIANT] = _VARIANTS_SCHEMA
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema, "required": ["object"]}


@cache
def _classes(module: str) -> dict[str, ast.ClassDef]:
    """The classes of a module in its source, which is parsed once: `inspect` parses it for each of its classes."""
    return {
        node.name: node for node in ast.parse(getsource(sys.modules[module])).body if isinstance(node, ast.ClassDef)
    }


def _describe(definition: dict[str, Any], model: type[BaseModel]) -> None:
    """Give the properties of a schema what stands below the fields of its model.

    pydantic would read the source at every start of a process (`use_attribute_docstrings`), which takes 25 ms.
    """
    for kind in reversed([kind for kind in model.__mro__ if issubclass(kind, BaseModel) and kind is not BaseModel]):
        if all(field.description for field in kind.model_fields.values()):  # as of one that has no source
            continue
        for field, text in pairwise(_classes(kind.__module__)[kind.__name__].body):
            if not (isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name)):
                continue
            name = field.target.id
            known = model.model_fields.get(name)
            if known and isinstance(text, ast.Expr) and isinstance(text.value, ast.Constant):
                key = str(known.validation_alias or known.alias or name)
                definition["properties"][key]["description"] = cleandoc(str(text.value.value))


if __name__ == "__main__":
    file = Path(__file__).parents[2] / "clsco/scene/schema.json"
    file.write_text(json.dumps(generate_schema(), indent=1) + "\n", "utf-8")
