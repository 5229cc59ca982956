"""Rims before and behind the lens: light, moments, what is lost for good, and devices against the twin."""

from __future__ import annotations

from math import acos, pi, sqrt
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import clsco
from clsco import reference
from clsco.constants import BAND
from clsco.errors import SceneError
from clsco.optics.lens import Lens, blur_radius
from clsco.optics.point_spread import point_spread
from clsco.optics.rims import frame_throughput, rim_throughput
from clsco.scene.model import Scene
from tests.pipeline.common import assert_strips_agree
from tests.scenes import scene_from
from tests.slow import combined, mostly_slow

FIGURE = 1e-5  # of white
WIDE: dict[str, Any] = {
    "camera": {"f_number": 2.0, "focus_distance": 100.0, "pixel_pitch": 0.05, "resolution": [150, 52]},
    "sequence": {"samples": 1},
}
DEPTH, SLOPE = 340.0, 0.125  # of a small emitter, mm and X / Z: 50 px to the right


def emitter(rims: list[dict[str, float]], depth: float = DEPTH, slope: float = SLOPE, **psf: Any) -> Scene:
    side = 2.0 * 0.0025 * depth
    item = {"shape": "rectangle", "center": [slope * depth, 0.0, depth], "size": [side, side]}
    psf = {"silhouette_samples": 1} | psf
    return scene_from(WIDE | {"aperture": {"rim": rims}, "psf": psf}, item | {"texture": np.ones((8, 8), np.float32)})


def overlap(radius: float, away: float) -> float:
    """Part of the unit disc in another disc, of this radius and so far away."""
    if away >= 1 + radius:
        return 0.0
    if away <= abs(radius - 1):
        return min(1.0, radius**2)
    one = acos((away**2 + 1 - radius**2) / (2 * away))
    other = acos((away**2 + radius**2 - 1) / (2 * away * radius))
    kite = sqrt((1 + away + radius) * (1 + away - radius) * (1 - away + radius) * (-1 + away + radius))
    return (one + radius**2 * other - 0.5 * kite) / pi


def as_seen(scene: Scene, slope: float = SLOPE, depth: float = DEPTH) -> list[tuple[float, float]]:
    """Centers right of the middle and radii of the rims, in lens radii, by the paths of rays."""
    lens, radius, found = Lens.of(scene.camera), float(blur_radius(scene.camera, 1 / depth)), []
    for rim in scene.aperture.rim:
        d, sensor = rim.distance, scene.camera.sensor_distance
        assert sensor is not None
        arrives = slope * scene.camera.focal_length + radius * 0.05 * np.array([-1.0, 1.0])  # upright, from both edges
        ends = np.array([-lens.radius, lens.radius])
        if d > 0:
            places = ends + (slope * depth - ends) * d / depth
        else:
            places = ends + (-arrives * sensor / scene.camera.focal_length - ends) * -d / sensor
        middle, across = places.mean(), 0.5 * (places[1] - places[0])
        found.append((-middle / across, 0.5 * rim.diameter / abs(across)))
    return found


def light(scene: Scene) -> tuple[float, float, NDArray[np.float64]]:
    """All of it, where its middle is right of the emitter's, px, and its variances."""
    frame = clsco.render_frame(scene, truth=())
    color = frame.color.astype(np.float64)
    x, y = np.arange(150) - 74.5 - 50.0, np.arange(52) - 25.5
    whole, columns, rows = color.sum(), color.sum(axis=0), color.sum(axis=1)
    middle = (columns @ x) / whole if whole else 0.0
    spread = [columns @ (x - middle) ** 2 / whole, rows @ y**2 / whole] if whole else [0.0, 0.0]
    return float(whole), float(middle), np.array(spread)


CUTS = {
    "front": [{"distance": 30.0, "diameter": 11.0}],
    "rear": [{"distance": -8.0, "diameter": 6.5}],
    "both": [{"distance": 20.0, "diameter": 11.0}, {"distance": -5.0, "diameter": 10.0}],
}


