"""Instruments over and beside the picture in Chromium."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import clsco
from clsco.files.images import read_image
from tests.studio.browser import number, pixels, rest
from tests.studio.test_canvas_browser import STILL, at, codes, seen

pytestmark = pytest.mark.browser
FILES, OPENS = {"scene.toml": STILL}, "scene.toml"
COLORED = """([red, green, blue]) => { const over = document.querySelector('#over');
  const { data } = over.getContext('2d').getImageData(0, 0, over.width, over.height), found = [];
  for (let k = 0; k < data.length; k += 4) {
    if (data[k] === red && data[k + 1] === green && data[k + 2] === blue && data[k + 3] > 200) found.push(k / 4);
  }
  return found.map((at) => [at % over.width, Math.floor(at / over.width)]); }"""
YELLOW, RED, LIGHT_BLUE = [255, 210, 77], [255, 50, 50], [159, 212, 255]


def until_drawn(page: Any, color: list[int], least: int) -> list[list[int]]:
    for _ in range(100):
        found: list[list[int]] = page.evaluate(COLORED, color)
        if len(found) >= least:
            return found
        page.wait_for_timeout(100)
    raise AssertionError(f"{len(found)} pixels of {color}")


@pytest.mark.everyday
def test_a_click_chooses_an_object_and_outlines_it(page: Any) -> None:
    page.mouse.click(*at(page, 64, 110))
    page.locator('.objects button[aria-pressed="true"]', has_text="2 wall").wait_for()
    page.mouse.click(*at(page, 64, 64))
    page.locator('.objects button[aria-pressed="true"]', has_text="1 ball").wait_for()
    for _ in range(50):
        found = until_drawn(page, YELLOW, 100)
        stage, canvas = page.locator("#stage").bounding_box(), page.locator("#canvas").bounding_box()
        scale = canvas["width"] / 128
        across = [(x + stage["x"] - canvas["x"]) / scale - 64 for x, _ in found]
        down = [(y + stage["y"] - canvas["y"]) / scale - 64 for _, y in found]
        far = [math.hypot(x, y) for x, y in zip(across, down, strict=True)]
        if max(far) < 27:
            break
        page.wait_for_timeout(100)  # that of the wall is still there
    rim = 12.0 / math.sqrt(250.0**2 - 12.0**2) * 20.0 / 0.04
    assert min(far) > rim - 3
    assert max(far) < rim + 3
    page.keyboard.press("Escape")
    page.wait_for_function(f"({COLORED})({YELLOW}).length === 0")


def test_handles_move_the_object_that_is_outlined(page: Any) -> None:
    page.mouse.click(*at(page, 64, 64))
    page.locator('.objects button[aria-pressed="true"]', has_text="1 ball").wait_for()
    until_drawn(page, LIGHT_BLUE, 20)
    before = [number(page, f"object.0.center.{axis}") for axis in range(3)]
    scale = page.locator("#canvas").bounding_box()["width"] / 128
    x, y = at(page, 64, 64)
    drag(page, (x, y), (x + 16 * scale, y))
    page.wait_for_function("studio.values['object.0.center.0'] > 0.1")
    rest(page)
    step = 0.04 / 20.0 * (before[2] - 12.0)  # mm per pixel, of the point that is held
    after = [number(page, f"object.0.center.{axis}") for axis in range(3)]
    assert after == pytest.approx([before[0] + 16 * step, *before[1:]], rel=0.05, abs=1e-3)
    until_drawn(page, LIGHT_BLUE, 20)
    drag(page, (x + 16 * scale, y - 36), (x + 16 * scale, y - 86))  # the handle along z
    page.wait_for_function(f"studio.values['object.0.center.2'] > {before[2]} + 5")
    assert number(page, "object.0.center.0") == after[0]
    page.keyboard.press("Escape")
    page.wait_for_function("studio.chosen() === -1")


def drag(page: Any, begin: tuple[float, float], end: tuple[float, float]) -> None:
    page.mouse.move(*begin)
    page.mouse.down()
    page.wait_for_timeout(300)
    page.mouse.move(*end, steps=5)
    page.wait_for_timeout(300)
    page.mouse.up()


def test_the_histogram_counts_what_is_clipped(page: Any) -> None:
    brightest = codes(clsco.parse_scene(STILL)).max(-1)
    dark, bright = (100 * float(np.mean(brightest == code)) for code in (0, 255))
    page.wait_for_function("document.querySelector('#clipped').textContent !== ''")
    words = page.locator("#clipped").inner_text().replace(",", "").split()
    assert [float(word) for word in words if word[0].isdigit()] == pytest.approx([dark, bright], rel=0.01, abs=1e-9)
    page.keyboard.press("3")  # depth has none
    page.wait_for_function("document.querySelector('#histogram-part').hidden")


def test_focus_peaking_marks_edges_that_are_sharp(page: Any) -> None:
    assert page.evaluate(COLORED, RED) == []
    page.locator("#shown summary").click()
    page.locator("#peaking").check()
    until_drawn(page, RED, 20)
    page.locator("#peaking").uncheck()
    page.wait_for_function(f"({COLORED})({RED}).length === 0")


def test_this_picture_is_saved_as_it_is(page: Any, tmp_path: Path) -> None:
    rest(page)
    page.locator("#shown summary").click()
    with page.expect_download() as waits:
        page.locator("#save-picture").click()
    assert waits.value.suggested_filename == "untitled-color-Exact.png"
    waits.value.save_as(tmp_path / "picture.png")
    assert np.array_equal(read_image(tmp_path / "picture.png").data[..., :3], pixels(page))


def test_the_wipe_has_a_line_and_says_what_is_on_both_sides(page: Any) -> None:
    page.keyboard.press("p")
    page.locator("#then", has_text="pinned").wait_for()
    before = pixels(page)
    page.evaluate("studio.set('camera.f_number', 8)")
    page.locator("#now", has_text="now: f/8").wait_for(timeout=20000)
    assert page.locator("#then").inner_text().startswith("pinned: f/")
    rest(page)
    page.locator("#wipe").fill("25")
    stage, canvas = page.locator("#stage").bounding_box(), page.locator("#canvas").bounding_box()
    middle = canvas["x"] + canvas["width"] / 4 - stage["x"]
    line = np.flatnonzero((seen(page)[-60:-10] == (255, 180, 84)).all(axis=(0, 2)))
    assert line.mean() + 0.5 == pytest.approx(middle, abs=1.5)
    page.keyboard.press("d")
    page.locator("#then", has_text=f"difference × 8: at most {np.abs(pixels(page) - before).max()} of 255").wait_for()
    page.keyboard.press("p")
    page.locator("#pinned").wait_for(state="hidden")


def test_compared_versions_differ_by_what_they_mean_and_by_the_eye(page: Any) -> None:
    page.evaluate("(studio.set('stereo.baseline', 4), studio.flush())")
    page.locator("#eye").wait_for()
    rest(page)
    page.keyboard.press("p")
    page.evaluate("studio.set('object.0.motion.velocity', [0, 0, 0])")  # as without any
    page.wait_for_function("studio.values['object.0.motion.velocity.0'] === 0")
    assert (page.locator("#then").inner_text(), page.locator("#now").inner_text()) == ("pinned", "now")
    page.keyboard.press("e")
    page.locator("#now", has_text="now: right eye").wait_for()
    assert page.locator("#then").inner_text() == "pinned: left eye"
    page.keyboard.press("e")
    page.evaluate("studio.set('object.0.texture', 'siemens_star')")
    page.locator("#now", has_text="now: Input image siemens_star").wait_for()


def test_esc_leaves_a_box_so_that_letters_are_shortcuts(page: Any) -> None:
    page.locator("#dial-camera\\.f_number").click()
    page.keyboard.press("3")
    assert page.evaluate("studio.view") == "color"
    page.keyboard.press("Escape")
    assert page.evaluate("document.activeElement === document.body")
    page.keyboard.press("3")
    page.wait_for_function("studio.view === 'depth'")
    for key in ("?", "2", "p", "Escape", "1"):  # no shortcuts in a dialog
        page.keyboard.press(key)
    rest(page)
    assert (page.evaluate("studio.view"), page.locator("#compared").is_visible()) == ("color", False)


def test_views_of_a_sensor_say_that_there_is_none(page: Any) -> None:
    for view in ("raw", "noise"):
        tab = page.locator(f'[data-view="{view}"]')
        assert tab.is_disabled()
        assert tab.get_attribute("title") == "the scene has no sensor: see its panel"
    for view in ("depth", "missing", "mask"):
        assert page.locator(f'[data-view="{view}"]').is_enabled()


def test_the_histogram_is_that_of_the_step_of_a_stack(page: Any) -> None:
    before = page.locator("#clipped").inner_text()
    plotted = "document.querySelector('#histogram').toDataURL()"
    whole = page.evaluate(plotted)
    page.locator("#stack").click()
    page.locator("#stack-nearest").fill("60")
    page.locator("#stack-farthest").fill("400")
    page.locator("#stack-steps").fill("2")
    page.locator("#render-stack").click()
    page.locator("#stack-about", has_text="2 frames").wait_for(timeout=60000)
    assert page.evaluate(plotted) != whole
    page.locator("#stack").click()
    page.wait_for_function(f"{plotted} === {whole!r}")
    assert page.locator("#clipped").inner_text() == before
