"""trace.cl against its twin: sources, silhouettes, sub-pixel sources and ground truth, for every shape and feature."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pyopencl as cl
import pytest
from numpy.typing import NDArray

from clsco.device import Program, Session
from clsco.layout import Real, camera_struct, flat, pose_struct, psf_struct, structs, surface_struct
from clsco.motion import middle_time, pose_at
from clsco.plan import Plan, make_plan
from clsco.program import build, download, empty, kernel, launch, upload
from clsco.psf import psf_table
from clsco.reference import trace as twin
from clsco.reference.geometry import table_coordinate, tilt_slope
from clsco.render import EMPTY_STATISTICS, TRUTH_BUFFERS
from clsco.scene import (
    Camera,
    Cone,
    Cylinder,
    Ellipsoid,
    Motion,
    ObjectMotion,
    Plane,
    Psf,
    Quadric,
    Scene,
    Sequence,
    Sphere,
)
from clsco.surfaces import PlacedSurface, place

Array = NDArray[Any]
SINGLE = 2.0**-24  # largest relative error of a rounding to float32
BOX = ((-26.0, 20.0), (-15.0, 22.0), (-40.0, 40.0))
MOTION = ObjectMotion(velocity=(3.0, -2.0, 6.0), angular_velocity=(20.0, 15.0, -40.0))
STILL = ObjectMotion()
GUARD = 4


def scene(item: Any, moving: ObjectMotion = MOTION, **sections: Any) -> Scene:
    """A scene of some 40 x 50 px that sees the whole object: pixels eight times as wide as usual."""
    size = sections.pop("size", (50, 40))
    camera = Camera(resolution=size, pixel_pitch=0.12, aperture_diameter=25.0)
    sections.setdefault("sequence", Sequence(frames=2, interval=0.4, shutter=0.3))
    return Scene(camera=camera, objects=(item.model_copy(update={"motion": moving}),), **sections)


BALL = Sphere(center=(3.0, -2.0, 280.0))
BOWL = Quadric(coefficients=(1.0, 0.8, 0.0, 0, 0, 0, 0, 0, -40.0, 0), center=(0.0, 0.0, 250.0))
# Every feature on and off: name, scene, channels.
SCENES: dict[str, tuple[Scene, int]] = {
    "plane at rest": (scene(Plane(slope_x=0.5, slope_y=-0.2), STILL), 3),
    "plane moved, no tilt": (scene(Plane(slope_x=0.5), psf=Psf(tilt=False)), 1),
    "card, nearest": (scene(Plane(bounds=BOX), motion=Motion(texture_filter="nearest")), 1),
    "sphere at rest": (scene(BALL, STILL), 1),
    "sphere moved, 2 x 2": (scene(BALL, psf=Psf(silhouette_samples=2)), 3),
    "cap, 3 x 3, sampled": (
        scene(BALL.model_copy(update={"bounds": BOX}), psf=Psf(silhouette_samples=3, edge="sampled")),
        1,
    ),
    "cylinder, bilinear": (
        scene(Cylinder(axis=(0.3, 1.0, 0.2)), motion=Motion(texture_filter="bilinear")),
        1,
    ),
    "cone, axis": (scene(Cone(half_angle=40.0), motion=Motion(rotation="axis")), 1),
    "ellipsoid, gaussian": (
        scene(Ellipsoid(semi_axes=(30.0, 20.0, 50.0)), psf=Psf(model="gaussian", silhouette_samples=1)),
        1,
    ),
    "paraboloid": (scene(BOWL), 1),
    "bounded paraboloid": (scene(BOWL.model_copy(update={"bounds": BOX})), 3),
    "one column": (scene(BALL, size=(1, 40)), 1),
    "one pixel": (scene(BALL, size=(1, 1)), 1),
    "nothing in sight": (scene(Sphere(center=(900.0, 0.0, 280.0)), STILL), 1),
}


@dataclass
class Traced:
    """What trace.cl wrote: arrays as they lie on the device."""

    plan: Plan
    label: Array
    source: Array
    value: Array
    statistics: Array
    pixels: Array = field(default_factory=lambda: np.zeros(0, np.int32))
    sub_source: Array = field(default_factory=lambda: np.zeros(0, np.float32))
    sub_value: Array = field(default_factory=lambda: np.zeros(0, np.float32))

    @property
    def slot(self) -> Array:
        return self.source[..., 3].view(np.int32)


def random_texture(wanted: Scene, channels: int) -> Array:
    assert wanted.camera.resolution is not None
    columns, rows = wanted.camera.resolution
    return np.random.default_rng(3).random((rows, columns, channels), np.float32)


def placed(wanted: Scene, time: float) -> PlacedSurface:
    item = wanted.objects[0]
    return place(item, pose_at(item.motion, time, wanted.motion.rotation))


def planned(wanted: Scene, channels: int, samples: int | None = None) -> Plan:
    """Plan of a scene, with `samples` sub-pixel sources or as many as the scene has silhouettes for."""
    plan = make_plan(wanted, channels, ())
    keep = {"guard_px": GUARD} | ({} if samples is None else {"silhouettes": samples})
    return Plan(**{**vars(plan), **keep})


def built(session: Session, plan: Plan, real: Real, truth: tuple[str, ...] = tuple(TRUTH_BUFFERS)) -> Program:
    """All kernels in one program, so that few have to be compiled."""
    features = plan.features() | {"TRUTH": int(bool(truth))}
    features |= {f"TRUTH_{name.upper()}": int(name in truth) for name in TRUTH_BUFFERS}
    return build(session, ["trace.cl"], features, structs(real), real)


def traced(
    session: Session, plan: Plan, time: float, weight: float = 1.0, real: Real = "double",
    local: tuple[int, int] = (64, 1), capacity: int | None = None,
) -> Traced:  # fmt: skip
    """All passes of one moment."""
    wanted, each, area = plan.scene, plan.silhouettes**2, plan.width * plan.height
    capacity = area if capacity is None else capacity
    tables = [
        psf_table(wanted.psf, plan.smallest_blur, plan.largest_blur, n) for n in (0, *[plan.silhouettes] * (each > 0))
    ]
    psf = psf_struct(wanted.psf, tables[0], tables[1] if each else None, real)
    camera = camera_struct(wanted.camera, plan.guard_px, real)
    surface = surface_struct(wanted.objects[0], placed(wanted, time), real)
    texture = upload(session, flat(random_texture(wanted, plan.channels), np.float32))
    sizes = (
        16 * area,
        4 * plan.channels * area,
        area,
        4 * capacity,
        16 * capacity * each,
        4 * capacity * each * plan.channels,
    )
    source, value, label, pixels, sub_source, sub_value = (empty(session, size) for size in sizes)
    statistics = empty(session, EMPTY_STATISTICS.nbytes)
    cl.enqueue_copy(session.queue, statistics, EMPTY_STATISTICS)
    program, grid = built(session, plan, real), (plan.width, plan.height)
    head = (camera, surface, psf, np.float32(weight), texture)
    launch(session, kernel(program, "trace"), grid, local, *head, source, value, label, statistics)
    if each:
        marks = (camera, label, np.int32(capacity), source, pixels, statistics)
        launch(session, kernel(program, "mark_silhouettes"), grid, local, *marks)
        out = (pixels, np.int32(capacity), sub_source, sub_value, statistics)
        launch(session, kernel(program, "trace_subpixels"), (capacity * each,), (local[0] * local[1],), *head, *out)
    shape = (plan.height, plan.width)
    found = Traced(
        plan,
        download(session, label, shape, np.uint8) if each else np.zeros(shape, np.uint8),
        download(session, source, (*shape, 4), np.float32),
        download(session, value, (plan.channels, *shape), np.float32),
        download(session, statistics, (4,), np.int32),
    )
    if each:
        found.pixels = download(session, pixels, (capacity,), np.int32)
        found.sub_source = download(session, sub_source, (capacity, plan.silhouettes, plan.silhouettes, 4), np.float32)
        found.sub_value = download(
            session, sub_value, (plan.channels, capacity, plan.silhouettes, plan.silhouettes), np.float32
        )
    return found


def assert_records(plan: Plan, found: Array, radius: Array, gradient: Array, there: Array, subpixel: bool) -> None:
    """Records (..., 4) against the twin's radius and gradient, where `there`; -1 elsewhere."""
    psf = plan.scene.psf
    table = psf_table(psf, plan.smallest_blur, plan.largest_blur, plan.silhouettes if subpixel else 0)
    assert (found[~there][..., :3] == [-1.0, 0.0, 0.0]).all()
    if not there.any():
        return
    expected = table_coordinate(psf, radius, subpixel, table.first, len(table.intervals))[there]
    # At a limb the root of a vanishing discriminant amplifies rounding of some 1e-15 to the root of that.
    np.testing.assert_allclose(found[there][:, 0], expected, rtol=2.0**-22, atol=1e-5)
    assert (np.floor(found[there][:, 0]) == np.floor(expected)).mean() > 0.999
    slope = tilt_slope(gradient, radius)[there]
    if not plan.tilt:
        assert not found[there][:, 1:3].any()
        return
    assert slope.any() or plan.scene.objects[0].shape == "plane"
    # Two conversions, a quotient and a product in float32; near a limb slopes and their errors run away together.
    steep = 1e-12 * slope.astype(float) ** 2
    assert (
        np.abs(found[there][:, 1:3] - slope) <= 4 * SINGLE * np.abs(slope) + steep.max(axis=1)[:, None] + 1e-12
    ).all()


