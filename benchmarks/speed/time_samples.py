"""Time samples of the photographic scenes: how many their motion needs, their error, and the time of a frame.

    python -m benchmarks.speed.time_samples [--only NAME ...] [--width 640] [--samples 17] [--exact 65] [--repeats 2]

Processor time of a whole call, by turns, beside that of one time sample; worst pixel and RMS of the difference to a
frame of many time samples (`--exact`, 0 for none), of white.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

import clsco
from benchmarks.speed.photographic_frames import Wanted, scene_of

SCENES = Path(__file__).parent / "scenes"
NAMES = ("portrait", "street", "fence", "macro", "cart")


def _timed(scene: Any) -> tuple[Any, float]:
    before = time.process_time()
    frame = clsco.render_frame(scene, truth=())
    return frame, time.process_time() - before


def _measure(name: str, width: int, samples: int, exact: int, repeats: int) -> str:
    scene = scene_of(Wanted(str(SCENES / f"{name}.toml"), width=width))
    scenes = {key: scene.replace("sequence.samples", key) for key in (1, "auto", samples)}
    seconds: dict[Any, list[float]] = {key: [] for key in scenes}
    frames = {}
    for repeat in range(repeats + 1):
        for key, each in scenes.items():
            frames[key], taken = _timed(each)
            if repeat:  # the first one compiles
                seconds[key].append(taken)
    one = median(seconds[1])
    words = [f"{name}, {width} px: one sample {one:.2f} s"]
    many = _timed(scene.replace("sequence.samples", exact))[0].color.astype(np.float64) if exact else None
    for key in ("auto", samples):
        found = median(seconds[key])
        text = f"{key} = {frames[key].metadata['samples']} samples {found:.2f} s, {found / one:.2f} times"
        if many is not None:
            off = np.abs(frames[key].color - many)
            text += f", worst {off.max():.1e}, RMS {np.sqrt(np.mean(off**2)):.1e}"
        words.append(text)
    return "; ".join(words)


def main() -> None:
    """Print a line for each scene."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="*", choices=NAMES, default=NAMES)
    parser.add_argument("--width", type=int, default=640)
    parser.add_argument("--samples", type=int, default=17)
    parser.add_argument("--exact", type=int, default=65)
    parser.add_argument("--repeats", type=int, default=2)
    wanted = parser.parse_args()
    for name in wanted.only:
        print(_measure(name, wanted.width, wanted.samples, wanted.exact, wanted.repeats), flush=True)


if __name__ == "__main__":
    main()
