"""Scenes of the studio as files, as links, and saved for recovery."""

from __future__ import annotations

import base64
import difflib
import hashlib
import json
import os
import re
import tomllib
import zlib
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from itertools import takewhile
from pathlib import Path
from typing import Any

from clsco.errors import ClscoError, SceneError
from clsco.files.atomic import atomic_write_bytes
from clsco.resources import open_regular, read_regular
from clsco.scene.file import named_files, read_mapping, relocated
from clsco.scene.quantities import Location
from clsco.scene.shapes import SHAPES
from clsco.scene.text import key_name
from clsco.scene.toml import toml_text
from clsco.studio.tables import Table, at, sparse

LARGEST = 2**20  # bytes of a scene file, or of a link's content
LARGEST_IMAGE = 2**30  # bytes of a file for which a digest is computed
MOST_FILES = 512  # files that a link may name; 64 objects have at most 7 each
START = "#s="
Linked = tuple[Table, dict[str, tuple[Any, str]]]
"""Scene of a link, and its missing images; see `from_link`."""


class ConflictError(ClscoError):
    """A file on the disk has other content than the session last read from it or wrote to it."""


def digest_of(path: Path) -> str:
    """SHA-256 of a scene or an image, hexadecimal; "" if the file is missing, or larger than 1 GiB."""
    try:
        with open_regular(path, LARGEST_IMAGE, follow=True) as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except (OSError, ValueError):
        return ""


def scene_text(table: Mapping[str, Any], path: Path, old: Path | None) -> str:
    """Text of a scene file, .toml or .json, with the keys that differ from their defaults.

    old: the scene's previous file, whose comments, order, and keys equal to their defaults are kept.
    """
    if path.suffix.lower() == ".json":
        try:
            content = read_mapping(str(old), ()) if old is not None else {}
        except SceneError:  # the old file is missing or no longer valid
            content = {}
        return json.dumps(_kept(sparse(table), table, content), indent=2, ensure_ascii=False) + "\n"
    if old is None or old.suffix.lower() != ".toml":
        return toml_text(sparse(table))
    import tomlkit
    from tomlkit.exceptions import TOMLKitError

    try:
        before = read_regular(old, LARGEST, follow=True).decode("utf-8-sig")
        wanted = _kept(sparse(table), table, tomllib.loads(before))
        document = tomlkit.parse(_arranged(before, wanted))
        _update(document, wanted)
        text = tomlkit.dumps(document)
        if tomllib.loads(text) == wanted:
            return text
    except (OSError, ValueError, TOMLKitError):  # the old file is missing or no longer valid
        pass
    return toml_text(sparse(table))


def _kept(fewer: Any, table: Any, old: Any) -> Any:
    """The table without keys that are neither in `fewer`, its sparse form, nor in `old`, its form in the old file."""
    if not isinstance(table, Mapping):
        return table
    found = {}
    for key, value in table.items():
        before = old.get(key) if isinstance(old, Mapping) else None
        if isinstance(value, Mapping) and (key in fewer or isinstance(before, Mapping)):
            if part := _kept(fewer.get(key, {}), value, before):
                found[key] = part
        elif isinstance(value, list) and value and isinstance(value[0], Mapping):
            listed = before if isinstance(before, list) else []
            less = fewer.get(key, value)
            found[key] = [
                _kept(less[k], item, _twin(item, k, listed)) if len(less) == len(value) else item
                for k, item in enumerate(value)
            ]
        elif key in fewer or before is not None:
            found[key] = value
    return found


def _twin(item: Mapping[str, Any], index: int, listed: list[Any]) -> Any:
    """The table of the old file that corresponds to `item`, the scene's table at `index`; None if there is none.

    listed: tables of the old file. An equal table is preferred, then one with the same name, then the one at `index`.
    """
    others = [other for other in listed if isinstance(other, Mapping)]
    same = [other for other in others if other == item]
    same = [other for k, other in enumerate(listed) if k == index and other in same] or same
    same += [other for other in others if "name" in item and other.get("name") == item["name"]]
    if same:
        return same[0]
    return listed[index] if index < len(listed) else None


def _arranged(text: str, table: Table) -> str:
    """The text of a scene file with objects and groups added, removed and reordered as in `table`."""
    content = tomllib.loads(text)
    for key in ("object", "group"):
        listed, wanted = content.get(key, []), table.get(key, [])
        unused: list[Any] = list(listed)
        order: list[int | None] = []
        for index, item in enumerate(wanted):
            twin = _twin(item, index, unused)
            order.append(next((k for k, other in enumerate(unused) if other is twin), None) if twin else None)
            if order[-1] is not None:
                unused[order[-1]] = None
        new = ["" if number is not None else toml_text({key: [wanted[k]]}) for k, number in enumerate(order)]
        text = arranged(text, key, order, new)
    return text


