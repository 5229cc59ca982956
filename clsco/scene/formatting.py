"""Formatting of amounts for people; the module has no imports, because `--help` loads it."""

from __future__ import annotations


def format_bytes(count: float) -> str:
    """Format a number of bytes: "512 B", "1.5 GiB"."""
    for unit in ("B", "KiB", "MiB", "GiB", "TiB"):
        if count < 1024.0 or unit == "TiB":
            break
        count /= 1024.0
    return f"{count:.0f} {unit}" if unit == "B" else f"{count:.1f} {unit}"


def format_seconds(seconds: float) -> str:
    """Format a time: "0.35 s", "42 s", "3 min", "2.5 h"."""
    if seconds < 100.0:
        return f"{seconds:.2g} s" if seconds < 10.0 else f"{seconds:.0f} s"
    for unit, length in (("min", 60.0), ("h", 3600.0), ("d", 86400.0)):
        if seconds < 100.0 * length or unit == "d":
            break
    return f"{seconds / length:.0f} {unit}" if unit == "min" else f"{seconds / length:.1f} {unit}"
