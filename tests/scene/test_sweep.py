"""Sweeps: the scenes and labels that lists and ranges give, and one message for every fault."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

import pytest

import clsco
from clsco.errors import SceneError
from clsco.scene.file import MAX_FILE_BYTES, MAX_OUTPUTS, load_scene, parse_scene, swept_keys
from clsco.scene.sweep import load_sweep, parse_sweep
from tests.scene.test_bad_scenes import cases
from tests.scenes import refusals, scene_file

BALL = '[[object]]\nshape = "sphere"\n'


def mapping(text: str) -> dict[str, Any]:
    return tomllib.loads(f"{text}\n{BALL}")


def messages_of(data: Any) -> tuple[str, ...]:
    messages = refusals(parse_sweep, data, "bad.toml")
    assert all(message.startswith("bad.toml: ") and "\n" not in message for message in messages)
    return tuple(message.removeprefix("bad.toml: ") for message in messages)


def test_without_several_values_there_is_one_scene() -> None:
    data = mapping("camera.resolution = [64, 48]\ncamera.motion.velocity = [1, 2, 3]\nsequence.samples = 3")
    assert swept_keys(data) == []
    sweep = parse_sweep(data)
    assert (sweep.labels, sweep.scenes) == (("",), (parse_scene(data),))


def test_text_of_a_file_is_read() -> None:
    text = f"camera.f_number = [2, 4]\n{BALL}"
    assert clsco.parse_sweep(text) == parse_sweep(tomllib.loads(text))
    assert clsco.parse_scene(BALL) == parse_scene(tomllib.loads(BALL)) == parse_sweep(BALL).scenes[0]
    for parse in (clsco.parse_sweep, clsco.parse_scene):
        for wrong, message in (
            ("camera = ", "bad: not valid TOML: Invalid value"),
            ("a" + ".b" * 200 + " = 1", "bad: a line must have at most 100 dots"),
            ("#" * (MAX_FILE_BYTES + 1), "bad: a scene must have at most 1048576 characters"),
        ):
            with pytest.raises(SceneError, match=f"^{message}"):
                parse(wrong, "bad")


def test_a_range_has_both_ends_and_equal_steps() -> None:
    sweep = parse_sweep(mapping("camera.focus_distance = { from = 200, to = 400, steps = 9 }"))
    assert [scene.camera.focus_distance for scene in sweep.scenes] == [200.0 + 25.0 * i for i in range(9)]
    assert sweep.labels == tuple(f"focus_distance_{200 + 25 * i}" for i in range(9))
    third = parse_sweep(mapping("camera.pixel_pitch = { from = 0.1, to = 0.2, steps = 4 }"))
    assert third.labels == ("pixel_pitch_0.1", "pixel_pitch_0.133333", "pixel_pitch_0.166667", "pixel_pitch_0.2")
    assert (third.scenes[0].camera.pixel_pitch, third.scenes[-1].camera.pixel_pitch) == (0.1, 0.2)
    down = parse_sweep(mapping("sequence.frames = { from = 5, to = 1, steps = 3 }"))
    assert [scene.sequence.frames for scene in down.scenes] == [5, 3, 1]


def test_every_combination_comes_with_the_first_key_outermost() -> None:
    sweep = parse_sweep(mapping("sequence.samples = [3, 'auto']\ncamera.f_number = [2, 4.0, 8]"))
    wanted = [(samples, number) for samples in (3, "auto") for number in (2.0, 4.0, 8.0)]
    assert [(scene.sequence.samples, scene.camera.f_number) for scene in sweep.scenes] == wanted
    assert sweep.labels == tuple(f"samples_{samples}__f_number_{number:g}" for samples, number in wanted)


def test_ranges_have_equal_steps_of_diopters() -> None:
    sweep = parse_sweep(mapping("camera.focus_distance = { from = 250, to = inf, steps = 5, spacing = 'diopters' }"))
    powers = [1 / (scene.camera.focus_distance or 1) for scene in sweep.scenes]
    assert powers == pytest.approx([4e-3, 3e-3, 2e-3, 1e-3, 0])
    assert sweep.labels[0] == "focus_distance_250"


def test_variants_change_keys_together() -> None:
    text = """
    camera = { sensor_distance = 21.0, f_number = 2 }
    sensor = { noise_seed = 7 }
    [[variant]]
    camera = { focus_distance = 250, normalization_distance = 260 }
    object.0.name = "near"
    [[variant]]
    camera.focus_distance = [300, 400]
    """
    data = mapping(text)
    sweep = parse_sweep(data)
    assert sweep.labels == ("v00", "v01__focus_distance_300", "v01__focus_distance_400")
    cameras = [scene.camera for scene in sweep.scenes]
    assert [camera.focus_distance for camera in cameras] == [250, 300, 400]
    assert [camera.normalization_distance for camera in cameras] == [260, 20, 20]
    assert {camera.f_number for camera in cameras} == {2}
    assert [scene.objects[0].name == "near" for scene in sweep.scenes] == [True, False, False]
    seeds = [scene.sensor.noise_seed for scene in sweep.scenes if scene.sensor is not None]
    assert seeds == [7, 8, 9]  # each is an exposure of its own
    assert data == mapping(text)
    again = parse_sweep({**data, "variant": [{"object": {"0": {"name": "near"}}}, {}, {"camera": {"f_number": 3}}]})
    assert [scene.objects[0].name == "near" for scene in again.scenes] == [True, False, False]
    own = parse_sweep({**data, "variant": [{"sensor": {"noise_seed": 3}}, {"sensor": {"noise_seed": 3}}]})
    assert [scene.sensor.noise_seed for scene in own.scenes if scene.sensor is not None] == [3, 3]


def test_vectors_are_swept_by_lists_and_ranges_of_vectors() -> None:
    text = """
    [camera]
    resolution = [[64, 48], [32, 24]]
    motion.velocity = { from = [0, 0, -1.5], to = [2, 0, 1.5], steps = 3 }
    """
    data = mapping(text) | {"object": [{"shape": "plane"}, {"shape": "sphere"}]}
    data["object"][1]["motion"] = {"angular_velocity": [[0, 90, 0]]}
    sweep = parse_sweep(data)
    assert sweep.labels == tuple(
        f"resolution_{size}__camera_velocity_{velocity}__object_1_angular_velocity_0_90_0"
        for size in ("64_48", "32_24")
        for velocity in ("0_0_-1.5", "1_0_0", "2_0_1.5")
    )
    middle = sweep.scenes[4]
    assert middle.camera.resolution == (32, 24)
    assert middle.camera.motion.velocity == (1.0, 0.0, 0.0)
    assert middle.objects[1].motion.angular_velocity == (0.0, 90.0, 0.0)


def test_names_of_shutter_curves_are_swept_and_weights_are_one_value() -> None:
    def curves(values: str) -> list[Any]:
        sweep = parse_sweep(mapping(f"sequence.shutter_curve = {values}"))
        return [scene.sequence.shutter_curve for scene in sweep.scenes]

    assert curves('["box", "triangle"]') == ["box", "triangle"]
    assert curves("[[0, 1], [1.0, 0.0]]") == [(0, 1), (1, 0)]
    assert curves("[0, 1]") == [(0, 1)]


def test_labels_differ_and_name_folders() -> None:
    sweep = parse_sweep(mapping("camera.focus_distance = [250.0000001, 250.0000002, 1e9, 300]"))
    assert sweep.labels == tuple(f"focus_distance_{v}" for v in ("250.0000001", "250.0000002", "1000000000", "300"))
    assert all(re.fullmatch(r"[A-Za-z0-9][\w.+-]*", label) for label in sweep.labels)


def test_a_sweep_is_the_scenes_of_single_values(tmp_path: Path) -> None:
    path = scene_file(tmp_path / "stack.toml", f'camera.f_number = 4\n{BALL}texture = "wall.png"\n')
    assert clsco.load_sweep(path) == clsco.load_sweep(path, [])
    assert load_sweep(path).scenes == (load_scene(path),)
    sweep = load_sweep(path, ["camera.focus_distance=[200, 300]", "object.0.motion.velocity=[[1, 0, 0], [2, 0, 0]]"])
    assert sweep.labels[1] == "focus_distance_200__object_0_velocity_2_0_0"
    single = ["camera.focus_distance=200", "object.0.motion.velocity=[2, 0, 0]"]
    assert sweep.scenes[1] == load_scene(path, single)
    assert sweep.scenes[1].objects[0].texture == str(tmp_path / "wall.png")
    assert load_sweep(path, ["camera.f_number={from=2, to=4, steps=2}"]).labels == ("f_number_2", "f_number_4")


def test_one_scene_is_not_read_from_a_sweep(tmp_path: Path) -> None:
    path = scene_file(tmp_path / "stack.toml", f"camera.f_number = [2, 4]\nsequence.samples = {{ from = 3 }}\n{BALL}")
    rule = "must be one value; clsco.load_sweep reads a list or range of them"
    assert refusals(load_scene, path) == (
        f"{path}: camera.f_number: {rule}; got [2, 4]",
        f"{path}: sequence.samples: {rule}; got a table of 1 keys",
    )


BAD_SWEEPS = cases(r"""
camera.f_number = [] -> camera.f_number: must hold 1 to 4096 values; got 0
camera.f_number = [2, 3, -4] -> camera.f_number[2]: must be greater than 0; got -4
camera.f_number = [2, '3'] -> camera.f_number[1]: must be a number; got "3"
camera.f_number = [2, 3, 2.0] -> camera.f_number[2]: values must differ; camera.f_number[0] is the same; got 2.0
camera.focus_distance = [20, 250] -> camera.focus_distance[0]: must be greater than focal_length = 20 mm; got 20
camera.resolution = [[4, 4], [4, 0]] -> camera.resolution[1][1]: must be between 1 and 65536 px; got 0
camera.motion.velocity = [[0, 0, 1], 3] -> camera.motion.velocity[1]: must be a list of 3 numbers; got 3
camera.focus_distance = {from = 10, to = 40, steps = 4} ; camera.focal_length = 10
    -> camera.focus_distance[0]: must be greater than focal_length = 10 mm; got 10
