"""Missing pixels: AIT and mean/median against plain loops, and that they always end."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from numpy.typing import NDArray

from clsco.reference.inpainting.fill import FillReport, Method, far_bounds, fill_ait, fill_objects, mark_missing
from clsco.reference.inpainting.fill_mean_median import fill_mean_median, smooth_median
from clsco.reference.inpainting.score import score_mean_median

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
STEPS = {"NW": (-1, -1), "N": (-1, 0), "NE": (-1, 1), "W": (0, -1), "E": (0, 1)}
STEPS |= {"SW": (1, -1), "S": (1, 0), "SE": (1, 1)}


def known_around(values: Array, known: Mask, i: int, j: int) -> list[Array]:
    """Values of the known neighbors of a pixel."""
    places = [(i + down, j + right) for down, right in STEPS.values()]
    inside = [(a, b) for a, b in places if 0 <= a < known.shape[0] and 0 <= b < known.shape[1]]
    return [values[place] for place in inside if known[place]]


def plain_missing(known: Mask) -> Mask:
    """Missing pixels by scanning rows and columns one by one."""
    missing = np.zeros_like(known)
    for mask, out in ((known, missing), (known.T, missing.T)):
        for line, result in zip(mask, out, strict=True):
            ends = np.flatnonzero(line)
            if ends.size:
                result[ends[0] : ends[-1]] = True
    return missing & ~known


def plain_ait(values: Array, known: Mask, missing: Mask) -> tuple[Array, Mask]:
    """One sweep of AIT on one channel, pixel by pixel, as physics states it."""
    rows, columns = known.shape
    result, filled = values.copy(), np.zeros_like(known)

    def line(index: int, row: Array, there: Mask) -> float | None:
        ends = np.flatnonzero(there)
        left, right = ends[ends < index], ends[ends > index]
        if left.size == 0 or right.size == 0:
            return None
        a, b = int(left[-1]), int(right[0])
        return float(row[a] + (row[b] - row[a]) * (index - a) / (b - a))

    for i, j in zip(*np.nonzero(missing), strict=True):
        value: float | None = None
        if i in (0, rows - 1) or j in (0, columns - 1):
            value = line(j, values[i], known[i])
            if value is None:
                value = line(i, values[:, j], known[:, j])
        else:
            for di, dj in ((0, -1), (-1, 0), (-1, -1), (-1, 1)):
                if value is None and known[i + di, j + dj] and known[i - di, j - dj]:
                    value = 0.5 * (values[i + di, j + dj] + values[i - di, j - dj])
            for di, dj in ((0, -1), (0, 1), (-1, 0), (1, 0), (-1, -1), (1, 1), (-1, 1), (1, -1)):
                if value is None and known[i + di, j + dj]:
                    value = values[i + di, j + dj]
        if value is not None:
            result[i, j], filled[i, j] = value, True
    return result, filled


def random_masks(count: int, largest: int = 14) -> list[tuple[Array, Mask]]:
    """Images of random sizes from 1 x 1, two channels, with random masks of random density."""
    rng = np.random.default_rng(17)
    cases = []
    for _ in range(count):
        shape = tuple(rng.integers(1, largest, 2))
        cases.append((rng.random((*shape, 2)), rng.random(shape) < rng.random()))
    return cases


def fill(
    values: Array, known: Mask, method: Method, allowed: Mask | None = None
) -> tuple[Array, NDArray[np.uint8], FillReport]:
    """Values, status and report of a scene with one object."""
    objects = np.zeros(known.shape, np.uint8)
    result, _, status, report = fill_objects(values, objects, known, allowed, method, 0, far=False)
    return result, status, report


def test_missing_is_between_known() -> None:
    masks = [known for _, known in random_masks(200)]
    assert any(mark_missing(known, None).any() for known in masks)
    for known in masks:
        assert (mark_missing(known, None) == plain_missing(known)).all()
        allowed = np.zeros_like(known)
        allowed[::2] = True
        assert (mark_missing(known, allowed) == (plain_missing(known) & allowed)).all()


def test_a_sweep_of_ait_is_what_plain_loops_do() -> None:
    swept = 0
    for values, known in random_masks(300):
        missing = mark_missing(known, None)
        result, filled, _ = fill_ait(values, known, missing)
        for channel in range(2):
            expected, expected_filled = plain_ait(values[..., channel], known, missing)
            assert (filled == expected_filled).all()
            np.testing.assert_allclose(result[..., channel], expected, rtol=0, atol=4 * np.finfo(float).eps)
        swept += int(filled.sum())
    assert swept > 1000


def test_ait_takes_pairs_in_their_order() -> None:
    values = np.arange(9.0).reshape(3, 3, 1) ** 2
    missing = np.zeros((3, 3), dtype=bool)
    missing[1, 1] = True
    for pairs, expected in (
        (("W", "E", "N", "S"), (9 + 25) / 2),
        (("W", "N", "S", "NW", "SE"), (1 + 49) / 2),
        (("W", "N", "NW", "SE", "NE", "SW"), (0 + 64) / 2),
        (("W", "N", "NE", "SW"), (4 + 36) / 2),
        (("E", "N", "NE"), 25.0),
        (("SW", "NE", "SE"), 20.0),
        (("SW", "SE"), 64.0),
        (("NE", "SE"), 64.0),
    ):
        known = np.zeros((3, 3), dtype=bool)
        for name in pairs:
            known[1 + STEPS[name][0], 1 + STEPS[name][1]] = True
        result, filled, _ = fill_ait(values, known, missing)
        assert filled[1, 1], pairs
        assert result[1, 1, 0] == expected, pairs


@pytest.mark.parametrize("method", ["ait", "mean_median"])
def test_filling_always_ends_with_nothing_left(method: Method) -> None:
    filled_in_all, many_sweeps = 0, 0
    for values, known in random_masks(200 if method == "ait" else 100):
        result, status, report = fill(values, known, method)
        missing = status == 1
        assert (missing | ~mark_missing(known, None)).all()
        assert not mark_missing(known | missing, None).any()
        assert report.unfilled_pixels == 0
        assert report.missing_pixels == report.filled_pixels == missing.sum()
        assert report.sweeps <= 4 * sum(known.shape)
        assert (status == missing).all()
        assert (result[known] == values[known]).all()
        if missing.any():
            # Means, medians and interpolation stay within the known values; eps for their rounding.
            low, high = values[known].min(axis=0), values[known].max(axis=0)
            assert (result[missing] >= low - 1e-15).all()
            assert (result[missing] <= high + 1e-15).all()
        filled_in_all += report.filled_pixels
        many_sweeps += report.sweeps > 2
    assert filled_in_all > 1000
    assert many_sweeps > 3


def test_what_cannot_be_filled_is_reported() -> None:
    known = np.zeros((9, 9), dtype=bool)
    known[4, [1, 7]] = True
    allowed = np.zeros((9, 9), dtype=bool)
    allowed[4, 4] = True  # no known neighbor ever comes near
    for method in ("ait", "mean_median"):
        _, status, report = fill(np.ones((9, 9, 2)), known, method, allowed)
        assert (report.missing_pixels, report.filled_pixels, report.unfilled_pixels, report.sweeps) == (1, 0, 1, 0)
        assert status[4, 4] == 2
        assert status.sum() == 2
    _, status, report = fill(np.ones((9, 9, 2)), known, "none")
    assert (report.missing_pixels, report.unfilled_pixels, report.sweeps) == (5, 5, 0)
    assert (status[4, 2:7] == 2).all()


def test_scores_are_those_of_every_subset() -> None:
    rng = np.random.default_rng(23)
    values, known = rng.random((8, 9, 3)), rng.random((8, 9)) < 0.93
    found = score_mean_median(values, known, 2.0**16)
    values = np.rint(values * 2**16)
    expected = np.zeros((2, 9))
    count = subsets = 0
    for i in range(1, 7):
        for j in range(1, 8):
            if not known[i - 1 : i + 2, j - 1 : j + 2].all():
                continue
            count += 1
            near = np.array(known_around(values, known, i, j))
            for k in range(4, 9):
                for subset in combinations(range(8), k):
                    subsets += 1
                    some = near[list(subset)]
                    for row, estimate in enumerate((some.mean(axis=0), np.median(some, axis=0))):
                        expected[row, k] += ((estimate - values[i, j]) ** 2).sum()
    assert 5 < count < 42
    assert subsets == 163 * count
    twice = (2.0 * np.arange(9)) ** 2
    # 1e5 squares summed in another order
    np.testing.assert_allclose((found.mean, found.median), expected * twice, rtol=1e-12)
    assert found.samples == 3 * count
    for errors, row in zip(found.mean_square_errors(), expected[:, 4:], strict=True):
        subsets_of = np.array([70, 56, 28, 8, 1])
        np.testing.assert_allclose(errors, row / subsets_of / (3 * count) / 2.0**32, rtol=1e-12)


def test_median_wins_on_steps_and_mean_on_noise() -> None:
    step = np.zeros((12, 12, 1))
    step[:, 6:] = 1.0
    score = score_mean_median(step, np.ones((12, 12), dtype=bool), 1.0)
    assert score.median_wins().any()
    assert (score.median_wins("median") == (np.arange(9) >= 4)).all()
    noise = np.random.default_rng(1).standard_normal((40, 40, 1))
    score = score_mean_median(noise, np.ones((40, 40), dtype=bool), 2.0**12)
    assert not score.median_wins().any()
    assert all(mean < median for mean, median in zip(*score.mean_square_errors(), strict=True))
    nothing = score_mean_median(noise, np.zeros((40, 40), dtype=bool), 1.0)
    assert not any(nothing.mean + nothing.median)
    assert nothing.mean_square_errors() == ([], [])


def test_a_sweep_of_mean_median_by_hand() -> None:
    rng = np.random.default_rng(29)
    values, known = rng.random((10, 11, 2)), rng.random((10, 11)) < 0.5
    missing = ~known
    median_wins = np.arange(9) % 2 == 1
    for minimum in (4, 1):
        result, filled, _ = fill_mean_median(values, known, missing, median_wins, minimum)
        seen = set()
        for i, j in zip(*np.nonzero(missing), strict=True):
            near = known_around(values, known, i, j)
            assert filled[i, j] == (len(near) >= minimum)
            if len(near) >= minimum:
                seen.add(len(near))
                by_median = len(near) >= 4 and median_wins[len(near)]
                expected = np.median(near, axis=0) if by_median else np.mean(near, axis=0)
                np.testing.assert_allclose(result[i, j], expected, rtol=1e-14)
        assert {4, 5} <= seen
        assert minimum == 4 or 3 in seen
        assert not filled[known].any()


def test_smoothing_reads_the_former_round() -> None:
    rng = np.random.default_rng(31)
    values, filled = rng.random((9, 9, 2)), rng.random((9, 9)) < 0.4
    valid = filled | (rng.random((9, 9)) < 0.7)
    result = smooth_median(values, filled, valid)
    changed = 0
    for i, j in np.ndindex(9, 9):
        near = known_around(values, valid, i, j)
        expected = np.median(near, axis=0) if filled[i, j] and near else values[i, j]
        np.testing.assert_allclose(result[i, j], expected, rtol=1e-15)
        changed += bool(filled[i, j])
    assert changed > 10


@pytest.mark.parametrize("kind", ["noise", "lines"])
def test_mean_median_is_its_stages_one_after_another(kind: str) -> None:
    rng = np.random.default_rng(37)
    values = rng.random((20, 22, 3))
    if kind == "lines":
        values[..., 0] = values[..., 1] = np.arange(22) // 11  # the median keeps this edge, the mean does not
    known = rng.random((20, 22)) < 0.9
    known[7:13, 8:14] = False
    result, status, _ = fill(values, known, "mean_median")
    wins = score_mean_median(values[..., :2], known, 2.0**16).median_wins()
    assert wins[4:].any() == (kind == "lines")
    expected, valid = values, known.copy()
    while mark_missing(valid, None).any():
        for minimum in (4, 3, 2, 1):
            swept, filled, _ = fill_mean_median(expected, valid, mark_missing(valid, None), wins, minimum)
            if filled.any():
                break
        expected, valid = swept, valid | filled
    for _ in range(20):
        expected = smooth_median(expected, valid & ~known, valid)
    assert (result == expected).all()
    assert ((status == 1) == (valid & ~known)).all()


NEAR, FAR = 1 / 200.0, 1 / 400.0


def test_bounds_come_from_the_first_pair_on_opposite_sides() -> None:
    """One wanted pixel in an empty image, known ones at given steps from it: the farther of which pair decides?"""
    for ends, expected in (
        ({"W": (1, FAR), "E": (4, NEAR)}, FAR),  # uncovered by an edge that has moved to the right
        ({"W": (1, NEAR), "E": (1, NEAR), "N": (9, FAR), "S": (1, FAR)}, NEAR),  # a gap in a near surface
        ({"W": (3, NEAR), "E": (3, NEAR), "N": (2, FAR), "S": (2, NEAR)}, FAR),  # the column is shorter
        ({"W": (2, NEAR), "E": (2, NEAR), "N": (2, FAR), "S": (2, FAR)}, NEAR),  # of equals the row
        ({"NE": (1, FAR), "SW": (2, NEAR), "W": (3, NEAR), "E": (1, NEAR)}, FAR),
        ({"NW": (5, NEAR), "SE": (1, NEAR), "N": (1, FAR), "E": (1, FAR)}, NEAR),  # no other line has two ends
        ({"W": (1, FAR), "N": (1, FAR)}, np.inf),
        ({"W": (5, NEAR), "E": (4, NEAR), "N": (9, FAR), "S": (8, FAR)}, FAR),  # a hole between two near things
        ({"W": (5, NEAR), "E": (4, NEAR), "N": (9, FAR), "S": (6, NEAR), "NW": (7, FAR), "SE": (7, FAR)}, FAR),
        ({"W": (5, FAR), "E": (4, FAR), "N": (9, 0.8 * FAR), "S": (9, 1.2 * FAR)}, FAR),  # one slanted plane
        ({"W": (5, NEAR), "E": (4, FAR), "N": (9, 0.5 * FAR), "S": (8, 0.5 * FAR)}, FAR),
    ):
        w, known, wanted = np.zeros((19, 19)), np.zeros((19, 19), dtype=bool), np.zeros((19, 19), dtype=bool)
        wanted[9, 9] = True
        for name, (step, depth) in ends.items():
            at = (9 + step * STEPS[name][0], 9 + step * STEPS[name][1])
            w[at], known[at] = depth, True
        bounds = far_bounds(w, known, wanted)
        assert bounds[9, 9] == np.float32(1.02) * np.float32(expected), ends
        assert np.isinf(bounds[~wanted]).all()


def cards(*columns: slice) -> tuple[Array, NDArray[np.uint8], Mask]:
    """Values and objects of near cards (1) before a far plane (2), and a mask with all pixels known."""
    values, objects = np.zeros((30, 40, 2)), np.full((30, 40), 2, dtype=np.uint8)
    values[..., 0], values[..., 1] = 0.2, FAR
    for card in columns:
        values[8:20, card], objects[8:20, card] = (0.9, NEAR), 1
    return values, objects, np.ones((30, 40), dtype=bool)


@pytest.mark.parametrize("method", ["ait", "mean_median"])
def test_what_an_edge_uncovers_is_filled_from_the_far_side(method: Method) -> None:
    """A hole between a near card and a far plane: nothing of the card comes into it."""
    values, objects, known = cards(slice(20, 32))
    known[8:20, 12:20] = known[14, 25] = False  # uncovered, and a gap in the card
    given, seen = np.where(known[..., None], values, 0.0), np.where(known, objects, 255).astype(np.uint8)
    result, found, status, report = fill_objects(given, seen, known, None, method, 0)
    assert (status == ~known).all()
    assert report.filled_pixels == 12 * 8 + 1
    # Means and medians of equal values, which a few roundings may change.
    np.testing.assert_allclose(result, values, rtol=1e-12)
    assert (found == objects).all()
    across, *_ = fill(given, known, method)
    assert np.abs(across - values)[..., 0].max() > 0.3


@pytest.mark.parametrize("method", ["ait", "mean_median"])
def test_a_hole_between_two_near_things_is_filled_from_behind_them(method: Method) -> None:
    """Two cards: between them the plane is hidden or uncovered."""
    values, objects, known = cards(slice(6, 14), slice(22, 32))
    known[8:20, 14:22] = False
    given, seen = np.where(known[..., None], values, 0.0), np.where(known, objects, 255).astype(np.uint8)
    result, found, *_ = fill_objects(given, seen, known, None, method, 0)
    wide = slice(8, 20), slice(17, 19)  # beyond a gap that a growing card could leave
    np.testing.assert_allclose(result[wide], values[wide], rtol=1e-12)
    assert (found[wide] == 2).all()


@pytest.mark.parametrize("method", ["ait", "mean_median"])
def test_far_filling_always_ends_with_nothing_left(method: Method) -> None:
    """Depths at random, so that bounds often leave no neighbor: then nearer ones serve."""
    relaxed = 0
    for values, known in random_masks(100 if method == "ait" else 30):
        objects = np.where(known, 1, 255).astype(np.uint8)
        result, found, status, report = fill_objects(values, objects, known, None, method, 0)
        assert report.unfilled_pixels == 0
        assert report.sweeps <= 4 * sum(known.shape)
        assert (found[known | (status == 1)] == 1).all()
        assert (found[status == 0][~known[status == 0]] == 255).all()
        missing = mark_missing(known, None)
        bounds = far_bounds(values[..., 1], known, missing)
        relaxed += int((result[..., 1].astype(np.float32) > bounds)[missing].sum())
    assert relaxed > 5
