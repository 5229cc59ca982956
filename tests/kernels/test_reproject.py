"""reproject.cl against its twin: where pixels go, who wins, what they bring, and that its two depth tests agree."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pyopencl as cl
import pytest
from numpy.typing import NDArray

from clsco.device import Program, Session
from clsco.forward import SEGMENT, ForwardWarp, forward_features
from clsco.layout import Real, camera_struct, flat, pose_structs, structs, surface_structs
from clsco.motion import pose_at
from clsco.plan import Plan, make_plan
from clsco.program import build, download, empty, kernel, launch, upload
from clsco.reference.reproject import (
    NO_WINNER,
    reproject,
    reproject_depth,
    reproject_gather,
    reproject_nearest,
    reproject_rest,
    reproject_targets,
    reproject_winner,
)
from clsco.scene import (
    Camera,
    Cone,
    Cylinder,
    Ellipsoid,
    Fill,
    Motion,
    Object,
    ObjectMotion,
    Plane,
    Quadric,
    Scene,
    Sphere,
)
from clsco.surfaces import place

Array = NDArray[Any]
NONE = np.iinfo(np.int32).max

MOTION = ObjectMotion(velocity=(0.9, -0.4, -7.0), angular_velocity=(20.0, 35.0, -50.0))
SLOW = ObjectMotion(velocity=(0.11, 0.07, 3.0), angular_velocity=(3.0, -2.0, 5.0))
BOX = ((-2.0, 2.5), (-1.5, 2.0), (-4.0, 4.0))
# All features of the ray-surface solution; sizes odd, even, degenerate, and longer than a segment.
SCENES: list[tuple[Object, tuple[int, int]]] = [
    (Plane(motion=MOTION), (1, 1)),
    (Plane(slope_x=0.5, slope_y=-0.3, motion=SLOW), (1, 70)),
    (Plane(slope_x=0.5, motion=MOTION), (2, 9)),
    (Plane(bounds=BOX, motion=SLOW), (40, 61)),
    (Sphere(center=(0.2, -0.3, 280.0), radius=4.0, motion=MOTION), (64, 64)),
    (Cylinder(center=(0.0, 0.1, 270.0), radius=2.0, axis=(1.0, 0.2, 0.3), motion=MOTION), (33, 130)),
    (Cone(apex=(0.0, 0.0, 240.0), half_angle=20.0, motion=SLOW), (50, 31)),
    (Ellipsoid(center=(0.5, 0.0, 260.0), semi_axes=(3.0, 2.0, 5.0), motion=MOTION), (47, 20)),
    (Quadric(center=(0.0, 0.0, 260.0), coefficients=(1, 2, 0, 0.3, 0, 0, 0, 0, -20, 0), motion=SLOW), (29, 64)),
]
IDS = [f"{item.shape}{shape}" for item, shape in SCENES]


@dataclass(frozen=True)
class Case:
    """A scene with its texture and its structs on the device."""

    plan: Plan
    texture: Array
    guard: int
    time: float = 1.0
    real: Real = "double"

    @property
    def item(self) -> Object:
        return self.plan.scene.objects[0]

    @property
    def pose(self) -> Any:
        return pose_at(self.item.motion, self.time, "euler")

    @property
    def rest(self) -> Any:
        return place(self.item, pose_at(self.item.motion, 0.0, "euler"))

    @property
    def shape(self) -> tuple[int, int]:
        return self.plan.rows + 2 * self.guard, self.plan.columns + 2 * self.guard

    @property
    def camera(self) -> Any:
        return camera_struct(self.plan.scene.camera, self.guard, self.real)

    def twin(self) -> tuple[Array, Array, Array]:
        """Known, radiance and inverse depth from the reference."""
        return reproject(self.plan.scene, self.texture.astype(np.float64), self.rest, self.pose, self.guard)

    def warp(self, session: Session, owned: bool | None = None) -> dict[str, Array]:
        """Valid, value, w, coc and status from the device, nothing filled."""
        texture, plan = upload(session, flat(self.texture, np.float32)), self.plan
        warp = ForwardWarp(session, plan, self.camera, texture, self.rest, self.real, owned)
        surface = place(self.item, self.pose)
        done = warp.warp(self.pose, surface, 1.0, [])
        real, channels = structs(self.real)["pose_t"]["shift"].base, plan.channels
        return {
            "valid": download(session, done.valid, self.shape, np.bool_),
            "value": np.moveaxis(download(session, done.value, (channels, *self.shape), np.float32), 0, -1),
            "w": download(session, warp.filler.w, self.shape, real),
            "coc": download(session, done.coc, self.shape, real),
        }


def make_case(item: Object, shape: tuple[int, int], guard: int = 3, channels: int = 1, **camera: Any) -> Case:
    scene = Scene(
        camera=Camera(resolution=(shape[1], shape[0]), **camera),
        objects=(item,),
        motion=Motion(warp="forward"),
        fill=Fill(method="none", domain="span"),
    )
    texture = np.random.default_rng(41).random((*shape, channels)).astype(np.float32)
    # One band for every guard that a test asks for, whatever the blur of the scene needs.
    return Case(replace(make_plan(scene, channels), guard_px=guard), texture, guard)


class Kernels:
    """Runs single kernels of a case on arrays."""

    def __init__(self, session: Session, case: Case, owned: bool) -> None:
        features = forward_features(case.plan, owned)
        self.session, self.case, self.owned = session, case, owned
        self.program: Program = build(session, ["reproject.cl"], features, structs("double"), "double")
        self.surface = upload(session, surface_structs([case.item], [case.rest], "double"))

    def run(self, name: str, size: tuple[int, ...], local: tuple[int, ...], *args: Any) -> None:
        launch(self.session, kernel(self.program, name), size, local, self.case.camera, *args)

    def out(self, dtype: Any, count: int, value: int = 0) -> cl.Buffer:
        buffer = empty(self.session, np.dtype(dtype).itemsize * count)
        cl.enqueue_fill_buffer(self.session.queue, buffer, np.array(value, dtype), 0, buffer.size)
        return buffer

    def rest(self, local: tuple[int, int] = (64, 1)) -> Array:
        rows, columns = self.case.plan.rows, self.case.plan.columns
        rest = self.out(np.float64, rows * columns)
        self.run("reproject_rest", (columns, rows), local, self.surface, rest)
        return download(self.session, rest, (rows, columns), np.float64)

    def targets(self, rest: Array, local: int = 8) -> tuple[Array, Array, Array]:
        """Target, moved, and bounds where there are any."""
        each = -(-rest.shape[1] // SEGMENT) if self.owned else rest.shape[1]
        segments = rest.shape[0] * each
        target, moved = self.out(np.int32, rest.size), self.out(np.float64, rest.size)
        bounds = self.out(np.int32, 2 * segments)
        poses = upload(self.session, pose_structs([self.case.pose], "double"))
        args = (self.surface, poses, upload(self.session, rest), target, moved)
        self.run("reproject_targets", (segments,), (local,), *args, *((bounds,) if self.owned else ()))
        return (
            download(self.session, target, (rest.size,), np.int32),
            download(self.session, moved, (rest.size,), np.float64),
            download(self.session, bounds, (segments, 2), np.int32),
        )

    def nearest(self, target: Array, moved: Array, bounds: Array, band: int, local: int = 1) -> Array:
        pixels = self.case.shape[0] * self.case.shape[1]
        winner = self.out(np.int32, pixels)
        args = (upload(self.session, a) for a in (target, moved, bounds))
        size = (-(-self.case.shape[0] // band),)
        self.run("reproject_nearest", size, (local,), *args, np.int32(band), winner)
        return download(self.session, winner, (pixels,), np.int32)

    def by_atomics(self, target: Array, moved: Array, local: int = 64) -> tuple[Array, Array]:
        """Depth and winner."""
        pixels = self.case.shape[0] * self.case.shape[1]
        depth, winner = self.out(np.int32, pixels), self.out(np.int32, pixels, NONE)
        sources = (upload(self.session, target), upload(self.session, moved))
        self.run("reproject_depth", target.shape, (local,), *sources, depth)
        self.run("reproject_winner", target.shape, (local,), *sources, depth, winner)
        found = download(self.session, depth, (pixels,), np.int32).view(np.float32)
        return found, download(self.session, winner, (pixels,), np.int32)


def narrow(winner: NDArray[np.int64]) -> Array:
    """The twin's winners as the device has them."""
    return np.where(winner == NO_WINNER, NONE, winner).astype(np.int32)


