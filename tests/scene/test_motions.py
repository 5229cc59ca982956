"""Bad motions, one message each."""

from __future__ import annotations

import tomllib
from typing import Any

import pytest

import clsco
from clsco.frame.provenance import units
from clsco.scene.changes import dump, override
from clsco.scene.file import swept_keys
from tests.scene.test_bad_scenes import cases
from tests.scenes import refusals

PLANE = '\n[[object]]\nshape = "plane"\n'
BAD = cases(r"""
acceleration = [1, 2] -> acceleration: must be a list of 3 numbers; got [1, 2]
acceleration = [0, 0, -2e9] -> acceleration[2]: must be between -1e+09 and 1e+09 mm/s^2; got -2000000000.0
angular_acceleration = [0, nan, 0] -> angular_acceleration[1]: must be a finite number; got nan
angular_acceleration = [0, 0, 2e9]
    -> angular_acceleration[2]: must be between -1e+09 and 1e+09 deg/s^2; got 2000000000.0
accelaration = [0, 0, 1] -> accelaration: unknown key (did you mean acceleration?); got [0, 0, 1]
keyframe = [] -> keyframe: must hold 1 to 256 keyframes; got 0
keyframe = 3 -> keyframe: must be an array of tables, [[...keyframe]]; got 3
keyframe = {time = 0} -> keyframe: must be an array of tables, [[...keyframe]]; got a table of 1 keys
keyframe = [SOME KEYS] -> keyframe: must hold 1 to 256 keyframes; got 257
keyframe = [1] -> keyframe[0]: must be a table; got 1
keyframe = [{}] -> keyframe[0].time: must be given; got nothing
keyframe = [{time = 2e9}] -> keyframe[0].time: must be between -1e+09 and 1e+09 s; got 2000000000.0
keyframe = [{time = 1}, {time = 1.0}] -> keyframe[1].time: must be later than that of the keyframe before; got 1.0
keyframe = [{time = 0, positon = [0, 0, 0]}]
    -> keyframe[0].positon: unknown key (did you mean position?); got [0, 0, 0]
velocity = [1, 0, 0] ; keyframe = [{time = 0}] -> keyframe: give keyframes or velocity, not both; got 1 keyframes
angular_acceleration = [1, 0, 0] ; keyframe = [{time = 0}]
    -> keyframe: give keyframes or angular_acceleration, not both; got 1 keyframes
interpolation = "linear" -> interpolation: belongs to keyframes; there are none; got "linear"
outside = "hold" -> outside: belongs to keyframes; there are none; got "hold"
keyframe = [{time = 0}] ; interpolation = "bezier"
    -> interpolation: must be step, linear, cubic or bspline; got "bezier"
keyframe = [{time = 0}] ; outside = "stop" -> outside: must be hold, linear or error; got "stop"
keyframe = [{time = 0}, {time = 1}, {time = 3}] ; interpolation = "bspline"
    -> interpolation: bspline needs keyframes at equal intervals of time; got "bspline"
""")
BAD_SHAKES = cases(r"""
shake = 3 -> : must be a table; got 3
shake.rotation_rms = -1 -> .rotation_rms: must be between 0 and 45 deg; got -1
shake.rotation_rms = inf -> .rotation_rms: must be a finite number; got inf
shake.translation_rms = 2e6 -> .translation_rms: must be between 0 and 1000000 mm; got 2000000.0
shake.band = [1, 2e6] -> .band[1]: must be between 1e-06 and 1000000 Hz; got 2000000.0
shake.band = 3 -> .band: must be a list of 2 numbers; got 3
shake.band = [5, 5] -> .band: lower bound must be less than the upper bound; got [5, 5]
shake.band = [0, 5] -> .band[0]: must be greater than 0 Hz; got 0
shake.seed = 1.5 -> .seed: must be an integer; got 1.5
shake.sed = 1 -> .sed: unknown key (did you mean seed?); got 1
""")
BAD_LENSES = cases(r"""
lens = 3 -> : must be a table; got 3
lens.interpolation = "linear" -> .interpolation: belongs to keyframes; there are none; got "linear"
lens.outside = "hold" -> .outside: belongs to keyframes; there are none; got "hold"
lens.field_curvature = 2 -> .field_curvature: must be between -1 and 1 1/mm; got 2
lens.focus_surface = "cone" -> .focus_surface: must be plane or sphere; got "cone"
lens.vignetting = "some" -> .vignetting: must be none, natural, or a list of 3 numbers between -10 and 10; got "some"
lens.vignetting = [0, 0] -> .vignetting: must be none, natural, or a list of 3 numbers between -10 and 10; got [0, 0]
lens.vignetting = [-5, 4, 0]
    -> .vignetting: must leave 1 + a1 r^2 + a2 r^4 + a3 r^6 at least 0 up to the corner, r = 1; got [-5, 4, 0]
lens.lateral = [1, 1, 2] -> .lateral[2]: must be between 0.9 and 1.1; got 2
lens.distortion = [0, 0] -> .distortion: must be a list of 3 numbers; got [0, 0]
lens.distortion = [0, 11, 0] -> .distortion[1]: must be between -10 and 10; got 11
lens.tangential = [0, -11] -> .tangential[1]: must be between -10 and 10; got -11
lens.axial = [0, 0] -> .axial: must be a list of 3 numbers; got [0, 0]
lens.axial = [0, 0, -20] -> .axial[2]: must leave a focal length, of camera.focal_length = 20 mm; got -20.0
lens.keyframe = [] -> .keyframe: must hold 1 to 256 keyframes; got 0
lens.keyframe = [{time = 0}] -> .keyframe[0]: must have focal_length, focus_distance or f_number; got none
lens.keyframe = [{f_number = 2}] -> .keyframe[0].time: must be given; got nothing
lens.keyframe = [{time = 0, f_number = 2}, {time = 0, f_number = 4}]
    -> .keyframe[1].time: must be later than that of the keyframe before; got 0.0
lens.keyframe = [{time = 0, focus_distance = 20.0}]
    -> .keyframe[0].focus_distance: must be greater than camera.focal_length = 20 mm; got 20.0
lens.keyframe = [{time = 0, focal_length = 300.0, focus_distance = 250.0}]
    -> .keyframe[0].focus_distance: must be greater than its focal_length = 300 mm; got 250.0
lens.keyframe = [{time = 0, focal_length = 0}] -> .keyframe[0].focal_length: must be greater than 0 mm; got 0
lens.keyframe = [{time = 0, focal_length = 1e-3, f_number = 1e4}]
    -> .keyframe[0].f_number: must leave an aperture between 1e-06 and 1e+09 mm; got 10000.0
lens.keyframe = [{time = 0, focus_distance = -1}] -> .keyframe[0].focus_distance: must be greater than 0 mm; got -1
lens.keyframe = [{time = 0, f_number = 0}] -> .keyframe[0].f_number: must be greater than 0; got 0
lens.keyframe = [{time = 0, f_stop = 2}] -> .keyframe[0].f_stop: unknown key; got 2
lens = {keyframe = [{time = 0, f_number = 2}], interpolation = "bezier"}
    -> .interpolation: must be step, linear, cubic or bspline; got "bezier"
lens = {keyframe = [{time = 0, f_number = 2}], outside = "stop"}
    -> .outside: must be hold, linear or error; got "stop"
lens.interpolation = "bspline" ; lens.keyframe = [{time=0, f_number=2}, {time=1, f_number=2}, {time=3, f_number=2}]
    -> .interpolation: bspline needs keyframes at equal intervals of time; got "bspline"
""")
KEYED = """
[[object]]
shape = "sphere"

[object.motion]
interpolation = "linear"

[[object.motion.keyframe]]
time = 0.0

[[object.motion.keyframe]]
time = 1.5
position = [1.0, 2.0, 3.0]
rotation = [0.0, 90.0, 0.0]
"""


