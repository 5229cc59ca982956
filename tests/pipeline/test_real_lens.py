"""Lenses that are not thin, from scene to frame: field curvature, focus on a sphere, color, vignetting."""

from __future__ import annotations

import weakref
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import clsco
from clsco.cli.check import compare_frames
from clsco.optics.lens import Lens
from clsco.optics.vignetting import throughput
from clsco.passes import vignetting
from clsco.plan.prepare import prepare
from clsco.scene.model import Camera, Scene
from tests.pipeline.common import SLOPE, assert_strips_agree, lens_points, waves
from tests.scenes import assert_agree, reference_frames, rendered, scene_from
from tests.slow import mostly_slow

CAMERA: dict[str, Any] = {"resolution": [40, 32], "pixel_pitch": 0.1}
BALL: dict[str, Any] = {"shape": "sphere", "center": [0.0, 0.0, 280.0], "radius": 30.0, "texture": "bricks"}
COLORED = BALL | {"texture": "#ff8040"}
WALL: dict[str, Any] = {"shape": "plane", "distance": 290.0, "texture": "siemens_star", "slope_x": 0.3}
MOVING = {"motion": {"velocity": [20.0, 5.0, 0.0], "angular_velocity": [0.0, 0.0, 20.0]}}
EXPOSED = {"samples": 3, "shutter": 0.1, "interval": 0.1}
AXIAL, CURVED, SPHERE = {"axial": [0.2, 0.0, -0.15]}, {"field_curvature": -1 / 30}, {"focus_surface": "sphere"}
DARK: dict[str, Any] = {"vignetting": [-0.3, 0.1, -0.2]}
LATERAL = {"lateral": [1.02, 1.0, 0.97]}
ALL = AXIAL | CURVED | SPHERE
RIMS = {"rim": [{"distance": 20.0, "diameter": 30.0}, {"distance": -10.0, "diameter": 30.0}]}
ZOOM = {"keyframe": [{"time": 0.0, "focal_length": 20.0}, {"time": 0.1, "focal_length": 24.0}]}
WAVES = (0.4, 0.2)
scene = partial(scene_from, {"camera": CAMERA})
SCENES: dict[str, Scene] = {
    "axial": scene(BALL, WALL, lens=AXIAL),
    "all": scene(BALL, WALL, lens=ALL),
    "in focus": scene(WALL | {"slope_x": 0.0, "distance": 250.017}, lens=DARK),
    "dark": scene(BALL, WALL, lens=ALL | DARK),
    "lateral": scene(WALL, lens=LATERAL),
    "lateral and all": scene(BALL | MOVING, WALL, lens=ALL | LATERAL | DARK, sequence=EXPOSED),
    "lateral, layered": scene(BALL, WALL, lens=ALL | LATERAL, psf={"occlusion": "layered"}),
    "zoom": scene(BALL, WALL, lens=ALL | DARK | ZOOM, sequence=EXPOSED),
    "forward": scene(BALL | MOVING, WALL, lens=ALL, sequence=EXPOSED, motion={"warp": "forward"}),
    "sensor": scene(BALL, WALL, lens=ALL, sensor={"mosaic": "rggb"}),
    "map": scene(SLOPE, lens=ALL | DARK, sequence=EXPOSED),
    "map, moving": scene(SLOPE | MOVING, lens=ALL | DARK, sequence=EXPOSED),
    "map, zoom": scene(SLOPE, lens=ALL | DARK | ZOOM, sequence=EXPOSED),
    "map, lateral": scene(SLOPE, lens=ALL | DARK | LATERAL, sequence=EXPOSED),
    "rims": scene(BALL, WALL, lens=ALL | DARK, camera=CAMERA | {"aperture_diameter": 30.0}, aperture=RIMS),
}
FAST = ("lateral", "in focus")


@pytest.mark.parametrize("name", mostly_slow(SCENES, FAST))
def test_device_against_reference(name: str) -> None:
    if SCENES[name].sensor is None:
        assert_agree(rendered(SCENES[name]), reference_frames(SCENES[name]))
        return
    for checked in compare_frames(SCENES[name], None, None):  # a code changes with the last bit of its light
        assert {difference.output for difference in checked.differences} > {"color", "electrons", "raw"}
        assert [difference for difference in checked.differences if not difference.agrees] == []


def test_shares_of_a_time_sample_stay_until_they_are_read(monkeypatch: pytest.MonkeyPatch) -> None:
    """Arrays at addresses that a processor takes them from in place, each spoiled as soon as nothing holds it."""

    @lru_cache(maxsize=1)
    def share(camera: Camera, kind: Any) -> NDArray[np.float32]:
        found = throughput(camera, kind).astype(np.float32)
        room = np.empty(found.nbytes + 256, np.uint8)
        start = -room.ctypes.data % 128
        placed = room[start : start + found.nbytes].view(np.float32).reshape(found.shape)
        placed[:] = found
        weakref.finalize(placed, room.fill, 255)  # no numbers
        return placed

    stop = {"keyframe": [{"time": 0.0, "f_number": 0.4}, {"time": 0.1, "f_number": 0.6}], "vignetting": "natural"}
    wanted = scene(WALL, lens=stop, sequence=EXPOSED)  # a blur that is still under way when the next one begins
    (exact,) = reference_frames(wanted)
    monkeypatch.setattr(vignetting, "_share", share)
    for _ in range(6):
        (frame,) = rendered(wanted, truth=())
        assert np.abs(frame.color - exact.color).max() < 1e-5


