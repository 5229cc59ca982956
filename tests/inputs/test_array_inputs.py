"""Scenes with arrays in memory: the frames, plans and records that the same arrays in files give."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import clsco
from clsco.cli.check import compare
from clsco.frame.frame import Frame
from clsco.frame.outputs import ALL_TRUTH
from clsco.frame.provenance import file_digests, record, scene_sha256
from clsco.inputs.files import InputFiles
from clsco.plan.prepare import prepare, prepare_sweep
from clsco.scene.arrays import ArrayInput
from clsco.scene.sweep import parse_sweep
from tests.slow import mostly_slow

ROWS, COLUMNS = 24, 32
RNG = np.random.default_rng(8)
CODES = RNG.integers(0, 256, (ROWS, COLUMNS, 3), np.uint8)
RADIANCE = RNG.random((ROWS, COLUMNS), np.float32)
SMALL = RADIANCE[:9, :7]  # resampled
DEPTH = np.where(np.arange(COLUMNS) < 14, 240.0, 300.0) + np.zeros((ROWS, 1))
CAMERA = {"pixel_pitch": 0.2, "aperture_diameter": 12.0}
MOVING = {"velocity": [9.0, 0.0, 0.0]}
MAP = {"shape": "depth_map", "depth": DEPTH, "texture": CODES}
SCENES: dict[str, dict[str, Any]] = {
    "size of a texture": {"object": [{"shape": "plane", "texture": CODES}]},
    "several": {
        "camera": {"resolution": [COLUMNS, ROWS]},
        "object": [{"shape": "sphere", "radius": 16.0, "texture": SMALL}, {"shape": "plane", "texture": RADIANCE}],
    },
    "linear codes": {"object": [{"shape": "plane", "texture": CODES}], "image": {"transfer": "linear"}},
    "depth map": {"object": [MAP]},
    "moving map": {"object": [MAP | {"motion": MOVING}], "sequence": {"samples": 2}},
    "stereo": {"object": [MAP | {"unit": "m", "depth": DEPTH / 1000}], "stereo": {"baseline": 4.0}},
}


def scene_with(name: str, folder: Path | None = None) -> clsco.Scene:
    """A scene with its arrays in memory, or in files of a folder."""
    data = {**SCENES[name], "camera": CAMERA | SCENES[name].get("camera", {})}
    if folder is not None:
        data["object"] = [dict(item) for item in data["object"]]
        for k, item in enumerate(data["object"]):
            for key in {"texture", "depth"} & item.keys():
                np.save(folder / f"{k}_{key}.npy", item[key])
                item[key] = folder / f"{k}_{key}.npy"
    return clsco.parse_scene(data)


def same(one: Frame, other: Frame) -> None:
    for name in ("color", *ALL_TRUTH):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), name)


@pytest.mark.parametrize("name", mostly_slow(SCENES, ["size of a texture", "moving map"]))
def test_frames_have_the_bits_of_files(name: str, tmp_path: Path) -> None:
    scene, from_files = scene_with(name), scene_with(name, tmp_path)
    for one, other in zip(clsco.render(scene), clsco.render(from_files), strict=True):
        same(one, other)
        assert one.metadata["bits"] == other.metadata["bits"]


@pytest.mark.parametrize("name", mostly_slow(SCENES, ["depth map", "moving map"]))
def test_the_reference_takes_arrays(name: str) -> None:
    scene = scene_with(name)
    for frame, exact in zip(clsco.render(scene), clsco.reference.render(scene), strict=True):
        assert [loaded.count for loaded in compare(frame, exact)] == [0] * len(compare(frame, exact))


def test_live_keeps_arrays_by_content() -> None:
    scene = scene_with("size of a texture")
    with clsco.Live() as live:
        same(live.render(scene), clsco.render_frame(scene))
        darker = scene.replace("object[0].texture", CODES // 2)
        same(live.render(darker), clsco.render_frame(darker))
        assert live.render(darker).color.mean() < 0.5 * live.render(scene).color.mean()
        cached = live.files.cache.bytes
        same(live.render(scene.replace("object[0].texture", CODES.copy())), clsco.render_frame(scene))
        assert live.files.cache.bytes == cached


def test_a_texture_is_decoded_once() -> None:
    files = InputFiles()
    one, other = (clsco.Plane(texture=CODES.copy()).inputs()["texture"] for _ in range(2))
    loaded = [files.texture(source, "srgb", (ROWS, COLUMNS)) for source in (one, other)]
    assert loaded[0].radiance is loaded[1].radiance
    assert files.texture(one, "linear", (ROWS, COLUMNS)).radiance is not loaded[0].radiance


def test_a_sweep_shares_its_arrays() -> None:
    sweep = parse_sweep({"camera": {"pixel_pitch": 0.2, "f_number": np.array([2.0, 4.0])}, "object": [MAP]})
    sources = [scene.objects[0].inputs() for scene in sweep.scenes]
    assert sources[0] == sources[1]
    assert [each.plan.columns for each in prepare_sweep(sweep)] == [COLUMNS, COLUMNS]
    frames = dict(clsco.render_sweep(sweep, truth=()))
    assert not np.array_equal(frames[0].color, frames[1].color)


def test_plans_know_size_and_channels() -> None:
    plan = prepare(scene_with("size of a texture")).plan
    assert (plan.columns, plan.rows, plan.channels) == (COLUMNS, ROWS, 3)
    assert prepare(scene_with("several")).plan.channels == 1


def test_the_record_has_the_hash_of_the_content() -> None:
    scene = scene_with("depth map")
    about = json.loads(json.dumps(record(scene), allow_nan=False))
    (item,) = about["scene"]["object"]
    texture, depth = (scene.objects[0].inputs()[key] for key in ("texture", "depth"))
    assert isinstance(texture, ArrayInput)
    assert isinstance(depth, ArrayInput)
    assert item["texture"] == f"array of uint8 (24, 32, 3), sha256 {texture.sha256[:16]}"
    assert about["textures_sha256"] == {item["texture"]: texture.sha256}
    assert about["depths_sha256"] == {item["depth"]: depth.sha256}
    assert file_digests([scene]) == {}
    assert scene_sha256(scene) == scene_sha256(scene_with("depth map"))
    assert scene_sha256(scene) != scene_sha256(scene.replace("object[0].depth", DEPTH + 1))


def test_depths_that_do_not_fit_are_refused_by_their_key() -> None:
    scene = clsco.parse_scene({"camera": {"resolution": [9, 8]}, "object": [MAP]})
    with pytest.raises(clsco.SceneError, match=r"^object\[0\].depth: array of float64 \(24, 32\), \w+ \w+: the size"):
        prepare(scene)
    with pytest.raises(clsco.SceneError, match=r"at least one pixel must have a depth; got 768 zero"):
        prepare(scene_with("depth map").replace("object[0].depth", np.zeros((ROWS, COLUMNS), np.uint16)))
