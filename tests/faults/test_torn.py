"""A disk that fails at every call, and processes that are killed: whole frames or none, and nothing left over."""

from __future__ import annotations

import errno
import json
import os
import re
import resource
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import pytest
from click.testing import CliRunner

from clsco.cli.main import main
from clsco.data.failures import failure_of
from clsco.errors import DeviceError, FileError
from clsco.files import atomic as files
from clsco.files.images import write_exr
from clsco.frame.files import read_complete
from clsco.opencl import pocl_cache as poclcache
from clsco.opencl.device import choose
from clsco.opencl.session import session_on
from tests.faults.opencl import counted

SCENE = """
[camera]
resolution = [12, 9]
[sequence]
frames = 2
samples = 2
[[object]]
shape = "plane"
distance = 250.0
motion.velocity = [3.0, 0.0, 0.0]
"""  # the kernels are those of tests/faults/kills.py
REASONS = (errno.ENOSPC, errno.EACCES, errno.EIO, errno.EROFS, errno.EDQUOT)


class Disk:
    """Counts what is asked of the disk; the call of number `fails_at` raises."""

    def __init__(self, fails_at: int = -1) -> None:
        self.fails_at, self.names = fails_at, list[str]()

    def call(self, name: str) -> None:
        self.names.append(name)
        if len(self.names) - 1 == self.fails_at:
            reason = REASONS[self.fails_at % len(REASONS)]
            raise OSError(reason, os.strerror(reason))


class Written:
    """A file whose writes are counted."""

    def __init__(self, file: BinaryIO, disk: Disk) -> None:
        self.file, self.disk = file, disk

    def __getattr__(self, name: str) -> Any:
        return getattr(self.file, name)

    def __enter__(self) -> Written:
        return self

    def __exit__(self, *about: object) -> None:
        self.file.close()

    def write(self, content: bytes) -> int:
        self.disk.call("write")
        return self.file.write(content)

    def writelines(self, parts: list[bytes]) -> None:
        for part in parts:
            self.write(part)


@contextmanager
def failing(disk: Disk) -> Iterator[None]:
    def opened(path: Path, mode: str) -> Any:
        if mode == "rb":
            return open(path, mode)
        disk.call("open")
        return Written(open(path, mode), disk)  # type: ignore[arg-type]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(files, "open", opened, raising=False)
        patch.setattr(os, "fsync", counted(disk.call, "fsync", os.fsync))
        for name in ("replace", "mkdir", "touch"):
            patch.setattr(Path, name, counted(disk.call, name, getattr(Path, name)))
        yield


def check_folder(out: Path) -> int:
    """The number of whole frames; asserts that there is nothing else."""
    names = {path.name for path in out.iterdir()} if out.is_dir() else set()
    described = {name for name in names if name.endswith(".json")}
    assert all(read_complete(out, int(name[6:10])) is not None for name in described)
    whole = {name for each in described for name in json.loads((out / each).read_text())["files"]}
    left = {name for name in names - described - whole if not name.startswith("frame_")}
    assert left == set(), "a temporary file is left"
    return len(described)


