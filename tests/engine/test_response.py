"""Response of a frame to one source: by linearity, against the reference, and at the border."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import clsco
from clsco.engine.response import isolate_source
from clsco.optics.point_spread import point_spread
from clsco.scene.model import Scene
from tests.scenes import scene_from
from tests.slow import mostly_slow

TABLES: dict[str, Any] = {
    "camera": {"resolution": [14, 11], "pixel_pitch": 0.05, "aperture_diameter": 8.0},
    "sequence": {"samples": 3, "shutter": 0.2},
}
BALL = {"shape": "sphere", "center": [0.0, 0.0, 280.0], "radius": 3.0}
WALL = {"shape": "plane", "distance": 330.0, "slope_x": 0.3}
MOVING = BALL | {"motion": {"velocity": [10.0, 0.0, 0.0]}}
WITHOUT = {"border": "renormalize"}
SCENES = {
    "visibility": scene_from(TABLES, BALL, WALL),
    "moving": scene_from(TABLES, MOVING, WALL),
    "renormalize": scene_from(TABLES, BALL, WALL, psf=WITHOUT),
    "layered": scene_from(TABLES, BALL, WALL, psf={"occlusion": "layered", **WITHOUT}),
    "forward": scene_from(TABLES, WALL | {"motion": {"velocity": [0.0, 0.0, 20.0]}}, motion={"warp": "forward"}),
    "hexagon": scene_from(TABLES, BALL, WALL, aperture={"shape": "polygon", "blades": 6}),
    "depth map": scene_from(TABLES, {"shape": "depth_map", "depth": np.linspace(200.0, 320.0, 154).reshape(11, 14)}),
}


def textured(scene: Scene, textures: list[Any]) -> Scene:
    for number, texture in enumerate(textures):
        scene = scene.replace(f"object.{number}.texture", texture)
    return scene


@pytest.mark.parametrize("name", mostly_slow(list(SCENES), ["visibility"]))
def test_a_frame_is_the_sum_of_its_sources(name: str) -> None:
    scene, random = SCENES[name], np.random.default_rng(3)
    # With texels in the middle alone, none of the mirrored ones beyond the frame are in it.
    inner = slice(None) if scene.psf.border == "renormalize" or not scene.is_analytic else slice(5, 7)
    textures = [np.zeros((11, 14), np.float32) for _ in scene.objects]
    for texture in textures:
        texture[inner, inner] = random.random(texture[inner, inner].shape)
    found = np.zeros((11, 14))
    with clsco.Live() as live:
        frame = live.render(textured(scene, textures), truth=()).color
        for item, texture in enumerate(textures):
            for row, column in zip(*np.nonzero(texture), strict=True):
                found += texture[row, column] * live.response(scene, int(column), int(row), item=item)
    assert frame.max() > 0.05
    np.testing.assert_allclose(found, frame, atol=2e-6)


@pytest.mark.parametrize("name", mostly_slow(list(SCENES), ["moving"]))
def test_the_reference_has_the_same_response(name: str) -> None:
    scene = SCENES[name]
    for x, y, item in ((7, 5, 0), (1, 2, len(scene.objects) - 1)):
        lit = isolate_source(scene, x, y, item=item)
        exact = lit.inside(next(clsco.reference.render(lit.scene)))
        np.testing.assert_allclose(clsco.response(scene, x, y, item=item), exact, atol=2e-6)


def test_the_light_of_the_border_is_lost_and_that_beside_the_frame_comes_in() -> None:
    scene = scene_from(TABLES, WALL | {"slope_x": 0.0})
    radius = clsco.render_frame(scene).blur_radius
    assert radius is not None
    offset = np.arange(-12.0, 13.0)
    spread = point_spread(scene.psf).weights(offset, offset[:, None], radius[5, 7])  # of the source at (12, 12)
    for x, y in ((7, 5), (0, 5), (13, 0), (-2, 5)):
        expected = spread[12 - y : 23 - y, np.clip(np.arange(14) - x + 12, 0, 24)]
        np.testing.assert_allclose(clsco.response(scene, x, y), expected, atol=2e-6)
    assert clsco.response(scene, 7, 5).sum() == pytest.approx(1.0, abs=1e-5)
    assert clsco.response(scene, 0, 5).sum() < 0.8


@pytest.mark.slow
def test_a_response_has_the_way_of_its_source_and_none_of_the_texture() -> None:
    scene = SCENES["moving"].replace("camera.aperture_diameter", 0.5)
    moved = clsco.response(scene, 7, 5)
    still = clsco.response(scene.replace("object.0.motion", {}), 7, 5)
    assert (moved > 0.01).sum(axis=1).max() > 2 * (still > 0.01).sum(axis=1).max()  # along x
    lying = {"texture_mapping": "surface", "texture": "#c86432"}
    other = scene_from(
        TABLES, MOVING | lying, WALL, light={"direction": [0.0, 0.0, 1.0]}, camera={"aperture_diameter": 0.5}
    )
    np.testing.assert_allclose(clsco.response(other, 7, 5), moved, atol=2e-6)


SKY = {"shape": "background", "texture": "checkerboard"}
DOT = {"shape": "disc", "center": [0.0, 0.0, 280.0], "radius": 3.0}
EVEN = {"shape": "depth_map", "depth": np.full((11, 14), 290.0)}
FALLING = EVEN | {"depth": np.linspace(260.0, 320.0, 154).reshape(11, 14)}  # near above, far below


@pytest.mark.parametrize(
    ("objects", "pixel", "number"),
    [
        ((WALL, BALL), (7, 5), 1),
        ((WALL, BALL), (0, 0), 0),
        ((WALL, BALL), (-1, 5), 0),  # beside the frame
        ((BALL, SKY), (7, 5), 0),
        ((SKY, BALL), (0, 10), 0),
        ((WALL, DOT | {"motion": {"velocity": [90.0, 0.0, 0.0]}}), (7, 5), 1),  # gone later
        ((EVEN, FALLING), (7, 1), 1),
        ((EVEN, FALLING), (7, 9), 0),
    ],
)
def test_a_source_is_on_the_object_that_is_seen(objects: Any, pixel: tuple[int, int], number: int) -> None:
    scene = scene_from(TABLES, *objects, sequence={"frames": 2, "interval": 1.0, "shutter": 0.2})
    for index in (0, 1):
        lit = isolate_source(scene, *pixel, index).scene.objects
        assert [not isinstance(item.texture, str) for item in lit] == [k == number for k in range(len(lit))]


def test_the_response_without_a_number_is_that_of_what_is_seen() -> None:
    scene = scene_from(TABLES, WALL, BALL)
    expected = clsco.response(scene, 7, 5, item=1)
    assert expected.max() > 0
    np.testing.assert_array_equal(clsco.response(scene, 7, 5), expected)
    with clsco.Live() as live:
        np.testing.assert_array_equal(live.response(scene, 7, 5), expected)


def test_a_source_must_be_somewhere() -> None:
    scene = scene_from(TABLES, BALL)
    with pytest.raises(clsco.SceneError, match="x, y: must be on a surface at t = 0; got nothing at 0, 10"):
        clsco.response(scene, 0, 10)
    assert clsco.response(scene, 0, 10, item=0).max() == 0.0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((14 + 99, 0), "x: must be a whole number from"),
        ((0, 1.5), "y: must be a whole number from"),
        ((0, 0, 1), "frames: must lie from 0 to 0; got 1"),
    ],
)
def test_what_is_no_source_is_refused(arguments: tuple[Any, ...], message: str) -> None:
    with pytest.raises(clsco.SceneError, match=message):
        clsco.response(SCENES["visibility"], *arguments)
    with pytest.raises(clsco.SceneError, match="x: must be a whole number from 0 to 13; got -1"):
        clsco.response(SCENES["renormalize"], -1, 0)
    with pytest.raises(clsco.SceneError, match="item: must be a whole number from 0 to 1; got 2"):
        clsco.response(SCENES["visibility"], 0, 0, item=2)
