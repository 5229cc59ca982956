"""The picture in Chromium: objects dragged in it, its time samples, playing, focal stack, and how it is shown."""

from __future__ import annotations

import io
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

import clsco
from clsco.files.transfer import encode
from tests.studio.browser import BALL, WALL, open_scene, pixels, rest

pytestmark = pytest.mark.browser
SCENE = f"""
[camera]
resolution = [128, 128]
pixel_pitch = 0.04

[sequence]
frames = 3
interval = 0.5
shutter = 0.4

{BALL}
texture = "bricks"

[object.motion]
velocity = [8.0, 0.0, 0.0]

{WALL}
bounds = [[-20.0, 20.0], [-50.0, 50.0], [0.0, 1000.0]]

[[object]]
name = "sky"
shape = "background"
texture = "#204060"
"""
STILL = SCENE.replace("velocity = [8.0", "velocity = [0.0")


FILES, OPENS = {"still.toml": STILL, "moving.toml": SCENE}, "still.toml"


@pytest.fixture
def moving(page: Any) -> Any:
    open_scene(page, "moving.toml")
    return page


def codes(scene: clsco.Scene, index: int = 0) -> NDArray[np.int64]:
    return encode(clsco.render_frame(scene, index, truth=(), device="pocl").color, 8, "srgb").astype(int)


def at(page: Any, column: float, row: float) -> tuple[float, float]:
    """Place of a pixel of the frame on the page."""
    box = page.locator("#canvas").bounding_box()
    return box["x"] + (column + 0.5) * box["width"] / 128, box["y"] + (row + 0.5) * box["height"] / 128


def becomes(page: Any, wanted: NDArray[np.int64], most: int = 0) -> None:
    """Wait until this is shown, with codes that are off by `most` or less."""
    for _ in range(100):
        off = np.abs(pixels(page) - wanted).max()
        if off <= most:
            return
        page.wait_for_timeout(100)
    raise AssertionError(f"off by {off}")


def drag(page: Any, start: tuple[float, float], end: tuple[float, float], escape: bool = False) -> None:
    """Drag from pixel to pixel with the tool that is taken, and wait for the exact frame."""
    before = page.evaluate("studio.revision")
    page.mouse.move(*at(page, *start))
    page.mouse.down()
    page.mouse.move(*at(page, *end), steps=8)
    page.wait_for_function(f"studio.revision > {before}")
    if escape:
        page.keyboard.press("Escape")
    page.mouse.up()
    page.wait_for_timeout(300)
    rest(page)


def values(page: Any, name: str, count: int = 3) -> list[float]:
    return [page.evaluate(f"studio.values['{name}.{k}']") for k in range(count)]


@pytest.mark.everyday
def test_an_object_is_dragged_with_the_pointer(page: Any) -> None:
    before = pixels(page)
    page.keyboard.press("m")
    assert page.locator("#move").get_attribute("aria-pressed") == "true"
    drag(page, (64, 64), (84, 54))
    step = 0.04 * 250.0 / 20.0  # mm per pixel at the center of the ball, whose front is nearer
    front = (250.0 - 12.0) / 250.0
    x, y, z = values(page, "object.0.center")
    assert (x, y) == pytest.approx((20 * step * front, 10 * step * front), rel=0.03)
    assert z == 250.0
    becomes(page, codes(clsco.parse_scene(STILL).replace("object.0.center", [x, y, z])))
    page.keyboard.press("Control+z")  # the drag was one step
    becomes(page, before)
    assert values(page, "object.0.center") == [0.0, 0.0, 250.0]
    assert page.locator("#undo").is_disabled()


def test_a_drag_is_taken_back_and_goes_along_z_with_shift(page: Any) -> None:
    page.locator("#move").click()
    drag(page, (64, 64), (84, 54), escape=True)
    assert values(page, "object.0.center") == [0.0, 0.0, 250.0]
    assert page.locator("#undo").is_disabled()
    page.keyboard.down("Shift")
    drag(page, (64, 64), (84, 44))
    page.keyboard.up("Shift")
    x, y, z = values(page, "object.0.center")
    assert (x, y) == (0.0, 0.0)
    assert z > 255.0


@pytest.mark.everyday
def test_planes_are_dragged_and_the_background_is_not(page: Any) -> None:
    page.keyboard.press("m")
    page.keyboard.down("Shift")
    drag(page, (64, 100), (64, 60))
    page.keyboard.up("Shift")
    page.locator("button", has_text="2 wall").click()
    page.wait_for_function("studio.values['object.1.distance'] > 305")
    page.mouse.move(*at(page, 3, 64))
    page.mouse.down()
    page.wait_for_function("document.querySelector('#message').textContent.includes('move: there must be an object')")
    page.mouse.up()


def test_the_name_of_what_would_be_moved_is_shown(page: Any) -> None:
    page.keyboard.press("m")
    for pixel, name in (((64, 64), "ball"), ((64, 110), "wall")):
        page.mouse.move(*at(page, *pixel), steps=3)
        page.wait_for_function(f"document.querySelector('#hint').textContent === '{name}'")
    page.keyboard.press("Escape")
    assert page.locator("#move").get_attribute("aria-pressed") == "false"


def test_a_time_sample_is_seen_alone(moving: Any) -> None:
    scene = clsco.parse_scene(SCENE)
    frame = clsco.render_frame(scene, 0, truth=("subframes",), device="pocl")
    assert frame.subframes is not None
    ticks = moving.locator("#exposed button")
    assert ticks.count() == len(frame.subframes)
    whole = pixels(moving)
    assert np.array_equal(whole, codes(scene))
    ticks.last.click()
    alone = encode(frame.subframes[-1], 8, "srgb").astype(int)
    becomes(moving, alone, most=1)
    assert np.abs(whole - alone).max() > 20
    assert ticks.last.get_attribute("aria-pressed") == "true"
    ticks.last.click()
    becomes(moving, whole)


