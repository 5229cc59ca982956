"""Random openings of the lens before random scenes: device against reference, strips, precision; examples of lenses."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import clsco
from clsco import reference
from clsco.constants import BAND
from clsco.scene.model import Scene
from tests.kernels.test_pupils import heart
from tests.pipeline.test_strips import memory_for
from tests.slow import mostly_slow

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
FIGURE, SINGLE = 1e-5, 2e-4  # of white
COUNT = 60


def drawn(seed: int) -> tuple[Scene, str]:
    """A scene of up to three objects, and the method of its blur."""
    rng = np.random.default_rng(seed)

    def between(low: float, high: float) -> float:
        return float(rng.uniform(low, high))

    shape = str(rng.choice(["circle", "polygon", "ring", "image"]))
    aperture: dict[str, Any] = {"shape": shape, "exposure": str(rng.choice(["normalized", "area"]))}
    if shape == "polygon":
        bent = between(-0.4, 1.0) if rng.random() < 0.6 else 0.0
        aperture |= {"blades": int(rng.integers(3, 9)), "blade_curvature": bent, "rotation": between(0.0, 90.0)}
    elif shape == "ring":
        aperture["obstruction"] = between(0.1, 0.8)
    elif shape == "image":
        aperture |= {"image": heart(24), "rotation": between(0.0, 360.0)}
    if rng.random() < 0.4:
        aperture["squeeze"] = between(0.6, 2.0)
    cuts = rng.random() < 0.4
    if cuts:
        aperture["rim"] = [{"distance": 40.0, "diameter": between(14.0, 20.0)}, {"distance": -5.0, "diameter": 14.0}]
    occlusion = str(rng.choice(["visibility", "none"] if cuts else ["visibility", "visibility", "layered", "none"]))
    psf = {
        "occlusion": occlusion, "tilt": bool(rng.random() < 0.7), "edge": str(rng.choice(["integrated", "area"])),
        "border": "renormalize" if rng.random() < 0.2 else "lose", "silhouette_samples": int(rng.integers(1, 4)),
    }  # fmt: skip
    ball = {"shape": "sphere", "center": [between(-6, 6), between(-4, 4), between(120, 220)], "radius": between(4, 9)}
    plane = {"shape": "plane", "distance": between(250.0, 500.0), "slope_x": between(-0.8, 0.8), "texture": "bricks"}
    camera = {
        "f_number": between(1.4, 2.4), "focus_distance": between(140.0, 260.0), "pixel_pitch": 0.12,
        "resolution": [int(rng.integers(28, 40)), int(rng.integers(20, 30))],
    }  # fmt: skip
    objects = [plane] if rng.random() < 0.25 else [ball, plane]
    return clsco.parse_scene({"camera": camera, "aperture": aperture, "psf": psf, "object": objects}), str(
        rng.choice(["gather", "scatter"])
    )


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(COUNT))
def test_random_openings_are_those_of_the_reference(seed: int) -> None:
    scene, method = drawn(seed)
    (found,), (exact,) = clsco.render(scene, method=method, truth=()), reference.render(scene)
    limit = 4 * FIGURE if scene.psf.border == "renormalize" else FIGURE
    assert np.abs(found.color - exact.color).max() < limit
    if seed % 3 == 0:
        high = scene.replace("camera.resolution", [24, 3 * BAND])
        (whole,) = clsco.render(high, method=method, truth=())
        memory = memory_for(high, BAND, (), method)
        (strips,) = clsco.render(high, method=method, truth=(), memory=memory)
        assert strips.metadata["strips"] > 1
        np.testing.assert_array_equal(strips.color, whole.color)
    if seed % 3 == 1:
        (single,) = clsco.render(scene, method=method, precision="single", truth=())
        assert np.abs(single.color - found.color).max() < SINGLE


LENSES = ("lens_fast_prime", "lens_coded_aperture", "lens_heart")


@pytest.mark.parametrize("name", mostly_slow(LENSES, LENSES[1:2]))
def test_lens_files(name: str) -> None:
    """In an eighth of their size; the plain lens gives another picture."""
    pitch, (columns, rows) = 8.0, clsco.load_scene(EXAMPLES / f"{name}.toml").camera.frame_size
    scene = clsco.load_scene(EXAMPLES / f"{name}.toml")
    camera = {"resolution": [columns // 8, rows // 8], "pixel_pitch": pitch * scene.camera.pixel_pitch}
    for key, value in camera.items():
        scene = scene.replace(f"camera.{key}", value)
    (found,), (exact,) = clsco.render(scene, truth=()), reference.render(scene)
    assert np.abs(found.color - exact.color).max() < FIGURE
    (plain,) = clsco.render(scene.replace("aperture", {}), truth=())
    assert np.abs(found.color - plain.color).max() > 0.01


def test_a_rim_does_not_cut_what_lies_between_it_and_the_lens() -> None:
    card = {"shape": "rectangle", "center": [1.0, 0.5, 25.0], "size": [9.0, 7.0], "texture": "#ffffff"}
    near = {"camera": {"focus_distance": 60.0, "pixel_pitch": 0.2, "resolution": [48, 36]}, "object": [card]}
    behind = clsco.parse_scene({**near, "aperture": {"rim": [{"distance": 30.0, "diameter": 0.5}]}})
    image, alone = (
        clsco.render_frame(behind, truth=()).color,
        clsco.render_frame(clsco.parse_scene(near), truth=()).color,
    )
    np.testing.assert_array_equal(image, alone)
    (exact,) = clsco.reference.render(behind)
    np.testing.assert_allclose(image, exact.color, rtol=0, atol=1e-5)
