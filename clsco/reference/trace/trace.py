"""Rays cast at surfaces: sources, and sub-pixel sources at silhouettes.

The padded grid has `guard` rows and columns on each side of the frame, because surfaces there contribute light to it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.constants import SHARED_PLACE
from clsco.inputs.pupils import scene_point_spread
from clsco.optics.ellipses import shape_of
from clsco.optics.lens import ray_step
from clsco.optics.lens_path import camera_at, colored, lens_at, lenses_at, reference_camera
from clsco.optics.light import place_light
from clsco.optics.motion import Eye, poses_at
from clsco.optics.point_spread import PointSpread, subpixel_offsets
from clsco.optics.quadrics import place
from clsco.optics.rays import ray_changes
from clsco.optics.visibility import OcclusionGroup
from clsco.reference.common.equation import Points
from clsco.reference.common.geometry import (
    Array,
    blur_radius,
    pixel_ray,
    pixel_reach,
    pixel_tilt,
    signed_size,
    surface_slope,
    tilt_slope,
)
from clsco.reference.common.visibility import HIDDEN, Visibility, check_visibility
from clsco.reference.common.visibility_test import bend_visibility
from clsco.reference.trace.detail import detailed_texture, is_shared
from clsco.reference.trace.light import shade
from clsco.reference.trace.mapping import Indices, MappedTexture
from clsco.reference.trace.outline import UNMARKED, cell_coverage, is_at_limb, labels_around
from clsco.reference.trace.small import cast_behind, small_members, with_small
from clsco.reference.trace.view import Cast, Texture, View, cast
from clsco.scene.model import Camera, Scene

SILHOUETTE_RANGE = 2  # px, Chebyshev distance from a silhouette within which pixels get sub-pixel sources


@dataclass(frozen=True, eq=False)
class Sources:
    """Sources, one per pixel of the padded grid (H, W).

    radiance: (H, W, C), linear. inverse_depth: (H, W), 1/mm. label: (H, W), 0 for no source, else root and object; the
    highest bit changes where two surfaces meet. radius: (H, W), signed blur radius in px. gradient: (H, W, 2), gradient
    of the radius, px per px, right and down. lit: (H, W), True if any of the source's radiance reaches the lens.
    visibility: occluders of the sources, None if there are none. parts: (H, W), number of parts per axis that the
    texture needs, 0 for none. share: (H, W), sharpening coefficient of the texture, see `sharpen`. shape: (H, W, 3),
    shapes of elliptic blurs, None for discs. widening: (H, W, 2), relative change of the ellipse's size per px, right
    and down.
    """

    radiance: Array
    inverse_depth: Array
    label: NDArray[np.uint8]
    radius: Array
    gradient: Array
    lit: NDArray[np.bool_]
    visibility: Visibility | None = None
    parts: NDArray[np.intp] | None = None
    share: Array | None = None
    shape: Array | None = None
    widening: Array | None = None


@dataclass(frozen=True, eq=False)
class SubpixelSources:
    """S x S sources in each of M pixels, which replace the pixel's own source; each has the weight 1/S^2.

    row, column (M,): pixel of the padded grid. hit (M, S, S): True for a surface visible from the lens. visibility:
    occluders of the sources with `hit`, in order, None if there are none. radius (M, S, S): px. gradient (M, S, S, 2):
    px per px. radiance (M, S, S, C): multiplied by the covered area in cells. limb (M, S, S): True at a limb, None if
    there is none. shape (M, 3), of the pixels, and widening (M, S, S, 2): as for `Sources`. Source (i, j) is blurred
    from the middle of its cell, which is `subpixel_offsets(S)[i]` rows and `subpixel_offsets(S)[j]` columns off the
    pixel's center.
    """

    row: NDArray[np.int64]
    column: NDArray[np.int64]
    hit: NDArray[np.bool_]
    radius: Array
    gradient: Array
    radiance: Array
    visibility: Visibility | None = None
    limb: NDArray[np.bool_] | None = None
    shape: Array | None = None
    widening: Array | None = None


def padded_grid(camera: Camera, guard: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows (H, 1) and columns (1, W) of the padded grid in frame pixels: -guard .. n-1+guard."""
    assert camera.resolution is not None
    columns, rows = camera.resolution
    return np.arange(-guard, rows + guard)[:, None], np.arange(-guard, columns + guard)[None, :]


