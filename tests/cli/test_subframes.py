"""`clsco render --subframes`: an image of each time sample beside the frame."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import clsco
from clsco.files.images import read_image
from clsco.files.transfer import encode
from clsco.frame.files import read_complete
from tests.cli.test_main import names
from tests.command import clsco_


def test_they_are_files_of_the_frame(ball: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert clsco_("render", ball, "-o", out, "--subframes", "--frames", ":1").exit_code == 0
    pictures = ["frame_0000.png", *(f"frame_0000_sample_0{number}.png" for number in range(3))]
    assert names(out) == ["frame_0000.json", *pictures]
    recorded = read_complete(out, 0)
    assert recorded is not None
    assert list(recorded["files"]) == pictures
    assert [round(sample["time"], 3) for sample in recorded["intermediate"]] == [0.167, 0.5, 0.833]
    frame = clsco.render_frame(ball, truth=("subframes",))
    assert frame.subframes is not None
    for name, image in zip(pictures, [frame.color, *frame.subframes], strict=True):
        np.testing.assert_array_equal(read_image(out / name).data, encode(image, 8, "srgb"))
    assert not np.array_equal(read_image(out / pictures[1]).data, read_image(out / pictures[3]).data)


def test_arrays_of_them_beside_the_truth(ball: Path, tmp_path: Path) -> None:
    assert clsco_("render", ball, "-o", tmp_path, "--truth", "subframes,missing", "--frames", ":1").exit_code == 0
    with np.load(tmp_path / "frame_0000.npz") as arrays:
        assert set(arrays) == {"subframes", "missing"}
        assert arrays["subframes"].shape == (3, 24, 40)
    assert (tmp_path / "frame_0000_sample_02.png").is_file()


def test_resume_makes_those_that_are_not_there(ball: Path, tmp_path: Path) -> None:
    def frames(*options: str) -> int:
        assert clsco_("render", ball, "-o", tmp_path, "--frames", ":1", *options).exit_code == 0
        return (tmp_path / "frame_0000.json").stat().st_mtime_ns

    plain = frames()
    both = frames("--resume", "--subframes")
    assert both > plain
    assert frames("--resume", "--subframes") == frames("--resume") == both
    (tmp_path / "frame_0000_sample_01.png").unlink()
    assert frames("--resume", "--subframes") > both