def _update(document: Any, table: Mapping[str, Any]) -> None:
    """Replace the content of a tomlkit table; comments stay with their keys."""
    for key in [key for key in document if key not in table]:
        del document[key]
    for key, value in table.items():
        before = document.get(key)
        if isinstance(value, Mapping) and isinstance(before, Mapping):
            _update(before, value)
        elif _is_array(before) and _is_array(value) and len(before) == len(value):
            for part, item in zip(before, value, strict=True):
                _update(part, item)
        elif before is None:
            _append(document, key, value)
        elif not _same(before, value):
            document[key] = value


def _is_array(value: Any) -> bool:
    return isinstance(value, list) and bool(value) and all(isinstance(item, Mapping) for item in value)


def _append(document: Any, key: str, value: Any) -> None:
    """Add a key after the other keys of a tomlkit table, before trailing comments, which describe the next table."""
    body = getattr(getattr(document, "value", None), "body", [])  # [] for the document as a whole
    last: list[Any] = []
    while len(body) > 1 and body[-1][0] is None:
        last.insert(0, body.pop())
    document[key] = value
    body.extend(last)


def _same(before: Any, value: Any) -> bool:
    """True if a value of tomlkit equals a scene's and has the same type."""
    plain = before.unwrap() if hasattr(before, "unwrap") else before
    return bool(plain == value) and repr(plain) == repr(value)


def difference(path: Path, text: str) -> str:
    """Changes from a file to a text, as a unified diff."""
    try:
        before = read_regular(path, LARGEST, follow=True).decode("utf-8-sig", "replace").splitlines()
    except OSError:  # no file, or one that cannot be a scene
        before = []
    return "\n".join(difflib.unified_diff(before, text.splitlines(), "on the disk", "in the studio", lineterm=""))


def moved(table: Table, start: Path, to: Path) -> Table:
    """The table with file names that are relative to the folder `to` instead of `start`; absolute names stay."""
    if start == to:
        return table

    def other(_: Location, name: str) -> str:
        return name if Path(name).is_absolute() else Path(os.path.relpath(start / name, to)).as_posix()

    return relocated(table, other)


def link_of(table: Table, start: Path, root: Path) -> str:
    """A scene as a URL fragment. File names are relative to `start` in the scene, and to `root` in the fragment.

    The fragment is "#s=" and URL-safe base64 of deflated JSON, which has the keys that differ from their defaults, and
    the SHA-256 of each file. Files outside the root keep only their names.
    """
    files: dict[str, str] = {}
    digest = cache(digest_of)

    def shared(_: Location, name: str) -> str:
        path = (start / name).resolve()
        short = path.relative_to(root).as_posix() if path.is_relative_to(root) else path.name
        files[short] = digest(path)
        return short

    few = relocated(sparse(table), shared)
    content: Table = few | ({"files": files} if files else {})
    text = json.dumps(content, separators=(",", ":"), ensure_ascii=False).encode()
    pressed = zlib.compressobj(9, zlib.DEFLATED, -15)
    return START + base64.urlsafe_b64encode(pressed.compress(text) + pressed.flush()).decode().rstrip("=")


def from_link(text: str, places: Iterable[Path]) -> Linked:
    """The scene of a link from `link_of`, with or without "#s=".

    places: folders where files are searched: by path in the first one, the studio's folder, and by name in all others.
    Each file is hashed once. Files may be large, so call this in a thread.

    Returns the scene's table, which is not validated, and the missing images: name and message by path of the key. In
    the table, the default replaces a missing image.

    Raises SceneError if the text is not a link, holds more than 1 MiB, names more than MOST_FILES files or an absolute
    path, or needs a depth map or an image of the aperture that is missing.
    """
    content = _unpacked(text.strip().rpartition(START)[2])
    digests = content.pop("files", {})
    missing: dict[str, tuple[Any, str]] = {}
    first, *others = places
    named = list(named_files(content))
    if len(named) > MOST_FILES:
        raise SceneError(f"link: must name at most {MOST_FILES} files; got {len(named)}")
    digest = cache(digest_of)

    @cache
    def files() -> dict[str, list[Path]]:
        """Files of all folders but the first, by name."""
        by_name = defaultdict[str, list[Path]](list)
        for path in (path for folder in others for path in folder.rglob("*")):
            by_name[path.name].append(path)
        return by_name

    for place, name in named:
        stated = digests.get(name) if isinstance(digests, Mapping) else None
        if Path(name).is_absolute():
            raise SceneError(f"scene: {key_name(place)}: must not be an absolute path in a link")
        parts = [str(part) for part in place]
        item, key = at(content, parts[:-1]), parts[-1]
        if stated and digest(first / name) == stated:
            continue
        if stated and (same := [path for path in files()[Path(name).name] if digest(path) == stated]):
            item[key] = str(same[0])
            continue
        rule = f"needs the file {Path(name).name} (SHA-256 {str(stated)[:12]}...), which is not there: choose it"
        if key in ("depth", "image"):
            raise SceneError(f"scene: {key_name(place)}: {rule}")
        missing[".".join(parts)] = name, rule
        if key == "texture":
            item[key] = SHAPES["plane"].model_fields["texture"].default
            item.pop("texture_layer", None)
        else:
            del item[key]
    return content, missing


