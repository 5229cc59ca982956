"""Writer of scenes as TOML text; reading the text gives an equal scene."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from typing import Any

from clsco.scene.file import MAX_DOTS


def toml_text(table: Mapping[str, Any]) -> str:
    """Text in TOML of nested tables, with values before tables; `tomllib.loads` gives an equal mapping."""
    return "\n\n".join(part for part in _parts(table, "", "") if part) + "\n"


def _parts(table: Mapping[str, Any], name: str, header: str) -> list[str]:
    """Lines of a table under its header, then those of each nested table."""
    values = [f"{_key(key)} = {_value(value)}" for key, value in table.items() if not _is_table(value)]
    parts = ["\n".join(([header] if header else []) + values)]
    for key, value in table.items():
        inner = f"{name}.{_key(key)}" if name else _key(key)
        if isinstance(value, Mapping):
            parts += _parts(value, inner, f"[{inner}]")
        elif _is_table(value):
            for item in value:
                parts += _parts(item, inner, f"[[{inner}]]")
    return parts


def _is_table(value: Any) -> bool:
    """True if a value is a table, or a list of tables."""
    listed = isinstance(value, list) and value != [] and all(isinstance(v, Mapping) for v in value)
    return isinstance(value, Mapping) or listed


def _key(key: str) -> str:
    return key if re.fullmatch(r"[A-Za-z0-9_-]+", key) else _text(key)


def _text(text: str) -> str:
    """A quoted text with escapes for invisible characters; JSON's escapes are valid in TOML."""
    quoted = json.dumps(text, ensure_ascii=False)
    escaped = (c if c.isprintable() else f"\\U{ord(c):08x}" for c in quoted)
    return quoted if quoted.isprintable() else "".join(escaped)


def _value(value: Any) -> str:
    if isinstance(value, list):
        return f"[{', '.join(map(_value, value))}]"
    if isinstance(value, Mapping):  # in a list with other values
        return f"{{ {', '.join(f'{_key(key)} = {_value(entry)}' for key, entry in value.items())} }}"
    if isinstance(value, str):
        text = _text(value)
        return text.replace(".", "\\u002e") if value.count(".") > MAX_DOTS // 2 else text
    return json.dumps(value) if isinstance(value, bool) else repr(value)
