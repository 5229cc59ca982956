"""Frames whose light is diffracted: device against reference, strips, exact convolutions, and beside discs."""

from __future__ import annotations

from functools import partial
from math import log10
from typing import Any

import numpy as np
import pytest

import clsco
from clsco.errors import SceneError
from clsco.inputs.pupils import scene_point_spread
from clsco.optics.pupils.hankel import HankelDiffracted
from clsco.optics.waves import MOST_WAVES, disc_psnr
from clsco.plan.prepare import prepare
from clsco.scene.model import Camera, Scene
from tests.pipeline.common import assert_strips_agree
from tests.scenes import assert_agree, reference_frames, rendered, scene_from
from tests.slow import combined, mostly_slow

CAMERA = {"resolution": [48, 32]}
FACING: Any = {"shape": "plane", "distance": 262.0, "texture": "checkerboard"}
TILTED: Any = {"shape": "plane", "distance": 252.0, "slope_x": 0.8, "texture": "bricks"}  # through the focus
BALL: Any = {"shape": "sphere", "radius": 5.0, "center": [2.0, 0.0, 236.0], "texture": "bricks"}
NEAR: Any = {"shape": "sphere", "radius": 5.0, "center": [2.0, 0.0, 247.0], "texture": "bricks"}
COLORED: Any = {**TILTED, "texture": "#c86432"}
LONG = {"wavelengths": [2500.0] * 3, "tail": 0.04}  # Q = 0.5 px

COMA: Any = {"model": "wave", **LONG, "zernike": {"3,1": 0.2, "2,-2": 0.05}}
HALF: Any = np.tri(9, dtype=np.float32)

scene = partial(scene_from, {"camera": CAMERA, "psf": {"model": "wave"}})
CASES: dict[str, dict[str, Any]] = {
    "facing": {"object": [FACING]},
    "through the focus": {"object": [TILTED]},
    "hidden, wide": {"object": [BALL, {**FACING, "distance": 275.0}]},
    "hidden, wide, far light": {"object": [BALL, {**FACING, "distance": 275.0}], "psf": {"model": "wave", **LONG}},
    "layered": {"object": [BALL, FACING], "psf": {"model": "wave", "occlusion": "layered"}},
    "colors": {"object": [NEAR, COLORED]},
    "coma": {"object": [TILTED], "psf": COMA},
    "spherical, hidden": {"object": [NEAR, TILTED], "psf": {"model": "wave", **LONG, "seidel": {"W040": -0.4}}},
    "coma, hidden, wide": {"object": [BALL, {**FACING, "distance": 275.0}], "psf": COMA},
    "coma, renormalized": {"object": [TILTED], "psf": {**COMA, "border": "renormalize", "rest": "lose"}},
    "blades": {"object": [TILTED], "aperture": {"shape": "polygon", "blades": 5}, "psf": {"model": "wave", **LONG}},
    "blades, hidden": {
        "object": [BALL, {**FACING, "distance": 275.0}],
        "psf": {"model": "wave", **LONG},
        "aperture": {"shape": "polygon", "blades": 7, "blade_curvature": 0.4},
    },
    "image": {
        "object": [NEAR, TILTED],
        "aperture": {"shape": "image", "image": HALF},
        "psf": {"model": "wave", "tail": 0.1},
    },
    "moving": {
        "object": [{**NEAR, "motion": {"velocity": [20.0, 0.0, 10.0]}}, TILTED],
        "sequence": {"frames": 1, "samples": 3, "shutter": 0.05},
    },
}


@pytest.mark.parametrize(("case", "method"), combined(CASES, ("auto", "scatter"), kept=[("image", "auto")]))
def test_device_and_reference_agree(case: str, method: str) -> None:
    wanted = scene(**CASES[case], camera={"resolution": [32, 20]})
    assert_agree(rendered(wanted, method=method), reference_frames(wanted), least=0.0)


IN_STRIPS = ["facing", "through the focus", "hidden, wide, far light", "coma, hidden, wide"]


@pytest.mark.parametrize("case", mostly_slow(IN_STRIPS, ["facing"]))
def test_strips_have_the_bits_of_the_whole(case: str) -> None:
    assert_strips_agree(scene(**CASES[case], camera={"resolution": [48, 200]}))


def psnr(image: np.ndarray[Any, Any], exact: np.ndarray[Any, Any]) -> float:
    return -10.0 * log10(float(np.square(image - exact).mean()))


def inner(image: np.ndarray[Any, Any], border: int = 12) -> np.ndarray[Any, Any]:
    return np.asarray(image[border:-border, border:-border], np.float64)


