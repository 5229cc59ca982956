"""The window as a stranger uses it: by keys alone, in several tabs, closed and loaded again meanwhile."""

from __future__ import annotations

import itertools
import time
from pathlib import Path
from typing import Any

import pytest
from websockets.exceptions import InvalidStatus

from tests.studio.browser import SMALL, axe_faults, from_menu, number, open_scene, opened, rest, states, type_in
from tests.studio.running import Running, until

pytestmark = pytest.mark.browser
FILES = {"small.toml": SMALL, "many.toml": SMALL.replace("[[object]]", "[sequence]\nframes = 3000\n[[object]]")}
SHIPPED = ("sphere.toml",)
FOCUSED = """() => {
  const element = document.activeElement, style = getComputedStyle(element);
  const parts = ["dialog", "header", "#lens-strip", "#middle", "#panels", "#side", "#making", "#status"];
  const part = parts.find((each) => element.closest(each));
  const text = element.innerText ?? "", width = parseFloat(style.outlineWidth);
  return { part: part ?? element.tagName, text, style: style.outlineStyle, width };
}"""


def focused(page: Any) -> dict[str, Any]:
    """Element that has the focus, which is seen."""
    found: dict[str, Any] = page.evaluate(FOCUSED)
    if found["part"] != "BODY":
        assert found["style"] != "none", found
        assert found["width"] >= 2, found
    return found


def walk(page: Any, key: str, text: str) -> list[str]:
    """Press a key until an element with a text has the focus; the parts of the page that were passed."""
    parts: list[str] = []
    for _ in range(400):
        page.keyboard.press(key)
        at = focused(page)
        parts.append(at["part"])
        if text in at["text"]:
            return [part for part, _ in itertools.groupby(parts)]
    raise AssertionError(f"{text}: is not reached by {key}; {parts}")


def open_by_keys(page: Any) -> None:
    if focused(page)["part"] != "header":
        walk(page, "Tab", "start.toml")
    page.keyboard.press("Enter")
    walk(page, "Tab", "Open")
    page.keyboard.press("Enter")
    page.locator("dialog[open] .names").wait_for()


def test_from_a_scene_to_its_frame_by_keys_alone(page: Any, root: Path) -> None:
    open_by_keys(page)
    inside = set()
    for _ in range(12):
        page.keyboard.press("Tab")
        inside.add(focused(page)["part"])
    assert inside <= {"dialog", "BODY"}  # the focus does not leave a dialog for the page behind
    page.keyboard.press("Escape")
    page.locator("dialog[open]").wait_for(state="detached" if page.locator("dialog[open]").count() == 0 else "hidden")
    assert "start.toml" in focused(page)["text"]  # and it comes back to what opened it
    open_by_keys(page)
    assert walk(page, "Tab", "small.toml")[-1] == "dialog"
    page.keyboard.press("Enter")
    page.wait_for_function("studio.values['camera.pixel_pitch'] === 0.1 && studio.rung === 2", timeout=20000)
    assert walk(page, "Tab", "Generate") == ["header"]
    assert walk(page, "Tab", "1:1") == ["#lens-strip", "#middle", "#panels", "#status"]
    assert walk(page, "Shift+Tab", "Generate") == ["#status", "#panels", "#middle", "#lens-strip", "header"]
    page.keyboard.press("Enter")
    page.get_by_label("Into the folder").wait_for()
    walk(page, "Tab", "Generate 1 frame")
    page.keyboard.press("Enter")
    page.locator(".job.done").first.wait_for(timeout=60000)
    assert (root / "frames" / "small" / "frame_0000.png").is_file()
    page.keyboard.press("Escape")
    page.get_by_label("Into the folder").wait_for(state="hidden")
    assert focused(page)["text"] == "Generate"  # it comes back to what opened it
    page.keyboard.press("Control+Enter")
    page.get_by_label("Into the folder").wait_for()


def save_as(dialog: Any, name: str) -> None:
    dialog.get_by_label("File in").fill(name)
    dialog.get_by_role("button", name="Save", exact=True).click()


def becomes(path: Path, text: str) -> None:
    """Wait until a file has a text."""
    until(lambda: path.is_file() and text in path.read_text())


def test_two_tabs_do_not_write_over_each_other(page: Any, running: Running, root: Path) -> None:
    other = page.context.new_page()
    other.goto(running.page + "/")
    rest(other)
    for tab in (page, other):
        open_scene(tab, "sphere.toml")
    type_in(page, "object.0.radius", "21")
    type_in(other, "object.0.radius", "22")
    from_menu(page, "Save")
    becomes(root / "sphere.toml", "radius = 21")
    from_menu(other, "Save")
    dialog = other.locator("dialog[open]")
    dialog.get_by_role("alert").wait_for()
    assert "with other content" in dialog.get_by_role("alert").inner_text()
    dialog.get_by_role("button", name="Show the difference").click()
    dialog.locator("pre.difference", has_text="-radius = 21").wait_for()
    assert "+radius = 22" in dialog.locator("pre.difference").inner_text()
    dialog.get_by_role("button", name="Save under another name").click()
    save_as(dialog, "other.toml")
    dialog.wait_for(state="hidden")
    becomes(root / "other.toml", "radius = 22")
    assert "radius = 21" in (root / "sphere.toml").read_text()
    type_in(other, "object.0.radius", "24")
    from_menu(other, "Save as")
    save_as(dialog, "sphere.toml")
    dialog.get_by_role("button", name="Overwrite").click()
    dialog.wait_for(state="hidden")
    becomes(root / "sphere.toml", "radius = 24")
    from_menu(other, "Save as")  # over a file that is another one
    save_as(dialog, "small.toml")
    dialog.get_by_role("alert").wait_for()
    assert "small.toml: is there already" in dialog.get_by_role("alert").inner_text()
    dialog.get_by_role("button", name="Save under another name").click()
    save_as(dialog, "third.toml")
    dialog.wait_for(state="hidden")
    becomes(root / "third.toml", "radius = 24")
    type_in(page, "object.0.radius", "23")
    rest(page)
    assert number(other, "object.0.radius") == 24


