"""Laws of the blur and of filling by themselves, through `clsco.defocus` and `clsco.inpaint`."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

import clsco
from tests.laws.scenes import COLUMNS, ROWS, eighths, law, same_bits

pytestmark = pytest.mark.laws
Array = NDArray[Any]
ROUNDING = 4e-6  # of the brightest light: sums of some hundred weights of float32
LARGEST = 4  # px


def drawn(seed: int, *shape: int) -> Array:
    """Random light."""
    return np.random.default_rng(seed).random(shape or (ROWS, COLUMNS)).astype(np.float32)


def dark_around(image: Array, margin: int) -> Array:
    """An image with a dark border."""
    return np.pad(image[margin:-margin, margin:-margin], margin)


def radii(seed: int) -> Array:
    """A slanted plane of signed blur radii, (rows, columns), with another one before it."""
    rng = np.random.default_rng(seed)
    i, j = np.mgrid[-1 : 1 : ROWS * 1j, -1 : 1 : COLUMNS * 1j]
    slanted = rng.uniform(-1, 1) * i + rng.uniform(-1, 1) * j + rng.uniform(-2, 2)
    found = np.where(np.hypot(i - rng.uniform(-1, 1), j) < 0.6, rng.uniform(-LARGEST, LARGEST), slanted)
    found[0, :2] = 0, LARGEST  # the same tables for all
    return found


def blurred(image: Array, coc: Array, memory: int | None = None) -> Array:
    """By the default PSF, each source by itself: no depth layers, and nothing beyond the border."""
    alone: dict[str, Any] = {"psf": {"occlusion": "none"}, "outside": "black", "soft_edges": "keep"}
    return clsco.defocus(image, coc, method="gather", memory=memory, **alone)


seeds = st.integers(0, 2**32 - 1)


@law
@given(seeds, st.integers(-8, 8), st.integers(-8, 8))
def test_blur_is_linear_in_light(seed: int, a: int, b: int) -> None:
    coc, one, other = radii(seed), drawn(seed), drawn(seed + 1)
    both = blurred(a * one + b * other, coc)
    apart = a * blurred(one, coc) + b * blurred(other, coc)
    np.testing.assert_allclose(both, apart, atol=32 * ROUNDING)


@law
@given(seeds, st.integers(-20, 20))
def test_blur_does_not_know_units_of_light(seed: int, exponent: int) -> None:
    coc, image, factor = radii(seed), drawn(seed), np.float32(2.0**exponent)
    assert same_bits(blurred(image * factor, coc), blurred(image, coc) * factor)


@law
@given(eighths(-LARGEST, LARGEST), st.integers(1, 255))
def test_uniform_light_stays(radius: float, level: int) -> None:
    image, margin = np.full((ROWS, COLUMNS), level / 256, np.float32), LARGEST + 1
    found = blurred(image, np.full(image.shape, radius))
    inside = np.s_[margin:-margin, margin:-margin]
    np.testing.assert_allclose(found[inside], image[inside], rtol=1e-6)
    assert (found <= image * (1 + 1e-6)).all()


@law
@given(seeds, eighths(-LARGEST, LARGEST))
def test_no_light_is_lost_or_made(seed: int, radius: float) -> None:
    image = dark_around(drawn(seed), LARGEST + 1)
    found = blurred(image, np.full(image.shape, radius))
    assert found.min() > -1e-6  # tables are cubic in R
    assert abs(found.sum(dtype=float) / image.sum(dtype=float) - 1) < 1e-6


@law
@given(seeds)
def test_rows_are_as_columns(seed: int) -> None:
    image, coc = drawn(seed), radii(seed)
    np.testing.assert_allclose(blurred(image.T, coc.T), blurred(image, coc).T, atol=ROUNDING)


@law
@given(seeds)
def test_a_quarter_turn_is_a_quarter_turn(seed: int) -> None:
    image, coc = drawn(seed), radii(seed)
    np.testing.assert_allclose(blurred(np.rot90(image), np.rot90(coc)), np.rot90(blurred(image, coc)), atol=ROUNDING)


@law
@given(seeds, st.integers(-3, 3), st.integers(-3, 3))
def test_what_is_shifted_is_blurred_alike(seed: int, down: int, right: int) -> None:
    coc, margin = radii(seed), LARGEST + 2
    image = dark_around(drawn(seed), margin)
    there = blurred(np.roll(image, (down, right), (0, 1)), np.roll(coc, (down, right), (0, 1)))
    inside = np.s_[margin:-margin, margin:-margin]
    here = np.roll(blurred(image, coc), (down, right), (0, 1))
    np.testing.assert_allclose(there[inside], here[inside], atol=ROUNDING)


@law
@given(seeds)
def test_front_and_back_blur_alike(seed: int) -> None:
    """A disc is its own mirror image, and so is the tilt's factor 1 + l . grad R where both l and R change sign."""
    image, coc = drawn(seed), radii(seed)
    assert same_bits(blurred(image, coc), blurred(image, -coc))


@law
@given(seeds, st.integers(590, 970))  # KiB, from what 64 rows take to less than 192 rows do
def test_strips_change_no_bit(seed: int, kib: int) -> None:
    """Five strips of 64 rows, or three of 128."""
    rows = 4 * 64 + 7
    image, coc = drawn(seed, rows, 16), np.resize(radii(seed), (rows, 16))
    coc[0, :2] = 0.0, LARGEST  # so that tables are always of one size
    whole, cut = (blurred(image, coc, size) for size in (None, kib << 10))
    assert same_bits(whole, cut)


@law
@given(seeds, st.integers(-20, 20), st.integers(1, 400))
def test_filling_does_not_know_units_of_light(seed: int, exponent: int, count: int) -> None:
    image, rng = drawn(seed), np.random.default_rng(seed)
    missing = (rng.permutation(image.size) < count).reshape(image.shape)
    factor = np.float32(2.0**exponent)
    one, other = (
        clsco.inpaint(given, missing, method="mean-median", options=clsco.MeanMedian(border_share=0.0))
        for given in (image, image * factor)
    )
    assert same_bits(one * factor, other)
    assert same_bits(one[~missing], image[~missing])
    assert np.isfinite(one).all()