@pytest.mark.parametrize(("item", "shape"), SCENES, ids=IDS)
@pytest.mark.parametrize("owned", [True, False])
def test_each_kernel_is_its_twin(session: Session, item: Object, shape: tuple[int, int], owned: bool) -> None:
    case = make_case(item, shape)
    kernels, pixels = Kernels(session, case, owned), case.shape[0] * case.shape[1]
    rest = kernels.rest()
    expected = reproject_rest(case.plan.scene, case.rest)
    assert expected.any()
    assert ((rest > 0) == (expected > 0)).all()
    # Two orders of the same few operations in double: some eps of what they add up, which cancels at limbs.
    np.testing.assert_allclose(rest, expected, rtol=1e-12)

    target, moved, bounds = kernels.targets(rest)
    expected_target, expected_moved = reproject_targets(case.plan.scene, case.rest, case.pose, rest, case.guard)
    assert (target == expected_target).all()
    np.testing.assert_allclose(moved, expected_moved, rtol=1e-12)
    key = moved.astype(np.float32)
    expected_winner = narrow(reproject_nearest(expected_target, key, pixels))
    if owned:
        for row, rows in enumerate(target.reshape(rest.shape)):
            for i, (low, high) in enumerate(bounds.reshape(rest.shape[0], -1, 2)[row]):
                some = rows[i * SEGMENT : (i + 1) * SEGMENT]
                some = some[some >= 0]
                assert (low, high) == ((some.min(), some.max()) if some.size else (NONE, -1))
        for band in (1, 5, 1000):
            assert (kernels.nearest(target, moved, bounds, band) == expected_winner).all()
    else:
        depth, winner = kernels.by_atomics(target, moved)
        assert (depth == reproject_depth(expected_target, key, pixels)).all()
        assert (winner == narrow(reproject_winner(expected_target, key, depth))).all()
        assert (winner == expected_winner).all()


