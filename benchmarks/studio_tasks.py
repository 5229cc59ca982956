"""Ten tasks of a new user in the studio, done in Chromium: clicks, texts, scrolls and seconds of each, and a picture of
its end.

    python -m benchmarks.studio_tasks [--width 1280 390] [--only PART] [-o FOLDER]

A drag counts as a click, as does a choice in a list; a text is what is typed into one box. Seconds go from the first
step to what the task is for, as fast as the page answers; people take longer. With PYTHONPATH=CHECKOUT of an older
version, its studio does the tasks that it can.
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.studio.browser import chromium, rest
from tests.studio.running import studio

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
SCENES = ("sphere", "occlusion_three", "sphere_moving")
HEIGHTS = {1280: 800, 390: 844}
WAIT = 180_000  # ms


@dataclass
class Hand:
    """Clicks, texts and scrolls in a page, counted."""

    page: Any
    clicks: int = 0
    texts: int = 0
    scrolls: int = 0

    def seen(self, *selectors: str) -> Any:
        """The first of some elements that is there, brought into sight: folded parts and drawers are opened first."""
        self.page.locator(", ".join(selectors)).first.wait_for(state="attached")
        found = next(self.page.locator(each).first for each in selectors if self.page.locator(each).count())
        for button, part in (("#drawer", "#panels"), ("#inspector", "#side")):
            hidden = found.evaluate(
                "(it, part) => it.closest(part) !== null && it.getBoundingClientRect().right <= 0"
                " || it.closest(part) !== null && it.getBoundingClientRect().left >= innerWidth",
                part,
            )
            if hidden:
                self.click(button)
        if found.evaluate("(it) => it.closest('details:not([open])') !== null && it.tagName !== 'SUMMARY'"):
            self.clicks += 1
            found.evaluate("(it) => it.closest('details').querySelector('summary').click()")
        before = found.bounding_box()
        found.scroll_into_view_if_needed()
        self.scrolls += before != found.bounding_box()
        return found

    def click(self, *selectors: str) -> None:
        self.clicks += 1
        self.seen(*selectors).click()

    def press(self, name: str, inside: str = "body") -> None:
        """Click a button by its words."""
        self.clicks += 1
        if self.page.locator("#menu button", has_text=name).count():
            self.click("#scene")
        button = self.page.locator(inside).get_by_role("button", name=name, exact=True).first
        button.scroll_into_view_if_needed()
        button.click()

    def choose(self, selector: str, value: str) -> None:
        self.clicks += 1
        self.seen(selector).select_option(value)

    def type(self, text: str, *selectors: str) -> None:
        self.texts += 1
        box = self.seen(*selectors)
        box.fill(text)
        box.press("Enter")

    def point(self, x: float, y: float, clicks: int = 1) -> None:
        """Point at a place of the picture, in shares of its width and height, and click."""
        self.clicks += clicks
        self.page.evaluate("document.querySelector('#studio').classList.remove('open', 'sided', 'making')")
        box = self.page.locator("#canvas").bounding_box()
        place = box["x"] + x * box["width"], box["y"] + y * box["height"]
        self.page.mouse.move(*place)
        if clicks:
            self.page.mouse.click(*place)

    def until(self, condition: str) -> None:
        self.page.wait_for_function(condition, timeout=WAIT)

    def open(self, name: str) -> None:
        """Have a scene shown, which does not count."""
        self.page.locator("#scene").click()
        self.page.locator("#menu").get_by_role("button", name="Open", exact=True).click()
        self.page.get_by_role("button", name=f"{name}.toml").first.click()
        self.page.locator("dialog[open]").wait_for(state="hidden")
        self.until("studio.rung === 2")


def focus_near(hand: Hand) -> None:
    before = hand.page.evaluate("studio.values['camera.focus_distance'] ?? -1")
    hand.click("#focus")
    hand.point(0.5, 0.5)
    hand.until(f"studio.values['camera.focus_distance'] !== {before} && studio.rung === 2")


def stop_down(hand: Hand) -> None:
    hand.type("8", '#lens-strip input[data-kind][data-path="camera.f_number"]')
    hand.until("studio.values['camera.f_number'] === 8 && studio.rung === 2")


def own_photo(hand: Hand) -> None:
    hand.clicks += 2  # Browse, and the file in the system's own dialog
    hand.seen('[data-browse="object.0.texture"]')
    hand.page.locator('input[data-upload="object.0.texture"]').set_input_files(str(EXAMPLES / "depth_map_image.png"))
    hand.until("String(studio.values['object.0.texture']).startsWith('uploads/') && studio.rung === 2")


def what_is_in_focus(hand: Hand) -> None:
    hand.click('[data-view="blur radius"]')
    hand.until("studio.rung === 2 && !document.querySelector('#legend').hidden")


def why_soft(hand: Hand) -> None:
    hand.point(0.75, 0.3, clicks=0)
    hand.until("document.querySelector('#values').textContent.includes('Blur radius')")
    hand.seen("#values")


def compare_with_thesis(hand: Hand) -> None:
    hand.click("#comparing")
    hand.click("[data-compare=thesis]")
    hand.page.locator("#then", has_text="as the thesis").wait_for(timeout=WAIT)


def remove_object(hand: Hand) -> None:
    hand.click("[data-mode=inpaint]:visible", "[data-part-of=inpaint]:visible")
    hand.page.locator("[data-brush=told]", has_text="of 262144").wait_for(timeout=WAIT)
    hand.click("[data-brush=tool][value=rectangle]")
    place = hand.page.locator("[data-brush=canvas]").bounding_box()
    hand.clicks += 1
    hand.page.mouse.move(place["x"] + 0.42 * place["width"], place["y"] + 0.42 * place["height"])
    hand.page.mouse.down()
    hand.page.mouse.move(place["x"] + 0.5 * place["width"], place["y"] + 0.5 * place["height"], steps=4)
    hand.page.mouse.up()
    hand.click("#fills .primary")
    hand.page.locator("#cards [data-filled]").first.wait_for(timeout=WAIT)


def clip(hand: Hand) -> None:
    hand.click("#generate")
    hand.click("#making summary")
    hand.clicks += 1
    hand.page.get_by_label("Clip beside the frames").select_option("mp4")
    hand.click("#making button.primary")
    hand.page.locator(".job video").first.wait_for(timeout=WAIT, state="attached")


def data_set(hand: Hand) -> None:
    hand.click("#generate")
    hand.click("#making summary")
    sheet = hand.page.locator("#making")
    hand.clicks += 2
    sheet.get_by_label("Render").select_option("set")
    sheet.get_by_label("Distribution file").select_option("set.toml")
    hand.texts += 1
    sheet.get_by_label("Samples", exact=True).fill("4")
    hand.click("#making button.primary")
    hand.page.locator(".job.done code", has_text="dataset").first.wait_for(timeout=WAIT, state="attached")


def share(hand: Hand) -> None:
    hand.press("Share")
    hand.page.locator("dialog[open] [data-copy]").first.click()
    hand.clicks += 1


TASKS: dict[str, tuple[str, Callable[[Hand], None]]] = {
    "focus on the near object": ("occlusion_three", focus_near),
    "f/2 to f/8": ("sphere", stop_down),
    "own photo on a ball": ("sphere", own_photo),
    "what is in focus?": ("occlusion_three", what_is_in_focus),
    "why is it soft here?": ("occlusion_three", why_soft),
    "compare with the thesis": ("sphere", compare_with_thesis),
    "remove an object": ("occlusion_three", remove_object),
    "a clip": ("sphere_moving", clip),
    "a set": ("sphere", data_set),
    "share": ("sphere", share),
}
SET = """camera.resolution = [24, 16]
[[object]]
shape = "sphere"
[[vary.object]]
index = 0
radius = { uniform = [20, 40] }
"""


def main() -> None:
    """Do the tasks, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--width", type=int, nargs="+", choices=HEIGHTS, default=list(HEIGHTS))
    parser.add_argument("--only", default="", help="part of the names of the tasks")
    parser.add_argument("-o", "--output", type=Path, default=Path("build/studio_tasks"))
    chosen = parser.parse_args()
    chosen.output.mkdir(parents=True, exist_ok=True)
    print(f"{'task':28}{'px':>6}{'clicks':>8}{'texts':>7}{'scrolls':>9}{'s':>8}", flush=True)
    for width in chosen.width:
        with tempfile.TemporaryDirectory() as folder:  # without the jobs of another width
            root = Path(folder)
            for name in SCENES:
                shutil.copy(EXAMPLES / f"{name}.toml", root)
            (root / "set.toml").write_text(SET)
            with studio(root, str(root / "sphere.toml"), "--device", "pocl") as running, chromium() as browser:
                for number, (name, (scene, work)) in enumerate(TASKS.items(), 1):
                    if chosen.only in name:
                        done(browser, running.address, width, f"{number:02}", name, scene, work, chosen.output)


def done(
    browser: Any, address: str, width: int, number: str, name: str, scene: str, work: Callable[[Hand], None],
    folder: Path,
) -> None:  # fmt: skip
    """Do a task in a page of its own."""
    context = browser.new_context(viewport={"width": width, "height": HEIGHTS[width]})
    context.set_default_timeout(WAIT)
    page = context.new_page()
    page.goto(address)
    rest(page)
    hand = Hand(page)
    hand.open(scene)
    start = time.monotonic()
    try:
        work(hand)
        took = f"{time.monotonic() - start:8.1f}"
    except Exception as error:  # an older studio cannot, or the page is at fault: the others go on
        took = f"  {type(error).__name__}: {str(error)[:80]!r}"
    print(f"{name:28}{width:6}{hand.clicks:8}{hand.texts:7}{hand.scrolls:9}{took}", flush=True)
    page.wait_for_timeout(500)
    page.screenshot(path=folder / f"{width}-{number}-{name.replace(' ', '_').replace('/', '').strip('?')}.png")
    context.close()


if __name__ == "__main__":
    main()
