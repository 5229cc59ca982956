"""kernels/trace against its twin: sources, silhouettes, sub-pixel sources and ground truth, for all shapes."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pyopencl as cl
import pytest
from numpy.typing import NDArray

from clsco.constants import STATISTIC_SLOTS
from clsco.frame.outputs import OUTPUTS, RAY_OUTPUTS, STEREO_NAMES
from clsco.frame.strips import Strip
from clsco.opencl.buffers import copied, download, empty, upload
from clsco.opencl.program import Target
from clsco.opencl.session import Session
from clsco.optics.exposure import middle_time
from clsco.optics.lens import Lens, ray_step
from clsco.optics.motion import Eye, Pose, poses_at, rest_poses
from clsco.optics.point_spread import point_spread
from clsco.optics.psf_tables import psf_table
from clsco.optics.quadrics import place
from clsco.optics.visibility import OcclusionGroup
from clsco.passes.pack import camera_grid, group_struct, lens_struct, pose_structs, psf_struct, surface_structs
from clsco.passes.trace import EMPTY_STATISTICS, TRACE_FILES
from clsco.plan.buffers import source_bytes
from clsco.plan.methods import Choice
from clsco.plan.plan import Plan
from clsco.records import Real, flat
from clsco.reference.common.geometry import pixel_tilt, tilt_slope
from clsco.reference.trace import trace as twin
from clsco.reference.trace.truth import ground_truth
from clsco.reference.trace.view import View
from clsco.scene.model import (
    Cone,
    Cylinder,
    Ellipsoid,
    Motion,
    Object,
    ObjectMotion,
    Plane,
    Psf,
    Quadric,
    Scene,
    Sequence,
    Sphere,
    Stereo,
)
from tests.kernels.conftest import download_sources
from tests.kernels.launches import run
from tests.scenes import plan_scene, scene_of
from tests.slow import mostly_slow
from tests.spreads import table_coordinate

Array = NDArray[Any]
SINGLE = 2.0**-24  # largest relative error of a rounding to float32
BOX = ((-26.0, 20.0), (-15.0, 22.0), (-40.0, 40.0))
MOTION = ObjectMotion(velocity=(3.0, -2.0, 6.0), angular_velocity=(20.0, 15.0, -40.0))
STILL = ObjectMotion()
LENS = {"pixel_pitch": 0.12, "aperture_diameter": 25.0}
SEQUENCE = Sequence(frames=2, interval=0.4, shutter=0.3)
GUARD = 4
MONO = tuple(name for name in RAY_OUTPUTS if name not in STEREO_NAMES)
WHOLE, PARTLY_OCCLUDED, LIMB, PARTLY_LIMB = -1, -2, -6, -7  # in a source's last field, where it holds no slot


def scene(item: Any, moving: ObjectMotion = MOTION, **sections: Any) -> Scene:
    """A scene of some 40 x 50 px that sees the whole object: pixels eight times as wide as usual."""
    items = item if isinstance(item, tuple) else (item.model_copy(update={"motion": moving}),)
    shown: dict[str, Any] = {"size": (50, 40), "camera": LENS, "sequence": SEQUENCE} | sections
    return scene_of(*items, **shown)


BALL = Sphere(center=(3.0, -2.0, 280.0))
BOWL = Quadric(coefficients=(1.0, 0.8, 0.0, 0, 0, 0, 0, 0, -40.0, 0), center=(0.0, 0.0, 250.0))
WALL = Plane(distance=380.0, slope_x=0.2)
# A ball before a tilted cylinder before a wall; a card that sinks into it; a ball that moves inside of a tube.
ROW = (
    Sphere(center=(-16.0, 4.0, 170.0), radius=16.0, motion=MOTION),
    Cylinder(center=(8.0, 0.0, 260.0), radius=14.0, axis=(0.3, 1.0, 0.2)),
    WALL,
)

CARD = Plane(distance=240.0, slope_x=-0.8, bounds=BOX, motion=MOTION)
TUBE = Cylinder(center=(2.0, 1.0, 230.0), radius=24.0, axis=(0.2, 0.1, 1.0), bounds=((-60, 60), (-60, 60), (-50, 50)))


def bounded(wanted: Scene) -> bool:
    """True if a curved surface is cut, so that the lens sees its inside past its edge."""
    return any(item.bounds is not None and item.shape != "plane" for item in wanted.objects)


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
    "cylinder, bilinear": (scene(Cylinder(axis=(0.3, 1.0, 0.2)), motion=Motion(texture_filter="bilinear")), 1),
    "cone, axis": (scene(Cone(half_angle=40.0), motion=Motion(rotation="axis")), 1),
    "ellipsoid, gaussian": (
        scene(Ellipsoid(semi_axes=(30.0, 20.0, 50.0)), psf=Psf(model="gaussian", silhouette_samples=1)),
        1,
    ),
    "paraboloid": (scene(BOWL), 1),
    "bounded paraboloid": (scene(BOWL.model_copy(update={"bounds": BOX})), 3),
    "one column": (scene(BALL, size=(1, 40)), 1),
    "one pixel": (scene(Cone(half_angle=40.0), motion=Motion(rotation="axis"), size=(1, 1)), 1),
    "nothing in visibility": (scene(Sphere(center=(900.0, 0.0, 280.0)), psf=Psf(silhouette_samples=2)), 3),
    "three in a row": (scene(ROW, psf=Psf(silhouette_samples=2)), 1),
    "card in a cylinder": (scene((CARD, *ROW[1:]), psf=Psf(silhouette_samples=1)), 3),
    "ball in a tube": (
        scene((BALL.model_copy(update={"motion": MOTION}), TUBE), psf=Psf(model="gaussian", silhouette_samples=3)),
        1,
    ),
}


# What the tests of all scenes look at; of the others in `make test` whole frames only.
SOME = ["plane at rest", "card, nearest", "sphere moved, 2 x 2", "cone, axis"]
SOME += ["one pixel", "nothing in visibility", "three in a row"]


@dataclass
class Traced:
    """Output of kernels/trace: arrays as they lie on the device."""

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


def random_textures(wanted: Scene, channels: int) -> tuple[Array, ...]:
    """One per object, (rows, columns, channels)."""
    assert wanted.camera.resolution is not None
    columns, rows = wanted.camera.resolution
    return tuple(np.random.default_rng(3).random((len(wanted.objects), rows, columns, channels), np.float32))


def view(plan: Plan, time: float) -> View:
    textures = tuple(texture.astype(float) for texture in random_textures(plan.scene, plan.channels))
    return twin.view_at(plan.scene, textures, time, plan.eye, plan.moves or plan.eye_moved)


def planned(wanted: Scene, channels: int, samples: int | None = None, eye: Eye = "left") -> Plan:
    """Plan of a scene, with `samples` sub-pixel sources or as many as the scene has silhouettes for."""
    plan = plan_scene(wanted, channels, eye=eye)
    chosen = plan.choices if samples is None else replace(plan.choices, silhouettes=Choice(samples))
    return replace(plan, guard_px=GUARD, choices=chosen)


def built(session: Session, plan: Plan, real: Real) -> Target:
    """All kernels in one target, so that few have to be compiled."""
    return Target(session, TRACE_FILES, plan.features() | {"GATHER": 0, "DIVIDED": 0}, real)


def on_device(session: Session, plan: Plan, time: float, real: Real, eye: Eye | None = None) -> cl.Buffer:
    """Surfaces of all objects at a time."""
    return placed_on_device(session, plan, poses_at(plan.scene, time, eye or plan.eye), real)


def placed_on_device(session: Session, plan: Plan, poses: tuple[Pose, ...], real: Real) -> cl.Buffer:
    """Surfaces of all objects in poses."""
    items = plan.scene.objects
    placed = [place(*pair) for pair in zip(items, poses, strict=True)]
    return upload(session, surface_structs(items, placed, real, range(len(items))))


def stack(session: Session, plan: Plan) -> cl.Buffer:
    """Textures of all objects."""
    textures = random_textures(plan.scene, plan.channels)
    return upload(session, np.stack([flat(texture, np.float32) for texture in textures]))


def traced(
    session: Session, plan: Plan, time: float, real: Real = "double",
    local: tuple[int, int] = (64, 1), capacity: int | None = None, group: OcclusionGroup | None = None,
) -> Traced:  # fmt: skip
    """All passes of one moment, of one group; by default the first."""
    wanted, each, area = plan.scene, plan.silhouettes**2, plan.width * plan.height
    capacity = area if capacity is None else capacity
    tables = [
        psf_table(plan.psf, plan.smallest_blur, plan.largest_blur, n) for n in (0, *[plan.silhouettes] * (each > 0))
    ]
    occluded, shape = plan.features()["OCCLUDED"], (plan.height, plan.width)
    marked, slots = bool(each or occluded), (capacity, plan.silhouettes, plan.silhouettes)
    sizes = {
        "source": source_bytes(area, plan.tilt, marked), "value": 4 * plan.channels * area, "label": area,
        "pixels": 4 * capacity, "sub_source": 16 * capacity * each, "sub_value": 4 * capacity * each * plan.channels,
        "sub_label": capacity * each, "sub_depth": 8 * capacity * each, "depth": 8 * area,
    }  # fmt: skip
    given: dict[str, Any] = {name: empty(session, size) for name, size in sizes.items()}
    given |= {
        "grid": camera_grid(wanted.camera, plan.guard_px, real),
        "lens": lens_struct(Lens.of(wanted.camera), real),
        "surfaces": on_device(session, plan, time, real),
        "group": group_struct(group or plan.groups[0], len(wanted.objects)),
        "psf": psf_struct(plan.psf, tables[0], tables[1] if each else None, real),
        "texture": stack(session, plan),
        "capacity": capacity,
        "statistics": copied(session, EMPTY_STATISTICS),
    }
    target, grid = built(session, plan, real), (plan.width, plan.height)
    run(session, target, "cast", grid, local, **given)
    run(session, target, "aim", grid, local, **given)
    if each:
        run(session, target, "mark_silhouettes", grid, local, **given)
        for name in ("label_subpixels", "trace_subpixels"):
            run(session, target, name, (capacity,), (local[0] * local[1],), **given)
    found = Traced(
        plan,
        download(session, given["label"], shape, np.uint8) if each else np.zeros(shape, np.uint8),
        download_sources(session, given["source"], shape, plan.tilt, marked),
        download(session, given["value"], (plan.channels, *shape), np.float32),
        download(session, given["statistics"], EMPTY_STATISTICS.shape, np.int32),
    )
    if each:
        found.pixels = download(session, given["pixels"], (capacity,), np.int32)
        found.sub_source = download(session, given["sub_source"], (*slots, 4), np.float32)
        found.sub_value = download(session, given["sub_value"], (plan.channels, *slots), np.float32)
    return found


def assert_records(plan: Plan, found: Array, radius: Array, gradient: Array, there: Array, subpixel: bool) -> None:
    """Records (..., 4) against the twin's radius and gradient, where `there`; -1 elsewhere."""
    psf, slope = plan.scene.psf, tilt_slope(gradient, radius)[there]
    table = psf_table(point_spread(psf), plan.smallest_blur, plan.largest_blur, plan.silhouettes if subpixel else 0)
    if plan.tilt and not subpixel:
        tilt, radius = pixel_tilt(gradient, radius)
        slope = tilt[there]
    assert (found[~there][..., :3] == [-1.0, 0.0, 0.0]).all()
    if not there.any():
        return
    expected = table_coordinate(point_spread(psf), radius, subpixel, table.low, table.end - table.low)[there]
    # At a limb the root of a vanishing discriminant amplifies rounding of some 1e-15 to the root of that.
    np.testing.assert_allclose(found[there][:, 0], expected, rtol=2.0**-22, atol=1e-5)
    assert (np.floor(found[there][:, 0]) == np.floor(expected)).mean() > 0.999
    if not plan.tilt:
        assert not found[there][:, 1:3].any()
        return
    assert slope.any() or plan.scene.objects[0].shape == "plane"
    # Two conversions, a quotient and a product in float32; near a limb slopes and their errors run away together.
    steep = 1e-12 * slope.astype(float) ** 2
    assert (
        np.abs(found[there][:, 1:3] - slope) <= 4 * SINGLE * np.abs(slope) + steep.max(axis=1)[:, None] + 1e-10
    ).all()


