"""Blurs of the PSFs that tests are written for, and random sources."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.inputs.pupils import load_point_spread
from clsco.optics.point_spread import PointSpread
from clsco.optics.psf_grid import table_coordinate as coordinate_of_radius
from clsco.optics.resolved_view import guard_band
from clsco.plan.methods import Blur, BlurSpec
from clsco.reference.layered.layered import layered
from clsco.reference.trace.trace import Sources, SubpixelSources
from clsco.scene.model import Aperture, Psf

PSFS = [Psf(model=model, edge=edge) for model in ("pillbox", "gaussian") for edge in ("sampled", "area", "integrated")]


def name_of(psf: Psf) -> str:
    """Its name in those of tests."""
    return f"{psf.model}-{psf.edge}"


def spec_of(
    psf: Psf, largest: float = 0.0, method: Blur = "gather", aperture: Aperture | None = None, **others: Any
) -> BlurSpec:
    """Blur by the keys of [psf] and [aperture]; `largest`: |R| in px."""
    given = {"smallest": 0.0, "tilt": psf.tilt, "border": psf.border} | others
    return BlurSpec(load_point_spread(psf, aperture or Aperture()), method, largest=largest, **given)


def layered_before_black(
    spec: BlurSpec, image: NDArray[np.float64], coc: NDArray[np.float64]
) -> tuple[NDArray[np.float64], int]:
    """`layered` of an image (rows, columns, C) with nothing beyond its border."""
    guard = guard_band(spec.psf, "lose", spec.largest)
    light, radii = np.pad(image, ((guard, guard), (guard, guard), (0, 0))), np.pad(coc, guard)
    there = np.pad(np.ones(coc.shape, np.bool_), guard)
    return layered(spec, light, radii, there, (coc.shape[0], coc.shape[1]), guard)


def table_coordinate(
    psf: PointSpread, radius: NDArray[np.float64], subpixel: bool, first: int, count: int, turned: int = 0
) -> NDArray[np.float32]:
    """Coordinates (...) in a device's table of PSF weights; their integer part is the interval's number.

    radius: (...) px; first, count: the table has `count` intervals, from number `first` on, to which other radii are
    clamped; turned: for a signed shape, the number added to coordinates of negative radii, where 0 stands for `count`.
    Coordinates are rounded to float32, but for a sampled PSF never into the next interval, as weights may jump there.
    """
    u = np.maximum(coordinate_of_radius(psf, radius, subpixel), first)
    rounded = u.astype(np.float32)
    highest = np.full(u.shape, first + count)
    jumps = psf.sampled and not subpixel
    ceiling = (np.minimum(np.floor(u) + 1.0, highest) if jumps else highest).astype(np.float32)
    coordinate = np.where(rounded < ceiling, rounded, np.nextafter(ceiling, np.float32(0.0)))
    if not psf.signed:
        return coordinate
    negative, end = (values + np.float32(turned or count) for values in (coordinate, ceiling))
    negative = np.where(negative < end, negative, np.nextafter(end, np.float32(0.0)))
    return np.where(np.asarray(radius) < 0.0, negative, coordinate)


def convolve(psf: PointSpread, radiance: NDArray[np.float64], radius: float, guard: int) -> NDArray[np.float64]:
    """Blurred image (m, n, C) of radiances (m + 2 guard, n + 2 guard, C) of one radius, px: weights, shifted."""
    far, (rows, columns, channels) = psf.reach(abs(radius)), radiance.shape
    offset = np.arange(-far, far + 1, dtype=np.float64)
    table = psf.weights(offset[None, :], offset[:, None], np.asarray(abs(radius)))
    padded = np.pad(radiance, ((far, far), (far, far), (0, 0)))
    color = np.zeros((rows - 2 * guard, columns - 2 * guard, channels))
    for (dy, dx), weight in np.ndenumerate(table):
        color += weight * padded[guard + dy :, guard + dx :][: len(color), : color.shape[1]]
    return color


def random_sources(shape: tuple[int, int], smallest: float, largest: float, steepest: float, channels: int) -> Sources:
    """Sources of either sign and any gradient up to `steepest` px per px, a tenth of the pixels empty."""
    rng = np.random.default_rng(41)
    label = (rng.random(shape) < 0.9).astype(np.uint8)
    there = label > 0
    angle, length = rng.uniform(0, 2 * np.pi, shape), rng.uniform(0, steepest, shape)
    gradient = np.stack([length * np.cos(angle), length * np.sin(angle)], axis=-1)
    radius = np.where(there, rng.choice([-1, 1], shape) * rng.uniform(smallest, largest, shape), 0.0)
    radiance = np.where(there[..., None], rng.random((*shape, channels)), 0.0)
    return Sources(radiance, np.ones(shape), label, radius, gradient, there)


def random_subpixels(sources: Sources, samples: int, count: int, smallest: float, largest: float) -> SubpixelSources:
    """Sub-pixel sources in `count` random pixels, whether those have a source of their own or not; half at limbs."""
    rng = np.random.default_rng(43)
    height, width, channels = sources.radiance.shape
    pixel = rng.choice(height * width, count, replace=False)
    shape = (count, samples, samples)
    return SubpixelSources(
        row=pixel // width,
        column=pixel % width,
        hit=rng.random(shape) < 0.7,
        radius=rng.choice([-1, 1], shape) * rng.uniform(smallest, largest, shape),
        gradient=rng.uniform(-0.6, 0.6, (*shape, 2)),
        radiance=rng.random((*shape, channels)),
        limb=rng.random(shape) < 0.5,
    )
