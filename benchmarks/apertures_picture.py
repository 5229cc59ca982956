"""docs/apertures.png, points of light behind and before the focus through apertures of four shapes: python -m
benchmarks.apertures_picture [-o FILE]"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

import clsco

ROWS, COLUMNS, POINTS = 150, 200, 24
RADIUS = 11.0  # px
BRIGHTNESS, DARKNESS = 45.0, 0.02  # of a point, and of all between


def heart(count: int = 256) -> NDArray[np.float32]:
    """Transmission (count, count) of the heart (x^2 + y^2 - a)^3 < b x^2 y^3."""
    at = (np.arange(count) + 0.5) * 2 / count - 1
    x, y = at[None, :], 0.1 - at[:, None]
    return ((x * x + y * y - 0.35) ** 3 < 1.2 * x * x * y**3).astype(np.float32)


def apertures() -> tuple[dict[str, Any], ...]:
    """Sections [aperture] in the picture."""
    polygon, ring = {"shape": "polygon", "blades": 5}, {"shape": "ring", "obstruction": 0.5}
    return {}, polygon, ring, {"shape": "image", "image": heart()}


def picture() -> NDArray[np.uint8]:
    """Columns of apertures; behind the focus above, before it below."""
    points, place = np.full((ROWS, COLUMNS), DARKNESS, np.float32), np.random.default_rng(3)
    points[place.integers(12, ROWS - 12, POINTS), place.integers(12, COLUMNS - 12, POINTS)] = BRIGHTNESS
    shown = [
        [clsco.defocus(points, np.full(points.shape, radius), aperture=aperture) for aperture in apertures()]
        for radius in (RADIUS, -RADIUS)
    ]
    codes = np.clip(np.block(shown), 0.0, 1.0) ** (1 / 2.2)
    return np.rint(255 * codes).astype(np.uint8)


def main() -> None:
    """Write the picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", dest="out", type=Path, default=Path(__file__).parents[1] / "docs" / "apertures.png")
    Image.fromarray(picture()).save(parser.parse_args().out, optimize=True)


if __name__ == "__main__":
    main()
