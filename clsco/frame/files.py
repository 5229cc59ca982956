"""The files of a frame, or of the two views of a stereo pair: written together, and checked for completeness."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.errors import require_extra
from clsco.files.archives import npy_bytes
from clsco.files.atomic import atomic_folder, atomic_write_bytes, make_writable_folder, remove_file, sha256
from clsco.files.cameras import colmap_texts
from clsco.files.color import SRGB, Color
from clsco.files.images import write_exr, write_json, write_npz, write_png, write_tiff
from clsco.files.transfer import encode
from clsco.files.truth_codes import flo_bytes, kitti_depth_codes, kitti_disparity_codes, kitti_flow_codes, pfm_bytes
from clsco.frame.cameras import all_pinholes, exr_attributes, eye_of, mark_behind_lens
from clsco.frame.channels import exr_channels
from clsco.frame.frame import Frame
from clsco.frame.outputs import ALL_TRUTH, ATTRIBUTES, FILE_NAMES, IMAGE_NAMES, OUTPUTS, SENSOR_NAMES
from clsco.frame.truth_files import Shot, TruthFile, TruthFormat, choose_files
from clsco.optics.motion import Eye
from clsco.resources import read_regular
from clsco.scene.model import Scene


def _single(shot: Shot, file: TruthFile) -> NDArray[Any]:
    """The only array of a file that holds a single array."""
    (frame,) = shot.views
    (array,) = file.arrays(frame).values()
    return array


def _write_npz(path: Path, shot: Shot, file: TruthFile) -> None:
    (frame,) = shot.views
    write_npz(path, file.arrays(frame), file.compressed)


def _write_exr(path: Path, shot: Shot, file: TruthFile) -> None:
    channels = [exr_channels(_per_pixel(shot, frame, file.arrays(frame))) for frame in shot.views]
    names = [frame.eye for frame in shot.views] if len(shot.views) > 1 else ()
    known = [] if shot.scene is None else [exr_attributes(shot.scene, view.index, eye_of(view)) for view in shot.views]
    if not shot.color.is_plain:  # replace the chromaticities, or omit them if only an ICC profile states the primaries
        others = known or [{}] * len(shot.views)
        known = [{k: v for k, v in about.items() if k != "chromaticities"} for about in others]
        known = [about | shot.color.exr_attributes() for about in known]
    write_exr(path, *channels, names=names, attributes=known)


def _per_pixel(shot: Shot, frame: Frame, arrays: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """The arrays of a frame with its row times repeated for each pixel, because an EXR holds only arrays of pixels."""
    times = arrays.pop("row_time", None)
    if times is None or shot.scene is None:
        return arrays
    lines = times if shot.scene.sequence.by_columns else times[:, None]
    return arrays | {"row_time": np.broadcast_to(lines, frame.color.shape[:2])}


def _write_npy(path: Path, shot: Shot, file: TruthFile) -> None:
    atomic_write_bytes(path, npy_bytes(_single(shot, file)))


def _write_pfm(path: Path, shot: Shot, file: TruthFile) -> None:
    array = _single(shot, file)
    if file.names[0] in (*_FLOWS, "disparity"):  # unknown values are 0 in frames, +inf in files
        vectors = array.reshape(*array.shape[:2], -1)
        known = _known(shot, file)[..., None] & np.isfinite(vectors).all(axis=-1, keepdims=True)
        array = np.where(known, vectors, np.float32(np.inf)).reshape(array.shape)
    atomic_write_bytes(path, pfm_bytes(array, str(path)))


def _write_codes(path: Path, shot: Shot, file: TruthFile) -> None:
    write_png(path, _single(shot, file))


def _write_code_tiff(path: Path, shot: Shot, file: TruthFile) -> None:
    write_tiff(path, _single(shot, file))


def _write_flo(path: Path, shot: Shot, file: TruthFile) -> None:
    atomic_write_bytes(path, flo_bytes(_single(shot, file), _known(shot, file), str(path)))


def _write_kitti_flow(path: Path, shot: Shot, file: TruthFile) -> None:
    write_png(path, kitti_flow_codes(_single(shot, file), _known(shot, file), str(path)))


def _write_kitti_disparity(path: Path, shot: Shot, file: TruthFile) -> None:
    write_png(path, kitti_disparity_codes(_single(shot, file), _known(shot, file), str(path)))


def _write_kitti_depth(path: Path, shot: Shot, file: TruthFile) -> None:
    write_png(path, kitti_depth_codes(_single(shot, file), str(path)))


def _write_colmap(folder: Path, shot: Shot, _wanted: TruthFile) -> None:
    scene = shot.scene
    assert scene is not None
    shown: dict[Eye, str] = {"left": "left" if scene.stereo else "", "right": "right"}
    texts = colmap_texts((f"{_stem(index, shown[eye])}.png", camera) for index, eye, camera in all_pinholes(scene))
    with atomic_folder(make_writable_folder(folder), "model") as temporary:
        for name, content in texts.items():
            atomic_write_bytes(temporary / name, content)


def _known(shot: Shot, file: TruthFile) -> NDArray[np.bool_]:
    """Mask of pixels with known flow or disparity: they show a surface, which for flow remains in front of the lens."""
    (frame,), (name,) = shot.views, file.names
    assert frame.mask is not None  # as `besides` of the format names it
    if name not in _FLOWS or shot.scene is None or not shot.scene.moves:
        return frame.mask
    return frame.mask & ~mark_behind_lens(shot.scene, frame, 1 if name == "flow" else -1)


_WITHOUT = (*SENSOR_NAMES, "subframes")
# Arrays of floats that a PFM can hold: one to three per pixel.
_FLOATS = tuple(FILE_NAMES[name] for name, each in OUTPUTS.items() if each.dtype is np.float32 and name not in _WITHOUT)
_FLOWS, _WHERE_FLOW_HOLDS = ("flow", "flow_backward"), ("mask", "depth", "object_id")
LARGEST_JSON = 2**22  # largest JSON file of a frame, bytes; 64 objects with all of their keys take a fiftieth
# One row for each format, by name; `clsco render --format` takes its names from here.
TRUTH_FORMATS = {
    "npz": TruthFormat("{stem}.npz", _write_npz, options=("float16", "compressed")),
    "exr": TruthFormat("{stem}.exr", _write_exr, "frame", options=("float16",), needs=("OpenEXR", "exr")),
    "npy": TruthFormat("{stem}_{array}.npy", _write_npy, "array", options=("float16",)),
    "pfm": TruthFormat("{stem}_{array}.pfm", _write_pfm, "array", _FLOATS, _WHERE_FLOW_HOLDS),
    "flo": TruthFormat("{stem}_{array}.flo", _write_flo, "array", _FLOWS, _WHERE_FLOW_HOLDS),
    "kitti_flow": TruthFormat("{stem}_kitti_{array}.png", _write_kitti_flow, "array", _FLOWS, _WHERE_FLOW_HOLDS),
    "kitti_disparity": TruthFormat(
        "{stem}_kitti_{array}.png", _write_kitti_disparity, "array", ("disparity",), ("mask",)
    ),
    "kitti_depth": TruthFormat("{stem}_kitti_{array}.png", _write_kitti_depth, "array", ("depth",)),
    "png": TruthFormat("{stem}_{array}.png", _write_codes, "array", ("raw",)),
    "tiff": TruthFormat("{stem}_{array}.tif", _write_code_tiff, "array", ("raw",), needs=("tifffile", "formats")),
    "colmap": TruthFormat("sparse/0", _write_colmap, "scene", ()),
}  # fmt: skip


def files_of(truth: str, formats: str = "", types: str = "") -> tuple[TruthFile, ...]:
    """Files of ground truth for a user's options; arguments and errors are those of `choose_files`."""
    return choose_files(truth, formats, types, TRUTH_FORMATS)


