"""EXR files with several layers, parts and windows: which channels are the image and the depth, and where they lie."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest
from numpy.typing import NDArray

from clsco.errors import FileError
from clsco.files.images import image_size, read_image, write_png
from clsco.files.layers import depth_channels, full_names, image_channels
from clsco.inputs.depth_files import read_depth
from tests.command import clsco_, done

Array = NDArray[Any]
RNG = np.random.default_rng(6)
PHOTO, ALBEDO = RNG.random((2, 12, 16, 3), np.float32)
DEPTH = np.linspace(0.2, 0.4, 12 * 16, dtype=np.float32).reshape(12, 16)


def layer(name: str, image: Array, names: str = "RGB") -> dict[str, Array]:
    planes = np.moveaxis(np.atleast_3d(image), 2, 0)
    return {f"{name}{own}": np.ascontiguousarray(plane) for own, plane in zip(names, planes, strict=False)}


def save(path: Path, *parts: dict[str, Array], names: tuple[str, ...] = (), **window: Any) -> Path:
    """An EXR with a part for each mapping of channels."""
    header = {"type": OpenEXR.scanlineimage, **window}
    if not names:
        OpenEXR.File(header, parts[0]).write(str(path))
    else:
        pages = [OpenEXR.Part(header | {"name": n}, part, n) for n, part in zip(names, parts, strict=True)]
        OpenEXR.File(pages).write(str(path))
    return path


ALPHA = {"ViewLayer.Combined.A": np.ones((12, 16), np.float32)}
BLENDER = (
    layer("ViewLayer.Combined.", PHOTO) | ALPHA | layer("ViewLayer.Depth.", DEPTH, "Z")
    | layer("ViewLayer.Normal.", ALBEDO, "XYZ") | layer("ViewLayer.DiffCol.", ALBEDO)
)  # fmt: skip
PARTS = (layer("", PHOTO), layer("", ALBEDO), layer("", DEPTH, "Z"))


def test_an_image_and_its_depth_in_one_file_of_layers(tmp_path: Path) -> None:
    path = save(tmp_path / "render.exr", BLENDER)
    np.testing.assert_array_equal(read_image(path).data, PHOTO)
    np.testing.assert_array_equal(read_depth(path), DEPTH)
    for name in ("ViewLayer.DiffCol", "diffcol", "DiffCol"):
        np.testing.assert_array_equal(read_image(path, layer=name).data, ALBEDO)
    for name in ("Depth", "ViewLayer.Depth", "ViewLayer.Depth.Z"):
        np.testing.assert_array_equal(read_depth(path, name), DEPTH)


def test_parts_may_have_channels_of_equal_names(tmp_path: Path) -> None:
    path = save(tmp_path / "render.exr", *PARTS, names=("rgba", "albedo", "depth"))
    np.testing.assert_array_equal(read_image(path).data, PHOTO)
    np.testing.assert_array_equal(read_image(path, layer="albedo").data, ALBEDO)
    np.testing.assert_array_equal(read_depth(path), DEPTH)
    save(path, *PARTS, names=("one", "two", "three"))
    with pytest.raises(FileError, match=r"must hold one image, or its layer must be named; got layers one two$"):
        read_image(path)
    np.testing.assert_array_equal(read_image(path, layer="two").data, ALBEDO)


def test_a_layer_that_is_not_there_is_refused(tmp_path: Path) -> None:
    path = save(tmp_path / "render.exr", BLENDER)
    with pytest.raises(FileError, match=r"must hold the channels R G B or Y in a layer Beauty; got ViewLayer\.Comb"):
        read_image(path, layer="Beauty")
    with pytest.raises(FileError, match=r"or Z or V of a layer 'De\\npth'; got ViewLayer\.Combined\.A "):
        read_depth(path, "De\npth")
    write_png(tmp_path / "a.png", np.zeros((2, 2), np.uint8))
    for read in (lambda: read_image(tmp_path / "a.png", layer="Z"), lambda: read_depth(tmp_path / "a.png", "Z")):
        with pytest.raises(FileError, match=r"only an EXR has layers, such as Z; got PNG$"):
            read()


@pytest.mark.parametrize(("names", "layer_name", "expected"), [
    (["R", "G", "B"], None, ["R", "G", "B"]),
    (["B", "G", "R", "A", "Z"], None, ["R", "G", "B", "A"]),
    (["Y"], None, ["Y"]),
    (["R", "G", "B", "diffuse.R", "diffuse.G", "diffuse.B"], None, ["R", "G", "B"]),
    (["R", "G", "B", "diffuse.R", "diffuse.G", "diffuse.B"], "diffuse", ["diffuse.R", "diffuse.G", "diffuse.B"]),
    (["a.Y", "a.Z"], None, ["a.Y"]),
    (["a.R", "a.G", "b.R", "b.G", "b.B"], None, ["b.R", "b.G", "b.B"]),
    (["x.a.Y", "y.a.Y"], "a", "layers x.a y.a"),
    (["Y", "RY", "BY"], None, "BY RY Y"),
    (["R", "G"], None, "G R"),
    ([], None, "none"),
])  # fmt: skip
def test_image_channels(names: list[str], layer_name: str | None, expected: list[str] | str) -> None:
    if isinstance(expected, list):
        assert image_channels(names, layer_name) == expected
    else:
        with pytest.raises(LookupError) as caught:
            image_channels(names, layer_name)
        assert caught.value.args[1] == expected


@pytest.mark.parametrize(("names", "layer_name", "expected"), [
    (["R", "G", "B", "Z"], None, ["Z"]),
    (["depth.R", "depth.G", "depth.B"], "depth", ["depth.R", "depth.G", "depth.B"]),
    (["a.Z", "b.Z"], None, ["a.Z", "b.Z"]),
    (["a.Z", "b.Z"], "B", ["b.Z"]),
    (["a.X", "a.Y", "a.Z"], "a", ["a.Y"]),
    (["a.X", "a.Y", "a.Z"], "a.Z", ["a.Z"]),
    (["a.Z"], "c", []),
])  # fmt: skip
def test_depth_channels(names: list[str], layer_name: str | None, expected: list[str]) -> None:
    assert depth_channels(names, layer_name) == expected


def test_parts_without_names_of_their_own_are_counted() -> None:
    named = full_names([("", ["R"]), ("same", ["R"]), ("same", ["same.R"]), ("left", ["left.Z"])])
    assert named == [{"R": "part0.R"}, {"R": "part1.R"}, {"same.R": "part2.same.R"}, {"left.Z": "left.Z"}]
    assert full_names([("any", ["R", "a.Z"])]) == [{"R": "R", "a.Z": "a.Z"}]


@pytest.mark.parametrize(("first", "last"), [
    ((0, 0), (15, 11)), ((4, 3), (9, 8)), ((-2, -1), (13, 10)), ((-3, -2), (18, 14)), ((12, 6), (20, 9)),
    ((20, 20), (35, 31)),
])  # fmt: skip
def test_windows_are_laid_into_the_display(tmp_path: Path, first: tuple[int, int], last: tuple[int, int]) -> None:
    columns, rows = last[0] - first[0] + 1, last[1] - first[1] + 1
    data = RNG.random((rows, columns, 3), np.float32) + np.float32(0.1)
    window: Any = {"dataWindow": (first, last), "displayWindow": ((0, 0), (15, 11))}
    path = save(tmp_path / "a.exr", layer("", data) | {"Z": data[..., 1].copy()}, **window)
    i, j = np.indices((12, 16))
    inside = (i >= first[1]) & (i <= last[1]) & (j >= first[0]) & (j <= last[0])
    picture, depth = read_image(path).data, read_depth(path)
    assert image_size(path) == (16, 12)
    assert (picture.shape, depth.shape) == ((12, 16, 3), (12, 16))
    np.testing.assert_array_equal(picture[inside], data[i[inside] - first[1], j[inside] - first[0]])
    np.testing.assert_array_equal(picture[~inside], 0)
    np.testing.assert_array_equal(depth, np.where(inside, picture[..., 1], np.nan))


def test_commands_take_layers(tmp_path: Path) -> None:
    """One file is both image and depth; named layers give what files with these alone give."""
    render, options = save(tmp_path / "render.exr", BLENDER), ("--unit", "m", "--pixel-pitch", 0.05)
    photo, albedo = (save(tmp_path / f"{n}.exr", layer("", image)) for n, image in (("p", PHOTO), ("a", ALBEDO)))
    depth = save(tmp_path / "z.exr", layer("", DEPTH, "Z"))
    named = ("--image-layer", "DiffCol", "--depth-layer", "Depth")
    for image, words in ((photo, ()), (albedo, named)):
        one = done("defocus", render, render, "-o", tmp_path / "a.tif", *options, *words)
        two = done("defocus", image, depth, "-o", tmp_path / "b.tif", *options)
        np.testing.assert_array_equal(read_image(tmp_path / "a.tif").data, read_image(tmp_path / "b.tif").data)
        assert one.stderr.rpartition(": R ")[2] == two.stderr.rpartition(": R ")[2]
    result = clsco_("defocus", render, render, "-o", render, *options, *named)
    assert (result.exit_code, "must not be the image or the depth" in result.stderr) == (1, True)
    result = clsco_("defocus", render, depth, "-o", tmp_path / "a.tif", *options, "--image-layer", "none")
    assert (result.exit_code, "in a layer none; got ViewLayer" in result.stderr) == (1, True)
    save(tmp_path / "small.exr", layer("a.", DEPTH[:5], "Z"))
    result = clsco_("defocus", photo, tmp_path / "small.exr", "-o", tmp_path / "a.tif", "--depth-layer", "a")
    assert (result.exit_code, "16 x 12 pixels; got 16 x 5" in result.stderr) == (1, True)
    write_png(tmp_path / "mask.png", np.zeros((12, 16), np.uint8))
    result = done("inpaint", render, tmp_path / "mask.png", "-o", tmp_path / "c.tif", "--image-layer", "DiffCol")
    np.testing.assert_array_equal(read_image(tmp_path / "c.tif").data, ALBEDO)
