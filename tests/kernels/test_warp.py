"""warp.cl against its twin: where pixels go, who wins, what they bring, both depth tests; then the whole warp."""

from __future__ import annotations

from dataclasses import asdict, replace
from typing import Any

import numpy as np
import pyopencl as cl
import pytest
from numpy.typing import NDArray

from clsco.constants import NO_WINNER, OWNED_PIXELS
from clsco.inputs.textures import Texture
from clsco.opencl.buffers import download, empty, upload
from clsco.opencl.session import Session
from clsco.optics.motion import Pose, rest_center
from clsco.passes.pack import pose_structs
from clsco.passes.placed import PlacedScene
from clsco.passes.warp import ForwardWarp, forward_features
from clsco.records import flat
from clsco.reference.common.geometry import pixel_ray, solve_quadric
from clsco.reference.inpainting.fill import Method, fill_objects
from clsco.reference.trace.trace import padded_grid
from clsco.reference.warp import warp as twin
from clsco.scene.model import DepthMap, ObjectMotion, Plane, Sphere
from tests.kernels.launches import run
from tests.kernels.warps import SLOW, WARPS, Case, gray, make_case
from tests.slow import mostly_slow

Array = NDArray[Any]
NONE = np.iinfo(np.int32).max


class Kernels:
    """Runs single kernels of a case on arrays."""

    def __init__(self, session: Session, case: Case, owned: bool) -> None:
        if owned and session.device.kind == "gpu":
            pytest.skip("needs a processor")
        features = forward_features(case.plan, owned)
        self.session, self.case, self.owned, self.several = session, case, owned, bool(features["SEVERAL"])
        self.far = bool(features["FILL_FAR"])
        forward = case.forward(session, owned)
        self.target, self.surfaces = forward.kernels, forward.rest_surfaces

    def run(self, name: str, size: tuple[int, ...], local: tuple[int, ...], **given: Any) -> None:
        run(self.session, self.target, name, size, local, grid=self.case.grid, lens=self.case.lens, **given)

    def out(self, dtype: Any, count: int, value: int = 0) -> cl.Buffer:
        buffer = empty(self.session, np.dtype(dtype).itemsize * count)
        cl.enqueue_fill_buffer(self.session.queue, buffer, np.array(value, dtype), 0, buffer.size)
        return buffer

    def rest(self, local: tuple[int, int] = (64, 1)) -> tuple[Array, Array]:
        """Inverse depth and object."""
        case, rows, columns = self.case, self.case.plan.rows, self.case.plan.columns
        rest, whose = self.out(np.float64, rows * columns), self.out(np.uint8, rows * columns)
        members = np.uint64(sum(1 << k for k, item in enumerate(case.items) if item.shape != "depth_map"))
        maps = [depth for depth in case.maps if depth is not None]
        given: dict[str, Any] = {"maps": np.stack(maps)} if maps else {}
        given |= {"object": whose} if self.several else {}
        given |= {"surfaces": self.surfaces, "count": len(case.items), "members": members, "rest": rest}
        self.run("reproject_rest", (columns, rows), local, **given)
        found = download(self.session, rest, (rows, columns), np.float64)
        return found, download(self.session, whose, (rows, columns), np.uint8)

    def targets(self, rest: Array, whose: Array, local: int = 8) -> tuple[Array, Array, Array]:
        """Target, moved, and bounds where there are any."""
        each = -(-rest.shape[1] // OWNED_PIXELS) if self.owned else rest.shape[1]
        segments = rest.shape[0] * each
        target, moved = self.out(np.int32, rest.size), self.out(np.float64, rest.size)
        bounds = self.out(np.int32, 2 * segments)
        given: dict[str, Any] = {"object": whose} if self.several else {}
        given |= {"bounds": bounds} if self.owned else {}
        given |= {"surfaces": self.surfaces, "poses": pose_structs(self.case.poses, "double"), "rest": rest}
        self.run("reproject_targets", (segments,), (local,), target=target, moved=moved, **given)
        return (
            download(self.session, target, (rest.size,), np.int32),
            download(self.session, moved, (rest.size,), np.float64),
            download(self.session, bounds, (segments, 2), np.int32),
        )

    def nearest(self, target: Array, moved: Array, bounds: Array, band: int, local: int = 1) -> Array:
        pixels = self.case.shape[0] * self.case.shape[1]
        winner, depth = self.out(np.int32, pixels), self.out(np.int32, pixels)
        given = {"target": target, "moved": moved, "bounds": bounds, "band": band, "winner": winner, "depth": depth}
        self.run("reproject_nearest", (-(-self.case.shape[0] // band),), (local,), **given)
        if self.far:
            expected = twin.reproject_depth(target.astype(np.int64), moved.astype(np.float32), pixels)
            assert (download(self.session, depth, (pixels,), np.float32) == expected).all()
        return download(self.session, winner, (pixels,), np.int32)

    def by_atomics(self, target: Array, moved: Array, local: int = 64) -> tuple[Array, Array]:
        """Depth and winner."""
        pixels = self.case.shape[0] * self.case.shape[1]
        depth, winner = self.out(np.int32, pixels), self.out(np.int32, pixels, NO_WINNER)
        given = {"target": target, "moved": moved, "depth": depth}
        self.run("reproject_depth", target.shape, (local,), **given)
        self.run("reproject_winner", target.shape, (local,), winner=winner, **given)
        found = download(self.session, depth, (pixels,), np.int32).view(np.float32)
        return found, download(self.session, winner, (pixels,), np.int32)

    def gaps(self, winner: Array, depth: Array, local: tuple[int, int] = (1, 8)) -> Array:
        """Known pixels without what shows through."""
        height, width = self.case.shape
        size = (-(-width // (OWNED_PIXELS if self.owned else 1)), height)
        valid = self.out(np.uint8, height * width, 9)
        self.run("reproject_gaps", size, local, depth=depth, winner=winner, valid=valid)
        return download(self.session, valid, (height, width), np.uint8)


def narrow(winner: NDArray[np.int64]) -> Array:
    """The twin's winners as the device has them."""
    return winner.astype(np.int32)


@pytest.mark.parametrize("owned", [True, False])
@pytest.mark.parametrize("name", mostly_slow(WARPS, ["cone 50 x 31", "map before map"]))
def test_each_kernel_is_its_twin(session: Session, name: str, owned: bool) -> None:
    case = make_case(*WARPS[name])
    kernels, pixels, scene = Kernels(session, case, owned), case.shape[0] * case.shape[1], case.plan.scene
    rest, whose = kernels.rest()
    expected, expected_whose = twin.reproject_rest(scene, case.rest, case.maps)
    assert expected.any()
    assert ((rest > 0) == (expected > 0)).all()
    # Two orders of the same few operations in double: some eps of what they add up, which cancels at limbs.
    np.testing.assert_allclose(rest, expected, rtol=1e-12)
    assert (whose == expected_whose).all()

    target, moved, bounds = kernels.targets(rest, whose)
    expected_target, expected_moved = twin.reproject_targets(scene, case.poses, rest, whose, case.guard)
    assert (target == expected_target).all()
    np.testing.assert_allclose(moved, expected_moved, rtol=1e-12)
    key = moved.astype(np.float32)
    nearest = twin.reproject_depth(expected_target, key, pixels)
    expected_winner = narrow(twin.reproject_winner(expected_target, key, nearest))
    if owned:
        for row, rows in enumerate(target.reshape(rest.shape)):
            for i, (low, high) in enumerate(bounds.reshape(rest.shape[0], -1, 2)[row]):
                some = rows[i * OWNED_PIXELS : (i + 1) * OWNED_PIXELS]
                some = some[some >= 0]
                assert (low, high) == ((some.min(), some.max()) if some.size else (NONE, -1))
        for band in (1, 5, 1000):
            assert (kernels.nearest(target, moved, bounds, band) == expected_winner).all()
    else:
        depth, winner = kernels.by_atomics(target, moved)
        assert (depth == nearest).all()
        assert (winner == narrow(twin.reproject_winner(expected_target, key, depth))).all()
        assert (winner == expected_winner).all()


@pytest.mark.parametrize("owned", mostly_slow([True, False], [True]))
@pytest.mark.parametrize("depth_mm", [170.0, 110.0, 70.0])
def test_what_shows_through_a_grown_surface_is_left_out(session: Session, owned: bool, depth_mm: float) -> None:
    """A card comes nearer before a plane. Where it grows more than to four times its size, gaps remain."""
    card = Plane(
        name="card", distance=200.0, bounds=((-1.5, 1.5), (-1.5, 1.5), (-1.0, 1.0)),
        motion=ObjectMotion(velocity=(0.3, 0.0, depth_mm - 200.0)),
    )  # fmt: skip
    far = Plane(distance=380.0, slope_x=0.2)
    case = make_case((card, far), (60, 150))
    rest, whose = twin.reproject_rest(case.plan.scene, case.rest, case.maps)
    target, moved = twin.reproject_targets(case.plan.scene, case.poses, rest, whose, case.guard)
    key, pixels = moved.astype(np.float32), case.shape[0] * case.shape[1]
    depth = twin.reproject_depth(target, key, pixels).reshape(case.shape)
    winner = twin.reproject_winner(target, key, depth.ravel()).reshape(case.shape)
    expected = twin.reproject_gaps(winner, depth, 150)
    left_out = (winner != NO_WINNER) & ~expected
    assert left_out.sum() > 100
    kernels = Kernels(session, case, owned)
    for local in ((1, 8), (64, 1)):
        assert (kernels.gaps(narrow(winner), depth, local) == expected).all()


@pytest.mark.parametrize("name", ["near and far", "map and ball", "map before map"])
def test_groups_show_all_their_objects(name: str) -> None:
    """Otherwise the tests above say little; 0.5 s later, before the maps have turned away."""
    items, shape = WARPS[name]
    seen = replace(make_case(items, shape), time=0.5).twin().object
    assert set(range(len(items))) <= set(np.unique(seen).tolist())


def test_gather_takes_what_winners_bring(session: Session) -> None:
    case = make_case((Plane(),), (40, 61), guard=2, channels=3)
    kernels, pixels = Kernels(session, case, True), case.shape[0] * case.shape[1]
    rng = np.random.default_rng(7)
    sources = case.plan.rows * case.plan.columns
    winner = np.where(rng.random(pixels) < 0.6, rng.integers(0, sources, pixels), NO_WINNER).astype(np.int32)
    moved = rng.uniform(0.003, 0.005, sources)
    out = [kernels.out(t, n * pixels, 9) for t, n in (("f4", 3), ("f8", 1), ("f8", 1), ("u1", 1), ("u1", 1))]
    planes = dict(zip(("value", "w", "coc", "valid", "status"), out, strict=True))
    given = {"texture": flat(case.textures[0], np.float32), "moved": moved, "winner": winner, "surfaces": None}
    kernels.run("reproject_gather", case.shape[::-1], (64, 1), **given, **planes)
    values = np.concatenate([case.textures.reshape(sources, 3), moved[:, None]], axis=1)
    known, expected = twin.reproject_gather(winner.astype(np.int64), values)
    assert 0.5 < known.mean() < 0.7
    value = download(session, out[0], (3, pixels), np.float32).T
    assert (value == expected[:, :3].astype(np.float32)).all()
    assert (download(session, out[1], (pixels,), np.float64) == expected[:, 3]).all()
    assert (download(session, out[3], (pixels,), np.uint8) == known).all()
    assert not download(session, out[4], (pixels,), np.uint8).any()
    assert not download(session, out[2], (pixels,), np.float64)[~known].any()


def test_of_equal_sources_the_first_wins(session: Session) -> None:
    """Depths that differ in double but not in float are a tie; of others the nearest wins, first or last."""
    case = make_case((Plane(),), (1, 200), guard=0, channels=3)
    rng = np.random.default_rng(13)
    moved = rng.integers(1, 4, 200) * (1 / 250.0) * (1 + 1e-10 * rng.random(200))
    target = rng.integers(-1, 40, 200).astype(np.int32)
    points = target.astype(np.int64), moved.astype(np.float32)
    expected = narrow(twin.reproject_winner(*points, twin.reproject_depth(*points, 200)))
    best = twin.reproject_depth(target.astype(np.int64), moved.astype(np.float32), 200)
    ties = sum(target[i] >= 0 and np.float32(moved[i]) == best[target[i]] for i in range(200))
    assert ties > (expected != NO_WINNER).sum() + 20
    assert (Kernels(session, case, False).by_atomics(target, moved)[1] == expected).all()
    bounds = np.tile(np.array([0, 39], np.int32), (4, 1))
    assert (Kernels(session, case, True).nearest(target, moved, bounds, 16) == expected).all()


@pytest.mark.parametrize("name", mostly_slow(["sphere 64 x 64", "map before map"], ["map before map"]))
def test_local_sizes_change_no_bit(session: Session, name: str) -> None:
    case = make_case(*WARPS[name])
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
    assert (winner != NO_WINNER).sum() > 100
    assert (owned.nearest(*first, band=7, local=4) == winner).all()
    for local in (1, 16, 256):
        assert (atomic.by_atomics(*first[:2], local)[1] == winner).all()


@pytest.mark.parametrize("owned", [True, False])
def test_range_of_radii(session: Session, owned: bool) -> None:
    """Few or no pixels are known, in the last column and the last row as well."""
    case = make_case((Plane(),), (9, 70), channels=3)
    kernels, (height, width) = Kernels(session, case, owned), case.shape
    rng = np.random.default_rng(11)
    size = (-(-width // (OWNED_PIXELS if owned else 1)), height)
    for known in (0.0, 0.05, 0.9):
        coc, valid = rng.normal(0, 7, (height, width)), (rng.random((height, width)) < known).astype(np.uint8)
        if known:
            coc[-1, -1], coc[0, 0], valid[-1, -1], valid[0, 0] = -60, 1e-5, 1, 1
        statistics = upload(session, np.array([0, NONE, 3, 4], np.int32))
        kernels.run("note_radii", size, (1, 8), coc=coc, valid=valid, statistics=statistics)
        found = download(session, statistics, (4,), np.int32)
        expected = np.array([60, 1e-5] if known else [0, 0], np.float32).view(np.int32)
        assert found.tolist() == ([*expected.tolist(), 3, 4] if known else [0, NONE, 3, 4])


# Whole frames, which tests/pipeline looks at as well


def bordered(case: Case, values: Array, valid: Array) -> tuple[Array, Array]:
    """Values and validity after the last step, which scenes with a depth map have: the mirror image around them."""
    mapped = any(item.shape == "depth_map" for item in case.items)
    return twin.extend_border(values, valid, case.guard) if mapped else (values, valid)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "domain", "method"),
    [
        ("two balls", "span", "mean_median"), ("near and far", "surface", "ait"), ("map and ball", "span", "ait"),
        ("two balls", "surface", "ait"), ("near and far", "surface", "mean_median"),
        ("map and ball", "surface", "mean_median"),
    ],
)  # fmt: skip
def test_filled_warp_is_its_twin(session: Session, name: str, domain: str, method: Method) -> None:
    items, shape = WARPS[name]
    case = make_case(items, shape, channels=3, method=method, domain=domain)
    new, allowed, placed = case.twin(), None, case.placed(case.poses)
    if domain == "surface" and not any(item.shape == "depth_map" for item in items):
        rays = pixel_ray(case.plan.scene.camera, *padded_grid(case.plan.scene.camera, case.guard))
        allowed = np.zeros(case.shape, dtype=bool)
        for item, surface in zip(items, placed, strict=True):
            assert surface is not None
            allowed |= solve_quadric(surface, item.bounds, rays)[1] > 0
    values = np.concatenate([new.radiance, new.inverse_depth[..., None]], axis=-1)
    filled, objects, status, report = fill_objects(values, new.object, new.known, allowed, method, case.guard)
    assert (status == 1).sum() > 50
    warp = case.forward(session)
    sample, done = warp.scene.posed(case.poses), warp.filler.planes
    assert done.object is not None
    warp.nearest(sample, [])
    warp.gather([])
    assert warp.fill(sample, []) == asdict(report)
    valid = new.known | (status == 1)
    filled, objects, known = twin.fill_entered(filled, objects, valid, new.entered, case.guard)
    status, valid = np.where(known & ~valid, 1, status), known
    filled, valid = bordered(case, filled, valid)
    assert (download(session, done.valid, case.shape, np.bool_) == valid).all()
    assert (download(session, done.status, case.shape, np.uint8) == status).all()
    assert (download(session, done.object, case.shape, np.uint8) == objects).all()
    value = np.moveaxis(download(session, done.value, (3, *case.shape), np.float32), 0, -1)
    # A rounding to float32 of values up to 1 in each sweep.
    np.testing.assert_allclose(value, filled[..., :3], rtol=0, atol=1e-7 * (report.sweeps + 1))
    np.testing.assert_allclose(download(session, done.w, case.shape, np.float64), filled[..., 3], rtol=1e-12)


@pytest.mark.slow
def test_objects_may_share_textures(session: Session) -> None:
    case = make_case(*WARPS["near and far"])
    shared = replace(case, textures=np.stack([case.textures[0], case.textures[0]]))
    texture = Texture(gray(case.textures[0]), 8, "both")
    placed = PlacedScene(session, case.plan.scene, case.plan.psf, [texture, texture], "double")
    done = ForwardWarp(case.plan, placed, case.maps).warp(placed.posed(case.poses), [])
    value = download(session, done.value, case.shape, np.float32)
    assert (value == shared.warp(session)["value"][..., 0]).all()
    assert (value != case.warp(session)["value"][..., 0]).any()


@pytest.mark.slow
def test_any_rigid_motion_is_that_of_its_points(session: Session) -> None:
    """As seen from a moving camera: a turn about any axis and a shift that has nothing to do with the center."""
    case = make_case(*WARPS["map before map"], guard=20)
    rng = np.random.default_rng(47)
    poses = []
    for item in case.items:
        turn, _ = np.linalg.qr(np.eye(3) + 0.01 * rng.standard_normal((3, 3)))
        turn *= np.sign(np.diag(turn))
        poses.append(Pose(turn, (turn - np.eye(3)) @ rest_center(item) + rng.uniform(-1.0, 1.0, 3)))
    forward = case.forward(session)
    done = forward.warp(forward.scene.posed(poses), [])
    assert done.object is not None
    seen = download(session, done.object, case.shape, np.uint8)
    w, value = download(session, done.w, case.shape, np.float64), download(session, done.value, case.shape, np.float32)
    rest, whose = twin.reproject_rest(case.plan.scene, case.rest, case.maps)
    step, (rows, columns) = case.grid["step"], rest.shape
    best: dict[tuple[int, int], tuple[float, int, float]] = {}
    for i, j in np.argwhere(rest > 0):
        k = int(whose[i, j])
        center, z = rest_center(case.items[k]), 1 / rest[i, j]
        point = np.array([step * (j - (columns - 1) / 2) * z, step * ((rows - 1) / 2 - i) * z, z])
        x, y, z = poses[k].rotation @ (point - center) + center + poses[k].shift
        place_px = np.array([(rows - 1) / 2 - y / z / step, (columns - 1) / 2 + x / z / step])
        target = tuple((twin.nearest_pixel(place_px) + 20).tolist())
        inside = 0 <= target[0] < case.shape[0] and 0 <= target[1] < case.shape[1]
        if z > 0 and inside and 1 / z > best.get(target, (0.0,))[0]:
            best[target] = (1 / z, k, float(case.textures[k, i, j, 0]))
    assert {k for _, k, _ in best.values()} == {0, 1, 2, 3}
    assert (seen != 255).sum() == len(best)
    for target, (nearness, k, texel) in best.items():
        assert (seen[target], value[target]) == (k, np.float32(texel))
        assert abs(w[target] / nearness - 1) < 1e-12  # the same few operations in another order


@pytest.mark.slow
@pytest.mark.parametrize("name", ["map alone", "map and ball"])
def test_truth_of_a_depth_map(session: Session, name: str) -> None:
    """Depth, radius, mask and object are those of the planes; nothing is given that is not asked for."""
    names = ("sharp", "filled", "depth", "blur_radius", "mask", "object_id", "normal")
    case = make_case(*WARPS[name], guard=4, channels=3, method="ait")
    warp = case.forward(session)
    sample = warp.scene.posed(case.poses)
    truth, found = warp.truth(sample, names, []), case.warp(session)
    assert set(truth) == set(names) - {"normal"}
    frame = (slice(4, -4), slice(4, -4))
    mask = found["valid"][frame]
    assert 0 < mask.mean() < 1
    assert (truth["mask"] == mask).all()
    assert (truth["sharp"] == found["value"][frame]).all()
    assert (truth["depth"][~mask] == np.inf).all()
    assert (truth["depth"][mask] == 1 / found["w"][frame][mask]).all()
    assert (truth["blur_radius"] == found["coc"][frame].astype(np.float32)).all()
    seen = found.get("object", np.zeros(case.shape))[frame].astype(np.int32)
    assert (truth["object_id"] == np.where(mask, seen, -1)).all()
    assert truth["object_id"].dtype == np.int32
    assert warp.truth(sample, ("mask",), []).keys() == {"mask"}
    assert not warp.truth(sample, ("normal",), [])


@pytest.mark.slow
def test_a_map_of_a_surface_moves_as_the_surface(session: Session) -> None:
    item = Sphere(center=(0.0, 0.0, 280.0), radius=4.0, motion=SLOW)
    case = make_case((item,), (64, 64))
    depth = twin.reproject_rest(case.plan.scene, case.rest, case.maps)[0]
    mapped = make_case((DepthMap(depth="ball.npy", center=item.center, motion=SLOW),), (64, 64))
    placed = PlacedScene(
        session, mapped.plan.scene, mapped.plan.psf, [Texture(gray(case.textures[0]), 8, "ball")], "double"
    )
    warp = ForwardWarp(replace(mapped.plan, guard_px=case.guard), placed, [depth])
    done, expected = warp.warp(placed.posed(case.poses), []), case.warp(session)
    assert 100 < expected["valid"].sum() < 4000
    frame = (slice(case.guard, -case.guard), slice(case.guard, -case.guard))
    assert (download(session, done.valid, case.shape, np.bool_) == expected["valid"])[frame].all()
    assert (download(session, done.value, case.shape, np.float32) == expected["value"][..., 0])[frame].all()
