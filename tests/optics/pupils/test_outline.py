"""Weights of polygons, rings, ellipses and images: light, moments, orientation, and areas by brute force."""

from __future__ import annotations

from math import ceil, cos, pi, sin, tau
from typing import Any

import numpy as np
import pytest

from clsco.optics.point_spread import PointSpread, point_spread
from clsco.optics.psf_grid import table_coordinate
from clsco.optics.psf_tables import psf_table, table_bytes
from clsco.optics.pupils.image import Image, image_pupil, turned
from clsco.optics.pupils.polygon import Polygon, vertices
from clsco.scene.model import Aperture, Psf
from tests.optics.grids import grid, square
from tests.slow import combined, mostly_slow

CURVED: dict[str, Any] = {"shape": "polygon", "blades": 5, "rotation": 11.0}
OPENINGS: dict[str, dict[str, Any]] = {
    "pentagon": CURVED,
    "bulging": CURVED | {"blade_curvature": 0.6},
    "concave": CURVED | {"blade_curvature": -0.7},
    "bulging, narrow": CURVED | {"blade_curvature": 0.4, "squeeze": 1.9},
    "pentagon, wide": CURVED | {"squeeze": 0.6},
    "ellipse": {"squeeze": 2.5},
    "flat ellipse": {"squeeze": 0.5},
    "elliptic ring": {"shape": "ring", "obstruction": 0.4, "squeeze": 1.5},
    "thin ring": {"shape": "ring", "obstruction": 0.95},
    "heart, narrow": {"shape": "image", "squeeze": 1.6},
}


def heart(count: int, rotation: float = 0.0, squeeze: float = 1.0) -> Image:
    """(x^2 + y^2 - a)^3 < b x^2 y^3, upright."""
    at = (np.arange(count) + 0.5) * 2 / count - 1
    x, y = at[None, :], 0.1 - at[:, None]
    return image_pupil(np.asarray((x * x + y * y - 0.35) ** 3 < 1.2 * x * x * y**3, np.float64), rotation, squeeze)


def opening(name: str, edge: str = "integrated") -> PointSpread:
    aperture = OPENINGS[name]
    if aperture.get("shape") == "image":
        return PointSpread(heart(48, 20.0, aperture["squeeze"]), "integrated" if edge == "integrated" else "area")
    return point_spread(Psf.model_validate({"edge": edge}), Aperture(**aperture))


@pytest.mark.parametrize("edge", mostly_slow(["integrated", "area"], ["integrated"]))
@pytest.mark.parametrize("name", mostly_slow(OPENINGS, ["pentagon", "thin ring", "heart, narrow"]))
def test_no_light_is_lost(name: str, edge: str) -> None:
    psf = opening(name, edge)
    for radius in (1e-9, 1e-4, 0.3, 1.0, -7.3, 40.0):
        x, y = grid(psf.reach(abs(radius), True) + 1)
        found = psf.weights(x, y, np.asarray(radius))
        assert found.min() >= 0.0
        assert found.sum() == pytest.approx(1.0, abs=1e-9)
        assert psf.subpixel_weights(x - 0.375, y + 0.125, np.asarray(radius)).sum() == pytest.approx(1.0, abs=1e-9)
        np.testing.assert_array_less(np.abs(found - psf.weights(-x, -y, np.asarray(-radius))), 1e-12)


@pytest.mark.parametrize("name", mostly_slow(OPENINGS, ["bulging, narrow", "concave", "thin ring", "heart, narrow"]))
def test_weights_are_areas_by_brute_force(name: str) -> None:
    """Points of the opening, each seen from points of the pixel."""
    psf, radius = opening(name), -2.7
    half = ceil(135 * psf.extent)
    step = (np.arange(-half, half) + 0.5) / 50  # pixels begin and end between two points
    u, v = np.meshgrid(step, step)
    through = psf.pupil.transmission(u / radius, v / radius)
    light = through.sum() * (step[1] - step[0]) ** 2 / (pi * radius**2)
    assert psf.pupil.light == pytest.approx(light, rel=2e-3)
    moment = 0.5 * (through * (u * u + v * v)).sum() / through.sum()
    assert psf.pupil.second_moment == pytest.approx(moment / radius**2, rel=2e-3)
    area = opening(name, "area")
    for dx, dy in ((0, 0), (2, 1), (-2, 0), (1, -2), (-1, 2)):
        a, b = np.abs(u - dx), np.abs(v - dy)
        for lens, seen in ((psf, np.maximum(1 - a, 0) * np.maximum(1 - b, 0)), (area, (a < 0.5) & (b < 0.5))):
            weight = lens.weights(np.asarray(float(dx)), np.asarray(float(dy)), np.asarray(radius))
            assert weight == pytest.approx((seen * through).sum() / through.sum(), abs=3e-4)


