"""Dialogs to open, recover, save and share scenes, and the presets."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from functools import partial
from itertools import groupby
from pathlib import Path
from typing import NamedTuple

from clsco.errors import SceneError
from clsco.studio.folder import SCENES, listed
from clsco.studio.presets import load_preset, presets
from clsco.studio.server import Studio
from clsco.studio.session import ConflictError, Document
from clsco.studio.store import from_link, read_kept
from clsco.studio.widgets.html import Dialog, button, notify, page, say, text_box


class Tile(NamedTuple):
    """A scene to choose: its name, and the address of its picture, or ""."""

    name: str
    picture: str


def draw_tiles(groups: Mapping[str, list[Tile]], chosen: Callable[[str, int], object], search: str) -> None:
    """Draw scenes as pictures in groups, with a search box that filters them by words in their names or groups.

    groups: scenes by heading, "" for none; chosen: called with the group and the number of a scene in it.
    """
    with say("label", class_="box"):
        say("span", search)
        say("input", type="search", autocomplete="off", data_search="")
    for heading, tiles in groups.items():
        with say("section", data_group=heading.lower()):
            if heading:
                say("h3", heading)
            with say("ul", class_="names tiles"):
                for number, tile in enumerate(tiles):
                    pressed = partial(chosen, heading, number)
                    with say("li"), say("button", type="button", title=tile.name, click=lambda _, do=pressed: do()):
                        if tile.picture:
                            say("img", src=tile.picture, alt="", loading="lazy")
                        else:
                            say("span", aria_hidden="true", class_="no-picture")
                        say("span", tile.name)
    say("p", "Nothing has these words.", data_nothing="", hidden=True, role="status")


def open_dialog(session: Document, studio: Studio) -> Callable[[], None]:
    """A dialog with the scenes of the studio's folder; returns a function that opens it."""
    dialog = Dialog("Open a scene", wide=True)

    def show() -> None:
        names = listed(session.root, SCENES)

        def chosen(_: str, number: int) -> None:
            session.open(Path(names[number]))
            dialog.close()

        with dialog.filled():
            if names:
                tiles = [Tile(name, studio.picture_of(session.root / name)) for name in names]
                draw_tiles({"": tiles}, chosen, f"Search the scenes in {session.root.name}")
            else:
                say("p", f"There is no scene in {session.root.name}.")
        dialog.open()

    return show


def recover_dialog(session: Document, studio: Studio) -> Callable[[], None]:
    """A dialog with unsaved scenes of former studios; returns a function that opens it."""
    dialog = Dialog("Recover a scene that was not saved", wide=True)

    def show() -> None:
        kept = studio.kept_scenes()

        def chosen(_: str, number: int) -> None:
            session.recover(kept[number])
            dialog.close()

        with dialog.filled():
            tiles = [Tile(_kept_name(path), studio.picture_of(path)) for path in kept]
            draw_tiles({"": tiles}, chosen, "Search by title or time")
        dialog.open()

    return show


def _kept_name(path: Path) -> str:
    """Title of a recoverable scene, with its time."""
    try:
        title = str(read_kept(path)[0].get("title") or "untitled")
    except (SceneError, AttributeError):
        title = "damaged"
    return f"{title}, {time.strftime('%Y-%m-%d %H:%M', time.localtime(path.lstat().st_mtime))}"


def save_dialog(session: Document) -> tuple[Callable[[], None], Callable[[], None]]:
    """A dialog to save under a name.

    Returns two functions: one saves at once if the scene has a file, and otherwise asks for a name; one always asks.
    """
    dialog = Dialog("Save the scene")
    typed = {"name": ""}

    def save(path: Path | None, overwrite: bool = False) -> None:
        try:
            session.save(path, overwrite)
        except ConflictError as error:
            conflict(path, str(error))
            return
        assert session.path is not None
        notify(f"Saved {session.path.name}")
        dialog.close()

    def conflict(path: Path | None, message: str) -> None:
        with dialog.filled():
            say("p", message, role="alert")
            with say("div", class_="row"):
                button("Overwrite", partial(save, path, True))
                button("Save under another name", ask)
                button("Show the difference", partial(difference, path))
        dialog.open()

    def difference(path: Path | None) -> None:
        with dialog.filled():
            say("pre", session.difference(path) or "There is none.", class_="difference")
            with say("div", class_="row"):
                button("Overwrite", partial(save, path, True))
                button("Save under another name", ask)

    def ask() -> None:
        known = session.path.relative_to(session.root).as_posix() if session.path is not None else "scene.toml"
        typed["name"] = known
        with dialog.filled():
            text_box(f"File in {session.root.name}", known, lambda name: typed.update(name=name))
            with say("div", class_="row"):
                button("Save", lambda: save(Path(typed["name"])), class_="primary")
        dialog.open()

    def at_once() -> None:
        if session.path is None:
            ask()
        else:
            save(None)

    return at_once, ask


def share_dialog(session: Document) -> Callable[[], None]:
    """A dialog with the link of the scene, and a box for another link; returns a function that opens it."""
    dialog = Dialog("Share the scene")
    typed = {"link": ""}

    def load() -> None:
        session.load_share(from_link(typed["link"], session.readable))
        dialog.close()

    def show() -> None:
        link = session.share()
        here = f"{page().address}{link}"  # with the secret path, which others need not know
        typed["link"] = ""
        with dialog.filled():
            say("p", "The address holds the whole scene, but for images.")
            for label, text in (("For others, who open it below in their studio", link), ("For this browser", here)):
                with say("label", class_="box"):
                    say("span", label)
                    with say("div", class_="row"):
                        say("input", type="text", readonly=True, value=text, aria_label=label, data_link="")
                        say("button", "Copy", type="button", data_copy=text)
            text_box("From others", "", lambda text: typed.update(link=text))
            with say("div", class_="row"):
                button("Open the link", load, class_="primary")
        dialog.open()

    return show


def preset_dialog(session: Document) -> Callable[[], None]:
    """A dialog with the examples and the figures of the thesis; returns a function that opens it."""
    dialog = Dialog("Presets", wide=True)
    groups = {heading: list(each) for heading, each in groupby(presets(), lambda preset: preset.group)}

    def chosen(heading: str, number: int) -> None:
        load_preset(session, groups[heading][number].name)
        dialog.close()

    def show() -> None:
        with dialog.filled():
            tiles = {heading: [Tile(each.title, each.picture) for each in found] for heading, found in groups.items()}
            draw_tiles(tiles, chosen, "Search examples and figures")
        dialog.open()

    return show
