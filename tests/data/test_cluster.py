"""Sets made by workers of dask.distributed, started by their own commands, in folders and in stores."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from clsco.data import cluster as cluster_module
from clsco.data.cluster import cluster_device, run_cluster
from clsco.data.pool import Place, run_pool
from clsco.data.storage import open_storage
from clsco.errors import ClscoError
from tests.data.fakes import job_of, make_here
from tests.data.test_shards import files

pytest.importorskip("distributed")
ROOT = Path(__file__).resolve().parents[2]


class Cluster:
    """A scheduler and workers, each a process."""

    def __init__(self) -> None:
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self.port = probe.getsockname()[1]
        self.address = f"tcp://127.0.0.1:{self.port}"
        self.scheduler = self._start("scheduler", "--host", "127.0.0.1", "--port", str(self.port))
        self.workers: list[subprocess.Popen[bytes]] = []

    def add(self, *options: str) -> subprocess.Popen[bytes]:
        """Start a worker."""
        words = ("worker", self.address, "--no-nanny", *(options or ("--nthreads", "1")))
        self.workers.append(self._start(*words))
        return self.workers[-1]

    def _start(self, *words: str) -> subprocess.Popen[bytes]:
        return subprocess.Popen(
            [sys.executable, "-m", "dask", *words, "--no-dashboard"],
            env={**os.environ, "PYTHONPATH": str(ROOT)}, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip

    def end(self) -> None:
        """Kill all."""
        for process in (*self.workers, self.scheduler):
            process.kill()
            process.wait()


@pytest.fixture
def cluster() -> Iterator[Cluster]:
    found = Cluster()
    yield found
    found.end()


def no_strays(folder: Path) -> bool:
    """True if no hidden file is left; that of a worker goes at the end of its task."""
    end = time.monotonic() + 10.0
    while any(folder.glob(".*")) and time.monotonic() < end:
        time.sleep(0.05)
    return not any(folder.glob(".*"))


@pytest.mark.slow
def test_a_cluster_of_which_one_worker_is_killed_and_one_is_added(cluster: Cluster, tmp_path: Path) -> None:
    bad: dict[str, Any] = {"undrawable": frozenset({2}), "unrenderable": frozenset({9})}
    make_here(job_of(tmp_path / "one", 96, **bad))
    for _ in range(3):
        cluster.add()
    cluster.add("--nthreads", "3")  # as a plain `dask worker`, with one task at a time nevertheless
    family, precision = cluster_device(cluster.address)
    job = job_of(tmp_path / "two", 96, **bad)
    assert (family, precision) == (job.identity.device_family, "double")
    counted: list[int] = []

    def advance(count: int) -> None:
        counted.append(count)
        if sum(counted) == 20:
            cluster.workers[0].kill()
            cluster.add()

    run_cluster(job, range(24), cluster.address, advance)
    assert sum(counted) == 96
    assert files(tmp_path / "one") == files(tmp_path / "two")
    assert no_strays(tmp_path / "two")


@pytest.mark.slow
def test_workers_with_a_device_each_and_a_sample_that_ends_them(cluster: Cluster, tmp_path: Path) -> None:
    for _ in range(2):
        words = ("worker", cluster.address, "--nthreads", "2", "--resources", "device=1")
        cluster.workers.append(cluster._start(*words))  # with its nanny, which starts it again
    make_here(job_of(tmp_path / "one", 8))
    job = job_of(tmp_path / "two", 8, deadly=frozenset({5}))
    run_cluster(job, range(2), cluster.address, lambda _: None)
    made, wanted = files(tmp_path / "two"), files(tmp_path / "one")
    assert made["data/000000.tar"] == wanted["data/000000.tar"]
    assert b'"failed":1' in made["manifest/000001.jsonl"]
    for process in cluster.workers:
        process.terminate()
        process.wait(60)


@pytest.mark.slow
def test_a_scheduler_that_goes_away_ends_the_command(cluster: Cluster, tmp_path: Path) -> None:
    cluster.add()
    cluster_device(cluster.address)  # there is a worker
    job, counted = job_of(tmp_path, 4000), list[int]()

    def advance(count: int) -> None:
        counted.append(count)
        if sum(counted) == 20:
            cluster.scheduler.kill()

    with pytest.raises(ClscoError, match="must be there until the set is made, which may be resumed"):
        run_cluster(job, range(1000), cluster.address, advance)
    with pytest.raises(ClscoError, match="must be the address of a scheduler; got nonsense"):
        run_cluster(job, range(1), "nonsense", advance)


@pytest.mark.slow
def test_a_scheduler_that_goes_away_before_a_worker_comes(cluster: Cluster, monkeypatch: pytest.MonkeyPatch) -> None:
    def submit(*arguments: Any) -> Any:
        cluster.scheduler.kill()
        return of_cluster(*arguments)

    of_cluster = cluster_module._submit
    monkeypatch.setattr(cluster_module, "_submit", submit)
    with pytest.raises(ClscoError, match="must be there until the set is made, which may be resumed"):
        cluster_device(cluster.address)


@pytest.mark.slow
def test_workers_write_to_an_object_store(cluster: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    server, s3fs = pytest.importorskip("moto.server"), pytest.importorskip("s3fs")
    store = server.ThreadedMotoServer("127.0.0.1", 0)
    store.start()
    try:
        host, port = store.get_host_and_port()
        monkeypatch.setenv("AWS_ENDPOINT_URL", f"http://{host}:{port}")
        for name in ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY"):
            monkeypatch.setenv(name, "testing")
        monkeypatch.setenv("AWS_DEFAULT_REGION", "us-east-1")
        s3fs.S3FileSystem().mkdir("bucket")
        make_here(job_of(tmp_path / "one", 24))
        wanted = files(tmp_path / "one")
        run_pool(job_of("s3://bucket/pool", 24), range(6), [Place(None, 1)] * 2, lambda _: None, 2**34)
        cluster.add()
        run_cluster(job_of("s3://bucket/dask", 24), range(6), cluster.address, lambda _: None)
        for name in ("pool", "dask"):
            storage = open_storage(f"s3://bucket/{name}")
            keys = [key for folder in ("data", "manifest") for key in storage.sizes(folder)]
            assert {key: storage.read(key) for key in keys} == wanted
    finally:
        store.stop()
