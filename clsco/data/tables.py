"""Reader of distribution files: joins their tables with the tables of their base."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from clsco.data.folder import Folder, RefusedError
from clsco.data.forms import is_form
from clsco.errors import SceneError
from clsco.scene.changes import displace, entry_at, key_parts, override
from clsco.scene.file import read_mapping
from clsco.scene.text import shown

OWN = ("base", "vary", "accept", "derive", "check")
MAX_BASES = 8
EVERY = 1000  # by default, one of this many samples is compared with rays
MAX_DEPTH = 12  # largest number of nested tables and lists


@dataclass(frozen=True)
class DistributionTables:
    """Tables of a distribution file, joined with the tables of its base."""

    scene: dict[str, Any]
    vary: dict[str, Any]
    accept: Any
    derive: Any
    check: dict[str, int]  # `every`: one of this many samples has its first frame compared with rays; {} for none
    is_joined: bool = False  # True if the file has a base

    def content(self) -> dict[str, Any]:
        """Content of a single file, without a base, that gives the same samples."""
        own = {"vary": self.vary, "accept": self.accept, "derive": self.derive, "check": self.check}
        return self.scene | {name: table for name, table in own.items() if table}


def read_tables(
    where: str, overrides: Sequence[str], folder: Folder, content: Mapping[str, Any] | None = None
) -> DistributionTables:
    """Read a distribution file, or its `content`; join it with its bases, and apply overrides. Raises SceneError."""
    rule = f"{where}: must hold tables, lists, numbers and texts"
    data = read_mapping(where, ()) if content is None else as_json(content, rule, _of_json)
    is_joined = "base" in data
    data = _with_base(data, where, where, folder, [])
    if deep := [key for key, value in data.items() if _is_deeper(value, MAX_DEPTH - 1)]:
        raise SceneError(f"{where}: {deep[0][:64]}: tables and lists must be at most {MAX_DEPTH} in each other")
    override(data, overrides, where)
    vary = data.pop("vary", {})
    accept, derive = data.pop("accept", {}), data.pop("derive", {})
    if not isinstance(vary, dict):
        raise SceneError(f"{where}: vary: must be a table; got {shown(vary)}")
    if (check := data.pop("check", None)) is not None:
        every = check.get("every", EVERY) if isinstance(check, dict) and check.keys() <= {"every"} else None
        if type(every) is not int or every < 1:
            rule = "must be a table with every, a whole number from 1 on"
            raise SceneError(f"{where}: check: {rule}; got {shown(check)}")
        check = {"every": every}
    for text in overrides:
        parts = key_parts(text.partition("=")[0].strip())
        if parts[0] not in OWN:
            _unvaried(vary, parts, data)
    return DistributionTables(data, vary, accept, derive, check or {}, is_joined)


def _with_base(data: dict[str, Any], path: str, where: str, folder: Folder, names: list[str]) -> dict[str, Any]:
    """Content of a file joined with its base, recursively; names: files that have this file as a base."""
    if "base" not in data:
        return data
    name = data.pop("base")
    try:
        path_of_base = folder.inside(name)
        if Path(name).name != name:
            raise RefusedError("must be a file in the same folder")
        if path_of_base.name in names or path_of_base == Path(where).resolve():
            raise RefusedError("must not lead back to a file that it is a base of")
        if len(names) == MAX_BASES:
            raise RefusedError(f"must be at most {MAX_BASES} files one after the other")
    except RefusedError as error:
        raise SceneError(error.message(f"{path}: base", name)) from None
    base = str(folder.path / name)
    return joined(_with_base(read_mapping(base, ()), base, where, folder, [*names, path_of_base.name]), data)


def as_json(content: Any, rule: str, default: Callable[[Any], Any], **options: bool) -> dict[str, Any]:
    """A mapping in types that JSON has; default, options: as for `json.dumps`. Raises SceneError, which begins so."""
    try:
        return dict(json.loads(json.dumps(dict(content), default=default, **options)))  # type: ignore[arg-type]
    except (TypeError, ValueError, RecursionError) as error:
        raise SceneError(f"{rule}; got {error}") from error


def _of_json(value: Any) -> Any:
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, Mapping):
        return dict(value)
    return os.fspath(value)


def joined(base: dict[str, Any], data: dict[str, Any]) -> dict[str, Any]:
    """Join the content of a file with its base: tables are merged key by key, other values replace those of the base.

    A table that is one value, such as a distribution or a range, is replaced as a whole. A key also removes keys of the
    base that contradict it, as f_number removes aperture_diameter.
    """
    remaining = dict(base)
    for section, value in data.items():
        if section in ("vary", "accept", "derive") or not isinstance(value, dict):
            continue
        for key in value:
            displace(remaining, f"{section}.{key}", value[key])
    return _merged(remaining, data)


def _merged(base: Mapping[str, Any], data: Mapping[str, Any]) -> dict[str, Any]:
    merged = {key: dict(value) if isinstance(value, dict) else value for key, value in base.items()}
    for key, value in data.items():
        old = merged.get(key)
        join = isinstance(old, dict) and isinstance(value, dict) and not (_is_value(old) or _is_value(value))
        merged[key] = _merged(old or {}, value) if join else value
    return merged


def _is_value(table: Any) -> bool:
    return is_form(table) or "from" in table


def _is_deeper(value: Any, most: int) -> bool:
    """True if a value has more than `most` levels of nested tables and lists."""
    inner = list(value.values()) if isinstance(value, Mapping) else value if isinstance(value, list) else []
    return bool(inner) and (most == 0 or any(_is_deeper(part, most - 1) for part in inner))


def _unvaried(vary: dict[str, Any], parts: list[str], scene: Mapping[str, Any]) -> None:
    """Remove the distribution of a key that an override has set, and distributions of keys that contradict it."""
    displace(vary, ".".join(parts), entry_at(scene, parts))
    node: Any = vary
    if parts[0] in ("object", "group") and len(parts) > 1:
        entries = vary.get(parts[0])
        listed = [entry for entry in entries if isinstance(entry, dict)] if isinstance(entries, list) else []
        node = next((entry for entry in listed if str(entry.get("index")) == parts[1]), {})
        parts = parts[2:]
    for part in parts[:-1]:
        node = node.get(part) if isinstance(node, dict) and not is_form(node.get(part)) else None
    if isinstance(node, dict) and parts:
        node.pop(parts[-1], None)
