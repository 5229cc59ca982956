"""Files, links, images and the brush in Chromium."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from clsco.files.images import read_image
from clsco.studio.session import Document
from tests.cli.test_dataset import DISTRIBUTION
from tests.studio.browser import EXAMPLES, box, from_menu, open_scene, opened, rest
from tests.studio.running import Running

pytestmark = pytest.mark.browser


FILES = {"mine.toml": DISTRIBUTION}
SHIPPED = ("sphere.toml", "focal_stack.toml", "damaged.png", "damaged_mask.png")


def test_a_link_opens_the_scene(running: Running, root: Path) -> None:
    session = Document(root)
    session.patch("object.0.distance", 333.0)
    with opened(running) as page:
        page.evaluate("link => { location.hash = link; }", session.share())
        page.wait_for_function("studio.values['object.0.distance'] === 333")
        assert box(page, "object.0.distance").input_value() == "333"
        assert page.evaluate("location.hash") == ""


def test_an_image_is_chosen_and_shown_small(page: Any, root: Path) -> None:
    box(page, "object.0.texture")
    page.locator('[data-upload="object.0.texture"]').set_input_files(str(EXAMPLES / "depth_map_image.png"))
    page.locator("[data-about]", has_text="320 x 320 px, 8 bits").wait_for(timeout=15000)
    assert len(list((root / "uploads").iterdir())) == 1  # no other test comes before


def test_painted_pixels_are_filled_by_all_methods(page: Any, root: Path) -> None:
    page.get_by_role("radio", name="Inpaint").click()
    page.locator("[data-brush=told]", has_text="0 of 262144 px").wait_for()
    page.locator("#paint [data-upload]").set_input_files(str(EXAMPLES / "damaged.png"))
    page.locator("#paint", has_text="300 × 300 px").wait_for()
    page.get_by_label("File of the mask (PNG)").fill("damaged_mask.png")
    page.get_by_role("button", name="Load the mask").click()
    page.locator("[data-brush=told]", has_text="of 90000 px are painted over").wait_for()
    count = missing(page)
    drawn(page, (-40, -40), (20, -20))
    assert missing(page) > count + 100
    page.get_by_role("button", name="Fill", exact=True).click()
    page.wait_for_function("document.querySelectorAll('#cards [data-filled]').length === 3", timeout=90000)
    right = page.locator("[data-brush=right]")
    right.get_by_text("filled: texture").wait_for()
    page.reload()
    page.get_by_role("radio", name="Inpaint").click()
    right.get_by_text("filled: texture").wait_for()  # what was filled is still seen
    filled = page.locator("#painting").screenshot()
    page.locator("[data-card=mean-median]").click()
    right.get_by_text("filled: mean and median").wait_for()
    page.wait_for_timeout(200)
    assert page.locator("#painting").screenshot() != filled
    page.get_by_role("button", name="Before").click()
    right.wait_for(state="hidden")
    assert page.locator(".figures th[scope=row]").all_text_contents()[0] == "Missing pixels"
    page.get_by_role("button", name="Write the results").click()
    page.wait_for_timeout(700)
    assert {path.name for path in (root / "inpainting").glob("*.png")} == {
        "image.png", "mask.png", "mean-median.png", "biharmonic.png", "texture.png",
    }  # fmt: skip
    assert read_image(root / "inpainting" / "mask.png").data.max() == 255


def missing(page: Any) -> int:
    page.wait_for_timeout(300)
    return int(page.locator("[data-brush=told]").inner_text().split()[0])


def drawn(page: Any, *points: tuple[float, float]) -> None:
    """Draw with the tool that is chosen, in CSS px from the middle of the canvas."""
    place = page.locator("[data-brush=canvas]").bounding_box()
    x, y = place["x"] + place["width"] / 2, place["y"] + place["height"] / 2
    page.mouse.move(x + points[0][0], y + points[0][1])
    page.mouse.down()
    for across, down in points[1:]:
        page.mouse.move(x + across, y + down, steps=6)
    page.mouse.up()


def test_the_brush_opens_by_its_key_with_the_frame_and_takes_strokes_back(page: Any) -> None:
    page.keyboard.press("b")
    page.locator("[data-brush=told]", has_text="0 of 262144 px").wait_for()
    scale = page.evaluate("parseFloat(document.querySelector('#zoom').textContent) / 100")
    page.locator("[data-brush=tool][value=rectangle]").check()
    drawn(page, (-60, -60), (-20, -40))
    rectangle = missing(page)
    assert rectangle == pytest.approx(40 * 20 / scale**2, rel=0.1)
    page.locator("[data-brush=tool][value=lasso]").check()
    drawn(page, (10, 0), (70, 0), (70, 40), (10, 40))
    lasso = missing(page) - rectangle
    assert lasso == pytest.approx(60 * 40 / scale**2, rel=0.1)
    page.locator("[data-brush=erase]").check()
    drawn(page, (5, 20), (75, 20), (75, 45), (5, 45))
    assert missing(page) - rectangle == pytest.approx(lasso / 2, rel=0.2)
    page.keyboard.press("Control+z")
    assert missing(page) == rectangle + lasso
    page.keyboard.press("Control+z")
    page.keyboard.press("Control+z")
    assert missing(page) == 0
    page.keyboard.press("Control+Shift+Z")
    assert missing(page) == rectangle
    runs = page.evaluate("fetch(`inpainting/mask?tab=${studio.tab}`).then((answer) => answer.json())")["runs"]
    assert sum(runs[1::2]) == rectangle
    assert not page.locator("#redo").is_enabled()
    width = page.locator("[data-brush=size]").input_value()
    page.keyboard.press("]")
    assert int(page.locator("[data-brush=size]").input_value()) > int(width)


def test_zoom_in_the_brush_makes_strokes_finer(page: Any) -> None:
    page.keyboard.press("b")
    page.locator("[data-brush=told]", has_text="0 of 262144 px").wait_for()
    page.locator("[data-brush=tool][value=rectangle]").check()
    drawn(page, (-20, -20), (20, 20))
    before = missing(page)
    page.locator("[data-brush=clear]").click()
    page.evaluate("studio.viewport.zoom(1.5 ** 2)")
    drawn(page, (-20, -20), (20, 20))
    assert missing(page) == pytest.approx(before / 1.5**4, rel=0.15)
    page.locator("[data-brush=canvas]").focus()
    page.keyboard.press("Enter")  # the keyboard paints, too
    page.locator("[data-brush=clear]").click()
    assert missing(page) == 0
    page.locator("[data-brush=canvas]").focus()
    page.keyboard.press("Enter")
    assert missing(page) == pytest.approx(113, abs=15)  # a disc of 12 px


def test_a_data_set_is_made_and_survives_a_reload(page: Any) -> None:
    page.locator("#generate").click()
    sheet = page.locator("#making")
    sheet.get_by_text("All 11 formats").click()
    sheet.get_by_label("Render").select_option("a data set")
    files = sheet.get_by_label("Distribution file")
    files.select_option("mine.toml")
    assert "sets/stereo.toml" in files.locator("option").all_inner_texts()
    sheet.get_by_label("Samples", exact=True).fill("0")
    sheet.locator(".primary").click()
    page.locator("#message", has_text="samples: must be an integer from 1 on; got '0'").wait_for()
    sheet.get_by_label("Samples", exact=True).fill("18")
    page.locator("#cost", has_text="time and size show once it runs").wait_for()
    sheet.get_by_role("button", name="Generate 18 samples").dblclick()
    page.locator(".job").wait_for()
    page.reload()
    rest(page)
    assert (page.locator(".job").count(), sheet.is_visible()) == (1, False)
    page.locator("#generate").click()
    page.locator(".job.done").wait_for(timeout=60000)
    page.locator(".job summary").click()
    words = "--count 18 --shard-size 2 --seed 0 --format webdataset --device pocl --resume --quiet"
    assert page.locator(".job code").inner_text() == f"clsco dataset make mine.toml -o sets/start {words}"
    page.wait_for_function("document.querySelector('.job img').naturalWidth === 24")


def test_each_scene_of_a_sweep_is_shown(page: Any) -> None:
    open_scene(page, "focal_stack.toml")
    chosen = page.get_by_label("Scene that is shown")
    chosen.wait_for()
    first = page.evaluate("document.querySelector('#canvas').toDataURL()")
    revision = page.evaluate("studio.revision")
    chosen.select_option(index=8)
    page.wait_for_function(f"studio.revision > {revision}")
    rest(page)
    assert page.evaluate("document.querySelector('#canvas').toDataURL()") != first
    page.locator("#generate").click()
    page.get_by_role("button", name="Generate 9 frames").wait_for()
    from_menu(page, "Open")
    page.get_by_role("button", name="sphere.toml").click()
    chosen.wait_for(state="detached")
