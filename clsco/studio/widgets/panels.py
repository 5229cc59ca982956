"""Panels of the scene's keys: those of the thesis with its labels, then all others.

`static/studio.js` reads and writes controls with `data-path`; changes to the set of controls are redrawn here.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from clsco.scene.shapes import SHAPES
from clsco.studio.folder import IMAGES, listed
from clsco.studio.forms import Field, Panel, panels
from clsco.studio.keyframes import tracks
from clsco.studio.presets import choose_method, is_as_the_thesis
from clsco.studio.session import Document
from clsco.studio.tables import ON_THE_STRIP, SHAPE_LABELS, THESIS_TITLES, at, words
from clsco.studio.widgets.html import (
    PagePart,
    button,
    check,
    check_box,
    choice,
    icon,
    label,
    number,
    page,
    say,
)  # fmt: skip

_MOTIONS = {"velocity": "Translation", "angular_velocity": "Rotation"}
_SHAPE_ICONS = {"plane": "square", "cylinder": "cylinder", "sphere": "globe", "cone": "cone", "ellipsoid": "egg"}
_ICONS = dict(zip(THESIS_TITLES, ("image", "shapes", "sliders-horizontal", "move-3d", "camera"), strict=True))
_ICONS |= {"Light": "lightbulb", "Sensor": "cpu", "Stereo": "columns-2", "Sequence": "film"}
_ICONS |= {"PSF and method": "aperture", "Filling": "wand-sparkles", "Keyframes": "timer", "Texture": "grid-2x2"}
_TYPE, _PROPERTIES, _MOTION = 1, 2, 3  # positions among the panels of the thesis


@dataclass
class Chosen:
    """State of the panels of a page."""

    index: int = 0  # of the selected object
    scene: int = 0  # the `State.opened` to which `added` belongs
    open: str = THESIS_TITLES[2]  # title of the panel that is unfolded, "" for none
    added: set[str] = field(default_factory=set)  # titles of panels that the user added to those that the scene uses
    before: dict[str, Any] = field(default_factory=dict)  # values of motions that were switched off, by path


def draw_panels(session: Document, now: Chosen) -> None:
    """Draw the objects of a session and all panels, and redraw a part when its set of controls changes."""
    now.scene = session.state.opened

    def draw() -> None:
        listed = panels(session, now.index)
        shown = [panel for panel in listed if panel.is_open or panel.title in now.added]
        for position, panel in enumerate(shown):
            _draw(session, panel, position, now, method)
        with say("div", class_="chips", role="group", aria_label="Add what the scene needs"):
            for panel in listed:
                if panel not in shown:
                    with button("", partial(add, panel.title), class_="chip"):
                        icon("plus")
                        say("span", panel.title)

    def add(title: str) -> None:
        now.added.add(title)
        now.open = title
        area.refresh()

    def names() -> Any:
        return now.index, [(item["shape"], item.get("name")) for item in session.table["object"]]

    objects = PagePart(lambda: object_list(session, now.index, choose), names)
    method = PagePart(partial(_method, session), partial(is_as_the_thesis, session))
    area = PagePart(draw, partial(_form, session, now))

    def choose(index: int) -> None:
        now.index = index
        changed()

    def changed() -> None:
        now.index = min(now.index, len(session.table["object"]) - 1)
        if now.scene != session.state.opened:  # another scene, whose keys decide which panels are open
            now.scene = session.state.opened
            now.added.clear()
        for part in (objects, method, area):
            part.changed()

    objects()
    area()
    page().endings.append(session.subscribe(changed))


def _form(session: Document, chosen: Chosen) -> Any:
    """Key of the panels, without values that are typed or dragged in them: redrawing would interrupt the user."""
    path = f"object.{chosen.index}"
    moves = [is_chosen(session, f"{path}.motion.{key}") for key in _MOTIONS]
    counts = [len(session.table.get(key, ())) for key in ("object", "group")]
    counts += [len(track.times) for track in tracks(session)]
    return chosen.index, chosen.scene, session.shown(f"{path}.shape"), counts, moves


def is_chosen(session: Document, path: str) -> bool:
    """True if a motion is given, even if it is 0."""
    return at(session.table, path.split(".")) is not None or any(key.startswith(path) for key in session.refused)


def _draw(session: Document, panel: Panel, position: int, chosen: Chosen, method: Callable[[], Any]) -> None:
    def toggled(is_open: object) -> None:
        if is_open:
            chosen.open = panel.title
        elif chosen.open == panel.title:
            chosen.open = ""

    with say("details", name="panel", open=panel.title == chosen.open, class_="panel", toggle=toggled):
        with say("summary"):
            icon(_ICONS.get(panel.title, "box"))
            say("h2", panel.title)
            _draw_brief(panel, position, chosen.index)
            icon("chevron-right")
        with say("div", class_="body"):
            if panel.title == "PSF and method":
                method()
            for each in panel.fields:
                if position == _TYPE:
                    _shapes(session, each)
                elif position == _MOTION and each.key in _MOTIONS:
                    _motion(session, each, chosen)
                elif each.path in ON_THE_STRIP:
                    say("button", f"{each.label}: in the lens below", type="button", data_to=each.path)
                else:
                    draw_field(session, each)


def _draw_brief(panel: Panel, position: int, index: int) -> None:
    """Draw the place for a value of a panel, which the page's script fills."""
    paths = {0: f"object.{index}.texture", _TYPE: f"object.{index}.shape", _MOTION: "moves"}
    path = "camera.focal_length" if panel.title == THESIS_TITLES[-1] else paths.get(position)
    say("output", data_brief=path)