def test_a_copy_of_a_tab_is_a_session_of_its_own(page: Any, running: Running) -> None:
    type_in(page, "object.0.distance", "310")
    copy = page.context.new_page()
    copy.add_init_script(f"sessionStorage.setItem('tab', {page.evaluate('studio.tab')!r})")  # as browsers copy it
    copy.goto(page.url)
    rest(copy)
    assert copy.evaluate("studio.tab") != page.evaluate("studio.tab")
    type_in(copy, "object.0.distance", "320")
    rest(copy)
    assert number(page, "object.0.distance") == 310


def test_jobs_go_on_without_their_page_and_previews_do_not(page: Any, running: Running, root: Path) -> None:
    open_scene(page, "many.toml")
    page.locator("#generate").click()
    page.get_by_label("Into the folder").fill("long")
    page.get_by_role("button", name="Generate 3000 frames").click()
    job = page.locator(".job.running:has-text('long')")
    page.wait_for_function("document.querySelector('.job.running progress').value > 0", timeout=60000)
    page.reload()
    page.locator("#generate").click()
    job.locator("progress").wait_for(timeout=20000)  # it is there again, and how far it is
    (cancel := page.get_by_role("button", name="Cancel job")).focus()
    before = page.locator(".job.running progress").evaluate("bar => bar.value")
    page.wait_for_function(f"document.querySelector('.job.running progress').value > {before}", timeout=20000)
    assert cancel.evaluate("button => button === document.activeElement")  # what is pressed stays as the job gets on
    done = len(list((root / "long").glob("*.png")))
    tab, origin = page.evaluate("studio.tab"), page.context
    page.evaluate("look = studio.look; studio.set('object.0.distance', 260)")
    page.close()
    end = time.monotonic() + 3
    while True:  # the socket of a tab that is still shown something is refused
        try:
            with running.frames(tab):
                break
        except InvalidStatus:
            assert time.monotonic() < end
            time.sleep(0.05)
    time.sleep(1)
    assert len(list((root / "long").glob("*.png"))) > done
    again = origin.new_page()
    again.goto(running.page + "/")
    again.locator("#generate").click()
    again.locator(".job.running:has-text('long')").get_by_role("button", name="Cancel job").click()
    rest(again)
    again.locator(".job.canceled:has-text('long')").wait_for(timeout=20000)


@pytest.mark.parametrize(
    ("scheme", "width"),
    [("dark", 1280), *(pytest.param(*each, marks=pytest.mark.slow) for each in (("light", 1280), ("light", 390)))],
)
def test_axe_finds_nothing_in_any_state(running: Running, scheme: str, width: int) -> None:
    with opened(running, width, color_scheme=scheme) as page:
        faults = {name: axe_faults(page) for name in states(running, page)}
        assert len(faults) >= 21
        assert {name: found for name, found in faults.items() if found} == {}


BADGE = "document.querySelector('#badge').textContent"


def test_the_badge_says_of_what_the_picture_is(page: Any) -> None:
    assert page.evaluate(BADGE) == "Exact"
    type_in(page, "object.0.distance", "-1")
    assert page.evaluate(BADGE) == "Earlier values"
    type_in(page, "camera.focal_length", "-1")
    assert page.locator("#fault").inner_text().endswith("; and 1 more")
    type_in(page, "object.0.distance", "300")
    type_in(page, "camera.focal_length", "20")
    page.wait_for_function(f"{BADGE} === 'Exact'", timeout=20000)
    assert page.evaluate(f"(studio.look('depth'), {BADGE})") == "Earlier view: color"
    page.wait_for_function(f"studio.rung === 2 && {BADGE} === 'Exact'", timeout=20000)
    assert page.evaluate(f"(studio.set('object.0.shape', 'sphere'), studio.flush(), {BADGE})") == "Earlier values"
    page.wait_for_function(f"{BADGE} === 'Exact'", timeout=20000)


def test_generate_says_what_it_costs_and_begins_a_stack_at_the_objects(page: Any) -> None:
    def costs(words: str) -> None:
        page.locator("#cost", has_text=words).wait_for(timeout=20000)

    page.keyboard.press("Control+Enter")
    costs(", about ")
    for value, words in (([256, 256], "cost not known yet"), ([256, 256], ", about "), (-1, "; invalid: camera")):
        page.evaluate("(value) => studio.set('camera.resolution', value)", value)
        costs(words)
    assert page.locator("#making .primary").is_disabled()
    page.evaluate("(studio.set('camera.resolution', [256, 256]), studio.set('object.0.distance', 300))")
    page.locator("#making .primary:enabled").wait_for()
    page.locator("#making summary").first.click()
    page.locator("#making").get_by_label("Render").select_option("stack")
    page.wait_for_function("document.querySelector('#stack-nearest').value === '240'", timeout=20000)
    page.wait_for_timeout(300)
    assert page.get_by_label("Nearest focus distance").input_value() == "240"
