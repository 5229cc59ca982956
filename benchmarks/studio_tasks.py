"""Ten tasks of a new user in the studio, done in Chromium: clicks, texts, scrolls and seconds of each, and a picture of
its end; then previews beside exact frames.

    python -m benchmarks.studio_tasks [--width 1280 390] [--only PART] [--result FILE] [-o FOLDER]

A drag counts as a click, as does a choice in a list; a text is what is typed into one box. Seconds go from the first
step to what the task is for, as fast as the page answers; people take longer. With PYTHONPATH=CHECKOUT of an older
version, its studio does the tasks that it can.

PSNR of previews, in dB: of 8-bit codes, beside the exact frame reduced to the size of the preview, and of the preview
enlarged beside the exact frame. Then a drag of the focus: pictures a second, and ms from a step to its picture.
"""

from __future__ import annotations

import argparse
import os
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

import clsco
from clsco.engine.live import Live
from clsco.files.transfer import encode
from clsco.plan.prepare import with_resolution
from clsco.studio.ladder import EIGHTHS, coarser
from tests.studio.browser import DRAG, chromium, rest
from tests.studio.running import studio

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
SCENES = ("sphere", "occlusion_three", "sphere_moving")
DRAGGED = {"evening": (594, 650), "sphere": (250, 300), "occlusion_three": (250, 300), "portrait": (1200, 1500)}
HEIGHTS = {1280: 800, 390: 844, 640: 400}  # the last one is a window at 200 %
WAIT = 180_000  # ms
WATCH_BADGE = """() => {
  const badge = document.querySelector("#badge");
  window.said = new Set();
  new MutationObserver(() => window.said.add(badge.textContent)).observe(badge, { childList: true });
}"""


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
        self.page.get_by_role("button", name=f"{name}.toml", exact=True).first.click()
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
    hand.until("document.querySelector('#what').textContent.includes('blur disc')")


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
    clips = hand.page.locator(".job video")
    before = clips.count()
    hand.click("#making button.primary")
    clips.nth(before).wait_for(timeout=WAIT, state="attached")


