"""Keyframes as marks on the time line, and the views of a sensor, in Chromium."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

import clsco
from clsco.optics.motion import keyframe_at
from tests.studio.browser import BALL, WALL, box, number, opened, pixels, rest, scene_of, type_in
from tests.studio.running import Running

pytestmark = pytest.mark.browser
SCENE = f"""
[camera]
resolution = [96, 72]
pixel_pitch = 0.06

[sequence]
frames = 2
interval = 0.5

{BALL}
texture = "#c08040"

{WALL}

[[object.motion.keyframe]]
time = 0.0
position = [-4.0, 0.0, 0.0]

[[object.motion.keyframe]]
time = 0.4
position = [0.0, 2.0, 0.0]

[[object.motion.keyframe]]
time = 1.0
position = [4.0, 0.0, 0.0]
"""
SENSOR = """
[sensor]
white_electrons = 800.0
bits = 10
seed = 5
"""
FILES, OPENS = {"scene.toml": SCENE + SENSOR}, "scene.toml"
KEY = "object.1.motion.keyframe.1.time"


@pytest.fixture
def page(running: Running) -> Iterator[Any]:
    with opened(running) as shown:
        shown.locator("#keyframes").click()
        yield shown


def mark(page: Any, path: str) -> Any:
    return page.locator(f'#lanes [data-path="{path}"]')


def count(page: Any, marks: int) -> None:
    page.wait_for_function(f"document.querySelectorAll('#lanes input').length === {marks}", timeout=20000)


def valued(page: Any, path: str, value: float) -> None:
    page.wait_for_function(f"Math.abs(studio.values['{path}'] - {value}) < 1e-6", timeout=20000)


def test_a_key_is_added_at_the_time_and_removed(page: Any) -> None:
    count(page, 3)
    page.locator("#track").select_option("object.0.motion.keyframe")
    page.locator("#key-time").fill("0.25")
    page.locator("#key-time").press("Enter")
    page.locator("#time", has_text="frame 1 of 2, at t = 0.25 s").wait_for()
    rest(page)
    page.locator("#add-key").click()
    count(page, 4)
    page.wait_for_function("document.activeElement.dataset.path === 'object.0.motion.keyframe.0.time'")
    assert page.locator("#keyframes-about").inner_text() == "keyframe 1, t = 0.25 s"
    assert scene_of(page).objects[0].motion.keyframe == (clsco.Keyframe(time=0.25),)
    page.locator("#add-key").click()
    page.locator("#message", has_text="keyframe: there must be none at this time; got one at 0.25 s").wait_for()
    page.locator("#undo").click()
    count(page, 3)
    page.locator("#redo").click()
    count(page, 4)
    mark(page, "object.0.motion.keyframe.0.time").press("Delete")
    count(page, 3)
    assert not scene_of(page).objects[0].motion.moves
    page.locator("#whole").click()
    page.locator("#time", has_text="frame 1 of 2, t = 0 s").wait_for()
    assert not page.locator("#whole").is_visible()


def test_a_key_between_others_is_on_their_path(page: Any) -> None:
    before = scene_of(page).objects[1].motion
    lane = page.locator('.lane[data-track="object.1.motion.keyframe"]').bounding_box()
    page.mouse.click(lane["x"] + 7 + 0.7 * (lane["width"] - 14), lane["y"] + 10)
    page.locator("#time", has_text="frame 2 of 2, at t = 0.7 s").wait_for()
    page.locator("#add-key").click()
    count(page, 4)
    keys = scene_of(page).objects[1].motion.keyframe
    expected = keyframe_at(before, 0.7, "euler")
    assert keys[2].time == pytest.approx(0.7, abs=0.002)
    assert keys[2].position == pytest.approx(expected.position, abs=0.05)
    page.locator("#remove-key").click()
    count(page, 3)


@pytest.mark.everyday
def test_a_mark_is_dragged_as_one_step_of_undo(page: Any) -> None:
    place = mark(page, KEY).bounding_box()
    wide, middle = place["width"] - 14, place["y"] + 10
    page.mouse.move(place["x"] + 7 + 0.4 * wide, middle)
    page.mouse.down()
    page.mouse.move(place["x"] + 7 + 0.8 * wide, middle, steps=12)
    page.mouse.up()
    page.wait_for_function(f"Math.abs(studio.values['{KEY}'] - 0.8) < 0.01", timeout=20000)
    assert scene_of(page).objects[1].motion.keyframe[1].time == pytest.approx(0.8, abs=0.01)
    page.locator("#undo").click()
    valued(page, KEY, 0.4)
    assert not page.locator("#undo").is_enabled()
    page.wait_for_function(f"Number(document.querySelector('#lanes [data-path=\"{KEY}\"]').value) === 0.4")
    mark(page, KEY).focus()
    rest(page)


def test_a_mark_is_stepped_by_keys_and_taken_back(page: Any) -> None:
    mark(page, KEY).press("ArrowRight")
    valued(page, KEY, 0.401)
    mark(page, KEY).press("Shift+ArrowRight")
    valued(page, KEY, 0.411)
    mark(page, KEY).press("Escape")
    valued(page, KEY, 0.4)
    mark(page, KEY).press("Enter")  # its boxes are another object's
    page.wait_for_function(f"document.activeElement.id === 'box-{KEY}'", timeout=20000)
    assert box(page, KEY).is_visible()
    assert number(page, KEY) == pytest.approx(0.4)


def test_a_time_that_cannot_be_is_refused_beside_its_mark(page: Any) -> None:
    mark(page, KEY).focus()
    page.evaluate(f"studio.set('{KEY}', 1.0)")
    page.locator("#keyframes-about[data-wrong]", has_text="must be later than that of the keyframe before").wait_for()
    assert mark(page, KEY).get_attribute("aria-invalid") == "true"
    assert scene_of(page).objects[1].motion.keyframe[1].time == 0.4
    page.evaluate(f"studio.set('{KEY}', 0.5)")
    valued(page, KEY, 0.5)
    page.locator("#keyframes-about:not([data-wrong])", has_text="keyframe 2, t = 0.5 s").wait_for()
    mark(page, KEY).press("Enter")
    box(page, KEY).wait_for(timeout=20000)
    type_in(page, KEY, "0.45")
    page.wait_for_function(f"Number(document.querySelector('#lanes [data-path=\"{KEY}\"]').value) === 0.45")


def test_the_focus_is_pulled_by_keys_of_the_lens(page: Any) -> None:
    page.locator("#track").select_option("lens.keyframe")
    for time in ("0", "1"):
        page.locator("#key-time").fill(time)
        page.locator("#add-key").click()
        page.wait_for_function(f"document.querySelectorAll('#lanes [data-path^=lens]').length === {1 + int(time)}")
    page.locator("#edit-key").click()
    path = "lens.keyframe.1.focus_distance"
    box(page, path).wait_for(timeout=20000)
    type_in(page, path, "320")
    assert [key.focus_distance for key in scene_of(page).lens.keyframe] == [pytest.approx(250.0, abs=0.1), 320.0]
    rest(page)


@pytest.mark.parametrize("view", ["raw", "noise"])
def test_views_of_a_sensor(page: Any, view: str) -> None:
    """Gray by code, or a color map by electrons: lightness grows with what the frame has."""
    page.get_by_role("tab", name=view.capitalize(), exact=True).click()
    page.wait_for_function(f"studio.view === '{view}' && studio.rung === 2", timeout=60000)
    shown = pixels(page) @ [0.299, 0.587, 0.114]
    frame = clsco.render_frame(scene_of(page), truth=("raw", "noise_sigma"))
    plane = frame.arrays()["raw" if view == "raw" else "noise_sigma"].astype(float)
    plane = plane.mean(axis=2) if plane.ndim == 3 else plane
    assert plane.shape == shown.shape
    tenths = [shown.ravel()[part].mean() for part in np.array_split(np.argsort(plane, axis=None), 10)]
    assert np.all(np.diff(tenths) > -2.0)
    assert tenths[-1] - tenths[0] > 60.0
    assert not page.locator("#message").is_visible()
