"""Pictures and page of docs/gallery.md, one for each example: python -m benchmarks.gallery [NAME ...]

The studio's list of presets has them smaller, and those of the thesis.
"""

from __future__ import annotations

import argparse
import json
import tomllib
from pathlib import Path

from PIL import Image

import clsco
from clsco.data.distribution import load_distribution

ROOT = Path(__file__).resolve().parents[1]
EXAMPLES, PAGE, PICTURES = ROOT / "examples", ROOT / "docs/gallery.md", ROOT / "docs/gallery"
PRESETS = ROOT / "clsco/studio/static/presets"
WIDTH, QUALITY = 320, 82  # px, of 100
SMALL, FIRST_SMALL = (128, 45), (222, 70)  # width and quality of the pictures that the package contains
ACROSS = 3  # examples in a row of the page
SEED = 2026
TOLERANCE = 0.004  # of white, a code of 8 bits

FIRST = ("evening", "portrait", "macro", "street", "shutter", "night", "hearts", "swirl", "coded")
CHAPTERS = (
    "Begin here", "Shapes", "Several objects", "Motion", "Lenses", "Sensors and shutters",
    "Photographs, pairs and stacks", "Data sets",
)  # fmt: skip

HEAD = """# Gallery

All examples but those of [the thesis](thesis.md). `clsco examples NAME -o .` copies one with its images;
`clsco render NAME.toml -o frames` renders it, `clsco dataset make NAME.toml -o DATA` makes a data set.
"""


def grid(cells: list[str]) -> str:
    """A Markdown table of cells, ACROSS in a row."""
    rows = [cells[first : first + ACROSS] for first in range(0, len(cells), ACROSS)]
    lines = ["| " + " | ".join(row + [""] * (ACROSS - len(row))) + " |" for row in rows]
    return "\n".join(["|" + " |" * ACROSS, "|" + "---|" * ACROSS, *lines])


def chapter(name: str, scene: clsco.Scene, several: bool) -> str:
    """Heading of the gallery under which a scene stands."""
    if name in FIRST:
        return CHAPTERS[0]
    shapes = {item.shape for item in scene.objects}
    if name.startswith("sets/"):
        return "Data sets"
    if several or scene.stereo is not None or "depth_map" in shapes:
        return "Photographs, pairs and stacks"
    if scene.sensor is not None or scene.sequence.readout:
        return "Sensors and shutters"
    if scene.aperture != clsco.Aperture() or scene.lens is not None or scene.psf.model == "wave":
        return "Lenses"
    if scene.moves:
        return "Motion"
    return "Several objects" if len(scene.objects) > 1 else "Shapes"


def first_scene(name: str) -> tuple[clsco.Scene, bool]:
    """A scene of an example, and whether it is one of several."""
    path = EXAMPLES / f"{name}.toml"
    if name.startswith("sets/"):
        return load_distribution(path).draw(SEED, 0).scenes[0], True
    sweep = clsco.load_sweep(path)
    return sweep.scenes[len(sweep.scenes) // 2], len(sweep.scenes) > 1


def picture_name(name: str) -> str:
    return f"{name.replace('sets/', 'set_')}.jpg"


def make_picture(name: str, scene: clsco.Scene) -> None:
    """Write the pictures of an example: of the gallery, but for those of the thesis, and of the presets."""
    views = clsco.render(scene, frames=[scene.sequence.frames // 2], truth=(), tolerance=TOLERANCE)
    picture = Image.fromarray(next(iter(views)).image())
    if not name.startswith("thesis/"):
        write_small(picture, WIDTH, QUALITY, PICTURES / picture_name(name))
    if not name.startswith("sets/"):
        write_small(picture, *(FIRST_SMALL if name in FIRST else SMALL), PRESETS / f"{name}.webp")


def write_small(picture: Image.Image, width: int, quality: int, path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    size = width, round(picture.height * width / picture.width)
    picture.convert("RGB").resize(size, Image.Resampling.LANCZOS).save(path, quality=quality, optimize=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", metavar="NAME", nargs="*", help="of pictures to make; by default all")
    wanted = parser.parse_args().names
    chapters: dict[str, list[str]] = {}
    groups: dict[str, str] = {}
    for path in sorted(EXAMPLES.glob("thesis/*.toml")):
        name = path.relative_to(EXAMPLES).with_suffix("").as_posix()
        if not wanted or name in wanted:
            make_picture(name, first_scene(name)[0])
            print(name)
    others = {*EXAMPLES.glob("*.toml"), *EXAMPLES.glob("sets/*.toml")}
    first = [EXAMPLES / f"{name}.toml" for name in FIRST]
    for path in [*first, *sorted(others - set(first))]:
        name = path.relative_to(EXAMPLES).with_suffix("").as_posix()
        scene, several = first_scene(name)
        if not wanted or name in wanted:
            make_picture(name, scene)
            print(name)
        title = tomllib.loads(path.read_text("utf-8"))["title"]
        cell = f"![{name}](gallery/{picture_name(name)})<br>[{name}](../examples/{name}.toml)<br>{title}"
        groups[name] = chapter(name, scene, several)
        chapters.setdefault(groups[name], []).append(cell)
    tables = [f"## {heading}\n\n{grid(chapters[heading])}" for heading in CHAPTERS]
    listed = {heading: [name for name, each in groups.items() if each == heading] for heading in CHAPTERS[:-1]}
    (PRESETS / "groups.json").write_text(json.dumps(listed, indent=1) + "\n", "utf-8")
    PAGE.write_text("\n\n".join((HEAD.rstrip(), *tables)) + "\n", "utf-8")


if __name__ == "__main__":
    main()
