"""A scene for tests of commands."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.scenes import scene_file

BALL = """
title = "Ball"
[camera]
resolution = [40, 24]
pixel_pitch = 0.1
normalization_distance = 20.0
[sequence]
frames = 3
samples = 3
[[object]]
name = "ball"
shape = "sphere"
motion.velocity = [3.0, 0.0, 0.0]
"""


@pytest.fixture
def ball(tmp_path: Path) -> Path:
    """A scene file: three frames of a ball that moves."""
    return scene_file(tmp_path / "ball.toml", BALL)
