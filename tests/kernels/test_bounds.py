"""Roots of a quadric that count: within bounds, as near to them as arithmetic can tell, and of one root."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from clsco.opencl.buffers import download, empty
from clsco.opencl.session import Session
from clsco.optics.motion import pose_at
from clsco.optics.quadrics import PlacedSurface, place
from clsco.passes.pack import surface_structs
from clsco.records import REAL, Real
from clsco.reference.common import geometry as twin
from clsco.scene.model import Cylinder, Ellipsoid, Object, ObjectMotion, Plane, Quadric
from tests.kernels.numbers import held, whole

Array = NDArray[Any]
Run = Callable[..., None]
RNG = np.random.default_rng

SOURCE = """
// Ray i, of components in `rays` one after the other, and surface i, or the only one.
__kernel void roots(__constant surface_t *surfaces, const int single, const int only, __global const real *rays,
                    const int count, __global real *w, __global uchar *label)
{
    const int i = get_global_id(0);
    if (i >= count)
        return;
    const real3 ray = (real3)(rays[i], rays[count + i], rays[2 * count + i]);
    uchar found;
    w[i] = solve_root(surfaces + (single ? 0 : i), ray, only, &found);
    label[i] = found;
}
"""
TURNED = ObjectMotion(velocity=(2.0, 1.0, 5.0), angular_velocity=(10.0, -15.0, 30.0))
BOX = ((4.0, 30.0), (-30.0, 30.0), (-40.0, 22.0))


def turned(item: Object) -> PlacedSurface:
    return place(item, pose_at(TURNED, 0.6, "euler"))


def rays_to(count: int, width: float) -> Array:
    """Rays (count, 3) that both precisions hold exactly."""
    slopes = RNG(21).uniform(-width, width, (count, 2))
    return held(np.concatenate([slopes, np.ones((count, 1))], axis=1))


def solved(
    session: Session, run_source: Run, items: list[Object], rays: Array, real: Real, only: int = 0, quadratic: int = 1
) -> tuple[Array, Array]:
    """Inverse depths and labels (count,) of a surface for each ray, or of one for all."""
    count = len(rays)
    w, label = empty(session, 8 * count), empty(session, count)
    placed = surface_structs(items, [turned(item) for item in items], real)
    features = {"BOUNDED": 1, "QUADRATIC": quadratic, "LINEAR": 1}
    numbers = np.int32(len(items) == 1), np.int32(only), rays.T.ravel().astype(REAL[real]), np.int32(count)
    run_source(SOURCE, "roots", real, features, count, placed, *numbers, w, label)
    return whole(session, w, (count,), real), download(session, label, (count,), np.uint8)


SOLIDS: list[Object] = [
    Ellipsoid(center=(0.0, 0.0, 300.0), semi_axes=(30.0, 20.0, 50.0), motion=TURNED, bounds=BOX),
    # The same with the other sign: the root with +sqrt is the farther one.
    Quadric(
        coefficients=(-1.0, -1.5, -0.5, 0.3, 0.1, 0.2, 0, 0, 0, 900.0),
        center=(0.0, 0.0, 300.0),
        motion=TURNED,
        bounds=BOX,
    ),
]


@pytest.mark.parametrize("real", ["double", "float"])
@pytest.mark.parametrize("item", SOLIDS, ids=lambda item: str(item.shape))
def test_one_sheet_or_both_within_bounds(session: Session, run_source: Run, item: Object, real: Real) -> None:
    rays, surface = rays_to(4000, 0.1), turned(item)
    assert (surface.constant < 0) == isinstance(item, Quadric)
    found_labels = []
    for only in range(3):
        w, label = solved(session, run_source, [item], rays, real, only)
        expected_w, expected = twin.solve_quadric(surface, item.bounds, rays, only)
        np.testing.assert_array_equal(label, expected)
        np.testing.assert_allclose(w, expected_w, rtol=1e-9 if real == "double" else 1e-6, atol=0)
        found_labels.append(label)
    both, plus, minus = found_labels
    # Each is seen alone, and the farther one through the part of the nearer one that the bounds take away.
    for one, other, alone in ((plus, minus, 1), (minus, plus, 2)):
        assert set(np.unique(one)) == {0, alone}
        assert ((one > 0) & (other == 0)).sum() > 50
        assert ((one > 0) & (both == alone)).sum() > 50


@pytest.mark.parametrize("real", ["double", "float"])
@pytest.mark.parametrize("axis", range(3))
def test_bounds_close_to_the_surface(session: Session, run_source: Run, axis: int, real: Real) -> None:
    """Each ray has a surface of its own, with a bound just before or behind where the ray meets it."""
    item = Cylinder(center=(3.0, -5.0, 310.0), radius=40.0, motion=TURNED)
    rays, surface = rays_to(240, 0.08), turned(item)
    w, label = twin.solve_quadric(surface, None, rays)
    assert label.all()
    along = surface.body_offset[axis] * w, twin.turned(surface.body_turn, rays)[:, axis]
    position, step = sum(along) / w, (1e-10 if real == "double" else 4e-6) * sum(np.abs(part) for part in along) / w
    items: list[Object] = []
    for i in range(len(rays)):
        within, low = i % 2, i // 2 % 2
        bound = position[i] + step[i] * (1 if bool(within) != bool(low) else -1)
        box = [(-1e4, 1e4)] * 3
        box[axis] = (bound, 1e4) if low else (-1e4, bound)
        items.append(item.model_copy(update={"bounds": tuple(box)}))
    # The near root is the one that is cut.
    _, near = solved(session, run_source, items, rays, real, only=int(label[0]))
    assert (label == label[0]).all()
    np.testing.assert_array_equal(near > 0, np.arange(len(rays)) % 2 == 1)


@pytest.mark.parametrize("real", ["double", "float"])
@pytest.mark.parametrize("quadratic", [0, 1])
def test_bounds_that_touch_the_surface_take_nothing_away(
    session: Session, run_source: Run, real: Real, quadratic: int
) -> None:
    """A plane lies at depth 0 of its own frame: a box that begins there holds all of it."""
    item = Plane(distance=250.0, motion=TURNED, bounds=((-1e4, 1e4), (-1e4, 1e4), (0.0, 1e4)))
    rays = rays_to(2000, 0.3)
    _, label = solved(session, run_source, [item], rays, real, quadratic=quadratic)
    assert label.all()
