"""Scenes to start from: the examples, and figures of the thesis, with the numbers in their captions."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsco.files.images import read_image
from clsco.inputs.textures import bricks
from clsco.resources import folder
from clsco.scene.file import read_mapping
from clsco.studio.session import Document
from clsco.studio.tables import Table

FIRST = "evening"  # the preset that a studio without a scene begins with
OF_THE_THESIS = "Figures of the thesis"
PICTURES = Path(__file__).parent / "static" / "presets"  # from python -m benchmarks.gallery
_METHOD = ("psf", "image", "motion", "fill")  # sections that set the method, not the scene


@dataclass(frozen=True)
class ScenePreset:
    """A scene of the package: name of its file in the examples, "thesis/fig_3_04_left", its caption, and a heading."""

    name: str
    title: str
    group: str

    @property
    def path(self) -> Path:
        return _shipped(f"{self.name}.toml")

    @property
    def picture(self) -> str:
        """URL of a small picture."""
        return f"static/presets/{self.name}.webp"


@cache
def presets() -> tuple[ScenePreset, ...]:
    """The examples, ordered by topic, then the figures of the thesis in order."""
    groups: dict[str, list[str]] = json.loads((PICTURES / "groups.json").read_bytes())
    groups[OF_THE_THESIS] = [f"thesis/{path.stem}" for path in sorted(_shipped("thesis").glob("*.toml"))]
    found = [ScenePreset(name, "", group) for group, names in groups.items() for name in names]
    found = [replace(preset, title=str(read_mapping(str(preset.path), ())["title"])) for preset in found]
    titles = [preset.title for preset in found]
    return tuple(_numbered(preset) if titles.count(preset.title) > 1 else preset for preset in found)


def load_preset(session: Document, name: str) -> None:
    """Go to the scene of a preset, as an undo step."""
    path = _shipped(f"{name}.toml")
    session.load_table(read_mapping(str(path), ()), path.parent)


def is_as_the_thesis(session: Document) -> bool:
    """True if [psf] and [image] are as in the thesis. [motion] and [fill] are ignored: not all its figures use them."""
    return {key: session.table.get(key) for key in _METHOD[:2]} == {key: _thesis()[key] for key in _METHOD[:2]}


def choose_method(session: Document, as_the_thesis: bool) -> None:
    """Set the sections that select the method of the thesis, with forward warp and filling, or remove all sections that
    select a method; one undo step.
    """
    table = {key: value for key, value in session.table.items() if key not in _METHOD}
    if as_the_thesis:
        table |= {key: _thesis()[key] for key in _METHOD}
    session.take(replace(session.state, table=table))


@cache
def _thesis() -> Table:
    """Sections of a thesis figure with motion."""
    return read_mapping(str(_shipped("thesis/fig_4_13.toml")), ())


def _numbered(preset: ScenePreset) -> ScenePreset:
    """A preset of a part of a figure, with the part's letter added to the title, which all parts share."""
    part = re.search(r"_([a-z])$", preset.name)
    return replace(preset, title=preset.title.replace(":", f" {part[1]}:", 1)) if part else preset


RED, ROPE = (208, 24, 32), (226, 150, 62)
Pair = tuple[NDArray[Any], NDArray[np.bool_]]


@dataclass(frozen=True)
class Removal:
    """An image, and the mask of the pixels to remove; `make` returns both."""

    title: str
    make: Callable[[], Pair]


def _letters() -> Pair:
    """Bricks with red letters over them."""
    from PIL import Image, ImageDraw, ImageFont

    rows, columns = 300, 400
    drawn = Image.new("L", (columns, rows))
    pen = ImageDraw.Draw(drawn)
    for place, words in (((24, 30), "These letters"), ((80, 120), "are not part"), ((36, 210), "of the wall.")):
        pen.text(place, words, 255, ImageFont.load_default(44))
    mask = np.asarray(drawn) >= 128
    image = np.repeat(bricks(rows, columns)[:, :, np.newaxis], 3, axis=2)
    image[mask] = RED
    return image, mask


def _rope() -> Pair:
    """A picture with a rope across it; the mask extends 2 px beyond the rope on each side."""
    from PIL import Image, ImageDraw

    image = read_image(_shipped("depth_map_image.png")).data.copy()
    rows, columns = image.shape[:2]
    x = np.arange(-8, columns + 8, 4)
    points = [(int(k), round(0.2 * rows + 0.5 * k + 26.0 * np.sin(k / 42.0))) for k in x]
    found = []
    for width in (5, 9):
        drawn = Image.new("L", (columns, rows))
        ImageDraw.Draw(drawn).line(points, 255, width, joint="curve")
        found.append(np.asarray(drawn) >= 128)
    image[found[0]] = ROPE
    return image, found[1]


def _scratches() -> Pair:
    """A photograph with scratches and text; the package includes their mask."""
    return read_image(_shipped("damaged.png")).data, read_image(_shipped("damaged_mask.png")).data > 127


def _shipped(name: str) -> Path:
    return Path(str(folder("examples"))) / name


REMOVALS = {
    "red_letters": Removal("Red letters, 5.16", _letters),
    "rope": Removal("Rope, 5.19", _rope),
    "scratches": Removal("Scratches", _scratches),
}
"""Images to inpaint, by name."""
