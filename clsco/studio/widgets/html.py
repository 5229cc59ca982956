"""HTML elements: text that is always escaped, buttons, boxes, dialogs, and parts that can be redrawn."""

from __future__ import annotations

import html
import itertools
import json
import math
import secrets
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any

from clsco.errors import ClscoError, SceneError
from clsco.studio.forms import Field

Handler = Callable[[Any], object]
EVENTS = ("click", "change", "input", "toggle")
_EMPTY = ("img", "input")  # tags without an end
_PAGE: ContextVar[Page] = ContextVar("page")  # being drawn, or whose event is handled


class Page:
    """A page in a browser: its HTML, the handlers of its elements, and queued messages.

    `told` is called when messages are queued, the functions `endings` when the page is closed. `key` distinguishes the
    page from pages loaded earlier.
    """

    def __init__(self, address: str = "", told: Callable[[], object] = lambda: None) -> None:
        self.address, self._told = address, told
        self.key = secrets.token_urlsafe(9)
        self.endings: list[Callable[[], object]] = []
        self.out: list[str] = []
        self.numbers = itertools.count(1)
        self.handlers: dict[int, Handler] = {}
        self._messages: list[dict[str, Any]] = []

    @contextmanager
    def current(self) -> Iterator[None]:
        """Make this the page for elements and notices created in the block."""
        token = _PAGE.set(self)
        try:
            yield
        finally:
            _PAGE.reset(token)

    def hear(self, number: int, value: Any) -> None:
        """Call the handler of the element `number` with its value, if it still exists; errors are shown."""
        if number in self.handlers:
            with self.current():
                tried(lambda: self.handlers[number](value))

    def tell(self, **said: Any) -> None:
        """Queue a message for the browser."""
        if "part" in said:
            self.forget(said["part"], said["part"] + 1)
        self._messages.append(said)
        self._told()

    def forget(self, first: int, last: int) -> None:
        """Remove the handlers of elements and parts numbered from `first` to below `last`."""
        for number in range(first, last):
            self.handlers.pop(number, None)
        self._messages = [message for message in self._messages if not first <= message.get("part", -1) < last]

    def taken(self) -> list[dict[str, Any]]:
        """Return the queued messages, and clear the queue."""
        messages, self._messages = self._messages, []
        return messages

    def end(self) -> None:
        """Call the functions in `endings`."""
        for end in self.endings:
            end()


def page() -> Page:
    """The page being drawn, or whose event is being handled."""
    return _PAGE.get()


class Element:
    """An element; elements created in its block are nested in it."""

    def __init__(self, out: list[str]) -> None:
        self._out = out

    def __enter__(self) -> None:
        self._end = self._out.pop()

    def __exit__(self, *_: object) -> None:
        self._out.append(self._end)


def say(tag: str, text: str = "", **attributes: Any) -> Element:
    """Write an element with an escaped text.

    In attribute names `_` becomes `-`, and is removed at the end; attributes that are None or False are omitted. One
    named after an event of `EVENTS` is a handler, called with the element's value.
    """
    out, words = page().out, ""
    for name, value in attributes.items():
        if name in EVENTS:
            words += handled(name, value)
        elif value is not None and value is not False:
            words += f" {name.rstrip('_').replace('_', '-')}"
            words += "" if value is True else f'="{html.escape(str(value))}"'
    out += [f"<{tag}{words}>{html.escape(text)}", "" if tag in _EMPTY else f"</{tag}>"]
    return Element(out)


def handled(event: str, handler: Handler) -> str:
    """Attributes of an element whose event has a handler."""
    number = next(page().numbers)
    page().handlers[number] = handler
    return f' data-on="{event}" data-number="{number}"'


class PagePart:
    """A part of a page, drawn where it is created, and again when it is refreshed, or when its `key` has `changed`."""

    def __init__(self, draw: Callable[[], object] = lambda: None, key: Callable[[], object] = lambda: None) -> None:
        self._page, self._draw, self._html = page(), draw, ""
        self._key, self._drawn_key = key, key()
        self._number = next(self._page.numbers)
        self._first = self._last = 0  # numbers of its elements

    def __call__(self) -> None:
        with say("div", data_part=self._number):
            with self._drawn():
                self._draw()
            self._page.out.append(self._html)

    def refresh(self) -> None:
        """Draw the part again."""
        with self.filled():
            self._draw()

    def changed(self) -> None:
        """Draw the part again if its key has changed."""
        if (key := self._key()) != self._drawn_key:
            self._drawn_key = key
            self.refresh()

    @contextmanager
    def filled(self) -> Iterator[None]:
        """Draw other content in the part; handlers of its former content are removed."""
        before = self._html
        with self._drawn():
            yield
        if self._html != before:
            self._page.tell(part=self._number, html=self._html)

    @contextmanager
    def _drawn(self) -> Iterator[None]:
        around, self._page.out = self._page.out, []
        self._page.forget(self._first, self._last)
        self._first = next(self._page.numbers)
        try:
            with self._page.current():
                yield
            self._html = "".join(self._page.out)
        finally:
            self._page.out = around
            self._last = next(self._page.numbers)


def tried(action: Callable[[], object]) -> bool:
    """Call a function, and show its ClscoError if it raises one; returns True if it raises none."""
    try:
        action()
    except ClscoError as error:
        messages = error.messages if isinstance(error, SceneError) else (str(error),)
        notify(";\n".join(messages[:6]), is_good=False)
        return False
    return True


