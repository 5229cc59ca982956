"""Commands that read scenes: `clsco demo`, `plan`, `check`, `schema` and `validate`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from clsco.cli.inputs import first_scene, report_scenes
from clsco.cli.options import (
    PATH,
    device_option,
    memory_option,
    no_color_option,
    precision_option,
    quiet_option,
    require_device,
    scene_argument,
    scenes_argument,
    set_option,
    truth_options,
)
from clsco.cli.output import echo
from clsco.cli.render import request_for, require_uncolored
from clsco.errors import SceneError

if TYPE_CHECKING:
    from clsco.frame.truth_files import TruthFile
    from clsco.plan.prepare import Prepared


@click.command()
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


@click.command()
@scene_argument
@set_option
@truth_options
@no_color_option
@memory_option
@click.option("--gpu", is_flag=True, help="On a graphics card instead of a processor.")
@click.option("--json", "machine", is_flag=True, help="Print passes, bytes and predicted seconds as JSON.")
def plan(
    scene: Path,
    overrides: tuple[str, ...],
    files: tuple[TruthFile, ...],
    no_color: bool,
    memory: int | None,
    gpu: bool,
    machine: bool,
) -> None:
    """Report what rendering a scene takes, and how long; runs nothing, and needs no OpenCL."""
    from clsco.plan.device import ThisMachine

    require_uncolored(files, no_color)
    device = ThisMachine(kind="gpu") if gpu else None
    first = first_scene(scene, overrides, request_for(files, memory=memory, color=not no_color), device, machine)
    report_scenes(scene, ("",), [first], close=True)
    from clsco.cli.plan_tables import plan_tables, planned_values
    from clsco.cli.tables import print_tables
    from clsco.cost.cheaper import cheaper_settings
    from clsco.cost.predict import cost_of

    cost = cost_of(first)
    cheaper = () if cost is None else cheaper_settings(first, cost)
    if machine:
        echo(json.dumps(planned_values(first.plans, cost, cheaper), indent=2))
    else:
        print_tables(*plan_tables(first.plans, cost, cheaper))


@click.command()
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


@click.command()
def schema() -> None:
    """Print the JSON Schema of a scene file."""
    from clsco.scene.schema import scene_schema

    echo(json.dumps(scene_schema(), indent=2))


@click.command()
@scenes_argument
def validate(scenes: tuple[Path, ...]) -> None:
    """Check scene files and their textures without rendering: reports valid files, and all faults of the others.

    Warns of frames that will take more than a minute, with the keys that take less and their error.
    """
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
        most = max(prepared, key=lambda each: each.plan.taps)
        if warning := _long_frame(most):
            label = labels[prepared.index(most)]
            where = f"{path} (with {label})" if label else f"{path}"
            echo(f"{where}: {warning}", err=True)
    if faults:
        raise SceneError(faults)


def _long_frame(prepared: Prepared) -> str | None:
    """Warning of a frame that takes long; frames that are short at a glance are not predicted, to answer at once."""
    from clsco.cost.short import LONG_FRAME, most_seconds

    if most_seconds(prepared.plan) < LONG_FRAME:
        return None
    from clsco.cost.cheaper import warning_of

    return warning_of(prepared)
