"""Elements of HTML as they are: text that is never read as markup, buttons, boxes, dialogs, and parts that change."""

from __future__ import annotations

import html
import itertools
import secrets
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any

from clsco.errors import ClscoError, SceneError
from clsco.studio.forms import Field

Handler = Callable[[Any], object]
EVENTS = ("click", "change", "input", "toggle")
_EMPTY = ("img", "input")  # tags without an end
_PAGE: ContextVar[Page] = ContextVar("page")  # that is drawn, or in which something was pressed


class Page:
    """A page in a browser: what was drawn of it, what its elements do, and what it is to be told.

    Parameters
    ----------
    address : str
        Address of the page, as the browser has it.
    told : function
        Is called when there is something to tell.

    Attributes
    ----------
    key : str
        Tells it from pages that were loaded before.
    endings : list of functions
        Called when the page is gone.
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
        """Have elements and notices be of this page."""
        token = _PAGE.set(self)
        try:
            yield
        finally:
            _PAGE.reset(token)

    def hear(self, number: int, value: Any) -> None:
        """Do what an element is for, if it is still there; what is refused is shown."""
        if number in self.handlers:
            with self.current():
                tried(lambda: self.handlers[number](value))

    def tell(self, **said: Any) -> None:
        """Have the browser told something, as soon as it listens."""
        if "part" in said:
            self.forget(said["part"], said["part"] + 1)
        self._messages.append(said)
        self._told()

    def forget(self, first: int, last: int) -> None:
        """Forget what elements and parts do whose numbers are from `first` to below `last`."""
        for number in range(first, last):
            self.handlers.pop(number, None)
        self._messages = [message for message in self._messages if not first <= message.get("part", -1) < last]

    def taken(self) -> list[dict[str, Any]]:
        """Messages that are to be told, which then were."""
        messages, self._messages = self._messages, []
        return messages

    def end(self) -> None:
        """Let go of what the page follows."""
        for end in self.endings:
            end()


def page() -> Page:
    """The page that is drawn, or in which something was pressed."""
    return _PAGE.get()


class Element:
    """An element that was written; what is said within it is written before its end."""

    def __init__(self, out: list[str]) -> None:
        self._out = out

    def __enter__(self) -> None:
        self._end = self._out.pop()

    def __exit__(self, *_: object) -> None:
        self._out.append(self._end)


def say(tag: str, text: str = "", **attributes: Any) -> Element:
    """Write an element with a text, whatever is in it.

    Attributes have `_` for `-`, and those that are None or False are left out. That of an event of `EVENTS` is the
    function that takes the element's value then.
    """
    out, words = page().out, ""
    for name, value in attributes.items():
        if name in EVENTS:
            number = next(page().numbers)
            page().handlers[number] = value
            words += f' data-on="{name}" data-number="{number}"'
        elif value is not None and value is not False:
            words += f" {name.rstrip('_').replace('_', '-')}"
            words += "" if value is True else f'="{html.escape(str(value))}"'
    out += [f"<{tag}{words}>{html.escape(text)}", "" if tag in _EMPTY else f"</{tag}>"]
    return Element(out)


class PagePart:
    """A part of a page that is drawn where it is called, and again when it is refreshed.

    Parameters
    ----------
    draw : function, optional
        Draws what is in it; by default nothing, until it is filled.
    """

    def __init__(self, draw: Callable[[], object] = lambda: None) -> None:
        self._page, self._draw, self._html = page(), draw, ""
        self._number = next(self._page.numbers)
        self._first = self._last = 0  # numbers of its elements

    def __call__(self) -> None:
        with say("div", data_part=self._number):
            with self._drawn():
                self._draw()
            self._page.out.append(self._html)

    def refresh(self) -> None:
        """Draw it again."""
        with self.filled():
            self._draw()

    @contextmanager
    def filled(self) -> Iterator[None]:
        """Draw something else in it; what could be pressed in it before is gone then."""
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
    """Do something and show its fault if there is one; True if there is none."""
    try:
        action()
    except ClscoError as error:
        messages = error.messages if isinstance(error, SceneError) else (str(error),)
        notify("\n".join(messages[:6]), is_good=False)
        return False
    return True


def notify(text: str, is_good: bool = True) -> None:
    """Show a message for a while."""
    page().tell(notice=text, good=is_good)


def button(text: str, pressed: Callable[[], object], **attributes: Any) -> Element:
    """A button; what it refuses is shown."""
    return say("button", text, type="button", click=lambda _: pressed(), **attributes)


def text_box(label: str, value: str, typed: Callable[[str], object], **attributes: Any) -> None:
    """A labeled box for text; `typed` is called with each change."""
    with say("label", class_="box"):
        say("span", label)
        say("input", type="text", value=value, autocomplete="off", input=lambda text: typed(str(text)), **attributes)


def check_box(label: str, is_on: bool, changed: Callable[[bool], object], **attributes: Any) -> None:
    """A labeled check box."""
    with say("label", class_="check"):
        say("input", type="checkbox", checked=is_on, change=lambda on: changed(bool(on)), **attributes)
        say("span", label)


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
    with say("label", class_="box"):
        say("span", label)
        with say("select", change=lambda option: chosen(str(option))):
            for option, text in named.items():
                lacks = needs.get(option, "")
                shown = f"{text} ({lacks})" if lacks else text
                say("option", shown, value=option, selected=option == value, disabled=bool(lacks))


class Dialog:
    """A dialog of the browser's own, which keeps the focus inside, and closes with Esc.

    draw: what is in it, until it is filled with something else.
    """

    def __init__(self, title: str, draw: Callable[[], object] = lambda: None, wide: bool = False) -> None:
        self._page = page()
        self._place = f"#dialog-{next(self._page.numbers)}"
        body = PagePart(draw)
        self.filled = body.filled
        with say("dialog", id=self._place[1:], aria_label=title, class_=f"studio-dialog{' wide' if wide else ''}"):
            say("h2", title)
            body()
            with say("div", class_="dialog-end"):
                say("button", "Close", type="button", data_close=self._place)

    def open(self) -> None:
        """Show it, if it is not shown."""
        self._page.tell(show=self._place)

    def close(self) -> None:
        """Hide it."""
        self._page.tell(close=self._place)


def number(field: Field, value: Any) -> None:
    """Draw a number: its label, a slider where it has one, a box and its unit, and a place for its message.

    Parameters
    ----------
    field : Field
        Field of a number.
    value
        Value to show; None: nothing.
    """
    with say("div", class_="live"):
        box = f"box-{field.path}"
        say("label", field.name, for_=box)
        slider(field)
        number_box(field, value, box)
        say("span", field.unit, class_="unit")
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
