"""Makes road.jpg, what the camera of fig_4_19.toml sees of the road of fig_4_18.toml: python examples/thesis/road.py.

The upper camera moves there within a second: it turns by 60 deg about the lens and goes so far that its axis meets the
road where it did.
"""

from math import radians
from pathlib import Path

import numpy as np
from PIL import Image

import clsco
from clsco.files.transfer import encode
from clsco.scene.model import Scene

FOLDER = Path(__file__).resolve().parent
ANGLE, DISTANCE = 60.0, 250.0  # deg, mm


def view() -> Scene:
    """The scene of fig_4_18.toml, whose camera is where that of fig_4_19.toml is in the middle of the shutter.

    On the way there the road is far out of focus: a pinhole spares that.
    """
    angle = radians(ANGLE)
    velocity = [0.0, float(-DISTANCE * np.sin(angle)), float(DISTANCE * (1.0 - np.cos(angle)))]
    motion = (f"camera.motion.velocity={velocity}", f"camera.motion.angular_velocity=[{-ANGLE}, 0.0, 0.0]")
    others = ("sequence.interval=2.0", "sequence.samples=1", "camera.aperture_diameter=0.001")
    return clsco.load_scene(FOLDER / "fig_4_18.toml", (*motion, *others))


def main() -> None:
    frame = clsco.render_frame(view(), truth=("sharp",))
    assert frame.sharp is not None
    Image.fromarray(encode(frame.sharp, 8, "linear")).save(FOLDER / "road.jpg", quality=85, optimize=True)


if __name__ == "__main__":
    main()
