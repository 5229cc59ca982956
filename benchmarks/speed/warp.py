"""Depth test and filling of the forward warp, against numba's depth test and a copy of what a filling reads and writes.

The scenes are those of the thesis' figures 4.14 and 4.15, where a plane comes nearer and turns by 45 degrees.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.box import SIMPLE
from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from benchmarks.blur.stages import MeasuredStages
from clsco.inputs.textures import load_scene_textures
from clsco.opencl.device import Device
from clsco.opencl.session import Session
from clsco.optics.motion import Pose, poses_at, rest_center, rest_poses
from clsco.optics.quadrics import place
from clsco.scene.examples import example
from clsco.scene.model import Scene

Array = NDArray[Any]

SCENES = {"nearer": "thesis/fig_4_14", "turned": "thesis/fig_4_15"}
EXAMPLE_SIZE = 512
ROUNDS = 5


@dataclass(frozen=True)
class WarpRow:
    """A part of the forward warp beside what it is measured against; process CPU time, medians, ns per pixel.

    stage: "depth test" or "filling"; peer: the fastest of what it is compared with; missing_share: of the pixels;
    times: peer_ns / cpu_ns.
    """

    scene: str
    size: int
    stage: str
    cpu_ns: float
    peer: str
    peer_ns: float
    missing_share: float
    times: float


def scene_at(name: str, size: int) -> tuple[Scene, Array]:
    """A scene of SCENES at size x size px with the field of view that it has at 512, and its texture."""
    scene = example(SCENES[name])
    pitch = scene.camera.pixel_pitch * EXAMPLE_SIZE / size
    camera = scene.camera.model_copy(update={"resolution": (size, size), "pixel_pitch": pitch})
    scene, (texture,) = load_scene_textures(scene.model_copy(update={"camera": camera}))
    return scene, texture.radiance


def numba_depth_tests(scene: Scene) -> dict[str, Callable[[], Array]]:
    """Numba's depth tests of a scene of one object, with one thread and with all."""
    from benchmarks.speed import direct, zbuffer

    (item,), (pose,) = scene.objects, poses_at(scene, scene.sequence.shutter, "left")
    step = scene.camera.pixel_pitch / scene.camera.normalization_distance
    args = (rest_inverse_depth(scene), _flat(pose), rest_center(item), step)
    return {
        "numba, one thread": partial(zbuffer.nearest_serial, *args, 1),
        "numba, threads": partial(zbuffer.nearest_threads, *args, direct.THREADS),
    }


def rest_inverse_depth(scene: Scene) -> Array:
    """Inverse depth (rows, columns) in 1/mm of the plane in its reference pose."""
    from clsco.reference.warp.warp import reproject_rest

    surfaces = [place(item, pose) for item, pose in zip(scene.objects, rest_poses(scene), strict=True)]
    return np.ascontiguousarray(reproject_rest(scene, surfaces, [None])[0])


def run(device: Device, size: int, advance: Callable[[], object]) -> list[WarpRow]:
    """Measure both stages of all scenes at size x size px. Raises DeviceError, KernelError."""
    rows = []
    with Session(device) as session:
        for name in SCENES:
            scene, texture = scene_at(name, size)
            stages, tests = MeasuredStages(session, scene, texture), numba_depth_tests(scene)
            spent = _measured([stages.depth_test, stages.gather, stages.fill, *tests.values()], advance)
            peers = dict(zip(tests, spent[3:], strict=True))
            fastest = min(peers, key=lambda key: peers[key])
            missing = stages.filled()
            copied = _measured([_copy(missing, stages.shape)], advance)[0]
            share = len(missing) / size**2
            found = [("depth test", spent[0], fastest, peers[fastest]), ("filling", spent[2], "copy", copied)]
            for stage, seconds, peer, other in found:
                ns = (1e9 * value / size**2 for value in (seconds, other))
                rows.append(WarpRow(name, size, stage, next(ns), peer, next(ns), share, other / seconds))
    return rows


def steps() -> int:
    """Number of times that `run` calls `advance`."""
    return 2 * ROUNDS * len(SCENES)


def _measured(calls: list[Callable[[], object]], advance: Callable[[], object]) -> list[float]:
    """Median process CPU time in s of each call, all called in turn, after a first round that does not count."""
    spent: list[list[float]] = [[] for _ in calls]
    for call in calls:
        call()
    for _ in range(ROUNDS):
        for times, call in zip(spent, calls, strict=True):
            start = time.process_time()
            call()
            times.append(time.process_time() - start)
        advance()
    return [float(np.median(times)) for times in spent]


def _copy(missing: Array, shape: tuple[int, int]) -> Callable[[], object]:
    """A copy of the neighborhoods of missing pixels in planes of `shape`: radiance, inverse depth and blur radius."""
    from benchmarks.speed import zbuffer

    types = (np.float32, np.float64, np.float64)
    planes = [np.ones(shape, dtype) for dtype in (*types, *types)]
    return partial(zbuffer.copy_neighborhoods, missing, *planes)


def _flat(pose: Pose) -> Array:
    return np.concatenate([np.ravel(pose.rotation), pose.shift])


def warp_table(rows: Sequence[WarpRow]) -> RenderableType:
    """Depth test and filling, with how many times the fastest of the others takes."""
    shown = Table(title=Text("Forward warp; ns per pixel"), title_justify="left", box=SIMPLE, pad_edge=False)
    for name in ("plane", "px", "stage", "ns", "peer", "its ns", "times"):
        shown.add_column(name, justify="left" if name in ("plane", "stage", "peer") else "right")
    for row in rows:
        figures = (f"{row.cpu_ns:.1f}", row.peer, f"{row.peer_ns:.1f}", f"{row.times:.2f}")
        shown.add_row(row.scene, f"{row.size}", row.stage, *figures)
    return shown
