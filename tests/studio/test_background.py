"""Background tasks of the studio go on after errors, and the page is told."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("starlette", reason="needs the extra studio")

from clsco.errors import FileError
from clsco.studio import background, server
from clsco.studio.background import keep_running
from clsco.studio.jobs import Jobs
from clsco.studio.server import Studio, Tab
from tests.studio.test_jobs import until


class Reports:
    """Messages that a page was told."""

    def __init__(self) -> None:
        self.messages: list[str] = []

    async def add(self, messages: list[str]) -> None:
        self.messages += messages

    async def tell(self, error: list[str]) -> None:
        self.messages += error


async def run_for(task: Awaitable[None], is_done: Callable[[], bool]) -> None:
    running = asyncio.ensure_future(task)
    try:
        await until(is_done, 10.0)
    finally:
        running.cancel()


@pytest.fixture(autouse=True)
def _without_pauses(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(background, "PAUSE", 0.0)
    monkeypatch.setattr(server, "TICK", 0.0)


@pytest.mark.parametrize("errors", [[OSError(28, "No space left on device")] * 3, [ValueError("a"), KeyError("b")]])
def test_a_task_goes_on_and_each_error_is_told_once(errors: list[Exception], capsys: Any) -> None:
    left, reports, runs = list(errors), Reports(), list[int]()

    async def task() -> None:
        await asyncio.sleep(0)
        runs.append(1)
        if left:
            raise left.pop(0)

    asyncio.run(run_for(keep_running(task, reports.add), lambda: len(runs) > len(errors) + 2))
    told = dict.fromkeys(f"studio: must not fail; got {type(error).__name__}: {error}" for error in errors)
    assert reports.messages == list(told)
    assert capsys.readouterr().err.count("Traceback") == len(told)


def test_an_error_that_ends_a_task_is_not_told() -> None:
    reports = Reports()

    async def task() -> None:
        raise EOFError

    asyncio.run(keep_running(task, reports.add, (EOFError,)))
    assert reports.messages == []


def test_scenes_are_kept_after_a_full_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The disk is full for a moment: `Studio.watch` goes on, and all open tabs are told."""
    studio, kept, reports = Studio(tmp_path), list[str](), Reports()
    tab = studio.tabs["tab"] = Tab(studio.new_session())
    tab.preview = reports  # type: ignore[assignment]

    def keep() -> None:
        kept.append("")
        if len(kept) == 1:
            raise OSError(28, "No space left on device")

    monkeypatch.setattr(studio, "keep", keep)
    asyncio.run(run_for(keep_running(studio.watch, studio.report), lambda: len(kept) > 3))
    assert reports.messages == ["studio: must not fail; got OSError: [Errno 28] No space left on device"]


@pytest.mark.parametrize("error", [FileError("a"), RuntimeError("b"), KeyError()])
def test_a_job_that_raises_has_failed(error: Exception, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    async def work(*_: object) -> str:
        raise error

    async def run() -> None:
        jobs = Jobs(tmp_path)
        monkeypatch.setattr(jobs, "_work", work)
        job = jobs.add("a job", ["plan", "scene.toml"], "out")
        await until(lambda: not job.is_unfinished, 10.0)
        assert (job.status, job.message) == ("failed", f"clsco: must run; got {error or type(error).__name__}")

    asyncio.run(run())
