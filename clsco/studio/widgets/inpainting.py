"""Inpainting with a brush: what is painted over goes, by several methods side by side."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial

from nicegui import run, ui

from clsco.errors import ClscoError
from clsco.studio.folder import IMAGES, listed
from clsco.studio.inpainting import METHODS, Inpainting, inpainting_of
from clsco.studio.session import Session
from clsco.studio.widgets.plain import Dialog, button, check_box, say, text_box, tried

_TOOLS = {"brush": "Brush", "erase": "Erase", "rectangle": "Rectangle", "color": "Pixels of a color"}
_LABELS = {"mean-median": "Mean and median (thesis)", "biharmonic": "Biharmonic", "texture": "Texture"}
_FRAME = "async () => emit(await window.studioBrush.frame())"


def inpainting_dialog(session: Session, tab: str, device: str | None = None) -> Callable[[], None]:
    """The dialog of inpainting.

    Parameters
    ----------
    session : Session
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
    typed = {"name": "", "mask": "", "folder": "inpainting"}
    wanted = dict.fromkeys(METHODS, True)

    def opened(name: str) -> None:
        inpainting.open(name)
        ui.run_javascript("studioBrush.load()")
        results.refresh()

    def masked() -> None:
        inpainting.load_mask(typed["mask"])
        ui.run_javascript("studioBrush.load()")
        results.refresh()

    def saved() -> None:
        names = inpainting.save(typed["folder"])
        ui.notify(f"Wrote {', '.join(names)} to {typed['folder']}", type="positive")

    async def fill() -> None:
        for method in [method for method, is_on in wanted.items() if is_on]:
            try:
                await run.io_bound(inpainting.fill, method)
            except ClscoError as error:
                ui.notify(str(error), type="negative", close_button="Close")
                return
            results.refresh()

    @ui.refreshable
    def results() -> None:
        _results(inpainting, tab)

    with dialog.body:
        names = "names-inpainting"
        with say("datalist", id=names):
            for name in listed(session.root, IMAGES):
                say("option", value=name)
        with say("div").classes("row"):
            text_box(f"Image in {session.root.name}", "", lambda name: typed.update(name=name), list=names)
            button("Open the image", lambda: opened(typed["name"]))
            say("button", "Take the frame shown", type="button").on(
                "click", lambda event: tried(lambda: opened(str(event.args))), js_handler=_FRAME
            )
        _tools()
        say("canvas", width=1, height=1, data_brush="canvas", role="img", aria_label="Image with what is missing")
        say("p", "Open an image, and paint over what is to go.", data_brush="told", role="status").classes("quiet")
        with say("div").classes("row"):
            text_box("Mask from a file", "", lambda name: typed.update(mask=name), list=names)
            button("Take the mask", masked)
        with say("div", role="group", aria_label="Methods").classes("row"):
            for method in METHODS:
                check_box(_LABELS[method], True, partial(wanted.__setitem__, method))
            say("button", "Fill", type="button").classes("primary").on("click", fill, args=[])
        results()
        with say("div").classes("row"):
            text_box("Folder for the results", typed["folder"], lambda name: typed.update(folder=name))
            button("Write the results", saved)
    return dialog.open


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
    with say("div").classes("row"):
        with say("label").classes("check"):
            say("span", "Width of the brush (px)")
            say("input", type="range", min="1", max="100", step="1", value="12", data_brush="size")
        with say("label").classes("check"):
            say("span", "Tolerance of a color (% of white)")
            say("input", type="range", min="0", max="50", step="1", value="8", data_brush="tolerance")
        say("button", "Clear the mask", type="button", data_brush="clear")


def _results(inpainting: Inpainting, tab: str) -> None:
    """What the methods have made, and the table of figure 5.21."""
    if not inpainting.results:
        return
    now = time.monotonic_ns()
    with say("div").classes("beside"):
        for method in inpainting.results:
            with say("figure"):
                say("img", src=f"/inpainting/picture?tab={tab}&which={method}&at={now}", alt=f"Filled by {method}")
                say("figcaption", _LABELS[method])
    with say("table").classes("figures"):
        say("caption", "What each method has taken")
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
        say("code", inpainting.command(method)).classes("line")
