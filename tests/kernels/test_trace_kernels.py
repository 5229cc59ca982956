"""Single kernels of kernels/trace: what they write, and that it is all; silhouettes by labels alone; hidden light."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, Literal

import numpy as np
import pyopencl as cl
import pytest
from numpy.typing import NDArray

from clsco.frame.strips import Strip
from clsco.opencl.buffers import copied, download, empty
from clsco.opencl.session import Session
from clsco.optics.lens import Lens
from clsco.optics.psf_tables import psf_table
from clsco.optics.visibility import OcclusionGroup
from clsco.passes.pack import camera_grid, grid_struct, group_struct, lens_struct, psf_struct
from clsco.passes.trace import EMPTY_STATISTICS
from clsco.plan.buffers import source_bytes
from clsco.plan.plan import Plan
from clsco.records import REAL, Real
from clsco.reference.trace import trace as twin
from clsco.reference.trace.truth import ground_truth
from clsco.scene.model import Cylinder, ObjectMotion, Psf, Sphere
from tests.kernels import test_trace as traces
from tests.kernels.launches import run
from tests.kernels.test_trace import GUARD, SCENES, built, planned, scene, traced, view
from tests.slow import mostly_slow

Array = NDArray[Any]
Run = Callable[..., None]
LOCAL = (7, 5)  # divide neither the grid nor its part
SPARE, UNTOUCHED = 4096, 0xA5  # bytes beyond what a kernel may write, and what is in them
TIME = 0.55


@pytest.fixture
def plan() -> Plan:
    """A card that sinks into a cylinder, both moved, in color."""
    cylinder = traces.ROW[1].model_copy(update={"motion": traces.MOTION})
    psf = Psf(silhouette_samples=2, edge="sampled")
    return planned(scene((traces.CARD, cylinder), psf=psf), 3)


def buffers(session: Session, **sizes: int) -> dict[str, cl.Buffer]:
    return {name: copied(session, np.full(size + SPARE, UNTOUCHED, np.uint8)) for name, size in sizes.items()}


def written(session: Session, buffer: cl.Buffer, shape: tuple[int, ...], dtype: Any) -> Array:
    """Download what a kernel wrote to one of `buffers`, and check that it wrote nothing beyond."""
    size = int(np.prod(shape)) * np.dtype(dtype).itemsize
    found = download(session, buffer, (size + SPARE,), np.uint8)
    assert (found[size:] == UNTOUCHED).all()
    return found[:size].view(dtype).reshape(shape)


def pixel_arguments(session: Session, plan: Plan, group: OcclusionGroup) -> dict[str, Any]:
    wanted = plan.scene
    tables = [psf_table(plan.psf, plan.smallest_blur, plan.largest_blur, n) for n in (0, plan.silhouettes)]
    return {
        "grid": camera_grid(wanted.camera, plan.guard_px, "double"),
        "lens": lens_struct(Lens.of(wanted.camera), "double"),
        "surfaces": traces.on_device(session, plan, TIME, "double"),
        "group": group_struct(group, len(wanted.objects)),
        "psf": psf_struct(plan.psf, tables[0], tables[1], "double"),
        "texture": traces.stack(session, plan),
    }


@pytest.mark.parametrize("occlusion", mostly_slow(["none", "visibility"], ["visibility"]))
def test_what_is_cast_once_is_aimed_for_one_lens_after_the_other(
    session: Session, plan: Plan, occlusion: Literal["none", "visibility"]
) -> None:
    plan = planned(plan.scene.model_copy(update={"psf": plan.scene.psf.model_copy(update={"occlusion": occlusion})}), 3)
    target, grid = built(session, plan, "double"), (plan.width, plan.height)
    area, group = plan.width * plan.height, plan.groups[-1]
    hits = {"value": 4 * plan.channels * area, "depth": 8 * area, "label": area}
    given, planes = pixel_arguments(session, plan, group), buffers(session, **hits)
    run(session, target, "cast", grid, LOCAL, **given, **planes)
    shape, exact = (plan.height, plan.width), twin.trace(view(plan, TIME), group, GUARD)
    labels = written(session, planes["label"], shape, np.uint8)
    np.testing.assert_array_equal(labels, exact.label & 127)
    depth = written(session, planes["depth"], shape, np.float64)
    np.testing.assert_allclose(depth, exact.inverse_depth, rtol=1e-7, atol=0)  # at a limb half of the digits are left
    wide, found = Lens.of(plan.scene.camera), []
    for lens in (wide, replace(wide, blur_scale=0.5 * wide.blur_scale, radius=0.5 * wide.radius), wide):
        size, statistics = source_bytes(area, plan.tilt, True), copied(session, EMPTY_STATISTICS)
        out = buffers(session, source=size)
        given["lens"] = lens_struct(lens, "double")
        run(session, target, "aim", grid, LOCAL, **given, **planes, **out, statistics=statistics)
        label = written(session, planes["label"], shape, np.uint8)
        np.testing.assert_array_equal(label & 127, labels)
        source = written(session, out["source"], (size,), np.uint8)
        found.append((label, source, download(session, statistics, (4,), np.int32)))
    for first, again in zip(found[0], found[2], strict=True):
        np.testing.assert_array_equal(first, again)
    assert (found[0][1] != found[1][1]).any()
    assert (found[0][2] != found[1][2]).any()
    np.testing.assert_array_equal(found[0][0], exact.label)


def test_pinhole(session: Session, plan: Plan) -> None:
    """Against the twin: each object has light of its own in each channel."""
    shape = (plan.height, plan.width)
    everything = twin.everything(plan.scene)
    given = pixel_arguments(session, plan, everything)
    area = plan.width * plan.height
    out = buffers(session, value=4 * plan.channels * area, coc=8 * area, valid=area)
    statistics = copied(session, EMPTY_STATISTICS)
    target = built(session, plan, "double")
    run(session, target, "pinhole", shape[::-1], LOCAL, statistics=statistics, **given, **out)
    expected = twin.trace(view(plan, TIME), everything, GUARD)
    seen = expected.label > 0
    np.testing.assert_array_equal(written(session, out["valid"], shape, np.uint8), seen)
    np.testing.assert_allclose(written(session, out["coc"], shape, np.float64), expected.radius, rtol=1e-11, atol=1e-11)
    value = written(session, out["value"], (plan.channels, *shape), np.float32)
    limit = 35 * traces.SINGLE  # as in test_trace.py
    np.testing.assert_allclose(value, np.moveaxis(expected.radiance, -1, 0), rtol=0, atol=limit)
    noted = download(session, statistics, (4,), np.int32)[:2].view(np.float32)
    radii = np.abs(expected.radius[seen])
    np.testing.assert_allclose(noted, [radii.max(), radii.min()], rtol=1e-6)


def truth(session: Session, plan: Plan, strip: Strip, local: tuple[int, int]) -> dict[str, Array]:
    forms, shape = traces.truth_forms(plan, traces.MONO), (strip.rows, plan.columns)
    pixels = strip.rows * plan.columns
    out = buffers(session, **{name: pixels * n * dtype().itemsize for name, (dtype, n) in forms.items()})
    given = traces.truth_arguments(session, plan, 1, strip) | traces.truth_outputs(out)
    run(session, built(session, plan, "double"), "ground_truth", shape[::-1], local, **given)
    return {name: written(session, out[name], (*shape, n), dtype) for name, (dtype, n) in forms.items()}


def test_ground_truth_of_a_strip_is_a_part_of_the_whole(session: Session, plan: Plan) -> None:
    strip = Strip(top=11, rows=18, above=7, below=9)
    whole = truth(session, plan, Strip(0, plan.rows, GUARD, GUARD), (64, 1))
    part = truth(session, plan, strip, LOCAL)
    for name, expected in whole.items():
        assert len(np.unique(expected)) > 1, name
        np.testing.assert_array_equal(part[name], expected[strip.inside], name)
    textures = tuple(texture.astype(float) for texture in traces.random_textures(plan.scene, plan.channels))
    exact = ground_truth(plan.scene, textures, 1, plan.eye)
    turned = exact.object_id == 1
    assert 0.02 < exact.hidden[turned].mean() < 0.9
    np.testing.assert_array_equal(whole["hidden"][..., 0], exact.hidden)


@pytest.mark.parametrize("shape", [(1, 1), (2, 3), (4, 4), (5, 9), (8, 6)])
def test_a_change_of_label_anywhere(session: Session, shape: tuple[int, int]) -> None:
    """Borders, too: scenes have nothing but a guard band there."""
    target = built(session, planned(*SCENES["sphere moved, 2 x 2"]), "double")
    grid, area = grid_struct(*shape, 0, "double"), shape[0] * shape[1]
    for odd in range(area):
        label = np.full(shape, 3, np.uint8)
        label.flat[odd] = 130
        source, pixels = copied(session, np.full((4, area), -1.0, np.float32)), empty(session, 4 * area)
        statistics = copied(session, EMPTY_STATISTICS)
        given = {"grid": grid, "label": label, "source": source, "pixels": pixels, "statistics": statistics}
        run(session, target, "mark_silhouettes", shape[::-1], (64, 1), capacity=area, **given)
        count = download(session, statistics, EMPTY_STATISTICS.shape, np.int32)[2]
        marked = twin.mark_silhouettes(label)
        assert sorted(download(session, pixels, (area,), np.int32)[:count]) == np.flatnonzero(marked).tolist()


def test_no_pixel_beyond_the_grid(session: Session) -> None:
    """Work-groups reach beyond it, to labels that differ from all of its own."""
    target = built(session, planned(*SCENES["sphere moved, 2 x 2"]), "double")
    rows, columns, spare = 8, 17, 64
    grid, area = grid_struct(rows, columns, 0, "double"), rows * columns
    label = np.full(area + spare, 3, np.uint8)
    label[area:] = 130
    statistics = copied(session, EMPTY_STATISTICS)
    pixels = copied(session, np.full(area + spare, -1, np.int32))
    source = copied(session, np.full(4 * (area + spare), -1.0, np.float32))
    given = {"grid": grid, "label": label, "source": source, "pixels": pixels, "statistics": statistics}
    run(session, target, "mark_silhouettes", (columns, rows), (7, 5), capacity=area + spare, **given)
    assert download(session, statistics, EMPTY_STATISTICS.shape, np.int32).tolist() == EMPTY_STATISTICS.tolist()
    assert (download(session, pixels, (area + spare,), np.int32) == -1).all()


def test_what_was_behind_the_lens_is_dark(session: Session) -> None:
    """A tube around the axis goes by: what is seen of its near part comes from behind the lens."""
    tube = Cylinder(center=(0.0, 0.0, 200.0), radius=24.0, axis=(0.0, 0.0, 1.0))
    plan = planned(scene(tube, ObjectMotion(velocity=(0.0, 0.0, 600.0)), psf=Psf(silhouette_samples=2)), 3)
    textures = tuple(texture.astype(float) for texture in traces.random_textures(plan.scene, plan.channels))
    exact = ground_truth(plan.scene, textures, 1)
    dark = exact.sharp[..., 0] == 0
    assert 0.1 < dark[exact.mask].mean() < 0.9
    traces.assert_truth(session, plan, ("sharp",), 1)


def test_what_is_behind_the_lens_in_the_next_frame_is_not_visible(session: Session) -> None:
    motion = ObjectMotion(velocity=(0.0, 0.0, -1000.0))
    plan = planned(scene(Sphere(center=(0.0, 0.0, 580.0), radius=200.0), motion, psf=Psf(silhouette_samples=2)), 3)
    found = traces.truth_on_device(session, plan, ("flow", "flow_occluded", "flow_backward"), 0)
    assert found["flow_occluded"].all()
    assert not found["flow"].any()
    assert found["flow_backward"].any()
    traces.assert_truth(session, plan, ("flow", "flow_occluded", "flow_backward"), 0)


def test_subpixel_sources_of_all_layers_are_marked(session: Session) -> None:
    """Sub-pixel sources are marked if something hides all of them or a part, their edge being as soft as the source is
    wide, and at limbs."""
    plan = planned(scene(traces.ROW, psf=Psf(silhouette_samples=2)), 1)
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
        marks = np.where(blocked, traces.PARTLY_OCCLUDED, traces.WHOLE)
        marks[exact.hit & exact.limb] = np.where(blocked, traces.PARTLY_LIMB, traces.LIMB)[exact.hit & exact.limb]
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
