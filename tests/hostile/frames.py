"""Random small scenes, rendered: python -m tests.hostile.frames --cases 1000

A case draws every key that changes what is computed (`drawn.py`), and the method; keys that do not go together make it
one of those that are refused. Its first frame has to agree with the reference as `clsco check` asks, in double
precision. A case that does not is reported with its number, which repeats it: --first N --cases 1; of one that ends
the process, the number is the last word.
"""

from __future__ import annotations

import argparse
import sys
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


def main() -> int:
    """Run cases, tell of each that is wrong; 1 where there are any."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=1000)
    parser.add_argument("--first", type=int, default=0, help="number of the first case")
    asked = parser.parse_args()
    tally, failures = {"cases": 0, "refused": 0}, 0
    for number in range(asked.first, asked.first + asked.cases):
        print(f"case {number}", end="\r", flush=True)
        if faults := outcome(number, tally):
            failures += 1
            print(*(f"case {number}: {fault}" for fault in faults), sep="\n")
    print(f"{tally['cases']} cases, {tally['refused']} refused, {failures} failures")
    return int(failures > 0)


if __name__ == "__main__":
    sys.exit(main())
