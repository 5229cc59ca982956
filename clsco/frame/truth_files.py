"""Files of ground truth: named arrays, file formats, and number types.

The JSON file of a frame records such a file as FORMAT+OPTION:ARRAY,..., for example "npz", "npz:depth,coc",
"npz+compressed" or "npy+depth=float16:depth,mask".
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from clsco.errors import SceneError
from clsco.files.color import SRGB, Color
from clsco.files.ranges import check_values
from clsco.frame.frame import Frame
from clsco.frame.outputs import ALL_TRUTH, ATTRIBUTES, OUTPUTS, attributes_of
from clsco.scene.model import Scene

ALL = "all"
FLOATS = ("float32", "float16")  # types of an array of floats


@dataclass(frozen=True)
class TruthFile:
    """Ground-truth file that a user asks for; in some formats, one file per array.

    format: key of `clsco.frame.files.TRUTH_FORMATS`. names: names in files of its arrays; () for all. float16: names of
    the arrays that are stored as float16, with 11 significant bits, up to 65504; ("all",) for all arrays. compressed:
    True to compress floats, too.
    """

    format: str
    names: tuple[str, ...] = ()
    float16: tuple[str, ...] = ()
    compressed: bool = False

    def __str__(self) -> str:
        options = "".join("+float16" if name == ALL else f"+{name}=float16" for name in self.float16)
        options += "+compressed" if self.compressed else ""
        return f"{self.format}{options}" + (f":{','.join(self.names)}" if self.names else "")

    def arrays(self, frame: Frame) -> dict[str, NDArray[Any]]:
        """The arrays of a frame for this file, by their names in files. Raises FileError for floats beyond float16."""
        known = frame.arrays()
        held = {name: array for name, array in known.items() if name in (self.names or known)}
        halves = held if ALL in self.float16 else self.float16
        where = f"frame {frame.index}"
        return {name: to_float16(f"{where}: {name}", each) if name in halves else each for name, each in held.items()}


def to_float16(where: str, array: NDArray[Any]) -> NDArray[Any]:
    """Convert floats to float16, except times, which have one axis. Raises FileError for values beyond the range of
    float16; where: start of the message.
    """
    if array.dtype.kind != "f" or array.ndim < 2:  # times keep their digits
        return array
    with np.errstate(over="ignore"):  # values that become infinite are rejected next
        half = array.astype(np.float16)
    check_values(where, "sizes must be at most 65504 in float16", array, np.isinf(half) & np.isfinite(array))
    return half


@dataclass(frozen=True, eq=False)
class Shot:
    """Content of a file of ground truth.

    views: one frame, both views of a stereo pair, or () for a file of a whole scene; scene: one with a resolution, if
    known; color: color space of the radiance.
    """

    views: tuple[Frame, ...]
    scene: Scene | None
    color: Color = SRGB


@dataclass(frozen=True)
class TruthFormat:
    """A format of ground truth.

    name: pattern of file names, such as "{stem}_{array}.flo", or the folder of files of a whole scene. write: called
    with a path, the content, and the file that a user asked for, which has a single name if `per` is "array". per:
    content of one file: both views of a stereo pair ("frame"), one view, one array of a view, or the whole scene.
    arrays: names in files of the arrays that it can hold. besides: other attributes of a frame, by which known pixels
    are marked. options: some of "compressed" and "float16". needs: a module, and the extra of clsco that installs it.
    """

    name: str
    write: Callable[[Path, Shot, TruthFile], None]
    per: Literal["frame", "view", "array", "scene"] = "view"
    arrays: tuple[str, ...] = tuple(ATTRIBUTES)
    besides: tuple[str, ...] = ()
    options: tuple[str, ...] = ()
    needs: tuple[str, str] | None = None


def array_names(truth: str | Iterable[str]) -> tuple[str, ...]:
    """Names in files of requested arrays, in their fixed order: "blur_radius" becomes "coc".

    truth: attributes or names in files, an iterable or a comma-separated text, or "all". Raises SceneError.
    """
    attributes = attributes_of(ALL_TRUTH if truth == ALL else truth, [*OUTPUTS])
    return tuple(name for name, attribute in ATTRIBUTES.items() if attribute in attributes)


def parse_types(text: str, known: Mapping[str, Sequence[str]]) -> dict[str, str]:
    """Types in which arrays are stored, by the array's name.

    text: such as "color=float32,depth=float16"; "all=float16" applies to every array that is not named and can have
    this type. known: types that each array can have. Raises SceneError with a message for each fault.
    """
    types: dict[str, str] = {}
    faults = []
    every = {dtype for dtypes in known.values() for dtype in dtypes}
    for part in text.split(",") if text else ():
        name, _, dtype = part.partition("=")
        dtypes = sorted(every) if name == ALL else known.get(name)
        if dtypes is None:
            faults.append(f"types: must name arrays, some of {', '.join(known)}; got {part}")
        elif dtype not in dtypes:
            faults.append(f"types: {name} must be one of {', '.join(dtypes)}; got {part}")
        elif name in types:
            faults.append(f"types: must name each array once; got {name} twice")
        else:
            types[name] = dtype
    if faults:
        raise SceneError(faults)
    others = types.pop(ALL, "")
    return {name: others for name, dtypes in known.items() if others in dtypes} | types


def choose_files(truth: str, formats: str, types: str, known: Mapping[str, TruthFormat]) -> tuple[TruthFile, ...]:
    """Files of ground truth from options; empty without truth and formats.

    truth: such as "depth,coc"; "all", or "" with formats, means every array that the formats can hold. formats: names
    and options, such as "npz+compressed,exr"; by default "npz". types: float32 or float16, as for `parse_types`. Raises
    SceneError for unknown words, an array that no format can hold, and a format that can hold none.
    """
    if not (truth or formats):
        if types:
            raise SceneError(f"types: are those of arrays in files, which truth or format name; got {types} alone")
        return ()
    names = () if truth in (ALL, "") else array_names(truth)
    stored = parse_types(types, dict.fromkeys(ATTRIBUTES, FLOATS))
    halves = tuple(name for name, dtype in stored.items() if dtype == "float16")
    files_in_formats = [_in_format(part, names, halves, known) for part in (formats or "npz").split(",")]
    if lost := [name for name in names if all(name not in file.names for file in files_in_formats)]:
        raise SceneError(f"format: must be one that holds {lost[0]}; got {formats or 'npz'}")
    files = tuple(dict.fromkeys(files_in_formats))
    if len({file.format for file in files}) < len(files):
        raise SceneError(f"format: must name each format once; got {formats}")
    return files


def _in_format(text: str, names: Sequence[str], halves: Sequence[str], known: Mapping[str, TruthFormat]) -> TruthFile:
    """The `TruthFile` for a format with options, such as "npz+compressed". It holds those of `names` that the format
    can hold; halves: names of arrays to store as float16.
    """
    form, *options = text.split("+")
    if form not in known:
        raise SceneError(f"format: must be some of {','.join(known)}; got {text}")
    if "float16" in options:
        raise SceneError(f"format: must be {form}, with types all=float16; got {text}")
    if unknown := [option for option in options if option != "compressed" or option not in known[form].options]:
        rule = f"{form} or {form}+compressed" if "compressed" in known[form].options else f"{form} without options"
        raise SceneError(f"format: must be {rule}; got {form}+{unknown[0]}")
    held = known[form].arrays
    chosen = tuple(name for name in ATTRIBUTES if name in names and name in held)
    if names and held and not chosen:
        raise SceneError(f"format: {form} must hold some of {','.join(names)}; got {','.join(held)}")
    shared = tuple(name for name in halves if name in (chosen or held) and "float16" in known[form].options)
    float16 = (ALL,) if shared and len(shared) == len(chosen or held) else shared
    return TruthFile(form, chosen, float16, "compressed" in options)
