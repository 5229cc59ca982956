"""Pictures with labels, side by side."""

from __future__ import annotations

import numpy as np

from clsco.frame.contact_sheet import GAP, PAPER, contact_sheet, split_into_rows


def test_pictures_have_their_places_and_labels_below() -> None:
    tiles = [(np.full((20 + 10 * number, 30, 3), 40 * number, np.uint8), "label") for number in range(3)]
    rows = split_into_rows(tiles, 2)
    assert [len(row) for row in rows] == [2, 1]
    sheet = contact_sheet(rows, text=12)
    assert sheet.shape == (GAP + (30 + 18 + GAP) + (40 + 18 + GAP), GAP + 2 * (30 + GAP), 3)
    assert (sheet[GAP : GAP + 20, GAP : GAP + 30] == 0).all()
    assert (sheet[GAP : GAP + 30, 2 * GAP + 30 : 2 * GAP + 60] == 40).all()
    below = sheet[GAP + 30 : GAP + 48, GAP : GAP + 30]
    assert (below == PAPER).any()
    assert (below < 100).any()
    below_that = 2 * GAP + 48
    assert (sheet[below_that : below_that + 40, GAP : GAP + 30] == 80).all()


def test_a_title_is_above_and_no_pictures_are_a_sheet() -> None:
    tiles = [(np.zeros((9, 200, 3), np.uint8), "")]
    plain, titled = contact_sheet([tiles]), contact_sheet([tiles], "title")
    assert titled.shape[0] == plain.shape[0] + 18
    np.testing.assert_array_equal(titled[-9:], plain[-9:])
    assert (titled[: GAP + 18] < 100).any()
    assert contact_sheet([]).ndim == 3
