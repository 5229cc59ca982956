"""The panels of the thesis in Chromium, with Reset and Generate; and what else is done with the page."""

from __future__ import annotations

import json
import os
import shutil
import signal
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

import clsco
from clsco.cli.main import main
from tests.studio.browser import chromium, opened, rest
from tests.studio.running import Running, studio
from tests.studio.test_browser import children

pytestmark = pytest.mark.browser
EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
SHAPES = {
    "Planar": "plane", "Cylindrical": "cylinder", "Spherical": "sphere", "Conical": "cone", "Elliptical": "ellipsoid",
}  # fmt: skip


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("root")
    shutil.copy(EXAMPLES / "damaged.png", folder)
    (folder / "small.toml").write_text(
        '[camera]\nresolution = [64, 48]\npixel_pitch = 0.1\n[[object]]\nshape = "plane"\ntexture = "checkerboard"\n'
    )
    return folder


@pytest.fixture(scope="module")
def running(root: Path) -> Iterator[Running]:
    with studio(root, "--device", "pocl") as started:
        yield started


@pytest.fixture
def page(running: Running) -> Iterator[Any]:
    with opened(running) as shown:
        yield shown


def box(page: Any, path: str) -> Any:
    return page.locator(f'[data-path="{path}"]:not([type=range])')


def number(page: Any, path: str) -> float:
    return float(box(page, path).input_value())


def type_in(page: Any, path: str, value: str) -> None:
    """Type a value, and leave the box."""
    before = page.evaluate("studio.revision")
    box(page, path).fill(value)
    box(page, path).blur()
    page.wait_for_function(f"studio.revision > {before} || Object.keys(studio.faults).length", timeout=20000)


def choose(page: Any, shape: str) -> None:
    page.get_by_role("radio", name=shape, exact=True).check()
    page.wait_for_function(f"studio.values['object.0.shape'] === '{SHAPES[shape]}'", timeout=20000)
    path = {"Planar": "distance", "Conical": "apex.2"}.get(shape, "center.2")
    box(page, f"object.0.{path}").wait_for(timeout=20000)


def test_the_panels_of_the_thesis_with_its_defaults(page: Any) -> None:
    titles = page.locator("#panels summary").all_inner_texts()
    assert titles[:5] == [
        "Input Image File", "Select Object Type", "Select Object Properties", "Motion parameters",
        "Camera Specifications",
    ]  # fmt: skip
    shapes = page.locator('[role=radiogroup][aria-label="Object type"] label, .shapes label').all_inner_texts()
    assert [text.strip() for text in shapes][:5] == list(SHAPES)
    assert page.get_by_role("radio", name="Planar", exact=True).is_checked()
    assert box(page, "object.0.texture").input_value() == "bricks"
    camera = {"focal_length": 20, "aperture_diameter": 10, "pixel_pitch": 0.01, "sensor_distance": 21.739,
              "normalization_distance": 20}  # fmt: skip
    for key, value in camera.items():
        assert number(page, f"camera.{key}") == value
    for index in range(3):
        for key in ("velocity", "angular_velocity"):
            motion = box(page, f"object.0.motion.{key}.{index}")
            assert motion.input_value() == "0"
            assert motion.is_disabled()
    assert number(page, "sequence.frames") == 1
    assert number(page, "sequence.interval") == 1
    for path in ("object.0.distance", "object.0.slope_x", "object.0.slope_y"):
        assert box(page, path).is_visible()
    for name, symbol in (
        ("focal_length", "f"),
        ("aperture_diameter", "D"),
        ("pixel_pitch", "p"),
        ("sensor_distance", "s"),
    ):
        label = box(page, f"camera.{name}").get_attribute("aria-label")
        assert f" {symbol} (mm)" in label
    assert page.locator("#reset").inner_text() == "Reset"
    assert page.locator("#generate").inner_text() == "Generate"
    assert page.evaluate(
        "document.documentElement.scrollHeight <= innerHeight && document.documentElement.scrollWidth <= innerWidth"
    )


