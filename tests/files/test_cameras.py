"""Cameras in the files of COLMAP: every number comes back, and poses of any turn become quaternions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from clsco.files.cameras import Pinhole, colmap_texts

TURNS = [*Rotation.random(20, random_state=3), *Rotation.from_rotvec(np.pi * np.eye(3)), Rotation.identity()]


def camera(turn: Rotation, columns: int = 64) -> Pinhole:
    return Pinhole(columns, 48, 2000.1, (31.5, 23.5), turn.as_matrix(), np.array([10.0, -0.3, 1e-9]))


def test_colmaps_text_holds_every_pose() -> None:
    texts = colmap_texts((f"{number:02d}.png", camera(turn)) for number, turn in enumerate(TURNS))
    (one,) = (line for line in texts["cameras.txt"].decode().splitlines() if not line.startswith("#"))
    assert one == "1 PINHOLE 64 48 2000.1 2000.1 32.0 24.0"
    lines = [line for line in texts["images.txt"].decode().split("\n") if not line.startswith("#")]
    assert lines[1::2] == [""] * len(TURNS)  # no points
    for number, (line, turn) in enumerate(zip(lines[0:-1:2], TURNS, strict=True)):
        identity, *pose, kind, name = line.split()
        w, x, y, z, *translation = map(float, pose)
        assert (identity, kind, name) == (str(number + 1), "1", f"{number:02d}.png")
        np.testing.assert_allclose(Rotation.from_quat([x, y, z, w]).as_matrix(), turn.as_matrix(), atol=2e-15)
        assert w >= 0
        assert translation == [10.0, -0.3, 1e-9]
        assert "-0.0 " not in line


def test_colmap_has_distortion_in_its_own_order() -> None:
    texts = colmap_texts([("a.png", replace(camera(TURNS[0]), distortion=(-0.25, 0.05, 0.01, -0.02, 0.5)))])
    expected = "1 FULL_OPENCV 64 48 2000.1 2000.1 32.0 24.0 -0.25 0.05 0.01 -0.02 0.5 0.0 0.0 0.0"
    assert texts["cameras.txt"].decode().splitlines()[1] == expected


def test_colmap_has_each_kind_of_camera_once() -> None:
    texts = colmap_texts([("a.png", camera(TURNS[0])), ("b.png", camera(TURNS[1], 65)), ("c.png", camera(TURNS[2]))])
    assert texts["cameras.txt"].decode().count("PINHOLE") == 2
    lines = texts["images.txt"].decode().split("\n")[1::2]
    assert [line.split()[-2:] for line in lines[:3]] == [["1", "a.png"], ["2", "b.png"], ["1", "c.png"]]