@pytest.mark.parametrize("time", mostly_slow([0.0, 0.55], [0.55]))
@pytest.mark.parametrize("name", mostly_slow(SCENES, SOME))
def test_sources(session: Session, name: str, time: float) -> None:
    wanted, channels = SCENES[name]
    plan = planned(wanted, channels)
    assert (len(plan.groups) > 1) == (len(wanted.objects) > 1 or bounded(wanted))
    shares = []
    for group in plan.groups:
        found, expected = traced(session, plan, time, group=group), twin.trace(view(plan, time), group, GUARD)
        there = expected.label > 0
        shares.append(there.mean())
        if plan.silhouettes and plan.features()["QUADRATIC"]:  # a plane has but one root
            assert (found.label == expected.label).all()
        elif plan.silhouettes:
            assert ((found.label > 0) == there).all()
        assert ((found.source[..., 0] >= 0) == expected.lit).all()
        assert_records(plan, found.source, expected.radius, expected.gradient, expected.lit, False)
        # Filters work in float32, on positions that float32 would not hold: see test_geometry.py for the figure.
        limit = (34 * SINGLE if plan.moves else SINGLE) + SINGLE
        np.testing.assert_allclose(found.value, np.moveaxis(expected.radiance, -1, 0), rtol=0, atol=limit)
        assert not found.value[:, ~there].any()
        blocked = (
            np.zeros_like(there) if expected.visibility is None else expected.visibility.row.reshape(there.shape) >= 0
        )
        own = found.slot < 0
        assert (found.slot[own] == np.where(blocked & expected.lit, PARTLY_OCCLUDED, WHOLE)[own]).all()
        assert own.all() or plan.silhouettes
    if name not in ("nothing in visibility", "one pixel"):
        assert max(shares) > 0.2