def notify(text: str, is_good: bool = True) -> None:
    """Show a message for a while."""
    page().tell(notice=text, good=is_good)


def button(text: str, pressed: Callable[[], object], **attributes: Any) -> Element:
    """A button; errors of its handler are shown."""
    return say("button", text, type="button", click=lambda _: pressed(), **attributes)


def icon_button(name: str, label: str, pressed: Callable[[], object], **attributes: Any) -> None:
    """A button with a symbol in place of its label; errors of its handler are shown."""
    with button("", pressed, class_="icon", aria_label=label, title=label, **attributes):
        icon(name)


def icon(name: str) -> None:
    """A symbol of static/icons.svg."""
    with say("svg", class_="i", aria_hidden="true"):
        say("use", href=f"static/icons.svg#{name}")


def text_box(label: str, value: str, typed: Callable[[str], object], **attributes: Any) -> None:
    """A labeled box for text; `typed` is called with each change."""
    with say("label", class_="box"):
        say("span", label)
        say("input", type="text", value=value, autocomplete="off", input=lambda text: typed(str(text)), **attributes)


def command_row(line: str, of: str = "") -> None:
    """A command line, and a button that copies it; of: what its accessible name adds."""
    with say("div", class_="row"):
        say("code", line)
        say("button", "Copy", type="button", data_copy=line, aria_label=f"Copy the command line{of}")


def check_box(label: str, is_on: bool, changed: Callable[[bool], object], **attributes: Any) -> None:
    """A labeled check box; `changed` is called with its new state."""
    check(label, checked=is_on, change=lambda on: changed(bool(on)), **attributes)


def check(label: str, type: str = "checkbox", **attributes: Any) -> None:  # noqa: A002 - as in HTML
    """A labeled check box or radio button, with a symbol above the label if one is given."""
    symbol = attributes.pop("symbol", "")
    with say("label", class_="check"):
        say("input", type=type, **attributes)
        if symbol:
            icon(symbol)
        say("span", label)


def choice(
    label: str, options: Mapping[str, str], value: str, chosen: Callable[[str], object], missing: Mapping[str, str]
) -> None:
    """A labeled list of options, by value; `missing` has the reasons why some of them cannot be `chosen`."""
    with say("label", class_="box"):
        say("span", label)
        with say("select", change=lambda option: chosen(str(option)) if str(option) in options else None):
            for option, text in options.items():
                lacks = missing.get(option, "")
                shown = f"{text} ({lacks})" if lacks else text
                say("option", shown, value=option, selected=option == value, disabled=bool(lacks))


class Dialog:
    """A native dialog of the browser, which keeps the focus inside, and closes with Esc."""

    def __init__(self, title: str, wide: bool = False) -> None:
        self._page = page()
        self._place = f"#dialog-{next(self._page.numbers)}"
        body = PagePart()
        self.filled = body.filled
        with say("dialog", id=self._place[1:], aria_label=title, class_=f"studio-dialog{' wide' if wide else ''}"):
            say("h2", title)
            body()
            with say("div", class_="dialog-end"):
                say("button", "Close", type="button", data_close=self._place)

    def open(self) -> None:
        """Show the dialog, if it is hidden."""
        self._page.tell(show=self._place)

    def close(self) -> None:
        """Hide the dialog."""
        self._page.tell(close=self._place)


def label(field: Field, tag: str = "label", text: str = "", **attributes: Any) -> None:
    """Write the label of a field. The page's script puts a dot before it if the value differs from the default, and a
    double click resets the value.
    """
    limits = "" if field.least is None else f", {field.least:g} to {field.most:g} {field.unit}"
    title = f"{field.help} (default {field.default}{limits}; a double click resets)"
    default = json.dumps("inf" if field.default == math.inf else field.default)
    text = text or f"{field.label} {field.symbol}".strip()
    say(tag, text, title=title, data_clear=field.path, data_default=default, **attributes)


def number(field: Field, value: Any, letter: str = "") -> None:
    """Draw a number field: its label or letter, its box over a slider, whose fill is the place, and its message."""
    with say("div", class_="live"):
        box = f"box-{field.path}"
        if not letter:
            label(field, for_=box)
        with say("div", class_="num"):
            slider(field, tabindex="-1")
            if letter:
                say("b", letter, aria_hidden="true")
            number_box(field, value, box)
            if not letter:
                say("span", field.unit, class_="unit")
        say("div", data_fault=field.path, hidden=True)


def slider(field: Field, **attributes: Any) -> None:
    """Draw the slider of a number, if it has one; the page's script sets its position."""
    if field.slider is None:
        return
    least, most = (field.place(end) for end in field.slider)
    step = {"": field.step, "stops": 1.0}.get(field.scale, (most - least) / 200.0)
    say(
        "input", type="range", min=str(least), max=str(most), step="any", data_step=str(step), value=str(least),
        data_scale=field.scale or None, data_only=field.only or None, data_path=field.path,
        aria_label=f"{field.name}, slider", title=field.help, **attributes,
    )  # fmt: skip


def number_box(field: Field, value: Any, name: str) -> None:
    """Draw the box of a number; name: its id."""
    shown = "" if value is None else f"{value:.12g}" if isinstance(value, float) else str(value)
    say(
        "input", id=name, type="text", inputmode="decimal", data_kind="number", data_path=field.path, value=shown,
        data_only=field.only or None, aria_label=field.name, title=field.help, autocomplete="off",
    )  # fmt: skip
