"""Named degenerate cases: objects of which some ray is tangent, parallel, on an apex, at a horizon, or out of scale."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import product
from math import atan, degrees

import numpy as np
from numpy.typing import NDArray

from benchmarks.stability.hardcase import SINGLE_OR_DOUBLE
from benchmarks.stability.rays import REALS, Caster, RayTarget, Window
from clsco.engine.sequence import render_sweep
from clsco.errors import ClscoError
from clsco.frame.frame import Frame
from clsco.opencl.device import Device
from clsco.opencl.session import Session
from clsco.records import Real
from clsco.reference.common.geometry import solve_quadric
from clsco.scene.model import (
    Camera,
    Cone,
    Cylinder,
    Ellipsoid,
    Object,
    ObjectMotion,
    Plane,
    Quadric,
    Scene,
    Sequence,
    Sphere,
)

STEP = 1.0 / 64.0  # slope between rays, so that pixels fall exactly on what cases are about
ACROSS = 33  # rays a side; the one in the middle is the axis
SIDES = {"left": (-1.0, 0.0), "right": (1.0, 0.0), "top": (0.0, 1.0), "bottom": (0.0, -1.0)}
TURNS = {"": (0.0, 0.0, 0.0), ", turned by 90 deg": (90.0, 0.0, 0.0), ", turned by 180 deg": (0.0, 180.0, 0.0)}
# Coefficients of 3.39 about the center: squares, products xy yz zx, linear ones, constant.
QUADRICS = {
    "paraboloid open away": (0.01, 0.01, 0, 0, 0, 0, 0, 0, -1, 0),
    "paraboloid open towards the lens": (0.01, 0.01, 0, 0, 0, 0, 0, 0, 1, 0),
    "paraboloid across the axis": (0, 0.01, 0.01, 0, 0, 0, 1, 0, 0, 0),
    "saddle": (0.01, -0.01, 0, 0, 0, 0, 0, 0, 1, 0),
    "saddle of planes of rays": (0, 0, 0, 0.01, 0, 0, 0, 0, 1, 0),
    "parabolic cylinder": (0.01, 0, 0, 0, 0, 0, 0, 0, 1, 0),
    "hyperbolic cylinder": (1, 0, -1, 0, 0, 0, 0, 0, 0, -100),
    "elliptic cylinder along the axis": (1, 4, 0, 0, 0, 0, 0, 0, 0, -100),
    "hyperboloid of one sheet": (1, 1, -1, 0, 0, 0, 0, 0, 0, -100),
    "hyperboloid of two sheets": (1, 1, -1, 0, 0, 0, 0, 0, 0, 100),
    "hyperboloid about y": (1, -1, 1, 0, 0, 0, 0, 0, 0, -100),
    "double cone": (1, 1, -1, 0, 0, 0, 0, 0, 0, 0),
    "crossing planes": (1, 0, -1, 0, 0, 0, 0, 0, 0, 0),
    "crossing planes on rays": (1, -1, 0, 0, 0, 0, 0, 0, 0, 0),
    "parallel planes": (0, 0, 1, 0, 0, 0, 0, 0, 0, -100),
    "parallel planes along the axis": (1, 0, 0, 0, 0, 0, 0, 0, 0, -100),
    "double plane": (0, 0, 1, 0, 0, 0, 0, 0, 0, 0),
    "plane as a quadric": (0, 0, 0, 0, 0, 0, 0.5, 0, 1, 0),
    "line across": (0, 1, 1, 0, 0, 0, 0, 0, 0, 0),
    "point": (1, 1, 1, 0, 0, 0, 0, 0, 0, 0),
    "nothing": (1, 1, 1, 0, 0, 0, 0, 0, 0, 100),
    "imaginary cylinder": (1, 1, 0, 0, 0, 0, 0, 0, 0, 100),
    "weak curvature": (1e-9, 1e-9, 0, 0, 0, 0, 0, 0, 1, 0),
}


def _spheres() -> Iterator[tuple[str, Object]]:
    for (side, (x, y)), radius in product(SIDES.items(), (1e-3, 30.0, 1e6)):
        center = (x * radius, y * radius, 4.0 * radius)
        yield f"sphere of {radius:g} mm that touches the axis from the {side}", Sphere(radius=radius, center=center)
    for gap in (0.0, 1e-15, -1e-15, 1e-12, -1e-12, 1e-6, -1e-6, 1e-3, -1e-3):
        name = f"sphere, the lens {gap:+g} radii outside of it" if gap else "sphere with the lens on it"
        yield name, Sphere(radius=32.0, center=(0.0, 0.0, 32.0 * (1.0 + gap)))
    yield "sphere about the lens", Sphere(radius=32.0, center=(0.0, 0.0, 0.0))
    yield "sphere with the lens inside", Sphere(radius=32.0, center=(16.0, 0.0, -8.0))
    for radius, ratio in product((1e-6, 1e-3, 1.0, 1e3, 1e6, 1e9), (1.0001, 10.0, 1e4, 1e6)):
        if radius * ratio <= 1e9:
            center = (0.0, 0.0, radius * ratio)
            yield f"sphere of {radius:g} mm, {ratio:g} radii away", Sphere(radius=radius, center=center)
    for radius in (0.5, 30.0, 1e6):
        yield f"sphere of {radius:g} mm, 1 mm from the lens", Sphere(radius=radius, center=(0.0, 0.0, radius + 1.0))


def _ellipsoids() -> Iterator[tuple[str, Object]]:
    for axis, thickness in product(range(3), (1e-6, 1e-3, 1e3, 1e6)):
        a, b, c = (thickness if k == axis else 32.0 for k in range(3))
        distance = 256.0 + (thickness if axis == 2 else 0.0)
        yield (
            f"ellipsoid {thickness:g} mm thick along {'xyz'[axis]}",
            Ellipsoid(semi_axes=(a, b, c), center=(0.0, 0.0, distance)),
        )
    for side, (x, y) in SIDES.items():
        center = (32.0 * x, 8.0 * y, 256.0)
        yield f"ellipsoid that touches the axis from the {side}", Ellipsoid(semi_axes=(32.0, 8.0, 16.0), center=center)
    yield "ellipsoid with the lens on it", Ellipsoid(semi_axes=(32.0, 8.0, 16.0), center=(0.0, 0.0, 16.0))
    yield "ellipsoid about the lens", Ellipsoid(semi_axes=(32.0, 8.0, 16.0), center=(0.0, 0.0, 0.0))


def _cylinders() -> Iterator[tuple[str, Object]]:
    directions = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "the axis": (0.0, 0.0, 1.0), "x = y = z": (1.0, 1.0, 1.0)}
    for (along, axis), radius in product(directions.items(), (1e-6, 1e-3, 32.0, 1e6)):
        yield (
            f"cylinder of {radius:g} mm along {along}",
            Cylinder(radius=radius, axis=axis, center=(0.0, 0.0, 256.0 + 2.0 * radius)),
        )
    forward = (0.0, 0.0, 1.0)
    yield "cylinder along the axis with the lens on it", Cylinder(radius=32.0, axis=forward, center=(32.0, 0.0, 256.0))
    yield "cylinder along the axis beside the lens", Cylinder(radius=32.0, axis=forward, center=(64.0, 0.0, 256.0))
    yield "cylinder with its axis through the lens", Cylinder(radius=4.0, axis=(1.0, 2.0, 8.0), center=(1.0, 2.0, 8.0))
    yield "cylinder a little off the axis", Cylinder(radius=4.0, axis=(1e-9, 0.0, 1.0), center=(0.0, 0.0, 256.0))
    for side, (x, y) in SIDES.items():
        name = f"cylinder that touches the axis from the {side}"
        yield name, Cylinder(radius=32.0, axis=(y, x, 0.0), center=(32.0 * x, 32.0 * y, 256.0))


def _cones() -> Iterator[tuple[str, Object]]:
    angles = {
        "1e-3 deg": 1e-3,
        "on rays": degrees(atan(8.0 * STEP)),
        "45 deg": 45.0,
        "89 deg": 89.0,
        "almost a plane": 90.0 - 1e-9,
    }
    apexes = {
        "seen along its axis": (0.0, 0.0, 256.0),
        "1 mm away": (0.0, 0.0, 1.0),
        "apex on a ray": (32.0, 16.0, 256.0),
        "apex at the lens": (0.0, 0.0, 0.0),
        "apex behind the lens": (0.0, 0.0, -256.0),
    }
    for (angle, half_angle), (where, apex) in product(angles.items(), apexes.items()):
        yield f"cone, {angle}, open away, {where}", Cone(half_angle=half_angle, apex=apex, nappe="away")
        if apex[2] > 0.0:
            yield (
                f"cone, {angle}, open towards the lens, {where}",
                Cone(half_angle=half_angle, apex=apex, nappe="towards"),
            )


def _planes() -> Iterator[tuple[str, Object]]:
    slopes = {
        "facing": (0.0, 0.0),
        "with the horizon on rays": (1.0 / (8.0 * STEP), 0.0),
        "with the horizon on rays of two slopes": (1.0 / (8.0 * STEP), 1.0 / (8.0 * STEP)),
        "with the horizon a little beside rays": (1.0 / (8.0 * STEP) * (1.0 + 1e-12), 0.0),
        "almost along the axis": (0.0, 1e6),
        "along a diagonal": (-1e6, 1e6),
    }
    for (how, (slope_x, slope_y)), distance in product(slopes.items(), (1e-5, 1.0, 256.0, 1e9)):
        yield f"plane {how}, {distance:g} mm away", Plane(distance=distance, slope_x=slope_x, slope_y=slope_y)


def _quadrics() -> Iterator[tuple[str, Object]]:
    for (name, coefficients), scale in product(QUADRICS.items(), (1.0, 1e-20, 1e20)):
        scaled = tuple(scale * c for c in coefficients)
        suffix = "" if scale == 1.0 else f", times {scale:g}"
        yield f"{name}{suffix}", Quadric(coefficients=scaled, center=(0.0, 0.0, 256.0))
        if scale == 1.0:
            yield f"{name}, off the axis", Quadric(coefficients=scaled, center=(32.0, 16.0, 256.0))
            yield f"{name}, 1 mm away", Quadric(coefficients=scaled, center=(0.0, 0.0, 1.0))


def cases() -> dict[str, RayTarget]:
    """All targets by name; turned ones turn rays into rays exactly."""
    found = {}
    window = Window(STEP, -(ACROSS // 2), -(ACROSS // 2), ACROSS)
    for make in (_spheres, _ellipsoids, _cylinders, _cones, _planes, _quadrics):
        for name, item in make():
            found[name] = RayTarget(item, ObjectMotion(), window)
    for name in [name for name, target in found.items() if target.item.shape in ("plane", "ellipsoid", "cone")]:
        for suffix, angles in TURNS.items():
            turned = RayTarget(found[name].item, ObjectMotion(angular_velocity=angles), window)
            found[name + suffix] = turned
    return found


@dataclass(frozen=True)
class Outcome:
    """Result of a case in one precision: counts of numbers that are not finite, and of rays of another class than the
    reference's, none of which must be in double precision; refused: the reason if the case was refused."""

    name: str
    precision: Real
    rays: int
    not_finite: int
    other_class: int
    refused: str = ""

    @property
    def reached(self) -> bool:
        """True if nothing is wrong."""
        return self.not_finite == 0 and (self.other_class == 0 or self.precision == "float")