sequence.interval = [1, 2, 0.1] ; sequence.shutter = 0.5
    -> sequence.shutter: must be at most interval = 0.1 s; got 0.5 (with sequence.interval[2])
sequence.frames = {from = 1, to = 2, steps = 3} -> sequence.frames[1]: must be an integer; got 1.5
camera.f_number = {from = 1, to = 2, steps = 3, spacing = "even"}
    -> camera.f_number.spacing: must be "diopters"; got "even"
camera.focus_distance = {from = 100, to = [200], steps = 3, spacing = "diopters"}
    -> camera.focus_distance.to: must be a positive number in a range of diopters; got [200]
variant = 3 -> variant: must be 1 to 4096 tables, [[variant]]; got 3
variant = [{camera.f_number = 3}, {camera.f_numbre = 3}]
    -> variant[1]: camera.f_numbre: unknown key (did you mean f_number?); got 3
variant = [{object.7.name = "a"}] -> variant[0]: object: must be an array of tables, [[object]]; got a table of 1 keys
camera.f_number = {from = 1, to = 2} -> camera.f_number.steps: must be given; got nothing
camera.f_number = {from = 1, to = 2, steps = 1} -> camera.f_number.steps: must be an integer between 2 and 4096; got 1
camera.f_number = {from = nan, to = 2, steps = 3}
    -> camera.f_number.from: must be a finite number, or a list of them; got nan
