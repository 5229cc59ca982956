"""Path tracers on the photographic scenes: Mitsuba 3, where nothing moves, and Cycles, at equal error.

Both get what `benchmarks.truth.meshes` makes of a scene, with the same thin lens, box filter and images. An error is
the root of the mean of (x - a)(x - b), a and b being two independent pictures with more rays: their noise is in no such
mean, but for its scatter. Where nothing moves a is by Mitsuba and b by Cycles.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.speed.photographic_frames import Wanted, scene_of
from benchmarks.truth.cycles_meshes import Cycles
from benchmarks.truth.meshes import Mesh, meshes_of
from benchmarks.truth.mitsuba import VARIANT
from benchmarks.truth.mitsuba_meshes import render
from clsco.inputs.textures import load_scene_textures

Array = NDArray[Any]
POSES = 5
THREADS = 2
SLOWEST, FASTEST = 0.5, 1.0  # exponents of the number of rays, by which noise falls


@dataclass(frozen=True)
class Traced:
    """Pictures of one scene by one program with different numbers of rays.

    Attributes
    ----------
    name : str
        Program.
    samples : tuple of int
        Rays per pixel, at least two numbers, ascending.
    seconds : tuple of float
        Processor time in s of each.
    errors : tuple of float
        RMS error of each, of white.
    """

    name: str
    samples: tuple[int, ...]
    seconds: tuple[float, ...]
    errors: tuple[float, ...]

    def at(self, error: float) -> float:
        """Processor time in s at an RMS error: from the fastest and the slowest picture, noise falling on as it does
        between them, and without what does not grow with the number of rays."""
        (fewest, most), (low, high) = (ends(values) for values in (self.samples, self.errors))
        power = math.log(low / high) / math.log(most / fewest)
        rays = most * (high / error) ** (1.0 / min(max(power, SLOWEST), FASTEST))
        first, last = ends(self.seconds)
        return rays * (last - first) / (most - fewest)


def ends(values: Sequence[Any]) -> tuple[Any, Any]:
    """First and last of some values."""
    return values[0], values[-1]


@dataclass(frozen=True)
class Judge:
    """Two independent pictures of a scene, (rows, columns, 3) of linear radiance."""

    first: Array
    second: Array

    def error(self, image: Array) -> float:
        """RMS error of a picture that is independent of both."""
        return math.sqrt(max(float(np.mean((image - self.first) * (image - self.second))), 0.0))


@dataclass(frozen=True)
class Peers:
    """Path tracers with one scene. cycles: a process with it; still: nothing moves."""

    camera: Any
    meshes: list[Mesh]
    cycles: Cycles
    still: bool

    def picture(self, name: str, samples: int, seed: int) -> tuple[Array, float]:
        """A picture and its processor time in s."""
        if name == "Cycles":
            return self.cycles.render(samples, seed)
        return render(self.camera, self.meshes, samples, [seed], VARIANT)[0]

    @property
    def names(self) -> tuple[str, ...]:
        """Programs that can render the scene."""
        return ("Mitsuba", "Cycles") if self.still else ("Cycles",)

    def judge(self, samples: int, folder: Path) -> Judge:
        """Two pictures to judge others by, with so many rays per pixel; kept in a folder by what is in the scene."""
        digest = hashlib.sha256(repr((self.camera, samples)).encode())
        for mesh in self.meshes:
            for array in (mesh.vertices, mesh.places, mesh.faces, mesh.image, mesh.poses):
                digest.update(np.ascontiguousarray(array).tobytes())
        path = folder / f"{digest.hexdigest()[:24]}.npz"
        if not path.exists():
            pictures = [self.picture(name, samples, seed)[0] for seed, name in enumerate(self.names * 2)][:2]
            folder.mkdir(parents=True, exist_ok=True)
            np.savez(path, first=pictures[0], second=pictures[1])
        with np.load(path, allow_pickle=False) as found:
            return Judge(found["first"], found["second"])

    def traced(self, name: str, samples: Sequence[int], judge: Judge) -> Traced:
        """Pictures by a program after one that does not count, by which it compiles and sets up."""
        self.picture(name, 1, 7)
        found = [self.picture(name, count, 8 + k) for k, count in enumerate(samples)]
        seconds, errors = tuple(spent for _, spent in found), tuple(judge.error(image) for image, _ in found)
        return Traced(name, tuple(samples), seconds, errors)


@contextmanager
def peers_of(wanted: Wanted, blender_python: Path) -> Iterator[Peers]:
    """Path tracers with a scene. blender_python: Python that has `bpy`."""
    scene, textures = load_scene_textures(scene_of(wanted))
    meshes = meshes_of(scene, [texture.radiance for texture in textures], POSES)
    cycles = Cycles(blender_python, scene.camera, meshes, THREADS)
    try:
        yield Peers(scene.camera, meshes, cycles, not any(mesh.moves for mesh in meshes))
    finally:
        cycles.close()
