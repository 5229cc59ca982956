"""Polygonal irises on the device: gather, scatter and tiles against their twin, whole scenes, strips, refusals."""

from __future__ import annotations

import numpy as np
import pytest

import clsco
from clsco import reference
from clsco.engine.defocus import defocus
from clsco.errors import SceneError
from clsco.opencl.session import Session
from clsco.optics.psf import weights
from clsco.plan.methods import Blur
from clsco.plan.plan import make_plan
from clsco.reference.layered.layered import layered
from clsco.scene.changes import dump
from clsco.scene.model import Aperture, Psf
from tests.engine.test_defocus import picture
from tests.engine.test_defocus import reference as blurred_by_reference
from tests.kernels.sources import ROUNDING, assert_close, blurred, light
from tests.scenes import scene_from
from tests.slow import mostly_slow

FIGURE = 1e-5  # of white
METHODS: list[Blur] = ["gather", "scatter", "tiles"]
PENTAGON = Aperture(shape="polygon", blades=5, rotation=8.0)


def iris(**keys: object) -> Psf:
    return Psf.model_validate(keys).through(PENTAGON)


SOURCES = mostly_slow([("integrated", "lose"), ("area", "renormalize")], [("integrated", "lose")])


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(("edge", "border"), SOURCES)
def test_every_kind_of_source(session: Session, edge: str, border: str, method: Blur) -> None:
    guard = 0 if border == "renormalize" else 5
    given = light(iris(edge=edge, border=border), shape=(13, 21), guard=guard, channels=3, samples=2)
    limit = 4 * FIGURE if border == "renormalize" else FIGURE  # a share of the light is divided by
    assert_close(blurred(session, given, method), given.expected(), limit)
    assert_close(blurred(session, given, method), blurred(session, given, "scatter"), ROUNDING)


@pytest.mark.parametrize("method", METHODS)
def test_an_image_of_radii_of_both_signs(method: str) -> None:
    image, coc = picture(30, 44)
    coc = coc - 2.5
    psf = iris(occlusion="none")
    found = defocus(image, coc, psf, method=method, outside="black")
    assert coc.min() < -2
    assert coc.max() > 2
    assert np.abs(found - blurred_by_reference(image, coc, psf)).max() < FIGURE
    assert np.abs(found - defocus(image, coc, Psf(), method=method)).max() > 0.01


@pytest.mark.parametrize("radius", [9.3, -9.3])
def test_a_point_of_light_shows_the_iris(radius: float) -> None:
    image = np.zeros((31, 31), np.float32)
    image[15, 15] = 1.0
    span = np.arange(-15.0, 16.0)
    found = defocus(image, np.full(image.shape, radius), iris())
    expected = weights(iris(), span[None, :], span[:, None], np.asarray(radius))
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-7)
    assert found.sum() == pytest.approx(1.0, abs=1e-5)


def test_layers_of_depth() -> None:
    image, coc = picture(30, 44)
    coc[8:20, 10:25] = -6.0
    psf = iris(occlusion="layered")
    values = image.astype(np.float64)[..., None]
    expected, _ = layered(psf, values, coc, np.ones(coc.shape, bool), coc.shape, 0, float(np.abs(coc).max()))
    assert np.abs(defocus(image, coc, psf, outside="black") - expected[..., 0]).max() < FIGURE


OBJECTS = [
    {"shape": "sphere", "center": [-3.0, 1.0, 190.0], "radius": 7.0, "texture": "bricks"},
    {
        "shape": "cylinder",
        "center": [3.0, 0.0, 270.0],
        "radius": 9.0,
        "axis": [0.2, 1.0, 0.0],
        "texture": "siemens_star",
    },
    {"shape": "plane", "distance": 380.0, "texture": "checkerboard"},
]


POLYGON = {
    "camera": {"focus_distance": 250.0, "pixel_pitch": 0.04, "resolution": [40, 28]},
    "aperture": {"shape": "polygon", "blades": 5, "rotation": 8.0},
}


@pytest.mark.parametrize("method", METHODS[:2])
@pytest.mark.parametrize("psf", [{}, {"occlusion": "layered"}], ids=str)
def test_scenes_of_several_objects(psf: dict[str, object], method: str) -> None:
    wanted = scene_from(POLYGON, *OBJECTS, psf=psf)
    (found,), (exact,) = clsco.render(wanted, method=method), reference.render(wanted)
    assert np.abs(found.color - exact.color).max() < FIGURE
    (round_one,) = clsco.render(wanted.model_validate(dump(wanted) | {"aperture": {}}), method=method)
    assert np.abs(found.color - round_one.color).max() > 1e-3


@pytest.mark.parametrize("method", METHODS)
def test_a_ball_and_its_silhouette(method: str) -> None:
    wanted = scene_from(POLYGON, *OBJECTS[:1])
    (found,), (exact,) = clsco.render(wanted, method=method), reference.render(wanted)
    assert np.abs(found.color - exact.color).max() < FIGURE


def test_convolution_is_refused() -> None:
    image = np.zeros((16, 16), np.float32)
    refused = r'^method: convolve needs aperture\.shape = "circle"; got polygon$'
    with pytest.raises(SceneError, match=refused):
        defocus(image, np.full(image.shape, 5.0), iris(), method="convolve")
    with pytest.raises(SceneError, match=refused):
        make_plan(scene_from(POLYGON, *OBJECTS[2:]), 1, method="convolve")
    assert make_plan(scene_from(POLYGON, *OBJECTS[2:]), 1).blur in METHODS
