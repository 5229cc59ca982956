"""The command `clsco psf`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import clsco
from clsco.cli.sheets import CELL, psf_sheet
from clsco.files.images import read_image
from clsco.frame.contact_sheet import GAP
from tests.command import clsco_
from tests.scenes import scene_file

SCENE = """
[camera]
resolution = [40, 32]
pixel_pitch = 0.03
f_number = [2.0, 4.0]
[[object]]
shape = "plane"
distance = 300.0
"""


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    return scene_file(tmp_path / "scene.toml", SCENE)


def run(*words: object) -> tuple[int, str]:
    result = clsco_("psf", *words)
    return result.exit_code, result.output


def test_weights_and_axes_are_written(scene: Path, tmp_path: Path) -> None:
    out = tmp_path / "psf.npz"
    places = ("--at", 3, 4.5, "--at", 39, 31)
    code, text = run(scene, "-o", out, "--set", "camera.f_number=2", *places, "--depths", "200,inf")
    assert code == 0
    assert text == f"{out}: circle, integrated: 2 places, 2 depths, 29 x 29 px, R -3.334 to 13.33 px\n"
    expected = clsco.psf(clsco.load_scene(scene, ["camera.f_number=2"]), [(3, 4.5), (39, 31)], [200, np.inf]).arrays()
    with np.load(out) as arrays:
        assert set(arrays.files) == set(expected)
        for name, array in expected.items():
            np.testing.assert_array_equal(arrays[name], array)


def test_a_picture_has_a_column_for_each_depth_with_the_same_scale(scene: Path, tmp_path: Path) -> None:
    out = tmp_path / "psf.png"
    code, text = run(scene, "-o", out, "--depths", "208.3333,250,312.5")
    assert code == 0
    assert text.startswith("the first of 2 scenes, ")
    picture = read_image(out).data
    stack = clsco.psf(clsco.load_scene(scene, ["camera.f_number=2"]), depths=[208.3333, 250.0, 312.5])
    np.testing.assert_array_equal(picture, psf_sheet(stack))
    top = GAP + 18  # below the title
    cells = [picture[top : top + CELL, left : left + CELL] for left in range(GAP, GAP + 3 * (CELL + GAP), CELL + GAP)]
    bright = [int((cell[..., 0] > 127).sum()) for cell in cells]
    assert bright[1] < 0.1 * bright[0]
    assert bright[0] == pytest.approx(bright[2], rel=0.05)
    assert all(cell.max() == 255 for cell in cells)


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        ("-o psf.gif", 1, "error: psf.gif: must end in .npz or .png"),
        ("-o psf.npz --at 40 0", 1, "error: psf: at: must be in the frame, columns 0 to 39 and rows 0 to 31"),
        ("-o psf.npz --depths -1", 1, "error: psf: depths must be one or more distances in mm, above 0"),
        ("-o psf.npz --depths near", 2, "must be Z,Z,..., distances in mm; got near"),
        ("-o psf.npz --frame 1", 1, "error: psf: frame must be between 0 and 0; got 1"),
        ("-o no/such/psf.npz", 1, "error: no/such/psf.npz: "),
        ("-o no/such/psf.png", 1, "error: no/such/psf.png: "),
        ("", 2, "Missing option '-o'"),
    ],
)
def test_what_is_refused(
    scene: Path, words: str, code: int, message: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    status, text = run(scene, *words.split())
    assert (status, message in text) == (code, True), text
    assert list(tmp_path.iterdir()) == [scene]


def test_wavelengths_are_channels(scene: Path, tmp_path: Path) -> None:
    out = tmp_path / "psf.npz"
    keys = ("camera.f_number=4", "psf.model=wave", "psf.tail=0.1")
    waves = (*(word for key in keys for word in ("--set", key)), "--depths", "250", "--wavelengths")
    code, text = run(scene, "-o", out, *waves, "2000,4000")
    assert (code, text.count("2 channels")) == (0, 1)
    with np.load(out) as arrays:
        assert arrays["channel"].tolist() == ["2000 nm", "4000 nm"]
        short, long = arrays["weights"].max(axis=(1, 2, 3, 4))
    assert short > 1.2 * long
    code, text = run(scene, "-o", out, *waves, "2000,blue")
    assert "must be NM,NM,..., wavelengths in nm; got 2000,blue" in text
