"""PoCL's cache of compiled kernels: a separate folder, with a lock between processes and checksums of its files.

PoCL compiles a kernel at the build of its program and at its first launch, into a folder that all processes share. It
loads files from there unchecked: a damaged file crashes the process (SIGABRT or SIGBUS), and two processes that compile
the same kernel at once sometimes damage its file. So clsco uses a folder of its own, holds a lock whenever PoCL may
write to it, and compares the files with checksums that were recorded under the lock.
"""

from __future__ import annotations

import json
import logging
import os
import shutil
import signal
import stat
import time
import zlib
from collections.abc import Iterator, MutableMapping
from contextlib import ExitStack, contextmanager, suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from clsco.resources import ExposedFolderError, private_folder, read_regular, temporary_folder

try:
    import fcntl
except ImportError:  # Windows, where PoCL is not shipped
    fcntl = None  # type: ignore[assignment]

VARIABLE = "POCL_CACHE_DIR"
SPECIALIZATION = "POCL_WORK_GROUP_SPECIALIZATION"
LOCK = "clsco.lock"
LIST = "clsco.json"
MOST_LIST = 2**26  # largest size of the list of checksums, bytes
ROOM = 16 * 2**20  # free disk space required for compilation, bytes; the largest program takes some 2 MB
HANDLES = 64  # least limit of open files with which PoCL's compiler and the linker work
_LARGEST = 64 * 2**20  # bytes of a cache beyond which it is emptied, as PoCL never removes files of older kernels
ABANDONED_S = 600.0  # s after which a temporary file of PoCL is abandoned
_SETTLED = 2 * 10**9  # ns: two changes of a folder this far apart have different times on any file system
_AT_ONCE = getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)  # opening a pipe does not block

_Sums = dict[str, list[int]]
_Listing = tuple[int, list[str], list[str]]  # time of a folder's last change, names of files, names of subfolders
# Listings by path: to check whether a folder has changed takes a tenth of the time of reading it.
_listings: dict[str, _Listing] = {}


def prepare(environ: MutableMapping[str, str] = os.environ) -> None:
    """Set the environment variable of PoCL's cache folder; call this before the first query of the platforms.

    The folder is `clsco/pocl-<versions>` in the user's cache folder. If clsco cannot write to it, others can, or its
    disk is full, PoCL gets a temporary folder, which is removed at exit. A POCL_CACHE_DIR set by the user stays
    unchanged. Unless the user sets POCL_WORK_GROUP_SPECIALIZATION, PoCL compiles no variants for small grids and for an
    offset, because these save no time.
    """
    environ.setdefault(SPECIALIZATION, "0")
    if environ.get(VARIABLE):
        return
    try:
        folder = private_folder("clsco", f"pocl-{_versions()}", environ=environ)
        if has_room(_make_folder(folder)):
            environ[VARIABLE] = str(folder)
            return
    except ExposedFolderError as exposed:
        text = "%s, as what is in it is executed; kernels go to a temporary folder"
        logging.getLogger("clsco").warning(text, exposed)
    except (OSError, RuntimeError):  # read-only, full, or a user without a home
        pass
    environ[VARIABLE] = str(_make_folder(temporary_folder("kernels") / "clsco" / "pocl"))


def is_on_disk() -> bool:
    """True if PoCL's folder is in a file system that stores files, unlike /proc."""
    try:
        return shutil.disk_usage(_folder()).total > 0
    except OSError:  # the user has set a folder that does not exist yet
        return True


def has_room(folder: Path | None = None) -> bool:
    """True if a folder, by default PoCL's, has disk space for compilation; otherwise PoCL would abort the process."""
    try:
        return shutil.disk_usage(folder or _folder()).free >= ROOM
    except OSError:  # the user has set a folder that does not exist yet
        return True


def shortage() -> str:
    """Text on why PoCL would abort the process when it compiles: no disk space, or a limit; else ""."""
    if not has_room():
        return "a full disk"
    with suppress(ImportError):  # as on Windows
        import resource

        if 0 <= (limit := resource.getrlimit(resource.RLIMIT_FSIZE)[0]) < ROOM:
            return f"a limit of {limit} bytes a file (ulimit -f)"
        if 0 <= (limit := resource.getrlimit(resource.RLIMIT_NOFILE)[0]) < HANDLES:
            return f"a limit of {limit} open files (ulimit -n)"
    return ""


def check() -> int:
    """Remove programs of which a file is missing, unreadable, unrecorded or not as recorded; returns their number.

    A cache above its size limit is emptied. Does nothing in a folder that the user has set.
    """
    folder = _folder()
    if not _is_ours(folder):
        return 0
    with _lock(folder):
        recorded = _read_record(folder)
        states = {}
        for name, _ in _names(folder):
            with suppress(OSError):  # PoCL moves temporary files without our lock; unreadable ones are removed
                states[name] = _state(f"{folder}/{name}")
        programs = {_program(name) for name in states}
        bad = {
            _program(name)
            for name in states.keys() | recorded.keys()
            if name not in states or name not in recorded or states[name][2] != recorded[name][2]
        }
        if sum(size for size, _, _ in states.values()) > _LARGEST:
            bad = programs
        for program in bad:
            shutil.rmtree(folder / program, ignore_errors=True)
        if bad:
            _write_record(folder)
        return len(bad)