def reference_hits(target: RayTarget) -> NDArray[np.bool_]:
    """Mask of the rays of a target's window (side, side) that hit in the NumPy reference."""
    x, y = target.window.slopes()
    rays = np.stack([x.high, y.high, np.ones(x.high.shape)], axis=-1)
    w, label = solve_quadric(target.placed(), None, rays)
    assert np.isfinite(w).all()
    return label > 0


def cast(session: Session, targets: Mapping[str, RayTarget]) -> list[Outcome]:
    """Rays of every case, in every precision that the device has. Raises DeviceError, KernelError."""
    found = []
    for real in REALS:
        if real == "double" and not session.device.has_fp64:
            continue
        caster = Caster(session, real)
        for name, target in targets.items():
            hit, w = caster(target)
            lost = int((~np.isfinite(w)).sum() + (w[~hit] != 0.0).sum() + (w[hit] <= 0.0).sum())
            found.append(Outcome(name, real, hit.size, lost, _wrong(target, hit)))
    return found


def _wrong(target: RayTarget, hit: NDArray[np.bool_]) -> int:
    """Rays of another class than the reference's."""
    return int((hit != reference_hits(target)).sum())


def scene_of(target: RayTarget) -> Scene:
    """A frame of the rays of a target, one second after its reference pose."""
    # Nearly a pinhole, so that what is 1e-5 mm away can be shown, too.
    camera = Camera(resolution=(ACROSS, ACROSS), pixel_pitch=20.0 * STEP, f_number=1e6, focus_distance=250.0)
    item = target.item.model_copy(update={"motion": target.motion})
    sequence = Sequence(interval=2.0, samples=1)  # in the middle of the shutter
    return Scene(camera=camera, objects=(item,), sequence=sequence)