@pytest.mark.parametrize("name", mostly_slow(CUTS, ["both"]))
def test_light_and_moments_are_those_of_the_overlap(name: str) -> None:
    """Sources of a disc of 14 px radius: 1 % of the light, 0.1 px, 1 % of the variances; both clip opposite sides."""
    scene, whole = emitter(CUTS[name]), light(emitter([]))
    radius = float(blur_radius(scene.camera, 1 / DEPTH))
    assert radius > 13
    circles = as_seen(scene)
    at = (np.arange(800) + 0.5) / 400 - 1
    x, y = np.meshgrid(at, at)
    passes = x * x + y * y <= 1
    for center, size in circles:
        passes &= (x - center) ** 2 + y * y <= size**2
    share = passes.sum() / (x * x + y * y <= 1).sum()
    if len(circles) == 1:
        assert share == pytest.approx(overlap(circles[0][1], abs(circles[0][0])), abs=1e-3)
    assert 0.2 < share < 0.9
    found, middle, spread = light(scene)
    assert found / whole[0] == pytest.approx(share, rel=0.01)
    assert middle == pytest.approx(radius * x[passes].mean() + whole[1], abs=0.1)
    expected = radius**2 * np.array([x[passes].var() - 0.25, y[passes].var() - 0.25]) + whole[2]
    assert spread == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize("border", mostly_slow(["lose", "renormalize"], ["lose"]))
def test_all_light_may_be_cut(border: str) -> None:
    scene = emitter([{"distance": 60.0, "diameter": 3.0}, {"distance": -5.0, "diameter": 100.0}], border=border)
    (center, size), _ = as_seen(scene)
    assert abs(center) > 1 + size
    (frame,), (exact,) = clsco.render(scene, truth=()), reference.render(scene)
    assert not frame.color.any()
    assert not exact.color.any()


def test_rims_that_are_wide_change_no_bit() -> None:
    wide = [{"distance": 30.0, "diameter": 200.0}, {"distance": -5.0, "diameter": 100.0}]
    (found,), (plain,) = (clsco.render(emitter(rims), truth=(), method="gather") for rims in (wide, []))
    np.testing.assert_array_equal(found.color, plain.color)


NEAR: dict[str, Any] = {
    "camera": {"f_number": 1.0, "focus_distance": 80.0, "pixel_pitch": 0.3, "resolution": [28, 20]},
    "aperture": {"rim": [{"distance": 40.0, "diameter": 24.0}, {"distance": -5.0, "diameter": 19.0}]},
}
BALL = {"shape": "sphere", "center": [-8.0, 3.0, 130.0], "radius": 12.0, "texture": "bricks"}
SLOPED = {"shape": "plane", "distance": 300.0, "slope_x": 0.8, "texture": "checkerboard"}
SCENES: dict[str, Scene] = {
    "tilt": scene_from(NEAR, SLOPED),
    "objects": scene_from(NEAR, BALL, SLOPED),
    "wide, in color": scene_from(
        {
            "aperture": {"rim": [{"distance": 40.0, "diameter": 15.0}, {"distance": -5.0, "diameter": 16.0}]},
            "camera": NEAR["camera"] | {"pixel_pitch": 0.14, "resolution": [22, 10]},
        },
        SLOPED | {"texture": np.random.default_rng(4).random((32, 32, 3), np.float32), "slope_y": -0.3},
    ),
    "pentagon": scene_from(NEAR | {"aperture": NEAR["aperture"] | {"shape": "polygon", "blades": 5}}, BALL, SLOPED),
    "ring": scene_from(NEAR | {"aperture": NEAR["aperture"] | {"shape": "ring", "obstruction": 0.4}}, BALL, SLOPED),
    "gaussian": scene_from(NEAR, BALL, SLOPED, psf={"model": "gaussian"}),
    "not hidden": scene_from(NEAR, BALL, SLOPED, psf={"occlusion": "none", "edge": "area"}),
    "given back": scene_from(NEAR, BALL, SLOPED, psf={"border": "renormalize"}),
}


