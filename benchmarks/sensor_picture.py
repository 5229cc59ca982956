"""docs/sensor.png, a scene at night as light and by a sensor: python -m benchmarks.sensor_picture [-o FILE]"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

import clsco
from clsco.frame.views import viridis

ROOT = Path(__file__).resolve().parents[1]
SIZE, CUT, ZOOM = 256, 64, 4
CORNER = 128, 64  # row and column of the parts
OVERRIDES = (f"camera.resolution=[{SIZE}, {SIZE}]", "camera.pixel_pitch=0.09")
SPEEDS = (100.0, 800.0, 3200.0, 12800.0)


def codes(image: NDArray[Any]) -> NDArray[np.uint8]:
    """Codes of sRGB's exponent, (rows, columns, 3), of light."""
    return np.rint(255 * np.clip(image, 0.0, 1.0) ** (1 / 2.2)).astype(np.uint8)


def part(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """A part of an image, enlarged."""
    row, column = CORNER
    cut = image[row : row + CUT, column : column + CUT]
    return cut.repeat(ZOOM, axis=0).repeat(ZOOM, axis=1)


def picture() -> NDArray[np.uint8]:
    """Light, image, noise and codes of a mosaic above; parts of the image at four sensitivities below."""
    scene = clsco.load_scene(ROOT / "examples" / "night.toml", OVERRIDES)
    light = clsco.render_frame(scene.replace("sensor", None), truth=())
    frame = clsco.render_frame(scene, truth="noise_sigma").arrays()
    mosaic = clsco.render_frame(scene.replace("sensor.mosaic", "rggb"), truth="raw").arrays()["raw"]
    sigma = frame["noise_sigma"][..., 1]
    gray = codes(mosaic[..., None].repeat(3, axis=2) / mosaic.max())
    above = [codes(light.color), codes(frame["color"]), viridis(sigma, float(sigma.min()), float(sigma.max()))]
    images = [clsco.render_frame(scene.replace("sensor.iso", speed), truth=()) for speed in SPEEDS]
    below = [part(codes(each.color)) for each in images]
    return np.vstack([np.hstack([*above, part(gray)]), np.hstack(below)])


def main() -> None:
    """Write the picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", dest="out", type=Path, default=ROOT / "docs" / "sensor.png")
    Image.fromarray(picture()).save(parser.parse_args().out, optimize=True)


if __name__ == "__main__":
    main()
