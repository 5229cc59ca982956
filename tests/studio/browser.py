"""Chromium with the studio in it, and what is done with its page."""

from __future__ import annotations

import shutil
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from clsco.scene.sweep import parse_sweep
from clsco.studio.store import from_link
from tests.studio.running import Running

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
DRAG = """async ([path, first, last, steps, rate]) => {
  const slider = document.querySelector(`input[type=range][data-path="${path}"]`), times = [];
  const before = studio.revision, start = performance.now(), sleep = (ms) => new Promise((end) => setTimeout(end, ms));
  studio.painted.length = 0;
  for (let step = 1; step <= steps; step += 1) {
    const wait = start + (1000 * step) / rate - performance.now();
    if (wait > 0) await sleep(wait);
    slider.value = studio.placeOf(slider, first + ((last - first) * step) / steps);
    times.push(performance.now());
    slider.dispatchEvent(new Event("input", { bubbles: true }));
  }
  const released = performance.now();
  slider.dispatchEvent(new Event("change", { bubbles: true }));
  while (performance.now() - released < 5000 && !(studio.rung === 2 && studio.revision >= before + 1
    && studio.painted.at(-1)?.[2] > released && studio.painted.at(-1)[1] === 2)) await sleep(5);
  return { before, times, released, painted: studio.painted.slice(), revision: studio.revision };
}"""

PIXELS = """(selector) => {
  const canvas = document.querySelector(selector), { width, height } = canvas;
  return [width, height, [...canvas.getContext("2d").getImageData(0, 0, width, height).data]];
}"""


def pixels(page: Any, canvas: str = "#canvas") -> NDArray[np.int64]:
    """Red, green, blue of a canvas, which is opaque."""
    columns, rows, data = page.evaluate(PIXELS, canvas)
    codes = np.array(data).reshape(rows, columns, 4)
    assert (codes[..., 3] == 255).all()
    return codes[..., :3]


@contextmanager
def opened(running: Running, width: int = 1280, height: int = 720, **options: Any) -> Iterator[Any]:
    """A page of the studio, which shows an exact frame; it fails where the page reports an error."""
    errors: list[str] = []
    with chromium(**{"viewport": {"width": width, "height": height}, "color_scheme": "dark"} | options) as context:
        page = context.new_page()
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.on("console", lambda said: errors.append(said.text) if said.type == "error" else None)
        page.goto(running.address)
        rest(page)
        yield page
    assert not errors, errors


@contextmanager
def chromium(**options: Any) -> Iterator[Any]:
    """A browser of its own, as it were: a context of the Chromium of this module, where it is installed."""
    with closing(_started()[1].new_context(**options)) as context:
        yield context


@cache
def _started() -> tuple[Any, Any]:
    playwright = pytest.importorskip("playwright.sync_api", reason="needs playwright: pip install playwright")
    path = shutil.which("chromium")
    if path is None:
        pytest.skip("needs chromium: apt-get install chromium")
    playwright.Page.wait_for_function = _wait_for
    started = playwright.sync_playwright().start()
    return started, started.chromium.launch(executable_path=path, args=["--no-sandbox"])


def end_chromium() -> None:
    """End it, and the event loop of Playwright, beside which there can be no other."""
    if _started.cache_info().currsize:
        started, browser = _started()
        browser.close()
        started.stop()
        _started.cache_clear()


def _wait_for(page: Any, expression: str, *, arg: Any = None, timeout: float = 30000.0) -> None:
    """Wait until an expression is true: as Playwright's own, which needs a policy that lets strings be evaluated."""
    error = pytest.importorskip("playwright.sync_api").Error
    end = time.monotonic() + timeout / 1000.0
    while time.monotonic() < end:
        with suppress(error):  # while a page is loaded
            if page.evaluate(expression, arg):
                return
        page.wait_for_timeout(20)
    raise TimeoutError(expression)


def rest(page: Any) -> None:
    """Wait for an exact frame."""
    try:
        page.wait_for_function("window.studio && studio.rung === 2", timeout=60000)
    except Exception as error:
        state = page.evaluate("[studio.revision, studio.rung, studio.painted.slice(-4)]")
        raise AssertionError(state, page.locator("#message").inner_text()) from error


SHAPES = {
    "Planar": "plane", "Cylindrical": "cylinder", "Spherical": "sphere", "Conical": "cone", "Elliptical": "ellipsoid",
}  # fmt: skip
SMALL = '[camera]\nresolution = [64, 48]\npixel_pitch = 0.1\n[[object]]\nshape = "plane"\ntexture = "checkerboard"\n'
BALL = '[[object]]\nname = "ball"\nshape = "sphere"\ncenter = [0.0, 0.0, 250.0]\nradius = 12.0'
WALL = '[[object]]\nname = "wall"\nshape = "plane"\ndistance = 300.0\ntexture = "checkerboard"'


def box(page: Any, path: str) -> Any:
    """The box of a key, whose panel is unfolded."""
    found = page.locator(f':is(#panels, #lens-strip) [data-path="{path}"]:not([type=range])')
    found.first.evaluate("each => { const panel = each.closest('details'); if (panel) panel.open = true; }")
    return found


