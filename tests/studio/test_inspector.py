"""Figures of a pixel: its point spread function by the model and as measured, and the place of its source."""

from __future__ import annotations

import base64
from typing import Any

import numpy as np
import pytest

import clsco
from clsco.studio.inspector import PLOTTED, figures_of, inspected, overview, point_spread, radius_gradient, source_of
from tests.scenes import scene_from

TABLES: dict[str, Any] = {"camera": {"resolution": [48, 40], "pixel_pitch": 0.05, "aperture_diameter": 40.0}}
WALL = {"shape": "plane", "distance": 300.0, "slope_x": 0.6, "slope_y": -0.3}
BALL = {"shape": "sphere", "center": [0.0, 0.0, 280.0], "radius": 30.0}


def test_the_model_is_what_is_measured_where_nothing_is_in_the_way() -> None:
    scene = scene_from(TABLES, WALL)
    frame = clsco.render_frame(scene)
    found = inspected(frame, scene, 23, 19, is_tilted=True)
    measured = figures_of(clsco.response(scene, 23, 19), 23, 19)
    for name in ("sum", "largest", "centroid", "rms"):
        assert found["psf"][name] == pytest.approx(measured[name], abs=2e-5), name
    assert found["psf"]["plot"] == measured["plot"]
    assert abs(found["psf"]["centroid"][0]) > 0.02  # tilted
    assert np.allclose(point_spread(scene, found["psf"]["radius"], np.zeros(2), (0.0, 0.0), 0.0)["centroid"], 0.0)


def test_rims_cut_off_what_is_measured_as_cut_off() -> None:
    rim = {"distance": 12.0, "diameter": 38.0}
    scene = scene_from(TABLES, WALL, aperture={"rim": [rim]})
    found = inspected(clsco.render_frame(scene), scene, 40, 10, is_tilted=True)
    measured = figures_of(clsco.response(scene, 40, 10), 40, 10)
    assert measured["sum"] < 0.995
    for name in ("sum", "largest", "centroid", "rms"):
        assert found["psf"][name] == pytest.approx(measured[name], abs=2e-4), name


@pytest.mark.parametrize("psf", [{}, {"model": "gaussian"}, {"edge": "sampled"}])
def test_weights_are_those_of_the_command(psf: dict[str, Any]) -> None:
    scene = scene_from(TABLES, WALL | {"slope_x": 0.0, "slope_y": 0.0}, psf=psf)
    found = inspected(clsco.render_frame(scene), scene, 23, 19)
    stack = clsco.psf(scene, depths=[found["values"]["depth"]])
    figures = figures_of(stack.weights[0, 0, 0], stack.reach, stack.reach)
    assert found["psf"]["radius"] == pytest.approx(stack.radius[0, 0, 0], rel=1e-6)
    assert found["psf"]["plot"] == figures["plot"]
    for name in ("sum", "largest", "rms"):
        assert found["psf"][name] == pytest.approx(figures[name], rel=1e-6), name


def test_the_gradient_of_the_radius_is_that_of_its_neighbors() -> None:
    scene = scene_from(TABLES, BALL)
    frame = clsco.render_frame(scene, truth="all")
    assert frame.blur_radius is not None
    radius = frame.blur_radius.astype(np.float64)
    for x, y in ((10, 8), (40, 30), (24, 3)):
        differences = radius[y, x + 1] - radius[y, x - 1], radius[y + 1, x] - radius[y - 1, x]
        assert radius_gradient(frame, scene, x, y) == pytest.approx(np.array(differences) / 2, abs=1e-3)


def test_a_source_is_where_its_point_was_in_the_reference_pose() -> None:
    moving = BALL | {"motion": {"velocity": [10.0, 5.0, 0.0]}}
    scene = scene_from(TABLES, moving, sequence={"frames": 2, "shutter": 0.2})
    frame = clsco.render_frame(scene, 1)
    source = source_of(frame, scene, 30, 18)
    assert not isinstance(source, str)
    depth = float(frame.depth[18, 30])  # type: ignore[index]
    assert source == (round(30 - 11 * 20 / 0.05 / depth), round(18 + 5.5 * 20 / 0.05 / depth), 0)  # at 1.1 s
    assert figures_of(clsco.response(scene, *source[:2], 1), 30, 18)["centroid"] == pytest.approx([0.0, 0.0], abs=0.5)


def test_an_overview_has_depths_of_the_objects_and_small_views() -> None:
    scene = scene_from(TABLES, BALL | {"name": "ball", "radius": 2.0}, WALL)
    frame: Any = clsco.render_frame(scene)
    found = overview(frame, scene)
    assert [entry[0] for entry in found["ranges"]] == ["Ball", "Plane"]
    for number, (_, *depths, _) in enumerate(found["ranges"]):
        assert depths == pytest.approx(np.percentile(frame.depth[frame.object_id == number], (1, 50, 99)), rel=2e-3)
    assert found["ends"] == {"nearest": f"{found['ranges'][0][1]:.4g}", "farthest": f"{found['ranges'][1][3]:.4g}"}
    columns, rows, text = found["views"]["depth"]
    assert np.array_equal(np.frombuffer(base64.b64decode(text), "<f4").reshape(rows, columns), frame.depth)


def test_what_has_no_source_says_why() -> None:
    scene = scene_from(TABLES, BALL | {"radius": 2.0})
    frame = clsco.render_frame(scene)
    assert source_of(frame, scene, 0, 0) == "no surface"
    assert "psf" not in inspected(frame, scene, 0, 0)
    pair = scene_from(TABLES, BALL, stereo={"baseline": 5.0})
    assert inspected(next(iter(clsco.render(pair))), pair, 24, 20)["unmeasured"] == "not of a stereo pair"


def test_figures_of_a_spread() -> None:
    spread = np.zeros((9, 12), np.float32)
    spread[2, 3], spread[2, 7] = 0.25, 0.75
    found = figures_of(spread, 6, 2)
    assert found["sum"] == 1.0
    assert found["centroid"] == [0.0, 0.0]
    assert found["rms"] == pytest.approx([np.sqrt(3.0), 0.0])
    assert found["reach"] == 3
    plot = np.frombuffer(base64.b64decode(found["plot"]), np.uint8).reshape(2 * PLOTTED + 1, -1)
    codes = {(int(y) - PLOTTED, int(x) - PLOTTED): int(plot[y, x]) for y, x in np.argwhere(plot)}
    assert codes == {(0, -3): 85, (0, 1): 255}
    dark = figures_of(np.zeros((3, 3)), 1, 1)
    assert dark["sum"] == 0.0
    assert "centroid" not in dark
