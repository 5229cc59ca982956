"""Random scenes of wide blur behind thin, touching and nested objects: the device against the reference, tap by tap."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import clsco
from clsco.cli.check import compare
from clsco.constants import BAND
from clsco.scene.model import Scene
from tests.pipeline.test_strips import memory_for
from tests.scenes import plan_scene, reference_frames, scene_from
from tests.slow import combined, mostly_slow

COUNT, SOME = 40, 8  # of the scenes; the one that `make test` looks at
WIDEST = 11  # px that the largest blur radius has at least


def drawn(number: int) -> Scene:
    """A scene by its number: objects some 285 mm away before a wall, or a photo far away, in focus at 200 mm."""
    rng = np.random.default_rng([39, number])

    def between(low: float, high: float) -> float:
        return float(rng.uniform(low, high))

    def around(x: float, y: float) -> list[list[float]]:
        """Bounds that cut along two axes, one of them at one end."""
        return [[-40.0, 40.0], [-x, y], [-40.0, between(-1.0, 3.0)]]

    place = [between(-8.0, 8.0), between(-6.0, 6.0), between(270.0, 300.0)]
    axis, size = rng.uniform(-1.0, 1.0, 3).tolist(), between(3.0, 7.0)
    turned = {"rotation": rng.uniform(-60.0, 60.0, 3).tolist()}
    kinds: dict[str, dict[str, Any]] = {
        "wire": {"shape": "cylinder", "center": place, "radius": between(0.05, 0.4), "axis": axis},
        "can": {"shape": "cylinder", "center": place, "radius": 0.8 * size, "axis": axis, "bounds": around(4.0, 6.0)},
        "ball": {"shape": "sphere", "center": place, "radius": size},
        "bowl": {"shape": "sphere", "center": place, "radius": 1.2 * size, "bounds": around(30.0, size / 2)},
        "egg": {"shape": "ellipsoid", "center": place, "semi_axes": [size, 1.0, 4.0], **turned},
        "horn": {"shape": "cone", "apex": place, "half_angle": between(10.0, 50.0), "bounds": around(9.0, 9.0)},
        "card": {"shape": "rectangle", "center": place, "size": [2 * size, 7.0], **turned},
        "coin": {"shape": "disc", "center": place, "radius": size, **turned},
    }
    chosen = rng.choice(list(kinds), rng.integers(1, 4), replace=False)
    objects = [kinds[name] | {"texture": rng.choice(["bricks", "checkerboard", "#c0c0c0"])} for name in chosen]
    more = rng.choice(["", "nested", "touching"])
    if more == "nested":
        objects.append({"shape": "sphere", "center": place, "radius": size / 2, "texture": "siemens_star"})
    if more == "touching":
        beside = [place[0] + size, *place[1:]]
        objects.append({"shape": "sphere", "center": beside, "radius": 2.0, "texture": "#ffffff"})
    walls: list[dict[str, Any]] = [
        {"shape": "plane", "distance": 380.0},
        {"shape": "plane", "distance": 380.0, "slope_x": between(-0.6, 0.6), "slope_y": between(-0.6, 0.6)},
        {"shape": "background"},
    ]
    objects.append(walls[number % 3] | {"texture": "checkerboard"})
    pupils: list[dict[str, Any]] = [
        {},
        {"aperture": {"shape": "polygon", "blades": int(rng.integers(3, 8)), "rotation": between(0.0, 90.0)}},
        {"aperture": {"shape": "ring", "obstruction": 0.4}},
    ]
    psfs: list[dict[str, Any]] = [{"edge": "area"}, {"edge": "sampled"}, {"model": "gaussian", "sigma_ratio": 0.4}]
    plain = {"silhouette_samples": int(rng.integers(1, 4)), "tilt": bool(rng.random() < 0.7)}
    far = objects[-1]["shape"] == "background"
    camera = {"resolution": [36, 28], "pixel_pitch": 0.1, "aperture_diameter": between(40.0, 55.0) / (1 + far)}
    return scene_from(
        {
            "camera": camera | {"focus_distance": 200.0},
            "object": objects,
            "psf": plain | (psfs[int(rng.integers(3))] if number % 4 == 3 else {}),
            **(pupils[int(rng.integers(1, 3))] if number % 4 == 1 else {}),
        }
    )


@pytest.mark.parametrize(("number", "precision"), combined(range(COUNT), ("double", "single"), kept=[(SOME, "double")]))
def test_device_against_reference(number: int, precision: Any) -> None:
    """Every pixel."""
    wanted = drawn(number)
    assert plan_scene(wanted, 1).largest_blur > WIDEST
    (exact,) = reference_frames(wanted)
    assert np.ptp(exact.color) > 0.02
    (frame,) = clsco.render(wanted, truth=(), method="gather", precision=precision)
    assert [found for found in compare(frame, exact) if not (found.agrees or found.largest <= 1e-5)] == []


@pytest.mark.parametrize("number", mostly_slow(range(0, COUNT, 8), [SOME]))
def test_strips_have_the_bits_of_the_whole_frame(number: int) -> None:
    """Runs that begin above a strip, or end below it; objects are in the middle one of three."""
    wanted = drawn(number).replace("camera.resolution", [30, 2 * BAND + 20])
    limit = memory_for(wanted, BAND, (), "gather")
    (whole,), (cut,) = (list(clsco.render(wanted, truth=(), method="gather", memory=most)) for most in (None, limit))
    assert (whole.metadata["strips"], cut.metadata["strips"]) == (1, 3)
    np.testing.assert_array_equal(cut.color, whole.color)
