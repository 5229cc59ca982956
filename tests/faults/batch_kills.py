"""kill -9 at random moments of `clsco dataset make`, and resume: python -m tests.faults.batch_kills --kills 100

A set of small frames is made by processes of one machine (1, 2 and 4 of them), by two parts of an array job at the same
time, and by workers of a dask cluster. A worker, the command, all of its processes at once, or the scheduler of the
cluster is killed after a random time, a few times in a row; after each kill every shard whose part is there must be
whole. Then --resume makes the rest: the set must have the bytes of one that nobody disturbed, and no other file. Only
log/ is not compared, which says how long a shard took.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import os
import random
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections import Counter
from importlib.util import find_spec
from pathlib import Path

COUNT, SIZE = 160, 4
DISTRIBUTION = """
[camera]
resolution = [48, 32]
pixel_pitch = 0.1
[vary.camera]
focus_distance = { uniform = [220, 320] }
[[object]]
shape = "sphere"
center = [0.0, 0.0, 280.0]
radius = 30.0
"""
WAYS = ("pool 1", "pool 2", "pool 4", "parts", "dask")
LATEST_S = 3.0  # after the start of the command
STUCK_S = 180.0
SETTLED_S = 10.0  # for tasks that a killed command had given to a cluster


def main() -> int:
    """Kill and resume, print what was found; 1 where anything is wrong."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--ways", default=",".join(WAYS), help="some of " + ", ".join(WAYS))
    given = parser.parse_args()
    ways = [way for way in given.ways.split(",") if way != "dask" or find_spec("distributed")]
    start, found, problems = time.monotonic(), Counter[str](), list[str]()
    with tempfile.TemporaryDirectory(prefix="clsco-batch-kills-") as name:
        base, rng = Path(name), random.Random(given.seed)
        (base / "set.toml").write_text(DISTRIBUTION)
        finished(command(base, base / "undisturbed"))
        wanted = digests(base / "undisturbed")
        turn = 0
        while found["kills"] < given.kills:
            way = ways[turn % len(ways)]
            turn += 1
            trial = Trial(base, way, rng, found, problems)
            try:
                trial.run(min(rng.randint(1, 4), given.kills - found["kills"]))
            finally:
                trial.end()
            problems += [f"{way}: {problem}" for problem in differences(wanted, base / "out")]
            shutil.rmtree(base / "out")
    recorded = ", ".join(f"{count} {what}" for what, count in sorted(found.items()))
    print(*problems[:20], sep="\n", end="\n" if problems else "")
    print(f"seed {given.seed}: {recorded}, {len(problems)} problems in {time.monotonic() - start:.0f} s")
    return int(bool(problems) or not found["kills"])


def command(base: Path, out: Path, *options: str) -> subprocess.Popen[bytes]:
    """Start `clsco dataset make`, in a group of processes of its own."""
    words = [
        "dataset",
        "make",
        str(base / "set.toml"),
        "-o",
        str(out),
        "--count",
        str(COUNT),
        "--shard-size",
        str(SIZE),
    ]
    return started([sys.executable, "-c", "from clsco.cli.process import run; run()", *words, "--resume", *options])


def started(words: list[str]) -> subprocess.Popen[bytes]:
    """A process in a group of its own, which says nothing."""
    return subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True)


def finished(process: subprocess.Popen[bytes]) -> None:
    """Wait for a command that nobody kills any more."""
    status = process.wait(STUCK_S)
    if status != 0:
        raise RuntimeError(f"a batch ended with the exit status {status}")


