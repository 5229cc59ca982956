"""Rays cast at the surface: sources of light, sub-pixel sources at silhouettes, ground truth.

The padded grid has `guard` rows and columns on each side of the frame: surface outside the frame lights it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clsco.motion import middle_time, pose_at
from clsco.psf import subpixel_offsets
from clsco.reference.geometry import (
    Array,
    blur_gradient,
    blur_radius,
    body_point,
    mirror_index,
    pixel_ray,
    project,
    rest_pixel,
    rest_position,
    sample_texture,
    solve_quadric,
    surface_normal,
    surface_slope,
    turned,
)
from clsco.scene import Camera, Scene
from clsco.surfaces import PlacedSurface, place

SILHOUETTE_RANGE = 2  # px, Chebyshev distance from a silhouette within which pixels get sub-pixel sources


@dataclass(frozen=True, eq=False)
class Sources:
    """Sources of light, one per pixel of the padded grid (H, W).

    radiance (H, W, C) linear light; inverse_depth (H, W) 1/mm; label (H, W): 0 no source, else which root of
    the surface; radius (H, W) signed blur radius in px; gradient (H, W, 2) of the radius, px per px, right
    and down.
    """

    radiance: Array
    inverse_depth: Array
    label: NDArray[np.uint8]
    radius: Array
    gradient: Array


@dataclass(frozen=True, eq=False)
class SubpixelSources:
    """S x S sources in each of M pixels, which replace the pixel's own; each has the weight 1/S^2.

    row, column (M,): padded-grid pixel; hit (M, S, S): there is surface; radius (M, S, S) px; gradient (M, S,
    S, 2) px per px; radiance (M, S, S, C). Source (i, j) is `clsco.psf.subpixel_offsets(S)[i]` rows and [j]
    columns off the pixel's center.
    """

    row: NDArray[np.int64]
    column: NDArray[np.int64]
    hit: NDArray[np.bool_]
    radius: Array
    gradient: Array
    radiance: Array


@dataclass(frozen=True, eq=False)
class Truth:
    """Ground truth at the middle of the shutter: see `clsco.frame.Frame`, whose names and units these are."""

    sharp: Array
    depth: Array
    coc: Array
    mask: NDArray[np.bool_]
    object_id: NDArray[np.int32]
    normal: Array
    flow: Array
    hidden: NDArray[np.bool_]


def padded_grid(camera: Camera, guard: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows (H, 1) and columns (1, W) of the padded grid in frame pixels: -guard .. n-1+guard."""
    assert camera.resolution is not None
    columns, rows = camera.resolution
    return np.arange(-guard, rows + guard)[:, None], np.arange(-guard, columns + guard)[None, :]


def _cast(scene: Scene, surface: PlacedSurface, rays: Array) -> tuple[Array, NDArray[np.uint8], Array, Array]:
    """Inverse depth, label, blur radius and its gradient along rays; 0 where no surface is."""
    w, label = solve_quadric(surface, scene.objects[0].bounds, rays)
    radius = np.where(label > 0, blur_radius(scene.camera, w), 0.0)
    return w, label, radius, blur_gradient(scene.camera, surface_slope(surface, rays, w))


def _moved_radiance(scene: Scene, surface: PlacedSurface, texture: Array, rays: Array, w: Array) -> Array:
    """Texture where the camera saw the surface points at rest; 0 where they were behind the lens."""
    row, column, valid = rest_pixel(surface, scene.camera, rays, w)
    radiance = sample_texture(texture, row, column, scene.motion.texture_filter)
    return np.where(valid[..., None], radiance, 0.0)


def _texels(texture: Array, row: NDArray[np.int64], column: NDArray[np.int64]) -> Array:
    """The texture's own texels at frame pixels, mirrored outside of the frame."""
    return np.asarray(texture[mirror_index(row, texture.shape[0]), mirror_index(column, texture.shape[1])])


def trace(scene: Scene, surface: PlacedSurface, texture: Array, guard: int, moved: bool) -> Sources:
    """Sources of light on the padded grid, from one ray through each pixel's center.

    texture: (rows, columns, channels) of the frame's size, linear light; guard: px; moved: the surface is not
    exactly where it is at rest. At rest the radiance is the texel itself, else the texture is sampled where
    the camera saw the point at rest. Validated against the thesis' depth formulas and the texture at rest.
    """
    row, column = padded_grid(scene.camera, guard)
    rays = pixel_ray(scene.camera, row, column)
    w, label, radius, gradient = _cast(scene, surface, rays)
    radiance = _moved_radiance(scene, surface, texture, rays, w) if moved else _texels(texture, row, column)
    return Sources(np.where((label > 0)[..., None], radiance, 0.0), w, label, radius, gradient)


