"""Hard cases of what comes after the rays: point spread functions, sums, forward warps, motion, missing pixels."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from math import comb, erf, pi

import mpmath
import numpy as np
from numpy.typing import NDArray

from benchmarks.blur.stages import MeasuredStages
from benchmarks.stability.hardcase import Compared, HardCase, Measured, hard_case, ns_per_value
from benchmarks.stability.oracle import DIGITS
from clsco.engine.defocus import defocus
from clsco.engine.inpaint import inpaint
from clsco.engine.sequence import render
from clsco.errors import SceneError
from clsco.inputs.pupils import scene_point_spread
from clsco.inputs.textures import load_texture
from clsco.opencl.session import Session
from clsco.optics.lens import LARGEST_BLUR, blur_radius
from clsco.optics.motion import pose_at
from clsco.optics.point_spread import point_spread
from clsco.passes.pack import pose_structs
from clsco.plan.plan import make_plan
from clsco.records import Real
from clsco.scene.model import Camera, Motion, ObjectMotion, Plane, Psf, Scene
from clsco.scene.model import Sequence as Exposure

Array = NDArray[np.float64]
PILLBOX = Psf(tilt=False, occlusion="none")
GAUSSIAN = Psf(model="gaussian", tilt=False, occlusion="none")
BOTH: tuple[tuple[str, Real], ...] = (("single", "float"), ("double", "double"))


def _times(values: int, **calls: Callable[[], object]) -> dict[str, float]:
    return {form: ns_per_value(call, values) for form, call in calls.items()}


# Point spread functions: "single" are the device's, from tables of float32, "double" the closed forms


def on_device(session: Session, psf: Psf, radii: Array) -> Array:
    """The PSFs (n, side, side) of blur radii (n,) in px, as `clsco.defocus` spreads a single bright pixel."""
    side, n = 2 * point_spread(psf).reach(float(radii.max())) + 3, len(radii)
    image = np.zeros((side, n * side), np.float32)
    image[side // 2, side // 2 :: side] = 1.0
    maps = np.repeat(radii, side)[None].repeat(side, axis=0)
    found = defocus(image, maps, psf, device=session.device.name, outside="black")
    return found.astype(np.float64).reshape(side, n, side).swapaxes(0, 1)


def in_closed_form(psf: Psf, radii: Array) -> Array:
    """The same by `PointSpread.weights`."""
    offset = np.arange(
        -point_spread(psf).reach(float(radii.max())) - 1.0, point_spread(psf).reach(float(radii.max())) + 2.0
    )
    return point_spread(psf).weights(offset[None, None, :], offset[None, :, None], radii[:, None, None])


def sampled(psf: Psf, radii: Array, ratio: float, normalized: bool) -> Array:
    """The thesis in float32, on the grid of `in_closed_form`: centers within R or 2 sigma, no blur below 0.5 px."""
    half = point_spread(psf).reach(float(radii.max())) + 1
    r = radii.astype(np.float32)[:, None, None]
    offset = np.arange(-half, half + 1).astype(np.float32)
    square = offset[None, None, :] ** 2 + offset[None, :, None] ** 2
    center = (square == 0) & (r < 0.5)
    if point_spread(psf).uniform:
        shares = np.where(square <= r * r, 1 / (np.float32(pi) * r * r), np.float32(0))
    else:
        sigma = np.float32(ratio) * r
        gauss = np.exp(-square / (2 * sigma * sigma)) / (2 * np.float32(pi) * sigma * sigma)
        shares = np.where(square <= 4 * sigma * sigma, gauss, np.float32(0))
    shares = np.where(r < 0.5, center.astype(np.float32), shares)
    if normalized:
        shares = shares / shares.sum(axis=(1, 2), keepdims=True)
    return shares.astype(np.float64)


def _forms(session: Session, psf: Psf, radii: Array, ratio: float, normalized: bool) -> dict[str, Array]:
    return {
        "naive": sampled(psf, radii, ratio, normalized),
        "single": on_device(session, psf, radii),
        "double": in_closed_form(psf, radii),
    }


def _psf_times(session: Session, psf: Psf, radii: Array) -> dict[str, float]:
    calls: dict[str, Callable[[], object]] = {
        "naive": lambda: sampled(psf, radii, 1.0, True),
        "single": lambda: on_device(session, psf, radii),
        "double": lambda: in_closed_form(psf, radii),
    }
    return _times(in_closed_form(psf, radii).size, **calls)


def _by_radius(radii: Array, errors: Mapping[str, Array]) -> list[tuple[float, Measured]]:
    return [
        (float(r), {form: Compared(float(error[k]), 0, 1) for form, error in errors.items()})
        for k, r in enumerate(radii)
    ]


def steps_of_radius(session: Session, psf: Psf, name: str, ratio: float) -> HardCase:
    """Measure how far a PSF changes from one radius to the next, which a ramp in depth shows as an edge."""
    step = 0.01
    radii = np.arange(0.05, 6.0, step)
    errors = {
        form: np.abs(np.diff(one, axis=0)).sum(axis=(1, 2)) / step
        for form, one in _forms(session, psf, radii, ratio, True).items()
    }
    remedy = "integrated over source and detector pixel: no threshold"
    found, times = _by_radius(radii[:-1], errors), _psf_times(session, psf, radii[::20])
    return hard_case(name, "R, px", "L1 / px", found, (4.0, 4.0), remedy, times, classes=False)


def gaussian_steps(session: Session) -> HardCase:
    """The rule that |R| < 0.5 px is no blur, with a Gaussian cut at 2 sigma = 2 sqrt(2) R."""
    return steps_of_radius(session, GAUSSIAN, "|R| < 0.5 rule, 2 sigma cut", 2.0**0.5)


def pillbox_steps(session: Session) -> HardCase:
    """Pixel centers that come into a disc one by one."""
    return steps_of_radius(session, PILLBOX, "pillbox on the lattice, jumps", 1.0)


def pillbox_energy(session: Session) -> HardCase:
    """1 / (pi R^2) at the pixel centers within R: from none to 1.59 times the energy."""
    radii = np.arange(0.5, 12.0, 0.05)
    forms = _forms(session, PILLBOX, radii, 1.0, False)
    errors = {form: np.abs(one.sum(axis=(1, 2)) - 1.0) for form, one in forms.items()}
    found, times = _by_radius(radii, errors), _psf_times(session, PILLBOX, radii[::20])
    remedy = "exact area of the circle in each square"
    # The device adds up to 600 weights of float32.
    return hard_case(
        "pillbox on the lattice, energy", "R, px", "energy", found, (1e-6, 1e-7), remedy, times, classes=False
    )


def _exact_gaussian(radius: float, half: int) -> Array:
    """A Gaussian without a cut, integrated over source and detector pixel, by mpmath."""
    with mpmath.workdps(40):
        sigma = mpmath.sqrt(mpmath.mpf(1) / 2) * mpmath.mpf(radius)

        def ramp(x: int) -> mpmath.mpf:  # integral of the integral of the density
            return x * mpmath.ncdf(x / sigma) + sigma * mpmath.npdf(x / sigma)

        axis = np.array([float(ramp(k + 1) - 2 * ramp(k) + ramp(k - 1)) for k in range(-half, half + 1)])
    return axis[:, None] * axis[None, :]


def _exact_disc(radius: float, half: int) -> Array:
    """A disc seen by a square detector from a square source, by mpmath's quadrature of chords."""
    with mpmath.workdps(30):
        r = mpmath.mpf(radius)

        def ramp(u: mpmath.mpf) -> mpmath.mpf:  # running integral of the tent
            u = max(min(u, mpmath.mpf(1)), mpmath.mpf(-1))
            return (1 + u) ** 2 / 2 if u < 0 else 1 - (1 - u) ** 2 / 2

        def share(a: int, b: int) -> float:
            def chord(x: mpmath.mpf) -> mpmath.mpf:
                h = mpmath.sqrt(max(r * r - x * x, mpmath.mpf(0)))
                return (1 - abs(x - a)) * (ramp(h - b) - ramp(-h - b))

            low, high = max(mpmath.mpf(a - 1), -r), min(mpmath.mpf(a + 1), r)
            if low >= high:
                return 0.0
            kinks = [mpmath.mpf(a)] + [
                s * mpmath.sqrt(r * r - m * m) for m in range(half + 2) if m < r for s in (-1, 1)
            ]
            ends = sorted({low, high, *(k for k in kinks if low < k < high)})
            return float(mpmath.quad(chord, ends) / (mpmath.pi * r * r))

        quarter = {(a, b): share(a, b) for a in range(half + 1) for b in range(half + 1)}
    at = np.abs(np.arange(-half, half + 1))
    return np.array([[quarter[a, b] for a in at.tolist()] for b in at.tolist()])