def view_at(
    scene: Scene, textures: tuple[Texture, ...], time: float, eye: Eye, moved: bool, psf: PointSpread | None = None,
    color: int | None = None,
) -> View:  # fmt: skip
    """Objects and lens at `time` seconds; color: number of a single color, or None; other arguments as for `View`."""
    reference, lens, lenses = reference_camera(scene), lens_at(scene, time, color), lenses_at(scene, time)
    shifted = scene.shifts_colors and color is not None
    if scene.lens is not None and (scene.lens.moves or scene.lens.distorts or shifted):
        camera = colored(camera_at(scene, time), scene.lens, color)
        scene = scene.model_copy(update={"camera": camera, "lens": None})
    placed = zip(scene.objects, poses_at(scene, time, eye), strict=True)
    surfaces = tuple(place(item, pose) for item, pose in placed)
    light, spread = place_light(scene, time, eye), psf or scene_point_spread(scene)
    return View(scene, surfaces, textures, moved, light, spread, reference, lens, lenses)


def everything(scene: Scene) -> OcclusionGroup:
    """All objects in one occlusion group without occluders: the pinhole image."""
    return OcclusionGroup((1 << len(scene.objects)) - 1, 0)


def trace(view: View, group: OcclusionGroup, guard: int) -> Sources:
    """Sources on the padded grid, from one ray through each pixel's center to the objects of an occlusion group.

    In the reference pose the radiance is the texel itself, otherwise the texture is interpolated at the point's
    projection in the reference pose.
    """
    row, column = padded_grid(view.camera, guard)
    hit = cast(view, group, row, column, (row, column), 1)
    label, lit, visibility = hit.label.copy(), hit.label > 0, None
    shape, widening = _ellipses(view, row, column)
    if group.occluders or view.psf.rims:
        rays, hit_widening = pixel_ray(view.camera, row, column)[lit], None if widening is None else widening[lit]
        zeros, radius = np.zeros(len(rays)), hit.radius[lit]
        gradient = _tilted(view, radius, hit.gradient[lit], hit_widening)
        place_of = np.stack([np.broadcast_to(at, lit.shape)[lit] for at in (row, column)])
        points = Points(rays, hit.w[lit], radius, zeros, zeros, 1.0, gradient, place=place_of)
        state, edge, partial = check_visibility(view.lens, view.surfaces, view.bounds, group, view.psf, points)
        label[lit] |= edge.astype(np.uint8) << 7
        number = np.full(lit.size, -1)
        number[np.flatnonzero(lit)] = partial.row
        visibility = replace(partial, row=number)
        if shape is not None:
            visibility = bend_visibility(visibility, shape[lit][partial.row >= 0])
        lit[lit] = state != HIDDEN
    parts, share = np.where(lit, hit.parts, 0), np.where(lit, hit.share, 0.0)
    return Sources(
        hit.radiance, hit.w, label, hit.radius, hit.gradient, lit, visibility, parts, share, shape, widening
    )  # fmt: skip


def _tilted(view: View, radius: Array, gradient: Array, widening: Array | None) -> Array:
    """Gradient (N, 2) of the blur radius of whole pixels, as visibility tests use it; 0 if tilt is ignored."""
    tilt, _ = pixel_tilt(gradient, radius, view.psf.diffracted)
    tilt = tilt if widening is None else tilt + widening
    size = pixel_reach(radius, view.psf.diffracted) * np.where(radius < 0.0, -1.0, 1.0)
    return np.asarray(tilt * size[:, None] * view.scene.psf.tilt)


def _ellipses(view: View, row: NDArray[Any], column: NDArray[Any]) -> tuple[Array | None, Array | None]:
    """Shape (..., 3) and widening (..., 2) of elliptic blurs on the rays through pixels; None for discs."""
    distortion = view.lens.distortion
    if not view.psf.stretched or distortion is None:
        return None, None
    x, y, _ = np.moveaxis(pixel_ray(view.camera, row, column), -1, 0)
    shape, (right, up) = shape_of(distortion, x, y), distortion.solved(x, y, *distortion.stretch_slope(x, y))
    return shape, ray_step(view.camera) * np.stack([right, -up], axis=-1)


