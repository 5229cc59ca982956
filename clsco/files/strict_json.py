"""Parser of untrusted JSON: rejects numbers that are not finite, and deep nesting."""

from __future__ import annotations

import json
import math
from typing import Any, NoReturn

MOST_DEEP = 64


def strict_json(content: bytes | str) -> Any:
    """Parse JSON. Raises ValueError for invalid JSON, NaN, infinity, and more than `MOST_DEEP` levels."""
    try:
        value = json.loads(content, parse_constant=_refuse_number, parse_float=_finite)
    except RecursionError:
        raise ValueError("nested too deeply") from None
    text = content if isinstance(content, bytes) else content.encode(errors="replace")
    if text.count(b"[") + text.count(b"{") > MOST_DEEP and _is_deep(value):  # counting is fast, and rules out most
        raise ValueError("nested too deeply")
    if b"\\ud" in text or b"\\uD" in text:  # an escape of half a character: UnicodeEncodeError, which is a ValueError
        json.dumps(value, ensure_ascii=False).encode()
    return value


def _refuse_number(text: str) -> NoReturn:
    raise ValueError(f"{text}, which is no number in JSON")


def _finite(text: str) -> float:
    value = float(text)
    return value if math.isfinite(value) else _refuse_number(text[:20])


def _is_deep(value: Any) -> bool:
    level = [value]
    for _ in range(MOST_DEEP):
        holders = [item for item in level if isinstance(item, (dict, list))]
        level = [inner for item in holders for inner in (item.values() if isinstance(item, dict) else item)]
        if not level:
            return False
    return True
