"""Scenes of `independent.py` with lenses, openings, shutters and things near the focus, of 128 x 128 px.

R in px is 500 D (1 / focus - 1 / Z), lengths in mm, at a pitch of 0.02: 5 px at Z = 333 for D = 10 and a focus at 250.
"""

from __future__ import annotations

from typing import Any

import numpy as np

SIZE = 128
RED, SAND, BLUE, WHITE = "#d02818", "#e0c080", "#2850d0", "#ffffff"

Content = dict[str, Any]


def _waves(seed: int) -> Any:
    """An image (SIZE, SIZE, 3) of a few waves, float: linear radiance."""
    draw = np.random.default_rng(seed)
    y, x = np.mgrid[:SIZE, :SIZE]
    found = np.full((SIZE, SIZE, 3), 0.5)
    for _ in range(4):
        phase = x * draw.uniform(-0.35, 0.35) + y * draw.uniform(-0.35, 0.35) + draw.uniform(0, 6)
        found += np.cos(phase)[..., None] * draw.uniform(0, 0.12, 3)
    return found.astype(np.float32)


def _squares(seed: int) -> Any:
    """An image (SIZE, SIZE, 3) of black and white squares of 5 px beside random gray ones."""
    draw = np.random.default_rng(seed)
    cells = np.where(draw.random((26, 26)) < 0.5, draw.random((26, 26)), draw.random((26, 26)) < 0.5)
    return np.repeat(np.kron(cells, np.ones((5, 5)))[:SIZE, :SIZE, None], 3, axis=2).astype(np.float32)


def _scene(
    *objects: Content, focus: float = 250.0, aperture: float = 10.0, pitch: float = 0.02, **tables: Any
) -> Content:
    camera = {
        "focal_length": 20.0, "pixel_pitch": pitch, "resolution": [SIZE, SIZE], "focus_distance": focus,
        "aperture_diameter": aperture,
    }  # fmt: skip
    return {"camera": camera, "object": list(objects), **tables}


def _card(depth: float = 225.0, turned: float = 17.0, **keys: Any) -> Content:
    card = {
        "shape": "rectangle",
        "size": [0.052 * depth, 0.04 * depth],
        "center": [0.004 * depth, -0.003 * depth, depth],
    }
    return {**card, "rotation": [0.0, 0.0, turned], "texture": SAND, **keys}


def _ball(depth: float = 225.0, **keys: Any) -> Content:
    center = [-0.006 * depth, 0.004 * depth, depth]
    return {"shape": "sphere", "center": center, "radius": 0.03 * depth, "texture": SAND, **keys}


def _wall(depth: float = 400.0, seed: int = 1, **keys: Any) -> Content:
    return {"shape": "plane", "distance": depth, "texture": _waves(seed), **keys}


def _letter() -> Any:
    """A mask (20, 20) that shows the letter F."""
    mask = np.zeros((20, 20))
    mask[3:17, 5:8] = mask[3:6, 5:15] = mask[9:11, 5:13] = 1.0
    return mask


def _code() -> Any:
    """A mask (14, 14) of 7 x 7 open and closed squares."""
    open_ = np.random.default_rng(7).random((7, 7)) < 0.5
    return np.kron(open_, np.ones((2, 2)))


def _blades(number: int, curvature: float = 0.0, rotation: float = 0.0, **keys: Any) -> Content:
    return {"shape": "polygon", "blades": number, "blade_curvature": curvature, "rotation": rotation, **keys}


def _rims(*pairs: tuple[float, float], **keys: Any) -> Content:
    return {"rim": [{"distance": distance, "diameter": diameter} for distance, diameter in pairs], **keys}


GREEN = {"wavelengths": [610.0, 540.0, 465.0]}
RING, LETTER = {"shape": "ring", "obstruction": 0.5}, {"shape": "image", "image": _letter()}
NEAR = {"focus": 237.5, "aperture": 10.0}  # R -1.2 px of the card, 8.5 px of the wall


def _with(content: Content, **tables: Any) -> Content:
    return {**content, **tables}


def _aberrated(psf: Content, *objects: Content, **keys: Any) -> Content:
    return _scene(*(objects or (_card(), _wall())), psf={**GREEN, **psf}, **keys)


def _target(depth: float, seed: int) -> Content:
    return {"shape": "plane", "distance": depth, "texture": _squares(seed)}