def faults(text: str) -> list[str]:
    return list(refusals(clsco.parse_scene, tomllib.loads(text)))


@pytest.mark.parametrize(("motion", "message"), BAD)
def test_each_fault_of_a_motion_is_one_message(motion: str, message: str) -> None:
    assert faults(f"{PLANE}[object.motion]\n{motion}") == [f"scene: object[0].motion.{message}"]
    assert faults(f"[camera.motion]\n{motion}{PLANE}") == [f"scene: camera.motion.{message}"]
    assert faults(f'[[group]]\nname = "a"\n[group.motion]\n{motion}{PLANE}') == [f"scene: group[0].motion.{message}"]


@pytest.mark.parametrize(("shake", "message"), BAD_SHAKES)
def test_each_fault_of_a_shake_is_one_message(shake: str, message: str) -> None:
    assert faults(f"[camera]\n{shake}{PLANE}") == [f"scene: camera.shake{message}"]


@pytest.mark.parametrize(("lens", "message"), BAD_LENSES)
def test_each_fault_of_a_lens_is_one_message(lens: str, message: str) -> None:
    assert faults(lens + PLANE) == [f"scene: lens{message}"]


def test_a_shake_is_given_by_a_table_or_an_object() -> None:
    scene = clsco.parse_scene(f"[camera.shake]\n{PLANE}")
    assert scene.camera.shake == clsco.CameraShake(rotation_rms=0.02, translation_rms=0.0, band=(2.0, 15.0), seed=1)
    assert scene.moves
    assert not scene.moves_evenly
    assert not scene.replace("camera.shake.rotation_rms", 0).moves
    assert scene.replace("camera.shake.translation_rms", 1).replace("camera.shake.rotation_rms", 0).moves
    assert units(scene)["camera.shake.band"] == "Hz"
    assert clsco.parse_scene(clsco.dump_scene(scene)) == scene