class Trial:
    """A set that is made while what makes it is killed."""

    def __init__(self, base: Path, way: str, rng: random.Random, found: Counter[str], problems: list[str]) -> None:
        self.base, self.way, self.rng, self.found, self.problems = base, way, rng, found, problems
        self.out = base / "out"
        self.cluster: list[subprocess.Popen[bytes]] = []  # the scheduler, then the workers
        self.port = 0

    def run(self, kills: int) -> None:
        """Kill so often, then make the rest."""
        for _ in range(kills):
            running = self.start()
            time.sleep(self.rng.uniform(0.0, LATEST_S))
            self.kill(running)
            for process in running:
                process.wait(STUCK_S)
            self.look()
        for process in self.start():
            finished(process)
        if self.way == "parts":  # the one that ended first saw a set that was not whole
            finished(command(self.base, self.out))

    def start(self) -> list[subprocess.Popen[bytes]]:
        """The commands that make the set together."""
        if self.way == "parts":
            parts = (("--part", f"{k}/2", "--workers", "1") for k in range(2))
            return [command(self.base, self.out, *options) for options in parts]
        if self.way == "dask":
            self.start_cluster()
            return [command(self.base, self.out, "--scheduler", f"tcp://127.0.0.1:{self.port}")]
        return [command(self.base, self.out, "--workers", self.way.split()[1])]

    def start_cluster(self) -> None:
        """Start what of the cluster is not alive: a scheduler, and two workers."""
        if not self.cluster or self.cluster[0].poll() is not None:
            self.end()
            with socket.socket() as probe:
                probe.bind(("127.0.0.1", 0))
                self.port = probe.getsockname()[1]
            words = ["scheduler", "--host", "127.0.0.1", "--port", str(self.port), "--no-dashboard"]
            self.cluster = [started([sys.executable, "-m", "dask", *words])]
        self.cluster = [process for process in self.cluster if process.poll() is None]
        while len(self.cluster) < 3:
            words = ["worker", f"tcp://127.0.0.1:{self.port}", "--nthreads", "1", "--no-nanny", "--no-dashboard"]
            self.cluster.append(started([sys.executable, "-m", "dask", *words]))

    def kill(self, running: list[subprocess.Popen[bytes]]) -> None:
        """Kill something of what runs."""
        process = self.rng.choice(running)
        victims = ["worker", "command", "all processes"] + ["scheduler"] * (self.way == "dask")
        victim = self.rng.choice(victims)
        self.found["kills"] += 1
        self.found[f"kills of a {victim}" if victim != "all processes" else "kills of all processes"] += 1
        if victim == "scheduler":
            self.cluster[0].kill()
        elif victim == "worker" and self.way == "dask":
            self.rng.choice(self.cluster[1:]).kill()
            self.start_cluster()  # another one comes
        elif victim == "worker":
            with contextlib.suppress(ProcessLookupError):
                os.kill(self.rng.choice(children(process.pid) or [process.pid]), signal.SIGKILL)
        elif victim == "command":
            process.kill()
        else:
            for each in running:
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(each.pid, signal.SIGKILL)

    def look(self) -> None:
        """No part may name what is not whole."""
        from clsco.data.sets import CARD, open_set, status_of
        from clsco.data.storage import open_storage

        if (self.out / CARD).exists():
            status = status_of(open_set(open_storage(self.out)), hashes=True)
            self.problems += [f"{self.way}: after a kill: {fault}" for fault in status.faults]
            self.found["shards that were there after kills"] += len(status.done)

    def end(self) -> None:
        """End the cluster, where there is one."""
        for process in self.cluster:
            process.kill()
            process.wait()
        self.cluster = []


def children(parent: int) -> list[int]:
    """Worker processes of a command."""
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            is_child = int(path.read_text().rpartition(")")[2].split()[1]) == parent
            if is_child and b"spawn_main" in (path.parent / "cmdline").read_bytes():
                found.append(int(path.parent.name))
    return found


def digests(out: Path) -> dict[str, str]:
    """SHA-256 of all files but those of the log; an empty folder counts as well."""
    return {
        path.relative_to(out).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else "folder"
        for path in sorted(out.rglob("*"))
        if path.relative_to(out).parts[0] != "log"
    }


def differences(wanted: dict[str, str], out: Path) -> list[str]:
    """Differences from a set that nobody disturbed."""
    end = time.monotonic() + SETTLED_S
    while any(out.glob(".*")) and time.monotonic() < end:
        time.sleep(0.1)
    got = digests(out)
    return [
        f"{name} must be as undisturbed; got {'another' if name in wanted and name in got else 'one too many or few'}"
        for name in sorted(wanted.keys() | got.keys())
        if wanted.get(name) != got.get(name)
    ]


if __name__ == "__main__":
    sys.exit(main())
