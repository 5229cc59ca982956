"""Hard cases of depth and of the blur's radius: the textbook's float32 and the package's kernels against the oracle."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from math import inf, nan

import mpmath
import numpy as np
from numpy.typing import NDArray

from benchmarks.stability import oracle
from benchmarks.stability.doubledouble import Wide, rounded, wide
from benchmarks.stability.hardcase import SINGLE_OR_DOUBLE, Compared, HardCase, Measured, hard_case, ns_per_value
from benchmarks.stability.rays import (
    DOUBTFUL,
    FEATURES,
    REALS,
    Caster,
    RayTarget,
    Window,
    certain,
    random_target,
    single_depth,
    ulps,
)
from clsco.opencl.session import Session
from clsco.optics.motion import rest_center
from clsco.optics.quadrics import canonical
from clsco.records import Real
from clsco.scene.model import Camera, Cone, Object, ObjectMotion, Plane, Quadric, Sphere

Array = NDArray[np.float64]
Single = NDArray[np.float32]
OTHER_ROOT = 0.01  # relative difference of depths from which on it is another root of the equation
TIMED_SIDE = 512
BOUNDS = (inf, 1.0)  # ULP of float32 in single precision, whose measure are radii of blur, and in double
LENSES = {
    "20 mm f/2": Camera(),
    "50 mm f/1.4": Camera(focal_length=50.0, f_number=1.4, focus_distance=2000.0, pixel_pitch=0.006),
    "400 mm f/2.8": Camera(focal_length=400.0, f_number=2.8, focus_distance=10000.0, pixel_pitch=0.005),
    "8 mm f/2.4": Camera(focal_length=8.0, f_number=2.4, focus_distance=500.0, pixel_pitch=0.002),
}
STILL = ObjectMotion()


def textbook(item: Object, x: Single, y: Single) -> tuple[NDArray[np.bool_], Single]:
    """Depth by the roots of A Z^2 + 2 B Z + C = 0, the closest positive one, all in float32 (3.20, 3.32, 3.42)."""
    q, linear, constant = _squares(item)
    at = rest_center(item).astype(np.float32)
    half = linear - q @ at
    c = at @ q @ at - 2 * (linear @ at) + constant
    with np.errstate(all="ignore"):
        a = q[0, 0] * x * x + q[1, 1] * y * y + q[2, 2]
        a = a + 2 * (q[0, 1] * x * y + q[1, 2] * y + q[2, 0] * x)
        b = half[0] * x + half[1] * y + half[2]
        if not q.any():
            z = -c / (2 * b)
            return z > 0, z
        root = np.sqrt(b * b - a * c)
        both = np.stack([(-b - root) / a, (-b + root) / a])
        z = np.fmin.reduce(np.where(both > 0, both, np.float32(np.nan)))
    return np.isfinite(z), z


def _squares(item: Object) -> tuple[Single, Single, np.float32]:
    """Matrix, half the linear part and constant of an object's equation in its own frame."""
    f, none = np.float32, np.zeros(3, np.float32)
    if isinstance(item, Plane):
        return np.zeros((3, 3), f), np.array([-item.slope_x, -item.slope_y, 1.0], f) / f(2), f(0)
    if isinstance(item, Sphere):
        return np.eye(3, dtype=f), none, -f(item.radius) * f(item.radius)
    if isinstance(item, Cone):
        spread = np.tan(f(np.radians(item.half_angle)))
        return np.diag(np.array([1, 1, -spread * spread], f)), none, f(0)
    assert isinstance(item, Quadric)
    xx, yy, zz, xy, yz, zx, *linear, constant = (f(v) for v in item.coefficients)
    matrix = np.array([[xx, xy / 2, zx / 2], [xy / 2, yy, yz / 2], [zx / 2, yz / 2, zz]], f)
    return matrix, np.array(linear, f) / f(2), constant


