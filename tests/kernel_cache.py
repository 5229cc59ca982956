"""Compiled kernels that one run of the tests leaves to the next ones: compiling is most of their time.

Processes and runs share a folder: PoCL 3.0, which tests run on, writes each file under another name and renames it
where it is whole, so that a run that is killed leaves nothing that might be damaged. What users have may do otherwise,
against which `clsco.opencl.pocl_cache` keeps a lock.
"""

from __future__ import annotations

import atexit
import os
import shutil
import tempfile
from pathlib import Path

KEPT = Path(__file__).resolve().parents[1] / ".pytest_cache" / "kernels"
LARGEST = 2**30
"""Bytes; programs beyond, of those that were used last, are removed. A whole run has some 100 MB."""


def cache_folder(kept: Path = KEPT) -> Path:
    """The folder, from which old programs are removed where this process ends; a temporary one if it is read-only."""
    try:
        kept.mkdir(parents=True, exist_ok=True)
        writable = os.access(kept, os.W_OK)
    except OSError:
        writable = False
    if writable:
        atexit.register(remove_old, kept)
        return kept
    temporary = Path(tempfile.mkdtemp(prefix="clsco-tests-"))
    atexit.register(shutil.rmtree, temporary, ignore_errors=True)
    return temporary


def remove_old(kept: Path, largest: int = LARGEST) -> None:
    """Remove the programs that were not used for the longest time, of which PoCL writes a file at each use."""
    programs = {file.parent: file.stat().st_mtime for file in kept.glob("??/*/last_accessed")}
    size = 0
    for program in sorted(programs, key=lambda each: programs[each], reverse=True):
        size += sum(path.stat().st_size for path in program.rglob("*"))
        if size > largest:
            shutil.rmtree(program, ignore_errors=True)