def needed_truth(files: Iterable[TruthFile]) -> tuple[str, ...]:
    """Attributes of a frame besides color that the files need, in the order of the frame."""
    needed: set[str] = set()
    for file in files:
        known = TRUTH_FORMATS[file.format]
        needed |= {ATTRIBUTES[name] for name in file.names or known.arrays if file.names or name not in IMAGE_NAMES}
        needed |= set(known.besides)
    return tuple(name for name in (*ALL_TRUTH, *IMAGE_NAMES) if name in needed)


def require_truth_formats(files: Sequence[TruthFile]) -> None:
    """Raise MissingDependencyError if the extra for a format in `TRUTH_FORMATS` is not installed."""
    for file in files:
        if needs := TRUTH_FORMATS[file.format].needs:
            require_extra(f"format {file}", *needs)


def _stem(index: int, eye: str) -> str:
    """Stem of the file names of a frame, or of a view of a stereo pair."""
    return f"frame_{index:04d}_{eye}" if eye else f"frame_{index:04d}"


def _pictures(stem: str, subframes: int) -> list[str]:
    """Names of the PNG files of a view: its image and its sub-frames."""
    return [f"{stem}.png", *(f"{stem}_sample_{number:02d}.png" for number in range(subframes))]


def _truth_names(
    index: int, eyes: Sequence[str], file: TruthFile, held: Collection[str]
) -> Iterator[tuple[str, tuple[str, ...], TruthFile]]:
    """For each file that `file` stands for: its name, the eyes in it, and a `TruthFile` with the arrays that it holds.
    In formats with a file per array, only arrays in `held` have a file.
    """
    known = TRUTH_FORMATS[file.format]
    if known.per == "frame":
        yield known.name.format(stem=_stem(index, "")), tuple(eyes), file
    for eye in eyes:
        stem = _stem(index, eye if len(eyes) > 1 else "")
        if known.per == "view":
            yield known.name.format(stem=stem), (eye,), file
        for array in (file.names or known.arrays) if known.per == "array" else ():
            if array in held:
                yield known.name.format(stem=stem, array=array), (eye,), replace(file, names=(array,))


