"""Commands that read scenes: `clsco demo`, `plan`, `check`, `schema` and `validate`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from clsco.cli import options
from clsco.cli.inputs import first_scene, report_scenes
from clsco.cli.options import PATH, Computation, NumberRange, option
from clsco.cli.output import echo
from clsco.cli.render import request_for, require_uncolored
from clsco.errors import DeviceError, MissingDependencyError, SceneError

if TYPE_CHECKING:
    from clsco.frame.truth_files import TruthFile
    from clsco.opencl.session import Session


@click.command()
@option("-o out", "DIR", "Folder.", PATH, shown=Path("demo"))
@options.device_option
@options.quiet_option
def demo(out: Path, device: str | None, quiet: bool) -> None:
    """Render some of the example scenes, and a sheet that shows them and their ground truth."""
    options.require_device(device)
    from clsco.cli.progress import progress
    from clsco.cli.sheets import DETAILS, demo_sheet
    from clsco.engine import batch
    from clsco.files.images import write_png
    from clsco.frame.truth_files import TruthFile
    from clsco.plan.prepare import prepare
    from clsco.scene.examples import EXAMPLES, example

    files = (TruthFile("npz"),)
    scenes = {name: prepare(example(name), request_for(files)) for name in EXAMPLES}
    jobs = [
        batch.prepare(each, out / name, range(each.scene.sequence.frames), files, False)
        for name, each in scenes.items()
    ]
    shown = {}
    with progress(sum(len(job.frames) for job in jobs), quiet) as advance:
        for job, frames in batch.run(jobs, device):
            shown[job.folder.name] = frames  # each frame of a sequence replaces the one before, so the last one stays
            advance()
    sheet = demo_sheet({EXAMPLES[name]: views[0] for name, views in shown.items()}, [shown[name] for name in DETAILS])
    write_png(out / "contact_sheet.png", sheet)
    place = click.format_filename(out)
    echo(f"{place}/contact_sheet.png: all scenes, and the ground truth of some")
    echo(f"{place}/NAME/frame_0000.png, .npz, .json: image, truth and parameters; NAME is one of")
    echo(f"  {', '.join(scenes)}")


@click.command()
@options.scene_argument
@options.set_option
@options.truth_options
@options.no_color_option
@options.computation_options
@options.flag("--json machine", "Print passes, bytes and predicted seconds as JSON.")
def plan(
    scene: Path, overrides: tuple[str, ...], files: tuple[TruthFile, ...], no_color: bool, computation: Computation,
    machine: bool,
) -> None:  # fmt: skip
    """Report what rendering a scene takes, and how long: passes, memory, and time, which is measured on a part of a
    frame.

    Without OpenCL, the time is omitted.
    """
    require_uncolored(files, no_color)
    session, used = _session_of_plan(computation.device)
    request = request_for(files, computation, color=not no_color)
    first = first_scene(scene, overrides, request, None if session is None else session.device, machine)
    report_scenes(scene, ("",), [first], close=True)
    from clsco.cli.plan_tables import plan_tables, planned_values
    from clsco.cli.tables import print_tables

    time = None
    if session is not None:
        from clsco.engine.probe import measure_frame

        time = measure_frame(session, first)
    if machine:
        echo(json.dumps(planned_values(first.plans, used, time), indent=2))
    else:
        print_tables(*plan_tables(first.plans, used, time))


def _session_of_plan(device: str | None) -> tuple[Session | None, str]:
    """Session and name of the device that measures the plan; if there is none and none was requested, None and why."""
    try:
        options.require_opencl()
        from clsco.opencl.session import session_for

        session = session_for(device)
    except (DeviceError, MissingDependencyError) as error:
        if device is not None:
            raise
        return None, f"none: {str(error).removeprefix('device: ')}"
    return session, str(session.device)


@click.command()
@options.scene_argument
@option(
    "--rays", "N", "Most rays of a pixel; 0: the reference alone, without the extra.", click.IntRange(0), shown=2**16
)
@option(
    "--seconds", "S", "Time for all rays, which ends at a standard error of 1e-3 of white.", NumberRange(min=0.0),
    shown=20.0,
)  # fmt: skip
@option("-o out", "OUT", "File: .json for all figures, .png for a picture of the pixels tried.", PATH)
@options.set_option
@options.device_option
@options.precision_option
def check(
    scene: Path, rays: int, seconds: float, out: Path | None, overrides: tuple[str, ...], device: str | None,
    precision: str | None,
) -> None:  # fmt: skip
    """Compare frames with the NumPy reference, output by output, and with rays through the real lens.

    Fails if color differs from the reference by more than 1e-5 of white (in single precision, by more than 1e-4 in
    more than 1 of 500 pixels), or a pixel from rays by more than 0.01 of white and 5 standard errors. Rays need
    clsco[check].
    """
    from clsco.cli.check import check_scene, require_report

    if out is not None:
        require_report(out)
    if rays:
        from clsco.truth import require_rays

        require_rays()
    first = first_scene(scene, overrides, request_for((), precision=precision))
    options.require_device(device)
    check_scene(scene, first.scene, (rays, seconds), out, device, precision)


@click.command()
def schema() -> None:
    """Print the JSON Schema of a scene file."""
    from clsco.scene.schema import scene_schema

    echo(json.dumps(scene_schema(), indent=2))


@click.command()
@options.scenes_argument
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
