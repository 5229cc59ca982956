"""Pupils other than a circle on the device: all methods against their twin, whole scenes, refusals."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import clsco
from clsco import reference
from clsco.engine.defocus import defocus
from clsco.errors import SceneError
from clsco.inputs.pupils import load_point_spread, scene_point_spread
from clsco.opencl.session import Session
from clsco.plan.methods import Blur, BlurSpec
from clsco.plan.request import Request
from clsco.reference.blur.blur import prepare_sources, scatter
from clsco.reference.trace.trace import Sources
from clsco.scene.model import Aperture, Psf
from tests.engine.test_defocus import picture
from tests.kernels.sources import ROUNDING, assert_close, blurred, light
from tests.scenes import plan_scene, scene_from
from tests.slow import combined, mostly_slow
from tests.spreads import layered_before_black, spec_of

FIGURE = 1e-5  # of white
METHODS: list[Blur] = ["gather", "scatter", "tiles"]


def heart(count: int = 64) -> NDArray[np.float32]:
    """(x^2 + y^2 - a)^3 < b x^2 y^3, upright."""
    at = (np.arange(count) + 0.5) * 2 / count - 1
    x, y = at[None, :], 0.1 - at[:, None]
    return ((x * x + y * y - 0.35) ** 3 < 1.2 * x * x * y**3).astype(np.float32)


APERTURES = {
    "pentagon": Aperture(shape="polygon", blades=5, rotation=8.0),
    "ring": Aperture(shape="ring", obstruction=0.4),
    "heart": Aperture(shape="image", image=heart()),
    "curved": Aperture(shape="polygon", blades=5, rotation=8.0, blade_curvature=0.5),
    "concave": Aperture(shape="polygon", blades=4, blade_curvature=-0.6, squeeze=0.7),
    "ellipse": Aperture(squeeze=1.6),
    "narrow heart": Aperture(shape="image", image=heart(), rotation=25.0, squeeze=1.4),
}
SOURCES = mostly_slow([("integrated", "lose"), ("area", "renormalize")], [("integrated", "lose")])
SIGNED = ("pentagon", "heart", "curved", "ellipse")
EACH_ONCE = [("pentagon", "gather"), ("ring", "scatter"), ("heart", "tiles")]


@pytest.mark.parametrize(("edge", "border"), SOURCES)
@pytest.mark.parametrize(("name", "method"), combined(APERTURES, METHODS, kept=EACH_ONCE))
def test_every_kind_of_source(session: Session, name: str, edge: str, border: str, method: Blur) -> None:
    guard = 0 if border == "renormalize" else 5
    psf = Psf.model_validate({"edge": edge, "border": border})
    given = light(psf, shape=(13, 21), guard=guard, channels=3, samples=2, aperture=APERTURES[name])
    limit = 4 * FIGURE if border == "renormalize" else FIGURE  # a share of the light is divided by
    assert_close(blurred(session, given, method), given.expected(), limit)
    assert_close(blurred(session, given, method), blurred(session, given, "scatter"), ROUNDING)


def by_reference(image: NDArray[Any], coc: NDArray[Any], spec: BlurSpec) -> NDArray[np.float64]:
    there = np.ones(coc.shape, bool)
    values, ones = np.asarray(image, np.float64)[..., None], np.ones(coc.shape)
    sources = Sources(values, ones, there.astype(np.uint8), coc, prepare_sources(coc, there), there)
    return scatter(spec, sources, None, coc.shape, 0)[..., 0]


@pytest.mark.parametrize(("name", "method"), combined(APERTURES, METHODS, kept=[("pentagon", "gather")]))
def test_an_image_of_radii_of_both_signs(name: str, method: str) -> None:
    image, coc = picture(20, 44)
    coc = 0.9 * coc - 2.2
    psf, aperture = Psf(occlusion="none"), APERTURES[name]
    found = defocus(image, coc, psf, aperture=aperture, method=method, outside="black")
    assert coc.min() < -2
    assert coc.max() > 2
    assert np.abs(found - by_reference(image, coc, spec_of(psf, aperture=aperture))).max() < FIGURE
    assert np.abs(found - defocus(image, coc, Psf(), method=method)).max() > 0.01


@pytest.mark.parametrize("radius", [9.3, -9.3])
@pytest.mark.parametrize("name", APERTURES)
def test_a_point_of_light_shows_the_pupil(name: str, radius: float) -> None:
    image = np.zeros((31, 31), np.float32)
    image[15, 15] = 1.0
    span = np.arange(-15.0, 16.0)
    found = defocus(image, np.full(image.shape, radius), aperture=APERTURES[name])
    expected = load_point_spread(Psf(), APERTURES[name]).weights(span[None, :], span[:, None], np.asarray(radius))
    np.testing.assert_allclose(found, expected, rtol=0, atol=4e-7)
    assert found.sum() == pytest.approx(1.0, abs=1e-5)


@pytest.mark.parametrize("name", mostly_slow(APERTURES, ["pentagon"]))
def test_layers_of_depth(name: str) -> None:
    image, coc = picture(15, 22)
    coc[4:10, 5:12] = -3.0
    spec = spec_of(Psf(), float(np.abs(coc).max()), aperture=APERTURES[name])
    expected, _ = layered_before_black(spec, image.astype(np.float64)[..., None], coc)
    found = defocus(image, coc, {"occlusion": "layered"}, aperture=APERTURES[name], outside="black")
    assert np.abs(found - expected[..., 0]).max() < FIGURE


OBJECTS = [
    {"shape": "sphere", "center": [-3.0, 1.0, 190.0], "radius": 7.0, "texture": "bricks"},
    {"shape": "cylinder", "center": [3, 0, 270], "radius": 9, "axis": [0.2, 1, 0], "texture": "siemens_star"},
    {"shape": "plane", "distance": 380.0, "texture": "checkerboard"},
]
CAMERA = {"camera": {"focus_distance": 250.0, "pixel_pitch": 0.04, "resolution": [40, 28]}}
PENTAGON = CAMERA | {"aperture": {"shape": "polygon", "blades": 5, "rotation": 8.0}}


SCENES = combined(
    APERTURES, ("visibility", "layered"), METHODS[:2],
    kept=[("ring", "visibility", "gather"), ("pentagon", "layered", "gather")],
)  # fmt: skip


@pytest.mark.parametrize(("name", "occlusion", "method"), SCENES)
def test_scenes_of_several_objects(name: str, occlusion: str, method: str) -> None:
    wanted = scene_from(CAMERA | {"aperture": APERTURES[name]}, *OBJECTS, psf={"occlusion": occlusion})
    (found,), (exact,) = clsco.render(wanted, method=method), reference.render(wanted)
    assert np.abs(found.color - exact.color).max() < FIGURE


def test_convolution_takes_a_ring_and_refuses_what_turns_over() -> None:
    image = np.zeros((16, 16), np.float32)
    rule = r"^method: convolve needs an aperture that blurs alike for R and -R; got "
    for name in SIGNED:
        with pytest.raises(SceneError, match=rule):
            defocus(image, np.full(image.shape, 5.0), aperture=APERTURES[name], method="convolve")
    with pytest.raises(SceneError, match=r"got 5 blades$"):
        plan_scene(scene_from(PENTAGON, *OBJECTS[2:]), 1, Request(method="convolve"))
    assert plan_scene(scene_from(PENTAGON, *OBJECTS[2:]), 1).blur in METHODS
    image, spec = picture(40, 50)[0], spec_of(Psf(), 14.3, aperture=APERTURES["ring"])
    radii = np.full(image.shape, 14.3)
    found = defocus(image, radii, aperture=APERTURES["ring"], method="convolve", outside="black")
    assert np.abs(found - by_reference(image, radii, spec)).max() < FIGURE


@pytest.mark.parametrize("name", mostly_slow(["curved", "heart", "ring"], ["ring"]))
def test_a_smaller_opening_is_darker_where_exposure_goes_by_area(name: str) -> None:
    aperture = APERTURES[name]
    area = aperture.model_copy(update={"exposure": "area"})
    wanted = scene_from(CAMERA | {"aperture": aperture}, *OBJECTS, sequence={"samples": 2})
    factor = scene_point_spread(wanted).pupil.light
    assert 0.3 < factor < 0.9
    darker = wanted.replace("aperture", area)
    (bright,), (dark,), (exact,) = clsco.render(wanted), clsco.render(darker), reference.render(darker)
    for output in ("color", "sharp"):
        np.testing.assert_allclose(getattr(dark, output), factor * getattr(bright, output), rtol=0, atol=5e-7)
    assert np.abs(dark.color - exact.color).max() < FIGURE
    assert dark.metadata["exposure"] == factor
    assert "exposure" not in bright.metadata


def test_an_image_is_darker_where_exposure_goes_by_area() -> None:
    image, coc = picture(20, 24)
    ring = Aperture(shape="ring", obstruction=0.5)
    psf = {"occlusion": "none"}
    found = [defocus(image, coc, psf, aperture=ring.model_copy(update={"exposure": e})) for e in ("normalized", "area")]
    np.testing.assert_allclose(found[1], 0.75 * found[0], rtol=0, atol=1e-6)