def frame_files(
    index: int, stereo: bool, truth: Sequence[TruthFile] = (), subframes: int = 0, held: Collection[str] = ("color",)
) -> set[str]:
    """Names of a frame's files besides its JSON file. held: names in files of the arrays that the frame has; without
    "color" it has no PNG.
    """
    eyes = ("left", "right") if stereo else ("",)
    pictured = eyes if "color" in held else ()
    names = {name for eye in pictured for name in _pictures(_stem(index, eye), subframes)}
    return names | {name for file in truth for name, _, _ in _truth_names(index, eyes, file, held)}


def frame_json(folder: str | os.PathLike[str], index: int) -> Path:
    """Path of the JSON file that describes a frame; this file is written last."""
    return Path(folder) / f"frame_{index:04d}.json"


def write_frame(
    folder: str | os.PathLike[str], views: Sequence[Frame], bits: int, transfer: str, truth: Sequence[TruthFile] = (),
    about: Mapping[str, Any] | None = None, scene: Scene | None = None, color: Color = SRGB,
) -> dict[str, Any]:  # fmt: skip
    """Write the files of a frame; the JSON file comes last and makes the frame complete. Returns the JSON's content.

    views: one frame, or the left and the right one of a stereo pair, whose files are frame_0000_left.png and so on; an
    EXR holds both. Sub-frames are frame_0000_sample_00.png and so on. bits: bits of the textures, 8, 16 or 32; the PNG
    has 16 for 32. transfer: curve of the PNG, "srgb" or "linear". The PNG clips radiance to 0 to 1; the other files are
    linear and do not clip. truth: files to write; those that are written once per scene (`write_scene_files`) are
    skipped. about: additional content of the JSON file. scene: one with a resolution, for the attributes of an EXR.
    color: color space of the image, whose curve replaces "srgb"; unless it is sRGB, the JSON file has its name, and an
    EXR its chromaticities.

    Raises FileError if a file cannot be written, or values do not fit its format. Files are renamed when all are
    complete on the disk; until then an older frame stays unchanged.
    """
    index, stereo = views[0].index, len(views) > 1
    by_eye = {frame.eye: frame for frame in views}
    held = {in_file for name, in_file in FILE_NAMES.items() if all(getattr(view, name) is not None for view in views)}
    described, curve = frame_json(folder, index), color.transfer(transfer)
    with atomic_folder(Path(folder), _stem(index, "")) as temporary:
        for eye, frame in by_eye.items():
            images = [frame.color, *(() if frame.subframes is None else frame.subframes)] if "color" in held else []
            stem = _stem(index, eye if stereo else "")
            for name, image in zip(_pictures(stem, len(images) - 1), images, strict=bool(images)):
                write_png(temporary / name, encode(image, min(bits, 16), curve), color)
        for file in truth:
            for name, eyes, part in _truth_names(index, list(by_eye), file, held):
                shot = Shot(tuple(by_eye[eye] for eye in eyes), scene, color)
                TRUTH_FORMATS[file.format].write(temporary / name, shot, part)
        digests = {path.name: sha256(path) for path in sorted(temporary.iterdir())}
        remove_file(described)  # from now on, an older frame is incomplete
    recorded = {"views": {frame.eye: dict(frame.metadata) for frame in views}} if stereo else dict(views[0].metadata)
    partial = [str(file) for file in truth if str(file) != file.format]
    profile = {} if color.is_plain else {"color_profile": color.name}
    content = {**(about or {}), **recorded, **({"truth": partial} if partial else {}), **profile, "files": digests}
    write_json(described, content)
    return content


def write_scene_files(folder: str | os.PathLike[str], scene: Scene, truth: Sequence[TruthFile]) -> None:
    """Write the ground-truth files that cover all frames of a scene; scene: one with a resolution. Raises FileError."""
    for file in truth:
        known = TRUTH_FORMATS[file.format]
        if known.per == "scene":
            known.write(Path(folder) / known.name, Shot((), scene), file)


def read_complete(folder: str | os.PathLike[str], index: int) -> dict[str, Any] | None:
    """Content of the JSON file of a frame, if all files that it names exist unchanged, else None."""
    described = frame_json(folder, index)

    def is_as_recorded(name: str, digest: str) -> bool:
        path = described.parent / name
        return path.name == name and sha256(path) == digest

    try:
        content: dict[str, Any] = json.loads(read_regular(described, LARGEST_JSON, follow=True))
        whole = all(is_as_recorded(name, digest) for name, digest in content["files"].items())
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return None
    return content if whole else None


def holds_truth(content: Mapping[str, Any], truth: Sequence[TruthFile]) -> bool:
    """True if a frame's files hold the requested ground truth, judged only by the content of its JSON file."""
    recorded = content.get("truth")
    texts = [text for text in recorded if isinstance(text, str)] if isinstance(recorded, list) else []
    partial = {re.split("[+:]", text)[0]: text for text in texts}
    return all(partial.get(file.format, file.format) == str(file) for file in truth)
