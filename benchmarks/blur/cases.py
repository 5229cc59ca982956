"""Cases of the benchmark: a grid of them, and the scene that they share (float64, pure)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from math import inf
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from clsco.errors import ClscoError
from clsco.optics.point_spread import point_spread
from clsco.plan.methods import Blur
from clsco.scene.model import Psf

Array = NDArray[Any]
Precision = Literal["double", "single"]
Scene = Literal["varying", "constant"]

SMALLEST_SIZE, LARGEST_SIZE = 16, 8192  # px a side
LARGEST_RADIUS = 60.0  # px
PSFS = {
    "sampled": Psf(edge="sampled", tilt=False),
    "integrated, tilt": Psf(),
    "gaussian": Psf(model="gaussian"),
}
# The reference takes a time that grows with the crop's area and the PSF's: a few seconds at most.
SMALLEST_CROP, LARGEST_CROP, CROP_TIMES_EXTENT = 32, 160, 2400.0
QUANTILES = 16  # radii of a map that stand for all of them where taps are counted


@dataclass(frozen=True)
class Case:
    """One row of the benchmark.

    size: px a side; radius: largest |R| of the map, px; scene: many radii, or one; psf: its name in PSFS; tool: clsco,
    or whose method it is; precision: of the geometry, for others of everything.
    """

    size: int
    radius: float
    scene: Scene
    psf: str
    channels: int
    precision: Precision
    tool: str
    method: str

    @property
    def kind(self) -> Case:
        """The same at any size."""
        return replace(self, size=0)

    @property
    def task(self) -> tuple[int, float, Scene, str, int]:
        """Key that cases share whose speed and error can be compared."""
        return self.size, self.radius, self.scene, self.psf, self.channels


@dataclass(frozen=True)
class BenchGrid:
    """The axes of the benchmark; rounds: timed calls of a case; longest_s: cases with longer calls are left out.

    once_s: longer calls are timed once; slowest: ways of clsco that take so many times as long as its fastest one, on a
    crop or at a smaller size, are left out; both_to: above so many px a side only the first precision is measured, as
    the blur itself is the same; minutes: after which no case is begun.
    """

    sizes: tuple[int, ...] = (512, 1024, 2048, 4096, 8192)
    radii: tuple[float, ...] = (0.0, 2.0, 6.0, 20.0, 60.0)
    channels: tuple[int, ...] = (1, 3)
    precisions: tuple[Precision, ...] = ("double", "single")
    rounds: int = 3
    longest_s: float = 10.0
    once_s: float = 0.3
    slowest: float = 10.0
    both_to: int = 2048
    minutes: float | None = None


FULL = BenchGrid()
QUICK = BenchGrid(sizes=(256, 512), radii=(2.0, 6.0, 20.0), channels=(1,), precisions=("double",), longest_s=0.2)


@dataclass(frozen=True)
class Peer:
    """A tool of others that blurs as well.

    Attributes
    ----------
    tool, method : str
        Its name, and that of its way.
    scene : str
        That it can do, "varying" or "constant".
    psf : str
        Name in PSFS.
    set_up : callable
        From linear radiance (rows, columns[, channels]), float32, and radii (rows, columns) in px to the call that is
        timed, which returns the blurred image. Makes its tables.
    """

    tool: str
    method: str
    scene: Scene
    psf: str
    set_up: Callable[[Array, Array], Callable[[], Array]]


def make_grid(quick: bool, sizes: Sequence[int], radii: Sequence[float], minutes: float | None = None) -> BenchGrid:
    """The grid of the command's options; sizes and radii in px, none: the grid's own, and all else that there is.

    Raises ClscoError.
    """
    for size in sizes:
        if not SMALLEST_SIZE <= size <= LARGEST_SIZE:
            raise ClscoError(f"--size: must be {SMALLEST_SIZE} to {LARGEST_SIZE} px; got {size}")
    for radius in radii:
        if not 0.0 <= radius <= LARGEST_RADIUS:
            raise ClscoError(f"--radius: must be 0 to {LARGEST_RADIUS:g} px; got {radius:g}")
    if minutes is not None and not 0.0 < minutes < inf:
        raise ClscoError(f"--minutes: must be above 0; got {minutes:g}")
    base = replace(QUICK if quick else FULL, minutes=minutes)
    sides, largest = tuple(sorted(set(sizes))) or base.sizes, tuple(sorted(set(radii))) or base.radii
    return replace(base, sizes=sides, radii=largest)


def methods(scene: Scene) -> tuple[str, ...]:
    """Methods that are measured on a scene, the fastest first: those for one radius have a scene of their own."""
    known = [name for name in get_args(Blur) if name != "none"]
    return tuple(name for name in known if (name == "convolve") == (scene == "constant"))


def grid_cases(grid: BenchGrid, has_fp64: bool, peers: Sequence[Peer] = ()) -> list[Case]:
    """The cases of a grid, those with the same scene side by side; those of `peers` take floats."""
    known = [precision for precision in grid.precisions if precision == "single" or has_fp64]
    found: list[Case] = []
    for size in grid.sizes:
        precisions = known if size <= grid.both_to else known[:1]
        for radius in grid.radii:
            for scene in get_args(Scene):
                for psf in PSFS:
                    found += [
                        Case(size, radius, scene, psf, channels, precision, "clsco", method)
                        for channels in grid.channels
                        for precision in precisions
                        for method in methods(scene)
                    ]
                    found += [
                        Case(size, radius, scene, psf, channels, "single", peer.tool, peer.method)
                        for channels in grid.channels
                        for peer in peers
                        if (peer.scene, peer.psf) == (scene, psf)
                    ]
    return found


def radius_map(side: int, largest: float) -> Array:
    """Signed radii (side, side) in px of a sphere before a tilted plane, float32: of both precisions the same discs."""
    i, j = np.mgrid[0:side, 0:side] / (side - 1.0) - 0.5
    plane = largest * (0.7 + 0.6 * j)
    ball = 1.0 - np.sqrt(np.maximum(1.0 - (np.hypot(i, j) / 0.4) ** 2, 0.0))
    return np.where(np.hypot(i, j) < 0.4, 0.3 * largest * ball, plane).astype(np.float32)


@lru_cache(maxsize=2)
def scene_radii(size: int, largest: float, scene: Scene) -> Array:
    """Signed radii (size, size) in px of a case's scene."""
    return radius_map(size, largest) if scene == "varying" else np.full((size, size), largest)


