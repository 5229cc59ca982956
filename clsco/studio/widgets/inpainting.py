"""The mode of inpainting: painted pixels are filled, by several methods for comparison."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from functools import partial
from typing import Any

from clsco.scene.formatting import format_seconds
from clsco.studio.folder import IMAGES, listed
from clsco.studio.inpainting import FILLERS, inpainting_of
from clsco.studio.presets import REMOVALS
from clsco.studio.session import Document
from clsco.studio.widgets.html import PagePart, button, command_row, notify, page, say, tried

METHODS = {
    "mean-median": ("Mean and median", "the thesis, chapter 5"), "biharmonic": ("Biharmonic", "smooth surfaces"),
    "texture": ("Texture", "frequency-selective"), "auto": ("Auto", "biharmonic or texture"),
}  # fmt: skip
_TICK = 0.4  # s between checks of a method's progress


class Painting:
    """The panel and the cards of a tab's mode, and the handlers of their buttons; `static/brush.js` paints."""

    def __init__(self, session: Document, tab: str, device: str | None) -> None:
        self._session, self._tab, self._page = session, tab, page()
        self._inpainting = inpainting_of(session, device)
        self._typed = {"mask": "inpainting/mask.png", "folder": "inpainting"}
        self._running: tuple[str, float] | None = None  # method that fills, and when it began
        self._filling: asyncio.Task[None] | None = None
        self._bar, self._work = PagePart(self._draw_bar), PagePart(self._draw_work)
        self._cards, self._results = PagePart(self._draw_cards), PagePart(self._draw_results)

    def parts(self) -> dict[str, Callable[..., object]]:
        """Parts of static/page.html, and after the name of an event, its handler."""
        typed = self._typed
        return {
            "images": lambda: [say("option", value=name) for name in listed(self._session.root, IMAGES)],
            "removals": self._draw_removals, "cards": self._cards,
            "work": self._work, "results": self._results, "change image": self._open, "click frame": self._open_frame,
            "input mask": partial(typed.__setitem__, "mask"), "input folder": partial(typed.__setitem__, "folder"),
            "click load": lambda _: self._load_mask(), "click save": lambda _: self._save_mask(),
            "click write": lambda _: self._save(),
        }  # fmt: skip

    def _brush(self, *call: Any) -> None:
        """Call a function of `static/brush.js`."""
        self._page.tell(brush=call)

    def _open_frame(self, name: object) -> None:
        self._open(name, f"frame of {self._session.table.get('title') or 'the scene'}")

    def _open(self, name: object, label: str = "") -> None:
        self._inpainting.open(str(name))
        self._inpainting.title = label or str(name)
        self._changed("load")

    def _open_removal(self, name: str) -> None:
        self._inpainting.open_removal(name)
        self._changed("load")

    def _load_mask(self) -> None:
        self._inpainting.load_mask(self._typed["mask"])
        self._changed("replaced")

    def _changed(self, call: str) -> None:
        """Have the brush load another image or mask, which has no results."""
        self._cards.refresh()
        self._results.refresh()
        self._brush(call)

    def _save_mask(self) -> None:
        self._inpainting.save_mask(self._typed["mask"])
        notify(f"Wrote {self._typed['mask']}")

    def _save(self) -> None:
        notify(f"Wrote {', '.join(self._inpainting.save(self._typed['folder']))} to {self._typed['folder']}")

    def _fill(self, *methods: str) -> None:
        """Fill by those of the methods that have no result of this mask, one after the other."""
        if self._running is None:
            missing = [method for method in methods if method not in self._inpainting.results]
            self._filling = asyncio.create_task(self._fill_by(missing))

    async def _fill_by(self, methods: list[str]) -> None:
        for method in methods:
            self._running = (method, time.monotonic())
            self._work.refresh()
            filled = asyncio.create_task(asyncio.to_thread(self._inpainting.fill, method))
            while not (await asyncio.wait([filled], timeout=_TICK))[0]:
                self._bar.refresh()
            self._running = None
            self._work.refresh()
            if not tried(filled.result) or filled.result() is None:
                return
            self._cards.refresh()
            self._results.refresh()
            self._brush("filled", method, [*self._inpainting.results])

    def _draw_removals(self) -> None:
        for name, preset in REMOVALS.items():
            button(preset.title, partial(self._open_removal, name), class_="chip")

    def _draw_cards(self) -> None:
        for method in FILLERS:
            filled = self._inpainting.results.get(method)
            title, about = METHODS[method]
            with button(
                "", partial(self._fill, method), class_="card", data_card=method, data_filled=filled is not None,
                data_after="sent", aria_pressed="false",
            ):  # fmt: skip
                say("canvas", width=148, height=116, aria_hidden="true")
                with say("span"):
                    say("b", title)
                    say("small", about)
                    took = "" if filled is None or filled.figures["method"] == method else filled.figures["method"]
                    seconds = "not filled yet" if filled is None else format_seconds(filled.figures["seconds"])
                    say("small", f"{METHODS[took][0].lower()}, {seconds}" if took else seconds)

    def _draw_work(self) -> None:
        if self._running is None:
            button("Fill", partial(self._fill, *FILLERS[:-1]), data_after="sent", class_="primary")
        else:
            button("Cancel", self._inpainting.filler.cancel)
            self._bar()

    def _draw_bar(self) -> None:
        if self._running is not None:
            (method, began), share = self._running, self._inpainting.filler.share
            say("progress", value=f"{share:.3f}" if share else None, max="1", aria_label=f"Progress of {method}")
            say("small", f"{METHODS[method][0]}: {100.0 * share:.0f} %, {time.monotonic() - began:.0f} s")

    def _draw_results(self) -> None:
        """Draw the table of figure 5.21, and the command lines of the methods."""
        inpainting = self._inpainting
        if not inpainting.results:
            return
        with say("details", class_="fold"):
            say("summary", "Figures, as in figure 5.21")
            with say("div", class_="scrolled", tabindex="0"), say("table", class_="figures"):
                with say("tr"):
                    say("td")
                    for method in inpainting.results:
                        say("th", METHODS[method][0], scope="col")
                for label, values in inpainting.table():
                    with say("tr"):
                        say("th", label, scope="row")
                        for value in values:
                            say("td", value or "–")
        with say("details", class_="fold"):
            say("summary", "The same by hand")
            for method in inpainting.results:
                command_row(inpainting.command(method, self._typed["folder"]), f" of {method}")
