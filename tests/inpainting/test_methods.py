"""Tiles, and the choice of a method."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from clsco.errors import ArgumentError
from clsco.inpainting import tiles
from clsco.inpainting.biharmonic import fill_biharmonic
from clsco.inpainting.choice import choose_method
from clsco.inpainting.fse import fill_texture
from clsco.opencl import buffers
from clsco.opencl.session import Session

Array = NDArray[Any]


def filled(session: Session, fill: Any, image: Array, missing: Array) -> Array:
    """The image with the values that a method finds."""
    result = image.copy()
    result[missing] = fill(session, image, missing)
    return result


def smooth(rows: int, columns: int) -> Array:
    i, j = np.mgrid[0:rows, 0:columns]
    return (0.5 + 0.4 * np.sin(0.03 * i) * np.cos(0.02 * j))[..., None].astype(np.float32)


def textured(rows: int, columns: int) -> Array:
    i, j = np.mgrid[0:rows, 0:columns]
    return (0.5 + 0.3 * np.sign(np.sin(0.8 * i + 0.2 * j)) * np.cos(0.7 * j))[..., None].astype(np.float32)


def blocks(rows: int, columns: int) -> Array:
    missing = np.zeros((rows, columns), bool)
    for i in range(20, rows - 12, 40):
        missing[i : i + 12, 10 : columns - 10 : 40] = True
        missing[i : i + 9, 14 : columns - 10 : 40] = True
    return missing


def test_each_image_has_its_method(session: Session) -> None:
    missing = blocks(150, 140)
    i, j = np.mgrid[0:150, 0:140]
    missing |= (i % 40 > 20) & (i % 40 < 29) & (j % 40 > 10) & (j % 40 < 19)
    for image, best in ((smooth(150, 140), "biharmonic"), (textured(150, 140), "texture")):
        assert [choose_method(session, image, missing) for _ in range(2)] == [best] * 2
        fills = {"texture": fill_texture, "biharmonic": fill_biharmonic}
        errors = {name: np.square(filled(session, fill, image, missing) - image).sum() for name, fill in fills.items()}
        assert min(errors, key=errors.__getitem__) == best


def test_where_nothing_can_be_tried(session: Session) -> None:
    for shape in ((1, 1), (1, 30), (30, 30)):
        missing = np.ones(shape, bool)
        missing[0, 0] = False
        assert choose_method(session, smooth(*shape), missing) == "texture"
    assert choose_method(session, smooth(30, 30), np.zeros((30, 30), bool)) == "texture"


@pytest.mark.parametrize("fill", [fill_texture, fill_biharmonic])
def test_buffers_of_large_holes_are_pages(session: Session, fill: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    image, missing = smooth(60, 70), blocks(60, 70)
    expected = fill(session, image, missing)
    monkeypatch.setattr(buffers, "SMALLEST", 1)
    assert np.array_equal(fill(session, image, missing), expected)


@pytest.mark.parametrize("fill", [fill_texture, fill_biharmonic])
def test_tiles_go_on_with_each_other(session: Session, fill: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    image, missing = smooth(150, 140), blocks(150, 140)
    whole = filled(session, fill, image, missing)
    monkeypatch.setattr(tiles, "TILE", 40)
    monkeypatch.setattr(tiles, "MARGIN", 16)
    found = filled(session, fill, image, missing)
    assert np.array_equal(found[~missing], image[~missing])
    assert not np.array_equal(found, whole)
    # Another scale of what is known nearby, and holes that tiles cut; the image itself varies by 0.8.
    assert np.abs(found - whole).max() < 0.02


@pytest.mark.parametrize("fill", [fill_texture, fill_biharmonic])
def test_codes_are_filled_as_floats_are(session: Session, fill: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Only parts of an image become floats, whatever type it has."""
    monkeypatch.setattr(tiles, "TILE", 40)
    monkeypatch.setattr(tiles, "MARGIN", 16)
    missing = blocks(150, 140)
    codes = np.rint(255 * smooth(150, 140)).astype(np.uint8)
    found = fill(session, codes, missing)
    assert found.shape == (missing.sum(), 1)
    assert np.array_equal(found, fill(session, codes.astype(np.float32), missing))


def test_tiles_that_see_nothing_known_wait(session: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tiles, "TILE", 20)
    monkeypatch.setattr(tiles, "MARGIN", 5)
    image, missing = smooth(60, 70), np.ones((60, 70), bool)
    missing[-3:, -40:] = False
    found = filled(session, fill_texture, np.where(missing[..., None], np.float32(np.nan), image), missing)
    assert np.isfinite(found).all()
    assert found.min() >= image[~missing].min()
    assert found.max() <= image[~missing].max()


@pytest.mark.parametrize("fill", [fill_texture, fill_biharmonic])
def test_nothing_known_is_an_error(session: Session, fill: Any) -> None:
    with pytest.raises(ArgumentError, match=r"^missing: must leave a pixel known; got all 6 missing$"):
        fill(session, np.zeros((2, 3, 1), np.float32), np.ones((2, 3), bool))
