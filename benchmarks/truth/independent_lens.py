"""Lenses of `independent.py`: openings, errors of the wavefront, distortion, rims and diffraction, by the words of
docs/scene_files.md, docs/lenses.md and docs/aberrations.md alone.

The ray through the point l of the lens (in radii) that arrives at the pixel x' comes from a source whose pinhole image
is at x = x' - R(Z) l - 2 Q grad W(l), with x' without distortion. Where R or W depends on the place x in the field, x
is found by iteration.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

Array = NDArray[np.float64]

GRID, FINE = 512, 4  # cells of an opening per axis, and points of each
DEGREE = 6  # of a wavefront
# Numbers of a lens: five of distortion, curvature of the field in 1/mm, 1 for a focus on a sphere, pitch and focal
# length in mm, distance of the corner in px, W131, W222 and W220 times 2 Q in px, squeeze, 1 where the place counts.
RADIAL, TANGENTIAL, CURVATURE, SPHERE, PITCH, FOCAL, CORNER, COMA, ASTIGMATISM, FIELD, SQUEEZE, VARIES = (
    0, 3, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14,
)  # fmt: skip
NUMBERS = 15


@dataclass(frozen=True)
class Lens:
    """Lens of one color: `numbers`; `wave` (7, 7), coefficients of x^i y^j of the wavefront times 2 Q; `rims` (n, 2),
    distance and radius in mm; `rows` and `cells`, running sums of an opening's transmission, empty for a circle;
    `sigma` and `most` of a Gaussian, 0 for none; `magnification`, and `power`, what is added to 1/f."""

    numbers: Array
    wave: Array
    rims: Array
    rows: Array
    cells: Array
    sigma: float
    most: float
    magnification: float
    power: float


def is_inside_polygon(x: Array, y: Array, blades: int, curvature: float) -> NDArray[np.bool_]:
    """True inside of blades whose corners are on the unit circle; an edge faces right."""
    half = math.pi / blades
    side = np.round(np.arctan2(y, x) / (2 * half)) * 2 * half
    along, across = x * np.cos(side) + y * np.sin(side), y * np.cos(side) - x * np.sin(side)
    chord, height = math.cos(half), curvature * (1 - math.cos(half))
    if height == 0:
        return np.asarray(along <= chord)
    radius = (math.sin(half) ** 2 + height**2) / (2 * height)  # of the arc through both corners; < 0: concave
    away = np.hypot(along - (chord + height - radius), across)
    return np.asarray(away <= radius if height > 0 else away >= -radius)


def transmission(aperture: Mapping[str, Any]) -> Array:
    """Transmission of GRID x GRID cells, FINE x FINE points each, of an opening as the image of a far light shows it:
    rows from the top."""
    at = (np.arange(GRID * FINE) + 0.5) / (GRID * FINE) * 2 - 1
    right, up = np.meshgrid(at, -at)
    angle = math.radians(aperture.get("rotation", 0.0))
    x, y = math.cos(angle) * right + math.sin(angle) * up, math.cos(angle) * up - math.sin(angle) * right
    within = np.hypot(x, y)
    match aperture["shape"]:
        case "polygon":
            return is_inside_polygon(x, y, aperture["blades"], aperture.get("blade_curvature", 0.0)).astype(float)
        case "ring":
            return np.asarray((within <= 1) & (within >= aperture["obstruction"]), float)
        case "image":
            image = np.asarray(aperture["image"], float)
            place = [np.clip(((side + 1) / 2 * len(image)).astype(int), 0, len(image) - 1) for side in (-y, x)]
            return np.where(within <= 1, image[place[0], place[1]], 0.0)
    raise ValueError(f"independent: aperture must be one that this tracer knows; got {aperture['shape']!r}")


def zernike(n: int, m: int, x: Array, y: Array) -> Array:
    """The polynomial of ANSI Z80.28, rms 1 over the unit circle."""
    rho, phi = np.hypot(x, y), np.arctan2(y, x)
    radial = sum(
        (-1) ** k
        * math.factorial(n - k)
        / (math.factorial(k) * math.factorial((n + abs(m)) // 2 - k) * math.factorial((n - abs(m)) // 2 - k))
        * rho ** (n - 2 * k)
        for k in range((n - abs(m)) // 2 + 1)
    )
    return np.asarray(math.sqrt((1 + (m != 0)) * (n + 1)) * radial * (np.cos(m * phi) if m >= 0 else np.sin(-m * phi)))


def wavefront(psf: Mapping[str, Any]) -> Array:
    """Coefficients (7, 7) of x^i y^j of the errors that are the same all over the field, in waves."""
    at = np.linspace(-1, 1, 21)
    x, y = (side.ravel() for side in np.meshgrid(at, at))
    waves = psf.get("seidel", {}).get("W040", 0.0) * (x * x + y * y) ** 2
    for name, size in psf.get("zernike", {}).items():
        n, m = map(int, name.split(","))
        waves = waves + size * zernike(n, m, x, y)
    powers = [(i, j) for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i)]
    fitted = np.linalg.lstsq(np.stack([x**i * y**j for i, j in powers], axis=1), waves, rcond=None)[0]
    coefficients = np.zeros((DEGREE + 1, DEGREE + 1))
    for (i, j), value in zip(powers, fitted, strict=True):
        coefficients[i, j] = value if abs(value) > 1e-12 else 0.0
    return coefficients


def lens_of(content: Mapping[str, Any], color: int) -> Lens:
    """The lens of a color, 0 to 2, of a scene file."""
    camera, psf, aperture = content["camera"], content.get("psf", {}), content.get("aperture", {})
    own = content.get("lens", {})
    focal, pitch = camera.get("focal_length", 20.0), camera.get("pixel_pitch", 0.01)
    diameter = camera.get("aperture_diameter", focal / camera.get("f_number", 2.0))
    unit = psf["wavelengths"][1] * 1e-6 * focal / (diameter * pitch) if "wavelengths" in psf else 0.0  # Q of green, px
    numbers = np.zeros(NUMBERS)
    numbers[RADIAL : RADIAL + 3] = own.get("distortion", (0.0, 0.0, 0.0))
    numbers[TANGENTIAL : TANGENTIAL + 2] = own.get("tangential", (0.0, 0.0))
    numbers[CURVATURE], numbers[SPHERE] = own.get("field_curvature", 0.0), own.get("focus_surface") == "sphere"
    numbers[PITCH], numbers[FOCAL], numbers[SQUEEZE] = pitch, focal, aperture.get("squeeze", 1.0)
    numbers[CORNER] = math.hypot(*camera["resolution"]) / 2
    for place, name in ((COMA, "W131"), (ASTIGMATISM, "W222"), (FIELD, "W220")):
        numbers[place] = 2 * unit * psf.get("seidel", {}).get(name, 0.0)
    numbers[VARIES] = np.any(numbers[[CURVATURE, SPHERE, COMA, ASTIGMATISM, FIELD]] != 0)
    rims = [(rim["distance"], rim["diameter"] / 2) for rim in aperture.get("rim", ())]
    rows = cells = np.zeros(0)
    if aperture.get("shape", "circle") != "circle":
        opening = transmission(aperture).reshape(GRID, FINE, GRID, FINE).mean(axis=(1, 3))
        cells = np.cumsum(opening, axis=1)
        rows = np.cumsum(cells[:, -1])
    gaussian = psf.get("model") == "gaussian"
    changed = focal + own.get("axial", (0.0, 0.0, 0.0))[color]
    return Lens(
        numbers, 2 * unit * wavefront(psf), np.reshape(rims, (-1, 2)).astype(float), rows, cells.ravel(),
        psf.get("sigma_ratio", math.sqrt(0.5)) if gaussian else 0.0, psf.get("truncation", 3.0),
        own.get("lateral", (1.0, 1.0, 1.0))[color], 1 / changed - 1 / focal,
    )  # fmt: skip


def vignetting(content: Mapping[str, Any]) -> Array:
    """Factor (rows, columns) of the frame."""
    camera, kind = content["camera"], content.get("lens", {}).get("vignetting", "none")
    columns, rows = camera["resolution"]
    x, y = np.meshgrid(np.arange(columns) - (columns - 1) / 2, np.arange(rows) - (rows - 1) / 2)
    if kind == "natural":
        ratio = camera.get("pixel_pitch", 0.01) / camera.get("focal_length", 20.0)
        return np.asarray((1 + (x * x + y * y) * ratio**2) ** -2)
    return np.ones((rows, columns))


@njit(cache=True)
def _search(sums, start, stop, value):  # type: ignore[no-untyped-def]
    """First index of running sums that are above a value, and how far into its step the value is."""
    low, high = start, stop - 1
    while low < high:
        middle = (low + high) // 2
        if sums[middle] > value:
            high = middle
        else:
            low = middle + 1
    before = sums[low - 1] if low > start else 0.0
    step = sums[low] - before
    return low - start, (value - before) / step if step > 0.0 else 0.5


@njit(cache=True)
def lens_point(numbers, rows, cells, sigma, most, u, v):  # type: ignore[no-untyped-def]
    """A point of the lens in radii, of two uniform numbers."""
    if len(rows) > 0:
        row, down = _search(rows, 0, len(rows), u * rows[-1])
        start = row * len(rows)
        column, right = _search(cells, start, start + len(rows), v * cells[start + len(rows) - 1])
        x, y = 2.0 * (column + right) / len(rows) - 1.0, 1.0 - 2.0 * (row + down) / len(rows)
    else:
        radius, angle = math.sqrt(u), 2.0 * math.pi * v
        if sigma > 0.0:
            radius = sigma * math.sqrt(-2.0 * math.log(1.0 - u * (1.0 - math.exp(-0.5 * most * most))))
        x, y = radius * math.cos(angle), radius * math.sin(angle)
    return x / numbers[SQUEEZE], y


@njit(cache=True)
def straighten(numbers, ratio, x, y):  # type: ignore[no-untyped-def]
    """Place in px without distortion of a place with it, by Newton's method; formulas of OpenCV, whose y is down."""
    if numbers[0] == 0.0 and numbers[1] == 0.0 and numbers[2] == 0.0 and numbers[3] == 0.0 and numbers[4] == 0.0:
        return x, y
    k1, k2, k3, p1, p2 = numbers[0], numbers[1], numbers[2], numbers[3], numbers[4]
    a, b = x * ratio, -y * ratio
    right, down = a, b
    for _ in range(12):
        r = right * right + down * down
        radial, slope = 1.0 + r * (k1 + r * (k2 + r * k3)), k1 + r * (2.0 * k2 + 3.0 * k3 * r)
        f = right * radial + 2.0 * p1 * right * down + p2 * (r + 2.0 * right * right) - a
        g = down * radial + p1 * (r + 2.0 * down * down) + 2.0 * p2 * right * down - b
        fx = radial + 2.0 * right * right * slope + 2.0 * p1 * down + 6.0 * p2 * right
        fy = 2.0 * right * down * slope + 2.0 * p1 * right + 2.0 * p2 * down
        gy = radial + 2.0 * down * down * slope + 6.0 * p1 * down + 2.0 * p2 * right
        whole = fx * gy - fy * fy
        right, down = right - (f * gy - g * fy) / whole, down - (g * fx - f * fy) / whole
    return right / ratio, -down / ratio


