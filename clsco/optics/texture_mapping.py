"""Mapping from points of a surface to its texture image (float64, pure).

A point p of an object's own frame (mm) is q = frame p. Two coordinates of q are lengths or angles on the surface:

    plane       (q_x, q_y)                                            mm
    cylinder    (phi, q_y),  phi = atan2(q_x, q_z)                    rad, mm
    longitude   (phi, theta),  theta = atan2(q_y, hypot(q_x, q_z))    rad
    cone        s (sin psi, cos psi),  s = |q|,  psi = phi sin(half angle): the cone rolled out    mm
    triplanar   the two other components of q, for each of three axes, weighted by max(n^2 - 0.1, 0)^2    mm
    cube        the two other components over the largest one, for each of six sides                 -1 to 1

where n is the component of the unit normal along the axis. With these two coordinates (x, y), (column, row) = scale (x,
y) + shift in texels; texel edges are at integers: column 0 is the left border of the image, row 0 the upper one.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, pi, radians, sin, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.constants import (
    DETAILED_MOST,
    DETAILED_TEXELS,
    FINE_MOST,
    FINE_TEXELS,
    MAP_CONE,
    MAP_CUBE,
    MAP_CYLINDER,
    MAP_LONGITUDE,
    MAP_PLANE,
    MAP_TRIPLANAR,
    NEAR_FOCUS,
    WRAP_CLAMP,
    WRAP_MIRROR,
    WRAP_NONE,
    WRAP_REPEAT,
)
from clsco.optics.point_spread import PointSpread
from clsco.scene.model import Cone, Cylinder, Disc, Ellipsoid, Object, Plane, Rectangle, Scene
from clsco.scene.texture_keys import Mapped

KINDS: dict[Mapped | None, int] = {
    "card": MAP_PLANE,
    "plane": MAP_PLANE,
    "cylinder": MAP_CYLINDER,
    "longitude": MAP_LONGITUDE,
    "cone": MAP_CONE,
    "triplanar": MAP_TRIPLANAR,
    "cube": MAP_CUBE,
}
WRAPS = {"repeat": WRAP_REPEAT, "mirror": WRAP_MIRROR, "clamp": WRAP_CLAMP, "none": WRAP_NONE}
Matrix = NDArray[np.float64]
DETAILED_LEAST = 0.01  # |R| in px above which pixels may need several sources; not for waves and aberrations


@dataclass(frozen=True)
class TextureMap:
    """Map of an image of `columns` x `rows` texels onto a surface.

    kind: one of MAP_... (`clsco.constants`). frame: matrix (3, 3) of q = frame p, from the object's own frame. scale:
    (2, 2), texels per unit of the two coordinates: columns, then rows. shift: column and row of the coordinates (0, 0).
    slant: sine of a cone's half angle. wrap_x, wrap_y: one of WRAP_..., horizontally and vertically.
    """

    kind: int
    frame: Matrix
    scale: Matrix
    shift: Matrix
    slant: float
    wrap_x: int
    wrap_y: int
    columns: int
    rows: int


def needs_detail(scene: Scene, psf: PointSpread, largest: float) -> bool:
    """True if textures on surfaces need sub-pixel sources instead of pixel means, for |R| up to `largest` px."""
    return scene.has_mapped_textures and texture_spread(psf) * largest > detail_least(psf)


def texture_spread(psf: PointSpread) -> float:
    """Radius in px of the disc with the second moments of the PSF for R = 1; 0 unless psf.edge is "integrated"."""
    return 2.0 * sqrt(psf.pupil.second_moment) if psf.edge == "integrated" else 0.0


def detail_least(psf: PointSpread) -> float:
    """Value of `texture_spread` times |R| in px above which pixels may need several sources.

    Negative for waves and aberrations with edge "integrated", as their points in focus are spots.
    """
    return -1.0 if psf.diffracted and psf.edge == "integrated" else DETAILED_LEAST


def cut_parts(
    texels: NDArray[Any], spread: NDArray[Any], samples: int, least: float = DETAILED_LEAST
) -> NDArray[np.intp]:
    """Number of parts per axis into which pixels (n,) are split; 0 where one source is enough.

    texels: squared number of texels per pixel, along the wider axis; spread: `texture_spread` times |R|, px; samples:
    sub-pixel sources per axis; least: `detail_least`, px.
    """
    finer = texels > np.float32(FINE_TEXELS) ** 2
    most = np.where(finer, np.float32(FINE_MOST), np.float32(DETAILED_MOST))
    detailed = (texels > np.float32(DETAILED_TEXELS) ** 2) & (spread > np.float32(least)) & (spread < most)
    fine = finer | (spread < np.float32(NEAR_FOCUS))
    many = 4 if samples % 4 == 0 else 3 if samples % 3 == 0 else samples
    return np.where(detailed, np.where(fine, many, 2 if samples % 2 == 0 else many), 0)


def texture_map(item: Object, columns: int, rows: int) -> TextureMap:
    """Map of a texture, or of each side of a cube map, of `columns` x `rows` texels; not for mapping "projected"."""
    kind = KINDS[item.mapped]
    per_unit, middle = _texels(item, kind, columns, rows)
    angle = radians(item.texture_angle or 0.0)
    turn = np.array([[cos(angle), sin(angle)], [-sin(angle), cos(angle)]])
    units = np.diag([item.radius if isinstance(item, Cylinder) and kind == MAP_CYLINDER else 1.0, 1.0])
    right, up = item.texture_offset or (0.0, 0.0)
    wrap = WRAPS[item.wrap]
    # The upper and lower edge of an image from pole to pole are the poles: beyond them, the image is mirrored.
    to_poles = kind == MAP_LONGITUDE and abs(per_unit[1]) * pi == rows and up == 0.0
    return TextureMap(
        kind, _frame(item, kind), np.diag(per_unit) @ turn @ units, middle + np.array([-right * columns, up * rows]),
        sin(radians(item.half_angle)) if isinstance(item, Cone) else 0.0, wrap, WRAP_MIRROR if to_poles else wrap,
        columns, rows,
    )  # fmt: skip


def _texels(item: Object, kind: int, columns: int, rows: int) -> tuple[Matrix, Matrix]:
    """Texels per mm, per rad, or per unit of a cube's sides: columns to the right, rows upwards and therefore negative;
    and the column and row of the middle.
    """
    aspect, middle = rows / columns, np.array([0.5 * columns, 0.5 * rows])
    across, *up = item.texture_repeats or (1.0,)
    if kind == MAP_LONGITUDE:
        # By default, once around and from pole to pole; a single number keeps the texels' proportions at the equator.
        copies = up[0] if up else 0.5 * across / aspect if item.texture_repeats else 1.0
        return np.array([columns * across / (2 * pi), -(rows * copies) / pi]), middle
    if kind == MAP_CUBE:
        copies = up[0] if up else across
        return np.array([0.5 * columns * across, -0.5 * rows * copies]), middle
    if item.texture_size is not None:
        width, *height = item.texture_size
    elif isinstance(item, Rectangle | Disc):
        width, height = item.size[0] / across, [item.size[1] / copies for copies in up]
        height = height if item.texture_repeats else [item.size[1]]
    else:
        assert isinstance(item, Cylinder)
        width, height = 2 * pi * item.radius / across, []
    return np.array([columns / width, -rows / (height[0] if height else width * aspect)]), middle


def _frame(item: Object, kind: int) -> Matrix:
    """Value of `TextureMap.frame`, whose rows are the axes of q in the object's own frame.

    Maps by longitude and cube maps: right, up, towards the camera, divided by the semi-axes of an ellipsoid. Cylinder:
    the second row is the cylinder's axis; the third points towards the camera, or up if the axis points there. Cone:
    right, the cone's axis, up. Plane: right, up, the normal away from the camera. All others: the object's own axes.
    """
    if kind in (MAP_LONGITUDE, MAP_CUBE):
        axes = item.semi_axes if isinstance(item, Ellipsoid) else (1.0, 1.0, 1.0)
        return np.diag([1.0, 1.0, -1.0]) / np.array(axes)[:, None]
    if kind == MAP_CONE:
        return np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]])
    if kind == MAP_CYLINDER:
        assert isinstance(item, Cylinder)
        axis = np.asarray(item.axis, dtype=np.float64) / np.linalg.norm(item.axis)
        towards = np.array([0.0, 0.0, -1.0])
        if np.hypot(axis[0], axis[1]) < 1e-6:  # seen along its axis: up
            towards = np.array([0.0, 1.0, 0.0])
        front = towards - (towards @ axis) * axis
        front /= np.linalg.norm(front)
        return np.array([np.cross(front, axis), axis, front])
    if kind == MAP_PLANE and isinstance(item, Plane):
        normal = np.array([-item.slope_x, -item.slope_y, 1.0])
        right = np.array([1.0, 0.0, item.slope_x])
        normal, right = normal / np.linalg.norm(normal), right / np.linalg.norm(right)
        return np.array([right, np.cross(normal, right), normal])
    return np.eye(3)