@contextmanager
def exclusive() -> Iterator[None]:
    """Lock the cache folder against other processes in the block, where PoCL may write to it, and record new files."""
    folder = _folder()
    with _lock(folder), held_signals():
        try:
            yield
        finally:
            if _is_ours(folder):
                _write_record(folder)


@contextmanager
def held_signals() -> Iterator[None]:
    """Hold back Ctrl-C and SIGTERM in the block, also from threads that start in it and from programs that these run.

    Otherwise Ctrl-C in a terminal would end PoCL's linker, too, and PoCL would abort the process.
    """
    if hasattr(signal, "pthread_sigmask"):  # not on Windows, where PoCL is not shipped
        before = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT, signal.SIGTERM))
    try:
        yield
    finally:
        if hasattr(signal, "pthread_sigmask"):
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _folder() -> Path:
    return Path(os.environ[VARIABLE])


def _is_ours(folder: Path) -> bool:
    # Decided by the name, because a child process inherits the variable that its parent has set.
    return folder.parent.name == "clsco" and folder.name.startswith("pocl")


def _make_folder(folder: Path) -> Path:
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    with open(folder / LOCK, "ab"):  # a folder may exist, but not be writable
        return folder


def _versions() -> str:
    versions = []
    for package in ("pocl-binary-distribution", "pyopencl"):
        try:
            versions.append(version(package))
        except PackageNotFoundError:  # PoCL came with the system
            versions.append("system")
    return "-".join(versions)


@contextmanager
def _lock(folder: Path) -> Iterator[None]:
    with ExitStack() as stack:
        # A read-only folder that the user has set needs no lock: PoCL cannot write to it either.
        with suppress(OSError):
            handle = stack.enter_context(open(_make_folder(folder) / LOCK, "ab"))  # closing it unlocks
            if fcntl is not None:
                fcntl.flock(handle, fcntl.LOCK_EX)
        yield


def _names(folder: Path) -> Iterator[tuple[str, bool]]:
    """Names of all compiled files, each with True if its folder is unchanged since this process last read the folder.

    Names are plain strings: this runs after every compilation, and `Path` would take ten times as long.
    """
    waiting = [""]
    while waiting:
        inside = waiting.pop()
        with suppress(OSError):  # another process may remove a cache that is too large
            (_, files, folders), unchanged = _list_folder(f"{folder}/{inside}")
            # PoCL loads neither `last_accessed`, which it rewrites at every use, nor left-over files `tempfile_`.
            if inside:
                yield from ((inside + name, unchanged) for name in files if name != "last_accessed")
            waiting += [f"{inside}{name}/" for name in folders]


def _list_folder(path: str) -> tuple[_Listing, bool]:
    """Content of a folder, and True if the folder is unchanged since this process last read it."""
    changed = os.stat(path).st_mtime_ns  # noqa: PTH116
    cached = _listings.get(path)
    if cached is not None and cached[0] == changed:
        return cached, True
    with os.scandir(path) as entries:
        inside = [(entry.name, entry.is_dir(follow_symlinks=False)) for entry in entries]
    files, folders = ([name for name, is_folder in inside if is_folder == kind] for kind in (False, True))
    listing = changed, files, folders
    if time.time_ns() - changed > _SETTLED:
        _listings[path] = listing
    return listing, False


def _program(name: str) -> str:
    return "/".join(name.split("/")[:2])  # PoCL's folders: two letters of a hash, then the other letters


def _state(path: str, recorded: list[int] | None = None) -> list[int]:
    """Size, modification time and checksum of a file; `recorded` itself if it has the size and time of the file."""
    handle = os.open(path, os.O_RDONLY | _AT_ONCE)
    try:
        status = os.fstat(handle)
        if not stat.S_ISREG(status.st_mode):
            raise FileNotFoundError(path)
        key = [status.st_size, status.st_mtime_ns]
        if recorded is not None and recorded[:2] == key:
            return recorded
        return [*key, zlib.crc32(os.read(handle, status.st_size))]
    finally:
        os.close(handle)


def _read_record(folder: Path) -> _Sums:
    try:
        text, _, checksum = read_regular(folder / LIST, MOST_LIST).decode().rpartition("\n")
        if int(checksum) != zlib.crc32(text.encode()):  # a damaged list is not used
            return {}
        entries = json.loads(text).items()
        return {name: [int(size), int(modified), int(crc)] for name, (size, modified, crc) in entries}
    except (OSError, ValueError, TypeError, AttributeError):  # no list yet, or a damaged one
        return {}


def _write_record(folder: Path) -> None:
    recorded = _read_record(folder)
    sums: _Sums = {}
    for name, same in _names(folder):
        entry = recorded.get(name)
        if same and entry is not None:  # PoCL moves new files to the folder, which changes it
            sums[name] = entry
            continue
        with suppress(OSError):
            sums[name] = _state(f"{folder}/{name}", entry)
    if sums != recorded:
        temporary = folder / f"{LIST}.new"
        with suppress(OSError):  # on a full disk, unrecorded programs are compiled again
            text = json.dumps(sums)
            temporary.write_text(f"{text}\n{zlib.crc32(text.encode())}", "utf-8")
            temporary.replace(folder / LIST)
    for leftover in folder.glob("tempfile_*"):
        with suppress(OSError):
            if time.time() - leftover.stat().st_mtime > ABANDONED_S:  # a process with another lock file may link others
                leftover.unlink()