def test_values_of_a_shape_are_there_when_one_comes_back(page: Any) -> None:
    choose(page, "Spherical")
    type_in(page, "object.0.radius", "41.5")
    for shape in ("Conical", "Elliptical", "Cylindrical", "Planar"):
        choose(page, shape)
        rest(page)
    choose(page, "Spherical")
    assert number(page, "object.0.radius") == 41.5


def test_reset_leaves_the_image(page: Any) -> None:
    choose(page, "Spherical")
    box(page, "object.0.texture").fill("damaged.png")
    box(page, "object.0.texture").blur()
    type_in(page, "camera.focal_length", "25")
    page.locator("#reset").click()
    box(page, "object.0.distance").wait_for(timeout=20000)
    page.wait_for_function("studio.values['camera.focal_length'] === 20", timeout=20000)
    assert box(page, "object.0.texture").input_value() == "damaged.png"
    assert number(page, "camera.focal_length") == 20
    page.locator("#undo").click()
    box(page, "object.0.radius").wait_for(timeout=20000)
    page.wait_for_function("studio.values['camera.focal_length'] === 25", timeout=20000)


def test_a_wrong_value_stays_in_its_box_with_its_message(page: Any) -> None:
    type_in(page, "camera.focal_length", "-3")
    fault = page.locator('[data-fault="camera.focal_length"]')
    fault.wait_for(state="visible", timeout=20000)
    assert "got -3" in fault.inner_text()
    assert box(page, "camera.focal_length").input_value() == "-3"
    assert box(page, "camera.focal_length").get_attribute("aria-invalid") == "true"
    type_in(page, "camera.focal_length", "22")
    fault.wait_for(state="hidden", timeout=20000)
    assert not page.evaluate("document.querySelector('#badge').textContent === ''")


@pytest.mark.parametrize("label", list(SHAPES))
def test_generate_writes_the_bytes_of_the_command(page: Any, root: Path, label: str, tmp_path: Path) -> None:
    page.get_by_role("button", name="Open", exact=True).click()
    page.get_by_role("button", name="small.toml").click()
    page.wait_for_function("studio.values['camera.pixel_pitch'] === 0.1", timeout=20000)
    choose(page, label)
    type_in(page, "sequence.frames", "2")
    rest(page)
    page.locator("#generate").click()
    name = f"out/{SHAPES[label]}"
    page.get_by_label("Output folder").fill(name)
    page.get_by_role("button", name="Write 2 frames").click()
    page.locator(f".job.done:has-text('{name}')").wait_for(timeout=60000)
    scene = root / name / "scene.toml"
    assert tomllib.loads(scene.read_text())["object"][0]["shape"] == SHAPES[label]
    result = CliRunner().invoke(
        main, ["render", str(scene), "-o", str(tmp_path / "out"), "--device", "pocl", "--quiet"]
    )
    assert result.exit_code == 0, result.output
    for index in range(2):
        file = f"frame_{index:04d}"
        assert (root / name / f"{file}.png").read_bytes() == (tmp_path / "out" / f"{file}.png").read_bytes()
        ours, theirs = (json.loads((place / f"{file}.json").read_text()) for place in (root / name, tmp_path / "out"))
        assert {key for key in ours if ours[key] != theirs[key]} <= {"seconds"}


def test_a_click_focuses_on_what_is_there(page: Any) -> None:
    choose(page, "Spherical")
    rest(page)
    stage = page.locator("#stage").bounding_box()
    x, y = stage["x"] + stage["width"] / 2 + 60, stage["y"] + stage["height"] / 2
    page.keyboard.press("f")
    column, row = page.evaluate("([x, y]) => studio.pixelAt(x, y)", [x, y])
    page.mouse.click(x, y)
    page.wait_for_function("document.querySelector('#values').rows.length > 5", timeout=20000)
    moved = "Math.abs(studio.values['camera.focus_distance'] - 250.0173) > 0.1"
    page.wait_for_function(moved, timeout=20000)
    shape = page.evaluate("studio.values['object.0.radius']")
    center = [page.evaluate(f"studio.values['object.0.center.{index}']") for index in range(3)]
    sphere = clsco.Sphere(center=tuple(center), radius=shape)
    (frame,) = clsco.render(clsco.Scene(objects=(sphere,)), truth=("depth",), device="pocl")
    assert frame.depth is not None
    assert page.evaluate("studio.values['camera.focus_distance']") == pytest.approx(
        float(frame.depth[row, column]), rel=1e-6
    )


