"""Ground truth without the image: the same bits, and nothing run, written or counted that only the image needs."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import clsco
from clsco.frame.outputs import ALL_TRUTH
from clsco.plan.prepare import prepare
from clsco.plan.request import Request
from tests.command import clsco_
from tests.slow import mostly_slow

CAMERA = {"resolution": [48, 40], "pixel_pitch": 0.08}
NEAR: dict[str, Any] = {
    "shape": "sphere",
    "center": [0.0, 0.0, 230.0],
    "radius": 8.0,
    "motion": {"velocity": [4, 0, 0]},
}
TWO = {"camera": CAMERA, "sequence": {"samples": 3}, "object": [NEAR, {"shape": "plane", "distance": 300.0}]}
ONE = TWO | {"object": [NEAR | {"texture_mapping": "surface"}]}
WARPED = TWO | {"motion": {"warp": "forward"}}
SCENES = {
    "hidden": TWO, "mapped": ONE, "forward": WARPED, "stereo": TWO | {"stereo": {"baseline": 6.0}},
    "layered": TWO | {"psf": {"occlusion": "layered"}},
}  # fmt: skip


def with_map(moves: bool) -> dict[str, Any]:
    depth = np.full((40, 48), 300.0, np.float32)
    depth[10:30, 10:30], depth[18:20, 18:20] = 240.0, 0.0
    item = {"shape": "depth_map", "depth": depth, "texture": np.linspace(0.0, 1.0, 40 * 48).reshape(40, 48)}
    return {"camera": CAMERA, "object": [item | ({"motion": {"velocity": [5, 0, 0]}} if moves else {})]}


@pytest.mark.parametrize("name", mostly_slow([*SCENES, "map", "moving map"], ["hidden", "stereo"]))
def test_truth_has_the_bits_that_it_has_beside_the_image(name: str) -> None:
    scene = clsco.parse_scene(SCENES[name] if name in SCENES else with_map(name == "moving map"))
    both, alone = (list(clsco.render(scene, color=color, frames=(0,))) for color in (True, False))
    assert len(both) == len(alone)
    for one, other in zip(both, alone, strict=True):
        arrays = one.arrays()
        assert arrays.pop("color") is not None
        assert other.color is None
        assert other.arrays().keys() == arrays.keys()
        for array, found in other.arrays().items():
            np.testing.assert_array_equal(found, arrays[array], strict=True)


@pytest.mark.parametrize(
    ("content", "truth", "kinds"),
    [
        (TWO, ("depth", "missing"), ["ground truth"]),
        (SCENES["layered"], ("depth",), ["ground truth"]),
        (WARPED, ("depth", "filled"), ["ground truth"]),
        (WARPED, ("missing",), ["reproject", "fill", "ground truth"]),
        (with_map(False), ("depth", "missing"), ["ground truth"]),
    ],
)
def test_passes_are_those_of_the_truth(content: dict[str, Any], truth: tuple[str, ...], kinds: list[str]) -> None:
    scene = clsco.parse_scene(content)
    plan = prepare(scene, Request(truth, color=False)).plan
    assert [each.kind for each in plan.passes] == kinds
    assert plan.taps == 0.0
    frame = clsco.render_frame(scene, truth=truth, color=False)
    assert not {"gather", "cast", "pinhole", "trace_subpixels"} & frame.metadata["seconds"].keys()


def test_time_falls() -> None:
    scene = clsco.parse_scene(TWO | {"camera": CAMERA | {"f_number": 0.5}, "sequence": {"samples": 25}})
    spent = []
    for color in (False, True):
        clsco.render_frame(scene, truth="depth", color=color)  # compiles
        seconds = clsco.render_frame(scene, truth="depth", color=color).metadata["seconds"]
        spent.append(sum(seconds.values()))
    assert 2.0 * spent[0] < spent[1]


def test_a_frame_without_color_says_so(tmp_path: Path) -> None:
    frame = clsco.render_frame(clsco.parse_scene(ONE), truth="depth", color=False)
    assert repr(frame) == "<Frame 0: 48 x 40 px, no image, f/2; depth>"
    assert "img" not in frame._repr_html_()
    for use in (frame.image, lambda: frame.save(tmp_path / "frame.png"), lambda: frame.save(tmp_path / "frame.tif")):
        with pytest.raises(
            clsco.ArgumentError, match="frame 0: must have color for an image; got one rendered with color"
        ):
            use()
    frame.save(tmp_path / "frame.npz")
    with np.load(tmp_path / "frame.npz") as arrays:
        assert list(arrays) == ["depth"]
    assert [path.name for path in tmp_path.iterdir()] == ["frame.npz"]


@pytest.mark.parametrize("truth", ["alpha", ("depth", "subframes"), ()])
def test_what_belongs_to_the_image_needs_it(truth: Any) -> None:
    of_the_image = "the image, what a sensor gives, alpha and subframes"
    with pytest.raises(clsco.SceneError, match=f"color: must be True for {of_the_image}; got False"):
        clsco.render(clsco.parse_scene(ONE), truth=truth, color=False)


@pytest.fixture
def ball(tmp_path: Path) -> Path:
    path = tmp_path / "ball.json"
    path.write_text(json.dumps(TWO), "utf-8")
    return path


def test_files_are_those_of_the_truth(ball: Path, tmp_path: Path) -> None:
    out, words = tmp_path / "out", ("--truth", "depth,coc", "--format", "npz", "--no-color")
    assert clsco_("render", ball, "-o", out, *words).stdout == f"{out}: 1 frame, from frame_0000 on: json, npz\n"
    assert sorted(path.name for path in out.iterdir()) == ["frame_0000.json", "frame_0000.npz"]
    assert "already" in clsco_("render", ball, "-o", out, *words, "--resume").stdout
    assert "png" in clsco_("render", ball, "-o", out, *words[:2], "--resume").stdout
    assert "already" in clsco_("render", ball, "-o", out, *words, "--resume").stdout
    plan = " ".join(clsco_("plan", ball, *words).stdout.split())
    assert "image nobody asked for the color" in plan
    assert "trace" not in plan


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ((), "--no-color: needs --truth"),
        (("--truth", "depth", "--format", "npz", "--subframes"), "must be without --subframes and --video"),
        (("--truth", "depth,color", "--format", "npz"), "--truth must be without color; got npz:color,depth"),
    ],
)
def test_what_the_image_is_needed_for_is_refused(ball: Path, tmp_path: Path, words: Any, message: str) -> None:
    result = clsco_("render", ball, "-o", tmp_path / "out", "--no-color", *words)
    assert result.exit_code == 2
    assert message in " ".join(result.stderr.split())
    assert not (tmp_path / "out").exists()


def test_all_truth_can_be_alone() -> None:
    frame = clsco.render_frame(clsco.parse_scene(ONE), truth=ALL_TRUTH, color=False)
    assert {"sharp", "depth", "uv", "flow_backward"} <= frame.arrays().keys()
