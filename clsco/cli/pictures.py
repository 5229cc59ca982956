"""Implementation of `clsco defocus` for layers, sequences, and files that hold image and depth."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np
from numpy.typing import NDArray

import clsco
from clsco.cli.defocus import Files, layer_files, scenes_from_files, write_color
from clsco.cli.inputs import paired_files, prepare_file, report_loss, report_notes
from clsco.cli.options import Computation, parse_length, require_device
from clsco.cli.output import echo
from clsco.cli.progress import progress
from clsco.errors import FileError, SceneError
from clsco.files.atomic import raise_file_error
from clsco.files.layers import list_names
from clsco.inputs.depth_files import DEPTH_FORMATS
from clsco.inputs.focus import Focus
from clsco.inputs.pictures import PictureLayers, load_layers
from clsco.scene.model import Scene

if TYPE_CHECKING:
    from clsco.engine.batch import Span

NUMBER = re.compile(r"#+|%(?:0?(\d))?d")  # place of a frame's number in a name: shot_####.exr, shot_%04d.exr
TRACK = "must be a distance, like 3m, or distances by increasing frame, like 1:3m,48:5m, or a CSV file of these"


@dataclass(frozen=True)
class FrameFiles:
    """Files of one frame: its number in a sequence or None, its layers, and the file for the image."""

    number: int | None
    layers: tuple[Files, ...]
    out: Path


@dataclass(frozen=True)
class FocusTrack:
    """Distances in focus by frame; their inverses in 1/mm are interpolated linearly, and hold before and after."""

    frames: tuple[int, ...]
    powers: tuple[float, ...]

    def at(self, frame: int) -> float:
        """Distance in focus, mm."""
        power = float(np.interp(frame, self.frames, self.powers))
        return 1.0 / power if power > 0.0 else np.inf


def parse_focus_distance(text: str) -> float | FocusTrack:
    """A distance in mm, or a track from text or from a CSV file of frames and distances, which may have a heading."""
    if Path(text).suffix.lower() == ".csv":
        try:
            lines = [re.split(r"[,;\s]+", line.strip()) for line in Path(text).read_text().splitlines() if line.strip()]
        except (OSError, ValueError) as error:
            raise click.BadParameter(f"{TRACK}; got {text}: {error}") from None
        pairs = lines[1:] if lines and not lines[0][0].isdecimal() else lines
    elif ":" in text:
        pairs = [pair.split(":") for pair in text.split(",")]
    else:
        return parse_length(text)
    if not pairs or not all(len(pair) == 2 and pair[0].isdecimal() for pair in pairs):
        raise click.BadParameter(f"{TRACK}; got {text}")
    frames, distances = [int(frame) for frame, _ in pairs], [parse_length(distance) for _, distance in pairs]
    if sorted(set(frames)) != frames or not min(distances) > 0.0:
        raise click.BadParameter(f"{TRACK}; got {text}")
    return FocusTrack(tuple(frames), tuple(1.0 / distance for distance in distances))


def parse_layer(text: str) -> Files:
    """Files of a layer, from the text IMAGE or IMAGE:DEPTH."""
    match = re.fullmatch(r"(.+\.\w+):(.+)", text)
    image, depth = match.groups() if match else (text, text)
    return layer_files(Path(image), Path(depth))


def picture_frames(
    image: Path | None, depth: Path | None, out: Path, layer: Sequence[str], names: str | None, span: Span
) -> list[FrameFiles]:  # fmt: skip
    """Frames of the arguments and options of `clsco defocus`: layer, names: values of --layer and --layers."""
    if (image is None) != bool(layer) or (names is not None and (image is None or depth is not None)):
        raise click.UsageError("must be IMAGE [DEPTH], or --layer without both, or IMAGE with --layers; got others")
    if image is None:
        return frames_of([parse_layer(text) for text in layer], out, span)
    if image.is_dir():
        pairs = paired_files(image, depth or image, DEPTH_FORMATS, out)
        return [FrameFiles(None, (layer_files(first, second),), file) for first, second, file in pairs]
    files = layer_files(image, depth or image)
    if names is None:
        return frames_of([files], out, span)
    return frames_of([{**files, "texture_layer": n, "depth_layer": n} for n in names.split(",")], out, span)


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
        rule = "a sequence must have a number in IMAGE or a layer and in OUT, as in shot_####.exr or shot_%04d.exr"
        raise FileError(f"{out}: {rule}; got it in {'one of them' if numbered or is_numbered(out) else 'none'}")
    if not numbered:
        return [FrameFiles(None, tuple(layers), out)]
    first, end = span
    numbers: Iterable[int] = range(first or 0, end or 0)
    if first is None or end is None:
        numbers = sorted(n for n in _numbers(Path(numbered[0])) if (first or 0) <= n and (end is None or n < end))
    if not numbers:
        raise_file_error(numbered[0], "must be at least one file", "none")
    for path in numbered:
        if missing := [str(number) for number in numbers if not path_of_frame(path, number).exists()]:
            raise_file_error(path, "must have a file for each frame", f"none for {list_names(missing)}")

    def files_of(files: Files, number: int) -> Files:
        return {k: str(path_of_frame(v, number)) if v in numbered else v for k, v in files.items()}

    return [FrameFiles(n, tuple(files_of(files, n) for files in layers), path_of_frame(out, n)) for n in numbers]


def _numbers(path: Path) -> Iterable[int]:
    """Numbers of the files of a sequence."""
    name = re.compile(r"(\d+)".join(map(re.escape, NUMBER.sub("\0", path.name).split("\0"))))
    matches = (name.fullmatch(file.name) for file in path.parent.iterdir())
    return (int(match[1]) for match in matches if match and path_of_frame(path, int(match[1])).name == match[0])


def defocus_frames(
    frames: Sequence[FrameFiles], options: Mapping[str, Any], overrides: Sequence[str], focus: Focus | None,
    max_blur: float | None, computation: Computation, quiet: bool,
) -> None:  # fmt: skip
    """Defocus the layers of each frame, and write the images.

    options, overrides: as for `scenes_from_files`, but the focus distance may be a track. focus, max_blur: as for
    `load_layers`.
    """
    track = options["focus_distance"] if isinstance(options["focus_distance"], FocusTrack) else None
    if track is not None and frames[0].number is None:
        raise click.UsageError("--focus-distance: a track needs a sequence, such as shot_####.exr")
    first = {**options, "focus_distance": track.at(frames[0].number or 0)} if track else options
    sweep = scenes_from_files(frames[0].layers, first, overrides)
    if len(sweep.scenes) > 1:
        raise SceneError(f"--set: layers and sequences take one value for each key; got {len(sweep.scenes)} scenes")
    for frame in frames:
        paths = [Path(files[key]) for files in frame.layers for key in ("texture", "depth")]
        prepare_file(frame.out, paths, "an image or a depth")
    require_device(computation.device)
    with progress(len(frames), quiet) as advance:
        for frame in frames:
            scene = _scene_of(sweep.scenes[0], frame, track)
            loaded = load_layers(scene, focus, max_blur)
            for path, line in loaded.notes:
                report_notes(click.format_filename(path), [line])
            if frame is frames[0]:
                report_loss(frame.out, loaded.color)
            if not loaded.is_opaque and frame.out.suffix.lower() != ".exr":
                rule = "must end in .exr, which holds alpha, as no layer is opaque"
                raise_file_error(frame.out, rule, repr(frame.out.suffix))
            image, soft = _blur(loaded, computation)
            if soft:
                report_notes(str(frame.out), [f"{soft} pixels at soft edges get the depth of one side"])
            write_color(frame.out, image, loaded.bits, scene.image.transfer, loaded.color)
            advance()
    if len(frames) > 1 and not quiet:
        echo(f"{click.format_filename(frames[0].out.parent)}: {len(frames)} images")


def _scene_of(scene: Scene, frame: FrameFiles, track: FocusTrack | None) -> Scene:
    """The scene of a frame, from that of the first one."""
    objects = [item.model_copy(update=dict(files)) for item, files in zip(scene.objects, frame.layers, strict=True)]
    scene = scene.model_copy(update={"objects": tuple(objects)})
    return scene if track is None else scene.replace("camera.focus_distance", track.at(frame.number or 0))


def _blur(loaded: PictureLayers, computation: Computation) -> tuple[NDArray[np.float32], int]:
    """The image of layers: gray, RGB, or premultiplied RGB and alpha if no layer is opaque; and the number of pixels at
    soft edges.
    """
    scene, item = loaded.scene, loaded.scene.objects[0]
    options: dict[str, Any] = {
        "psf": scene.psf, "aperture": scene.aperture, "camera": scene.camera, "device": computation.device,
        "memory": computation.memory, "soft_edges": item.model_dump()["soft_edges"], "return_report": True,
    }  # fmt: skip
    defocus: Callable[..., Any] = clsco.defocus
    if loaded.is_opaque and len(loaded.layers) == 1:
        ((rgba, radius),) = loaded.layers
        image, report = defocus(rgba[..., : 1 if loaded.is_gray else 3], radius, **options)
    else:
        image, report = defocus(layers=loaded.layers, **options)
    inside = [slice(more, length - more) for more, length in zip(loaded.margin, image.shape[:2], strict=True)]
    image = image[tuple(inside)]
    if loaded.is_opaque:
        image = image[..., 0] if loaded.is_gray else image[..., :3]
    return image, report.soft_edges