def data_set(hand: Hand) -> None:
    hand.click("#generate")
    hand.click("#making summary")
    sheet = hand.page.locator("#making")
    hand.clicks += 2
    sheet.get_by_label("Render").select_option("set")
    sheet.get_by_label("Distribution file").select_option("set.toml")
    hand.texts += 1
    sheet.get_by_label("Samples", exact=True).fill("4")
    sets = hand.page.locator(".job.done code", has_text="dataset")
    before = sets.count()
    hand.click("#making button.primary")
    sets.nth(before).wait_for(timeout=WAIT, state="attached")


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
    """Do the tasks and measure previews, and print and keep tables."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--width", type=int, nargs="+", choices=HEIGHTS, default=list(HEIGHTS))
    parser.add_argument("--only", default="", help="part of the names of the tasks, or of the scenes of previews")
    parser.add_argument("-o", "--output", type=Path, default=Path("build/studio_tasks"))
    parser.add_argument("--result", type=Path, help="file for the tables")
    chosen = parser.parse_args()
    chosen.output.mkdir(parents=True, exist_ok=True)
    lines: list[str] = []

    def tell(*cells: object) -> None:
        lines.append(f"| {' | '.join(map(str, cells))} |")
        print(lines[-1], flush=True)

    tell("task", "px", "clicks", "texts", "scrolls", "s")
    tell(*["---"] * 6)
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder) / "scenes"
        shutil.copytree(EXAMPLES, root)
        (root / "set.toml").write_text(SET)
        with studio(root, str(root / "sphere.toml"), "--device", "pocl") as running, chromium() as browser:
            for width in chosen.width:
                for number, (name, (scene, work)) in enumerate(TASKS.items(), 1):
                    if chosen.only in name:
                        tell(*done(browser, running.address, width, f"{number:02}", name, scene, work, chosen.output))
        lines.append("")
        tell("scene", "of full size", "PSNR, reduced", "PSNR, enlarged", "CPU ms")
        tell(*["---"] * 5)
        scenes = [name for name in DRAGGED if chosen.only in name]
        for name in scenes:
            for cells in previews(name):
                tell(*cells)
        lines.append("")
        tell("scene", "load", "pictures a second", "step to paint, ms", "of full size")
        tell(*["---"] * 5)
        for name in scenes:
            with studio(root, str(root / f"{name}.toml"), "--device", "pocl") as running, chromium() as browser:
                tell(*drag(browser, running.address, name))
    if chosen.result is not None:
        about = "`python -m benchmarks.studio_tasks`; columns are explained there."
        chosen.result.write_text("\n".join(["# Tasks and previews in the studio", "", *lines, "", about, ""]))


def done(
    browser: Any, address: str, width: int, number: str, name: str, scene: str, work: Callable[[Hand], None],
    folder: Path,
) -> tuple[object, ...]:  # fmt: skip
    """Do a task in a page of its own; returns a row of the table."""
    context = browser.browser.new_context(viewport={"width": width, "height": HEIGHTS[width]})
    context.set_default_timeout(WAIT)
    page = context.new_page()
    page.goto(address)
    rest(page)
    hand = Hand(page)
    hand.open(scene)
    start = time.monotonic()
    try:
        work(hand)
        took = f"{time.monotonic() - start:.1f}"
    except Exception as error:  # an older studio cannot, or the page is at fault: the others go on
        took = f"{type(error).__name__}: {str(error)[:80]!r}"
    page.wait_for_timeout(500)
    page.screenshot(path=folder / f"{width}-{number}-{name.replace(' ', '_').replace('/', '').strip('?')}.png")
    context.close()
    return name, width, hand.clicks, hand.texts, hand.scrolls, took


def previews(name: str) -> Iterator[tuple[object, ...]]:
    """Rows of previews of a scene."""
    scene = with_resolution(clsco.load_scene(EXAMPLES / f"{name}.toml"))
    size = scene.camera.frame_size
    with Live("pocl") as live:

        def codes(shown: clsco.Scene) -> Image.Image:
            color = encode(live.render(shown, truth=()).color, 8, scene.image.transfer)
            return Image.fromarray(np.broadcast_to(color.reshape(*color.shape[:2], -1), (*color.shape[:2], 3)).copy())

        exact = codes(scene)
        for eighths in (3, 4, 5, EIGHTHS):
            known = coarser(scene, size, eighths)
            preview = codes(known)
            distance, times = scene.camera.focused_distance, []
            for step in range(1, 6):  # rays are cast once, as in a drag
                start = time.process_time()
                live.render(known.replace("camera.focus_distance", distance * (1 + 0.001 * step)), truth=())
                times.append(time.process_time() - start)
            reduced = psnr(preview, exact.resize(preview.size, Image.Resampling.BOX, reducing_gap=None))
            enlarged = psnr(preview.resize(exact.size, Image.Resampling.BICUBIC), exact)
            yield name, f"{eighths}/8", f"{reduced:.1f}", f"{enlarged:.1f}", f"{1000 * min(times):.0f}"


def psnr(image: Image.Image, other: Image.Image) -> float:
    """PSNR of two images with 8-bit codes, dB."""
    difference = np.asarray(image, dtype=np.float64) - np.asarray(other)
    return float(10 * np.log10(255**2 / max(np.mean(difference**2), 1e-6)))


def drag(browser: Any, address: str, name: str) -> tuple[object, ...]:
    """Drag the focus of a scene; returns a row of the table, of the best of several drags: the first ones compile."""
    page = browser.new_page()
    page.set_viewport_size({"width": 1280, "height": 800})
    page.goto(address)
    page.evaluate(WATCH_BADGE)
    first, last = DRAGGED[name]
    best, median, load = 0.0, float("nan"), os.getloadavg()[0]
    for _ in range(6):
        rest(page)
        page.wait_for_timeout(5000)
        page.evaluate("() => window.said.clear()")
        found = page.evaluate(DRAG, ["camera.focus_distance", first, last, 60, 30])
        painted = [(revision, seen) for revision, _, seen in found["painted"]]
        rate = 1000 * sum(seen <= found["released"] for _, seen in painted) / (found["released"] - found["times"][0])
        if rate > best:
            latest, delays = max(revision for revision, _ in painted), []
            for number, moved in enumerate(found["times"], 1):
                wanted = min(found["before"] + number, latest)
                seen = next((seen for revision, seen in painted if revision >= wanted and seen >= moved), float("inf"))
                delays.append(seen - moved)
            best, median, load = rate, float(np.median(delays)), os.getloadavg()[0]
    said = page.evaluate("[...window.said].filter((text) => text.startsWith('Preview'))")
    page.close()
    sizes = ", ".join(sorted({text.split()[1].strip(",") for text in said}))
    return name, f"{load:.1f}", f"{best:.1f}", f"{median:.0f}", sizes


if __name__ == "__main__":
    main()
