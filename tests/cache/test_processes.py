"""Processes of this machine by what Linux says of them, and by psutil, as on other systems."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from clsco import resources

WAITS = [sys.executable, "-c", "input()"]


@pytest.fixture(params=["proc", "psutil"])
def system(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    if request.param == "proc" and not resources.PROC.is_dir():
        pytest.skip("has no /proc")
    if request.param == "psutil":
        pytest.importorskip("psutil")
        monkeypatch.setattr(resources, "PROC", tmp_path)


@pytest.fixture
def child() -> Iterator[subprocess.Popen[bytes]]:
    with subprocess.Popen(WAITS, stdin=subprocess.PIPE, start_new_session=True) as started:
        yield started
        started.kill()


@pytest.mark.usefixtures("system")
def test_a_process_has_one_start_until_it_ends(child: subprocess.Popen[bytes]) -> None:
    start = resources.process_began(child.pid)
    assert start is not None
    assert resources.process_began(child.pid) == start
    assert not resources.process_is_gone(child.pid)
    child.kill()
    os.waitid(os.P_PID, child.pid, os.WEXITED | os.WNOWAIT)  # nobody has asked yet how it ended
    assert resources.process_began(child.pid) is None
    assert resources.process_is_gone(child.pid)
    child.wait()
    assert resources.process_began(child.pid) is None
    assert resources.process_is_gone(child.pid)


@pytest.mark.usefixtures("system")
def test_later_processes_have_later_starts(child: subprocess.Popen[bytes]) -> None:
    own, other = resources.process_began(os.getpid()), resources.process_began(child.pid)
    assert own is not None
    assert other is not None
    assert own < other
    assert not resources.process_is_gone(os.getpid())


def test_somebody_elses_process_is_not_gone(monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(process: int, number: int) -> None:
        raise PermissionError

    monkeypatch.setattr(os, "kill", refused)
    assert not resources.process_is_gone(os.getpid())
