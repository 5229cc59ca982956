"""Resources of the machine: shipped, cache and temporary folders, processes, processors, and safe opening of regular
files, which rejects links, pipes and devices.
"""

from __future__ import annotations

import atexit
import errno
import hashlib
import mmap
import os
import platform
import secrets
import shutil
import stat
import tempfile
from collections.abc import Mapping
from contextlib import suppress
from functools import cache
from importlib.resources import files
from importlib.resources.abc import Traversable
from io import BufferedReader
from pathlib import Path
from types import ModuleType
from typing import BinaryIO, Literal

_HOST = hashlib.sha256(platform.node().encode()).hexdigest()[:8]
_RUN = secrets.token_hex(4)  # distinguishes this process from earlier ones with the same id
PROC = Path("/proc")  # Linux's folder with information on processes
ABANDONED_S = 24 * 3600.0  # time in s without changes after which another machine's temporary folder is abandoned

# Without O_NONBLOCK, opening a pipe could block forever. Windows has neither this flag nor O_NOFOLLOW.
_SAFELY = os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
DEVICE = "a device or a pipe"  # how errors name a file that is neither regular nor a folder


Kind = Literal["cache", "state"]
_PLACES = {"cache": ("XDG_CACHE_HOME", ".cache"), "state": ("XDG_STATE_HOME", ".local/state")}


@cache
def folder(name: str) -> Traversable:
    """The shipped folder `name`, "kernels" or "examples". In a source tree it is the folder beside the package,
    otherwise the installed folder `clsco/<name>`. Raises FileNotFoundError if neither exists.
    """
    beside = Path(__file__).resolve().parent.parent / name
    if (beside.parent / "pyproject.toml").is_file() and beside.is_dir():
        return beside
    inside = files("clsco") / name
    if inside.is_dir():
        return inside
    raise FileNotFoundError(f"{name}: must be installed as clsco/{name} or lie beside the package; got neither")


def code_digest(*modules: ModuleType) -> str:
    """SHA-256 of the source files of modules and packages, for keys of results cached on disk."""
    digest = hashlib.sha256()
    for module in modules:
        path = Path(str(module.__file__))
        for file in sorted(path.parent.glob("*.py")) if path.name == "__init__.py" else (path,):
            digest.update(file.read_bytes())
    return digest.hexdigest()