def image_scene(how: str, occlusion: str) -> Scene:
    """A step of depth before a slanted wall, as a map, or objects of which one moves."""
    row, column = np.indices((20, 28))
    depth = np.where(np.hypot(row - 8, column - 15) < 4.5, 130.0, 280.0 + 2.0 * row + column)
    map_ = {"shape": "depth_map", "depth": depth, "unit": "mm", "texture": "bricks"}
    psf, lens = {"occlusion": occlusion}, {"distortion": [-0.2, 0.0, 0.0], "field_curvature": -0.02}
    moving = {"motion": {"velocity": [30.0, 0.0, 0.0]}}
    if how != "forward":
        return scene_from(NEAR, map_, psf=psf, lens=lens if how == "distorted" else {})
    exposed = {"samples": 2, "shutter": 0.1, "interval": 0.1}
    return scene_from(NEAR, BALL | moving, SLOPED, psf=psf, motion={"warp": "forward"}, sequence=exposed)


SCENES |= {
    f"{how}, {occlusion}": image_scene(how, occlusion)
    for how in ("map", "distorted", "forward")
    for occlusion in ("none", "layered")
}
KEPT = [("objects", "gather"), ("map, layered", "gather")]


@pytest.mark.parametrize(("name", "method"), combined(SCENES, ("gather", "scatter"), kept=KEPT))
def test_scenes_are_those_of_the_twin(name: str, method: str) -> None:
    wanted = SCENES[name]
    (found,), (exact,) = clsco.render(wanted, truth=(), method=method), reference.render(wanted)
    assert np.abs(found.color - exact.color).max() < (4 if name == "given back" else 1) * FIGURE
    assert exact.throughput is not None
    assert exact.throughput.mean() < 0.99


def test_strips_have_the_bits_of_the_whole() -> None:
    assert_strips_agree(SCENES["objects"].replace("camera.resolution", [24, 3 * BAND]))


@pytest.mark.slow
def test_single_precision() -> None:
    double, single = (clsco.render_frame(SCENES["objects"], truth=(), precision=each) for each in ("double", "single"))
    assert np.abs(single.color - double.color).max() < 1e-4


def test_depth_layers_have_the_light_that_rims_let_through() -> None:
    """A step of depth of one brightness is as bright as the lens is open, and behind its edge as well."""
    wanted = SCENES["map, layered"].replace("object[0].texture", "#ffffff")
    frame = clsco.render_frame(wanted, truth="throughput")
    assert frame.throughput is not None
    assert frame.throughput.min() < 0.75
    assert np.abs(frame.color - frame.throughput)[8:-8, 8:-8].max() < 1e-3


def test_refusals() -> None:
    with pytest.raises(SceneError, match=r"^method: tiles needs sources with nothing in their way"):
        list(clsco.render(SCENES["tilt"], method="tiles"))
    with pytest.raises(SceneError, match=r"^aperture\.rim: needs a camera"):
        clsco.defocus(np.ones((4, 4)), np.ones((4, 4)), aperture=SCENES["tilt"].aperture)


BORDERED: dict[str, dict[str, Any]] = {
    "ring": {"shape": "ring", "obstruction": 0.4},
    "hexagon": {"shape": "polygon", "rotation": 8.0},
    "squeezed": {"squeeze": 1.5},
    "concave": {"shape": "polygon", "blades": 5, "blade_curvature": -0.6},
}


