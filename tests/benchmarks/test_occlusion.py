"""The benchmark of blurred edges: its judge with several objects, its edges, and its files of figures."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import clsco
from benchmarks.truth.occlusion import EXAMPLES, MODES, Judged, compare, markdown, near_edges, scene_of
from benchmarks.truth.traced import decibels, pinhole_view, update

FOLDER = Path(__file__).resolve().parents[2] / "examples"


def test_every_example_of_occlusion_is_measured() -> None:
    assert {path.stem for path in FOLDER.glob("occlusion_*.toml")} == set(EXAMPLES.values()) - {"sphere"}
    for name in EXAMPLES:
        scene = scene_of(name, "layered", 128)
        assert scene.psf.occlusion == "layered"
        # Blur radii in px as at 512 px: D / p is the same.
        assert scene.camera.aperture_diameter / scene.camera.pixel_pitch == pytest.approx(1000.0, rel=1e-12)
        assert scene.camera.resolution == (128, 128)


def test_edges_are_where_objects_or_depths_change_at_any_moment() -> None:
    objects, depth = np.zeros((2, 20, 30), np.int64), np.full((2, 20, 30), 200.0)
    assert not near_edges(objects, depth, 3).any()
    objects[0, :, 10:] = 1  # between columns 9 and 10
    expected = np.zeros((20, 30), np.bool_)
    expected[:, 6:14] = True
    np.testing.assert_array_equal(near_edges(objects, depth, 3), expected)
    depth[1, 15:] = 203.0  # 1.5 %
    np.testing.assert_array_equal(near_edges(objects, depth, 3), expected)
    depth[1, 15:] = np.inf  # between rows 14 and 15
    expected[11:19] = True
    np.testing.assert_array_equal(near_edges(objects, depth, 3), expected)


@pytest.mark.slow
def test_the_view_of_pixel_centers() -> None:
    still = {"center": [0.0, 0.0, 190.0], "radius": 5.0}
    wall = {"shape": "plane", "distance": 300.0, "bounds": [[-99.0, 99.0], [0.0, 99.0], [-1.0, 1.0]]}
    ball = {"shape": "sphere", **still, "motion": {"velocity": [1e4, 0.0, 0.0]}}
    scene = clsco.parse_scene({"camera": {"resolution": [65, 65], "pixel_pitch": 0.08}, "object": [wall, ball]})
    objects, depth = pinhole_view(scene, [0.0, 1.0])
    assert (objects[0, 32, 32], depth[0, 32, 32]) == (1, pytest.approx(185.0, abs=0.1))  # gone by half of 1 / 8192
    # The ball has left. The upper half, its middle row included, sees the wall, the lower nothing.
    assert (objects[1] == np.where(np.arange(65) <= 32, 0, -1)[:, None]).all()
    assert np.isinf(depth[1, 33:]).all()
    assert set(np.unique(objects[0])) == {-1, 0, 1}


def _report(size: int, scenes: dict[str, Any]) -> dict[str, Any]:
    return {"size": size, "device": "some", "scenes": scenes}


def _scene(**settings: float) -> dict[str, Any]:
    rows = {name: {"psnr": value, "psnr_edges": value - 3, "seconds": value / 10} for name, value in settings.items()}
    return {"noise": 1e-4, "noise_edges": 1e-3, "settings": rows}


def test_figures_that_were_not_measured_now_are_kept(tmp_path: Path) -> None:
    path = tmp_path / "sub" / "occlusion.json"
    update(path, _report(512, {"wire": _scene(none=30.0)}), EXAMPLES, markdown)
    update(path, _report(512, {"card": _scene(none=31.0, visibility=62.0)}), EXAMPLES, markdown)
    update(path, _report(512, {"wire": _scene(layered=40.0)}), EXAMPLES, markdown)
    stored = json.loads(path.read_text())["scenes"]
    assert list(stored) == ["card", "wire"]
    assert {mode: row["psnr"] for mode, row in stored["wire"]["settings"].items()} == {"none": 30.0, "layered": 40.0}
    lines = path.with_suffix(".md").read_text().splitlines()
    assert "| card | 80.0 / 60.0 | 31.0 / 28.0 | 3.100 s |  |  | 62.0 / 59.0 | 2.00x |" in lines
    assert len(lines[-1].split("|")) == 2 * len(MODES) + 4
    update(path, _report(64, {"tube": _scene(none=20.0)}), EXAMPLES, markdown)
    assert list(json.loads(path.read_text())["scenes"]) == ["tube"]


def test_errors_near_the_edges() -> None:
    edges = np.zeros((4, 5), np.bool_)
    edges[1] = True
    image, noise = np.where(edges, 0.1, 0.0), np.zeros((2, 4, 5))
    noise[0, 2], noise[1, 3] = 0.05, -0.05  # has no share, as that of two pictures is independent
    figures = compare(image, Judged(noise[0], noise[1], edges, 0.0, 0.0), 2.5)
    # A quarter of the pixels has the error 0.1: 20 dB there, 10 log10(4) more in the whole.
    assert figures.psnr_edges == pytest.approx(20.0, abs=1e-12)
    assert figures.psnr == pytest.approx(20.0 + 10 * math.log10(4), abs=1e-12)
    assert (figures.largest, figures.seconds) == (0.1, 2.5)
    assert decibels(1e-3) == pytest.approx(60.0, abs=1e-12)
