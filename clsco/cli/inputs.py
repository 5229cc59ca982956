"""Messages that commands print before they render: on colors, depth maps, their blur, and time samples."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from clsco.cli.output import echo
from clsco.errors import FileError, SceneError

if TYPE_CHECKING:
    from clsco.files.color import Color
    from clsco.files.images import ImageWriter
    from clsco.plan.device import DeviceFacts
    from clsco.plan.prepare import Prepared, PreparedFile
    from clsco.plan.request import Request
    from clsco.scene.model import DepthMap, Scene


def first_scene(
    path: Path, overrides: tuple[str, ...], request: Request, device: DeviceFacts | None = None, aside: bool = False
) -> Prepared:  # fmt: skip
    """Prepare the first scene of a file, and print its label if there are several; aside: True to print to stderr."""
    from clsco.plan.prepare import prepare_files
    from clsco.scene.sweep import load_sweeps

    ((path, sweep),) = load_sweeps([path], overrides)
    if isinstance(sweep, SceneError):
        raise sweep
    alone = replace(sweep, labels=sweep.labels[:1], scenes=sweep.scenes[:1])
    ((_, (label,), (first,)),) = prepare_files([(path, alone)], request, device)
    if label:
        echo(f"the first of {len(sweep.labels)} scenes, {label}:", err=aside)
    return first


def report_inputs(planned: Sequence[PreparedFile]) -> None:
    """Print notes to stderr: on images, depth maps and their largest blur, and time samples chosen for a tolerance."""
    from clsco.scene.model import DepthMap

    for path, labels, prepared in planned:
        report_scenes(path, labels, prepared)
        for label, each in zip(labels, prepared, strict=True):
            maps = [item for item in each.scene.objects if isinstance(item, DepthMap)]
            if label == labels[0]:  # all scenes of a file have the same images
                _report_images(each)
                for item in maps:
                    _report_depth(each, item)
            for item in maps:
                from clsco.inputs.focus import lens_line  # 1 ms, and few scenes have depth maps

                _report(str(item.depth), label, lens_line(each.scene, each.files.map(each.scene, item)))
            if each.approximation is not None:
                _report(click.format_filename(path), label, each.approximation.line())


def report_scenes(path: Path, labels: Sequence[str], prepared: Sequence[Prepared], close: bool = False) -> None:
    """Print to stderr which images are stretched, and which parts of scenes are out of sight or black, each once.

    close: True to report a close focus, too, because image sizes then differ from the usual formulas.
    """
    from clsco.inputs.textures import find_stretched
    from clsco.optics.resolved_view import without_lens
    from clsco.plan.notes import close_focus_note, sight_notes

    for line in find_stretched(each.scene for each in prepared):
        _report(click.format_filename(path), "", line)
    known, reported = set["Scene"](), set[str]()
    for label, each in zip(labels, prepared, strict=True):
        without = without_lens(each.scene)
        lines = [] if without in known else sight_notes(each.plans)
        known.add(without)
        if close and (note := close_focus_note(each.scene.camera)) is not None:
            lines.append(note)
            close = False
        for line in (line for line in lines if line not in reported):
            reported.add(line)
            _report(click.format_filename(path), label, line)


def _report(path: str, label: str, line: str) -> None:
    echo(f"{path}{f' (with {label})' if label else ''}: {line}", err=True)


def report_notes(path: str, notes: Iterable[str]) -> None:
    """Print notes on an image, those of `clsco.files.images.Picture.notes`, to stderr."""
    for note in notes:
        echo(f"{path}: {note}", err=True)


def prepare_file(out: Path, sources: Iterable[Path], names: str) -> ImageWriter:
    """Writer for an image file that is none of the sources, in a writable folder. Raises FileError, as `writer_for`."""
    from clsco.files.atomic import is_same_place, make_writable_folder
    from clsco.files.images import writer_for

    for path in sources:
        if is_same_place(out, path):
            raise FileError(f"{out}: must not be {names} that it is made of; got {path}")
    writer = writer_for(out)
    make_writable_folder(out.parent)
    return writer


def paired_files(
    image: Path, other: Path, formats: Collection[str], out: Path, to_files: bool = True
) -> list[tuple[Path, Path, Path]]:  # fmt: skip
    """Pairs of an image and its depth map or mask, with the output, where {} is the image's name without its extension.

    If `image` is a folder, each of its images belongs to the file of the same name in the folder `other`, whose
    extensions are `formats`, or to the single file `other`. to_files: True if `out` is a file, False if it is a folder,
    which takes any number of images. Raises FileError.
    """
    from clsco.files.decoders import IMAGE_FORMATS
    from clsco.files.layers import list_names

    def by_name(folder: Path, suffixes: Collection[str]) -> dict[str, Path]:
        paths = [path for path in sorted(folder.iterdir()) if path.suffix.lower() in suffixes and path.name[0] != "."]
        names = {path.stem: path for path in paths}
        if len(names) != len(paths) or not paths:
            rule = f"must hold files of different names that end in {' '.join(suffixes)}"
            raise FileError(f"{folder}: {rule}; got {list_names(path.name for path in paths) or 'none'}")
        return names

    images = by_name(image, IMAGE_FORMATS) if image.is_dir() else {image.stem: image}
    others = by_name(other, formats) if image.is_dir() and other.is_dir() else dict.fromkeys(images, other)
    if missing := images.keys() - others.keys():
        rule = f"must have a file for each image in {image}"
        raise FileError(f"{other}: {rule}; got none for {list_names(missing)}")
    if len(images) > 1 and "{}" not in str(out) if to_files else "{}" in str(out):
        rule = "must be a file with {} for the name of each image, or a folder without {}"
        raise FileError(f"{out}: {rule}; got {len(images)} image{'s' * (len(images) > 1)}")
    return [(path, others[name], Path(str(out).replace("{}", name))) for name, path in images.items()]


def report_loss(out: Path, color: Color) -> None:
    """Print to stderr that a file cannot store a color profile."""
    from clsco.files.images import WRITERS

    if loss := WRITERS[out.suffix.lower()].loss(color):
        echo(f"{click.format_filename(out)}: {loss}", err=True)


def _report_images(prepared: Prepared) -> None:
    for image in prepared.colors:
        report_notes(str(image), prepared.files.about(image).notes)
    if prepared.color.is_plain:
        for image, color in prepared.colors.items():
            if not color.is_plain and not prepared.files.about(image).is_gray:
                handled = "converted to it" if color.converts(prepared.scene.image.transfer) else "taken as such"
                echo(f"{image}: frames are in sRGB, and colors of the profile {color.name} are {handled}", err=True)


def _report_depth(prepared: Prepared, item: DepthMap) -> None:
    from clsco.files.images import upright_note
    from clsco.inputs.depth_files import DEPTH_FORMATS

    files = item.files()
    if files.keys() >= {"texture", "depth"} and (note := upright_note(files["texture"], files["depth"], DEPTH_FORMATS)):
        echo(note, err=True)
    values = prepared.files.depth_values(prepared.scene, item)
    if report := values.report():
        taken_as = "; those without are taken as infinitely far" if values.invalid and item.no_depth == "far" else ""
        echo(f"{item.depth}: {report}{taken_as}", err=True)