def test_scenes_have_sources_of_every_kind() -> None:
    """The test above would show little if nothing, or everything, were hidden."""
    found = np.zeros(4, np.int64)
    for name in ("three in a row", "card in a cylinder", "ball in a tube"):
        plan = planned(*SCENES[name])
        for group in plan.groups:
            one = twin.trace(view(plan, 0.55), group, GUARD)
            if one.visibility is not None:
                blocked = one.visibility.row.reshape(one.lit.shape) >= 0
                kinds = (one.lit & blocked, one.lit & ~blocked, (one.label > 0) & ~one.lit, one.label >= 128)
                found += [int(kind.sum()) for kind in kinds]
    assert found.min() > 100, found


WITH_SILHOUETTES = [name for name, (wanted, n) in SCENES.items() if planned(wanted, n).silhouettes]


@pytest.mark.parametrize("name", mostly_slow(WITH_SILHOUETTES, set(WITH_SILHOUETTES) & set(SOME)))
def test_silhouettes_get_slots(session: Session, name: str) -> None:
    wanted, channels = SCENES[name]
    found = traced(session, planned(wanted, channels), 0.55)
    marked = twin.mark_silhouettes(found.label)
    count = int(marked.sum())
    assert (found.slot >= 0).tolist() == marked.tolist()
    assert sorted(found.slot[marked].tolist()) == list(range(count))
    where = found.pixels[found.slot[marked]]
    assert where.tolist() == np.flatnonzero(marked).tolist()
    assert found.statistics[STATISTIC_SLOTS] == count
    if name == "sphere moved, 2 x 2":
        assert 100 < count < marked.size / 2


