"""The strip of the lens in Chromium, scales of sliders, and controls that do nothing."""

from __future__ import annotations

from typing import Any

import pytest

import clsco
from clsco.optics.lens import SHARP
from clsco.studio.forms import PLACES
from clsco.studio.lens import lens_line
from tests.studio.browser import SMALL, axe_faults, box, number, opened, rest, type_in
from tests.studio.running import Running

pytestmark = pytest.mark.browser
FILES, OPENS = {"scene.toml": SMALL}, "scene.toml"
FOCUS = '#lens-strip input[data-kind][data-path="camera.focus_distance"]'
STOP = '#lens-strip input[type=range][data-path="camera.f_number"]'


def known(page: Any, path: str) -> Any:
    return page.evaluate(f"studio.values['{path}']")


@pytest.mark.everyday
def test_the_lens_is_at_hand_above_the_picture(page: Any) -> None:
    scene = clsco.parse_scene(SMALL)
    before = page.locator("#in-focus").inner_text()
    near, far = (lens_line(scene)[end] for end in ("near", "far"))
    assert before == f"sharp {near:.4g} – {far:.4g} mm, {far - near:.3g} mm deep"
    page.locator(FOCUS).fill("233.4567")
    page.wait_for_function("studio.values['camera.focus_distance'] === 233.4567")
    page.locator(STOP).focus()  # the box is left: it shows what means something
    page.wait_for_function(f"document.querySelector('{FOCUS}').value === '233.46'")
    page.locator(FOCUS).focus()
    assert page.locator(FOCUS).input_value() == "233.4567"
    assert number(page, "camera.focus_distance") == 233.4567  # that of the panel is the same
    page.locator(STOP).focus()
    for wanted in (2.2, 2.5, 2.8):  # thirds of a stop from f/2
        page.keyboard.press("ArrowRight")
        page.wait_for_function(f"studio.values['camera.f_number'] === {wanted}")
    scene = scene.replace("camera.focus_distance", 233.4567).replace("camera.f_number", 2.8)
    near, far = (lens_line(scene)[end] for end in ("near", "far"))
    page.wait_for_function(f"document.querySelector('#in-focus').textContent.includes('{near:.4g} – {far:.4g} mm')")
    rest(page)
    page.locator("#focus").click()
    place = page.locator("#canvas").bounding_box()
    page.mouse.click(place["x"] + place["width"] / 2, place["y"] + place["height"] / 2)
    (plane,) = scene.objects
    assert isinstance(plane, clsco.Plane)
    page.wait_for_function(f"studio.values['camera.focus_distance'] === {plane.distance}")
    assert axe_faults(page) == []


def test_strip_and_header_are_in_reach_on_a_small_screen(running: Running) -> None:
    """Also with the panels or the side open, which buttons of the header close again."""

    def assert_in_reach(element: Any) -> None:
        place = element.bounding_box()
        assert place["x"] >= 0
        assert place["x"] + place["width"] <= 390

    with opened(running, 390, 800) as page:
        for path in ("camera.focus_distance", "camera.f_number", "camera.focal_length"):
            assert_in_reach(page.locator(f'#lens-strip input[data-kind][data-path="{path}"]'))
        assert axe_faults(page) == []
        for name in ("drawer", "inspector"):
            page.locator(f"#{name}").click()
            for button in page.locator("#studio > header button:visible").all():
                assert_in_reach(button)
            page.locator(f"#{name}").click(timeout=2000)


def test_what_does_nothing_is_disabled_and_says_why(page: Any) -> None:
    page.locator("summary", has_text="PSF and method").click()
    assert box(page, "psf.sigma_ratio").is_disabled()
    place = page.locator('#panels .live:has([data-path="psf.sigma_ratio"])')
    assert place.get_attribute("data-idle") == "only with psf.model = gaussian"
    box(page, "psf.model").select_option("gaussian")
    page.wait_for_function("studio.values['psf.model'] === 'gaussian'")
    assert box(page, "psf.sigma_ratio").is_enabled()
    assert place.get_attribute("data-idle") is None
    page.locator("summary", has_text="Sequence and motion").click()
    assert box(page, "sequence.shutter").is_disabled()  # nothing moves
    page.get_by_role("checkbox", name="Translation", exact=True).check()
    box(page, "object.0.motion.velocity.0").wait_for()
    type_in(page, "object.0.motion.velocity.0", "5")
    page.wait_for_function("studio.values.moves")
    assert box(page, "sequence.shutter").is_enabled()


def test_an_empty_box_has_no_place_on_its_slider(page: Any) -> None:
    page.locator("summary", has_text="Stereo").click()
    slider = page.locator('input[type=range][data-path="stereo.baseline"]')
    assert slider.get_attribute("data-empty") == ""
    type_in(page, "stereo.baseline", "4")
    page.wait_for_function("studio.values['stereo.baseline'] === 4")
    assert slider.get_attribute("data-empty") is None
    assert float(slider.input_value()) == pytest.approx(PLACES["log"](4.0))


def test_scales_of_the_page_are_those_of_the_forms(page: Any) -> None:
    for scale, place in PLACES.items():
        for value in (0.7, 3.2, 250.0):
            slider = f'{{ dataset: {{ scale: "{scale}" }} }}'
            assert page.evaluate(f"studio.placeOf({slider}, {value})") == pytest.approx(place(value), rel=1e-12)
    assert SHARP == 0.5


def test_colors_are_light_where_those_of_the_system_are(running: Running) -> None:
    """But around the picture, in which colors are judged."""
    grounds = "[document.body, document.querySelector('#stage')].map((e) => getComputedStyle(e).backgroundColor)"
    with opened(running, scheme="light") as page:
        body, stage = page.evaluate(grounds)
        assert (body, stage) == ("rgb(211, 212, 214)", "rgb(17, 18, 20)")
        assert axe_faults(page) == []
        page.locator("button", has_text="Presets").click()
        assert axe_faults(page) == []
    with opened(running) as page:
        assert page.evaluate(grounds) == ["rgb(27, 28, 30)", stage]
