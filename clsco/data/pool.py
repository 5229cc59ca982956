"""Pool of processes on this machine that make the shards of a set. Each process uses one device."""

from __future__ import annotations

import logging
import os
import signal
import threading
import time
import warnings
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, MutableMapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from types import FrameType
from typing import TYPE_CHECKING, Any, NoReturn

from clsco.data.failures import failure_of
from clsco.data.storage import open_storage, remove_path
from clsco.engine.child import Child, at_forced_end, how_ended
from clsco.errors import ClscoError
from clsco.resources import processors, resident_bytes

if TYPE_CHECKING:
    from clsco.data.shards import SetJob, ShardMaker
    from clsco.opencl.device import Device

_LOG = logging.getLogger("clsco")
RECYCLED_SHARDS = 32  # number of shards after which a process is replaced, because drivers leak memory
END_S = 20.0  # s after which a process that was asked to end is killed
# The wheel of PoCL 3.0 reads the first variable, later versions of PoCL read the second one.
_THREAD_VARIABLES = (
    "POCL_MAX_PTHREAD_COUNT", "POCL_CPU_MAX_CU_COUNT", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS",
)  # fmt: skip


@dataclass(frozen=True)
class Place:
    """Device of a worker process; threads: limit of its CPU threads, 0 for no limit."""

    device: DeviceName
    threads: int = 0


Advance = Callable[[int], object]  # called with the number of samples made since its last call


@dataclass
class _Worker:
    child: Child
    place: Place
    is_ready: bool = False
    is_leaving: bool = False
    task: ShardTask | None = None
    shards: int = 0