def draw_field(session: Document, shown: Field) -> None:
    """Draw one field: its control or those of its components, its description, and a button to reset it."""
    value = session.shown(shown.path)
    if shown.kind == "vector":
        with say("fieldset", class_="vector"):
            label(shown, "legend")
            _components(session, shown)
            if shown.key == "semi_axes":
                check_box("c = b, as in the thesis", session.is_linked, partial(setattr, session, "is_linked"))
        return
    with say("div", class_="field"):
        if shown.kind == "number":
            number(shown, value)
        elif shown.kind == "flag":
            only = shown.only or None
            with say("div", data_clear=shown.path, data_default=json.dumps(shown.default)):
                check(shown.label, checked=bool(value), title=shown.help, data_path=shown.path, data_only=only)
            _fault(shown)
        else:
            box = f"box-{shown.path}"
            label(shown, for_=box)
            if shown.kind == "choice":
                _select(shown, value, box)
            else:
                _text(session, shown, value, box)
            _fault(shown)


def _components(session: Document, shown: Field) -> None:
    with say("div", class_="three"):
        for index, letter in enumerate(shown.components):
            part = shown.component(index)
            number(part, session.shown(part.path), letter)


def _select(shown: Field, value: Any, box: str) -> None:
    only = shown.only or None
    with say("select", id=box, data_path=shown.path, aria_label=shown.name, title=shown.help, data_only=only):
        if shown.default is None:
            say("option", "by default", value="", selected=value is None)
        for option, label in shown.choices:
            say("option", label, value=option, selected=option == value)
        if isinstance(value, list):  # weights of a shutter curve, from a scene file
            say("option", str(value), value="", selected=True, disabled=True)


def _text(session: Document, shown: Field, value: Any, box: str) -> None:
    names = f"names-{shown.path}" if shown.kind == "image" else None
    with say("div", class_="row"):
        say(
            "input", id=box, type="text", data_path=shown.path, value="" if value is None else str(value), list=names,
            data_only=shown.only or None, aria_label=shown.name, title=shown.help, autocomplete="off",
        )  # fmt: skip
        if shown.kind == "image":
            say("input", type="file", accept=",".join(IMAGES), hidden=True, data_upload=shown.path, tabindex="-1")
            say("button", "Browse", type="button", data_browse=shown.path, aria_label=f"Browse for {shown.label}")
    if names is not None:
        with say("datalist", id=names):
            for name in [name for name, _ in shown.choices] + listed(session.folder, IMAGES)[:100]:
                say("option", value=name)
    if shown.key == "texture":
        with say("div", data_drop=shown.path, class_="drop"):
            say("img", data_thumbnail=shown.path, alt="", hidden=True, class_="thumbnail")
            say("span", "Drop an image here", data_about=shown.path)


def _fault(shown: Field) -> None:
    say("div", data_fault=shown.path, hidden=True)


