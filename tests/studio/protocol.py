"""The module of the page that opens what the socket brings: python -m tests.studio.protocol writes it anew."""

from __future__ import annotations

import json
import struct
from pathlib import Path

from clsco.studio import pictures

MODULE = Path(pictures.__file__).parent / "static/protocol.js"
RUNGS = ("DRAGGING", "LOSSY", "EXACT", "PINNED", "STACKED", "OUTLINED")
ENCODINGS = ("MESSAGE", "JPEG", "PNG", "FLOAT32")
READERS = {"B": "getUint8({})", "H": "getUint16({}, true)", "I": "getUint32({}, true)"}


def numbers(names: tuple[str, ...]) -> str:
    return "{ " + ", ".join(f"{name}: {getattr(pictures, name)}" for name in names) + " }"


def protocol() -> str:
    """Text of the module, from the constants and the layout of `clsco.studio.pictures`."""
    order, kinds = pictures.HEADER.format[0], pictures.HEADER.format[1:]
    reads = [
        f"    {name}: head.{READERS[kind].format(struct.calcsize(order + kinds[:at]))},"
        for at, (name, kind) in enumerate(zip(pictures.FIELDS, kinds, strict=True))
    ]
    lines = (
        "// What comes over the socket; made from clsco/studio/pictures.py by python -m tests.studio.protocol.",
        "",
        f"export const RUNG = {numbers(RUNGS)};",
        f"export const ENCODING = {numbers(ENCODINGS)};",
        f"export const VIEWS = {json.dumps(list(pictures.VIEWS))};",
        f"export const NO_NUMBER = {pictures.NO_NUMBER}; // of a picture of a moment, in place of a frame's",
        "",
        f"const HEAD = {pictures.HEADER.size}; // bytes before the payload",
        "",
        "const header = (buffer) => {",
        "  const head = new DataView(buffer, 0, HEAD);",
        "  return {",
        *reads,
        "  };",
        "};",
        "",
        "/** @param {ArrayBuffer} buffer */",
        "export const opened = (buffer) => {",
        "  const { view, columns, rows, flags, ...rest } = header(buffer);",
        "  const picture = {",
        "    ...rest, view: VIEWS[view], full: [columns, rows], right: Boolean(flags & 2), still: Boolean(flags & 1),",
        "  };",
        "  return { picture, payload: new Uint8Array(buffer, HEAD) };",
        "};",
    )
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    MODULE.write_text(protocol(), "utf-8")
