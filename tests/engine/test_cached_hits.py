"""Hits that a `Live` keeps: a scene that differs in one key from the one before it has the bits that it has alone."""

from __future__ import annotations

from typing import Any

import numpy as np

import clsco
from clsco.engine.live import Live
from clsco.scene.model import Camera, Light, Sequence, Sphere
from clsco.scene.quantities import Strict
from tests.scenes import scene_from

BASE: dict[str, Any] = {
    "camera": {"resolution": [24, 18], "pixel_pitch": 0.2},
    "sequence": {"samples": 2, "shutter": 0.5, "interval": 1.0},
    "light": {"direction": [0.0, 1.0, 1.0]},
    "psf": {"silhouette_samples": 1},
}
BALL = {"shape": "sphere", "center": [0.0, 0.0, 280.0], "radius": 16.0, "motion": {"velocity": [9.0, 0.0, 0.0]}}
WALL = {"shape": "plane", "distance": 330.0, "texture": "checkerboard"}
OTHERS: dict[str, Any] = {
    "camera.focal_length": 21.0,
    "camera.f_number": 3.0,
    "camera.focus_distance": 310.0,
    "camera.aperture_diameter": 7.0,
    "camera.sensor_distance": 22.0,
    "camera.normalization_distance": 21.0,
    "camera.pixel_pitch": 0.3,
    "camera.resolution": [20, 18],
    "camera.motion": {"velocity": [20.0, 0.0, 0.0]},
    "camera.shake": {"rotation_rms": 0.5, "band": [0.2, 1.0]},
    "sequence.frames": 2,
    "sequence.interval": 2.0,
    "sequence.shutter": 0.4,
    "sequence.samples": 3,
    "sequence.sampling": "endpoint",
    "sequence.shutter_start": 0.1,
    "sequence.readout": 0.2,
    "light.direction": [1.0, 2.0, 0.5],
    "light.position": [0.0, 50.0, 0.0],
    "light.ambient": 0.5,
    "object[0].texture": "#808080",
    "object[0].rotation": [0.0, 30.0, 0.0],
    "object[0].motion": {"angular_velocity": [0.0, 40.0, 0.0]},
    "object[0].center": [3.0, 0.0, 280.0],
    "object[0].radius": 12.0,
    "object[0].texture_repeats": [3.0],
    "object[0].texture_wrap": "mirror",
}
# Keys that others stand for, that say what belongs together, or that other programs are built for.
ELSEWHERE = {"shape", "bounds", "name", "group", "shutter_curve", "scan"}
ELSEWHERE |= {f"texture_{key}" for key in ("layer", "size", "offset", "angle", "mapping")}


SMALL = np.random.default_rng(5).random((8, 8), np.float32)


def test_each_key_that_hits_depend_on_has_rays_cast_anew() -> None:
    models: dict[str, type[Strict]] = {"camera": Camera, "sequence": Sequence, "light": Light, "object[0]": Sphere}
    keys = {f"{where}.{key}" for where, model in models.items() for key in model.model_fields if key not in ELSEWHERE}
    sides = {key for key in keys if key.rpartition("_")[2] in ("back", "left", "right", "top", "bottom")}
    assert keys - sides <= set(OTHERS)
    base = scene_from(BASE, BALL | {"texture_mapping": "surface", "texture": SMALL, "texture_repeats": [2.0]}, WALL)
    with Live() as live:
        first = live.render(base, truth=())
        for key, value in OTHERS.items():
            scene = base.replace(key, value)
            frame = live.render(scene, truth=())
            alike = key in ("sequence.frames", "sequence.interval")  # which are of later frames
            assert np.array_equal(frame.color, first.color) == alike, key
            np.testing.assert_array_equal(frame.color, clsco.render_frame(scene, truth=()).color, key)
