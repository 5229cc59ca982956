"""What a file of ground truth holds, as `clsco render --truth` names it: "npz", "npz:depth,coc", "npz+float16"."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.errors import ImageError, SceneError
from clsco.frame.frame import ALL_TRUTH, FILE_NAMES, IMAGE_NAMES, Frame

OPTIONS = ("float16", "compressed")
ATTRIBUTES = {in_file: name for name, in_file in FILE_NAMES.items()}


@dataclass(frozen=True)
class TruthFile:
    """A file of ground truth.

    Attributes
    ----------
    format : str
        Its extension.
    names : tuple of str
        Arrays in it, as they are called in files; () for all of them.
    float16 : bool
        Floats have 16 bits: 11 significant ones, and sizes up to 65504.
    compressed : bool
        Floats are compressed as well.
    """

    format: str
    names: tuple[str, ...] = ()
    float16: bool = False
    compressed: bool = False

    def __str__(self) -> str:
        options = "".join(f"+{name}" for name in OPTIONS if getattr(self, name))
        return f"{self.format}{options}" + (f":{','.join(self.names)}" if self.names else "")

    @property
    def truth(self) -> tuple[str, ...]:
        """Attributes of a frame besides color that it needs."""
        return tuple(ATTRIBUTES[name] for name in self.names if name != "color") if self.names else ALL_TRUTH

    def arrays(self, frame: Frame) -> dict[str, NDArray[Any]]:
        """The arrays of a frame in it, as they are called in files. Raises ImageError for floats beyond float16."""
        known = {in_file: getattr(frame, name) for name, in_file in FILE_NAMES.items()}
        found = {n: array for n, array in known.items() if array is not None and n in (self.names or known)}
        return {name: self._stored(f"frame {frame.index}: {name}", array) for name, array in found.items()}

    def _stored(self, where: str, array: NDArray[Any]) -> NDArray[Any]:
        if not self.float16 or array.dtype.kind != "f":
            return array
        with np.errstate(over="ignore"):  # what becomes infinite is refused next
            half = array.astype(np.float16)
        beyond = np.isinf(half) & np.isfinite(array)
        if beyond.any():
            first = tuple(int(index) for index in np.unravel_index(int(beyond.argmax()), beyond.shape))
            got = f"{array[first]:.6g} at row {first[0]}, column {first[1]} ({int(beyond.sum())} in all)"
            raise ImageError(f"{where}: sizes must be at most 65504 in float16; got {got}")
        return half


def parse_truth(text: str, formats: Collection[str]) -> tuple[TruthFile, ...]:
    """Files of ground truth by their names: formats, each with options and names of arrays.

    Parameters
    ----------
    text : str
        Such as "npz,exr", "npz:depth,coc,exr" or "npz+float16+compressed:depth".
    formats : collection of str
        Those there are.

    Returns
    -------
    tuple of TruthFile

    Raises
    ------
    SceneError
        Anything else, or a format twice.
    """
    found: list[list[str]] = []
    for part in text.split(","):
        if part.partition(":")[0].partition("+")[0] in formats:
            found.append([part])
        elif found and ":" in found[-1][0]:
            found[-1].append(part)
        else:
            raise SceneError(f"must be some of {','.join(formats)}; got {text}")
    files = tuple(dict.fromkeys(_parsed(",".join(parts)) for parts in found))
    if len({file.format for file in files}) < len(files):
        raise SceneError(f"must name each format once; got {text}")
    return files


def _parsed(text: str) -> TruthFile:
    head, colon, listed = text.partition(":")
    form, *options = head.split("+")
    names = [FILE_NAMES.get(name, name) for name in listed.split(",")] if colon else []
    for name in names:
        if name not in ATTRIBUTES:
            raise SceneError(f"must name arrays after {form}:, some of {', '.join(ATTRIBUTES)}; got {name or text}")
    for option in options:
        if option not in OPTIONS:
            raise SceneError(f"must have the options {' and '.join(OPTIONS)} alone, like {form}+float16; got {option}")
    if form == "exr" and "compressed" in options:
        raise SceneError(f"must be compressed with npz alone, as exr always is; got {text}")
    ordered = tuple(name for name in ATTRIBUTES if name in names)
    return TruthFile(form, ordered, "float16" in options, "compressed" in options)


def needed_truth(files: Iterable[TruthFile]) -> tuple[str, ...]:
    """Attributes of a frame besides color that files need, in the order of the frame."""
    needed = {name for file in files for name in file.truth}
    return tuple(name for name in (*ALL_TRUTH, *IMAGE_NAMES) if name in needed)
