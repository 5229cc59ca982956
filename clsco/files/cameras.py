"""Cameras in the text files of COLMAP (cameras.txt, images.txt, points3D.txt)."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Pinhole:
    """A camera and its pose: X_camera = rotation X_world + translation, in mm; x to the right, y down, z forward.

    columns, rows, focal and center (column and row of the principal point; pixel centers are integers): px.
    distortion: k1, k2, p1, p2, k3 of OpenCV, or ().
    """

    columns: int
    rows: int
    focal: float
    center: tuple[float, float]
    rotation: Array
    translation: Array
    distortion: tuple[float, ...] = ()


def _quaternion(rotation: Array) -> Array:
    """Unit quaternion (w, x, y, z), w >= 0, of a rotation matrix; from the largest component to avoid cancellation."""
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = rotation
    # Four times the product of each pair of components, such as 4 w x in row 0, column 1.
    products = np.array(
        [
            [1.0 + xx + yy + zz, zy - yz, xz - zx, yx - xy],
            [zy - yz, 1.0 + xx - yy - zz, xy + yx, xz + zx],
            [xz - zx, xy + yx, 1.0 - xx + yy - zz, yz + zy],
            [yx - xy, xz + zx, yz + zy, 1.0 - xx - yy + zz],
        ]
    )
    row = products[int(np.argmax(np.diag(products)))]
    return row * (math.copysign(1.0, row[0]) / np.linalg.norm(row))


def colmap_texts(images: Iterable[tuple[str, Pinhole]]) -> dict[str, bytes]:
    """Files of a sparse model of COLMAP, in mm and without points: content by file name.

    images: name and camera of each image. COLMAP has pixel centers at halves, so the principal point is written half a
    pixel farther right and down. Tests compare with pycolmap, and with points projected into the frame.
    """
    cameras: dict[str, int] = {}
    lines = ["# IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME, from world to camera, mm; then a line of no points"]
    for number, (name, camera) in enumerate(images, 1):
        column, row = (at + 0.5 for at in camera.center)
        numbers = [camera.focal, camera.focal, column, row, *camera.distortion]
        numbers += [0.0] * 3 if camera.distortion else []  # k4 to k6
        model = "FULL_OPENCV" if camera.distortion else "PINHOLE"
        kind = f"{model} {camera.columns} {camera.rows} {' '.join(map(repr, numbers))}"
        identity = cameras.setdefault(kind, len(cameras) + 1)
        turned = (*_quaternion(camera.rotation), *camera.translation)
        pose = " ".join(repr(float(value) + 0.0) for value in turned)  # 0 instead of -0
        lines.append(f"{number} {pose} {identity} {name}\n")
    kinds = [f"{identity} {kind}" for kind, identity in cameras.items()]
    return {
        "cameras.txt": _text("# CAMERA_ID MODEL WIDTH HEIGHT FX FY CX CY, px", *kinds),
        "images.txt": _text(*lines),
        "points3D.txt": _text("# no points"),
    }


def _text(*lines: str) -> bytes:
    return "".join(f"{line}\n" for line in lines).encode()