@pytest.mark.parametrize(("name", "method"), combined(BORDERED, ("gather", "scatter"), kept=[("hexagon", "gather")]))
def test_an_even_plane_behind_any_opening_is_as_bright_as_it_is_open(name: str, method: str) -> None:
    """Under a front and a rear rim, at |R| of 0.2, 3 and 8 px; a weight that is the product of both shares is off by
    4e-3 to 3e-2."""
    camera = {"aperture_diameter": 10.0, "focus_distance": 250.0, "pixel_pitch": 0.02, "resolution": [24, 24]}
    rims = [{"distance": 35.0, "diameter": 8.5}, {"distance": -10.0, "diameter": 7.5}]
    for radius in (0.2, -3.0, 8.0):
        plane = {"shape": "plane", "distance": 5000.0 / (20.0 - radius), "texture": np.ones((8, 8), np.float32)}
        scene = scene_from({"camera": camera, "aperture": BORDERED[name] | {"rim": rims}}, plane)
        frame = clsco.render_frame(scene, truth="throughput", method=method)
        assert frame.throughput is not None
        assert np.abs(frame.color - frame.throughput)[10:14, 10:14].max() < 2e-3


def test_throughput_is_that_of_the_overlap() -> None:
    scene = emitter(CUTS["front"])
    for depth in (DEPTH, 100.0, 92.0):
        slopes, w = np.array([[0.0, 0.0], [SLOPE, 0.0], [0.0, -SLOPE], [0.5, 0.0]]), np.full(4, 1 / depth)
        psf, radius = point_spread(scene.psf, scene.aperture), blur_radius(scene.camera, w)
        found = rim_throughput(Lens.of(scene.camera), psf, slopes, w, radius)
        circles = [as_seen(scene, slope, depth)[0] for slope in (0.0, SLOPE, SLOPE, 0.5)]
        assert found == pytest.approx([overlap(size, abs(center)) for center, size in circles], abs=1e-4)
        assert found[1] == pytest.approx(found[2], abs=1e-4)
        assert found[3] == 0.0


def test_throughput_of_wide_frames_is_that_of_each_pixel() -> None:
    """At its own point in focus, from where rims cut nothing to where they let nothing through."""
    camera = {"aperture_diameter": 10.0, "focus_distance": 250.0, "pixel_pitch": 0.02, "resolution": [700, 2]}
    scene = scene_from({"camera": camera, "aperture": {"rim": [{"distance": 35.0, "diameter": 11.0}]}}, SLOPED)
    psf, lens = point_spread(scene.psf, scene.aperture), Lens.of(scene.camera)
    slopes = np.stack([(np.arange(700) - 349.5) * 0.02 / 20.0, np.full(700, 0.01 / 20.0)], axis=-1)
    right = rim_throughput(lens, psf, slopes, np.full(700, 1 / 250.0), np.zeros(700))
    assert right.max() == pytest.approx(1.0, abs=1e-5)
    assert right.min() == 0.0
    error = np.abs(frame_throughput(scene, 0.0, psf)[0] - right)
    assert error.max() < 1e-3
    assert error.mean() < 1e-4


@pytest.mark.slow
def test_light_of_an_even_surface_is_the_throughput() -> None:
    """Wherever the surface is, with natural vignetting as well; device and reference."""
    sheet = {"shape": "plane", "texture": np.ones((40, 60), np.float32)}
    camera = {"f_number": 2.0, "focus_distance": 100.0, "pixel_pitch": 0.1, "resolution": [60, 40]}
    for distance, rims in ((300.0, CUTS["front"]), (80.0, CUTS["both"])):
        tables = {"camera": camera, "lens": {"vignetting": "natural"}, "aperture": {"rim": rims}}
        wanted = scene_from(tables, sheet | {"distance": distance})
        (found,), (exact,) = clsco.render(wanted), reference.render(wanted)
        assert found.throughput is not None
        assert found.throughput.min() < 0.8
        assert found.throughput.max() == pytest.approx(1.0, abs=1e-2)
        assert np.abs(found.color - found.throughput)[8:-8, 8:-8].max() < 0.005
        assert exact.throughput is not None
        assert np.abs(found.throughput - exact.throughput).max() <= 1e-6
        bound = FIGURE if distance == 300.0 else 1e-4  # R of 6.7 px and of -2.5 px, which is not wide (WIDE_LENS)
        assert np.abs(found.color - exact.color).max() < bound
