"""The command `clsco examples`: example scenes and distributions as files, for users without a checkout."""

from __future__ import annotations

import tomllib
from importlib.resources import as_file
from pathlib import Path

import click

from clsco.cli.options import PATH, Names, option
from clsco.cli.output import echo
from clsco.errors import SceneError
from clsco.resources import folder

THESIS = "thesis/"  # beginning of the names of figures of the thesis, which are not listed


def _files(place: Path) -> dict[str, Path]:
    """The example files in a folder, by the name that the command lists."""
    files = {str(path.relative_to(place).with_suffix("")): path for path in sorted(place.rglob("*.toml"))}
    return files | {path.stem: path for path in sorted(place.glob("*.png")) if _mask(path).is_file()}


def _names() -> list[str]:
    with as_file(folder("examples")) as place:
        return list(_files(place))


@click.command()
@click.argument("names", metavar="[NAME]...", nargs=-1, type=Names(_names))
@option("-o out", "DIR", "Folder for copies of these examples, with their images.", PATH)
def examples(names: tuple[str, ...], out: Path | None) -> None:
    """List the example files, or copy some: scenes for clsco render, sets/NAME for clsco dataset make, and images with
    their masks for clsco inpaint."""
    from clsco.cli.tables import print_tables, table
    from clsco.scene.text import meant, shown

    with as_file(folder("examples")) as place:
        files = _files(place)
        known = {name: path for name, path in files.items() if not name.startswith(THESIS)}
        if unknown := [name for name in names if name not in files]:
            hint = meant(unknown[0], files)
            raise SceneError(f"examples: must be some of {', '.join(known)}; got {shown(unknown[0])}{hint}")
        if out is None:
            listed = {name: files[name] for name in names} if names else known
            rows = [(name, _title(path)) for name, path in listed.items()]
            print_tables(table("Examples", ("name", "title"), rows))
            echo("clsco examples NAME... -o DIR: copies of the files")
            return
        if not names:
            raise click.UsageError("-o: needs names of examples; got none")
        for name in dict.fromkeys(names):
            for path in (files[name], *_named(files[name])):
                _copy(path, out / path.name)
            echo(f"{click.format_filename(out / files[name].name)}: {_title(files[name])}")


def _mask(image: Path) -> Path:
    return image.with_stem(f"{image.stem}_mask")


def _title(path: Path) -> str:
    if path.suffix != ".toml":
        return "Image with missing pixels, and its mask"
    return str(tomllib.loads(path.read_text("utf-8")).get("title", ""))


def _named(path: Path) -> list[Path]:
    """Files in the same folder that a scene or distribution refers to; for an image, its mask."""
    if path.suffix != ".toml":
        return [_mask(path)]
    text = path.read_text("utf-8")
    return sorted(each for each in path.parent.iterdir() if f'"{each.name}"' in text)


def _copy(source: Path, target: Path) -> None:
    """Copy a file; an existing target must have the same content."""
    from clsco.files.atomic import atomic_write_bytes, raise_file_error

    data = source.read_bytes()
    if target.exists() and target.read_bytes() != data:
        raise_file_error(target, "must not be there, or be the same file", "another one")
    target.parent.mkdir(parents=True, exist_ok=True)
    atomic_write_bytes(target, data)
