"""Choice of the scene that is shown, of a file with several."""

from __future__ import annotations

from collections.abc import Callable

from nicegui import ui

from clsco.studio.session import Document
from clsco.studio.widgets.html import choice, say, tried


def draw_sweep(session: Document) -> Callable[[], None]:
    """Say that a file has several scenes, and let one be chosen; returns what ends it, when the page is closed."""

    @ui.refreshable
    def area() -> None:
        labels = session.state.labels
        if len(labels) == 1:
            return
        with say("section", aria_label="Sweep").classes("objects"):
            say("p", f"Keys with several values make {len(labels)} scenes; Generate writes them all.", role="status")
            named = {label: f"{number + 1} {label.replace('__', ', ')}" for number, label in enumerate(labels)}
            choice("Scene that is shown", named, labels[session.state.shown], chosen)

    def chosen(label: str) -> None:
        tried(lambda: session.show_scene(label))

    before = [_seen(session)]

    def changed() -> None:
        if _seen(session) != before[0]:
            before[0] = _seen(session)
            area.refresh()

    area()
    return session.subscribe(changed)


def _seen(session: Document) -> tuple[tuple[str, ...], int]:
    return session.state.labels, session.state.shown
