"""docs/evening.jpg, glazed balls before the lights of an evening: python -m benchmarks.evening_picture [-o FILE]

Textures are painted here, with fixed seeds: patterns on the surfaces of balls, lit by a warm lamp on the left and a
cold one on the right; planks with soft shadows; a sky with lights far brighter than white, which the lens turns into
discs.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

import clsco
from clsco.files.transfer import encode

Array = NDArray[np.float64]
ROOT = Path(__file__).parents[1]
COLUMNS, ROWS, WIDTH_MM = 1152, 768, 36.0
LAMP, COLD = "#ffd9a8", "#7f9cff"
SKY = {0.0: "#060b1e", 0.3: "#14183f", 0.48: "#5b2a55", 0.56: "#b9573a", 0.62: "#3a1d2c", 1.0: "#0c0a12"}
LIGHTS = ("#ffb45a", "#ffd08a", "#ff8c5a", "#ff6f91", "#7fd4ff", "#ffe7b0")
# Center and radius in mm.
GLAZED = ((-34.0, -30.0, 648.0), 58.0)
YELLOW = ((150.0, -34.0, 930.0), 54.0)
TEAL = ((-300.0, -22.0, 1330.0), 66.0)
ROSE = ((74.0, -62.0, 375.0), 26.0)
TABLE_Y, TABLE_Z, TABLE_MM = -88.0, 900.0, 1400.0


def linear(color: str) -> Array:
    """Radiance of a color such as "#ffd9a8", from sRGB."""
    code = np.array([int(color[k : k + 2], 16) / 255.0 for k in (1, 3, 5)])
    return np.where(code <= 0.04045, code / 12.92, ((code + 0.055) / 1.055) ** 2.4)


def blend(first: Array, second: Array, share: Array) -> Array:
    """Mixture of two colors or images, by the share of the second at each pixel."""
    mixed: Array = first + (second - first) * share[..., None]
    return mixed


def soft_step(value: Array, width: float) -> Array:
    """0 below 0, 1 above, with a ramp of this width."""
    return np.clip(value / width + 0.5, 0.0, 1.0)


def unit(*vector: float) -> Array:
    """Vector of length 1."""
    return np.array(vector) / np.linalg.norm(vector)


def smooth_noise(rows: int, columns: int, cells: int, seed: int) -> Array:
    """Sum of four octaves of random values, interpolated: mean 0, standard deviation 1, periodic from left to right."""
    rng, total = np.random.default_rng(seed), np.zeros((rows, columns))
    for octave in range(4):
        count = cells * 2**octave
        values = rng.normal(size=(count // 2 + 2, count)).astype(np.float32)
        values = np.concatenate([values, values[:, :1]], axis=1)
        total += np.asarray(Image.fromarray(values).resize((columns, rows), Image.Resampling.BICUBIC)) / 2**octave
    return (total - total.mean()) / total.std()


def sphere_normals(rows: int) -> Array:
    """Normals (rows, 2 rows, 3) at the pixels of an image on a sphere: x right, y up, z to the camera."""
    longitude = (np.arange(2 * rows) + 0.5) / rows * np.pi - np.pi
    latitude = np.pi / 2 - (np.arange(rows) + 0.5) / rows * np.pi
    x, y = np.meshgrid(longitude, latitude)
    return np.stack([np.sin(x) * np.cos(y), np.sin(y), np.cos(x) * np.cos(y)], axis=-1)


def glaze(normals: Array, albedo: Array) -> Array:
    """Radiance of a glazed surface (Lambert and Blinn): a warm lamp, a cold one behind, light from the table."""
    lamp, behind, view = unit(-0.62, 0.62, 0.5), unit(0.95, 0.25, -0.25), unit(0.0, 0.0, 1.0)
    diffuse = 1.15 * np.clip(normals @ lamp, 0.0, 1.0)[..., None] * linear(LAMP)
    diffuse = diffuse + 0.55 * np.clip(normals @ behind, 0.0, 1.0)[..., None] ** 1.5 * linear(COLD)
    diffuse = diffuse + (0.08 - 0.08 * normals[..., 1:2]) * linear("#5a3520") + 0.035
    glint = np.clip(normals @ unit(*(lamp + view)), 0.0, 1.0)[..., None] ** 60 * linear(LAMP)
    edge = (1.0 - np.clip(normals[..., 2:], 0.0, 1.0)) ** 4 * linear(COLD)
    return albedo * diffuse + 0.55 * glint + 0.055 * edge


def rosette(normals: Array) -> Array:
    """Albedo of rings of petals about an axis that leans towards the camera."""
    axis = unit(0.18, 0.22, 1.0)
    right = unit(*np.cross([0.0, 1.0, 0.0], axis))
    ring = np.degrees(np.arccos(np.clip(normals @ axis, -1.0, 1.0))) / 9.0
    angle = np.arctan2(normals @ np.cross(axis, right), normals @ right)
    red, cream, blue, gold = (linear(color) for color in ("#b3261a", "#fff1d6", "#10305c", "#f2a33a"))
    albedo = np.broadcast_to(red, normals.shape)
    for k in range(14):
        across = np.clip(ring - k, 0.0, 1.0)
        petal = np.cos(angle * (12 if k < 5 else 24) + np.pi * (k % 2)) * np.sin(np.pi * across)
        inside = (ring > k) & (ring < k + 1)
        albedo = blend(albedo, (cream, blue, gold)[k % 3], inside * soft_step(petal - 0.37, 0.06))
        albedo = blend(albedo, (gold, cream, blue)[k % 3], inside * soft_step(petal - 0.74, 0.06))
        albedo = blend(albedo, cream, 0.9 * soft_step(0.05 - abs(ring - k - 1), 0.03))
    return albedo


def stripes(normals: Array, colors: tuple[str, str], count: int, axis: Array) -> Array:
    """Albedo of rings of two colors about an axis."""
    height = np.arcsin(np.clip(normals @ axis, -1.0, 1.0))
    return blend(linear(colors[0]), linear(colors[1]), soft_step(np.sin(count * height), 0.25))


def dots(normals: Array, colors: tuple[str, str], count: int = 40, radius: float = 0.16) -> Array:
    """Albedo of dots of a radius, rad, on a spiral that spreads them evenly."""
    k = np.arange(count) + 0.5
    height, angle = 1.0 - 2.0 * k / count, np.pi * (1.0 + np.sqrt(5.0)) * k
    across = np.sqrt(1.0 - height**2)
    middles = np.stack([np.cos(angle) * across, height, np.sin(angle) * across])
    return blend(
        linear(colors[0]), linear(colors[1]), soft_step((normals @ middles).max(axis=-1) - np.cos(radius), 6e-3)
    )


def planks(shadows: Sequence[tuple[tuple[float, float, float], float]]) -> Array:
    """Radiance of the table, brighter under the lamp, with a soft shadow of each ball."""
    rows, columns = 512, 768
    y, x = np.mgrid[:rows, :columns]
    plank = 7.0 * x / columns
    tone = np.random.default_rng(5).uniform(-1.0, 1.0, 8)[plank.astype(int)]
    grain = 0.5 + 0.5 * np.sin(14.0 * (plank % 1.0) + 2.2 * smooth_noise(rows, columns, 3, 11) + 9.0 * tone)
    share = np.clip(0.2 + 0.42 * grain + 0.1 * smooth_noise(rows, columns, 6, 8) + 0.22 * tone, 0.0, 1.0)
    radiance = 0.62 * blend(linear("#3a1d10"), linear("#8a4b26"), share)
    radiance[abs(plank % 1.0 - 0.5) > 0.492] *= 0.25
    right, away = TABLE_MM * (x / columns - 0.5), TABLE_MM * (0.5 - y / rows)
    radiance *= (0.35 + 1.1 * np.exp(-(((right + 120) / 520) ** 2) - ((away + 120) / 420) ** 2))[..., None]
    radiance += 0.03 * np.exp(-(((away - 620) / 260) ** 2))[..., None] * linear("#ff9a5a")
    for (center_x, _, center_z), radius in shadows:
        distance = np.hypot((right - center_x - 0.25 * radius) / 1.25, away - (center_z - TABLE_Z) - 0.1 * radius)
        radiance *= (1.0 - 0.88 * np.exp(-((distance / (0.85 * radius)) ** 2)))[..., None]
    return radiance


def evening_lights() -> Array:
    """Radiance of a sky at dusk with strings of lights, and those of a town at its horizon."""
    rows, columns, rng = 384, 576, np.random.default_rng(4)
    heights, colors = list(SKY), np.array([linear(color) for color in SKY.values()])
    at = (np.arange(rows) + 0.5) / rows
    sky = np.stack([np.interp(at, heights, colors[:, channel]) for channel in range(3)], axis=-1)[:, None]
    radiance = sky * (1.0 + 0.1 * smooth_noise(rows, columns, 5, 3)[..., None])
    spots = []
    for string in range(3):
        top, sag = 0.1 * string + rng.uniform(0.02, 0.18), rng.uniform(0.06, 0.2)
        for k in range(12 + string):
            along = (k + 0.5 + rng.uniform(-0.2, 0.2)) / (12 + string)
            spots.append(
                (1.1 * along - 0.05, top + 4 * sag * along * (1 - along), rng.uniform(45, 100), rng.integers(2))
            )
    for _ in range(58):
        place = rng.uniform(), float(np.clip(rng.normal(0.5, 0.075), 0.3, 0.66))
        spots.append((*place, 90 * rng.uniform(0.15, 1.1) ** 1.5, rng.integers(len(LIGHTS))))
    y, x = np.mgrid[:rows, :columns]
    for place_x, place_y, strength, number in spots:
        distance = (x - place_x * columns) ** 2 + (y - place_y * rows) ** 2
        radiance += strength * np.exp(-distance / (2 * 1.35**2))[..., None] * linear(LIGHTS[number])
    return radiance


def evening() -> clsco.Scene:
    """The scene: near, in focus and far, f/1.6."""

    def ball(place: tuple[tuple[float, float, float], float], albedo: Array, normals: Array) -> clsco.Sphere:
        texture = glaze(normals, albedo).astype(np.float32)
        return clsco.Sphere(center=place[0], radius=place[1], texture=texture, texture_mapping="surface")

    fine, normals = sphere_normals(640), sphere_normals(384)
    camera: dict[str, Any] = {"focal_length": 50.0, "f_number": 1.6, "focus_distance": 594.0}
    return clsco.Scene(
        camera=clsco.Camera(**camera, pixel_pitch=WIDTH_MM / COLUMNS, resolution=(COLUMNS, ROWS)),
        objects=(
            ball(GLAZED, rosette(fine), fine),
            ball(YELLOW, dots(normals, ("#e0a316", "#5a2a10")), normals),
            ball(TEAL, stripes(normals, ("#0e6a6e", "#e8e0c4"), 9, unit(0.3, 1.0, 0.2)), normals),
            ball(ROSE, stripes(normals, ("#d8557a", "#ffd5d0"), 7, unit(1.0, 0.6, 0.2)), normals),
            clsco.Rectangle(
                center=(0.0, TABLE_Y, TABLE_Z),
                size=(TABLE_MM, TABLE_MM),
                rotation=(90.0, 0.0, 0.0),
                texture=planks((GLAZED, YELLOW, TEAL, ROSE)).astype(np.float32),
                texture_mapping="surface",
            ),
            clsco.Background(texture=evening_lights().astype(np.float32)),
        ),
    )


def main() -> None:
    """Render and write the picture."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", dest="out", type=Path, default=ROOT / "docs" / "evening.jpg")
    out = parser.parse_args().out
    color = clsco.render_frame(evening(), truth=()).color
    Image.fromarray(encode(color, 8, "srgb")).save(out, quality=88, optimize=True)


if __name__ == "__main__":
    main()
