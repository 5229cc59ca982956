"""Folders of frames, as `clsco render` writes them; the files may be untrusted."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.errors import FileError, SceneError
from clsco.files.arrays import read_exr, read_npz
from clsco.files.atomic import raise_file_error
from clsco.files.decoders import IMAGE_FORMATS
from clsco.files.images import read_image
from clsco.files.transfer import TRANSFERS
from clsco.frame.channels import channel_names
from clsco.frame.files import LARGEST_JSON, frame_json
from clsco.resources import read_regular

MOST_FAULTS = 20
_COMPONENTS = {"color": ((), (3,)), "sharp": ((), (3,)), "coc": ((), (3,)), "flow": ((2,),)}


@dataclass(frozen=True)
class FrameFolder:
    """Frames of one scene, with consecutive `numbers`.

    eyes: ("",), or ("left", "right") for stereo pairs; interval: seconds between frames; transfer: curve of the PNG
    files; of: number of frames that the whole scene has; scenes: `scene_sha256` of the frames, a single one if all
    frames are of the same scene.
    """

    folder: Path
    numbers: range
    eyes: tuple[str, ...]
    interval: float
    transfer: str
    of: int
    scenes: frozenset[str]

    def images(self, eye: str = "") -> Iterator[NDArray[Any]]:
        """Codes of each frame's PNG, (rows, columns[, 3]). Raises the errors of `read_image`."""
        for number in self.numbers:
            yield read_image(self._file(number, "png", eye)).data

    def arrays(self, name: str, eye: str = "") -> Iterator[NDArray[np.floating]]:
        """An array of each frame, float32, from its NPZ or EXR; name: as in files, such as "coc". Raises FileError."""
        for number in self.numbers:
            npz, exr = self._file(number, "npz", eye), self._file(number, "exr", "")
            if npz.exists():
                array = read_npz(npz, [name])[name]
                where = npz
            elif exr.exists():
                planes = _exr_planes(exr, name, eye)
                array = np.stack(planes, axis=-1) if len(planes) > 1 else planes[0]
                where = exr
            else:
                raise_file_error(self.folder, f"must hold {npz.name} or {exr.name}, with {name}", "neither")
            if array.shape[2:] not in _COMPONENTS.get(name, ((),)):
                raise_file_error(where, f"{name} must have its channels", f"shape {array.shape}")
            yield array.astype(np.float32, copy=False)

    def has(self, name: str, eye: str = "") -> bool:
        """True if the first frame has an array `name`."""
        try:
            next(self.arrays(name, eye))
        except FileError:
            return False
        return True

    def _file(self, number: int, suffix: str, eye: str) -> Path:
        return self.folder / f"{frame_json(self.folder, number).stem}{'_' if eye else ''}{eye}.{suffix}"


def _exr_planes(path: Path, name: str, eye: str) -> list[NDArray[Any]]:
    """Planes of the channels of an array; of blur radii, one for each color if the file has these. Raises FileError."""
    try:
        return read_exr(path, channel_names(name), eye)
    except FileError as error:
        if name != "coc":
            raise
        try:
            return read_exr(path, channel_names(name, 3), eye)
        except FileError:
            raise error from None