def test_a_slider_is_worked_by_keys(page: Any) -> None:
    slider = page.locator('input[type=range][data-path="camera.focal_length"]')
    step, start = float(slider.get_attribute("data-step")), number(page, "camera.focal_length")
    slider.focus()
    for key, factor in (("ArrowRight", 1.0), ("Shift+ArrowRight", 10.0), ("Alt+ArrowLeft", -0.1)):
        page.keyboard.press(key)
        start += factor * step
        assert number(page, "camera.focal_length") == pytest.approx(start)
    for digit, view in enumerate(
        ("color", "sharp", "depth", "blur radius", "flow", "normal", "id", "mask", "missing"), 1
    ):
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


def test_a_killed_renderer_is_started_again(page: Any, running: Running) -> None:
    rest(page)
    for pid in children(running.process.pid):
        if "spawn_main" in Path(f"/proc/{pid}/cmdline").read_text():
            os.kill(pid, signal.SIGKILL)
    type_in(page, "camera.focal_length", "21")
    page.locator("#message").wait_for(state="visible", timeout=20000)
    assert "signal 9" in page.locator("#message").inner_text()
    rest(page)


def test_two_tabs_are_two_sessions(page: Any, running: Running) -> None:
    other = page.context.new_page()
    other.goto(running.origin)
    rest(other)
    type_in(other, "camera.focal_length", "33")
    rest(other)
    assert number(page, "camera.focal_length") == 20
    same = page.context.new_page()  # a tab that is duplicated has the address of the first
    same.goto(other.url)
    rest(same)
    assert same.evaluate("studio.tab") != other.evaluate("studio.tab")


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
        await opens(`${own}/_nicegui_ws/socket.io/?EIO=4&transport=websocket`),
        await reads(origin, { credentials: "include" }),
        await reads(`${origin}/texture?tab=x&kind=png`, { method: "POST", body: "x" })];
    }"""
    with chromium() as browser:
        context = browser.new_context()
        context.new_page().goto(running.address)  # the cookie is there
        hostile = context.new_page()
        hostile.route("http://evil.example/**", lambda route: route.fulfill(body="<p>hello", content_type="text/html"))
        hostile.goto("http://evil.example/")
        assert hostile.evaluate(attack, running.origin) == ["refused"] * 4
        hostile.set_content(f'<form method="post" action="{running.origin}/"><button>x</button></form>')
        with hostile.expect_navigation() as form:
            hostile.click("button")
        assert form.value.status == 403


def test_a_server_that_stops_is_told_of(tmp_path: Path) -> None:
    with studio(tmp_path, "--device", "pocl") as running, chromium() as browser:
        page = browser.new_page()
        page.goto(running.address)
        rest(page)
        running.process.kill()
        page.locator("#lost").wait_for(state="visible", timeout=20000)
        assert page.locator("#canvas").is_visible()


@pytest.mark.parametrize("width", [1280, 800])
def test_axe_finds_nothing(running: Running, width: int) -> None:
    axe = pytest.importorskip("axe_playwright_python", reason="needs axe: pip install axe-playwright-python")
    (script,) = Path(axe.__file__).parent.rglob("axe.min.js")
    with opened(running, width) as page:
        if width < 900:
            page.locator("#drawer").click()
        page.evaluate(script.read_text())
        found = page.evaluate("axe.run()")
        assert [(fault["id"], fault["nodes"][0]["html"]) for fault in found["violations"]] == []
        assert len(found["passes"]) > 20
