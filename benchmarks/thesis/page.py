"""The page of the thesis: its figures, each with a caption, and its numbers beside those that are measured."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from html import escape
from importlib.resources import as_file
from pathlib import Path

import numpy as np
from PIL import Image

from benchmarks.thesis.figures import (
    FIGURES,
    OTHERS,
    TRUTH,
    Figure,
    Number,
    RenderedScene,
    numbers_named,
    union_of_missing,
)
from clsco.cli.progress import progress
from clsco.engine import batch
from clsco.engine.batch import Job
from clsco.files.atomic import atomic_folder, atomic_write, make_writable_folder
from clsco.files.images import read_image, write_png
from clsco.frame.frame import Frame
from clsco.plan.prepare import prepare
from clsco.plan.request import Request
from clsco.resources import folder
from clsco.scene.file import load_scene
from clsco.scene.model import Scene

PAGE, PART = "thesis", "thesis_only"  # of all figures, and of some; .md and .html
NUMBERS_PAGE = "_numbers.md"  # after these names; that of all figures is in benchmarks/results
PICTURES = "thesis_figures"
ACROSS, SIDE, GAP, PAPER = 3, 256, 6, 250  # pictures in a row of a figure, and px
QUALITY = 80  # of the figures beside the page, WebP; their files in DIR are PNG

INTRODUCTION = """\
# The thesis, figure by figure

The figures and numbers of K. Sathyanarayana's thesis *Generating Video Frames with Depth Of Field and Motion Blur
Effects for 3D Animation*, rendered by the thesis' method. In a checkout `python -m benchmarks thesis -o DIR` renders
the scenes of `examples/thesis` into folders of DIR, and writes this page and DIR/thesis.html, with the figures in full
size. `--only 4.9` renders this figure alone, and names the pages thesis_only.
"""
NUMBERS_HEAD = """\
## Numbers

A number agrees if it equals the stated one in all its digits, or is within a stated bound; "(around) 6 pixels" counts
as at most 6.5. Some numbers depend on sizes that the thesis does not state.

"""
COLUMNS = ("figure", "what", "stated", "got", "verdict", "note")
INPUTS_HEAD = "Inputs, as stated:\n\n"
ALL_NUMBERS = "[all numbers](../benchmarks/results/thesis_numbers.md)"
NUMBERS_TITLE = "# Numbers of the thesis\n\n`python -m benchmarks thesis -o DIR`\n"
FIGURES_HEAD = """\
## Figures

DIR/thesis.html lists the values that the thesis does not state.

| | | |
|---|---|---|
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
                made = RenderedScene(job.prepared.scene, tuple(rendered.pop(stem)))
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


def _number_cells(number: Number, got: float) -> tuple[str, ...]:
    """Cells of a row, as COLUMNS has them."""
    return number.figure, number.what, number.stated, _got(number, got), _verdict(number, got), number.note


def _got(number: Number, got: float) -> str:
    return f"{got + 0.0:.{number.digits}f}"


def _caption(figure: Figure) -> str:
    chosen = f" Chosen: {figure.chosen}." if figure.chosen else ""
    return f"{figure.number}: {figure.shows}.{chosen}"


def _small(figure: Figure) -> str:
    """Name of the picture of a figure beside the page."""
    return f"{PICTURES}/{figure.number}.webp"


def _numbers_table(values: Values) -> str:
    head = _row(COLUMNS) + "|---" * len(COLUMNS) + "|\n"
    return head + "".join(_row(_number_cells(*item)) for item in values.items())


def numbers_page(values: Values) -> str:
    """All numbers in Markdown, and the inputs."""
    inputs = {number: got for number, got in values.items() if _verdict(number, got) == "input"}
    parts = [NUMBERS_TITLE, _numbers_table({number: values[number] for number in values if number not in inputs})]
    if inputs:
        lines = (f"- {number.figure}: {number.what} {_got(number, got)}" for number, got in inputs.items())
        notes = (f" ({number.note})" * bool(number.note) for number in inputs)
        parts.append(INPUTS_HEAD + "".join(f"{line}{note}\n" for line, note in zip(lines, notes, strict=True)))
    return "\n".join(parts)


