"""Parser of untrusted JSON: rejects numbers that are not finite, and deep nesting."""

from __future__ import annotations

import json
import math
from typing import Any

MOST_DEEP = 64


def strict_json(content: bytes | str) -> Any:
    """Parse JSON. Raises ValueError for invalid JSON, NaN, infinity, and more than `MOST_DEEP` levels."""
    try:
        value = json.loads(content, parse_constant=_finite, parse_float=_finite)
    except RecursionError:
        raise ValueError("nested too deeply") from None
    text = content if isinstance(content, bytes) else content.encode(errors="replace")
    if text.count(b"[") + text.count(b"{") > MOST_DEEP and _is_deep(value):  # counting is fast, and rules out most
        raise ValueError("nested too deeply")
    if b"\\ud" in text or b"\\uD" in text:  # an escape of half a character: UnicodeEncodeError, which is a ValueError
        json.dumps(value, ensure_ascii=False).encode()
    return value


def _finite(text: str) -> float:
    if not math.isfinite(value := float(text)):
        raise ValueError(f"{text[:20]}, which is no number in JSON")
    return value


def _is_deep(value: Any) -> bool:
    level = [value]
    for _ in range(MOST_DEEP):
        holders = [item for item in level if isinstance(item, (dict, list))]
        level = [inner for item in holders for inner in (item.values() if isinstance(item, dict) else item)]
        if not level:
            return False
    return True