@pytest.mark.parametrize("time", [0.0, 0.55])
@pytest.mark.parametrize("name", SCENES)
def test_sources(session: Session, name: str, time: float) -> None:
    wanted, channels = SCENES[name]
    plan = planned(wanted, channels)
    found = traced(session, plan, time, 0.3)
    texture = random_texture(wanted, channels).astype(float)
    expected = twin.trace(wanted, placed(wanted, time), texture, GUARD, plan.moves)
    there = expected.label > 0
    if name not in ("nothing in sight", "one pixel"):
        assert there.mean() > 0.2
    if plan.silhouettes and plan.features()["QUADRATIC"]:  # a plane has but one root
        assert (found.label == expected.label).all()
    elif plan.silhouettes:
        assert ((found.label > 0) == there).all()
    assert ((found.source[..., 0] >= 0) == there).all()
    assert_records(plan, found.source, expected.radius, expected.gradient, there, False)
    # Filters work in float32, on positions that float32 would not hold: see test_geometry.py for the figure.
    limit = 0.3 * (34 * SINGLE if plan.moves else SINGLE) + SINGLE
    np.testing.assert_allclose(found.value, 0.3 * np.moveaxis(expected.radiance, -1, 0), rtol=0, atol=limit)
    assert not found.value[:, ~there].any()
    if not plan.silhouettes:
        assert (found.slot == -1).all()