@pytest.mark.slow
def test_one_color_is_that_of_its_lens_alone() -> None:
    """Red of a lens with longitudinal color is red of a thin lens with red's focal length, and the same opening."""
    given = scene(COLORED, WALL, lens=AXIAL)
    (found,), wanted = rendered(given), given.replace("lens", {})
    red = wanted.model_copy(update={"camera": wanted.camera.model_copy(update={"focal_length": 20.2})})
    (alone,) = rendered(red)
    np.testing.assert_allclose(found.color[..., 0], alone.color[..., 0], atol=2e-7)
    assert np.abs(found.blur_radius[..., 0] - alone.blur_radius).max() < 1e-5
    (green,) = rendered(wanted)
    np.testing.assert_allclose(found.color[..., 1], green.color[..., 1], atol=2e-7)
    assert (found.blur_radius[..., 1] == green.blur_radius).all()
    assert np.array_equal(found.depth, green.depth)


def test_gray_textures_are_seen_in_color() -> None:
    gray = scene(WALL, lens=AXIAL)
    assert clsco.render_frame(gray, truth=()).color.shape == (32, 40, 3)
    assert clsco.render_frame(gray.replace("lens", {}), truth=()).color.shape == (32, 40)


def test_a_lens_with_nothing_in_it_is_a_thin_one() -> None:
    """To the bit, and without a program or a pass of its own."""
    thin, given = scene(BALL, WALL), scene(BALL, WALL, lens={"axial": [0.0, 0.0, 0.0], "focus_surface": "plane"})
    (one,), (other,) = (rendered(each, truth="blur_radius") for each in (thin, given))
    assert (one.color == other.color).all()
    assert (one.blur_radius == other.blur_radius).all()
    plans = [prepare(each).plan for each in (thin, given)]
    assert plans[0].features() == plans[1].features()
    assert [step.kind for step in plans[0].passes] == [step.kind for step in plans[1].passes]
    assert plans[0].features()["CURVED"] == 0


@pytest.mark.slow
@pytest.mark.processor  # as atomics add up units of the brightest color
def test_colors_apart_have_the_bits_of_colors_together() -> None:
    apart, together = (
        clsco.render_frame(scene(COLORED, WALL, lens=CURVED | axial), truth=())
        for axial in ({"axial": [0.0, 0.0, 1e-12]}, {})
    )
    assert (apart.color == together.color).all()


@pytest.mark.parametrize(
    "psf", mostly_slow([{}, {"occlusion": "layered"}], [{"occlusion": "layered"}]), ids=["visibility", "layered"]
)
def test_strips_have_the_same_bits(psf: dict[str, Any]) -> None:
    tall = scene(BALL, WALL, lens=ALL, psf=psf, camera=CAMERA | {"resolution": [24, 200]})
    assert_strips_agree(tall, ("blur_radius",))


@pytest.mark.slow
def test_coverage_is_that_of_green_light() -> None:
    found = clsco.render_frame(SCENES["all"], truth=("alpha",))
    green = clsco.render_frame(scene(BALL, WALL, lens=CURVED | SPHERE), truth=("alpha",))
    assert np.array_equal(found.alpha, green.alpha)  # type: ignore[arg-type]


@pytest.mark.slow
def test_vignetting_is_a_factor_of_light_after_the_blur() -> None:
    truth = ("alpha", "subframes", "throughput")
    dark, bright = (clsco.render_frame(scene(BALL, WALL, lens=lens), truth=truth) for lens in (DARK, {}))
    share = dark.throughput
    assert share is not None
    assert bright.throughput is None
    assert (dark.color == share * bright.color).all()
    assert (dark.subframes == share * bright.subframes).all()  # type: ignore[operator]
    assert np.array_equal(dark.alpha, bright.alpha)  # type: ignore[arg-type]


def test_a_response_is_darkened_as_the_frame_is() -> None:
    dark, bright = scene(WALL, lens=DARK), scene(WALL)
    share = clsco.render_frame(dark, truth="throughput", color=False).throughput
    assert share is not None
    for where in ((3, 3), (-1, 20)):
        found, wanted = (clsco.response(each, *where) for each in (dark, bright))
        assert wanted.max() > 1e-3
        assert (found == share * wanted).all()


def test_a_response_is_that_of_green_light() -> None:
    found, wanted = clsco.response(scene(WALL, lens=AXIAL), 20, 16), clsco.response(scene(WALL), 20, 16)
    assert (found == wanted).all()


