"""The strip of the lens in Chromium, scales of sliders, and controls that do nothing."""

from __future__ import annotations

from typing import Any

import pytest

import clsco
from clsco.optics.lens import SHARP
from clsco.studio.forms import PLACES
from clsco.studio.lens import lens_line
from tests.studio.browser import SMALL, box, opened, type_in, unfold
from tests.studio.running import Running

pytestmark = pytest.mark.browser
FILES, OPENS = {"scene.toml": SMALL}, "scene.toml"
FOCUS = '#depth input[data-kind][data-path="camera.focus_distance"]'
STOP = '#opening input[type=range][data-path="camera.f_number"]'


@pytest.mark.everyday
def test_the_lens_is_at_hand_above_the_picture(page: Any) -> None:
    scene = clsco.parse_scene(SMALL)
    near, far = (lens_line(scene)[end] for end in ("near", "far"))
    assert page.locator("#in-focus").inner_text() == f"sharp from {near:.3g} to {far:.3g} mm"
    assert page.locator("#deep").inner_text() == f"{far - near:.2g} mm deep"
    page.locator(FOCUS).fill("233.4567")
    page.wait_for_function("studio.values['camera.focus_distance'] === 233.4567")
    page.locator(STOP).focus()  # the box is left: it shows what means something
    page.wait_for_function(f"document.querySelector('{FOCUS}').value === '233.46'")
    page.locator(FOCUS).focus()
    assert page.locator(FOCUS).input_value() == "233.4567"
    page.locator(STOP).focus()
    for wanted in (2.2, 2.5, 2.8):  # thirds of a stop from f/2
        page.keyboard.press("ArrowRight")
        page.wait_for_function(f"studio.values['camera.f_number'] === {wanted}")
    scene = scene.replace("camera.focus_distance", 233.4567).replace("camera.f_number", 2.8)
    near, far = (lens_line(scene)[end] for end in ("near", "far"))
    page.wait_for_function(f"document.querySelector('#in-focus').textContent.includes('{near:.3g} to {far:.3g} mm')")
    page.evaluate("(studio.set('camera.focus_distance', 250), studio.set('camera.pixel_pitch', 0.001))")
    page.locator("#in-focus", has_text="sharp at 250 mm").wait_for()
    assert page.locator("#deep").inner_text() == "0.88 mm deep"
    assert not page.locator("[data-stop='1']").is_visible()
    page.evaluate("(studio.set('aperture.shape', 'polygon'), studio.set('camera.f_number', 1))")
    page.locator("[data-stop='1'][aria-checked=true]").wait_for()
    assert page.locator("#blades path").count() == clsco.Aperture().blades


def test_commands_and_values_are_found_by_words(page: Any) -> None:
    page.keyboard.press("Control+k")
    page.keyboard.type("f number 4")
    page.keyboard.press("Enter")
    page.wait_for_function("studio.values['camera.f_number'] === 4")
    for key, path in (("l", "camera.focus_distance"), ("a", "camera.f_number")):
        page.keyboard.press(key)
        assert page.evaluate("document.activeElement.dataset.path") == path


def test_what_does_nothing_is_disabled_and_says_why(page: Any) -> None:
    unfold(page, "PSF and method")
    assert box(page, "psf.sigma_ratio").is_disabled()
    place = page.locator('#panels .live:has([data-path="psf.sigma_ratio"])')
    assert place.get_attribute("data-idle") == "only with psf.model = gaussian"
    box(page, "psf.model").select_option("gaussian")
    page.wait_for_function("studio.values['psf.model'] === 'gaussian'")
    assert box(page, "psf.sigma_ratio").is_enabled()
    assert place.get_attribute("data-idle") is None
    unfold(page, "Sequence")
    assert box(page, "sequence.shutter").is_disabled()  # nothing moves
    unfold(page, "Motion parameters")
    page.get_by_role("checkbox", name="Translation", exact=True).check()
    box(page, "object.0.motion.velocity.0").wait_for()
    type_in(page, "object.0.motion.velocity.0", "5")
    page.wait_for_function("studio.values.moves")
    assert box(page, "sequence.shutter").is_enabled()


def test_scales_of_the_page_are_those_of_the_forms(page: Any) -> None:
    for scale, place in PLACES.items():
        for value in (0.7, 3.2, 250.0):
            slider = f'{{ dataset: {{ scale: "{scale}" }} }}'
            assert page.evaluate(f"studio.placeOf({slider}, {value})") == pytest.approx(place(value), rel=1e-12)
    assert SHARP == 0.5


def test_colors_are_light_where_those_of_the_system_are(running: Running) -> None:
    """But around the picture, in which colors are judged."""
    grounds = "[document.body, document.querySelector('#studio')].map((e) => getComputedStyle(e).backgroundColor)"
    with opened(running, color_scheme="light") as page:
        body, stage = page.evaluate(grounds)
        assert (body, stage) == ("rgb(220, 220, 220)", "rgb(30, 30, 30)")
        unfold(page, "Sequence")
        page.evaluate("studio.set('sequence.shutter', 0.5)")
        page.locator("[data-idle] > [data-other]").first.wait_for()
        opacities = "(all) => all.map((each) => getComputedStyle(each).opacity)"
        assert set(page.locator("[data-other]").evaluate_all(opacities)) == {"1"}  # dots are 5.7 : 1 on the panel
    with opened(running) as page:
        assert page.evaluate(grounds) == ["rgb(18, 18, 18)", "rgb(12, 12, 12)"]
        page.locator("#theme").click()
        page.reload()
        assert page.evaluate(grounds) == [body, stage]