camera.f_number = {from = 1, to = [2, 3], steps = 3}
    -> camera.f_number.to: must have as many numbers as from = 1; got [2, 3]
camera.f_number = {from = 2, to = 2, steps = 3} -> camera.f_number.to: must differ from from; got 2
camera.f_number = {from = 2, to = 3, steps = 3, step = 1}
    -> camera.f_number.step: a range has from, to and steps; got 1
camera.f_number = {from = 1, to = 9, steps = 99} ; sequence.frames = {from = 1, to = 99, steps = 99}
    -> camera.f_number, sequence.frames: must give at most 4096 scenes in all; got 9801
image.transfer = ['srgb', 'linear'] -> image.transfer: must be srgb or linear; got ["srgb", "linear"]
""")
TOO_NEAR = "camera.focus_distance[0]: must be greater than focal_length = 30 mm; got 25 mm (25 m?)"
BAD_SWEEPS += [[
    "camera.focal_length = [20, 30]\ncamera.focus_distance = [25, 200, 300]",
    f"{TOO_NEAR} (with camera.focal_length[1], camera.focus_distance[0])",
]]  # fmt: skip


@pytest.mark.parametrize(("text", "message"), BAD_SWEEPS)
def test_bad_sweeps(text: str, message: str) -> None:
    assert messages_of(mapping(text)) == (message,)


def test_all_faults_are_reported_at_once_and_each_once() -> None:
    data = mapping("camera.f_number = [2, -4]\nsequence.samples = [0, 3]\npsf.tilt = 1")
    assert messages_of(data) == (
        "psf.tilt: must be true or false; got 1",
        'sequence.samples[0]: must be an integer between 1 and 4096, or "auto"; got 0',
        "camera.f_number[1]: must be greater than 0; got -4",
    )
    data = mapping("camera.f_number = [2, 2]\npsf.tilt = 1\nsequence.samples = [0]")
    assert messages_of(data) == (
        "camera.f_number[1]: values must differ; camera.f_number[0] is the same; got 2",
        "psf.tilt: must be true or false; got 1",
        'sequence.samples[0]: must be an integer between 1 and 4096, or "auto"; got 0',
    )


def test_a_missing_texture_is_reported_with_the_faults_of_a_sweep(tmp_path: Path) -> None:
    path = scene_file(tmp_path / "stack.toml", f'camera.f_number = [2, -4]\n{BALL}texture = "none.png"\n')
    assert refusals(load_sweep, path) == (
        f"{path}: camera.f_number[1]: must be greater than 0; got -4",
        f'{path}: object[0].texture: must be an existing file, a built-in pattern or a color #rrggbb; got "none.png"',
    )


def test_as_many_outputs_as_are_allowed() -> None:
    sweep = parse_sweep(mapping(f"camera.f_number = {{from = 1, to = 9, steps = {MAX_OUTPUTS}}}"))
    assert len(set(sweep.labels)) == len(sweep.scenes) == MAX_OUTPUTS
