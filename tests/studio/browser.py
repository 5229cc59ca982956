"""Chromium with the studio in it."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from tests.studio.running import Running

DRAG = """async ([path, first, last, steps, rate]) => {
  const slider = document.querySelector(`input[type=range][data-path="${path}"]`);
  const times = [], before = studio.revision, start = performance.now();
  studio.painted.length = 0;
  for (let step = 1; step <= steps; step += 1) {
    const wait = start + (1000 * step) / rate - performance.now();
    if (wait > 0) await new Promise((done) => setTimeout(done, wait));
    slider.value = first + ((last - first) * step) / steps;
    times.push(performance.now());
    slider.dispatchEvent(new Event("input", { bubbles: true }));
  }
  const released = performance.now();
  slider.dispatchEvent(new Event("change", { bubbles: true }));
  while (performance.now() - released < 5000 && !(studio.rung === 2 && studio.revision >= before + 1
    && studio.painted.at(-1)?.[2] > released && studio.painted.at(-1)[1] === 2)) {
    await new Promise((done) => setTimeout(done, 5));
  }
  return { before, times, released, painted: studio.painted.slice(), revision: studio.revision };
}"""

PIXELS = """() => {
  const canvas = document.querySelector("#canvas");
  const { width, height } = canvas;
  return [width, height, [...canvas.getContext("2d").getImageData(0, 0, width, height).data]];
}"""


@contextmanager
def opened(running: Running, width: int = 1280, height: int = 720) -> Iterator[Any]:
    """A page of the studio, which shows an exact frame; it fails where the page reports an error."""
    errors: list[str] = []
    with chromium() as browser:
        page = browser.new_context(viewport={"width": width, "height": height}).new_page()
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.on("console", lambda said: errors.append(said.text) if said.type == "error" else None)
        page.goto(running.address)
        rest(page)
        yield page
    assert errors == []


@contextmanager
def chromium() -> Iterator[Any]:
    """Chromium, where it is installed."""
    playwright = pytest.importorskip("playwright.sync_api", reason="needs playwright: pip install playwright")
    path = shutil.which("chromium")
    if path is None:
        pytest.skip("needs chromium: apt-get install chromium")
    with playwright.sync_playwright() as started:
        browser = started.chromium.launch(executable_path=path, args=["--no-sandbox"])
        yield browser
        browser.close()


def rest(page: Any) -> None:
    """Wait for an exact frame."""
    page.wait_for_function("window.studio && studio.rung === 2", timeout=60000)
