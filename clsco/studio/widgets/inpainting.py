"""Inpainting with a brush: painted pixels are replaced, by several methods side by side."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial

from nicegui import run, ui

from clsco.errors import ClscoError
from clsco.studio.folder import IMAGES, listed
from clsco.studio.inpainting import FILLERS, Inpainting, inpainting_of
from clsco.studio.jobs import Jobs
from clsco.studio.presets import REMOVALS
from clsco.studio.session import Document
from clsco.studio.widgets.html import Dialog, button, check_box, say, text_box, tried

_TOOLS = {
    "brush": "Brush", "rectangle": "Rectangle", "lasso": "Lasso", "color": "Pixels of a color", "move": "Move the view",
}  # fmt: skip
_LABELS = {"mean-median": "Mean and median (thesis)", "biharmonic": "Biharmonic", "texture": "Texture"}
_FRAME = "async () => emit(await studio.brush.shownFrame())"
_ALL_SENT = "async () => { await studio.brush.sent(); emit(); }"
_BLANK = "what is hatched is filled; wheel or fingers zoom, Shift and a drag move the view"
_TICK = 0.4  # s between looks at a method


class _Actions:
    """Actions of the dialog, and the parts of it that they make anew."""

    def __init__(self, inpainting: Inpainting, jobs: Jobs, tab: str, dialog: Dialog) -> None:
        self.inpainting, self.jobs, self.tab, self.dialog = inpainting, jobs, tab, dialog
        self.typed = {"name": "", "mask": "inpainting/mask.png", "folder": "inpainting"}
        self.wanted = dict.fromkeys(FILLERS, True)
        self.running: tuple[str, float] | None = None  # method that fills, and when it began

    def open(self, name: str) -> None:
        self.inpainting.open(name)
        self._loaded()

    def open_removal(self, name: str) -> None:
        self.inpainting.open_removal(name)
        self._loaded()

    def _loaded(self) -> None:
        ui.run_javascript("studio.brush.load()")
        self.results.refresh()

    def load_mask(self) -> None:
        self.inpainting.load_mask(self.typed["mask"])
        ui.run_javascript("studio.brush.replaced()")
        self.results.refresh()

    def save_mask(self) -> None:
        self.inpainting.save_mask(self.typed["mask"])
        ui.notify(f"Wrote {self.typed['mask']}", type="positive")

    def save(self) -> None:
        names = self.inpainting.save(self.typed["folder"])
        ui.notify(f"Wrote {', '.join(names)} to {self.typed['folder']}", type="positive")

    def chosen(self) -> list[str]:
        return [method for method, is_on in self.wanted.items() if is_on]

    def begin(self) -> None:
        self.inpainting.begin(self.jobs, self.chosen(), self.typed["folder"])
        self.dialog.close()

    async def fill(self, timer: ui.timer) -> None:
        self.results.refresh()
        timer.activate()
        for method in self.chosen():
            self.running = (method, time.monotonic())
            self.progress.refresh()
            try:
                found = await run.io_bound(self.inpainting.fill, method)
            except ClscoError as error:
                ui.notify(str(error), type="negative", close_button="Close")
                break
            finally:
                self.running = None
                self.progress.refresh()
            if found is None:
                break
            self.results.refresh()
        timer.deactivate()

    @ui.refreshable_method
    def progress(self) -> None:
        if self.running is not None:
            method, began = self.running
            _progress(self.inpainting, method, time.monotonic() - began)

    @ui.refreshable_method
    def results(self) -> None:
        _results(self.inpainting, self.tab, self.typed["folder"])


def inpainting_dialog(session: Document, jobs: Jobs, tab: str, device: str | None = None) -> Callable[[], None]:
    """The dialog of inpainting.

    Parameters
    ----------
    session : Document
    jobs : Jobs
    tab : str
        Name of the tab.
    device : str, optional

    Returns
    -------
    function
        Opens it.
    """
    inpainting = inpainting_of(session, device)
    dialog = Dialog("Inpainting")
    dialog.element.classes("wide")
    actions = _Actions(inpainting, jobs, tab, dialog)
    typed = actions.typed
    with dialog.body:
        timer = ui.timer(_TICK, actions.progress.refresh, active=False)
        names = "names-inpainting"
        with say("datalist", id=names):
            for name in listed(session.root, IMAGES):
                say("option", value=name)
        with say("div").classes("row"):
            text_box(f"Image in {session.root.name}", "", lambda name: typed.update(name=name), list=names)
            button("Open the image", lambda: actions.open(typed["name"]))
            say("button", "Take the frame shown", type="button", data_brush="frame").on(
                "click", lambda event: tried(lambda: actions.open(str(event.args))), js_handler=_FRAME
            )
        with say("div", role="group", aria_label="Presets").classes("row"):
            say("span", "Presets:").classes("quiet")
            for name, preset in REMOVALS.items():
                button(preset.title, partial(actions.open_removal, name))
        _tools()
        say(
            "canvas", data_brush="canvas", tabindex="0", role="img",
            aria_label="Image with its mask; arrows move the brush, Enter paints",
        )  # fmt: skip
        with say("div").classes("row"):
            say("span", "Open an image, and paint over what is to go.", data_brush="told", role="status")
            say("span", _BLANK).classes("quiet")
        with say("div", role="group", aria_label="Methods").classes("row"):
            for method in FILLERS:
                check_box(_LABELS[method], True, partial(actions.wanted.__setitem__, method))
            say("button", "Fill", type="button").classes("primary").on(
                "click", lambda _: actions.fill(timer), js_handler=_ALL_SENT
            )
        actions.progress()
        actions.results()
        with say("div").classes("row"):
            text_box("Mask (PNG)", typed["mask"], lambda name: typed.update(mask=name), list=names)
            button("Load the mask", actions.load_mask)
            say("button", "Save the mask", type="button").on(
                "click", lambda _: tried(actions.save_mask), js_handler=_ALL_SENT
            )
        with say("div").classes("row"):
            text_box("Folder for the results", typed["folder"], lambda name: typed.update(folder=name))
            button("Write the results", actions.save)
            say("button", "Fill as jobs", type="button", title="Goes on when the page is closed").on(
                "click", lambda _: tried(actions.begin), js_handler=_ALL_SENT
            )

    def show() -> None:
        dialog.open()
        ui.run_javascript(f"studio.brush.opened({'true' if inpainting.name else 'false'})")

    return show


def _tools() -> None:
    """Tools of the brush, which `static/brush.js` reads."""
    with say("div", role="radiogroup", aria_label="Tool").classes("row"):
        for tool, label in _TOOLS.items():
            with say("label").classes("check"):
                say(
                    "input", type="radio", name="brush-tool", value=tool, data_brush="tool",
                    checked=True if tool == "brush" else None,
                )  # fmt: skip
                say("span", label)
        with say("label", title="E").classes("check"):
            say("input", type="checkbox", data_brush="erase")
            say("span", "Erase")
    with say("div").classes("row"):
        with say("label", title="[ and ]").classes("check"):
            say("span", "Width of the brush (px)")
            say("input", type="range", min="1", max="200", step="1", value="12", data_brush="size")
        with say("label").classes("check"):
            say("span", "Tolerance of a color (% of white)")
            say("input", type="range", min="0", max="50", step="1", value="8", data_brush="tolerance")
    with say("div").classes("row"):
        say("button", "Undo stroke", type="button", data_brush="undo", title="Ctrl Z", disabled=True)
        say("button", "Redo stroke", type="button", data_brush="redo", title="Shift Ctrl Z", disabled=True)
        say("button", "Clear the mask", type="button", data_brush="clear")
        say("span").classes("spread")
        say("span", "", data_brush="zoom").classes("quiet")
        say("button", "−", type="button", data_brush="smaller", aria_label="Zoom out")
        say("button", "+", type="button", data_brush="larger", aria_label="Zoom in")
        say("button", "Fit", type="button", data_brush="fit", title="0")


def _progress(inpainting: Inpainting, method: str, seconds: float) -> None:
    """Progress of a method, with a button that cancels it."""
    share = inpainting.filler.share
    with say("div").classes("row"):
        say("span", f"{_LABELS[method]}: {100.0 * share:.0f} %, {seconds:.0f} s")
        say("progress", value=f"{share:.3f}" if share else None, max="1", aria_label=f"Progress of {method}")
        button("Cancel", inpainting.filler.cancel)


def _results(inpainting: Inpainting, tab: str, folder: str) -> None:
    """Images that the methods have filled, and the table of figure 5.21."""
    if not inpainting.results:
        return
    now = time.monotonic_ns()
    with say("div").classes("beside"):
        for method in inpainting.results:
            place = f"inpainting/picture?tab={tab}&which={method}&at={now}"
            with say("figure"):
                say("img", src=place, alt=f"Filled by {method}")
                with say("figcaption"):
                    say("span", f"{_LABELS[method]} ")
                    if inpainting.image.dtype == "uint8":  # else what is shown has fewer bits
                        say("a", "Save as PNG", href=place, download=f"{method}.png")
    with say("div").classes("scrolled"), say("table").classes("figures"):
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
        with say("div").classes("row"):
            say("code", line).classes("line")
            say("button", "Copy", type="button", data_copy=line, aria_label=f"Copy the command line of {method}")
