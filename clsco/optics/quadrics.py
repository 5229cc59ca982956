"""Shapes as canonical quadrics, placed in front of the camera by a pose (float64, pure).

Every shape is the zero set of sum q_i X_i^2 + 2 sum l_i X_i - k in its canonical frame, along its principal axes. One
ray-surface solution serves all shapes, in a form without cancellation (Lagrange's identity, see `solve_quadric` in
kernels/common/geometry.clh).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf, pi

import numpy as np

from clsco.optics.bounds import Array, Bounds, cutting
from clsco.optics.lens import Lens
from clsco.optics.motion import Pose, rest_center, static_rotation
from clsco.scene.model import Background, Cone, Cylinder, Disc, Ellipsoid, Object, Plane, Quadric, Rectangle, Sphere

# Eigenvalues of a quadric below this fraction of the largest count as zero: they are rounding, not curvature.
NULL_CURVATURE = 1e-13
# The square is completed along an axis only if this moves the origin by at most this multiple of the center's distance.
FARTHEST_CENTER = 4.0


@dataclass(frozen=True)
class Canonical:
    """A shape in its canonical frame X = axes (X_object - origin): sum q_i X_i^2 + 2 sum l_i X_i = k.

    axes: rows are the canonical axes in the object's frame. origin: mm. nappe: sign that the third canonical coordinate
    must have, 0 for either. radius: in mm, of the disc about the third axis to which a plane is cut, or infinite.
    """

    q: Array
    l: Array  # noqa: E741 - the name of the linear part in physics
    k: float
    axes: Array
    origin: Array
    nappe: int = 0
    radius: float = inf


@dataclass(frozen=True)
class Extent:
    """Bounds of an object's visible part: low and high slopes (x, y) of rays, and inverse depths w in 1/mm."""

    x: tuple[float, float]
    y: tuple[float, float]
    w: tuple[float, float]


EVERYWHERE = Extent((-inf, inf), (-inf, inf), (0.0, inf))


@dataclass(frozen=True)
class PlacedSurface:
    """A surface at one time in the camera's frame; the point at depth Z on ray d has the canonical coordinates X =
    offset + Z turn d.

    offset: position of the lens in the canonical frame, mm. body_turn, body_offset: transformation from the camera's
    frame to a frame at the object's center with the axes of the reference pose; it moves points back to this pose.
    own_turn, own_offset: transformation to the object's own frame, for bounds; it also undoes the static rotation.
    rest: the object's center in the reference pose, mm. constant: the quadric's value at the lens center. ball: center
    x, y, z and radius of a ball around the part of the surface in front of the camera, mm; infinite radius without one.
    width: approximate width of the image across its longest direction, as a difference of slopes; infinite for
    unbounded surfaces, negative for cylinders and cones, whose width varies (`outline_lines`).
    """

    canonical: Canonical
    turn: Array
    offset: Array
    body_turn: Array
    body_offset: Array
    own_turn: Array
    own_offset: Array
    rest: Array
    constant: float
    ball: Array
    extent: Extent = EVERYWHERE
    width: float = inf


def _axes_along(axis: Array) -> Array:
    """Right-handed orthonormal axes as rows, the third along `axis`."""
    third = axis / np.linalg.norm(axis)
    helper = np.eye(3)[int(np.argmin(np.abs(third)))]
    first = np.cross(helper, third)
    first /= np.linalg.norm(first)
    return np.array([first, np.cross(third, first), third])


def _canonical_quadric(coefficients: tuple[float, ...], farthest: float) -> Canonical:
    """Canonical form of the quadric with the coefficients of (3.39), in its principal axes.

    The origin is shifted to make l_i 0, except along axes where the shift would exceed `farthest` mm. The origin of a
    plane is shifted onto the plane, so that k = 0, as visibility tests expect.
    """
    xx, yy, zz, xy, yz, zx, x, y, z, constant = coefficients
    matrix = np.array([[xx, xy / 2, zx / 2], [xy / 2, yy, yz / 2], [zx / 2, yz / 2, zz]])
    linear = np.array([x, y, z]) / 2
    q, vectors = np.linalg.eigh(matrix)
    axes = vectors.T
    largest = np.max(np.abs(q))
    q = np.where(np.abs(q) <= NULL_CURVATURE * largest, 0.0, q)
    half_linear = axes @ linear
    # A weak curvature would put its center so far away that the offset swallows the digits of the surface.
    curved = (q != 0) & (np.abs(half_linear) <= farthest * np.abs(q))
    shift = np.where(curved, -half_linear / np.where(curved, q, 1.0), 0.0)
    linear_rest = np.where(curved, 0.0, half_linear)
    k = -(constant + float(half_linear @ shift))
    if not q.any():
        shift, k = half_linear * (k / (2.0 * float(half_linear @ half_linear))), 0.0
    return Canonical(q, linear_rest, k, axes, axes.T @ shift)


