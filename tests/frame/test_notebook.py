"""Frames as people see and save them: a line, pictures of notebooks, codes, files."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from clsco.errors import ArgumentError, FileError
from clsco.files.images import read_image
from clsco.files.transfer import encode
from clsco.frame.frame import Frame
from clsco.frame.notebook import LARGEST_SHOWN, png_to_show
from clsco.frame.outputs import OUTPUTS


def made(color: tuple[int, ...] = (6, 8, 3), **more: object) -> Frame:
    values = np.linspace(0, 1, int(np.prod(color)), dtype=np.float32).reshape(color)
    return Frame(index=3, color=values, metadata={"f_number": 2.0, "bits": 8}, **more)  # type: ignore[arg-type]


def test_every_array_of_a_frame_is_a_row_of_outputs() -> None:
    assert list(OUTPUTS) == [each.name for each in fields(Frame) if each.name not in ("index", "eye", "metadata")]


def test_a_frame_prints_as_one_line() -> None:
    radius = np.array([[-1.234, 0.0], [4.0, np.inf]], np.float32)
    frame = made((2, 2), blur_radius=radius, mask=np.ones((2, 2), np.bool_), eye="left")
    assert repr(frame) == "<Frame 3 (left): 2 x 2 px, gray, f/2, R -1.23 to 4 px; blur_radius mask>"
    assert repr(made((1500, 900, 3))) == "<Frame 3: 900 x 1500 px, color, f/2; no truth>"


def test_an_output_that_is_not_there_is_an_error() -> None:
    frame = made(blur_radius=np.ones((6, 8), np.float32))
    assert frame.require("coc") is frame.require("blur_radius") is frame.blur_radius
    assert frame.require("color") is frame.color
    with pytest.raises(ArgumentError, match=r"^frame 3: must have depth; got color, coc$"):
        frame.require("depth")


@pytest.mark.parametrize("shape", [(6, 8), (6, 8, 3)])
def test_codes_for_other_packages_have_three_channels(shape: tuple[int, ...]) -> None:
    frame = made(shape)
    assert frame.image().shape == (6, 8, 3)
    assert frame.image().dtype == np.uint8
    np.testing.assert_array_equal(frame.image()[..., 0], encode(frame.color.reshape(6, 8, -1)[..., 0], 8, "srgb"))


def test_notebooks_get_a_picture_of_bounded_size(tmp_path: Path) -> None:
    path = tmp_path / "shown.png"
    path.write_bytes(png_to_show(made().color))
    np.testing.assert_array_equal(read_image(path).data, made().image())
    path.write_bytes(png_to_show(np.full((2, 3 * LARGEST_SHOWN), 0.5, np.float32)))
    assert read_image(path).data.shape == (1, LARGEST_SHOWN, 3)
    shown = made()._repr_html_()
    assert "<Frame" not in shown
    assert "&lt;Frame 3: 8 x 6 px" in shown
    assert "data:image/png;base64,iVBOR" in shown


@pytest.mark.parametrize("ending", [".png", ".PNG", ".tif", ".exr", ".npz"])
def test_the_extension_says_what_is_saved(ending: str, tmp_path: Path) -> None:
    frame, path = made(depth=np.full((6, 8), 250, np.float32)), tmp_path / f"frame{ending}"
    frame.save(path)
    if ending == ".npz":
        with np.load(path) as saved:
            assert {name: saved[name].dtype for name in saved} == {"color": np.float32, "depth": np.float32}
        return
    expected = encode(frame.color, 8, "srgb") if ending.lower() == ".png" else frame.color
    np.testing.assert_array_equal(read_image(path).data, expected)


def test_other_extensions_are_refused(tmp_path: Path) -> None:
    with pytest.raises(FileError, match=r"the extension must be one of .png, .tif, .tiff, .exr, .npz; got .gif"):
        made().save(tmp_path / "frame.gif")
    with pytest.raises(FileError, match="got none"):
        made().save(tmp_path / "frame")
    assert list(tmp_path.iterdir()) == []
