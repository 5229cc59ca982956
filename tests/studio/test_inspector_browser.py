"""The inspector in Chromium: its numbers are those of the files, and its response that of `clsco.response`."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

import clsco
from clsco.cli.main import main
from clsco.studio.inspector import figures_of
from tests.studio.browser import opened, rest
from tests.studio.running import Running

pytestmark = pytest.mark.browser
SHIPPED, OPENS = ("occlusion_three.toml",), "occlusion_three.toml"
PLACES = ((0.17, 0.42), (0.52, 0.501), (0.8, 0.2))  # not between two pixels


@pytest.fixture
def page(running: Running) -> Iterator[Any]:
    with opened(running) as shown:
        shown.keyboard.press("i")
        shown.evaluate("""() => studio.hearing.push((said) => {
          for (const name of ["inspected", "measured"]) if (said[name]) window[`latest_${name}`] = said[name];
        })""")
        yield shown


def point_at(page: Any, place: tuple[float, float]) -> tuple[int, int]:
    """Move to a place of the picture, in parts of its sides; gives the pixel."""
    box = page.locator("#canvas").bounding_box()
    x, y = round(box["x"] + place[0] * box["width"]), round(box["y"] + place[1] * box["height"])
    page.mouse.move(x, y)
    column, row = page.evaluate("([x, y]) => studio.viewport.pixelAt(x, y)", [x, y])
    shown = f"window.latest_inspected?.values.x === {column} && latest_inspected.values.y === {row}"
    page.wait_for_function(shown, timeout=20000)
    return column, row


def test_values_are_those_of_the_files(page: Any, root: Path, tmp_path: Path) -> None:
    command = ["render", str(root / "occlusion_three.toml"), "-o", str(tmp_path), "--format", "npz", "--device", "pocl"]
    result = CliRunner().invoke(main, command)
    assert result.exit_code == 0, result.output
    (path,) = tmp_path.glob("**/*.npz")
    with np.load(path) as truth:
        for place in PLACES:
            column, row = point_at(page, place)
            values = page.evaluate("latest_inspected.values")
            names = {"depth": "depth", "blur_radius": "coc", "normal": "normal", "object_id": "object_id"}
            for name, key in names.items():
                np.testing.assert_array_equal(np.float32(values[name]), truth[key][row, column], name)


def test_the_response_under_the_pointer(page: Any, root: Path) -> None:
    scene = clsco.load_scene(root / "occlusion_three.toml")
    column, row = point_at(page, PLACES[0])
    page.wait_for_function("window.latest_measured || document.querySelector('#measure').offsetParent", timeout=20000)
    if page.locator("#measure").is_visible():  # it takes longer than it does unasked
        page.locator("#measure").click()
    page.wait_for_function("window.latest_measured", timeout=20000)
    measured = page.evaluate("latest_measured")
    expected = figures_of(clsco.response(scene, column, row, item=2, device="pocl"), column, row)
    assert measured == {"x": column, "y": row, "response": expected}
    assert expected["sum"] < 0.9  # behind the ball
    assert str(round(expected["sum"], 3)) in page.locator("#psf-values").inner_text().split()


def test_a_click_and_enter_focus_on_what_is_there(page: Any, running: Running) -> None:
    point_at(page, PLACES[1])
    depth = page.evaluate("latest_inspected.values.depth")
    page.keyboard.press("f")
    page.mouse.down()
    page.mouse.up()
    page.wait_for_function(f"Math.abs(studio.values['camera.focus_distance'] - {depth}) < 1e-3", timeout=20000)
    rest(page)
    assert page.evaluate("studio.values['camera.focus_distance']") == pytest.approx(depth, rel=1e-6)
    point_at(page, PLACES[1])
    page.wait_for_function("Math.abs(latest_inspected.values.blur_radius) < 1e-3", timeout=20000)
    x = page.evaluate("latest_inspected.values.x")
    page.keyboard.press("Shift+ArrowLeft")  # the point goes by keys, too
    page.wait_for_function(f"latest_inspected.values.x === {x} - 40", timeout=20000)
    depth = page.evaluate("latest_inspected.values.depth")
    page.keyboard.press("Enter")
    page.wait_for_function(f"Math.abs(studio.values['camera.focus_distance'] - {depth}) < 1e-3", timeout=20000)
