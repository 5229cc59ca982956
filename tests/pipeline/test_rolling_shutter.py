"""Rolling shutters: each row, or column, is exposed at its own time, and what is not open is not rendered."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import clsco
from clsco import reference
from clsco.engine.film import Film
from clsco.optics.exposure import line_times
from clsco.plan.plan import Plan
from clsco.scene.model import Scene
from tests.pipeline.common import PLAIN, assert_strips_agree
from tests.pipeline.test_scenes import BALL, GOING
from tests.scenes import scene_from
from tests.slow import mostly_slow

ROWS, COLUMNS = 100, 56
CAMERA = {"resolution": [COLUMNS, ROWS], "pixel_pitch": 0.08, "aperture_diameter": 20.0}
CARD = {"shape": "plane", "distance": 300.0, "texture": "checkerboard"}
MOVING = BALL | {"motion": GOING}
SCANS = ("top_to_bottom", "bottom_to_top", "left_to_right", "right_to_left")
OPEN = {"samples": 2, "shutter": 0.3, "readout": 0.6}
LAYERED = {"psf": PLAIN | {"occlusion": "layered"}}
COLORED = {"lens": {"axial": [0.02, 0.0, -0.02]}}
FLAT = {"psf": PLAIN | {"occlusion": "none"}}


def scene(*items: dict[str, Any], sections: dict[str, Any] | None = None, **sequence: Any) -> Scene:
    given = {"camera": CAMERA, "psf": PLAIN, "sequence": OPEN | sequence} | (sections or {})
    return scene_from(given, *(items or (MOVING, CARD)))


SHUTTERS: Any = (None, "box"), (LAYERED, "triangle"), (FLAT, [1.0, 0.0, 0.5])
OPENED = [(scan, *shutter) for shutter in SHUTTERS for scan in SCANS]


@pytest.mark.parametrize(("scan", "sections", "curve"), mostly_slow(OPENED, [("left_to_right", None, "box")]))
def test_the_device_renders_what_the_reference_does(scan: str, sections: dict[str, Any] | None, curve: Any) -> None:
    wanted = scene(sections=sections, scan=scan, shutter_curve=curve)
    (frame,), (exact,) = clsco.render(wanted, truth=()), reference.render(wanted)
    np.testing.assert_allclose(frame.color, exact.color, atol=1e-5)
    assert frame.metadata["samples"] == 6


@pytest.mark.parametrize("scan", SCANS)
def test_a_line_is_the_mean_of_the_subframes_while_it_is_open(scan: str) -> None:
    """Each line has two of four sub-frames: the first and the last line whole ones, and others parts of two more."""
    wanted = scene(scan=scan, readout=0.3)
    frame: Any = clsco.render_frame(wanted, truth=("subframes",))
    color, images = frame.color, frame.subframes
    if scan in ("left_to_right", "right_to_left"):
        color, images = color.T, images.swapaxes(1, 2)
    if scan in ("bottom_to_top", "right_to_left"):
        color, images = color[::-1], images[:, ::-1]
    np.testing.assert_allclose(color[0], images[:2, 0].mean(axis=0), atol=2e-7)
    np.testing.assert_allclose(color[-1], images[2:, -1].mean(axis=0), atol=2e-7)
    half = (len(color) - 1) // 2  # the last line opens after two of the four shares
    late = 2.0 * np.arange(half)[:, None] / (len(color) - 1)  # shares after the first line, at most one
    first, second, third = (image[:half] for image in images[:3])
    np.testing.assert_allclose(color[:half], 0.5 * ((1.0 - late) * first + second + late * third), atol=2e-7)
    assert np.abs(color - images.mean(axis=0))[:half].max() > 0.01


def test_only_rows_that_are_open_are_rendered(monkeypatch: pytest.MonkeyPatch) -> None:
    wanted = scene(sections={"camera": CAMERA | {"resolution": [COLUMNS, 200]}}, readout=2.0, shutter=0.1, samples=1)
    heights: list[int] = []
    add = Film.add

    def noted(self: Film, session: Any, strip: Any, number: int, found: Any) -> None:
        heights.append(self.strip_parts[strip][number].rows)
        add(self, session, strip, number, found)

    monkeypatch.setattr(Film, "add", noted)
    (narrow,) = clsco.render(wanted, truth=())
    some = sum(heights)
    heights.clear()
    monkeypatch.setattr(Plan, "narrows", False)
    (whole,) = clsco.render(wanted, truth=())
    assert sum(heights) > 4.0 * some  # not more, as parts begin with whole bands
    np.testing.assert_allclose(narrow.color, whole.color, atol=1.2e-7)  # of bands that end sooner


IN_STRIPS: Any = [("top_to_bottom", None, 0.6), ("right_to_left", None, 0.6), ("top_to_bottom", COLORED, 2.0)]


@pytest.mark.parametrize(("scan", "sections", "readout"), mostly_slow(IN_STRIPS, IN_STRIPS[:2]))
def test_strips_have_the_bits_of_the_frame(scan: str, sections: dict[str, Any] | None, readout: float) -> None:
    """Strips in which a time sample is not open have no part of it."""
    assert_strips_agree(scene(scan=scan, sections=sections, readout=readout))


@pytest.mark.parametrize("scan", ["top_to_bottom", "left_to_right"])
def test_what_does_not_move_is_as_bright_as_ever(scan: str) -> None:
    (frame,) = clsco.render(scene(scan=scan, shutter_curve="triangle"), truth=())
    (still,) = clsco.render(scene(CARD), truth=())
    away = np.zeros(frame.color.shape, np.bool_)
    away[:10] = away[-10:] = True
    np.testing.assert_allclose(frame.color[away], still.color[away], atol=1.5e-7)


def test_lines_that_are_never_open_together_have_time_samples_of_their_own() -> None:
    wanted = scene(readout=2.0, shutter=0.005, samples=1)
    (frame,) = clsco.render(wanted, truth=())
    assert frame.metadata["samples"] == ROWS
    times = [sample["time"] for sample in frame.metadata["intermediate"]]
    np.testing.assert_allclose(times, line_times(wanted, 0), atol=1e-12)
    for row in (45, 54):
        at = line_times(wanted, 0)[row]
        (then,) = clsco.render(scene(readout=0.0, shutter=1e-6, samples=1, shutter_start=at - 0.5e-6), truth=())
        np.testing.assert_allclose(frame.color[row], then.color[row], atol=2e-6)


def edge_places(image: NDArray[np.floating]) -> NDArray[np.float64]:
    """Columns at which rows go from white to black."""
    return np.asarray(image.astype(np.float64).sum(axis=1) - 0.5)


def edge_scene(**sequence: Any) -> Scene:
    """An edge in focus that moves by 24 px in the readout and the exposure of 1 s each, to the right."""
    picture = np.zeros((96, 160), np.float32)
    picture[:, :60] = 1.0
    camera = {"resolution": [160, 96], "pixel_pitch": 0.05, "focus_distance": 250.0, "aperture_diameter": 1.0}
    speed = 24.0 * 0.05 * 250.0 / 20.0
    card = {"shape": "plane", "distance": 250.0, "texture": picture, "motion": {"velocity": [speed, 0.0, 0.0]}}
    sections = {"camera": camera, "motion": {"texture_filter": "bilinear"}}
    return scene_from(sections | {"sequence": {"interval": 1.0, "readout": 1.0} | sequence}, card)


@pytest.mark.parametrize(("scan", "sign"), [("top_to_bottom", 1.0), ("bottom_to_top", -1.0)])
def test_an_edge_leans_by_its_speed_times_the_time_from_row_to_row(scan: str, sign: float) -> None:
    (frame,) = clsco.render(edge_scene(scan=scan), truth=())
    places = edge_places(frame.color)
    lean = np.polyfit(np.arange(96), places, 1)[0]
    assert lean == pytest.approx(sign * 24.0 / 95.0, abs=1e-3)
    assert np.abs(np.diff(places) - sign * 24.0 / 95.0).max() < 0.02


def test_an_edge_that_columns_follow_is_stretched() -> None:
    """From left to right at 159 px/s against 24: it is met at x = x0 + v t with t = x / 159."""
    (frame,) = clsco.render(edge_scene(scan="left_to_right", shutter=1e-3, samples=1), truth=())
    assert edge_places(frame.color) == pytest.approx((59.5 + 24.0 * 0.0005) / (1.0 - 24.0 / 159.0), abs=0.02)


def test_a_defocused_point_that_moves_is_a_sheared_disc() -> None:
    """cov(x, y) / var(y) is the way of the image from row to row."""
    camera = {"resolution": [96, 96], "pixel_pitch": 0.02, "focus_distance": 180.0, "aperture_diameter": 12.0}
    speed = 23.0 * 0.02 * 250.0 / 20.0  # 23 px/s
    spot: dict[str, Any] = {"shape": "rectangle", "center": [0.0, 0.0, 250.0], "size": [0.5, 0.5], "texture": "#ffffff"}
    spot |= {"motion": {"velocity": [speed, 0.0, 0.0]}}
    wanted = scene_from({"camera": camera, "sequence": {"interval": 1.0, "shutter": 0.5, "readout": 0.5}}, spot)
    (frame,) = clsco.render(wanted, truth=())
    image = frame.color.astype(np.float64)
    row, column = np.indices(image.shape)
    row, column = (at - (image * at).sum() / image.sum() for at in (row, column))
    shear = (image * row * column).sum() / (image * row**2).sum()
    assert (image * row**2).sum() / image.sum() > 8.0**2 / 4.0  # of a disc of 8 px at least
    assert shear == pytest.approx(23.0 * 0.5 / 95.0, rel=0.02)


@pytest.mark.parametrize("scan", ["top_to_bottom", pytest.param("left_to_right", marks=pytest.mark.slow)])
def test_fewer_samples_by_a_tolerance_are_within_it(scan: str) -> None:
    wanted = scene(samples=9, scan=scan)
    (exact,), (fewer,) = clsco.render(wanted, truth=()), clsco.render(wanted, truth=(), tolerance=0.02)
    assert fewer.metadata["samples"] < exact.metadata["samples"]
    assert np.sqrt(np.mean((fewer.color - exact.color) ** 2)) < 0.02


@pytest.mark.slow
def test_lenses_that_share_their_rays_have_the_bits_of_each_alone() -> None:
    base = scene()
    lenses = [base.replace("camera.aperture_diameter", size) for size in (10.0, 20.0)]
    for (_, shared), lens in zip(clsco.render_sweep(lenses, truth=()), lenses, strict=True):
        (alone,) = clsco.render(lens, truth=())
        np.testing.assert_allclose(shared.color, alone.color, atol=1e-6)


@pytest.mark.slow
def test_both_eyes_roll() -> None:
    pair = scene(sections={"stereo": {"baseline": 20.0}})
    for frame, exact in zip(clsco.render(pair, truth=()), reference.render(pair), strict=True):
        np.testing.assert_allclose(frame.color, exact.color, atol=1e-5)
