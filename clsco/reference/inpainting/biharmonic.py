"""The biharmonic equation in holes: conjugate gradients with a preconditioner of splines at all sizes.

Method and sources: clsco/inpainting/biharmonic.py. Vectors are arrays (H, W, K) that are 0 outside of the holes.
"""

from __future__ import annotations

import numpy as np

from clsco.inpainting.hole_shapes import FINER_GAIN, FIRST_GAIN, MOST_STEPS, TOLERANCE, spline_holes
from clsco.reference.common.geometry import Array
from clsco.reference.inpainting.neighbors import Mask


def fill_biharmonic(image: Array, missing: Mask) -> Array:
    """An image (H, W, K) with the Laplacian of the Laplacian 0 in its holes (H, W), unclipped."""
    if not missing.any():
        return image
    holes = [missing]
    while (coarse := spline_holes(holes[-1])).any() and coarse.size < holes[-1].size:
        holes.append(coarse)
    residual = start_residual(image, missing)
    solution, direction = np.zeros_like(residual), preconditioned(residual, holes)
    now = first = add_partials(add_products(residual, direction))
    for _ in range(MOST_STEPS):
        if not (now > TOLERANCE**2 * first).any():
            break
        applied = apply_biharmonic(direction, missing)
        energy = add_partials(add_products(direction, applied))
        solution, residual = take_step(now, energy, direction, applied, solution, residual)
        better = preconditioned(residual, holes)
        before, now = now, add_partials(add_products(residual, better))
        direction = turn_direction(before, now, better, direction)
    return np.where(missing[..., None], solution, image)


def laplacian(u: Array) -> Array:
    """Five-point Laplacian (H, W, K) of u; nothing flows over the border."""
    p = np.pad(u, ((1, 1), (1, 1), (0, 0)), mode="edge")
    return np.asarray(p[:-2, 1:-1] + p[2:, 1:-1] + p[1:-1, :-2] + p[1:-1, 2:] - 4 * u)


def start_residual(image: Array, missing: Mask) -> Array:
    """Residual of the solution 0 in the holes of an image."""
    return -apply_biharmonic(np.where(missing[..., None], 0, image), missing)


def apply_biharmonic(direction: Array, missing: Mask) -> Array:
    """The Laplacian of the Laplacian, in the holes."""
    return np.where(missing[..., None], laplacian(laplacian(direction)), 0)


def add_products(a: Array, b: Array) -> Array:
    """Sums (H, K) of the products in each row."""
    return np.asarray((a * b).sum(axis=1))


def add_partials(partial: Array) -> Array:
    """Their sum (K,)."""
    return np.asarray(partial.sum(axis=0))


def take_step(
    now: Array, energy: Array, direction: Array, applied: Array, solution: Array, residual: Array
) -> tuple[Array, Array]:
    """Solution and residual after a step; now, energy: (K,), products with the residual and of the direction."""
    size = np.divide(now, energy, out=np.zeros_like(now), where=energy > 0)
    return solution + size * direction, residual - size * applied


def turn_direction(before: Array, now: Array, better: Array, direction: Array) -> Array:
    """The next direction; before, now: (K,), products of the residual and the preconditioned one."""
    return better + np.divide(now, before, out=np.zeros_like(now), where=before > 0) * direction


def preconditioned(residual: Array, holes: list[Mask]) -> Array:
    """The residual smoothed by splines in ever coarser holes."""
    vectors = [residual]
    for level, inside in enumerate(holes[1:]):
        vectors.append(coarser(vectors[-1], inside, FIRST_GAIN if level == 0 else FINER_GAIN))
    for level in range(len(vectors) - 2, -1, -1):
        vectors[level] = finer(vectors[level], vectors[level + 1], holes[level])
    return vectors[0]


def coarser(fine: Array, inside: Mask, gain: float) -> Array:
    """Residuals of the splines of twice the size, times gain; inside: (H', W'), those that there are."""
    rows, columns = (_refinement(size) for size in fine.shape[:2])
    return np.where(inside[..., None], gain * np.einsum("ia,ijk,jb->abk", rows, fine, columns, optimize=True), 0)


def finer(fine: Array, coarse: Array, missing: Mask) -> Array:
    """A fine vector plus the splines of twice the size."""
    rows, columns = (_refinement(size) for size in fine.shape[:2])
    added = np.einsum("ia,abk,jb->ijk", rows, coarse, columns, optimize=True)
    return np.where(missing[..., None], fine + added, 0)


def _refinement(size: int) -> Array:
    """Weights of the splines of ceil(size / 2) coarse pixels at `size` fine ones, mirrored at the border."""
    result = np.zeros((size, (size + 1) // 2))
    for i in range(size):
        result[i, i // 2] += 0.75
        result[i, min(max(i // 2 + (1 if i % 2 else -1), 0), result.shape[1] - 1)] += 0.25
    return result
