"""The page of the studio."""

from __future__ import annotations

from clsco.studio.forms import field_at
from clsco.studio.pictures import SENSOR_VIEWS, VIEWS
from clsco.studio.server import Studio
from clsco.studio.session import Document
from clsco.studio.widgets.files import open_dialog, preset_dialog, recover_dialog, save_dialog, share_dialog
from clsco.studio.widgets.html import Page, button, number_box, say, slider
from clsco.studio.widgets.inpainting import inpainting_dialog
from clsco.studio.widgets.jobs import draw_jobs, generate_dialog
from clsco.studio.widgets.panels import draw_panels, draw_sweep

KEYS = (
    ("← → ↑ ↓", "step of a slider; with Shift ten times, with Alt a tenth"),
    ("1 … 9", "views"),
    (", .", "frame before, next frame"),
    ("F, then a click", "focus on what is there"),
    ("a click", "choose the object that is there, and outline it; Esc ends that"),
    (
        "a drag of a handle",
        "of the object that is outlined: the one in its middle moves it at its depth, the one above along z",
    ),
    ("M, then a drag", "move the object that is there at its depth; with Shift along z, which planes always do"),
    ("B", "inpainting; there [ and ] make the brush smaller and larger, E erases, 0 fits, Ctrl Z takes a stroke back"),
    ("E", "the right eye's view of a stereo pair, and back"),
    ("P, Space", "pin the exact frame; see it while the key is down"),
    ("Delete, Enter", "on the mark of a keyframe: remove it, go to its boxes; arrows move it in time"),
    ("Ctrl Z, Shift Ctrl Z", "undo, redo"),
    ("Ctrl S", "save"),
    ("Ctrl Enter", "generate"),
    ("Esc", "take back what is being dragged; cancel what takes long"),
    ("?", "this list"),
)
PINS = {"": "Pin …", "this": "this frame (P)", "thesis": "as the thesis"}
COMPARISONS = {
    "off": "not compared", "wipe": "wipe", "flip": "flip (Space)", "8": "difference × 8", "64": "difference × 64",
}  # fmt: skip
DIALS = (("camera.focus_distance", "Focus"), ("camera.f_number", "f/"), ("camera.focal_length", "f"))
_HEAD = """<!DOCTYPE html>
<html lang="en-US"><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<title>clsco studio</title><link rel="icon" href="data:,">
<link rel="stylesheet" href="static/studio.css"><link rel="stylesheet" href="static/forms.css">
<link rel="stylesheet" href="static/files.css"><script type="module" src="static/studio.js"></script>
<svg width="0" height="0" aria-hidden="true">
<filter id="view-filter" x="0" y="0" width="1" height="1">
<feComponentTransfer class="stops" color-interpolation-filters="linearRGB">
<feFuncR type="linear"/><feFuncG type="linear"/><feFuncB type="linear"/></feComponentTransfer>
<feComponentTransfer class="gamma" color-interpolation-filters="sRGB">
<feFuncR type="gamma"/><feFuncG type="gamma"/><feFuncB type="gamma"/></feComponentTransfer>
</filter></svg>
"""


def draw(name: str, studio: Studio, address: str) -> tuple[Page, str]:
    """Create the page of the tab `name` at the URL `address`; returns the page and its HTML."""
    page = Page(address, studio.tabs[name].told.set)
    with page.current():
        _draw(page, name, studio)
    return page, _HEAD + "".join(page.out)


def _draw(page: Page, name: str, studio: Studio) -> None:
    session = studio.tabs[name].session
    with say("div", id="studio", data_tab=name, data_page=page.key, data_proof=studio.proof_key):
        say("div", id="lost", role="status", hidden=True)
        with say("header"):
            _header(session, studio, name)
        with say("nav", id="panels", aria_label="Panels"):
            with say("div", id="panels-scroll"):
                draw_sweep(session)
                draw_panels(session)
            with say("div", id="panels-end"):
                say("button", "Reset", id="reset", data_do="reset", title="Panels 2 to 5 to their defaults")
                generate = generate_dialog(session, studio.jobs, studio.device or "")
                button("Generate", generate, id="generate", class_="primary")
        _lens_strip(session)
        with say("main", id="middle", aria_label="Picture and time line"):
            _middle()
        with say("aside", id="side", aria_label="Inspector and jobs", tabindex=0):
            _inspector()
            draw_jobs(studio.jobs)
    with say("dialog", id="keys", aria_label="Keyboard"):
        with say("table"):
            for keys, meaning in KEYS:
                with say("tr"):
                    say("th", keys, scope="row")
                    say("td", meaning)
        say("button", "Close", data_close="#keys")