@pytest.mark.parametrize(
    ("distance", "psf"),
    combined(
        (240.0, 250.0167, 262.0), ("circle", "coma"), kept=[(250.0167, "circle"), (262.0, "circle"), (240.0, "coma")]
    ),
)
def test_a_facing_plane_is_convolved_exactly(distance: float, psf: str) -> None:
    """In focus as well: the Airy spot is no special case."""
    keys = {"model": "wave"} if psf == "circle" else {**COMA, "tail": 0.1}
    wanted = scene(object=[{**FACING, "distance": distance}], camera={"resolution": [64, 48]}, psf=keys)
    (frame,) = rendered(wanted, truth=["sharp", "blur_radius"])
    radius, spread = float(frame.blur_radius[0, 0]), scene_point_spread(prepare(wanted).scene)
    far = spread.reach(abs(radius))
    span = np.arange(-far, far + 1.0)
    weights = spread.weights(span, span[:, None], np.asarray(radius))[::-1, ::-1]  # the sum is over sources
    sharp = np.pad(frame.sharp.astype(np.float64), far)
    rows, columns = frame.color.shape
    exact = np.zeros((rows, columns))
    for i in range(2 * far + 1):
        for j in range(2 * far + 1):
            exact += weights[i, j] * sharp[i : i + rows, j : j + columns]
    assert np.abs(inner(frame.color, far) - inner(exact, far)).max() < 1e-6


@pytest.mark.parametrize(("f_number", "pitch"), mostly_slow([(2.0, 0.01), (2.8, 0.005), (4.0, 0.005)], [(2.8, 0.005)]))
def test_a_disc_differs_as_the_plan_says(f_number: float, pitch: float) -> None:
    place = np.indices((108, 108)) // 18
    squares = np.ascontiguousarray(place.sum(axis=0) % 2, np.float32)
    camera = {"resolution": [108, 108], "f_number": f_number, "focal_length": 20.0, "pixel_pitch": pitch}
    lens = Camera.model_validate(camera)
    unit, scale = 5.4e-4 * f_number / pitch, 20.0 * lens.aperture_diameter / (2.0 * pitch)
    found = []
    for radius in (1.0, 2.0, 4.0):
        distance = 1.0 / (1.0 / 20.0 - 1.0 / 21.739 - radius / scale)
        plane = {**FACING, "distance": distance, "texture": squares}
        (light,) = clsco.render(scene(object=[plane], camera=camera), truth=())
        (disc,) = clsco.render(scene(object=[plane], camera=camera, psf={"model": "pillbox"}), truth=())
        found.append(psnr(disc.color.astype(np.float64), light.color.astype(np.float64)))
    assert min(found) == pytest.approx(disc_psnr(unit), abs=1.5)


@pytest.mark.slow
def test_an_image_by_its_radii() -> None:
    image, radii = np.zeros((32, 40), np.float32), np.full((32, 40), 1.5)
    image[16, 20] = 1.0
    camera = Camera(f_number=8.0, focal_length=20.0, pixel_pitch=0.005)
    blurred = clsco.defocus(image, radii, "wave", camera=camera)
    psf = scene_point_spread(Scene(camera=camera, psf=clsco.Psf(model="wave"), objects=(clsco.Plane(),)))
    span = np.arange(-6.0, 7.0)
    expected = psf.weights(span, span[:, None], np.asarray(1.5))
    assert np.abs(blurred[10:23, 14:27] - expected).max() < 1e-6
    colored = clsco.defocus(np.repeat(image[..., None], 3, axis=2), radii, "wave", camera=camera)
    assert np.abs(colored[..., 1] - blurred).max() < 1e-7
    assert np.ptp(colored[16, 20]) > 1e-3
    with pytest.raises(SceneError, match="camera: must be given"):
        clsco.defocus(image, radii, "wave")


def test_too_many_waves_are_refused() -> None:
    camera = {"resolution": [32, 32], "pixel_pitch": 0.05, "aperture_diameter": 10.0}
    with pytest.raises(SceneError) as error:
        prepare(scene(object=[{**FACING, "distance": 22.0}], camera=camera, psf={"model": "wave", "tail": 0.1}))
    assert error.value.messages[0].startswith(f'psf.model: "wave" takes at most {MOST_WAVES:g} waves of defocus')


def test_the_light_that_is_cut_is_told() -> None:
    (frame,) = rendered(scene(object=[FACING]), truth=())
    spread = scene_point_spread(scene(object=[FACING])).pupil
    assert isinstance(spread, HankelDiffracted)
    assert frame.metadata["light_cut"] == pytest.approx(spread.left_out(3.0), rel=0.3)
    (disc,) = rendered(scene(object=[FACING], psf={"model": "pillbox"}), truth=())
    assert "light_cut" not in disc.metadata


def test_words_of_the_plan() -> None:
    plan = prepare(scene(object=[TILTED])).plan
    (words,) = [dict(step.parameters) for step in plan.passes if step.kind == "blur"]
    assert words["waves"].startswith("Q = 0.108 px, ")
    assert words["disc"] == "would have about 49 dB against waves"
    assert "of the light, beyond" in words["tail"]
    assert words["tables"].endswith("MiB")
    plan = prepare(scene(**CASES["coma"])).plan
    (words,) = [dict(step.parameters) for step in plan.passes if step.kind == "blur"]
    assert words["pupil"] == "512 samples over the diameter, by Fourier transforms"
