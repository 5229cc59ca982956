"""Primaries of color spaces: matrices from their linear values to linear sRGB."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Matrix = NDArray[np.float64]

ALIKE = 1e-3  # a matrix this close to the identity counts as the identity: under half a code of 8 bits at white
D50 = np.array([0.9642, 1.0, 0.8249])  # white of the profile connection space (ICC.1:2022, 7.2.16)
_BRADFORD = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])
_D65, _C = (0.3127, 0.329), (0.31, 0.316)
SRGB_CHROMATICITIES = (*_D65, 0.64, 0.33, 0.3, 0.6, 0.15, 0.06)
_OF_1953, _OF_525_LINES = (0.67, 0.33, 0.21, 0.71, 0.14, 0.08), (0.63, 0.34, 0.31, 0.595, 0.155, 0.07)
_P3 = (0.68, 0.32, 0.265, 0.69, 0.15, 0.06)
CICP_CHROMATICITIES = {  # ITU-T H.273, table 2: x and y of white, red, green and blue
    1: SRGB_CHROMATICITIES,
    4: (*_C, *_OF_1953),
    5: (*_D65, 0.64, 0.33, 0.29, 0.6, 0.15, 0.06),
    6: (*_D65, *_OF_525_LINES),
    7: (*_D65, *_OF_525_LINES),
    8: (*_C, 0.681, 0.319, 0.243, 0.692, 0.145, 0.049),
    9: (*_D65, 0.708, 0.292, 0.17, 0.797, 0.131, 0.046),
    11: (0.314, 0.351, *_P3),
    12: (*_D65, *_P3),
    22: (*_D65, 0.63, 0.34, 0.295, 0.605, 0.155, 0.077),
}


def chromaticities_to_srgb(chromaticities: Sequence[float] | Matrix) -> Matrix | None:
    """Matrix (3, 3) to linear sRGB from primaries given as x and y of white, red, green and blue; None if they are
    collinear. White stays white, by Bradford's adaptation.
    """
    xyz = colorants(chromaticities)
    return None if xyz is None else colorants_to_srgb(xyz)


def colorants_to_srgb(xyz: Matrix) -> Matrix:
    """Matrix (3, 3) to linear sRGB from X, Y and Z of primaries under D50 as columns; exactly the identity for those of
    sRGB up to rounding.
    """
    srgb = colorants(SRGB_CHROMATICITIES)
    assert srgb is not None
    matrix = np.asarray(np.linalg.solve(srgb, xyz), np.float64)
    return np.eye(3) if np.abs(matrix - np.eye(3)).max() <= ALIKE else matrix


def colorants_to_chromaticities(xyz: Matrix, white: Matrix = D50) -> tuple[float, ...]:
    """x and y of white, red, green and blue, from X, Y and Z of the primaries as columns, adapted to D50 from those of
    the white.
    """
    with np.errstate(all="ignore"):  # `colorants` rejects chromaticities that are not finite
        native = np.linalg.inv(adaptation(white)) @ np.column_stack([xyz.sum(axis=1), xyz])
        return tuple((native[:2] / native.sum(axis=0)).T.ravel().tolist())


def adaptation(white: Matrix) -> Matrix:
    """Bradford's matrix from X, Y and Z under a white to X, Y and Z under D50."""
    return np.asarray(np.linalg.solve(_BRADFORD, ((_BRADFORD @ D50) / (_BRADFORD @ white))[:, None] * _BRADFORD))


def white_of(chromaticities: Sequence[float] | Matrix) -> Matrix:
    """X, Y and Z of the white."""
    x, y = chromaticities[:2]
    return np.array([x / y, 1.0, (1 - x - y) / y])


def colorants(chromaticities: Sequence[float] | Matrix) -> Matrix | None:
    """X, Y and Z of red, green and blue as columns, adapted to D50; None if the primaries are collinear."""
    x, y = np.asarray(chromaticities, np.float64).reshape(4, 2).T
    if not np.isfinite([x, y]).all() or y[0] <= 0:
        return None
    white, columns = white_of((x[0], y[0])), np.stack([x, y, 1 - x - y])[:, 1:]  # y of a primary may be below 0
    if np.linalg.cond(columns) > 1e6 or (_BRADFORD @ white <= 0).any():
        return None
    matrix: Matrix = adaptation(white) @ (columns * np.linalg.solve(columns, white))
    return matrix
