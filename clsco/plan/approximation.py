"""Reduction of time samples and silhouette samples within a tolerance of the frame (float64, pure).

Consider a pattern that moves by D px while the shutter is open. In the frame, its component of f cycles per px along
the motion is multiplied by M(f) = sum_i w_i exp(2 pi i f D t_i), summed over the time samples, with t from 0 to 1. With
fewer samples, M differs, and the squared error of the frame is

    e^2 = sum_f P(f) H(f)^2 |M(f) - M_exact(f)|^2

P: power of the moving pattern: for a texture, the power along its rows and columns; for outlines of length l per px^2
and contrast c, l c^2 / (2 pi f)^2. H: transfer function of the PSF.

Each of the N x N sub-pixel sources of a pixel emits the light of its covered part from its middle. At an edge along the
rows of sources, this changes the first moment of the pixel's light by m, and

    e^2 = l c^2 (mean m^2 sum_f (2 pi f)^2 H(f)^2 + s mean off^2 sum_f H(f)^2)

off: error of a coverage that is the number of covered sources divided by N^2; s: fraction of outlines whose pixels have
such a coverage, CORNERS for N > 1, and 1 for N = 1. `clsco.plan.texture_sources` treats errors of textures on surfaces.

Validated against frames with all samples: tests/plan/test_approximation.py.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from math import ceil, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.inputs.textures import Texture
from clsco.optics.exposure import frame_exposure, shutter_span
from clsco.optics.image_motion import ImagePath, image_paths, sampled_frames
from clsco.optics.lens_path import camera_at, lenses_at, reference_camera
from clsco.optics.motion import poses_at
from clsco.optics.point_spread import PointSpread
from clsco.optics.rays import slopes_at
from clsco.optics.resolved_view import Maps, cast_grid, middle_of
from clsco.optics.texture_mapping import needs_detail, texture_map
from clsco.plan.plan import Plan
from clsco.plan.request import check_tolerance
from clsco.plan.texture_sources import STEEP, footprints, power_in_frame, spectrum_of, squared_errors
from clsco.scene.model import Scene

Array = NDArray[np.float64]
Samples = tuple[int, int]

SIDE, LINES = 256, 64  # length of texture segments whose spectrum is computed, px, and their number per axis
FREQUENCIES = np.arange(1, SIDE + 1) / SIDE  # cycles per px; textures have power in the lower half, outlines in all
NO_POWER = np.zeros(SIDE)
CYCLE_STEPS = 8  # bins per cycle of motion
STRIDE = 7  # px from one sample of a texture's means to the next; few patterns have this period
MARGIN = 1.5  # factor of squared errors, because rays sample outlines and paths coarsely
CORNERS = 0.06  # fraction of outlines where covered sources are counted: corners, and surfaces seen edge-on
# Cost of a sub-pixel source in each pixel, relative to a time sample with one source per pixel: if fine textures need
# sub-pixel sources, and if only outlines do.
FINE_COST, OUTLINE_COST = 1 / 8, 1 / 80
UNEVEN = 0.2  # fraction used in place of CORNERS for differences between time samples
TRAVEL_SHARES = (0.55, 0.7, 0.85, 1.0)  # fractions of the longest path that points travel; the worst one counts


@dataclass(frozen=True)
class ApproximationReport:
    """Samples used for a frame with a tolerance.

    tolerance: requested RMS error, 1 = white; rms_error: estimated RMS error relative to a frame with all samples of
    the scene, 0 if all are used. Silhouette samples are counted along an axis of a pixel; 1 means that no pixel has
    sub-pixel sources.
    """

    tolerance: float
    rms_error: float
    samples: int
    scene_samples: int
    silhouette_samples: int
    scene_silhouette_samples: int

    @property
    def counts(self) -> Samples:
        """Numbers of time samples, and of sub-pixel sources along an axis."""
        return self.samples, self.silhouette_samples

    def line(self) -> str:
        """Report in one line."""
        time, silhouettes = (self.samples, self.scene_samples), (self.silhouette_samples, self.scene_silhouette_samples)
        if time == silhouettes == (1, 1):
            return "exact: nothing can be saved, as nothing moves, and no silhouette is in sight"
        if self.rms_error == 0.0:
            return f"exact: fewer samples may be off by more than {self.tolerance:g} of white"
        kinds = (("time", *time), ("silhouette", *silhouettes))
        counts = " and ".join(f"{count} of {total} {kind} samples" for kind, count, total in kinds if total > 1)
        return f"{counts}: estimated RMS error {self.rms_error:.2g} of white"


def fewer_samples(
    plan: Plan, tolerance: float, textures: Callable[[], tuple[Texture, ...]], maps: Maps, least: Samples = (1, 1)
) -> tuple[Scene, ApproximationReport]:
    """Choose the cheapest numbers of samples whose estimated error is within a tolerance, the RMS error with 1 = white.

    plan: a plan with all samples; textures: returns the textures of all objects, called only if samples may be saved;
    least: lower bounds of time samples and silhouette samples. Returns the scene with these numbers, or the scene of
    the plan if all samples are needed. Raises SceneError if the tolerance is not a positive number.
    """
    check_tolerance(tolerance)
    scene, exact = plan.scene, (plan.samples, max(plan.silhouettes, 1))
    samples, silhouettes, square = *exact, 0.0
    fine = needs_detail(scene, plan.psf, plan.largest_blur)
    keeps_silhouettes = exact[1] == 1 or (fine and not (plan.psf.uniform or plan.psf.pupil.soft))
    if (exact[0] > 1 or not keeps_silhouettes) and not scene.lens_moves:  # the estimate assumes a fixed lens
        images = textures()
        parts = _parts(scene, images, maps)
        outlines = _Outlines.of(plan.psf, parts)
        time_error = partial(_time_error, scene, *_cycles(plan.psf, parts), outlines.coverage_error(exact[1]), exact[0])
        source_errors = {exact[1]: 0.0}
        if not keeps_silhouettes:
            # At least 2 for fine textures: one source for a pixel reaches farther, and has more taps than 2 x 2 parts.
            fewer = [count for count in STEEP if max(least[1], 1 + fine) <= count < exact[1]]
            source_errors |= {count: outlines.source_error(exact[1], count) for count in fewer}
            if fine:
                for count, error in squared_errors(scene, plan.psf, images, maps, exact[1], fewer).items():
                    source_errors[count] += MARGIN * error
        samples, silhouettes = _cheapest((least[0], exact[0]), source_errors, tolerance**2, time_error, fine)
        square = source_errors[silhouettes] + (time_error(samples) if samples < exact[0] else 0.0)
    report = ApproximationReport(tolerance, sqrt(square), samples, exact[0], silhouettes, exact[1])
    if (samples, silhouettes) == exact:
        return scene, report
    update: dict[str, Any] = {}
    if samples < exact[0]:
        update["sequence"] = scene.sequence.model_copy(update={"samples": samples})
    if silhouettes < exact[1]:
        update["psf"] = scene.psf.model_copy(update={"silhouette_samples": silhouettes})
    return scene.model_copy(update=update), report


def _cheapest(
    samples: Samples, source_errors: Mapping[int, float], square: float, time_error: Callable[[int], float], fine: bool
) -> Samples:
    """Numbers of time samples, and of sources along an axis, with the lowest cost within the squared error `square`.

    samples: least and exact number of time samples; source_errors: squared errors by number of sources; time_error:
    squared error by number of time samples; fine: True if textures need sub-pixel sources, not only outlines.
    """
    source_cost, choices = FINE_COST if fine else OUTLINE_COST, []
    for count, error in source_errors.items():
        if error <= square:
            time_samples = _fewest(range(*samples), square - error, time_error) or samples[1]
            choices.append((time_samples * (1.0 + source_cost * count**2), time_samples, count))
    return min(choices)[1:]


def _fewest(counts: range, square: float, error: Callable[[int], float]) -> int:
    """Smallest of increasing `counts` with a squared error of at most `square`, by bisection; 0 if there is none."""
    place = bisect_left(counts, True, key=lambda count: error(count) <= square)
    return counts[place] if place < len(counts) else 0


@dataclass(frozen=True)
class _Part:
    """Statistics of an object in the frame.

    travel: while the shutter is open, length of the path of the object's image and of the edge of its blur, along x and
    along y, px; radius: smallest |R|, px; power: power of its texture in the frame, white^2, by FREQUENCIES along x and
    along y; outline: length of its outlines times their squared contrast per px^2, for outlines that cross x, and for
    those that cross y.
    """

    travel: tuple[float, float]
    radius: float
    power: tuple[Array, Array]
    outline: tuple[float, float]


def _cycles(psf: PointSpread, parts: tuple[_Part, ...]) -> tuple[Array, Array]:
    """Cycles by which moving patterns pass a pixel, and the power of these patterns.

    Returns the numbers of cycles (n,) while the shutter is open, and the power (shares, n) in the frame, white^2, if
    points travel each of TRAVEL_SHARES of the longest path.
    """
    longest = max((max(part.travel) for part in parts), default=0.0)
    powers = np.zeros((len(TRAVEL_SHARES), ceil(longest * CYCLE_STEPS) + 1))
    for part in parts:
        transfer = _squared_transfer(psf, part.radius)
        step = transfer * (np.sinc(FREQUENCIES) / (2.0 * np.pi * FREQUENCIES)) ** 2 * 2.0 / SIDE
        for travel, power, outline in zip(part.travel, part.power, part.outline, strict=True):
            for share, cycles in zip(TRAVEL_SHARES, powers, strict=True):
                index = np.rint(share * travel * FREQUENCIES * CYCLE_STEPS).astype(np.intp)
                np.add.at(cycles, index, power * transfer + outline * step)
    return np.arange(powers.shape[1]) / CYCLE_STEPS, powers


def _time_error(scene: Scene, cycles: Array, power: Array, uneven: float, exact: int, count: int) -> float:
    """Squared error of a frame with `count` time samples instead of `exact`. cycles, power: from `_cycles`; uneven:
    squared error of the coverage in each time sample.
    """
    missed = np.mean(np.abs(_sums(scene, cycles, exact) - _sums(scene, cycles, count)) ** 2, axis=0)
    return MARGIN * (float((power * missed).sum(axis=1).max()) + uneven * (1.0 / count + 1.0 / exact))


def _sums(scene: Scene, cycles: Array, count: int) -> NDArray[np.complex128]:
    """Sums M of the module's formula over `count` time samples, (rows, n) if rows have their own weights, else (1, n);
    cycles: values of f D, (n,).
    """
    exposure = frame_exposure(scene, 0, count)
    opens, closes = shutter_span(scene.sequence, 0)
    turns = np.exp(2j * np.pi / (closes - opens) * np.multiply.outer(exposure.times, cycles))
    return np.asarray(exposure.weights.reshape(len(exposure.times), -1).T @ turns)


@dataclass(frozen=True)
class _Outlines:
    """Factors of squared errors at outlines: l c^2 of the module's formula times a sum over frequencies.

    edges: factor for errors of the coverage; slopes: factor for errors of its first moment, px^-2.
    """

    edges: float
    slopes: float

    @staticmethod
    def of(psf: PointSpread, parts: tuple[_Part, ...]) -> _Outlines:
        slope = 2.0 / SIDE * (2.0 * np.pi * FREQUENCIES * np.sinc(FREQUENCIES)) ** 2
        pairs = [(sum(part.outline), _squared_transfer(psf, part.radius)) for part in parts]
        edges = (length * float(transfer[: SIDE // 2].mean()) for length, transfer in pairs)
        slopes = (length * float(slope @ transfer) for length, transfer in pairs)
        return _Outlines(sum(edges), sum(slopes))

    def coverage_error(self, sources: int) -> float:
        """Squared error of the coverage in one time sample with `sources` sub-pixel sources per axis."""
        return self.edges * (UNEVEN if sources > 1 else 1.0) / (12.0 * sources**2)

    def source_error(self, exact: int, count: int) -> float:
        """Squared error of count x count sub-pixel sources instead of exact x exact."""
        place = np.linspace(0.0, 1.0, 1025)[1:]  # positions of an edge in its pixel
        exact_coverage, coverage = (np.floor(place * sources + 0.5) / sources for sources in (exact, count))
        square = (CORNERS if count > 1 else 1.0) * self.edges * float(np.mean((coverage - exact_coverage) ** 2))
        if count > 1:
            square += self.slopes * float(np.mean((_moments(place, exact) - _moments(place, count)) ** 2))
        return MARGIN * square


def _moments(place: Array, sources: int) -> Array:
    """First moment of the part of a pixel that is covered from its start to an edge at `place`, from 0 to 1. Each of
    the sources along an axis has the light of its covered part in its middle.
    """
    full = np.floor(place * sources)
    return np.asarray((0.5 * full**2 + (place * sources - full) * (full + 0.5)) / sources**2)


def _squared_transfer(psf: PointSpread, radius: float) -> Array:
    """Upper bound of H^2 by FREQUENCIES, from the second moment of the PSF. A PSF that is not Gaussian counts as a
    disc; for PSFs that are neither Gaussian nor uniform the bound is 1.
    """
    z = 4.0 * np.pi * sqrt(psf.pupil.second_moment) * radius * FREQUENCIES
    if not (psf.pupil.soft or psf.uniform):
        return np.ones_like(FREQUENCIES)
    if psf.pupil.soft:
        return np.asarray(np.exp(-0.25 * z * z))
    return 1.0 / np.maximum(np.pi / 8.0 * z**3, 1.0)  # the envelope of (2 J1(z) / z)^2


def _parts(scene: Scene, textures: tuple[Texture, ...], maps: Maps) -> tuple[_Part, ...]:
    """Statistics of each object that is visible in the middle of the sequence; `travel` is its longest path over the
    whole sequence.
    """
    w, (x, y) = cast_grid(scene, maps)
    front = w.max(axis=0)
    nearest = np.where(front > 0.0, w.argmax(axis=0), -1)
    contrasts = _contrasts(textures, scene.light is not None)
    across, down = (_outlines(scene, contrasts, nearest, front, axis) for axis in (1, 0))
    paths = [image_paths(scene, maps, frame) for frame in sampled_frames(scene)] if scene.moves else []
    parts = []
    for k in np.flatnonzero(np.bincount(nearest.ravel() + 1)[1:]).tolist():
        visible = nearest == k
        slopes = x[visible], y[visible]
        radii = np.abs([lens.image_radius(w[k][visible], *slopes) for lens in lenses_at(scene, 0.0)])
        travel, power = (0.0, 0.0), (NO_POWER, NO_POWER)
        if scene.moves:
            travel = _longest_travel(scene, [frame_paths[k] for frame_paths in paths])
            mapped = scene.objects[k].mapped is not None
            along_x, along_y = _mapped_power(scene, k, textures[k], *slopes) if mapped else _power(textures[k])
            power = (visible.mean() * along_x, visible.mean() * along_y)
        parts.append(_Part(travel, float(radii.min()), power, (across[k], down[k])))
    return tuple(parts)


def _longest_travel(scene: Scene, paths: list[ImagePath]) -> tuple[float, float]:
    """Length along x and along y of the longest path of an object's image and of its blur's edge, px. A diagonal path
    counts with its full length along both axes.
    """
    longest, (lens, *_) = np.zeros(2), lenses_at(scene, 0.0)
    for path in paths:
        slopes = slopes_at(reference_camera(scene), path.places[:, 0], path.places[:, 1])
        radius = np.abs(lens.image_radius(path.places[:, 2], *slopes))
        rim = (np.abs(np.diff(radius, axis=0)) * path.visible).sum(axis=0)
        along, diagonal = np.abs(path.steps).sum(axis=0) + rim, np.linalg.norm(path.steps, axis=1).sum(axis=0) + rim
        longest = np.maximum(longest, np.minimum(2.0 * along, diagonal).max(axis=1, initial=0.0))
    return float(longest[0]), float(longest[1])


def _outlines(scene: Scene, contrasts: Array, nearest: NDArray[np.intp], w: Array, axis: int) -> Array:
    """Length per px^2 times squared contrast of each object's outlines that lie between consecutive rays along an axis.

    An outline counts for the object in front. nearest: number of the object that each ray hits, -1 for none; w: inverse
    depth of that object.
    """
    size = scene.camera.frame_size[1 - axis]
    first, second = (np.take(nearest, range(n, nearest.shape[axis] - 1 + n), axis) for n in (0, 1))
    w_first, w_second = (np.take(w, range(n, nearest.shape[axis] - 1 + n), axis) for n in (0, 1))
    front = np.where(w_first >= w_second, first, second)
    crossed = first != second
    lengths = np.zeros(len(contrasts))
    np.add.at(lengths, front[crossed], contrasts[first[crossed], second[crossed]])
    return lengths / crossed.shape[1 - axis] / size


def _contrasts(textures: tuple[Texture, ...], shaded: bool) -> Array:
    """Mean squared difference between the radiances of any two objects, (objects + 1, objects + 1). The last index
    stands for an empty pixel. shaded: True if a light may leave either of the two objects dark.
    """
    images = [texture.radiance[::STRIDE, ::STRIDE] for texture in textures]
    mean = np.array([*(float(image.mean()) for image in images), 0.0])
    square = np.array([*(float(np.square(image).mean()) for image in images), 0.0])
    contrasts = square[:, None] + square - 2.0 * mean[:, None] * mean
    return np.asarray(np.maximum(contrasts, np.maximum(square[:, None], square)) if shaded else contrasts)


def _power(texture: Texture) -> tuple[Array, Array]:
    """Power of a texture by FREQUENCIES along x and y, averaged over its channels."""
    image = texture.radiance.reshape(*texture.radiance.shape[:2], -1)
    return _along(image), _along(image.swapaxes(0, 1))


def _mapped_power(scene: Scene, number: int, texture: Texture, x: Array, y: Array) -> tuple[Array, Array]:
    """Power of a texture on a surface by FREQUENCIES along x and y; x, y: slopes (n,) of rays that hit the object in
    the middle of the sequence.
    """
    time, item, image = middle_of(scene), scene.objects[number], texture.radiance
    mapped = texture_map(item, image.shape[1], image.shape[0])
    across = footprints(item, poses_at(scene, time)[number], mapped, camera_at(scene, time), x, y)
    return power_in_frame(spectrum_of(image), across, FREQUENCIES)


def _along(image: NDArray[np.float32]) -> Array:
    """Mean power by FREQUENCIES of segments of rows under a Hann window; image: (rows, columns, channels)."""
    rows, columns, _ = image.shape
    side, lines = min(SIDE, columns), min(LINES, rows)
    starts, firsts = (np.linspace(0, end, lines).astype(np.intp).tolist() for end in (columns - side, rows - 1))
    segments = np.stack([image[row, at : at + side] for row, at in zip(firsts, starts, strict=True)])
    window = np.sin(np.pi * (np.arange(side) + 0.5) / side) ** 2
    spectrum = np.fft.rfft((segments - segments.mean(axis=1, keepdims=True)) * window[:, None], axis=1)
    power = 2.0 * np.mean(np.abs(spectrum) ** 2, axis=(0, 2))[1:] / side / (window**2).sum()
    binned = np.zeros(FREQUENCIES.size)
    np.add.at(binned, np.minimum((np.arange(1, power.size + 1) * SIDE // side), SIDE // 2) - 1, power)
    return binned
