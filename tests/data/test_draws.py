"""Random streams: those of Philox, and functions of the same bits everywhere."""

from __future__ import annotations

import hashlib
import math
import statistics
from fractions import Fraction

import numpy as np

from clsco.data.draws import LARGEST_NORMAL, cube_root, exact_log, exp, log, normal, shuffled, stream_words, unit

ULP = 2.0**-52


def words(*values: int) -> np.ndarray:
    return np.array(values, np.uint64)


def test_words_are_those_of_philox() -> None:
    digest = np.frombuffer(hashlib.sha256(b"x").digest(), "<u8")
    first, second = digest[:2].tolist()
    before = words(2**64 - 1, (3 << 32) + 4, first, second)  # 1 is added first, and carried
    theirs = np.random.Philox(key=words(11, 7), counter=before)
    assert stream_words(11, 7, "x", 9, 3, 5).tolist() == theirs.random_raw(9).tolist()
    assert stream_words(2**64 - 1, 2**63 - 1, "x", 0).tolist() == []


def test_every_part_of_the_key_matters() -> None:
    base = {"seed": 1, "number": 5, "name": "x", "count": 2, "attempt": 1, "element": 0}
    changes: list[dict[str, object]] = [{"seed": 2}, {"number": 6}, {"name": "y"}, {"attempt": 2}, {"element": 1}]
    drawn = [stream_words(**{**base, **change}).tobytes() for change in ({}, *changes)]  # type: ignore[arg-type]
    assert len(set(drawn)) == len(drawn)


def test_functions_are_within_some_units_of_the_last_place() -> None:
    rng = np.random.default_rng(1)
    x = rng.uniform(-690, 690, 20000)
    assert np.abs(exp(x) / np.exp(x) - 1).max() <= 2 * ULP
    positive = np.exp(x)
    assert np.abs(log(positive) / np.log(positive) - 1).max() <= 2 * ULP
    near = rng.uniform(0.5, 2.0, 20000)
    assert np.abs(log(near) - np.log(near)).max() <= 2 * ULP
    some = positive[:2000]  # in exact numbers, as NumPy's cube root is itself off by more on some processors
    cubes = [Fraction(root) ** 3 / Fraction(x) for root, x in zip(cube_root(some).tolist(), some.tolist(), strict=True)]
    assert max(abs(float(cube - 1)) for cube in cubes) <= 3 * 2 * ULP
    assert exact_log(10.0) == math.log(10.0)
    drawn = rng.integers(0, 2**64, 3000, np.uint64)
    known = statistics.NormalDist()
    places = ((drawn >> np.uint64(12)).astype(np.float64) + 0.5) * 2.0**-52
    assert np.abs(normal(drawn) - [known.inv_cdf(float(p)) for p in places]).max() < 1e-14


def test_bits_are_those_that_they_were() -> None:
    drawn = np.concatenate([stream_words(2026, number, "camera.focus_distance", 2) for number in (0, 31415)])
    assert unit(drawn)[::2].tolist() == [0.7020074292885422, 0.7099000347340569]
    normals = ["0x1.0f7421504386dp-1", "0x1.5ae61161dd41fp-1", "0x1.1b2ef79dca38cp-1", "-0x1.84956d4d1ba7dp-1"]
    assert [x.hex() for x in normal(drawn).tolist()] == normals
    assert [x.hex() for x in exp(np.array([1.0, -3.7])).tolist()] == ["0x1.5bf0a8b14576ap+1", "0x1.9511fc6871044p-6"]


def test_extreme_words_stay_in_range() -> None:
    ends = words(0, 2**64 - 1)
    assert (unit(ends) >= 0.0).all()
    assert (unit(ends) < 1.0).all()
    assert (np.abs(normal(ends)) < LARGEST_NORMAL).all()
    assert normal(ends)[0] == -normal(ends)[1]


def test_an_order_has_each_number_once_and_differs_by_turn() -> None:
    first, second = shuffled(1, "x", 100, 0), shuffled(1, "x", 100, 1)
    assert sorted(first.tolist()) == sorted(second.tolist()) == list(range(100))
    assert (first != second).any()
