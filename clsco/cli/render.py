"""Implementation of `clsco render`, and functions shared with `clsco defocus`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from clsco.cli import options
from clsco.cli.focus import focus_at_option, focus_depth_option, focus_files, parse_focus
from clsco.cli.inputs import report_inputs
from clsco.cli.options import PATH, Computation, flag, option
from clsco.cli.output import echo
from clsco.cli.video import remove_clips, require_clips, write_clips

if TYPE_CHECKING:
    from clsco.cli.focus import Loaded
    from clsco.engine.batch import Job, Span
    from clsco.frame.truth_files import TruthFile
    from clsco.plan.request import Request


@click.command()
@options.scenes_argument
@option("-o out", "DIR", "Folder for the frames.", PATH, required=True)
@options.truth_options
@options.no_color_option
@option("--frames span", "A:B", "Frames A to B - 1, counted from 0.", options.parse_span, default=":")
@options.set_option
@focus_at_option
@focus_depth_option
@options.computation_options
@flag("--subframes", "Also write the image of each time sample: frame_0000_sample_00.png.")
@option(
    "--video preset", "PRESET",
    "When all frames are there, write a clip beside them, such as clip.mp4: mp4, ffv1, prores or another preset of "
    "clsco video.",
    options.PRESET,
)  # fmt: skip
@flag("--check", "Record how far frames are from rays through the lens, in their JSON files.")
@flag("--resume", "Leave out frames that are in DIR already, whole and of this scene.")
@options.quiet_option
def render(
    scenes: tuple[Path, ...], files: tuple[TruthFile, ...], no_color: bool, overrides: tuple[str, ...],
    focus_at: tuple[int, int] | None, focus_depth: float | None, check: bool, **values: Any,
) -> None:  # fmt: skip
    """Render the frames of scenes to files.

    A frame is frame_0000.png, and frame_0000.json, which records how it was made. With several scenes, each has a
    folder of its name in DIR. If keys of a scene have several values, each combination has a folder like f_number_4.
    """
    from clsco.scene.sweep import load_sweeps

    if no_color and (values["subframes"] or values["preset"]):
        raise click.UsageError("--no-color: makes no image, so must be without --subframes and --video")
    require_uncolored(files, no_color)
    focus = parse_focus(focus_at, focus_depth)
    loaded = focus_files(load_sweeps(scenes, overrides), focus)
    if check:
        from clsco.truth import require_rays

        require_rays()
    render_to_folders(loaded, files=files, color=not no_color, check=check, **values)


def require_uncolored(files: tuple[TruthFile, ...], no_color: bool) -> None:
    """Raise an error if --no-color is given, and the files need the image, or there are no files."""
    if not no_color:
        return
    if not files:
        raise click.UsageError("--no-color: needs --truth, as nothing else is written")
    from clsco.frame.outputs import OF_THE_IMAGE

    for file in files:
        if named := [name for name in file.names if name in OF_THE_IMAGE]:
            raise click.UsageError(f"--no-color: makes no image, so --truth must be without {named[0]}; got {file}")


def request_for(files: tuple[TruthFile, ...], computation: Computation | None = None, **values: Any) -> Request:
    """Request for the outputs that these files of ground truth store; without files, it has no outputs."""
    from clsco.plan.request import Request

    if computation is not None:
        values |= {name: getattr(computation, name) for name in ("precision", "memory", "tolerance")}
    if not files:
        return Request(**values)
    from clsco.frame.files import needed_truth

    return Request(needed_truth(files), **values)


def render_to_folders(
    loaded: Loaded, out: Path, files: tuple[TruthFile, ...], computation: Computation, quiet: bool,
    span: Span = (None, None), resume: bool = False, subframes: bool = False, preset: str | None = None,
    color: bool = True, check: bool = False,
) -> None:  # fmt: skip
    """Plan scenes, and render the scenes of each file into a folder in `out`; other arguments as for `render`."""
    if files:
        from clsco.frame.files import require_truth_formats

        require_truth_formats(files)
    from clsco.cli.progress import frame_progress
    from clsco.plan.prepare import prepare_files

    request = request_for(files, computation, color=color)
    if subframes:
        request = replace(request, truth=tuple(dict.fromkeys((*request.truth, "subframes"))))
    prepared = prepare_files(loaded, request)
    report_inputs(prepared)
    options.require_device(computation.device)
    from clsco.engine import batch

    if preset is not None:
        require_clips(prepared, preset)
    jobs = batch.prepare_all(prepared, out, files, span, resume)
    if preset is not None:
        remove_clips(jobs, preset)  # clips of older frames
    with frame_progress(sum(len(job.frames) for job in jobs), quiet, computation.device) as advance:
        for _ in batch.run(jobs, computation.device, check):
            advance()
    if preset is not None:
        write_clips(jobs, preset)
    if not quiet:
        echo(_written(out, jobs))


def _written(out: Path, jobs: Sequence[Job]) -> str:
    place, count = click.format_filename(out), sum(len(job.frames) for job in jobs)
    if not count:
        return f"{place}: all frames are there already"
    first = next(job for job in jobs if job.frames)
    views = " of two views" if len(first.prepared.plans) > 1 else ""
    where = f" in {len(jobs)} folders" if len(jobs) > 1 else ""
    image = ("png",) if first.prepared.plan.color else ()
    kinds = ", ".join(dict.fromkeys((*image, "json", *(file.format for file in first.files))))
    return f"{place}: {count} frame{'s' * (count > 1)}{views}{where}, from frame_{first.frames[0]:04d} on: {kinds}"
