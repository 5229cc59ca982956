"""Pupils from image files: what is read, how scenes name them, and what is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import imageio.v3 as iio
import numpy as np
import pytest

import clsco
from clsco.errors import ClscoError
from clsco.frame.provenance import record, scene_sha256
from clsco.inputs.pupils import load_point_spread
from clsco.optics.pupils.image import MOST_CELLS, Image
from clsco.scene.changes import dump
from clsco.scene.file import load_scene
from clsco.scene.model import Aperture, Psf

SCENE = """
[camera]
resolution = [24, 16]
[aperture]
shape = "image"
image = "mask.png"
[[object]]
shape = "plane"
distance = 300
"""


def mask(side: int = 32) -> np.ndarray[Any, np.dtype[np.uint8]]:
    """White on the right."""
    image = np.zeros((side, side), np.uint8)
    image[:, side // 2 :] = 255
    return image


def pupil_of(image: Any) -> Image:
    loaded = load_point_spread(Psf(), Aperture(shape="image", image=image)).pupil
    assert isinstance(loaded, Image)
    return loaded


def test_a_scene_names_a_file_beside_it(tmp_path: Path) -> None:
    iio.imwrite(tmp_path / "mask.png", mask())
    (tmp_path / "scene.toml").write_text(SCENE)
    scene = load_scene(tmp_path / "scene.toml")
    assert scene.aperture.image == str(tmp_path / "mask.png")
    (frame,) = clsco.render(scene)
    (same,) = clsco.render(clsco.parse_scene(dump(scene)))
    assert frame.color.tobytes() == same.color.tobytes()
    content = record(scene)
    assert list(content["apertures_sha256"]) == [str(tmp_path / "mask.png")]
    before = scene_sha256(scene)
    iio.imwrite(tmp_path / "mask.png", mask()[::-1, ::-1])
    assert scene_sha256(scene) != before
    (turned,) = clsco.render(scene)
    assert np.abs(turned.color - frame.color).max() > 1e-3


def test_an_array_is_written_beside_the_scene(tmp_path: Path) -> None:
    aperture = {"shape": "image", "image": mask().astype(np.float32) / 255}
    scene = clsco.parse_scene({"aperture": aperture, "object": [{"shape": "plane", "distance": 300}]})
    clsco.dump_scene(scene, tmp_path / "scene.toml")
    assert (tmp_path / "scene_aperture_image.npy").exists()
    assert pupil_of(load_scene(tmp_path / "scene.toml").aperture.image) == pupil_of(scene.aperture.image)
    with pytest.raises(ClscoError, match=r"^scene: aperture\.image: "):
        clsco.dump_scene(scene)


def test_values_are_linear_and_large_images_are_resampled() -> None:
    codes = np.full((40, 40), 255, np.uint8)
    codes[20:] = 188  # half of white
    assert pupil_of(codes).image[35, 20] == pytest.approx(0.503, abs=0.005)
    assert pupil_of(np.repeat(codes[..., None], 3, axis=2)) == pupil_of(codes)
    large = pupil_of(mask(1200))
    assert large.count == MOST_CELLS
    assert large.second_moment == pytest.approx(pupil_of(mask(512)).second_moment, rel=1e-3)


@pytest.mark.parametrize(
    ("image", "message"),
    [
        ("bricks", "aperture.image: must be an image file; got 'bricks'"),
        (np.zeros((8, 9), np.uint8), "aperture.image: must be a square; got 9 x 8 px"),
        (np.zeros((8, 8), np.uint8), "aperture.image: must let light pass inside its circle; got black"),
        (np.eye(8, dtype=np.float32) - 0.5, "aperture.image: must be at least 0 everywhere; got -0.5"),
        (np.arange(192, dtype=np.uint8).reshape(8, 8, 3), "aperture.image: must be gray; got colors"),
    ],
)
def test_images_that_cannot_be(image: Any, message: str) -> None:
    scene = {"aperture": {"shape": "image", "image": image}, "object": [{"shape": "plane", "distance": 300}]}
    with pytest.raises(ClscoError) as caught:
        list(clsco.render(scene))
    assert str(caught.value) == message
    with pytest.raises(ClscoError) as caught:
        clsco.defocus(np.zeros((8, 8), np.float32), np.ones((8, 8)), aperture={"shape": "image", "image": image})
    assert str(caught.value) == message


def test_a_missing_file_is_listed_with_other_faults(tmp_path: Path) -> None:
    (tmp_path / "scene.toml").write_text(SCENE + 'texture = "gone.png"\n')
    with pytest.raises(ClscoError) as caught:
        list(clsco.render(tmp_path / "scene.toml"))
    text = str(caught.value)
    assert "object[0].texture: " in text
    assert "aperture.image: " in text
