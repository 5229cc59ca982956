"""Soft depth edges: each depth between two surfaces becomes that of one, and what is no soft edge stays as it is."""

from __future__ import annotations

import io
from collections.abc import Callable
from typing import Any

import imagecodecs
import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

import clsco
from clsco.inputs.soft_edges import assign_soft_edges
from clsco.optics.lens import blur_radius
from clsco.scene.model import Camera
from tests.command import clsco_
from tests.slow import mostly_slow

Array = NDArray[Any]
SIDE, FINE = 96, 8
NEAR, FAR = -11.0, 0.0  # R, px
ROW, J = np.mgrid[:SIDE, :SIDE]


def fine_disc() -> Array:
    """Mask of a disc, (SIDE FINE, SIDE FINE)."""
    y, x = (np.mgrid[: SIDE * FINE, : SIDE * FINE] + 0.5) / FINE - SIDE / 2
    return np.asarray(np.hypot(x - 0.7, y + 0.4) < 27)


DISC = fine_disc()
COVERED = DISC.reshape(SIDE, FINE, SIDE, FINE).mean((1, 3))
HARD = np.where(COVERED >= 0.5, NEAR, FAR)


def smooth(image: Array, sigma: float) -> Array:
    """Blurred by a Gaussian."""
    offset = np.arange(-8, 9)
    weights = np.exp(-0.5 * (offset / sigma) ** 2)
    for _ in range(2):
        padded = np.pad(image, ((8, 8), (0, 0)), mode="edge")
        rows = range(len(offset))
        image = sum(weights[k] * padded[k : k + len(image)] for k in rows).T / weights.sum()
    return image


