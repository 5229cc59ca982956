"""Commands that read images: `clsco defocus` and `inpaint`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from clsco.cli import options
from clsco.cli.focus import focus_at_option, focus_depth_option, focus_distance_option, focus_files, parse_focus
from clsco.cli.inputs import paired_files, report_inputs, report_loss, report_notes
from clsco.cli.options import PATH, Command, Computation, Names, NumberRange, option, require_device
from clsco.cli.output import echo
from clsco.cli.render import render_to_folders, request_for

if TYPE_CHECKING:
    from clsco.engine.batch import Span
    from clsco.frame.truth_files import TruthFile


def _ratio(text: str) -> float:
    above, line, below = text.partition("/")
    try:
        return float(above) / float(below) if line else float(text)
    except (ValueError, ZeroDivisionError):
        raise click.BadParameter(f"must be a number, like 0.001, or a ratio, like 1/256; got {text}") from None


_LAYER = "Of {}, an EXR with several: the layer, such as Combined or ViewLayer.Combined."


def _number(name: str, text: str) -> Callable[[Command], Command]:
    return option(name, "NUMBER", text, float)


def _length(name: str, text: str) -> Callable[[Command], Command]:
    return option(name, "LENGTH", text, options.parse_length)


def _depth_option(key: str, metavar: str, text: str) -> Callable[[Command], Command]:
    names = options.attribute(f"clsco.scene.shapes:DepthMap.{key}")
    return option(f"--{key.replace('_', '-')}", metavar, text, Names(names))


@click.command()
@click.argument("image", type=PATH, required=False)
@click.argument("depth", type=PATH, required=False)
@option(
    "-o out", "OUT", "Folder for frames, or a file .png, .tif or .exr for the image alone; {} is the name of IMAGE.",
    PATH, required=True,
)  # fmt: skip
@option(
    "--layer", "IMAGE[:DEPTH]", "A layer in place of IMAGE and DEPTH; may be given again, up to 8 times, in any order.",
    multiple=True,
)  # fmt: skip
@option("--layers", "NAME,...", "Layers of IMAGE, an EXR that holds colors, alpha and depth of each.")
@option("--frames span", "A:B", "Of a sequence: files numbered A to B - 1.", options.parse_span, default=":")
@option("--image-layer texture_layer", "NAME", _LAYER.format("IMAGE"))
@option("--depth-layer", "NAME", _LAYER.format("DEPTH"))
@_depth_option("unit", "UNIT", "Of DEPTH: mm (default), m, inverse_mm, inverse_m, disparity or coc.")
@option("--scale", "NUMBER", "What 1 in DEPTH is worth, such as 0.001, 1/256 or -1.", _ratio)
@_length("--baseline", "Distance between the views of a disparity, mm.")
@_number("--offset", "Added to DEPTH times scale: a in 1/Z = a + b v, or doffs of Middlebury's calibrations, px.")
@_length("--near", "Distance of the nearest number in DEPTH, mm, as of relative depth.")
@_length("--far", "Distance of the farthest number in DEPTH, mm; by default infinite with an inverse unit.")
@_depth_option(
    "depth_kind", "KIND",
    "Of DEPTH: z (default), along the optical axis, or ray, the distance from the lens along each pixel's ray.",
)  # fmt: skip
@_depth_option(
    "no_depth", "WHERE",
    "What has no depth, such as 0, is: around (default), at the depth around it, or far, as the sky.",
)  # fmt: skip
@_depth_option("soft_edges", "METHOD", "Depths between two surfaces at their edge: assign to one (default) or keep.")
@_length("--focal-length", "f, mm, or like 85mm or 3.5cm, as all lengths.")
@_number("--f-number", "f / D.")
@focus_distance_option
@focus_at_option
@focus_depth_option
@_length("--pixel-pitch", "Distance between pixels on the detector, mm.")
@_length("--sensor-width", "Width of the image on the detector, in place of the pixel pitch, such as 36mm.")
@option("--fov", "ANGLE", "Horizontal angle of view, in place of the pixel pitch, like 40deg.", options.parse_angle)
@option("--max-blur", "PX", "Clamp blur radii, and count the pixels.", NumberRange(0.0, 512.0, min_open=True))
@options.truth_options
@options.set_option
@options.computation_options
@options.quiet_option
def defocus(
    image: Path | None, depth: Path | None, out: Path, layer: tuple[str, ...], layers: str | None, span: Span,
    max_blur: float | None, files: tuple[TruthFile, ...], overrides: tuple[str, ...], computation: Computation,
    quiet: bool, **values: Any,
) -> None:  # fmt: skip
    """Defocus IMAGE by its depth map DEPTH, a file of the same size. Without DEPTH, IMAGE is an EXR that holds both.

    If IMAGE is a folder, each of its images is defocused by the file of its name in the folder DEPTH. DEPTH is a PNG,
    JPEG, TIFF, EXR, PFM, DPT, NPY or NPZ. A name like shot_####.exr stands for a sequence. All else is as in a scene
    with this one object; --set sets its other keys. If --set gives a key several values, the frame of each value has a
    folder in OUT.
    """
    from clsco.cli.defocus import check_pair, is_image_file, layer_files, prepare_image, scenes_from_files, write_color
    from clsco.inputs.depth_files import DEPTH_FORMATS
    from clsco.plan.prepare import prepare_files

    alone = is_image_file(out)
    if alone and files:
        raise click.UsageError(f"--truth: OUT must be a folder; got {click.format_filename(out)}")
    focus = parse_focus(values.pop("focus_at"), values.pop("focus_depth"))
    if focus is not None and values["focus_distance"] is not None:
        raise click.UsageError("focus: goes without --focus-distance; got both")
    special = layer or layers or max_blur or span != (None, None) or isinstance(values["focus_distance"], dict)
    if special or image is None or (alone and (depth is None or "#" in out.name or "%" in out.name)):
        from clsco.cli.defocus import defocus_frames, picture_frames

        frames = picture_frames(image, depth, out, layer, layers, span)
        if not alone:
            raise click.UsageError(f"OUT: must end in .png, .tif or .exr with these options; got {out}")
        defocus_frames(frames, values, overrides, focus, max_blur, computation, quiet)
        return
    depth = depth or image
    pairs = paired_files(image, depth, DEPTH_FORMATS, out, alone)
    sweeps = [(first, scenes_from_files([layer_files(first, second)], values, overrides)) for first, second, _ in pairs]
    for _, sweep in sweeps:
        check_pair(sweep.scenes[0])
    loaded = focus_files(sweeps, focus)
    if not alone:
        render_to_folders(loaded, out, files, computation, quiet)
        return
    planned = prepare_files(loaded, request_for((), computation))
    for (*_, file), (_, _, prepared) in zip(pairs, planned, strict=True):
        prepare_image([each.scene for each in prepared], file)
    report_inputs(planned)
    scenes = [prepared for _, _, (prepared,) in planned]
    for (*_, file), scene in zip(pairs, scenes, strict=True):
        report_loss(file, scene.color)
    require_device(computation.device)
    from clsco.cli.progress import progress
    from clsco.engine.sequence import render_prepared
    from clsco.opencl.session import session_for

    with progress(len(scenes), quiet) as advance:
        for k, frame in render_prepared(session_for(computation.device), scenes):
            scene, bits = scenes[k], frame.metadata["bits"]
            write_color(pairs[k][-1], frame.color, bits, scene.scene.image.transfer, scene.color)
            advance()
    if len(scenes) > 1 and not quiet:
        echo(f"{click.format_filename(out)}: {len(scenes)} images")


@click.command()
@click.argument("image", type=PATH)
@click.argument("mask", type=PATH)
@option("-o out", "OUT", "File for the filled image: .png, .tif or .exr; {} is the name of IMAGE.", PATH, required=True)
@option(
    "--method", "METHOD", "mean-median, biharmonic, texture, or auto for the better of the last two.",
    Names(lambda: ("auto", "mean-median", "biharmonic", "texture")), shown="auto",
)  # fmt: skip
@option("--image-layer", "NAME", _LAYER.format("IMAGE"))
@_number("--threshold", "Values of MASK from this one on are missing; without it they must be 0 and white.")
@option(
    "--estimator", "NAME", "Of mean-median: scored (default), mean or median.",
    Names(lambda: ("scored", "mean", "median")),
)  # fmt: skip
@option("--minimum", "NUMBER", "Of mean-median: known neighbors that a pixel needs, 4.", int)
@option("--smoothing-rounds", "NUMBER", "Of mean-median: 20; 0 turns smoothing off.", int)
@_number("--border-share", "Of mean-median: of the border, the share that is blended, 0.4; 0 turns it off.")
@options.device_option
@options.quiet_option
def inpaint(
    image: Path, mask: Path, out: Path, method: str, image_layer: str | None, threshold: float | None,
    device: str | None, quiet: bool, **constants: Any,
) -> None:  # fmt: skip
    """Fill the missing pixels of IMAGE: those that are white (255) in MASK, a file of the same size.

    If IMAGE is a folder, MASK is one file for all its images, or a folder with masks of the same names. IMAGE is gray
    or color, of 8 or 16 bits, or of floats, whose missing pixels may be NaN. OUT has the type of IMAGE.
    """
    from clsco.cli.inpaint import mean_median_options, prepare_out, read_pair
    from clsco.files.decoders import IMAGE_FORMATS

    pairs = paired_files(image, mask, IMAGE_FORMATS, out)
    for first, second, file in pairs:
        prepare_out(file, first, second)
    require_device(device)
    from clsco import inpaint as fill
    from clsco.cli.progress import progress, shares
    from clsco.cli.tables import inpaint_tables, print_tables

    chosen, several, copies = mean_median_options(method, constants), len(pairs) > 1, list[str]()
    with progress(len(pairs), quiet, "images") if several else shares(quiet) as advance:
        for first, second, file in pairs:
            picture, missing = read_pair(first, second, threshold, image_layer)
            writer = prepare_out(file, first, second, picture.is_float)
            report_notes(str(first), picture.notes())
            report_loss(file, picture.color)
            filled, report = fill(
                picture.data, missing, method=method, device=device, progress=None if several else advance,
                options=chosen, return_report=True,
            )  # fmt: skip
            writer.save(file, filled, picture.color)
            if several:
                advance(1)
            if not report.missing_pixels:
                copies.append("{} is a copy of {}".format(*map(click.format_filename, (file, first))))
    if several:
        echo(f"{click.format_filename(out)}: {len(pairs)} images")
    else:
        print_tables(*inpaint_tables(report))
    for line in copies:
        echo(f"no pixel is missing: {line}")
