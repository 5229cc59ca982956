"""Formatting of scene keys and values for messages."""

from __future__ import annotations

import json
import re
import reprlib
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from clsco.scene.quantities import as_python

_SHORT = reprlib.Repr()
_SHORT.maxlevel, _SHORT.maxlist, _SHORT.maxtuple, _SHORT.maxdict, _SHORT.maxother = 3, 6, 6, 4, 60


def key_name(loc: Sequence[Any]) -> str:
    """Key as written in a file: object[0].motion.velocity[2]."""
    name = ""
    for part in loc:
        if isinstance(part, int):
            name += f"[{part}]"
        else:
            bare = re.fullmatch(r"[A-Za-z0-9_-]{1,64}", str(part)) is not None
            name += ("." if name else "") + (str(part) if bare else shown(str(part)))
    return name or "scene"


def meant(name: object, known: Iterable[str]) -> str:
    """Hint " (did you mean NAME?)" with the most similar known name, "" if none is similar."""
    from difflib import get_close_matches  # 2 ms, which only an error needs

    near = get_close_matches(str(name)[:64], list(known), n=1)
    return f" (did you mean {near[0]}?)" if near else ""


def shown(value: Any) -> str:
    """A value on one short line, as a scene file would write it where possible."""
    value = as_python(value)
    if isinstance(value, np.ndarray):
        return f"an array of {value.dtype} {value.shape}"
    if isinstance(value, str):
        return json.dumps(brief(value), ensure_ascii=not value.isprintable())
    if value is None or isinstance(value, bool):
        return json.dumps(value)
    if isinstance(value, int) and value.bit_length() > 128:
        return f"an integer of about {int(value.bit_length() * 0.30103) + 1} digits"
    if isinstance(value, list | tuple) and len(value) <= 10 and not any(isinstance(v, list | dict) for v in value):
        return f"[{', '.join(shown(entry) for entry in value)}]"
    if isinstance(value, dict):
        return f"a table of {len(value)} keys"
    if isinstance(value, list | tuple):
        return f"a list of {len(value)} entries"
    return " ".join(_SHORT.repr(value).split())


def any_of(words: Iterable[str]) -> str:
    """Words as "a, b or c"."""
    *others, last = words
    return " or ".join(filter(None, (", ".join(others), last)))


def brief(text: str, most: int = 60) -> str:
    """A text, shortened to a number of characters."""
    return text if len(text) <= most else text[: most - 3] + "..."