@njit(cache=True)
def distort(numbers, slope_x, slope_y):  # type: ignore[no-untyped-def]
    """Slopes with distortion of slopes without it."""
    k1, k2, k3, p1, p2 = numbers[0], numbers[1], numbers[2], numbers[3], numbers[4]
    right, down = slope_x, -slope_y
    r = right * right + down * down
    radial = 1.0 + r * (k1 + r * (k2 + r * k3))
    a = right * radial + 2.0 * p1 * right * down + p2 * (r + 2.0 * right * right)
    b = down * radial + p1 * (r + 2.0 * down * down) + 2.0 * p2 * right * down
    return a, -b


@njit(cache=True)
def bend(numbers, wave, u, v, x, y):  # type: ignore[no-untyped-def]
    """Way in px by which the ray through a point of the lens arrives beside R l, right and up; x, y: of its source."""
    right = up = 0.0
    for i in range(DEGREE + 1):
        for j in range(DEGREE + 1 - i):
            if wave[i, j] != 0.0:
                if i > 0:
                    right += wave[i, j] * i * u ** (i - 1) * v**j
                if j > 0:
                    up += wave[i, j] * j * u**i * v ** (j - 1)
    hx, hy = x / numbers[CORNER], y / numbers[CORNER]
    along, away = u * hx + v * hy, u * u + v * v
    right += numbers[COMA] * (2.0 * u * along + away * hx) + 2.0 * numbers[ASTIGMATISM] * along * hx
    up += numbers[COMA] * (2.0 * v * along + away * hy) + 2.0 * numbers[ASTIGMATISM] * along * hy
    field = 2.0 * numbers[FIELD] * (hx * hx + hy * hy)
    return right + field * u, up + field * v


