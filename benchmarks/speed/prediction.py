"""Predicted and measured time of frames: what `clsco plan` and `clsco validate` say of a scene.

    python -m benchmarks.speed.prediction [--only WORD] [--width PX] [--write]

Scenes of examples, as they are and with other lenses, PSFs and colors, and the photographic ones, still and moving
(`benchmarks.speed.photographic`), with so many columns. Measured is the processor time of a warm frame, the less of
two, over the number of cores: what it takes where nothing else runs. Fails where a prediction is off by more than a
factor of 2 and 10 ms; --write first fits the rates in clsco/cost/rates.py to what was measured, pass by pass, and takes
this machine's core as that which they are of.
"""

from __future__ import annotations

import argparse
import re
import sys
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.speed import photographic
from benchmarks.speed.photographic_frames import scene_of
from clsco import Scene, load_sweep
from clsco.cost import rates
from clsco.cost.predict import core_seconds, cost_of, host_work
from clsco.cost.work import Work, frame_work
from clsco.engine.sequence import render_prepared
from clsco.frame.frame import ALL_TRUTH, truth_names
from clsco.opencl.session import Session, session_for
from clsco.plan.prepare import Prepared, prepare
from clsco.plan.request import Request

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
COLOR = {"object.0.texture": "#c86432"}
ONCE = {"sequence.samples": 1}
RIMS = {"aperture.rim": [{"distance": 30.0, "diameter": 12.0}, {"distance": -6.0, "diameter": 12.0}]}
WAVES = {"psf.model": "wave"}
FACTOR, SMALL = 2.0, 0.01  # s, of which a prediction may be off in any case
LONG = 2.0  # s, of frames that are measured once after the first, which may compile
STEPS, ROUNDS, TINY = 3000, 12, 1e-300  # of the fit
WIDTH = 320  # px
NOTHING = 1e-12  # s, of an operation that the fit has no use for
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
# Kinds of passes by their kernels: the others are of the kind that their plan has besides.
KERNELS = {
    "cast": "trace", "aim": "trace", "pinhole": "pinhole",
    "mark_silhouettes": "silhouettes", "label_subpixels": "silhouettes", "trace_subpixels": "silhouettes",
    "trace_small": "silhouettes", "trace_detail": "silhouettes", "sharpen": "silhouettes",
    "ground_truth": "ground truth", "host": "host",
    "reproject_targets": "reproject", "reproject_nearest": "reproject", "reproject_gather": "reproject",
    "accumulate": "accumulate", "sense": "sensor", "find_discontinuities": "cluster", "label_depth_layers": "cluster",
    "seed_hidden": "cluster", "column_seeds": "cluster", "reach_hidden": "cluster", "open_depth_layer": "cluster",
    "push": "cluster", "pull": "cluster", "take_depth_layer": "cluster",
}  # fmt: skip
BLURS, SOURCES = ("gather", "convolve", "sum_across", "sum_down"), ("prepare_sources",)


@dataclass(frozen=True)
class Case:
    """A scene, its work by kinds of passes, and what it took, s of processor time; of kinds of passes, too."""

    name: str
    prepared: Prepared
    work: dict[str, Work]
    seconds: float
    of_kinds: dict[str, float]


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


def measured(session: Session, name: str, scene: Scene) -> Case:
    """Work of a scene and its time: the less of two frames after one that compiles."""
    truth = truth_names(ALL_TRUTH) if name.split()[0] in WITH_TRUTH else ()
    prepared = prepare(scene, Request(truth), session.device)
    best, of_kernels = np.inf, dict[str, float]()
    for number in range(3):
        began = time.process_time()
        frames = [frame for _, frame in render_prepared(session, [prepared], [0])]
        spent = time.process_time() - began
        if number and spent < best:
            best, of_kernels = spent, {}
            for frame in frames:
                for kernel, seconds in frame.metadata["seconds"].items():
                    of_kernels[kernel] = of_kernels.get(kernel, 0.0) + seconds
        if number and spent > LONG:
            break
    work: dict[str, Work] = {}
    for plan in prepared.plans:
        for kind, found in [
            *((step.kind, w) for step, w in frame_work(plan, prepared.maps)),
            ("host", host_work(plan)),
        ]:
            for operation, count in found.items():
                sums = work.setdefault(kind, {})
                sums[operation] = sums.get(operation, 0.0) + count
    share, of_kinds = best / sum(of_kernels.values()), dict[str, float]()
    for kernel, seconds in of_kernels.items():
        kind = kind_of(kernel, work.keys())
        of_kinds[kind] = of_kinds.get(kind, 0.0) + share * seconds
    return Case(name, prepared, work, best, of_kinds)


