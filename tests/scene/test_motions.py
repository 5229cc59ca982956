"""Bad motions, one message each."""

from __future__ import annotations

import tomllib

import pytest

import clsco
from clsco.errors import SceneError

PLANE = '\n[[object]]\nshape = "plane"\n'
BAD = [
    ("acceleration = [1, 2]", "acceleration: must be a list of 3 numbers; got [1, 2]"),
    (
        "acceleration = [0, 0, -2e9]",
        "acceleration[2]: must be between -1e+09 and 1e+09 mm/s^2; got -2000000000.0",
    ),
    ("angular_acceleration = [0, nan, 0]", "angular_acceleration[1]: must be a finite number; got nan"),
    (
        "angular_acceleration = [0, 0, 2e9]",
        "angular_acceleration[2]: must be between -1e+09 and 1e+09 deg/s^2; got 2000000000.0",
    ),
    ("accelaration = [0, 0, 1]", "accelaration: unknown key (did you mean acceleration?); got [0, 0, 1]"),
]


def faults(text: str) -> list[str]:
    with pytest.raises(SceneError) as error:
        clsco.parse_scene(tomllib.loads(text))
    return list(error.value.messages)


@pytest.mark.parametrize(("motion", "message"), BAD)
def test_each_fault_of_a_motion_is_one_message(motion: str, message: str) -> None:
    assert faults(f"{PLANE}[object.motion]\n{motion}") == [f"scene: object[0].motion.{message}"]
    assert faults(f"[camera.motion]\n{motion}{PLANE}") == [f"scene: camera.motion.{message}"]
    assert faults(f'[[group]]\nname = "a"\n[group.motion]\n{motion}{PLANE}') == [f"scene: group[0].motion.{message}"]