def test_more_silhouettes_than_slots(session: Session) -> None:
    """The rest keep their own source, and their number is reported."""
    plan = planned(*SCENES["sphere moved, 2 x 2"])
    marked = int(twin.mark_silhouettes(traced(session, plan, 0.55).label).sum())
    found = traced(session, plan, 0.55, capacity=50)
    assert marked > 50
    assert found.statistics[STATISTIC_SLOTS] == marked
    assert sorted(found.slot[found.slot >= 0].tolist()) == list(range(50))
    assert (found.source[found.slot >= 0][:, 0] >= -1).all()


SUBPIXELS = [("sphere moved, 2 x 2", 2), ("cap, 3 x 3, sampled", 3), ("ball in a tube", 3), ("cylinder, bilinear", 2)]
SUBPIXELS += [("sphere moved, 2 x 2", 4), ("sphere at rest", 3), ("three in a row", 2)]


@pytest.mark.parametrize(("name", "samples"), mostly_slow(SUBPIXELS, [SUBPIXELS[0], SUBPIXELS[-1]]))
def test_subpixel_sources(session: Session, name: str, samples: int) -> None:
    wanted, channels = SCENES[name]
    wanted = wanted.model_copy(update={"psf": wanted.psf.model_copy(update={"silhouette_samples": samples})})
    plan = planned(wanted, channels, samples)
    found = traced(session, plan, 0.55)
    marked = twin.mark_silhouettes(found.label)
    expected = twin.trace_subpixels(view(plan, 0.55), plan.groups[0], GUARD, marked)
    slots = found.slot[expected.row, expected.column]
    records, hit = found.sub_source[slots], expected.hit
    assert 0.1 < hit.mean() < 0.99
    assert ((records[..., 0] >= 0) == hit).all()
    assert_records(plan, records, expected.radius, expected.gradient, hit, True)
    value = np.moveaxis(found.sub_value[:, slots], 0, -1)[hit]
    # The texture is sampled where each sub-pixel's point was at rest.
    limit = 40 * SINGLE / samples**2
    np.testing.assert_allclose(value, 1 / samples**2 * expected.radiance[hit], rtol=0, atol=limit)


