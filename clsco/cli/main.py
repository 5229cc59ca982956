"""The command `clsco`: words to calls, results to tables, errors to one line each and an exit status.

Exit status: 0 done; 1 a user's error, reported on stderr; 2 wrong usage; 3 no usable device; 130 interrupted, 143
terminated.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from clsco import __version__
from clsco.cli.focus import focus_at_option, focus_depth_option, focus_files, parse_focus
from clsco.cli.inputs import first_scene, report_inputs, report_loss, report_notes, report_scenes
from clsco.cli.options import (
    PATH,
    Commands,
    Computation,
    Names,
    attribute,
    computation_options,
    device_option,
    memory_option,
    no_color_option,
    precision_option,
    quiet_option,
    require_device,
    require_opencl,
    scene_argument,
    scenes_argument,
    set_option,
    truth_options,
)
from clsco.cli.output import echo, show_log
from clsco.cli.render import render_to_folders, request_for, require_uncolored
from clsco.errors import ClscoError, DeviceError, MissingDependencyError, SceneError

if TYPE_CHECKING:
    from clsco.cli.plan_time import Setting
    from clsco.frame.truth_files import TruthFile
    from clsco.opencl.session import Session


MODULES = {
    "dataset": "Make data sets of many scenes drawn from distributions, look at them, and check them.",
    "examples": "List the example files, or copy some.",
    "psf": "Write the point spread functions of a scene's lens.",
    "render": "Render the frames of scenes to files.",
    "studio": "Edit a scene in the browser while it is rendered.",
    "video": "Make a clip of the frames in DIR, which clsco render wrote.",
}
"""Commands that have a module each, which is imported where one is called, and their lines in the list of commands."""


def _of_module(name: str) -> Any:
    return getattr(import_module(f"clsco.cli.{name}"), name)


class _AllCommands(Commands):
    """The commands of this module, and those of `MODULES`."""

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the list of commands, without importing their modules."""
        stubs: dict[str, click.Command] = {name: click.Command(name, help=text) for name, text in MODULES.items()}
        listing = click.Group(commands={**self.commands, **stubs})
        listing.format_commands(ctx, formatter)

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Names in the order of the alphabet."""
        return sorted([*super().list_commands(ctx), *MODULES])

    def get_command(self, ctx: click.Context, name: str) -> click.Command | None:
        """Command of this name."""
        if name in MODULES:
            return _of_module(name)
        return super().get_command(ctx, name)


@click.group(cls=_AllCommands, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="clsco")
@click.option("-v", "--verbose", count=True, help="Say on stderr what is done; -vv: with all details.")
def main(verbose: int) -> None:
    """Images of moving objects out of focus, with their ground truth."""
    if verbose:
        show_log(verbose)


@main.command()
@click.option("-o", "out", metavar="DIR", type=PATH, default=Path("demo"), show_default=True, help="Folder.")
@device_option
@quiet_option
def demo(out: Path, device: str | None, quiet: bool) -> None:
    """Render some of the example scenes, and a sheet that shows them and their ground truth."""
    require_device(device)
    from clsco.cli.demo import write_contact_sheet
    from clsco.cli.progress import progress
    from clsco.engine import batch
    from clsco.frame.truth_files import TruthFile
    from clsco.plan.prepare import prepare
    from clsco.scene.examples import EXAMPLES, example

    files = (TruthFile("npz"),)
    scenes = {name: prepare(example(name), request_for(files)) for name in EXAMPLES}
    jobs = {
        name: batch.prepare(each, out / name, range(each.scene.sequence.frames), files, False)
        for name, each in scenes.items()
    }
    shown = {}
    with progress(sum(len(job.frames) for job in jobs.values()), quiet) as advance:
        for job, frames in batch.run(list(jobs.values()), device):
            shown[job.folder.name] = frames  # the last one of a sequence
            advance()
    write_contact_sheet(out / "contact_sheet.png", shown)
    place = click.format_filename(out)
    echo(f"{place}/contact_sheet.png: all scenes, and the ground truth of some")
    echo(f"{place}/NAME/frame_0000.png, .npz, .json: image, truth and parameters; NAME is one of")
    echo(f"  {', '.join(jobs)}")


@main.command()
@scene_argument
@set_option
@truth_options
@no_color_option
@memory_option
@device_option
@click.option("--json", "machine", is_flag=True, help="Print passes, bytes and predicted seconds as JSON.")
def plan(
    scene: Path,
    overrides: tuple[str, ...],
    files: tuple[TruthFile, ...],
    no_color: bool,
    memory: int | None,
    device: str | None,
    machine: bool,
) -> None:
    """Report what rendering a scene takes, and how long, which is measured on a part of a frame.

    Without OpenCL it reports all but the time.
    """
    require_uncolored(files, no_color)
    session, used = _session_of_plan(device)
    request = request_for(files, memory=memory, color=not no_color)
    first = first_scene(scene, overrides, request, None if session is None else session.device, machine)
    report_scenes(scene, ("",), [first], close=True)
    from clsco.cli.plan_tables import plan_tables, planned_values
    from clsco.cli.tables import print_tables

    time, cheaper = None, list[tuple["Setting", float]]()
    if session is not None:
        from clsco.cli.plan_time import cheaper_settings
        from clsco.engine.probe import measure_frame

        time = measure_frame(session, first)
        cheaper = cheaper_settings(session, first, time)
    if machine:
        echo(json.dumps(planned_values(first.plans, used, time, cheaper), indent=2))
    else:
        print_tables(*plan_tables(first.plans, used, time, cheaper))


def _session_of_plan(device: str | None) -> tuple[Session | None, str]:
    """The session that a plan is measured in, with the device; or none, and why, where no device was asked for."""
    try:
        require_opencl()
        from clsco.opencl.session import session_for

        session = session_for(device)
    except (DeviceError, MissingDependencyError) as error:
        if device is not None:
            raise
        return None, f"none: {str(error).removeprefix('device: ')}"
    return session, str(session.device)


@main.command()
@scene_argument
@click.option(
    "--rays", metavar="N", type=click.IntRange(min=0), default=2**16, show_default=True,
    help="Most rays of a pixel; 0: the reference alone, without the extra.",
)  # fmt: skip
@click.option(
    "--seconds", metavar="S", type=click.FloatRange(min=0.0), default=20.0, show_default=True,
    help="Time for all rays, which ends at a standard error of 1e-3 of white.",
)  # fmt: skip
@click.option(
    "-o", "out", metavar="OUT", type=PATH, help="File: .json for all figures, .png for a picture of the pixels tried."
)
@set_option
@device_option
@precision_option
def check(
    scene: Path,
    rays: int,
    seconds: float,
    out: Path | None,
    overrides: tuple[str, ...],
    device: str | None,
    precision: str | None,
) -> None:
    """Compare frames with the NumPy reference, output by output, and with rays through the real lens.

    Fails where color differs from the reference by more than 1e-5 of white (in single precision, by more than 1e-4 in
    more than 1 of 500 pixels), or pixels from rays by more than 0.01 of white and 5 standard errors. Rays need the
    extra check.
    """
    from clsco.cli.check_scene import check_scene, require_report

    if out is not None:
        require_report(out)
    if rays:
        from clsco.truth import require_rays

        require_rays()
    first = first_scene(scene, overrides, request_for((), precision=precision))
    require_device(device)
    check_scene(scene, first.scene, (rays, seconds), out, device, precision)


@main.command()
@device_option
@click.option("--self-test", "tested", is_flag=True, help="Run small kernels on each device.")
@click.option("--warm", "warms", is_flag=True, help="Compile the kernels of usual scenes ahead: a minute or so.")
def devices(device: str | None, tested: bool, warms: bool) -> None:
    """List OpenCL devices, what each can do, and which one is used and why."""
    require_opencl()
    from clsco.cli.tables import device_tables, print_tables
    from clsco.opencl.device import list_devices
    from clsco.opencl.self_test import self_test

    all_devices, choice = list_devices(device, "--device")
    checks = {item: self_test(item) for item in all_devices} if tested else {}
    if all_devices:
        print_tables(*device_tables(all_devices, choice.device, checks))
    if choice.device is None:
        raise DeviceError(choice.reason)
    echo(f"used: {choice.device} ({choice.reason})")
    failed = [f"{item}: {check.name}" for item, results in checks.items() for check in results if not check.passed]
    if failed:
        raise ClscoError(f"self-test: every check must pass; got failures in {', '.join(failed)}")
    if warms:
        from clsco.cli.warm import warm_cache

        done = warm_cache(device)
        echo(f"warm: {done.programs} programs compiled for {done.plans} renders, in {done.seconds:.0f} s")


@main.command()
def schema() -> None:
    """Print the JSON Schema of a scene file."""
    from clsco.scene.schema import scene_schema

    echo(json.dumps(scene_schema(), indent=2))


@main.command()
@scenes_argument
def validate(scenes: tuple[Path, ...]) -> None:
    """Check scene files and their textures without rendering: reports valid files, and all faults of the others."""
    from clsco.plan.prepare import prepare_files
    from clsco.scene.sweep import load_sweeps

    faults: list[str] = []
    for loaded in load_sweeps(scenes):
        try:
            ((path, labels, prepared),) = prepare_files([loaded])
        except SceneError as error:
            faults.extend(error.messages)
            continue
        count = f", {len(labels)} scenes" if labels != ("",) else ""
        echo(f"{click.format_filename(path)}: valid{count}")
        report_scenes(path, labels, prepared, close=True)
    if faults:
        raise SceneError(faults)


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


def _choice(place: str, key: str, metavar: str, text: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    kind = Names(attribute(f"{place}.{key}"))
    return click.option(f"--{key.replace('_', '-')}", metavar=metavar, type=kind, help=text)


_depth_option = partial(_choice, "clsco.scene.shapes:DepthMap")
_spread_option = partial(_choice, "clsco.scene.spread:Psf")


@main.command()
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
@_number("--aperture-diameter", "D, mm; instead of the f-number.")
@_number("--focus-distance", "Distance in focus, mm.")
@focus_at_option
@focus_depth_option
@_number("--sensor-distance", "Distance from lens to detector, mm; instead of the distance in focus.")
@_number("--pixel-pitch", "Distance between pixels on the detector, mm.")
@_spread_option("model", "MODEL", "Of the blur: pillbox (default) or gaussian.")
@_spread_option("edge", "EDGE", "Of the blur: integrated (default), area or sampled.")
@_spread_option("occlusion", "METHOD", "How near hides far: layered (default) or none.")
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

    DEPTH is a PNG, JPEG, TIFF, EXR, PFM, DPT, NPY or NPZ. All else is as in a scene with this one object, whose other
    keys --set reaches. Where --set gives a key of the camera several values, each has a folder in OUT.
    """
    from clsco.cli.defocus import check_pair, is_image_file, prepare_image, scenes_from_files, write_color
    from clsco.plan.prepare import prepare_files

    alone, request = is_image_file(out), request_for((), computation)
    if alone and files:
        raise click.UsageError(f"--truth: OUT must be a folder; got {click.format_filename(out)}")
    focus = parse_focus(focus_at, focus_depth)
    for name in ("focus_distance", "sensor_distance"):
        if focus is not None and options[name] is not None:
            raise click.UsageError(f"focus: goes without --{name.replace('_', '-')}; got both")
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