def _header(session: Document, studio: Studio, name: str) -> None:
    """Header with title, files, undo and redo."""
    say("button", "☰", id="drawer", aria_label="Panels", data_toggle="open")
    say("h1", id="title")
    say("span", id="file", role="status")
    save, save_as = save_dialog(session)
    button("Open", open_dialog(session, studio))
    button("Presets", preset_dialog(session))
    button("Save", save, id="save")
    button("Save as", save_as)
    button("Share", share_dialog(session))
    button("Inpaint", inpainting_dialog(session, name, studio.device), id="inpaint")
    say("button", "Undo", id="undo", data_do="undo", disabled=True)
    say("button", "Redo", id="redo", data_do="redo", disabled=True)
    if studio.kept_scenes():
        button("Recover", recover_dialog(session, studio), title="Scenes of a studio that ended before they were saved")
    say("div", class_="spread")
    say("span", id="plan", title="Of the exact frame: passes, time, and memory on the device, as `clsco plan` reports")
    say("button", "?", aria_label="Keyboard", data_show="#keys")
    say("button", "Inspector", id="inspector", data_toggle="sided")


def _lens_strip(session: Document) -> None:
    """Strip with the lens, always visible: dials, "Focus by click", and the range in focus."""
    with say("section", id="lens-strip", aria_label="Lens"):
        about = "Lens, and what is in focus before it"
        say("canvas", id="lens-small", width=110, height=30, role="img", aria_label=about)
        for path, label in DIALS:
            dial = field_at(session, path)
            assert dial is not None
            with say("div", class_="dial"):
                say("label", label, for_=f"dial-{path}")
                slider(dial)
                number_box(dial, session.shown(path), f"dial-{path}")
                say("span", dial.unit, class_="unit")
        say(
            "button", "Focus by click", id="focus", aria_pressed="false", data_tool="focus",
            title="Then click what is to be in focus (F)",
        )  # fmt: skip
        say("output", id="in-focus", title="Where |R| is below half a pixel")


def _middle() -> None:
    """Tabs of the views, the canvas and the time line."""
    with say("div", id="views", role="tablist", aria_label="Views"):
        for view in VIEWS:
            is_first = "true" if view == "color" else "false"
            only = "sensor" if view in SENSOR_VIEWS else None
            say(
                "button", view, role="tab", data_view=view, data_only=only, aria_selected=is_first,
                aria_controls="stage",
            )  # fmt: skip
    with say("div", id="stage", role="tabpanel", aria_label="Picture"):
        say("canvas", id="canvas", width=1, height=1, role="img", aria_label="Rendered frame")
        say("canvas", id="pinned", width=1, height=1, hidden=True, aria_hidden="true")
        say("canvas", id="stacked", width=1, height=1, hidden=True, role="img", aria_label="Frame of the focal stack")
        say("canvas", id="over", aria_hidden="true")
        say("div", id="hint", hidden=True)
        say("div", "no picture yet", id="badge", data_rung="earlier")
        say("div", id="pin-badge", hidden=True)
        say("div", id="progress", role="status", hidden=True)
        say("div", id="message", role="alert", popover="manual", hidden=True)
        with say("div", id="scale-bar", hidden=True):
            say("div", id="scale-line")
            say("span", id="scale-about")
        with say("div", id="legend", hidden=True):
            with say("div", id="legend-row"):
                say("span", id="legend-least")
                say("canvas", id="legend-bar", width=160, height=10, aria_hidden="true")
                say("span", id="legend-most")
            say("div", id="legend-about")
    with say("div", id="tools"):
        say(
            "button", "Move", id="move", aria_pressed="false", data_tool="move",
            title="Then drag an object, with Shift along z (M)",
        )  # fmt: skip
        with say("select", id="pin", aria_label="Pin a frame to compare with"):
            for value, label in PINS.items():
                say("option", label, value=value)
        with say("select", id="compare", aria_label="Compare with the pinned frame", disabled=True):
            for value, label in COMPARISONS.items():
                say("option", label, value=value)
        say("input", id="wipe", type="range", min=0, max=100, value=50, aria_label="Wipe", hidden=True)
        say("div", class_="spread")
        say(
            "button", "Right eye", id="eye", aria_pressed="false", hidden=True,
            title="The other view of the stereo pair (E)",
        )  # fmt: skip
        _view_controls()
        say("button", "Focal stack", id="stack", aria_pressed="false", aria_controls="stack-row")
        say("span", id="size")
        say("span", id="zoom")
        say("button", "Fit", id="fit")
        say("button", "1:1", id="actual")
    _stack()
    with say("div", id="exposure-row", hidden=True):
        say("div", id="exposed", role="group", aria_label="Time samples")
        say("div", id="band", aria_hidden="true")
        say("span", id="exposure-about")
    with say("div", id="line"):
        say("button", "▶", id="play", aria_label="Play", aria_pressed="false")
        say("input", id="frame", type="range", min=0, max=0, value=0, step=1, aria_label="Frame")
        say("span", id="time")
        say("button", "Whole frame", id="whole", hidden=True, title="The frame with all of its time samples")
        say("button", "Keyframes", id="keyframes", aria_pressed="false", aria_controls="keyframes-part")
    _keyframes()