def spread_sources(sources: Sources) -> Sources:
    """Sources with the radius and gradient that `scatter` uses for whole pixels, see `pixel_tilt`."""
    tilt, radius = pixel_tilt(sources.gradient, sources.radius)
    return replace(sources, radius=radius, gradient=signed_size(radius)[..., None] * tilt)


def mark_silhouettes(label: NDArray[np.uint8 | np.bool_]) -> NDArray[np.bool_]:
    """Mask (H, W) of pixels with a different label within 2 px, in rows and in columns.

    label: (H, W) from `trace`. Near such silhouettes the blur radius is steep or discontinuous.
    """
    padded = np.pad(label, SILHOUETTE_RANGE, mode="edge")
    size = 2 * SILHOUETTE_RANGE + 1
    windows = np.lib.stride_tricks.sliding_window_view(padded, (size, size))
    return np.asarray((windows != label[..., None, None]).any(axis=(-1, -2)))


def sharpen(sources: Sources, marked: NDArray[np.bool_]) -> Sources:
    """Sharpen the sources of textures on surfaces by differences to neighbors, so that each source represents a square.

    See kernels/trace/footprint.clh. marked (H, W): pixels with sub-pixel sources, which are excluded.
    """
    assert sources.share is not None
    share = np.where(marked, 0.0, sources.share)
    radiance = sources.radiance.copy()
    for axis in (0, 1):
        s, light, new = (np.moveaxis(plane, axis, 0) for plane in (share, sources.radiance, radiance))
        shared = (s[:-1] > 0.0) & (s[1:] > 0.0)
        flow = np.where(shared, 0.5 * (s[:-1] + s[1:]), 0.0)[..., None] * (light[:-1] - light[1:])
        new[:-1] += flow
        new[1:] -= flow
    return replace(sources, radiance=radiance)


def trace_subpixels(
    view: View, group: OcclusionGroup, guard: int, marked: NDArray[np.bool_], sources: Sources | None = None
) -> SubpixelSources:
    """Sub-pixel sources for the marked pixels (H, W) of the padded grid, and for pixels of `sources` with parts.

    Their number per axis is psf.silhouette_samples. At outlines, each source represents the area that its surface
    covers. In the reference pose, the sources in a marked pixel share the pixel's texel; otherwise each interpolates
    the texture at its own position.
    """
    psf, samples = view.scene.psf, view.scene.psf.silhouette_samples
    parts = np.zeros(marked.shape, np.intp)
    if sources is not None and sources.parts is not None:
        parts = np.where(marked, 0, sources.parts)
    row, column = np.nonzero(marked | (parts > 0))
    offsets, place = subpixel_offsets(samples), (row - guard, column - guard)
    texel = (place[0][:, None, None], place[1][:, None, None])
    at_row, at_column = texel[0] + offsets[:, None], texel[1] + offsets
    small = small_members(view, group, *place) & marked[row, column]
    hit = cast_behind(view, group, small, at_row, at_column, texel, samples)
    lens_radius, empty = hit.radius, hit.label == 0  # the radius for visibility tests
    hit, limb = _cover(view, group, hit, marked, (row, column), guard)
    middle_radius = blur_radius(view.lens, pixel_ray(view.camera, at_row, at_column), hit.w)
    lens_radius = np.where(empty & (hit.label > 0), middle_radius, lens_radius)
    if small.any():
        hit, pixel = with_small(view, group, hit, small, place)
        row, column, at_row, at_column = row[pixel], column[pixel], at_row[pixel], at_column[pixel]
        count = len(limb)
        limb = np.pad(limb, ((0, len(pixel) - count), (0, 0), (0, 0)))
        added = pixel_ray(view.camera, at_row[count:], at_column[count:])
        lens_radius = np.concatenate([lens_radius, blur_radius(view.lens, added, hit.w[count:])])
    cut = parts[row, column]
    if sources is not None and cut.any():
        hit = _with_parts(view, hit, sources, (row, column), cut, guard)
        lens_radius = np.where((cut > 0)[:, None, None], hit.radius, lens_radius)
    lit, visibility = hit.label > 0, None
    shape, widening = _ellipses(view, row - guard, column - guard)
    _, cell_widening = _ellipses(view, at_row, at_column)
    if widening is not None and cell_widening is not None:
        widening = np.where((cut > 0)[:, None, None, None], widening[:, None, None], cell_widening)
    if group.occluders or view.psf.rims:
        rays = pixel_ray(view.camera, at_row, at_column)[lit]
        pixel, i, j = np.nonzero(lit)
        # As on devices, from the gradient divided by the radius of the covered area.
        tilted = tilt_slope(hit.gradient, hit.radius, view.psf.diffracted)
        tilted = (tilted if widening is None else tilted + widening) * signed_size(lens_radius)[..., None] * psf.tilt
        points = Points(
            rays, hit.w[lit], lens_radius[lit], offsets[j], offsets[i], 1.0 / samples, tilted[lit], limb[lit],
            place=np.stack([row[pixel], column[pixel]]) - guard,
        )  # fmt: skip
        if sources is not None and cut.any() and view.psf.shares_lens:
            points = _from_middles(view, points, sources, (row, column), cut, pixel, guard)
        state, _, visibility = check_visibility(view.lens, view.surfaces, view.bounds, group, view.psf, points)
        lit[lit] = state != HIDDEN
        visibility = visibility.select(state != HIDDEN)
        if shape is not None:
            visibility = bend_visibility(visibility, shape[np.nonzero(lit)[0][visibility.row >= 0]])
    return SubpixelSources(
        row, column, lit, hit.radius, hit.gradient, hit.radiance, visibility, limb, shape, widening
    )  # fmt: skip


