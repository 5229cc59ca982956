"""JSON Schema of scene files, for editors and other programs; `tests/scene/schema_file.py` writes it."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

_FORMS_OF_VALUES = {"AxisAngle", "Range", "UnitQuaternion"}  # tables that stand for a single value


def scene_schema() -> dict[str, Any]:
    """Read the JSON Schema (draft 2020-12) of a scene file."""
    schema: dict[str, Any] = json.loads(Path(__file__).with_suffix(".json").read_text("utf-8"))
    return schema


def list_keys() -> list[str]:
    """List the keys of a scene in the form of `--set`: "camera.f_number", "object.0.radius"."""
    schema = scene_schema()

    def keys(properties: Mapping[str, Any], start: str) -> Iterator[str]:
        for key, entry in properties.items():
            models = dict.fromkeys(re.findall(r"#/\$defs/(\w+)", json.dumps(entry)))
            tables = [schema["$defs"][name]["properties"] for name in models if name not in _FORMS_OF_VALUES]
            is_array = any("items" in form for form in (entry, *entry.get("anyOf", ())))
            for table in tables:
                yield from keys(table, f"{start}{key}.0." if is_array else f"{start}{key}.")
            if not tables:
                yield start + key

    return list(dict.fromkeys(keys(schema["properties"], "")))
