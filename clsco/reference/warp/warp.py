"""Forward warp (4.3.3): moves the pixels of the reference pose and projects each to the nearest pixel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clsco.constants import NO_WINNER, WIDEST_GAP
from clsco.optics.lens_path import reference_camera
from clsco.optics.motion import Pose, rest_center
from clsco.optics.quadrics import PlacedSurface, cutting_bounds
from clsco.reference.common.geometry import Array, mirror_index, pixel_ray, project, solve_quadric
from clsco.reference.trace.trace import padded_grid
from clsco.scene.model import Camera, Scene

NO_OBJECT = np.uint8(255)
SAME_DEPTH = np.float32(1.02)  # ratio of depths below which neighbors in the reference pose are one surface
EDGE_PX = 1  # px; a surface this close to the frame's edge in the reference pose is assumed to continue outside
SNAP = 4096  # snapping steps per px; snapping keeps rounding errors from moving a position across a pixel's edge

Surfaces = Sequence[PlacedSurface | None]
Maps = Sequence[Array | None]


@dataclass(frozen=True, eq=False)
class Reprojected:
    """Pixels of the padded grid (H, W) after a move.

    known (H, W): True if a source was moved to the pixel; radiance (H, W, C); inverse_depth (H, W): 1/mm; object (H,
    W): number of the visible object. In unknown pixels, object is 255 and all others are 0. entered (H, W): for scenes
    with a depth map, from `mark_entered`; else False.
    """

    known: NDArray[np.bool_]
    radiance: Array
    inverse_depth: Array
    object: NDArray[np.uint8]
    entered: NDArray[np.bool_]


def nearest_pixel(position: Array) -> NDArray[np.int64]:
    """Pixel of a position in px: snapped to 1/4096 px, then rounded half up in integers.

    Plain rounding would let errors in the last digit decide at half-pixel shifts, and lose pixels.
    """
    snapped = np.floor(np.clip(position, -1e9, 1e9) * SNAP + 0.5).astype(np.int64)
    return (snapped + SNAP // 2) >> 12


def reproject_rest(scene: Scene, surfaces: Surfaces, maps: Maps) -> tuple[Array, NDArray[np.uint8]]:
    """Inverse depth (rows, columns) in 1/mm and object number of the frame's pixels, which are the sources of the warp.

    surfaces: of every object at t = 0, None for a depth map; maps: inverse depths (rows, columns) in 1/mm of depth
    maps, None for other objects. The nearest object is used, of equally near ones the first. Both results are 0 without
    a surface.
    """
    rays, depths = pixel_ray(reference_camera(scene), *padded_grid(scene.camera, 0)), []
    for item, surface, depth in zip(scene.objects, surfaces, maps, strict=True):
        w = depth if surface is None else solve_quadric(surface, cutting_bounds(item), rays)[0]
        assert w is not None  # every object is a surface or a depth map
        depths.append(w)
    return np.max(depths, axis=0), np.argmax(depths, axis=0).astype(np.uint8)


def reproject_targets(
    scene: Scene, poses: Sequence[Pose], w: Array, whose: NDArray[np.uint8], guard: int, camera: Camera | None = None
) -> tuple[NDArray[np.int64], Array]:
    """Target (sources,) on the padded grid, and inverse depth (sources,) in 1/mm, after objects have moved to `poses`.

    w, whose: from `reproject_rest`; camera: by default the scene's. Targets are pixel numbers, row by row. A source
    without a surface, or that is moved behind the lens or outside of the grid, has the target -1 and the inverse depth
    0.
    """
    rays = pixel_ray(reference_camera(scene), *padded_grid(scene.camera, 0))
    point = rays / np.where(w > 0.0, w, 1.0)[..., None]
    moved = np.empty_like(point)
    for k, (item, pose) in enumerate(zip(scene.objects, poses, strict=True)):
        on_object, center = whose == k, rest_center(item)
        moved[on_object] = center + pose.shift + (point[on_object] - center) @ pose.rotation.T
    usable = (w > 0.0) & (moved[..., 2] > 0.0)
    row, column = project(camera or reference_camera(scene), np.where(usable[..., None], moved, 1.0))
    target_row, target_column = nearest_pixel(row) + guard, nearest_pixel(column) + guard
    height, width = (n + 2 * guard for n in w.shape)
    usable &= (target_row >= 0) & (target_row < height) & (target_column >= 0) & (target_column < width)
    target = np.where(usable, target_row * width + target_column, -1).ravel()
    return target, np.where(usable, 1.0 / np.where(usable, moved[..., 2], 1.0), 0.0).ravel()


def reproject_depth(target: NDArray[np.int64], key: NDArray[np.float32], pixels: int) -> NDArray[np.float32]:
    """Largest inverse depth (pixels,) in 1/mm of the sources moved to each target, 0 for a target without sources.

    target: (sources,) pixel number, -1 for none; key: (sources,) inverse depth > 0, rounded to float32, because every
    device compares inverse depths in float32.
    """
    depth, used = np.zeros(pixels, dtype=np.float32), target >= 0
    np.maximum.at(depth, target[used], key[used])
    return depth


def reproject_winner(
    target: NDArray[np.int64], key: NDArray[np.float32], depth: NDArray[np.float32]
) -> NDArray[np.int64]:
    """For each target, the lowest number (pixels,) of its sources with the largest inverse depth, or NO_WINNER.

    depth: from `reproject_depth`.
    """
    winner = np.full(depth.shape, NO_WINNER, np.int64)
    source = np.flatnonzero(target >= 0)
    source = source[key[source] == depth[target[source]]]
    np.minimum.at(winner, target[source], source)
    return winner


def reproject_gaps(winner: NDArray[np.int64], depth: NDArray[np.float32], columns: int) -> NDArray[np.bool_]:
    """Mask (H, W) of pixels with a winner, except those visible only through a gap of a surface that has grown.

    depth: (H, W), inverse depth of each winner, 1/mm; columns: number of columns of the frame.
    """
    (height, width), bound = winner.shape, SAME_DEPTH * depth

    def nearer(down: int, right: int) -> NDArray[np.int64]:
        """Number of the first nearer pixel in the direction (down, right), -1 for none."""
        numbers = np.full(winner.shape, -1)
        for step in range(WIDEST_GAP, 0, -1):  # the last assignment wins, which is the nearest step
            i, j = (np.arange(n) + step * direction for n, direction in ((height, down), (width, right)))
            inside = ((i >= 0) & (i < height))[:, None] & ((j >= 0) & (j < width))
            at = np.ix_(np.clip(i, 0, height - 1), np.clip(j, 0, width - 1))
            numbers = np.where(inside & (depth[at] > bound), at[0] * width + at[1], numbers)
        return numbers

    hidden = np.zeros(winner.shape, dtype=bool)
    for down, right in ((0, 1), (1, 0), (1, 1), (-1, 1)):
        before, after = nearer(-down, -right), nearer(down, right)
        (a, b), (first, second) = ((plane.ravel()[before], plane.ravel()[after]) for plane in (winner, depth))
        close = np.maximum(first, second) <= SAME_DEPTH * np.minimum(first, second)
        neighbors = (abs(a // columns - b // columns) <= 1) & (abs(a % columns - b % columns) <= 1)
        hidden |= (before >= 0) & (after >= 0) & close & neighbors
    return np.asarray((winner != NO_WINNER) & ~hidden)


def reproject_gather(winner: NDArray[np.int64], values: Array) -> tuple[NDArray[np.bool_], Array]:
    """Mask of targets (pixels,) with a winner, and the winner's `values` (sources, channels), 0 without a winner."""
    known = winner != NO_WINNER
    return known, np.where(known[:, None], values[np.where(known, winner, 0)], 0.0)