@pytest.mark.parametrize(("item", "shape"), SCENES, ids=IDS)
@pytest.mark.parametrize("channels", [1, 3])
def test_warp_is_its_twin(session: Session, item: Object, shape: tuple[int, int], channels: int) -> None:
    case = make_case(item, shape, guard=channels - 1, channels=channels)
    known, radiance, w = case.twin()
    found = case.warp(session)
    assert known.any() or shape[0] < 3
    assert (found["valid"] == known).all()
    assert (found["value"] == radiance).all()  # texels are only moved
    np.testing.assert_allclose(found["w"], w, rtol=1e-12)  # as above
    camera = case.camera
    coc = np.where(known, camera["blur_scale"] * (camera["focus_power"] - w), 0.0)
    # What rtol = 1e-12 of w makes of the radius, in px.
    np.testing.assert_allclose(found["coc"], coc, rtol=0, atol=1e-12 * camera["blur_scale"] * w.max(initial=0))


def test_gather_weighs_what_winners_bring(session: Session) -> None:
    case = make_case(*SCENES[3], guard=2, channels=3)
    kernels, pixels = Kernels(session, case, True), case.shape[0] * case.shape[1]
    rng = np.random.default_rng(7)
    sources = case.texture.shape[0] * case.texture.shape[1]
    winner = np.where(rng.random(pixels) < 0.6, rng.integers(0, sources, pixels), NONE).astype(np.int32)
    moved = rng.uniform(0.003, 0.005, sources)
    out = [kernels.out(t, n * pixels, 9) for t, n in (("f4", 3), ("f8", 1), ("f8", 1), ("u1", 1), ("u1", 1))]
    inputs = (upload(session, a) for a in (flat(case.texture, np.float32), moved, winner))
    kernels.run("reproject_gather", case.shape[::-1], (64, 1), np.float32(0.3), *inputs, *out)
    values = np.concatenate([case.texture.reshape(sources, 3), moved[:, None]], axis=1)
    known, expected = reproject_gather(np.where(winner == NONE, NO_WINNER, winner.astype(np.int64)), values)
    assert 0.5 < known.mean() < 0.7
    value = download(session, out[0], (3, pixels), np.float32).T
    assert (value == np.float32(0.3) * expected[:, :3].astype(np.float32)).all()
    assert (download(session, out[1], (pixels,), np.float64) == expected[:, 3]).all()
    assert (download(session, out[3], (pixels,), np.uint8) == known).all()
    assert not download(session, out[4], (pixels,), np.uint8).any()
    assert not download(session, out[2], (pixels,), np.float64)[~known].any()


