"""Rays, the common ray-surface solution, and derived quantities, in NumPy float64.

Rays are arrays (..., 3) whose third component is 1, so that a surface point is ray / w with w (...) the inverse depth
in 1/mm; w = 0 means "no surface". Every function works on arrays of any shape.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clsco.optics.lens import Lens, ray_step
from clsco.optics.quadrics import PlacedSurface
from clsco.optics.rays import places_of, ray_slopes
from clsco.optics.visibility import OcclusionGroup
from clsco.scene.model import Camera

Array = NDArray[np.float64]
Bounds = tuple[tuple[float, float], tuple[float, float], tuple[float, float]]
Filter = Literal["nearest", "bilinear", "bicubic"]

BOUNDS_SLACK = 1e-14  # relative tolerance of bounds
NEAREST_INVERSE_DEPTH = 1e6  # 1/mm; surfaces nearer than 1e-6 mm are ignored
FARTHEST_TEXEL = 1e9  # px, to which texture positions are clamped
SMALLEST_RADIUS = 1.0  # px, which replaces smaller blur radii when an offset is divided by the radius
STEEPEST_TILT = 1e6  # 1/px, limit that keeps tilt finite at a limb, far beyond tilts at which weights are clamped


def _product_error(a: Array, b: Array, product: Array) -> Array:
    """a b - product, computed exactly as by an FMA (Dekker 1971); valid far from the limits of float64's range."""

    def halves(value: Array) -> tuple[Array, Array]:
        scaled = 134217729.0 * value  # 2^27 + 1 (Veltkamp)
        high = scaled - (scaled - value)
        return high, value - high

    (ah, al), (bh, bl) = halves(a), halves(b)
    return al * bl - (((product - ah * bh) - al * bh) - ah * bl)


def difference_of_products(a: ArrayLike, b: ArrayLike, c: ArrayLike, d: ArrayLike) -> Array:
    """a b - c d without cancellation of the products' rounding errors; the arguments broadcast.

    The error is at most 1.5 ulp (Jeannerod, Louvet, Muller 2013), apart from one more rounding of the last sum.
    """
    a, b, c, d = (np.asarray(v, dtype=np.float64) for v in (a, b, c, d))
    first, subtracted = a * b, c * d
    errors = _product_error(a, b, first) - _product_error(c, d, subtracted)
    return np.asarray((first - subtracted) + errors)


def pixel_ray(camera: Camera, row: ArrayLike, column: ArrayLike) -> Array:
    """Rays (..., 3) through pixel positions: slopes x right, y up, and 1 (3.1, 3.2).

    row, column: positions in px, which may be fractional and outside of the frame; they broadcast.
    """
    x, y = ray_slopes(camera, row, column)
    return np.stack([x, y, np.ones_like(x)], axis=-1)


def project(camera: Camera, position: Array) -> tuple[Array, Array]:
    """Row and column in px of the pinhole projection (2.4, 2.5) of points (..., 3).

    position: in the camera frame, in mm or scaled by any factor per point; the third coordinate must not be 0.
    """
    columns, rows = camera.frame_size
    right, up = places_of(camera, position[..., 0] / position[..., 2], position[..., 1] / position[..., 2])
    return (rows - 1) / 2 - up, (columns - 1) / 2 + right


def turned(matrix: Array, vector: Array) -> Array:
    """Product of a matrix (3, 3) and vectors (..., 3)."""
    return np.asarray(vector @ matrix.T)


def quarter_discriminant(surface: PlacedSurface, d: Array) -> Array:
    """B^2 - A C of the quadric along canonical rays d (..., 3), without cancellation.

    With m = o x d (Lagrange's identity): k A - sum of q_i q_j m_k^2 + (l.d)^2 + 2 sum of q_i d_i l_j m_ij.
    """
    shape = surface.canonical
    (qx, qy, qz), (lx, ly, lz), (ox, oy, oz) = shape.q, shape.l, surface.offset
    dx, dy, dz = np.moveaxis(d, -1, 0)
    mx = difference_of_products(oy, dz, oz, dy)
    my = difference_of_products(oz, dx, ox, dz)
    mz = difference_of_products(ox, dy, oy, dx)
    leading = qx * dx * dx + qy * dy * dy + qz * dz * dz
    twist = qx * qy * mz * mz + qy * qz * mx * mx + qz * qx * my * my
    linear = lx * dx + ly * dy + lz * dz
    mixed = qx * dx * (ly * mz - lz * my) + qy * dy * (lz * mx - lx * mz) + qz * dz * (lx * my - ly * mx)
    return np.asarray(shape.k * leading - twist + linear * linear + 2.0 * mixed)


