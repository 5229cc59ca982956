"""Splits a frame's sources into still ones, which all time samples share, and other ones (float64, pure).

Still sources are blurred once, with the weight of the whole exposure: the same terms are added in another order.
kernels/trace/still.clh explains how the device selects them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import ceil, floor, inf, isfinite, isinf

import numpy as np
from numpy.typing import NDArray

from clsco.constants import MOVING_MARGIN, PLACE_NUMBERS
from clsco.optics.lens import Lens, ray_step
from clsco.optics.quadrics import PlacedSurface, cutting_bounds
from clsco.optics.visibility import OcclusionGroup
from clsco.scene.model import Camera, Object

Array = NDArray[np.float64]
Window = tuple[int, int, int, int]
"""Left, top, right and bottom in px of a part of a grid with its guard band; right and bottom are excluded."""

SAME_SHAPE = 1e-12  # relative difference that is rounding, between poses that turn a shape about its axis
WINDOW_MARGIN = 2 * MOVING_MARGIN + 1  # px around moving objects: sources there, and the pixels that determine outlines


@dataclass(frozen=True, eq=False)
class StillSplit:
    """Changes of objects during the exposure of a frame.

    Attributes
    ----------
    moving, changing : int
        Bit k of `moving`: the shape of object k moves. Bit k of `changing`: its shape or its texture moves. A cylinder
        that rotates about its axis is changing but not moving: it hides the same points as before.
    places : ndarray of float64, (samples, objects, PLACE_NUMBERS)
        Numbers for each object at each time sample. Its extent (`PlacedSurface.extent`): low and high x, low and high y
        of rays, low and high inverse depth in 1/mm. The ball around it: x and y of the ray to its center, inverse depth
        of the center, and this times the radius, infinite without a ball.
    """

    moving: int
    changing: int
    places: Array

    def has_still(self, group: OcclusionGroup) -> bool:
        """True if sources of a group may be still: a member does not change, and its moving objects are bounded."""
        moving = numbers(self.moving & (group.members | group.occluders))
        return bool(group.members & ~self.changing) and bool(np.isfinite(self.places[:, moving, 9]).all())

    def window(
        self, group: OcclusionGroup, camera: Camera, reach: float, guard: int, first: int, height: int
    ) -> Window | None:  # fmt: skip
        """Part of a grid that contains all sources of an occlusion group that are not still; None if all are still.

        Parameters
        ----------
        group : OcclusionGroup
        camera : Camera
            Camera with a resolution.
        reach : float
            Extent of the lens in lens radii.
        guard : int
            Columns of the guard band on each side, px.
        first, height : int
            First row of the grid in the frame, negative in the guard band, and number of rows.
        """
        step, (columns, rows), radius = ray_step(camera), camera.frame_size, Lens.of(camera).radius * reach
        still, extents = numbers(group.members & ~self.changing), list[Array]()
        for k in numbers(group.members & self.changing):
            extents.append(self.places[:, k, :4])
        for k in numbers(group.occluders & self.moving) if still else ():
            ahead = self.places[:, k, 5] - self.places[:, still, 4].min()
            extents.append(self.places[:, k, :4] + radius * np.maximum(ahead, 0.0)[:, None] * [-1.0, 1.0, -1.0, 1.0])
        if not extents:
            return None
        ends = np.concatenate(extents) / step
        x, y = 0.5 * (columns - 1) + guard, 0.5 * (rows - 1) - first
        left, right = _cells(x + ends[:, 0].min(), x + ends[:, 1].max(), columns + 2 * guard)
        top, bottom = _cells(y - ends[:, 3].max(), y - ends[:, 2].min(), height)
        return (left, top, right, bottom) if left < right and top < bottom else None


def numbers(bits: int) -> list[int]:
    """Numbers of the objects whose bits are set."""
    return [k for k in range(bits.bit_length()) if bits >> k & 1]


def _cells(low: float, high: float, size: int) -> tuple[int, int]:
    """First and end of the pixels, out of `size`, within WINDOW_MARGIN of the interval from `low` to `high` px."""
    first = floor(low) - WINDOW_MARGIN if isfinite(low) else 0
    last = ceil(high) + WINDOW_MARGIN + 1 if isfinite(high) else size
    return min(max(first, 0), size), max(min(last, size), 0)


def split_still(items: Sequence[Object], times: Sequence[Sequence[PlacedSurface]]) -> StillSplit:
    """Determine the changes of analytic objects during an exposure; times: surfaces of all `items` at each time sample.

    Examples
    --------
    >>> import numpy as np
    >>> from clsco import Cylinder
    >>> from clsco.optics.motion import Pose
    >>> from clsco.optics.quadrics import place
    >>> from clsco.optics.still import split_still
    >>> tube, turn = Cylinder(center=(0, 0, 280), radius=30), np.diag([-1.0, 1.0, -1.0])
    >>> split = split_still((tube,), [(place(tube, Pose(r, np.zeros(3))),) for r in (np.eye(3), turn)])
    >>> split.moving, split.changing
    (0, 1)
    """
    moving = changing = 0
    for k, item in enumerate(items):
        first, *later = (surfaces[k] for surfaces in times)
        changed = [surface for surface in later if not _same_place(first, surface)]
        changing |= bool(changed) << k
        moving |= (not all(_same_shape(item, first, surface) for surface in changed)) << k
    places = np.array([_place(surface) for surfaces in times for surface in surfaces])
    return StillSplit(moving, changing, places.reshape(len(times), len(items), PLACE_NUMBERS))


def _place(surface: PlacedSurface) -> list[float]:
    """One entry of `StillSplit.places`."""
    extent, (x, y, z, radius) = surface.extent, surface.ball.tolist()
    w, size = (0.0, inf) if isinf(extent.w[1]) else (1.0 / z, radius / z)  # infinite: no ball, or the lens is in it
    return [*extent.x, *extent.y, *extent.w, x * w, y * w, w, size]


def _same_place(first: PlacedSurface, second: PlacedSurface) -> bool:
    """True if an object is in exactly the same pose."""
    names = ("turn", "offset", "body_turn", "body_offset", "own_turn", "own_offset")
    return all(np.array_equal(getattr(first, name), getattr(second, name)) for name in names)


def _same_shape(item: Object, first: PlacedSurface, second: PlacedSurface) -> bool:
    """True if an object in another pose hides the same points, up to rounding."""
    pairs = zip(_hiding(item, first), _hiding(item, second), strict=True)
    return all(bool((np.abs(a - b) <= SAME_SHAPE * scale).all()) for (a, scale), (b, _) in pairs)


def _hiding(item: Object, surface: PlacedSurface) -> Iterator[tuple[Array, float]]:
    """Numbers that determine which points an object hides, in the camera's frame, each with the magnitude of its terms:
    the quadratic, linear and constant part of its equation, the axis of its nappe, the center of a disc, and bounds.
    """
    shape, turn, offset = surface.canonical, surface.turn, surface.offset
    size, far, straight = float(np.abs(shape.q).max()), float(np.linalg.norm(offset)), float(np.linalg.norm(shape.l))
    yield turn.T @ (shape.q[:, None] * turn), size
    yield turn.T @ (shape.q * offset + shape.l), size * far + straight
    yield np.asarray(surface.constant), size * far**2 + straight * far + abs(shape.k)
    if shape.nappe:
        yield turn[2], 1.0
    if isfinite(shape.radius):
        yield turn.T @ offset, far
    for axis, ends in enumerate(cutting_bounds(item) or ()):
        if any(map(isfinite, ends)):
            yield surface.own_turn[axis], 1.0
            yield surface.own_offset[axis], float(np.linalg.norm(surface.own_offset))
