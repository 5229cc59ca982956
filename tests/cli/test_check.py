"""`clsco check`: differences of a frame from the reference's, and from rays."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import clsco
from clsco.cli import check
from clsco.files.images import read_image
from clsco.frame.frame import Frame
from clsco.frame.outputs import MOTION_NAMES, TRUTH_NAMES
from tests.cli.test_main import messages
from tests.command import clsco_, done
from tests.scenes import scene_file


@pytest.fixture
def ball(ball: Path) -> Path:
    return scene_file(ball, ball.read_text() + 'texture = "#c0c0c0"\n')


def test_differences() -> None:
    expected = np.array([[1.0, np.inf, 200.0], [4.0, 5.0, np.inf]])
    got = expected.astype(np.float32)
    assert check.difference("depth", got, expected).largest == 0.0
    got[0, 2] = 201.0
    measured = check.difference("depth", got, expected)
    # One of six pixels is off by 1/200: RMS 0.005 / sqrt(6).
    assert (measured.row, measured.column, measured.count) == (0, 2, 1)
    assert measured.largest == pytest.approx(0.005)
    assert measured.rms == pytest.approx(0.005 / np.sqrt(6))
    got[1, 2] = 7.0
    measured = check.difference("depth", got, expected)
    assert (measured.largest, measured.row, measured.column, measured.count) == (np.inf, 1, 2, 2)
    mask = np.array([[True, False]])
    assert check.difference("mask", ~mask, mask).count == 2


def test_places_in_many_copies_of_an_image_are_floats() -> None:
    expected = np.array([[[0.5, 3e6], [-2e6, 0.0]]])
    got = expected.astype(np.float32)
    got[0, 0, 1] = np.nextafter(got[0, 0, 1], np.float32(np.inf))
    assert check.difference("uv", got, expected).count == 0
    got[0, 1, 1] = 2e-5
    assert check.difference("uv", got, expected).count == 1


def test_in_single_precision_a_pixel_in_500_may_differ() -> None:
    expected = np.zeros((20, 50))
    got = expected.copy()
    got[3, :2], got[5] = 1.0, 5e-5
    assert check.difference("color", got, expected, single=True).agrees
    assert not check.difference("color", got, expected).agrees
    got[3, 2] = 1.0
    assert not check.difference("color", got, expected, single=True).agrees
    got[3, :3] = np.nan, 0.0, 0.0
    assert not check.difference("color", got, expected, single=True).agrees


def test_check_agrees(ball: Path, tmp_path: Path) -> None:
    report = tmp_path / "report.json"
    result = done("check", ball, "--rays", 512, "--set", "sequence.frames=2", "-o", report)
    rows = [line.split() for line in result.output.splitlines()]
    for name in ("color", *TRUTH_NAMES, *MOTION_NAMES):
        named = [row for row in rows if row[:1] == [name]]
        assert len(named) == 2
        assert all(row[-2] == "0" for row in named)  # pixels above the figure
    assert result.output.count("reference: ") == 2
    assert result.output.count("Pixels against rays") == 2
    views = json.loads(report.read_text())["views"]
    assert [(view["frame"], view["deviations"]) for view in views] == [(0, 0), (1, 0)]
    assert {row["name"] for row in views[0]["classes"]} >= {"outline", "random"}


def test_check_finds_by_rays_what_the_reference_shares(ball: Path, tmp_path: Path) -> None:
    """Weights at the centers of pixels alone: device and reference agree, and both are off."""
    picture = tmp_path / "tried.png"
    sampled = ("--set", "psf.edge=sampled", "--set", "sequence.frames=1")
    result = clsco_("check", ball, "--rays", 512, *sampled, "-o", picture)
    assert result.exit_code == 1
    assert result.stderr.startswith(f"error: {ball}: pixels must be within 0.01 of white and 5 errors of rays; got ")
    assert len(np.unique(read_image(picture).data.reshape(-1, 3), axis=0)) > 10
    (line,) = messages(clsco_("check", ball, "-o", "report.txt"), 1)
    assert line == "error: -o: must be a file .json or .png; got report.txt"


def changed(**places: Any) -> Callable[..., Iterator[Frame]]:
    """`render` with pixels changed: name=(index, value)."""

    def rendered(*args: Any, **options: Any) -> Iterator[Frame]:
        for frame in clsco.render(*args, **options):
            arrays = {name: getattr(frame, name).copy() for name in places}
            for name, (index, value) in places.items():
                arrays[name][index] = value
            yield replace(frame, **arrays)

    return rendered


def test_check_notices_a_wrong_pixel(ball: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(check, "render", changed(color=((5, 7), np.nan), depth=((2, 3), 1.0), mask=((4, 4), True)))
    words = ("check", "--rays", 0, ball, "--set", "sequence.frames=1")
    result = clsco_(*words)
    assert result.exit_code == 1
    assert f"error: {ball}: color must agree within 1e-05 of white; got inf in frame 0 (1 pixels" in result.stderr
    rows = {row[0]: row for row in (line.split() for line in result.stdout.splitlines()) if row}
    assert rows["color"][-4:] == ["5", "7", "1", "1e-05"]
    assert rows["depth"][-4:-1] == ["2", "3", "1"]
    assert rows["sharp"][-2] == "0"
    assert clsco_(*words, "--precision", "single").exit_code == 1
