"""Work of the studio that takes long: command lines of `clsco` in processes of their own, one at a time.

They go on when the studio ends, and the next one finds them: `jobs.json` in the user's own state folder says what was
begun, a file beside it how each process ended. Nothing of this is in the studio's folder: one from strangers has no
commands run.
"""

from __future__ import annotations

import contextlib
import json
import os
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Literal

from clsco.errors import ClscoError
from clsco.resources import group_runs, process_began, remove_left
from clsco.studio.session import StateFolder

LIST = "jobs.json"
LARGEST = 2**23  # bytes of the list
MOST = 500  # jobs in it; of those that are finished the oldest go
GRACE = 10.0  # seconds that a canceled command has to end
_TAIL = 4000  # bytes of what a command said
_TITLE = 200  # characters
# The end of a command goes to a file, as who began it may be gone by then; ^C is for the command alone.
_SHELL = 'trap : INT TERM; "$@"; printf %s "$?" > "$0.part" && mv "$0.part" "$0"'
_FOLLOWED, _PROGRESS = ("--progress", "json"), '{"progress"'  # which `clsco.cli.progress` prints
_PYTHON = (sys.executable, "-P", "-c", "from clsco.cli.process import run; run()")

Status = Literal["waiting", "running", "done", "failed", "canceled", "interrupted"]
UNFINISHED = ("waiting", "running")


@dataclass(frozen=True)
class CommandJob:
    """One command.

    Attributes
    ----------
    number : int
    title : str
    arguments : tuple of str
        Arguments of `clsco`; paths are relative to the root.
    folder : str
        Folder of its files, relative to the root.
    pattern : str
        Pattern of its files in the folder, or the name of its one file.
    total : int
        Expected number of frames or samples; 0 where nobody knows.
    status : str
    done : int
        Frames or samples that are there.
    began, ended : float
        Seconds since 1970; 0 before.
    process, process_began : int
        Process of the running command, by number and start time, as numbers come again.
    message : str
        Message on what went wrong.
    """

    number: int
    title: str
    arguments: tuple[str, ...]
    folder: str
    pattern: str
    total: int
    status: Status = "waiting"
    done: int = 0
    began: float = 0.0
    ended: float = 0.0
    process: int = 0
    process_began: float = 0.0
    message: str = ""

    @property
    def line(self) -> str:
        """The command line, to be run in the root."""
        return shlex.join(["clsco", *self.arguments])

    @property
    def command(self) -> str:
        """Command of `clsco`: "render", "video", "dataset", "inpaint"."""
        return self.arguments[0]

    @property
    def is_unfinished(self) -> bool:
        return self.status in UNFINISHED

    def seconds_left(self, now: float) -> float | None:
        """Estimate of the time left, by the share that is done; None where there is none yet."""
        if self.status != "running" or not 0 < self.done < self.total:
            return None
        return (now - self.began) / self.done * (self.total - self.done)


