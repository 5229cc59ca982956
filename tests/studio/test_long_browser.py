"""Long work in Chromium: the reference beside the work, time samples that are counted, and Esc."""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.studio.browser import opened
from tests.studio.running import Running, studio

pytestmark = pytest.mark.browser
EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
BADGE, PROGRESS, REFERENCE = "#pin-badge", "#progress", "#reference"


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("root")
    for name in ("sphere", "sphere_moving"):
        shutil.copy(EXAMPLES / f"{name}.toml", folder)
    return folder


@pytest.fixture(scope="module")
def running(root: Path, request: pytest.FixtureRequest) -> Iterator[Running]:
    with studio(root, str(root / f"{request.param}.toml"), "--device", "pocl") as started:
        yield started


@pytest.fixture
def page(running: Running) -> Iterator[Any]:
    with opened(running) as shown:
        yield shown


def shown(page: Any, selector: str, text: str = "") -> None:
    """Wait until a part of the page is seen, with a text in it."""
    page.wait_for_function(
        "([selector, text]) => { const part = document.querySelector(selector);"
        " return !part.hidden && part.textContent.includes(text); }",
        arg=[selector, text], timeout=40000,
    )  # fmt: skip


def put(page: Any, path: str, value: float) -> None:
    page.evaluate("([path, value]) => studio.set(path, value)", [path, value])
    page.wait_for_function("([path, value]) => studio.values[path] === value", arg=[path, value], timeout=20000)


@pytest.mark.parametrize("running", ["sphere"], indirect=True)
def test_the_reference_runs_beside_the_work(page: Any) -> None:
    put(page, "camera.resolution.0", 128)
    put(page, "camera.resolution.1", 128)
    page.wait_for_function("studio.revision === 2 && studio.rung === 2", timeout=60000)
    revision = 2
    page.select_option("#pin", "reference")
    shown(page, REFERENCE, f"The reference renders revision {revision}")
    put(page, "camera.focus_distance", 280.0)
    page.wait_for_function(f"studio.revision === {revision + 1} && studio.rung === 2", timeout=60000)
    shown(page, BADGE, f"reference, revision {revision} (now {revision + 1})")
    page.select_option("#compare", "64")
    shown(page, BADGE, "difference × 64 to reference")
    assert "px" in page.locator(BADGE).inner_text()
    page.keyboard.press("Control+z")
    page.wait_for_function(f"studio.revision === {revision + 2} && studio.rung === 2", timeout=60000)
    shown(page, BADGE, f"(now {revision + 2})")
    assert re.search("(none|at most 1 of 255, .* px)$", page.locator(BADGE).inner_text())  # as both are rounded
    page.select_option("#pin", "reference")
    shown(page, REFERENCE)
    page.locator("#reference-cancel").click()
    assert page.locator(REFERENCE).is_hidden()


@pytest.mark.parametrize("running", ["sphere_moving"], indirect=True)
def test_time_samples_are_counted_and_esc_ends_them(page: Any) -> None:
    put(page, "sequence.samples", 200)
    shown(page, PROGRESS, "of 200 · Esc cancels")
    page.get_by_role("tab", name="depth").focus()  # the page is alive
    page.keyboard.press("Escape")
    shown(page, PROGRESS, "canceled")
    page.wait_for_timeout(1500)
    assert page.locator("#badge").inner_text().startswith("preview")
    put(page, "sequence.samples", 3)
    page.wait_for_function("studio.rung === 2", timeout=60000)
    assert page.locator(PROGRESS).is_hidden()
