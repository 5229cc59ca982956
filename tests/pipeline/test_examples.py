"""Every example scene on the device against the NumPy reference, output by output."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import clsco
from clsco import reference
from clsco.cli.check import Difference, compare
from clsco.files.images import read_image, write_png
from clsco.frame.frame import Frame
from clsco.scene.model import DepthMap, Scene
from clsco.scene.sweep import load_sweep
from tests.scenes import outputs_of
from tests.slow import mostly_slow

Small = Callable[[Path], Scene]
Exact = Callable[[Path], tuple[Frame, ...]]
EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
PATHS = sorted(path for path in EXAMPLES.rglob("*.toml") if path.parent.name != "sets")  # distributions of scenes
# The whole view on 96 x 64 px: pixels 5 times as wide, and 4 times the aperture, so that blur stays some px.
SMALL = ("camera.resolution=[96, 64]", "camera.pixel_pitch=0.05", "camera.aperture_diameter=40.0")
# Depth maps have their size: every fifth pixel of the files, 5 times as wide.
SMALL_MAP = ("camera.pixel_pitch=0.08", "camera.aperture_diameter=20.0")
# Where things hide each other, half the blur: the reference looks at every tap.
SMALL_SEVERAL = (*SMALL[:2], "camera.aperture_diameter=20.0")
# Lenses that are looked at as they are, of which most see points of light: the view alone on fewer pixels.
LENSES = {"lens_fast_prime", "lens_coded_aperture", "lens_heart", "microscope_objective", "phone_camera", "star_field"}
# A few sub-frames, which take the reference seconds each.
BRIEF = dict.fromkeys(("rolling_fan", "rolling_train"), ("sequence.readout=0.004", "sequence.samples=1"))
# What takes the reference many seconds, and is looked at in parts by tests/pipeline/test_occlusion.py.
LONG = {
    f"occlusion_{stem}"
    for stem in (
        "passing",
        "tube",
        "sharp_near",
        "sharp_far",
        "interpenetrating",
        "three",
        "wire",
        "ground",
        "card",
        "near_sphere",
    )
}
LONG |= {
    "bowl",
    "tube",
    "focal_stack",
    "camera_motion",
    "sphere_moving",
    "stereo",
    "cart",
    "cone_turning",
    "sphere_turning",
    "cylinder_turning",
}
# Shapes and PSFs that the scatter method, tests of kernels and the stability report look at, and figures with them.
LONG |= {
    "cylinder",
    "cone",
    "saddle",
    "plane_tilted",
    "plane_tilted_both",
    "plane_gaussian",
    "road",
    "fig_3_04_right",
    "fig_3_05_right",
    "fig_3_08_right",
}
LONG |= {"fig_3_15_right", "fig_4_03", "fig_4_06", "fig_4_17", "fig_4_19", "chromatic_ruler", "plane_approaching"}
LONG |= {"rolling_fan", "rolling_train"}  # see tests/pipeline/test_rolling_shutter.py and test_line_truth.py
LONG |= {"vignetted"}  # see tests/pipeline/test_real_lens.py
LONG |= {"background"}  # see tests/pipeline/test_background.py
LONG |= {"night"}  # see tests/pipeline/test_sensor.py
LONG |= {"focus_pull", "hand_held"}  # see tests/pipeline/test_lens_path.py and test_keyframes.py
LONG |= {"dolly_zoom"}  # see tests/pipeline/test_zoom.py
LONG |= {"wide_angle"}  # see tests/pipeline/test_distortion.py
LONG |= {"disc"}  # see tests/pipeline/test_rotated.py
LONG |= {"lens_fast_prime", "lens_coded_aperture", "lens_heart"}  # see tests/pipeline/test_apertures.py
LONG |= {"lit"}  # see tests/pipeline/test_surface_textures.py and test_light.py
LONG |= {"card", "ellipsoid"}  # see tests/pipeline/test_occlusion.py
LONG |= {"microscope_objective", "newtonian", "phone_camera", "star_field"}  # see tests/pipeline/test_waves.py
LONG |= {"slide_upside_down", "tilted_mirror"}  # see there
LONG |= {"plane_moving", "plane_turning"}  # as plane_approaching moves
# Figures of the thesis that vary others by their numbers alone.
LONG |= {
    f"fig_{number}" for number in ("3_04_left", "3_05_left", "3_08_left", "3_12_left", "3_15_left", "4_02", "4_14")
}
LONG |= {f"fig_{number}" for number in ("3_03", "4_08", "4_09", "4_10", "4_11", "4_12", "4_18")} | {"section_4_3_3"}
LONG |= {f"fig_{number}" for number in ("3_09_a", "3_09_b", "3_09_c", "3_13_a", "3_13_b", "4_13", "4_15", "3_17_left")}
SINGLE = ("quadric",)
SEVERAL = ("cone_turning", "cylinder_turning", "plane_gaussian", "quadric", "road", "fig_3_12_right")


def name(path: Path) -> str:
    return path.stem


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Small:
    """Examples with few pixels; of a sweep its first scene."""
    folder = tmp_path_factory.mktemp("map")

    def load(path: Path) -> Scene:
        if path.stem != "depth_map":
            several = path.read_text("utf-8").count("[[object]]") > 1
            keys = (*(SMALL_SEVERAL if several else SMALL), *BRIEF.get(path.stem, ()))
            if path.stem in LENSES:
                camera = clsco.load_scene(path).camera
                keys = SMALL[0], f"camera.pixel_pitch={camera.pixel_pitch * camera.frame_size[0] / 96}"
            scene = load_sweep(path, keys).scenes[0]
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


def worst(frames: list[Frame], exacts: tuple[Frame, ...]) -> list[Difference]:
    """Differences of all outputs of all frames, after a look at whether there is anything to compare."""
    assert len(frames) == len(exacts) > 0
    for frame in frames:
        assert frame.color.dtype == np.float32
        assert np.ptp(frame.color) > 0.1  # a picture, not a surface of one color
        assert frame.mask is not None
        assert frame.mask.mean() > 0.2 or np.median(frame.color) < 1e-3  # or lights before a black sky
    return [found for pair in zip(frames, exacts, strict=True) for found in compare(*pair)]


@pytest.mark.parametrize(
    "path", [pytest.param(p, marks=[pytest.mark.slow] * (p.stem in LONG)) for p in PATHS], ids=name
)
def test_every_output_agrees_in_double_precision(path: Path, small: Small, exact: Exact) -> None:
    # Geometry is the same arithmetic in float64, and a hit or a miss is decided alike; color is summed in
    # float32 from at most a few hundred weights, each good to 6e-8, of PSF tables good to 1e-6 of their sum.
    scene = small(path)
    differences = worst(list(clsco.render(scene, precision="double")), exact(path))
    assert {found.output for found in differences} == outputs_of(scene)
    assert [found for found in differences if found.count] == []


@pytest.mark.parametrize("method", ["gather", "scatter", "convolve"])
def test_methods_agree_where_they_can_do_the_scene(method: str, small: Small, exact: Exact) -> None:
    # Each adds the same weights in another order: float32 in a row, fixed point, or one PSF for all pixels.
    path = EXAMPLES / "plane_approaching.toml"
    frames = list(clsco.render(small(path), method=method))
    assert frames[0].metadata["blur_method"] == method
    assert [found for found in worst(frames, exact(path)) if not found.agrees] == []


@pytest.mark.parametrize("stem", mostly_slow(SEVERAL, ["quadric"]))
def test_scatter_agrees(stem: str, small: Small, exact: Exact) -> None:
    (path,) = (path for path in PATHS if path.stem == stem)
    frames = list(clsco.render(small(path), truth=(), method="scatter"))
    for frame, wanted in zip(frames, exact(path), strict=True):
        assert frame.metadata["blur_method"] == "scatter"
        (color,) = compare(frame, wanted)
        assert color.count == 0, color


@pytest.mark.parametrize(
    "path",
    [pytest.param(p, marks=[pytest.mark.slow] * (p.stem not in SINGLE)) for p in PATHS],
    ids=name,
)
def test_every_output_agrees_in_single_precision(path: Path, small: Small, exact: Exact) -> None:
    frames = list(clsco.render(small(path), precision="single"))
    assert frames[0].metadata["precision"] == "single"
    assert [found for found in worst(frames, exact(path)) if not found.agrees] == []
