"""Messages on array values outside the range of a file's format."""

from __future__ import annotations

from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from clsco.errors import FileError


def first_of(values: NDArray[Any], wrong: NDArray[np.bool_]) -> str:
    """Text on wrong values, such as "nan at row 0, column 1 (2 in all)": the first one, its position, and their number.
    If the mask has no axis for channels, the text has all channels of the pixel.
    """
    first = tuple(int(index) for index in np.unravel_index(int(wrong.argmax()), wrong.shape))
    shown = ", ".join(f"{value:.6g}" for value in np.ravel(values[first]))
    return f"{shown} at row {first[0]}, column {first[1]} ({int(wrong.sum())} in all)"


def check_values(where: str, rule: str, values: NDArray[Any], wrong: NDArray[np.bool_]) -> None:
    """Raise FileError `where: rule; got TEXT` if the mask `wrong` marks any value; TEXT comes from `first_of`."""
    if wrong.any():
        raise FileError(f"{where}: {rule}; got {first_of(values, wrong)}")


def raise_shape_error(where: str, rule: str, values: NDArray[Any]) -> NoReturn:
    """Raise FileError on the shape of `values`: `where: shape must be rule; got shape`."""
    raise FileError(f"{where}: shape must be {rule}; got {values.shape}")
