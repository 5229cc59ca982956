"""Scenes as text in TOML, which is read back to equal scenes."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from clsco.scene.file import MAX_DOTS


def toml_text(table: Mapping[str, Any]) -> str:
    """Text in TOML of nested tables.

    Parameters
    ----------
    table : mapping
        Content of a scene file: text, numbers, booleans, lists of them, tables, and lists of tables.

    Returns
    -------
    str
        Values of a table before the tables in it; `tomllib.loads` gives an equal mapping.
    """
    return "\n\n".join(part for part in _parts(table, "", "") if part) + "\n"


def _parts(table: Mapping[str, Any], name: str, header: str) -> list[str]:
    """A table under its header, then each table in it."""
    values = [f"{key} = {_value(value)}" for key, value in table.items() if not _is_table(value)]
    found = ["\n".join(([header] if header else []) + values)]
    for key, value in table.items():
        inner = f"{name}.{key}" if name else key
        if isinstance(value, Mapping):
            found += _parts(value, inner, f"[{inner}]")
        elif _is_table(value):
            for item in value:
                found += _parts(item, inner, f"[[{inner}]]")
    return found


def _is_table(value: Any) -> bool:
    """Whether a value is a table, or a list of tables."""
    return isinstance(value, Mapping) or (isinstance(value, list) and any(isinstance(v, Mapping) for v in value))


def _value(value: Any) -> str:
    if isinstance(value, list):
        return f"[{', '.join(map(_value, value))}]"
    if isinstance(value, str):
        text = json.dumps(value, ensure_ascii=False)  # the escapes of JSON are among those of TOML
        return text.replace(".", "\\u002e") if value.count(".") > MAX_DOTS // 2 else text
    return json.dumps(value) if isinstance(value, bool) else repr(value)