def both_roots(surface: PlacedSurface, a: Array, b: Array, root: Array) -> tuple[Array, Array]:
    """Roots (-B + sqrt(D))/C and (-B - sqrt(D))/C of C w^2 + 2 B w + A = 0, with labels 1 and 2.

    root (...): square root of D. If C is 0 or tiny, a root may be 0, infinite or NaN.
    """
    # -B and -sign(B) sqrt(D) have one sign: their sum does not cancel. The other root comes from A = C w1 w2.
    t = -b - np.copysign(root, b)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        sum_root = t / surface.constant if surface.constant != 0.0 else np.zeros_like(t)
        product_root = np.where(t != 0.0, a / t, 0.0)
    negative = np.signbit(b)
    return np.where(negative, sum_root, product_root), np.where(negative, product_root, sum_root)


def root_counts(surface: PlacedSurface, bounds: Bounds | None, d: Array, own: Array, w: Array) -> NDArray[np.bool_]:
    """Mask of roots (...) that are in front of the lens, on the required nappe, within the bounds, and on the disc.

    d: (..., 3), rays in the canonical frame; own: (..., 3), the same rays in the object's own frame; w: (...) 1/mm,
    finite or not. Both sides of a comparison are multiplied by w, so that nothing is divided by w.
    """
    counts = np.isfinite(w) & (w > 0.0) & (w < NEAREST_INVERSE_DEPTH)
    w = np.where(counts, w, 0.0)
    counts &= surface.canonical.nappe * (surface.offset[2] * w + d[..., 2]) >= 0.0
    if bounds is not None:
        for axis, (low, high) in enumerate(bounds):
            shift = surface.own_offset[axis] * w
            along = shift + own[..., axis]
            # A bound that touches the surface must not lose its last point to rounding.
            slack = BOUNDS_SLACK * (np.abs(shift) + np.abs(own[..., axis]))
            if low > -np.inf:
                counts &= low * w - slack <= along
            if high < np.inf:
                counts &= along <= high * w + slack
    if surface.canonical.radius < np.inf:
        shift, ray = surface.offset[:2] * w[..., None], d[..., :2]
        reach = surface.canonical.radius * w + BOUNDS_SLACK * (np.abs(shift) + np.abs(ray)).sum(axis=-1)
        counts &= ((shift + ray) ** 2).sum(axis=-1) <= reach * reach
    return np.asarray(counts)


def solve_quadric(
    surface: PlacedSurface, bounds: Bounds | None, rays: Array, only: int = 0
) -> tuple[Array, NDArray[np.uint8]]:
    """Inverse depth (...) in 1/mm of the nearest visible root along rays (..., 3), and the root's label.

    bounds: box in the object's own frame, mm; only: label of the only root to use, 0 for both. Labels: 0 no surface (w
    = 0), 1 the root (-B + sqrt(D))/C, 2 the root (-B - sqrt(D))/C of C w^2 + 2 B w + A = 0. A root is visible if it is
    real, 0 < w < 1e6, on the required nappe, within the bounds, and on the disc. Nothing is divided by w, so the sign
    of w decides at the horizon and at infinity. Of two equal roots the first is used.
    """
    shape = surface.canonical
    d, own_rays = turned(surface.turn, rays), turned(surface.own_turn, rays)
    a, b = (shape.q * d * d).sum(axis=-1), ((shape.q * surface.offset + shape.l) * d).sum(axis=-1)
    discriminant = quarter_discriminant(surface, d)
    root = np.sqrt(np.maximum(discriminant, 0.0))
    plus, minus = both_roots(surface, a, b, root)
    inverse_depth, label = np.zeros_like(a), np.zeros(a.shape, dtype=np.uint8)
    # The roots differ by 2 sqrt(D) / C: the nearer one first.
    plus_first = (surface.constant > 0.0) | (root == 0.0)
    for first in (True, False):
        number = np.where(plus_first == first, np.uint8(1), np.uint8(2))
        w = np.where(number == 1, plus, minus)
        candidate = (label == 0) & (discriminant >= 0.0) & ((only == 0) | (number == only))
        counts = candidate & root_counts(surface, bounds, d, own_rays, w)
        inverse_depth = np.where(counts, w, inverse_depth)
        label = np.where(counts, number, label)
    return inverse_depth, label


