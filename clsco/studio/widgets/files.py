"""Dialogs to open, save and share scenes, and the menu of presets."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

from nicegui import ui

from clsco.studio.folder import SCENES, listed
from clsco.studio.presets import load_preset, presets
from clsco.studio.session import ConflictError, Document
from clsco.studio.widgets.html import Dialog, button, say, text_box, tried


def open_dialog(session: Document) -> Callable[[], None]:
    """A dialog with the scenes of the studio's folder; returns what opens it."""
    dialog = Dialog("Open a scene")

    def chosen(name: str) -> None:
        session.open(Path(name))
        dialog.close()

    def show() -> None:
        with dialog.filled():
            names = listed(session.root, SCENES)
            say("p", f"Scenes in {session.root.name}" if names else f"There is no scene in {session.root.name}.")
            with ui.element("ul").classes("names"):
                for name in names:
                    with ui.element("li"):
                        button(name, partial(chosen, name))
        dialog.open()

    return show


def save_dialog(session: Document) -> tuple[Callable[[], None], Callable[[], None]]:
    """A dialog to save under a name; returns what saves at once if there is a file, and what always asks."""
    dialog = Dialog("Save the scene")
    typed = {"name": ""}

    def save(path: Path | None, overwrite: bool = False) -> None:
        try:
            if not tried_unless_conflict(session, path, overwrite):
                return
        except ConflictError as error:
            conflict(path, str(error))
            return
        assert session.path is not None
        ui.notify(f"Saved {session.path.name}", type="positive")
        dialog.close()

    def conflict(path: Path | None, message: str) -> None:
        with dialog.filled():
            say("p", message, role="alert")
            with ui.element("div").classes("row"):
                button("Overwrite", partial(save, path, True))
                button("Save under another name", ask)
                button("Show the difference", partial(difference, path))
        dialog.open()

    def difference(path: Path | None) -> None:
        with dialog.filled():
            say("pre", session.difference(path) or "There is none.").classes("difference")
            with ui.element("div").classes("row"):
                button("Overwrite", partial(save, path, True))
                button("Save under another name", ask)

    def ask() -> None:
        known = session.path.relative_to(session.root).as_posix() if session.path is not None else "scene.toml"
        typed["name"] = known
        with dialog.filled():
            text_box(f"File in {session.root.name}", known, lambda name: typed.update(name=name))
            with ui.element("div").classes("row"):
                button("Save", lambda: save(Path(typed["name"]))).classes("primary")
        dialog.open()

    def at_once() -> None:
        if session.path is None:
            ask()
        else:
            save(None)

    return at_once, ask


def tried_unless_conflict(session: Document, path: Path | None, overwrite: bool) -> bool:
    """Save, and show the fault if there is one, but for a conflict, which is raised."""
    conflicts: list[ConflictError] = []

    def action() -> None:
        try:
            session.save(path, overwrite)
        except ConflictError as error:
            conflicts.append(error)

    done = tried(action)
    if conflicts:
        raise conflicts[0]
    return done


def share_dialog(session: Document) -> Callable[[], None]:
    """A dialog with the link of the scene, and with a box for that of another; returns what opens it."""
    dialog = Dialog("Share the scene")
    typed = {"link": ""}

    def load() -> None:
        session.load_share(typed["link"])
        dialog.close()

    def show() -> None:
        link = session.share()
        typed["link"] = ""
        with dialog.filled():
            say("p", "The address holds the whole scene, but for images; who has the studio opens it in theirs.")
            with ui.element("div").classes("row"):
                say("input", type="text", readonly=True, value=link, aria_label="Link", data_link="")
                say("button", "Copy", type="button", data_copy=link)
            text_box("Link from others", "", lambda text: typed.update(link=text))
            with ui.element("div").classes("row"):
                button("Open the link", load)
        dialog.open()

    return show


def preset_dialog(session: Document) -> Callable[[], None]:
    """A dialog with the figures of the thesis and the examples; returns what opens it."""
    dialog = Dialog("Presets")
    with dialog.body:
        group = ""
        for preset in presets():
            if preset.group != group:
                group = preset.group
                say("h3", group)
                names = ui.element("ul").classes("names")
            with names, ui.element("li"):
                button(preset.title, partial(_load, session, preset.name, dialog))
    return dialog.open


def _load(session: Document, name: str, dialog: Dialog) -> None:
    load_preset(session, name)
    dialog.close()
