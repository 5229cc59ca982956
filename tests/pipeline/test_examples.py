"""Every example scene on the device against the NumPy reference, output by output."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import clsco
from clsco import reference
from clsco.check import FIGURES, Difference, compare
from clsco.frame import STEREO_NAMES, Frame
from clsco.images import read_image, write_png
from clsco.scene import DepthMap, Scene
from clsco.sweep import load_sweep

Small = Callable[[Path], Scene]
Exact = Callable[[Path], tuple[Frame, ...]]
EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
PATHS = sorted(EXAMPLES.rglob("*.toml"))
# The whole view on 96 x 64 px: pixels 5 times as wide, and 4 times the aperture, so that blur stays some px.
SMALL = ("camera.resolution=[96, 64]", "camera.pixel_pitch=0.05", "camera.aperture_diameter=40.0")
# Depth maps have their size: every fifth pixel of the files, 5 times as wide.
SMALL_MAP = ("camera.pixel_pitch=0.08", "camera.aperture_diameter=20.0")
# Where things hide each other, half the blur: the reference looks at every tap.
SMALL_SEVERAL = (*SMALL[:2], "camera.aperture_diameter=20.0")
# What takes the reference many seconds, and is looked at in parts by tests/pipeline/test_occlusion.py.
LONG = {
    f"occlusion_{stem}"
    for stem in ("passing", "tube", "sharp_near", "sharp_far", "interpenetrating", "three", "wire", "ground", "card")
}
LONG |= {"bowl", "tube", "focal_stack", "camera_motion"}
SEVERAL = ("bowl", "cone_turning", "cylinder_turning", "plane_gaussian", "quadric", "road", "fig_3_12_right")


def name(path: Path) -> str:
    return path.stem


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Small:
    """Examples with few pixels; of a sweep its first scene."""
    folder = tmp_path_factory.mktemp("map")

    def load(path: Path) -> Scene:
        if path.stem != "depth_map":
            several = path.read_text("utf-8").count("[[object]]") > 1
            return load_sweep(path, SMALL_SEVERAL if several else SMALL).scenes[0]
        (item,) = clsco.load_scene(path).objects
        assert isinstance(item, DepthMap)
        files = {}
        for key, name in (("texture", item.texture), ("depth", item.depth)):
            files[key] = folder / f"{key}.png"
            write_png(files[key], np.ascontiguousarray(read_image(name).data[::5, ::5]))
        return clsco.load_scene(path, [*SMALL_MAP, *(f"object.0.{key}={files[key]}" for key in files)])

    return cache(load)


@pytest.fixture(scope="module")
def exact(small: Small) -> Exact:
    return cache(lambda path: tuple(reference.render(small(path))))


def worst(frames: list[Frame], exacts: tuple[Frame, ...]) -> list[Difference]:
    """Differences of all outputs of all frames, after a look at whether there is anything to compare."""
    assert len(frames) == len(exacts) > 0
    for frame in frames:
        assert frame.color.dtype == np.float32
        assert np.ptp(frame.color) > 0.1  # a picture, not a surface of one color
        assert frame.mask is not None
        assert frame.mask.mean() > 0.2
    return [found for pair in zip(frames, exacts, strict=True) for found in compare(*pair)]


@pytest.mark.parametrize(
    "path", [pytest.param(p, marks=[pytest.mark.slow] * (p.stem in LONG)) for p in PATHS], ids=name
)
def test_every_output_agrees_in_double_precision(path: Path, small: Small, exact: Exact) -> None:
    # Geometry is the same arithmetic in float64, and a hit or a miss is decided alike; color is summed in
    # float32 from at most a few hundred weights, each good to 6e-8, of PSF tables good to 1e-6 of their sum.
    scene = small(path)
    differences = worst(list(clsco.render(scene, precision="double")), exact(path))
    assert {found.output for found in differences} == set(FIGURES) - (set() if scene.stereo else set(STEREO_NAMES))
    assert [found for found in differences if found.count] == []


@pytest.mark.parametrize("method", ["gather", "scatter", "convolve"])
def test_methods_agree_where_they_can_do_the_scene(method: str, small: Small, exact: Exact) -> None:
    # Each adds the same weights in another order: float32 in a row, fixed point, or one PSF for all pixels.
    path = EXAMPLES / "plane_approaching.toml"
    frames = list(clsco.render(small(path), method=method))
    assert frames[0].metadata["blur_method"] == method
    assert [found for found in worst(frames, exact(path)) if found.count] == []


@pytest.mark.parametrize("stem", SEVERAL)
def test_scatter_agrees(stem: str, small: Small, exact: Exact) -> None:
    (path,) = (path for path in PATHS if path.stem == stem)
    frames = list(clsco.render(small(path), truth=(), method="scatter"))
    for frame, wanted in zip(frames, exact(path), strict=True):
        assert frame.metadata["blur_method"] == "scatter"
        (color,) = compare(frame, wanted)
        assert color.count == 0, color


def near_silhouettes(frame: Frame, px: int) -> NDArray[np.bool_]:
    """Pixels within `px` px, by column and row, of a change of the mask."""
    assert frame.mask is not None
    mask = frame.mask
    near = np.zeros_like(mask)
    near[:, 1:] |= mask[:, 1:] != mask[:, :-1]
    near[1:] |= mask[1:] != mask[:-1]
    for axis in (0, 1):
        near = np.logical_or.reduce([_shifted(near, step, axis) for step in range(-px - 1, px + 1)])
    return near


def _shifted(array: NDArray[np.bool_], step: int, axis: int) -> NDArray[np.bool_]:
    out = np.zeros_like(array)
    source, target = slice(max(0, -step), min(0, -step) or None), slice(max(0, step), min(0, step) or None)
    places = [(slice(None),) * axis + (part,) for part in (target, source)]
    out[places[0]] = array[places[1]]
    return out


@pytest.mark.parametrize("stem", [s for s in SEVERAL if s != "bowl"])
def test_single_precision_differs_near_silhouettes_only(stem: str, small: Small, exact: Exact) -> None:
    # float32 places a surface to 2^-24 of its distance times the condition of the root, and a sub-pixel ray
    # may miss what it barely touches: one of 16 of a pixel's sources, spread over the reach of the PSF.
    (path,) = (path for path in PATHS if path.stem == stem)
    for frame, wanted in zip(clsco.render(small(path), precision="single"), exact(path), strict=True):
        assert frame.metadata["precision"] == "single"
        assert wanted.flow is not None
        # The silhouette is known at the middle of the shutter; it goes half the flow to either side of it.
        moves = int(np.ceil(np.abs(wanted.flow).max() / 2))
        band = near_silhouettes(wanted, frame.metadata["guard_px"] + moves)
        difference = np.abs(frame.color - wanted.color)
        assert difference[~band].max(initial=0.0) < 1e-5
        assert difference.max() < 0.02
        for output in ("mask", "object_id", "filled", "hidden"):
            differs = getattr(frame, output) != getattr(wanted, output)
            assert differs.mean() < 0.005, output
        assert frame.depth is not None
        assert wanted.depth is not None
        both = np.isfinite(frame.depth) & np.isfinite(wanted.depth)
        error = np.abs(frame.depth[both] / wanted.depth[both] - 1)
        # float32 has 6e-8; a grazing ray loses up to half of the digits.
        assert error.max() < 1e-5
        assert np.median(error) < 2e-7


def test_a_band_around_silhouettes() -> None:
    mask = np.zeros((9, 12), np.bool_)
    mask[4:, 6:] = True
    frame = Frame(0, np.zeros((9, 12), np.float32), mask=mask)
    near = near_silhouettes(frame, 1)
    assert near[4].tolist() == [False] * 4 + [True] * 8
    assert near[8].tolist() == [False] * 4 + [True] * 4 + [False] * 4
    assert near[:, 11].tolist() == [False] * 2 + [True] * 4 + [False] * 3
