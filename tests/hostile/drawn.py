"""Random small scenes of every kind, by number, as a scene file or Python has them."""

from __future__ import annotations

from typing import Any

import numpy as np

from clsco.scene.shapes import SHAPES
from clsco.scene.texture_keys import RULES

TEXTURES = ("bricks", "checkerboard", "slanted_edge", "siemens_star")
BOXES = (
    [[-30.0, 30.0], [-30.0, 30.0], [-3.0, 60.0]],
    [[-9.0, 12.0], [-30.0, 8.0], [-60.0, 5.0]],
    [[-60.0, 60.0], [-60.0, 60.0], [-60.0, 60.0]],
)
UNCUT = ("rectangle", "disc", "box")
WRAPS = ("repeat", "mirror", "clamp", "none")
SIDES = ("back", "left", "right", "top", "bottom")


class Draws:
    """The values of a case, drawn one after the other."""

    def __init__(self, number: int) -> None:
        self.rng = np.random.default_rng([7, number])

    def one(self, *values: Any) -> Any:
        """One of these."""
        return values[self.rng.integers(len(values))]

    def near(self, low: float, high: float) -> float:
        """A number between two, such as a person would write."""
        return round(float(self.rng.uniform(low, high)), 3)

    def motion(self) -> dict[str, Any]:
        """Velocities, or none."""
        found: dict[str, Any] = {}
        if self.one(True, False):
            found["velocity"] = [self.near(-12, 12), self.near(-12, 12), self.near(-25, 25)]
        if self.one(True, False):
            found["angular_velocity"] = [self.near(-60, 60) * self.one(0, 1) for _ in range(3)]
        return found

    def rotation(self) -> Any:
        """In one of its three forms; quarter turns leave edges on pixels."""
        angles = [self.one(0.0, 90.0, self.near(-180, 180)) for _ in range(3)]
        axis, angle = [self.near(-1, 1), self.near(-1, 1), self.near(0.1, 1)], self.near(-400, 400)
        return self.one(angles, angles, {"axis": axis, "angle": angle}, {"quaternion": [angle / 100, *axis]})

    def shape(self) -> dict[str, Any]:
        """A shape with the keys of its own."""
        one, near = self.one, self.near
        center = [near(-15, 15), near(-15, 15), near(170, 330)]
        axis = [near(-1, 1), near(-1, 1), near(0.1, 1)]
        shapes: tuple[dict[str, Any], ...] = (
            {"shape": "plane", "distance": near(170, 350), "slope_x": one(0, near(-1, 1)), "slope_y": one(0, 0.4)},
            {"shape": "sphere", "center": center, "radius": near(5, 45)},
            {"shape": "cylinder", "center": center, "radius": near(5, 30), "axis": axis},
            {"shape": "cone", "apex": center, "half_angle": near(5, 60), "nappe": one("away", "towards")},
            {"shape": "ellipsoid", "center": center, "semi_axes": [near(5, 40) for _ in range(3)]},
            {"shape": "quadric", "center": center,
             "coefficients": [1.0, near(-1, 1), one(0, near(-1, 1)), 0, 0, 0, 0, 0, near(-40, 40), near(-500, 500)]},
            {"shape": "rectangle", "center": center, "size": [near(5, 60), near(5, 60)], "offset": one(0, near(-9, 9))},
            {"shape": "disc", "center": center, "radius": near(5, 30), "offset": one(0, near(-9, 9))},
            {"shape": "box", "center": center, "size": [near(5, 40) for _ in range(3)]},
        )  # fmt: skip
        return one(*shapes)

    def image(self) -> Any:
        """Image that may lie on a surface: a pattern, a color, or an array, as small as one texel."""
        size = self.one((1, 1), (1, 7), (25, 40), (33, 16, 3))
        return self.one(*TEXTURES, "#c86432", self.rng.random(size).astype(np.float32))

    def lying(self, shape: str) -> dict[str, Any]:
        """Keys of a texture on a surface, with sizes and offsets from ordinary to extreme."""
        one, near = self.one, self.near
        mapping = one(*SHAPES[shape].MAPPINGS)
        takes = RULES[SHAPES[shape].MAPPINGS[mapping]]
        found: dict[str, Any] = {"texture_mapping": mapping, "texture": self.image()}
        lengths = one(near(3, 60), near(3, 60), [near(3, 60), near(3, 60)], 1e-6, 0.004, 1e5, 1e9, [1e-3, 1e3])
        if takes.size == "must" or (takes.size and one(True, False)):
            found["texture_size"] = lengths
        elif takes.repeats and one(True, False):
            copies = [one(near(0.3, 5), 1, 3, 4, 1e-6, 1e6) for _ in range(takes.repeats)]
            found["texture_repeats"] = one(copies, copies[0])
        if takes.offset and one(True, False):
            found["texture_offset"] = one([near(-1, 1), near(-1, 1)], [0.5, 0.0], [1e6, -1e6], [0.0, 12345.678])
        if takes.angle and one(True, False):
            found["texture_angle"] = one(30.0, 90.0, near(-400, 400))
        if one(True, True, False):
            found["texture_wrap"] = one(*WRAPS)
        if mapping == "cube" or (shape == "box" and one(True, False)):
            sides = self.rng.random((2, *one((1, 1), (8, 8), (21, 21), (9, 14)))).astype(np.float32)
            found |= one({"texture": "bricks"}, {"texture": sides[0], f"texture_{one(*SIDES)}": sides[1]})
        return found

    def item(self, groups: bool, rays: bool) -> dict[str, Any]:
        """An object; groups: whether there is one to be in; rays: whether they are cast at it."""
        one = self.one
        found = self.shape()
        shape = found["shape"]
        found["texture"] = one(*TEXTURES)
        if shape not in UNCUT and one(True, False, False):
            found["bounds"] = one(*BOXES)
        if one(True, False):
            found["rotation"] = self.rotation()
        if groups and one(True, False):
            found["group"] = "cart"
        if rays and one(True, True, False):
            found |= self.lying(shape)
        return found | ({"motion": moving} if (moving := self.motion()) else {})