def unfold(page: Any, title: str) -> None:
    """Unfold a panel, which is added if the scene does not use it."""
    found = page.locator(f".panel:not([open]) > summary:has-text('{title}'), .chip:has-text('{title}')")
    if found.count():
        found.first.click()


def from_menu(page: Any, name: str) -> None:
    """Choose an entry of the menu of the scene."""
    page.locator("#scene").click()
    page.locator("#menu").get_by_role("button", name=name, exact=True).click()


def number(page: Any, path: str) -> float:
    """The number of the box of a key, with all digits."""
    return float(box(page, path).evaluate("(box) => box.dataset.full ?? box.value"))


def type_in(page: Any, path: str, value: str) -> None:
    """Type a value, leave the box, and wait for the answer."""
    before = page.evaluate("[studio.revision, JSON.stringify(studio.faults)]")
    box(page, path).fill(value)
    box(page, path).blur()
    answer = "(before) => studio.revision > before[0] || JSON.stringify(studio.faults) !== before[1]"
    page.wait_for_function(answer, arg=before, timeout=20000)


def choose(page: Any, shape: str) -> None:
    """Choose an object type, and wait for its panel."""
    unfold(page, "Select Object Type")
    page.get_by_role("radio", name=shape, exact=True).check()
    page.wait_for_function(f"studio.values['object.0.shape'] === '{SHAPES[shape]}'", timeout=20000)
    path = {"Planar": "distance", "Conical": "apex.2"}.get(shape, "center.2")
    box(page, f"object.0.{path}").wait_for(timeout=20000)


def open_scene(page: Any, name: str) -> None:
    """Open a scene of the folder."""
    before = page.evaluate("studio.revision")
    from_menu(page, "Open")
    page.get_by_role("button", name=name, exact=True).click()
    page.locator("dialog[open]").wait_for(state="hidden")
    page.wait_for_function(f"studio.revision > {before}")
    rest(page)


def scene_of(page: Any) -> Any:
    """The scene of a page, as it is told to the browser in case that the studio ends."""
    link = page.evaluate("""() => new Promise((done) => { studio.flush(); studio.send({ do: "keep" });
      studio.hearing.push((said) => { if (said.kept) done(said.kept.scene); }); })""")
    return parse_sweep(from_link(link, (Path(),))[0]).scenes[0]


def axe_faults(page: Any) -> list[tuple[str, str]]:
    """Faults that axe finds in a page: the rule, and the first element that breaks it."""
    axe = pytest.importorskip("axe_playwright_python", reason="needs axe: pip install axe-playwright-python")
    (script,) = Path(axe.__file__).parent.rglob("axe.min.js")
    page.evaluate(script.read_text())
    found = page.evaluate("axe.run()")
    assert len(found["passes"]) > 10
    return [(fault["id"], fault["nodes"][0]["html"]) for fault in found["violations"]]


_PANELS = "if (innerWidth <= 900) studio.dock('open', true);"
_UNFOLDED = "for (const each of document.querySelectorAll('.panel')) each.open = !(each.name = '');"
_LOADING = "hear({ progress: { doing: 'compiling', done: 2, total: 7, still: 12 } })"
STATES: dict[str, tuple[str, ...]] = {  # of the page: what is clicked, or scripts, and in the end what is seen then
    "rest": ("#canvas",), "depth": ("[data-view=depth]", "[data-view=depth][aria-selected=true]"),
    "views": ("#more", "#views[data-all]"), "inspector": ("[data-part-of=sided]", "#side"),
    "panels": (_PANELS, _UNFOLDED, ".panel[open]"),
    "new panel": (_PANELS, "#panels-scroll .chip:last-child", ".panel[open]"),
    "objects": (_PANELS, "[popovertarget=object-menu]", "#object-menu"), "menu": ("#scene", "#menu"),
    **{f"entry {k} of the menu": (f"#menu button:nth-child({k})", "dialog[open]") for k in (1, 2, 4, 5)},
    "keys": ("#help", "#keys"), "find": ("#find", "#palette"), "compare": ("#comparing", "#studio"),
    "keyframes": ("studio.set('object.0.motion.velocity.0', 5);", "#keyframes", "#keyframes-part"),
    "stack": ("#stack", "#stack-row"), "view": ("#shown summary", "#shown-panel"),
    "Generate": ("#generate", "#making summary", "#making details + details summary", "#making"),
    "inpainting": ("[data-mode=inpaint]", "#painting"), "image": ("[data-mode=inpaint]", _PANELS, "#paint"),
    "wrong": ("studio.set('camera.f_number', -1);", "#wrong"), "message": ("studio.fail(['a: b']);", "#message"),
    "loading": ("studio.done = () => {};", f"for (const hear of studio.hearing) {_LOADING};", "#progress"),
    "lost": ("studio.closed();", "#lost"),
}  # fmt: skip


def states(running: Running, page: Any) -> Iterator[str]:
    """Lead a page to each of STATES, and give their names."""
    for name, (*steps, seen) in STATES.items():
        page.goto(f"{running.page}/")  # a new tab
        page.wait_for_function("window.studio && 'camera.f_number' in studio.values")
        for step in steps:
            page.evaluate(step if step.endswith(";") else f"document.querySelector({step!r}).click()")
        page.locator(seen).first.wait_for()
        page.wait_for_timeout(300)
        yield name
