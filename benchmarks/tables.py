"""Figures of a benchmark as a Markdown table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

Figures = Mapping[str, float | str]


def write_table(path: Path, heading: str, rows: Sequence[Figures]) -> None:
    """Write rows with the same keys, or some of the first one's, to a file; its folder is made."""
    names = list(dict.fromkeys(name for row in rows for name in row))
    lines = [heading, "", f"| {' | '.join(names)} |", "|---" * len(names) + "|"]
    lines += [f"| {' | '.join(_text(row.get(name, '')) for name in names)} |" for row in rows]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(lines) + "\n", "utf-8")


def _text(value: float | str) -> str:
    return value if isinstance(value, str) else f"{value:.4g}"