class Jobs:
    """The commands of a studio, in the order in which they were asked for.

    Parameters
    ----------
    root : Path
        Folder that all of them work in.
    environment : mapping, optional
        Variables of the processes, besides those of this one.

    Attributes
    ----------
    state : StateFolder
        Files that are kept for the next studio.

    Raises
    ------
    ClscoError
        Another studio has the folder.
    """

    def __init__(self, root: Path, environment: Mapping[str, str] | None = None) -> None:
        self.root = root.resolve()
        self._environment = {**os.environ, **(environment or {})}
        self.state = StateFolder(self.root)
        self._listeners: list[Callable[[], None]] = []
        self._canceled: dict[int, float] = {}
        self._processes: dict[int, subprocess.Popen[bytes]] = {}
        self._jobs = _read(self.state)

    @property
    def listed(self) -> tuple[CommandJob, ...]:
        """All jobs, the last one first."""
        return tuple(reversed(self._jobs))

    def subscribe(self, listener: Callable[[], None]) -> Callable[[], None]:
        """Have a function called after each change; returns what ends it."""
        self._listeners.append(listener)
        return lambda: self._listeners.remove(listener) if listener in self._listeners else None

    def add(self, title: str, arguments: Sequence[str], folder: str, pattern: str, total: int) -> CommandJob:
        """Begin a command, or have it wait for those before.

        Raises ClscoError: the folder is not below the root, or another command that is not done writes to it.
        """
        self.require_free(folder)
        number = 1 + max((job.number for job in self._jobs), default=0)
        self._put(CommandJob(number, title[:_TITLE], tuple(arguments), folder, pattern, total))
        self.poll()
        return self.job(number)

    def require_free(self, folder: str) -> None:
        """Raise ClscoError where a folder is not below the root, or a command that is not done writes to it."""
        target = (self.root / folder).resolve()
        if not target.is_relative_to(self.root) or target.is_relative_to(self.state.path) or target == self.root:
            raise ClscoError(f"output folder: must be below the folder of the studio; got {folder!r}")
        for other in self._jobs:
            if other.is_unfinished and (self.root / other.folder).resolve() == target:
                raise ClscoError(f"output folder: job {other.number} writes to it already; got {folder!r}")

    def job(self, number: int) -> CommandJob:
        """A job by its number. Raises KeyError."""
        return {job.number: job for job in self._jobs}[number]

    def cancel(self, number: int) -> None:
        """End a job. Files that are whole stay, others go."""
        job = self.job(number)
        if job.status == "waiting":
            self._put(replace(job, status="canceled", ended=time.time()))
        elif job.status == "running":
            self._canceled.setdefault(number, time.monotonic())
            _signal(job, signal.SIGINT, number in self._processes)
        self.poll()

    def again(self, number: int) -> CommandJob:
        """Run a finished job once more; frames that are whole are left out."""
        job = self.job(number)
        arguments = job.arguments
        if job.command == "render" and "--resume" not in arguments:
            arguments = (*arguments, "--resume")
        return self.add(job.title, arguments, job.folder, job.pattern, job.total)

    def forget(self, number: int) -> None:
        """Take a finished job off the list; its files stay."""
        job = self.job(number)
        if not job.is_unfinished:
            self._jobs = [other for other in self._jobs if other.number != number]
            self._drop(job)
            self._write()
            self._tell()

    def files(self, number: int) -> list[Path]:
        """List the pictures and clips that a job has made, by name."""
        folder = self.root / self.job(number).folder
        found: list[Path] = []
        for place, folders, names in os.walk(folder):  # passes over folders of unfinished work, which may go meanwhile
            folders[:] = [name for name in folders if not name.startswith(".")]
            found += [Path(place) / name for name in names if not name.startswith(".")]
        return sorted(path for path in found if path.suffix in (".png", ".mp4", ".webm"))

    def poll(self) -> None:
        """Look at the running command, and begin the next one; to be called every half second or so."""
        changed = False
        for job in [job for job in self._jobs if job.status == "running"]:
            changed |= self._look_at(job)
        if not any(job.status == "running" for job in self._jobs):
            waiting = [job for job in self._jobs if job.status == "waiting"]
            if waiting:
                self._begin(waiting[0])
                changed = True
        if changed:
            self._tell()

    def close(self) -> None:
        """Let go of the folder; a running command goes on."""
        self.state.close()

    def _drop(self, job: CommandJob) -> None:
        """Remove what a job has said."""
        self.state.remove(_log(job), _end(job), f"{_end(job)}.part")

    def _begin(self, job: CommandJob) -> None:
        self._drop(job)
        command = ["sh", "-c", _SHELL, str(self.state.path / _end(job)), *_PYTHON, *job.arguments, *_FOLLOWED]
        try:
            with open(self.state.path / _log(job), "xb") as log:
                process = subprocess.Popen(
                    command, cwd=self.root, env=self._environment, stdin=subprocess.DEVNULL, stdout=log, stderr=log,
                    start_new_session=True,
                )  # fmt: skip
        except OSError as error:
            self._put(replace(job, status="failed", message=f"{error.strerror}", ended=time.time()))
            return
        self._processes[job.number] = process
        now = time.time()
        self._put(
            replace(
                job, status="running", began=now, process=process.pid, process_began=process_began(process.pid) or 0.0
            )
        )

    def _look_at(self, job: CommandJob) -> bool:
        """Bring a running job up to date; whether it changed."""
        process = self._processes.get(job.number)
        if process is not None:
            process.poll()  # so that it does not stay as a zombie
        is_alive = process_began(job.process) == job.process_began and (process is None or process.returncode is None)
        if process is not None:  # the shell may end before the command, if it is killed
            is_alive = is_alive or group_runs(job.process)
        since = self._canceled.get(job.number)
        if is_alive and since is not None and time.monotonic() - since > GRACE:
            _signal(job, signal.SIGKILL, process is not None)
        done = self._count(job)
        if is_alive:
            if done == job.done:
                return False
            self._jobs = [replace(job, done=done) if other.number == job.number else other for other in self._jobs]
            return True
        code = self._code(job)
        if since is not None and code != 0:
            status: Status = "canceled"
        elif code is None:
            status = "interrupted"
        else:
            status = "done" if code == 0 else "canceled" if code == 130 else "failed"
        _remove_parts(self.root, job.folder)
        message = "" if status == "done" else self._said(job)
        if (ended := self._processes.pop(job.number, None)) is not None:
            ended.wait()
        self._canceled.pop(job.number, None)
        self._put(replace(job, status=status, done=done, ended=time.time(), message=message))
        return True

    def _count(self, job: CommandJob) -> int:
        """Files or samples that are made, by the last line of progress; a command that goes on counts what is left."""
        for line in reversed(self._tail(job)):
            if line.startswith(_PROGRESS):
                with contextlib.suppress(ValueError, KeyError, TypeError, ZeroDivisionError):
                    said = json.loads(line)
                    if said["progress"] == "percent":
                        return int(job.total * said["done"] // said["total"])
                    return max(job.total - said["total"] + said["done"], 0) if job.total else int(said["done"])
        return job.done

    def _code(self, job: CommandJob) -> int | None:
        """Exit status of a command that ended, None where it was killed with all that was around it."""
        try:
            return int(self.state.read(_end(job), 16))
        except (OSError, ValueError):
            return None

    def _said(self, job: CommandJob) -> str:
        """The end of what a command said."""
        return "\n".join([line for line in self._tail(job) if not line.startswith(_PROGRESS)][-8:])

    def _tail(self, job: CommandJob) -> list[str]:
        try:
            return self.state.tail(_log(job), _TAIL).decode(errors="replace").strip().splitlines()
        except OSError:
            return []

    def _put(self, job: CommandJob) -> None:
        """Take a job in place of that of its number, or as the last one, on the disk, too."""
        others = [job if other.number == job.number else other for other in self._jobs]
        self._jobs = others if job in others else [*others, job]
        for old in [other for other in self._jobs if not other.is_unfinished][: max(len(self._jobs) - MOST, 0)]:
            self._jobs.remove(old)
            self._drop(old)
        self._write()
        self._tell()

    def _write(self) -> None:
        listed = [asdict(job) for job in self._jobs]
        self.state.write(LIST, json.dumps(listed, indent=1).encode())

    def _tell(self) -> None:
        for listener in tuple(self._listeners):
            listener()


def _log(job: CommandJob) -> str:
    return f"job_{job.number}.log"


def _end(job: CommandJob) -> str:
    return f"job_{job.number}.end"


def _read(state: StateFolder) -> list[CommandJob]:
    """Jobs of a list; none where it is not what a studio wrote."""
    try:
        listed = json.loads(state.read(LIST, LARGEST))
        return [CommandJob(**{**entry, "arguments": tuple(entry["arguments"])}) for entry in listed]
    except (OSError, ValueError, TypeError, KeyError, RecursionError):
        return []


def _signal(job: CommandJob, number: signal.Signals, is_ours: bool) -> None:
    """Send a signal to the group of a job's command, if that is still the one; is_ours: this process began it."""
    if job.process and (process_began(job.process) == job.process_began or (is_ours and group_runs(job.process))):
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(job.process, number)


def _remove_parts(root: Path, folder: str) -> None:
    """Remove temporary files and folders of commands that were killed while they wrote below the root."""
    if not (root / folder).resolve().is_relative_to(root):  # it may be another folder by now
        return
    for place in {path.parent for path in (root / folder).rglob(".*.part")}:
        remove_left(place)
