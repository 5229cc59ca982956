"""Random small scenes for the laws: numbers of few bits, so that what should be exact can be."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import Phase, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

import clsco
from clsco.frame.frame import Frame
from clsco.scene.model import Camera, Ellipsoid, Object, ObjectMotion, Psf, Scene, Sphere
from clsco.scene.model import Sequence as Exposure

COLUMNS, ROWS = 24, 20
BOX = ((-64.0, 64.0),) * 3
LIGHT = (-4, 1, 3)  # powers of two by which textures are brighter
EXAMPLES = {"laws": 500, "some_laws": 100}  # of each law, by the profile of `make laws`
NAMES = ("depth", "blur_radius", "mask", "object_id", "normal", "flow")
# Radii stay below 1 px: tables for larger ones, made anew for each scene, take longer than all the rest.
CAMERA = {
    "focal_length": 20.0, "aperture_diameter": 2.5, "sensor_distance": 21.739, "normalization_distance": 20.0,
    "pixel_pitch": 0.2,
}  # fmt: skip

# The same examples on every run. Nothing is shrunk: examples are small already, and each try is a frame.
law = settings(
    max_examples=EXAMPLES.get(settings.get_current_profile_name(), 4), derandomize=True, deadline=None, database=None,
    phases=(Phase.generate,),
)  # fmt: skip
# Each choice takes a program of its own, which takes seconds.
PRECISIONS = st.sampled_from(["double", "single"])
OCCLUSIONS = st.sampled_from(["none", "visibility"])
FILTERS = st.sampled_from(["bicubic", "bilinear", "nearest"])


def eighths(low: int, high: int) -> st.SearchStrategy[float]:
    """Multiples of 1/8."""
    return st.integers(8 * low, 8 * high).map(lambda n: n / 8)


def triples(low: int, high: int) -> st.SearchStrategy[tuple[float, float, float]]:
    """Three multiples of 1/8."""
    return st.tuples(*[eighths(low, high)] * 3)


centers = st.tuples(eighths(-30, 30), eighths(-30, 30), eighths(150, 400))
radii = eighths(15, 60)
speeds = triples(-8, 8)


@st.composite
def bodies(draw: st.DrawFn) -> Object:
    """A ball or an ellipsoid in a box that it fits into, moving."""
    motion = ObjectMotion(velocity=draw(speeds))
    if draw(st.booleans()):
        return Sphere(center=draw(centers), radius=draw(radii), motion=motion, bounds=BOX)
    axes = draw(st.tuples(radii, radii, radii))
    return Ellipsoid(center=draw(centers), semi_axes=axes, motion=motion, bounds=BOX)


pairs = st.tuples(bodies(), bodies())


def scene(light: Path, objects: tuple[Object, ...], texture: str = "plain", **sections: Any) -> Scene:
    """A scene of a small frame; all of them are made by few programs, which take longer than all frames."""
    painted = tuple(item.model_copy(update={"texture": str(light / f"{texture}.npy")}) for item in objects)
    camera = Camera(resolution=(COLUMNS, ROWS), **(CAMERA | sections.pop("camera", {})))
    shown = {"psf": Psf(silhouette_samples=1, occlusion="none"), "sequence": Exposure(samples=1)} | sections
    return Scene(camera=camera, objects=painted, **shown)


def rendered(given: Scene, frame: int = 0, precision: str | None = None) -> Frame:
    """A frame with its ground truth."""
    (one,) = clsco.render(given, truth=NAMES, frames=[frame], precision=precision, method="gather")
    return one


def same_bits(one: Any, other: Any) -> bool:
    """True if two arrays are equal bit by bit, but for the sign of 0."""
    return bool(np.array_equal(np.asarray(one), np.asarray(other)))


def hit(frame: Frame) -> NDArray[np.bool_]:
    """Mask of pixels with a surface."""
    assert frame.mask is not None
    return frame.mask