def nearest_surface(
    surfaces: Sequence[PlacedSurface], bounds: Sequence[Bounds | None], group: OcclusionGroup, rays: Array
) -> tuple[Array, NDArray[np.uint8], NDArray[np.int32]]:
    """Inverse depth (...) in 1/mm of the nearest surface along rays (..., 3), its label, and its object number.

    surfaces, bounds: one per object of the scene. Label: 0 no surface (w = 0, number -1), else 2 k + the label of
    `solve_quadric` for object k. Of equally near surfaces the first is used.
    """
    nearest = np.zeros(rays.shape[:-1])
    label, number = np.zeros(nearest.shape, dtype=np.uint8), np.full(nearest.shape, -1, dtype=np.int32)
    for k, surface in enumerate(surfaces):
        if group.members >> k & 1:
            w, root = solve_quadric(surface, bounds[k], rays, group.root)
            nearer = w > nearest
            nearest = np.where(nearer, w, nearest)
            label = np.where(nearer, (2 * k + root).astype(np.uint8), label)
            number = np.where(nearer, np.int32(k), number)
    return nearest, label, number


def canonical_gradient(surface: PlacedSurface, d: Array, w: Array) -> Array:
    """Gradient (..., 3) of the quadric at hits of canonical rays d, multiplied by w / 2, in the canonical frame."""
    point = surface.offset * w[..., None] + d
    return np.asarray(surface.canonical.q * point + surface.canonical.l * w[..., None])


def surface_slope(surface: PlacedSurface, rays: Array, w: Array) -> Array:
    """Derivative (..., 2) of the inverse depth by the ray's slope, x right and y up, in 1/mm.

    Computed by implicit differentiation of the quadric. It is 0 without a surface, and where the quadric has no
    gradient along the ray (at a cone's apex, or for an exactly tangent ray).
    """
    d = turned(surface.turn, rays)
    g = canonical_gradient(surface, d, w)
    n = turned(surface.turn.T, g)
    along = (g * d).sum(axis=-1)
    usable = (w > 0.0) & (along != 0.0)
    with np.errstate(over="ignore"):
        scale = np.where(usable, w / np.where(usable, along, 1.0), 0.0)
        return np.asarray(scale[..., None] * n[..., :2])


def blur_radius(lens: Lens, rays: Array, w: Array) -> Array:
    """Signed blur radius (...) in px for inverse depths w (...) in 1/mm on rays (..., 3)."""
    return along_rays(lens, rays).blur_radius(w, (rays[..., :2] ** 2).sum(axis=-1))


def along_rays(lens: Lens, rays: Array) -> Lens:
    """The lens for rays (..., 3); in a distorted image its attributes are arrays (...) that include the local scale."""
    return lens.along(rays[..., 0], rays[..., 1])


def blur_gradient(camera: Camera, lens: Lens, slope: Array, rays: Array, w: Array) -> Array:
    """Gradient (..., 2) of the signed blur radius in px per px, right and down.

    slope: (..., 2) from `surface_slope`, for w (...) on rays (..., 3). R = kappa (K - w) (2.33), so R decreases with w;
    with a curved focus the slope of K is added. In a distorted image R is multiplied by its `stretch`, and derivatives
    per px use the inverse Jacobian of the slopes.
    """
    if lens.is_curved:
        slope = slope - lens.focus_rise((rays[..., :2] ** 2).sum(axis=-1))[..., None] * rays[..., :2]
    if lens.distortion is not None:
        x, y = rays[..., 0], rays[..., 1]
        radius, scale = blur_radius(lens, rays, w), along_rays(lens, rays).blur_scale
        by_size = lens.distortion.stretch_slope(x, y)
        changes = (radius * by_size[k] - scale * slope[..., k] for k in range(2))
        right, up = lens.distortion.solved(x, y, *changes)
        return ray_step(camera) * np.stack([right, -up], axis=-1)
    return np.asarray(lens.blur_scale * ray_step(camera) * slope * np.array([-1.0, 1.0]))


