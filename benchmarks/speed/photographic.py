"""Frames of the kind that a lens is opened for: time of each way of occlusion, of two versions by turns, and of path
tracers at equal error.

    python -m benchmarks.speed.photographic [--only NAME] [--motion moving one still] [--modes none layered visibility]
        [--width 640] [--repeats 3] [--base CHECKOUT] [--base-modes visibility] [--blender-python PATH] [-o FILE]

The scenes are benchmarks/speed/scenes/*.toml, in color, 640 x 480 px: wide blur behind and before what is in focus.
`moving` takes the time samples of `auto`, `one` takes one of the same motion, and `still` has none. Figures are medians
of processor time of `clsco.render_frame` in s, without ground truth; the first frame, which compiles, counts only where
it is the only one. `--base` names a checkout of another version with its .venv, which makes the frames by turns.

`tolerance` among the modes is `visibility` with `--tolerance 0.003`. `--blender-python` names a Python with `bpy`, and
has Cycles make pictures of `moving` and `still`, and Mitsuba of `still` (the extra `bench`), with two numbers of rays
per pixel (`--rays`), which are kept, and with fewer by turns with clsco, from which follows their time at an error.
Errors are RMS of white, against the former; see `benchmarks.speed.photographic_peers`.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median

import numpy as np

from benchmarks.speed.photographic_frames import Taken, Wanted, ask, worker
from benchmarks.speed.photographic_peers import Traced, peers_of
from benchmarks.tables import Figures, write_table

SCENES = ("portrait", "street", "fence", "macro", "cart")
FOLDER = Path(__file__).parent / "scenes"
MOTIONS = ("still", "one", "moving")
MODES = ("none", "layered", "visibility", "tolerance")
BASE = "base "
TOLERANCE = 0.003
ERRORS = (3e-3, 1e-3)
KEPT = Path(__file__).resolve().parents[2] / "build" / "photographic"


@dataclass(frozen=True)
class Row:
    """Frames of one scene with one motion, by modes of occlusion; those of the base have BASE before the mode.

    errors: RMS error by modes; traced: pictures by path tracers.
    """

    scene: str
    motion: str
    taken: dict[str, list[Taken]]
    errors: dict[str, float]
    traced: list[Traced]

    def seconds(self, mode: str) -> float:
        """Median of processor time, s."""
        found = self.taken[mode]
        return median(one.seconds for one in found[len(found) > 1 :])

    def figures(self) -> Figures:
        """A row of the table."""
        found: dict[str, float | str] = {"scene": self.scene, "motion": self.motion}
        found["time samples"] = ", ".join(dict.fromkeys(str(taken[0].samples) for taken in self.taken.values()))
        found |= {f"{mode}, s": self.seconds(mode) for mode in self.taken}
        for mode in self.taken:
            if BASE + mode in self.taken:
                found[f"{BASE}/ {mode}"] = self.seconds(BASE + mode) / self.seconds(mode)
        found |= {f"error of {mode}": error for mode, error in self.errors.items()}
        for error in ERRORS if self.traced else ():
            for traced in self.traced:
                found[f"{traced.name} at {error:g}, s"] = traced.at(error)
            enough = [self.seconds(mode) for mode, own in self.errors.items() if own <= error]
            least = min(traced.at(error) for traced in self.traced)
            found[f"better one / clsco at {error:g}"] = least / min(enough) if enough else "not reached"
        return found


def wanted(scene: str, motion: str, mode: str, width: int) -> Wanted:
    """A frame of a scene."""
    occlusion = "visibility" if mode == "tolerance" else mode
    settings = [f"psf.occlusion={occlusion}", *(["sequence.samples=1"] if motion == "one" else [])]
    tolerance = TOLERANCE if mode == "tolerance" else 0.0
    return Wanted(str(FOLDER / f"{scene}.toml"), tuple(settings), motion == "still", width, tolerance)


def frames(options: argparse.Namespace, scene: str, motion: str, save: Path) -> dict[str, list[Taken]]:
    """Frames of a scene, by turns; those of this version leave their latest picture in a folder."""
    found: dict[str, list[Taken]] = {}
    for _ in range(options.repeats):
        for mode in options.modes:
            for version, process in options.workers.items():
                if version and mode not in options.base_modes:
                    continue
                frame = wanted(scene, motion, mode, options.width)
                frame = frame if version else replace(frame, save=str(save / f"{mode}.npy"))
                found.setdefault(version + mode, []).append(ask(process, frame))
    return found


def measured(options: argparse.Namespace, scene: str, motion: str) -> Row:
    """A row of the table."""
    with tempfile.TemporaryDirectory() as folder:
        taken = frames(options, scene, motion, Path(folder))
        if options.blender_python is None or motion == "one":
            return Row(scene, motion, taken, {}, [])
        with peers_of(wanted(scene, motion, "visibility", options.width), options.blender_python) as peers:
            few, many = options.rays
            judge = peers.judge(few, many, options.kept)
            errors = {mode: judge.error(np.load(f"{folder}/{mode}.npy")) for mode in options.modes}
            return Row(scene, motion, taken, errors, peers.traced(judge))


def keep(path: Path, width: int, row: Row) -> None:
    """Put a row in place of an earlier one with its scene and motion, into a file of rows and the table beside it."""
    rows = json.loads(path.read_text("utf-8")) if path.exists() else {}
    rows[f"{row.scene} {row.motion}"] = row.figures()
    order = [f"{scene} {motion}" for scene in SCENES for motion in MOTIONS]
    rows = {name: rows[name] for name in order if name in rows}
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(rows, indent=1) + "\n", "utf-8")
    write_table(path.with_suffix(".md"), f"# Photographic scenes, {width} columns", list(rows.values()))


def main() -> None:
    """Read the command line, measure, print and write."""
    formatter = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=formatter)
    parser.add_argument("--only", default="", metavar="NAME", help="part of the names of the scenes")
    parser.add_argument("--motion", nargs="+", choices=MOTIONS, default=MOTIONS)
    parser.add_argument("--modes", nargs="+", choices=MODES, default=MODES)
    parser.add_argument("--width", type=int, default=640, metavar="PX", help="columns; R grows with them")
    parser.add_argument("--repeats", type=int, default=3, metavar="N")
    parser.add_argument("--base", type=Path, metavar="CHECKOUT", help="another version")
    parser.add_argument("--base-modes", nargs="+", choices=MODES, default=MODES, help="that it makes, of --modes")
    parser.add_argument("--blender-python", type=Path, metavar="PATH", help="compare with path tracers")
    parser.add_argument("--rays", type=int, nargs=2, default=(16, 64), metavar="N", help="per pixel, to judge by")
    parser.add_argument("--kept", type=Path, default=KEPT, metavar="DIR", help="where those pictures are kept")
    parser.add_argument("-o", type=Path, dest="file", help="keep rows there, as JSON, and the table beside it")
    options = parser.parse_args()
    options.workers = {"": worker(Path(sys.executable))}
    if options.base:
        options.workers[BASE] = worker(options.base / ".venv" / "bin" / "python")
    for scene in (name for name in SCENES if options.only in name):
        for motion in options.motion:
            row = measured(options, scene, motion)
            print(row.figures(), flush=True)
            if options.file:
                keep(options.file, options.width, row)
            for mode, all_taken in row.taken.items():
                passes = {name: round(spent, 3) for name, spent in all_taken[-1].passes.items()}
                print(f"    {mode:16} {passes}")
            for traced in row.traced:
                print(f"    {traced}")


if __name__ == "__main__":
    main()