@pytest.mark.parametrize("name", [name for name, (wanted, n) in SCENES.items() if planned(wanted, n).silhouettes])
def test_silhouettes_get_slots(session: Session, name: str) -> None:
    wanted, channels = SCENES[name]
    found = traced(session, planned(wanted, channels), 0.55)
    marked = twin.mark_silhouettes(found.label)
    count = int(marked.sum())
    assert (found.slot >= 0).tolist() == marked.tolist()
    assert sorted(found.slot[marked].tolist()) == list(range(count))
    where = found.pixels[found.slot[marked]]
    assert where.tolist() == np.flatnonzero(marked).tolist()
    assert found.statistics[2:].tolist() == [count, count]
    if name == "sphere moved, 2 x 2":
        assert 100 < count < marked.size / 2


def test_more_silhouettes_than_slots(session: Session) -> None:
    """The rest keep their own source, and their number is told."""
    plan = planned(*SCENES["sphere moved, 2 x 2"])
    marked = int(twin.mark_silhouettes(traced(session, plan, 0.55).label).sum())
    found = traced(session, plan, 0.55, capacity=50)
    assert marked > 50
    assert found.statistics[2:].tolist() == [marked, marked]
    assert sorted(found.slot[found.slot >= 0].tolist()) == list(range(50))
    assert (found.source[found.slot >= 0][:, 0] >= -1).all()