@njit(cache=True)
def focus_at(numbers, ratio, focus, x, y):  # type: ignore[no-untyped-def]
    """K in 1/mm for a source at a place of the image, px; focus: that on the axis."""
    square = x * x + y * y
    if numbers[CURVATURE] != 0.0:
        power = 1.0 / numbers[FOCAL]
        sensor = 1.0 / (power - focus)
        focus = power - 1.0 / (sensor - 0.5 * numbers[CURVATURE] * square * numbers[PITCH] ** 2)
    if numbers[SPHERE] > 0.0:
        focus *= math.sqrt(1.0 + square * ratio * ratio)
    return focus


@njit(cache=True)
def passes_rims(rims, numbers, focus, depth, lens_x, lens_y, slope_x, slope_y, at_x, at_y):  # type: ignore[no-untyped-def]
    """True if a ray from a depth passes all circles. lens: mm; slope: of the ray outside; at: slopes of the pixel."""
    for n in range(len(rims)):
        d, radius = rims[n]
        if d >= depth:
            continue
        if d > 0.0:
            x, y = lens_x + d * slope_x, lens_y + d * slope_y
        else:
            way = 1.0 + d * (1.0 / numbers[FOCAL] - focus)
            x, y = lens_x * way - d * at_x, lens_y * way - d * at_y
        if x * x + y * y > radius * radius:
            return False
    return True