def test_frames_are_played_from_what_came(moving: Any) -> None:
    scene = clsco.parse_scene(SCENE)
    moving.locator("#play").click()
    moving.wait_for_function("document.querySelector('#badge').textContent === 'Played'", timeout=20000)
    assert moving.locator("#play").get_attribute("aria-pressed") == "true"
    seen = set()
    for _ in range(40):
        seen.add(moving.locator("#frame").input_value())
        moving.wait_for_timeout(60)
    assert seen == {"0", "1", "2"}
    moving.locator("#play").click()
    becomes(moving, codes(scene, int(moving.locator("#frame").input_value())))
    rest(moving)  # and is said to be exact


def test_time_samples_are_counted_and_esc_ends_them(moving: Any) -> None:
    progress = "document.querySelector('#progress')"
    moving.evaluate("studio.set('sequence.samples', 2000)")
    shown = f"!{progress}.hidden && {progress}.textContent.includes('of 2000 · Esc cancels')"
    moving.wait_for_function(shown, timeout=40000)
    moving.get_by_role("tab", name="Depth").focus()  # the page is alive
    moving.keyboard.press("Escape")
    moving.wait_for_function(f"{progress}.textContent.includes('Canceled')")
    moving.wait_for_timeout(1500)
    assert moving.locator("#badge").inner_text().startswith("Preview")
    moving.evaluate("studio.set('sequence.samples', 3)")
    rest(moving)
    assert moving.locator("#progress").is_hidden()


def test_motion_is_shown_as_arrows(moving: Any) -> None:
    drawn = """() => { const over = document.querySelector('#over');
      const { data } = over.getContext('2d').getImageData(0, 0, over.width, over.height);
      let count = 0;
      for (let k = 0; k < data.length; k += 4) count += data[k] > 200 && data[k + 2] < 120 && data[k + 3] > 200;
      return count; }"""
    before = moving.evaluate(drawn)  # the ring about the point
    moving.locator("#shown summary").click()
    moving.locator("#arrows").check()
    moving.wait_for_function(f"({drawn})() > {before} + 30", timeout=5000)  # by the next animation frame


def test_a_focal_stack_is_looked_through(page: Any) -> None:
    page.locator("#stack").click()
    for name, value in (("nearest", "240"), ("farthest", "300"), ("steps", "4")):
        page.locator(f"#stack-{name}").fill(value)
    page.locator("#render-stack").click()
    page.wait_for_function("document.querySelector('#stack-about').textContent === '4 frames'", timeout=30000)
    for step, distance in ((3, 300.0), (1, 260.0)):
        page.locator("#step").fill(str(step))
        scene = clsco.parse_scene(STILL).replace("camera.focus_distance", distance)
        assert np.array_equal(pixels(page, "#stacked"), codes(scene))
        assert f"{distance:g} mm" in page.locator("#step-about").inner_text()
    page.locator("#refocus").click()
    page.wait_for_function("studio.values['camera.focus_distance'] === 260")
    becomes(page, codes(clsco.parse_scene(STILL).replace("camera.focus_distance", 260.0)))
    assert page.locator("#stacked").is_hidden()


def seen(page: Any) -> NDArray[np.uint8]:
    """The picture and all that is over it."""
    return np.asarray(Image.open(io.BytesIO(page.locator("#stage").screenshot())).convert("RGB"))


def test_exposure_and_gamma_are_of_the_view(page: Any) -> None:
    before, values = pixels(page), page.evaluate("studio.values")
    look = seen(page)
    page.locator("#shown summary").click()
    page.locator("#exposure").fill("2")
    page.locator("#gamma").fill("1.6")
    assert page.locator("#view-about").inner_text() == "+2 EV, gamma 1.6"
    page.locator("#shown summary").click()
    assert "view-filter" in page.evaluate("getComputedStyle(document.querySelector('#canvas')).filter")
    assert seen(page).astype(int).mean() > 1.3 * look.mean()
    assert np.array_equal(pixels(page), before)
    assert page.evaluate("studio.values") == values
    assert page.locator("#undo").is_disabled()
    page.locator("#shown summary").click()
    page.locator("#neutral").click()
    page.locator("#shown summary").click()
    assert page.evaluate("getComputedStyle(document.querySelector('#canvas')).filter") == "none"
    assert np.count_nonzero((seen(page) != look).any(axis=-1)) < 10  # corners of the badge are drawn in another layer


def test_the_right_eye_of_a_pair_is_seen(page: Any) -> None:
    assert page.locator("#eye").is_hidden()
    page.evaluate("studio.set('stereo.baseline', 4)")
    page.wait_for_function("!document.querySelector('#eye').hidden")
    frames = clsco.render(clsco.parse_scene(STILL).replace("stereo", {"baseline": 4.0}), frames=[0], device="pocl")
    left, right = (encode(frame.color, 8, "srgb").astype(int) for frame in frames)
    becomes(page, left)
    page.keyboard.press("e")
    assert page.locator("#eye").get_attribute("aria-pressed") == "true"
    becomes(page, right)
    page.keyboard.press("m")
    drag(page, (46, 64), (56, 64))
    assert values(page, "object.0.center")[0] == pytest.approx(10 * 0.04 * 238.0 / 20.0, rel=0.03)
    page.evaluate("studio.set('stereo.baseline', null)")
    page.wait_for_function("document.querySelector('#eye').hidden")
    rest(page)
    assert page.locator("#eye").get_attribute("aria-pressed") == "false"
