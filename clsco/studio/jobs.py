"""Long tasks of the studio: command lines of `clsco` in child processes, one at a time."""

from __future__ import annotations

import asyncio
import itertools
import json
import os
import shlex
import signal
import sys
import time
from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal

from clsco.engine.child import how_ended
from clsco.errors import ClscoError
from clsco.studio.background import Observable

MOST = 500  # jobs in the list; beyond it, the oldest finished jobs are removed
PAUSE = 4.0  # time without news of progress, in times that telling it took: pages list all pictures
GRACE = 10.0  # s that a canceled command has to end
RESULTS = (".png", ".mp4", ".webm")
_LONGEST_LINE = 2**20  # bytes of a line that a command prints
_PROGRESS = ("--progress", "json")
_COMMAND = (sys.executable, "-P", "-c", "from clsco.cli.process import run; run()")

Status = Literal["waiting", "running", "done", "failed", "canceled"]


@dataclass(eq=False)
class CommandJob:
    """A command line that the studio runs: arguments of `clsco`, and the folder or file that the command writes.

    Paths are relative to the studio's root. done, total: numbers of frames or samples, 0 while unknown. began: s since
    1970. message: error output, "" without an error.
    """

    number: int
    title: str
    arguments: tuple[str, ...]
    output: str
    status: Status = "waiting"
    done: int = 0
    total: int = 0
    began: float = 0.0
    message: str = ""

    @property
    def line(self) -> str:
        """The command line, to run in the root."""
        return shlex.join(["clsco", *self.arguments])

    @property
    def command(self) -> str:
        """Command of `clsco`: "render" or "dataset"."""
        return self.arguments[0]

    @property
    def is_unfinished(self) -> bool:
        return self.status in ("waiting", "running")

    def seconds_left(self, now: float) -> float | None:
        """Estimated time left in s, from the fraction done; None while unknown."""
        if self.status != "running" or not 0 < self.done < self.total:
            return None
        return (now - self.began) / self.done * (self.total - self.done)


