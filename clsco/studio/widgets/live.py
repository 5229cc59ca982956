"""Sliders with number boxes whose values go to the server by the studio's own socket, as fast as they are dragged.

`static/studio.js` knows a control by its attribute `data-path`; it keeps those of one key alike.
"""

from __future__ import annotations

from html import escape
from typing import Any

from nicegui import ui

from clsco.studio.forms import Field


def number(field: Field, value: Any) -> None:
    """Draw a number: its label, a slider where it has one, a box and its unit, and a place for its message.

    Parameters
    ----------
    field : Field
        Of a number.
    value
        What is shown; None: nothing.
    """
    with ui.element("div").classes("live"):
        box = f"box-{field.path}"
        ui.element("label").props(f'for="{box}"').props["innerText"] = field.name
        shown = "" if value is None else f"{value:.12g}" if isinstance(value, float) else str(value)
        if field.slider is not None:
            least, most = field.slider
            slider = _attributes(
                type="range", min=least, max=most, step="any", data_step=field.step, data_path=field.path,
                value=shown or least, aria_label=f"{field.name}, slider", title=field.help,
            )  # fmt: skip
            ui.element("input").props(slider)
        attributes = _attributes(
            id=box, type="text", inputmode="decimal", data_kind="number", data_path=field.path, value=shown,
            aria_label=field.name, title=field.help, autocomplete="off",
        )  # fmt: skip
        ui.element("input").props(attributes)
        ui.element("span").classes("unit").props["innerText"] = field.unit
        ui.element("div").props(_attributes(data_fault=field.path, role="alert") + " hidden")


def _attributes(**values: Any) -> str:
    """Attributes for `Element.props`."""
    return " ".join(f'{name.replace("_", "-")}="{escape(str(value))}"' for name, value in values.items())
