"""kill -9 at random moments of a batch, and resume: python -m tests.faults.kills --kills 100

Frames are rendered with ground truth by `clsco render`, and become a clip by `clsco video`. A data set is made by
processes of one machine (1, 2 and 4 of them), by two parts of an array job at the same time, by workers of a dask
cluster, and by `clsco dataset convert`, in all formats in turn. A worker, the command (also by SIGTERM and SIGINT), all
of its processes at once, or the scheduler of the cluster is killed after a random time, a few times in a row; after
each kill every frame and every shard that says it is there must be whole, a frame that was whole stays as it is, and
stderr has at most one line. Then --resume makes the rest: files must have the bytes of a batch that nobody disturbed,
and there must be no other file. Only log/ and the JSON files of frames are not compared, which say how long something
took.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from tests.cli.test_dataset import DISTRIBUTION

COUNT, SIZE, FRAMES = 160, 4, 12
SCENE = f"""
[camera]
resolution = [96, 64]
[sequence]
frames = {FRAMES}
samples = 2
[[object]]
shape = "plane"
distance = 250.0
motion.velocity = [3.0, 0.0, 0.0]
"""
WAYS = ("render", "video", "pool 1", "pool 2", "pool 4", "parts", "dask", "convert")
FORMATS = ("webdataset", "npz", "hdf5", "zarr")
STUCK_S = 180.0
SETTLED_S = 10.0  # for tasks that a killed command had given to a cluster


def main(words: list[str] | None = None) -> int:
    """Kill and resume, print what was found; 1 where anything is wrong."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--ways", default=",".join(WAYS), help="some of " + ", ".join(WAYS))
    chosen = parser.parse_args(words)
    ways = [way for way in chosen.ways.split(",") if way != "dask" or find_spec("distributed")]
    start, counts, problems = time.monotonic(), Counter[str](), list[str]()
    with tempfile.TemporaryDirectory(prefix="clsco-kills-") as name:
        base, rng = Path(name), random.Random(chosen.seed)
        (base / "set.toml").write_text(DISTRIBUTION)
        (base / "scene.toml").write_text(SCENE)
        if "video" in ways:
            finish(start_render(base, base / "frames"))
        if "convert" in ways:
            finish(start_make(base, base / "source"))
        undisturbed, seconds, turn = dict[str, dict[str, str]](), dict[tuple[str, str], float](), 0
        while counts["kills"] < chosen.kills:
            way, form = ways[turn % len(ways)], FORMATS[(turn // len(ways) + chosen.seed) % len(FORMATS)]
            turn += 1
            made = way if way in ("render", "video") else form
            trial = Trial(base, way, form, rng, seconds.get((way, form), 0.0), counts, problems)
            begun = time.monotonic()
            try:
                trial.run(min(rng.randint(1, 4), chosen.kills - counts["kills"]) if trial.seconds else 0)
            finally:
                trial.end()
            seconds.setdefault((way, form), time.monotonic() - begun)
            expected = undisturbed.setdefault(made, digests(base / "out"))
            problems += [f"{way}: {problem}" for problem in differences(expected, base / "out")]
            shutil.rmtree(base / "out")
    recorded = ", ".join(f"{count} {what}" for what, count in sorted(counts.items()))
    print(*problems[:20], sep="\n", end="\n" if problems else "")
    print(f"seed {chosen.seed}: {recorded}, {len(problems)} problems in {time.monotonic() - start:.0f} s")
    return int(bool(problems) or not counts["kills"])


def start_make(base: Path, out: Path, *options: str) -> subprocess.Popen[bytes]:
    """Start `clsco dataset make`."""
    size = ("--count", str(COUNT), "--shard-size", str(SIZE))
    return start_clsco("dataset", "make", str(base / "set.toml"), "-o", str(out), *size, *options)


def start_render(base: Path, out: Path) -> subprocess.Popen[bytes]:
    """Start `clsco render`, of frames with ground truth."""
    return start_clsco("render", str(base / "scene.toml"), "-o", str(out), "--format", "npz")


def start_clsco(*words: str, more: Sequence[str] = ("--resume",)) -> subprocess.Popen[bytes]:
    """Start a command that goes on with what is there."""
    return start([sys.executable, "-c", "from clsco.cli.process import run; run()", *words, *more])


def start(words: list[str]) -> subprocess.Popen[bytes]:
    """Start a process in a group of its own, whose stderr is a file that workers may outlive."""
    stderr = tempfile.TemporaryFile()  # noqa: SIM115
    process = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=stderr, start_new_session=True)
    process.stderr = stderr
    return process


def said(process: subprocess.Popen[bytes]) -> str:
    """The text on stderr of a process that has ended; to be called once."""
    assert process.stderr is not None
    with process.stderr as file:
        return os.pread(file.fileno(), 10**6, 0).decode()


def finish(process: subprocess.Popen[bytes]) -> None:
    """Wait for a command that nobody kills any more."""
    status, text = process.wait(STUCK_S), said(process)
    if status != 0:
        raise RuntimeError(f"a batch ended with the exit status {status}: {text}")


class Trial:
    """A batch that is made while what makes it is killed."""

    def __init__(
        self, base: Path, way: str, form: str, rng: random.Random, seconds: float, counts: Counter[str],
        problems: list[str],
    ) -> None:  # fmt: skip
        """Prepare a batch that takes so many seconds where nobody disturbs it."""
        self.base, self.way, self.rng, self.seconds, self.form = base, way, rng, seconds, ("--format", form)
        self.counts, self.problems = counts, problems
        self.out = base / "out"
        self.cluster: Any = None  # tests.data.test_cluster.Cluster, which needs dask
        self.complete: dict[int, int] = {}  # frames, and when their JSON files were written

    def run(self, kills: int) -> None:
        """Kill so often, then make the rest."""
        for _ in range(kills):
            running = self.start()
            time.sleep(self.rng.uniform(0.0, self.seconds))
            self.kill(running)
            for process in running:
                status, text = process.wait(STUCK_S), said(process)
                if status not in (0, -signal.SIGKILL) and len(text.splitlines()) != (status > 0):
                    self.problems.append(f"{self.way}: status {status} with {text!r}")
            self.check_parts()
        for process in self.start():
            finish(process)
        if self.way == "parts":  # the one that ended first saw a set that was not whole
            finish(start_make(self.base, self.out, *self.form))

    def start(self) -> list[subprocess.Popen[bytes]]:
        """Start the commands that make the batch together."""
        if self.way == "render":
            return [start_render(self.base, self.out)]
        if self.way == "video":
            self.out.mkdir(exist_ok=True)
            return [start_clsco("video", str(self.base / "frames"), "-o", str(self.out / "clip.mp4"), more=())]
        if self.way == "convert":
            return [start_clsco("dataset", "convert", str(self.base / "source"), "-o", str(self.out), *self.form)]
        if self.way == "parts":
            parts = (("--part", f"{k}/2", "--workers", "1") for k in range(2))
            return [start_make(self.base, self.out, *self.form, *options) for options in parts]
        if self.way == "dask":
            self.start_cluster()
            return [start_make(self.base, self.out, *self.form, "--scheduler", self.cluster.address)]
        return [start_make(self.base, self.out, *self.form, "--workers", self.way.split()[1])]

    def start_cluster(self) -> None:
        """Start what of the cluster is not alive: a scheduler, and two workers."""
        from tests.data.test_cluster import Cluster

        if self.cluster is None or self.cluster.scheduler.poll() is not None:
            self.end()
            self.cluster = Cluster()
        self.cluster.workers = [process for process in self.cluster.workers if process.poll() is None]
        while len(self.cluster.workers) < 2:
            self.cluster.add()

    def kill(self, running: list[subprocess.Popen[bytes]]) -> None:
        """Kill something of what runs."""
        process = self.rng.choice(running)
        victims = ["worker", "command", "all processes"] + ["scheduler"] * (self.way == "dask")
        victim = self.rng.choice(victims)
        self.counts["kills"] += 1
        self.counts[f"kills of a {victim}" if victim != "all processes" else "kills of all processes"] += 1
        if victim == "scheduler":
            self.cluster.scheduler.kill()
        elif victim == "worker" and self.way == "dask":
            self.rng.choice(self.cluster.workers).kill()
            self.start_cluster()  # another one comes
        elif victim == "worker":
            with contextlib.suppress(ProcessLookupError):
                os.kill(self.rng.choice(children(process.pid) or [process.pid]), signal.SIGKILL)
        elif victim == "command":
            process.send_signal(self.rng.choice((signal.SIGKILL, signal.SIGTERM, signal.SIGINT)))
        else:
            for each in running:
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(each.pid, signal.SIGKILL)

    def check_parts(self) -> None:
        """No frame and no part of a set may name what is not whole."""
        from clsco.data.card import CARD
        from clsco.data.sets import open_set, status_of
        from clsco.data.storage import open_storage
        from clsco.frame.files import read_complete

        if (self.out / CARD).exists():
            status = status_of(open_set(open_storage(self.out)), hashes=True)
            self.problems += [f"{self.way}: after a kill: {fault}" for fault in status.faults]
            self.counts["shards that were there after kills"] += len(status.done)
        before, self.complete = self.complete, {}
        for path in self.out.glob("frame_*.json"):
            number = int(path.stem[-4:])
            if read_complete(self.out, number) is None:
                self.problems.append(f"{path.name} says that its frame is complete, and it is not")
            self.complete[number] = path.stat().st_mtime_ns
        if before.items() - self.complete.items():
            self.problems.append("frames were complete and were lost or made anew")
        self.counts["frames that were there after kills"] += len(self.complete)

    def end(self) -> None:
        """End the cluster, where there is one."""
        if self.cluster is not None:
            self.cluster.end()


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
    """SHA-256 of all files but those that have times; an empty folder counts as well."""
    found = {}
    for path in sorted(out.rglob("*")):
        name, is_hashed = path.relative_to(out), path.is_file() and not path.match("frame_*.json")
        if name.parts[0] != "log":
            found[name.as_posix()] = hashlib.sha256(path.read_bytes()).hexdigest() if is_hashed else "there"
    return found


def differences(expected: dict[str, str], out: Path) -> list[str]:
    """Differences from a set that nobody disturbed."""
    end = time.monotonic() + SETTLED_S
    while any(out.glob(".*")) and time.monotonic() < end:
        time.sleep(0.1)
    got = digests(out)
    return [
        f"{name} must be as undisturbed; got {'another' if name in expected and name in got else 'one too many or few'}"
        for name in sorted(expected.keys() | got.keys())
        if expected.get(name) != got.get(name)
    ]


if __name__ == "__main__":
    sys.exit(main())