def _shapes(session: Document, shown: Field) -> None:
    """Draw radio buttons of the shapes: the five of the thesis, and the others below."""
    value = session.shown(shown.path)
    with say("div", role="radiogroup", aria_label=shown.label, class_="types"):
        for option, label in shown.choices:
            check(
                label, "radio", name=shown.path, value=option, checked=option == value, data_path=shown.path,
                symbol=_SHAPE_ICONS.get(option, ""),
            )  # fmt: skip
    _fault(shown)


def _motion(session: Document, shown: Field, chosen: Chosen) -> None:
    path, is_on = shown.path, is_chosen(session, shown.path)

    def choose(on: bool) -> None:
        if on:
            session.patch(path, chosen.before.pop(path, None) or [0.0, 0.0, 0.0])
        else:
            chosen.before[path] = session.known(path)
            session.patch(path, None)

    check_box(_MOTIONS[shown.key], is_on, choose, title=shown.help)
    with say("fieldset", disabled=not is_on, class_="vector"):
        say("legend", f"{shown.symbol} ({shown.unit})")
        _components(session, shown)
    _fault(shown)


def _method(session: Document) -> None:
    is_thesis = is_as_the_thesis(session)
    with say("div", role="group", aria_label="Method", class_="row"):
        for on, text in ((True, "As the thesis"), (False, "Defaults of clsco")):
            pressed = "true" if is_thesis is on else "false"
            button(text, partial(choose_method, session, on), aria_pressed=pressed)


def object_list(session: Document, index: int, choose: Callable[[int], None]) -> None:
    """Draw the list of objects, with the selected one marked, and buttons to edit the list."""
    objects = session.table["object"]
    last = len(objects) - 1

    def moved(to: int) -> None:
        session.move_object(index, to)
        choose(to)

    def deleted() -> None:
        session.delete_object(index)
        choose(max(index - 1, 0))

    with say("section", aria_label="Objects", class_="objects"):
        with say("ul"):
            for number, item in enumerate(objects):
                label = str(item.get("name") or SHAPE_LABELS.get(item["shape"], words(item["shape"])))
                with (
                    say("li"),
                    button(
                        "", partial(choose, number), aria_pressed="true" if number == index else "false", title=label,
                        aria_label=f"Object {number + 1}, {label}", class_="swatch",
                    ),
                ):  # fmt: skip
                    say("span", f"{number + 1} {label}")
                    say("img", data_thumbnail=f"object.{number}.texture", alt="", hidden=True)
        label = "Add or arrange objects"
        with say("button", type="button", class_="icon", aria_label=label, title=label, popovertarget="object-menu"):
            icon("plus")
        with say("div", id="object-menu", popover=True, role="group", aria_label="Change the list of objects"):
            _adding(session, choose)
            button("Copy", lambda: choose(session.copy_object(index)), aria_label="Copy the object")
            button("Delete", deleted, aria_label="Delete the object", disabled=last == 0)
            button("Earlier", lambda: moved(index - 1), disabled=index == 0)
            button("Later", lambda: moved(index + 1), disabled=index == last)


def _adding(session: Document, choose: Callable[[int], None]) -> None:
    ready = [shape for shape in SHAPES if shape != "depth_map"]  # a depth map needs a file first
    add = session.add_object
    with say("select", aria_label="Add an object", data_once=True, change=lambda shape: choose(add(str(shape)))):
        say("option", "Add ...", value="")
        for shape in ready:
            say("option", SHAPE_LABELS.get(shape, words(shape)), value=shape)


def draw_sweep(session: Document) -> None:
    """Draw a selector of the scenes of a sweep; nothing for a single scene."""

    def draw() -> None:
        labels = session.state.labels
        if len(labels) == 1:
            return
        with say("section", aria_label="Sweep", class_="objects"):
            say("p", f"Keys with several values make {len(labels)} scenes; Generate writes them all.", role="status")
            named = {label: f"{number + 1} {label.replace('__', ', ')}" for number, label in enumerate(labels)}
            choice("Scene that is shown", named, labels[session.state.shown], session.show_scene, {})

    area = PagePart(draw, lambda: (session.state.labels, session.state.shown))
    area()
    page().endings.append(session.subscribe(area.changed))
