"""A scene that several files look at, and frames in strips beside whole ones."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import clsco
from clsco.opencl.device import choose
from clsco.plan.memory import device_bytes
from clsco.plan.prepare import prepare
from clsco.plan.request import Request
from clsco.scene.model import Scene
from tests.scenes import assert_same

ROOT = Path(__file__).resolve().parents[2]
Array = NDArray[np.float64]
CAMERA: dict[str, Any] = {
    "resolution": [48, 36], "pixel_pitch": 0.1, "aperture_diameter": 20.0, "focus_distance": 250.0,
}  # fmt: skip
BALL: dict[str, Any] = {"shape": "sphere", "center": [3.0, 4.0, 265.0], "radius": 9.0, "texture": "bricks"}
WALL: dict[str, Any] = {"shape": "plane", "distance": 330.0, "texture": "checkerboard"}
# A slope of depths, 270 to 300 mm.
SLOPE: dict[str, Any] = {
    "shape": "depth_map", "texture": "bricks", "unit": "mm",
    "depth": 270.0 + np.add.outer(np.arange(32), np.arange(40.0)) / 2,
}  # fmt: skip
# A block of depths before a wall.
STEP = np.full((36, 48), 330.0)
STEP[10:26, 12:30] = 240.0
# Where something else than the PSF is looked at: compiled in a third of the time.
PLAIN = {"edge": "sampled", "tilt": False, "silhouette_samples": 1}


def printed_with_threads(threads: str, code: str) -> str:
    """Output of a process that runs `code` with so many threads of PoCL."""
    environ = os.environ | {"POCL_MAX_PTHREAD_COUNT": threads, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-c", code]
    return subprocess.run(command, env=environ, check=True, capture_output=True, text=True, timeout=300).stdout


def waves(frequencies: tuple[float, float], row: Array, column: Array, soft: int) -> Array:
    """Waves of so many rad per px along x and y, as a source's pixel and one of the detector leave of them where `soft`
    is 1.
    """
    across, down = (np.sinc(wave / 2 / np.pi) ** (2 * soft) for wave in frequencies)
    return 0.5 + 0.25 * across * np.sin(frequencies[0] * column) + 0.2 * down * np.cos(frequencies[1] * row)


def lens_points(radius: float, count: int = 800) -> Array:
    """Places (count, 2) of equal areas over a round lens, in mm from its middle."""
    number = np.arange(count) + 0.5
    size, turn = radius * np.sqrt(number / count), number * np.pi * (3.0 - 5.0**0.5)
    return np.stack([size * np.cos(turn), size * np.sin(turn)], axis=1)


def assert_strips_agree(wanted: Scene, truth: tuple[str, ...] = ()) -> Any:
    """All arrays of the first frame have the bits of the whole one where memory is a byte short of it; gives that."""
    memory = device_bytes(prepare(wanted, Request(truth), choose()).plan) - 1
    whole, cut = (clsco.render_frame(wanted, truth=truth, memory=limit) for limit in (None, memory))
    assert cut.metadata["strips"] > whole.metadata["strips"] == 1
    assert_same(cut, whole)
    return whole
