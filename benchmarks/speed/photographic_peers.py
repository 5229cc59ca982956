"""Path tracers on the photographic scenes: Mitsuba 3, where nothing moves, and Cycles, at equal error.

Both get what `benchmarks.truth.meshes` makes of a scene, with the same thin lens, box filter and images. An error is
the root of the mean of (x - a)(x - b), a and b being two independent pictures with more rays: their noise is in no such
mean, but for its scatter. Where nothing moves a is the mean of two by Mitsuba and b of two by Cycles.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterator
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
TIMED = (4, 64)  # rays per pixel of pictures whose times give that of a ray
LEAST_POWER = 0.5  # of the number of rays, by which noise falls in the end


@dataclass(frozen=True)
class Noise:
    """RMS noise of pictures by one program.

    Attributes
    ----------
    few, many : int
        Rays per pixel.
    of_few, of_many : float
        Noise with so many, of white.
    """

    few: int
    many: int
    of_few: float
    of_many: float

    def rays(self, error: float) -> float:
        """Rays per pixel that an RMS error takes.

        Noise falls as that of so few rays does at first, and as the inverse root in the end: from `many` on by the mean
        of both powers. Of 160 x 120 px of two of the scenes that is what Cycles does from 64 to 1,024 rays; Mitsuba's
        power is 1/2 throughout.
        """
        power = math.log(self.of_few / self.of_many) / math.log(self.many / self.few)
        return self.many * (self.of_many / error) ** (2.0 / (LEAST_POWER + max(power, LEAST_POWER)))


@dataclass(frozen=True)
class Traced:
    """Pictures of one scene by one program: rays per pixel that take RMS errors, and processor time in s of one."""

    name: str
    noise: Noise
    ray: float

    def at(self, error: float) -> float:
        """Processor time in s at an RMS error, of the rays alone."""
        return self.ray * self.noise.rays(error)


@dataclass(frozen=True)
class Judge:
    """Two independent pictures of a scene, (rows, columns, 3) of linear radiance, and the noise of each program's."""

    first: Array
    second: Array
    noise: dict[str, Noise]

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
        return render(self.camera, self.meshes, samples, seed, VARIANT)

    @property
    def names(self) -> tuple[str, ...]:
        """Programs that can render the scene."""
        return ("Mitsuba", "Cycles") if self.still else ("Cycles",)

    def judge(self, few: int, many: int, folder: Path) -> Judge:
        """Pictures to judge others by, and their noise; kept in a folder by what is in the scene."""
        digest = hashlib.sha256(repr((self.camera, few, many)).encode())
        for mesh in self.meshes:
            for array in (mesh.vertices, mesh.places, mesh.faces, mesh.image, mesh.poses):
                digest.update(np.ascontiguousarray(array).tobytes())
        path = folder / f"{digest.hexdigest()[:24]}.npz"
        if not path.exists():
            pairs, measured = list[tuple[Array, Array]](), {}
            for name in self.names:
                one, other = (self.picture(name, many, seed)[0] for seed in (1, 2))
                coarse = Judge(one, other, {}).error(self.picture(name, few, 3)[0])
                pairs.append((one, other))
                measured[name] = (few, many, coarse, float(np.sqrt(np.mean((one - other) ** 2) / 2.0)))
            means = [(one + other) / 2.0 for one, other in pairs] if len(pairs) > 1 else pairs[0]
            folder.mkdir(parents=True, exist_ok=True)
            kept = [image.astype(np.float32) for image in means]
            np.savez(path, first=kept[0], second=kept[1], noise=json.dumps(measured))
        with np.load(path, allow_pickle=False) as found:
            of_names = {name: Noise(*values) for name, values in json.loads(str(found["noise"])).items()}
            return Judge(found["first"].astype(float), found["second"].astype(float), of_names)

    def traced(self, judge: Judge) -> list[Traced]:
        """Times of all programs, each of the latter of two pictures, as the first ones compile and set up."""
        found = []
        for name in self.names:
            low, high = ([self.picture(name, count, seed)[1] for seed in (7, 8)][1] for count in TIMED)
            found.append(Traced(name, judge.noise[name], (high - low) / (TIMED[1] - TIMED[0])))
        return found


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