@main.command()
@click.argument("image", type=PATH)
@click.argument("mask", type=PATH)
@click.option(
    "-o", "out", metavar="OUT", required=True, type=PATH, help="File for the filled image: .png, .tif or .exr."
)
@click.option(
    "--report", "folder", metavar="DIR", type=PATH, help="Folder for figures, plots and images of the stages."
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
    folder: Path | None,
    image_layer: str | None,
    threshold: float | None,
    device: str | None,
    quiet: bool,
    **options: Any,
) -> None:
    """Fill the missing pixels of IMAGE: those that are white (255) in MASK, a file of the same size.

    8 and 16 bits, gray and color, and floats, of which missing ones may be no numbers. OUT has the type of IMAGE.
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
    from clsco.files.atomic import make_writable_folder
    from clsco.files.plots import require_matplotlib
    from clsco.inpainting.report import write_report

    if folder is not None:
        require_matplotlib("report", "report")
        make_writable_folder(folder)
    method = options.pop("method")
    chosen = mean_median_options(method, options)
    with shares(quiet) as progress:
        filled, report = fill(
            pixels, missing, method=method, device=device, progress=progress, options=chosen, return_report=True
        )
    writer.save(out, filled, color)
    if folder is not None:
        write_report(folder, report, pixels, missing, filled)
    print_tables(*inpaint_tables(report))
    if not report.missing_pixels:
        echo(f"no pixel is missing: {click.format_filename(out)} is a copy of {click.format_filename(image)}")
