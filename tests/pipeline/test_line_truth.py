"""Ground truth of a rolling shutter: each row, or column, at its own time, and flow to the line that shows a point."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest

import clsco
from clsco.cli.check import compare
from clsco.frame.files import files_of, write_frame
from clsco.frame.truth_files import TruthFile
from clsco.frame.views import VIEWS
from clsco.optics.exposure import line_times
from clsco.scene.model import Scene
from tests.files.readers import torchvision_flo
from tests.pipeline.common import PLAIN, assert_strips_agree
from tests.pipeline.test_rolling_shutter import OPEN, SCANS
from tests.pipeline.test_scenes import BALL
from tests.scenes import outputs_of, reference_frames, rendered, scene_from
from tests.slow import mostly_slow

CAMERA: dict[str, Any] = {"resolution": [56, 48], "pixel_pitch": 0.08, "aperture_diameter": 20.0}
MOVING = BALL | {"motion": {"velocity": [15.0, 12.0, 20.0], "angular_velocity": [10.0, 40.0, 5.0]}}
CARD = {"shape": "plane", "distance": 300.0, "texture": "checkerboard", "motion": {"velocity": [3.0, -8.0, 0.0]}}


def scene(*items: dict[str, Any], sections: dict[str, Any] | None = None, **sequence: Any) -> Scene:
    camera = CAMERA | {"motion": {"velocity": [3.0, 2.0, 5.0]}}
    given = {"camera": camera, "psf": PLAIN, "sequence": OPEN | sequence} | (sections or {})
    return scene_from(given, *(items or (MOVING, CARD)))


@pytest.mark.parametrize("scan", mostly_slow(SCANS, ["left_to_right"]))
@pytest.mark.parametrize("sections", mostly_slow([{}, {"stereo": {"baseline": 20.0, "toe_in": 2.0}}], [{}]))
def test_every_output_agrees(scan: str, sections: dict[str, Any]) -> None:
    wanted = scene(scan=scan, sections=sections)
    for frame, exact in zip(rendered(wanted, precision="double"), reference_frames(wanted), strict=True):
        found = compare(frame, exact)
        assert {"row_time", "flow", "flow_backward", "flow_occluded", "depth"} <= {each.output for each in found}
        assert ("disparity" in {each.output for each in found}) == bool(sections)
        assert [each for each in found if each.count] == []
        assert 0.02 < frame.flow_occluded.mean() < 0.7


PULL = {"lens": {"keyframe": [{"time": 0.0, "focus_distance": 250.0}, {"time": 1.0, "focus_distance": 330.0}]}}
SHAKE = {"camera": {"resolution": [40, 30], "pixel_pitch": 0.08, "shake": {"rotation_rms": 0.5, "band": [2.0, 8.0]}}}


@pytest.mark.parametrize("sections", mostly_slow([PULL, SHAKE], [SHAKE]), ids=["focus", "shake"])
def test_a_lens_and_a_camera_that_move_within_the_frame(sections: dict[str, Any]) -> None:
    """A shake goes faster than the rows in places, where points are met several times or never."""
    wanted = scene(BALL, CARD, sections={"camera": CAMERA | {"resolution": [40, 30]}} | sections)
    (frame,), (exact,) = rendered(wanted, precision="double"), reference_frames(wanted)
    assert [each for each in compare(frame, exact) if each.count] == []
    assert np.isinf(frame.flow_backward).any() == ("shake" in sections["camera"] if "camera" in sections else False)


@pytest.mark.parametrize("scan", ["top_to_bottom", "right_to_left"])
def test_a_line_has_the_truth_of_its_time(scan: str) -> None:
    wanted, names = scene(scan=scan), ("depth", "blur_radius", "normal", "object_id", "mask", "sharp", "hidden")
    frame = clsco.render_frame(wanted, truth=("row_time", *names), color=False)
    times = line_times(wanted, 0)
    np.testing.assert_array_equal(frame.row_time, times)
    for line in (0, 20, 31, 47):
        start = times[line] - 0.5e-6
        global_one = scene(readout=0.0, shutter=1e-6, samples=1, shutter_start=start)
        then = clsco.render_frame(global_one, truth=names, color=False)
        at = (slice(None), line) if scan == "right_to_left" else (line, slice(None))
        for name in names:
            one, other = (getattr(each, name)[at] for each in (frame, then))
            np.testing.assert_allclose(one, other, atol=2e-5, err_msg=name)


def test_strips_have_the_truth_of_the_frame() -> None:
    wanted = scene(sections={"camera": CAMERA | {"resolution": [56, 100]}})
    outputs = tuple(sorted(outputs_of(wanted) - {"color"}))
    assert_strips_agree(wanted, outputs)


def drifting(right: float, down: float, **sequence: Any) -> Scene:
    """A plane whose image moves by so many px/s."""
    step = 0.08 * 300.0 / 20.0
    card = CARD | {"motion": {"velocity": [right * step, -down * step, 0.0]}}
    return scene(card, sections={"camera": CAMERA}, **sequence)


@pytest.mark.parametrize("scan", mostly_slow(SCANS, ["bottom_to_top", "left_to_right"]))
def test_flow_solves_for_the_time_of_the_row_it_leads_to(scan: str) -> None:
    """y' - y = v (T + t (y' - y)), t being the time from row to row."""
    right, down = 6.0, 4.0
    given = drifting(right, down, scan=scan, frames=3)
    (frame,) = rendered(given, frames=[1], truth=("flow", "flow_backward"), color=False)
    rows = scan in ("top_to_bottom", "bottom_to_top")
    late = 0.6 / (47 if rows else 55) * (1.0 if scan in ("top_to_bottom", "left_to_right") else -1.0)
    for flow, interval in ((frame.flow, 1.0), (frame.flow_backward, -1.0)):
        along, across = (down, right) if rows else (right, down)
        wanted = along * interval / (1.0 - along * late)
        other = across * (interval + late * wanted)
        middle = flow[10:-10, 10:-10]
        np.testing.assert_allclose(middle[..., int(rows)], wanted, atol=1e-5)
        np.testing.assert_allclose(middle[..., 1 - int(rows)], other, atol=1e-5)


def test_there_is_no_flow_where_the_image_is_as_fast_as_the_scan(tmp_path: Path) -> None:
    wanted = drifting(3.0, 80.0)  # 47 rows in 0.6 s: 78 px/s
    (frame,) = rendered(wanted)
    assert np.isinf(frame.flow).all()
    assert frame.flow_occluded.all()
    (extent,) = VIEWS["flow"].extent(frame.flow)
    assert extent == 0.0
    assert (VIEWS["flow"].paint(frame.flow, (extent,)) == 0).all()
    write_frame(tmp_path, [frame], 8, "srgb", files_of("", "flo,npz"), scene=wanted)
    assert (torchvision_flo(tmp_path / "frame_0000_flow.flo") > 1e9).all()  # unknown
    (slow,) = rendered(drifting(3.0, 76.0), truth=("flow",), color=False)
    assert np.isfinite(slow.flow).all()


def test_row_time_is_in_files_of_arrays(tmp_path: Path) -> None:
    wanted = scene(scan="left_to_right")
    frame = clsco.render_frame(wanted)
    files = (TruthFile("npz", float16=("all",)), TruthFile("npy", ("row_time",)), TruthFile("exr"))
    write_frame(tmp_path, [frame], 8, "srgb", files, scene=wanted)
    for found in (np.load(tmp_path / "frame_0000.npz")["row_time"], np.load(tmp_path / "frame_0000_row_time.npy")):
        assert found.dtype == np.float64
        np.testing.assert_array_equal(found, line_times(wanted, 0))
    (part,) = OpenEXR.File(str(tmp_path / "frame_0000.exr"), separate_channels=True).parts
    found = part.channels["row_time"].pixels
    np.testing.assert_array_equal(found, np.broadcast_to(line_times(wanted, 0).astype(np.float32), (48, 56)))
    assert clsco.render_frame(scene(readout=0.0), truth="all", color=False).row_time is None