def test_moments_of_closed_forms() -> None:
    """Variances per axis at R = 14.4 px: R^2 / 4 of a disc, (2 + cos(tau / n)) R^2 / 12 of a polygon, (1 + q^2) R^2 / 4
    of a ring, that of x by the square of the squeeze less; and 1 / 6 of the pixels."""
    cases: list[tuple[dict[str, Any], float]] = [
        ({}, 0.25),
        ({"shape": "polygon", "blades": 5}, (2 + cos(tau / 5)) / 12),
        ({"shape": "polygon", "blades": 6}, (2 + cos(tau / 6)) / 12),
        ({"shape": "polygon", "blades": 6, "blade_curvature": 1.0}, 0.25),
        ({"shape": "ring", "obstruction": 0.4}, 0.25 * 1.16),
    ]
    for aperture, moment in cases:
        for squeeze in (0.5, 1.0, 2.0):
            psf = point_spread(Psf(), Aperture(**aperture, squeeze=squeeze))
            found, (x, y) = square(psf, 14.4, psf.reach(14.4) + 1), grid(psf.reach(14.4) + 1)
            expected = 14.4**2 * moment
            assert (found * x * x).sum() == pytest.approx(expected / squeeze**2 + 1 / 6, rel=2e-4)
            assert (found * y * y).sum() == pytest.approx(expected + 1 / 6, rel=2e-5)


def test_names_tell_the_shape_and_the_squeeze() -> None:
    names = {name: opening(name).pupil.name for name in ("bulging", "pentagon, wide", "elliptic ring", "thin ring")}
    assert names == {
        "bulging": "5 blades, curved by 0.6", "pentagon, wide": "5 blades, squeezed 0.6 times",
        "elliptic ring": "ring, 0.4 covered, squeezed 1.5 times", "thin ring": "ring, 0.95 covered",
    }  # fmt: skip


def test_light_of_blades() -> None:
    """Polygon and circular segments: at curvature 1 the circle."""
    polygon = 5 / tau * sin(tau / 5)
    light = [point_spread(Psf(), Aperture(**CURVED, blade_curvature=c)).pupil.light for c in (-1.0, 0.0, 1e-9, 1.0)]
    assert light == pytest.approx([2 * polygon - 1, polygon, polygon, 1.0], abs=1e-8)


def test_blades_keep_their_corners() -> None:
    """Behind the focus an edge faces right: its middle bulges towards the circle, the corner opposite stays on it."""
    widths = []
    for curvature in (-1.0, 0.0, 0.5, 1.0):
        psf = point_spread(Psf(), Aperture(shape="polygon", blades=5, blade_curvature=curvature))
        middle = square(psf, 20.0, 22)[22] > 1e-9
        widths.append((np.flatnonzero(middle)[[-1, 0]] - 22).tolist())
    apothem = 20 * cos(pi / 5)
    edges = (2 * apothem - 20, apothem, 10 + apothem / 2, 20)
    assert [right for right, _ in widths] == [ceil(edge) for edge in edges]
    assert {left for _, left in widths} == {-20}


def test_an_image_is_turned_counter_clockwise() -> None:
    picture = np.zeros((40, 40))
    picture[18:22, 24:36] = 1.0  # to the right
    assert (turned(picture, 90.0) == np.rot90(picture)).all()
    found = turned(picture, 30.0)
    assert found.sum() == pytest.approx(picture.sum(), rel=1e-2)
    at = np.arange(40) - 19.5
    right, up = (found * at).sum() / found.sum(), (found * -at[:, None]).sum() / found.sum()
    assert np.degrees(np.arctan2(up, right)) == pytest.approx(30.0, abs=0.1)
    assert np.hypot(right, up) == pytest.approx(10.0, abs=0.05)


