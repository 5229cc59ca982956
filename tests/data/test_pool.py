"""Processes of one machine: what they make is what one process makes, also where some of them die."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest

from clsco.data import pool
from clsco.data.pool import Place, places, run_pool
from clsco.data.shards import SetJob
from clsco.errors import ClscoError
from tests.data.fakes import job_of, make_here
from tests.data.test_shards import files

MEMORY = 2**34


def run(job: SetJob, workers: int, shards: int) -> int:
    """Make all shards; the number of samples that were counted."""
    counted: list[int] = []
    run_pool(job, range(shards), [Place(None, 1)] * workers, counted.append, MEMORY)
    return sum(counted)


def test_a_worker_that_is_killed_costs_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    handle, killed = pool._Pool._handle_message, list[int]()

    def handle_and_kill(self: pool._Pool, worker: pool._Worker, message: tuple[object, ...]) -> None:
        handle(self, worker, message)
        if message[0] == "ready" and not killed:
            process = worker.child.pid
            assert process is not None
            killed.append(process)
            os.kill(process, signal.SIGKILL)

    monkeypatch.setattr(pool._Pool, "_handle_message", handle_and_kill)
    make_here(job_of(tmp_path / "one", 10))
    assert run(job_of(tmp_path / "two", 10), 1, 3) == 10
    assert killed
    assert files(tmp_path / "one") == files(tmp_path / "two")
    assert not list((tmp_path / "two").glob(".*"))
    assert "POCL_MAX_PTHREAD_COUNT" not in os.environ


@pytest.mark.slow
def test_a_sample_that_ends_its_process_is_left_out(tmp_path: Path) -> None:
    job = job_of(tmp_path / "one", 16, deadly=frozenset({5}), undrawable=frozenset({2}))
    assert run(job, 2, 4) == 16
    assert '"failed":1' in (tmp_path / "one" / "manifest" / "000001.jsonl").read_text()
    run(job_of(tmp_path / "two", 16, deadly=frozenset({5}), undrawable=frozenset({2})), 1, 4)
    assert files(tmp_path / "one") == files(tmp_path / "two")


@pytest.mark.slow
def test_what_no_other_process_would_do_better_ends_the_run(tmp_path: Path) -> None:
    (tmp_path / "set").mkdir()
    (tmp_path / "set" / "data").write_bytes(b"")  # where a folder must be
    with pytest.raises(ClscoError, match="the data set must be writable and readable; got"):
        run(job_of(tmp_path / "set", 10), 2, 3)
    assert not list((tmp_path / "set").glob(".*"))
    with pytest.raises(ClscoError, match="device: must be a part of the name"):
        run_pool(job_of(tmp_path / "no", 4), range(1), [Place("nosuch")], print, MEMORY)


def test_processes_share_the_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pool, "processors", lambda: 8)
    assert places([(0, True)], None) == [Place(0, 1)] * 8
    assert places([(0, True)], 3) == [Place(0, 2)] * 3
    assert places([(1, False), (2, False)], None) == [Place(1), Place(2)]
    assert places([(1, False), (2, False)], 3) == [Place(1), Place(1), Place(2)]
