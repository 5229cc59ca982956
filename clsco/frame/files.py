"""The files of a frame, or of the two views of a stereo pair: written together, and found whole again."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.errors import ImageError
from clsco.files.atomic import remove, sha256, together
from clsco.files.images import write_exr, write_json, write_npz, write_png
from clsco.files.transfer import encode
from clsco.frame.frame import STEREO_NAMES, Frame
from clsco.frame.truth_files import TruthFile, parse_truth


def exr_channels(frame: Frame, wanted: TruthFile | None = None) -> dict[str, NDArray[Any]]:
    """Name a frame's arrays as channels R G B A, Z, coc, sharp.R, N.X, flow.u, id, mask, filled, missing, hidden.

    A scene that moves has flow_backward.u and flow_occluded, one with textures on surfaces uv.u, a stereo pair
    disparity and occluded, too; sub-frames are sample_00.R and so on. A gray frame has R, G and B, so that every reader
    shows it. A is the alpha where it was requested, else 1: a photograph covers all of its pixels. wanted: which of the
    arrays, and how; by default all as they are.
    """
    arrays = (wanted or TruthFile("exr")).arrays(frame)
    color, plain = arrays.get("color"), ("coc", "mask", "filled", "missing", "hidden", "flow_occluded", *STEREO_NAMES)

    def split(layer: str, names: str, array: NDArray[Any] | None) -> dict[str, NDArray[Any]]:
        if array is None:
            return {}
        return {layer + name: array if array.ndim == 2 else array[..., n] for n, name in enumerate(names)}

    alpha = arrays.get("alpha")
    if alpha is None and color is not None:
        alpha = np.ones(color.shape[:2], color.dtype)
    subframes: dict[str, NDArray[Any]] = {}
    for number, image in enumerate(arrays.get("subframes", ())):
        subframes |= split(f"sample_{number:02d}.", "RGB", image)
    single = {"Z": "depth", "id": "object_id"} | {name: name for name in plain}
    return {
        **split("", "RGB", color),
        **({} if alpha is None else {"A": alpha}),
        **{channel: arrays[name] for channel, name in single.items() if name in arrays},
        **split("sharp.", "RGB", arrays.get("sharp")),
        **split("N.", "XYZ", arrays.get("normal")),
        **split("flow.", "uv", arrays.get("flow")),
        **split("flow_backward.", "uv", arrays.get("flow_backward")),
        **split("uv.", "uv", arrays.get("uv")),
        **subframes,
    }


def _write_npz(path: Path, views: Sequence[Frame], wanted: TruthFile) -> None:
    (frame,) = views
    write_npz(path, wanted.arrays(frame), wanted.compressed)


def _write_exr(path: Path, views: Sequence[Frame], wanted: TruthFile) -> None:
    channels = [exr_channels(frame, wanted) for frame in views]
    write_exr(path, *channels, names=[frame.eye for frame in views] if len(views) > 1 else ())


@dataclass(frozen=True)
class TruthFormat:
    """A format that holds the color of a frame with its truth, in linear radiance.

    Attributes
    ----------
    write : callable
        Takes a path, the views of one file, and what of them is wanted.
    joins_views : bool
        One file holds both views of a stereo pair; else each has its own.
    needs : (str, str), optional
        Module that it needs, and the extra of clsco that brings it.
    """

    write: Callable[[Path, Sequence[Frame], TruthFile], None]
    joins_views: bool = False
    needs: tuple[str, str] | None = None


# By extension, one row for each format: `clsco render --truth` takes its names from here.
TRUTH_FORMATS = {
    "npz": TruthFormat(_write_npz),
    "exr": TruthFormat(_write_exr, joins_views=True, needs=("OpenEXR", "exr")),
}


def truth_files(text: str) -> tuple[TruthFile, ...]:
    """Files of ground truth by their names, none for "". Raises SceneError as `parse_truth`."""
    return parse_truth(text, TRUTH_FORMATS) if text else ()


def require_truth_formats(files: Sequence[TruthFile]) -> None:
    """Raise ImageError where the extra that a format in `TRUTH_FORMATS` needs is not installed."""
    for file in files:
        needs = TRUTH_FORMATS[file.format].needs
        if needs is not None and find_spec(needs[0]) is None:
            got = "got no such module"
            raise ImageError(f"truth: {file.format} needs {needs[0]}: pip install 'clsco[{needs[1]}]'; {got}")


def _stems(index: int, eyes: Sequence[str]) -> list[str]:
    """Stem of the files of each view."""
    stem = f"frame_{index:04d}"
    return [f"{stem}_{eye}" for eye in eyes] if len(eyes) > 1 else [stem]


def _pictures(stem: str, subframes: int) -> list[str]:
    """Names of the PNG files of a view: its image, and those of its time samples."""
    return [f"{stem}.png", *(f"{stem}_sample_{number:02d}.png" for number in range(subframes))]


def frame_files(index: int, stereo: bool, truth: Sequence[TruthFile] = (), subframes: int = 0) -> set[str]:
    """Names of the files of a frame besides its JSON file; a stereo pair has a PNG of each view.

    Parameters
    ----------
    index : int
    stereo : bool
    truth : sequence of TruthFile
    subframes : int
        Time samples whose images are files, too.

    Returns
    -------
    set of str
    """
    apart = _stems(index, ("left", "right") if stereo else ("",))
    names = {name for own in apart for name in _pictures(own, subframes)}
    for file in truth:
        stems = [f"frame_{index:04d}"] if TRUTH_FORMATS[file.format].joins_views else apart
        names |= {f"{stem}.{file.format}" for stem in stems}
    return names


def frame_json(folder: str | os.PathLike[str], index: int) -> Path:
    """The file that describes a frame, which is written last."""
    return Path(folder) / f"frame_{index:04d}.json"


def write_frame(
    folder: str | os.PathLike[str], views: Sequence[Frame], bits: int, transfer: str, truth: Sequence[TruthFile] = (),
    about: Mapping[str, Any] | None = None,
) -> dict[str, Any]:  # fmt: skip
    """Write the files of a frame; frame_0000.json comes last and makes the frame complete.

    Parameters
    ----------
    folder : path
    views : sequence of Frame
        One frame, or the left and the right one of a stereo pair, whose files are frame_0000_left.png and so on; an EXR
        holds both, as the views left and right. Their sub-frames, if any, are frame_0000_sample_00.png and so on.
    bits : {8, 16, 32}
        Of the textures; 32 makes a PNG of 16.
    transfer : {"srgb", "linear"}
        Of the PNG alone, which clips radiance below 0 and above 1; the others keep it.
    truth : sequence of TruthFile
        Each holds the color and all truth of the frame, or what it names of them, linear.
    about : mapping, optional
        Content of the JSON file besides the frame's own metadata.

    Returns
    -------
    dict
        Content of the JSON file: `about`, the metadata (of a pair `views` with that of each), `truth`, what files of it
        hold where that is not all as it is, and `files`, file name to SHA-256.

    Raises
    ------
    ImageError
        A file cannot be written, or floats do not fit the float16 that is wanted.

    Notes
    -----
    All files get their names when all are on the disk; until then an older frame stays as it is.
    """
    index, stereo = views[0].index, len(views) > 1
    stem, apart = f"frame_{index:04d}", _stems(index, [frame.eye for frame in views])
    described = frame_json(folder, index)
    with together(Path(folder), stem) as made:
        for own, frame in zip(apart, views, strict=True):
            images = [frame.color, *(() if frame.subframes is None else frame.subframes)]
            for name, image in zip(_pictures(own, len(images) - 1), images, strict=True):
                write_png(made / name, encode(image, min(bits, 16), transfer))
        for file in truth:
            known = TRUTH_FORMATS[file.format]
            if known.joins_views:
                known.write(made / f"{stem}.{file.format}", views, file)
                continue
            for own, frame in zip(apart, views, strict=True):
                known.write(made / f"{own}.{file.format}", [frame], file)
        digests = {path.name: sha256(path) for path in sorted(made.iterdir())}
        remove(described)  # an older frame is not whole any more
    recorded = {"views": {frame.eye: dict(frame.metadata) for frame in views}} if stereo else dict(views[0].metadata)
    partial = [str(file) for file in truth if file != TruthFile(file.format)]
    content = {**(about or {}), **recorded, **({"truth": partial} if partial else {}), "files": digests}
    write_json(described, content)
    return content


def read_complete(folder: str | os.PathLike[str], index: int) -> dict[str, Any] | None:
    """JSON content of a frame on disk if all files that it names are there, unchanged; else None."""
    described = frame_json(folder, index)

    def is_as_recorded(name: str, digest: str) -> bool:
        path = described.parent / name  # to open a pipe would block for ever
        return path.name == name and path.is_file() and sha256(path) == digest

    try:
        content: dict[str, Any] = json.loads(described.read_bytes() if described.is_file() else b"")
        whole = all(is_as_recorded(name, digest) for name, digest in content["files"].items())
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return None
    return content if whole else None


def holds_truth(content: Mapping[str, Any], truth: Sequence[TruthFile]) -> bool:
    """Whether files of a frame hold what is wanted, by the content of its JSON file and by no more than their names."""
    recorded = content.get("truth")
    texts = [text for text in recorded if isinstance(text, str)] if isinstance(recorded, list) else []
    partial = {re.split("[+:]", text)[0]: text for text in texts}
    return all(partial.get(file.format, file.format) == str(file) for file in truth)
