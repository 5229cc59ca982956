"""Radiance below 0, as filters that ring leave it, goes through all that is linear, and ends at 0 in codes alone."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray

import clsco
from clsco.files.images import read_image, write_exr_image, write_png
from clsco.files.truth_codes import pfm_bytes
from clsco.inputs.textures import load_texture
from tests.command import clsco_
from tests.scenes import assert_agree, reference_frames, rendered, scene_from
from tests.slow import combined

Array = NDArray[Any]
RINGING = (np.random.default_rng(8).random((24, 32, 3)) * 1.4 - 0.3).astype(np.float32)
SAVERS: dict[str, Callable[[Path, Array], object]] = {
    "tif": lambda path, data: tifffile.imwrite(path, data, photometric="rgb"),
    "exr": write_exr_image,
    "pfm": lambda path, data: path.write_bytes(pfm_bytes(data)),
    "npy": np.save,
}


@pytest.mark.parametrize("suffix", SAVERS)
def test_every_float_file_may_hold_it(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a.{suffix}"
    SAVERS[suffix](path, RINGING)
    picture = read_image(path)
    np.testing.assert_array_equal(picture.data, RINGING)
    count = int((RINGING < 0).sum())
    assert picture.notes() == (f"{count} of 2304 values are below 0: floats keep them, codes end at 0",)
    texture = load_texture(path, "srgb")
    np.testing.assert_array_equal(texture.radiance, RINGING)
    assert texture.brightest == pytest.approx(1.4, abs=0.01)  # the span
    hidden = np.zeros((24, 32), np.bool_)
    hidden[:, 1:] = True
    assert read_image(path, hidden).below == int((RINGING[:, 0] < 0).sum())


@pytest.mark.parametrize(
    ("method", "occlusion"),
    combined(
        ("gather", "scatter", "tiles", "convolve"),
        ("none", "layered"),
        kept=[("gather", "layered"), ("scatter", "none"), ("convolve", "none")],
    ),
)
def test_blur_is_linear_below_0_as_well(method: str, occlusion: str) -> None:
    """That of a difference is the difference of two: of what is never below 0."""
    radius = np.full((24, 32), 5.0) if method == "convolve" else np.linspace(-6, 6, 24 * 32).reshape(24, 32)
    psf: Any = {"occlusion": occlusion, "tilt": method != "convolve"}
    above, below = np.maximum(RINGING, 0), np.maximum(-RINGING, 0)
    blurred, plus, minus = (clsco.defocus(image, radius, psf, method=method) for image in (RINGING, above, below))
    assert blurred.min() < -0.01 or method == "convolve"
    np.testing.assert_allclose(blurred, plus - minus, rtol=0, atol=1e-5)


def walls(**keys: Any) -> clsco.Scene:
    """A wall, and a card before it, both with radiance below 0."""
    plane = {"shape": "plane", "distance": 290.0, "texture": RINGING}
    card = {"shape": "rectangle", "size": [4.0, 3.0], "center": [0.5, 0.0, 240.0], "texture": RINGING[::-1]}
    tables = {"camera": {"resolution": [32, 24], "pixel_pitch": 0.05}, "object": [card, plane]}
    return scene_from(tables | keys)


MOVING: Any = {"shape": "sphere", "center": [0.0, 0.0, 280.0], "radius": 3.0, "texture": RINGING}
FORWARD: Any = {
    "camera": {"resolution": [32, 24], "pixel_pitch": 0.05},
    "object": [MOVING | {"motion": {"velocity": [3.0, 0.0, 0.0]}}, {"shape": "plane", "texture": RINGING[:, ::-1]}],
    "motion": {"warp": "forward"},
    "sequence": {"samples": 3},
}


@pytest.mark.slow
@pytest.mark.parametrize("scene", [
    walls(), walls(psf={"occlusion": "layered"}), scene_from(FORWARD | {"fill": {"method": "ait"}}),
    scene_from(FORWARD | {"fill": {"method": "mean_median"}}),
], ids=["visibility", "layered", "ait", "mean and median"])  # fmt: skip
def test_scenes_agree_with_the_reference(scene: clsco.Scene) -> None:
    frames = rendered(scene)
    assert min(float(frame.color.min()) for frame in frames) < -0.01
    assert_agree(frames, reference_frames(scene))


@pytest.mark.parametrize("method", ["biharmonic", "texture", "mean-median"])
def test_holes_are_filled_from_it(method: str) -> None:
    """A ramp from -1 to 1 goes on through a hole."""
    ramp = np.broadcast_to(np.linspace(-1, 1, 48, dtype=np.float32), (32, 48)).copy()
    hole = np.zeros(ramp.shape, np.bool_)
    hole[12:17, 10:15] = True
    filled = clsco.inpaint(np.where(hole, np.float32(np.nan), ramp), hole, method=method)
    np.testing.assert_allclose(filled, ramp, rtol=0, atol=0.12)
    np.testing.assert_array_equal(filled[~hole], ramp[~hole])


def test_codes_end_at_0_and_that_is_said(tmp_path: Path) -> None:
    SAVERS["tif"](tmp_path / "image.tif", RINGING)
    np.save(tmp_path / "radius.npy", np.zeros((24, 32)))
    write_png(tmp_path / "mask.png", np.zeros((24, 32), np.uint8))
    image = tmp_path / "image.tif"
    line = f"{image}: {int((RINGING < 0).sum())} of 2304 values are below 0: floats keep them, codes end at 0\n"
    for out in ("out.tif", "out.exr", "out.png"):
        result = clsco_("defocus", image, tmp_path / "radius.npy", "--unit", "coc", "-o", tmp_path / out)
        assert (result.exit_code, result.stderr.startswith(line)) == (0, True), result.output
        data = read_image(tmp_path / out).data
        if out.endswith("png"):
            assert (data[RINGING <= 0] == 0).all()
        else:
            np.testing.assert_allclose(data, RINGING, rtol=0, atol=1e-6)
    result = clsco_("inpaint", image, tmp_path / "mask.png", "-o", tmp_path / "filled.tif")
    assert (result.exit_code, result.stderr) == (0, line)
    np.testing.assert_array_equal(read_image(tmp_path / "filled.tif").data, RINGING)