def places(devices: Sequence[tuple[DeviceName, bool]], workers: int | None) -> list[Place]:
    """List the places of worker processes.

    devices: names, each with True for a processor. workers: number of processes, which are spread over the devices;
    None for one per graphics card, and one per core of a processor.
    """
    cores = processors()
    if workers is None:
        counts = [cores if is_cpu else 1 for _, is_cpu in devices]
    else:
        counts = [len(range(k, workers, len(devices))) for k in range(len(devices))]
    return [
        Place(device, max(1, cores // count) if is_cpu else 0)
        for (device, is_cpu), count in zip(devices, counts, strict=True)
        for _ in range(count)
    ]


def run_pool(job: SetJob, shards: Sequence[int], where: Sequence[Place], advance: Advance, memory: int) -> None:
    """Make shards in one process per place. A process that uses more than `memory` bytes after a shard is replaced.

    Raises ClscoError if no process starts, a device is of another family, the storage fails, or a shard cannot be made.
    """
    _Pool(job, shards, where, advance, memory).run()


class _Pool:
    def __init__(
        self, job: SetJob, shards: Sequence[int], where: Sequence[Place], advance: Advance, memory: int
    ) -> None:
        self.job, self.advance, self.memory = job, advance, memory
        self.schedule = Schedule((shard, job.numbers(shard)) for shard in shards)
        self.where = list(where[: max(1, len(shards))])
        self.workers: list[_Worker] = []
        self.seen: dict[int, int] = {}
        self.failed_starts = 0

    def run(self) -> None:
        with stoppable():
            try:
                self.workers = [self._start(place) for place in self.where]
                while not self.schedule.is_over:
                    self._step()
            finally:
                self._end()

    def _start(self, place: Place) -> _Worker:
        environ = dict(os.environ)
        if place.threads:
            limit_threads(place.threads, environ)
        child = Child(run_worker, self.job, place.device, not place.threads, environ=environ)
        _LOG.info("process %d: makes shards", child.pid)
        return _Worker(child, place)

    def _step(self) -> None:
        """Send tasks to idle processes, wait for messages of processes, and handle these."""
        for worker in self.workers:
            if worker.is_ready and worker.task is None and not worker.is_leaving and self.schedule.waiting:
                worker.task = self.schedule.waiting.popleft()
                worker.child.send(worker.task)
        readable = wait([worker.child.pipe for worker in self.workers])
        for worker in [worker for worker in self.workers if worker.child.pipe in readable]:
            try:
                self._handle_message(worker, worker.child.pipe.recv())
            except (EOFError, OSError):
                self._on_worker_exit(worker)

    def _handle_message(self, worker: _Worker, message: tuple[Any, ...]) -> None:
        kind, *content = message
        if kind == "fatal":
            raise ClscoError(content[0])
        if kind == "ready":
            worker.is_ready, self.failed_starts = True, 0
        elif kind == "progress":
            self._count(*content)
        else:
            task, worker.task = worker.task, None
            assert task is not None
            if kind == "failed":
                self.schedule.died(task, content[0])
                worker.is_leaving = True  # the driver may be lost, but only in this process
            else:
                self.schedule.done(task)
                if task.tried is None:
                    self._count(task.shard, len(self.job.numbers(task.shard)))
                worker.shards += 1
                worker.is_leaving = worker.shards >= RECYCLED_SHARDS or content[0] > self.memory
            if worker.is_leaving:
                worker.child.send(None)

    def _count(self, shard: int, done: int) -> None:
        before = self.seen.get(shard, 0)
        if done > before:
            self.seen[shard] = done
            self.advance(done - before)

    def _on_worker_exit(self, worker: _Worker) -> None:
        """Handle the end of a process: record its task as failed, and start another process in its place."""
        status = worker.child.end(END_S)
        if not worker.is_leaving:
            _LOG.info("process %d: ended with %s", worker.child.pid, how_ended(status))
        self.workers.remove(worker)
        open_storage(self.job.where).tidy()
        if worker.task is not None:
            self.schedule.died(worker.task)
        elif not worker.is_ready:
            self.failed_starts += 1
            if self.failed_starts >= RETRIES * len(self.where):
                raise ClscoError(f"worker: a process must start and find its device; got {how_ended(status)}")
        if not self.schedule.is_over:
            self.workers.append(self._start(worker.place))

    def _end(self) -> None:
        for worker in self.workers:
            if self.schedule.is_over:
                worker.child.send(None)
            else:
                worker.child.terminate()
        statuses = [worker.child.end(END_S) for worker in self.workers]
        if any(statuses):
            with suppress(ClscoError):
                open_storage(self.job.where).tidy()


@contextmanager
def stoppable() -> Iterator[None]:
    """Make SIGTERM raise SystemExit in the block, unless the program handles SIGTERM itself."""
    if threading.current_thread() is not threading.main_thread() or signal.getsignal(signal.SIGTERM) != signal.SIG_DFL:
        yield
        return

    before = signal.signal(signal.SIGTERM, _exit)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _exit(number: int, _: FrameType | None) -> NoReturn:
    warnings.simplefilter("ignore")  # libraries warn of coroutines that are dropped unawaited
    raise SystemExit(128 + number)


def limit_threads(count: int, environ: MutableMapping[str, str]) -> None:
    """Limit, by environment variables, the threads of libraries that read them: in this process or in a new one."""
    for name in _THREAD_VARIABLES:
        environ.setdefault(name, str(count))


REPORT_S = 0.2  # s between reports on the progress of a shard

DeviceName = str | int | None
"""Part of a device's name, as for `clsco.render`; or the number of the device, as several may have one name."""


def run_worker(pipe: Connection, job: SetJob, name: DeviceName, overlapped: bool) -> None:
    """Receive tasks through the pipe, run them, and send results back, until the parent sends None or ends.

    name: device; overlapped: as for `ShardMaker`.
    """
    signal.signal(signal.SIGTERM, _exit)  # so that no file is written after `close` removes all files
    storage = open_storage(job.where)
    at_forced_end(storage.close)
    try:
        device = device_of(name)
        from clsco.data.shards import ShardMaker

        maker = ShardMaker(job, storage, device, overlapped)
        pipe.send(("ready",))
        while (task := pipe.recv()) is not None:
            pipe.send(_answer(maker, task, pipe))
    except (ClscoError, OSError) as error:
        pipe.send(("fatal", failure_of(error, job.where)[1]))
    finally:
        storage.close()


def device_of(name: DeviceName) -> Device:
    """The device with a name or number. Raises DeviceError if there is none."""
    from clsco.opencl.device import choose, list_devices

    return list_devices()[0][name] if isinstance(name, int) else choose(name, "device")


def perform(maker: ShardMaker, task: ShardTask, advance: Any = lambda: None) -> None:
    """Run a task: deliver its shard, or, if only some samples are tried, drop their files."""
    made = maker.make(task.shard, task.tried, dict(task.failed), advance)
    if task.tried is None:
        maker.deliver(made, {"pid": os.getpid(), "device": str(maker.renderer.device), "rss": resident_bytes()})
    else:
        for path in made.files.values():
            remove_path(path)


def _answer(maker: ShardMaker, task: ShardTask, pipe: Connection) -> tuple[Any, ...]:
    count, reported = 0, time.monotonic()

    def advance() -> None:
        nonlocal count, reported
        count += 1
        if task.tried is None and time.monotonic() > reported + REPORT_S:
            reported = time.monotonic()
            pipe.send(("progress", task.shard, count))

    try:
        perform(maker, task, advance)
    except Exception as error:  # any error is reported to the parent, which continues
        return failure_of(error, maker.storage.where)
    return "done", resident_bytes()


RETRIES, RETRIES_OF_ERROR = 3, 2
"""Attempts at a task before it counts as failed: if its process dies each time, and if an attempt reports an error."""
DIED = f"sample: must be made; got a process that ended, {RETRIES} times"


@dataclass(frozen=True)
class ShardTask:
    """A shard to make. failed: numbers and messages of samples to skip; tried: None, or the only samples to make, which
    are then dropped: this finds samples that fail.
    """

    shard: int
    tried: range | None = None
    failed: tuple[tuple[int, str], ...] = ()


class Schedule:
    """Schedule of the shards of a set; shards: number of each shard, and its sample numbers.

    If all attempts at a shard fail, the shard is bisected to find the samples that fail by themselves, and is then made
    without these.
    """

    def __init__(self, shards: Iterable[tuple[int, range]]) -> None:
        self.samples = dict(shards)
        self.waiting = deque(ShardTask(shard) for shard in self.samples)
        self._deaths: Counter[ShardTask] = Counter()
        self._trials: Counter[int] = Counter()  # by shard, number of trials that wait or run
        self._rounds: Counter[int] = Counter()  # by shard, number of bisections
        self._failed: dict[int, dict[int, str]] = {}
        self._left = len(self.samples)

    @property
    def is_over(self) -> bool:
        return self._left == 0

    def done(self, task: ShardTask) -> None:
        if task.tried is None:
            self._left -= 1
        else:
            self._after_trial(task.shard)

    def died(self, task: ShardTask, cause: str | None = None) -> None:
        """Record that a task failed; cause: message of the error, None if the process died.

        Raises ClscoError if a shard fails although each of its samples succeeds by itself.
        """
        self._deaths[task] += 1
        again = self._deaths[task] < (RETRIES if cause is None else RETRIES_OF_ERROR)
        if task.tried is None:
            numbers = self.samples[task.shard]
            if again:
                self.waiting.appendleft(task)
            elif self._rounds[task.shard] == RETRIES or not numbers:
                rule = "must be made, as each of its samples by itself was"
                raise ClscoError(f"shard {task.shard}: {rule}; got {cause or DIED}")
            else:
                self._rounds[task.shard] += 1
                self._failed.setdefault(task.shard, {})
                self._try(task.shard, numbers)
        elif len(task.tried) > 1:
            middle = task.tried.start + len(task.tried) // 2
            self._try(task.shard, range(task.tried.start, middle))
            self._try(task.shard, range(middle, task.tried.stop))
            self._after_trial(task.shard)
        elif again:
            self.waiting.appendleft(task)
        else:
            self._failed[task.shard][task.tried.start] = cause or DIED
            self._after_trial(task.shard)

    def _try(self, shard: int, numbers: range) -> None:
        self._trials[shard] += 1
        self.waiting.append(ShardTask(shard, numbers))

    def _after_trial(self, shard: int) -> None:
        self._trials[shard] -= 1
        if not self._trials[shard]:
            self.waiting.appendleft(ShardTask(shard, failed=tuple(sorted(self._failed[shard].items()))))
