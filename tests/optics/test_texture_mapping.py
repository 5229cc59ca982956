"""Places of known points of every shape in the image on it."""

from __future__ import annotations

from math import cos, pi, sin, sqrt
from typing import Any

import numpy as np
import pytest

from clsco.constants import WRAP_CLAMP, WRAP_MIRROR, WRAP_REPEAT
from clsco.optics.texture_mapping import texture_map
from clsco.reference.trace.mapping import along_axis, texel_at
from clsco.scene.model import Object
from tests.scenes import scene_from

COLUMNS, ROWS = 60, 40
BALL = {"shape": "sphere", "radius": 30.0}
TUBE = {"shape": "cylinder", "radius": 30.0}
CARD = {"shape": "rectangle", "size": [30.0, 20.0]}
ROOF = {"shape": "plane", "distance": 250.0, "slope_y": 1.0, "texture_size": 60.0}
HAT = {"shape": "cone", "half_angle": 30.0, "texture_size": 60.0}
EGG = {"shape": "ellipsoid", "semi_axes": [10.0, 20.0, 30.0]}


def item(shape: dict[str, Any], **keys: Any) -> Object:
    (found,) = scene_from({}, {"texture_mapping": "surface"} | shape | keys).objects
    return found


def texel(shape: Object, *points: Any, size: tuple[int, int] = (COLUMNS, ROWS)) -> list[tuple[float, float]]:
    """(column, row) of points in the object's own frame: right, up, away from the camera."""
    found = texture_map(shape, *size)
    at = texel_at(found, np.array(points, float) @ found.frame.T)
    return list(zip(at.column.tolist(), at.row.tolist(), strict=True))


FRONT, RIGHT, TOP = [0.0, 0.0, -30.0], [30.0, 0.0, 0.0], [0.0, 30.0, 0.0]


@pytest.mark.parametrize(
    ("shape", "point", "expected"),
    [
        (item(BALL), FRONT, (30, 20)),
        (item(BALL), RIGHT, (45, 20)),
        (item(BALL), TOP, (30, 0)),
        (item(BALL), [0.0, -30.0, 0.0], (30, 40)),
        (item(BALL, texture_repeats=[2, 1]), RIGHT, (60, 20)),
        (item(BALL, texture_repeats=2), RIGHT, (60, 20)),
        (item(BALL, texture_repeats=2), TOP, (30, 20 - 40 * 2 * 60 / (2 * 40) / 2)),
        (item(EGG), [0.0, 20.0 / sqrt(2), -30.0 / sqrt(2)], (30, 10)),
        (item(TUBE), FRONT, (30, 20)),
        (item(TUBE), [30.0, 60 * pi * 40 / 60 / 2, 0.0], (45, 0)),
        (item(TUBE, texture_size=[60.0 * pi, 10.0]), [0.0, 5.0, -30.0], (30, 0)),
        (item(TUBE, axis=[0.0, 0.0, 1.0]), TOP, (30, 20)),
        (item(CARD), [-15.0, 10.0, 0.0], (0, 0)),
        (item(CARD), [15.0, -10.0, 0.0], (60, 40)),
        (item(CARD, texture_repeats=2), [15.0, 0.0, 0.0], (90, 20)),
        (item(CARD, texture_repeats=[1, 2]), [0.0, 10.0, 0.0], (30, -20)),
        (item(CARD, texture_size=[60.0, 20.0]), [15.0, 10.0, 0.0], (45, 0)),
        (item(CARD, texture_offset=[0.5, 0.25]), [0.0, 0.0, 0.0], (0, 30)),
        # A point to the right of the middle shows what is below it in an image turned counterclockwise.
        (item(CARD, texture_size=[60.0, 40.0], texture_angle=90.0), [10.0, 0.0, 0.0], (30, 30)),
        (item(ROOF), [6.0, 0.0, 0.0], (36, 20)),
        (item(ROOF), [0.0, 6.0, 6.0], (30, 20 - 6 * sqrt(2))),
        (item(HAT), [0.0, 10.0, 10.0 * sqrt(3)], (30, 0)),
        (item(HAT), [10.0, 0.0, 10.0 * sqrt(3)], (30 + 20 * sqrt(0.5), 20 - 20 * sqrt(0.5))),
        (item(BALL, texture_mapping="cube"), FRONT, (30, 20)),
        (item(BALL, texture_mapping="cube"), [15.0, 15.0, -30.0], (45, 10)),
        (item(BALL, texture_mapping="cube"), [30.0, 15.0, -15.0], (15, 10)),
    ],
)
def test_known_points(shape: Object, point: list[float], expected: tuple[float, float]) -> None:
    ((column, row),) = texel(shape, point)
    assert (column, row) == pytest.approx(expected, abs=1e-9)