def kind_of(kernel: str, kinds: Iterable[str]) -> str:
    """Kind of the pass, of those of a plan, that runs a kernel."""
    if kernel in KERNELS:
        return KERNELS[kernel]
    beside = next((kind for kind in kinds if kind in ("depth layers", "fill", "count missing")), "blur")
    if beside == "depth layers":
        return beside
    return "blur" if kernel in BLURS else "sources" if kernel in SOURCES else beside


def fitted(cases: Iterable[Case]) -> dict[str, float]:
    """Rates, none below 0, that come closest to what was measured by its ratio, of passes of all cases at once."""
    rows = [(case.work[kind], spent) for case in cases for kind, spent in case.of_kinds.items() if kind in case.work]
    rows = [(work, spent) for work, spent in rows if any(work.values()) and spent > 0.0]
    names = sorted({name for work, _ in rows for name, count in work.items() if count})
    counts = np.array([[work.get(name, 0.0) for name in names] for work, _ in rows])
    spent = np.array([seconds for _, seconds in rows])
    known = spent.sum() / counts.sum(axis=0) / len(names)
    for _ in range(ROUNDS):
        weight = 1.0 / np.sqrt(spent * (counts @ known))
        scale = known.copy()
        a, b, c = counts * weight[:, None] * scale, spent * weight, np.ones(len(names))
        for _ in range(STEPS):  # multiplicative updates (Lee, Seung 2001)
            c *= (a.T @ b) / np.maximum(a.T @ (a @ c), TINY)
        known = c * scale
    return dict(zip(names, known.tolist(), strict=True))


def write(found: Mapping[str, float]) -> None:
    """Put rates, and the time of this machine's core, into clsco/cost/rates.py."""
    path = Path(rates.__file__)
    text = path.read_text("utf-8")
    for name, value in found.items():
        rates.RATES[name] = float(f"{value:.2g}") if value > NOTHING else 0.0
        text = re.sub(rf'(    "{re.escape(name)}": )[^,]*,', rf"\g<1>{rates.RATES[name]:.2g},", text)
    rates.CORE_SECONDS = float(f"{core_seconds():.3g}")
    text = re.sub(r"CORE_SECONDS = .*", f"CORE_SECONDS = {core_seconds():.3g}", text)
    path.write_text(text, "utf-8")


def shown(case: Case, slower: float) -> bool:
    """Print the row of a scene at once, and say whether its prediction is off."""
    cost = cost_of(case.prepared, cores=1, slower=slower)
    assert cost is not None
    ratio = cost.seconds / case.seconds
    off = not (abs(cost.seconds - case.seconds) < SMALL or 1 / FACTOR < ratio < FACTOR)
    times = f"{1e3 * cost.seconds:.3g} | {1e3 * case.seconds:.3g} | {ratio:.2f}{' (off)' * off}"
    print(f"| {case.name} | {times} | {cost.dearest[0]} {cost.dearest[1]:.0%} |", flush=True)
    return off


def main() -> int:
    """Read the command line, measure, print."""
    formatter = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=formatter)
    parser.add_argument("--only", default="", metavar="WORD", help="in the name of a scene")
    parser.add_argument("--width", type=int, default=WIDTH, metavar="PX", help="of photographic scenes")
    parser.add_argument("--write", action="store_true")
    options = parser.parse_args()
    session = session_for(None)
    chosen = [(name, scene) for name, scene in scenes(options.width) if options.only in name]
    cases: Iterable[Case] = (measured(session, name, scene) for name, scene in chosen)
    if options.write:
        cases = list(cases)
        write(fitted(cases))
    slower = core_seconds() / rates.CORE_SECONDS
    print("| scene | predicted, ms | measured, ms | ratio | most costly |\n|---|---|---|---|---|")
    wrong = sum(shown(case, slower) for case in cases)
    core = f"a core takes {slower:.2f} of the rates'"
    print(f"{len(chosen)} scenes, {wrong} off by more than a factor of {FACTOR:g}; {core}")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