@pytest.mark.parametrize(
    ("name", "samples"),
    [
        ("sphere moved, 2 x 2", 2),
        ("sphere moved, 2 x 2", 4),
        ("cap, 3 x 3, sampled", 3),
        ("cylinder, bilinear", 2),
        ("sphere at rest", 3),
    ],
)
def test_subpixel_sources(session: Session, name: str, samples: int) -> None:
    wanted, channels = SCENES[name]
    wanted = wanted.model_copy(update={"psf": wanted.psf.model_copy(update={"silhouette_samples": samples})})
    plan = planned(wanted, channels, samples)
    found = traced(session, plan, 0.55, 0.3)
    marked = twin.mark_silhouettes(found.label)
    texture = random_texture(wanted, channels).astype(float)
    expected = twin.trace_subpixels(wanted, placed(wanted, 0.55), texture, GUARD, plan.moves, marked)
    slots = found.slot[expected.row, expected.column]
    records, hit = found.sub_source[slots], expected.hit
    assert 0.1 < hit.mean() < 0.99
    assert ((records[..., 0] >= 0) == hit).all()
    assert_records(plan, records, expected.radius, expected.gradient, hit, True)
    value = np.moveaxis(found.sub_value[:, slots], 0, -1)[hit]
    # The texture is sampled where each sub-pixel's point was at rest.
    limit = 0.3 / samples**2 * 40 * SINGLE
    np.testing.assert_allclose(value, 0.3 / samples**2 * expected.radiance[hit], rtol=0, atol=limit)


def test_range_of_radii_is_noted(session: Session) -> None:
    plan = planned(*SCENES["sphere moved, 2 x 2"])
    surface, texture = placed(plan.scene, 0.55), random_texture(plan.scene, 3).astype(float)
    sources = twin.trace(plan.scene, surface, texture, GUARD, True)
    sub = twin.trace_subpixels(plan.scene, surface, texture, GUARD, True, twin.mark_silhouettes(sources.label))
    radii = np.abs(np.concatenate([sources.radius[sources.label > 0], sub.radius[sub.hit]]))
    noted = traced(session, plan, 0.55).statistics[:2].view(np.float32)
    # Rounded to float32; the largest is at the limb, good to the root of 1e-15 of some 60 px.
    np.testing.assert_allclose(noted, [radii.max(), radii.min()], rtol=1e-6)
    nothing = traced(session, planned(*SCENES["nothing in sight"]), 0.0).statistics
    assert nothing.tolist() == EMPTY_STATISTICS.tolist()


@pytest.mark.parametrize("name", ["sphere moved, 2 x 2", "bounded paraboloid", "card, nearest"])
def test_same_bits_again_and_in_other_groups(session: Session, name: str) -> None:
    plan = planned(*SCENES[name])

    def contents(found: Traced) -> list[bytes]:
        """Everything, slots in the order of their pixels."""
        order = found.slot[found.slot >= 0]
        parts = [found.label, found.source[..., :3], found.value, found.statistics, found.slot >= 0]
        if order.size:
            hit = found.sub_source[order][..., 0] >= 0
            parts += [found.sub_source[order], np.where(hit, found.sub_value[:, order], 0), found.pixels[order]]
        return [part.tobytes() for part in parts]

    first = contents(traced(session, plan, 0.55))
    assert contents(traced(session, plan, 0.55)) == first
    for local in ((7, 3), (16, 4)):
        assert contents(traced(session, plan, 0.55, local=local)) == first, local


@pytest.mark.parametrize("name", ["sphere moved, 2 x 2", "plane moved, no tilt", "cone, axis"])
def test_single_precision(session: Session, name: str) -> None:
    plan = planned(*SCENES[name])
    double, single = (traced(session, plan, 0.55, real=real) for real in ("double", "float"))
    both = (double.source[..., 0] >= 0) & (single.source[..., 0] >= 0)
    assert ((double.source[..., 0] >= 0) == (single.source[..., 0] >= 0)).mean() > 0.998  # a limb by rounding
    # w is good to 1e-6 where a ray does not graze; u is some 50 times as much of ln R, and R a difference of w.
    difference = np.abs(double.source[..., 0] - single.source[..., 0])[both]
    assert np.median(difference) < 1e-3
    assert np.quantile(difference, 0.9) < 1e-2
    # A position of 50 px in float32, turned and projected by some 10 roundings, times a slope of at most 2 per px.
    value = np.abs(double.value - single.value)[:, both]
    assert np.quantile(value, 0.9) < 1e-3


