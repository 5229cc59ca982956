"""Data sets of strangers: python -m tests.hostile.sets --cases 1000 [--seed 1]

A card, a part of a manifest or what describes a record gets other values, and bytes of shards of every format are
damaged, by a seed and a number; all that reads a set then has to end in a ClscoError of one line, or well. Prints a
line for each case that does not, and how many there were; exit status 1 where there is one.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import random
import shutil
import sys
import tempfile
import traceback
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import clsco.data
from clsco.data.build import located
from clsco.data.containers import CONTAINERS
from clsco.data.copies import convert
from clsco.data.manifest import part_key
from clsco.data.sets import open_set, status_of
from clsco.data.storage import open_storage
from clsco.data.verify import scene_table, verify_files
from clsco.errors import ClscoError
from clsco.scene.toml import toml_text
from tests.data.samples import make_set, record
from tests.hostile.mutate import VALUE_CHANGES
from tests.hostile.pictures import DAMAGES

REFUSED = "refused"
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
    """Changed sets that end in something else than a ClscoError of one line, and the number of such errors."""
    make_set(folder / "whole", form="folders+raw")
    found, refused = list[str](), 0
    for number in numbers:
        shutil.rmtree(folder / "set", ignore_errors=True)
        name = changed(seed, number, folder / "whole", folder / "set")
        for what, read in readers(folder / "set", folder / "spare").items():
            fault = outcome(read)
            refused += fault == REFUSED
            found += [f"{number} {name} {what}: {fault}"] if fault not in ("", REFUSED) else []
    return found, refused


def shard_faults(seed: int, numbers: range, folder: Path) -> tuple[list[str], int]:
    """The same of shards whose bytes are damaged, number by number of another format."""
    folder.mkdir(exist_ok=True)
    forms, names = sorted(CONTAINERS), ("color", "mask", "depth", "flow")
    for form in forms:
        path = folder / f"whole_{form}"
        if not path.exists():
            CONTAINERS[form].write(path, (record(number, wanted=names) for number in (1, 2)))
    found, refused = list[str](), 0
    for number in numbers:
        form, rng, path = forms[number % len(forms)], random.Random(f"{seed}:{number}"), folder / "shard"
        whole = folder / f"whole_{form}"
        shutil.rmtree(path, ignore_errors=True)
        path.unlink(missing_ok=True)
        shutil.copytree(whole, path) if whole.is_dir() else shutil.copy(whole, path)
        file = rng.choice(sorted(each for each in path.rglob("*") if each.is_file())) if path.is_dir() else path
        content = file.read_bytes()
        for _ in range(rng.choice((1, 1, 3))):
            content = rng.choice(DAMAGES)(rng, content)
        file.write_bytes(content)

        def read(form: str = form, path: Path = path) -> object:
            with closing(CONTAINERS[form].read(path)) as reader:
                return [each.sha256() for each in reader]

        fault = outcome(read)
        refused += fault == REFUSED
        found += [f"{number} {form} {file.name}: {fault}"] if fault not in ("", REFUSED) else []
    return found, refused


def outcome(read: Callable[[], object]) -> str:
    """ "" for what is read, REFUSED for an error of one line, else what it ended in."""
    try:
        read()
    except ClscoError as error:
        lines = str(error).split("\n")
        return REFUSED if all(line.isprintable() for line in lines) else f"not printable: {ascii(str(error))[:200]}"
    except Exception as error:
        last = traceback.extract_tb(error.__traceback__)[-1]
        return f"{type(error).__name__}: {ascii(str(error))[:150]} at {last.filename}:{last.lineno}"
    return ""


def _json(value: Any) -> str:
    """JSON of a value; nested too deeply for that, as text."""
    try:
        return json.dumps(value, default=str)
    except (RecursionError, ValueError):
        return "[" * 3000 + "]" * 3000


def main() -> int:
    """Run cases of both kinds; 1 where one ends in something else."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    total = 0
    with tempfile.TemporaryDirectory(prefix="clsco-sets-") as folder:
        for what, run in (("values", faults), ("bytes", shard_faults)):
            found, refused = run(given.seed, range(given.cases), Path(folder, what))
            print(*found, sep="\n", end="\n" if found else "")
            print(f"seed {given.seed}: {given.cases} sets with other {what}, {refused} refused, {len(found)} failures")
            total += len(found)
    return int(total > 0)


if __name__ == "__main__":
    sys.exit(main())
