"""What `clsco defocus` does: an image and its depth map to scenes, what the map leaves out, and one image file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from clsco.errors import ImageError, SceneError
from clsco.files.atomic import refuse, same_place, writable_folder
from clsco.files.images import codec, image_size, write_exr, write_png, write_tiff
from clsco.files.transfer import encode
from clsco.frame.frame import Frame
from clsco.inputs.depth_files import read_depth
from clsco.inputs.depth_maps import check_sizes, inverse_depth
from clsco.scene.file import override
from clsco.scene.model import DepthMap, Scene
from clsco.scene.sweep import Sweep, parse_sweep

WHERE = "defocus"
IMAGE_SUFFIXES = (".png", ".tif", ".tiff", ".exr")
_OTHER_IMAGES = (".bmp", ".gif", ".hdr", ".jpeg", ".jpg", ".npy", ".npz", ".pfm", ".ppm", ".webp")
_SECTION_OF = {
    **dict.fromkeys(("unit", "scale", "baseline", "offset"), "object"),
    **dict.fromkeys(("focal_length", "f_number", "aperture_diameter", "focus_distance"), "camera"),
    **dict.fromkeys(("sensor_distance", "pixel_pitch"), "camera"),
    **dict.fromkeys(("model", "edge", "occlusion"), "psf"),
}


def scenes_from_files(image: Path, depth: Path, options: Mapping[str, Any], overrides: Sequence[str] = ()) -> Sweep:
    """The scene of an image that has the depths of a map; several where keys of the camera have several values.

    image, depth: files of the same size. options: value by key, of the depth map (unit, scale, baseline, offset), of
    [camera] (focal_length, f_number, aperture_diameter, focus_distance, sensor_distance, pixel_pitch) or of [psf]
    (model, edge, occlusion); None stands for a key that is not given. overrides: as of `clsco.load_sweep`, after the
    options.
    Returns scenes with one object of shape depth_map, and absolute paths. Raises SceneError with a line per fault.
    """
    paths = {"texture": str(image.absolute()), "depth": str(depth.absolute())}
    item: dict[str, Any] = {"shape": "depth_map", "name": "image", **paths}
    tables: dict[str, dict[str, Any]] = {"object": item, "camera": {}, "psf": {}}
    for key, value in options.items():
        if value is not None:
            tables[_SECTION_OF[key]][key] = value
    data = {**tables, "object": [item]}
    override(data, overrides, WHERE)
    return parse_sweep(data, WHERE)


def depth_report(scene: Scene) -> list[str]:
    """Read the depth maps of a scene, and tell of each in one line what it has no depth for, if anything.

    Raises ImageError where a map and its image differ in size, and as `clsco.inputs.depth_files.read_depth` and
    `clsco.inputs.depth_maps.inverse_depth` do.
    """
    lines = []
    for item in scene.objects:
        if isinstance(item, DepthMap):
            raw = read_depth(item.depth)
            rows, columns = raw.shape
            check_sizes(item.texture, image_size(item.texture), item.depth, (columns, rows))
            values = inverse_depth(raw, item.unit, item.scale, scene.camera, item.baseline, item.depth, item.offset)
            lines += [f"{item.depth}: {values.report()}"] if values.report() else []
    return lines


def is_image_file(out: Path) -> bool:
    """Whether OUT names an image file and no folder; raises ImageError for an image that cannot be written."""
    suffix = out.suffix.lower()
    if out.is_dir():
        return False
    if suffix in _OTHER_IMAGES:
        refuse(out, f"must be a folder, or end in one of {' '.join(IMAGE_SUFFIXES)}", repr(out.suffix))
    return suffix in IMAGE_SUFFIXES


def prepare_image(scenes: Sequence[Scene], out: Path) -> None:
    """Make the folder of an image file, and prove that the file can be written.

    scenes: those to be rendered. Raises SceneError where they have more than one image, ImageError where OUT is what
    the image is made of, an extra of clsco is missing, or the folder cannot be written.
    """
    count = sum(scene.sequence.frames * (1 if scene.stereo is None else 2) for scene in scenes)
    if count != 1:
        raise SceneError(f"{out}: a file takes one image, a folder takes more; got {count}")
    for item in scenes[0].objects:
        for path in (item.texture, item.depth if isinstance(item, DepthMap) else item.texture):
            if same_place(out, path):
                raise ImageError(f"{out}: must not be the image or the depth that it is made of; got {path}")
    if out.suffix.lower() == ".exr":
        codec(out, "OpenEXR", "exr")
    elif out.suffix.lower() != ".png":
        codec(out, "tifffile", "formats")
    writable_folder(out.parent)


def write_image(out: Path, frame: Frame, bits: int, transfer: str) -> None:
    """Write the color of a frame to one file, by its extension; raises ImageError where that fails.

    bits: 8, 16 or 32, as the image has. PNG and TIFF have codes of as many bits, a PNG of 32 bits 16, and a TIFF of
    32 bits linear float32; an EXR has linear float32 in R G B. transfer: "srgb" or "linear", of codes.
    """
    suffix = out.suffix.lower()
    if suffix == ".exr":
        gray = frame.color.ndim == 2  # in three channels, so that every reader shows it
        write_exr(out, {name: frame.color if gray else frame.color[..., n] for n, name in enumerate("RGB")})
    elif suffix == ".png":
        write_png(out, encode(frame.color, min(bits, 16), transfer))
    else:
        write_tiff(out, frame.color if bits == 32 else encode(frame.color, bits, transfer))
