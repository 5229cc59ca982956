"""Predicted and measured time of frames: what `clsco plan` says of a scene.

    python -m benchmarks.speed.prediction [--only WORD] [--width PX] [-o FILE]

Scenes of examples, as they are and with other lenses, PSFs and colors, and the photographic ones, still and moving
(`benchmarks.speed.photographic`), with so many columns. Measured is the processor time of a warm frame over the number
of cores: what it takes where nothing else runs. Fails where a prediction is off by more than a factor of 2 and 10 ms.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Mapping
from itertools import product
from pathlib import Path
from time import process_time
from typing import Any

from benchmarks.speed import photographic
from benchmarks.speed.photographic_frames import scene_of
from clsco import Scene, load_sweep
from clsco.engine.probe import measure_frame
from clsco.engine.sequence import render_prepared
from clsco.frame.outputs import ALL_TRUTH, truth_names
from clsco.opencl.session import Session, session_for
from clsco.plan.prepare import Prepared, prepare
from clsco.plan.request import Request

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
COLOR = {"object.0.texture": "#c86432"}
ONCE = {"sequence.samples": 1}
RIMS = {"aperture.rim": [{"distance": 30.0, "diameter": 12.0}, {"distance": -6.0, "diameter": 12.0}]}
WAVES = {"psf.model": "wave"}
FACTOR, SMALL = 2.0, 0.01  # s, of which a prediction may be off in any case
LONG, FRAMES = 2.0, 3  # s, of frames that are measured once, and how often others are
WIDTH = 320  # px
Keys = Mapping[str, Any]
OF_EXAMPLES: tuple[tuple[str, Keys], ...] = (
    ("background", {}), ("bowl", {}), ("camera_motion", {"sequence.samples": 3}), ("card", {"sequence.samples": 3}),
    ("cart", ONCE), ("cone_turning", {"sequence.samples": 3}), ("cylinder", {}), ("depth_map", {}),
    ("depth_map", {"camera.f_number": 1}), ("focal_stack", {}), ("lit", {}), ("occlusion_ground", {}),
    ("occlusion_ground", {"camera.f_number": 1}), ("occlusion_interpenetrating", {}), ("occlusion_near_sphere", {}),
    ("occlusion_passing", ONCE), ("occlusion_sharp_near", {}),
    ("occlusion_sharp_near", {"psf.occlusion": "layered"}), ("occlusion_three", {}), ("occlusion_three", COLOR),
    ("occlusion_three", {"camera.f_number": 1}), ("occlusion_three", {"psf.occlusion": "none"}),
    ("occlusion_three", {"psf.model": "gaussian"}), ("occlusion_three", {"psf.silhouette_samples": 8}),
    ("occlusion_three", {"aperture.shape": "polygon"}), ("occlusion_tube", {}), ("occlusion_wire", COLOR),
    ("plane_approaching", {}), ("plane_defocused", {"camera.f_number": 0.1}),
    ("plane_moving", {"sequence.samples": 25, "psf.edge": "sampled", "psf.border": "renormalize"}),
    ("plane_tilted", COLOR | {"camera.f_number": 0.5}), ("plane_tilted", {"camera.f_number": 0.25}),
    ("plane_tilted", {"camera.f_number": 0.15}),
    ("plane_tilted", {"psf.model": "gaussian", "camera.f_number": 1}),
    ("plane_tilted", {"psf.edge": "sampled", "camera.f_number": 0.25}),
    ("plane_tilted", {"aperture.shape": "polygon", "camera.f_number": 1}),
    ("plane_tilted", RIMS | {"camera.f_number": 1}), ("occlusion_three", RIMS),
    ("plane_tilted", RIMS | {"aperture.shape": "polygon", "camera.f_number": 1}),
    ("plane_tilted", WAVES | {"camera.f_number": 1}), ("occlusion_three", WAVES),
    ("plane_tilted", WAVES | {"aperture.shape": "polygon", "camera.f_number": 1}), ("road", {}),
    ("sphere", COLOR | {"camera.f_number": 0.5}), ("sphere", {"sensor": {}}),
    ("sphere_turning", {"sequence.samples": 3}), ("stereo", {}),
    ("thesis_pipeline", {}), ("thesis_pipeline", {"sequence.samples": 25}), ("tube", {}),
)  # fmt: skip
WITH_TRUTH = {"cart", "lit", "stereo"}
HEAD = f"""# Predicted and measured time of frames

`python -m benchmarks.speed.prediction -o FILE`: photographic scenes have {WIDTH} columns. Predicted: what `clsco plan`
says, which measures a share of a frame. Measured: processor time of a whole, warm frame over the number of cores.
"""


def scenes(width: int) -> Iterable[tuple[str, Scene]]:
    """All scenes by their names; width: columns of the photographic ones."""
    for name, keys in OF_EXAMPLES:
        scene = load_sweep(EXAMPLES / f"{name}.toml").scenes[0]
        for key, value in keys.items():
            scene = scene.replace(key, value)
        told = (f"{key}={value}" if isinstance(value, str | float | int) else key for key, value in keys.items())
        yield " ".join([name, *told]), scene
    for name, motion in product(photographic.SCENES, ("still", "moving")):
        yield f"photographic {name} {motion}", scene_of(photographic.wanted(name, motion, "visibility", width))


def measured(session: Session, prepared: Prepared) -> float:
    """Processor time of a warm frame over the number of cores, s: the least of a few."""
    spent = list[float]()
    while len(spent) < FRAMES and not (spent and spent[-1] > LONG):
        began = process_time()
        for _ in render_prepared(session, [prepared], [prepared.scene.sequence.frames // 2]):
            pass
        spent.append((process_time() - began) / session.device.compute_units)
    return min(spent)


def main() -> int:
    """Read the command line, measure, print."""
    formatter = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=formatter)
    parser.add_argument("--only", default="", metavar="WORD", help="in the name of a scene")
    parser.add_argument("--width", type=int, default=WIDTH, metavar="PX", help="of photographic scenes")
    parser.add_argument("-o", "--output", type=Path, metavar="FILE", help="write the table to a file")
    options = parser.parse_args()
    session, wrong, rows = session_for("cpu"), 0, ["| scene | predicted, ms | measured, ms | ratio | measured on |"]
    rows.append("|---|---|---|---|---|")
    for name, scene in ((name, scene) for name, scene in scenes(options.width) if options.only in name):
        truth = truth_names(ALL_TRUTH) if name.split()[0] in WITH_TRUTH else ()
        prepared = prepare(scene, Request(truth), session.device)
        time = measure_frame(session, prepared)
        seconds = measured(session, prepared)
        ratio = time.seconds / seconds
        off = not (abs(time.seconds - seconds) < SMALL or 1 / FACTOR < ratio < FACTOR)
        wrong += off
        figures = f"{1e3 * time.seconds:.3g} | {1e3 * seconds:.3g} | {ratio:.2f}{' (off)' * off} | {time.share:.1%}"
        rows.append(f"| {name} | {figures} |")
        print(rows[-1], flush=True)
    text = f"{len(rows) - 2} scenes, {wrong} off by more than a factor of {FACTOR:g}"
    print(text)
    if options.output is not None:
        options.output.write_text("\n".join([HEAD, *rows, "", f"{text}.", ""]), "utf-8")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
