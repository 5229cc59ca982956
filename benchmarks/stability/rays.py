"""Windows of rays at random surfaces: the package's geometry on the device, against the oracle."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import log, sqrt
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from benchmarks.stability import oracle
from benchmarks.stability.doubledouble import Wide, wide
from clsco.opencl.buffers import download, empty, upload
from clsco.opencl.program import Target, launch
from clsco.opencl.session import Session
from clsco.optics.lens import Lens
from clsco.optics.motion import pose_at, rest_center
from clsco.optics.point_spread import point_spread
from clsco.optics.psf_tables import psf_features
from clsco.optics.quadrics import PlacedSurface, place
from clsco.optics.visibility import OcclusionGroup
from clsco.passes.blur import PIXELS
from clsco.passes.pack import grid_struct, group_struct, lens_struct, surface_structs
from clsco.plan.buffers import STATISTICS
from clsco.records import REAL, Real, Struct
from clsco.scene.model import Camera, Cone, Cylinder, Ellipsoid, Object, ObjectMotion, Plane, Psf, Quadric, Sphere
from clsco.scene.quantities import Vector

Array = NDArray[np.float64]
SIDE = 64  # rays a side of a window
DOUBTFUL = 2.0**-20  # of the terms of discriminant and leading coefficient, within which hit or miss may differ
FARTHEST_RATIO = 1e6  # of distance and size
REALS: tuple[Real, Real] = ("double", "float")
ROUNDING = 2.0**-24  # of an operation in single precision
NEARER, MOST_ZOOMS = 32, 3  # each time at an outline, rays are so many times closer together
FARTHEST_PIXEL = 2**23  # from the axis; frames have up to 2^16 px a side
# Every shape by one program: what a shape has no use for is 0.
FEATURES = {"SEVERAL": 0, "QUADRATIC": 1, "LINEAR": 1, "NAPPE": 1, "BOUNDED": 1, "OCCLUDED": 0, "MOVED": 0, "TILT": 0}
FEATURES |= {"TEXTURED": 0, "LIT": 0, "CURVED": 0}
FEATURES |= {"FILTER": 0, "CHANNELS": 1, "SUBPIXELS": 0} | psf_features(point_spread(Psf()))


@dataclass(frozen=True)
class Window:
    """Rays through pixels `row` to row + side - 1 and likewise columns, (0, 0) on the axis, slopes `step` apart."""

    step: float
    row: int = -SIDE // 2
    column: int = -SIDE // 2
    side: int = SIDE

    def slopes(self) -> tuple[Wide, Wide]:
        """x and y of the rays, (side, side), exactly."""
        number = np.arange(self.side, dtype=np.float64)
        x, y = np.meshgrid(self.column + number, -(self.row + number))
        return wide(x) * wide(self.step), wide(y) * wide(self.step)


@dataclass(frozen=True)
class RayTarget:
    """An object after one second of its motion, and rays at it."""

    item: Object
    motion: ObjectMotion
    window: Window

    def placed(self) -> PlacedSurface:
        """The surface as the package places it."""
        return place(self.item, pose_at(self.motion, 1.0, "euler"))


class Caster:
    """Casts windows of rays of up to `side` by kernels of kernels/trace, in one precision."""

    def __init__(
        self, session: Session, real: Real, side: int = SIDE, features: Mapping[str, int] = FEATURES
    ) -> None:  # fmt: skip
        self.session, self.real = session, real
        self.program = Target(session, ["trace/cast.cl"], features, real)
        self.texture, area = upload(session, np.ones((1, 1), np.float32)), side * side
        self.value, self.wide, self.class_ = (empty(session, size * area) for size in (4, REAL[real].itemsize, 1))
        self.statistics = empty(session, 4 * STATISTICS)

    def __call__(self, target: RayTarget) -> tuple[NDArray[np.bool_], Array]:
        """Cast the rays of a target: mask of hits (side, side), and inverse depth in 1/mm with all its digits."""
        self.launch("cast", target)
        return self._found(target.window.side)

    def blur(self, target: RayTarget, camera: Camera) -> tuple[NDArray[np.bool_], Array]:
        """Cast the rays of a target: mask of hits (side, side), and the signed blur radius there in px."""
        self.launch("pinhole", target, lens_struct(Lens.of(camera), self.real))
        return self._found(target.window.side)

    def launch(self, name: str, target: RayTarget, *lens: Struct) -> None:
        """Run a kernel over the window and wait for it; lens: lens_t of one that needs it."""
        window = target.window
        grid = grid_struct(1, 1, 0, self.real, step=window.step)
        # A frame of one pixel on the axis, with sources on a grid anywhere around it.
        grid["guard"], grid["top"] = -window.column, window.row
        grid["above"], grid["width"], grid["height"] = 0, window.side, window.side
        surfaces = upload(self.session, surface_structs([target.item], [target.placed()], self.real))
        values: tuple[Any, ...] = self.texture, self.value, self.wide
        args = (grid, *lens, surfaces, group_struct(OcclusionGroup(1, 0), 1), *values)
        last = (self.class_, *((self.statistics,) if name == "pinhole" else ()))
        launch(self.session, self.program[name], (window.side,) * 2, PIXELS, *args, *last)
        self.session.queue.finish()

    def _found(self, side: int) -> tuple[NDArray[np.bool_], Array]:
        values = download(self.session, self.wide, (side, side), REAL[self.real]).astype(np.float64)
        return download(self.session, self.class_, (side, side), np.uint8) > 0, values


def single_depth(hit: NDArray[np.bool_], w: Array) -> NDArray[np.float32]:
    """Depth in mm as users get it, float32; infinite where nothing is."""
    return np.where(hit, 1.0 / np.where(hit, w, 1.0), np.inf).astype(np.float32)


def ulps(found: NDArray[np.float32], exact_w: Wide) -> Array:
    """Distance of depths from 1 / w, in units of the last place of float32 there."""
    exact = wide(1.0) / exact_w
    off = (wide(found.astype(np.float64)) - exact).high
    return np.abs(off) / np.spacing(np.abs(exact.high).astype(np.float32)).astype(np.float64)


def certain(target: RayTarget, of: oracle.Surface, exact: oracle.Depths, band: float) -> NDArray[np.bool_]:
    """Mask of rays whose discriminant and leading coefficient are not within `band` of 0, relative to their own terms.

    Those of the discriminant are what Lagrange's identity leaves of B^2 - A C: its sign is no rounding there, even
    where both products are 1e12 times their difference.
    """
    surface, (x, y) = target.placed(), target.window.slopes()
    d = np.tensordot(np.stack([x.high, y.high, np.ones(x.high.shape)], axis=-1), surface.turn, axes=(-1, 1))
    q, l, o = (np.abs(v) for v in (surface.canonical.q, surface.canonical.l, surface.offset))  # noqa: E741
    m = np.abs(np.cross(np.broadcast_to(surface.offset, d.shape), d))
    d = np.abs(d)
    # Of a ray through an apex nothing is left but its own rounding.
    m += ROUNDING * np.linalg.norm(o) * np.linalg.norm(d, axis=-1, keepdims=True)
    a, ld = d**2 @ q, d @ l
    # The oracle's equation is the same up to a factor.
    own, others = (q, of.q) if q.any() else (l, of.l)
    scale = float(np.linalg.norm(own)) / sqrt(sum(float(v) ** 2 for v in others.flat))
    discriminant = np.abs(exact.discriminant.high) * scale**2
    if not q.any():  # a plane: D = (l.d)^2, and the sign is that of l.d
        return np.asarray(np.sqrt(discriminant) > band * ld)
    i, j = [1, 2, 0], [2, 0, 1]
    mixed = 2.0 * (q * d * (l[i] * m[..., j] + l[j] * m[..., i])).sum(axis=-1)
    terms = abs(surface.canonical.k) * a + m**2 @ (q[i] * q[j]) + ld**2 + mixed
    # Where the leading coefficient vanishes so does the smaller root, whatever its sign; the larger one stays.
    safe = exact.larger | (np.abs(exact.leading.high) * scale > band * a)
    return np.asarray((discriminant > band * terms) & safe)


# Random targets


def _size_and_place(rng: np.random.Generator, ratio: float) -> tuple[float, Vector, float]:
    """Size in mm, center at `ratio` sizes, and half the width of a window that shows it, as a slope."""
    size, half = float(np.exp(rng.uniform(-4.0, 6.0))), float(rng.uniform(0.8, 1.6)) / ratio
    # Pixels are numbered from the axis, so what is measured from close by cannot be far off it.
    off_axis = min(0.7, 2.0 * half / SIDE * FARTHEST_PIXEL / NEARER ** float(rng.uniform(0.0, MOST_ZOOMS)))
    towards = np.array([*rng.uniform(-off_axis, off_axis, 2), 1.0])
    x, y, z = (towards * (size * ratio / np.linalg.norm(towards))).tolist()
    return size, (x, y, z), half


def _any_turn(rng: np.random.Generator) -> ObjectMotion:
    return ObjectMotion(angular_velocity=tuple(rng.uniform(-180.0, 180.0, 3).tolist()))


def _sphere(rng: np.random.Generator, ratio: float) -> tuple[Object, float]:
    size, center, half = _size_and_place(rng, ratio)
    return Sphere(radius=size, center=center), half


def _cylinder(rng: np.random.Generator, ratio: float) -> tuple[Object, float]:
    size, center, half = _size_and_place(rng, ratio)
    return Cylinder(radius=size, center=center, axis=tuple(rng.standard_normal(3).tolist())), half


def _ellipsoid(rng: np.random.Generator, ratio: float) -> tuple[Object, float]:
    size, center, half = _size_and_place(rng, ratio)
    axes = size * np.exp(rng.uniform(-3.0, 0.0, 3))
    return Ellipsoid(semi_axes=tuple(axes.tolist()), center=center), half


def _plane(rng: np.random.Generator, ratio: float) -> tuple[Object, float]:
    slope_x, slope_y = (3.0 * rng.standard_normal(2)).tolist()
    return Plane(distance=float(ratio), slope_x=slope_x, slope_y=slope_y), 0.6


def _cone(rng: np.random.Generator, ratio: float) -> tuple[Object, float]:
    _, apex, _ = _size_and_place(rng, ratio)
    nappe: Literal["away", "towards"] = "away" if rng.random() < 0.5 else "towards"
    return Cone(half_angle=float(rng.uniform(3.0, 85.0)), apex=apex, nappe=nappe), float(rng.uniform(0.05, 0.8))


def _quadric(definite: bool) -> Callable[[np.random.Generator, float], tuple[Object, float]]:
    def make(rng: np.random.Generator, ratio: float) -> tuple[Object, float]:
        size, center, half = _size_and_place(rng, ratio)
        q = np.exp(rng.uniform(-2.0, 2.0, 3)) * (1.0 if definite else rng.choice([-1.0, 1.0], 3))
        linear = np.zeros(3)
        if not definite and rng.random() < 0.3:  # a paraboloid
            q[0], linear[0] = 0.0, size * rng.uniform(-1.0, 1.0)
        axes = np.linalg.qr(rng.standard_normal((3, 3)))[0]
        m, linear = axes.T @ np.diag(q) @ axes, 2.0 * linear @ axes
        constant = -(size**2) if definite else size**2 * rng.choice([-1.0, 1.0])
        second = [m[0, 0], m[1, 1], m[2, 2], 2 * m[0, 1], 2 * m[1, 2], 2 * m[2, 0]]
        wide_view = not definite and rng.random() < 0.5
        coefficients = tuple(float(v) for v in (*second, *linear, constant))
        return Quadric(coefficients=coefficients, center=center), float(rng.uniform(0.05, 0.5)) if wide_view else half

    return make


FAMILIES: dict[str, Callable[[np.random.Generator, float], tuple[Object, float]]] = {
    "plane": _plane,
    "cylinder": _cylinder,
    "sphere": _sphere,
    "cone": _cone,
    "ellipsoid": _ellipsoid,
    "definite quadric": _quadric(True),
    "indefinite quadric": _quadric(False),
}


def random_target(family: str, rng: np.random.Generator) -> RayTarget:
    """An object of a family, turned any way, 1.05 to FARTHEST_RATIO sizes away, and a window that shows it."""
    ratio = float(np.exp(rng.uniform(log(1.05), log(FARTHEST_RATIO))))
    item, half = FAMILIES[family](rng, ratio)
    step = 2.0 * half / SIDE
    x, y, z = rest_center(item).tolist()
    row, column = (round(v / step) - SIDE // 2 for v in (-y / z, x / z))
    return RayTarget(item, _any_turn(rng), Window(step, row, column))


def closer(target: RayTarget, hit: NDArray[np.bool_], rng: np.random.Generator) -> RayTarget | None:
    """The same object in a window on its outline, None where there is none or a pixel's number would be too large."""
    window = target.window
    edges = np.argwhere(hit[1:] != hit[:-1])
    if not len(edges):
        return None
    row, column = edges[rng.integers(len(edges))].tolist()
    row, column = ((v * NEARER) for v in (window.row + row, window.column + column))
    # The outline passes between this row and the next.
    row, column = row + NEARER // 2 - SIDE // 2, column - SIDE // 2
    if max(abs(row), abs(column)) >= FARTHEST_PIXEL:
        return None
    return RayTarget(target.item, target.motion, Window(window.step / NEARER, row, column))
