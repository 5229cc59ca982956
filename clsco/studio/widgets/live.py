"""Sliders with number boxes whose values go to the server by the studio's own socket, as fast as they are dragged.

`static/studio.js` knows a control by its attribute `data-path`; it keeps those of one key alike.
"""

from __future__ import annotations

from typing import Any

from clsco.studio.forms import Field
from clsco.studio.widgets.html import say


def number(field: Field, value: Any) -> None:
    """Draw a number: its label, a slider where it has one, a box and its unit, and a place for its message.

    Parameters
    ----------
    field : Field
        Field of a number.
    value
        Value to show; None: nothing.
    """
    with say("div").classes("live"):
        box = f"box-{field.path}"
        say("label", field.name, for_=box)
        shown = "" if value is None else f"{value:.12g}" if isinstance(value, float) else str(value)
        if field.slider is not None:
            least, most = field.slider
            say(
                "input", type="range", min=str(least), max=str(most), step="any", data_step=str(field.step),
                data_path=field.path, value=shown or str(least), aria_label=f"{field.name}, slider", title=field.help,
            )  # fmt: skip
        say(
            "input", id=box, type="text", inputmode="decimal", data_kind="number", data_path=field.path, value=shown,
            aria_label=field.name, title=field.help, autocomplete="off",
        )  # fmt: skip
        say("span", field.unit).classes("unit")
        say("div", data_fault=field.path, role="alert", hidden=True)