def reproject(
    scene: Scene, textures: Sequence[Array], surfaces: Surfaces, maps: Maps, poses: Sequence[Pose], guard: int,
    camera: Camera | None = None,
) -> Reprojected:  # fmt: skip
    """Forward warp: move the pixels of the reference pose to `poses` on the padded grid.

    textures: (rows, columns, C) of the frame's size, one per object. Sources are the pixels of the frame itself, with
    its pinhole image. Of several sources at a target, the nearest is used, of equally near ones the first, row by row.
    With several objects, or a depth map, pixels visible only through gaps of a surface that has grown are unknown.
    """
    rows, columns, channels = textures[0].shape
    height, width = rows + 2 * guard, columns + 2 * guard
    rest, whose = reproject_rest(scene, surfaces, maps)
    target, moved_w = reproject_targets(scene, poses, rest, whose, guard, camera)
    key = moved_w.astype(np.float32)
    depth = reproject_depth(target, key, height * width)
    winner = reproject_winner(target, key, depth)
    if len(surfaces) > 1 or surfaces[0] is None:
        valid = reproject_gaps(winner.reshape(height, width), depth.reshape(height, width), columns)
        winner = np.where(valid.ravel(), winner, NO_WINNER)
    row, column = np.indices(whose.shape)
    radiance = np.stack(textures)[whose, row, column]
    values = [radiance.reshape(rows * columns, channels), moved_w[:, None], whose.reshape(-1, 1)]
    known, gathered = reproject_gather(winner, np.concatenate(values, axis=1))
    gathered, known = gathered.reshape(height, width, -1), known.reshape(height, width)
    objects = np.where(known, gathered[..., -1].astype(np.uint8), NO_OBJECT)
    entered = np.zeros(known.shape, dtype=bool)
    if any(surface is None for surface in surfaces):
        entered = mark_entered(winner.reshape(height, width), known, guard)
    return Reprojected(known, gathered[..., :-2], gathered[..., -2], objects, entered)


