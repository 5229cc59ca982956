"""Frames of the photographic scenes by the clsco of the Python that runs this, in a process that others ask.

It imports clsco and NumPy alone, so that the Python of another version can run it: a line of JSON on standard input for
each frame, a line of JSON on standard output with what it took.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

STILL = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Wanted:
    """A frame.

    Attributes
    ----------
    path : str
        Scene file.
    settings : tuple of str
        Keys and values, as `--set` takes them.
    still : bool
        Nothing moves.
    width : int
        Columns of the frame; the field of view stays, and blur radii in px grow with it.
    tolerance : float
        Largest RMS error that `clsco.render_frame` may make; 0 for what is exact.
    save : str
        File for the linear radiance (rows, columns, channels), float32; "" for none.
    """

    path: str
    settings: tuple[str, ...] = ()
    still: bool = False
    width: int = 640
    tolerance: float = 0.0
    save: str = ""


@dataclass(frozen=True)
class Taken:
    """Cost of a frame: processor time in s; elapsed time of its passes in s; time samples."""

    seconds: float
    passes: dict[str, float]
    samples: int


def scene_of(wanted: Wanted) -> Any:
    """The scene of a frame (`clsco.Scene`)."""
    import clsco

    scene = clsco.load_scene(wanted.path, list(wanted.settings))
    assert scene.camera.resolution is not None
    columns, rows = scene.camera.resolution
    if wanted.width != columns:
        pitch = scene.camera.pixel_pitch * columns / wanted.width
        scene = scene.replace("camera.resolution", (wanted.width, round(rows * wanted.width / columns)))
        scene = scene.replace("camera.pixel_pitch", pitch)
    if wanted.still:
        movers = [("object", k) for k, item in enumerate(scene.objects) if item.shape != "background"]
        movers += [("group", k) for k, _ in enumerate(scene.groups)]
        for kind, k in movers:
            for key in ("velocity", "angular_velocity"):
                scene = scene.replace(f"{kind}.{k}.motion.{key}", STILL)
    return scene


def worker(python: Path) -> subprocess.Popen[str]:
    """A process beside this Python that makes frames."""
    command = (str(python), str(Path(__file__).resolve()))
    return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)


def ask(process: subprocess.Popen[str], wanted: Wanted) -> Taken:
    """Have a worker make a frame."""
    assert process.stdin is not None
    assert process.stdout is not None
    process.stdin.write(json.dumps(asdict(wanted)) + "\n")
    process.stdin.flush()
    return Taken(**json.loads(process.stdout.readline()))


def serve() -> None:
    """Make the frames that lines of standard input ask for."""
    import clsco

    for line in sys.stdin:
        wanted = Wanted(**json.loads(line))
        scene = scene_of(wanted)
        before = time.process_time()
        frame = clsco.render_frame(scene, truth=(), tolerance=wanted.tolerance or None)
        seconds = time.process_time() - before
        if wanted.save:
            np.save(wanted.save, frame.color)
        samples = frame.metadata["samples"]
        print(json.dumps(asdict(Taken(seconds, frame.metadata["seconds"], samples))), flush=True)


if __name__ == "__main__":
    serve()