@pytest.mark.parametrize("name", mostly_slow([*SOME[1:3], "bounded paraboloid", "three in a row"], SOME[2:3]))
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


@pytest.mark.parametrize(
    "name", mostly_slow(["sphere moved, 2 x 2", "plane moved, no tilt", "cone, axis"], ["cone, axis"])
)
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


def truth_arguments(session: Session, plan: Plan, frame: int, strip: Strip | None = None) -> dict[str, Any]:
    """Arguments of ground_truth but for its outputs, of a frame or a strip of it."""
    wanted = plan.scene
    other: Eye = "left" if plan.eye == "right" else "right"
    before, now, then = (middle_time(wanted.sequence, k) for k in (frame - 1, frame, frame + 1))
    seen = {"next": (then, plan.eye), "previous": (before, plan.eye), "there": (now, other)}
    return {
        name: pose_structs(poses_at(wanted, *each), "double", ray_step(wanted.camera)) for name, each in seen.items()
    } | {
        "grid": camera_grid(wanted.camera, plan.guard_px, "double", strip),
        "lens": lens_struct(Lens.of(wanted.camera), "double"),
        "surfaces": on_device(session, plan, now, "double"),
        "still": placed_on_device(session, plan, rest_poses(wanted), "double"),
        "opposite": on_device(session, plan, now, "double", other),
        "following": on_device(session, plan, then, "double"),
        "group": group_struct(twin.everything(wanted), len(wanted.objects)),
        "texture": stack(session, plan),
        "to_left": 1 if plan.eye == "right" else -1,
    }


def truth_forms(plan: Plan, names: tuple[str, ...]) -> dict[str, tuple[Any, int]]:
    """Types of the mask and other outputs of ground_truth, and numbers in a pixel."""
    forms = {name: (OUTPUTS[name].dtype, OUTPUTS[name].components or plan.channels) for name in names}
    return {"mask": (np.uint8, 1), **forms}


def truth_outputs(buffers: dict[str, cl.Buffer]) -> dict[str, cl.Buffer | None]:
    """Outputs of ground_truth as it calls them; those that are not wanted are null."""
    named = {"coc" if name == "blur_radius" else name: buffers.get(name) for name in RAY_OUTPUTS}
    return {"mask": buffers["mask"], **named}