def sections(number: int) -> dict[str, Any]:
    """The scene of a case, as a file would have it."""
    draws = Draws(number)
    one, near = draws.one, draws.near
    count = int(one(1, 1, 1, 2, 2, 3))
    camera = {
        "resolution": [int(one(1, 17, 32, 45)), int(one(1, 14, 24, 66))],
        "pixel_pitch": one(0.08, 0.15), "aperture_diameter": one(4.0, 10.0, 30.0), "focus_distance": near(180, 340),
    }  # fmt: skip
    if one(*[False] * 5, True):
        camera["motion"] = draws.motion()
    found: dict[str, Any] = {"camera": camera}
    if grouped := one(True, False, False):
        found["group"] = [{"name": "cart", "motion": draws.motion()}]
        found["group"][0] |= one({}, {"origin": [near(-20, 20), near(-20, 20), near(150, 350)]})
    found["psf"] = {
        "model": one("pillbox", "gaussian"), "edge": one("sampled", "area", "integrated"), "tilt": one(True, False),
        "silhouette_samples": int(one(1, 2, 4)), "border": one("lose", "renormalize"),
        "occlusion": one("visibility", "layered", "none"),
    }  # fmt: skip
    found["sequence"] = {"samples": one(1, 2, 3), "sampling": one("midpoint", "endpoint"), "shutter": one(0.1, 1.0)}
    found["motion"] = {"rotation": one("euler", "axis")}
    if forward := one(True, False, False):
        found["motion"]["warp"] = "forward"
        found["fill"] = {"method": one("ait", "mean_median", "none"), "domain": one("surface", "span")}
    else:
        found["motion"]["texture_filter"] = one("bicubic", "bilinear", "nearest")
    if one(*[False] * 7, True):
        found["stereo"] = {"baseline": near(2, 12), "toe_in": one(0.0, 1.0)}
    if not forward and one(True, False):
        light = {"direction": [near(-1, 1), near(-1, 1), near(-0.5, 1)]}
        light = one(light, {"position": [near(-80, 80), near(-80, 80), near(-50, 400)]})
        found["light"] = light | {"ambient": one(0.0, 0.3, 1.0)}
    found["object"] = [draws.item(grouped, not forward) for _ in range(count)]
    if one(True, False, False):
        behind = {"shape": "background", "texture": one(*TEXTURES)}
        found["object"] = [*found["object"], behind] if one(True, True, True, False) else [behind]
    return found
