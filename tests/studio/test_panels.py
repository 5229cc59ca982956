"""The panels of the thesis in Chromium, with Reset and Generate; and what else is done with the page."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from clsco.cli.main import main
from clsco.studio.pictures import VIEWS
from clsco.studio.tables import THESIS_TITLES
from tests.studio import browser
from tests.studio.browser import SHAPES, SMALL, box, choose, number, open_scene, rest, type_in, unfold
from tests.studio.running import Running
from tests.studio.test_jobs import written

pytestmark = pytest.mark.browser
FILES, SHIPPED = {"small.toml": SMALL}, ("damaged.png",)
CHECKLIST = {  # labels and values of some boxes of the five panels; tests/studio/test_forms.py has all symbols
    "object.0.distance": ("Distance a (mm)", "250"),
    "object.0.motion.angular_velocity.2": ("Rotation z ωz (deg/s)", "0"),
    "sequence.interval": ("Inter-frame interval t (s)", "1"),
    "camera.sensor_distance": ("Lens to sensor distance s (mm)", "21.739"),
    "camera.normalization_distance": ("Magnification normalization distance s0 (mm)", "20"),
}


@pytest.mark.everyday
def test_the_panels_of_the_thesis_with_its_defaults(page: Any) -> None:
    assert tuple(page.locator("#panels summary h2").all_inner_texts()[:5]) == THESIS_TITLES
    unfold(page, "Select Object Type")
    shapes = page.locator('[role=radiogroup][aria-label="Object type"] label, .shapes label').all_inner_texts()
    assert [text.strip() for text in shapes][:5] == list(SHAPES)
    assert page.get_by_role("radio", name="Planar", exact=True).is_checked()
    assert box(page, "object.0.texture").input_value() == "bricks"
    for path, (name, value) in CHECKLIST.items():
        assert box(page, path).get_attribute("aria-label") == name
        assert box(page, path).input_value() == value
        assert box(page, path).is_visible()
        assert box(page, path).is_disabled() == (".motion." in path)
    assert number(page, "camera.focus_distance") == pytest.approx(250.0, abs=0.02)  # what these amount to
    assert number(page, "camera.f_number") == 2.0
    assert page.locator("#reset").inner_text() == "Reset"
    assert page.locator("#generate").inner_text() == "Generate"
    assert page.evaluate(
        "document.documentElement.scrollHeight <= innerHeight && document.documentElement.scrollWidth <= innerWidth"
    )


def test_a_motion_that_is_not_chosen_is_none(page: Any) -> None:
    unfold(page, "Motion parameters")
    page.get_by_label("Translation", exact=True).check()
    page.locator('input[data-kind][data-path="object.0.motion.velocity.0"]:enabled').wait_for()
    type_in(page, "object.0.motion.velocity.0", "3")
    page.get_by_label("Translation", exact=True).uncheck()
    page.locator('input[data-kind][data-path="object.0.motion.velocity.0"]:disabled').wait_for()
    assert box(page, "object.0.motion.velocity.0").input_value() == "0"


@pytest.mark.parametrize(
    "label", [pytest.param(label, marks=pytest.mark.everyday if label == "Conical" else ()) for label in SHAPES]
)
def test_shapes_generated_are_those_of_the_command(page: Any, root: Path, label: str, tmp_path: Path) -> None:
    open_scene(page, "small.toml")
    choose(page, label)
    type_in(page, "sequence.frames", "2")
    folder = generated(page, root, f"out/{SHAPES[label]}")
    assert tomllib.loads((folder / "scene.toml").read_text())["object"][0]["shape"] == SHAPES[label]
    assert_made_by_the_command(folder, folder / "scene.toml", tmp_path)


def generated(page: Any, root: Path, name: str) -> Path:
    """Press Generate; the folder with what it wrote."""
    page.locator("#generate").click()
    page.get_by_label("Into the folder").fill(name)
    page.locator("#making .primary").click()
    page.locator(f".job.done:has-text('{name}')").wait_for(timeout=60000)
    page.locator("#generate").click()
    return root / name


def assert_made_by_the_command(folder: Path, scene: Path, other: Path) -> None:
    """The files of a folder are those of `clsco render`, byte by byte, but for the seconds in them."""
    command = ["render", str(scene), "-o", str(other), "--device", "pocl", "--quiet"]
    result = CliRunner().invoke(main, command)
    assert result.exit_code == 0, result.output
    assert written(folder) == written(other) != {}


def test_a_slider_is_worked_by_keys(page: Any) -> None:
    unfold(page, "Camera Specifications")
    slider = page.locator('#panels input[type=range][data-path="camera.sensor_distance"]')
    step, start = float(slider.get_attribute("data-step")), number(page, "camera.sensor_distance")
    slider.focus()
    for key, factor in (("ArrowRight", 1.0), ("Shift+ArrowRight", 10.0), ("Alt+ArrowLeft", -0.1)):
        page.keyboard.press(key)
        start += factor * step
        assert number(page, "camera.sensor_distance") == pytest.approx(start)
    for digit, view in enumerate([*VIEWS][:9], 1):
        page.locator("#stage").click()
        page.keyboard.press(str(digit))
        page.wait_for_function(f"studio.view === '{view}' && studio.rung === 2", timeout=30000)
    page.keyboard.press("1")
    page.keyboard.press("Control+z")
    page.wait_for_function("!document.querySelector('#redo').disabled", timeout=20000)
    page.keyboard.press("?")
    assert page.locator("#keys").is_visible()


def test_a_script_in_a_title_is_not_run(page: Any) -> None:
    page.evaluate("""studio.put("title", "<img src=x onerror='window.hit=1'><script>window.hit=1</script>")""")
    page.wait_for_function("document.querySelector('#title').textContent.includes('<script>')", timeout=20000)
    rest(page)
    page.reload()
    rest(page)
    assert "<script>" in page.locator("#title").inner_text()
    assert page.evaluate("window.hit") is None


def test_a_hostile_page_gets_nothing(running: Running) -> None:
    attack = """async (origin) => {
      const opens = (url) => new Promise((done) => {
        const socket = new WebSocket(url);
        socket.onopen = () => done("open");
        socket.onerror = () => done("refused");
      });
      const reads = (url, options) => fetch(url, options).then((answer) => answer.status, () => "refused");
      const own = origin.replace("http", "ws");
      return [await opens(`${own}/frames?tab=x`),
        await reads(`${origin}/`, { credentials: "include" }),
        await reads(`${origin}/texture?tab=x&kind=png`, { method: "POST", body: "x" })];
    }"""
    with browser.chromium() as context:
        context.new_page().goto(running.address)  # the cookie is there
        hostile = context.new_page()
        hostile.route("http://evil.example/**", lambda route: route.fulfill(body="<p>hello", content_type="text/html"))
        hostile.goto("http://evil.example/")
        assert hostile.evaluate(attack, running.page) == ["refused"] * 3  # although it knows the path
        hostile.set_content(f'<form method="post" action="{running.page}/"><button>x</button></form>')
        with hostile.expect_navigation() as form:
            hostile.click("button")
        assert form.value.status == 403
