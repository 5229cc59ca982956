"""Frames whose aberrations vary over the field: device against reference, strips, and directions in a frame."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import pytest

import clsco
from clsco.optics.point_spread import diffraction_unit
from clsco.plan.prepare import prepare
from clsco.scene.model import Scene
from tests.pipeline.common import assert_strips_agree
from tests.scenes import assert_agree, reference_frames, rendered, scene_from
from tests.slow import combined, mostly_slow

CAMERA, SMALL = {"resolution": [48, 32]}, {"resolution": [32, 20]}
FACING: Any = {"shape": "plane", "distance": 252.0, "texture": "checkerboard"}
TILTED: Any = {"shape": "plane", "distance": 251.0, "slope_x": 0.4, "texture": "bricks"}  # through the focus
NEAR: Any = {"shape": "sphere", "radius": 5.0, "center": [2.0, 0.0, 247.0], "texture": "bricks"}
FIELD: Any = {
    "model": "wave",
    "wavelengths": [2500.0] * 3,  # Q = 0.5 px
    "tail": 0.04,
    "seidel": {"W131": 0.12, "W222": 0.08, "W220": -0.02},
}
BY_RAYS: Any = {"wavelengths": FIELD["wavelengths"], "seidel": FIELD["seidel"], "silhouette_samples": 2}
rays = partial(scene_from, {"camera": CAMERA, "psf": BY_RAYS})
scene = partial(scene_from, {"camera": CAMERA, "psf": FIELD})
small = partial(scene, camera=SMALL)
CASES: dict[str, Scene] = {
    "facing": small(object=[FACING]),
    "through the focus": small(object=[TILTED]),
    "hidden": small(object=[NEAR, FACING]),
    "renormalized": small(object=[TILTED], psf={"border": "renormalize"}),
    "layered": small(object=[NEAR, FACING], psf={"occlusion": "layered"}),
    "colors": small(object=[{**FACING, "texture": "#c86432"}], psf={"wavelengths": [2600.0, 2500.0, 2200.0]}),
    "blades": small(object=[FACING], aperture={"shape": "polygon", "blades": 5}),
    "moving": small(
        object=[{**NEAR, "motion": {"velocity": [20.0, 0.0, 0.0]}}, FACING],
        sequence={"frames": 1, "samples": 2, "shutter": 0.05},
    ),
    "rays": rays(object=[TILTED], camera=SMALL),
    "rays, hidden": rays(object=[NEAR, FACING]),
    "rays, hidden, blades": rays(object=[NEAR, FACING], aperture={"shape": "polygon", "blades": 5}),
}


@pytest.mark.parametrize(
    ("case", "method"),
    [*combined(CASES, ("auto", "scatter"), kept=[("rays", "auto")]), *mostly_slow([("rays", "tiles")], [])],
)
def test_device_and_reference_agree(case: str, method: str) -> None:
    assert_agree(rendered(CASES[case], method=method), reference_frames(CASES[case]), least=0.0)


def test_strips_have_the_bits_of_the_whole() -> None:
    assert_strips_agree(scene(object=[FACING], camera={"resolution": [48, 100]}))


def test_corners_of_a_frame_mirror_each_other_and_tails_point_outwards() -> None:
    dots = np.zeros((32, 48), np.float32)
    for row in (5, 26):
        for column in (6, 41):
            dots[row, column] = 1.0
    (frame,) = clsco.render(scene(object=[{**FACING, "distance": 250.0167, "texture": dots}]), truth=())
    color = frame.color.astype(np.float64)
    assert color == pytest.approx(color[::-1], abs=1e-6)
    assert color == pytest.approx(color[:, ::-1], abs=1e-6)
    part, place = color[20:, 35:], np.arange(48.0)
    assert (part * place[35:]).sum() / part.sum() > 41.05
    assert (part * np.arange(20.0, 32.0)[:, None]).sum() / part.sum() > 26.03


def test_the_blur_of_a_radius_map_varies_over_its_image() -> None:
    image, radius = np.zeros((25, 33), np.float32), np.full((25, 33), 0.5)
    image[3, 4] = image[12, 16] = 1.0
    camera = {"f_number": 2.0, "focal_length": 20.0, "pixel_pitch": 0.01}
    blurred = clsco.defocus(image, radius, FIELD | {"occlusion": "none"}, camera=camera)
    corner, middle = blurred[:7, :9], blurred[9:16, 12:21]
    assert corner.sum() == pytest.approx(middle.sum(), abs=0.02)
    assert middle == pytest.approx(middle[::-1], abs=1e-6)
    assert (corner * np.arange(9)).sum() / corner.sum() < 3.95


def test_psf_is_that_of_each_place() -> None:
    wanted = scene(object=[FACING])
    stack = clsco.psf(wanted, depths=[252.0])
    assert len(stack.at) == 4
    assert not np.allclose(stack.weights[0, 0], stack.weights[0, 3], atol=1e-3)
    left, right = clsco.psf(wanted, at=[(4.0, 6.0), (43.0, 25.0)], depths=[252.0]).weights[0]
    assert left == pytest.approx(right[:, ::-1, ::-1], abs=1e-6)


def test_a_plan_names_cells() -> None:
    words = dict(prepare(scene(object=[FACING])).plan.passes[-1].parameters)
    assert words["field"] == "4 x 4 cells, between whose corners weights are blended, 0.006 off (L1)"


@pytest.mark.slow
def test_light_stays() -> None:
    wanted = scene(object=[{**FACING, "texture": "#808080"}], psf={**FIELD, "border": "renormalize"})
    sharp = scene(object=wanted.objects, psf={"border": "renormalize"})
    (frame,), (plain,) = clsco.render(wanted, truth=()), clsco.render(sharp, truth=())
    assert frame.color.mean() == pytest.approx(plain.color.mean(), rel=1e-5)


@pytest.mark.parametrize("model", ["pillbox", "wave"])
def test_even_light_stays_even(model: str) -> None:
    """W131 enlarges the image: a frame would lose the fraction 4 Q W131 / corner of its light, 4 %."""
    wall = {**FACING, "distance": 250.0, "texture": "#ffffff"}
    psf = {"model": model, "wavelengths": [2500.0] * 3, "seidel": {"W131": 0.4}}
    frame = clsco.render_frame(scene_from({"psf": psf, "camera": SMALL}, wall), truth=())
    assert frame.color[8:-8, 8:-8].mean() == pytest.approx(1.0, abs=6e-3)


@pytest.mark.parametrize(
    "tables",
    [
        {"psf": {"wavelengths": [540.0] * 3, "seidel": {"W131": 2.0}}},
        {"lens": {"field_curvature": -0.5}},
        {"lens": {"field_curvature": -0.5, "distortion": [-0.5, 0.0, 0.0]}},
    ],
    ids=["coma", "curved", "curved and distorted"],
)
def test_a_card_before_a_wall_of_its_color_is_not_seen(tables: dict[str, Any]) -> None:
    """Occluders are displaced and blurred by the lens at their own position: 3 % would be wrong at the
    outline by coma, and 2.7e-4 of the light by a curved focus.
    """
    card: Any = {"shape": "rectangle", "size": [2.0, 1.5], "center": [0.0, 0.0, 225.0], "texture": "#ffffff"}
    wall = {**FACING, "distance": 400.0, "texture": "#ffffff"}
    camera = {"resolution": [48, 32], "aperture_diameter": 5.0, "pixel_pitch": 0.02, "focus_distance": 250.0}
    frame = clsco.render_frame(scene_from({"camera": camera, **tables}, card, wall), truth=())
    middle = frame.color[6:-6, 6:-6]
    assert middle == pytest.approx(1.0, abs=0.018)
    assert middle.mean() == pytest.approx(1.0, abs=1e-3 if "psf" in tables else 1e-4)


def test_a_plan_names_rays() -> None:
    words = dict(prepare(rays(object=[FACING])).plan.passes[-1].parameters)
    assert words["rays"] == "bent by up to 0.48 px, 192 of them over the diameter"
    assert "waves" not in words


def test_distortion_is_a_term_of_the_wavefront() -> None:
    """Rays in the corner arrive 2 Q W311 px farther out; frames are those of lens.distortion."""
    wide = CAMERA | {"pixel_pitch": 0.1}
    wanted = scene_from({"camera": wide, "psf": {"wavelengths": [2500.0] * 3, "seidel": {"W311": -2.0}}}, TILTED)
    assert wanted.lens is not None
    camera, (k1, *_) = wanted.camera, wanted.lens.radial
    unit = camera.pixel_pitch / camera.normalization_distance
    corner = 0.5 * np.hypot(47.0, 31.0)
    assert k1 * (corner * unit) ** 3 / unit == pytest.approx(2.0 * diffraction_unit(camera, 2500.0) * -2.0)
    assert wanted.replace("psf.seidel.W311", -2.0) == wanted
    same = scene_from({"camera": wide, "lens": {"distortion": [k1, 0.0, 0.0]}}, TILTED)
    frame, expected = (clsco.render_frame(each, truth=("sharp", "blur_radius"), color=False) for each in (wanted, same))
    for name in ("sharp", "blur_radius"):
        np.testing.assert_array_equal(getattr(frame, name), getattr(expected, name))


def test_distortion_of_the_wavefront_needs_a_frame() -> None:
    with pytest.raises(clsco.SceneError, match=r"psf\.seidel\.W311: needs camera\.resolution"):
        clsco.parse_scene({"object": [FACING], "psf": {"seidel": {"W311": 1.0}}})