def _from_middles(
    view: View, points: Points, sources: Sources, pixel: tuple[Indices, Indices], cut: Indices, slot: Indices,
    guard: int,
) -> Points:  # fmt: skip
    """Points for visibility tests; in pixels cut into parts, they are replaced by the pixel's middle if `is_shared`.

    pixel: rows and columns (M,); cut: number of parts (M,) per axis; slot: for each of the `points`, the index of its
    pixel in `pixel`.
    """
    radius, gradient = sources.radius[pixel], sources.gradient[pixel]
    shared = (cut > 0) & is_shared(radius, view.psf.extent, gradient)
    assert sources.visibility is not None
    partly = sources.visibility.row.reshape(sources.lit.shape)[pixel]
    nearest = np.append(sources.visibility.nearest, np.inf)[partly]
    shared &= nearest >= SHARED_PLACE
    replaced, middle = shared[slot], slot[shared[slot]]
    rays, w, tilted = points.rays.copy(), points.w.copy(), points.gradient.copy()
    rays[replaced] = pixel_ray(view.camera, pixel[0] - guard, pixel[1] - guard)[middle]
    widening = None if sources.widening is None else sources.widening[pixel]
    w[replaced] = sources.inverse_depth[pixel][middle]
    tilted[replaced] = _tilted(view, radius, gradient, widening)[middle]
    width = np.where(replaced, 1.0, points.width)
    return replace(points, rays=rays, w=w, gradient=tilted, width=width, shared=replaced)


