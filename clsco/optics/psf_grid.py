"""Intervals of PSF tables: conversion between blur radius and table coordinate (float64, pure)."""

from __future__ import annotations

from functools import lru_cache
from math import ceil, floor
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from clsco.constants import POWERS, TABLE_STEPS, TAP_LANES
from clsco.optics.point_spread import MINIMUM_BLUR, PointSpread

Array = NDArray[np.float64]
Widths = TypeVar("Widths", int, NDArray[np.int64])

# Tables have TABLE_STEPS or more intervals per octave of the radius plus an offset (`octaves_from`), so that intervals
# grow with the radius. The weight of a point source has a kink of order 3/2 where its circle touches a pixel's edge,
# first at R = 1/8 px; with edge "area", all weights have such kinks. The weight of a Gaussian has a corner where the
# cut-off touches one. tests/optics/test_point_spread.py bounds interpolation errors of PSFs, tests/kernels/test_blur.py
# those of frames.
OFFSET, AREA_STEPS = 0.125, 128  # twice as many steps for general shapes, whose edges lie at any angle
GAUSSIAN_STEPS = 64  # a power of 2, so that intervals begin at the corners, up to an extent of 2 TABLE_STEPS offsets
# Discs of sub-pixel sources have kinks where they touch pixel edges, at multiples of 1/8 px for 2 or 4 samples: up to
# R = 16 px an interval begins there. With 48 steps, a small object before a wall of one radius has an error of 1.5e-5.
SUBPIXEL_STEPS = 64
# A sampled Gaussian changes fastest with few taps: FINE_STEPS intervals per unit of dx^2 + dy^2 up to FINE_UNTIL.
FINE_STEPS, FINE_UNTIL = 16, 16
# Chebyshev points of [0, 1]: near the best cubic, and never on a jump of a sampled PSF.
NODES = 0.5 - 0.5 * np.cos((2 * np.arange(POWERS) + 1) * np.pi / 8)
TO_POWERS = np.linalg.inv(np.vander(NODES, POWERS, increasing=True))
BLOCK = 64  # intervals of a sampled Gaussian, or of waves, that are computed together


def sampled_steps(psf: PointSpread) -> tuple[int, int]:
    """For a sampled PSF: number of intervals per unit of dx^2 + dy^2 near 0, and number of units with so many
    intervals. Each unit beyond is one interval.
    """
    return (1, 0) if psf.uniform else (FINE_STEPS, FINE_UNTIL)


def table_steps(psf: PointSpread, subpixel: bool) -> int:
    """Intervals per octave of the radius, or, for waves and aberrations, per px."""
    if psf.diffracted:
        return psf.pupil.steps
    if psf.edge == "area" and not subpixel:
        return 2 * AREA_STEPS if psf.layout == "general" else AREA_STEPS
    if psf.alignment:
        return GAUSSIAN_STEPS
    return SUBPIXEL_STEPS if subpixel else TABLE_STEPS


def octaves_from(psf: PointSpread) -> float:
    """Inverse of the offset that is added to radii before taking their logarithm, 1 / px; a float32.

    For a Gaussian, the offset is at most OFFSET / extent: with sub-pixel sources, pixel edges are at multiples of 1 /
    alignment px, and an interval must begin where the cut-off reaches one.
    """
    if not psf.alignment:
        return 1.0 / OFFSET
    return float(np.float32(psf.extent * psf.alignment * ceil(1.0 / (psf.alignment * OFFSET))))


def table_coordinate(psf: PointSpread, radius: Array, subpixel: bool = False) -> Array:
    """Coordinate u of a blur radius in px; its integer part is the number of the table's interval."""
    r = np.abs(np.asarray(radius, dtype=np.float64))
    if psf.edge == "sampled" and not subpixel:
        key = np.where(r < MINIMUM_BLUR, 0.0, psf.key * r * r)
        steps, until = sampled_steps(psf)
        return np.where(key < until, key * steps, until * steps + (key - until))
    if psf.diffracted:
        return table_steps(psf, subpixel) * r
    mantissa, exponent = np.frexp(r * octaves_from(psf) + 1.0)
    return np.asarray(table_steps(psf, subpixel) * (exponent - 1 + 2.0 * mantissa - 1.0))


