"""Fewer samples within a tolerance: the estimated error is above the true one, and nothing takes longer than before."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import clsco
from clsco.optics.exposure import Exposure, frame_exposure
from clsco.plan import approximation
from clsco.plan.approximation import ApproximationReport
from clsco.plan.prepare import Prepared, prepare, prepare_sweep
from clsco.plan.request import Request
from clsco.scene.model import Scene
from clsco.scene.sweep import Sweep
from tests.command import clsco_
from tests.scenes import scene_file
from tests.slow import combined, mostly_slow

CAMERA: dict[str, Any] = {"resolution": [96, 72], "pixel_pitch": 0.05, "aperture_diameter": 12.0}
BALL: dict[str, Any] = {"shape": "sphere", "center": [0.0, 0.0, 262.0], "radius": 1.0, "texture": "#e0e0e0"}
WALL: dict[str, Any] = {"shape": "plane", "distance": 300.0, "texture": "#303030"}
MOVES: dict[str, Any] = {"velocity": [160.0, 30.0, 0.0]}
STRIPES = np.tile(np.arange(96) // 4 % 2, (72, 1)).astype(np.float32)
FINE: dict[str, Any] = {"shape": "plane", "distance": 300.0, "texture": "siemens_star", "texture_mapping": "surface"}
FINE |= {"texture_size": 40.0}
STILL: dict[str, Any] = {"camera": CAMERA, "object": [BALL, WALL]}
MOVING: dict[str, Any] = STILL | {"sequence": {"frames": 1, "shutter": 0.05, "interval": 0.1}}
SCENES: dict[str, dict[str, Any]] = {
    "moving ball": MOVING | {"object": [BALL | {"motion": MOVES}, WALL]},
    "textured": MOVING
    | {"object": [BALL | {"motion": MOVES, "texture": "bricks"}, WALL | {"texture": "siemens_star"}]},
    "blurred outline": STILL | {"camera": CAMERA | {"aperture_diameter": 40.0, "focus_distance": 320.0}},
    "outline in focus": STILL | {"camera": CAMERA | {"aperture_diameter": 0.5}},
    "approaching": MOVING | {"object": [WALL | {"texture": "bricks", "motion": {"velocity": [0.0, 0.0, -900.0]}}]},
    "turning": MOVING | {"object": [WALL | {"texture": "bricks", "motion": {"angular_velocity": [0.0, 0.0, 400.0]}}]},
    "stripes": MOVING
    | {"object": [WALL | {"texture": STRIPES, "motion": {"velocity": [240.0, 0.0, 0.0]}}], "camera": CAMERA},
    "camera": MOVING | {"camera": CAMERA | {"motion": MOVES}, "object": [BALL, WALL | {"texture": "checkerboard"}]},
    "Gaussian": MOVING | {"object": [BALL | {"motion": MOVES}, WALL], "psf": {"model": "gaussian"}},
    "fine texture": STILL | {"camera": CAMERA | {"focus_distance": 303.0}, "object": [FINE]},
    "tilted through the focus": STILL
    | {"camera": CAMERA | {"focus_distance": 300.0}, "object": [FINE | {"slope_x": 1.0, "slope_y": 0.5}]},
    "fine texture, moving": MOVING | {"object": [FINE | {"motion": {"velocity": [120.0, 40.0, 0.0]}}]},
    "lit": MOVING | {"object": [BALL | {"motion": MOVES}, WALL], "light": {"direction": [1.0, 1.0, 1.0]}},
}


def prepared(scene: Any, tolerance: float | None = None) -> Prepared:
    return prepare(clsco.parse_scene(scene), Request(tolerance=tolerance))


@pytest.mark.parametrize(
    ("name", "tolerance"),
    combined(SCENES, (0.002, 0.01, 0.04), kept=[("blurred outline", 0.04), ("stripes", 0.002), ("stripes", 0.04)]),
)
def test_the_true_error_stays_below_the_estimate_and_the_tolerance(name: str, tolerance: float) -> None:
    exact = clsco.render_frame(SCENES[name], truth=())
    found = clsco.render_frame(SCENES[name], truth=(), tolerance=tolerance)
    report = ApproximationReport(**found.metadata["approximation"])
    error = np.sqrt(np.mean((found.color.astype(np.float64) - exact.color) ** 2))
    assert error <= max(report.rms_error, 1e-6) <= tolerance
    assert found.metadata["samples"] == report.samples <= report.scene_samples == exact.metadata["samples"]
    fewer = report.samples < report.scene_samples or report.silhouette_samples < report.scene_silhouette_samples
    assert fewer or tolerance < 0.04


def test_fine_textures_have_as_few_sources_as_the_tolerance_lets_them() -> None:
    """A lens whose light is no disc keeps them all: its errors are not estimated."""
    scene, ring = SCENES["tilted through the focus"], {"aperture": {"shape": "ring"}}
    counts = [prepared(scene, tolerance).plan.silhouettes for tolerance in (1e-5, 0.1)]
    assert counts == [4, 2]
    assert prepared(scene | ring, 0.1).plan.silhouettes == 4


def test_stripes_that_move_by_their_own_width_are_not_taken_for_still_ones() -> None:
    """Samples one period of a pattern apart would show it as if nothing moved."""
    report = prepared(SCENES["stripes"], 0.05).approximation
    assert report is not None
    moved_px = report.scene_samples - 1
    assert report.samples > moved_px / 8
    assert report.samples < report.scene_samples


@pytest.mark.parametrize(("bent", "alike"), [(0.0, True), (0.9, False)])
def test_errors_of_rows_with_weights_of_their_own_are_averaged(
    bent: float, alike: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    plain = prepared(SCENES["turning"], 0.05).approximation

    def bend(scene: Scene, frame: int, samples: int) -> Exposure:
        """Later samples weigh more further down."""
        exposure, later = frame_exposure(scene, frame, samples), np.linspace(-bent, bent, samples)[:, None]
        return replace(exposure, weights=(1.0 + later * np.linspace(-1.0, 1.0, 72)) / samples)

    monkeypatch.setattr(approximation, "frame_exposure", bend)
    found = prepared(SCENES["turning"], 0.05).approximation
    assert plain is not None
    assert found is not None
    assert plain.samples < plain.scene_samples
    assert (found.rms_error == pytest.approx(plain.rms_error)) == alike


@pytest.mark.parametrize("name", mostly_slow(SCENES, ["textured", "camera", "fine texture"]))
def test_no_pass_takes_more_than_without_a_tolerance(name: str) -> None:
    """Fewer samples of each kind, so that nothing is added."""
    exact = prepared(SCENES[name]).plan
    for tolerance in (1e-6, 0.1):
        plan = prepared(SCENES[name], tolerance).plan
        assert plan.samples <= exact.samples
        assert plan.silhouettes <= exact.silhouettes
        assert plan.taps <= exact.taps
        assert sum(size for one in plan.passes for size in one.buffers.values()) <= sum(
            size for one in exact.passes for size in one.buffers.values()
        )


def test_more_is_saved_the_larger_the_tolerance_and_the_wider_the_blur() -> None:
    counts = []
    for aperture in (0.5, 12.0, 40.0):
        scene = SCENES["camera"] | {"camera": SCENES["camera"]["camera"] | {"aperture_diameter": aperture}}
        reports = [prepared(scene, tolerance).approximation for tolerance in (0.003, 0.01, 0.05)]
        counts.append([report.samples for report in reports if report is not None])
    for row in (*counts, *map(list, zip(*counts, strict=True))):
        assert row == sorted(row, reverse=True)
        assert row[-1] < row[0]


def test_what_saves_nothing_has_the_same_bits_and_says_so(tmp_path: Path) -> None:
    flat = {"camera": CAMERA, "object": [WALL | {"texture": "bricks"}]}
    for scene, tolerance, why in (
        (flat, 0.1, "exact: nothing can be saved, as nothing moves, and no silhouette is in sight"),
        (SCENES["stripes"], 1e-6, "exact: fewer samples may be off by more than 1e-06 of white"),
    ):
        exact, found = (clsco.render_frame(scene, truth=(), tolerance=given) for given in (None, tolerance))
        np.testing.assert_array_equal(found.color, exact.color)
        assert exact.metadata["approximation"] is None
        assert ApproximationReport(**found.metadata["approximation"]).line() == why
    text = '[camera]\nresolution = [24, 16]\n[[object]]\nshape = "plane"\ndistance = 300.0\n'
    done = clsco_("render", scene_file(tmp_path / "flat.toml", text), "-o", tmp_path / "out", "--tolerance", 0.1)
    assert done.exit_code == 0, done.output
    assert done.stderr.count("exact: nothing can be saved, as nothing moves, and no silhouette is in sight") == 1


def test_the_choice_is_reported_and_a_frame_of_another_tolerance_is_made_again(tmp_path: Path) -> None:
    text = (
        "[camera]\nresolution = [48, 32]\npixel_pitch = 0.1\n[sequence]\nframes = 1\nshutter = 0.05\ninterval = 0.1\n"
        '[[object]]\nshape = "sphere"\ntexture = "#ffffff"\nmotion = {velocity = [90.0, 0.0, 0.0]}\n'
    )
    command = ["render", scene_file(tmp_path / "ball.toml", text), "-o", tmp_path / "out", "--resume"]
    written = []
    for more in (["--tolerance", "0.02"], ["--tolerance", "0.02"], [], ["--tolerance", "0.01"]):
        done = clsco_(*command, *more)
        assert done.exit_code == 0, done.output
        values = json.loads((tmp_path / "out" / "frame_0000.json").read_text())["approximation"]
        assert (None if values is None else values["tolerance"]) == (float(more[1]) if more else None)
        written.append((tmp_path / "out" / "frame_0000.json").stat().st_mtime_ns)
        if len(written) == 1:
            report = ApproximationReport(**values)
            assert report.samples < report.scene_samples
            assert f"{report.samples} of {report.scene_samples} time samples and " in done.stderr
            assert f"silhouette samples: estimated RMS error {report.rms_error:.2g} of white" in done.stderr
    assert written[0] == written[1] < written[2] < written[3]


def test_frames_without_color_have_all_samples_and_are_left_as_they_are(tmp_path: Path) -> None:
    text = '[camera]\nresolution = [24, 16]\npixel_pitch = 0.1\n[[object]]\nshape = "sphere"\n'
    command = ["render", scene_file(tmp_path / "ball.toml", text), "-o", tmp_path / "out", "--resume"]
    command += ["--no-color", "--format", "npz", "--tolerance", "0.1"]
    outputs = [clsco_(*command) for _ in range(2)]
    assert [done.exit_code for done in outputs] == [0, 0], outputs[0].output
    assert "all frames are there already" in outputs[1].output
    assert json.loads((tmp_path / "out" / "frame_0000.json").read_text())["approximation"] is None


def test_lenses_that_share_rays_have_the_samples_of_the_one_that_needs_most() -> None:
    scenes = [
        clsco.parse_scene(SCENES["camera"]).replace("camera.aperture_diameter", aperture)
        for aperture in (0.5, 12.0, 40.0)
    ]
    alone = [prepare(scene, Request(tolerance=0.01)).plan for scene in scenes]
    assert len({plan.samples for plan in alone}) == 3
    together = [each.plan for each in prepare_sweep(Sweep(("",) * 3, tuple(scenes)), Request(tolerance=0.01))]
    assert {plan.samples for plan in together} == {max(plan.samples for plan in alone)}
    assert {plan.silhouettes for plan in together} == {max(plan.silhouettes for plan in alone)}
    moved = clsco.parse_scene(SCENES["stripes"])
    other = prepare_sweep(Sweep(("", ""), (scenes[2], moved)), Request(tolerance=0.01))
    assert other[0].plan.samples == alone[2].samples


def test_views_of_a_stereo_pair_have_the_same_samples() -> None:
    scene = SCENES["moving ball"] | {"stereo": {"baseline": 10.0}}
    one, other = prepared(scene, 0.01).plans
    assert (one.samples, one.silhouettes) == (other.samples, other.silhouettes)
    assert one.samples < prepared(scene).plan.samples
