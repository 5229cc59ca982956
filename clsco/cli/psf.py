"""The command `clsco psf`: the point spread functions of a scene's lens, as arrays or as a picture."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from clsco.cli.inputs import first_scene
from clsco.cli.options import PATH, option, scene_argument, set_option
from clsco.cli.output import echo
from clsco.errors import ClscoError

if TYPE_CHECKING:
    from clsco.reference.spreads import PsfStack

SUFFIXES = (".npz", ".png")


def _numbers(text: str, rule: str) -> tuple[float, ...]:
    try:
        return tuple(float(part) for part in text.split(","))
    except ValueError:
        raise click.BadParameter(f"must be {rule}; got {text}") from None


@click.command()
@scene_argument
@option("-o out", "OUT", "File: .npz for the weights and their axes, .png for a picture of them.", PATH, required=True)
@option(
    "--at", "X Y",
    "Column and row of the source in the frame, counted from 0; may be given again. Default: the middle.",
    float, nargs=2, multiple=True,
)  # fmt: skip
@option(
    "--depths", "Z,Z,...",
    "Depths of the source, mm; inf is one. Default: nine through the focus, to the largest |R| of the scene.",
    lambda text: _numbers(text, "Z,Z,..., distances in mm"),
)  # fmt: skip
@option(
    "--wavelengths", "NM,NM,...", 'Wavelengths in place of colors, nm; only with psf.model = "wave".',
    lambda text: _numbers(text, "NM,NM,..., wavelengths in nm"),
)  # fmt: skip
@option("--frame index", "N", "Frame whose lens is taken. Default: 0.", int, default=0)
@set_option
def psf(scene: Path, out: Path, at: tuple[tuple[float, float], ...], overrides: tuple[str, ...], **lens: Any) -> None:
    """Write the point spread functions of a scene's lens: the weights that its frames are made with.

    The functions are for a source that is not occluded, at depths on both sides of the focal surface. Needs no OpenCL.
    """
    if out.suffix.lower() not in SUFFIXES:
        raise ClscoError(f"{click.format_filename(out)}: must end in {' or '.join(SUFFIXES)}")
    from clsco.plan.request import Request
    from clsco.reference.spreads import psf_of

    stack = psf_of(first_scene(scene, overrides, Request()), at or None, **lens)
    if out.suffix.lower() == ".npz":
        from clsco.files.images import write_npz

        write_npz(out, stack.arrays())
    else:
        from clsco.cli.sheets import psf_sheet
        from clsco.files.images import write_png

        write_png(out, psf_sheet(stack))
    echo(f"{click.format_filename(out)}: {_about(stack)}")


def _about(stack: PsfStack) -> str:
    channels, places, depths, side, _ = stack.weights.shape
    counts = [f"{channels} channels"] * (channels > 1) + [f"{places} places"] * (places > 1) + [f"{depths} depths"]
    low, high = float(stack.radius.min()), float(stack.radius.max())
    return f"{stack.name}: {', '.join(counts)}, {side} x {side} px, R {low:.4g} to {high:.4g} px"
