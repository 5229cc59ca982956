"""Errors of a frame in which fine textures on surfaces have fewer sub-pixel sources (float64, pure).

A pixel whose texture is too fine for one source is cut into p x p parts and has N x N sources, each with the mean of
the texture in its part (kernels/trace/detail.clh). Along one axis, the sources of a pixel turn a pattern cos(2 pi f x),
at the middle of the pixel, into

    V(f) = 1 / N sum_n S(x_n) cos(2 pi f c_n) sinc(f / p) (1 + 4 c sin(pi f / p)^2)

x_n: position of source n; c_n: middle of its part, both relative to the middle of the pixel; S: fraction of the disc
around a source that lies within the width of the pixel; c: coefficient of the exchange between parts. V is multiplied
for both axes, and the pixel's footprint on the surface converts f from cycles per texel:

    e^2 = sum_f P(f) (V_exact(f_x) V_exact(f_y) - V(f_x) V(f_y))^2

P: power of the texture. If R changes by G px from pixel to pixel, and discs are so small that they barely reach over
the border of a pixel, the sum of all discs is uneven: e = STEEP G L for a radiance L, as measured on tilted planes
through the focus. One source per pixel is N = p = 1. Hidden, shaded and dark parts count as if they were visible with
the texture's radiance. Validated against frames: tests/plan/test_approximation.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from itertools import product
from math import log2, pi, sqrt

import numpy as np
from numpy.typing import NDArray

from clsco.constants import LEAST_TEXELS, MAP_CONE, MAP_CUBE, MAP_CYLINDER, MAP_LONGITUDE, MAP_TRIPLANAR
from clsco.inputs.textures import Texture
from clsco.optics.exposure import sequence_times
from clsco.optics.lens_path import camera_at, lenses_at
from clsco.optics.motion import Pose, poses_at
from clsco.optics.point_spread import PointSpread
from clsco.optics.quadrics import place, predict_inverse_depth
from clsco.optics.rays import places_of, slopes_at
from clsco.optics.resolved_view import GRID, Maps, cast_grid
from clsco.optics.texture_mapping import TextureMap, cut_parts, detail_least, texture_map, texture_spread
from clsco.scene.model import Camera, Object, Scene

Array = NDArray[np.float64]

SIDE, PATCHES = 64, 9  # side in texels of a patch whose spectrum is computed, and patches along each axis
LOOKS = 8  # rays at which the power of a texture in the frame is evaluated
HELD = 0.4  # highest frequency in a coarser level of a mipmap, cycles per texel of that level
STEEP = {1: 0.08, 2: 0.16, 3: 0.1, 4: 0.06, 8: 0.03}  # factor of the module's formula, by sources along an axis
NARROW = 0.75  # px, radius of discs below which STEEP applies
STRIDE = 7  # texels from one sample of a mean to the next
BETWEEN = 5  # positions around each ray of a grid at which R is interpolated
FINEST = 6.0  # cycles per px, beyond which all means are constant
STEPS = 64  # number of frequencies from one cycle per px to the next
FREQUENCIES = np.arange(int(FINEST * STEPS) + 1) / STEPS
RADII = 0.0105 * 2.0 ** (np.arange(40) / 4.0)  # radii of discs in px, up to 9
REACHING = 2.0  # slope of the beginning of the exchange, as in detail.clh
ALONG = ((2, 1), (0, 2), (0, 1))  # for each axis, the other two axes, which texture columns and rows follow


def squared_errors(
    scene: Scene, psf: PointSpread, textures: Sequence[Texture], maps: Maps, exact: int, counts: Sequence[int]
) -> dict[int, float]:
    """Estimate the squared errors in white^2 of a frame in which fine textures have fewer sub-pixel sources.

    textures: textures of all objects; exact: number of sources along an axis in the exact frame; counts: smaller
    numbers, of which 1 means one source per pixel. Returns for each number in `counts` the largest error at the
    examined times.
    """
    spectra: dict[int, tuple[Spectrum, float]] = {}
    firsts = [next(j for j, other in enumerate(textures) if other.radiance is texture.radiance) for texture in textures]
    cells = [(size - 1) / (GRID - 1) for size in scene.camera.frame_size[::-1]]  # px
    largest, times = dict.fromkeys(counts, 0.0), sequence_times(scene)
    for time in times[:: max(len(times) // 2, 1)]:
        (w, slopes), errors = cast_grid(scene, maps, time), dict.fromkeys(counts, 0.0)
        camera, poses, lenses = camera_at(scene, time), poses_at(scene, time), lenses_at(scene, time)
        nearest = np.where(w.max(axis=0) > 0.0, w.argmax(axis=0), -1)
        for k, item in enumerate(scene.objects):
            visible = nearest == k
            if item.mapped is None or not visible.any():
                continue
            image = textures[k].radiance
            mapped = texture_map(item, image.shape[1], image.shape[0])
            across = footprints(item, poses[k], mapped, camera, slopes[0][visible], slopes[1][visible])
            for lens in lenses:
                radius = texture_spread(psf) * np.where(w[k] > 0.0, lens.image_radius(w[k], *slopes), np.nan)
                change = [np.nan_to_num(np.gradient(radius, axis=axis)) for axis in (0, 1)]
                spread = _between(radius, np.abs(change).max(axis=0))[:, visible]
                texels = np.nan_to_num((across**2).sum(axis=1).max(axis=0))
                fine = cut_parts(np.broadcast_to(texels, spread.shape), spread, exact, detail_least(psf)) > 0
                if not fine.any():
                    continue
                if firsts[k] not in spectra:
                    spectra[firsts[k]] = spectrum_of(image), float(np.square(image[::STRIDE, ::STRIDE]).mean())
                spectrum, light = spectra[firsts[k]]
                steep = sum((step[visible] / cell) ** 2 for step, cell in zip(change, cells, strict=True))
                lights = light * float((fine & (spread < NARROW)).mean(axis=0) @ steep) / fine.shape[1]
                for count in counts:
                    errors[count] += (lights * STEEP[count] ** 2) * float(visible.mean()) / len(lenses)
                for kind, share in _kinds(across, spread, fine):
                    for count, square in _kind_errors(kind, spectrum, exact, counts).items():
                        errors[count] += share * square * float(visible.mean()) / len(lenses)
        largest = {count: max(square, errors[count]) for count, square in largest.items()}
    return largest


def _between(radius: Array, change: Array) -> Array:
    """|R| (BETWEEN, rows, columns) at positions around each ray of a grid, because few rays hit the focus exactly.

    radius: signed R at the rays; change: change of R from ray to ray.
    """
    steps = np.linspace(-0.5, 0.5, BETWEEN + 1)
    return np.abs(radius + change * (0.5 * (steps[1:] + steps[:-1]))[:, None, None])


def footprints(item: Object, pose: Pose, image: TextureMap, camera: Camera, x: Array, y: Array) -> Array:
    """Footprints (2, 2, n) of pixels on a texture, in texels.

    The first axis is the step to the right neighbor of a pixel or to its lower one, the second the change of the
    texture's column or row in that step. image: mapping of the texture; x, y: slopes (n,) of rays that hit the object.
    NaN if the ray of a neighbor misses the object.
    """
    surface, (right, up) = place(item, pose), places_of(camera, x, y)
    points = np.empty((3, x.size, 3))
    for point, aside, above in zip(points, (0.0, 1.0, 0.0), (0.0, 0.0, -1.0), strict=True):
        rays = np.stack([*slopes_at(camera, right + aside, up + above), np.ones(x.size)])
        w = predict_inverse_depth(item, surface, rays[0], rays[1])
        distance = np.where(w > 0.0, 1.0 / np.where(w > 0.0, w, 1.0), np.nan)
        point[:] = (surface.own_offset[:, None] + surface.own_turn @ rays * distance).T @ image.frame.T
    change = points[1:] - points[0]
    normal = np.cross(*change) if image.kind == MAP_TRIPLANAR else points[0]
    side = np.abs(np.nan_to_num(normal)).argmax(axis=-1) if image.kind in (MAP_TRIPLANAR, MAP_CUBE) else None
    places = _coordinates(image, points, side)
    change = places[:, 1:] - places[:, :1]
    if image.kind in (MAP_CYLINDER, MAP_LONGITUDE):
        change[0] = np.remainder(change[0] + pi, 2.0 * pi) - pi
    return np.einsum("ij,jkn->kin", image.scale, change)


def _coordinates(image: TextureMap, q: Array, side: NDArray[np.intp] | None) -> Array:
    """The two coordinates (2, ..., n) of points (..., n, 3) in the frame of a texture (`clsco.optics.texture_mapping`).
    side: axis (n,) along which each point is projected, for cube and triplanar maps.
    """
    x, y, z = np.moveaxis(q, -1, 0)
    if side is not None:
        x, y = (np.choose(side, [q[..., ALONG[axis][k]] for axis in range(3)]) for k in range(2))
        over = np.choose(side, [q[..., axis] for axis in range(3)]) if image.kind == MAP_CUBE else 1.0
        return np.stack([x / over, y / over])
    angle = np.arctan2(x, z)
    if image.kind == MAP_CONE:
        length, rolled = np.linalg.norm(q, axis=-1), image.slant * angle
        return np.stack([length * np.sin(rolled), length * np.cos(rolled)])
    if image.kind == MAP_LONGITUDE:
        return np.stack([angle, np.arctan2(y, np.hypot(x, z))])
    return np.stack([angle if image.kind == MAP_CYLINDER else x, y])


Kind = tuple[Array, int]
"""Kind of pixels: a footprint (2, 2), as in `footprints`, and the index in RADII of the radius of the discs."""
Spectrum = tuple[Array, Array, Array]
"""Power of a texture, white^2, and its frequencies along columns and along rows, cycles per texel; of one shape."""


def _kinds(across: Array, spread: Array, fine: NDArray[np.bool_]) -> list[tuple[Kind, float]]:
    """Kinds of pixels with fine texture, each with the fraction of all pixels that it stands for.

    across: footprints (2, 2, n); spread: radii (BETWEEN, n) of the discs around each ray; fine: mask (BETWEEN, n) of
    fine texture.
    """
    discs = np.abs(np.log(RADII[:, None] / np.maximum(spread[fine], RADII[0]))).argmin(axis=0)
    fine_rays, kinds = np.nonzero(fine)[1], []
    for disc in np.flatnonzero(np.bincount(discs)).tolist():
        rays = fine_rays[discs == disc]
        for ray in rays[[rays.size // 4, rays.size * 3 // 4]].tolist():
            kinds.append(((across[:, :, ray], disc), 0.5 * rays.size / spread.size))
    return kinds


def power_in_frame(spectrum: Spectrum, across: Array, cycles: Array) -> tuple[Array, Array]:
    """Power of a texture's image without the constant term, by frequency along x, and by frequency along y.

    Each pixel of the image has the mean of the texture over its area. across: footprints (2, 2, n); cycles: frequencies
    in cycles per px, multiples of the first one.
    """
    powers, columns, rows = spectrum
    binned = np.zeros((2, cycles.size))
    rays = np.flatnonzero(np.isfinite(across).all(axis=(0, 1)))
    rays = rays[np.linspace(0, rays.size - 1, min(rays.size, LOOKS)).astype(np.intp)] if rays.size else rays
    for ray in rays.tolist():
        along = [np.abs(column * columns + row * rows) for column, row in across[:, :, ray]]
        passed = powers * (np.sinc(along[0]) * np.sinc(along[1])) ** 2 / rays.size
        for axis in range(2):
            at = np.rint(along[axis] / cycles[0]).astype(np.intp)
            inside = (at > 0) & (at <= cycles.size)
            np.add.at(binned[axis], at[inside] - 1, passed[inside])
    return binned[0], binned[1]


def _kind_errors(kind: Kind, power: Spectrum, exact: int, counts: Sequence[int]) -> dict[int, float]:
    """Squared error of one kind of pixels for each number of sources in `counts`."""
    (changes, disc), (powers, columns, rows) = kind, power
    texels = (changes**2).sum(axis=1).max(keepdims=True)

    def transfer(count: int) -> Array:
        parts = int(cut_parts(texels, RADII[[disc]], count)[0]) if count > 1 else 1
        along = _transfer(count, max(parts, 1))[disc]
        level = _level(changes / max(parts, 1))
        resolved = np.maximum(np.abs(columns), np.abs(rows)) <= HELD / 2.0**level if level else 1.0
        return np.asarray(along[index[0]] * along[index[1]] * resolved)

    index = [
        np.minimum(np.rint(STEPS * np.abs(column * columns + row * rows)), FREQUENCIES.size - 1).astype(np.intp)
        for column, row in changes
    ]
    exact_transfer = transfer(exact)
    return {count: float((powers * (exact_transfer - transfer(count)) ** 2).sum()) for count in counts}


def _level(changes: Array) -> int:
    """Coarsest mipmap level in which a footprint (2, 2) is at least LEAST_TEXELS wide."""
    across = sqrt(2.0 / float((changes**2).sum())) * abs(float(np.linalg.det(changes)))
    return max(int(log2(max(across / LEAST_TEXELS, 1.0))), 0)


@lru_cache(maxsize=32)
def _transfer(count: int, parts: int) -> Array:
    """V of the module's formula, by RADII and FREQUENCIES, for count x count sources in parts x parts parts."""
    reach = int(count * (RADII[-1] + 1.0))
    source = np.arange(-reach, reach + count)
    place, middle = (source + 0.5) / count - 0.5, (source * parts // count + 0.5) / parts - 0.5
    radius = RADII[:, None]
    shares = _left_of((place + 0.5) / radius) - _left_of((place - 0.5) / radius)
    size = np.minimum(parts * radius, 1.0)
    exchanged = size * (16.0 / (3.0 * pi) - size) / 8.0
    if count > 1:
        exchanged *= np.clip(REACHING * (2.0 * count * radius - 1.0), 0.0, 1.0)
    means = np.cos(2.0 * pi * np.multiply.outer(middle, FREQUENCIES)) * np.sinc(FREQUENCIES / parts)
    return np.asarray(shares / count @ means * (1.0 + 4.0 * exchanged * np.sin(pi * FREQUENCIES / parts) ** 2))


def _left_of(place: Array) -> Array:
    """Fraction of a disc of radius 1 to the left of a vertical line at `place`."""
    t = np.clip(place, -1.0, 1.0)
    return np.asarray(0.5 + (t * np.sqrt(1.0 - t * t) + np.arcsin(t)) / pi)


def spectrum_of(image: NDArray[np.float32]) -> Spectrum:
    """Mean power spectrum of patches of a texture under a Hann window; successive patches use successive channels."""
    channels = image.reshape(*image.shape[:2], -1)
    sides = tuple(min(SIDE, size) for size in channels.shape[:2])
    starts = (
        np.unique(np.linspace(0, size - side, PATCHES).astype(np.intp)).tolist()
        for size, side in zip(channels.shape, sides, strict=False)
    )
    corners = enumerate(product(*starts))
    window = np.multiply.outer(*(np.sin(pi * (np.arange(side) + 0.5) / side) ** 2 for side in sides))
    patches = np.stack(
        [channels[i : i + sides[0], j : j + sides[1], k % channels.shape[2]] for k, (i, j) in corners], dtype=np.float64
    )
    spectrum = np.fft.rfft2((patches - patches.mean(axis=(1, 2), keepdims=True)) * window)
    power = np.mean(np.abs(spectrum) ** 2, axis=0) / (window.size * float((window**2).sum()))
    power[:, 1 : (sides[1] + 1) // 2] *= 2.0  # also stands for negative frequencies
    columns, rows = np.meshgrid(np.fft.rfftfreq(sides[1]), np.fft.fftfreq(sides[0]))
    return power, columns, rows
