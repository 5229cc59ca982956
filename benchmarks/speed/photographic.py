"""Frames of the kind that a lens is opened for: time of each way of occlusion, of two versions by turns.

    python -m benchmarks.speed.photographic [--only NAME] [--motion moving one still] [--modes none layered visibility]
        [--width 640] [--repeats 3] [--base CHECKOUT] [-o FILE]

The scenes are benchmarks/speed/scenes/*.toml, in color, 640 x 480 px: wide blur behind and before what is in focus.
`moving` takes the time samples of `auto`, `one` takes one of the same motion, and `still` has none. Figures are medians
of processor time of `clsco.render_frame` in s, without ground truth; the first frame, which compiles, counts only where
it is the only one. `--base` names a checkout of another version with its .venv, which makes the frames by turns.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path
from statistics import median

from benchmarks.speed.photographic_frames import Taken, Wanted, ask, worker
from benchmarks.tables import Figures, write_table

SCENES = ("portrait", "street", "fence", "macro", "cart")
FOLDER = Path(__file__).parent / "scenes"
MOTIONS = ("still", "one", "moving")
MODES = ("none", "layered", "visibility")
BASE = "base "


@dataclass(frozen=True)
class Row:
    """Frames of one scene with one motion, by modes of occlusion; those of the base have BASE before the mode."""

    scene: str
    motion: str
    taken: dict[str, list[Taken]]

    def seconds(self, mode: str) -> float:
        """Median of processor time, s."""
        found = self.taken[mode]
        return median(one.seconds for one in found[len(found) > 1 :])

    def figures(self) -> Figures:
        """A row of the table."""
        found: dict[str, float | str] = {"scene": self.scene, "motion": self.motion}
        found["time samples"] = str(next(iter(self.taken.values()))[0].samples)
        found |= {f"{mode}, s": self.seconds(mode) for mode in self.taken}
        for mode in MODES:
            if BASE + mode in self.taken:
                found[f"{BASE}/ {mode}"] = self.seconds(BASE + mode) / self.seconds(mode)
        return found


def wanted(scene: str, motion: str, mode: str, width: int) -> Wanted:
    """A frame of a scene."""
    settings = [f"psf.occlusion={mode}", *(["sequence.samples=1"] if motion == "one" else [])]
    return Wanted(str(FOLDER / f"{scene}.toml"), tuple(settings), motion == "still", width)


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
    parser.add_argument("-o", type=Path, dest="file", help="also write the table as Markdown")
    options = parser.parse_args()
    workers = {"": worker(Path(sys.executable))}
    if options.base:
        workers[BASE] = worker(options.base / ".venv" / "bin" / "python")
    rows = []
    for scene in (name for name in SCENES if options.only in name):
        for motion in options.motion:
            taken: dict[str, list[Taken]] = {}
            for _ in range(options.repeats):
                for mode in options.modes:
                    for version, process in workers.items():
                        found = ask(process, wanted(scene, motion, mode, options.width))
                        taken.setdefault(version + mode, []).append(found)
            rows.append(Row(scene, motion, taken))
            print(rows[-1].figures(), flush=True)
            for mode, all_taken in taken.items():
                passes = {name: round(spent, 3) for name, spent in all_taken[-1].passes.items()}
                print(f"    {mode:16} {passes}")
    if options.file:
        write_table(options.file, f"# Photographic scenes, {options.width} columns", [row.figures() for row in rows])


if __name__ == "__main__":
    main()