def surface_normal(surface: PlacedSurface, rays: Array, w: Array) -> Array:
    """Unit normal (..., 3) in the camera frame, towards the lens; 0 without a surface (w = 0).

    Where the quadric has no gradient (at a cone's apex), it is the direction to the lens.
    """
    n = turned(surface.turn.T, canonical_gradient(surface, turned(surface.turn, rays), w))
    n = np.where((n * rays).sum(axis=-1, keepdims=True) > 0.0, -n, n)
    n = np.where(np.abs(n).max(axis=-1, keepdims=True) > 0.0, n, -rays)
    n = n / np.sqrt((n * n).sum(axis=-1, keepdims=True))
    return np.where((w > 0.0)[..., None], n, 0.0)


def body_point(surface: PlacedSurface, rays: Array, w: Array) -> Array:
    """Position (..., 3) of surface points on rays, in the reference pose, relative to the object's center.

    The position is in the camera's axes, and multiplied by w, so that it has no unit.
    """
    return np.asarray(surface.body_offset * w[..., None] + turned(surface.body_turn, rays))


def rest_position(surface: PlacedSurface, rays: Array, w: Array) -> Array:
    """Position (..., 3) of surface points in the reference pose, in the camera frame, multiplied by w (without unit).

    The third component is positive if the point was in front of the lens.
    """
    return np.asarray(surface.rest * w[..., None] + body_point(surface, rays, w))


