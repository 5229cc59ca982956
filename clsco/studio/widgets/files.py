"""Dialogs to open, recover, save and share scenes, and the presets."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import NamedTuple

from clsco.errors import ClscoError, SceneError
from clsco.scene.file import read_mapping
from clsco.studio.folder import SCENES, listed
from clsco.studio.presets import load_preset, presets
from clsco.studio.server import Studio
from clsco.studio.session import ConflictError, Document
from clsco.studio.store import from_link, read_kept
from clsco.studio.widgets.html import Dialog, button, notify, page, say, text_box

_LENS = {"focal_length": "{:g} mm", "f_number": "f/{:g}"}


class Tile(NamedTuple):
    """A scene to choose: its name, the URL of its picture or "", a function that goes to the scene, and its file."""

    name: str
    picture: str
    choose: Callable[[], object]
    path: Path | None = None


def _tile_dialog(title: str, search: str, groups: Callable[[], Mapping[str, list[Tile]]]) -> Callable[[], None]:
    """A dialog with scenes by heading, "" for none; returns a function that opens it with the scenes of that time."""
    dialog = Dialog(title, wide=True)

    def show() -> None:
        with dialog.filled():
            if tiles := groups():
                _draw_tiles(tiles, dialog, search)
        dialog.open()

    return show


def _draw_tiles(groups: Mapping[str, list[Tile]], dialog: Dialog, search: str) -> None:
    """Draw scenes as pictures, with a search box that filters them by words in their names or groups."""

    def chosen(tile: Tile, _: object) -> None:
        tile.choose()
        dialog.close()

    with say("label", class_="box"):
        say("span", search)
        say("input", type="search", autocomplete="off", data_search="")
    for heading, tiles in groups.items():
        with say("section", data_group=heading.lower()):
            if heading:
                say("h3", heading)
            with say("ul", class_="names tiles"):
                for tile in tiles:
                    with say("li"), say("button", type="button", title=tile.name, click=partial(chosen, tile)):
                        title, fact = _described(tile.path)
                        if tile.picture:
                            say("img", src=tile.picture, alt="", loading="lazy")
                        else:
                            say("span", title, aria_hidden="true", class_="no-picture")
                        say("span", tile.name)
                        say("small", fact, aria_hidden="true")
    say("p", "Nothing has these words.", data_nothing="", hidden=True, role="status")


def open_dialog(session: Document, studio: Studio) -> Callable[[], None]:
    """A dialog with the scenes of the studio's folder; returns a function that opens it."""
    root = session.root

    def tiles() -> dict[str, list[Tile]]:
        names = listed(root, SCENES)
        if not names:
            say("p", f"There is no scene in {root.name}.")
            return {}
        paths = [(name, root / name) for name in names]
        return {"": [Tile(name, studio.picture_of(path), partial(session.open, path), path) for name, path in paths]}

    return _tile_dialog("Open a scene", f"Search the scenes in {root.name}", tiles)


def _described(path: Path | None) -> tuple[str, str]:
    """Title of a scene file, and its lens and number of objects in words; both are empty without a file of a scene."""
    with suppress(ClscoError, AttributeError, LookupError, TypeError):
        table = read_mapping(str(path), ())
        count, camera = len(table["object"]), table.get("camera", {})
        words = [text.format(camera[key]) for key, text in _LENS.items() if isinstance(camera.get(key), int | float)]
        return str(table.get("title", "")), ", ".join([*words, f"{count} object{'s' if count > 1 else ''}"])
    return "", ""


def recover_dialog(session: Document, studio: Studio) -> Callable[[], None]:
    """A dialog with unsaved scenes of former studios; returns a function that opens it."""

    def tiles() -> dict[str, list[Tile]]:
        paths = studio.kept_scenes()
        return {"": [Tile(_kept_name(path), studio.picture_of(path), partial(session.recover, path)) for path in paths]}

    return _tile_dialog("Recover a scene that was not saved", "Search by title or time", tiles)


def _kept_name(path: Path) -> str:
    title = "damaged"
    with suppress(SceneError, AttributeError):
        title = str(read_kept(path)[0].get("title") or "untitled")
    return f"{title}, {time.strftime('%Y-%m-%d %H:%M', time.localtime(path.lstat().st_mtime))}"


def save_dialog(session: Document) -> tuple[Callable[[], None], Callable[[], None]]:
    """A dialog to save under a name; returns functions that save, at once if the scene has a file, or always ask."""
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

    def conflict(path: Path | None, message: str = "") -> None:
        """Show the message, or without one the difference, and the choices."""
        with dialog.filled():
            if message:
                say("p", message, role="alert")
            else:
                say("pre", session.difference(path) or "There is none.", class_="difference")
            with say("div", class_="row"):
                button("Overwrite", partial(save, path, True))
                button("Save under another name", ask)
                if message:
                    button("Show the difference", partial(conflict, path))
        dialog.open()

    def ask() -> None:
        path = session.path
        known = typed["name"] = "scene.toml" if path is None else path.relative_to(session.root).as_posix()
        with dialog.filled():
            text_box(f"File in {session.root.name}", known, lambda name: typed.update(name=name))
            with say("div", class_="row"):
                button("Save", lambda: save(Path(typed["name"])), class_="primary")
        dialog.open()

    return lambda: ask() if session.path is None else save(None), ask


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
    groups: dict[str, list[Tile]] = {}
    for each in presets():
        tile = Tile(each.title, each.picture, partial(load_preset, session, each.name), each.path)
        groups.setdefault(each.group, []).append(tile)
    return _tile_dialog("Presets", "Search examples and figures", lambda: groups)
