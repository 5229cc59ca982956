"""Processes that work for another one: what they say, and how they end."""

from __future__ import annotations

import os
import platform
import resource
import signal
import subprocess
import sys
import time
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np
import pytest

from clsco.engine.child import Child, how_ended

PARENT = """
import sys
sys.path.insert(0, {root!r})
from clsco.engine.child import Child
from tests.faults.test_child import sleeps
if __name__ == "__main__":
    print(Child(sleeps).pipe.recv(), flush=True)
    sys.stdin.read()
"""


def echoes(pipe: Connection, *given: object) -> None:
    pipe.send((given, os.environ.get("CLSCO_TEST"), signal.getsignal(signal.SIGINT) == signal.SIG_IGN))
    while True:
        pipe.send(pipe.recv())


def sleeps(pipe: Connection) -> None:
    pipe.send(os.getpid())
    time.sleep(100.0)


def prints(_: Connection) -> None:
    print("Python", file=sys.stderr)
    os.write(2, b"a library that crashes\n")


def pictures(pipe: Connection) -> None:
    """Make pictures of 3 MB, three at a time, and say how many pages the kernel had to give for each time."""
    for _ in range(6):
        before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
        made = [np.ones((512, 512, 3), np.float32) for _ in range(3)]
        pipe.send((len(made), resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before))


def test_it_takes_arguments_and_variables_and_speaks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("CLSCO_TEST", raising=False)
    child = Child(echoes, 1, "two", environ={"CLSCO_TEST": "3"})
    assert "CLSCO_TEST" not in os.environ
    assert child.pipe.recv() == ((1, "two"), "3", True)
    child.send("word")
    assert child.pipe.recv() == "word"
    assert child.is_alive
    child.terminate()
    assert how_ended(child.end()) == "signal 15"
    assert not child.is_alive
    child.send("nobody hears it")


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="other libraries of C keep memory as they will")
def test_it_keeps_the_memory_of_pictures() -> None:
    child = Child(pictures)
    assert [child.pipe.recv() for _ in range(6)][-1] < (3, 100)  # of 2304 pages
    child.end()


def test_only_python_prints(capfd: pytest.CaptureFixture[str]) -> None:
    assert Child(prints).end(60.0) == 0
    assert capfd.readouterr().err == "Python\n"


def test_one_that_is_stopped_ends() -> None:
    child = Child(sleeps)
    assert child.pipe.recv() == child.pid
    os.kill(child.pid, signal.SIGSTOP)
    child.terminate()
    assert child.end(0.1) < 0
    assert not child.is_alive


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGTERM])
def test_it_does_not_outlive_its_parent(how: signal.Signals, tmp_path: Path) -> None:
    script = tmp_path / "parent.py"
    script.write_text(PARENT.format(root=str(Path(__file__).resolve().parents[2])))
    with subprocess.Popen(
        [sys.executable, str(script)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as parent:
        assert parent.stdout is not None
        pid = int(parent.stdout.readline())
        parent.send_signal(how)
    end = time.monotonic() + 30.0
    while Path(f"/proc/{pid}").exists() and time.monotonic() < end:
        time.sleep(0.05)
    assert not Path(f"/proc/{pid}").exists()
