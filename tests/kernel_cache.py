"""Compiled kernels that one run of the tests leaves to the next ones: compiling is most of their time.

A run works in a folder of its own, with links to what was kept: PoCL writes to no file that is there, but for the one
that tells when a program was used last. What a run has compiled is kept where it ends, as links as well, so that a run
that is killed leaves nothing that might be damaged.
"""

from __future__ import annotations

import atexit
import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

KEPT = Path(__file__).resolve().parents[1] / ".pytest_cache" / "kernels"
LARGEST = 2**30
"""Bytes; programs beyond, of those that were used last, are removed. A whole run has some 100 MB."""

_USED = "last_accessed"
_DAY = 86400.0  # s


def new_run(kept: Path = KEPT) -> Path:
    """Folder of a run, which is removed where this process ends; a temporary one where `kept` cannot be written."""
    try:
        kept.mkdir(parents=True, exist_ok=True)
        run = Path(tempfile.mkdtemp(prefix="run-", dir=kept))
    except OSError:
        run = Path(tempfile.mkdtemp(prefix="clsco-tests-"))
    atexit.register(shutil.rmtree, run, ignore_errors=True)
    if run.parent == kept:
        atexit.register(keep, run, kept)
    return run


def take_kept(folder: Path, kept: Path = KEPT) -> None:
    """Link all that was kept into the folder of one process of a run."""
    for path in _compiled(kept):
        _link(path, folder / path.relative_to(kept))


def keep(run: Path, kept: Path = KEPT, largest: int = LARGEST) -> None:
    """Keep what the processes of a run have compiled, and forget what was not used for the longest time."""
    for process in (run, *run.glob("gw*")):
        for path in _compiled(process):
            _link(path, kept / path.relative_to(process))
        for used in process.glob(f"??/*/{_USED}"):
            with suppress(FileNotFoundError):
                os.utime(kept / used.parent.relative_to(process))
    with suppress(FileNotFoundError):  # another run ends at the same time, and removes the same
        _forget(kept, largest)


def _forget(kept: Path, largest: int) -> None:
    size = 0
    for program in sorted(kept.glob("??/*"), key=lambda each: each.stat().st_mtime, reverse=True):
        size += sum(path.stat().st_size for path in program.rglob("*"))
        if size > largest:
            shutil.rmtree(program, ignore_errors=True)
    for left in kept.glob("run-*"):  # of runs that were killed
        if time.time() - left.stat().st_mtime > _DAY:
            shutil.rmtree(left, ignore_errors=True)


def _compiled(folder: Path) -> Iterator[Path]:
    """PoCL's files: in a folder of two letters of the program's hash, and one of the rest of it."""
    for path in folder.glob("??/*/**/*"):
        if path.is_file() and path.name != _USED:
            yield path


def _link(path: Path, to: Path) -> None:
    with suppress(FileExistsError, FileNotFoundError):  # another run ends at the same time
        to.parent.mkdir(parents=True, exist_ok=True)
        to.hardlink_to(path)
