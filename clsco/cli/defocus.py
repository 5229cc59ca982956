"""Implementation of `clsco defocus`: makes scenes of images and depth maps, defocuses layers, writes image files."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import click
import numpy as np
from numpy.typing import NDArray

import clsco
from clsco.cli.inputs import paired_files, prepare_file, report_loss, report_notes
from clsco.cli.options import Computation, require_device
from clsco.cli.output import echo
from clsco.cli.progress import progress
from clsco.errors import FileError, SceneError
from clsco.files.atomic import raise_file_error
from clsco.files.color import SRGB, Color
from clsco.files.images import WRITERS, check_same_size, image_size, writer_for
from clsco.files.layers import list_names
from clsco.files.transfer import encode
from clsco.inputs.depth_files import DEPTH_FORMATS
from clsco.inputs.files import shared_files
from clsco.inputs.focus import Focus
from clsco.inputs.pictures import PictureLayers, load_layers
from clsco.scene.changes import override
from clsco.scene.model import Camera, DepthMap, Scene
from clsco.scene.sweep import Sweep, parse_sweep

if TYPE_CHECKING:
    from clsco.cli.focus import FocusTrack
    from clsco.engine.batch import Span

WHERE = "defocus"
_OTHER_IMAGES = (".bmp", ".gif", ".hdr", ".jpeg", ".jpg", ".npy", ".npz", ".pfm", ".ppm", ".webp")
Files = Mapping[str, str]
"""Keys of a depth map that name its files and their layers; paths are absolute."""

NUMBER = re.compile(r"#+|%(?:0?(\d))?d")  # place of a frame's number in a name: shot_####.exr, shot_%04d.exr
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
    codes = None if as_floats else encode(image, min(bits, writer.code_bits), color.transfer(transfer))
    writer.save(out, image if codes is None else codes, color)


class FrameFiles(NamedTuple):
    """Files of one frame: its number, None without a sequence; its layers; the file for the image."""

    number: int | None
    layers: Sequence[Files]
    out: Path


def picture_frames(
    image: Path | None, depth: Path | None, out: Path, layer: Sequence[str], names: str | None, span: Span
) -> list[FrameFiles]:  # fmt: skip
    """Frames of the arguments and options of `clsco defocus`; layer, names: values of --layer and --layers."""
    if (image is None) != bool(layer) or (names is not None and (image is None or depth is not None)):
        raise click.UsageError("must be IMAGE [DEPTH], or --layer without both, or IMAGE with --layers; got others")
    if image is not None and image.is_dir() and names is None and span == (None, None):
        pairs = paired_files(image, depth or image, DEPTH_FORMATS, out)
        return [FrameFiles(None, [layer_files(first, second)], file) for first, second, file in pairs]
    if image is None:
        parts = (re.fullmatch(r"(.+\.\w+):(.+)", text) or (text, text, text) for text in layer)
        return frames_of([layer_files(Path(part[1]), Path(part[2])) for part in parts], out, span)
    files, layers = layer_files(image, depth or image), [] if names is None else names.split(",")
    return frames_of([{**files, "texture_layer": n, "depth_layer": n} for n in layers] or [files], out, span)


def is_numbered(path: Path | str) -> bool:
    """True if a path stands for the frames of a sequence."""
    return NUMBER.search(Path(path).name) is not None and not Path(path).exists()


def path_of_frame(path: Path | str, number: int) -> Path:
    """The path of a frame."""
    path = Path(path)

    def digits(match: re.Match[str]) -> str:
        return f"{number:0{len(match[0]) if match[0][0] == '#' else int(match[1] or 0)}d}"

    return path.with_name(NUMBER.sub(digits, path.name))


def frames_of(layers: Sequence[Files], out: Path, span: Span) -> list[FrameFiles]:
    """The frames of layers whose files may be sequences. Raises FileError if a file of a frame is missing."""
    numbered = list(dict.fromkeys(f[key] for f in layers for key in ("texture", "depth") if is_numbered(f[key])))
    if bool(numbered) != is_numbered(out) or (span != (None, None) and not numbered):
        rule = "a sequence needs numbers in OUT and in IMAGE or a layer, as in shot_####.exr or shot_%04d.exr"
        raise FileError(f"{out}: {rule}; got {'one of them' if numbered or is_numbered(out) else 'none'}")
    if not numbered:
        return [FrameFiles(None, layers, out)]
    first, end = span
    numbers = list(range(first or 0, end or 0))
    if first is None or end is None:
        path = Path(numbered[0])
        pattern = re.compile(r"(\d+)".join(map(re.escape, NUMBER.sub("\0", path.name).split("\0"))))
        matches = (pattern.fullmatch(file.name) for file in path.parent.glob("*"))
        numbers = sorted(n for m in matches if m and (first or 0) <= (n := int(m[1])) and (end is None or n < end))
    for name in numbered:
        missing = [str(number) for number in numbers if not path_of_frame(name, number).exists()]
        if missing or not numbers:
            raise_file_error(name, "must have a file for each frame", f"none for {list_names(missing) or 'any'}")

    def files_of(files: Files, number: int) -> Files:
        return {k: str(path_of_frame(v, number)) if v in numbered else v for k, v in files.items()}

    return [FrameFiles(n, [files_of(files, n) for files in layers], path_of_frame(out, n)) for n in numbers]


def defocus_frames(
    frames: Sequence[FrameFiles], options: Mapping[str, Any], overrides: Sequence[str], focus: Focus | None,
    max_blur: float | None, computation: Computation, quiet: bool,
) -> None:  # fmt: skip
    """Defocus the layers of each frame, and write the images.

    options, overrides: as for `scenes_from_files`, but the focus distance may be a track. focus, max_blur: as for
    `load_layers`.
    """
    if computation.precision is not None or computation.tolerance is not None:
        raise click.UsageError("--precision, --tolerance: need DEPTH or a folder OUT, and no layers or sequence")
    track = options["focus_distance"] if isinstance(options["focus_distance"], Mapping) else None
    if track and frames[0].number is None:
        raise click.UsageError("--focus-distance: distances by frame need a sequence, such as shot_####.exr")
    first = {**options, "focus_distance": distance_at(track, frames[0])} if track else options
    scenes = scenes_from_files(frames[0].layers, first, overrides).scenes
    if len(scenes) > 1:
        raise SceneError(f"--set: must give a key one value, without DEPTH and with layers; got {len(scenes)} scenes")
    for frame in frames:
        paths = (Path(files[key]) for files in frame.layers for key in ("texture", "depth"))
        prepare_file(frame.out, paths, "the image or the depth")
    require_device(computation.device)
    with progress(len(frames), quiet) as advance:
        for frame in frames:
            pairs = zip(scenes[0].objects, frame.layers, strict=True)
            items = tuple(item.model_copy(update=dict(files)) for item, files in pairs)
            scene = scenes[0].model_copy(update={"objects": items})
            if track:
                scene = scene.replace("camera.focus_distance", distance_at(track, frame))
            loaded = load_layers(scene, focus, max_blur)
            for path, line in loaded.notes:
                report_notes(path, [line])
            if not loaded.is_opaque and frame.out.suffix.lower() != ".exr":
                rule = "must end in .exr, which holds alpha, as no layer is opaque"
                raise_file_error(frame.out, rule, repr(frame.out.suffix))
            if frame is frames[0]:
                report_loss(frame.out, loaded.color)
            write_color(frame.out, _blur(loaded, computation), loaded.bits, scenes[0].image.transfer, loaded.color)
            advance()
    if len(frames) > 1 and not quiet:
        echo(f"{click.format_filename(frames[0].out.parent)}: {len(frames)} images")


def distance_at(track: FocusTrack, frame: FrameFiles) -> float:
    """Distance in focus of a frame in mm: linear in 1 / distance between frames of the track, constant outside."""
    power = float(np.interp(frame.number or 0, sorted(track), [1.0 / track[number] for number in sorted(track)]))
    return 1.0 / power if power else np.inf


def _blur(loaded: PictureLayers, computation: Computation) -> NDArray[np.float32]:
    """The image of layers: gray, RGB, or premultiplied RGB and alpha if no layer is opaque."""
    scene, defocus = loaded.scene, cast("Callable[..., Any]", clsco.defocus)
    options: dict[str, Any] = {"device": computation.device, "memory": computation.memory}
    options |= {"psf": scene.psf, "aperture": scene.aperture, "camera": scene.camera}
    item = next(item for item in scene.objects if isinstance(item, DepthMap))
    options["soft_edges"] = item.soft_edges
    images: dict[str, Any] = {"layers": loaded.layers}
    if loaded.is_opaque and len(loaded.layers) == 1:
        ((rgba, radius),) = loaded.layers
        images = {"image": rgba[..., : 1 if loaded.is_gray else 3], "blur_radius": radius}
    image, report = defocus(**images, return_report=True, **options)
    if report.soft_edges:
        where = str(item.depth) if len(loaded.layers) == 1 else "layers"
        pixels = sum(radius.size for _, radius in loaded.layers)
        report_notes(where, [f"{report.soft_edges} of {pixels} pixels at soft edges get the depth of one side"])
    rows, columns = (slice(more, length - more) for more, length in zip(loaded.margin, image.shape, strict=False))
    if not loaded.is_opaque:
        return image[rows, columns]
    return image[rows, columns, 0] if loaded.is_gray else image[rows, columns, :3]
