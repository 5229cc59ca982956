"""Pictures of docs/lenses.md, points of light behind and before the focus by a plain disc and by an effect: python -m
benchmarks.lens_pictures [NAME ...] [-o FOLDER]"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

import clsco

ROWS, COLUMNS, APART, GAP = 144, 208, 32, 4  # px
BRIGHTNESS, DARKNESS = 120.0, 0.008  # of a point, and of all between
CAMERA = {
    "resolution": [COLUMNS, ROWS],
    "focal_length": 20.0,
    "f_number": 1.4,
    "focus_distance": 100.0,
    "pixel_pitch": 0.12,
}
CAT_EYE = [{"distance": 16.0, "diameter": 17.0}, {"distance": -6.0, "diameter": 13.0}]  # mm
FAR, FOCUS, NEAR = 1000.0, 100.0, 53.0  # mm
WAVES = {"model": "wave", "wavelengths": [20000.0] * 3}  # Q is 0.23 px


def heart(count: int = 256) -> NDArray[np.float32]:
    """Transmission (count, count) of the heart (x^2 + y^2 - a)^3 < b x^2 y^3."""
    at = (np.arange(count) + 0.5) * 2 / count - 1
    x, y = at[None, :], 0.1 - at[:, None]
    return ((x * x + y * y - 0.35) ** 3 < 1.2 * x * x * y**3).astype(np.float32)


@dataclass(frozen=True)
class Effect:
    """An effect of a lens in a picture.

    name: of the file; sections: of the scene file, beside a camera; depths: of the points, mm, from above to below;
    on_surface: they lie on the planes, and are no image that the camera sees.
    """

    name: str
    sections: dict[str, Any]
    depths: tuple[float, ...] = (FAR, NEAR)
    on_surface: bool = False


EFFECTS = (
    Effect("polygon", {"aperture": {"shape": "polygon", "blades": 5}}),
    Effect("curved", {"aperture": {"shape": "polygon", "blades": 7, "blade_curvature": 0.6}}),
    Effect("squeeze", {"aperture": {"squeeze": 1.8}}),
    Effect("cat_eye", {"aperture": {"rim": CAT_EYE}}),
    Effect("ring", {"aperture": {"shape": "ring", "obstruction": 0.5}}),
    Effect("image", {"aperture": {"shape": "image", "image": heart()}}),
    Effect("gaussian", {"psf": {"model": "gaussian"}}),
    Effect("field_curvature", {"lens": {"field_curvature": -0.02}}, (FAR, FOCUS)),
    Effect("axial", {"lens": {"axial": [1.2, 0.0, -1.2]}}),
    Effect("vignetting", {"lens": {"vignetting": "natural"}}),
    Effect("distortion", {"lens": {"distortion": [-0.35, 0.08, 0.0]}}, on_surface=True),
    Effect("wave", {"psf": WAVES}),
    Effect("coma", {"psf": WAVES | {"zernike": {"3,1": 1.0}}}, (FAR, FOCUS, NEAR)),
    Effect("astigmatism", {"psf": WAVES | {"zernike": {"2,2": 1.5}}}, (FAR, FOCUS, NEAR)),
    Effect("field", {"camera": {"f_number": 5.6}, "psf": WAVES | {"seidel": {"W131": 1.0}}}, (FOCUS,)),
    Effect("spherical", {"psf": WAVES | {"seidel": {"W040": 5.0}}}, (FAR, FOCUS, NEAR)),
)


def points() -> NDArray[np.float32]:
    """Texture (ROWS, COLUMNS) with points APART px from each other, one of them on the axis."""
    found = np.full((ROWS, COLUMNS), DARKNESS, np.float32)
    found[ROWS // 2 % APART :: APART, COLUMNS // 2 % APART :: APART] = BRIGHTNESS
    return found


def picture(effect: Effect) -> NDArray[np.uint8]:
    """The plain disc on the left, the effect on the right; the farthest points above."""
    shown = []
    for depth in effect.depths:
        plane: dict[str, Any] = {"shape": "plane", "distance": depth, "texture": points()}
        if effect.on_surface:
            plane |= {"texture_mapping": "surface", "texture_size": COLUMNS * 0.12 / 20.0 * depth}
        plain = {"camera": CAMERA, "object": [plane]}
        sections = {name: CAMERA | keys if name == "camera" else keys for name, keys in effect.sections.items()}
        pair = [clsco.render_frame(clsco.parse_scene(scene), truth=()).color for scene in (plain, plain | sections)]
        shown.append(np.concatenate([_framed(each) for each in pair], axis=1))
    codes = np.clip(np.concatenate(shown)[GAP:, GAP:], 0.0, 1.0) ** (1 / 2.2)
    shades = np.rint(255 * codes).astype(np.uint8)
    return shades if (shades != shades[..., :1]).any() else shades[..., 0]


def _framed(image: NDArray[np.float32]) -> NDArray[np.float32]:
    """An image (rows, columns, 3) with a white border above and on the left."""
    colored = image if image.ndim == 3 else np.repeat(image[..., None], 3, axis=2)
    return np.pad(colored, [(GAP, 0), (GAP, 0), (0, 0)], constant_values=1.0)


def main() -> None:
    """Write pictures of all effects, or of some."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", metavar="NAME", nargs="*", help="Effects. Default: all.")
    parser.add_argument("-o", dest="out", type=Path, default=Path(__file__).parents[1] / "docs" / "lenses")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    for effect in EFFECTS:
        if effect.name in (given.names or [each.name for each in EFFECTS]):
            Image.fromarray(picture(effect)).save(given.out / f"{effect.name}.png", optimize=True)


if __name__ == "__main__":
    main()
