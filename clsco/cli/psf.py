"""The command `clsco psf`: the point spread functions of a scene's lens, as arrays or as a picture."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from clsco.cli.inputs import first_scene
from clsco.cli.options import PATH, scene_argument, set_option
from clsco.cli.output import echo
from clsco.errors import ClscoError

if TYPE_CHECKING:
    from clsco.reference.spreads import PsfStack

SUFFIXES = (".npz", ".png")


def _depths(text: str) -> tuple[float, ...]:
    return _numbers(text, "Z,Z,..., distances in mm")


def _wavelengths(text: str) -> tuple[float, ...]:
    return _numbers(text, "NM,NM,..., wavelengths in nm")


def _numbers(text: str, rule: str) -> tuple[float, ...]:
    try:
        return tuple(float(part) for part in text.split(","))
    except ValueError:
        raise click.BadParameter(f"must be {rule}; got {text}") from None


@click.command()
@scene_argument
@click.option(
    "-o", "out", metavar="OUT", required=True, type=PATH,
    help="File: .npz for the weights and their axes, .png for a picture of them.",
)  # fmt: skip
@click.option(
    "--at", metavar="X Y", type=float, nargs=2, multiple=True,
    help="Column and row of the source in the frame, counted from 0; may be given again. Default: the middle.",
)  # fmt: skip
@click.option(
    "--depths", metavar="Z,Z,...", type=_depths,
    help="Depths of the source, mm; inf is one. Default: nine through the focus, to the largest |R| of the scene.",
)  # fmt: skip
@click.option(
    "--wavelengths", metavar="NM,NM,...", type=_wavelengths,
    help="Wavelengths in place of colors, nm; only with psf.model = \"wave\".",
)  # fmt: skip
@click.option("--frame", "index", metavar="N", type=int, default=0, help="Frame whose lens is taken. Default: 0.")
@set_option
def psf(
    scene: Path,
    out: Path,
    at: tuple[tuple[float, float], ...],
    depths: tuple[float, ...] | None,
    index: int,
    wavelengths: tuple[float, ...] | None,
    overrides: tuple[str, ...],
) -> None:
    """Write the point spread functions of a scene's lens: the weights that its frames are made with.

    The functions are for a source that is not occluded, at depths on both sides of the focal surface. Needs no OpenCL.
    """
    if out.suffix.lower() not in SUFFIXES:
        raise ClscoError(f"{click.format_filename(out)}: must end in {' or '.join(SUFFIXES)}")
    from clsco.plan.request import Request
    from clsco.reference.spreads import psf_of

    stack = psf_of(first_scene(scene, overrides, Request()), at or None, depths, index, wavelengths)
    if out.suffix.lower() == ".npz":
        from clsco.files.images import write_npz

        write_npz(out, stack.arrays())
    else:
        from clsco.cli.psf_sheet import sheet
        from clsco.files.images import write_png

        write_png(out, sheet(stack))
    echo(f"{click.format_filename(out)}: {_about(stack)}")


def _about(stack: PsfStack) -> str:
    channels, places, depths, side, _ = stack.weights.shape
    counts = [f"{channels} channels"] * (channels > 1) + [f"{places} places"] * (places > 1) + [f"{depths} depths"]
    low, high = float(stack.radius.min()), float(stack.radius.max())
    return f"{stack.name}: {', '.join(counts)}, {side} x {side} px, R {low:.4g} to {high:.4g} px"
