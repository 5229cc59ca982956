"""The page of the thesis: its figures as files, its numbers beside those that are measured, and a sheet of pictures."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from importlib.resources import as_file
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from clsco.cli.progress import progress
from clsco.cli.thesis_figures import (
    FIGURES,
    OTHERS,
    TRUTH,
    Figure,
    Made,
    Number,
    numbers_named,
    union_of_missing,
)
from clsco.engine import batch
from clsco.engine.batch import Job
from clsco.files.atomic import together, whole_file
from clsco.files.images import read_image, write_png
from clsco.frame.frame import Frame
from clsco.plan.prepare import prepare
from clsco.plan.request import Request
from clsco.resources import folder
from clsco.scene.file import load_scene
from clsco.scene.model import Scene

PAGE, SHEET = "thesis.md", "thesis.png"
ACROSS, SIDE, GAP, LINE = 12, 72, 6, 16  # pictures in a row of the sheet, and px
PAPER, INK = 250, 20
MOST_NAMED = 3  # files of a figure; of more the first two and the last are

INTRODUCTION = """\
# The thesis, figure by figure

This page compares the figures and numbers of K. Sathyanarayana's thesis *Generating Video Frames with Depth Of Field
and Motion Blur Effects for 3D Animation* with those that clsco makes by the thesis' own method. `clsco thesis -o DIR`
renders all of them, and writes this page.
"""
NUMBERS_HEAD = """\
## Numbers

A number agrees where it is the stated one in all digits that are stated, or within "about". What clsco takes over as it
is stated is an input. Where the thesis does not state the sizes or distances that a number depends on, they are chosen,
and it cannot be expected to agree: those of figures 4.13, 4.16 and 4.17, of a sphere, a cylinder and a cone.

| figure | what | stated | got | verdict | scene | note |
|---|---|---|---|---|---|---|
"""
FIGURES_HEAD = f"""\
## Figures

![The pictures of all figures, in order]({SHEET})

Files are in DIR, each in a folder of the name of its scene in `examples/thesis`.

| figure | shows | files | what the thesis does not state, and is chosen |
|---|---|---|---|
"""
OTHERS_HEAD = """\
## Not rendered

| figures | why |
|---|---|
"""
Values = Mapping[Number, float]


def scenes_of(figures: Iterable[Figure], numbers: Iterable[Number]) -> dict[str, Scene]:
    """The scenes that they need, by stem."""
    stems = dict.fromkeys(stem for figure in figures for stem in figure.scenes)
    stems |= dict.fromkeys(stem for number in numbers for stem in number.scenes)
    with as_file(folder("examples") / "thesis") as place:
        return {stem: load_scene(place / f"{stem}.toml") for stem in stems}


def _job(out: Path, figures: Iterable[Figure], stem: str, scene: Scene) -> Job:
    """All frames of a scene, with their sub-frames where a figure shows them."""
    shown = any(f"{stem}/" in picture and "_sample_" in picture for figure in figures for picture in figure.pictures)
    prepared = prepare(scene, Request((*TRUTH, "subframes") if shown else TRUTH))
    return batch.prepare(prepared, out / stem, range(scene.sequence.frames), (), False)


def render(
    out: Path, figures: Collection[Figure], numbers: Collection[Number], device: str | None, quiet: bool
) -> dict[Number, float]:
    """Render the scenes of figures and numbers to folders in `out`, and measure the numbers.

    Masks are `missing.png` in these folders, white where pixels are missing, as `clsco inpaint` takes them. Raises as
    `clsco.render` and `clsco.frame.files.write_frame`.
    """
    jobs = [_job(out, figures, *scene) for scene in scenes_of(figures, numbers).items()]
    pictures = {picture for figure in figures for picture in figure.pictures}
    rendered: dict[str, list[Frame]] = {job.folder.name: [] for job in jobs}
    found: dict[Number, list[float]] = {number: [] if number.scenes else [number.measure()] for number in numbers}
    with progress(sum(len(job.frames) for job in jobs), quiet) as advance:
        for job, frames in batch.run(jobs, device):
            stem = job.folder.name
            rendered[stem] += frames
            if len(rendered[stem]) == len(job.frames):
                made = Made(job.prepared.scene, tuple(rendered.pop(stem)))
                if (mask := f"{stem}/missing.png") in pictures:
                    write_png(out / mask, np.where(union_of_missing(made.frames), 255, 0).astype(np.uint8))
                for number in numbers:
                    found[number] += [number.measure(made)] if stem in number.scenes else []
            advance()
    return {number: max(values) for number, values in found.items()}


def _verdict(number: Number, got: float) -> str:
    sized = {figure.number: figure.is_sized for figure in FIGURES}
    if not number.stated:
        return "not stated"
    if number.agrees(got):
        return "input" if number.is_input else "agrees"
    return "differs" if all(sized.get(name, True) for name in numbers_named(number.figure)) else "size not stated"


def _row(cells: Iterable[str]) -> str:
    return f"| {' | '.join(cells)} |\n"


def _number_row(number: Number, got: float) -> str:
    scene = f"`{number.scenes[0]}`" if number.scenes else "defaults of `clsco inpaint`"
    more = f" and {len(number.scenes) - 1} more" if len(number.scenes) > 1 else ""
    value = f"{got + 0.0:.{number.digits}f}"
    return _row(
        (number.figure, number.what, number.stated, value, _verdict(number, got), scene + more, number.note)
    )  # fmt: skip


def _figure_row(figure: Figure) -> str:
    files = [f"`{picture}`" for picture in figure.pictures]
    if len(files) > MOST_NAMED:
        files = [*files[:1], f"{files[1]} to {files[-1]}"]
    return _row((figure.number, figure.shows, ", ".join(files), figure.chosen))


def page(figures: Collection[Figure], values: Values) -> str:
    """The page in Markdown: numbers, figures, and what is not rendered."""
    parts = [INTRODUCTION]
    if values:
        parts.append(NUMBERS_HEAD + "".join(_number_row(number, got) for number, got in values.items()))
    if figures:
        parts.append(FIGURES_HEAD + "".join(map(_figure_row, figures)))
    parts.append(OTHERS_HEAD + "".join(map(_row, OTHERS)))
    return "\n".join(parts)


def sheet(out: Path, figures: Iterable[Figure]) -> NDArray[np.uint8]:
    """All pictures with the figure's number below each, gray (rows, columns)."""
    pictures = [(figure.number, picture) for figure in figures for picture in figure.pictures]
    rows = -(-len(pictures) // ACROSS)
    paper = Image.new("L", (GAP + ACROSS * (SIDE + GAP), GAP + rows * (SIDE + LINE + GAP)), PAPER)
    draw, font = ImageDraw.Draw(paper), ImageFont.load_default(11)
    for place, (number, name) in enumerate(pictures):
        row, column = divmod(place, ACROSS)
        x, y = GAP + column * (SIDE + GAP), GAP + row * (SIDE + LINE + GAP)
        small = Image.fromarray(read_image(out / name).data).resize((SIDE, SIDE), Image.Resampling.BOX)
        paper.paste(small, (x, y))
        draw.text((x, y + SIDE + 1), number, fill=INK, font=font)
    return np.asarray(paper)


def write_page(out: Path, figures: Collection[Figure], values: Values) -> None:
    """Write page and sheet, both or none. Raises ImageError where they cannot be written."""
    with together(out, "thesis") as made:
        if figures:
            write_png(made / SHEET, sheet(out, figures))
        with whole_file(made / PAGE) as file:
            file.write(page(figures, values).encode())
