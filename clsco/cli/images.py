"""Commands that read images: `clsco defocus` and `inpaint`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from clsco.cli.focus import focus_at_option, focus_depth_option, focus_files, parse_focus
from clsco.cli.inputs import report_inputs, report_loss, report_notes
from clsco.cli.options import (
    PATH,
    Computation,
    Names,
    attribute,
    computation_options,
    device_option,
    quiet_option,
    require_device,
    set_option,
    truth_options,
)
from clsco.cli.output import echo
from clsco.cli.render import render_to_folders, request_for

if TYPE_CHECKING:
    from clsco.frame.truth_files import TruthFile


def _ratio(text: str) -> float:
    above, line, below = text.partition("/")
    try:
        return float(above) / float(below) if line else float(text)
    except (ValueError, ZeroDivisionError):
        raise click.BadParameter(f"must be a number, like 0.001, or a ratio, like 1/256; got {text}") from None


def _number(name: str, text: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    return click.option(name, metavar="NUMBER", type=float, help=text)


def _layer(name: str, argument: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    text = f"Of {argument}, an EXR with several: the layer, such as Combined or ViewLayer.Combined."
    return click.option(name, metavar="NAME", help=text)


def _depth_option(key: str, metavar: str, text: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    kind = Names(attribute(f"clsco.scene.shapes:DepthMap.{key}"))
    return click.option(f"--{key.replace('_', '-')}", metavar=metavar, type=kind, help=text)


@click.command()
@click.argument("image", type=PATH)
@click.argument("depth", type=PATH)
@click.option(
    "-o", "out", metavar="OUT", required=True, type=PATH,
    help="Folder for the frame, or a file .png, .tif or .exr for its image alone.",
)  # fmt: skip
@_layer("--image-layer", "IMAGE")
@_layer("--depth-layer", "DEPTH")
@_depth_option("unit", "UNIT", "Of DEPTH: mm (default), m, inverse_mm, inverse_m, disparity or coc.")
@click.option("--scale", metavar="NUMBER", type=_ratio, help="What 1 in DEPTH is worth, such as 0.001, 1/256 or -1.")
@_number("--baseline", "Distance between the views of a disparity, mm.")
@_number("--offset", "Added to DEPTH times scale: a in 1/Z = a + b v, or doffs of Middlebury's calibrations, px.")
@_number("--near", "Distance of the nearest number in DEPTH, mm, as of relative depth.")
@_number("--far", "Distance of the farthest number in DEPTH, mm; by default infinite with an inverse unit.")
@_depth_option(
    "depth_kind", "KIND",
    "Of DEPTH: z (default), along the optical axis, or ray, the distance from the lens along each pixel's ray.",
)  # fmt: skip
@_depth_option(
    "no_depth",
    "WHERE",
    "What has no depth, such as 0, is: around (default), at the depth around it, or far, as the sky.",
)
@_depth_option("soft_edges", "METHOD", "Depths between two surfaces at their edge: assign to one (default) or keep.")
@_number("--focal-length", "f, mm.")
@_number("--f-number", "f / D.")
@_number("--focus-distance", "Distance in focus, mm.")
@focus_at_option
@focus_depth_option
@_number("--pixel-pitch", "Distance between pixels on the detector, mm.")
@truth_options
@set_option
@computation_options
@quiet_option
def defocus(
    image: Path,
    depth: Path,
    out: Path,
    files: tuple[TruthFile, ...],
    overrides: tuple[str, ...],
    image_layer: str | None,
    depth_layer: str | None,
    focus_at: tuple[int, int] | None,
    focus_depth: float | None,
    computation: Computation,
    quiet: bool,
    **options: str | float | None,
) -> None:
    """Defocus IMAGE by its depth map DEPTH, a file of the same size.

    DEPTH is a PNG, JPEG, TIFF, EXR, PFM, DPT, NPY or NPZ. All else is as in a scene with this one object; --set sets
    its other keys. If --set gives a key several values, the frame of each value has a folder in OUT.
    """
    from clsco.cli.defocus import check_pair, is_image_file, prepare_image, scenes_from_files, write_color
    from clsco.plan.prepare import prepare_files

    alone, request = is_image_file(out), request_for((), computation)
    if alone and files:
        raise click.UsageError(f"--truth: OUT must be a folder; got {click.format_filename(out)}")
    focus = parse_focus(focus_at, focus_depth)
    if focus is not None and options["focus_distance"] is not None:
        raise click.UsageError("focus: goes without --focus-distance; got both")
    sweep = scenes_from_files(image, depth, options, overrides, (image_layer, depth_layer))
    check_pair(sweep.scenes[0])
    loaded = focus_files([(image, sweep)], focus)
    if not alone:
        render_to_folders(loaded, out, files, computation, quiet)
        return
    planned = prepare_files(loaded, request)
    scenes = [each for _, _, prepared in planned for each in prepared]
    prepare_image([each.scene for each in scenes], out)
    report_inputs(planned)
    report_loss(out, scenes[0].color)
    require_device(computation.device)
    from clsco.cli.progress import progress
    from clsco.engine.sequence import render_prepared
    from clsco.opencl.session import session_for

    with progress(1, quiet) as advance:
        for _, frame in render_prepared(session_for(computation.device), scenes):
            write_color(out, frame, frame.metadata["bits"], scenes[0].scene.image.transfer, scenes[0].color)
            advance()


@click.command()
@click.argument("image", type=PATH)
@click.argument("mask", type=PATH)
@click.option(
    "-o", "out", metavar="OUT", required=True, type=PATH, help="File for the filled image: .png, .tif or .exr."
)
@click.option(
    "--method", metavar="METHOD", type=Names(lambda: ("auto", "mean-median", "biharmonic", "texture")),
    default="auto", show_default=True,
    help="mean-median, biharmonic, texture, or auto for the better of the last two.",
)  # fmt: skip
@_layer("--image-layer", "IMAGE")
@_number("--threshold", "Values of MASK from this one on are missing; without it they must be 0 and white.")
@click.option(
    "--estimator",
    metavar="NAME",
    type=Names(lambda: ("scored", "mean", "median")),
    help="Of mean-median: scored (default), mean or median.",
)
@click.option("--minimum", metavar="NUMBER", type=int, help="Of mean-median: known neighbors that a pixel needs, 4.")
@click.option("--smoothing-rounds", metavar="NUMBER", type=int, help="Of mean-median: 20; 0 turns smoothing off.")
@_number("--border-share", "Of mean-median: of the border, the share that is blended, 0.4; 0 turns it off.")
@device_option
@quiet_option
def inpaint(
    image: Path,
    mask: Path,
    out: Path,
    image_layer: str | None,
    threshold: float | None,
    device: str | None,
    quiet: bool,
    **options: Any,
) -> None:
    """Fill the missing pixels of IMAGE: those that are white (255) in MASK, a file of the same size.

    IMAGE is gray or color, of 8 or 16 bits, or of floats, whose missing pixels may be NaN. OUT has the type of IMAGE.
    """
    from clsco.cli.inpaint import mean_median_options, prepare_out, read_pair

    prepare_out(out, image, mask)
    picture, missing = read_pair(image, mask, threshold, image_layer)
    pixels, color = picture.data, picture.color
    writer = prepare_out(out, image, mask, picture.is_float)
    report_notes(str(image), picture.notes())
    report_loss(out, color)
    require_device(device)
    from clsco import inpaint as fill
    from clsco.cli.progress import shares
    from clsco.cli.tables import inpaint_tables, print_tables

    method = options.pop("method")
    chosen = mean_median_options(method, options)
    with shares(quiet) as progress:
        filled, report = fill(
            pixels, missing, method=method, device=device, progress=progress, options=chosen, return_report=True
        )
    writer.save(out, filled, color)
    print_tables(*inpaint_tables(report))
    if not report.missing_pixels:
        echo(f"no pixel is missing: {click.format_filename(out)} is a copy of {click.format_filename(image)}")
