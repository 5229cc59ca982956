"""The page of the studio: static/page.html, with the parts that depend on the session."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import partial
from pathlib import Path

from clsco.studio.forms import field_at
from clsco.studio.pictures import SENSOR_VIEWS, VIEWS
from clsco.studio.server import Studio
from clsco.studio.session import Document
from clsco.studio.tables import ON_THE_STRIP
from clsco.studio.widgets.files import open_dialog, preset_dialog, recover_dialog, save_dialog, share_dialog
from clsco.studio.widgets.html import EVENTS, Page, button, handled, icon, label, number_box, say, slider
from clsco.studio.widgets.inpainting import Painting
from clsco.studio.widgets.jobs import GenerateForm, draw_jobs
from clsco.studio.widgets.panels import Chosen, draw_panels, draw_sweep

LABELS = {"sharp": "All in focus", "blur radius": "Blur radius R", "normal": "Normals", "id": "Objects"}
_NO_SENSOR = ("sensor", "no sensor: add its panel")
RARE = {
    "flow": ("moves", "nothing moves"), "mask": ("gaps", "each pixel shows a surface"),
    "missing": ("warps", "no forward warp"), "raw": _NO_SENSOR, "noise": _NO_SENSOR,
}  # fmt: skip
"""Views that have a meaning only for some scenes: the condition's name in the page's script, and why they have none."""
# Texts of the page, and between them the names of its parts.
_TEMPLATE = re.split(r"{{(.+?)}}", (Path(__file__).parent / "static" / "page.html").read_text("utf-8"))
STOPS = ("0.7", "1", "1.4", "2", "2.8", "4", "5.6", "8", "11", "16")


def draw(name: str, studio: Studio, address: str) -> tuple[Page, str]:
    """Create the page of the tab `name` at the URL `address`; returns the page and its HTML."""
    tab = studio.tabs[name]
    page, session = Page(address, tab.told.set), tab.session
    identity = f'data-tab="{name}" data-page="{page.key}" data-proof="{studio.proof_key}"'
    with page.current():
        sheet = GenerateForm(session, studio.jobs, studio.device or "")
        painting = Painting(session, name, studio.device)
    chosen = Chosen()
    parts: dict[str, Callable[..., object]] = {
        "identity": lambda: page.out.append(identity),
        "menu": partial(_menu, session, studio),
        "sheet": sheet.draw,
        "cost": sheet.cost,
        "click make": sheet.begin,
        "stops": _stops,
        "views": _views,
        "sweep": partial(draw_sweep, session),
        "panels": partial(draw_panels, session, chosen),
        "click reset": lambda _: session.reset(chosen.index),
        "jobs": partial(draw_jobs, studio.jobs),
        **painting.parts(),
    }
    for kind, path in zip(("focus", "stop"), ON_THE_STRIP, strict=True):
        dial = field_at(session, path)
        assert dial is not None
        parts[f"{kind} slider"] = partial(slider, dial)
        text, box = {"focus": "Focus", "stop": "f/"}[kind], f"dial-{path}"
        parts[f"{kind} label"] = partial(label, dial, text=text, for_=box, class_="quiet")
        parts[f"{kind} box"] = partial(number_box, dial, session.shown(path), box)
    with page.current():
        for index, text in enumerate(_TEMPLATE):
            if index % 2 == 0:
                page.out.append(text)
            elif text.startswith("icon "):
                icon(text[5:])
            elif (event := text.partition(" ")[0]) in EVENTS:
                page.out.append(handled(event, parts[text]))
            else:
                parts[text]()
    return page, "".join(page.out)


def _menu(session: Document, studio: Studio) -> None:
    """Draw the menu of the scene, and beside it the dialogs, since a closed menu hides what is in it."""
    save, save_as = save_dialog(session)
    entries = {"Open": open_dialog(session, studio), "Presets": preset_dialog(session), "Save": save}
    entries |= {"Save as": save_as, "Share": share_dialog(session)}
    if studio.kept_scenes():
        entries["Recover"] = recover_dialog(session, studio)
    with say("div", id="menu", popover=True, role="group", aria_label="Scene"):
        for label, choose in entries.items():
            button(label, choose, id="save" if label == "Save" else None)


def _stops() -> None:
    for stop in STOPS:
        say("button", stop, type="button", role="radio", aria_checked="false", data_stop=stop, aria_label=f"f/{stop}")


def _views() -> None:
    for digit, view in enumerate(VIEWS, 1):
        rare, why = RARE.get(view, (None, None))
        with say(
            "button", type="button", role="tab", data_view=view, aria_controls="stage",
            aria_selected="true" if view == "color" else "false", data_only="sensor" if view in SENSOR_VIEWS else None,
            data_rare=rare, data_why=why, title=f"Key {digit}" if digit < 10 else None,
        ):  # fmt: skip
            say("canvas", width=96, height=54, aria_hidden="true")
            say("span", LABELS.get(view, view.capitalize()))