def truth_on_device(session: Session, plan: Plan, names: tuple[str, ...], frame: int) -> dict[str, Array]:
    """Outputs of ground_truth, of which the others are null."""
    forms, shape = truth_forms(plan, names), (plan.rows, plan.columns)
    pixels = plan.rows * plan.columns
    buffers = {name: empty(session, pixels * size * dtype().itemsize) for name, (dtype, size) in forms.items()}
    given = truth_arguments(session, plan, frame) | truth_outputs(buffers)
    run(session, built(session, plan, "double"), "ground_truth", shape[::-1], (64, 1), **given)
    return {name: download(session, buffers[name], (*shape, size), dtype) for name, (dtype, size) in forms.items()}


def assert_truth(session: Session, plan: Plan, names: tuple[str, ...], frame: int) -> None:
    """All outputs of ground_truth agree with the twin's."""
    found = truth_on_device(session, plan, names, frame)
    textures = tuple(texture.astype(float) for texture in random_textures(plan.scene, plan.channels))
    expected = ground_truth(plan.scene, textures, frame, plan.eye)
    assert (found["mask"][..., 0] == expected.mask).all()
    seen, nothing = expected.mask, {"depth": np.inf, "object_id": -1}
    for output in names:
        exact = np.asarray(getattr(expected, output), dtype=float)
        exact = exact[..., None] if exact.ndim == 2 else exact
        assert (found[output][~seen] == nothing.get(output, 0)).all(), output
        if output in ("hidden", "occluded", "flow_occluded", "object_id"):
            assert (found[output][seen] == exact[seen]).all(), output
            continue
        # Rounded to float32 at the end, texture filters in float32; near a limb half of float64's digits are left.
        scale = np.abs(exact[seen]).max(initial=1.0)
        limit = 40 * SINGLE if output == "sharp" else SINGLE * np.abs(exact[seen]) + 2e-7 * scale
        assert (np.abs(found[output][seen] - exact[seen]) <= limit).all(), output


@pytest.mark.parametrize("frame", mostly_slow([0, 1], [1]))
@pytest.mark.parametrize("name", mostly_slow(SCENES, SOME))
def test_ground_truth(session: Session, name: str, frame: int) -> None:
    assert_truth(session, planned(*SCENES[name]), MONO, frame)


@pytest.mark.parametrize(("eye", "items"), [("left", ROW), ("right", ROW), ("right", ROW[:2])])
def test_ground_truth_of_a_stereo_pair(session: Session, eye: Eye, items: tuple[Object, ...]) -> None:
    plan = planned(scene(items, stereo=Stereo(baseline=12.0, toe_in=1.0), psf=Psf(silhouette_samples=2)), 1, eye=eye)
    assert_truth(session, plan, tuple(RAY_OUTPUTS), 0)
    if items != ROW:  # there is nothing behind them
        return
    occluded = truth_on_device(session, plan, ("disparity", "occluded"), 0)["occluded"]
    assert 0.02 < occluded.mean() < 0.5


def test_points_are_hidden_and_occluded_in_the_next_frame(session: Session) -> None:
    """The scenes above would not test either if nothing, or everything, were."""
    for name, moves in (("sphere moved, 2 x 2", True), ("three in a row", True), ("plane at rest", False)):
        plan = planned(*SCENES[name])
        found = truth_on_device(session, plan, ("hidden", "flow_occluded", "object_id"), 1)
        last = found["object_id"] == len(plan.scene.objects) - 1  # a wall at rest, or the object itself
        shares = found["hidden"].mean(), found["flow_occluded"][last].mean()
        assert all(
            least < share < 0.5 if moves else share == 0 for share, least in zip(shares, (0.005, 0.003), strict=True)
        )


@pytest.mark.parametrize("output", mostly_slow(MONO, ["depth", "normal", "hidden", "flow_occluded"]))
def test_each_output_alone_is_the_same(session: Session, output: str) -> None:
    plan = planned(*SCENES["sphere moved, 2 x 2"])
    alone = truth_on_device(session, plan, (output,), 1)
    everything = truth_on_device(session, plan, MONO, 1)
    assert set(alone) == {"mask", output}
    for name, array in alone.items():
        assert (array == everything[name]).all()