class Rays:
    """Casts rays in every precision that the device has, and compares them with the oracle."""

    def __init__(self, session: Session) -> None:
        self.session = session
        self.reals: list[Real] = [real for real in REALS if real == "float" or session.device.has_fp64]
        self.casters = {SINGLE_OR_DOUBLE[real]: Caster(session, real) for real in self.reals}

    def measure(self, target: RayTarget) -> Measured:
        """Errors of depth in ULP of float32 outside of DOUBTFUL, and how many rays there are of another class."""
        of = oracle.surface(target.item, target.motion)
        x, y = target.window.slopes()
        exact = oracle.solve(of, x, y)
        sure = certain(target, of, exact, DOUBTFUL)
        forms = {"naive": textbook(target.item, x.high.astype(np.float32), y.high.astype(np.float32))}
        for form, cast in self.casters.items():
            hit, w = cast(target)
            forms[form] = hit, single_depth(hit, w)
        return {form: _compared(hit, z, exact, sure) for form, (hit, z) in forms.items()}

    def times(self, target: RayTarget) -> dict[str, float]:
        """ns per ray of each form, for TIMED_SIDE^2 of them by a program for this shape alone."""
        large = replace(target, window=replace(target.window, side=TIMED_SIDE))
        rays = TIMED_SIDE**2
        x, y = (v.high.astype(np.float32) for v in large.window.slopes())
        found = {"naive": ns_per_value(lambda: textbook(large.item, x, y), rays)}
        shape = canonical(large.item)
        quadratic = bool(shape.q.any())
        features = FEATURES | {"QUADRATIC": int(quadratic), "LINEAR": int(quadratic and bool(shape.l.any()))}
        features |= {"NAPPE": int(shape.nappe != 0), "BOUNDED": 0}
        for real in self.reals:
            caster = Caster(self.session, real, TIMED_SIDE, features)
            found[SINGLE_OR_DOUBLE[real]] = ns_per_value(partial(caster.launch, "cast", large), rays)
        return found


def _compared(hit: NDArray[np.bool_], z: Single, exact: oracle.Depths, sure: NDArray[np.bool_]) -> Compared:
    both = hit & exact.hit & sure
    with np.errstate(all="ignore"):
        off = np.abs(z.astype(np.float64) * exact.w.high - 1.0)
    other = both & ~(off < OTHER_ROOT)
    wrong = (sure & (hit != exact.hit)) | other
    same = both & ~other
    at = Wide(exact.w.high[same], exact.w.low[same])
    worst = float(ulps(z[same], at).max()) if same.any() else nan
    return Compared(worst, int(wrong.sum()), hit.size)


