"""Hook of mkdocs: what the pages link outside of docs/, such as results and examples, becomes a part of the site."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mkdocs.structure.files import File, InclusionLevel

if TYPE_CHECKING:
    from mkdocs.structure.files import Files

ROOT = Path(__file__).resolve().parents[1]
OUTSIDE = re.compile(r"\]\(\.\./([\w./-]+)")
BESIDE = re.compile(r"\]\(((?:\.\./)?[\w/-]+\.\w+)")  # what a page outside of docs/ links in turn
INSIDE = "repository"  # folder of the site for such files


def on_files(files: Files, config: Any) -> Files:
    """Add the files that pages link, and those that these link."""
    waiting = {name for page in files.documentation_pages() for name in OUTSIDE.findall(page.content_string)}
    while waiting:
        name = waiting.pop()
        path = ROOT / name
        file = File.generated(config, f"{INSIDE}/{name}", abs_src_path=str(path), inclusion=InclusionLevel.NOT_IN_NAV)
        files.append(file)
        if path.suffix == ".md":
            linked = [(path.parent / target).resolve() for target in BESIDE.findall(path.read_text("utf-8"))]
            inner = {each.relative_to(ROOT).as_posix() for each in linked if not each.is_relative_to(ROOT / "docs")}
            waiting |= {each for each in inner if files.get_file_from_path(f"{INSIDE}/{each}") is None}
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Lead links out of docs/ to their copies, and those of the copies into docs/ back."""
    if page.file.src_uri.startswith(f"{INSIDE}/"):
        up = "../" * page.file.src_uri.count("/")
        return re.sub(r"\]\((?:\.\./)*docs/", f"]({up}", markdown)
    return OUTSIDE.sub(rf"]({INSIDE}/\1", markdown)
