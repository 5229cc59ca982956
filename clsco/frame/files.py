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
    """Write frame_0000.png, .npz and .exr as asked, and last frame_0000.json: the frame is complete.

    views: one frame, or the left and the right one of a stereo pair, whose files are frame_0000_left.png and so on; an
    EXR holds both, as the views left and right. bits: 8, 16 or 32, as the textures have; 32 makes a PNG of 16.
    transfer: "srgb" or "linear", of the PNG alone. truth: any of "npz" and "exr"; each holds the color and all truth
    that the frame has, in linear light. Light below 0 or above 1 is clipped in the PNG and kept in the others.
    about: what the JSON file says besides the frame's own metadata.
    Returns the content of the JSON file: `about`, the metadata (of a pair: `views` with that of each), and `files`:
    file name -> SHA-256.
    Raises ImageError where a file cannot be written. All files get their names when all are on the disk; until then
    an older frame stays as it is.
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
    told = {"views": {frame.eye: dict(frame.metadata) for frame in views}} if stereo else dict(views[0].metadata)
    content = {**(about or {}), **told, "files": digests}
    write_json(described, content)
    return content


def read_complete(folder: str | os.PathLike[str], index: int) -> dict[str, Any] | None:
    """Give the JSON content of a frame on disk if all files that it names are there, unchanged; else None."""
    described = Path(folder) / f"frame_{index:04d}.json"

    def is_as_told(name: str, digest: str) -> bool:
        path = described.parent / name  # to open a pipe would block for ever
        return path.name == name and path.is_file() and sha256(path) == digest

    try:
        content: dict[str, Any] = json.loads(described.read_bytes() if described.is_file() else b"")
        whole = all(is_as_told(name, digest) for name, digest in content["files"].items())
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return None
    return content if whole else None