def _around(half: float, side: int = 64) -> Window:
    """A window about the axis, `half` as wide as a slope."""
    return Window(2.0 * half / side, -side // 2, -side // 2, side)


def far_sphere(rays: Rays, quick: bool) -> HardCase:
    """A sphere of 1 mm up to 1e6 mm away: c^2 - rho^2 and the discriminant cancel."""
    ratios = [2.0, 100.0, 1e4, 1e6] if quick else [1e4, *np.geomspace(1.5, 1e6, 25).tolist()]
    found = []
    for ratio in ratios:
        target = RayTarget(Sphere(radius=1.0, center=(0.0, 0.0, ratio)), STILL, _around(1.2 / ratio))
        found.append((ratio, rays.measure(target)))
    target = RayTarget(Sphere(radius=1.0, center=(0.0, 0.0, 1e4)), STILL, _around(1.2e-4, TIMED_SIDE))
    times = {} if quick else rays.times(target)
    remedy = "discriminant by Lagrange's identity, (c - rho)(c + rho), w = C / (c + sqrt(D/4))"
    return hard_case("sphere far away", "c / rho", "ULP", found, BOUNDS, remedy, times)


def central_quadrics(rays: Rays, quick: bool) -> HardCase:
    """600 random central quadrics of any signature, up to 1e6 times their size away."""
    rng, found = np.random.default_rng(4), []
    for number in range(60 if quick else 600):
        target = random_target("definite quadric" if number % 2 else "indefinite quadric", rng)
        target = replace(target, motion=STILL, window=replace(target.window, side=32))
        item = target.item
        assert isinstance(item, Quadric)
        size = abs(item.coefficients[9]) ** 0.5
        found.append((float(np.linalg.norm(item.center)) / size, rays.measure(target)))
    remedy = "discriminant by Lagrange's identity in the object's frame, determinants by FMA"
    times = {} if quick else rays.times(target)
    return hard_case("random central quadrics", "c / size", "ULP", found, BOUNDS, remedy, times)


def asymptotes(rays: Rays, quick: bool) -> HardCase:
    """x^2 - y^2 = z - 256 along rays that are nearly, or exactly, its asymptotes."""
    item, found = Quadric(coefficients=(1, -1, 0, 0, 0, 0, 0, 0, -1, 0), center=(0.0, 0.0, 256.0)), []
    for exponent in (4, 12, 20) if quick else range(4, 22):
        window = Window(0.24 / 2**exponent, -(2**exponent) - 32, 2**exponent - 32)
        found.append((2.0**exponent, rays.measure(RayTarget(item, STILL, window))))
    remedy = "roots C / (-B + sqrt D) and A / (-B - sqrt D): the linear case needs no branch"
    times = {} if quick else rays.times(RayTarget(item, STILL, _around(0.2, TIMED_SIDE)))
    return hard_case("leading coefficient to 0", "(x^2 + y^2) / (x^2 - y^2)", "ULP", found, BOUNDS, remedy, times)


def cone_nappe(rays: Rays, quick: bool) -> HardCase:
    """A cone seen along its axis: every ray meets both nappes, or the mirror one alone."""
    found = []
    for angle in (10.0, 45.0, 80.0) if quick else np.linspace(5.0, 85.0, 17).tolist():
        target = RayTarget(Cone(half_angle=angle, apex=(0.0, 0.0, 250.0)), STILL, _around(0.5))
        found.append((angle, rays.measure(target)))
    remedy = "w = (1 - a')/c, and the sign of Z - c chooses the nappe"
    times = {} if quick else rays.times(target)
    return hard_case("cone, closest positive root", "half angle, deg", "ULP", found, BOUNDS, remedy, times)


def horizon(rays: Rays, quick: bool) -> HardCase:
    """A plane, ever closer to where it vanishes."""
    item, found = Plane(distance=251.3, slope_x=3.7), []
    vanishes = 1.0 / item.slope_x
    for exponent in (2, 9, 16) if quick else range(2, 17):
        step = 2.0**-exponent * vanishes / 64
        window = Window(step, -32, round(vanishes / step) - 66)  # the last two columns miss the plane
        found.append((2.0**exponent, rays.measure(RayTarget(item, STILL, window))))
    target = RayTarget(item, STILL, _around(0.2, TIMED_SIDE))
    remedy = "w is linear: no division, no singularity"
    times = {} if quick else rays.times(target)
    return hard_case("plane at the horizon", "1 / (1 - b x)", "ULP", found, BOUNDS, remedy, times)


def scaled_quadric(rays: Rays, quick: bool) -> HardCase:
    """A sphere whose equation is multiplied by up to 1e25, as of lengths of 1e20 its square would be."""
    found = []
    for exponent in (0, 10, 20, 25) if quick else range(-25, 26, 5):
        scale = 10.0**exponent
        coefficients = (scale, scale, scale, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -900.0 * scale)
        target = RayTarget(Quadric(coefficients=coefficients, center=(0.0, 0.0, 280.0)), STILL, _around(0.15))
        found.append((scale, rays.measure(target)))
    remedy = "coefficients scaled by a power of two on the host; lengths beyond 1e9 mm are refused"
    times = {} if quick else rays.times(target)
    return hard_case("c = 1e20 overflows", "factor", "ULP", found, BOUNDS, remedy, times)


def near_focus(rays: Rays, quick: bool) -> HardCase:
    """The blur radius of four lenses from half the distance in focus up to 1e9 mm and beyond."""
    found = []
    for camera in LENSES.values():
        with mpmath.workdps(oracle.DIGITS):
            exact = [mpmath.mpf(v) for v in (camera.focal_length, camera.sensor_distance, camera.pixel_pitch)]
            power = 1 / exact[0] - 1 / exact[1]
            kappa = mpmath.mpf(camera.normalization_distance) * camera.aperture_diameter / (2 * exact[2])
            scale, focus, distance = rounded([kappa]), rounded([power]), float(1 / power)
        for nearest in (0.5, 0.999) if quick else (0.5, 0.9, 0.99, 0.999, 0.9999):
            # Rays at a plane whose inverse depth falls evenly from `nearest` focal distances to its mirror image,
            # and to none from half of it.
            span = 1.0 / nearest - 1.0
            item = Plane(distance=distance, slope_x=1.0)
            found.append((1.0 / span, _blur(rays, camera, item, Window(span / 32, -32, -32), (scale, focus))))
    remedy = "K = 1/f - 1/s in float64 on the host, R from K - w"
    return hard_case(
        "1/f - 1/u - 1/s near focus", "u / |u - u_focus|", "px", found, (1e-4, 1e-4), remedy, classes=False
    )


def _blur(rays: Rays, camera: Camera, item: Plane, window: Window, lens: tuple[Wide, Wide]) -> Measured:
    target = RayTarget(item, STILL, window)
    depths = oracle.solve(oracle.surface(item, STILL), *window.slopes())
    far = depths.hit & (depths.w.high >= 1e-9)
    w = Wide(depths.w.high[far], depths.w.low[far])
    scale, focus = lens
    exact = scale * (focus - w)
    f = np.float32
    u = (wide(1.0) / w).high.astype(f)
    kappa = f(camera.normalization_distance) * f(camera.aperture_diameter) / (f(2) * f(camera.pixel_pitch))
    naive = kappa * (f(1) / f(camera.focal_length) - f(1) / u - f(1) / f(camera.sensor_distance))
    forms = {"naive": naive.astype(np.float64)}
    for form, caster in rays.casters.items():
        forms[form] = caster.blur(target, camera)[1][far]
    return {form: Compared(float(np.abs((wide(r) - exact).high).max()), 0, int(far.sum())) for form, r in forms.items()}


CASES: Sequence[Callable[[Rays, bool], HardCase]] = (
    far_sphere, central_quadrics, asymptotes, cone_nappe, horizon, near_focus, scaled_quadric,
)  # fmt: skip