def canonical(item: Object) -> Canonical:
    """Canonical form of an analytic shape (3.7, 3.11, 3.18, 3.23, 3.33, 3.39); lengths in mm.

    Coefficients of free scale are scaled to the shape, so that sizes from 1e-6 to 1e9 mm stay in the range of float32.
    """
    still, zero, flat = np.eye(3), np.zeros(3), np.array([0.0, 0.0, 0.5])
    if isinstance(item, Plane):
        return Canonical(zero, np.array([-item.slope_x, -item.slope_y, 1.0]) / 2, 0.0, still, zero)
    if isinstance(item, Background):
        return Canonical(zero, flat, 0.0, still, zero)
    if isinstance(item, Rectangle | Disc):
        radius = item.radius if isinstance(item, Disc) else inf
        return Canonical(zero, flat, 0.0, still, np.array([0.0, 0.0, item.offset]), radius=radius)
    if isinstance(item, Sphere):
        return Canonical(np.ones(3), zero, item.radius**2, still, zero)
    if isinstance(item, Cylinder):
        axes = _axes_along(np.asarray(item.axis, dtype=np.float64))
        return Canonical(np.array([1.0, 1.0, 0.0]), zero, item.radius**2, axes, zero)
    if isinstance(item, Cone):
        spread = np.tan(np.radians(item.half_angle)) ** 2
        sign = 1 if item.nappe == "away" else -1
        return Canonical(np.array([1.0, 1.0, -spread]), zero, 0.0, still, zero, sign)
    if isinstance(item, Ellipsoid):
        axes_mm = np.asarray(item.semi_axes, dtype=np.float64)
        largest = float(axes_mm.max())
        return Canonical((largest / axes_mm) ** 2, zero, largest**2, still, zero)
    assert isinstance(item, Quadric)
    distance = float(np.linalg.norm(item.center))
    # Multiples are the same surface; this power of 2 keeps products of coefficients within float32, and all digits.
    second, first = np.abs(item.coefficients[:6]).max(), np.abs(item.coefficients[6:9]).max()
    factor = 2.0 ** -int(np.frexp(max(second, first / max(distance, 1.0)))[1])
    return _canonical_quadric(tuple(factor * c for c in item.coefficients), FARTHEST_CENTER * distance)


def cutting_bounds(item: Object) -> Bounds | None:
    """Bounds in mm that really cut an object, in its own frame; rays and visibility tests use only these.

    A bound that the surface at most touches is infinite; None if no bound cuts it, and for a depth map.
    """
    if item.bounds is None:
        return None
    shape = canonical(item)
    square, linear = shape.axes.T @ np.diag(shape.q) @ shape.axes, shape.axes.T @ shape.l
    half = linear - square @ shape.origin
    constant = -float(shape.origin @ (half + linear)) - shape.k
    matrix = np.block([[square, half[:, None]], [half, constant]])
    return cutting(tuple(map(tuple, matrix.tolist())), shape.nappe, item.bounds)


def place(item: Object, pose: Pose) -> PlacedSurface:
    """Surface of an analytic object in a pose, in the frame of the lens."""
    shape, rest = canonical(item), rest_center(item)
    body_turn = pose.rotation.T
    body_offset = body_turn @ (-rest - pose.shift)
    own_turn, own_offset = body_turn, body_offset
    if item.rotation is not None:
        back = static_rotation(item).T
        own_turn, own_offset = back @ body_turn, back @ body_offset
    turn = shape.axes @ own_turn
    offset = shape.axes @ (own_offset - shape.origin)
    if isinstance(item, Sphere):
        # (c - rho)(c + rho) keeps the digits that c^2 - rho^2 loses beyond c/rho = 1e4
        distance = float(np.linalg.norm(offset))
        constant = (distance - item.radius) * (distance + item.radius)
    else:
        constant = float(shape.q @ offset**2 + 2.0 * (shape.l @ offset) - shape.k)
    transforms, ball = (turn, offset, body_turn, body_offset, own_turn, own_offset), _ball(item, pose)
    placed = PlacedSurface(shape, *transforms, rest, constant, ball, _ball_extent(*ball.tolist()))
    return replace(placed, width=_width(item, placed))


def outline_form(surface: PlacedSurface) -> Array:
    """Symmetric matrix M (3, 3) such that r M r is the discriminant of a curved surface along ray r.

    A ray misses if r M r < 0. The surface's outline in the image is the conic r M r = 0.
    """
    gradient = (surface.canonical.q * surface.offset + surface.canonical.l) @ surface.turn
    square = surface.turn.T @ (surface.canonical.q[:, None] * surface.turn)
    return np.asarray(np.outer(gradient, gradient) - surface.constant * square)


def outline_lines(surface: PlacedSurface, x: Array, y: Array) -> tuple[Array, Array]:
    """For the two lines that outline a cylinder or a cone: distances of rays from their midline, and half of their
    distance.

    Both results are approximate, differences of slopes, and infinite if the image is wide. x, y: slopes of the rays, of
    one shape.
    """
    form = outline_form(surface)
    bend = -float(form[0, 0] + form[1, 1])
    if not bend > 0.0:
        return np.full_like(x, inf), np.full_like(x, inf)
    along, up, value = (row[0] * x + row[1] * y + row[2] for row in form)
    off = np.hypot(along, up) / bend
    return off, np.sqrt(np.maximum((along * x + up * y + value) / bend + off**2, 0.0))