def test_colors_are_of_the_sizes_that_the_lens_says() -> None:
    spot = {"shape": "disc", "center": [16.0, 8.0, 250.017], "radius": 5.0, "texture": "#ffffff"}
    image = clsco.render_frame(scene(spot, lens=LATERAL), truth=()).color.astype(np.float64)
    place = np.stack([np.arange(40) - 19.5, np.zeros(40)]), np.stack([np.zeros(32), 15.5 - np.arange(32)])
    for color, size in enumerate(LATERAL["lateral"]):
        light = image[..., color]
        x, y = light.sum(axis=0) @ place[0][0] / light.sum(), light.sum(axis=1) @ place[1][1] / light.sum()
        wanted = size * 20.0 / 0.1 / 250.017
        assert x == pytest.approx(16.0 * wanted, abs=0.02)
        assert y == pytest.approx(8.0 * wanted, abs=0.02)
        assert light.sum() == pytest.approx(np.pi * (5.0 * wanted) ** 2, rel=2e-3)


def test_radii_follow_the_lens_to_the_corners() -> None:
    wall = {"shape": "plane", "distance": 250.0}
    frame = clsco.render_frame(scene(wall, lens=CURVED | SPHERE), truth="blur_radius", color=False)
    x, y = np.meshgrid((np.arange(40) - 19.5) * 0.1 / 20, (np.arange(32) - 15.5) * 0.1 / 20)
    lens = Lens.of(clsco.Camera(pixel_pitch=0.1), clsco.Lens(**CURVED, **SPHERE))  # type: ignore[arg-type]
    np.testing.assert_allclose(frame.blur_radius, lens.blur_radius(1 / 250.0, x * x + y * y), atol=1e-6)  # type: ignore[arg-type]


def test_a_sphere_in_focus_against_rays_through_the_lens() -> None:
    """Each pixel is the mean of what rays through its point of the sphere meet on a plane behind this."""
    columns, rows, depth = 64, 48, 1000.0
    camera = clsco.Camera(resolution=(columns, rows), pixel_pitch=0.25, focus_distance=250.0, aperture_diameter=40.0)
    row, column = np.indices((rows, columns)).astype(np.float64)
    wall = clsco.Plane(distance=depth, texture=waves(WAVES, row, column, 0).astype(np.float32))
    given = clsco.Scene(camera=camera, objects=(wall,), lens=clsco.Lens(focus_surface="sphere"))
    found = clsco.render_frame(given, truth=()).color[8:-8, 8:-8]
    step = 0.25 / camera.normalization_distance
    x, y = step * (column - 31.5), step * (23.5 - row)
    away = (1.0 / depth - np.sqrt(1.0 + x * x + y * y) / 250.0) / step
    traced = np.zeros((rows, columns))
    for right, up in lens_points(20.0):
        traced += waves(WAVES, row - up * away, column + right * away, 1) / 800
    error = np.abs(found - traced[8:-8, 8:-8])
    assert error.mean() < 4e-4  # of the second order in grad R; radii of K - w cos, a tenth off, have 2.4e-3 and 9.2e-3
    assert error.max() < 1.5e-3
    assert np.ptp(found) > 0.1


def test_an_image_that_would_lie_at_the_lens_is_refused() -> None:
    wall = {"shape": "plane", "distance": 250.0}
    wide = scene(wall, lens={"field_curvature": 0.5}, camera=CAMERA | {"pixel_pitch": 1.0})
    with pytest.raises(clsco.SceneError, match=r"lens.field_curvature: the image of a plane must stay behind the lens"):
        clsco.render_frame(wide)


@pytest.mark.parametrize("lens", [CURVED, {"distortion": [-0.25, 0.05, 0.0], "tangential": [0.01, -0.02]}])
def test_files_of_radii_need_equal_blur(tmp_path: Path, lens: dict[str, Any]) -> None:
    given = {"shape": "depth_map", "depth": str(tmp_path / "none.npy"), "texture": "bricks", "unit": "coc"}
    with pytest.raises(clsco.SceneError, match=r"object\[0\].unit: coc belongs to lenses without field_curvature"):
        scene(given, lens=lens)


@pytest.mark.slow
def test_a_rim_does_not_cut_what_lies_between_it_and_the_lens() -> None:
    card = {"shape": "rectangle", "center": [1.0, 0.5, 25.0], "size": [9.0, 7.0], "texture": "#ffffff"}
    near = {"camera": {"focus_distance": 60.0, "pixel_pitch": 0.2, "resolution": [48, 36]}, "object": [card]}
    behind = clsco.parse_scene({**near, "aperture": {"rim": [{"distance": 30.0, "diameter": 0.5}]}})
    image, alone = (clsco.render_frame(each, truth=()).color for each in (behind, clsco.parse_scene(near)))
    np.testing.assert_array_equal(image, alone)
    (exact,) = reference_frames(behind)
    np.testing.assert_allclose(image, exact.color, rtol=0, atol=1e-5)
