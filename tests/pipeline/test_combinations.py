"""Random combinations of the effects of lenses: device against reference, methods, precisions and strips; and the
combinations that are refused."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from clsco.cli.check import compare
from clsco.constants import BAND
from clsco.plan.prepare import prepare
from clsco.scene.model import Scene
from tests.kernels.test_pupils import heart
from tests.pipeline.test_strips import memory_for
from tests.scenes import reference_frames, rendered, scene_from

COUNT = 60  # of the scenes
FIGURE = 1e-5  # of white
ROOM = 1 << 20  # bytes for a plan that has to be widened
ON_EDGES = 1e-4  # of white, over the frame: of cells that single precision has beyond an edge, however far they blur
METHODS = ("gather", "scatter", "tiles")
Draw = Callable[[float, float], float]
Tables = dict[str, Any]


def drawn(number: int) -> Scene:
    """A scene by its number: up to two objects before a wall, through a lens with about half of all effects."""
    rng = np.random.default_rng([41, number])

    def between(low: float, high: float) -> float:
        return float(rng.uniform(low, high))

    moving, warped = rng.random() < 0.5, rng.random() < 0.12
    psf = _psf(rng, between, warped)
    tables = {"psf": psf, "aperture": _aperture(rng, between, psf), "lens": _lens(rng, between)}
    if moving or warped:
        tables["sequence"] = {"samples": int(rng.integers(2, 4)), "shutter": 0.1, "interval": 0.1}
        if rng.random() < 0.4 and not warped:
            tables["sequence"]["readout"] = between(0.02, 0.1)
        _changes(rng, between, tables)
    if warped:
        tables["motion"] = {"warp": "forward"}
        tables["aperture"].pop("rim", None)
    tables["camera"] = {
        "resolution": [40, 30], "pixel_pitch": between(0.15, 0.25), "f_number": between(0.3, 0.8),
        "focus_distance": between(180.0, 260.0),
    }  # fmt: skip
    objects = _objects(rng, between, moving or warped)
    _aberrations(np.random.default_rng([41, number, 1]), tables)
    return scene_from(tables, *objects)


def _psf(rng: np.random.Generator, between: Draw, warped: bool) -> Tables:
    found: Tables = {
        "model": str(rng.choice(["pillbox", "pillbox", "gaussian", "wave"])), "tilt": bool(rng.random() < 0.7),
        "border": "renormalize" if rng.random() < 0.15 else "lose", "silhouette_samples": int(rng.integers(1, 4)),
        "occlusion": str(rng.choice([*["visibility"] * (0 if warped else 2), "layered", "none"])),
    }  # fmt: skip
    if found["model"] != "wave":
        return found | {"edge": str(rng.choice(["integrated", "area", "sampled"], p=[0.5, 0.3, 0.2]))}
    found["silhouette_samples"] = int(rng.integers(1, 3))
    far = between(9000.0, 14000.0)  # nm: with these pixels Q is 0.02 to 0.07 px
    found |= {"wavelengths": [1.2 * far, far, 0.9 * far], "tail": 0.2, "rest": str(rng.choice(["renormalize", "lose"]))}
    if rng.random() < 0.5:
        found["zernike"] = {"3,1": between(-0.2, 0.2), "2,-2": between(-0.2, 0.2), "4,0": between(-0.1, 0.1)}
    if rng.random() < 0.3:
        found["seidel"] = {"W040": between(-0.5, 0.5)}
    return found


def _aperture(rng: np.random.Generator, between: Draw, psf: Tables) -> Tables:
    if psf["model"] == "gaussian" or psf.get("edge") == "sampled":
        return {}
    shape = str(rng.choice(["circle", "polygon", "ring", "image"]))
    found: Tables = {"shape": shape, "exposure": str(rng.choice(["normalized", "area"]))}
    if shape == "polygon":
        bent = between(-0.4, 1.0) if rng.random() < 0.6 else 0.0
        found |= {"blades": int(rng.integers(3, 9)), "blade_curvature": bent, "rotation": between(0.0, 90.0)}
    elif shape == "ring":
        found["obstruction"] = between(0.1, 0.8)
    elif shape == "image":
        found |= {"image": heart(24), "rotation": between(0.0, 360.0)}
    if rng.random() < 0.4:
        found["squeeze"] = between(1.0, 2.0)
    if rng.random() < 0.4 and psf["model"] != "wave" and psf["occlusion"] != "layered":
        found["rim"] = [{"distance": 40.0, "diameter": between(25.0, 50.0)}, {"distance": -5.0, "diameter": 25.0}]
    return found


def _lens(rng: np.random.Generator, between: Draw) -> Tables:
    every: Tables = {
        "distortion": [between(-0.2, 0.2), between(-0.1, 0.1), 0.0],
        "tangential": [between(-0.01, 0.01), between(-0.01, 0.01)],
        "vignetting": "natural" if rng.random() < 0.5 else [-0.3, between(0.0, 0.2), -0.1],
        "field_curvature": between(-0.03, 0.03),
        "focus_surface": "sphere",
        "axial": [between(-0.1, 0.2), 0.0, between(-0.2, 0.1)],
        "lateral": [between(0.98, 1.02), 1.0, between(0.98, 1.02)],
    }
    return {name: value for name, value in every.items() if rng.random() < 0.35}


def _changes(rng: np.random.Generator, between: Draw, tables: Tables) -> None:
    """Add a zoom, a pull of the focus or an opening, of waves a pull only."""
    if rng.random() < 0.4:
        others = [] if tables["psf"]["model"] == "wave" else ["focal_length", "f_number"]
        ends = {"focal_length": (20.0, 23.0), "focus_distance": (190.0, 240.0), "f_number": (0.4, 0.6)}
        name = str(rng.choice(["focus_distance", *others]))
        tables["lens"]["keyframe"] = [{"time": 0.1 * k, name: ends[name][k]} for k in range(2)]


def _aberrations(rng: np.random.Generator, tables: Tables) -> None:
    """Add wavefronts that vary over the field, by waves or by rays, and a wide field to a distorted image; waves are
    long enough for tables to be made in seconds."""
    psf, lens, camera = (tables[name] for name in ("psf", "lens", "camera"))
    changes = lens.get("keyframe", [{}])[0]
    if "distortion" in lens and psf["model"] == "pillbox" and "motion" not in tables and rng.random() < 0.6:
        camera["pixel_pitch"] *= 2.5  # discs are ellipses in its image
        psf |= {"edge": "integrated", "occlusion": "visibility"}
        tables["aperture"].clear()
        return
    varies, by_rays = rng.random() < 0.35, rng.random() < 0.5
    seidel = {name: float(rng.uniform(-most, most)) for name, most in (("W131", 0.15), ("W222", 0.1), ("W220", 0.05))}
    if psf["model"] == "wave":
        camera["f_number"] *= 6.0 if varies else 4.0
    elif psf["model"] == "pillbox" and psf["edge"] == "integrated" and by_rays and "rim" not in tables["aperture"]:
        if {"focal_length", "f_number"} & {*changes}:
            return
        psf |= {"wavelengths": [14000.0, 12000.0, 10000.0]}
        psf["zernike"] = {"3,1": float(rng.uniform(-2.0, 2.0)), "2,-2": float(rng.uniform(-2.0, 2.0))}
        seidel = {name: 30.0 * value for name, value in seidel.items()}
    else:
        return
    if varies:
        psf.pop("zernike", None)
        psf["seidel"] = seidel | ({} if changes else {"W311": float(rng.uniform(-1.0, 1.0))})


def _objects(rng: np.random.Generator, between: Draw, moving: bool) -> list[Tables]:
    path = {"velocity": rng.uniform(-30.0, 30.0, 3).tolist(), "angular_velocity": rng.uniform(-20, 20, 3).tolist()}
    place = [between(-15.0, 15.0), between(-10.0, 10.0), between(130.0, 220.0)]
    nearer: list[Tables] = [
        {"shape": "sphere", "center": place, "radius": between(6.0, 14.0)},
        {"shape": "cylinder", "center": place, "radius": between(1.0, 3.0), "axis": rng.uniform(-1, 1, 3).tolist()},
        {"shape": "rectangle", "center": place, "size": [20.0, 12.0], "rotation": rng.uniform(-50, 50, 3).tolist()},
    ]
    wall = {"shape": "plane", "distance": between(250.0, 400.0), "slope_x": between(-0.6, 0.6), "texture": "bricks"}
    found = [nearer[int(rng.integers(3))] | {"texture": str(rng.choice(["checkerboard", "#ff8040"]))}]
    if moving:
        found[0]["motion"] = path
    return [*found, wall] if rng.random() < 0.8 else [wall]


def method_of(number: int, wanted: Scene) -> str:
    """Methods by turns; tiles see nothing in the way of light, and no ellipses."""
    hides = wanted.aperture.rim or (wanted.psf.occlusion == "visibility" and len(wanted.objects) > 1)
    hides = hides or prepare(wanted).plan.psf.stretched > 0.0
    return METHODS[number % (2 if hides else 3)]


def limit_of(wanted: Scene) -> float:
    """Shares of light that are divided by the weights inside have the rounding of both."""
    return 4 * FIGURE if wanted.psf.border == "renormalize" else FIGURE


@pytest.mark.slow
@pytest.mark.parametrize("number", range(COUNT))
def test_device_against_reference(number: int) -> None:
    """Every output, by each method in turn, in both precisions."""
    wanted = drawn(number)
    (frame,), (exact,) = rendered(wanted, method=method_of(number, wanted)), reference_frames(wanted)
    assert np.ptp(exact.color) > 0.02
    assert np.abs(frame.color - exact.color).max() < limit_of(wanted)
    assert [each for each in compare(frame, exact) if not (each.agrees or each.output == "color")] == []
    (single,) = rendered(wanted, truth=(), method=method_of(number, wanted), precision="single")
    assert np.abs(single.color - exact.color).mean() < ON_EDGES


@pytest.mark.slow
@pytest.mark.parametrize("number", range(0, COUNT, 4))
def test_strips_have_the_bits_of_the_whole_frame(number: int) -> None:
    drawn_scene = drawn(number)
    wanted = drawn_scene.replace("camera.resolution", [24, 3 * BAND])
    if wanted.lens is not None:  # the edge of a frame that is so much higher is bent as that of the drawn one
        shrunk = (drawn_scene.camera.frame_size[1] / (3 * BAND)) ** 2
        wanted = wanted.replace("lens.field_curvature", shrunk * wanted.lens.field_curvature)
    method = method_of(number, wanted)
    (whole,) = rendered(wanted, method=method, truth=())
    # What comes near beside a high frame may show R beyond the prediction: then it is made again, with wider strips.
    memory = min(memory_for(wanted, BAND, (), method) + ROOM, memory_for(wanted, 3 * BAND, (), method) - 1)
    (cut,) = rendered(wanted, method=method, truth=(), memory=memory)
    assert cut.metadata["strips"] > whole.metadata["strips"] == 1
    np.testing.assert_array_equal(cut.color, whole.color)
