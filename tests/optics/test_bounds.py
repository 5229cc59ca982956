"""Bounds that cut a surface, and those that only touch it."""

from __future__ import annotations

from math import inf, radians, tan
from typing import Any, Literal

import numpy as np
import pytest
from numpy.typing import NDArray

from clsco.optics.quadrics import canonical, cutting_bounds
from clsco.scene.model import Cone, Cylinder, Disc, Ellipsoid, Object, Plane, Quadric, Rectangle, Sphere

FREE = (-inf, inf)
WIDE = (-50.0, 50.0)
EQUAL = (-9.0, 9.0)
RIM = 14.0 * tan(radians(30.0))
UPRIGHT = Cylinder(radius=9.0)
LEANING = Cylinder(radius=9.0, axis=(1.0, 1.0, 0.0))
PARABOLOID = Quadric(coefficients=(1, 1, 0, 0, 0, 0, 0, 0, -5, 0))
CASES: dict[str, tuple[Object, Any, Any]] = {
    "a sphere in its box": (Sphere(radius=9.0), (EQUAL,) * 3, None),
    "half of it": (Sphere(radius=9.0), (EQUAL, (0.0, 9.0), EQUAL), (FREE, (0.0, inf), FREE)),
    "a cut just inside": (Sphere(radius=9.0), ((-8.9999, 9.0), EQUAL, EQUAL), ((-8.9999, inf), FREE, FREE)),
    "rounded to float32": (Sphere(radius=9.1), ((float(np.float32(-9.1)), 9.0999999),) * 3, None),
    "an ellipsoid": (
        Ellipsoid(semi_axes=(9.0, 7.0, 5.0)), (EQUAL, (-7.0, 7.0), (-5.0, 2.0)), (FREE, FREE, (-inf, 2.0)),
    ),
    "a quadric that is a sphere": (Quadric(coefficients=(1, 1, 1, 0, 0, 0, 0, 0, 0, -81)), (EQUAL,) * 3, None),
    "a tube": (UPRIGHT, (EQUAL, (-14.0, 14.0), EQUAL), (FREE, (-14.0, 14.0), FREE)),
    "a little beyond": (UPRIGHT, ((-9.001, 9.001), WIDE, WIDE), (FREE, WIDE, FREE)),
    "half a tube": (UPRIGHT, ((-9.0, 0.0), WIDE, EQUAL), ((-inf, 0.0), WIDE, FREE)),
    "a leaning tube": (LEANING, (WIDE, (-9.0, 9.0), EQUAL), (FREE, EQUAL, FREE)),
    "a cone and its rim": (Cone(half_angle=30.0), ((-RIM, RIM), (-RIM, RIM), (0.0, 14.0)), (FREE, FREE, (-inf, 14.0))),
    "the other nappe": (
        Cone(half_angle=30.0, nappe="towards"), ((-RIM, RIM), WIDE, (-14.0, 0.0)), (FREE, FREE, (-14.0, inf)),
    ),
    "a cone within its rim": (
        Cone(half_angle=30.0), ((-RIM, 0.9 * RIM), WIDE, (0.0, 14.0)), ((-inf, 0.9 * RIM), FREE, (-inf, 14.0)),
    ),
    "a paraboloid": (PARABOLOID, ((-10.0, 10.0), WIDE, (0.0, 20.0)), (FREE, FREE, (-inf, 20.0))),
    "a plane in its own surface": (Plane(), (EQUAL, EQUAL, (0.0, 5.0)), (EQUAL, EQUAL, FREE)),
    "the edge of a sloped one": (Plane(slope_x=0.5), ((-12.0, 12.0), EQUAL, (-6.0, 6.0)), (FREE, EQUAL, (-6.0, 6.0))),
    "nothing within bounds": (Plane(), (EQUAL, EQUAL, (1.0, 5.0)), (EQUAL, EQUAL, (1.0, inf))),
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_bounds_that_touch_do_not_cut(name: str) -> None:
    item, bounds, expected = CASES[name]
    assert cutting_bounds(item.model_copy(update={"bounds": bounds})) == expected


def test_cards_keep_their_sides_alone() -> None:
    assert cutting_bounds(Rectangle(size=(8.0, 6.0), offset=3.0)) == ((-4.0, 4.0), (-3.0, 3.0), FREE)
    assert cutting_bounds(Disc()) is cutting_bounds(Sphere()) is None


def random_item(rng: np.random.Generator, bounds: Any) -> Object:
    x, y = (float(rng.choice([0.0, slope])) for slope in (-1.0, 0.3))
    nappe: Literal["away", "towards"] = "away" if rng.random() < 0.5 else "towards"
    axis = tuple(rng.choice([0.0, 1.0, -0.5], 3).tolist())
    coefficients = rng.choice([0.0, 1.0, -1.0, 0.5, 0.2], 10) * np.array([1.0] * 6 + [5.0] * 3 + [20.0])
    items: tuple[Any, ...] = (
        lambda: Sphere(radius=9.0, bounds=bounds),
        lambda: Ellipsoid(semi_axes=tuple(rng.uniform(3.0, 12.0, 3).tolist()), bounds=bounds),
        lambda: Cylinder(radius=7.0, axis=axis if any(axis) else (0.0, 0.0, 1.0), bounds=bounds),
        lambda: Cone(half_angle=rng.uniform(10.0, 70.0), nappe=nappe, bounds=bounds),
        lambda: Quadric(coefficients=tuple((coefficients + (not coefficients[:9].any())).tolist()), bounds=bounds),
        lambda: Plane(slope_x=x, slope_y=y, bounds=bounds),
    )  # fmt: skip
    found: Object = items[rng.integers(len(items))]()
    return found


def points_of(rng: np.random.Generator, item: Object) -> NDArray[np.float64]:
    """Points (n, 3) of a surface in the object's own frame, on lines of random and of its axes' directions."""
    shape = canonical(item)
    start = (rng.uniform(-20.0, 20.0, (2000, 3)) - shape.origin) @ shape.axes.T
    way = np.where(rng.random((2000, 1)) < 0.5, rng.normal(size=(2000, 3)), np.eye(3)[rng.integers(0, 3, 2000)])
    way = way @ shape.axes.T
    a, b = (way * way) @ shape.q, (start * way) @ shape.q + way @ shape.l
    c = (start * start) @ shape.q + 2.0 * start @ shape.l - shape.k
    with np.errstate(all="ignore"):
        root = np.sqrt(b * b - a * c)
        t = np.concatenate([(-b + root) / a, (-b - root) / a, -c / (2.0 * b)])
        found = np.tile(start, (3, 1)) + t[:, None] * np.tile(way, (3, 1))
        met = np.abs((found * found) @ shape.q + 2.0 * found @ shape.l - shape.k) < 1e-9
    found = found[met]
    return np.asarray(found[shape.nappe * found[:, 2] >= 0] @ shape.axes + shape.origin)


def test_no_point_of_a_random_surface_tells_the_difference() -> None:
    rng = np.random.default_rng(11)
    dropped = kept = 0
    for _ in range(120):
        bounds = np.sort(rng.choice([-12.0, -9.0, -7.0, -5.0, 0.0, 2.0, 5.0, 7.0, 9.0, 12.0], (3, 2)), axis=1)
        bounds[:, 1] += 3.0 * (bounds[:, 0] == bounds[:, 1])
        item = random_item(rng, tuple(map(tuple, bounds.tolist())))
        cut = np.array(cutting_bounds(item) or (FREE,) * 3)
        points = points_of(rng, item)
        inside = ((points >= cut[:, 0]) & (points <= cut[:, 1])).all(axis=1)
        beyond = (points < bounds[:, 0] - 1e-5) | (points > bounds[:, 1] + 1e-5)
        assert not beyond[inside].any(), (item, cut)
        dropped, kept = dropped + np.isinf(cut).sum(), kept + np.isfinite(cut).sum()
    assert dropped > 100
    assert kept > 100
