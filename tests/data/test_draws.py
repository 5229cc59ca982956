"""Random streams: known answers, the bits of vectors and single draws, and functions of the same bits everywhere."""

from __future__ import annotations

import math
import statistics

import numpy as np
import pytest

from clsco.data.draws import (
    CHUNK,
    LARGEST_NORMAL,
    cube_root,
    exact_log,
    exp,
    log,
    name_hash,
    normal,
    philox,
    shuffled,
    stream_words,
    unit,
)

ULP = 2.0**-52
# kat_vectors of Random123, philox4x64 10: counter, key, answer.
KNOWN = (
    ((0,) * 4, (0,) * 2, (0x16554D9ECA36314C, 0xDB20FE9D672D0FDC, 0xD7E772CEE186176B, 0x7E68B68AEC7BA23B)),
    (
        (2**64 - 1,) * 4,
        (2**64 - 1,) * 2,
        (0x87B092C3013FE90B, 0x438C3C67BE8D0224, 0x9CC7D7C69CD777B6, 0xA09CAEBF594F0BA0),
    ),
    (
        (0x243F6A8885A308D3, 0x13198A2E03707344, 0xA4093822299F31D0, 0x082EFA98EC4E6C89),
        (0x452821E638D01377, 0xBE5466CF34E90C6C),
        (0xA528F45403E61D95, 0x38C72DBD566E9788, 0xA5A1610E72FD18B5, 0x57BD43B5E52B7FE6),
    ),
)


def words(*values: int) -> np.ndarray:
    return np.array(values, np.uint64)


@pytest.mark.parametrize(("counter", "key", "answer"), KNOWN)
def test_philox_gives_the_known_answers(
    counter: tuple[int, ...], key: tuple[int, ...], answer: tuple[int, ...]
) -> None:
    c0, c1, c2, c3 = (words(part) for part in counter)
    assert philox((words(key[0]), words(key[1])), (c0, c1, c2, c3)).tolist() == [list(answer)]


def test_philox_is_that_of_numpy() -> None:
    rng = np.random.default_rng(5)
    for key in rng.integers(0, 2**64, (5, 2), np.uint64):
        counter = rng.integers(1, 2**64, 4, np.uint64)
        before = counter - np.array([1, 0, 0, 0], np.uint64)  # numpy's adds 1 first
        theirs = np.random.Philox(key=key, counter=before).random_raw(4)
        c0, c1, c2, c3 = (part[None] for part in counter)
        assert (philox((key[:1], key[1:]), (c0, c1, c2, c3))[0] == theirs).all()


def test_words_of_a_sample_are_those_in_a_vector() -> None:
    numbers = np.arange(CHUNK // 2 + 3, dtype=np.uint64) * np.uint64(7919)
    names, counts = ["a", "camera.b", "c"], [1, 9, 0]
    together = stream_words(11, numbers, names, counts, 3)
    for k in (0, 1, CHUNK // 2 + 2):
        alone = stream_words(11, numbers[k : k + 1], names, counts, 3)
        assert [own[k].tolist() for own in together] == [one[0].tolist() for one in alone]
    (other,) = stream_words(11, numbers[:4], ["camera.b"], [9], 3)
    assert (other == together[1][:4]).all()  # whatever else there is


def test_every_part_of_the_key_matters() -> None:
    base = {"seed": 1, "numbers": words(5), "names": ["x"], "counts": [2], "attempt": 1, "elements": words(0)}
    changes: list[dict[str, object]] = [
        {"seed": 2}, {"numbers": words(6)}, {"names": ["y"]}, {"attempt": 2}, {"elements": words(1)},
    ]  # fmt: skip
    found = [stream_words(**{**base, **change})[0].tobytes() for change in ({}, *changes)]  # type: ignore[arg-type]
    assert len(set(found)) == len(found)
    assert name_hash("x") != name_hash("y")


def test_functions_are_within_some_units_of_the_last_place() -> None:
    rng = np.random.default_rng(1)
    x = rng.uniform(-690, 690, 20000)
    assert np.abs(exp(x) / np.exp(x) - 1).max() <= 2 * ULP
    positive = np.exp(x)
    assert np.abs(log(positive) / np.log(positive) - 1).max() <= 2 * ULP
    near = rng.uniform(0.5, 2.0, 20000)
    assert np.abs(log(near) - np.log(near)).max() <= 2 * ULP
    assert np.abs(cube_root(positive) / np.cbrt(positive) - 1).max() <= 2 * ULP
    assert exact_log(10.0) == math.log(10.0)
    drawn = rng.integers(0, 2**64, 3000, np.uint64)
    known = statistics.NormalDist()
    places = ((drawn >> np.uint64(12)).astype(np.float64) + 0.5) * 2.0**-52
    assert np.abs(normal(drawn) - [known.inv_cdf(float(p)) for p in places]).max() < 1e-14


def test_bits_do_not_depend_on_the_length_of_a_vector() -> None:
    drawn = np.random.default_rng(2).integers(0, 2**64, 1001, np.uint64)
    place = unit(drawn) + 1e-9
    whole = normal(drawn), exp(place), log(place), cube_root(place)
    for k in (0, 1, 7, 1000):
        one = slice(k, k + 1)
        alone = normal(drawn[one]), exp(place[one]), log(place[one]), cube_root(place[one])
        assert [vector[k] for vector in whole] == [vector[0] for vector in alone]


def test_bits_are_those_that_they_were() -> None:
    (drawn,) = stream_words(2026, words(0, 31415), ["camera.focus_distance"], [2])
    assert [f"{x!r}" for x in unit(drawn)[:, 0].tolist()] == PINNED_UNIT
    assert [x.hex() for x in normal(drawn).ravel().tolist()] == PINNED_NORMAL
    assert [x.hex() for x in exp(np.array([1.0, -3.7])).tolist()] == PINNED_EXP


PINNED_UNIT = ["0.7020074292885422", "0.7099000347340569"]
PINNED_NORMAL = ["0x1.0f7421504386dp-1", "0x1.5ae61161dd41fp-1", "0x1.1b2ef79dca38cp-1", "-0x1.84956d4d1ba7dp-1"]
PINNED_EXP = ["0x1.5bf0a8b14576ap+1", "0x1.9511fc6871044p-6"]


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