def test_what_is_beyond_an_image() -> None:
    """A card shows its photo once, others repeat theirs, and beyond a pole the image comes back."""
    assert texture_map(item(CARD), 8, 8).wrap_x == WRAP_CLAMP
    assert texture_map(item(CARD, texture_repeats=3), 8, 8).wrap_x == WRAP_REPEAT
    assert texture_map(item(CARD, texture_wrap="mirror"), 8, 8).wrap_y == WRAP_MIRROR
    ball = texture_map(item(BALL), 8, 8)
    assert (ball.wrap_x, ball.wrap_y) == (WRAP_REPEAT, WRAP_MIRROR)
    assert texture_map(item(BALL, texture_repeats=[1, 2]), 8, 8).wrap_y == WRAP_REPEAT


def test_cones_are_rolled_out_without_stretching() -> None:
    """Distances along the surface are those in the image, 1 texel per mm, in any direction."""
    shape = item(HAT)
    angle, length = np.radians(50.0), 40.0
    s, c = 0.5, sqrt(3) / 2

    def point(along: float, around: float) -> list[float]:
        return [along * s * np.sin(around), along * s * np.cos(around), along * c]

    places = [np.array(place) for place in texel(shape, point(length, angle), point(length + 1e-4, angle))]
    assert np.linalg.norm(places[1] - places[0]) == pytest.approx(1e-4, rel=1e-6)
    places = [np.array(place) for place in texel(shape, point(length, angle), point(length, angle + 1e-4))]
    assert np.linalg.norm(places[1] - places[0]) == pytest.approx(1e-4 * length * s, rel=1e-6)


MOVED_AND_TURNED = {"texture_offset": [0.5, 0.0], "texture_angle": 90.0}


@pytest.mark.parametrize(
    ("keys", "point", "expected"),
    [
        ({"shape": "rectangle", "size": [40, 30], "texture_repeats": 2}, (-20.0, 0.0, 0.0), (-0.5, 0.5)),
        ({"shape": "rectangle", "size": [40, 20], **MOVED_AND_TURNED}, (0, 20, 0), (0.5, 0.5)),
        ({"shape": "sphere", "texture_repeats": 4}, (0.0, 1.0, -1e-9), (0.5, 2.5)),
        ({"shape": "ellipsoid", "semi_axes": [10, 20, 10]}, (0, 20 * sin(0.5), -10 * cos(0.5)), (0.5, 0.5 + 0.5 / pi)),
    ],
)  # fmt: skip
def test_what_the_page_of_scene_files_says(keys: dict[str, Any], point: Any, expected: Any) -> None:
    """An even number ends in halves; the offset turns with the image; repeats and latitude on round bodies."""
    ((column, row),) = texel(item(keys), point, size=(64, 32))
    np.testing.assert_allclose([column / 64, 1 - row / 32], expected, rtol=0, atol=1e-6)


def test_triplanar_images_read_right_from_the_right_the_top_and_the_front() -> None:
    """Right and up for who looks from there: away, up; right, away; right, up."""
    found = texture_map(item(BALL, texture_mapping="triplanar", texture_size=10.0), 32, 32)
    for axis, (right, up) in enumerate((((0, 0, 1), (0, 1, 0)), ((1, 0, 0), (0, 0, 1)), ((1, 0, 0), (0, 1, 0)))):
        texel = texel_at(found, along_axis(np.array([right, up], float), axis))
        np.testing.assert_allclose(texel.column, [19.2, 16.0])
        np.testing.assert_allclose(texel.row, [16.0, 12.8])