def _cover(
    view: View, group: OcclusionGroup, hit: Cast, marked: NDArray[np.bool_], pixel: tuple[Indices, Indices], guard: int
) -> tuple[Cast, NDArray[np.bool_]]:
    """Replace radius, gradient and radiance of ray hits (M, S, S) at outlines by those of the areas that they cover.

    Also returns a mask of hits at limbs (`is_at_limb`). marked: (H, W); pixel: rows and columns (M,). Pixels that are
    not marked keep their hits.
    """
    samples = view.scene.psf.silhouette_samples
    label = np.where(marked[pixel][:, None, None], hit.label, UNMARKED).astype(np.uint8)
    place = (pixel[0] - guard, pixel[1] - guard)
    coverage = cell_coverage(view, *place, labels_around(*pixel, label, marked.shape))
    covered, right, down = (n[:, 1:-1, 1:-1] for n in (coverage.covered, coverage.right, coverage.down))
    added = (hit.label == 0) & (coverage.part[:, 1:-1, 1:-1] > 0.0)
    hit = replace(hit, label=np.where(added, coverage.label[:, 1:-1, 1:-1], hit.label))
    beside = (hit.label > 0) & ((covered != 1.0) | (right != 0.0) | (down != 0.0))
    slot, i, j = at = np.nonzero(beside)
    texel, offsets = (place[0][slot], place[1][slot]), subpixel_offsets(samples)
    row, column, below, aside = texel[0] + offsets[i], texel[1] + offsets[j], down[at] / samples, right[at] / samples
    neighbor_hits = cast(view, group, row + below, column + aside, texel, samples)
    same = neighbor_hits.label == hit.label[at]  # may be False at a corner
    inside = tuple(n[same] for n in at)
    planes = {name: getattr(hit, name).copy() for name in ("radius", "gradient", "radiance", "w")}
    for name, plane in planes.items():
        plane[inside] = getattr(neighbor_hits, name)[same]
    planes["w"] = np.where(added, planes["w"], hit.w)
    planes["radiance"] *= np.where(beside, covered, 1.0)[..., None]
    hit.label[at] = np.where(same | ~added[at], hit.label[at], 0)
    limb = np.zeros(hit.label.shape, dtype=bool)
    rays = pixel_ray(view.camera, row + np.where(same, below, 0.0), column + np.where(same, aside, 0.0))
    for object_label in np.unique(hit.label[at]).tolist():
        mask = hit.label[at] == object_label
        limb[tuple(n[mask] for n in at)] = is_at_limb(view, object_label, rays[mask], samples)
    return replace(hit, **planes), limb


def _with_parts(
    view: View, hit: Cast, sources: Sources, pixel: tuple[Indices, Indices], cut: Indices, guard: int
) -> Cast:
    """Replace ray hits (M, S, S) in pixels cut into parts; all values except the texture are linear within the pixel.

    pixel: rows and columns (M,); cut: number of parts (M,) per axis, 0 to keep `hit`.
    """
    camera, samples = view.camera, view.scene.psf.silhouette_samples
    below, right = np.meshgrid(*2 * (subpixel_offsets(samples),), indexing="ij")
    hit = Cast(*(values.copy() for values in vars(hit).values()))
    objects = ((sources.label[pixel] & 127).astype(np.intp) - 1) // 2
    for number, parts in {*zip(objects[cut > 0].tolist(), cut[cut > 0].tolist(), strict=True)}:
        selected = (objects == number) & (cut == parts)
        row, column = (n[selected] for n in pixel)
        surface, texture = view.surfaces[number], view.textures[number]
        rays = pixel_ray(camera, row - guard, column - guard)
        assert isinstance(texture, MappedTexture)
        planes = sources.inverse_depth, sources.radius, sources.gradient
        w, radius, gradient = (plane[row, column] for plane in planes)
        slope = surface_slope(surface, rays, w)
        values = detailed_texture(texture, surface, camera, rays, w, radius, samples, parts)
        if view.light is not None:
            values = values * shade(view.light, surface, number, rays, w)[:, None, None, None]
        index = np.arange(samples) * parts // samples
        hit.radiance[selected] = values[:, index][:, :, index]
        hit.label[selected] = sources.label[row, column][:, None, None]
        along, aside, upwards = ray_changes(camera, rays[:, 0], rays[:, 1])
        x, y = slope[:, 0] * along + slope[:, 1] * aside, slope[:, 0] * aside + slope[:, 1] * upwards
        hit.w[selected] = w[:, None, None] + right * x[:, None, None] - below * y[:, None, None]
        x, y = (gradient[:, k, None, None] for k in range(2))
        hit.radius[selected] = radius[:, None, None] + right * x + below * y
        # A source's own pixel gets light from all of the lens until the source's disc extends beyond that pixel.
        reached = np.minimum(np.abs(hit.radius[selected]), 1.0)
        hit.gradient[selected] = gradient[:, None, None] * reached[..., None]
    return hit
