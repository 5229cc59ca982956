"""The panels in Chromium: the words of the thesis, Reset, Generate, and what goes wrong."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from clsco.cli.main import main
from clsco.files.images import read_image
from clsco.studio.session import Session
from tests.studio.browser import opened, rest
from tests.studio.running import Running, studio

pytestmark = pytest.mark.browser
EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


@pytest.fixture
def root(tmp_path: Path) -> Path:
    for name in ("sphere.toml", "damaged.png", "damaged_mask.png"):
        shutil.copy(EXAMPLES / name, tmp_path)
    return tmp_path


@pytest.fixture
def running(root: Path) -> Iterator[Running]:
    with studio(root, "--device", "pocl") as started:
        yield started


@pytest.fixture
def page(running: Running) -> Iterator[Any]:
    with opened(running) as shown:
        yield shown


def box(page: Any, path: str) -> Any:
    return page.locator(f'#panels input[data-kind=number][data-path="{path}"]')


def panel(page: Any, title: str) -> Any:
    return page.locator("details.panel", has=page.locator("summary", has_text=title)).first


def typed(page: Any, path: str, value: str) -> None:
    box(page, path).fill(value)
    box(page, path).blur()
    page.wait_for_timeout(300)


def test_the_panels_are_those_of_the_thesis(page: Any) -> None:
    titles = [text.strip() for text in page.locator("details.panel > summary").all_inner_texts()]
    assert titles[:5] == [
        "Input Image File", "Select Object Type", "Select Object Properties", "Motion parameters",
        "Camera Specifications",
    ]  # fmt: skip
    types = panel(page, "Select Object Type").locator("label.check").all_inner_texts()
    assert [text.strip() for text in types][:5] == ["Planar", "Cylindrical", "Spherical", "Conical", "Elliptical"]
    shown = {
        "camera.focal_length": ("Focal length f (mm)", "20"),
        "camera.aperture_diameter": ("Aperture diameter D (mm)", "10"),
        "camera.pixel_pitch": ("Pixel pitch p (mm)", "0.01"),
        "camera.sensor_distance": ("Lens to sensor distance s (mm)", "21.739"),
        "camera.normalization_distance": ("Magnification normalization distance s0 (mm)", "20"),
        "camera.f_number": ("F-number f/D", "2"),
        "sequence.frames": ("Number of frames n", "1"),
        "sequence.interval": ("Inter-frame interval t (s)", "1"),
        "object.0.distance": ("Distance a (mm)", "250"),
        "object.0.motion.velocity.0": ("Translation x vx (mm/s)", "0"),
        "object.0.motion.angular_velocity.1": ("Rotation y ωy (deg/s)", "0"),
    }
    for path, (name, value) in shown.items():
        assert box(page, path).get_attribute("aria-label") == name
        assert box(page, path).input_value() == value
    assert box(page, "camera.focus_distance").input_value().startswith("250.0")
    assert page.locator("#reset").inner_text() == "Reset"
    assert page.locator("#generate").inner_text() == "Generate"
    assert box(page, "object.0.motion.velocity.0").is_disabled()


def test_shapes_keep_their_values_and_reset_leaves_the_image(page: Any) -> None:
    panel(page, "Input Image File").locator("input[type=text]").fill("checkerboard")
    page.get_by_role("radio", name="Spherical").check()
    box(page, "object.0.radius").wait_for()
    typed(page, "object.0.radius", "12")
    page.get_by_role("radio", name="Conical").check()
    box(page, "object.0.half_angle").wait_for()
    page.get_by_role("radio", name="Spherical").check()
    box(page, "object.0.radius").wait_for()
    assert box(page, "object.0.radius").input_value() == "12"
    page.get_by_label("Translation", exact=True).check()
    page.wait_for_function("!document.querySelector('input[data-path=\"object.0.motion.velocity.0\"]').disabled")
    typed(page, "object.0.motion.velocity.0", "3")
    page.get_by_label("Translation", exact=True).uncheck()
    page.wait_for_timeout(500)
    assert box(page, "object.0.motion.velocity.0").input_value() == "0"
    typed(page, "camera.focal_length", "25")
    page.locator("#reset").click()
    box(page, "object.0.distance").wait_for()
    page.wait_for_timeout(300)
    assert page.get_by_role("radio", name="Planar").is_checked()
    assert box(page, "camera.focal_length").input_value() == "20"
    assert panel(page, "Input Image File").locator("input[type=text]").input_value() == "checkerboard"
    page.locator("#undo").click()
    box(page, "object.0.radius").wait_for()
    assert box(page, "camera.focal_length").input_value() == "25"


def test_what_is_wrong_is_said_beside_its_box(page: Any) -> None:
    typed(page, "object.0.distance", "-4")
    fault = page.locator('[data-fault="object.0.distance"]')
    fault.wait_for(state="visible")
    assert fault.inner_text() == "must be greater than 0 mm; got -4"
    assert box(page, "object.0.distance").input_value() == "-4"
    assert box(page, "object.0.distance").get_attribute("aria-invalid") == "true"
    typed(page, "object.0.distance", "300")
    fault.wait_for(state="hidden")


def test_boxes_keep_what_is_typed_when_the_page_changes(page: Any) -> None:
    typed(page, "object.0.distance", "320")
    page.get_by_role("button", name="Presets").click()
    page.locator("dialog[open]").wait_for()
    page.keyboard.press("Escape")
    page.get_by_role("button", name="Open", exact=True).click()
    page.get_by_role("button", name="sphere.toml").wait_for()
    page.keyboard.press("Escape")
    assert box(page, "object.0.distance").input_value() == "320"


def test_generate_writes_what_the_command_does(page: Any, root: Path) -> None:
    page.get_by_role("button", name="Presets").click()
    page.get_by_role("button", name="Figure 3.12 left: sphere, pillbox").click()
    box(page, "object.0.radius").wait_for()
    rest(page)
    page.locator("#generate").click()
    page.get_by_role("button", name="Write 1 frame").click()
    page.locator(".job.done").wait_for(timeout=60000)
    line = page.locator(".job code").inner_text()
    picture = page.locator(".job img")
    page.wait_for_function("document.querySelector('.job img').naturalWidth === 512")
    assert picture.count() == 1
    folder = root / line.split(" -o ")[1].split()[0]
    out = root / "by_command"
    scene = str(EXAMPLES / "thesis" / "fig_3_12_left.toml")
    assert CliRunner().invoke(main, ["render", scene, "-o", str(out)]).exit_code == 0
    assert (folder / "frame_0000.png").read_bytes() == (out / "frame_0000.png").read_bytes()


def test_save_asks_before_it_overwrites(page: Any, root: Path) -> None:
    page.get_by_role("button", name="Open", exact=True).click()
    page.get_by_role("button", name="sphere.toml").click()
    box(page, "object.0.radius").wait_for()
    typed(page, "object.0.radius", "28")
    other = Session(root)
    other.open(Path("sphere.toml"))
    other.patch("title", "theirs")
    other.save()
    page.locator("#save").click()
    page.get_by_role("button", name="Show the difference").click()
    page.locator("pre.difference", has_text="+radius = 28").wait_for()
    page.get_by_role("button", name="Overwrite").click()
    page.wait_for_timeout(700)
    assert "radius = 28" in (root / "sphere.toml").read_text()
    assert (root / "sphere.toml").read_text().startswith("# Nearest point at 250 mm")


def test_a_link_opens_the_scene(running: Running, root: Path) -> None:
    session = Session(root)
    session.patch("object.0.distance", 333.0)
    with opened(running) as page:
        page.evaluate("link => { location.hash = link; }", session.share())
        page.wait_for_function(
            "document.querySelector('input[data-kind=number][data-path=\"object.0.distance\"]').value === '333'"
        )
        assert page.evaluate("location.hash") == ""


def test_an_image_is_chosen_and_shown_small(page: Any, root: Path) -> None:
    page.locator('[data-upload="object.0.texture"]').set_input_files(str(EXAMPLES / "depth_map_image.png"))
    page.locator("[data-about]", has_text="320 x 320 px, 8 bits").wait_for(timeout=15000)
    assert len(list((root / "uploads").iterdir())) == 1


def test_painted_pixels_are_filled_by_all_methods(page: Any, root: Path) -> None:
    page.get_by_role("button", name="Inpaint").click()
    page.get_by_label(f"Image in {root.name}").fill("damaged.png")
    page.get_by_role("button", name="Open the image").click()
    page.wait_for_function("document.querySelector('[data-brush=canvas]').width === 300")
    page.get_by_label("Mask (PNG)").fill("damaged_mask.png")
    page.get_by_role("button", name="Load the mask").click()
    page.locator("[data-brush=told]", has_text="of 90000 pixels are missing").wait_for()
    page.wait_for_timeout(500)
    count = int(page.locator("[data-brush=told]").inner_text().split()[0])
    drawn(page, (-40, -40), (20, -20))
    page.wait_for_timeout(300)
    assert int(page.locator("[data-brush=told]").inner_text().split()[0]) > count + 100
    page.get_by_role("button", name="Fill", exact=True).click()
    page.wait_for_function("document.querySelectorAll('.beside img').length === 3", timeout=90000)
    assert page.locator(".figures th[scope=row]").all_inner_texts()[0] == "Missing pixels"
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
    page.locator("[data-brush=told]", has_text="0 of 262144 pixels").wait_for()
    scale = page.evaluate("parseFloat(document.querySelector('[data-brush=zoom]').textContent) / 100")
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
    runs = page.evaluate("fetch(`/inpainting/mask?tab=${studio.tab}`).then((answer) => answer.json())")["runs"]
    assert sum(runs[1::2]) == rectangle
    assert not page.locator("#redo").is_enabled()
    width = page.locator("[data-brush=size]").input_value()
    page.keyboard.press("]")
    assert int(page.locator("[data-brush=size]").input_value()) > int(width)


def test_zoom_in_the_brush_makes_strokes_finer(page: Any) -> None:
    page.keyboard.press("b")
    page.locator("[data-brush=told]", has_text="0 of 262144 pixels").wait_for()
    page.locator("[data-brush=tool][value=rectangle]").check()
    drawn(page, (-20, -20), (20, 20))
    before = missing(page)
    page.locator("[data-brush=clear]").click()
    page.locator("[data-brush=larger]").click()
    page.locator("[data-brush=larger]").click()
    drawn(page, (-20, -20), (20, 20))
    assert missing(page) == pytest.approx(before / 1.5**4, rel=0.15)
    page.locator("[data-brush=canvas]").focus()
    page.keyboard.press("Enter")  # the keyboard paints, too
    page.locator("[data-brush=clear]").click()
    assert missing(page) == 0
    page.locator("[data-brush=canvas]").focus()
    page.keyboard.press("Enter")
    assert missing(page) == pytest.approx(113, abs=15)  # a disc of 12 px