def _width(item: Object, surface: PlacedSurface) -> float:
    """Value of `PlacedSurface.width`. For a flat shape, it is the area of the image divided by the length of the ball's
    image; an area A at depth Z, in a plane at `distance` mm from the lens, has an image of area A distance / Z^3.
    """
    depth, radius = surface.ball[2:].tolist()
    ball_width = 2.0 * radius / depth if depth > radius else inf
    shape = surface.canonical
    if shape.q.any():
        if not shape.l.any() and (shape.k == 0.0 or not shape.q.all()):
            return -1.0
        form = outline_form(surface)
        bends = np.linalg.eigvalsh(-form[:2, :2])
        if not bends[0] > 0.0:
            return ball_width
        most = form[2, 2] - form[2, :2] @ np.linalg.solve(form[:2, :2], form[:2, 2])
        return min(ball_width, 2.0 * float(np.sqrt(most / bends[1]))) if most > 0.0 else ball_width
    if isinstance(item, Rectangle | Disc):
        area = pi * item.radius**2 if isinstance(item, Disc) else item.size[0] * item.size[1]
        return area * abs(surface.constant) / (2.0 * radius * depth**2) if depth > radius else inf
    return ball_width


def _ball(item: Object, pose: Pose) -> Array:
    """Value of `PlacedSurface.ball`."""
    balls: list[tuple[Array, float]] = []
    if isinstance(item, Sphere):
        balls.append((np.zeros(3), item.radius))
    if isinstance(item, Disc):
        balls.append((static_rotation(item) @ (0.0, 0.0, item.offset), item.radius))
    if isinstance(item, Ellipsoid):
        balls.append((np.zeros(3), max(item.semi_axes)))
    if item.bounds is not None:
        box = np.array(item.bounds)
        balls.append((static_rotation(item) @ box.mean(axis=1), 0.5 * float(np.linalg.norm(box[:, 1] - box[:, 0]))))
    if not balls:
        return np.array([0.0, 0.0, 0.0, inf])
    middle, radius = min(balls, key=lambda ball: ball[1])
    return np.array([*(rest_center(item) + pose.shift + pose.rotation @ middle), radius * (1.0 + 1e-9)])


def _ball_extent(x: float, y: float, z: float, radius: float) -> Extent:
    """Extent of a ball; unbounded if the lens is inside it."""
    if z - radius <= 1e-3 * radius:
        return EVERYWHERE

    def interval(center: float) -> tuple[float, float]:
        ends = [(center + s * radius) / (z + t * radius) for s in (-1, 1) for t in (-1, 1)]
        return min(ends), max(ends)

    return Extent(interval(x), interval(y), (1.0 / (z + radius), 1.0 / (z - radius)))


def axial_blur_radius(lens: Lens, surface: PlacedSurface) -> float:
    """Signed blur radius in px of the point where a lens's axis meets a plane."""
    inverse_depth = -2.0 * float(surface.canonical.l @ surface.turn[:, 2]) / surface.constant
    return float(lens.blur_radius(inverse_depth))


def predict_inverse_depth(item: Object, surface: PlacedSurface, x: Array, y: Array) -> Array:
    """Inverse depth in 1/mm along rays (x, y, 1), 0 if a ray misses, by the textbook formula in float64.

    Used for predictions and ground truth; renderings use `solve_quadric`.
    """
    rays, shape, bounds = np.stack([x, y, np.ones_like(x)]), surface.canonical, cutting_bounds(item)
    d = np.tensordot(surface.turn, rays, axes=1)
    own_rays = d if bounds is None else np.tensordot(surface.own_turn, rays, axes=1)
    o, q, half_linear = (v.reshape(3, *([1] * x.ndim)) for v in (surface.offset, shape.q, shape.l))
    a = (q * d * d).sum(axis=0)
    b = ((q * o + half_linear) * d).sum(axis=0)
    c = surface.constant
    discriminant = b * b - a * c
    root, hit = np.sqrt(np.maximum(discriminant, 0.0)), discriminant >= 0
    best = np.zeros_like(a)
    # If nothing cuts the surface, one sign gives the nearer point.
    is_whole = bounds is None and not shape.nappe and shape.radius == inf
    for sign in (np.copysign(1.0, c),) if is_whole else (1.0, -1.0):
        with np.errstate(all="ignore"):  # NaN is not kept
            w = (-b + sign * root) / c if c != 0 else -a / (2 * b)
            keep = hit & (w > best) & (w < inf)
            if shape.nappe:
                keep &= shape.nappe * (surface.offset[2] * w + d[2]) >= 0
            if shape.radius < inf:
                across = (surface.offset[axis] * w + d[axis] for axis in (0, 1))
                keep &= np.hypot(*across) <= shape.radius * w
            if bounds is not None:
                for axis in (axis for axis, ends in enumerate(bounds) if ends != (-inf, inf)):
                    along, (low, high) = surface.own_offset[axis] * w + own_rays[axis], bounds[axis]
                    keep &= (along >= low * w) & (along <= high * w)
        best[keep] = w[keep]
    return best
