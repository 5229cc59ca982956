"""Inpainting with a brush: painted pixels are filled, by several methods for comparison."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from functools import partial
from typing import Any

from clsco.studio.folder import IMAGES, listed
from clsco.studio.inpainting import FILLERS, Inpainting, inpainting_of
from clsco.studio.presets import REMOVALS
from clsco.studio.session import Document
from clsco.studio.widgets.html import Dialog, PagePart, button, check, check_box, notify, page, say, text_box, tried

_TOOLS = {
    "brush": "Brush", "rectangle": "Rectangle", "lasso": "Lasso", "color": "Pixels of a color", "move": "Move the view",
}  # fmt: skip
_LABELS = {
    "mean-median": "Mean and median (thesis)", "biharmonic": "Biharmonic", "texture": "Texture",
    "auto": "The better of these two",
}  # fmt: skip
_BLANK = "what is hatched is filled; wheel or fingers zoom, Shift and a drag move the view"
_TICK = 0.4  # s between checks of a method's progress


class _Dialog:
    """The dialog, the handlers of its buttons, and the parts that they redraw."""

    def __init__(self, session: Document, tab: str, device: str | None) -> None:
        self.session, self.tab = session, tab
        self.inpainting = inpainting_of(session, device)
        self.page = page()
        self.typed = {"name": "", "mask": "inpainting/mask.png", "folder": "inpainting"}
        self.wanted = {method: method != "auto" for method in FILLERS}
        self.running: tuple[str, float] | None = None  # method that fills, and when it began
        self.filling: asyncio.Task[None] | None = None
        self.bar, self.progress, self.results = map(PagePart, (self._draw_bar, self._draw_progress, self._draw_results))
        self.dialog = Dialog("Inpainting", self._draw, wide=True)

    def show(self) -> None:
        self.dialog.open()
        self._brush("opened", bool(self.inpainting.name))

    def _brush(self, *call: Any) -> None:
        """Call a function of `static/brush.js`."""
        self.page.tell(brush=call)

    def open(self, name: object) -> None:
        self.inpainting.open(str(name))
        self._brush("load")
        self.results.refresh()

    def open_removal(self, name: str) -> None:
        self.inpainting.open_removal(name)
        self._brush("load")
        self.results.refresh()

    def load_mask(self) -> None:
        self.inpainting.load_mask(self.typed["mask"])
        self._brush("replaced")
        self.results.refresh()

    def save_mask(self) -> None:
        self.inpainting.save_mask(self.typed["mask"])
        notify(f"Wrote {self.typed['mask']}")

    def save(self) -> None:
        names = self.inpainting.save(self.typed["folder"])
        notify(f"Wrote {', '.join(names)} to {self.typed['folder']}")

    def fill(self) -> None:
        self.filling = asyncio.create_task(self._fill())

    async def _fill(self) -> None:
        self.results.refresh()
        for method in [method for method, is_on in self.wanted.items() if is_on]:
            self.running = (method, time.monotonic())
            self.progress.refresh()
            filled = asyncio.create_task(asyncio.to_thread(self.inpainting.fill, method))
            while not (await asyncio.wait([filled], timeout=_TICK))[0]:
                self.bar.refresh()
            self.running = None
            self.progress.refresh()
            if not tried(filled.result) or filled.result() is None:
                return
            self.results.refresh()

    def _draw(self) -> None:
        names, root, typed = "names-inpainting", self.session.root, self.typed
        with say("datalist", id=names):
            for name in listed(root, IMAGES):
                say("option", value=name)
        with say("div", class_="row"):
            text_box(f"Image in {root.name}", "", lambda name: typed.update(name=name), list=names)
            button("Open the image", lambda: self.open(typed["name"]))
            say(
                "input", type="file", accept=",".join(IMAGES), hidden=True, tabindex="-1", data_upload="",
                data_after="uploaded", data_once=True, change=self.open,
            )  # fmt: skip
            say("button", "Browse", type="button", data_browse="", aria_label="Browse for an image")
            words = "Take the frame shown"
            say("button", words, type="button", data_brush="frame", data_after="shownFrame", click=self.open)
        with say("div", role="group", aria_label="Presets", class_="row"):
            say("span", "Presets:", class_="quiet")
            for name, preset in REMOVALS.items():
                button(preset.title, partial(self.open_removal, name))
        _tools()
        say(
            "canvas", data_brush="canvas", tabindex="0", role="img",
            aria_label="Image with its mask; arrows move the brush, Enter paints",
        )  # fmt: skip
        with say("div", class_="row"):
            say("span", "Open an image, and paint over what is to go.", data_brush="told", role="status")
            say("span", _BLANK, class_="quiet")
        with say("div", role="group", aria_label="Methods", class_="row"):
            for method in FILLERS:
                check_box(_LABELS[method], self.wanted[method], partial(self.wanted.__setitem__, method))
            button("Fill", self.fill, data_after="sent", class_="primary")
        self.progress()
        self.results()
        with say("div", class_="row"):
            text_box("Mask (PNG)", typed["mask"], lambda name: typed.update(mask=name), list=names)
            button("Load the mask", self.load_mask)
            button("Save the mask", self.save_mask, data_after="sent")
        with say("div", class_="row"):
            text_box("Folder for the results", typed["folder"], lambda name: typed.update(folder=name))
            button("Write the results", self.save)

    def _draw_progress(self) -> None:
        """Draw the progress of a method, with a button that cancels it."""
        if self.running is not None:
            with say("div", class_="row"):
                self.bar()
                button("Cancel", self.inpainting.filler.cancel)

    def _draw_bar(self) -> None:
        if self.running is not None:
            (method, began), share = self.running, self.inpainting.filler.share
            say("span", f"{_LABELS[method]}: {100.0 * share:.0f} %, {time.monotonic() - began:.0f} s")
            say("progress", value=f"{share:.3f}" if share else None, max="1", aria_label=f"Progress of {method}")

    def _draw_results(self) -> None:
        _results(self.inpainting, self.tab, self.typed["folder"])


def inpainting_dialog(session: Document, tab: str, device: str | None = None) -> Callable[[], None]:
    """The dialog of inpainting for the tab named `tab`; returns a function that opens it."""
    return _Dialog(session, tab, device).show


def _tools() -> None:
    """Draw the tools of the brush, which `static/brush.js` reads."""
    with say("div", role="radiogroup", aria_label="Tool", class_="row"):
        for tool, label in _TOOLS.items():
            check(label, "radio", name="brush-tool", value=tool, data_brush="tool", checked=tool == "brush")
        with say("label", title="E", class_="check"):
            say("input", type="checkbox", data_brush="erase")
            say("span", "Erase")
    with say("div", class_="row"):
        with say("label", title="[ and ]", class_="check"):
            say("span", "Width of the brush (px)")
            say("input", type="range", min="1", max="200", step="1", value="12", data_brush="size")
        with say("label", class_="check"):
            say("span", "Tolerance of a color (% of white)")
            say("input", type="range", min="0", max="50", step="1", value="8", data_brush="tolerance")
    with say("div", class_="row"):
        say("button", "Undo stroke", type="button", data_brush="undo", title="Ctrl Z", disabled=True)
        say("button", "Redo stroke", type="button", data_brush="redo", title="Shift Ctrl Z", disabled=True)
        say("button", "Clear the mask", type="button", data_brush="clear")
        say("span", class_="spread")
        say("span", "", data_brush="zoom", class_="quiet")
        say("button", "−", type="button", data_brush="smaller", aria_label="Zoom out")
        say("button", "+", type="button", data_brush="larger", aria_label="Zoom in")
        say("button", "Fit", type="button", data_brush="fit", title="0")


def _results(inpainting: Inpainting, tab: str, folder: str) -> None:
    """Draw the images filled by the methods, and the table of figure 5.21."""
    if not inpainting.results:
        return
    now = time.monotonic_ns()
    start = f"inpainting/picture?tab={tab}&at={now}&which="
    with say("div", class_="beside"):
        titles = {"before": "The image before it was filled", "large": "As wide as the window"}
        for method, filled in inpainting.results.items():
            place, took = f"{start}{method}", filled.figures["method"]
            with say("figure"):
                say("img", src=place, alt=f"Filled by {method}")
                say("img", src=f"{start}image", alt="Before", loading="lazy")
                with say("figcaption", class_="row"):
                    say("span", _LABELS[method] if took == method else f"{_LABELS[method]}: {_LABELS[took]}")
                    for word, title in titles.items():
                        say(
                            "button", word.capitalize(), type="button", title=title, aria_pressed="false",
                            data_figure=word, aria_label=f"{word.capitalize()}: {method}",
                        )  # fmt: skip
                    if inpainting.image.dtype == "uint8":  # else the displayed picture has fewer bits
                        say("a", "Save as PNG", href=place, download=f"{method}.png")
    with say("div", class_="scrolled"), say("table", class_="figures"):
        say("caption", "Figures of the methods, as in figure 5.21")
        with say("tr"):
            say("td")
            for method in inpainting.results:
                say("th", _LABELS[method], scope="col")
        for label, values in inpainting.table():
            with say("tr"):
                say("th", label, scope="row")
                for value in values:
                    say("td", value or "–")
    for method in inpainting.results:
        line = inpainting.command(method, folder)
        with say("div", class_="row"):
            say("code", line, class_="line")
            say("button", "Copy", type="button", data_copy=line, aria_label=f"Copy the command line of {method}")
