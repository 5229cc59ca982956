"""Arrays as colors: the tables that they come from, and one scale for a clip."""

from __future__ import annotations

import math

import matplotlib
import numpy as np
import pytest

from clsco.errors import FileError
from clsco.frame.views import VIEWS, flow_colors, viridis


def test_viridis_is_that_of_matplotlib() -> None:
    exact = 255 * np.array(matplotlib.colormaps["viridis"](np.arange(256)))[:, :3]
    painted = viridis(np.arange(256.0)[None], 0, 255)[0]
    assert abs(painted - exact).max() < 5.5
    light = painted @ np.array([0.2126, 0.7152, 0.0722])
    assert (np.diff(light) >= -0.5).all()
    np.testing.assert_array_equal(viridis(np.array([[-9.0, 999.0]]), 0, 255)[0], painted[[0, -1]])


def color_of(x: float, y: float) -> list[int]:
    """`computeColor` of Middlebury's colorcode.cpp."""
    wheel: list[tuple[int, int, int]] = []
    wheel += [(255, 255 * i // 15, 0) for i in range(15)]
    wheel += [(255 - 255 * i // 6, 255, 0) for i in range(6)]
    wheel += [(0, 255, 255 * i // 4) for i in range(4)]
    wheel += [(0, 255 - 255 * i // 11, 255) for i in range(11)]
    wheel += [(255 * i // 13, 0, 255) for i in range(13)]
    wheel += [(255, 0, 255 - 255 * i // 6) for i in range(6)]
    place = (math.atan2(-y, -x) / math.pi + 1) / 2 * (len(wheel) - 1)
    first = int(place)
    share = place - first
    colors = zip(wheel[first], wheel[(first + 1) % len(wheel)], strict=True)
    hues = [(1 - share) * one / 255 + share * other / 255 for one, other in colors]
    return [int(255 * (1 - math.hypot(x, y) * (1 - hue))) for hue in hues]


def test_flow_has_the_color_wheel_of_middlebury() -> None:
    turns = np.linspace(0, 2 * np.pi, 97)
    flow = np.stack([np.cos(turns), np.sin(turns)], axis=-1)[None] * np.array([0.0, 0.3, 0.7, 1.0])[:, None, None] * 8
    painted = flow_colors(flow, 8.0)
    expected = np.array([[color_of(x / 8, y / 8) for x, y in row] for row in flow.tolist()])
    assert abs(painted - expected).max() <= 1
    right, down = flow_colors(np.array([[[8.0, 0.0], [0.0, 8.0]]]), 8.0)[0]
    assert right.tolist() == [255, 0, 0]
    assert (down > [240, 200, -1]).all()
    assert flow_colors(np.zeros((1, 1, 2)), 0.0).tolist() == [[[255, 255, 255]]]


def test_a_clip_has_one_scale() -> None:
    depth = VIEWS["depth"]
    frames = [np.array([[200.0, np.inf]]), np.array([[300.0, 400.0]])]
    scale = depth.scale(frames)
    assert depth.label(scale) == "depth: viridis from 200 mm (dark) to 400 mm (bright); nothing is black"
    near, nothing = depth.paint(frames[0], scale)[0]
    assert (near.tolist(), nothing.tolist()) == ([0x44, 0x01, 0x54], [0, 0, 0])
    assert depth.paint(frames[1], scale)[0, 1].tolist() == [0xFD, 0xE7, 0x25]
    empty = [np.full((1, 2), np.inf)]
    assert depth.label(depth.scale(empty)) == "depth: nothing is there, black"
    assert not depth.paint(empty[0], depth.scale(empty)).any()

    radius = VIEWS["coc"]
    scale = radius.scale([np.array([[-3.0, 1.0]]), np.array([[2.0, 0.0]])])
    assert radius.label(scale) == "coc: viridis from -3 px (dark, near) to 3 px (bright, far); nothing is black"
    sharp, nothing = radius.paint(np.array([[0.0, np.inf]]), scale)[0]
    assert sharp.tolist() != nothing.tolist() == [0, 0, 0]
    assert radius.scale([np.full((1, 2), np.inf)]) == (0.0,)
    flow = VIEWS["flow"]
    assert flow.scale([np.array([[[3.0, 4.0]]]), np.zeros((1, 1, 2))]) == (5.0,)
    assert flow.scale([np.array([[[3.0, 4.0], [np.inf, np.inf]]])]) == (5.0,)


@pytest.mark.parametrize("name", VIEWS)
def test_other_numbers_are_refused(name: str) -> None:
    shape = (2, 2, 2) if name == "flow" else (2, 2)
    for wrong in (np.nan, -np.inf):
        with pytest.raises(FileError, match=f"^view: {name} must be finite"):
            VIEWS[name].scale([np.full(shape, wrong)])
