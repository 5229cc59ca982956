"""Rules of the shutter, broken: each case has one fault and must give exactly its message."""

from __future__ import annotations

import pytest

from tests.scene.test_bad_scenes import messages_of

SHUTTERS: list[tuple[str, str]] = [
    (
        'sequence.shutter_curve = "round"',
        'sequence.shutter_curve: must be box, trapezoid, triangle, or a list of 2 to 256 weights; got "round"',
    ),
    (
        "sequence.shutter_curve = [1]",
        "sequence.shutter_curve: must be box, trapezoid, triangle, or a list of 2 to 256 weights; got [1]",
    ),
    (
        "sequence.shutter_curve = [1, true]",
        "sequence.shutter_curve: must be box, trapezoid, triangle, or a list of 2 to 256 weights; got [1, true]",
    ),
    (
        "sequence.shutter_curve = [0, -1, 1]",
        "sequence.shutter_curve: must have weights between 0 and 1e+09, one of them above 0; got [0, -1, 1]",
    ),
    (
        "sequence.shutter_curve = [0, nan]",
        "sequence.shutter_curve: must have weights between 0 and 1e+09, one of them above 0; got [0, nan]",
    ),
    (
        "sequence.shutter_curve = [0, 0.0]",
        "sequence.shutter_curve: must have weights between 0 and 1e+09, one of them above 0; got [0, 0.0]",
    ),
    (
        'sequence = {sampling = "endpoint", shutter_curve = "triangle"}',
        'sequence.shutter_curve: belongs to sequence.sampling = "midpoint", not "endpoint"; got "triangle"',
    ),
    ("sequence.shutter_start = inf", "sequence.shutter_start: must be a finite number; got inf"),
    ("sequence.shutter_start = 2e9", "sequence.shutter_start: must be between -1e+09 and 1e+09 s; got 2000000000.0"),
]


@pytest.mark.parametrize(("line", "message"), SHUTTERS)
def test_bad_shutter(line: str, message: str) -> None:
    assert messages_of(f'{line}\nobject = [{{shape = "sphere"}}]') == (f"bad.toml: {message}",)
