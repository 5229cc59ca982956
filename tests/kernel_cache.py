"""Compiled kernels, and tables, that one run of the tests leaves to the next ones: these are most of their time.

clsco holds a lock of PoCL's folder while PoCL compiles, for which workers in one folder would wait. So each worker has
a folder of links to the programs of earlier runs, and exchanges new programs with the others after each file of tests.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from contextlib import suppress
from pathlib import Path

KEPT = Path(__file__).resolve().parents[1] / ".pytest_cache" / "kernels"
WORKER = "clsco-worker-"
LARGEST = 200 * 2**20
"""Bytes; programs beyond, of those that were used last, are removed. All tests have some 120 MB."""


def worker_folder(kept: Path = KEPT) -> Path:
    """A folder of this process alone, with links to all that earlier runs have left."""
    try:
        kept.mkdir(parents=True, exist_ok=True)
        folder = Path(tempfile.mkdtemp(prefix=WORKER, dir=kept.parent))
    except OSError:  # a checkout that is read-only
        return Path(tempfile.mkdtemp(prefix=WORKER))
    exchange_programs(folder, kept)
    return folder


def array_folder(kept: Path = KEPT) -> Path:
    """A folder of tables and patterns for later runs as well: their keys hold a digest of the code that makes them."""
    folder = kept.with_name("arrays")
    with suppress(OSError):
        folder.mkdir(parents=True, exist_ok=True)
    return folder if os.access(folder, os.W_OK) else Path(tempfile.mkdtemp(prefix=WORKER))


def exchange_programs(folder: Path, kept: Path = KEPT) -> None:
    """Link programs that a worker has compiled to where others look for them, and theirs to where it does."""
    if not kept.is_dir():
        return
    for program in folder.glob("??/*"):
        if not program.is_symlink():
            with suppress(OSError):  # files that are there, or that another process has removed, are passed over
                target = kept / program.parent.name / program.name
                shutil.copytree(program, target, copy_function=os.link, dirs_exist_ok=True)
    for program in kept.glob("??/*"):
        with suppress(FileExistsError):
            (folder / program.parent.name).mkdir(exist_ok=True)
            (folder / program.parent.name / program.name).symlink_to(program)


def remove_old(kept: Path = KEPT, largest: int = LARGEST) -> None:
    """Remove the programs that were not used for the longest time, of which PoCL writes a file at each use."""
    programs = {}
    for program in kept.glob("??/*"):
        used = program / "last_accessed"
        programs[program] = (used if used.exists() else program).stat().st_mtime
    size = 0
    for program in sorted(programs, key=lambda each: programs[each], reverse=True):
        size += sum(path.stat().st_size for path in program.rglob("*"))
        if size > largest:
            shutil.rmtree(program, ignore_errors=True)
