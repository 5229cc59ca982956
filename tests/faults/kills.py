"""kill -9 at random moments of a batch, and resume: python -m tests.faults.kills --kills 1000

`clsco render --resume` of a sequence with ground truth is killed after a random time, a few times in a row, and then
left to end; then the next batch begins. After each kill no frame that says it is complete may be anything else, none
that was complete before may be gone or made anew, and at most one may have been written in vain; in the end all files
are there, with the bytes of a batch that nobody killed, and no other file. With --naive files are written in place and
trusted when they are there: then the same checks have to find damage. Kernels are compiled into an own cache, which
begins empty.
"""

from __future__ import annotations

import argparse
import contextlib
import faulthandler
import json
import os
import random
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

FRAMES = 12
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
START_S, WRITING_S = 1.0, 0.3  # until a kill, from the start, or in two of three from the first frame written
STUCK_S = 120.0


def main() -> int:
    """Kill and resume, print what was found; 1 where anything is wrong."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=1000)
    parser.add_argument("--seconds", type=float, default=float("inf"), help="begin no other batch after so many")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--naive", action="store_true")
    parser.add_argument("--cache", help="folder of compiled kernels that are used; by default an empty one")
    given = parser.parse_args()
    start = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="clsco-kills-") as name:
        os.environ["POCL_CACHE_DIR"] = given.cache or ""
        os.environ["XDG_CACHE_HOME"] = f"{name}/cache"
        found, problems = soak(Path(name), given)
    recorded = ", ".join(f"{count} {what}" for what, count in sorted(found.items()))
    print(*problems[:20], sep="\n", end="\n" if problems else "")
    print(f"seed {given.seed}: {recorded}, {len(problems)} problems in {time.monotonic() - start:.0f} s")
    return int(bool(problems) != given.naive or not found["kills"])


def soak(base: Path, given: argparse.Namespace) -> tuple[Counter[str], list[str]]:
    """Batch after batch; the numbers of what happened, and what was wrong."""
    load()
    (base / "scene.toml").write_text(SCENE)
    rng, found, problems, start = random.Random(given.seed), Counter[str](), list[str](), time.monotonic()
    run(base, base / "reference", given.naive)
    wanted = digests(base / "reference")
    while found["kills"] < given.kills and time.monotonic() < start + given.seconds:
        out = base / "out"
        found["batches"] += 1
        complete: dict[int, int] = {}
        for _ in range(min(rng.randint(3, 12), given.kills - found["kills"])):
            killed, begun = run(base, out, given.naive, rng)
            found["kills"] += killed
            found["kills while files were written"] += any(out.glob(".*.part")) if out.is_dir() else 0
            now = complete_frames(out, problems)
            problems += [f"frame {k} was complete and is lost" for k in complete.keys() - now.keys()]
            problems += [f"frame {k} was complete and was made anew" for k in complete if now.get(k) != complete[k]]
            if len(begun - now.keys()) > 1:
                problems.append(f"frames {sorted(begun - now.keys())} were written in vain")
            complete = now
        run(base, out, given.naive)
        problems += ends_as(wanted, out)
        found["frames that are there"] += len(wanted) // 2
        shutil.rmtree(out)
    return found, problems


def load() -> None:
    """Import what a batch needs once for all children; no OpenCL is asked, which a fork would not survive."""
    import imageio.v3
    import pyopencl

    from clsco.cli import main as cli
    from clsco.cli import tables as show
    from clsco.engine import batch, renderer
    from clsco.frame import provenance as describe
    from clsco.scene import sweep

    assert all((imageio.v3, pyopencl, batch, cli, describe, renderer, show, sweep))


def run(base: Path, out: Path, naive: bool, rng: random.Random | None = None) -> tuple[bool, set[int]]:
    """Render in a child, to the end or killed; whether it was killed, and the frames that it began to write."""
    log = base / "log"
    log.write_bytes(b"")
    child = os.fork()
    if child == 0:
        faulthandler.enable()
        os._exit(render(base / "scene.toml", out, log, naive))
    end = time.monotonic() + STUCK_S
    if rng is not None:
        early = rng.random() < 1 / 3
        while not early and not log.stat().st_size and time.monotonic() < end and _runs(child):
            time.sleep(0.002)
        time.sleep(rng.random() * (START_S if early else WRITING_S))
        os.kill(child, signal.SIGKILL)
    while (ended := os.waitpid(child, os.WNOHANG))[0] == 0:
        time.sleep(0.005)
        if time.monotonic() > end:
            os.kill(child, signal.SIGKILL)
            raise TimeoutError(f"a batch took more than {STUCK_S:g} s")
    status = os.waitstatus_to_exitcode(ended[1])
    if status not in (0, -signal.SIGKILL) and not naive:
        raise RuntimeError(f"a batch ended with the exit status {status}")
    return status == -signal.SIGKILL, {int(word) for word in log.read_text().split()}


def _runs(child: int) -> bool:
    return os.waitid(os.P_PID, child, os.WEXITED | os.WNOHANG | os.WNOWAIT) is None


def render(scene: Path, out: Path, log: Path, naive: bool) -> int:
    """Run the command in the child, with a note of each frame that is written."""
    from clsco.cli.main import main as command
    from clsco.engine import batch
    from clsco.frame.files import write_frame

    notes = os.open(log, os.O_WRONLY | os.O_APPEND)

    def noted(folder: Any, views: Any, *args: Any, **options: Any) -> Any:
        os.write(notes, b"%d " % views[0].index)
        return write_frame(folder, views, *args, **options)

    setattr(batch, "write_frame", noted)  # noqa: B010, mypy knows the function's type
    if naive:
        make_naive()
    try:
        command(["render", str(scene), "-o", str(out), "--format", "npz", "--resume", "--quiet"])
    except SystemExit as ended:
        return int(ended.code or 0)
    return 0


def make_naive() -> None:
    """Write files in place, and take those that are there for whole."""
    from clsco.engine import batch
    from clsco.files import images
    from clsco.frame import files as framefiles
    from clsco.frame.provenance import record

    @contextlib.contextmanager
    def in_place(path: Path) -> Iterator[BinaryIO]:
        with open(path, "wb", buffering=0) as file:
            yield file

    @contextlib.contextmanager
    def in_folder(folder: Path, name: str) -> Iterator[Path]:
        yield folder

    def there(folder: Path, index: int) -> dict[str, Any] | None:
        path = Path(folder) / f"frame_{index:04d}"
        if not path.with_suffix(".png").exists():
            return None
        return batch_record | {"files": {f"{path.name}.png": "", f"{path.name}.npz": ""}}

    batch_record: dict[str, Any] = {}

    def remembered(*args: Any) -> dict[str, Any]:
        batch_record.update(record(*args))
        return dict(batch_record)

    for module, name, value in (
        (images, "atomic_write", in_place), (framefiles, "together", in_folder), (batch, "read_complete", there),
        (batch, "record", remembered),
    ):  # fmt: skip
        setattr(module, name, value)


def complete_frames(out: Path, problems: list[str]) -> dict[int, int]:
    """The frames in a folder that are complete, with the time of their JSON file; damaged ones are problems."""
    from clsco.frame.files import read_complete

    found = {}
    for path in sorted(out.glob("frame_*.json")):
        if read_complete(out, int(path.stem[-4:])) is None:
            problems.append(f"{path.name} says that its frame is complete, and it is not")
        else:
            found[int(path.stem[-4:])] = path.stat().st_mtime_ns
    return found


def digests(out: Path) -> dict[str, str]:
    """SHA-256 of all images and arrays, as the JSON files name them and as `sha256` finds them."""
    from clsco.files.atomic import sha256

    for path in out.glob("frame_*.json"):
        for name, digest in json.loads(path.read_bytes())["files"].items():
            assert sha256(out / name) == digest
    return {path.name: sha256(path) for path in out.iterdir() if path.suffix != ".json"}


def ends_as(wanted: dict[str, str], out: Path) -> list[str]:
    """Differences from a batch that nobody killed."""
    try:
        got = digests(out)
    except (AssertionError, OSError, ValueError) as error:
        return [f"a file is damaged in the end: {error!r}"]
    names = {path.name for path in out.iterdir() if path.suffix == ".json"}
    problems = [f"{name} is missing or damaged in the end" for name in wanted if got.get(name) != wanted[name]]
    problems += [f"{name} is a stray file" for name in got.keys() - wanted.keys()]
    expected = {f"frame_{k:04d}.json" for k in range(FRAMES)}
    return problems + [f"{name} is missing or a stray file" for name in expected ^ names]


if __name__ == "__main__":
    sys.exit(main())
