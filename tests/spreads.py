"""Blurs of the PSFs that tests are written for, and random sources."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.inputs.pupils import load_point_spread
from clsco.optics.point_spread import PointSpread
from clsco.plan.methods import Blur, BlurSpec
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
