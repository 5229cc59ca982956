"""Textures and depths of scenes: file names, layers of files, and arrays."""

from __future__ import annotations

import hashlib
import os
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import DTypeLike, NDArray
from pydantic import GetCoreSchemaHandler
from pydantic_core import CoreSchema, core_schema

from clsco.scene.quantities import Name, fault

MAX_ARRAY_PIXELS, MAX_ARRAY_SIDE = 2**27, 65536  # same limits as for image files
TEXTURE_TYPES = ("u1", "u2", "f2", "f4", "f8")
Kind = Literal["texture", "depth"]


class ArrayInput:
    """An array in a scene in place of a file: a read-only copy, compared by content.

    array: texture in uint8, uint16 or float32, (rows, columns[, 3]), or depth in integers or float64, (rows, columns).
    sha256: hash of its type, shape and values, hexadecimal.
    """

    __slots__ = ("array", "kind", "sha256")

    def __init__(self, array: NDArray[Any], kind: Kind) -> None:
        self.array, self.kind = np.array(array, order="C"), kind
        self.array.flags.writeable = False
        digest = hashlib.sha256(f"{self.array.dtype.str} {self.array.shape} ".encode())
        digest.update(self.array.data)
        self.sha256 = digest.hexdigest()

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> NDArray[Any]:
        return np.array(self.array, dtype=dtype, copy=copy)

    def __eq__(self, other: object) -> bool:
        return (self.kind, self.sha256) == (other.kind, other.sha256) if isinstance(other, ArrayInput) else False

    def __hash__(self) -> int:
        return hash(self.sha256)

    def __repr__(self) -> str:
        return f"array of {self.array.dtype} {self.array.shape}, sha256 {self.sha256[:16]}"

    def __deepcopy__(self, memo: object) -> ArrayInput:
        return self  # it is immutable

    def __reduce__(self) -> tuple[Any, ...]:
        return ArrayInput, (self.array, self.kind)


@dataclass(frozen=True)
class LayerInput(os.PathLike[str]):
    """A layer of an EXR file that has several; `str` and `os.fspath` return the path of the file.

    layer: name of the layer, as for `clsco.files.layers.image_channels` or `depth_channels`.
    """

    path: str
    layer: str

    def __fspath__(self) -> str:
        return self.path

    def __str__(self) -> str:
        return self.path


Input = str | LayerInput | ArrayInput
"""The name of a pattern, the path of a file, a layer of a file, or an array."""


@dataclass(frozen=True)
class _InputOf:
    """Constraint on a texture or depth: a name or path, converted to text, or an array, converted to `ArrayInput`."""

    kind: Kind

    def check(self, value: Any, text: Callable[[Any], str]) -> str | ArrayInput:
        """Convert an input to the form that the model stores, or raise its faults; text: validates a name or path."""
        if isinstance(value, ArrayInput):
            return value if value.kind == self.kind else self.check(value.array, text)
        if isinstance(value, np.ndarray):
            return ArrayInput(_texture(value) if self.kind == "texture" else _depth(value), self.kind)
        return text(os.fspath(value) if isinstance(value, os.PathLike) else value)

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        written = core_schema.plain_serializer_function_ser_schema(str, when_used="json")
        text = handler.generate_schema(Name)
        return core_schema.no_info_wrap_validator_function(self.check, text, serialization=written)


def _texture(array: NDArray[Any]) -> NDArray[Any]:
    """The array as `clsco.files.images.read_image` would return it: codes unchanged, floats as float32."""
    _check_shape(array, array.ndim == 2 or array.shape[2:] == (3,), "(rows, columns) or (rows, columns, 3)")
    if array.dtype.str[1:] not in TEXTURE_TYPES:
        raise fault("an array must hold uint8, uint16, float16, float32 or float64", str(array.dtype))
    if array.dtype.kind == "u":
        return array.astype(array.dtype.newbyteorder("="))
    with np.errstate(over="ignore"):  # overflow becomes infinite, which is rejected next
        radiance = array.astype(np.float32)
    wrong = ~np.isfinite(radiance)
    if wrong.any():
        first = tuple(int(index) for index in np.unravel_index(int(wrong.argmax()), wrong.shape))
        got = f"{array[first]} at row {first[0]}, column {first[1]} ({int(wrong.sum())} in all)"
        raise fault("values of an array must be finite", got)
    return radiance


def _depth(array: NDArray[Any]) -> NDArray[Any]:
    """The array as `clsco.inputs.depth_files.read_depth` would return it: integers unchanged, floats as float64."""
    _check_shape(array, array.ndim == 2, "(rows, columns)")
    if array.dtype.kind not in "iuf":
        raise fault("an array must hold integers or floats", str(array.dtype))
    return array.astype(np.float64 if array.dtype.kind == "f" else array.dtype.newbyteorder("="))


def _check_shape(array: NDArray[Any], right: bool, shape: str) -> None:
    """Reject arrays with a wrong shape or beyond the limits of files, and masked values."""
    if array.ndim < 2 or not right:
        raise fault(f"an array must have the shape {shape}", str(array.shape))
    rows, columns = array.shape[:2]
    if not (1 <= rows <= MAX_ARRAY_SIDE and 1 <= columns <= MAX_ARRAY_SIDE and rows * columns <= MAX_ARRAY_PIXELS):
        rule = f"an array must have from 1 to {MAX_ARRAY_SIDE} rows and columns, and at most {MAX_ARRAY_PIXELS} pixels"
        raise fault(rule, str(array.shape))
    masked = int(np.count_nonzero(np.ma.getmaskarray(array))) if isinstance(array, np.ma.MaskedArray) else 0
    if masked:
        raise fault("an array must have no masked values", f"{masked} of them")


class HasInputs(ABC):
    """Table of a scene whose keys name files, patterns or arrays."""

    @abstractmethod
    def inputs(self) -> dict[str, Input]:
        """The inputs that the table names, by key."""

    def files(self) -> dict[str, str]:
        """Paths of the files among the inputs, by key."""
        return {key: str(value) for key, value in self.inputs().items() if not isinstance(value, ArrayInput)}

    def arrays(self) -> dict[str, ArrayInput]:
        """The arrays among the inputs, by key."""
        return {key: value for key, value in self.inputs().items() if isinstance(value, ArrayInput)}


Given = str | os.PathLike[str] | NDArray[Any] | ArrayInput
TextureInput = Annotated[Given, _InputOf("texture")]
DepthInput = Annotated[Given, _InputOf("depth")]