def rest_pixel(surface: PlacedSurface, camera: Camera, rays: Array, w: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Row and column (...) in px of surface points projected in the reference pose, and a mask (...) of valid ones.

    Without a surface, and for points that were behind the lens, the mask is False and row = column = 0.
    """
    position = rest_position(surface, rays, w)
    valid = (w > 0.0) & (position[..., 2] > 0.0)
    row, column = project(camera, np.where(valid[..., None], position, 1.0))
    return np.where(valid, row, 0.0), np.where(valid, column, 0.0), valid


def mirror_index(i: NDArray[np.int64], n: int) -> NDArray[np.int64]:
    """Index in 0..n-1 of a signal mirrored about its outer edges: -1 -> 0, n -> n-1, period 2 n."""
    folded = np.mod(i, 2 * n)
    return np.asarray(np.where(folded >= n, 2 * n - 1 - folded, folded))


def filter_weights(t: Array, texture_filter: Filter) -> Array:
    """Weights (..., taps) of the texels around positions t (...) relative to one of them."""
    if texture_filter == "nearest":
        return np.ones((*t.shape, 1))
    if texture_filter == "bilinear":
        return np.stack([1.0 - t, t], axis=-1)
    weights = [
        0.5 * t * (-1.0 + t * (2.0 - t)),
        1.0 + 0.5 * t * t * (3.0 * t - 5.0),
        0.5 * t * (1.0 + t * (4.0 - 3.0 * t)),
        0.5 * t * t * (t - 1.0),
    ]
    return np.stack(weights, axis=-1)


def _taps(position: Array, texture_filter: Filter) -> tuple[NDArray[np.int64], Array]:
    """First texel and weights (..., taps) of the texels used to interpolate at a position along one axis."""
    position = np.clip(position, -FARTHEST_TEXEL, FARTHEST_TEXEL)
    first = np.floor(position + 0.5 * (texture_filter == "nearest"))
    return first.astype(np.int64) - (texture_filter == "bicubic"), filter_weights(position - first, texture_filter)


def sample_texture(texture: Array, row: Array, column: Array, texture_filter: Filter) -> Array:
    """Values (...[, channels]) of a texture (rows, columns[, channels]) at positions (...) in px, mirrored outside.

    texture_filter: "nearest" (halves are rounded up), "bilinear", or "bicubic" (Catmull-Rom, a = -1/2: may overshoot,
    is not clamped).
    """
    (first_row, row_weights), (first_column, column_weights) = (_taps(at, texture_filter) for at in (row, column))
    rows, columns = texture.shape[:2]
    result = np.zeros(row.shape + texture.shape[2:])
    for i in range(row_weights.shape[-1]):
        for j in range(column_weights.shape[-1]):
            texel = texture[mirror_index(first_row + i, rows), mirror_index(first_column + j, columns)]
            weight = row_weights[..., i] * column_weights[..., j]
            result += weight.reshape(weight.shape + (1,) * (texture.ndim - 2)) * texel
    return result


def tilt_slope(gradient: Array, radius: ArrayLike, waves: bool = False) -> Array:
    """Gradient of the signed blur radius divided by the radius, (..., 2) in 1/px: l . grad R per px of offset.

    gradient: (..., 2) px per px, right and down; radius: (...) signed, px. Below 1 px the disc is smaller than a pixel,
    and the offset of a pixel that it touches overestimates l; |radius| is therefore replaced by at least 1 px. With
    waves, light beside the image of a point in focus comes from the whole lens; the slope therefore tends to 0 with R.
    """
    radius = np.asarray(radius, dtype=np.float64)
    size = signed_size(radius)
    return np.clip(gradient * (radius / size**2 if waves else 1.0 / size)[..., None], -STEEPEST_TILT, STEEPEST_TILT)


def signed_size(radius: Array) -> Array:
    """A signed blur radius (...) in px whose absolute value is at least SMALLEST_RADIUS."""
    return np.where(radius < 0.0, -1.0, 1.0) * np.maximum(np.abs(radius), SMALLEST_RADIUS)


def tilt_share(factor: ArrayLike, limb: ArrayLike = False) -> Array:
    """Fraction (...) of a source's radiance that remains after tilt: `factor` f = 1 + l . grad R (...), at least 0.

    limb: True for sub-pixel sources at an outline where the surface turns away from the lens. For these the fraction is
    ((1 + f) / 2)^2, or 0 below f = -1, which includes the lens's view of the back (kernels/common/geometry.clh). The
    arguments broadcast.
    """
    factor = np.asarray(factor)
    return np.where(limb, 0.25 * np.maximum(factor + 1.0, 0.0) ** 2, np.maximum(factor, 0.0))


def pixel_reach(radius: ArrayLike, waves: bool = False) -> Array:
    """Divisor (...) in px of the gradient of R for sources that are whole pixels; see kernels/common/geometry.clh."""
    size = np.abs(np.asarray(radius, dtype=np.float64))
    if waves:
        return np.maximum(size, np.minimum(2.0 * size, 1.0))
    return np.where(size < SMALLEST_RADIUS, 2.0 * size, size + 2.0 / (3.0 * np.maximum(size, SMALLEST_RADIUS)))


def pixel_tilt(gradient: Array, radius: ArrayLike, waves: bool = False) -> tuple[Array, Array]:
    """Slope (..., 2) in 1/px for sources that are whole pixels, and the signed radius (...) in px for their weights.

    Arguments as for `tilt_slope`. From 1 px on, the slope is the gradient over `pixel_reach`. Below 1 px, the radius is
    the mean of |R| over the corners, and a slope is half of the difference of two opposite edges, divided by this
    radius, for the reason in kernels/common/geometry.clh. With waves, `tilt_slope` is used for all radii.
    """
    radius = np.asarray(radius, dtype=np.float64)
    if waves:
        return tilt_slope(gradient, radius, waves), radius
    size, near = np.abs(radius), np.abs(radius) < SMALLEST_RADIUS
    x, y = np.moveaxis(np.minimum(0.5 * np.abs(gradient), 0.5), -1, 0)
    most, aside, below, least = size + x + y, np.abs(size + x - y), np.abs(size - x + y), np.abs(size - x - y)
    mean = np.where(x + y > size, 0.25 * (most + aside + below + least), size)
    change = 0.25 * np.stack([most + aside - below - least, most + below - aside - least], axis=-1)
    sign = np.where((gradient < 0.0) == (radius < 0.0)[..., None], 1.0, -1.0)
    slope = sign * change / np.maximum(mean, 1e-30)[..., None]
    spread = np.where(near, np.where(radius < 0.0, -mean, mean), radius)
    far = np.where(radius < 0.0, -1.0, 1.0) * pixel_reach(radius)
    return np.where(near[..., None], slope, tilt_slope(gradient, far)), spread