def _keyframes() -> None:
    """Keyframes as marks on time lines, which the page's script draws, and buttons to add and remove them."""
    with say("div", id="keyframes-part", hidden=True, role="group", aria_label="Keyframes"):
        with say("div", id="keyframes-row"):
            say("select", id="track", aria_label="What has the keyframe")
            say("label", "t", for_="key-time")
            say(
                "input", id="key-time", type="text", inputmode="decimal", data_kind="number", autocomplete="off",
                aria_label="Time, s", title="Time of the time line; Enter goes there",
            )  # fmt: skip
            say("span", "s", class_="unit")
            say("button", "Add", id="add-key", title="Add a keyframe with the pose, or the lens, at this time")
            say("button", "Remove", id="remove-key", disabled=True, title="Remove the chosen keyframe (Delete)")
            say("button", "Edit", id="edit-key", disabled=True, title="The boxes of the chosen keyframe (Enter)")
            say("span", id="keyframes-about", role="status")
        say("div", id="lanes")


def _view_controls() -> None:
    """Exposure and gamma of the view, which do not change the picture itself."""
    with say("details", id="shown"):
        with say("summary", title="Exposure and gamma of the view; the scene and its files stay as they are"):
            say("span", "View: ")
            say("span", "as it is", id="view-about")
        with say("div", id="shown-panel"):
            say("label", "Exposure of the view (EV)", for_="exposure")
            say("input", id="exposure", type="range", min=-4, max=4, step=0.25, value=0)
            say("label", "Gamma of the view", for_="gamma")
            say("input", id="gamma", type="range", min=0.4, max=2.6, step=0.1, value=1)
            with say("label"):
                say("input", id="arrows", type="checkbox")
                say("span", "Arrows of motion")
            say("button", "As it is", id="neutral")
            with say("label", title="Pixels that differ from those around them, as cameras mark them"):
                say("input", id="peaking", type="checkbox")
                say("span", "Focus peaking")
            say("button", "Save this picture", id="save-picture")
            say("button", "Copy this picture", id="copy-picture")


def _stack() -> None:
    """Focal stack: frames at focus distances at equal steps, for browsing without delay."""
    with say("div", id="stack-row", hidden=True, role="group", aria_label="Focal stack"):
        for name, label, value in (("nearest", "from", 200), ("farthest", "to", 400), ("steps", "mm, steps", 9)):
            say("label", label, for_=f"stack-{name}")
            say("input", id=f"stack-{name}", type="number", value=value, min=1, step="any")
        say("button", "Render", id="render-stack")
        label = "Step of the stack"
        say("input", id="step", type="range", min=0, max=0, value=0, step=1, aria_label=label, disabled=True)
        say("span", id="step-about")
        say("button", "Focus here", id="refocus", disabled=True)
        say("span", id="stack-about", role="status")


def _inspector() -> None:
    """Panel about the pixel under the cursor: its values, a histogram and its point spread function."""
    with say("section", aria_label="Inspector"):
        with say("div", class_="row"):
            say("h2", "Inspector")
            say("span", "point at the picture", id="pixel")
        say("table", id="values")
        with say("div", id="histogram-part", hidden=True):
            say("canvas", id="histogram", width=276, height=56, role="img", aria_label="Histogram of the codes")
            say("p", id="clipped", class_="quiet")
        with say("div", id="psf-part", hidden=True):
            say("h3", "Point spread function")
            with say("div", class_="row"):
                for name, label in (("psf", "Weights"), ("response", "Measured")):
                    with say("figure"):
                        say("canvas", id=name, width=130, height=130, role="img", aria_label=f"{label} spread")
                        say("figcaption", label)
            say("p", id="psf-side", class_="quiet")
            with say("table"):
                with say("thead"), say("tr"):
                    for label in ("", "Weights", "Measured"):
                        say("th" if label else "td", label)
                say("tbody", id="psf-values")
            say("p", id="psf-about", class_="quiet")
            say("p", id="unmeasured", role="status", class_="quiet")
            say("button", "Measure", id="measure", title="Render the scene with only this source lit", hidden=True)
        say("h3", "Lens")
        say("canvas", id="lens", width=276, height=100, role="img", aria_label="Thin lens, not to scale")
        say("p", id="lens-about", class_="quiet")
