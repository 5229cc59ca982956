"""Messages on faults of distribution files: one each, with the key as the file has it."""

from __future__ import annotations

import pytest

from tests.data.distributions import SCENE, Load, messages

# Value of vary.camera.f_number, and the message after that key.
F_NUMBERS = [
    ("{ uniform = [4, 2] }", "uniform must be [low, high], low less than high; got [4, 2]"),
    ("{ unifrom = [2, 4] }", "must be a value, or a distribution by one of uniform, "),
    ("{ uniform = [2, 4], weights = [1] }", 'uniform takes size only; got "weights"'),
    ("{ uniform = [2, 4], choice = [1] }", "must be one distribution; got uniform and choice"),
    ("{ uniform = [2, nan] }", "uniform must be a finite number"),
    ("{ choice = [] }", "choice must be a list of 1 to 10000 values; got []"),
    ("{ choice = [2, 4], weights = [1] }", "weights must be a list of 2 numbers; got [1]"),
    ("{ choice = [2, 4], weights = [0, 0] }", "weights must be at least 0, and one above it"),
    ("{ integers = [2, 1.5] }", "must be an integer between"),
    ("{ log_uniform = [-1, 4] }", "log_uniform must be [low, high] of numbers above 0"),
    ("{ normal = [2, 0] }", "normal must be [mean, standard deviation], the latter above 0"),
    ('{ rotation = "sphere" }', 'rotation must be "uniform"; got "sphere"'),
    ('{ frustum = { depth = [1, 2], density = "x" } }', 'density must be "volume" or "depth"; got "x"'),
]
CAMERA, SPHERE, OBJECT = "[vary.camera]\n", '[[vary.object]]\nshape = "sphere"\n', "vary.object[0]."
# Text after the scene, and the message.
OTHERS = [
    (CAMERA + "focus_distance = { uniform = [10, 300] }",
     "vary.camera.focus_distance: must be greater than focal_length = 20 mm; got 10"),
    (CAMERA + "f_numbre = { uniform = [2, 4] }", "vary.camera.f_numbre: unknown key (did you mean f_number?)"),
    ("[vary.camrea]\nf_number = { uniform = [2, 4] }", "camrea: unknown key (did you mean camera?)"),
    ("[camera.motion]\nvelocity = { uniform = [1, 2] }", "camera.motion.velocity: a distribution belongs in [vary]"),
    ("[[vary.object]]\nindex = 3", OBJECT + "index: must be the position of a [[object]] of the scene, which has 1"),
    (SPHERE + "radius = { normal = [5, 4] }", OBJECT + "radius: must be greater than 0 mm; got"),
    (SPHERE + "radios = 4", OBJECT + "radios: unknown key (did you mean radius?)"),
    ("[[vary.object]]\nradius = 4", OBJECT + "shape: must be plane"),
    (SPHERE + "count = { uniform = [1, 2] }", OBJECT + "count: must be a number of objects, 0 to 64"),
    (SPHERE + "count = { integers = [1, 64] }", "object: must hold 1 to 64 objects; got 65"),
    ("[accept]\nmax_blur = 3", "accept.max_blur: unknown key; must be max_blur_px, "),
    ('[accept]\nmax_blur_px = "3"', "accept.max_blur_px: must be a number, or { min = number, max = number }"),
    ("[derive]\ncamera.f_number = { largest_flow_px = 3 }",
     "derive.camera.f_number: must be { largest_blur_px = value }"),
    ("[derive]\nsequence.frames = { largest_flow_px = 3 }", "derive.sequence.frames: must be one of sequence.interval"),
    ("[derive]\nsequence.shutter = { share_of_interval = { uniform = [0.5, 2] } }",
     "derive.sequence.shutter: share_of_interval must be a number up to 1; got 2"),
    ('[[vary.object]]\ncount = 2\nshape = "sphere"\nname = "wall"\n[[object]]\nshape = "plane"\nname = "wall 2"',
     'vary.object[0].name: names must differ; object[1] has the same; got "wall 2"'),
]  # fmt: skip
PLACED = '[[object]]\nshape = "plane"\n' + SPHERE + "center = { frustum = { depth = [1, 2] } }\n"
# Text before the scene's place, text after it, and the message.
NO_TABLES = [
    ("object = 3", SPHERE, "object: must be an array of tables, [[object]]"),
    ("camera = 3", PLACED, "camera: must be a table; got 3"),
    ("vary = 3", '[[object]]\nshape = "plane"\n', "vary: must be a table; got 3"),
]


@pytest.mark.parametrize(
    ("scene", "text", "expected"),
    [
        *((SCENE, f"{CAMERA}f_number = {value}", f"vary.camera.f_number: {expected}") for value, expected in F_NUMBERS),
        *((SCENE, text, expected) for text, expected in OTHERS),
        *NO_TABLES,
    ],
)
def test_a_fault_is_one_message_that_names_the_key(load: Load, scene: str, text: str, expected: str) -> None:
    (message,) = messages(load, text, scene)
    assert message.startswith(expected)


def test_all_faults_are_reported_at_once(load: Load) -> None:
    text = "f_number = { uniform = 3 }\nfocus_distance = { normal = [1] }\n[accept]\nx = 1"
    keys = [message.partition(":")[0] for message in messages(load, CAMERA + text)]
    assert keys == ["vary.camera.f_number", "vary.camera.focus_distance", "accept.x"]
