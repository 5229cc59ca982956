"""Kernels of trace.cl with more work-items than pixels, and of strips: what they write, and that it is all."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Literal

import numpy as np
import pyopencl as cl
import pytest
from numpy.typing import NDArray

from clsco.frame.strips import Strip
from clsco.opencl.buffers import copied, download
from clsco.opencl.program import build
from clsco.opencl.session import Program, Session
from clsco.optics.lens import Lens
from clsco.optics.psf_tables import psf_table
from clsco.optics.visibility import OcclusionGroup
from clsco.passes.pack import camera_grid, group_struct, lens_struct, psf_struct
from clsco.passes.trace import EMPTY_STATISTICS, TRACE_FILES
from clsco.plan.buffers import source_bytes
from clsco.plan.plan import Plan
from clsco.records import structs
from clsco.reference.trace import trace as twin
from clsco.reference.trace.truth import ground_truth
from clsco.scene.model import Psf
from tests.kernels.launches import run
from tests.kernels.test_trace import (
    CARD,
    GUARD,
    MONO,
    MOTION,
    ROW,
    SINGLE,
    on_device,
    planned,
    random_textures,
    scene,
    stack,
    truth_arguments,
    truth_forms,
    truth_outputs,
    view,
)

Array = NDArray[Any]
LOCAL = (7, 5)  # divide neither the grid nor its part
SPARE, UNTOUCHED = 4096, 0xA5  # bytes beyond what a kernel may write, and what is in them
TIME = 0.55


@pytest.fixture
def plan() -> Plan:
    """A card that sinks into a cylinder, both moved, in color."""
    cylinder = ROW[1].model_copy(update={"motion": MOTION})
    return planned(scene((CARD, cylinder), psf=Psf(silhouette_samples=2, edge="sampled", occlusion="none")), 3)


def everything_built(session: Session, plan: Plan) -> Program:
    return build(session, TRACE_FILES, plan.features() | {"GATHER": 0}, structs("double"), "double")


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
        "surfaces": on_device(session, plan, TIME, "double"),
        "group": group_struct(group, len(wanted.objects)),
        "psf": psf_struct(plan.psf, tables[0], tables[1], "double"),
        "texture": stack(session, plan),
    }


@pytest.mark.parametrize("occlusion", ["none", "visibility"])
def test_what_is_cast_once_is_aimed_for_one_lens_after_the_other(
    session: Session, plan: Plan, occlusion: Literal["none", "visibility"]
) -> None:
    plan = planned(plan.scene.model_copy(update={"psf": plan.scene.psf.model_copy(update={"occlusion": occlusion})}), 3)
    program, grid = everything_built(session, plan), (plan.width, plan.height)
    area, group = plan.width * plan.height, plan.groups[-1]
    hits = {"value": 4 * plan.channels * area, "depth": 8 * area, "label": area}
    given, planes = pixel_arguments(session, plan, group), buffers(session, **hits)
    run(session, program, "cast", grid, LOCAL, **given, **planes)
    shape, exact = (plan.height, plan.width), twin.trace(view(plan, TIME), group, GUARD)
    labels = written(session, planes["label"], shape, np.uint8)
    np.testing.assert_array_equal(labels, exact.label & 127)
    depth = written(session, planes["depth"], shape, np.float64)
    np.testing.assert_allclose(depth, exact.inverse_depth, rtol=1e-7, atol=0)  # at a limb half of the digits are left
    wide, aimed = Lens.of(plan.scene.camera), {name: planes[name] for name in ("depth", "label")}
    found = []
    for lens in (wide, replace(wide, blur_scale=0.5 * wide.blur_scale, radius=0.5 * wide.radius), wide):
        size, statistics = source_bytes(area, plan.tilt, True), copied(session, EMPTY_STATISTICS)
        out = buffers(session, source=size)
        given["lens"] = lens_struct(lens, "double")
        run(session, program, "aim", grid, LOCAL, **given, **aimed, **out, statistics=statistics)
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
    program = everything_built(session, plan)
    run(session, program, "pinhole", shape[::-1], LOCAL, statistics=statistics, **given, **out)
    expected = twin.trace(view(plan, TIME), everything, GUARD)
    seen = expected.label > 0
    np.testing.assert_array_equal(written(session, out["valid"], shape, np.uint8), seen)
    np.testing.assert_allclose(written(session, out["coc"], shape, np.float64), expected.radius, rtol=1e-11, atol=1e-11)
    value = written(session, out["value"], (plan.channels, *shape), np.float32)
    limit = 35 * SINGLE  # as in test_trace.py
    np.testing.assert_allclose(value, np.moveaxis(expected.radiance, -1, 0), rtol=0, atol=limit)
    noted = download(session, statistics, (4,), np.int32)[:2].view(np.float32)
    radii = np.abs(expected.radius[seen])
    np.testing.assert_allclose(noted, [radii.max(), radii.min()], rtol=1e-6)


def truth(session: Session, plan: Plan, strip: Strip, local: tuple[int, int]) -> dict[str, Array]:
    forms, shape = truth_forms(plan, MONO), (strip.rows, plan.columns)
    pixels = strip.rows * plan.columns
    out = buffers(session, **{name: pixels * n * dtype().itemsize for name, (dtype, n) in forms.items()})
    given = truth_arguments(session, plan, 1, strip) | truth_outputs(out)
    run(session, everything_built(session, plan), "ground_truth", shape[::-1], local, **given)
    return {name: written(session, out[name], (*shape, n), dtype) for name, (dtype, n) in forms.items()}


def test_ground_truth_of_a_strip_is_a_part_of_the_whole(session: Session, plan: Plan) -> None:
    strip = Strip(top=11, rows=18, above=7, below=9)
    whole, part = truth(session, plan, Strip(0, plan.rows, GUARD, GUARD), (64, 1)), truth(session, plan, strip, LOCAL)
    for name, expected in whole.items():
        assert len(np.unique(expected)) > 1, name
        np.testing.assert_array_equal(part[name], expected[strip.inside], name)
    textures = tuple(texture.astype(float) for texture in random_textures(plan.scene, plan.channels))
    exact = ground_truth(plan.scene, textures, 1, plan.eye)
    turned = exact.object_id == 1
    assert 0.02 < exact.hidden[turned].mean() < 0.9
    np.testing.assert_array_equal(whole["hidden"][..., 0], exact.hidden)
