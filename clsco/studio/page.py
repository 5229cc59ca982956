"""The page of the studio, drawn with NiceGUI; no other module but its widgets imports it."""

from __future__ import annotations

from fastapi import FastAPI
from nicegui import ui

from clsco.studio.server import Studio


def attach(app: FastAPI, studio: Studio) -> None:
    """Add the page to the server."""

    @ui.page("/", title="clsco studio")
    def page(s: str = "") -> None:
        name = studio.tab(s)
        session = studio.tabs[name].session
        ui.element("div").props(f"id=studio data-tab={name}")
        ui.label(session.scene.title or "untitled")

    ui.run_with(app, title="clsco studio", show_welcome_message=False, tailwind=False, dark=None)