def _truth(
    session: Session, name: str, psf: Psf, radii: Array, exact: Callable[[float, int], Array], bound: float, remedy: str
) -> HardCase:
    """L1 distance of PSFs from the truth, 2 for those that have no pixel in common."""
    found = []
    for radius in radii.tolist():
        one = np.array([radius])
        measured = {}
        for form, share in _forms(session, psf, one, 0.5**0.5, True).items():
            off = np.abs(share[0] - exact(radius, share.shape[1] // 2)).sum()
            measured[form] = Compared(float(off), 0, share.size)
        found.append((radius, measured))
    times = _psf_times(session, psf, np.linspace(0.5, float(radii.max()), 30))
    return hard_case(name, "R, px", "L1", found, (bound, bound), remedy, times, classes=False)


def gaussian_cut(session: Session) -> HardCase:
    """Measure the energy that a cut takes from a Gaussian: 2 sigma against 3 sigma, the default."""
    radii = np.array([0.7, 1.0, 2.0, 4.0, 6.0])
    # No PSF of unit energy that ends at 3 sigma is closer: the 0.54 % beyond it are missing there and too much here.
    bound = 1.001 * 2.0 * (1.0 - erf(3.0 / 2.0**0.5) ** 2)
    return _truth(session, "Gaussian cut", GAUSSIAN, radii, _exact_gaussian, bound, "cut at 3 sigma, integrated")


def gaussian_reference(session: Session) -> HardCase:
    """The same with a cut at 6 sigma."""
    psf, radii = Psf(model="gaussian", tilt=False, truncation=6.0), np.array([0.7, 1.0, 2.0, 4.0, 6.0])
    return _truth(session, "Gaussian cut, truncation = 6", psf, radii, _exact_gaussian, 1e-6, "truncation = 6")


def pillbox_truth(session: Session) -> HardCase:
    """A disc by its pixel centers."""
    radii, remedy = np.array([0.4, 1.0, 2.5, 4.3]), "closed form of a disc under a tent"
    return _truth(session, "pillbox on the lattice, truth", PILLBOX, radii, _exact_disc, 1e-6, remedy)


def float_sums(session: Session) -> HardCase:
    """Sums of one pixel's irradiance in whatever order it arrives, and an image blurred again and again."""
    rng, found, runs = np.random.default_rng(9), [], 10
    for side in (16, 64, 256):
        image, radii = rng.random((side, side)).astype(np.float32), rng.uniform(0.0, 5.0, (side, side))
        lights = image.ravel()
        naive = {np.add.accumulate(rng.permutation(lights))[-1].tobytes() for _ in range(runs)}
        blur = partial(defocus, image, radii, PILLBOX, device=session.device.name, outside="black")
        again = {blur().tobytes() for _ in range(runs)}
        measured = {"naive": Compared(len(naive) - 1.0, 0, runs), "single": Compared(len(again) - 1.0, 0, runs)}
        found.append((float(side * side), measured))
    remedy = "each pixel's sum has an owner and an order; not a number is refused"
    return hard_case("float atomics", "terms", "other results", found, (0.0, 0.0), remedy, classes=False)


# Forward warp


def _plane_scene(side: int, speed: tuple[float, float, float], **more: object) -> Scene:
    """A plane that fills the frame, in focus, and moves for a second."""
    camera = Camera(resolution=(side, side), pixel_pitch=0.01, focus_distance=250.0)
    item = Plane(distance=250.0, motion=ObjectMotion(velocity=speed))
    return Scene.model_validate({"camera": camera, "objects": (item,), **more})


def half_pixel_shift(session: Session) -> HardCase:
    """A plane that moves by fractions of a pixel: where positions round to either side, pixels stay empty."""
    side, found = 100, []
    texture = np.ones((side, side), np.float32)
    for shift in (0.0, 0.25, 0.5, 0.75, 1.0, 2.5, 10.5):
        scene = _plane_scene(side, (shift * 0.125, 0.0, 0.0), motion=Motion(warp="forward"))
        pixels = np.arange(side)
        inside = slice(int(np.floor(shift + 0.5)), side)
        f = np.float32
        x = f(0.01) * (pixels.astype(f) - f((side - 1) / 2)) * f(250.0) / f(20.0) + f(shift * 0.125)
        landed = np.rint(f(20.0) * x / f(250.0) / f(0.01) + f((side - 1) / 2)).astype(int)
        forms: dict[str, NDArray[np.bool_]] = {"naive": np.isin(pixels, landed)}
        for form, real in BOTH:
            if real == "float" or session.device.has_fp64:
                stages = MeasuredStages(session, scene, texture, real)
                stages.depth_test()
                forms[form] = np.asarray((stages.winners() < side * side).all(axis=0))
        holes = {form: int((~known[inside]).sum()) for form, known in forms.items()}
        count = inside.stop - inside.start
        found.append((shift, {form: Compared(100.0 * n / count, n, count) for form, n in holes.items()}))
    remedy = "positions snap to 1/4096 px, halves go up"
    return hard_case("half-pixel shift, rint", "shift, px", "% holes", found, (0.0, 0.0), remedy)


def depth_ties(session: Session) -> HardCase:
    """A plane that moves away: as many as 16 pixels of one depth come to a place, and one of them is shown."""
    side, found, rng = 128, [], np.random.default_rng(3)
    texture = np.ones((side, side), np.float32)
    for times in (2, 4):
        scene = _plane_scene(side, (0.0, 0.0, 250.0 * (times - 1)), motion=Motion(warp="forward"))
        # Exactly: column c comes to middle + (c - middle) / times.
        middle = (side - 1) / 2
        to = np.floor(middle + (np.arange(side) - middle) / times + 0.5).astype(int)
        place = (to[:, None] * side + to[None, :]).ravel()
        exact = np.full(side * side, np.iinfo(np.int32).max)
        np.minimum.at(exact, place, np.arange(side * side))
        order = rng.permutation(side * side)

        def last_writer(place: NDArray[np.intp] = place, order: NDArray[np.intp] = order) -> NDArray[np.intp]:
            last = np.full(side * side, np.iinfo(np.int32).max)
            last[place[order]] = order  # all tie at the smallest depth
            return last

        forms = {"naive": last_writer()}
        calls: dict[str, Callable[[], object]] = {"naive": last_writer}
        for form, real in BOTH:
            if real == "float" or session.device.has_fp64:
                stages = MeasuredStages(session, scene, texture, real)
                stages.depth_test()
                forms[form], calls[form] = stages.winners().ravel(), stages.depth_test
        wrong = {form: int((winner != exact).sum()) for form, winner in forms.items()}
        seen = int((exact < side * side).sum())
        found.append((float(times**2), {form: Compared(100.0 * n / seen, n, seen) for form, n in wrong.items()}))
    remedy = "of equally near ones the first: depth and number are compared together"
    return hard_case(
        "depth ties", "pixels at one place", "% wrong", found, (0.0, 0.0), remedy, _times(side * side, **calls)
    )


# Motion, missing pixels, angles, budget


def long_motion(session: Session) -> HardCase:
    """A plane that moves by up to 80 px in the exposure: five frames, or one per pixel."""
    side, found = 200, []
    texture = load_texture("bricks", "srgb", (side, side)).radiance.astype(np.float64)
    for pixels in (5, 20, 80):
        seen = np.s_[:, pixels + 2 : -pixels - 2]
        before = np.pad(texture, ((0, 0), (pixels + 2, pixels + 2)), mode="symmetric")

        def moved(shift: float, before: Array = before, margin: int = pixels + 2) -> Array:
            whole = int(np.floor(shift))
            left = before[:, margin - whole - 1 : margin - whole - 1 + side]
            right = before[:, margin - whole : margin - whole + side]
            return right + (shift - whole) * (left - right)

        # What lies between pixels is linear, so that the exposure's integral is a sum of trapezoids.
        ends = [moved(float(k)) for k in range(pixels + 1)]
        exact = (sum(ends) - 0.5 * (ends[0] + ends[-1])) / pixels
        forms: dict[str, Array] = {"naive": np.mean([moved((k + 1) * pixels / 5) for k in range(5)], axis=0)}
        motion, exposure = Motion(texture_filter="bilinear"), Exposure(samples=pixels)
        scene = _plane_scene(side, (0.125 * pixels, 0.0, 0.0), motion=motion, sequence=exposure)
        for form, real in BOTH:
            if real == "float" or session.device.has_fp64:
                (frame,) = render(scene, truth=(), device=session.device.name, precision=form)
                forms[form] = frame.color.astype(np.float64)
        measured = {}
        for form, image in forms.items():
            off = (image - exact)[seen]
            measured[form] = Compared(float(np.sqrt(np.mean(off**2))), 0, off.size)
        found.append((float(pixels), measured))
    remedy = "one midpoint per pixel of displacement, bilinear"
    return hard_case("80 px of motion", "displacement, px", "RMS", found, (1e-6, 1e-6), remedy, classes=False)


def stalled_filling(session: Session) -> HardCase:
    """The rule of four known neighbors on random 4 x 4 masks, which most of them never satisfy again."""
    rng, found = np.random.default_rng(5), []
    for count in range(4, 16, 2):
        chosen = rng.choice(comb(16, count), 40) if comb(16, count) < 40 else range(40)
        naive = own = 0
        for _ in chosen:
            missing = (rng.permutation(16) < count).reshape(4, 4)
            naive += _stalls(missing)
            filled = inpaint(rng.random((4, 4)), missing, method="mean-median", device=session.device.name)
            own += not np.isfinite(filled).all()
        total = len(chosen)
        measured = {form: Compared(100.0 * n / total, n, total) for form, n in (("naive", naive), ("single", own))}
        found.append((float(count), measured))
    remedy = "the minimum falls from 4 to 1 in a sweep that would stall"
    return hard_case(">= 4 known neighbors", "missing of 16", "% never end", found, (0.0, 0.0), remedy)


def _stalls(missing: NDArray[np.bool_]) -> bool:
    """True if pixels with four known neighbors run out before missing pixels do."""
    left = missing.copy()
    while left.any():
        known = np.pad(~left, 1).astype(int)
        near = sum(known[1 + i : 5 + i, 1 + j : 5 + j] for i in (-1, 0, 1) for j in (-1, 0, 1) if (i, j) != (0, 0))
        ready = left & (near >= 4)
        if not ready.any():
            return True
        left &= ~ready
    return False


def large_angles(session: Session) -> HardCase:
    """Turns by up to 1e9 degrees."""
    del session
    found = []
    for exponent in range(1, 10):
        turn = min(1.2345679 * 10.0**exponent, 1e9)
        with mpmath.workdps(DIGITS):
            exact = float(mpmath.sin(mpmath.radians(mpmath.mpf(turn))))
        pose = pose_at(ObjectMotion(angular_velocity=(0.0, 0.0, turn)), 1.0, "euler")
        record = pose_structs([pose], "float")["rotation"][0].astype(np.float64)
        sines = {
            "naive": float(np.sin(np.radians(np.float32(turn)))),
            "single": -float(record[1]),
            "double": -float(pose.rotation[0, 1]),
        }
        signed = {form: min(abs(v - exact), abs(v + exact)) for form, v in sines.items()}
        found.append((turn, {form: Compared(error, 0, 1) for form, error in signed.items()}))
    remedy = "degrees are reduced to a turn in float64 on the host"
    return hard_case("rotation by 1e7 deg", "angle, deg", "sine", found, (1e-7, 1e-14), remedy, classes=False)


def near_objects(session: Session) -> HardCase:
    """A plane down to 1 mm from the lens, each pixel of which lights up to 3e8 others."""
    del session
    camera, found = Camera(resolution=(64, 48)), []
    for distance in (1.0, 2.0, 5.0, 10.0, 20.0, 50.0):
        radius = abs(float(blur_radius(camera, 1.0 / distance)))
        try:
            scene = Scene(camera=camera, objects=(Plane(distance=distance),))
            make_plan(scene, scene_point_spread(scene), 1)
            own = pi * radius**2
        except SceneError:
            own = 0.0
        measured = {"naive": Compared(pi * radius**2, 0, 1), "single": Compared(own, 0, 1)}
        found.append((1.0 / distance, measured))
    remedy = f"refused before the launch beyond {LARGEST_BLUR:g} px"
    bound = pi * LARGEST_BLUR**2
    return hard_case("object at 1 mm", "1 / Z, 1/mm", "writes", found, (bound, bound), remedy, classes=False)


CASES: Sequence[Callable[[Session], HardCase]] = (
    gaussian_steps, pillbox_steps, pillbox_energy, gaussian_cut, gaussian_reference, pillbox_truth, float_sums,
    half_pixel_shift, depth_ties, long_motion, stalled_filling, large_angles, near_objects,
)  # fmt: skip
