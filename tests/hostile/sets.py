"""Data sets whose card, manifest or records hold anything, by a seed and a number, and all that reads them."""

from __future__ import annotations

import hashlib
import json
import random
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import clsco.data
from clsco.data.build import located
from clsco.data.convert import convert
from clsco.data.manifest import part_key
from clsco.data.sets import open_set, status_of
from clsco.data.storage import open_storage
from clsco.data.verify import scene_table, verify_files
from clsco.errors import ClscoError
from clsco.scene.toml import toml_text
from tests.data.samples import make_set
from tests.hostile.mutate import VALUE_CHANGES

FILES = ("dataset.json", part_key(0), "train/000000/000000001/meta.json")


def changed(seed: int, number: int, source: Path, target: Path) -> str:
    """Copy a set of `folders`, and change one of its files; says which."""
    rng = random.Random(f"{seed}:{number}")
    shutil.copytree(source, target)
    name = FILES[number % len(FILES)]
    path = target / name
    lines = [json.loads(line) for line in path.read_text().splitlines()] if name.endswith("l") else []
    chosen = rng.randrange(len(lines)) if lines else 0
    content = lines[chosen] if lines else json.loads(path.read_text())
    for _ in range(rng.choice((1, 1, 2))):
        if content:
            rng.choice(VALUE_CHANGES)(rng, content)
    if not lines:
        path.write_text(_json(content))
        return name
    lines[chosen] = content
    body = "".join(f"{_json(line)}\n" for line in lines[1:])
    if isinstance(lines[0], dict) and chosen:
        lines[0]["rows"] = hashlib.sha256(body.encode()).hexdigest()
    path.write_text(f"{_json(lines[0])}\n{body}")
    return name


def readers(folder: Path, spare: Path) -> dict[str, Callable[[], object]]:
    """All that reads a set, by name."""

    def records() -> object:
        return [record.sha256() for record in clsco.data.open(folder)]

    def verified() -> object:
        return verify_files(open_set(open_storage(folder)), lambda: None)

    def scene() -> object:
        return toml_text(located(scene_table(open_set(open_storage(folder)), 1), Path("/")))

    def converted() -> Any:
        shutil.rmtree(spare, ignore_errors=True)
        return convert(open_storage(folder), open_storage(spare), "npz", False, lambda count: lambda: None)

    return {
        "open": records, "status": lambda: status_of(open_set(open_storage(folder))), "verify": verified,
        "show": scene, "convert": converted,
    }  # fmt: skip


def faults(seed: int, numbers: range, folder: Path) -> tuple[list[str], int]:
    """What of changed sets ends in something else than a ClscoError of one line, and how many such errors there are."""
    make_set(folder / "whole", form="folders+raw")
    found, refused = [], 0
    for number in numbers:
        shutil.rmtree(folder / "set", ignore_errors=True)
        name = changed(seed, number, folder / "whole", folder / "set")
        for what, read in readers(folder / "set", folder / "spare").items():
            try:
                read()
            except ClscoError as error:
                refused += 1
                if not str(error).replace("\n", "").isprintable():
                    found.append(f"{number} {name} {what}: {ascii(str(error))[:200]}")
            except Exception as error:
                last = error.__traceback__
                while last is not None and last.tb_next is not None:
                    last = last.tb_next
                where = "" if last is None else f"{last.tb_frame.f_code.co_filename}:{last.tb_lineno}"
                found.append(f"{number} {name} {what}: {type(error).__name__}: {ascii(str(error))[:150]} {where}")
    return found, refused


def _json(value: Any) -> str:
    """JSON of a value; nested too deeply for that, as text."""
    try:
        return json.dumps(value, default=str)
    except (RecursionError, ValueError):
        return "[" * 3000 + "]" * 3000