# Ground truth


def truth_on_device(session: Session, plan: Plan, names: tuple[str, ...], frame: int) -> dict[str, Array]:
    """Outputs of ground_truth, built for these outputs only."""
    wanted, item = plan.scene, plan.scene.objects[0]
    now, then = (middle_time(wanted.sequence, k) for k in (frame, frame + 1))
    camera, shape = camera_struct(wanted.camera, plan.guard_px, "double"), (plan.rows, plan.columns)
    surface, still = (surface_struct(item, placed(wanted, t), "double") for t in (now, 0.0))
    later = pose_struct(pose_at(item.motion, then, wanted.motion.rotation), "double")
    texture = upload(session, flat(random_texture(wanted, plan.channels), np.float32))
    forms: dict[str, tuple[Any, int]] = {"mask": (np.uint8, 1)}
    forms |= {name: (form[0], form[1] or plan.channels) for name, form in TRUTH_BUFFERS.items() if name in names}
    buffers = {
        n: empty(session, plan.rows * plan.columns * size * dtype().itemsize) for n, (dtype, size) in forms.items()
    }
    head = (camera, surface, still, later, texture)
    program = built(session, plan, "double", names)
    launch(session, kernel(program, "ground_truth"), shape[::-1], (64, 1), *head, *buffers.values())
    return {name: download(session, buffers[name], (*shape, size), dtype) for name, (dtype, size) in forms.items()}


@pytest.mark.parametrize("frame", [0, 1])
@pytest.mark.parametrize("name", SCENES)
def test_ground_truth(session: Session, name: str, frame: int) -> None:
    wanted, channels = SCENES[name]
    plan = planned(wanted, channels)
    found = truth_on_device(session, plan, tuple(TRUTH_BUFFERS), frame)
    expected = twin.ground_truth(wanted, random_texture(wanted, channels).astype(float), frame)
    assert (found["mask"][..., 0] == expected.mask).all()
    seen = expected.mask
    for output in ("depth", "coc", "normal", "flow", "hidden", "sharp"):
        exact = np.asarray(getattr(expected, output), dtype=float)
        exact = exact[..., None] if exact.ndim == 2 else exact
        assert (found[output][~seen] == (np.inf if output == "depth" else 0)).all(), output
        if output == "hidden":
            assert (found[output][seen] == exact[seen]).all()
            continue
        # Rounded to float32 at the end, texture filters in float32; near a limb half of float64's digits are left.
        scale = np.abs(exact[seen]).max(initial=1.0)
        limit = 40 * SINGLE if output == "sharp" else SINGLE * np.abs(exact[seen]) + 2e-7 * scale
        assert (np.abs(found[output][seen] - exact[seen]) <= limit).all(), output


def test_hidden_points_are_there_and_seen_ones_too(session: Session) -> None:
    """The scenes above would not test `hidden` if nothing were."""
    hidden = [
        truth_on_device(session, planned(*SCENES[name]), ("hidden",), 1)["hidden"].mean()
        for name in ("sphere moved, 2 x 2", "cylinder, bilinear", "plane at rest")
    ]
    assert 0.005 < hidden[0] < 0.5
    assert 0.005 < hidden[1] < 0.5
    assert hidden[2] == 0.0


@pytest.mark.parametrize("output", TRUTH_BUFFERS)
def test_each_output_alone_is_the_same(session: Session, output: str) -> None:
    plan = planned(*SCENES["sphere moved, 2 x 2"])
    alone = truth_on_device(session, plan, (output,), 1)
    everything = truth_on_device(session, plan, tuple(TRUTH_BUFFERS), 1)
    assert set(alone) == {"mask", output}
    for name, array in alone.items():
        assert (array == everything[name]).all()
