"""Rules of the shutter, broken: each case has one fault and must give exactly its message."""

from __future__ import annotations

from clsco.scene.sweep import parse_sweep
from tests.scene.test_bad_scenes import messages_of


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
