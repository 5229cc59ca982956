"""Textures and depths as arrays and paths: kept by content, the bits of files, refused with one message."""

from __future__ import annotations

import copy
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import clsco
from clsco.files.decoders import MAX_PIXELS, MAX_SIDE
from clsco.scene.arrays import MAX_ARRAY_PIXELS, MAX_ARRAY_SIDE, ArrayInput
from tests.scenes import refusals

RNG = np.random.default_rng(4)
GRAY = RNG.integers(0, 256, (6, 8), np.uint8)
COLOR = RNG.random((6, 8, 3))


def kept(array: Any) -> ArrayInput:
    texture = clsco.Sphere(texture=array).texture
    assert isinstance(texture, ArrayInput)
    return texture


def test_a_copy_is_kept() -> None:
    given = GRAY.copy()
    ball = clsco.Sphere(texture=given)
    given[:] = 0
    np.testing.assert_array_equal(np.asarray(ball.texture), GRAY)
    assert ball == clsco.Sphere(texture=GRAY)
    with pytest.raises(ValueError, match="read-only"):
        kept(GRAY).array[0, 0] = 1


@pytest.mark.parametrize(
    ("given", "dtype"),
    [
        (GRAY, np.uint8),
        (GRAY.astype(">u2"), np.uint16),
        (COLOR, np.float32),
        (COLOR.astype(np.float16), np.float32),
        (COLOR[::-1, ::2], np.float32),
    ],
)
def test_what_is_kept(given: NDArray[Any], dtype: type[np.generic]) -> None:
    array = kept(given).array
    assert array.dtype == dtype
    assert array.flags.c_contiguous
    np.testing.assert_array_equal(array, given.astype(dtype))
    depth = clsco.DepthMap(depth=given[..., 0] if given.ndim == 3 else given).depth
    assert isinstance(depth, ArrayInput)
    assert depth.array.dtype == (np.float64 if given.dtype.kind == "f" else dtype)


def test_scenes_compare_by_content() -> None:
    one, same, other = (clsco.Scene(objects=(clsco.Plane(texture=a),)) for a in (GRAY, GRAY.copy(), GRAY + 1))
    assert one == same
    assert hash(one) == hash(same)
    assert one != other
    assert one != clsco.Scene(objects=(clsco.Plane(texture="bricks"),))
    assert kept(GRAY) != kept(GRAY.astype(np.uint16))
    assert kept(GRAY) != kept(GRAY.reshape(8, 6))
    for again in (copy.deepcopy(one), copy.copy(one), pickle.loads(pickle.dumps(one)), one.model_copy(deep=True)):
        assert again == one
        texture = again.objects[0].texture
        assert isinstance(texture, ArrayInput)
        assert not texture.array.flags.writeable


def test_a_path_is_its_text() -> None:
    item = clsco.DepthMap(depth=Path("maps") / "z.npy", texture=Path("wall.png"))
    assert (item.depth, item.texture) == ("maps/z.npy", "wall.png")
    assert item.files() == {"depth": "maps/z.npy", "texture": "wall.png"}
    assert clsco.parse_scene({"object": [{"shape": "plane", "texture": Path("a.png")}]}).objects[0].texture == "a.png"


def test_an_array_serves_as_the_other_kind() -> None:
    depth = clsco.DepthMap(depth=COLOR[..., 0]).depth
    assert kept(depth) == kept(COLOR[..., 0])
    assert kept(kept(GRAY)) == kept(GRAY)


SIZE = "an array must have from 1 to 65536 rows and columns, and at most 134217728 pixels"
VALUES = "values of an array must be finite"
NAN = np.where(np.arange(48).reshape(6, 8) == 19, np.nan, 1.0)
WRONG: list[tuple[Any, str]] = [
    (np.zeros(5), "an array must have the shape (rows, columns) or (rows, columns, 3); got (5,)"),
    (np.zeros((2, 2, 4)), "an array must have the shape (rows, columns) or (rows, columns, 3); got (2, 2, 4)"),
    (np.zeros((0, 4)), f"{SIZE}; got (0, 4)"),
    (np.broadcast_to(np.uint8(0), (2**14, 2**14)), f"{SIZE}; got (16384, 16384)"),
    (np.broadcast_to(np.uint8(0), (2, 65537)), f"{SIZE}; got (2, 65537)"),
    (np.zeros((2, 2), object), "an array must hold uint8, uint16, float16, float32 or float64; got object"),
    (np.zeros((2, 2), int), "an array must hold uint8, uint16, float16, float32 or float64; got int64"),
    (NAN, f"{VALUES}; got nan at row 2, column 3 (1 in all)"),
    (np.full((2, 2), 1e39), f"{VALUES}; got 1e+39 at row 0, column 0 (4 in all)"),
    (np.ma.masked_less(GRAY, 300), "an array must have no masked values; got 48 of them"),
    ([[0.0, 1.0]], "must be text; got a list of 1 entries"),
]


WRONG_DEPTHS: list[tuple[Any, str]] = [
    (COLOR, "an array must have the shape (rows, columns); got (6, 8, 3)"),
    (COLOR[..., 0] + 0j, "an array must hold integers or floats; got complex128"),
    (COLOR[:0, :, 0], f"{SIZE}; got (0, 8)"),
]
KEYS = [("sphere", "texture", *row) for row in WRONG] + [("depth_map", "depth", *row) for row in WRONG_DEPTHS]


@pytest.mark.parametrize(("shape", "key", "given", "message"), KEYS)
def test_wrong_arrays_are_refused(shape: str, key: str, given: Any, message: str) -> None:
    items = [{"shape": shape, key: given}, {"shape": "plane", "distance": -1.0}]
    assert refusals(clsco.parse_scene, {"object": items}) == (
        f"scene: object[0].{key}: {message}",
        "scene: object[1].distance: must be greater than 0 mm; got -1.0",
    )


def test_limits_are_those_of_files() -> None:
    assert (MAX_ARRAY_PIXELS, MAX_ARRAY_SIDE) == (MAX_PIXELS, MAX_SIDE)