@lru_cache(maxsize=1)
def picture(size: int) -> Array:
    """Linear radiance (size, size, 3), float32: uniform random numbers, of which nothing averages out."""
    return np.random.default_rng(0).random((size, size, 3), dtype=np.float32)


def channels_of(image: Array, channels: int) -> Array:
    """The first channels of an image (rows, columns, 3); a single one as (rows, columns)."""
    return np.ascontiguousarray(image[..., 0] if channels == 1 else image[..., :channels])


def crop_of(size: int, largest: float, psf: Psf) -> tuple[slice, slice]:
    """Rows and columns of the window whose error is measured: on the sphere's right edge, smaller for wider PSFs."""
    wanted = CROP_TIMES_EXTENT / (float(largest * point_spread(psf).extent) + 1.0)
    side = min(size, int(np.clip(wanted, SMALLEST_CROP, LARGEST_CROP)))
    top, left = (size - side) // 2, min(round(0.9 * size) - side // 2, size - side)
    return slice(top, top + side), slice(left, left + side)


@lru_cache(maxsize=64)
def mean_taps(psf: Psf, largest: float, scene: Scene) -> float:
    """Weights above 0 that a source has, in the mean over a scene."""
    radii = np.abs(scene_radii(256, largest, scene))
    levels = (np.arange(QUANTILES) + 0.5) / QUANTILES
    return float(np.mean([_taps(psf, radius) for radius in np.quantile(radii, levels).tolist()]))


def _taps(psf: Psf, radius: float) -> int:
    offset = np.arange(point_spread(psf).reach(radius) + 1.0)
    times = np.where(offset > 0, 2, 1)
    lit = point_spread(psf).weights(offset[None, :], offset[:, None], np.asarray(radius)) > 0
    return int(times @ lit @ times)
