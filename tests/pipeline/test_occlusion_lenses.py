"""A black card before a plane through general lenses: single pixels against sums over lens points and their boxes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import clsco
from clsco.optics.point_spread import point_spread
from clsco.optics.pupils.wavefront import Wavefront

SIZE, POINTS, PARTS = 28, 80, 8
PERIOD = 14.0  # px of the plane's texture
CORNER = (0.6, 0.9)  # mm: the card is to the right of it, and below
AT = np.arange(64) / 64 + 1 / 128 - 0.5
SINE = 0.5 + 0.4 * np.sin(2 * np.pi * AT) * np.sin(-2 * np.pi * AT)[:, None]


def scene_of(plane: float, card: float, textured: bool, sections: dict[str, Any]) -> clsco.Scene:
    camera = {"focal_length": 20.0, "aperture_diameter": 4.0, "focus_distance": 250.0, "pixel_pitch": 0.02}
    mapped = {"texture": SINE, "texture_mapping": "surface", "texture_size": PERIOD * 1e-3 * plane}
    far = {"shape": "plane", "distance": plane, **(mapped if textured else {"texture": "#ffffff"})}
    near = {
        "shape": "plane", "distance": card, "texture": "#000000",
        "bounds": ((CORNER[0], 1e3), (-1e3, CORNER[1]), (-1e4, 1e4)),
    }  # fmt: skip
    return clsco.parse_scene({"camera": {"resolution": [SIZE, SIZE], **camera}, "object": [far, near], **sections})


def right_values(scene: clsco.Scene, textured: bool, row: int, columns: NDArray[np.int64]) -> NDArray[np.float64]:
    """Irradiance in pixels of a row: rays through a lens point l arrive R l + 2 grad W from the place in the image."""
    pupil = point_spread(scene.psf, scene.aperture, camera=scene.camera).pupil
    opening, wavefront = getattr(pupil, "opening", pupil), getattr(pupil, "wavefront", Wavefront())
    at = (2 * np.arange(POINTS) + 1) / POINTS - 1
    x, y = (each.ravel() for each in np.meshgrid(at, at))
    passed = opening.transmission(x, y) > 0
    x, y = x[passed], y[passed]
    bent = wavefront.gradient(x, y)
    inside = (np.arange(PARTS) + 0.5) / PARTS - 0.5 * SIZE
    down, right = (each.ravel()[:, None, None] for each in np.meshgrid(row + inside, inside, indexing="ij"))
    far, near = (item.distance for item in scene.objects)  # type: ignore[union-attr]
    (far_x, far_y), (near_x, near_y) = (
        (
            (right + columns[:, None] - radius * x - 2 * bent[0]) * 1e-3 * distance,
            (down + 0 * columns[:, None] - radius * y - 2 * bent[1]) * -1e-3 * distance,
        )
        for distance in (far, near)
        for radius in [2000.0 * (1 / 250.0 - 1 / distance)]
    )
    cycle = 2 * np.pi / (PERIOD * 1e-3 * far)
    light = 0.5 + 0.4 * np.sin(cycle * far_x) * np.sin(cycle * far_y) if textured else np.ones_like(far_x)
    return np.asarray(np.where((near_x >= CORNER[0]) & (near_y <= CORNER[1]), 0.0, light).mean(axis=(0, 2)))


ONCE = {"silhouette_samples": 1}  # whose tables and programs take a third of the time
CONCAVE = {"aperture": {"shape": "polygon", "blades": 6, "blade_curvature": -1.0}, "psf": ONCE}
SPHERICAL = {"seidel": {"W040": 10.0}}
CASES: dict[str, tuple[float, float, bool, dict[str, Any], float]] = {
    # Plane, card, a texture that needs points, sections, and the largest error. By tents instead of boxes "near focus"
    # has 0.0068; by places of a lens without aberrations the next two have 0.14 and 0.39, by means of l alone 0.01 and
    # 0.06.
    "near focus": (320.0, 190.0, True, {}, 0.005),
    "concave": (1500.0, 150.0, True, CONCAVE, 0.007),
    "aberrated rays": (1500.0, 150.0, False, {"psf": SPHERICAL | ONCE}, 0.003),
    "aberrated, in focus": (250.0, 140.0, False, {"psf": SPHERICAL}, 0.003),
}


@pytest.mark.parametrize("name", CASES)
def test_single_pixels(name: str) -> None:
    plane, card, textured, sections, most = CASES[name]
    scene, row, columns = scene_of(plane, card, textured, sections), SIZE // 2 - 2, np.arange(9, 25, 2)
    pixels = np.asarray(clsco.render_frame(scene, truth=()).color)[row, columns]
    right = right_values(scene, textured, row, columns)
    assert np.ptp(right) > 0.4
    assert np.abs(pixels.reshape(len(columns), -1).mean(axis=1) - right).max() < most


@pytest.mark.parametrize(("diameter", "period"), [pytest.param(1.0, 6.3, marks=pytest.mark.slow), (2.0, 9.3)])
def test_waves_at_the_focus(diameter: float, period: float) -> None:
    """The amplitude of a sine in focus: by the transfer of a round lens and that of a pixel, but for the tail."""
    camera = {"focal_length": 20.0, "aperture_diameter": diameter, "focus_distance": 250.0, "pixel_pitch": 0.01}
    wall = {
        "shape": "plane", "distance": 250.0, "texture": SINE, "texture_mapping": "surface",
        "texture_size": period * 0.125,
    }  # fmt: skip
    content = {"camera": {"resolution": [40, 40], **camera}, "psf": {"model": "wave"}, "object": [wall]}
    image = np.asarray(clsco.render_frame(clsco.parse_scene(content), truth=()).color).reshape(40, 40)[8:-8, 8:-8]
    cycles = 2**0.5 / period * 550e-6 * 20.0 / diameter / 0.01
    transfer = 2 / np.pi * (np.arccos(cycles) - cycles * np.sqrt(1 - cycles**2)) * np.sinc(1 / period) ** 2
    phase = 2 * np.pi / period * (np.arange(8, 32) - 19.5)
    wave = np.sin(phase) * np.sin(-phase)[:, None]
    amplitude = ((image - 0.5) * wave).sum() / (wave * wave).sum()
    assert amplitude == pytest.approx(0.4 * transfer, rel=0.02)