class Jobs(Observable):
    """The commands of a studio, which run in its root and end with the studio. listed: all jobs, latest first."""

    def __init__(self, root: Path) -> None:
        super().__init__()
        self.root = root.resolve()
        self.listed: list[CommandJob] = []
        self._numbers = itertools.count(1)
        self._turn = asyncio.Lock()
        self._tasks: dict[int, asyncio.Task[None]] = {}
        self._next = 0.0  # time at which progress is told again

    def add(self, title: str, arguments: Sequence[str], output: str) -> CommandJob:
        """Start a command, or enqueue it behind others. Raises ClscoError as `require_free`."""
        self.require_free(output)
        job = CommandJob(next(self._numbers), title[:200], tuple(arguments), output)
        self.listed.insert(0, job)
        for old in [old for old in self.listed[MOST:] if not old.is_unfinished]:
            self.listed.remove(old)
        self._start(job)
        return job

    def require_free(self, output: str) -> None:
        """Raise ClscoError if an output is not below the root, or an unfinished job writes to it."""
        target = (self.root / output).resolve()
        if not target.is_relative_to(self.root) or target == self.root:
            raise ClscoError(f"output folder: must be below the folder of the studio; got {output!r}")
        for other in self.listed:
            if other.is_unfinished and (self.root / other.output).resolve() == target:
                raise ClscoError(f"output folder: job {other.number} writes to it already; got {output!r}")

    def job(self, number: int) -> CommandJob:
        """A job by its number. Raises KeyError."""
        return {job.number: job for job in self.listed}[number]

    def cancel(self, job: CommandJob) -> None:
        """Cancel a job. Finished files stay, unfinished files are removed."""
        task = self._tasks.get(job.number)
        if task is not None and not task.cancelling():  # a second request would interrupt the command's end
            task.cancel()

    def run_again(self, job: CommandJob) -> None:
        """Run a finished job again, skipping existing frames and samples. Raises ClscoError."""
        if not job.is_unfinished:
            self.require_free(job.output)
            job.status, job.done, job.total, job.message = "waiting", 0, 0, ""
            job.arguments += () if "--resume" in job.arguments else ("--resume",)
            self._start(job)

    def forget(self, job: CommandJob) -> None:
        """Remove a finished job from the list; its files stay."""
        if not job.is_unfinished and job in self.listed:
            self.listed.remove(job)
            self._tell()

    def results(self, job: CommandJob) -> list[Path]:
        """Paths of the pictures and clips that a job has written, sorted."""
        paths: list[Path] = []
        for place, folders, names in os.walk(self.root / job.output):  # hidden: unfinished files, which may vanish
            folders[:] = [name for name in folders if not name.startswith(".")]
            paths += [Path(place) / name for name in names if not name.startswith(".")]
        return sorted(path for path in paths if path.suffix in RESULTS)

    async def close(self) -> None:
        """Cancel all jobs, and wait until they end."""
        for job in self.listed:
            self.cancel(job)
        await asyncio.gather(*self._tasks.values(), return_exceptions=True)

    def _start(self, job: CommandJob) -> None:
        task = self._tasks[job.number] = asyncio.create_task(self._run(job))
        task.add_done_callback(partial(self._on_end, job))
        self._tell()

    def _on_end(self, job: CommandJob, task: asyncio.Task[None]) -> None:
        if task.cancelled():  # perhaps before it began
            job.status = "canceled"
        self._tasks.pop(job.number, None)
        self._tell()

    async def _run(self, job: CommandJob) -> None:
        async with self._turn:
            job.status, job.began = "running", time.time()
            self._tell()
            try:
                job.message = await self._work(job)
            except Exception as error:  # it cannot be started, or prints too long a line
                job.message = f"clsco: must run; got {error or type(error).__name__}"
            job.status = "failed" if job.message else "done"

    async def _work(self, job: CommandJob) -> str:
        """Run the command of a job; returns its error output if it failed, else ""."""
        process = await asyncio.create_subprocess_exec(
            *_COMMAND, *job.arguments, *_PROGRESS, cwd=self.root, start_new_session=True, limit=_LONGEST_LINE,
            stdin=asyncio.subprocess.DEVNULL, stdout=asyncio.subprocess.DEVNULL, stderr=asyncio.subprocess.PIPE,
        )  # fmt: skip
        assert process.stderr is not None
        last: deque[str] = deque(maxlen=8)
        try:
            async for line in process.stderr:
                text = line.decode(errors="replace").rstrip()
                if not self._follow(job, text):
                    last.append(text)
            status = await process.wait()
        finally:
            await _end(process)
        return "" if status == 0 else "\n".join(last) or f"clsco: must not fail; got {how_ended(status)}"

    def _follow(self, job: CommandJob, text: str) -> bool:
        """Update the job from a line of progress, as `clsco.cli.progress` prints it; False for other lines."""
        if not text.startswith('{"progress"'):
            return False
        with suppress(ValueError, KeyError, TypeError):
            progress = json.loads(text)
            job.done, job.total = int(progress["done"]), int(progress["total"])
            if (start := time.monotonic()) >= self._next or job.done == job.total:
                self._tell()
                self._next = time.monotonic() + PAUSE * (time.monotonic() - start)
        return True


async def _end(process: asyncio.subprocess.Process) -> None:
    """End a running command as Ctrl-C does, then kill its remaining processes, after at most GRACE.

    The signal is SIGTERM: in a studio that a script starts in the background, all commands ignore SIGINT.
    """
    if process.returncode is not None:
        return
    ended = asyncio.ensure_future(process.wait())
    for send, number, patience in ((os.kill, signal.SIGTERM, GRACE), (os.killpg, signal.SIGKILL, None)):
        with suppress(ProcessLookupError):
            send(process.pid, number)
        # Not `asyncio.timeout`: in Python 3.11.2 it ends a task that is being canceled.
        await asyncio.wait([ended], timeout=patience)
