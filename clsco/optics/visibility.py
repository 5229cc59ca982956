"""Occlusion groups: objects that cannot hide each other are blurred together, group by group (float64, pure).

Every object of a scene scatters its own radiance, including parts that are hidden in the pinhole image. Objects that
cannot hide each other share an `OcclusionGroup`, whose visibility tests include only objects that can occlude a member.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from math import inf

import numpy as np

from clsco.constants import LENS_CELLS
from clsco.optics.distortion import Array
from clsco.optics.lens import Lens
from clsco.optics.motion import Pose
from clsco.optics.point_spread import PointSpread
from clsco.optics.quadrics import EVERYWHERE, Extent, cutting_bounds, place
from clsco.scene.model import Camera, Object, Plane, Rectangle


@dataclass(frozen=True)
class OcclusionGroup:
    """An occlusion group: objects of which only the nearest along each ray counts, and their possible occluders.

    members, occluders: bit k stands for object k of the scene. own: number of the only member if it may hide itself,
    else -1. root: 1 or 2 if the group contains only the first or second root of that object (`solve_quadric`), 0 for
    both.
    """

    members: int
    occluders: int
    own: int = -1
    root: int = 0


NO_GROUP = OcclusionGroup(0, 0)  # where objects are not distinguished


@lru_cache(maxsize=16)
def lens_floats(psf: PointSpread) -> Array:
    """Read-only lens data for kernels, concatenated.

    First the cells (`PointSpread.lens_cells`). For a `signed` lens, mirrored cells and straight edges follow. For
    another lens, a factor for each cell follows: the position of the cell's middle times this factor is the mean
    position of the part of the cell inside the round edge. An edge at distance s behind the middle moves the mean by (s
    - 1/2) / 2. If the PSF is `cut_by_chords` and the lens has `Borders`, these are last: squeeze, light, the sizes of
    the four lists of borders, and the lists.
    """
    cells = psf.lens_cells()
    if psf.signed:
        floats = np.concatenate([cells.ravel(), cells[::-1, ::-1].ravel(), np.ravel(psf.pupil.edges)])
    else:
        at = np.arange(2 * LENS_CELLS) + 0.5 - LENS_CELLS
        away = np.hypot(at, at[:, None])
        floats = np.stack([cells, 1.0 - 0.5 * np.clip(away - (LENS_CELLS - 0.5), 0.0, 1.0) / away])
    if psf.cut_by_chords and (borders := psf.pupil.borders):
        lists = [np.ravel(array) for array in (borders.columns, borders.edges, borders.circles, borders.holes)]
        head = [borders.squeeze, psf.pupil.light, *(float(array.size) for array in lists)]
        floats = np.concatenate([floats.ravel(), head, *lists])
    floats.flags.writeable = False
    return floats


def extent(item: Object, poses: Sequence[Pose], depths: Array, slack: float = 0.0) -> Extent:
    """Bounds of an object's image and depth over all `poses`.

    depths: inverse depths of the object along rays over the frame, 1/mm, 0 where a ray misses; slack: each bound that
    is finite in all poses is moved outwards by this fraction of the range that it has over the poses; inverse depths
    stay at least 0.
    """
    hit = depths[depths > 0]
    depth_range = (0.9 * float(hit.min()), 1.1 * float(hit.max())) if hit.size else (0.0, inf)
    if isinstance(item, Plane) and hit.size < depths.size:
        depth_range = 0.0, depth_range[1]  # its horizon may be visible between rays
    extents = []
    for pose in poses:
        bounds = place(item, pose).extent
        # An unbounded object, or one around the lens, has the depths of rays that hit it; without a hit, all depths.
        extents.append(bounds if bounds.w[1] < inf else replace(bounds, w=depth_range))

    def hull(axis: str) -> tuple[float, float]:
        sides = lows, highs = tuple(zip(*(getattr(bounds, axis) for bounds in extents), strict=True))
        low, high = (slack * (max(side) - min(side)) if np.isfinite(side).all() else 0.0 for side in sides)
        return min(lows) - low, max(highs) + high

    nearest, deepest = hull("w")
    return Extent(hull("x"), hull("y"), (max(nearest, 0.0), deepest))


def may_hide(near: Extent, far: Extent, camera: Camera, reach: float) -> bool:
    """True if a point in `near` can be between a point in `far` and the lens; reach: lens extent in lens radii."""
    depth = near.w[1] - far.w[0]
    if depth <= 0.0:
        return False
    # In the image, a line to lens point l moves by a slope of (D / 2) l per unit of inverse depth.
    shift = Lens.of(camera).radius * reach * depth
    axes = ((near.x, far.x), (near.y, far.y))
    return all(a[0] - shift <= b[1] and b[0] - shift <= a[1] for a, b in axes)


def is_hollow(item: Object) -> bool:
    """True if the inside of a surface may be visible past its own edge: the surface is curved, and cut by bounds."""
    return not isinstance(item, Plane | Rectangle) and cutting_bounds(item) is not None


def separate_groups(items: Sequence[Object], camera: Camera, psf: PointSpread) -> tuple[OcclusionGroup, ...]:
    """Occlusion groups for objects that may be anywhere: one object each, with all others as occluders."""
    return occlusion_groups(items, [EVERYWHERE] * len(items), camera, psf)


def occlusion_groups(
    items: Sequence[Object], extents: Sequence[Extent], camera: Camera, psf: PointSpread
) -> tuple[OcclusionGroup, ...]:
    """Occlusion groups in which no member hides another, as few as a greedy search finds.

    extents: of `items`, in the same order. Each of the two roots of a hollow object forms a group of its own. If no
    object can be hidden, there is a single group without occluders.
    """
    hides, groups = list[int](), list[OcclusionGroup]()  # for each object: the objects that may hide it
    for k, far in enumerate(extents):
        near = (m for m, each in enumerate(extents) if m != k and may_hide(each, far, camera, psf.extent))
        hides.append(sum(1 << m for m in near))
    for k in (k for k, item in enumerate(items) if not is_hollow(item)):
        fits = (n for n, g in enumerate(groups) if not (g.members & hides[k] or g.occluders >> k & 1))
        place = next(fits, len(groups))
        group = groups[place] if place < len(groups) else NO_GROUP
        groups[place : place + 1] = [OcclusionGroup(group.members | 1 << k, group.occluders | hides[k])]
    hollow = (k for k, item in enumerate(items) if is_hollow(item))
    return (*(OcclusionGroup(1 << k, 1 << k | hides[k], k, root) for k in hollow for root in (1, 2)), *groups)
