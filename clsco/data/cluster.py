"""Makes the shards of a set as tasks of dask.distributed, on the workers of a cluster."""

from __future__ import annotations

import logging
import os
import pickle
import threading
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from typing import TYPE_CHECKING, Any

from clsco import __version__
from clsco.data.failures import failure_of
from clsco.data.pool import DIED, Schedule, ShardTask, device_of, limit_threads, perform, stoppable
from clsco.data.storage import open_storage
from clsco.errors import ClscoError, import_extra
from clsco.resources import processors

if TYPE_CHECKING:
    from clsco.data.shards import SetJob, ShardMaker

WORKERS_S = 600.0  # s to wait for a cluster's first worker, which may be in a queue
LOOK_S = 1.0  # s between queries of the list of workers
RESOURCE = "device"  # resource that workers of a cluster declare, if they declare any
_lock = threading.Lock()  # a process has one device, however many threads take tasks
_makers: dict[bytes, ShardMaker] = {}  # maker of the latest set, by the pickled set


def cluster_device(address: str) -> tuple[str, str]:
    """Device family and precision of one worker of a cluster. Raises ClscoError if the cluster has no worker."""
    distributed = _distributed()
    with _client(distributed, address) as client:
        future = _submit(client, _workers(client, address), _describe)
        try:
            family, precision = future.result(timeout=WORKERS_S)
        except TimeoutError:
            raise ClscoError(f"scheduler: {address} must have a worker; got none in {WORKERS_S:.0f} s") from None
        except (ImportError, AttributeError) as error:
            raise ClscoError(f"scheduler: workers must have this version of clsco; got {error}") from error
        except distributed.KilledWorker as error:
            raise ClscoError(f"scheduler: {address} must have a worker that works; got {error}") from error
        return str(family), str(precision)


def run_cluster(job: SetJob, shards: Sequence[int], address: str, advance: Callable[[int], object]) -> None:
    """Make shards on the workers of a cluster, each of which makes one shard at a time.

    address: address of the scheduler. advance: called with the number of samples of each new shard. Raises ClscoError
    if the scheduler cannot be reached or is lost, the storage fails, or a shard cannot be made.
    """
    distributed = _distributed()
    schedule = Schedule((shard, job.numbers(shard)) for shard in shards)
    packed = pickle.dumps(job)
    running: dict[Any, ShardTask] = {}
    ended = threading.Event()
    with stoppable(), _client(distributed, address) as client:
        try:
            while not schedule.is_over:
                workers = _workers(client, address)
                while schedule.waiting and len(running) < _room(workers):
                    task = schedule.waiting.popleft()
                    future = _submit(client, workers, _perform, packed, task)
                    running[future] = task
                    future.add_done_callback(lambda _: ended.set())
                ended.wait(LOOK_S)
                ended.clear()
                for future in [future for future in running if future.done()]:
                    task = running.pop(future)
                    if _ended_well(distributed, schedule, task, future, address) and task.tried is None:
                        advance(len(job.numbers(task.shard)))
        finally:
            with suppress(Exception):  # the scheduler may be gone
                client.cancel(list(running), force=True)
    open_storage(job.where).tidy()


def _ended_well(distributed: Any, schedule: Schedule, task: ShardTask, future: Any, address: str) -> bool:
    """Record how a task ended; returns True if it succeeded. Raises ClscoError if all other tasks would fail, too."""
    if future.status == "cancelled":
        raise _lost(address)
    if future.status == "error":
        error = future.exception()
        if not isinstance(error, distributed.KilledWorker):
            raise ClscoError(f"worker: must have what is installed here; got {error!r}")
        schedule.died(task, DIED)  # the scheduler has tried it again already
        return False
    kind, content = future.result()
    if kind == "fatal":
        raise ClscoError(content)
    if kind == "failed":
        schedule.died(task, content)
        return False
    schedule.done(task)
    return True


def _lost(address: str) -> ClscoError:
    rule = "must be there until the set is made, which may be resumed then"
    return ClscoError(f"scheduler: {address} {rule}; got a lost connection")


@contextmanager
def _client(distributed: Any, address: str) -> Iterator[Any]:
    """A client of the scheduler. Raises ClscoError if the scheduler cannot be reached, or is lost in the block."""
    logging.getLogger("distributed.client").setLevel(logging.CRITICAL)  # losses are reported in one line
    try:
        client = distributed.Client(address, timeout=20, set_as_default=False)
    except (OSError, ValueError) as error:
        got = str(error) or type(error).__name__
        raise ClscoError(f"scheduler: must be the address of a scheduler; got {address}: {got}") from error
    try:
        yield client
    except (OSError, distributed.comm.CommClosedError, distributed.client.FutureCancelledError) as error:
        raise _lost(address) from error
    finally:
        with suppress(Exception):  # the scheduler may be gone
            client.close(timeout=5)


def _distributed() -> Any:
    return import_extra("scheduler", "distributed", "distributed")


def _workers(client: Any, address: str) -> Mapping[str, Any]:
    """Workers that the scheduler lists. Raises ClscoError if the scheduler is lost."""
    workers: Mapping[str, Any] | None = client.scheduler_info(n_workers=-1).get("workers")
    if workers is None:
        raise _lost(address)
    return workers


def _room(workers: Mapping[str, Any]) -> int:
    """Number of tasks that may be submitted at a time: one for each worker, or for each device that workers declare.

    With more tasks, a worker that dies would also fail tasks that wait.
    """
    return max(1, sum(int(worker["resources"].get(RESOURCE, 1)) for worker in workers.values()))


def _submit(client: Any, workers: Mapping[str, Any], function: Callable[..., object], *arguments: object) -> Any:
    """Submit a call of a function; returns its future. A last argument is added: the number of workers on each host."""
    per_host = dict(Counter(worker["host"] for worker in workers.values()))
    declared = any(RESOURCE in worker["resources"] for worker in workers.values())
    return client.submit(function, *arguments, per_host, pure=False, resources={RESOURCE: 1} if declared else None)


def _prepare(per_host: Mapping[str, int]) -> Any:
    """The device of this worker. Its threads are limited, because workers on a host share the CPU cores."""
    worker = _distributed().get_worker()
    host = worker.address.rpartition("://")[2].rpartition(":")[0]
    limit_threads(max(1, processors() // per_host.get(host, 1)), os.environ)
    return device_of(None)


def _describe(per_host: Mapping[str, int]) -> tuple[str, str]:
    from clsco.data.shards import device_family

    with _lock:
        device = _prepare(per_host)
        return device_family(device), "double" if device.has_fp64 else "single"


def _perform(packed: bytes, task: ShardTask, per_host: Mapping[str, int]) -> tuple[str, str]:
    """Run a task on a worker; returns "done", "failed" or "fatal", and the reason of a failure."""
    with _lock:
        try:
            maker = _maker(packed, per_host)
            with closing(maker.storage):
                perform(maker, task)
        except Exception as error:  # any error is reported to the client
            return failure_of(error, pickle.loads(packed).where)
        return "done", ""


def _maker(packed: bytes, per_host: Mapping[str, int]) -> ShardMaker:
    from clsco.data.shards import ShardMaker

    if packed not in _makers:
        job: SetJob = pickle.loads(packed)
        if job.identity.version != __version__:
            rule = f"worker: must have version {job.identity.version} of clsco"
            raise ClscoError(f"{rule}; got {__version__}") from OSError()
        device, storage = _prepare(per_host), open_storage(job.where)
        storage.tidy()
        _makers.clear()
        _makers[packed] = ShardMaker(job, storage, device, device.kind != "cpu")
    return _makers[packed]