def distinct(targets: Mapping[str, RayTarget]) -> dict[str, RayTarget]:
    """Select the targets that are neither turned nor multiples of other targets."""
    return {name: target for name, target in targets.items() if ", turned by" not in name and ", times" not in name}


def rendered(targets: Mapping[str, RayTarget], device: Device) -> list[Outcome]:
    """The same by `clsco.render_sweep`, all outputs: a case may be refused, for what its blur would be."""
    found = []
    for real in REALS:
        if real == "double" and not device.has_fp64:
            continue
        names = list(targets)
        while names:
            scenes = [scene_of(targets[name]) for name in names]
            done = 0
            try:
                for k, frame in render_sweep(scenes, device=device.name, precision=SINGLE_OR_DOUBLE[real], frames=(0,)):
                    found.append(_outcome(names[k], targets[names[k]], frame, real))
                    done = k + 1
            except ClscoError as error:
                found.append(Outcome(names[done], real, 0, 0, 0, str(error)))
                done += 1
            names = names[done:]
    return found


def _outcome(name: str, target: RayTarget, frame: Frame, real: Real) -> Outcome:
    mask = frame.mask
    assert mask is not None
    assert frame.depth is not None
    arrays = {"color": frame.color, "depth where there is something": frame.depth[mask]}
    arrays |= {key: getattr(frame, key) for key in ("sharp", "blur_radius", "normal", "flow")}
    lost = sum(int((~np.isfinite(array)).sum()) for array in arrays.values())
    lost += int((frame.depth[~mask] != np.inf).sum())
    return Outcome(name, real, mask.size, lost, _wrong(target, mask))
