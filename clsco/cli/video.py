"""The command `clsco video`, and clips beside the frames of `clsco render --video`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from clsco.cli.options import PATH, PRESET, option, quiet_option
from clsco.cli.output import echo
from clsco.errors import ArgumentError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsco.engine.batch import Job
    from clsco.plan.prepare import PreparedFile


def _rate(text: str) -> Fraction:
    from clsco.files.video import parse_rate

    try:
        return parse_rate(text, "rate")
    except ArgumentError as error:
        raise click.BadParameter(str(error).removeprefix("rate: ")) from None


@click.command()
@click.argument("folder", metavar="DIR", type=PATH)
@option("-o out", "OUT", "File for the clip: .mp4, .webm, .mkv, .mov or .y4m.", PATH, required=True)
@option(
    "--preset", "NAME",
    "mp4, mp4-444, hevc10, av1, webm, h264-lossless, ffv1, ffv1-16, prores, prores-hq or y4m. Default: the first of "
    "these with the extension of OUT.",
    PRESET,
)  # fmt: skip
@click.option(
    "--view", type=click.Choice(["color", "sharp", "coc", "depth", "flow", "compare"]), default="color",
    show_default=True, help="coc, depth and flow as colors; compare: sharp and color side by side.",
)  # fmt: skip
@option("--fps", "RATE", "Frames per second, like 24000/1001. Default: 1 / interval.", _rate)
@option("--speed", "FACTOR", "Play so many times as fast as the scene, such as 0.25.", _rate)
@quiet_option
def video(
    folder: Path, out: Path, preset: str | None, view: str, fps: Fraction | None, speed: Fraction | None, quiet: bool
) -> None:
    """Make a clip of the frames in DIR, which clsco render wrote; or, with --fps, of other images, by number and name.

    Each view of stereo pairs has a clip, such as clip_left.mp4 and clip_right.mp4. Depth, blur radius and flow are
    shown as colors, on one scale for the whole clip, which is reported; they need frames rendered with --truth all,
    as npz or exr.
    """
    if fps is not None and speed is not None:
        raise click.UsageError("--speed: must be without --fps, which says how fast the clip is")
    from clsco.cli.progress import progress
    from clsco.files.video import preset_for, require_video
    from clsco.frame.frame_folder import plain_images, read_frame_folder
    from clsco.frame.video import Playing, clip_path, write_folder_clip

    name = preset_for(out, preset)
    require_video(out)
    if paths := plain_images(folder):
        _write_images(out, paths, fps, view, name, quiet)
        return
    frames, playing = read_frame_folder(folder), Playing(fps, speed or Fraction(1))
    with progress(len(frames.numbers) * len(frames.eyes), quiet) as advance:
        for eye in frames.eyes:
            target = clip_path(out, eye)
            _report(target, write_folder_clip(target, frames, eye, view, name, playing, advance))


def _write_images(out: Path, paths: Sequence[Path], fps: Fraction | None, view: str, preset: str, quiet: bool) -> None:
    """Write a clip of images that `clsco render` did not write, and that have no rate and no other arrays."""
    from clsco.cli.progress import progress
    from clsco.files.images import read_image
    from clsco.frame.video import write_video

    if fps is None or view != "color":
        raise click.UsageError("--fps: images that clsco render did not write need it, and have only --view color")
    with progress(len(paths), quiet, "images") as advance:

        def pictures() -> Iterator[NDArray[Any]]:
            for path in paths:
                yield read_image(path).data
                advance()

        notes = write_video(out, pictures(), fps, preset=preset)
    _report(out, [f"{len(paths)} images, {paths[0].name} to {paths[-1].name}, at {fps} per second", *notes])


def _report(where: Path, facts: Sequence[str]) -> None:
    for fact in facts:
        echo(f"{click.format_filename(where)}: {fact}", err=True)


def require_clips(planned: Sequence[PreparedFile], preset: str) -> None:
    """Fail, before any frame is rendered, if PyAV is missing or the preset cannot store a scene's clip."""
    from clsco.files.video import rate_of, require_size, require_video

    for path, _, prepared in planned:
        require_video(path)
        for each in prepared:
            rate_of(each.scene.sequence.interval, str(path))
            require_size(path, preset, each.plan.columns, each.plan.rows)


def _clips(job: Job, preset: str) -> list[tuple[str, Path]]:
    """Views of a job's frames, each with the path of its clip."""
    from clsco.frame.video import clip_path, folder_clip

    eyes = ("",) if job.prepared.scene.stereo is None else ("left", "right")
    return [(eye, clip_path(folder_clip(job.folder, preset), eye)) for eye in eyes]


def remove_clips(jobs: Sequence[Job], preset: str) -> None:
    """Remove clips of older frames, which are about to be replaced."""
    from clsco.files.atomic import remove_file

    for job in jobs:
        for _, path in _clips(job, preset) if job.frames else ():
            remove_file(path)


def write_clips(jobs: Sequence[Job], preset: str) -> None:
    """Write a clip beside the frames of each job, or print that some of them are missing or of another scene."""
    from clsco.frame.files import frame_json
    from clsco.frame.frame_folder import read_frame_folder
    from clsco.frame.video import Playing, write_folder_clip

    for job in jobs:
        numbers = range(job.prepared.scene.sequence.frames)
        missing = [number for number in numbers if not frame_json(job.folder, number).is_file()]
        if missing:
            _report(
                job.folder,
                [f"no clip, as {len(missing)} of {len(numbers)} frames are missing, frame {missing[0]} first"],
            )
            continue
        frames = read_frame_folder(job.folder, numbers)
        if frames.scenes != {job.record["scene_sha256"]}:
            _report(job.folder, ["no clip, as some of the frames are of another scene"])
            continue
        for eye, path in _clips(job, preset):
            _report(path, write_folder_clip(path, frames, eye, "color", preset, Playing()))