def page(figures: Collection[Figure], values: Values) -> str:
    """The page in Markdown: numbers that do not agree, figures, and a list of figures that are not rendered."""
    parts = [INTRODUCTION]
    verdicts = {number: _verdict(number, got) for number, got in values.items() if number.stated}
    if values:
        others = {number: values[number] for number, word in verdicts.items() if word not in ("agrees", "input")}
        count = f"{len(verdicts) - len(others)} of {len(verdicts)} agree ({ALL_NUMBERS})."
        parts.append(f"{NUMBERS_HEAD}{count} The others:\n\n{_numbers_table(others)}")
    if figures:
        cells = [f"![{figure.number}]({_small(figure)})<br>{figure.number}: {figure.shows}" for figure in figures]
        rows = (cells[first : first + ACROSS] for first in range(0, len(cells), ACROSS))
        parts.append(FIGURES_HEAD + "".join(_row([*row, *[""] * (ACROSS - len(row))]) for row in rows))
    parts.append(OTHERS_HEAD + "".join(map(_row, OTHERS)))
    return "\n".join(parts)


def _plain(cell: str) -> str:
    """A cell of the page in Markdown without its marks of code."""
    return cell.replace("`", "")


STYLE = """\
body { font: 16px/1.5 sans-serif; max-width: 1600px; margin: 2em auto; padding: 0 1em }
figure { margin: 2em 0 } figure img { max-width: 100%; margin: 0 6px 6px 0 }
figcaption { max-width: 60em } table { border-collapse: collapse } td, th { border: 1px solid #bbb; padding: 2px 8px }
"""


def html_page(figures: Iterable[Figure], values: Values) -> str:
    """The page in HTML: each figure in full size with its caption, its numbers below it."""
    shown = []
    for figure in figures:
        rows = [row for row in values if figure.number in numbers_named(row.figure)]
        images = "".join(f'<img alt="" src="{escape(picture)}">' for picture in figure.pictures)
        cells = (_number_cells(row, values[row]) for row in rows)
        table = "".join(f"<tr>{''.join(f'<td>{escape(_plain(cell))}</td>' for cell in row)}</tr>" for row in cells)
        head = "<tr>" + "".join(f"<th>{name}</th>" for name in COLUMNS) + "</tr>"
        numbers = f"<table>{head}{table}</table>" if rows else ""
        shown.append(f"<figure>{images}<figcaption>{escape(_caption(figure))}</figcaption>{numbers}</figure>\n")
    title = "The thesis, figure by figure"
    start = f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><title>{title}</title>\n'
    return f"{start}<style>\n{STYLE}</style></head><body>\n<h1>{title}</h1>\n{''.join(shown)}</body></html>\n"


def small_figure(out: Path, figure: Figure) -> Image.Image:
    """The pictures of a figure in rows, each SIDE px wide, gray."""
    rows = -(-len(figure.pictures) // ACROSS)
    across = min(len(figure.pictures), ACROSS)
    paper = Image.new("L", (across * (SIDE + GAP) - GAP, rows * (SIDE + GAP) - GAP), PAPER)
    for place, name in enumerate(figure.pictures):
        row, column = divmod(place, ACROSS)
        small = Image.fromarray(read_image(out / name).data).resize((SIDE, SIDE), Image.Resampling.BOX)
        paper.paste(small, (column * (SIDE + GAP), row * (SIDE + GAP)))
    return paper


def write_page(out: Path, name: str, figures: Collection[Figure], values: Values) -> None:
    """Write the pictures of figures, and then both pages, which are called `name`. Raises FileError."""
    if figures:
        with atomic_folder(make_writable_folder(out / PICTURES), "figures") as made:
            for figure in figures:
                with atomic_write(made / Path(_small(figure)).name) as file:
                    small_figure(out, figure).save(file, "WEBP", quality=QUALITY)
    with atomic_folder(out, name) as made:
        texts = {NUMBERS_PAGE: numbers_page(values)} if values else {}
        texts |= {".md": page(figures, values), ".html": html_page(figures, values)}
        for ending, text in texts.items():
            with atomic_write(made / f"{name}{ending}") as file:
                file.write(text.encode())
