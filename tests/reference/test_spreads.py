"""Point spread functions of a scene's lens: the weights that frames are made with, and their axes."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

import clsco
from clsco.errors import SceneError
from clsco.inputs.pupils import scene_point_spread
from clsco.optics.lens import Lens, blur_radius
from clsco.optics.psf_tables import table_weights
from clsco.passes.tables import shared_tables
from clsco.plan.prepare import prepare
from clsco.reference import spreads
from tests.slow import combined

PENTAGON: dict[str, Any] = {"aperture": {"shape": "polygon", "blades": 5, "rotation": 20.0}}
RING: dict[str, Any] = {"aperture": {"shape": "ring", "obstruction": 0.5}}
KINDS: list[dict[str, Any]] = [
    {}, {"psf": {"edge": "area"}}, {"psf": {"edge": "sampled"}}, {"psf": {"model": "gaussian"}},
    {"psf": {"model": "gaussian", "edge": "sampled"}}, PENTAGON, RING,
]  # fmt: skip


def scene_of(distance: float = 300.0, **sections: Any) -> clsco.Scene:
    camera = {"resolution": [40, 32], "pixel_pitch": 0.03} | sections.pop("camera", {})
    return clsco.parse_scene({"camera": camera, "object": [{"shape": "plane", "distance": distance}], **sections})


@pytest.mark.parametrize("sections", KINDS, ids=str)
@pytest.mark.parametrize("distance", [205.0, 251.0, 340.0])
def test_a_source_is_spread_by_them(sections: dict[str, Any], distance: float) -> None:
    scene = scene_of(distance, **sections)
    stack = clsco.psf(scene, at=[(19, 15)], depths=[distance])
    far = stack.reach
    spread = clsco.response(scene, 19, 15)
    np.testing.assert_allclose(
        spread[15 - far : 16 + far, 19 - far : 20 + far], stack.weights[0, 0, 0], atol=1e-6 * spread.max()
    )
    assert spread.sum() == pytest.approx(float(stack.weights.sum()), abs=1e-6)


@pytest.mark.parametrize("sections", KINDS, ids=str)
def test_they_are_those_of_the_tables(sections: dict[str, Any]) -> None:
    spread = scene_point_spread(scene_of(**sections))
    for radius in (-4.3, -0.2, 0.0, 0.7, 6.0):
        table = shared_tables().table(spread, 0.0, 8.0)
        np.testing.assert_array_equal(spreads.spread_weights(spread, radius), table_weights(table, spread, radius))
        found = spreads.spread_weights(spread, radius).astype(np.float64)
        offset = np.arange(-(found.shape[0] // 2), found.shape[0] // 2 + 1.0)
        expected = spread.weights(offset, offset[:, None], np.asarray(radius))
        assert np.abs(found - expected).sum() < 1e-4


def test_axes_of_the_default_go_through_the_focus_as_far_as_the_scene_does() -> None:
    scene = scene_of(400.0)
    stack, lens = clsco.psf(scene), Lens.of(scene.camera)
    assert stack.weights.shape[:3] == (1, 1, 9)
    np.testing.assert_array_equal(stack.at, [[19.5, 15.5]])
    assert np.all(np.diff(stack.depth) > 0.0)
    assert stack.radius[0, 0, 4] == pytest.approx(0.0, abs=1e-12)
    assert stack.radius[0, 0, -1] == pytest.approx(prepare(scene).plan.largest_blur)
    np.testing.assert_allclose(np.diff(1.0 / stack.depth), -stack.radius[0, 0, -1] / 4 / lens.blur_scale)
    np.testing.assert_allclose(stack.radius[0, 0], blur_radius(scene.camera, 1.0 / stack.depth), atol=1e-12)
    np.testing.assert_allclose(stack.weights.sum(axis=(3, 4)), 1.0, atol=1e-6)


@pytest.mark.parametrize(
    ("camera", "last"),
    [
        ({"focus_distance": 2000.0}, 1.667),  # R of infinity, which is less out of focus than the plane
        ({"sensor_distance": 20.0}, 0.0),
        ({"sensor_distance": 19.0}, -8.772),  # nothing is in focus
    ],
)
def test_depths_end_at_infinity(camera: dict[str, float], last: float) -> None:
    scene = scene_of(700.0, camera=camera)
    stack = clsco.psf(scene)
    assert stack.radius[0, 0, 0] == pytest.approx(float(blur_radius(scene.camera, 1 / 700.0)))
    assert stack.radius[0, 0, -1] == pytest.approx(last, abs=1e-3)
    assert stack.depth[-1] == np.inf
    assert len(stack.depth) == 9
    assert np.all(np.diff(stack.depth) > 0.0)


def test_far_and_near_are_turned_over() -> None:
    scene = scene_of(**PENTAGON)
    stack = clsco.psf(scene, depths=[1.0 / (2.0 / scene.camera.focused_distance - 1.0 / 300.0), 300.0])
    near, far = stack.weights[0, 0]
    assert stack.radius[0, 0, 0] == pytest.approx(-stack.radius[0, 0, 1])
    np.testing.assert_allclose(near[::-1, ::-1], far, atol=1e-6)
    assert np.abs(near - far).sum() > 0.1


def test_the_lens_is_that_of_the_frame() -> None:
    keys = [{"time": 0.0, "f_number": 2.0}, {"time": 2.0, "f_number": 4.0}]
    scene = scene_of(lens={"keyframe": keys}, sequence={"frames": 2})
    wide, narrow = (clsco.psf(scene, depths=[300.0], index=index).radius[0, 0, 0] for index in (0, 1))
    assert narrow / wide == pytest.approx(0.3125 / 0.4375)  # 1 / f-number at 1.5 s and at 0.5 s


RULER = {"axial": [0.05, 0.0, -0.05]}
BENT = {"field_curvature": -0.05}


def test_each_color_has_its_own_lens() -> None:
    scene = scene_of(300.0, lens=RULER)
    stack = clsco.psf(scene, at=[(19, 15)], depths=[300.0])
    assert stack.channels == ("red", "green", "blue")
    red, green, blue = stack.radius[:, 0, 0]
    assert red < green - 0.3
    assert blue > green + 0.3
    frame = clsco.render_frame(scene, truth=("blur_radius",))
    assert frame.blur_radius is not None
    np.testing.assert_allclose(frame.blur_radius[15, 19], stack.radius[:, 0, 0], rtol=1e-5)
    far, spread = stack.reach, clsco.response(scene, 19, 15)
    shown = spread[15 - far : 16 + far, 19 - far : 20 + far]  # of green light
    np.testing.assert_allclose(shown, stack.weights[1, 0, 0], atol=1e-6 * spread.max())


@pytest.mark.parametrize("lens", [BENT, {"focus_surface": "sphere"}, BENT | RULER])
def test_the_field_is_an_axis_where_the_blur_depends_on_it(lens: dict[str, Any]) -> None:
    scene = scene_of(300.0, lens=lens)
    stack = clsco.psf(scene, depths=[300.0])
    assert stack.weights.shape[:3] == (3 if "axial" in lens else 1, 4, 1)
    np.testing.assert_allclose(stack.at, [[19.5, 15.5], [26.0, 62.0 / 3], [32.5, 77.5 / 3], [39.0, 31.0]])
    assert np.all(np.diff(np.abs(stack.radius[0, :, 0] - stack.radius[0, 0, 0])) > 0.0)
    frame = clsco.render_frame(scene, truth=("blur_radius",))
    assert frame.blur_radius is not None
    np.testing.assert_allclose(np.atleast_1d(frame.blur_radius[31, 39]), stack.radius[:, 3, 0], rtol=1e-5)
    assert clsco.psf(scene_of(300.0, lens={"vignetting": "natural"})).weights.shape[:2] == (1, 1)


BLADES = {"shape": "polygon", "blades": 5}
RIMS = [{"distance": 12.0, "diameter": 12.0}, {"distance": -6.0, "diameter": 9.0}]


@pytest.mark.parametrize(
    ("distance", "shape"), combined([180.0, 258.0, 420.0], [{}, BLADES], kept=[(258.0, BLADES), (420.0, {})])
)
def test_rims_cut_light_off(distance: float, shape: dict[str, Any]) -> None:
    camera = {"resolution": [48, 40], "pixel_pitch": 0.1, "aperture_diameter": 12.0}
    scene = scene_of(distance, camera=camera, aperture=shape | {"rim": RIMS})
    stack = clsco.psf(scene, at=[(24, 20), (40, 8)], depths=[distance])
    far = stack.reach
    for place, (x, y) in enumerate([(24, 20), (40, 8)]):
        spread = clsco.response(scene, x, y)[y - far : y + far + 1, x - far : x + far + 1]
        np.testing.assert_allclose(spread, stack.weights[0, place, 0], atol=1e-5 * float(spread.max()))
    inside, outside = stack.weights.sum(axis=(-2, -1)).ravel()
    assert outside < 0.98 * inside < 1.0
    assert clsco.psf(scene, depths=[distance]).weights.shape[:3] == (1, 4, 1)


def test_arrays_of_a_file_have_their_units_in_their_names() -> None:
    arrays = clsco.psf(scene_of(), at=[(0, 0), (39, 31)], depths=[300.0, np.inf]).arrays()
    assert {name: array.shape for name, array in arrays.items()} == {
        "weights": (1, 2, 2, 29, 29), "channel": (1,), "at_px": (2, 2), "depth_mm": (2,), "inverse_depth_per_mm": (2,),
        "blur_radius_px": (1, 2, 2), "offset_px": (29,),
    }  # fmt: skip
    assert arrays["inverse_depth_per_mm"][1] == 0.0


OUTSIDE = "psf: at: must be in the frame, columns 0 to 39 and rows 0 to 31"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"at": [(40, 0)]}, f"{OUTSIDE}; got [40.0, 0.0]"),
        ({"at": [(float("nan"), 0)]}, f"{OUTSIDE}; got [nan, 0.0]"),
        ({"depths": []}, "psf: depths must be one or more distances in mm, above 0; got []"),
        ({"depths": [0.0]}, "psf: depths must be one or more distances in mm, above 0; got [0.0]"),
        ({"depths": [0.5]}, "psf: |R| must be at most 512 px; got 6653 px"),
        ({"index": 1}, "psf: frame must be between 0 and 0; got 1"),
    ],
)
def test_what_cannot_be(options: dict[str, Any], message: str) -> None:
    with pytest.raises(SceneError) as caught:
        clsco.psf(scene_of(), **options)
    assert str(caught.value) == message


def test_a_stack_that_is_too_large_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(spreads, "LARGEST_STACK", 2**20)
    with pytest.raises(SceneError, match="psf: must take at most 1 MiB; got 2 MiB: ask for fewer depths"):
        clsco.psf(scene_of(camera={"pixel_pitch": 0.01}), depths=np.linspace(150.0, 200.0, 200).tolist())


WAVES: Any = {"model": "wave", "wavelengths": [2400.0, 2000.0, 1600.0]}


def test_wavelengths_of_colors_give_the_weights_of_colors() -> None:
    scene = scene_of_waves(WAVES)
    colors = clsco.psf(scene, depths=[250.0, 252.0])
    each = clsco.psf(scene, depths=[250.0, 252.0], wavelengths=WAVES["wavelengths"])
    assert each.channels == ("2400 nm", "2000 nm", "1600 nm")
    assert colors.channels == ("red", "green", "blue")
    assert np.array_equal(each.weights, colors.weights)
    assert np.array_equal(each.radius, colors.radius)


def test_an_error_of_the_wavefront_is_a_length_for_all_wavelengths() -> None:
    """The longer waves are, the fewer of them it is, and the rounder the spot."""
    scene = scene_of_waves({**WAVES, "zernike": {"3,1": 0.2}})
    stack = clsco.psf(scene, depths=[250.0], wavelengths=[1500.0, 4000.0])
    short, long = (np.abs(each - each[:, ::-1]).sum() for each in stack.weights[:, 0, 0])
    assert short > 1.3 * long


@pytest.mark.parametrize(
    ("psf", "lens", "wavelengths", "message"),
    [
        ({}, {}, [500.0], 'wavelengths need psf.model = "wave"; got circle'),
        (WAVES, {"lateral": [1.0, 1.0, 1.01]}, [500.0], "wavelengths need lens.axial and lens.lateral"),
        (WAVES, {}, [], "wavelengths must be one or more, in nm; got none"),
        (WAVES, {}, [1.0], "wavelengths must make wavelength s0"),
    ],
)
def test_wavelengths_that_cannot_be(psf: Any, lens: Any, wavelengths: list[float], message: str) -> None:
    with pytest.raises(SceneError, match=re.escape(message)):
        clsco.psf(scene_of_waves(psf, lens), wavelengths=wavelengths)


def scene_of_waves(psf: Any, lens: Any = None) -> clsco.Scene:
    camera = {"resolution": [16, 12], "f_number": 2.0, "focal_length": 20.0, "focus_distance": 250.0}
    found = {"camera": camera, "psf": psf, "object": [{"shape": "plane", "distance": 251.0, "texture": "#c86432"}]}
    return clsco.parse_scene(found | ({"lens": lens} if lens else {}))
