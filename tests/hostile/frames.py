"""Random small scenes, rendered: python -m tests.hostile.frames --cases 1000

A case draws every key that changes what is computed (`drawn.py`), and the method; keys that do not go together make it
one of those that are refused. Its first frame has to agree with the reference as `clsco check` asks, in double
precision. A case that does not, or that ends the process, is
reported with its number, which repeats it: --first N --cases 1.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

import clsco
from clsco import reference
from clsco.cli.check import compare
from clsco.errors import ClscoError, SceneError
from clsco.plan.methods import MANY_RADII
from clsco.scene.file import parse_scene
from clsco.scene.model import Scene
from tests.hostile.drawn import sections


def agrees(scene: Scene, method: str) -> list[str]:
    """Faults of the first frame, or frames of a stereo pair."""
    frames = list(clsco.render(scene, method=method, precision="double"))
    found = []
    for frame, exact in zip(frames, reference.render(scene), strict=True):
        found += [f"{frame.eye}: {difference}" for difference in compare(frame, exact) if difference.count]
    return found


def outcome(number: int, tally: dict[str, int]) -> list[str]:
    """Faults of a case, which is counted."""
    tally["cases"] += 1
    content, rng = sections(number), np.random.default_rng([11, number])
    while True:
        try:
            scene = parse_scene(content)
            break
        except SceneError as error:  # keys that have no use in this scene, which a scene file may not have
            key = str(error).split(": ")[1]
            if not _removed(content, key):
                tally["refused"] += 1
                return []
    method = str(rng.choice(["auto", *MANY_RADII]))
    try:
        return agrees(scene, method)
    except ClscoError as error:
        tally["refused"] += 1
        return [] if "; got " in str(error) else [f"message: {error}"]


def _removed(content: dict[str, Any], key: str) -> bool:
    """Take a key out of the sections, "object[1].bounds" of the second object; whether it was there."""
    *path, last = key.replace("[", ".").replace("]", "").split(".")
    at: Any = content
    for part in path:
        at = at[int(part)] if isinstance(at, list) else at.get(part, {})
    return isinstance(at, dict) and at.pop(last, None) is not None


def work(first: int, cases: int, stop: float, path: Path) -> None:
    """Run cases one after the other; the file has their number and what was found so far."""
    tally = {"cases": 0, "refused": 0, "failures": 0}
    for number in range(first, first + cases):
        if time.time() > stop:
            return
        path.write_text(json.dumps({"number": number, **tally}))
        faults = outcome(number, tally)
        tally["failures"] += bool(faults)
        for fault in faults:
            print(f"case {number}: {fault}", flush=True)
        path.write_text(json.dumps({"number": number, **tally}))


def main() -> int:
    """Run cases, a new process after each that ends one; 1 where something is wrong."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=1000)
    parser.add_argument("--first", type=int, default=0, help="number of the first case")
    parser.add_argument("--seconds", type=float, default=1e6, help="stop after so many")
    parser.add_argument("--worker", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--stop", type=float, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.worker:
        work(given.first, given.cases, given.stop, given.worker)
        return 0
    total, first, end = {"cases": 0, "refused": 0, "failures": 0}, given.first, given.first + given.cases
    stop = time.time() + given.seconds
    with tempfile.TemporaryDirectory(prefix="clsco-frames-") as folder:
        path = Path(folder, "tally.json")
        while first < end and time.time() < stop:
            words = ["--first", first, "--cases", end - first, "--stop", stop, "--worker", path]
            done = subprocess.run([sys.executable, "-m", "tests.hostile.frames", *map(str, words)], check=False)
            tally = json.loads(path.read_text())
            first = tally.pop("number") + 1
            total = {name: count + tally[name] for name, count in total.items()}
            if done.returncode == 0:
                break
            total["cases"] += 1
            total["failures"] += 1
            print(f"case {first - 1}: ended the process with status {done.returncode}", flush=True)
    print(", ".join(f"{count} {name}" for name, count in total.items()))
    return int(total["failures"] > 0)


if __name__ == "__main__":
    sys.exit(main())