def scenes() -> dict[str, Content]:
    """All scenes by their names."""
    card, ball, wall = _card(), _ball(), _wall()
    waves = {"model": "wave", **GREEN}
    barrel = {"distortion": [-0.3, 0.05, 0.0]}
    zoom = {"keyframe": [{"time": 0.0, "focal_length": 20.0}, {"time": 1.0, "focal_length": 21.5}]}
    pull = {"keyframe": [{"time": 0.0, "focus_distance": 225.0}, {"time": 1.0, "focus_distance": 300.0}]}
    moving, faster = _card(motion={"velocity": [9.0, 4.0, 0.0]}), _card(motion={"velocity": [12.0, 0.0, 0.0]})
    return {
        # Openings, with something before a wall.
        "hexagon": _with(_scene(card, wall), aperture=_blades(6)),
        "pentagon, turned": _with(_scene(ball, wall), aperture=_blades(5, rotation=21.0)),
        "triangle": _with(_scene(card, wall), aperture=_blades(3, rotation=8.0)),
        "curved blades": _with(_scene(card, wall), aperture=_blades(7, 0.5)),
        "concave blades": _with(_scene(card, wall), aperture=_blades(5, -0.3)),
        "three concave blades": _with(_scene(ball, wall), aperture=_blades(3, -0.3, 30.0)),
        "ring": _with(_scene(card, wall), aperture=RING),
        "thin ring": _with(_scene(ball, wall), aperture={"shape": "ring", "obstruction": 0.8}),
        "letter F": _with(_scene(card, wall), aperture=LETTER),
        "letter F, ball": _with(_scene(ball, wall, focus=300.0), aperture={**LETTER, "rotation": 15.0}),
        "code": _with(_scene(card, wall), aperture={"shape": "image", "image": _code()}),
        "squeeze 2": _with(_scene(card, wall), aperture={"squeeze": 2.0}),
        "squeeze 0.6, pentagon": _with(_scene(ball, wall), aperture=_blades(5, squeeze=0.6)),
        "disc, R 16": _scene(card, wall, focus=180.0, aperture=16.0),
        # Cards near the focus, before a wall that is far from it.
        "card at R -1": _scene(card, wall, **NEAR),
        "card at R -0.5": _scene(card, wall, focus=230.2),
        "card at R -1, turned away": _scene(_card(rotation=[20.0, 35.0, 10.0]), wall, **NEAR),
        "card at R -1, hexagon": _with(_scene(card, wall, **NEAR), aperture=_blades(6)),
        "card at R -1, ring": _with(_scene(card, wall, **NEAR), aperture=RING),
        "card at R -1, letter F": _with(_scene(card, wall, **NEAR), aperture=LETTER),
        "ball at R -1": _scene(ball, wall, **NEAR),
        "card in focus, wall at R 1.5": _scene(card, _wall(241.5), focus=225.0),
        # Aberrations, by rays.
        "W040 10, card": _aberrated({"seidel": {"W040": 10.0}}),
        "W040 2, card": _aberrated({"seidel": {"W040": 2.0}}),
        "W040 10, R 0": _aberrated({"seidel": {"W040": 10.0}}, wall, focus=400.0),
        "W040 6, ball": _aberrated({"seidel": {"W040": -6.0}}, ball, wall, focus=300.0),
        "coma, card": _aberrated({"zernike": {"3,1": 1.5}}),
        "astigmatism, ball": _aberrated({"zernike": {"2,2": 1.5}}, ball, wall),
        "coma of the field, card": _aberrated({"seidel": {"W131": 4.0}}),
        "astigmatism of the field, card": _aberrated({"seidel": {"W222": 4.0}}),
        "W040 4, hexagon, card": _with(_aberrated({"seidel": {"W040": 4.0}}), aperture=_blades(6)),
        # Rims.
        "rim beside R 3.2": _with(_scene(_wall(274.0)), aperture=_rims((16.0, 8.0))),
        "rim that clears all": _with(_scene(_wall(270.0, slope_x=0.5)), aperture=_rims((16.0, 9.5))),
        "cat-eye, near ball": _with(_scene(_ball(120.0), wall), aperture=_rims((30.0, 12.0))),
        "cat-eye, card": _with(_scene(card, wall), aperture=_rims((40.0, 9.0))),
        "two rims": _with(_scene(ball, wall), aperture=_rims((30.0, 9.0), (-8.0, 8.0))),
        "rim, card at R -1": _with(_scene(card, wall, **NEAR), aperture=_rims((30.0, 8.0))),
        # Lenses that are not thin.
        "barrel, R below 2": _scene(_wall(265.0), pitch=0.1, aperture=20.0, lens=barrel),
        "barrel, card": _scene(_card(900.0), _wall(2000.0), pitch=0.1, aperture=10.0, lens=barrel),
        "pincushion, ball": _scene(_ball(), wall, pitch=0.06, aperture=16.0, lens={"distortion": [0.15, 0.0, 0.0]}),
        "tangential": _scene(
            card, wall, pitch=0.05, lens={"distortion": [-0.2, 0.0, 0.0], "tangential": [0.01, -0.02]}
        ),
        "curved field, card": _scene(card, wall, lens={"field_curvature": -0.1}),
        "focus on a sphere": _scene(ball, wall, pitch=0.08, aperture=20.0, lens={"focus_surface": "sphere"}),
        "longitudinal color": _scene(card, wall, lens={"axial": [0.1, 0.0, -0.1]}),
        "lateral color": _scene(card, wall, lens={"lateral": [1.01, 1.0, 0.99]}),
        # Waves, of a wall.
        "waves, R 0": _scene(_target(250.0, 3), aperture=2.5, pitch=0.01, psf=waves),
        "waves, R 2": _scene(_target(416.7, 4), aperture=1.25, pitch=0.01, psf=waves),
        "waves, ring": _with(_scene(_target(300.0, 5), aperture=2.5, pitch=0.01, psf=waves), aperture=RING),
        # Shutters, zooms, and a Gaussian.
        "triangle shutter": _scene(moving, wall, sequence={"shutter_curve": "triangle"}),
        "rolling shutter": _scene(faster, wall, sequence={"shutter": 0.5, "readout": 1.0, "interval": 2.0}),
        "zoom": _scene(card, wall, lens=zoom),
        "focus pull": _scene(card, wall, lens=pull),
        "Gaussian": _scene(_wall(380.0, slope_x=1.0), psf={"model": "gaussian"}),
    }  # fmt: skip
