"""The files of a frame, or of the two views of a stereo pair: written together, and found whole again."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.files.atomic import remove, sha256, together
from clsco.files.images import write_exr, write_json, write_npz, write_png
from clsco.files.transfer import encode
from clsco.frame.frame import STEREO_NAMES, TRUTH_NAMES, Frame


def frame_files(index: int, stereo: bool, truth: Sequence[str] = ()) -> set[str]:
    """Names of the files of a frame besides its JSON file.

    truth: any of "npz" and "exr". A stereo pair has a PNG and an NPZ of each view, and one EXR of both.
    """
    stem = f"frame_{index:04d}"
    apart = [f"{stem}_left", f"{stem}_right"] if stereo else [stem]
    names = {f"{own}.{suffix}" for own in apart for suffix in ("png", *truth) if suffix != "exr"}
    return names | ({f"{stem}.exr"} if "exr" in truth else set())


def exr_channels(frame: Frame) -> dict[str, NDArray[Any]]:
    """Name a frame's arrays as channels R G B A, Z, coc, sharp.R, N.X, flow.u, id, mask, filled, hidden.

    A stereo pair has disparity and occluded, too. A gray frame has R, G and B, so that every reader shows it. A is 1:
    a photograph covers all of its pixels.
    """

    def split(layer: str, names: str, array: NDArray[Any] | None) -> dict[str, NDArray[Any]]:
        if array is None:
            return {}
        return {layer + name: array if array.ndim == 2 else array[..., n] for n, name in enumerate(names)}

    single: dict[str, NDArray[Any] | None] = {"Z": frame.depth, "coc": frame.coc, "id": frame.object_id}
    single |= {"mask": frame.mask, "filled": frame.filled, "hidden": frame.hidden}
    single |= {"disparity": frame.disparity, "occluded": frame.occluded}
    return {
        **split("", "RGB", frame.color),
        "A": np.ones(frame.color.shape[:2], np.float32),
        **{name: channel for name, channel in single.items() if channel is not None},
        **split("sharp.", "RGB", frame.sharp),
        **split("N.", "XYZ", frame.normal),
        **split("flow.", "uv", frame.flow),
    }


def write_frame(
    folder: str | os.PathLike[str], views: Sequence[Frame], bits: int, transfer: str, truth: Sequence[str] = (),
    about: Mapping[str, Any] | None = None,
) -> dict[str, Any]:  # fmt: skip
    """Write the files of a frame; frame_0000.json comes last and makes the frame complete.

    Parameters
    ----------
    folder : path
    views : sequence of Frame
        One frame, or the left and the right one of a stereo pair, whose files are frame_0000_left.png and so on; an EXR
        holds both, as the views left and right.
    bits : {8, 16, 32}
        Of the textures; 32 makes a PNG of 16.
    transfer : {"srgb", "linear"}
        Of the PNG alone, which clips radiance below 0 and above 1; the others keep it.
    truth : sequence of {"npz", "exr"}
        Each holds the color and all truth of the frame, linear.
    about : mapping, optional
        Content of the JSON file besides the frame's own metadata.

    Returns
    -------
    dict
        Content of the JSON file: `about`, the metadata (of a pair `views` with that of each), and `files`, file name to
        SHA-256.

    Raises
    ------
    ImageError
        A file cannot be written.

    Notes
    -----
    All files get their names when all are on the disk; until then an older frame stays as it is.
    """
    index, stereo = views[0].index, len(views) > 1
    stem = f"frame_{index:04d}"
    described = Path(folder) / f"{stem}.json"
    with together(Path(folder), stem) as made:
        for frame in views:
            own = f"{stem}_{frame.eye}" if stereo else stem
            write_png(made / f"{own}.png", encode(frame.color, min(bits, 16), transfer))
            if "npz" in truth:
                arrays = {name: getattr(frame, name) for name in ("color", *TRUTH_NAMES, *STEREO_NAMES)}
                write_npz(made / f"{own}.npz", {name: array for name, array in arrays.items() if array is not None})
        if "exr" in truth:
            eyes = tuple(frame.eye for frame in views) if stereo else ()
            write_exr(made / f"{stem}.exr", *map(exr_channels, views), names=eyes)
        digests = {path.name: sha256(path) for path in sorted(made.iterdir())}
        remove(described)  # an older frame is not whole any more
    recorded = {"views": {frame.eye: dict(frame.metadata) for frame in views}} if stereo else dict(views[0].metadata)
    content = {**(about or {}), **recorded, "files": digests}
    write_json(described, content)
    return content


def read_complete(folder: str | os.PathLike[str], index: int) -> dict[str, Any] | None:
    """JSON content of a frame on disk if all files that it names are there, unchanged; else None."""
    described = Path(folder) / f"frame_{index:04d}.json"

    def is_as_recorded(name: str, digest: str) -> bool:
        path = described.parent / name  # to open a pipe would block for ever
        return path.name == name and path.is_file() and sha256(path) == digest

    try:
        content: dict[str, Any] = json.loads(described.read_bytes() if described.is_file() else b"")
        whole = all(is_as_recorded(name, digest) for name, digest in content["files"].items())
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return None
    return content if whole else None
