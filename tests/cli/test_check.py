"""Differences of an image from the reference's."""

from __future__ import annotations

import numpy as np
import pytest

from clsco.cli import check


def test_differences() -> None:
    wanted = np.array([[1.0, np.inf, 200.0], [4.0, 5.0, np.inf]])
    got = wanted.astype(np.float32)
    assert check.difference("depth", got, wanted).largest == 0.0
    got[0, 2] = 201.0
    found = check.difference("depth", got, wanted)
    # One of six pixels is off by 1/200: RMS 0.005 / sqrt(6).
    assert (found.row, found.column, found.count) == (0, 2, 1)
    assert found.largest == pytest.approx(0.005)
    assert found.rms == pytest.approx(0.005 / np.sqrt(6))
    got[1, 2] = 7.0
    found = check.difference("depth", got, wanted)
    assert (found.largest, found.row, found.column, found.count) == (np.inf, 1, 2, 2)
    mask = np.array([[True, False]])
    assert check.difference("mask", ~mask, mask).count == 2


def test_places_in_many_copies_of_an_image_are_floats() -> None:
    wanted = np.array([[[0.5, 3e6], [-2e6, 0.0]]])
    got = wanted.astype(np.float32)
    got[0, 0, 1] = np.nextafter(got[0, 0, 1], np.float32(np.inf))
    assert check.difference("uv", got, wanted).count == 0
    got[0, 1, 1] = 2e-5
    assert check.difference("uv", got, wanted).count == 1


def test_in_single_precision_a_pixel_in_500_may_differ() -> None:
    wanted = np.zeros((20, 50))
    got = wanted.copy()
    got[3, :2], got[5] = 1.0, 5e-5
    assert check.difference("color", got, wanted, single=True).agrees
    assert not check.difference("color", got, wanted).agrees
    got[3, 2] = 1.0
    assert not check.difference("color", got, wanted, single=True).agrees
    got[3, :3] = np.nan, 0.0, 0.0
    assert not check.difference("color", got, wanted, single=True).agrees