def _unpacked(text: str) -> Table:
    try:
        if len(text) > 2 * LARGEST:
            raise SceneError("link: must hold at most 1 MiB")
        pressed = base64.b64decode(text + "=" * (-len(text) % 4), altchars=b"-_", validate=True)
        opened = zlib.decompressobj(-15)
        content = opened.decompress(pressed, LARGEST + 1)
        if len(content) > LARGEST:
            raise SceneError("link: must hold at most 1 MiB")
        if not opened.eof:
            raise SceneError("link: must be whole; got a part of it")
        table = json.loads(content)
    except (ValueError, zlib.error, RecursionError):
        raise SceneError("link: must be one that the studio made") from None
    if not isinstance(table, dict):
        raise SceneError("link: must hold a scene")
    return table


def keep(table: Table, start: Path, path: Path) -> None:
    """Save a scene for recovery, atomically. Raises FileError."""
    content = {"folder": str(start), "scene": table}
    atomic_write_bytes(path, json.dumps(content, ensure_ascii=False).encode())


def read_kept(path: Path) -> tuple[Table, Path]:
    """A scene saved for recovery, and the base folder of its file names. Raises SceneError."""
    try:
        content = json.loads(read_regular(path, 2 * LARGEST))
        table, start = content["scene"], Path(content["folder"])
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        raise SceneError(f"{path.name}: must be what the studio kept") from None
    return table, start


_HEADER = re.compile(r"\s*(\[\[?)\s*([A-Za-z0-9_-]+)")


def arranged(text: str, key: str, order: Sequence[int | None], new: Sequence[str]) -> str:
    """Rearrange the tables of an array in valid TOML; sub-tables, and comments above a table, move with the table.

    order: for each table of the result, its number in the text, counted from 0; None for a new table, whose text is at
    the same index in `new`. All tables are put where the last one was. A line inside a string may be mistaken for a
    header, so compare the parsed content afterwards.
    """
    parts = _parts(text.splitlines(), key)
    slots = [number for number, (is_table, _) in enumerate(parts) if is_table]
    if not slots or (list(order) == list(range(len(slots))) and slots[-1] - slots[0] == len(slots) - 1):
        return text
    old = [_trimmed(parts[slot][1]) for slot in slots]
    between = max(1, len(parts[slots[0]][1]) - len(old[0]))  # blank lines
    found: list[str] = []
    for number, (is_table, lines) in enumerate(parts):
        if not is_table:
            found += lines
        elif number == slots[-1]:
            for place, table in enumerate(order):
                found += new[place].strip("\n").splitlines() if table is None else old[table]
                found += [""] * between
    return "\n".join(_trimmed(found)) + "\n"


def _parts(lines: Sequence[str], key: str) -> list[tuple[bool, list[str]]]:
    """Lines of the text, split into tables of the array (True) and other parts (False)."""
    parts: list[tuple[bool, list[str]]] = [(False, [])]
    for line in lines:
        header = _HEADER.match(line)
        if header is not None and (header[1] == "[[" or header[2] != key or not parts[-1][0]):
            begins = header[1] == "[[" and header[2] == key
            if begins or parts[-1][0]:
                before = parts[-1][1]
                above = len(list(takewhile(lambda each: each.lstrip().startswith("#"), reversed(before))))
                start = len(before) - above
                parts.append((begins, before[start:]))
                del before[start:]
        parts[-1][1].append(line)
    return parts


def _trimmed(lines: list[str]) -> list[str]:
    end = len(lines)
    while end and not lines[end - 1].strip():
        end -= 1
    return lines[:end]
