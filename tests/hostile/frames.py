"""Random small scenes, rendered: python -m tests.hostile.frames --cases 1000

A case draws every key that changes what is computed, from shapes and bounds to the PSF, occlusion, motion, filling,
stereo and method; keys that do not go together make it one of those that are refused. Its first frame has to agree
with the reference as `clsco check` asks, in double precision. A case that does not, or that ends the process, is
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

TEXTURES = ("bricks", "checkerboard", "slanted_edge", "siemens_star")
BOXES = (
    [[-30.0, 30.0], [-30.0, 30.0], [-3.0, 60.0]],
    [[-9.0, 12.0], [-30.0, 8.0], [-60.0, 5.0]],
    [[-60.0, 60.0], [-60.0, 60.0], [-60.0, 60.0]],
)


def sections(number: int) -> dict[str, Any]:
    """The scene of a case, as a file would have it."""
    rng = np.random.default_rng([7, number])

    def one(*values: Any) -> Any:
        return values[rng.integers(len(values))]

    def near(low: float, high: float) -> float:
        return round(float(rng.uniform(low, high)), 3)

    def motion() -> dict[str, Any]:
        found: dict[str, Any] = {}
        if one(True, False):
            found["velocity"] = [near(-12, 12), near(-12, 12), near(-25, 25)]
        if one(True, False):
            found["angular_velocity"] = [near(-60, 60) * one(0, 1) for _ in range(3)]
        return found

    def item() -> dict[str, Any]:
        center = [near(-15, 15), near(-15, 15), near(170, 330)]
        axis = [near(-1, 1), near(-1, 1), near(0.1, 1)]
        found: dict[str, Any] = one(
            {"shape": "plane", "distance": near(170, 350), "slope_x": one(0, near(-1, 1)), "slope_y": one(0, 0.4)},
            {"shape": "sphere", "center": center, "radius": near(5, 45)},
            {"shape": "cylinder", "center": center, "radius": near(5, 30), "axis": axis},
            {"shape": "cone", "apex": center, "half_angle": near(5, 60), "axis": axis},
            {"shape": "ellipsoid", "center": center, "semi_axes": [near(5, 40) for _ in range(3)]},
            {"shape": "quadric", "center": center,
             "coefficients": [1.0, near(-1, 1), one(0, near(-1, 1)), 0, 0, 0, 0, 0, near(-40, 40), near(-500, 500)]},
        )  # fmt: skip
        if one(True, False, False):
            found["bounds"] = one(*BOXES)
        return found | {"texture": one(*TEXTURES)} | ({"motion": moving} if (moving := motion()) else {})

    count = int(one(1, 1, 1, 2, 2, 3))
    camera = {
        "resolution": [int(one(1, 17, 32, 45)), int(one(1, 14, 24, 66))],
        "pixel_pitch": one(0.08, 0.15), "aperture_diameter": one(4.0, 10.0, 30.0), "focus_distance": near(180, 340),
    }  # fmt: skip
    if one(*[False] * 5, True):
        camera["motion"] = motion()
    found: dict[str, Any] = {"camera": camera, "object": [item() for _ in range(count)]}
    found["psf"] = {
        "model": one("pillbox", "gaussian"), "edge": one("sampled", "area", "integrated"), "tilt": one(True, False),
        "silhouette_samples": int(one(1, 2, 4)), "border": one("lose", "renormalize"),
        "occlusion": one("visibility", "layered", "none"),
    }  # fmt: skip
    found["sequence"] = {"samples": one(1, 2, 3), "sampling": one("midpoint", "endpoint"), "shutter": one(0.1, 1.0)}
    found["motion"] = {"rotation": one("euler", "axis")}
    if one(True, False):
        found["motion"]["warp"] = "forward"
        found["fill"] = {"method": one("ait", "mean_median", "none"), "domain": one("surface", "span")}
    else:
        found["motion"]["texture_filter"] = one("bicubic", "bilinear", "nearest")
    if one(*[False] * 7, True):
        found["stereo"] = {"baseline": near(2, 12), "toe_in": one(0.0, 1.0)}
    if one(*[False] * 3, True):
        place = one("direction", "position")
        found["light"] = {place: [near(-1, 1), near(0, 1), near(0.5, 1)], "ambient": one(0.0, 0.3)}
    return found


def agrees(scene: Scene, method: str) -> list[str]:
    """What is wrong with the first frame, or frames of a stereo pair."""
    frames = list(clsco.render(scene, method=method, precision="double", device="pocl"))
    found = []
    for frame, exact in zip(frames, reference.render(scene), strict=True):
        found += [f"{frame.eye}: {difference}" for difference in compare(frame, exact) if difference.count]
    return found


def outcome(number: int, tally: dict[str, int]) -> list[str]:
    """What is wrong with a case; counts it."""
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
