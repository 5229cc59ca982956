"""Processes that compile ahead: so many as are allowed; they and their folders do not outlive the one that asked."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from clsco.resources import processors, temporary_folder

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="processes are found in /proc")
CODE = """
import os, sys
os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:1])
from clsco.cli.process import run
sys.argv = ["clsco", "devices", "--warm"]
run()
"""
PATIENCE_S = 60.0


def children(pid: int) -> list[int]:
    """Children of a process, without the one by which Python keeps track of shared memory."""
    found = [int(word) for word in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
    return [each for each in found if b"resource_tracker" not in Path(f"/proc/{each}/cmdline").read_bytes()]


def until(condition: Callable[[], object]) -> None:
    end = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.05)


def is_there(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


@pytest.mark.processor  # for which other processes compile
@pytest.mark.parametrize("how", [signal.SIGTERM, signal.SIGINT, signal.SIGKILL], ids=lambda how: how.name)
def test_nothing_stays_of_what_is_ended(how: signal.Signals, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    environ = os.environ | {"TMPDIR": str(tmp_path)}
    process = subprocess.Popen([sys.executable, "-c", CODE], env=environ, stdout=-1, stderr=-1, start_new_session=True)
    until(lambda: children(process.pid))
    (folder,) = tmp_path.glob("clsco-warm.*")
    assert [path.name for path in folder.iterdir()] == ["0"]  # of two processors it may use one
    (compiling,) = children(process.pid)
    process.send_signal(how)
    process.communicate(timeout=PATIENCE_S)
    until(lambda: not is_there(compiling))
    if how == signal.SIGKILL:
        monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
        temporary_folder("warm").rmdir()  # the next one clears up
    assert list(tmp_path.iterdir()) == []


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