class ExposedFolderError(Exception):
    """Another user could put files into a cache folder; `folder`: the topmost such folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        super().__init__(f"{folder}: must belong to you, and be writable by you alone")


def private_folder(*names: str, environ: Mapping[str, str] = os.environ, kind: Kind = "cache") -> Path:
    """A folder in the user's cache or state folder that nobody else can write to, created if necessary.

    names: names of nested folders, the outermost first. kind: "cache", or "state" for data that cannot be computed
    again. The cache folder is XDG_CACHE_HOME, by default ~/.cache; the state folder is XDG_STATE_HOME, by default
    ~/.local/state. Raises ExposedFolderError if another user owns or may write to one of the nested folders, or could
    replace them; OSError or RuntimeError if the folder cannot be created, or the user has no home.
    """
    variable, default = _PLACES[kind]
    root = Path(environ.get(variable) or Path.home() / default)
    root.mkdir(mode=0o700, parents=True, exist_ok=True)
    made = [root.joinpath(*names[: k + 1]) for k in range(len(names))]
    for one in made:  # one by one, as `mode` does not apply to parents
        one.mkdir(mode=0o700, exist_ok=True)
    if (exposed := _exposed(root, *made)) is not None:
        raise ExposedFolderError(exposed)
    return made[-1]


def _exposed(root: Path, *ours: Path) -> Path | None:
    """The topmost folder in which another user could put files, or None; ours: folders in `root`, outermost first."""
    if not hasattr(os, "geteuid"):
        return None
    user = os.geteuid()
    above = root.stat()
    swappable = above.st_mode & stat.S_IWOTH and not above.st_mode & stat.S_ISVTX  # anybody could replace a subfolder
    if above.st_uid not in (user, 0) or swappable:
        return root
    for folder in ours:
        found = folder.lstat()
        if not stat.S_ISDIR(found.st_mode) or found.st_uid != user or found.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
            return folder
    return None


def open_regular(path: str | os.PathLike[str], most: int | None = None, *, follow: bool = False) -> BufferedReader:
    """Open a regular file for reading; a file of another kind is rejected as soon as its kind is known.

    most: size limit in bytes; for a file that may grow while it is read, use `read_regular`. follow: True to allow
    `path` to be a symbolic link, for names from users; links among the parent folders are always followed. Raises
    OSError if the file cannot be opened, is not regular, or is too large; `strerror` names the kind of file, such as "a
    device or a pipe".
    """
    flags = _SAFELY & ~getattr(os, "O_NOFOLLOW", 0) if follow else _SAFELY
    try:
        handle = os.open(path, flags)
    except OSError as error:
        if error.errno == errno.ELOOP and not follow:
            raise OSError(error.errno, "a symbolic link", error.filename) from None
        if error.errno in (errno.ENXIO, errno.ENODEV):  # a socket, or a missing device
            raise OSError(error.errno, DEVICE, error.filename) from None
        raise
    try:
        about = os.fstat(handle)
        if stat.S_ISDIR(about.st_mode):
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), os.fspath(path))
        if not stat.S_ISREG(about.st_mode):
            raise OSError(errno.EINVAL, DEVICE, os.fspath(path))
        if most is not None and about.st_size > most:
            raise _too_large(path, about.st_size, most)
        return open(path, "rb", opener=lambda _path, _flags: handle)  # unlike os.fdopen, sets the file's name
    except BaseException:
        os.close(handle)
        raise


def read_regular(path: str | os.PathLike[str], most: int, *, follow: bool = False) -> bytes:
    """Read the content of a regular file of at most `most` bytes. Arguments and errors are those of `open_regular`."""
    with open_regular(path, most, follow=follow) as file:
        content = file.read(min(most, os.fstat(file.fileno()).st_size) + 1)  # allocating `most` bytes would take time
    if len(content) > most:
        raise _too_large(path, len(content), most)
    return content


def _too_large(path: str | os.PathLike[str], size: int, most: int) -> OSError:
    return OSError(errno.EFBIG, f"{size} bytes, more than {most}", os.fspath(path))


def temporary_folder(name: str) -> Path:
    """A new private folder for this process and its children. It is removed when the process ends; if the process is
    killed, the next call in any process removes it.
    """
    base = Path(tempfile.gettempdir())
    remove_left(base, f"clsco-{name}")
    first, last = work_name(f"clsco-{name}").split(".", 1)
    made = Path(tempfile.mkdtemp(prefix=f"{first}.", suffix=f".{last}", dir=base))
    atexit.register(shutil.rmtree, made, ignore_errors=True)
    return made


def work_name(prefix: str, more: str = "") -> str:
    """Name for a temporary file or folder of this process, by which `remove_left` recognizes it. more: hexadecimal
    digits that distinguish names with the same prefix.
    """
    return f"{prefix}.{_HOST}-{os.getpid()}-{_RUN}{more and '-'}{more}.part"


def remove_left(folder: Path, prefix: str = "") -> None:
    """Remove temporary files and folders (`work_name`) in a folder that ended processes have left.

    Those of another machine are removed if they have not changed for ABANDONED_S. prefix: start of the names; by
    default, all names that begin with a dot are examined.
    """
    for path in folder.glob(f"{prefix}.*.part"):
        with suppress(OSError, ValueError):
            host, process, run, *_ = path.name.split(".")[-2].split("-")
            if host != _HOST:
                newest = max(each.stat().st_mtime for each in (path, *path.rglob("*")))
                left = newest < _now(folder) - ABANDONED_S
            elif int(process) == os.getpid():
                left = run != _RUN
            else:
                left = process_is_gone(int(process))
            if left and path.is_dir() and not path.is_symlink():
                shutil.rmtree(path, ignore_errors=True)
            elif left:
                path.unlink()


def process_began(process: int) -> float | None:
    """Start time of a process, to compare with others on this machine; None if no such process is running.

    On Linux it is in ticks since boot, which clock changes do not affect (proc(5)); on other systems in seconds of the
    clock.
    """
    if (PROC / "self").exists():
        try:
            text = (PROC / str(process) / "stat").read_text("utf-8", "replace")
        except OSError:
            return None
        fields = text.rpartition(")")[2].split()  # from the state on
        return None if fields[0] in ("Z", "X") else float(fields[19])
    import psutil

    try:
        entry = psutil.Process(process)
        return None if entry.status() in (psutil.STATUS_ZOMBIE, psutil.STATUS_DEAD) else float(entry.create_time())
    except psutil.NoSuchProcess:
        return None


def process_is_gone(process: int) -> bool:
    """True if a process of this machine has ended, even if its parent has not waited for it yet."""
    if os.name == "posix":  # on Windows signal 0 is Ctrl-C
        try:
            os.kill(process, 0)
        except ProcessLookupError:
            return True
        except OSError:  # another user's process
            return False
    return process_began(process) is None


def read_at(file: BinaryIO, size: int, place: int) -> bytes:
    """Read up to `size` bytes of a file from the offset `place` on; fewer if the file ends before."""
    file.seek(place)
    return file.read(size)


def _now(folder: Path) -> float:
    """The time by the clock of a folder's file system, which may be on another machine."""
    with tempfile.TemporaryFile(dir=folder) as probe:
        return os.fstat(probe.fileno()).st_mtime