def table_radius(psf: PointSpread, coordinate: Array, subpixel: bool) -> Array:
    """Inverse of table_coordinate."""
    if psf.edge == "sampled" and not subpixel:
        return np.maximum(np.sqrt(_sampled_reach(psf, coordinate) / psf.key), MINIMUM_BLUR)
    position = coordinate / table_steps(psf, subpixel)
    if psf.diffracted:
        return position
    octave = np.floor(position)
    return np.asarray((2.0**octave * (1.0 + position - octave) - 1.0) / octaves_from(psf))


def _sampled_reach(psf: PointSpread, coordinate: Array) -> Array:
    """Largest dx^2 + dy^2 of covered pixel centers, from the coordinate of a sampled PSF."""
    steps, until = sampled_steps(psf)
    return np.where(coordinate < until * steps, coordinate / steps, until + coordinate - until * steps)


def half_widths(psf: PointSpread, span: range, subpixel: bool) -> NDArray[np.int64]:
    """Half-widths in px of the stencils of a range of intervals; a sampled PSF has about R^2 intervals."""
    if psf.edge == "sampled" and not subpixel:
        return np.floor(np.sqrt(_sampled_reach(psf, np.array(span)))).astype(np.int64)
    return psf.reaches(table_radius(psf, np.array(span) + 1.0, subpixel), subpixel)


@lru_cache(maxsize=256)
def half_width(psf: PointSpread, index: int, subpixel: bool) -> int:
    """Half-width in px of the rows of an interval."""
    return int(half_widths(psf, range(index, index + 1), subpixel)[0])


def block_intervals(psf: PointSpread, subpixel: bool) -> int:
    """Number of intervals computed together: half an octave, or a quarter for sub-pixel sources.

    For sampled PSFs, waves and aberrations it is BLOCK; but for waves and aberrations of layout "general", it is the
    number per px, at least TAP_LANES.
    """
    if psf.diffracted and psf.layout == "general":
        return max(table_steps(psf, subpixel), TAP_LANES)
    by_numbers = (psf.edge == "sampled" and not subpixel) or psf.diffracted
    return BLOCK if by_numbers else table_steps(psf, subpixel) // (4 if subpixel else 2)


@lru_cache(maxsize=256)
def span_of(psf: PointSpread, smallest: float, largest: float, subpixel: bool) -> range:
    """Intervals for |blur radii| from smallest to largest px, extended downwards to a multiple of TAP_LANES.

    Thus the windows of WIDE_LANES intervals that kernels read begin at the same intervals for every smallest radius,
    which fixes the order of sums. General shapes spread by waves or aberrations have no windows, and are not extended.
    """
    first, last = (floor(float(table_coordinate(psf, np.array(r), subpixel))) for r in (smallest, largest))
    step = 1 if psf.diffracted and psf.layout == "general" else TAP_LANES
    return range(first // step * step, last + 1)


@lru_cache(maxsize=256)
def table_reach(psf: PointSpread, largest: float, subpixel: bool = False) -> int:
    """Largest half-width in px of the rows of `psf_table` for radii up to `largest` px."""
    return half_width(psf, span_of(psf, largest, largest, subpixel)[-1], subpixel)


def octant_taps(reach: int) -> int:
    """Number of taps of an octant, at |dx|, |dy| = a, b px with reach >= a >= b >= 0."""
    return (reach + 1) * (reach + 2) // 2


def row_lanes(half_width: Widths) -> Widths:
    """Number of floats of a row of weights, rounded up to whole vectors."""
    return -(-(2 * half_width + 1) // TAP_LANES) * TAP_LANES
