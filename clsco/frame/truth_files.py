"""Files of ground truth, as `clsco render --truth` names them: "npz", "flo", "npz:depth,coc", "npz+float16"."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from clsco.errors import SceneError
from clsco.files.color import SRGB, Color
from clsco.files.ranges import refuse_values
from clsco.frame.frame import FILE_NAMES, Frame
from clsco.scene.model import Scene

OPTIONS = ("float16", "compressed", "zstd")
ATTRIBUTES = {in_file: name for name, in_file in FILE_NAMES.items()}
OF_THE_IMAGE = frozenset({"color", "alpha", "subframes", "raw", "electrons", "noise_sigma", "saturated"})
"""Arrays that are not made without color."""


@dataclass(frozen=True)
class TruthFile:
    """A file of ground truth, or one for each array, as a user names it.

    Attributes
    ----------
    format : str
        Key of `clsco.frame.files.TRUTH_FORMATS`.
    names : tuple of str
        Arrays in it, as they are called in files; () for all of them.
    float16 : bool
        Floats have 16 bits: 11 significant ones, and sizes up to 65504.
    compressed : bool
        Floats are compressed as well.
    zstd : bool
        Whole files are compressed by Zstandard, and have the ending .zst.
    """

    format: str
    names: tuple[str, ...] = ()
    float16: bool = False
    compressed: bool = False
    zstd: bool = False

    def __str__(self) -> str:
        options = "".join(f"+{name}" for name in OPTIONS if getattr(self, name))
        return f"{self.format}{options}" + (f":{','.join(self.names)}" if self.names else "")

    def arrays(self, frame: Frame) -> dict[str, NDArray[Any]]:
        """The arrays of a frame in it, as they are called in files. Raises ImageError for floats beyond float16."""
        known = frame.arrays()
        found = {name: array for name, array in known.items() if name in (self.names or known)}
        return {name: self._stored(f"frame {frame.index}: {name}", array) for name, array in found.items()}

    def _stored(self, where: str, array: NDArray[Any]) -> NDArray[Any]:
        if not self.float16 or array.dtype.kind != "f" or array.ndim < 2:  # times keep their digits
            return array
        with np.errstate(over="ignore"):  # what becomes infinite is refused next
            half = array.astype(np.float16)
        beyond = np.isinf(half) & np.isfinite(array)
        refuse_values(where, "sizes must be at most 65504 in float16", array, beyond)
        return half


@dataclass(frozen=True, eq=False)
class Shot:
    """Content of a file of ground truth.

    Attributes
    ----------
    views : sequence of Frame
        Views in one file: a frame, or both views of a stereo pair.
    scene : Scene or None
        That they show, with its resolution.
    color : Color
        Color space whose primaries the radiance has.
    """

    views: tuple[Frame, ...]
    scene: Scene | None
    color: Color = SRGB


@dataclass(frozen=True)
class TruthFormat:
    """A format of ground truth.

    Attributes
    ----------
    name : str
        Name of its files: "{stem}_{array}.flo"; of a scene's its folder.
    write : callable
        Takes a path, what is written, and what of it is wanted; of a file `per` array that one name.
    per : {"frame", "view", "array", "scene"}
        Unit that has one file: both views of a stereo pair together, each view, each array of a view, or the whole
        scene.
    arrays : tuple of str, optional
        Arrays that it can hold, as they are called in files; by default any.
    besides : tuple of str
        Attributes of a frame that it needs to know where its arrays hold.
    options : tuple of str
        Some of `OPTIONS`.
    needs : (str, str), optional
        Module that it needs, and the extra of clsco that brings it.
    """

    name: str
    write: Callable[[Path, Shot, TruthFile], None]
    per: Literal["frame", "view", "array", "scene"] = "view"
    arrays: tuple[str, ...] = tuple(ATTRIBUTES)
    besides: tuple[str, ...] = ()
    options: tuple[str, ...] = ()
    needs: tuple[str, str] | None = None


def parse_truth(text: str, formats: Mapping[str, TruthFormat]) -> tuple[TruthFile, ...]:
    """Files of ground truth by their names: formats, each with options and names of arrays.

    Parameters
    ----------
    text : str
        Such as "npz,flo", "npz:depth,coc,exr" or "npz+float16+compressed:depth".
    formats : mapping of str to TruthFormat
        Known formats.

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
    files = tuple(dict.fromkeys(_parsed(",".join(parts), formats) for parts in found))
    if len({file.format for file in files}) < len(files):
        raise SceneError(f"must name each format once; got {text}")
    return files


def _parsed(text: str, formats: Mapping[str, TruthFormat]) -> TruthFile:
    head, colon, listed = text.partition(":")
    form, *options = head.split("+")
    known = formats[form]
    names = [FILE_NAMES.get(name, name) for name in listed.split(",")] if colon else []
    for name in names:
        if not known.arrays:
            raise SceneError(f"must be {form} without names, as it holds no arrays; got {text}")
        if name not in known.arrays:
            raise SceneError(f"must name arrays after {form}:, some of {', '.join(known.arrays)}; got {name or text}")
    for option in options:
        if not known.options:
            raise SceneError(f"must be {form} without options; got {head}")
        if option not in known.options:
            allowed = f"the option{'s' * (len(known.options) > 1)} {' and '.join(known.options)} alone"
            raise SceneError(f"must have {allowed}, like {form}+{known.options[0]}; got {option}")
    ordered = tuple(name for name in ATTRIBUTES if name in names)
    return TruthFile(form, ordered, **{option: option in options for option in OPTIONS})
