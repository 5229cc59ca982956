"""Paints the textures of evening.toml, portrait.toml and the other photographs: python examples/scene_textures.py

Balls are lit by a warm lamp on the left and a cold one behind them; lights, in .npy files, are far brighter than white.
All seeds are fixed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from clsco.files.transfer import encode

FOLDER = Path(__file__).resolve().parent
QUALITY = 78  # of the JPEG files, of 100
LAMP, COLD = "#ffd9a8", "#7f9cff"
DUSK = {0.0: "#060b1e", 0.3: "#14183f", 0.48: "#5b2a55", 0.56: "#b9573a", 0.62: "#3a1d2c", 1.0: "#0c0a12"}
TOWN = ("#ffb45a", "#ffd08a", "#ff8c5a", "#ff6f91", "#7fd4ff", "#ffe7b0")
SHADOWS = ((-34, -210, 62), (150, 60, 58), (-240, 330, 70), (112, -420, 40))  # x, z and radius in mm, on the table
Array = np.ndarray
Spot = tuple[float, float, float, str]  # shares of width and height, radiance, color


def linear(color: str) -> Array:
    """Radiance of a color such as "#ffd9a8", from sRGB."""
    code = np.array([int(color[k : k + 2], 16) / 255.0 for k in (1, 3, 5)])
    return np.where(code <= 0.04045, code / 12.92, ((code + 0.055) / 1.055) ** 2.4)


def blend(first: Array, second: Array, share: Array) -> Array:
    """Mixture of two colors or images, by the share of the second at each pixel."""
    return first + (second - first) * share[..., None]


def soft_step(value: Array, width: float) -> Array:
    """0 below 0, 1 above, with a ramp of this width."""
    return np.clip(value / width + 0.5, 0.0, 1.0)


def unit(*vector: float) -> Array:
    return np.array(vector) / np.linalg.norm(vector)


def noise(rows: int, columns: int, cells: int, seed: int, octaves: int = 4) -> Array:
    """Sum of octaves of random values, interpolated: standard deviation 1, periodic from left to right."""
    rng, total = np.random.default_rng(seed), np.zeros((rows, columns))
    for octave in range(octaves):
        count = cells * 2**octave
        values = rng.normal(size=(max(2, count // 2), count)).astype(np.float32)
        values = np.concatenate([values, values[:, :1]], axis=1)
        total += np.asarray(Image.fromarray(values).resize((columns, rows), Image.Resampling.BICUBIC)) / 2**octave
    return total / total.std()


def save(name: str, radiance: Array | Image.Image) -> None:
    """Write a picture, or light: as JPEG, or in an .npy as float16 of 7 bits, which deflate well."""
    if name.endswith(".npy"):
        mantissa, exponent = np.frexp(radiance)
        np.save(FOLDER / name, np.ldexp(np.round(128 * mantissa) / 128, exponent).astype(np.float16))
        return
    picture = radiance if isinstance(radiance, Image.Image) else Image.fromarray(encode(radiance, 8, "srgb"))
    picture.save(FOLDER / name, quality=QUALITY, optimize=True)


def normals(rows: int) -> Array:
    """Normals (rows, 2 rows, 3) at the pixels of an image on a sphere: x right, y up, z to the camera."""
    longitude = (np.arange(2 * rows) + 0.5) / rows * np.pi - np.pi
    latitude = np.pi / 2 - (np.arange(rows) + 0.5) / rows * np.pi
    x, y = np.meshgrid(longitude, latitude)
    return np.stack([np.sin(x) * np.cos(y), np.sin(y), np.cos(x) * np.cos(y)], axis=-1)


def ball(name: str, albedo: Callable[[Array], Array], rows: int = 320, shine: float = 60, gloss: float = 0.55) -> None:
    """Save a glazed surface (Lambert and Blinn) of an albedo, which is a function of the normals."""
    n = normals(rows)
    lamp, behind, view = unit(-0.62, 0.62, 0.5), unit(0.95, 0.25, -0.25), unit(0.0, 0.0, 1.0)
    diffuse = 1.15 * np.clip(n @ lamp, 0.0, 1.0)[..., None] * linear(LAMP) + 0.035
    diffuse = diffuse + 0.55 * np.clip(n @ behind, 0.0, 1.0)[..., None] ** 1.5 * linear(COLD)
    diffuse = diffuse + (0.08 - 0.08 * n[..., 1:2]) * linear("#5a3520")
    glint = np.clip(n @ unit(*(lamp + view)), 0.0, 1.0)[..., None] ** shine * linear(LAMP)
    second = np.clip(n @ unit(*(unit(0.8, 0.45, 0.3) + view)), 0.0, 1.0)[..., None] ** (2 * shine) * linear(COLD)
    edge = (1.0 - np.clip(n[..., 2:], 0.0, 1.0)) ** 4 * linear(COLD)
    save(name, albedo(n) * diffuse + gloss * (glint + 0.35 * second + 0.1 * edge))


def rosette(n: Array, axis: Array, colors: Sequence[str], petals: int = 12) -> Array:
    """Albedo of rings of petals about an axis."""
    right = unit(*np.cross([0.0, 1.0, 0.0], axis))
    ring = np.degrees(np.arccos(np.clip(n @ axis, -1.0, 1.0))) / 9.0
    angle = np.arctan2(n @ np.cross(axis, right), n @ right)
    albedo, *tones = (linear(color) for color in colors)
    for k in range(14):
        petal = np.cos(angle * petals * (1 if k < 5 else 2) + np.pi * (k % 2))
        petal = petal * np.sin(np.pi * np.clip(ring - k, 0.0, 1.0))
        inside = (ring > k) & (ring < k + 1)
        albedo = blend(albedo, tones[k % 3], inside * soft_step(petal - 0.37, 0.06))
        albedo = blend(albedo, tones[(k + 2) % 3], inside * soft_step(petal - 0.74, 0.06))
        albedo = blend(albedo, tones[0], 0.9 * soft_step(0.05 - abs(ring - k - 1), 0.03))
    return albedo


def stripes(n: Array, first: str, second: str, count: int = 9, axis: Sequence[float] = (0.3, 1.0, 0.2)) -> Array:
    """Albedo of rings of two colors about an axis."""
    height = np.arcsin(np.clip(n @ unit(*axis), -1.0, 1.0))
    return blend(linear(first), linear(second), soft_step(np.sin(count * height), 0.25))


def spot(n: Array, middles: Array, radius: float, ramp: float = 0.01) -> Array:
    """Share of discs of a radius, in rad, about the nearest of some directions."""
    return soft_step((n @ middles).max(axis=-1) - np.cos(radius), ramp)


def dots(n: Array) -> Array:
    """Albedo of dots on a spiral that spreads them evenly."""
    k = np.arange(40) + 0.5
    height, angle = 1.0 - k / 20, np.pi * (1.0 + np.sqrt(5.0)) * k
    across = np.sqrt(1.0 - height**2)
    middles = np.stack([np.cos(angle) * across, height, np.sin(angle) * across])
    return blend(linear("#e0a316"), linear("#5a2a10"), spot(n, middles, 0.16, 6e-3))


def doll_head(n: Array) -> Array:
    x, y = n[..., 0], n[..., 1]
    cheeks = 0.5 * np.exp(-(((abs(x) - 0.5) / 0.17) ** 2 + ((y + 0.28) / 0.12) ** 2))
    albedo = blend(linear("#e9b98c"), linear("#e0705c"), cheeks)
    fringe = y - 0.3 - 0.25 * np.cos(4.2 * x) * (abs(x) < 0.75) - 1.5 * np.maximum(abs(x) - 0.66, 0.0)
    hair = np.maximum(soft_step(fringe, 0.03), soft_step(abs(x) + 0.12 * y - 0.84, 0.03))
    hair = np.maximum(hair, soft_step(-n[..., 2] - 0.1, 0.05))
    albedo = blend(albedo, linear("#17100e"), hair)
    for side in (-0.3, 0.3):
        across = x - side
        lid, brow = abs(y - 0.01 + 1.8 * across**2), abs(y - 0.2 + 0.9 * across**2)
        albedo = blend(albedo, linear("#1a0d0a"), soft_step(0.02 - lid, 0.02) * (abs(across) < 0.13))
        albedo = blend(albedo, linear("#2a1712"), soft_step(0.012 - brow, 0.02) * (abs(across) < 0.14) * (1 - hair))
    return blend(albedo, linear("#b3261a"), soft_step(1.0 - np.hypot(x / 0.085, (y + 0.4) / 0.035), 0.2))


def kimono(n: Array) -> Array:
    albedo = rosette(n, unit(0.0, -0.1, 1.0), ("#17315e", "#f3d9b1", "#d0443a", "#e8a33c"), 8)
    collar = abs(abs(n[..., 0]) - 0.55 * np.maximum(n[..., 1] - 0.25, 0.0))
    return blend(albedo, linear("#f6ead2"), soft_step(0.06 - collar, 0.04) * (n[..., 1] > 0.25))


def wings(n: Array) -> Array:
    albedo = np.broadcast_to(linear("#d01c0e"), n.shape)
    marks = {(-0.5, 0.62, 0.55): 0.26, (0.55, 0.7, 0.4): 0.24, (-0.75, 0.3, 0.5): 0.2, (0.8, 0.35, 0.45): 0.2}
    for middle, radius in (marks | {(0.0, 0.95, 0.2): 0.2}).items():
        albedo = blend(albedo, linear("#120606"), spot(n, unit(*middle)[:, None], radius))
    return blend(albedo, linear("#120606"), soft_step(0.02 - abs(n[..., 0]), 0.015))


def beetle_head(n: Array) -> Array:
    eyes = np.stack([unit(-0.6, 0.5, 0.6), unit(0.6, 0.5, 0.6)], axis=1)
    return blend(linear("#100a0a"), linear("#f4efe0"), spot(n, eyes, 0.34, 0.02))


def daisy(n: Array) -> Array:
    radius = np.degrees(np.arccos(np.clip(n @ unit(0.0, 0.1, 1.0), -1.0, 1.0))) / 90
    petals = np.cos(11 * np.arctan2(n[..., 1] - 0.1, n[..., 0])) + 0.75 - 2.2 * abs(radius - 0.55)
    albedo = blend(linear("#5a2c86"), linear("#fff4fb"), soft_step(petals, 0.2) * (radius < 0.9) * (radius > 0.2))
    return blend(albedo, linear("#ffb81c"), soft_step(0.25 - radius, 0.03))


def chess(n: Array) -> Array:
    fields = np.sin(12 * np.arctan2(n[..., 0], n[..., 2])) * np.sin(12 * np.arcsin(n[..., 1]))
    return blend(linear("#0d2b36"), linear("#e9fbff"), soft_step(fields, 0.1))


def planks() -> Array:
    """Radiance of a table, brighter under the lamp, with a soft shadow of each ball."""
    rows, columns = 512, 768
    y, x = np.mgrid[:rows, :columns]
    plank = 7.0 * x / columns
    tone = np.random.default_rng(5).uniform(-1.0, 1.0, 8)[plank.astype(int)]
    grain = 0.5 + 0.5 * np.sin(14.0 * (plank % 1.0) + 2.2 * noise(rows, columns, 3, 11, 2) + 9.0 * tone)
    streaks = Image.fromarray(np.random.default_rng(2).normal(size=(rows // 16, columns)).astype(np.float32))
    grain += np.asarray(streaks.resize((columns, rows), Image.Resampling.BICUBIC)) / 3
    share = np.clip(0.2 + 0.42 * grain + 0.1 * noise(rows, columns, 6, 8, 5) + 0.22 * tone, 0.0, 1.0)
    radiance = 0.62 * blend(linear("#3a1d10"), linear("#8a4b26"), share)
    radiance[abs(plank % 1.0 - 0.5) > 0.492] *= 0.25
    right, away = 1400.0 * (x / columns - 0.5), 1400.0 * (0.5 - y / rows)
    radiance *= (0.35 + 1.1 * np.exp(-(((right + 120) / 520) ** 2) - ((away + 120) / 420) ** 2))[..., None]
    radiance += 0.03 * np.exp(-(((away - 620) / 260) ** 2))[..., None] * linear("#ff9a5a")
    for place_x, place_z, radius in SHADOWS:
        distance = np.hypot((right - place_x - 0.25 * radius) / 1.25, away - place_z - 0.1 * radius)
        radiance *= (1.0 - 0.88 * np.exp(-((distance / (0.85 * radius)) ** 2)))[..., None]
    return radiance


def lights(name: str, rows: int, columns: int, sky: dict[float, str], spots: Sequence[Spot]) -> None:
    """Save a sky, colors by height, and points of light."""
    at, colors = (np.arange(rows) + 0.5) / rows, np.array([linear(color) for color in sky.values()])
    gradient = np.stack([np.interp(at, list(sky), colors[:, channel]) for channel in range(3)], axis=-1)[:, None]
    radiance = np.repeat(gradient, columns, axis=1)
    y, x = np.mgrid[:rows, :columns]
    for place_x, place_y, strength, color in spots:
        distance = (x - place_x * columns) ** 2 + (y - place_y * rows) ** 2
        radiance += strength * np.where(distance < 16, np.exp(-distance / (2 * 0.9**2)), 0)[..., None] * linear(color)
    save(name, radiance)


def strings(seed: int, town: int = 58, count: int = 3, strength: float = 90) -> list[Spot]:
    """Strings of lights that sag, and the lights of a town at the horizon."""
    rng, spots = np.random.default_rng(seed), list[Spot]()
    for string in range(count):
        top, sag = 0.1 * string + rng.uniform(0.02, 0.18), rng.uniform(0.06, 0.2)
        for k in range(12 + string):
            along = (k + 0.5 + rng.uniform(-0.2, 0.2)) / (12 + string)
            height = top + 4 * sag * along * (1 - along)
            spots.append((1.1 * along - 0.05, height, strength * rng.uniform(0.5, 1.1), TOWN[rng.integers(2)]))
    for _ in range(town):
        place = rng.uniform(), float(np.clip(rng.normal(0.5, 0.075), 0.3, 0.66))
        spots.append((*place, strength * rng.uniform(0.15, 1.1) ** 1.5, TOWN[rng.integers(len(TOWN))]))
    return spots


def scattered(seed: int, count: int, strength: float, colors: Sequence[str], lowest: float = 1.0) -> list[Spot]:
    """Lights spread evenly, down to a share of the height."""
    rng = np.random.default_rng(seed)
    return [
        (rng.uniform(), rng.uniform(0, lowest), strength * rng.uniform(0.35, 1.2), colors[rng.integers(len(colors))])
        for _ in range(count)
    ]


def leaf() -> Array:
    rows, columns = 400, 600
    y, x = np.mgrid[:rows, :columns]
    u, v = x / columns - 0.5, y / rows - 0.5
    vein, small = abs(9 * (u - 1.1 * abs(v)) % 1 - 0.5), abs(42 * (u + 0.6 * abs(v)) % 1 - 0.5)
    share = np.clip(0.55 + 0.12 * noise(rows, columns, 8, 4) - 0.25 * (vein > 0.46) - 0.06 * (small > 0.42), 0.0, 1.0)
    radiance = blend(linear("#1c5a1e"), linear("#8fce3c"), share)
    return blend(radiance, linear("#d9f0a0"), np.exp(-((v / 0.012) ** 2))) * (1.05 - 0.9 * np.hypot(u, v))[..., None]


def asphalt() -> Array:
    """Radiance of a wet street that reflects lights."""
    radiance = linear("#1a1c26") * (1 + 0.25 * noise(300, 600, 20, 4)[..., None])
    rng, fade = np.random.default_rng(4), np.linspace(1.0, 0.15, 300)[:, None, None]
    for _ in range(26):
        color, x = ("#ffb45a", "#ff6a4a", "#7fb4ff")[rng.integers(3)], rng.uniform(0, 600)
        line = np.exp(-(((np.arange(600) - x) / rng.uniform(3, 10)) ** 2))[None, :, None]
        radiance = radiance + 0.3 * line * linear(color) * fade
    return radiance


def sky() -> Array:
    rows, columns = 320, 480
    at, colors = np.linspace(0.0, 1.0, rows), [linear(c) for c in ("#2f7fd6", "#cfe9ff", "#6aa84a", "#2f6a2a")]
    field = [np.interp(at, [0.0, 0.62, 0.66, 1.0], [color[k] for color in colors]) for k in range(3)]
    clouds = np.clip(noise(rows, columns, 5, 21, 5) - 0.5, 0.0, 1.4) / 1.4 * soft_step(0.6 - at, 0.1)[:, None]
    return blend(np.stack(field, axis=-1)[:, None], np.ones(3), 0.6 * clouds)


def tram() -> Image.Image:
    picture = Image.new("RGB", (900, 300), "#b3231b")
    draw = ImageDraw.Draw(picture)
    for box, color in (((0, 158, 900, 248), "#f2e3c0"), ((0, 248, 900, 300), "#2a1a18"), ((0, 0, 900, 16), "#3a2420")):
        draw.rectangle(box, fill=color)
    for left in range(30, 900, 143):
        draw.rounded_rectangle((left, 38, left + 120, 142), 10, fill="#ffdf9a")
    for left in (188, 615):
        draw.rectangle((left, 38, left + 90, 248), fill="#7b1712")
        draw.rectangle((left + 9, 47, left + 81, 142), fill="#ffe9b8")
    draw.ellipse((848, 169, 885, 206), fill="#fff6d8")
    return picture


def facade() -> Image.Image:
    picture, rng = Image.new("RGB", (900, 600), "#1b2036"), np.random.default_rng(8)
    draw = ImageDraw.Draw(picture)
    for left in range(0, 900, 100):
        draw.rectangle(
            (left, 60 + int(rng.integers(90)), left + 99, 600), fill=("#232a45", "#2c2440", "#1d2c3c")[left // 100 % 3]
        )
        for x, y in ((left + 12 + 30 * k % 90, 170 + 50 * (k // 3)) for k in range(24)):
            if rng.random() < 0.55:
                draw.rectangle(
                    (x, y, x + 18, y + 30), fill=("#ffcf7a", "#ffe2a8", "#8ab8ff", "#3a4468")[rng.integers(4)]
                )
    return picture


def house() -> Image.Image:
    picture, rng = Image.new("RGB", (720, 480)), np.random.default_rng(3)
    draw = ImageDraw.Draw(picture)
    for y in range(480):
        draw.line((0, y, 720, y), fill=(26 + y // 8, 44 + y // 8, 104 + y * 50 // 480))
    draw.point([(int(rng.integers(720)), int(rng.integers(260))) for _ in range(90)], fill="#ffffff")
    draw.ellipse((540, 50, 620, 130), fill="#fff3cf")
    draw.ellipse((520, 40, 595, 115), fill=(34, 52, 112))
    draw.polygon((0, 380, 180, 320, 400, 372, 720, 300, 720, 480, 0, 480), fill="#1c3a30")
    draw.polygon((210, 250, 320, 160, 430, 250), fill="#6a3434")
    for box, color in (
        ((230, 250, 410, 390), "#8a5a4a"),
        ((255, 280, 315, 340), "#ffc35a"),
        ((345, 280, 390, 390), "#5a2a1a"),
    ):
        draw.rectangle(box, fill=color)
    draw.line((285, 280, 285, 340), fill="#33211f", width=4)
    draw.line((255, 310, 315, 310), fill="#33211f", width=4)
    for x in (90, 140, 520, 600, 660):
        draw.polygon((x, 400, x + 30, 230 + x % 50, x + 60, 400), fill="#12281f")
    return picture


def main() -> None:
    red, pink = ("#b3261a", "#fff1d6", "#10305c", "#f2a33a"), ("#f3dfe6", "#d86a92", "#fff6f2", "#b02a5c")
    ball("glazed.jpg", lambda n: rosette(n, unit(0.18, 0.22, 1.0), red), rows=448)
    ball("teal.jpg", lambda n: stripes(n, "#0e6a6e", "#e8e0c4"))
    ball("yellow.jpg", dots)
    ball("rose.jpg", lambda n: stripes(n, "#d8557a", "#ffd5d0", 7, (1.0, 0.6, 0.2)))
    ball("doll_head.jpg", doll_head, rows=400, shine=30, gloss=0.25)
    ball("doll_body.jpg", kimono, rows=320, shine=30, gloss=0.2)
    ball("wings.jpg", wings, shine=90, gloss=0.9)
    ball("beetle_head.jpg", beetle_head, gloss=0.8)
    ball("pearl.jpg", lambda n: rosette(n, unit(0.0, 0.2, 1.0), pink, 6))
    ball("daisy.jpg", daisy)
    ball("chess.jpg", chess)
    save("table.jpg", planks())
    save("leaf.jpg", leaf())
    save("asphalt.jpg", asphalt())
    save("sky.jpg", sky())
    for name, draw in (("tram", tram), ("facade", facade), ("house", house)):
        save(f"{name}.png", draw())
    lights("evening.npy", 256, 384, DUSK, strings(4))
    lights("portrait.npy", 200, 300, {0.0: "#0a0716", 0.5: "#2a1230", 1.0: "#120810"}, strings(9, 46, 3, 62))
    meadow = {0.0: "#bfe27a", 0.4: "#4f9a3a", 1.0: "#1d4a1c"}
    lights("meadow.npy", 200, 300, meadow, scattered(1, 30, 25, ("#fffbd0", "#ffe9f2"), lowest=0.7))
    evening = {0.0: "#1c0412", 0.6: "#4a0a2c", 1.0: "#14040c"}
    lights("hearts.npy", 200, 300, evening, scattered(5, 52, 110, ("#ff4d7d", "#ff8fb1", "#ffb35c", "#ffe1ea")))
    forest = {0.0: "#20420f", 0.5: "#3c6a1a", 1.0: "#12290c"}
    lights("foliage.npy", 200, 300, forest, scattered(7, 170, 48, ("#d7f08a", "#9ad44a", "#fff6c0", "#ffd27a")))
    sea = {0.0: "#031018", 0.6: "#06303c", 1.0: "#020a10"}
    lights("coded.npy", 200, 300, sea, scattered(11, 34, 120, ("#4de0ff", "#8affd0", "#ffffff", "#b48aff")))


if __name__ == "__main__":
    main()