def mark_silhouettes(label: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Pixels (H, W) with a different label anywhere within 2 px, rows and columns counted separately.

    label: (H, W) from `trace`. There the blur radius runs away or jumps between two neighbors.
    """
    padded = np.pad(label, SILHOUETTE_RANGE, mode="edge")
    size = 2 * SILHOUETTE_RANGE + 1
    windows = np.lib.stride_tricks.sliding_window_view(padded, (size, size))
    return np.asarray((windows != label[..., None, None]).any(axis=(-1, -2)))


def trace_subpixels(
    scene: Scene, surface: PlacedSurface, texture: Array, guard: int, moved: bool, marked: NDArray[np.bool_]
) -> SubpixelSources:
    """Sub-pixel sources of the marked pixels (H, W) of the padded grid; other arguments as for `trace`.

    Their number per axis is psf.silhouette_samples. At rest they share their pixel's own texel, else each
    samples the texture at its own position.
    """
    samples = scene.psf.silhouette_samples
    row, column = np.nonzero(marked)
    offsets = subpixel_offsets(samples)
    at_row = (row - guard)[:, None, None] + offsets[:, None]
    at_column = (column - guard)[:, None, None] + offsets[None, :]
    rays = pixel_ray(scene.camera, at_row, at_column)
    w, label, radius, gradient = _cast(scene, surface, rays)
    if moved:
        radiance = _moved_radiance(scene, surface, texture, rays, w)
    else:
        texels = _texels(texture, row - guard, column - guard)
        radiance = np.broadcast_to(texels[:, None, None, :], (*w.shape, texture.shape[2]))
    return SubpixelSources(row, column, label > 0, radius, gradient, radiance)


def _hidden(scene: Scene, surface: PlacedSurface, rest: PlacedSurface, rays: Array, w: Array) -> NDArray[np.bool_]:
    """Surface points that the camera did not see at rest."""
    assert scene.camera.resolution is not None
    columns, rows = scene.camera.resolution
    row, column, valid = rest_pixel(surface, scene.camera, rays, w)
    outside = (row < -0.5) | (row >= rows - 0.5) | (column < -0.5) | (column >= columns - 0.5)
    w_rest, _ = solve_quadric(rest, scene.objects[0].bounds, pixel_ray(scene.camera, row, column))
    depth_ratio = np.where(valid, rest_position(surface, rays, w)[..., 2], 1.0)
    covered = w_rest * depth_ratio > w * (1.0 + 1e-6)
    return np.asarray((w > 0.0) & (~valid | outside | covered))


def ground_truth(scene: Scene, texture: Array, frame: int) -> Truth:
    """Ground truth (rows, columns[, ...]) of a frame at the middle of its shutter, at pixel centers.

    texture: as for `trace`. `flow` goes from a pixel to where its surface point is at the middle of the next
    frame's shutter; 0 where that is behind the lens. `hidden`: the point is outside of the frame at rest, or
    another point of the surface hides it there (nearer by more than 1e-6 of its depth). Validated: flow
    against the thesis' 80 and 70 px, normals and radius against closed forms.
    """
    item, camera = scene.objects[0], scene.camera
    rotation = scene.motion.rotation
    now, then = (pose_at(item.motion, middle_time(scene.sequence, k), rotation) for k in (frame, frame + 1))
    start = pose_at(item.motion, 0.0, rotation)
    surface, rest = place(item, now), place(item, start)
    sources = trace(scene, surface, texture, 0, item.motion.moves)
    row, column = padded_grid(camera, 0)
    rays, w = pixel_ray(camera, row, column), sources.inverse_depth
    mask = sources.label > 0
    body = turned(then.rotation, body_point(surface, rays, w))
    next_position = (surface.rest + then.shift) * w[..., None] + body
    before_lens = mask & (next_position[..., 2] > 0.0)
    next_row, next_column = project(camera, np.where(before_lens[..., None], next_position, 1.0))
    flow = np.stack([next_column - column, next_row - row], axis=-1)
    return Truth(
        sharp=sources.radiance,
        depth=np.where(mask, 1.0 / np.where(mask, w, 1.0), np.inf),
        coc=sources.radius,
        mask=mask,
        object_id=np.where(mask, np.int32(0), np.int32(-1)),
        normal=surface_normal(surface, rays, w),
        flow=np.where(before_lens[..., None], flow, 0.0),
        hidden=_hidden(scene, surface, rest, rays, w),
    )
