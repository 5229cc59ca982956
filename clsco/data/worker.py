"""A process that makes shards on one device, which its parent assigns."""

from __future__ import annotations

import os
import resource
import signal
import sys
import time
from multiprocessing.connection import Connection
from types import FrameType
from typing import TYPE_CHECKING, Any

from clsco.data.schedule import ShardTask
from clsco.data.storage import open_storage
from clsco.engine.child import at_forced_end
from clsco.errors import ClscoError

if TYPE_CHECKING:
    from clsco.data.shards import SetJob, ShardMaker
    from clsco.opencl.device import Device

REPORT_S = 0.2  # between reports of how far a shard has come

DeviceName = str | int | None
"""Part of a name as for `clsco.render`, or the number of a device among all, where several have one name."""


def run_worker(pipe: Connection, job: SetJob, name: DeviceName, overlapped: bool) -> None:
    """Make what comes through the pipe, and report it there, until the parent says None or ends."""
    signal.signal(signal.SIGTERM, _ended)  # so that no file is written any more when all are removed
    storage = open_storage(job.where)
    at_forced_end(storage.close)
    try:
        device = device_of(name)
        from clsco.data.shards import ShardMaker, device_family

        maker = ShardMaker(job, storage, device, overlapped)
        pipe.send(("ready", device_family(device)))
        while (task := pipe.recv()) is not None:
            pipe.send(_answer(maker, task, pipe))
    except (ClscoError, OSError) as error:
        pipe.send(("fatal", str(error)))
    finally:
        storage.close()


def device_of(name: DeviceName) -> Device:
    """The device of a name or number. Raises DeviceError where there is none."""
    from clsco.opencl.device import choose, list_devices

    return list_devices()[0][name] if isinstance(name, int) else choose(name, "device")


def perform(maker: ShardMaker, task: ShardTask, advance: Any = lambda: None) -> tuple[int, int]:
    """Do a task; the number of samples made, and of those that failed."""
    made = maker.make(task.shard, task.tried, dict(task.failed), advance)
    if task.tried is None:
        maker.deliver(made, {"pid": os.getpid(), "device": str(maker.renderer.device), "rss": resident_bytes()})
    else:
        maker.drop(made)
    return made.samples, made.failed


def failure_of(error: BaseException) -> tuple[str, str]:
    """Class of an error: "fatal" where the disk or the store failed, so that other shards fail as well, else
    "failed"."""
    text = str(error) if isinstance(error, ClscoError) else f"sample: must be made; got {error!r}"
    known: BaseException | None = error
    while known is not None:
        if isinstance(known, OSError):
            return "fatal", text
        known = known.__cause__
    return "failed", text


def resident_bytes() -> int:
    """Memory of this process."""
    try:
        with open("/proc/self/statm", "rb") as file:
            return int(file.read().split()[1]) * resource.getpagesize()
    except OSError:  # no such file on other systems: the most that it ever was, in KiB or on macOS in bytes
        most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        return most if sys.platform == "darwin" else most << 10


def _answer(maker: ShardMaker, task: ShardTask, pipe: Connection) -> tuple[Any, ...]:
    count, reported = 0, time.monotonic()

    def advance() -> None:
        nonlocal count, reported
        count += 1
        if task.tried is None and time.monotonic() > reported + REPORT_S:
            reported = time.monotonic()
            pipe.send(("progress", task.shard, count))

    try:
        made, failed = perform(maker, task, advance)
    except Exception as error:  # whatever it is, it is reported to the parent, which goes on
        return failure_of(error)
    return "done", made, failed, resident_bytes()


def _ended(number: int, _: FrameType | None) -> None:
    raise SystemExit(128 + number)
