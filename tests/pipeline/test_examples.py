"""Every example scene on the device against the NumPy reference, output by output."""

from __future__ import annotations

from collections.abc import Callable, Collection
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import clsco
from clsco import reference
from clsco.cli.check import Difference, compare
from clsco.files.images import read_image, write_png
from clsco.frame.frame import Frame
from clsco.scene import examples as demo
from clsco.scene.model import DepthMap, Scene
from clsco.scene.sweep import load_sweep
from tests.scenes import EXAMPLES, outputs_of
from tests.slow import mostly_slow

Small = Callable[[Path], Scene]
Exact = Callable[[Path], tuple[Frame, ...]]
# The whole view on 96 x 64 px: pixels 5 times as wide, and 4 times the aperture, so that blur stays some px.
SMALL = ("camera.resolution=[96, 64]", "camera.pixel_pitch=0.05", "camera.aperture_diameter=40.0")
# Depth maps have their size: every fifth pixel of the files, 5 times as wide.
SMALL_MAP = ("camera.pixel_pitch=0.08", "camera.aperture_diameter=20.0")
# Where things hide each other, half the blur: the reference looks at every tap.
SMALL_SEVERAL = (*SMALL[:2], "camera.aperture_diameter=20.0")
# Lenses that are looked at as they are, of which most see points of light: the view alone on fewer pixels.
LENSES = {"lens_fast_prime", "microscope_objective", "phone_camera", "star_field", *list(demo.EXAMPLES)[:9]}
# A few sub-frames, which take the reference seconds each.
BRIEF = dict.fromkeys(("rolling_fan", "rolling_train", "shutter"), ("sequence.readout=0.004", "sequence.samples=1"))
# Of each way to make a frame one; the reference takes many seconds for some of the others.
QUICK = {"depth_map", "siemens_star", "plane_defocused", "quadric", "fig_3_12_right", "thesis_pipeline"}
SEVERAL = ("quadric", "cone_turning", "cylinder_turning", "plane_gaussian", "road", "fig_3_12_right")
METHODS = [("plane_defocused", method) for method in ("gather", "scatter", "convolve")]
METHODS = mostly_slow([*METHODS, *((stem, "scatter") for stem in SEVERAL)], [*METHODS, ("quadric", "scatter")])


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Small:
    """Examples with few pixels; of a sweep its first scene."""
    folder = tmp_path_factory.mktemp("map")

    def load(path: Path) -> Scene:
        if path.stem != "depth_map":
            several = path.read_text("utf-8").count("[[object]]") > 1
            keys: tuple[str, ...] = SMALL_SEVERAL if several else SMALL
            if path.stem in LENSES:
                camera = clsco.load_scene(path).camera
                keys = SMALL[0], f"camera.pixel_pitch={camera.pixel_pitch * camera.frame_size[0] / 96}"
            scene = load_sweep(path, (*keys, *BRIEF.get(path.stem, ()))).scenes[0]
            return scene.model_copy(update={"sensor": None})  # whose codes depend on the last digit of the light
        (item,) = clsco.load_scene(path).objects
        assert isinstance(item, DepthMap)
        files = {}
        for key, source in item.files().items():
            files[key] = folder / f"{key}.png"
            write_png(files[key], np.ascontiguousarray(read_image(source).data[::5, ::5]))
        return clsco.load_scene(path, [*SMALL_MAP, *(f"object.0.{key}={files[key]}" for key in files)])

    return cache(load)


@pytest.fixture(scope="module")
def exact(small: Small) -> Exact:
    return cache(lambda path: tuple(reference.render(small(path))))


def worst(frames: list[Any], exacts: tuple[Frame, ...]) -> list[Difference]:
    """Differences of all outputs of all frames, after a look at whether there is anything to compare."""
    assert len(frames) == len(exacts) > 0
    for frame in frames:
        assert frame.color.dtype == np.float32
        assert np.ptp(frame.color) > 0.1  # a picture, not a surface of one color
        assert frame.mask.mean() > 0.04 or np.median(frame.color) < 1e-3  # or lights before a black sky
    return [found for pair in zip(frames, exacts, strict=True) for found in compare(*pair)]


def paths(kept: Collection[str]) -> list[Any]:
    return [pytest.param(path, marks=[pytest.mark.slow] * (path.stem not in kept), id=path.stem) for path in EXAMPLES]


@pytest.mark.parametrize("path", paths(QUICK))
def test_every_output_agrees_in_double_precision(path: Path, small: Small, exact: Exact) -> None:
    # Geometry is the same arithmetic in float64, and a hit or a miss is decided alike; color is summed in
    # float32 from at most a few hundred weights, each good to 6e-8, of PSF tables good to 1e-6 of their sum.
    scene = small(path)
    differences = worst(list(clsco.render(scene, precision="double")), exact(path))
    assert {found.output for found in differences} == outputs_of(scene)
    assert [found for found in differences if found.count] == []


@pytest.mark.parametrize(("stem", "method"), METHODS)
def test_methods_agree_where_they_can_do_the_scene(stem: str, method: str, small: Small, exact: Exact) -> None:
    # Each adds the same weights in another order: float32 in a row, fixed point, or one PSF for all pixels.
    (path,) = (path for path in EXAMPLES if path.stem == stem)
    frames = list(clsco.render(small(path), method=method))
    assert {frame.metadata["blur_method"] for frame in frames} == {method}
    assert [found for found in worst(frames, exact(path)) if found.count] == []


@pytest.mark.parametrize("path", paths({"quadric"}))
def test_every_output_agrees_in_single_precision(path: Path, small: Small, exact: Exact) -> None:
    frames = list(clsco.render(small(path), precision="single"))
    assert frames[0].metadata["precision"] == "single"
    assert [found for found in worst(frames, exact(path)) if not found.agrees] == []