def test_keyframes_are_written_and_read_back() -> None:
    scene = clsco.parse_scene(KEYED)
    (item,) = scene.objects
    assert item.motion == clsco.ObjectMotion(
        keyframe=(
            clsco.Keyframe(time=0.0),
            clsco.Keyframe(time=1.5, position=(1.0, 2.0, 3.0), rotation=(0.0, 90.0, 0.0)),
        ),
        interpolation="linear",
    )
    assert item.motion.outside == "hold"
    assert clsco.dump_scene(scene) == KEYED.lstrip()
    assert clsco.parse_scene(dump(scene)) == scene
    assert units(scene)["object[0].motion.keyframe[1].position"] == "mm"
    assert units(scene)["object[0].motion.keyframe[1].time"] == "s"
    later = scene.replace("object[0].motion.keyframe[1].time", 2).objects[0].motion.keyframe
    assert later is not None
    assert later[1].time == 2.0
    assert swept_keys(tomllib.loads(KEYED)) == []
    assert load(KEYED, ["object.0.motion.keyframe.1.position=[9, 0, 0]"])["position"] == [9, 0, 0]


def load(text: str, overrides: list[str]) -> dict[str, Any]:
    """The second keyframe of a scene with overrides."""
    data: dict[str, Any] = tomllib.loads(text)
    override(data, overrides, "scene")
    found: dict[str, Any] = data["object"][0]["motion"]["keyframe"][1]
    return found


def test_a_motion_with_keyframes_moves_where_one_is_off_the_reference_pose() -> None:
    assert not clsco.ObjectMotion(keyframe=(clsco.Keyframe(time=0.0),)).moves
    assert clsco.ObjectMotion(keyframe=(clsco.Keyframe(time=0.0, position=(0.0, 0.0, 1e-9)),)).moves
    turned = clsco.ObjectMotion(keyframe=(clsco.Keyframe(time=0.0, rotation=(0.0, 0.0, 5.0)),))
    assert turned.turns == (False, False, True)
    assert turned.moves


@pytest.mark.parametrize("motion", ["keyframe = [{time = 0}]", "keyframe = [{time = 0, position = [0, 0, 1]}]"])
def test_a_background_has_no_keyframes_that_move(motion: str) -> None:
    text = f'[[object]]\nshape = "background"\n[object.motion]\n{motion}'
    if "position" in motion:
        rule = "a background stays where it is; turn the camera by camera.motion; got a motion"
        assert faults(text) == [f"scene: object[0].motion: {rule}"]
    else:
        assert not clsco.parse_scene(text).moves