def mark_entered(winner: NDArray[np.int64], known: NDArray[np.bool_], guard: int) -> NDArray[np.bool_]:
    """Mask (H, W) of the frame's pixels that show surfaces from outside of the frame in the reference pose.

    In each row, these are the pixels beyond the outermost known pixel of the frame, if the source of that pixel was
    within EDGE_PX of the frame's edge on that side. Then columns are treated in the same way; for columns, pixels
    marked in rows count as known, with the source of the outermost known pixel of their row.
    """
    rows, columns = (n - 2 * guard for n in known.shape)
    inside = (slice(guard, guard + rows), slice(guard, guard + columns))
    source, known_inside = winner[inside], known[inside]
    by_row, outermost = _beyond_edge(known_inside, source % columns)
    source = np.where(known_inside, source, np.take_along_axis(source, outermost, axis=1))
    by_column, _ = _beyond_edge((known_inside | by_row).T, (source // columns).T)
    entered = np.zeros(known.shape, dtype=bool)
    entered[inside] = by_row | by_column.T
    return entered


def _beyond_edge(lines: NDArray[np.bool_], place: NDArray[np.int64]) -> tuple[NDArray[np.bool_], NDArray[np.int64]]:
    """Mask of pixels beyond the first or last known pixel of each line (L, N), if that pixel's source was at that end.

    lines: (L, N), known; place: (L, N), px, source position of each pixel along its line. Also returns, for each pixel,
    the position in its line of the nearer of these two known pixels (L, N).
    """
    length = lines.shape[1]
    at, occupied = np.arange(length), lines.any(axis=1)
    first, last = lines.argmax(axis=1), length - 1 - lines[:, ::-1].argmax(axis=1)
    low, high = (np.take_along_axis(place, end[:, None], axis=1)[:, 0] for end in (first, last))
    before = (occupied & (low <= EDGE_PX))[:, None] & (at < first[:, None])
    after = (occupied & (length - 1 - high <= EDGE_PX))[:, None] & (at > last[:, None])
    return before | after, np.where(at > last[:, None], last[:, None], first[:, None])


def fill_entered(
    values: Array, objects: NDArray[np.uint8], valid: NDArray[np.bool_], entered: NDArray[np.bool_], guard: int
) -> tuple[Array, NDArray[np.uint8], NDArray[np.bool_]]:
    """Fill pixels that have entered the frame from the mirrored image; returns values, objects and validity.

    values: (H, W, K); objects, valid: (H, W); entered: (H, W), from `mark_entered`. Each pixel is copied from its
    mirror image about the outermost valid pixel of its row in the frame, or else of its column. If there is none, it
    stays unchanged.
    """
    values, objects, valid = values.copy(), objects.copy(), valid.copy()
    rows, columns = (n - 2 * guard for n in valid.shape)
    inside = (slice(guard, guard + rows), slice(guard, guard + columns))
    value, object_, known, open_ = values[inside], objects[inside], valid[inside], entered[inside]
    for by_column in (False, True):
        if by_column:
            value, object_, known, open_ = value.swapaxes(0, 1), object_.T, known.T, open_.T
        first = known.argmax(axis=1)
        last = known.shape[1] - 1 - known[:, ::-1].argmax(axis=1)
        for line in np.flatnonzero(known.any(axis=1) & (open_ & ~known).any(axis=1)):
            at = np.flatnonzero(open_[line] & ~known[line])
            source = first[line] + mirror_index(at - first[line], int(last[line] - first[line] + 1))
            at, source = at[known[line, source]], source[known[line, source]]
            value[line, at], object_[line, at] = value[line, source], object_[line, source]
            known[line, at] = True
    return values, objects, valid


def extend_border(values: Array, valid: NDArray[np.bool_], guard: int) -> tuple[Array, NDArray[np.bool_]]:
    """Mirror the frame into the guard band of the padded grid: values (H, W, K) and validity (H, W).

    A depth map has no data in the guard band. There, its image is continued by its mirror image, as textures are. Only
    invalid pixels change.
    """
    row, column = (mirror_index(np.arange(-guard, n - guard), n - 2 * guard) + guard for n in valid.shape)
    take = ~valid & valid[np.ix_(row, column)]
    return np.where(take[..., None], values[np.ix_(row, column)], values), valid | take