def transfer(radius: float, unit: float, inner: float) -> CubicSpline:
    """Transfer function of a ring, 0 to 1 / Q cycles per px, Q = unit px: the overlap of the opening with itself, moved
    by 2 Q f radii, times the difference of the phases there."""
    at, shifts, found = (np.arange(4096) + 0.5) / 2048 - 1, np.linspace(0.0, 2.0, 2001), []
    for shift in shifts:
        far, near = abs(at) + shift / 2, abs(abs(at) - shift / 2)  # from the middles of both openings
        chord = np.sqrt(np.maximum(1 - far**2, 0)) - np.sqrt(np.maximum(inner**2 - near**2, 0))
        found.append((np.maximum(chord, 0) * np.cos(np.pi * radius / unit * at * shift)).mean())
    return CubicSpline(shifts / (2 * unit), np.array(found) / found[0])


def diffracted(content: Mapping[str, Any]) -> Array:
    """Frame (rows, columns, 3) of a wall that fills the view of a lens with waves, by Hopkins' transfer function: all
    of the light, however far it goes.

    The image on the wall is of squares of a pixel, the frame's own size, and goes on mirrored: it is a sum of waves of
    twice that size, of which pixels cannot tell those apart whose frequencies differ by whole numbers."""
    camera, psf, (wall,) = content["camera"], content["psf"], content["object"]
    focal, pitch = camera["focal_length"], camera["pixel_pitch"]
    ratio = focal / camera["aperture_diameter"] / pitch * 1e-6
    radius = 0.5 * focal * camera["aperture_diameter"] / pitch * (1 / camera["focus_distance"] - 1 / wall["distance"])
    image = np.asarray(wall["texture"], float)
    rows, columns = image.shape[:2]
    frame = np.zeros(image.shape)
    for color, wavelength in enumerate(psf["wavelengths"]):
        unit = wavelength * ratio  # Q, px
        passes, most = transfer(radius, unit, content.get("aperture", {}).get("obstruction", 0.0)), math.ceil(1 / unit)
        passed = np.zeros((2 * rows, 2 * columns))
        for i in range(-most, most + 1):
            for j in range(-most, most + 1):
                up, right = np.fft.fftfreq(2 * rows)[:, None] + i, np.fft.fftfreq(2 * columns) + j
                away = np.hypot(up, right)
                lens = np.where(away < 1 / unit, passes(np.minimum(away, 1 / unit)), 0)
                passed += lens * (np.sinc(up) * np.sinc(right)) ** 2  # the squares of the source and of the pixel
        wide = np.pad(image[..., color], ((0, rows), (0, columns)), mode="symmetric")
        frame[..., color] = np.fft.ifft2(np.fft.fft2(wide) * passed).real[:rows, :columns]
    return frame
