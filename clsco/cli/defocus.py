"""Implementation of `clsco defocus`: makes scenes from an image and its depth map, and writes one image file."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.cli.inputs import prepare_file
from clsco.errors import SceneError
from clsco.files.atomic import raise_file_error
from clsco.files.color import SRGB, Color
from clsco.files.images import WRITERS, check_same_size, image_size, writer_for
from clsco.files.transfer import encode
from clsco.inputs.depth_files import DEPTH_FORMATS
from clsco.inputs.files import shared_files
from clsco.scene.changes import override
from clsco.scene.model import Camera, DepthMap, Scene
from clsco.scene.sweep import Sweep, parse_sweep

WHERE = "defocus"
_OTHER_IMAGES = (".bmp", ".gif", ".hdr", ".jpeg", ".jpg", ".npy", ".npz", ".pfm", ".ppm", ".webp")
Files = Mapping[str, str]
"""Keys of a depth map that name its files and their layers; paths are absolute."""

_CAMERA = ("focal_length", "f_number", "focus_distance", "pixel_pitch")  # options that are keys of [camera]


def layer_files(image: Path, depth: Path) -> Files:
    return {"texture": str(image.absolute()), "depth": str(depth.absolute())}


def scenes_from_files(layers: Sequence[Files], options: Mapping[str, Any], overrides: Sequence[str] = ()) -> Sweep:
    """Make scenes of images and depth maps: one for each combination of values in `overrides`. Raises SceneError.

    layers: files of each image with its depth map. options: values of keys of the depth maps and the camera, None for a
    missing key; instead of `pixel_pitch`, the width of the image on the sensor in mm, `sensor_width`, or its angle in
    degrees, `fov`. overrides: as for `clsco.load_sweep`; they are applied after the options.
    """
    keys = {key: value for key, value in options.items() if value is not None}
    width, angle = keys.pop("sensor_width", None), keys.pop("fov", None)
    if [width, angle, keys.get("pixel_pitch")].count(None) < 2:
        raise SceneError("--pixel-pitch, --sensor-width, --fov: must be only one of them; got more")
    if angle is not None:
        width = 2.0 * keys.get("focal_length", Camera().focal_length) * math.tan(math.radians(angle) / 2.0)
    if width is not None:
        keys["pixel_pitch"] = width / image_size(layers[0]["texture"])[0]
    camera = {key: keys.pop(key) for key in _CAMERA if key in keys}
    names = ("image", *(f"layer {number}" for number in range(1, len(layers))))
    objects = [{"shape": "depth_map", "name": name, **keys, **files} for name, files in zip(names, layers, strict=True)]
    data = {"object": objects, "camera": camera}
    override(data, overrides, WHERE)
    return parse_sweep(data, WHERE)


def check_pair(scene: Scene) -> None:
    """Read an image and its depth map. Raises FileError if either cannot be read, or if their sizes differ."""
    for item in scene.objects:
        if isinstance(item, DepthMap):
            rows, columns = shared_files().depth(item.inputs()["depth"]).shape
            files = item.files()
            if "texture" in files:
                check_same_size(files["texture"], files["depth"], (columns, rows), DEPTH_FORMATS)


def is_image_file(out: Path) -> bool:
    """True if OUT names an image file, False if a folder. Raises FileError for a format that cannot be written."""
    suffix = out.suffix.lower()
    if out.is_dir():
        return False
    if suffix not in WRITERS and suffix in _OTHER_IMAGES:
        raise_file_error(out, f"must be a folder, or end in one of {' '.join(WRITERS)}", repr(out.suffix))
    return suffix in WRITERS


def prepare_image(scenes: Sequence[Scene], out: Path) -> None:
    """Make the folder of OUT, and check OUT: it can be written, it is no input, and there is only one image for it."""
    count = sum(scene.sequence.frames * (1 if scene.stereo is None else 2) for scene in scenes)
    if count != 1:
        raise SceneError(f"{out}: a file takes one image, a folder takes more; got {count}")
    named = [Path(name) for _, item in scenes[0].inputs for name in item.files().values()]
    prepare_file(out, named, "the image or the depth")


def write_color(out: Path, image: NDArray[np.float32], bits: int, transfer: str, color: Color = SRGB) -> None:
    """Write linear radiance to a file, in the format of its extension, with the color space of the source image.

    bits: bits per value of the source image, 8, 16 or 32. A file of codes has as many bits, or the most that the format
    can store. Linear float32 is stored in formats of floats, if `bits` is 32 or the format has no codes. transfer:
    curve of codes, "srgb" or "linear".
    """
    writer = writer_for(out)
    as_floats = writer.floats and (bits == 32 or not writer.code_bits)
    writer.save(
        out, image if as_floats else encode(image, min(bits, writer.code_bits), color.transfer(transfer)), color
    )
