"""reproject.cl against its twin: where pixels go, who wins, what they bring, and that its two depth tests agree."""

from __future__ import annotations

from dataclasses import dataclass, replace
from hashlib import sha256
from typing import Any

import numpy as np
import pyopencl as cl
import pytest
from numpy.typing import NDArray

from clsco.device import Program, Session
from clsco.forward import SEGMENT, ForwardWarp, forward_features
from clsco.layout import Real, camera_struct, flat, pose_structs, structs
from clsco.motion import Pose, pose_at, rest_center
from clsco.plan import Plan, make_plan
from clsco.program import build, download, empty, kernel, launch, upload
from clsco.reference.reproject import (
    NO_WINNER,
    Reprojected,
    nearest_pixel,
    reproject,
    reproject_depth,
    reproject_gaps,
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
    DepthMap,
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
from clsco.surfaces import PlacedSurface, place

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


# Several objects: overlapping, one inside another, equally near ones, a depth map among analytic surfaces and alone.
NEAR, INSIDE = Sphere(center=(0.4, 0.2, 200.0), radius=1.5, motion=SLOW), Sphere(center=(0.5, 0.2, 200.0), radius=0.7)
FAR = Plane(distance=380.0, slope_x=0.2, motion=ObjectMotion(velocity=(-3.0, 1.0, 5.0)))
MAP = DepthMap(depth="card.npy", center=(0.1, 0.0, 260.0), motion=MOTION)
GROUPS: dict[str, tuple[tuple[Object, ...], tuple[int, int]]] = {
    "near and far": ((NEAR, FAR), (40, 131)),
    "one in another": ((FAR, INSIDE, NEAR), (50, 50)),
    "equally near": ((Plane(name="a", motion=SLOW), Plane(name="b", motion=MOTION)), (30, 40)),
    "map alone": ((MAP,), (40, 70)),
    "map and ball": ((NEAR, MAP), (40, 70)),
    "map before map": ((FAR, MAP, DepthMap(depth="other.npy", center=(0.0, 0.0, 260.0), motion=SLOW), NEAR), (33, 65)),
}


@dataclass(frozen=True)
class Case:
    """A scene with its textures (objects, rows, columns, channels) and its structs on the device."""

    plan: Plan
    textures: Array
    guard: int
    time: float = 1.0
    real: Real = "double"

    @property
    def items(self) -> tuple[Object, ...]:
        return self.plan.scene.objects

    @property
    def poses(self) -> list[Pose]:
        return [pose_at(item.motion, self.time, "euler") for item in self.items]

    @property
    def rest(self) -> list[PlacedSurface | None]:
        return self.placed([pose_at(item.motion, 0.0, "euler") for item in self.items])

    @property
    def maps(self) -> list[Array | None]:
        """Cards before nothing, a little uneven, each covering less on its left."""
        rng = np.random.default_rng(43)
        w = rng.uniform(1 / 262.0, 1 / 258.0, (len(self.items), self.plan.rows, self.plan.columns))
        w[:, :4] = w[:, :, -9:] = 0.0
        covered = np.arange(self.plan.columns) >= 20 * np.arange(len(self.items))[:, None]
        return [w[k] * covered[k] if is_map(item) else None for k, item in enumerate(self.items)]

    @property
    def shape(self) -> tuple[int, int]:
        return self.plan.rows + 2 * self.guard, self.plan.columns + 2 * self.guard

    @property
    def camera(self) -> Any:
        return camera_struct(self.plan.scene.camera, self.guard, self.real)

    def placed(self, poses: list[Pose]) -> list[PlacedSurface | None]:
        return [None if is_map(item) else place(item, pose) for item, pose in zip(self.items, poses, strict=True)]

    def twin(self) -> Reprojected:
        """What is known according to the reference."""
        textures = list(self.textures.astype(np.float64))
        return reproject(self.plan.scene, textures, self.rest, self.maps, self.poses, self.guard)

    def forward(self, session: Session, owned: bool | None = None) -> ForwardWarp:
        texture = upload(session, np.stack([flat(texture, np.float32) for texture in self.textures]))
        return ForwardWarp(session, self.plan, self.camera, texture, self.rest, self.maps, self.real, owned)

    def warp(self, session: Session, owned: bool | None = None) -> dict[str, Array]:
        """Valid, value, w, coc and object from the device, nothing filled."""
        done = self.forward(session, owned).warp(self.poses, self.placed(self.poses), 1.0, [])
        real, channels = structs(self.real)["pose_t"]["shift"].base, self.plan.channels
        seen = {} if done.object is None else {"object": download(session, done.object, self.shape, np.uint8)}
        return seen | {
            "valid": download(session, done.valid, self.shape, np.bool_),
            "value": np.moveaxis(download(session, done.value, (channels, *self.shape), np.float32), 0, -1),
            "w": download(session, done.w, self.shape, real),
            "coc": download(session, done.coc, self.shape, real),
        }


def is_map(item: Object) -> bool:
    return item.shape == "depth_map"


def make_group(
    items: tuple[Object, ...], shape: tuple[int, int], guard: int = 3, channels: int = 1, **fill: Any
) -> Case:
    scene = Scene(
        camera=Camera(resolution=(shape[1], shape[0])),
        objects=items,
        motion=Motion(warp="forward"),
        fill=Fill(**{"method": "none", "domain": "span"} | fill),
    )
    textures = np.random.default_rng(41).random((len(items), *shape, channels)).astype(np.float32)
    # One band for every guard that a test asks for, whatever the blur of the scene needs.
    plan = make_plan(scene.model_copy(update={"objects": (FAR,)}), channels, ())
    return Case(replace(plan, scene=scene, guard_px=guard), textures, guard)


def make_case(item: Object, shape: tuple[int, int], guard: int = 3, channels: int = 1) -> Case:
    return make_group((item,), shape, guard, channels)


class Kernels:
    """Runs single kernels of a case on arrays."""

    def __init__(self, session: Session, case: Case, owned: bool) -> None:
        features = forward_features(case.plan, owned)
        self.session, self.case, self.owned, self.several = session, case, owned, bool(features["SEVERAL"])
        self.far = bool(features["FILL_FAR"])
        self.program: Program = build(session, ["reproject.cl"], features, structs("double"), "double")
        self.surfaces = case.forward(session, owned).rest_surfaces

    def run(self, name: str, size: tuple[int, ...], local: tuple[int, ...], *args: Any) -> None:
        launch(self.session, kernel(self.program, name), size, local, self.case.camera, *args)

    def out(self, dtype: Any, count: int, value: int = 0) -> cl.Buffer:
        buffer = empty(self.session, np.dtype(dtype).itemsize * count)
        cl.enqueue_fill_buffer(self.session.queue, buffer, np.array(value, dtype), 0, buffer.size)
        return buffer

    def rest(self, local: tuple[int, int] = (64, 1)) -> tuple[Array, Array]:
        """Inverse depth and object."""
        case, rows, columns = self.case, self.case.plan.rows, self.case.plan.columns
        rest, whose = self.out(np.float64, rows * columns), self.out(np.uint8, rows * columns)
        members = np.uint64(sum(1 << k for k, item in enumerate(case.items) if not is_map(item)))
        maps = [depth for depth in case.maps if depth is not None]
        args = [self.surfaces, np.int32(len(case.items)), members]
        args += [upload(self.session, np.stack(maps))] if maps else []
        self.run("reproject_rest", (columns, rows), local, *args, rest, *((whose,) if self.several else ()))
        found = download(self.session, rest, (rows, columns), np.float64)
        return found, download(self.session, whose, (rows, columns), np.uint8)

    def targets(self, rest: Array, whose: Array, local: int = 8) -> tuple[Array, Array, Array]:
        """Target, moved, and bounds where there are any."""
        each = -(-rest.shape[1] // SEGMENT) if self.owned else rest.shape[1]
        segments = rest.shape[0] * each
        target, moved = self.out(np.int32, rest.size), self.out(np.float64, rest.size)
        bounds = self.out(np.int32, 2 * segments)
        inputs = [upload(self.session, a) for a in (pose_structs(self.case.poses, "double"), rest, whose)]
        args = [self.surfaces, *inputs[:2], target, moved]
        args += [inputs[2]] if self.several else []
        self.run("reproject_targets", (segments,), (local,), *args, *((bounds,) if self.owned else ()))
        return (
            download(self.session, target, (rest.size,), np.int32),
            download(self.session, moved, (rest.size,), np.float64),
            download(self.session, bounds, (segments, 2), np.int32),
        )

    def nearest(self, target: Array, moved: Array, bounds: Array, band: int, local: int = 1) -> Array:
        pixels = self.case.shape[0] * self.case.shape[1]
        winner, depth = self.out(np.int32, pixels), self.out(np.int32, pixels)
        inputs = [upload(self.session, a) for a in (target, moved, bounds)]
        size = (-(-self.case.shape[0] // band),)
        self.run("reproject_nearest", size, (local,), *inputs, np.int32(band), winner, *((depth,) if self.far else ()))
        if self.far:
            expected = reproject_depth(target.astype(np.int64), moved.astype(np.float32), pixels)
            assert (download(self.session, depth, (pixels,), np.float32) == expected).all()
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

    def gaps(self, winner: Array, depth: Array, local: tuple[int, int] = (1, 8)) -> Array:
        """What is known without what shows through."""
        height, width = self.case.shape
        size = (-(-width // (SEGMENT if self.owned else 1)), height)
        valid = self.out(np.uint8, height * width, 9)
        self.run("reproject_gaps", size, local, upload(self.session, depth), upload(self.session, winner), valid)
        return download(self.session, valid, (height, width), np.uint8)


def narrow(winner: NDArray[np.int64]) -> Array:
    """The twin's winners as the device has them."""
    return np.where(winner == NO_WINNER, NONE, winner).astype(np.int32)


CASES = [((item,), shape) for item, shape in SCENES] + list(GROUPS.values())
CASE_IDS = IDS + list(GROUPS)


@pytest.mark.parametrize(("items", "shape"), CASES, ids=CASE_IDS)
@pytest.mark.parametrize("owned", [True, False])
def test_each_kernel_is_its_twin(
    session: Session, items: tuple[Object, ...], shape: tuple[int, int], owned: bool
) -> None:
    case = make_group(items, shape)
    kernels, pixels, scene = Kernels(session, case, owned), case.shape[0] * case.shape[1], case.plan.scene
    rest, whose = kernels.rest()
    expected, expected_whose = reproject_rest(scene, case.rest, case.maps)
    assert expected.any()
    assert ((rest > 0) == (expected > 0)).all()
    # Two orders of the same few operations in double: some eps of what they add up, which cancels at limbs.
    np.testing.assert_allclose(rest, expected, rtol=1e-12)
    assert (whose == expected_whose).all()

    target, moved, bounds = kernels.targets(rest, whose)
    expected_target, expected_moved = reproject_targets(scene, case.poses, rest, whose, case.guard)
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


@pytest.mark.parametrize(("items", "shape"), CASES, ids=CASE_IDS)
@pytest.mark.parametrize("channels", [1, 3])
def test_warp_is_its_twin(session: Session, items: tuple[Object, ...], shape: tuple[int, int], channels: int) -> None:
    case = make_group(items, shape, guard=channels - 1, channels=channels)
    expected, found = case.twin(), case.warp(session)
    known, w = expected.known, expected.inverse_depth
    assert known.any() or shape[0] < 3
    assert (found["valid"] == known).all()
    assert (found["value"] == expected.radiance).all()  # texels are only moved
    np.testing.assert_allclose(found["w"], w, rtol=1e-12)  # as above
    assert ("object" in found) == (len(items) > 1)
    if "object" in found:
        assert (found["object"] == expected.object).all()
    camera = case.camera
    coc = np.where(known, camera["blur_scale"] * (camera["focus_power"] - w), 0.0)
    # What rtol = 1e-12 of w makes of the radius, in px.
    np.testing.assert_allclose(found["coc"], coc, rtol=0, atol=1e-12 * camera["blur_scale"] * w.max(initial=0))


@pytest.mark.parametrize("owned", [True, False])
@pytest.mark.parametrize("depth_mm", [170.0, 110.0, 70.0])
def test_what_shows_through_a_grown_surface_is_left_out(session: Session, owned: bool, depth_mm: float) -> None:
    """A card comes nearer before a plane. Where it grows more than to four times its size, gaps remain."""
    card = Plane(
        name="card", distance=200.0, bounds=((-1.5, 1.5), (-1.5, 1.5), (-1.0, 1.0)),
        motion=ObjectMotion(velocity=(0.3, 0.0, depth_mm - 200.0)),
    )  # fmt: skip
    case = make_group((card, FAR), (60, 150))
    rest, whose = reproject_rest(case.plan.scene, case.rest, case.maps)
    target, moved = reproject_targets(case.plan.scene, case.poses, rest, whose, case.guard)
    key, pixels = moved.astype(np.float32), case.shape[0] * case.shape[1]
    depth = reproject_depth(target, key, pixels).reshape(case.shape)
    winner = reproject_winner(target, key, depth.ravel()).reshape(case.shape)
    expected = reproject_gaps(winner, depth, 150)
    left_out = (winner != NO_WINNER) & ~expected
    assert left_out.sum() > 100
    kernels = Kernels(session, case, owned)
    for local in ((1, 8), (64, 1)):
        assert (kernels.gaps(narrow(winner), depth, local) == expected).all()


@pytest.mark.parametrize("name", ["near and far", "map and ball", "map before map"])
def test_groups_show_all_their_objects(name: str) -> None:
    """Otherwise the tests above say little; 0.5 s later, before the maps have turned away."""
    items, shape = GROUPS[name]
    seen = replace(make_group(items, shape), time=0.5).twin().object
    assert set(range(len(items))) <= set(np.unique(seen).tolist())


def test_gather_weighs_what_winners_bring(session: Session) -> None:
    case = make_case(*SCENES[3], guard=2, channels=3)
    kernels, pixels = Kernels(session, case, True), case.shape[0] * case.shape[1]
    rng = np.random.default_rng(7)
    sources = case.plan.rows * case.plan.columns
    winner = np.where(rng.random(pixels) < 0.6, rng.integers(0, sources, pixels), NONE).astype(np.int32)
    moved = rng.uniform(0.003, 0.005, sources)
    out = [kernels.out(t, n * pixels, 9) for t, n in (("f4", 3), ("f8", 1), ("f8", 1), ("u1", 1), ("u1", 1))]
    inputs = [upload(session, a) for a in (flat(case.textures[0], np.float32), moved, winner)]
    kernels.run("reproject_gather", case.shape[::-1], (64, 1), np.float32(0.3), *inputs, *out)
    values = np.concatenate([case.textures.reshape(sources, 3), moved[:, None]], axis=1)
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


@pytest.mark.parametrize("items", [(SCENES[4][0],), GROUPS["map before map"][0]], ids=["one", "several"])
def test_local_sizes_change_no_bit(session: Session, items: tuple[Object, ...]) -> None:
    case = make_group(items, (64, 64))
    owned, atomic = Kernels(session, case, True), Kernels(session, case, False)
    rest, whose = owned.rest()
    again, whose_again = owned.rest((4, 16))
    assert (again == rest).all()
    assert (whose_again == whose).all()
    first = owned.targets(rest, whose)
    for other in (owned.targets(rest, whose, 1), owned.targets(rest, whose, 64), atomic.targets(rest, whose, 32)):
        assert (other[0] == first[0]).all()
        assert (other[1] == first[1]).all()
    winner = owned.nearest(*first, band=7)
    assert (winner != NONE).sum() > 100
    assert (owned.nearest(*first, band=7, local=4) == winner).all()
    for local in (1, 16, 256):
        assert (atomic.by_atomics(*first[:2], local)[1] == winner).all()


@pytest.mark.parametrize(("items", "shape"), CASES[4:6] + CASES[9:], ids=CASE_IDS[4:6] + CASE_IDS[9:])
@pytest.mark.parametrize("fill", ["ait", "mean_median"])
def test_both_depth_tests_give_the_same_bits(
    session: Session, items: tuple[Object, ...], shape: tuple[int, int], fill: str
) -> None:
    """One digest of all planes, whatever device, order of work and repetition; twice each."""
    case = make_group(items, shape, channels=3, method=fill)
    digests = set()
    for owned in (True, False, True, False):
        found = case.warp(session, owned)
        assert found["valid"].any()
        digests.add(sha256(b"".join(found[name].tobytes() for name in sorted(found))).hexdigest())
    assert len(digests) == 1


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
    shifted = np.roll(case.textures[0], (pixels, pixels), axis=(0, 1))
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
    assert (found["value"] == np.rot90(case.textures[0], turns)).all()  # rot90 turns against the clock


def test_what_moves_behind_the_lens_is_gone(session: Session) -> None:
    case = make_case(Plane(motion=ObjectMotion(velocity=(0.0, 0.0, -300.0))), (16, 16))
    assert not case.warp(session)["valid"].any()


def test_any_rigid_motion_is_that_of_its_points(session: Session) -> None:
    """As seen from a moving camera: a turn about any axis and a shift that has nothing to do with the center."""
    case = make_group(*GROUPS["map before map"], guard=20)
    rng = np.random.default_rng(47)
    poses = []
    for item in case.items:
        turn, _ = np.linalg.qr(np.eye(3) + 0.01 * rng.standard_normal((3, 3)))
        turn *= np.sign(np.diag(turn))
        poses.append(Pose(turn, (turn - np.eye(3)) @ rest_center(item) + rng.uniform(-1.0, 1.0, 3)))
    done = case.forward(session).warp(poses, case.placed(poses), 1.0, [])
    assert done.object is not None
    seen = download(session, done.object, case.shape, np.uint8)
    w, value = download(session, done.w, case.shape, np.float64), download(session, done.value, case.shape, np.float32)
    rest, whose = reproject_rest(case.plan.scene, case.rest, case.maps)
    step, (rows, columns) = case.camera["step"], rest.shape
    best: dict[tuple[int, int], tuple[float, int, float]] = {}
    for i, j in np.argwhere(rest > 0):
        k = int(whose[i, j])
        center, z = rest_center(case.items[k]), 1 / rest[i, j]
        point = np.array([step * (j - (columns - 1) / 2) * z, step * ((rows - 1) / 2 - i) * z, z])
        x, y, z = poses[k].rotation @ (point - center) + center + poses[k].shift
        place_px = np.array([(rows - 1) / 2 - y / z / step, (columns - 1) / 2 + x / z / step])
        target = tuple((nearest_pixel(place_px) + 20).tolist())
        inside = 0 <= target[0] < case.shape[0] and 0 <= target[1] < case.shape[1]
        if z > 0 and inside and 1 / z > best.get(target, (0.0,))[0]:
            best[target] = (1 / z, k, float(case.textures[k, i, j, 0]))
    assert {k for _, k, _ in best.values()} == {0, 1, 2, 3}
    assert (seen != 255).sum() == len(best)
    for target, (nearness, k, texel) in best.items():
        assert (seen[target], value[target]) == (k, np.float32(texel))
        assert abs(w[target] / nearness - 1) < 1e-12  # the same few operations in another order


@pytest.mark.parametrize("name", ["map alone", "map and ball"])
def test_truth_of_a_depth_map(session: Session, name: str) -> None:
    """Depth, radius, mask and object are those of the planes; nothing is given that the plan does not ask for."""
    names = ("sharp", "filled", "depth", "coc", "mask", "object_id", "normal")
    case = make_group(*GROUPS[name], guard=4, channels=3, method="ait")
    asked = replace(case, plan=replace(case.plan, truth=names))
    poses = case.poses
    warp = asked.forward(session)
    truth, found = warp.truth(poses, case.placed(poses), []), case.warp(session)
    assert set(truth) == set(names) - {"normal"}
    frame = (slice(4, -4), slice(4, -4))
    mask = found["valid"][frame]
    assert 0 < mask.mean() < 1
    assert (truth["mask"] == mask).all()
    assert (truth["sharp"] == found["value"][frame]).all()
    assert (truth["depth"][~mask] == np.inf).all()
    assert (truth["depth"][mask] == (1 / found["w"][frame][mask]).astype(np.float32)).all()
    assert (truth["coc"] == found["coc"][frame].astype(np.float32)).all()
    assert (truth["object_id"] == np.where(mask, found["object"][frame] if "object" in found else 0, -1)).all()
    assert not case.forward(session).truth(poses, case.placed(poses), [])


def test_a_map_of_a_surface_moves_as_the_surface(session: Session) -> None:
    item = Sphere(center=(0.0, 0.0, 280.0), radius=4.0, motion=SLOW)
    case = make_case(item, (64, 64))
    depth = reproject_rest(case.plan.scene, case.rest, case.maps)[0]
    mapped = make_case(DepthMap(depth="ball.npy", center=item.center, motion=SLOW), (64, 64))
    texture = upload(session, flat(case.textures[0], np.float32)[None])
    warp = ForwardWarp(session, mapped.plan, case.camera, texture, [None], [depth], "double")
    done, expected = warp.warp(case.poses, [None], 1.0, []), case.warp(session)
    assert 100 < expected["valid"].sum() < 4000
    assert (download(session, done.valid, case.shape, np.bool_) == expected["valid"]).all()
    assert (download(session, done.value, case.shape, np.float32) == expected["value"][..., 0]).all()
