"""Messages on faults of distribution files: one each, with the key as the file has it."""

from __future__ import annotations

import pytest

from tests.data.distributions import SCENE, Load, messages

F, G = "[vary.camera]\nf_number = ", "vary.camera.f_number: "
S, OBJECT = '[[vary.object]]\nshape = "sphere"\n', "vary.object[0]."


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        (
            "[vary.camera]\nf_number = { uniform = [4, 2] }",
            G + "uniform must be [low, high], low less than high; got [4, 2]",
        ),
        (
            "[vary.camera]\nf_number = { unifrom = [2, 4] }",
            G + "must be a value, or a distribution by one of uniform, ",
        ),
        (
            "[vary.camera]\nf_number = { uniform = [2, 4], weights = [1] }",
            G + 'uniform takes size only; got "weights"',
        ),
        (
            "[vary.camera]\nf_number = { uniform = [2, 4], choice = [1] }",
            G + "must be one distribution; got uniform and choice",
        ),
        (F + "{ uniform = [2, nan] }", G + "uniform must be a finite number"),
        (
            "[vary.camera]\nf_number = { choice = [] }",
            G + "choice must be a list of 1 to 10000 values; got []",
        ),
        (
            "[vary.camera]\nf_number = { choice = [2, 4], weights = [1] }",
            G + "weights must be a list of 2 numbers; got [1]",
        ),
        (
            "[vary.camera]\nf_number = { choice = [2, 4], weights = [0, 0] }",
            G + "weights must be at least 0, and one above it",
        ),
        (F + "{ integers = [2, 1.5] }", G + "must be an integer between"),
        (
            "[vary.camera]\nf_number = { log_uniform = [-1, 4] }",
            G + "log_uniform must be [low, high] of numbers above 0",
        ),
        (
            "[vary.camera]\nf_number = { normal = [2, 0] }",
            G + "normal must be [mean, standard deviation], the latter above 0",
        ),
        (
            "[vary.camera]\nfocus_distance = { uniform = [10, 300] }",
            "vary.camera.focus_distance: must be greater than focal_length = 20 mm; got 10",
        ),
        (
            "[vary.camera]\nf_numbre = { uniform = [2, 4] }",
            "vary.camera.f_numbre: unknown key (did you mean f_number?)",
        ),
        ("[vary.camrea]\nf_number = { uniform = [2, 4] }", "camrea: unknown key (did you mean camera?)"),
        (
            "[camera.motion]\nvelocity = { uniform = [1, 2] }",
            "camera.motion.velocity: a distribution belongs in [vary]",
        ),
        (
            "[[vary.object]]\nindex = 3",
            OBJECT + "index: must be the position of a [[object]] of the scene, which has 1",
        ),
        (
            '[[vary.object]]\nshape = "sphere"\nradius = { normal = [5, 4] }',
            OBJECT + "radius: must be greater than 0 mm; got",
        ),
        (S + "radios = 4", OBJECT + "radios: unknown key (did you mean radius?)"),
        ("[[vary.object]]\nradius = 4", OBJECT + "shape: must be plane"),
        (
            '[[vary.object]]\nshape = "sphere"\ncount = { uniform = [1, 2] }',
            OBJECT + "count: must be a number of objects, 0 to 64",
        ),
        (
            '[[vary.object]]\nshape = "sphere"\ncount = { integers = [1, 64] }',
            "object: must hold 1 to 64 objects; got 65",
        ),
        ("[accept]\nmax_blur = 3", "accept.max_blur: unknown key; must be max_blur_px, "),
        ('[accept]\nmax_blur_px = "3"', "accept.max_blur_px: must be a number, or { min = number, max = number }"),
        (
            "[derive]\ncamera.f_number = { largest_flow_px = 3 }",
            "derive.camera.f_number: must be { largest_blur_px = value }",
        ),
        (
            "[derive]\nsequence.frames = { largest_flow_px = 3 }",
            "derive.sequence.frames: must be one of sequence.interval",
        ),
        (
            "[derive]\nsequence.shutter = { share_of_interval = { uniform = [0.5, 2] } }",
            "derive.sequence.shutter: share_of_interval must be a number up to 1; got 2",
        ),
        ("object = 3", "object: must be an array of tables, [[object]]"),
        ("camera = 3", "camera: must be a table; got 3"),
        ("vary = 3", "vary: must be a table; got 3"),
    ],
)
def test_a_fault_is_one_message_that_names_the_key(load: Load, text: str, wanted: str) -> None:
    scene = SCENE
    if text == "object = 3":
        scene, text = text, '[[vary.object]]\nshape = "sphere"'
    elif text.startswith(("vary", "camera")):
        placed = '[[vary.object]]\nshape = "sphere"\ncenter = { frustum = { depth = [1, 2] } }\n'
        scene, text = text, '[[object]]\nshape = "plane"\n' + (placed if text.startswith("camera") else "")
    found = messages(load, text, scene)
    assert len(found) == 1, found
    assert found[0].startswith(wanted), found


def test_all_faults_are_reported_at_once(load: Load) -> None:
    found = messages(
        load, "[vary.camera]\nf_number = { uniform = 3 }\nfocus_distance = { normal = [1] }\n[accept]\nx = 1"
    )
    assert [message.partition(":")[0] for message in found] == [
        "vary.camera.f_number",
        "vary.camera.focus_distance",
        "accept.x",
    ]


def test_names_of_a_population_must_be_free(load: Load) -> None:
    found = messages(
        load, '[[vary.object]]\ncount = 2\nshape = "sphere"\nname = "wall"', SCENE.replace("wall", "wall 2")
    )
    assert found == ['vary.object[0].name: names must differ; object[0] has the same; got "wall 2"']
