"""The list of a scene's objects."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from nicegui import ui

from clsco.scene.shapes import SHAPES
from clsco.studio.session import Document
from clsco.studio.widgets.html import button, say, tried
from clsco.studio.words import SHAPE_LABELS, words


def object_list(session: Document, index: int, choose: Callable[[int], None]) -> None:
    """Draw the objects, of which one is shown in the panels, with what can be done with them.

    Parameters
    ----------
    session : Document
    index : int
        Index of the object in the panels.
    choose : function of int
        Shows another one.
    """
    objects = session.table["object"]
    last = len(objects) - 1

    def moved(to: int) -> None:
        session.move_object(index, to)
        choose(to)

    def deleted() -> None:
        session.delete_object(index)
        choose(max(index - 1, 0))

    with say("section", aria_label="Objects").classes("objects"):
        with ui.element("ul"):
            for number, item in enumerate(objects):
                label = str(item.get("name") or SHAPE_LABELS.get(item["shape"], words(item["shape"])))
                with ui.element("li"):
                    button(
                        f"{number + 1} {label}", partial(choose, number),
                        aria_pressed="true" if number == index else "false", aria_label=f"Object {number + 1}, {label}",
                    )  # fmt: skip
        with say("div", role="group", aria_label="Change the list of objects").classes("row"):
            _adding(session, choose)
            button("Copy", lambda: choose(session.copy_object(index)), aria_label="Copy the object")
            button("Delete", deleted, aria_label="Delete the object", disabled=None if last else True)
            button("↑", lambda: moved(index - 1), aria_label="Earlier", disabled=True if index == 0 else None)
            button("↓", lambda: moved(index + 1), aria_label="Later", disabled=True if index == last else None)


def _adding(session: Document, choose: Callable[[int], None]) -> None:
    """A list of shapes, of which one is added."""
    handler = "(event) => { const shape = event.target.value; event.target.value = ''; emit(shape); }"
    ready = [shape for shape in SHAPES if shape != "depth_map"]  # which needs a file first
    with say("select", aria_label="Add an object").on(
        "change", lambda event: tried(lambda: choose(session.add_object(str(event.args)))), js_handler=handler
    ):
        say("option", "Add ...", value="")
        for shape in ready:
            say("option", SHAPE_LABELS.get(shape, words(shape)), value=shape)