@pytest.mark.parametrize("truth", [("--format", "npz"), pytest.param(("--format", "npz,exr"), marks=pytest.mark.soak)])
def test_the_disk_fails_at_every_call(tmp_path: Path, truth: tuple[str, str]) -> None:
    (tmp_path / "scene.toml").write_text(SCENE)

    def render(out: Path, disk: Disk) -> Any:
        session_on.cache_clear()  # the kernels' cache is looked at each time
        with failing(disk):
            words = ["render", str(tmp_path / "scene.toml"), "-o", str(out), *truth, "--resume"]
            return CliRunner().invoke(main, words)

    assert render(tmp_path / "compiled", Disk()).exit_code == 0
    count = Disk()
    assert render(tmp_path / "whole", count).exit_code == 0
    assert set(count.names) == {"mkdir", "touch", "open", "write", "fsync", "replace"}
    for number in range(3, len(count.names), 1 if "exr" in truth[1] else len(count.names) // 4):
        out = tmp_path / f"out{number}"
        result = render(out, Disk(number))
        recorded = result.stderr.splitlines()
        assert result.exception is None or isinstance(result.exception, SystemExit), (number, repr(result.exception))
        # Of the kernels' cache, which works without a lock.
        if count.names[number] == "mkdir" and result.exit_code == 0:
            assert check_folder(out) == 2
            continue
        assert (result.exit_code, len(recorded)) == (1, 1), (number, count.names[number], recorded)
        assert recorded[0].startswith("error: ")
        assert "; got " in recorded[0]
        assert ".part" not in recorded[0]
        assert check_folder(out) < 2
        assert render(out, Disk()).exit_code == 0  # there is room again
        assert check_folder(out) == 2


def test_the_last_write_of_an_exr_fails(tmp_path: Path) -> None:
    """OpenEXR writes the table of lines when it closes a file, and drops the error of that."""
    plane = {"Y": np.ones((9, 12), np.float32)}
    count = Disk()
    with failing(count):
        write_exr(tmp_path / "a.exr", plane)
    last = len(count.names) - 1 - count.names[::-1].index("write")
    for number in range(count.names.index("write"), last + 1):
        with failing(Disk(number)), pytest.raises(FileError, match="the file must be writable; got "):
            write_exr(tmp_path / "b.exr", plane)
        assert [path.name for path in tmp_path.iterdir()] == ["a.exr"]


@pytest.mark.soak
def test_a_small_disk(tmp_path: Path) -> None:
    """A file system that is full after so many KiB, in a name space of its own."""
    (tmp_path / "scene.toml").write_text(SCENE.replace("[12, 9]", "[120, 90]"))
    (tmp_path / "disk").mkdir()
    words = [sys.executable, "-W", "error", "-c", "from clsco.cli.main import main; main()"]
    words += ["render", str(tmp_path / "scene.toml"), "-o", str(tmp_path / "disk" / "out"), "--format", "npz"]
    # Only Linux has them, and there the administrator may forbid them; full disks are also injected, above.
    if not shutil.which("unshare") or subprocess.run(["unshare", "-rm", "true"], capture_output=True).returncode:
        pytest.skip("a file system of its own needs name spaces, which this system does not allow")
    statuses = set()
    for size in (4, 8, 60, 120, 300, 500, 700, 900, 1100, 1300, 2000):
        mounted = f"mount -t tmpfs -o size={size}k,nr_inodes=20 tmpfs {tmp_path}/disk"
        copied = f"cp -r {tmp_path}/disk/. {tmp_path}/out{size}"
        command = ["unshare", "-rm", "sh", "-c", f'{mounted} && "$@"; status=$?; {copied}; exit $status', "-", *words]
        done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
        statuses.add(done.returncode)
        assert done.returncode in (0, 1), done.stderr
        lines = done.stderr.splitlines()
        assert len(lines) == done.returncode, done.stderr
        assert all(line.endswith("No space left on device") for line in lines), done.stderr
        whole = check_folder(tmp_path / f"out{size}" / "out")
        assert (whole == 2) == (done.returncode == 0)
    assert statuses == {0, 1}


def test_no_room_to_compile_is_reported_before_the_compiler_aborts(monkeypatch: pytest.MonkeyPatch) -> None:
    session = session_on(choose("pocl"))
    full = shutil.disk_usage("/")._replace(free=poclcache.ROOM - 1)
    monkeypatch.setattr(shutil, "disk_usage", lambda path: full)
    with pytest.raises(DeviceError, match=r"kernels need 16 MiB in the folder .*; got a full disk"):
        session.compiling()
    monkeypatch.undo()
    for kind, limit, got in (
        (resource.RLIMIT_FSIZE, 2**16, "65536 bytes a file (ulimit -f)"),
        (resource.RLIMIT_NOFILE, 12, "12 open files (ulimit -n)"),
    ):
        limits = {kind: (limit, limit)}
        monkeypatch.setattr("resource.getrlimit", lambda each, limits=limits: limits.get(each, (-1, -1)))
        with pytest.raises(DeviceError, match=re.escape(f"got a limit of {got}")) as caught:
            session.compiling()
    assert failure_of(caught.value, "DATA")[0] == "fatal"  # no failure of samples
    environ = {"XDG_CACHE_HOME": os.devnull + "/none"}
    poclcache.prepare(environ)
    assert Path(environ["POCL_CACHE_DIR"]).is_dir()


def test_a_full_cache_folder_is_not_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    full = shutil.disk_usage("/")._replace(free=0)
    monkeypatch.setattr(shutil, "disk_usage", lambda path: full)
    environ = {"XDG_CACHE_HOME": str(tmp_path)}
    poclcache.prepare(environ)
    assert tmp_path not in Path(environ["POCL_CACHE_DIR"]).parents


def test_a_list_of_the_cache_that_cannot_be_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "clsco" / "pocl-1"
    monkeypatch.setenv("POCL_CACHE_DIR", str(folder))

    def fail(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(Path, "write_text", fail)
        with poclcache.exclusive():
            (folder / "AB" / "one").mkdir(parents=True)
            (folder / "AB" / "one" / "program.bc").write_bytes(bytes(100))
    os.mkfifo(folder / "AB" / "one" / "pipe")
    for name, seconds in (("tempfile_left.so.o", 10**6), ("tempfile_linked.so.o", 10)):
        (folder / name).touch()
        os.utime(folder / name, (0, time.time() - seconds))
    assert poclcache.check() == 1  # what is not recorded may be damaged
    assert list(folder.rglob("program.bc")) == []
    assert [path.name for path in folder.glob("tempfile_*")] == ["tempfile_linked.so.o"]
