"""The benchmark of blurred edges: its judge with several objects, its edges, and its files of figures."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import clsco
from benchmarks.truth.occlusion import EXAMPLES, MODES, Judged, compare, markdown, near_edges, scene_of
from benchmarks.truth.traced import decibels, pinhole_view, rms, update
from clsco.truth.judge import trace_frame
from clsco.truth.problem import make_problem

Array = NDArray[np.float64]
FOLDER = Path(__file__).resolve().parents[2] / "examples"
SIZE, RAYS = 8, 20_000
# The view of the examples on 8 x 8 px; through a lens of 60 mm R is up to 3 px, and much of every flank is seen.
SMALL = (f"camera.resolution=[{SIZE}, {SIZE}]", "camera.pixel_pitch=0.64", "camera.aperture_diameter=60.0")


def _roots(a: Array, b: Array, c: Array) -> list[Array]:
    """Both roots of a t^2 + 2 b t + c, no number where there are none."""
    with np.errstate(invalid="ignore"):
        root = np.sqrt(b * b - a * c)
    return [(-b - root) / a, (-b + root) / a]


def _meetings(item: Any, start: Array, direction: Array) -> list[Array]:
    """Places where lines meet a surface at rest, as multiples of `direction` (rays, 3) from `start`; vector algebra."""
    if item.shape == "plane":
        normal = np.array([item.slope_x, item.slope_y, -1.0])
        return [-(start @ normal + item.distance) / (direction @ normal)]
    across, along = start - item.center, direction
    if item.shape == "cylinder":
        axis = np.asarray(item.axis) / np.linalg.norm(item.axis)
        across, along = np.cross(across, axis), np.cross(along, axis)
    a, b = (along**2).sum(-1), (across * along).sum(-1)
    return _roots(a, b, (across**2).sum(-1) - item.radius**2)


def _brute_force(scene: Any, textures: list[Array], seed: int) -> tuple[Array, Array]:
    """Mean and its standard deviation, (SIZE, SIZE): independent random rays, one object after the other."""
    camera, random = scene.camera, np.random.default_rng(seed)
    focus = 1 / (1 / camera.focal_length - 1 / camera.sensor_distance)
    pitch, s0 = camera.pixel_pitch, camera.normalization_distance
    mirrored = np.concatenate([np.arange(SIZE), np.arange(SIZE)[::-1]])
    mean, deviation = np.zeros((2, SIZE, SIZE))
    for row, column in np.ndindex(SIZE, SIZE):
        # From a point of the lens through the point in focus that the detector's point is the image of.
        x = (column - SIZE / 2 + random.random(RAYS)) * pitch
        y = (SIZE / 2 - row - random.random(RAYS)) * pitch
        radius = camera.aperture_diameter / 2 * np.sqrt(random.random(RAYS))
        turn = 2 * math.pi * random.random(RAYS)
        lens = np.stack([radius * np.cos(turn), radius * np.sin(turn), np.zeros(RAYS)], -1)
        direction = np.stack([x / s0 * focus, y / s0 * focus, np.full(RAYS, focus)], -1) - lens
        drift = scene.sequence.shutter * random.random((RAYS, 1))
        nearest, light = np.full(RAYS, np.inf), np.zeros(RAYS)
        for item, texture in zip(scene.objects, textures, strict=True):
            start = lens - drift * np.asarray(item.motion.velocity)
            origin = (0.0, 0.0, item.distance) if item.shape == "plane" else item.center
            for t in _meetings(item, start, direction):
                point = start + t[:, None] * direction
                box = ((-np.inf, np.inf),) * 3 if item.bounds is None else item.bounds
                low, high = np.transpose(box)
                with np.errstate(invalid="ignore"):
                    inside = ((point - origin >= low) & (point - origin <= high)).all(-1)
                    better = inside & (t > 0) & (t < nearest)
                X, Y, Z = point[better].T
                j = np.floor(s0 * X / Z / pitch + SIZE / 2).astype(int) % (2 * SIZE)
                i = np.floor(SIZE / 2 - s0 * Y / Z / pitch).astype(int) % (2 * SIZE)
                nearest[better], light[better] = t[better], texture[mirrored[i], mirrored[j]]
        mean[row, column], deviation[row, column] = light.mean(), light.std() / math.sqrt(RAYS)
    return mean, deviation


OCCLUDED = [stem for stem in EXAMPLES.values() if stem != "sphere"]


@pytest.mark.slow
@pytest.mark.parametrize("example", OCCLUDED)
def test_the_judge_sees_the_nearest_of_all_objects_with_its_own_texture(example: str) -> None:
    scene, random = clsco.load_scene(FOLDER / f"{example}.toml", SMALL), np.random.default_rng(11)
    textures = [random.random((SIZE, SIZE)) + index for index in range(len(scene.objects))]
    painted = [item.model_copy(update={"texture": each}) for item, each in zip(scene.objects, textures, strict=True)]
    scene = scene.model_copy(update={"objects": tuple(painted)})
    judged, noise = trace_frame(make_problem(scene), 1e-3, 16384)
    mean, deviation = _brute_force(scene, textures, seed=5)
    # Differences of 64 independent pixels, nearly normal: none beyond 5 deviations, and their mean square is 1 within
    # five times sqrt(2 / 64). One ray in fifty that met the wrong object would make 0.02, 3 deviations.
    relative = (judged - mean) / np.hypot(deviation, noise)
    assert rms(deviation) < 6e-3
    assert abs(relative).max() < 5
    assert 0.3 < np.mean(relative**2) < 1 + 5 * math.sqrt(2 / SIZE**2)


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
    image = np.where(edges, 0.1, 0.0)
    figures = compare(image, Judged(np.zeros((4, 5)), edges, 0.0, 0.0), 2.5)
    # A quarter of the pixels has the error 0.1: 20 dB there, 10 log10(4) more in the whole.
    assert figures.psnr_edges == pytest.approx(20.0, abs=1e-12)
    assert figures.psnr == pytest.approx(20.0 + 10 * math.log10(4), abs=1e-12)
    assert (figures.largest, figures.seconds) == (0.1, 2.5)
    assert decibels(1e-3) == pytest.approx(60.0, abs=1e-12)
