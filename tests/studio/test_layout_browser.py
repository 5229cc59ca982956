"""Numbers of the page in Chromium: sizes of its parts, ways by keys, the ruler's scale, and what faults cover."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import clsco
from clsco.studio.inspector import focus_point
from clsco.studio.presets import FIRST
from clsco.studio.server import STATIC
from tests.studio.browser import box, chromium, opened, rest, states
from tests.studio.running import Running

pytestmark = pytest.mark.browser
SHIPPED = ("evening.toml", "evening.npy", "glazed.jpg", "yellow.jpg", "teal.jpg", "rose.jpg", "table.jpg")
OPENS, FOCUS = f"{FIRST}.toml", "camera.focus_distance"
HIDDEN = """() => [...document.querySelectorAll('[role=tab], header button, #canvas, #badge')].filter((each) => {
  const box = each.getBoundingClientRect(), [x, y] = [box.x + box.width / 2, box.y + box.height / 2];
  return each.checkVisibility() && !each.contains(document.elementFromPoint(x, y)); }).map((each) => each.outerHTML)"""
BEYOND = """() => [...document.querySelectorAll('header *, #lens-strip :not(svg *), #status *, #stage')]
  .filter((each) => each.checkVisibility()).filter((each) => { const box = each.getBoundingClientRect();
    return box.width > 0 && (box.right > innerWidth + 0.5 || box.bottom > innerHeight + 0.5);
  }).map((each) => each.outerHTML)"""
SQUEEZED = "(all) => all.filter((each) => each.scrollWidth > each.clientWidth).map((each) => each.outerHTML)"
CUT = """() => [...document.querySelectorAll('header button, #ruler, #opening, #point, #tabs button')].filter((each) =>
  each.checkVisibility() && each.getBoundingClientRect().right > innerWidth).map((each) => each.outerHTML)"""
PARTS = "label:not(.box) input, .num input, .lane input, [data-time]"  # times are as close as they are
SMALL = """([parts, least]) => [...document.querySelectorAll('button, select, input, summary, label:not(.box):has(*)')]
  .filter((each) => {
    const { width, height } = each.getBoundingClientRect(), isHidden = getComputedStyle(each).clipPath !== 'none';
    return each.checkVisibility({ visibilityProperty: true }) && width > 0 && !each.matches(parts) && !isHidden
      && Math.min(width, height) < least - 0.1;
  }).map((each) => each.outerHTML.slice(0, 90))"""


@pytest.fixture(scope="module")
def shown(running: Running) -> Iterator[Any]:
    with opened(running, 1280, 800) as page:
        yield page


@pytest.fixture(autouse=True)
def _unchanged(shown: Any) -> Iterator[None]:
    yield
    shown.evaluate("(studio.set('camera.focus_distance', 594), studio.flush())")
    shown.wait_for_function("document.querySelector('#badge').textContent === 'Exact'", timeout=60000)


def test_the_point_in_focus_is_described_unasked(shown: Any, root: Path) -> None:
    shown.wait_for_function("document.querySelector('#what').textContent !== ''", timeout=500)
    frame: Any = clsco.render_frame(root / OPENS, truth=("depth", "blur_radius", "mask"), device="pocl")
    column, row = focus_point(frame)
    text = shown.locator("#what").inner_text()
    assert text.startswith(f"{frame.depth[row, column]:.3g} mm: ")
    assert text.endswith(f"blur disc {2 * abs(frame.blur_radius[row, column]):.1f} px")


def test_picture_and_lens_are_large(shown: Any) -> None:
    before = shown.locator("#canvas").bounding_box()["width"]
    assert before >= 820
    for part, (width, height) in {"#ruler": (650, 100), "#opening": (110, 110)}.items():
        place = shown.locator(part).bounding_box()
        assert (place["width"] >= width, place["height"] >= height) == (True, True), place
    shown.evaluate("studio.viewport.pan(9e4, -9e4)")
    place = shown.locator("#canvas").bounding_box()
    assert max(place["x"] - 1180, 48 - place["y"] - place["height"]) < 0  # a part stays in sight
    for button in ("#fit", "#inspector", "#generate"):
        shown.locator(button).click()
        assert shown.locator("#canvas").bounding_box()["width"] == before
    assert shown.locator("#making .primary").bounding_box()["y"] < 720
    assert shown.locator("#making input:visible").count() <= 7  # the folder, and at most six choices
    shown.keyboard.press("Escape")
    for path in (FOCUS, "camera.f_number"):
        assert shown.locator(f'[data-path="{path}"]:not([type=range])').count() == 1
    assert shown.evaluate(SMALL, [PARTS, 24]) == []
    sizes = shown.evaluate("[...document.querySelectorAll('body *')].map((each) => getComputedStyle(each).fontSize)")
    assert {float(size[:-2]) for size in sizes} <= {11, 12, 13, 15, 20, 28}
    for style in ("studio.css", "parts.css"):
        assert re.findall(r"#[0-9a-f]{3,8}\b(?=[;, ])|rgba?\(", (STATIC / style).read_text()) == []


def test_windows_hold_all(running: Running) -> None:
    with opened(running, 640, 400) as page:
        for mode in ("inpaint", "lens"):
            page.locator(f"[data-mode={mode}]").click()
            assert page.evaluate(BEYOND) + page.locator("header button:not(#scene)").evaluate_all(SQUEEZED) == []
        for width in (1280, 1000, 800):
            page.set_viewport_size({"width": width, "height": 720})
            page.wait_for_function(f"innerWidth === {width}")
            assert page.evaluate(BEYOND) == []
            assert {button.bounding_box()["height"] for button in page.locator("header button:visible").all()} == {32}


def test_fingers_reach_all_controls(running: Running) -> None:
    with opened(running, 390, 844, has_touch=True, is_mobile=True) as page:
        faults = {name: page.evaluate(SMALL, [PARTS, 44]) + page.evaluate(CUT) for name in states(running, page)}
        assert {name: found for name, found in faults.items() if found} == {}
        assert page.locator("#ruler").bounding_box()["width"] >= 350


def test_lens_and_focus_are_few_keys_away(running: Running, shown: Any) -> None:
    shown.reload()
    rest(shown)
    reached: dict[str, int] = {}
    for count in range(1, 15):
        shown.keyboard.press("Tab")
        reached.setdefault(shown.evaluate("document.activeElement.dataset.path ?? ''"), count)
    assert reached["camera.f_number"] <= 12
    assert reached[FOCUS] <= 14


def test_the_ruler_is_to_scale(shown: Any) -> None:
    shown.evaluate("studio.hearing.push((said) => { window.ranges = said.overview?.ranges ?? window.ranges; })")
    place = shown.locator("#ruler").bounding_box()
    end = "-Number(document.querySelector('#ruler input').min)"
    power = shown.evaluate(end) * (1 - (400 - 8) / (place["width"] - 16))
    shown.mouse.click(place["x"] + 400, place["y"] + 60)
    shown.wait_for_function("window.ranges && studio.rung === 2", timeout=60000)
    most, lens = shown.evaluate(end), shown.evaluate("studio.lens")

    def x(depth: float | None) -> float:
        return float(8 + (place["width"] - 16) * (1 - (1 / depth if depth else 0.0) / most))

    assert lens["focus"] == pytest.approx(1 / power, rel=2e-3)  # within a pixel
    read = "['x', 'width'].map((name) => Number(document.querySelector('#sharp').getAttribute(name)))"
    assert shown.evaluate(read) == pytest.approx([x(lens["near"]), x(lens["far"]) - x(lens["near"])], abs=1)
    bars = shown.evaluate("[...document.querySelectorAll('#scale [rx]')].map((bar) => Number(bar.getAttribute('x')))")
    ranges = shown.evaluate("window.ranges")
    starts = sorted(min(max(x(entry[1]), 8), place["width"] - 14) for entry in ranges)
    assert sorted(bars) == pytest.approx(starts, abs=1)
    name = shown.locator("#names button", has_text="Yellow ball")
    name.click()
    (middle,) = (entry[2] for entry in ranges if entry[0] == "Yellow ball")
    shown.wait_for_function(f"Math.abs(studio.values['{FOCUS}'] - {middle}) < 1e-3")
    shown.locator("#ruler input").press("End")  # infinity; the ruler holds the nearest object all the same
    shown.wait_for_function("studio.lens.focus === null && document.querySelector('#ruler input').value === '0'")
    assert 1 < shown.evaluate(end) * min(entry[1] for entry in ranges if entry[1]) < 1.6


def test_a_value_at_fault_is_told_in_the_status(shown: Any) -> None:
    painted = shown.evaluate("studio.painted.length")
    box(shown, FOCUS).fill("5")
    shown.locator("#fault", has_text="got 5 mm").wait_for()
    with pytest.raises(clsco.SceneError) as raised:
        clsco.parse_scene({"camera": {"focal_length": 50.0, FOCUS[7:]: 5.0}, "object": [{"shape": "plane"}]})
    assert str(raised.value).endswith(shown.locator("#fault").inner_text())
    assert shown.locator("#badge").inner_text() == "Earlier values"
    shown.evaluate(f"studio.fail(['{'x ' * 400}'])")  # a message leaves the state of the picture in sight, too
    assert shown.evaluate(HIDDEN) == []
    assert box(shown, FOCUS).get_attribute("aria-invalid") == "true"
    box(shown, FOCUS).blur()
    shown.get_by_role("button", name="Go to it").click()
    shown.wait_for_function(f"document.activeElement.dataset.path === '{FOCUS}'")
    shown.locator("#wrong").get_by_role("button", name="Undo").click()
    shown.wait_for_function("document.querySelector('#badge').textContent === 'Exact'")
    assert shown.evaluate("studio.painted.length") == painted  # nothing was rendered
    label = shown.locator("#depth label")
    assert label.get_attribute("data-other") == ""
    label.dblclick()
    shown.wait_for_function("document.querySelector('#depth label').dataset.other === undefined")


def test_nothing_moves_where_that_is_reduced_and_nothing_else_is_asked(running: Running) -> None:
    with chromium(reduced_motion="reduce") as context:
        page, asked = context.new_page(), set[str]()
        page.on("request", lambda request: asked.add(request.url.split("/")[2]))
        page.goto(running.address)
        page.wait_for_function("window.studio")
        moves = (
            "[...document.querySelectorAll('*')].every((each) => getComputedStyle(each).transitionDuration === '0s')"
        )
        assert page.evaluate(moves)
        assert asked == {running.host}
