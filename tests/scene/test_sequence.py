"""Rules of the shutter, broken: each case has one fault and must give exactly its message."""

from __future__ import annotations

import pytest

from clsco.scene.sweep import parse_sweep
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
    (
        "sequence.readout = -0.1",
        "sequence.readout: must be at least 0 s; for the other order of the rows change scan; got -0.1",
    ),
    ("sequence.readout = 2e9", "sequence.readout: must be between 0 and 1e+09 s; got 2000000000.0"),
    ("sequence.shutter_start = 2e9", "sequence.shutter_start: must be between -1e+09 and 1e+09 s; got 2000000000.0"),
    ("sequence.readout = nan", "sequence.readout: must be a finite number; got nan"),
    ('sequence.readout = "slow"', 'sequence.readout: must be a number; got "slow"'),
    (
        'sequence = {sampling = "endpoint", readout = 0.1}',
        'sequence.readout: belongs to sequence.sampling = "midpoint", not "endpoint"; got 0.1',
    ),
    (
        'sequence.scan = "upwards"',
        'sequence.scan: must be top_to_bottom, bottom_to_top, left_to_right or right_to_left; got "upwards"',
    ),
]


@pytest.mark.parametrize(("line", "message"), SHUTTERS)
def test_bad_shutter(line: str, message: str) -> None:
    assert messages_of(f'{line}\nobject = [{{shape = "sphere"}}]') == (f"bad.toml: {message}",)


def test_lines_in_turn_need_rays() -> None:
    text = "sequence.readout = 0.1\nmotion.warp = 'forward'\n"
    text += "object = [{shape = 'sphere', motion.velocity = [1, 0, 0]}]"
    rule = 'belongs to scenes of analytic surfaces with motion.warp = "inverse"'
    assert messages_of(text) == (f"bad.toml: sequence.readout: {rule}; got 0.1",)


def test_names_of_curves_are_swept_and_weights_are_one_value() -> None:
    given = {"object": [{"shape": "sphere"}]}
    names = parse_sweep(given | {"sequence": {"shutter_curve": ["box", "triangle"]}})
    assert [scene.sequence.shutter_curve for scene in names.scenes] == ["box", "triangle"]
    several = parse_sweep(given | {"sequence": {"shutter_curve": [[0, 1], [1.0, 0.0]]}})
    assert [scene.sequence.shutter_curve for scene in several.scenes] == [(0, 1), (1, 0)]
    assert parse_sweep(given | {"sequence": {"shutter_curve": [0, 1]}}).scenes[0].sequence.shutter_curve == (0, 1)
