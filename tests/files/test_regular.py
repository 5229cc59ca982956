"""Files of strangers: what is no regular file is not opened for longer than that takes to see."""

from __future__ import annotations

import os
import socket
from pathlib import Path

import pytest

from clsco.resources import open_regular, processors, read_regular


def got(path: Path | str, most: int = 100, *, follow: bool = False) -> str:
    try:
        read_regular(path, most, follow=follow)
    except OSError as error:
        return str(error.strerror)
    raise AssertionError(path)


def test_what_is_read(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"12345")
    (tmp_path / "link").symlink_to("a")
    assert read_regular(tmp_path / "a", 5) == b"12345"
    assert read_regular(tmp_path / "link", 5, follow=True) == b"12345"
    with open_regular(tmp_path / "a") as file:
        assert file.read(2) == b"12"


def test_what_stands_in_for_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a").write_bytes(b"123456")
    (tmp_path / "link").symlink_to("a")
    (tmp_path / "lost").symlink_to("nothing")
    (tmp_path / "zero").symlink_to("/dev/zero")
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "to_pipe").symlink_to("pipe")
    (tmp_path / "folder").mkdir()
    monkeypatch.chdir(tmp_path)  # names of sockets are short
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind("socket")
    assert got(tmp_path / "a", 5) == "6 bytes, more than 5"
    for name in ("link", "lost", "zero", "to_pipe"):
        assert got(tmp_path / name) == "a symbolic link"
    for name in ("zero", "to_pipe"):
        assert got(tmp_path / name, follow=True) == "a device or a pipe"
    for name in ("pipe", "socket"):
        assert got(tmp_path / name) == "a device or a pipe"
    assert got("/dev/zero") == "a device or a pipe"
    assert got(tmp_path / "folder") == "Is a directory"
    assert got(tmp_path / "nothing") == "No such file or directory"


def test_a_file_that_grows_while_it_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a").write_bytes(b"123")
    about = os.fstat

    def grown(handle: int) -> os.stat_result:
        state = about(handle)
        with open(tmp_path / "a", "ab") as file:
            file.write(b"4567")
        return state

    monkeypatch.setattr(os, "fstat", grown)
    assert got(tmp_path / "a", 5) == "6 bytes, more than 5"


def test_no_handle_is_left(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    before = len(list(Path("/proc/self/fd").iterdir()))
    for _ in range(20):
        got(tmp_path / "pipe")
        got(tmp_path)
    assert len(list(Path("/proc/self/fd").iterdir())) == before


@pytest.mark.parametrize(
    ("groups", "files", "count"),
    [
        ("0::/a/b\n", {"a/b/cpu.max": "max 100000\n", "a/cpu.max": "150000 100000\n"}, 2),
        ("0::/a/b\n", {"cpu.max": "20000 100000\n"}, 1),
        ("0::/\n", {"cpu.max": "max 100000\n"}, 64),
        ("4:cpu,cpuacct:/x\n0::/\n", {"cpu/cpu.cfs_quota_us": "250000\n", "cpu/cpu.cfs_period_us": "100000\n"}, 3),
        ("4:cpu:/\n", {"cpu/cpu.cfs_quota_us": "-1\n", "cpu/cpu.cfs_period_us": "100000\n"}, 64),
        ("5:cpuset:/\nnonsense\n", {"cpu.max": "100000 100000\n"}, 64),
    ],
    ids=["above", "less than one", "no limit", "version 1", "version 1, no limit", "damaged"],
)
def test_a_quota_of_a_control_group_is_kept(
    groups: str, files: dict[str, str], count: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "list").write_text(groups)
    for name, text in files.items():
        (tmp_path / "mounted" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "mounted" / name).write_text(text)
    monkeypatch.setattr(os, "process_cpu_count", lambda: 64, raising=False)
    assert processors(tmp_path / "list", tmp_path / "mounted") == count