@pytest.mark.parametrize(
    ("name", "samples"),
    combined(
        ["pentagon", "bulging", "flat ellipse", "heart, narrow"], [0, 2], kept=[("pentagon", 2), ("heart, narrow", 0)]
    ),
)
def test_tables_hold_the_weights(name: str, samples: int) -> None:
    """At most 2e-4 of the light is elsewhere, at any radius of either sign."""
    psf = opening(name)
    table, off = psf_table(psf, 0.0, 6.0, samples), []
    size = sum(each.nbytes for each in (table.intervals, table.coefficients, table.taps, table.outlines))
    assert table_bytes(psf, 0.0, 6.0, samples) == size
    for radius in (-5.99, -3.2, -0.7, 0.001, 0.31, 1.7, 5.5):
        u = float(table_coordinate(psf, np.asarray(radius), samples > 0)) - table.first
        start, half = table.intervals[int(u) + table.count * (radius < 0)]
        lanes, side = -(-(2 * half + 1) // 8) * 8, 2 * half + 1
        count = max(samples, 1) ** 2 * side
        block = table.coefficients[start : start + count * 4 * lanes].reshape(count, 4, lanes)[..., :side]
        found = np.tensordot((u % 1.0) ** np.arange(4), block.astype(float), axes=(0, 1)).reshape(-1, side, side)
        x, y = grid(half)
        offsets = [-0.25, 0.25] if samples else [0.0]
        weigh = psf.subpixel_weights if samples else psf.weights
        expected = [weigh(x - ox, y - oy, np.asarray(radius)) for oy in offsets for ox in offsets]
        off.append(max(np.abs(a - b).sum() for a, b in zip(found, expected, strict=True)))
    assert max(off) < 2e-4


@pytest.mark.parametrize("name", mostly_slow(["bulging, narrow", "concave", "elliptic ring"], ["elliptic ring"]))
def test_a_filled_grid_has_the_shares_of_its_pixels(name: str) -> None:
    pupil, span = opening(name).pupil, np.arange(-45.0, 46.0)
    filled = pupil.rows(np.array([40.3]), span, span, tent=False)[0]
    each = pupil.share(span, span[:, None], np.array(40.3), tent=False)
    assert filled == pytest.approx(each, abs=1e-6 * float(each.max()))
    assert filled.sum() == pytest.approx(1.0, abs=1e-12)


def test_rotation_is_counter_clockwise_as_the_image_is_seen() -> None:
    corners = vertices(5, 20.0) * [1, -1]  # up
    found = np.sort(np.degrees(np.arctan2(corners[:, 1], corners[:, 0])) % 360)
    np.testing.assert_allclose(found, [56, 128, 200, 272, 344])
    upper_right = square(PointSpread(Polygon(3, 90.0)), 10.0, 12)
    rows = np.flatnonzero(upper_right.sum(axis=1) > 1e-9) - 12
    assert (rows[0], rows[-1]) == (-5, 10)  # an edge above, a corner below


def test_a_heart_stands_upright_behind_the_focus_and_on_its_tip_before_it() -> None:
    behind, before = (square(PointSpread(heart(96)), radius, 22) for radius in (20.0, -20.0))
    np.testing.assert_allclose(before, behind[::-1, ::-1], rtol=0, atol=1e-12)
    np.testing.assert_allclose(behind, behind[:, ::-1], rtol=0, atol=1e-9)
    rows = np.flatnonzero(behind.sum(axis=1) > 1e-6)
    widths = (behind[rows] > 1e-6).sum(axis=1)
    assert widths[0] > 3 * widths[-1]  # lobes above, the tip below


def test_an_image_of_a_polygon_is_the_polygon() -> None:
    """Cells across the rim are wrong by half of them: 2 / count of the radius along it."""
    count, polygon = 512, Polygon(6, 20.0)
    at = (np.arange(4 * count) + 0.5) / (2 * count) - 1
    fine = polygon.transmission(at[None, :], at[:, None])
    image = image_pupil(fine.reshape(count, 4, count, 4).mean(axis=(1, 3)))
    for radius in (1.0, -5.0, 10.0):
        a, b = (square(PointSpread(pupil), radius, 12) for pupil in (image, polygon))
        assert np.abs(a - b).sum() < 2e-3
    assert image.second_moment == pytest.approx(polygon.second_moment, rel=1e-3)


def test_what_lies_outside_of_the_rim_is_dark() -> None:
    whole = image_pupil(np.ones((64, 64)))
    assert whole.second_moment == pytest.approx(0.25, rel=2e-3)
    assert whole.image[0, 0] == 0.0
    assert whole.image[32, 2] == 1.0


def test_pupils_of_other_cells_are_others() -> None:
    one, two = image_pupil(np.ones((8, 8))), image_pupil(np.eye(8))
    assert one != two
    assert repr(one) != repr(two)
    assert PointSpread(one) == PointSpread(image_pupil(np.full((8, 8), 0.3)))  # scaled to 1
    assert hash(PointSpread(one)) == hash(PointSpread(image_pupil(np.ones((8, 8)))))
    assert PointSpread(one) != point_spread(Psf())


def test_a_run_is_most_of_a_wide_polygon() -> None:
    table = psf_table(PointSpread(Polygon(5, 8.0)), 0.0, 20.0)
    reach = int(table.intervals[: table.count, 1].max())
    last = table.outlines[(table.end - 1 - table.first) * (2 * reach + 1) :][: 2 * reach + 1]
    of_runs, of_light = (last[:, 3] - last[:, 2]).sum(), (last[:, 1] - last[:, 0] + 1).sum()
    assert of_runs > 0.55 * of_light