def enlarged(image: Array, how: Image.Resampling) -> Array:
    """Halved and enlarged again."""
    half = image.reshape(SIDE // 2, 2, SIDE // 2, 2).mean((1, 3)).astype(np.float32)
    return np.asarray(Image.fromarray(half).resize((SIDE, SIDE), how), np.float64)


def of_codes(radius: Array) -> Array:
    """Compressed by JPEG, as codes of 8 bits."""
    codes, file = np.rint(200 + 10 * radius).astype(np.uint8), io.BytesIO()
    Image.fromarray(codes).save(file, "JPEG", quality=90)
    return (np.asarray(Image.open(file)).astype(np.float64) - 200) / 10


WAYS: dict[str, Callable[[], Array]] = {
    "averaged": lambda: NEAR * COVERED + FAR * (1 - COVERED),
    "blurred by 0.7 px": lambda: smooth(HARD, 0.7),
    "blurred by 1 px": lambda: smooth(HARD, 1.0),
    "blurred by 2 px": lambda: smooth(HARD, 2.0),
    "halved, bilinear": lambda: enlarged(HARD, Image.Resampling.BILINEAR),
    "halved, bicubic": lambda: enlarged(HARD, Image.Resampling.BICUBIC),
    "halved, bicubic, JPEG": lambda: of_codes(enlarged(HARD, Image.Resampling.BICUBIC)),
}


def without(radius: Array, image: Array | None = None) -> Array:
    """The map without its soft edges."""
    pixels, found = assign_soft_edges(radius, None, None if image is None else lambda: image)
    result = radius.astype(np.float64)
    result.flat[pixels] = found
    return result


@pytest.mark.parametrize("way", mostly_slow(list(WAYS), ["averaged", "blurred by 1 px", "halved, bicubic, JPEG"]))
@pytest.mark.parametrize("colored", [True, False], ids=["color", "no image"])
def test_an_edge_becomes_that_of_the_hard_map(way: str, colored: bool) -> None:
    soft = WAYS[way]()
    share = COVERED[..., None]
    image = (share * [0.8, 0.3, 0.1] + (1 - share) * [0.1, 0.4, 0.7]).astype(np.float32)
    found = without(soft, image if colored else None)
    outline = 2 * np.pi * 27  # px
    assert (np.abs(soft - HARD) > 1.5).sum() > 0.5 * outline
    # What is left is at 45 degrees, where an edge blurred by 2 px is longest.
    assert ((found > NEAR + 2) & (found < FAR - 2)).sum() < (0.15 if "2 px" in way else 0.01) * outline
    assert (np.abs(found - HARD) > 1.5).sum() < (0.25 if "2 px" in way else 0.15) * outline
    few = (COVERED > 0) & (COVERED < 1) & (np.abs(COVERED - 0.5) > 0.45)  # in steps that are too small to be an edge's
    assert way != "averaged" or (np.abs(found - HARD)[few] > 0.01).sum() < 0.4 * few.sum()


def test_surfaces_go_on_as_they_are() -> None:
    """Between a slanted plane and a sphere, averaged over each pixel: both continue to the edge."""
    y, x = (np.mgrid[: SIDE * FINE, : SIDE * FINE] + 0.5) / FINE - SIDE / 2
    dome, plane = -8 - 0.002 * (40**2 - x**2 - y**2), 3 + 0.03 * x + 0.02 * y
    fine = np.where(np.hypot(x, y) < 30, dome, plane)
    found = without(fine.reshape(SIDE, FINE, SIDE, FINE).mean((1, 3)))
    nearest = np.minimum(np.abs(found - dome[4::8, 4::8]), np.abs(found - plane[4::8, 4::8]))
    assert (nearest > 0.6).sum() < 20
    assert (np.abs(fine.reshape(SIDE, FINE, SIDE, FINE).mean((1, 3)) - fine[4::8, 4::8]) > 1.0).sum() > 140


def dome(relief: float, step: float) -> Array:
    away = np.hypot(ROW - SIDE / 2 + 0.3, J - SIDE / 2 - 0.2)
    return np.where(away < 35, -relief * np.sqrt(np.maximum(1 - (away / 35) ** 2, 0)), step)


RNG = np.random.default_rng(4)
KEPT = {
    "hard": HARD,
    "two slanted planes": np.where(J < 40, -5 + 0.1 * ROW, 4 + 0.05 * J),
    "a plane": 0.5 * J + 0.3 * ROW,
    "a steep plane": 2.0 * J + ROW,
    "spheres": np.hstack([dome(1, 1.5), dome(3, 3), dome(8, 6), dome(3, 12)]),
    "steps of 1 px": 2.0 * J,
    "steps of 3 px": 2.0 * (J // 3),
    "steps of 10 px": 2.0 * (J // 10),
    "a ramp of 6 px": np.clip((J - 40) / 6, 0, 1) * 10.0,
    "a ramp of 20 px": np.clip((J - 40) / 20, 0, 1) * 10.0,
    "a smooth ramp": 5 * np.tanh((J - 48.3) / 5),
    "noise": RNG.normal(0, 2, (SIDE, SIDE)),
    "a wire of 1 px": np.where(J == 40, -6.0, 4.0),
    "a post of 2 px between two walls": np.where(J < 40, 0.0, np.where(J < 42, 5.0, 10.0)),
    "a post of 5 px between two walls": np.where(J < 40, 0.0, np.where(J < 45, 5.0, 10.0)),
    "fewer pixels than surfaces need": np.linspace(-3.0, 4.0, 6).reshape(2, 3),
    "a row": np.where(np.arange(9) < 4, 0.0, 5.0)[None],
    "less than a pixel": 0.04 * (HARD + smooth(HARD, 1.0)),
}


@pytest.mark.parametrize("kind", KEPT)
def test_what_is_no_soft_edge_stays(kind: str) -> None:
    assert len(assign_soft_edges(KEPT[kind])[0]) == 0


def test_a_thin_post_of_its_own_color_stays() -> None:
    """One pixel at a depth between two walls is an averaged edge, but for its color."""
    radius = np.where(J < 40, 0.0, np.where(J == 40, 5.0, 10.0))
    walls = np.where((J < 40)[..., None], [0.8, 0.2, 0.1], [0.1, 0.2, 0.8])
    mixed = np.where((J == 40)[..., None], [0.45, 0.2, 0.45], walls)
    post = np.where((J == 40)[..., None], [0.1, 0.9, 0.1], walls)
    assert np.array_equal(without(radius, post), radius)
    assert set(np.unique(without(radius, mixed))) == {0.0, 10.0}


def test_color_says_where_an_edge_is() -> None:
    """An edge in depth that is a pixel off is moved to that in color; without contrast it stays."""
    depth = smooth(np.where(J < 40, 0.0, 10.0), 1.0)
    for edge in (39, 40, 41):
        image = np.where(edge > J, 0.8, 0.2).astype(np.float32)
        assert np.array_equal(np.rint(without(depth, image)), np.where(edge > J, 0.0, 10.0))
    assert np.array_equal(np.rint(without(depth, np.full_like(depth, 0.5))), np.where(J < 40, 0.0, 10.0))


def test_nothing_is_no_surface() -> None:
    soft = smooth(HARD, 1.0)
    soft[30:40, 20:60] = np.nan
    pixels, found = assign_soft_edges(soft)
    assert np.isfinite(found).all()
    assert not np.isnan(soft.flat[pixels]).any()


CAMERA: dict[str, Any] = {"focus_distance": 300.0, "pixel_pitch": 0.06, "focal_length": 20.0, "f_number": 1.0}


def soft_scene(unit: str, **keys: Any) -> clsco.Scene:
    """The disc before a wall, its depths averaged over each pixel."""
    depth = 150.0 * COVERED + 300.0 * (1 - COVERED)
    image = (0.7 * COVERED + 0.2 * (1 - COVERED)).astype(np.float32)
    radius = blur_radius(Camera(**CAMERA), 1 / depth)
    item = {"shape": "depth_map", "texture": image, "depth": depth if unit == "mm" else radius, "unit": unit} | keys
    camera = CAMERA | {"resolution": (SIDE, SIDE)}
    return clsco.parse_scene({"camera": camera, "image": {"transfer": "linear"}, "object": [item]})


def test_scenes_and_arrays_alike() -> None:
    scene = soft_scene("coc")
    frame = clsco.render_frame(scene, truth=("blur_radius",))
    kept = clsco.render_frame(soft_scene("coc", soft_edges="keep"), truth=("blur_radius",))
    assert frame.blur_radius is not None
    assert kept.blur_radius is not None
    between = [((each > NEAR + 1) & (each < FAR - 1)).sum() for each in (kept.blur_radius, frame.blur_radius)]
    assert between[0] > 100
    assert between[1] < 3
    item = scene.objects[0]
    assert isinstance(item, clsco.DepthMap)
    image, radius = np.asarray(item.texture), np.asarray(item.depth)
    found, report = clsco.defocus(image, radius, return_report=True)
    np.testing.assert_allclose(found, frame.color, atol=1e-5)
    assert report.soft_edges == (kept.blur_radius != frame.blur_radius).sum()
    as_given, none = clsco.defocus(image, radius, soft_edges="keep", return_report=True)
    np.testing.assert_allclose(as_given, kept.color, atol=1e-5)
    assert none.soft_edges == 0
    assert np.abs(found - as_given).max() > 0.05
    with pytest.raises(clsco.ClscoError, match='soft_edges: must be "assign" or "keep"; got \'snap\''):
        clsco.defocus(image, radius, soft_edges="snap")  # type: ignore[call-overload]


def test_the_command_counts_them(tmp_path: Any) -> None:
    depth = (150.0 * COVERED + 300.0 * (1 - COVERED)).astype(np.float32)
    np.save(tmp_path / "depth.npy", depth)
    (tmp_path / "image.png").write_bytes(imagecodecs.png_encode(np.rint(180 * COVERED + 40).astype(np.uint8)))
    files = [tmp_path / name for name in ("image.png", "depth.npy")]
    lens = ["--focal-length", "20", "--f-number", "1", "--focus-distance", "300", "--pixel-pitch", "0.06", "--quiet"]
    both = []
    for more in ([], ["--soft-edges", "keep"]):
        result = clsco_("defocus", *files, "-o", tmp_path / "out.png", *lens, *more)
        assert result.exit_code == 0, result.output
        both.append(result.stderr)
    assert " of 9216 pixels at soft edges get the depth of one side" in both[0]
    assert "soft edges" not in both[1]
    result = clsco_("defocus", *files, "-o", tmp_path / "o.png", "--soft-edges", "cut")
    assert result.exit_code == 1
    assert "soft_edges" in result.stderr
