"""Output of trace.cl for points that were behind the lens, or that something stands before."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from clsco.opencl.buffers import download, empty
from clsco.opencl.session import Session
from clsco.passes.trace import EMPTY_STATISTICS
from clsco.records import REAL, Real
from clsco.reference.trace import trace as twin
from clsco.reference.trace.truth import ground_truth
from clsco.scene.model import Cylinder, ObjectMotion, Psf, Sphere
from tests.kernels.test_trace import (
    GUARD,
    LIMB,
    PARTLY_LIMB,
    PARTLY_OCCLUDED,
    ROW,
    SCENES,
    WHOLE,
    assert_truth,
    planned,
    random_textures,
    scene,
    traced,
    truth_on_device,
    view,
)

Array = NDArray[Any]
Run = Callable[..., None]


def test_what_was_behind_the_lens_is_dark(session: Session) -> None:
    """A tube around the axis goes by: what is seen of its near part comes from behind the lens."""
    tube = Cylinder(center=(0.0, 0.0, 200.0), radius=24.0, axis=(0.0, 0.0, 1.0))
    plan = planned(scene(tube, ObjectMotion(velocity=(0.0, 0.0, 600.0)), psf=Psf(silhouette_samples=2)), 3)
    textures = tuple(texture.astype(float) for texture in random_textures(plan.scene, plan.channels))
    exact = ground_truth(plan.scene, textures, 1)
    dark = exact.sharp[..., 0] == 0
    assert 0.1 < dark[exact.mask].mean() < 0.9
    assert_truth(session, plan, ("sharp",), 1)


def test_points_are_occluded_in_the_next_frame_by_others_and_their_own(session: Session) -> None:
    """The scenes above would not test `flow_occluded` if nothing, or everything, were."""
    shares = []
    for name in ("sphere moved, 2 x 2", "three in a row", "plane at rest"):
        plan = planned(*SCENES[name])
        found = truth_on_device(session, plan, ("flow_occluded", "object_id"), 1)
        last = found["object_id"] == len(plan.scene.objects) - 1
        shares.append(found["flow_occluded"][last].mean())
    assert 0.003 < shares[0] < 0.5  # its own back
    assert 0.003 < shares[1] < 0.5  # a wall at rest
    assert shares[2] == 0.0


def test_what_is_behind_the_lens_in_the_next_frame_is_not_visible(session: Session) -> None:
    motion = ObjectMotion(velocity=(0.0, 0.0, -1000.0))
    plan = planned(scene(Sphere(center=(0.0, 0.0, 580.0), radius=200.0), motion, psf=Psf(silhouette_samples=2)), 3)
    found = truth_on_device(session, plan, ("flow", "flow_occluded", "flow_backward"), 0)
    assert found["flow_occluded"].all()
    assert not found["flow"].any()
    assert found["flow_backward"].any()
    assert_truth(session, plan, ("flow", "flow_occluded", "flow_backward"), 0)


def test_subpixel_sources_of_all_layers_are_marked(session: Session) -> None:
    """Sub-pixel sources are marked if something hides all of them or a part, their edge being as soft as the source is
    wide, and at limbs."""
    plan = planned(scene(ROW, psf=Psf(silhouette_samples=2)), 1)
    kinds = np.zeros(3, np.int64)
    for group in plan.groups:
        found = traced(session, plan, 0.55, group=group)
        marked = twin.mark_silhouettes(found.label)
        exact = twin.trace_subpixels(view(plan, 0.55), group, GUARD, marked)
        records = found.sub_source[found.slot[exact.row, exact.column]]
        np.testing.assert_array_equal(records[..., 0] >= 0, exact.hit)
        blocked = np.zeros(exact.hit.shape, bool)
        if exact.visibility is not None:
            blocked[exact.hit] = exact.visibility.row >= 0
        assert exact.limb is not None
        marks = np.where(blocked, PARTLY_OCCLUDED, WHOLE)
        marks[exact.hit & exact.limb] = np.where(blocked, PARTLY_LIMB, LIMB)[exact.hit & exact.limb]
        np.testing.assert_array_equal(records[..., 3].view(np.int32), marks)
        kinds += [int(kind.sum()) for kind in (~exact.hit, exact.hit & blocked, exact.hit & ~blocked)]
    assert kinds.min() > 100, kinds


def test_range_of_radii_is_noted(session: Session) -> None:
    plan = planned(*SCENES["sphere moved, 2 x 2"])
    sources = twin.trace(view(plan, 0.55), plan.groups[0], GUARD)
    sub = twin.trace_subpixels(view(plan, 0.55), plan.groups[0], GUARD, twin.mark_silhouettes(sources.label))
    radii = np.abs(np.concatenate([sources.radius[sources.label > 0], sub.radius[sub.hit]]))
    noted = traced(session, plan, 0.55).statistics[:2].view(np.float32)
    # Rounded to float32; the largest is at the limb, good to the root of 1e-15 of some 60 px.
    np.testing.assert_allclose(noted, [radii.max(), radii.min()], rtol=1e-6)
    nothing = traced(session, planned(*SCENES["nothing in visibility"]), 0.0).statistics
    assert nothing.tolist() == EMPTY_STATISTICS.tolist()


COVERS: dict[Real, float] = {"double": 1e-6, "float": 1e-5}  # relative difference of inverse depths
COVERED = """
__kernel void cover(__global const real *seen, __global const real *ratio, __global const real *w, const int count,
                    __global int *out)
{
    const int i = get_global_id(0);
    if (i < count)
        out[i] = covered(seen[i], ratio[i], w[i]);
}
"""


@pytest.mark.parametrize("real", ["double", "float"])
def test_a_point_is_covered_by_what_is_nearer_than_by_rounding(session: Session, run_source: Run, real: Real) -> None:
    nearer = np.repeat([0.0, 0.9, 1.1, 1e5], 50) * COVERS[real]
    w, ratio = np.random.default_rng(4).uniform([[2e-3], [0.5]], [[9e-3], [2.0]], (2, nearer.size))
    seen = w * (1 + nearer) / ratio
    text = '#include "trace/truth.cl"\n'
    out = empty(session, 4 * w.size)
    args = (values.astype(REAL[real]) for values in (seen, ratio, w))
    run_source(text + COVERED, "cover", real, {}, w.size, *args, np.int32(w.size), out)
    np.testing.assert_array_equal(download(session, out, w.shape, np.int32), nearer > COVERS[real])
