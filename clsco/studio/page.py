"""The page of the studio, drawn with NiceGUI; no other module but its widgets imports it."""

from __future__ import annotations

from fastapi import FastAPI
from nicegui import ui

from clsco.studio.forms import panels
from clsco.studio.pictures import VIEWS
from clsco.studio.server import Studio
from clsco.studio.session import Session
from clsco.studio.widgets.live import number

KEYS = (
    ("← → ↑ ↓", "step of a slider; with Shift ten times, with Alt a tenth"),
    ("1 … 9", "views"),
    (", .", "frame before, next frame"),
    ("Ctrl Z, Shift Ctrl Z", "undo, redo"),
    ("Ctrl S", "save"),
    ("Ctrl Enter", "generate"),
    ("Esc", "take back what is being dragged"),
    ("?", "this list"),
)


DRAWER = "document.querySelector('#studio').classList.toggle('open')"


def attach(app: FastAPI, studio: Studio) -> None:
    """Add the page to the server."""

    @ui.page("/", title="clsco studio")
    def page(s: str = "") -> None:
        name = studio.tab(s)
        ui.add_head_html('<link rel="stylesheet" href="/static/studio.css">')
        ui.add_body_html(
            '<script defer src="/static/colors.js"></script><script defer src="/static/studio.js"></script>'
        )
        draw(name, studio.tabs[name].session)

    ui.run_with(app, title="clsco studio", show_welcome_message=False, tailwind=False, dark=True)


def draw(name: str, session: Session) -> None:
    """Draw the page of a tab."""
    with ui.element("div").props(f"id=studio data-tab={name}"):
        _say("div", "The studio's server does not answer; trying again.", 'id=lost role="status" hidden')
        with ui.element("header"):
            _say("button", "☰", f'id=drawer aria-label="Panels" onclick="{DRAWER}"')
            _say("h1", "", "id=title")
            _say("button", "Undo", "id=undo data-do=undo disabled")
            _say("button", "Redo", "id=redo data-do=redo disabled")
            ui.element("div").classes("spread")
            _say("button", "?", 'aria-label="Keyboard" onclick="document.querySelector(\'#keys\').showModal()"')
        with ui.element("nav").props('id=panels aria-label="Panels"'):
            with ui.element("div").props("id=panels-scroll"):
                for panel in panels(session):
                    with ui.expansion(panel.title, value=panel.is_open).classes("w-full"):
                        for field in panel.fields:
                            if field.kind == "number":
                                number(field, session.shown(field.path))
                            elif field.kind == "vector":
                                for index in range(len(field.components)):
                                    part = field.component(index)
                                    number(part, session.shown(part.path))
            with ui.element("div").props("id=panels-end"):
                _say("button", "Reset", "id=reset data-do=reset")
                _say("button", "Generate", "id=generate").classes("primary")
        with ui.element("main").props("id=middle"):
            _middle()
        with ui.element("aside").props('id=side aria-label="Inspector and jobs"'):
            pass
    with ui.element("dialog").props('id=keys aria-label="Keyboard"'):
        with ui.element("table"):
            for keys, meaning in KEYS:
                with ui.element("tr"):
                    with ui.element("td"):
                        _say("kbd", keys)
                    _say("td", meaning)
        _say("button", "Close", "onclick=\"document.querySelector('#keys').close()\"")


def _middle() -> None:
    """Tabs of the views, the canvas and the time line."""
    with ui.element("div").props('id=views role=tablist aria-label="Views"'):
        for view in VIEWS:
            is_first = "true" if view == "color" else "false"
            _say("button", view, f'role=tab data-view="{view}" aria-selected="{is_first}"')
        ui.element("div").classes("spread")
        _say("span", "", "id=size")
        _say("span", "", "id=zoom")
        _say("button", "Fit", "id=fit")
        _say("button", "1:1", "id=actual")
    with ui.element("div").props("id=stage"):
        ui.element("canvas").props('id=canvas width=1 height=1 role=img aria-label="Rendered frame"')
        ui.element("canvas").props("id=over aria-hidden=true")
        _say("div", "", "id=badge")
        _say("div", "", "id=message role=alert hidden")
        with ui.element("div").props("id=legend hidden"):
            with ui.element("div").props("id=legend-row"):
                _say("span", "", "id=legend-least")
                ui.element("canvas").props("id=legend-bar width=160 height=10 aria-hidden=true")
                _say("span", "", "id=legend-most")
            _say("div", "", "id=legend-about")
    with ui.element("div").props("id=line"):
        _say("button", "▶", 'id=play aria-label="Play" aria-pressed=false')
        ui.element("input").props('id=frame type=range min=0 max=0 value=0 step=1 aria-label="Frame"')
        _say("span", "", "id=time")


def _say(tag: str, text: str, props: str = "") -> ui.element:
    """An element of plain text, whatever is in it."""
    element = ui.element(tag).props(props)
    if text:
        element.props["innerText"] = text
    return element
