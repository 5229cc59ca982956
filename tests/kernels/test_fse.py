"""Texture across holes on the device: against the reference, and what it goes on with."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from clsco.constants import FSE_BEFORE, FSE_BLOCK, FSE_SIDE
from clsco.inpainting.fse import fill_texture
from clsco.inpainting.fse_tables import FEWEST_WAVES, MOST_WAVES, STEP, WAVES_PER_CONTRAST, tables
from clsco.opencl.buffers import download, empty, upload
from clsco.opencl.program import Target, launch
from clsco.opencl.session import Session
from clsco.reference.inpainting import fse as reference
from tests.kernels.launches import filled

Array = NDArray[Any]


def picture(rows: int, columns: int, channels: int) -> Array:
    """Waves of several directions with a little noise, so that none is as strong as another."""
    rng = np.random.default_rng(11)
    i, j = np.mgrid[0:rows, 0:columns]
    planes = [
        0.5 + 0.2 * np.sin(0.9 * i + 0.3 * j + k) + 0.15 * np.sin(0.2 * i - 1.1 * j) + 0.05 * rng.random(i.shape)
        for k in range(channels)
    ]
    return np.stack(planes, axis=-1).astype(np.float32)


def holes(rows: int, columns: int) -> Array:
    missing = np.random.default_rng(12).random((rows, columns)) < 0.05
    missing[10:22, 15:30] = True
    missing[: rows // 8, :9] = True
    return missing


@pytest.mark.parametrize("channels", [1, 3])
def test_it_agrees_with_the_reference(session: Session, channels: int) -> None:
    image, missing = picture(32, 36, channels), holes(32, 36)
    low, high = image[~missing].min(axis=0), image[~missing].max(axis=0)
    scaled = (image.astype(np.float64) - low) / (high - low)
    expected = np.clip(reference.fill_texture(scaled, missing), 0, 1) * (high - low) + low
    found = filled(session, fill_texture, np.where(missing[..., None], np.float32(9), image), missing)
    assert found.dtype == np.float32
    assert np.array_equal(found[~missing], image[~missing])
    # Float32 spectra differ by 1e-6; where two waves are that close, another one goes first, which the next ones mend.
    error = np.abs(found - expected)[missing].max(axis=1)
    assert np.median(error) < 1e-5, f"{np.median(error):.1e}"
    assert (error > 1e-2).mean() < 0.02, f"{error.max():.1e} at most, {(error > 1e-2).sum()} of {error.size} pixels"


def test_as_many_waves_as_the_contrast_asks_for(session: Session) -> None:
    """In windows of so little contrast that there are fewer waves than at most, and more than at least."""
    missing = np.zeros((40, 80), bool)
    missing[17, 22] = True
    for contrast in (0.14, 0.17, 0.2, 0.23, 0.26, 0.3, 0.34):
        image = np.pad(0.5 + contrast * (picture(40, 40, 1) - 0.5), ((0, 0), (0, 40), (0, 0)), mode="edge")
        image[0, -1], image[-1, -1] = 0, 1  # far from the window
        assert 1.5 * FEWEST_WAVES < WAVES_PER_CONTRAST * image[1:33, 6:38].std() < MOST_WAVES / 1.5
        expected = reference.fill_texture(image.astype(np.float64), missing)
        assert np.abs(filled(session, fill_texture, image, missing) - expected)[missing].max() < 1e-6


@pytest.mark.parametrize(
    ("first", "other"), [((0, 3), (0, 5)), ((0, 3), (0, 11)), ((0, 3), (1, 3)), ((0, 13), (1, 3)), ((0, 5), (1, 3))]
)
def test_of_equally_strong_waves_the_first(session: Session, first: tuple[int, int], other: tuple[int, int]) -> None:
    """All waves are exactly as strong in a window with a single value; two of them count. A lane holds every eighth."""
    value, preference = np.zeros((FSE_SIDE, FSE_SIDE), np.float32), np.zeros((FSE_SIDE, FSE_SIDE // 2), np.float32)
    value[0, 0] = preference[first] = preference[other] = 1
    constants = (np.ones_like(value), preference, tables().cosines, tables().sines)
    arrays = [upload(session, array) for array in (value, value, *constants, np.full((1, 2), FSE_BEFORE, np.int32))]
    result = empty(session, 4 * FSE_BLOCK**2)
    target = Target(session, ["inpainting/fse.cl"], {"CHANNELS": 1, "SAMPLED": 0}, "float")
    settings = (np.int32(1), np.float32(STEP), np.float32(0), np.int32(1), np.int32(1))  # one wave
    size = (np.int32(FSE_SIDE), np.int32(FSE_SIDE))
    launch(session, target["extrapolate_blocks"], (1,), (1,), *size, *arrays, *settings, result)
    y, x = np.mgrid[FSE_BEFORE : FSE_BEFORE + FSE_BLOCK, FSE_BEFORE : FSE_BEFORE + FSE_BLOCK]
    wave = 2 * STEP * np.cos(2 * np.pi / FSE_SIDE * (first[0] * y + first[1] * x))
    assert np.abs(download(session, result, (FSE_BLOCK, FSE_BLOCK), np.float32) - wave).max() < 1e-6


def test_waves_go_on_across_a_hole(session: Session) -> None:
    i, j = np.mgrid[0:64, 0:64]
    image = (0.5 + 0.3 * np.sin(2 * np.pi * (i + 3 * j) / 16) + 0.1 * np.cos(2 * np.pi * i / 8))[..., None]
    missing = np.zeros((64, 64), bool)
    missing[26:38, 24:36] = True
    found = filled(session, fill_texture, image.astype(np.float32), missing)
    error = np.abs(found - image)[missing]
    # A mean of what is around would be wrong by 0.2; taken out in parts, a wave of 0.3 is found to some percent.
    assert np.abs(image.mean() - image[missing]).mean() > 0.15
    assert error.mean() < 0.03, f"{error.mean():.3f}"


@pytest.mark.parametrize("shape", [(1, 1), (1, 40), (40, 1), (2, 3), (5, 70)])
def test_sizes_and_holes_at_the_border(session: Session, shape: tuple[int, int]) -> None:
    image = picture(*shape, 1)
    missing = np.ones(shape, bool)
    missing[-1, -1] = False
    found = filled(session, fill_texture, np.where(missing[..., None], np.float32(5), image), missing)
    assert np.array_equal(found, np.full_like(image, image[-1, -1, 0]))  # kept within what is known: one value


def test_the_same_bits_again_and_nothing_missing(session: Session) -> None:
    image, missing = picture(60, 60, 3), holes(60, 60)
    first = filled(session, fill_texture, image, missing)
    assert np.array_equal(first, filled(session, fill_texture, image, missing))
    assert not np.array_equal(first, image)
    whole = filled(session, fill_texture, image, np.zeros_like(missing))
    assert np.array_equal(whole, image)
    assert whole is not image


def test_channels_far_apart_in_size_count_alike(session: Session) -> None:
    image, missing = picture(50, 50, 3), holes(50, 50)
    scale = np.array([1.0, 64.0, 4096.0], np.float32)
    found = filled(session, fill_texture, image * scale, missing)
    assert np.allclose(found / scale, filled(session, fill_texture, image, missing), atol=1e-5)


@pytest.mark.parametrize(
    ("columns", "pixels", "kind"),
    [(40, [(17, 22), (0, 39)], "cpu"), (40, [(17, 22), (0, 39)], "gpu"), (37, [(3, 36), (4, 0)], "cpu")],
    ids=["one block", "vectors in plain OpenCL C", "a block at the right border"],
)
def test_single_pixels_agree_with_the_reference(
    session: Session, columns: int, pixels: list[tuple[int, int]], kind: Any
) -> None:
    """No later block can hide or spread a difference; beyond the last of an odd number of columns is not the first
    pixel of the next row, which is settled before it."""
    image, missing = picture(40, columns, 3), np.zeros((40, columns), bool)
    missing[tuple(np.transpose(pixels))] = True
    low, high = image[~missing].min(axis=0), image[~missing].max(axis=0)
    expected = reference.fill_texture((image.astype(np.float64) - low) / (high - low), missing) * (high - low) + low
    with Session(replace(session.device, kind=kind)) as opened:
        assert np.abs(filled(opened, fill_texture, image, missing) - expected)[missing].max() < 1e-5
