"""Elements of HTML as they are: text that is never read as markup, buttons, boxes, and dialogs."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

from nicegui import ui

from clsco.errors import ClscoError, SceneError
from clsco.studio.forms import Field

_VALUE = "(event) => emit(event.target.value)"
_CHECKED = "(event) => emit(event.target.checked)"


def say(tag: str, text: str = "", **attributes: Any) -> ui.element:
    """An element with a text, whatever is in it; attributes have `_` for `-`, and those that are None are left out.

    The value of a box is what it begins with: Vue would give it that again each time that anything on the page changes.
    """
    element = ui.element(tag)
    for name, value in attributes.items():
        if value is not None:
            key = name.rstrip("_").replace("_", "-")
            element.props["^value" if tag == "input" and key == "value" else key] = value
    if text:
        element.props["innerText"] = text
    return element


def button(text: str, pressed: Callable[[], object], **attributes: Any) -> ui.element:
    """A button; what it refuses is shown."""

    def handle() -> None:
        tried(pressed)

    return say("button", text, type="button", **attributes).on("click", handle, args=[])


def tried(action: Callable[[], object]) -> bool:
    """Do something and show its fault if there is one; True if there is none."""
    client = ui.context.client  # what was pressed may be gone afterwards
    try:
        action()
    except ClscoError as error:
        messages = error.messages if isinstance(error, SceneError) else (str(error),)
        with client:
            ui.notify("\n".join(messages[:6]), type="negative", multi_line=True, close_button="Close", timeout=12000)
        return False
    return True


def text_box(label: str, value: str, typed: Callable[[str], object], **attributes: Any) -> ui.element:
    """A labeled box for text; `typed` is called with each change."""
    with say("label").classes("box"):
        say("span", label)
        return say("input", type="text", value=value, autocomplete="off", **attributes).on(
            "input", lambda event: typed(str(event.args)), js_handler=_VALUE
        )


def check_box(label: str, is_on: bool, changed: Callable[[bool], object], **attributes: Any) -> ui.element:
    """A labeled check box."""
    with say("label").classes("check"):
        box = say("input", type="checkbox", checked=is_on or None, **attributes)
        box.on("change", lambda event: changed(bool(event.args)), js_handler=_CHECKED)
        say("span", label)
    return box


def choice(
    label: str,
    options: Mapping[str, str] | Sequence[str],
    value: str,
    chosen: Callable[[str], object],
    missing: Mapping[str, str] | None = None,
) -> None:
    """A labeled list to choose one value of.

    options: values with their labels; missing: what those that cannot be chosen need, by value, or "".
    """
    named = options if isinstance(options, Mapping) else {option: option for option in options}
    needs = missing or {}
    with say("label").classes("box"):
        say("span", label)
        with say("select").on("change", lambda event: chosen(str(event.args)), js_handler=_VALUE):
            for option, text in named.items():
                lacks = needs.get(option, "")
                say(
                    "option", f"{text} ({lacks})" if lacks else text, value=option,
                    selected=True if option == value else None, disabled=True if lacks else None,
                )  # fmt: skip


class Dialog:
    """A dialog of the browser's own, which keeps the focus inside, and closes with Esc."""

    def __init__(self, title: str, wide: bool = False) -> None:
        self.element = say("dialog", aria_label=title).classes("studio-dialog wide" if wide else "studio-dialog")
        with self.element:
            say("h2", title)
            self.body = ui.element("div")
            with ui.element("div").classes("dialog-end"):
                self.actions = ui.element("span")
                button("Close", self.close)

    def open(self) -> None:
        """Show it, if it is not shown."""
        place = f"getHtmlElement({self.element.id})"
        self.element.client.run_javascript(f"if (!{place}.open) {place}.showModal()")

    def close(self) -> None:
        """Hide it."""
        self.element.client.run_javascript(f"getHtmlElement({self.element.id}).close()")

    @contextmanager
    def filled(self) -> Iterator[None]:
        """Fill it anew: what was pressed in it is gone then, and with it the context in which NiceGUI draws."""
        self.body.clear()
        with self.body:
            yield


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
        slider(field)
        number_box(field, value, box)
        say("span", field.unit).classes("unit")
        say("div", data_fault=field.path, role="alert", hidden=True)


def slider(field: Field) -> None:
    """Draw the slider of a number, if it has one; the page's script puts it where the value is."""
    if field.slider is None:
        return
    least, most = (field.place(end) for end in field.slider)
    step = {"": field.step, "stops": 1.0}.get(field.scale, (most - least) / 200.0)
    say(
        "input", type="range", min=str(least), max=str(most), step="any", data_step=str(step), value=str(least),
        data_scale=field.scale or None, data_only=field.only or None, data_path=field.path,
        aria_label=f"{field.name}, slider", title=field.help,
    )  # fmt: skip


def number_box(field: Field, value: Any, name: str) -> None:
    """Draw the box of a number; name: its id."""
    shown = "" if value is None else f"{value:.12g}" if isinstance(value, float) else str(value)
    say(
        "input", id=name, type="text", inputmode="decimal", data_kind="number", data_path=field.path, value=shown,
        data_only=field.only or None, aria_label=field.name, title=field.help, autocomplete="off",
    )  # fmt: skip