def read_frame_folder(folder: Path, only: range | None = None) -> FrameFolder:
    """List the frames of a folder, or those with numbers in `only`, from their JSON files.

    Raises SceneError with all faults: missing frames and PNG files, invalid JSON, and frames that differ from the first
    one in interval, transfer curve or number of views.
    """
    try:
        numbers = sorted(number for number in _numbers(folder) if only is None or number in only)
    except OSError as error:
        raise_file_error(folder, "must be a folder of frames", error, error)
    if not numbers:
        raise SceneError(f"{folder}: must hold frames from clsco render, frame_0000.json and so on; got none")
    faults = [
        f"{frame_json(folder, one + 1)}: must be there, as a clip has no hole in its frames; got {one} and then {other}"
        for one, other in pairwise(numbers)
        if other != one + 1
    ]
    facts: dict[int, tuple[float, str, bool, int]] = {}
    scenes = set()
    for number in numbers:
        path = frame_json(folder, number)
        content = _content(path, faults)
        if content is None:
            continue
        scenes.add(str(content.get("scene_sha256")))
        facts[number] = known = _known(content, path, faults)
        first = facts[min(facts)]
        if known[:3] != first[:3]:
            rule = f"must have the interval, transfer and views of frame {min(facts)}, {_describe(first)}"
            faults.append(f"{path}: {rule}; got {_describe(known)}")
        stem = path.with_suffix("").name
        for name in (f"{stem}_left.png", f"{stem}_right.png") if known[2] else (f"{stem}.png",):
            if not (folder / name).is_file():
                faults.append(f"{folder / name}: must be there, as {path.name} is; got none")
    if faults:
        more = [f"{folder}: and {len(faults) - MOST_FAULTS} more faults"] if len(faults) > MOST_FAULTS else []
        raise SceneError(faults[:MOST_FAULTS] + more)
    interval, transfer, is_stereo, count = facts[numbers[0]]
    eyes = ("left", "right") if is_stereo else ("",)
    whole = range(numbers[0], numbers[-1] + 1)
    return FrameFolder(folder, whole, eyes, interval, transfer, count, frozenset(scenes))


def plain_images(folder: Path) -> list[Path]:
    """Images of a folder without frames of `clsco render`, in natural order, such as a2.png before a10.png."""
    if not folder.is_dir() or any(folder.glob("frame_*.json")):
        return []
    paths = [path for path in folder.iterdir() if path.suffix.lower() in IMAGE_FORMATS and path.name[0] != "."]
    pieces = {path: re.split("([0-9]+)", path.name) for path in paths}  # every second one is a number
    return sorted(paths, key=lambda path: ([int(each) if each.isdecimal() else each for each in pieces[path]], path))


def _numbers(folder: Path) -> Iterator[int]:
    """Numbers of the frames that have a JSON file or a PNG."""
    matches = (re.fullmatch(r"frame_([0-9]{4,9})(_left|_right)?\.(?:json|png)", path.name) for path in folder.iterdir())
    numbers = {match[1] for match in matches if match}
    return (int(text) for text in numbers if text == f"{int(text):04d}")


def _content(path: Path, faults: list[str]) -> Mapping[str, Any] | None:
    """The content of a JSON file; if it is invalid, None, and a message is added to `faults`."""
    try:
        content = json.loads(read_regular(path, LARGEST_JSON, follow=True))
    except OSError as error:
        faults.append(f"{path}: must be there and readable, as it makes its frame whole; got {error.strerror}")
    except (ValueError, RecursionError) as error:
        faults.append(f"{path}: must be JSON; got {type(error).__name__}")
    else:
        if isinstance(content, dict):
            return content
        faults.append(f"{path}: must be a table; got {type(content).__name__}")
    return None


def _known(content: Mapping[str, Any], path: Path, faults: list[str]) -> tuple[float, str, bool, int]:
    """Interval, transfer, True for a stereo pair, and number of frames; for an invalid value a default, and a fault."""

    scene = content.get("scene")
    if not isinstance(scene, dict):
        faults.append(f"{path}: scene: must be a table, as clsco render writes it; got {type(scene).__name__}")
        scene = {}

    def value(table: str, key: str, default: Any, is_right: Callable[[Any], bool]) -> Any:
        inner = scene.get(table, {})
        value_of_key = inner.get(key, default) if isinstance(inner, dict) else None
        if is_right(value_of_key):
            return value_of_key
        faults.append(f"{path}: scene.{table}.{key}: must be one of a scene; got {str(value_of_key)[:40]}")
        return default

    interval = value("sequence", "interval", 1.0, lambda time: type(time) in (int, float) and 0 < time < math.inf)
    transfer = value("image", "transfer", "srgb", lambda name: isinstance(name, str) and name in TRANSFERS)
    count = value("sequence", "frames", 1, lambda number: isinstance(number, int) and 0 < number <= 1_000_000)
    return float(min(interval, 1e300)), transfer, scene.get("stereo") is not None, count


def _describe(known: tuple[float, str, bool, int]) -> str:
    return f"{known[0]:g} s, {known[1]}, {'stereo' if known[2] else 'one view'}"