def test_of_equal_sources_the_first_wins(session: Session) -> None:
    """Depths that differ in double but not in float are a tie; of others the nearest wins, first or last."""
    case = make_case(Plane(motion=SLOW), (1, 200), guard=0)
    rng = np.random.default_rng(13)
    moved = rng.integers(1, 4, 200) * (1 / 250.0) * (1 + 1e-10 * rng.random(200))
    target = rng.integers(-1, 40, 200).astype(np.int32)
    expected = narrow(reproject_nearest(target.astype(np.int64), moved.astype(np.float32), 200))
    best = reproject_depth(target.astype(np.int64), moved.astype(np.float32), 200)
    ties = sum(target[i] >= 0 and np.float32(moved[i]) == best[target[i]] for i in range(200))
    assert ties > (expected != NONE).sum() + 20
    assert (Kernels(session, case, False).by_atomics(target, moved)[1] == expected).all()
    bounds = np.tile(np.array([0, 39], np.int32), (4, 1))
    assert (Kernels(session, case, True).nearest(target, moved, bounds, 16) == expected).all()


def test_local_sizes_change_no_bit(session: Session) -> None:
    case = make_case(*SCENES[4])
    owned, atomic = Kernels(session, case, True), Kernels(session, case, False)
    rest = owned.rest()
    assert (owned.rest((4, 16)) == rest).all()
    first = owned.targets(rest)
    for again in (owned.targets(rest, 1), owned.targets(rest, 64), atomic.targets(rest, 32)):
        assert (again[0] == first[0]).all()
        assert (again[1] == first[1]).all()
    winner = owned.nearest(*first, band=7)
    assert (winner != NONE).sum() > 100
    assert (owned.nearest(*first, band=7, local=4) == winner).all()
    for local in (1, 16, 256):
        assert (atomic.by_atomics(*first[:2], local)[1] == winner).all()


@pytest.mark.parametrize("owned", [True, False])
@pytest.mark.parametrize(("item", "shape"), [SCENES[4], SCENES[5]], ids=[IDS[4], IDS[5]])
def test_both_depth_tests_give_the_same_bits(
    session: Session, item: Object, shape: tuple[int, int], owned: bool
) -> None:
    case = make_case(item, shape)
    found, again = case.warp(session), case.warp(session, owned)
    assert found["valid"].any()
    for name, array in found.items():
        assert (array == again[name]).all(), name


@pytest.mark.parametrize("real", ["double", "float"])
@pytest.mark.parametrize("shift_px", [0.0, 0.25, 0.5, 0.75, 1.0, -0.5, 2.5, -3.5])
@pytest.mark.parametrize("shape", [(30, 41), (32, 140)])
def test_shift_leaves_no_holes(session: Session, shift_px: float, shape: tuple[int, int], real: Real) -> None:
    speed = shift_px * 0.125  # 1 px is 0.125 mm at 250 mm
    item = Plane(motion=ObjectMotion(velocity=(speed, -speed, 0.0)))
    case = replace(make_case(item, shape, guard=0), real=real)
    found = case.warp(session)
    pixels = int(np.floor(shift_px + 0.5))  # right and down
    inside = np.zeros(shape, dtype=bool)
    rows, columns = (slice(max(pixels, 0), n + min(pixels, 0)) for n in shape)
    inside[rows, columns] = True
    assert (found["valid"] == inside).all()
    shifted = np.roll(case.texture, (pixels, pixels), axis=(0, 1))
    assert (found["value"][inside] == shifted[inside]).all()
    assert not found["value"][~inside].any()


@pytest.mark.parametrize("real", ["double", "float"])
@pytest.mark.parametrize(("angle", "turns"), [(90.0, -1), (180.0, -2), (-90.0, 1)])
@pytest.mark.parametrize("side", [24, 25, 66])
def test_quarter_turns_are_exact(session: Session, angle: float, turns: int, side: int, real: Real) -> None:
    item = Plane(motion=ObjectMotion(angular_velocity=(0.0, 0.0, angle)))
    case = replace(make_case(item, (side, side), guard=0), real=real)
    found = case.warp(session)
    assert found["valid"].all()
    assert (found["value"] == np.rot90(case.texture, turns)).all()  # rot90 turns against the clock


def test_what_moves_behind_the_lens_is_gone(session: Session) -> None:
    case = make_case(Plane(motion=ObjectMotion(velocity=(0.0, 0.0, -300.0))), (16, 16))
    assert not case.warp(session)["valid"].any()