def resident_bytes() -> int:
    """Resident memory of this process, bytes."""
    if (PROC / "self").exists():
        return int((PROC / "self" / "statm").read_bytes().split()[1]) * mmap.PAGESIZE
    import psutil

    return int(psutil.Process().memory_info().rss)


def machine_bytes(*, free: bool = False) -> int:
    """Memory of this machine in bytes: the total, or with `free` the free memory."""
    if (PROC / "self").exists():
        lines = (PROC / "meminfo").read_text("ascii").splitlines()
        amounts = {name: int(amount.split()[0]) for name, _, amount in (line.partition(":") for line in lines)}
        return 1024 * amounts["MemAvailable" if free else "MemTotal"]
    import psutil

    memory = psutil.virtual_memory()
    return int(memory.available if free else memory.total)


def processors(groups: Path = Path("/proc/self/cgroup"), mounted: Path = Path("/sys/fs/cgroup")) -> int:
    """Number of processors that this process may use: limited by its affinity and the quotas of its control groups.

    groups: file in which Linux lists the control groups of the process; mounted: folder with the settings of all
    control groups (version 1 or 2).
    """
    if hasattr(os, "process_cpu_count"):  # Python 3.13
        bound = os.process_cpu_count()
    elif hasattr(os, "sched_getaffinity"):
        bound = len(os.sched_getaffinity(0))
    else:
        bound = os.cpu_count()
    return max(1, min([bound or 1, *_quotas(groups, mounted)]))


def _quotas(groups: Path, mounted: Path) -> list[int]:
    """Numbers of processors, rounded up, that quotas of each control group and of its parents allow."""
    found = []
    with suppress(OSError, ValueError):
        for line in groups.read_text("utf-8").splitlines():
            _, kinds, path = line.split(":", 2)
            if not kinds:
                base, names = mounted, ["cpu.max"]
            elif "cpu" in kinds.split(","):
                base, names = mounted / "cpu", ["cpu.cfs_quota_us", "cpu.cfs_period_us"]
            else:
                continue
            folder = base / path.strip("/")
            for place in (folder, *folder.parents[: len(folder.parts) - len(base.parts)]):
                with suppress(OSError, ValueError):  # no such setting, or "max"
                    quota, period = (int(word) for name in names for word in (place / name).read_text("utf-8").split())
                    if quota > 0 and period > 0:
                        found.append(-(-quota // period))
    return found
